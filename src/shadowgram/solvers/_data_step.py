"""The data step of splittings with a weak pull to the previous estimate: (HHᵀ + μI) w = r, whose correction is Hᵀw.

Woodbury: argmin ½‖Hx − y‖² + μ/2‖x − v‖² is v − Hᵀw with r = Hv − y, and then Hx − y = r − HHᵀw. The accuracy is that of float32
or of the few steps that a warm start needs; `_admm_data` has one for those who ask for a given accuracy.
"""

from __future__ import annotations

import numpy as np

from shadowgram._threads import run_chunks
from shadowgram.operators.base import LinearOperator
from shadowgram.operators.structure import shot_gram

from . import _eigen_tv_kernels as kernels


class PixelSolves:
    """(HHᵀ + μI) w = r by one small inverse per detector element.

    Attributes
    ----------
    gain : mean diagonal element of HHᵀ, what a detector element gathers.
    """

    def __init__(self, gram: np.ndarray) -> None:
        self.gram = gram
        self.gain = float(np.einsum("qqij->", gram, dtype=np.float64)) / (gram.shape[0] * gram[0, 0].size)
        self.inverse = np.empty_like(gram)
        self.mu = gram.dtype.type(0)

    def prepare(self, mu: float) -> None:
        """Set μ; before the first solution and at every change."""
        self.mu = self.gram.dtype.type(mu)
        run_chunks(kernels.invert_gram, self.gram.shape[2], 8, self.gram, self.mu, self.inverse)

    def solve(self, r: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Fill `w`; return HHᵀw."""
        run_chunks(kernels.apply_gram, r.shape[1], 8, self.inverse, r, w)
        return r - self.mu * w


class ConjugateGradients:
    """(HHᵀ + μI) w = r by conjugate gradients from the previous w, for operators whose detector elements share light.

    Attributes
    ----------
    gain : mean diagonal element of HHᵀ, by a random probe with a fixed seed.
    """

    def __init__(self, H: LinearOperator, scratch: np.ndarray) -> None:
        self.H, self.scratch = H, scratch
        self.mu = scratch.dtype.type(0)
        probe = np.random.default_rng(0).choice([-1.0, 1.0], H.out_shape).astype(scratch.dtype)
        self.gain = energy(H.adjoint(probe, out=scratch)) / probe.size

    def prepare(self, mu: float) -> None:
        """Set μ; before the first solution and at every change."""
        self.mu = self.scratch.dtype.type(mu)

    def gram(self, w: np.ndarray) -> np.ndarray:
        """HHᵀw."""
        return self.H.forward(self.H.adjoint(w, out=self.scratch))

    def solve(self, r: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Improve `w` to 0.3 % of r, or for 20 steps; return HHᵀw."""
        product = self.gram(w)
        rest = r - product - self.mu * w
        direction, size, enough = rest.copy(), energy(rest), 1e-5 * energy(r)
        for _ in range(20):
            if size <= enough:
                break
            image = self.gram(direction)
            step = r.dtype.type(size / (inner(direction, image) + float(self.mu) * energy(direction)))
            w += step * direction
            product += step * image
            rest -= step * (image + self.mu * direction)
            previous, size = size, energy(rest)
            direction *= r.dtype.type(size / previous)
            direction += rest
        return product


def data_step(H: LinearOperator, scratch: np.ndarray) -> PixelSolves | ConjugateGradients:
    """The faster method for `H`. `scratch`, of H's `in_shape` and of the dtype to work in, may be written at any time."""
    gram = shot_gram(H)
    if gram is None:
        return ConjugateGradients(H, scratch)
    return PixelSolves(gram.astype(scratch.dtype))


def inner(a: np.ndarray, b: np.ndarray) -> float:
    """Inner product in float64, summed in an order that does not depend on the number of threads, as BLAS's may."""
    return float(np.multiply(a, b, dtype=np.float64).sum())


def energy(a: np.ndarray) -> float:
    """‖a‖², as `inner`."""
    return inner(a, a)
