"""The exact data step of ADMM: x = argmin ½‖Hx − y‖² + ρ/2‖x − v‖², by what is known of H.

Woodbury: x = v − Hᵀw with (HHᵀ + ρI) w = Hv − y, and then Hx − y = ρw. With HHᵀ = V diag(d) Vᵀ, or HᵀH where H has fewer columns
than rows, a change of ρ costs nothing.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from shadowgram._threads import run_chunks
from shadowgram.operators.base import LinearOperator
from shadowgram.operators.structure import shot_gram

from . import _eigen_tv_kernels as kernels

# Rows or columns up to which a dense eigendecomposition is made: about as many products with H and Hᵀ, and 2 s at the limit.
SMALL = 2048
_MOST_STEPS = 200  # of conjugate gradients in one data step


class DataStep(Protocol):
    """How x is found for one operator and one y."""

    exact: bool  # whether the last x was as accurate as asked for

    def solve(self, v: np.ndarray, rho: float, accuracy: float) -> tuple[np.ndarray, float]:
        """Give x, of v's dtype, and ‖Hx − y‖. `accuracy` is relative to ‖Hv − y‖; direct methods need none."""
        ...


def data_step(H: LinearOperator, y: np.ndarray) -> DataStep:
    """The fastest exact method: a small matrix a detector element, one dense decomposition, or conjugate gradients."""
    gram = shot_gram(H)
    if gram is not None:
        return PixelStep(H, y, gram)
    rows, columns = math.prod(H.out_shape), math.prod(H.in_shape)
    if min(rows, columns) > SMALL:
        return GradientStep(H, y)
    return RowStep(H, y) if rows <= columns else ColumnStep(H, y)


class PixelStep:
    """One shot × shot inverse a detector element, where these share no light."""

    def __init__(self, H: LinearOperator, y: np.ndarray, gram: np.ndarray) -> None:
        self.H, self.y, self.gram = H, y, gram
        self.inverse = np.empty_like(gram)
        self.rho = -1.0
        self.exact = True

    def solve(self, v: np.ndarray, rho: float, accuracy: float) -> tuple[np.ndarray, float]:  # noqa: ARG002
        if rho != self.rho:
            run_chunks(kernels.invert_gram, self.gram.shape[2], 8, self.gram, rho, self.inverse)
            self.rho = rho
        r = (self.H.forward(v) - self.y).astype(np.float64)
        w = np.empty_like(r)
        run_chunks(kernels.apply_gram, r.shape[1], 8, self.inverse, r, w)
        return v - self.H.adjoint(w.astype(v.dtype)), rho * length(w)


class RowStep:
    """Woodbury by the spectrum of HHᵀ, for an operator with few rows."""

    def __init__(self, H: LinearOperator, y: np.ndarray) -> None:
        self.H, self.y = H, y
        self.spectrum = _Spectrum(H @ H.H)
        self.exact = True

    def solve(self, v: np.ndarray, rho: float, accuracy: float) -> tuple[np.ndarray, float]:  # noqa: ARG002
        w = self.spectrum.divide(self.H.forward(v) - self.y, rho)
        return v - self.H.adjoint(w.astype(v.dtype)), rho * length(w)


class ColumnStep:
    """x = v − (HᵀH + ρI)⁻¹ Hᵀ(Hv − y) by the spectrum of HᵀH, for an operator with few columns and more rows."""

    def __init__(self, H: LinearOperator, y: np.ndarray) -> None:
        self.H, self.y = H, y
        self.spectrum = _Spectrum(H.H @ H)
        self.exact = True

    def solve(self, v: np.ndarray, rho: float, accuracy: float) -> tuple[np.ndarray, float]:  # noqa: ARG002
        x = (v - self.spectrum.divide(self.H.adjoint(self.H.forward(v) - self.y), rho)).astype(v.dtype)
        return x, length(self.H.forward(x) - self.y)


class _Spectrum:
    """M = V diag(d) Vᵀ of a symmetric operator, in float64, on one thread of BLAS: several wait for each other under load."""

    def __init__(self, symmetric: LinearOperator) -> None:
        import threadpoolctl

        size = math.prod(symmetric.in_shape)
        matrix, unit = np.empty((size, size)), np.zeros(size)
        for i in range(size):
            unit[i] = 1
            matrix[i] = symmetric.forward(unit.reshape(symmetric.in_shape)).ravel()
            unit[i] = 0
        self.blas = threadpoolctl.ThreadpoolController()
        with self.blas.limit(limits=1, user_api="blas"):
            values, self.vectors = np.linalg.eigh((matrix + matrix.T) / 2)
        self.values = np.maximum(values, 0)

    def divide(self, r: np.ndarray, rho: float) -> np.ndarray:
        """(M + ρI)⁻¹ r, in float64."""
        with self.blas.limit(limits=1, user_api="blas"):
            coefficients = r.astype(np.float64).ravel() @ self.vectors
            return (self.vectors @ (coefficients / (self.values + rho))).reshape(r.shape)


class GradientStep:
    """(HHᵀ + ρI) w = Hv − y by conjugate gradients from the previous residual ρw."""

    def __init__(self, H: LinearOperator, y: np.ndarray) -> None:
        self.H, self.y = H, y
        self.residual = np.zeros_like(y)  # ρw, which changes little when ρ does
        self.scratch = np.empty(H.in_shape, y.dtype)
        self.exact = True

    def solve(self, v: np.ndarray, rho: float, accuracy: float) -> tuple[np.ndarray, float]:
        kind = v.dtype.type
        r = self.H.forward(v) - self.y
        w = self.residual * kind(1 / rho)
        rest = r - self._system(w, kind(rho))
        direction, energy = rest.copy(), length(rest) ** 2
        enough = (max(accuracy, 4 * float(np.finfo(v.dtype).eps)) * length(r)) ** 2
        for _ in range(_MOST_STEPS):
            if energy <= enough:
                break
            image = self._system(direction, kind(rho))
            step = kind(energy / _inner(direction, image))
            w += step * direction
            rest -= step * image
            before, energy = energy, length(rest) ** 2
            direction *= kind(energy / before)
            direction += rest
        self.exact = energy <= enough
        self.residual = w * kind(rho)
        return v - self.H.adjoint(w), length(self.residual)

    def _system(self, w: np.ndarray, rho: np.floating) -> np.ndarray:
        return self.H.forward(self.H.adjoint(w, out=self.scratch)) + rho * w


def length(a: np.ndarray) -> float:
    """‖a‖ in float64, summed in an order that does not depend on the number of threads, as BLAS's may."""
    return math.sqrt(_inner(a, a))


def _inner(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.multiply(a, b, dtype=np.float64).sum())
