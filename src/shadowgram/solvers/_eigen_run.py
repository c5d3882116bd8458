"""A run of `EigenTV` or `EigenPnP`: its iterations, their history, and what comes back."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np

from shadowgram.operators.base import LinearOperator

from ._data_step import energy
from ._eigen_splitting import REFRESH, Splitting
from .solution import Callback, Solution, check_problem
from .whiteness import residual_whiteness

_LIT = 1e-3  # of the brightest response: below, an element of the detector counts as dark


class EigenRun:
    """Iterations on one problem, counted and recorded over all their phases.

    `state` is None where nothing was seen, and nothing has to be reconstructed.
    """

    def __init__(
        self,
        name: str,
        H: LinearOperator,
        y: np.ndarray,
        noise: float | None,
        nonnegative: bool,
        callback: Callback | None = None,
    ) -> None:
        self.begun, self.callback = time.perf_counter(), callback
        y = check_problem(H, y)
        if len(H.in_shape) != 3 or len(H.out_shape) != 3:
            raise ValueError(
                f"{name} reconstructs cubes (band, y, x) from snapshots (shot, y, x), "
                f"but the operator takes {H.in_shape} and gives {H.out_shape}"
            )
        self.nothing = np.zeros(0, y.dtype)
        self.H, self.dtype = H, y.dtype
        self.history: dict[str, list[float]] = {key: [] for key in ("residual", "change", "lambda", "mu", "seconds")}
        response = H.forward(np.ones(H.in_shape, y.dtype))
        self.lit = response > _LIT * response.max()
        self.state = Splitting(H, y, response, noise, nonnegative) if y.any() and response.any() else None

    @property
    def iterations(self) -> int:
        """Iterations made."""
        return len(self.history["seconds"])

    def minimise(self, max_iter: int, tol: float) -> bool:
        """Total variation until the cube changes by less than `tol` with λ settled; whether it came to that."""
        state = self.state
        if state is None:
            return True
        for iteration in range(max_iter):
            if iteration > 0 and iteration % REFRESH == 0:
                state.refresh()
            self.step(state, state.total_variation)
            if state.change < tol and state.settled:
                return True
        return False

    def step(self, state: Splitting, prior: Callable[[np.ndarray], None]) -> None:
        """One iteration; the callback is told, and may raise KeyboardInterrupt."""
        state.iterate(prior)
        values = {
            "residual": math.sqrt(energy(state.residual)) * state.amplitude,
            "change": state.change,
            "lambda": state.strength * state.gain * state.amplitude,
            "mu": state.mu,
            "seconds": time.perf_counter() - self.begun,
        }
        for name, value in values.items():
            self.history[name].append(value)
        if self.callback is not None:
            self.callback(self.iterations, values)

    def solution(self, converged: bool, interrupted: bool, denoised: bool | None = None) -> Solution:
        """What `solve` returns."""
        if self.state is None:
            x, whiteness = np.zeros(self.H.in_shape, self.dtype), None
        else:
            x = self.state.z
            x *= x.dtype.type(self.state.amplitude)
            whiteness = residual_whiteness(self.state.residual, self.lit)
        seconds = time.perf_counter() - self.begun
        return Solution(
            x, converged, self.iterations, self.history, interrupted, seconds, whiteness=whiteness, denoised=denoised
        )
