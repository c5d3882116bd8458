"""Operators of the CASSI family: the code or the snapshot shifts by whole pixels from band to band."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shadowgram._threads import run_chunks
from shadowgram.operators.base import LinearOperator, Shape
from shadowgram.operators.structure import shot_gram

from . import _shift_kernels as kernels


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


@shot_gram.register
def _(A: ShiftOperator) -> np.ndarray:
    bands, _, nx = A.cube_shape
    return _gram(
        [A.code[:, :, k * A.code_shift : k * A.code_shift + nx] for k in range(bands)], A.out_shift, A.out_shape
    )


@shot_gram.register
def _(A: ColoredOperator) -> np.ndarray:
    return _gram([A.code[:, k] for k in range(A.in_shape[0])], A.out_shift, A.out_shape)


def _gram(code_of_band: list[np.ndarray], out_shift: int, out_shape: Shape) -> np.ndarray:
    shots, rows, columns = out_shape
    gram = np.zeros((shots, shots, rows, columns))
    for k, code in enumerate(code_of_band):
        t = code.astype(np.float64)
        gram[:, :, :, k * out_shift : k * out_shift + t.shape[2]] += t[:, None] * t[None]
    return gram
