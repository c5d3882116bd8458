"""Colored CASSI: a single disperser behind a mask of optical filters, whose transmittance depends on the band.

g(x, y) = ∫ t(x − D(λ), y, λ) f(x − D(λ), y, λ) dλ; to first order, with d whole pixels a band, g[y, x + dk] = Σ_k t[k, y, x]
f[k, y, x]. Source: Arguello and Arce, IEEE Trans. Image Process. 23 (2014) 1896.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram.codes.patterns import check_code

from ._disperser import Disperser

if TYPE_CHECKING:
    from shadowgram.codes._colored_board import VoxelPairs
    from shadowgram.operators.base import LinearOperator


@dataclass(frozen=True, kw_only=True)
class ColoredCASSI(Disperser):
    """Geometry of a colored CASSI; parameters as for `CASSI`.

    Examples
    --------
    >>> import shadowgram as sg
    >>> imager = sg.ColoredCASSI(cube_shape=(12, 32, 32), wavelengths=(450, 650))
    >>> code = sg.codes.colored(shots=3, shape=imager.code_shape, filters="four", seed=0)
    >>> imager.operator(code).out_shape
    (3, 32, 43)
    """

    @property
    def code_shape(self) -> tuple[int, int, int]:
        """(band, y, x) of the colored coded aperture."""
        return self.cube_shape

    def effective_code(self, code: np.ndarray) -> np.ndarray:
        """Transmittance that each voxel sees, (shot, band, y, x)."""
        return check_code(code, self.code_shape).astype(np.float64)

    def voxel_pairs(self) -> VoxelPairs:
        """Voxels of a row that share detector elements, for `shadowgram.codes.design`."""
        from ._dispersed_pairs import voxel_pairs

        return voxel_pairs(self._dispersion, self.cube_shape)

    def operator(self, code: np.ndarray) -> LinearOperator:
        """Forward model with `code` (shot, band, y, x): datacube → snapshots (shot, y, x + last displacement)."""
        from ._shift_operators import ColoredOperator, DispersedOperator

        code = check_code(code, self.code_shape)
        step = self._dispersion.whole_step
        if step is not None:
            return ColoredOperator(code, step)
        return DispersedOperator(code, self.cube_shape, self._dispersion)
