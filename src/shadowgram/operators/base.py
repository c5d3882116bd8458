"""Linear forward models as values: two shapes and two maps.

A concrete operator is a frozen dataclass that gives `in_shape`, `out_shape`, `_forward` and `_adjoint`; the base class checks
shapes and dtypes once, and derives the rest. Arrays keep their natural shapes, (band, y, x) → (shot, y, x); flattening lives in
`shadowgram.operators.adapters` only. An operator holds no noise, no solver and no state that changes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

Shape = tuple[int, ...]


class LinearOperator(ABC):
    """A linear map between real arrays of fixed shapes, with its exact adjoint.

    Subclasses give the two shapes as properties, and `_forward(x, out)` and `_adjoint(y, out)`, which fill `out` completely
    from a C-contiguous array of the same dtype, float32 or float64.
    """

    @property
    @abstractmethod
    def in_shape(self) -> Shape:
        """Shape of what `forward` takes."""

    @property
    @abstractmethod
    def out_shape(self) -> Shape:
        """Shape of what `forward` gives."""

    @abstractmethod
    def _forward(self, x: np.ndarray, out: np.ndarray) -> None: ...

    @abstractmethod
    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None: ...

    def forward(self, x: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Apply the operator.

        Parameters
        ----------
        x : array of shape `in_shape`. float32 stays float32 and float64 stays float64; integers become float32.
        out : array of shape `out_shape` and the dtype of the result, C-contiguous, to be filled; made if not given.

        Raises
        ------
        ValueError
            If a shape does not fit.
        TypeError
            If `x` is complex or not numeric.
        """
        x = _as_real(x, self.in_shape, f"{type(self).__name__}.forward")
        out = _output(out, self.out_shape, x.dtype, f"{type(self).__name__}.forward")
        self._forward(x, out)
        return out

    def adjoint(self, y: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Apply the transpose, from `out_shape` to `in_shape`; arguments and errors as in `forward`."""
        y = _as_real(y, self.out_shape, f"{type(self).__name__}.adjoint")
        out = _output(out, self.in_shape, y.dtype, f"{type(self).__name__}.adjoint")
        self._adjoint(y, out)
        return out

    @property
    def H(self) -> LinearOperator:
        """The adjoint as an operator."""
        return Adjoint(self)

    def __matmul__(self, inner: LinearOperator) -> LinearOperator:
        return Compose(self, inner) if isinstance(inner, LinearOperator) else NotImplemented


def _as_real(a: np.ndarray, shape: Shape, where: str) -> np.ndarray:
    a = np.asarray(a)
    if a.shape != shape:
        raise ValueError(f"{where} takes an array of shape {shape}, got {a.shape}")
    if a.dtype.kind not in "fiub":
        raise TypeError(f"{where} takes real numbers, got an array of {a.dtype}")
    dtype = np.float64 if a.dtype.kind == "f" and a.dtype.itemsize > 4 else np.float32
    return np.ascontiguousarray(a, dtype)


def _output(out: np.ndarray | None, shape: Shape, dtype: np.dtype, where: str) -> np.ndarray:
    if out is None:
        return np.empty(shape, dtype)
    if out.shape != shape or out.dtype != dtype or not out.flags.c_contiguous:
        raise ValueError(
            f"{where} needs a C-contiguous out array of shape {shape} and {dtype}, got {out.shape} and {out.dtype}"
        )
    return out


@dataclass(frozen=True, eq=False)
class Adjoint(LinearOperator):
    """The transpose of an operator, as an operator."""

    of: LinearOperator

    @property
    def in_shape(self) -> Shape:
        """Shape of what `forward` takes."""
        return self.of.out_shape

    @property
    def out_shape(self) -> Shape:
        """Shape of what `forward` gives."""
        return self.of.in_shape

    @property
    def H(self) -> LinearOperator:
        """The operator that this is the adjoint of."""
        return self.of

    def _forward(self, x: np.ndarray, out: np.ndarray) -> None:
        self.of._adjoint(x, out)

    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None:
        self.of._forward(y, out)


@dataclass(frozen=True, eq=False)
class Compose(LinearOperator):
    """`outer @ inner`: the inner operator is applied first."""

    outer: LinearOperator
    inner: LinearOperator

    def __post_init__(self) -> None:
        if self.inner.out_shape != self.outer.in_shape:
            raise ValueError(
                f"cannot compose {type(self.outer).__name__} @ {type(self.inner).__name__}: "
                f"the inner one gives {self.inner.out_shape}, the outer one takes {self.outer.in_shape}"
            )

    @property
    def in_shape(self) -> Shape:
        """Shape of what `forward` takes."""
        return self.inner.in_shape

    @property
    def out_shape(self) -> Shape:
        """Shape of what `forward` gives."""
        return self.outer.out_shape

    def _forward(self, x: np.ndarray, out: np.ndarray) -> None:
        self.outer._forward(self.inner.forward(x), out)

    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None:
        self.inner._adjoint(self.outer.adjoint(y), out)
