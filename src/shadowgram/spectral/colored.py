"""Colored CASSI: a single disperser behind a mask of optical filters, whose transmittance depends on the band.

g(x, y) = ∫ t(x − D(λ), y, λ) f(x − D(λ), y, λ) dλ; to first order, with d whole pixels a band, g[y, x + dk] = Σ_k t[k, y, x]
f[k, y, x]. Source: Arguello and Arce, IEEE Trans. Image Process. 23 (2014) 1896.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from shadowgram.codes.patterns import check_code

from ._dispersion import Dispersion
from .cassi import check_geometry, dispersion_of, even_resolution, finer_fields
from .resolution import Resolution

if TYPE_CHECKING:
    from shadowgram.operators.base import LinearOperator


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
    band_shift: float | None = None
    shear: str = "centre"
    dispersion: tuple[tuple[float, float], ...] | None = None
    reference_bands: int | None = None

    def __post_init__(self) -> None:
        check_geometry(self)

    @cached_property
    def _dispersion(self) -> Dispersion:
        return dispersion_of(self)

    @property
    def displacements(self) -> np.ndarray:
        """(band,) px; displacement of each band's centre on the detector."""
        return self._dispersion.centres

    @property
    def code_shape(self) -> tuple[int, int, int]:
        """(band, y, x) of the colored coded aperture."""
        return self.cube_shape

    @property
    def resolution(self) -> Resolution:
        """The datacube and its resolution."""
        vignetted = self._dispersion.vignetted(self.cube_shape[2])
        return even_resolution(self.cube_shape, self.wavelengths, self.pitch, vignetted)

    def effective_code(self, code: np.ndarray) -> np.ndarray:
        """Transmittance that each voxel sees, (shot, band, y, x)."""
        return check_code(code, self.code_shape).astype(np.float64)

    def operator(self, code: np.ndarray) -> LinearOperator:
        """Forward model with `code` (shot, band, y, x): datacube → snapshots (shot, y, x + last displacement)."""
        from ._shift_operators import ColoredOperator, DispersedOperator

        code = check_code(code, self.code_shape)
        step = self._dispersion.whole_step
        if step is not None:
            return ColoredOperator(code, step)
        return DispersedOperator(code, self.cube_shape, self._dispersion)

    def finer(self, factor: int) -> ColoredCASSI:
        """Return the same instrument with finer bands and the exact shear, as `CASSI.finer` does.

        Its code has the finer bands too: that of this imager, (shot, band, y, x), repeated along them, as the filters are known
        for this imager's bands only.

        Examples
        --------
        >>> import numpy as np, shadowgram as sg
        >>> imager = sg.ColoredCASSI(cube_shape=(4, 8, 8), wavelengths=(450, 650))
        >>> code = sg.codes.colored(shots=2, shape=imager.code_shape, seed=0)
        >>> imager.finer(5).operator(np.repeat(code, 5, axis=1)).in_shape
        (20, 8, 8)
        """
        return dataclasses.replace(self, **finer_fields(self, factor))
