"""Colored CASSI: a single disperser behind a mask of optical filters, whose transmittance depends on the band.

g[y, x + dk] = Σ_k t[k, y, x] f[k, y, x]. Source: Arguello and Arce, IEEE Trans. Image Process. 23 (2014) 1896.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram.codes.patterns import check_code

from .cassi import check_geometry, even_resolution
from .resolution import Resolution

if TYPE_CHECKING:
    from ._shift_operators import ColoredOperator


@dataclass(frozen=True, kw_only=True)
class ColoredCASSI:
    """Geometry of a colored CASSI; parameters as for `CASSI`.

    Examples
    --------
    >>> import shadowgram as sg
    >>> imager = sg.ColoredCASSI(cube_shape=(12, 32, 32), wavelengths=(450, 650))
    >>> code = sg.codes.colored(shots=3, shape=imager.code_shape, filters="four", seed=0)
    >>> imager.operator(code).out_shape
    (3, 32, 43)
    """

    cube_shape: tuple[int, int, int]
    wavelengths: tuple[float, float]
    pitch: float = 10.0
    band_shift: int = 1

    def __post_init__(self) -> None:
        check_geometry(self.cube_shape, self.wavelengths, self.pitch, self.band_shift)

    @property
    def code_shape(self) -> tuple[int, int, int]:
        """(band, y, x) of the colored coded aperture."""
        return self.cube_shape

    @property
    def resolution(self) -> Resolution:
        """The datacube and its resolution."""
        return even_resolution(self.cube_shape, self.wavelengths, self.pitch)

    def effective_code(self, code: np.ndarray) -> np.ndarray:
        """Transmittance that each voxel sees, (shot, band, y, x)."""
        return check_code(code, self.code_shape).astype(np.float64)

    def operator(self, code: np.ndarray) -> ColoredOperator:
        """Forward model with `code` (shot, band, y, x): datacube → snapshots (shot, y, x + band_shift·(bands − 1))."""
        from ._shift_operators import ColoredOperator

        return ColoredOperator(check_code(code, self.code_shape), self.band_shift)
