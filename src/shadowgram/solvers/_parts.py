"""Parts of a measurement as operators of their own: weighted elements of the detector, or some of them, or some shots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shadowgram.operators.base import LinearOperator, Shape
from shadowgram.operators.structure import shot_gram


@dataclass(frozen=True, eq=False)
class Weighted(LinearOperator):
    """Every element of a measurement times a weight; with booleans, only some of the elements, and 0 in the others' places.

    Parameters
    ----------
    of : operator, such as (band, y, x) → (shot, y, x).
    weights : numbers or booleans, of its `out_shape`.
    """

    of: LinearOperator
    weights: np.ndarray

    @property
    def in_shape(self) -> Shape:
        """Shape of what is measured, such as (band, y, x)."""
        return self.of.in_shape

    @property
    def out_shape(self) -> Shape:
        """Shape of the measurement, such as (shot, y, x)."""
        return self.of.out_shape

    def _forward(self, x: np.ndarray, out: np.ndarray) -> None:
        self.of._forward(x, out)
        out *= self.weights

    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None:
        self.of._adjoint(np.ascontiguousarray(y * self.weights, y.dtype), out)


@shot_gram.register
def _(A: Weighted) -> np.ndarray | None:
    gram = shot_gram(A.of)
    return None if gram is None else gram * A.weights[:, None] * A.weights[None]


@dataclass(frozen=True, eq=False)
class Shots(LinearOperator):
    """Some of the shots.

    Parameters
    ----------
    of : operator (band, y, x) → (shot, y, x).
    chosen : numbers of the shots.
    """

    of: LinearOperator
    chosen: tuple[int, ...]

    @property
    def in_shape(self) -> Shape:
        """(band, y, x) of the cube."""
        return self.of.in_shape

    @property
    def out_shape(self) -> Shape:
        """(shot, y, x) of the snapshots that were chosen."""
        return len(self.chosen), *self.of.out_shape[1:]

    def _forward(self, x: np.ndarray, out: np.ndarray) -> None:
        out[:] = self.of.forward(x)[list(self.chosen)]

    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None:
        everything = np.zeros(self.of.out_shape, y.dtype)
        everything[list(self.chosen)] = y
        self.of._adjoint(everything, out)


@shot_gram.register
def _(A: Shots) -> np.ndarray | None:
    gram = shot_gram(A.of)
    return None if gram is None else np.ascontiguousarray(gram[np.ix_(A.chosen, A.chosen)])
