"""Operators of the CASSI family: the code or the snapshot shifts from band to band.

By whole pixels: `ShiftOperator` and `ColoredOperator`. By any distance, each voxel over the pixels of its footprint:
`DispersedOperator`, where the snapshot shifts, and `SmearedOperator`, where the code does.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from shadowgram._threads import run_chunks
from shadowgram.operators.base import LinearOperator, Shape
from shadowgram.operators.structure import shot_gram

from . import _shift_kernels as kernels
from ._dispersion import Dispersion, Footprints, smeared_code


@dataclass(frozen=True, eq=False)
class ShiftOperator(LinearOperator):
    """g[q, y, x + k·out_shift] = Σ_k code[q, y, x + k·code_shift] f[k, y, x]."""

    code: np.ndarray
    cube_shape: tuple[int, int, int]
    code_shift: int
    out_shift: int

    @property
    def in_shape(self) -> Shape:
        """(band, y, x) of the datacube."""
        return self.cube_shape

    @property
    def out_shape(self) -> Shape:
        """(shot, y, x) of the snapshots."""
        bands, ny, nx = self.cube_shape
        return len(self.code), ny, nx + (bands - 1) * self.out_shift

    def _forward(self, x: np.ndarray, out: np.ndarray) -> None:
        rows = self.cube_shape[1]
        run_chunks(kernels.shift_forward, rows, 8, x, self.code, self.code_shift, self.out_shift, out)

    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None:
        rows = self.cube_shape[1]
        run_chunks(kernels.shift_adjoint, rows, 8, y, self.code, self.code_shift, self.out_shift, out)


@dataclass(frozen=True, eq=False)
class ColoredOperator(LinearOperator):
    """g[q, y, x + k·out_shift] = Σ_k code[q, k, y, x] f[k, y, x]."""

    code: np.ndarray
    out_shift: int

    @property
    def in_shape(self) -> Shape:
        """(band, y, x) of the datacube."""
        return self.code.shape[1:]

    @property
    def out_shape(self) -> Shape:
        """(shot, y, x) of the snapshots."""
        shots, bands, ny, nx = self.code.shape
        return shots, ny, nx + (bands - 1) * self.out_shift

    def _forward(self, x: np.ndarray, out: np.ndarray) -> None:
        run_chunks(kernels.colored_forward, self.code.shape[2], 8, x, self.code, self.out_shift, out)

    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None:
        run_chunks(kernels.colored_adjoint, self.code.shape[2], 8, y, self.code, self.out_shift, out)


@dataclass(frozen=True, eq=False)
class DispersedOperator(LinearOperator):
    """g[q, y, x + first[k] + j] = Σ_k Σ_j weights[k, j] code[q, k, y, x] f[k, y, x]; a code of one band codes all bands."""

    code: np.ndarray
    cube_shape: tuple[int, int, int]
    dispersion: Dispersion

    @property
    def in_shape(self) -> Shape:
        """(band, y, x) of the datacube."""
        return self.cube_shape

    @property
    def out_shape(self) -> Shape:
        """(shot, y, x) of the snapshots."""
        _, ny, nx = self.cube_shape
        return len(self.code), ny, nx + self.dispersion.extra_columns

    @cached_property
    def _layout(self) -> _Layout:
        return _layout(self.dispersion.footprints, self.cube_shape[2], self.out_shape[2])

    def _forward(self, x: np.ndarray, out: np.ndarray) -> None:
        spread = self._layout.arguments(x.dtype)
        run_chunks(kernels.dispersed_forward, self.cube_shape[1], 8, x, self.code, *spread, out)

    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None:
        spread = self._layout.arguments(y.dtype)
        run_chunks(kernels.dispersed_adjoint, self.cube_shape[1], 8, y, self.code, *spread, out)


@dataclass(frozen=True, eq=False)
class SmearedOperator(LinearOperator):
    """g[q, y, x] = Σ_k Σ_j weights[k, j] code[q, y, x + first[k] + j] f[k, y, x]; outside, the code is closed."""

    code: np.ndarray
    cube_shape: tuple[int, int, int]
    footprints: Footprints

    @property
    def in_shape(self) -> Shape:
        """(band, y, x) of the datacube."""
        return self.cube_shape

    @property
    def out_shape(self) -> Shape:
        """(shot, y, x) of the snapshots."""
        return len(self.code), *self.cube_shape[1:]

    @cached_property
    def _layout(self) -> _Layout:
        return _layout(self.footprints, self.cube_shape[2], self.code.shape[2])

    def _forward(self, x: np.ndarray, out: np.ndarray) -> None:
        spread = self._layout.arguments(x.dtype)
        run_chunks(kernels.smeared_forward, self.cube_shape[1], 8, x, self.code, *spread, out)

    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None:
        spread = self._layout.arguments(y.dtype)
        run_chunks(kernels.smeared_adjoint, self.cube_shape[1], 8, y, self.code, *spread, out)


@dataclass(frozen=True, eq=False)
class _Layout:
    """Footprints in a row that has spare columns on both sides, so that no voxel is checked in the kernels.

    Attributes
    ----------
    place : (band,) int64; where the footprint of the band's first voxel begins in the row.
    weights : (band, j) float64; j a multiple of 3.
    reach : (band,) int64; the weights that are used, a multiple of 3.
    margin, width : spare columns on the left, and all columns of the row.
    """

    place: np.ndarray
    weights: np.ndarray
    reach: np.ndarray
    margin: int
    width: int

    def arguments(self, dtype: np.dtype) -> tuple[np.ndarray, np.ndarray, np.ndarray, int, int]:
        """What the kernels take."""
        return self.place, self.weights.astype(dtype), self.reach, self.margin, self.width


def _layout(footprints: Footprints, columns: int, wide_columns: int) -> _Layout:
    """Put the voxels of `columns` columns into a row of which `wide_columns` exist."""
    weights = np.pad(footprints.weights, ((0, 0), (0, -footprints.weights.shape[1] % 3)))
    used = weights.shape[1] - np.argmax(weights[:, ::-1] > 0, axis=1)
    margin = max(0, -int(footprints.first.min()))
    place = footprints.first + margin
    width = max(margin + wide_columns, int(place.max()) + columns + weights.shape[1])
    return _Layout(place, weights, -(-used // 3) * 3, margin, width)


@shot_gram.register
def _(A: ShiftOperator) -> np.ndarray:
    bands, _, nx = A.cube_shape
    return _gram(
        [A.code[:, :, k * A.code_shift : k * A.code_shift + nx] for k in range(bands)], A.out_shift, A.out_shape
    )


@shot_gram.register
def _(A: ColoredOperator) -> np.ndarray:
    return _gram([A.code[:, k] for k in range(A.in_shape[0])], A.out_shift, A.out_shape)


@shot_gram.register
def _(A: DispersedOperator) -> None:  # noqa: ARG001 - whatever the code is, neighbouring pixels share the light of a voxel
    return None


@shot_gram.register
def _(A: SmearedOperator) -> np.ndarray:
    bands, _, nx = A.cube_shape
    return _gram((smeared_code(A.code, A.footprints, k, nx) for k in range(bands)), 0, A.out_shape)


def _gram(code_of_band: Iterable[np.ndarray], out_shift: int, out_shape: Shape) -> np.ndarray:
    shots, rows, columns = out_shape
    gram = np.zeros((shots, shots, rows, columns))
    for k, code in enumerate(code_of_band):
        t = code.astype(np.float64)
        gram[:, :, :, k * out_shift : k * out_shift + t.shape[2]] += t[:, None] * t[None]
    return gram
