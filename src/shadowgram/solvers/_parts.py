"""Parts of a measurement as operators of their own: some elements of the detector, or some shots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shadowgram.operators.base import LinearOperator, Shape
from shadowgram.operators.structure import shot_gram


@dataclass(frozen=True, eq=False)
class Kept(LinearOperator):
    """Some elements of the detector; the others read 0.

    Parameters
    ----------
    of : operator (band, y, x) → (shot, y, x).
    elements : (shot, y, x) booleans, which ones are kept.
    """

    of: LinearOperator
    elements: np.ndarray

    @property
    def in_shape(self) -> Shape:
        """(band, y, x) of the cube."""
        return self.of.in_shape

    @property
    def out_shape(self) -> Shape:
        """(shot, y, x) of the snapshots, all of them."""
        return self.of.out_shape

    def _forward(self, x: np.ndarray, out: np.ndarray) -> None:
        self.of._forward(x, out)
        out *= self.elements

    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None:
        self.of._adjoint(np.ascontiguousarray(y * self.elements, y.dtype), out)


@shot_gram.register
def _(A: Kept) -> np.ndarray | None:
    gram = shot_gram(A.of)
    return None if gram is None else gram * A.elements[:, None] * A.elements[None]


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
