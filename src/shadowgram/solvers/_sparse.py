"""What GPSR and FISTA share: the problem min_θ ½‖y − HΨθ‖² + τ‖θ‖₁, its products, and the record of the iterations."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from shadowgram._threads import run_chunks
from shadowgram.operators.base import LinearOperator
from shadowgram.operators.transforms import BASES, basis

from . import _sparse_kernels as kernels
from .solution import Callback, Solution

# One iteration may lower the objective by little although more is to come: the rule for stopping looks at the mean over several.
WINDOW = 5
# An intermediate τ is left when the objective falls by less than this share in one iteration. Ten times more left it too early:
# up to twice the iterations in all.
ROUGH = 1e-3


def check_settings(
    spec: str, chosen: str | LinearOperator, levels: int | None, tau: float, max_iter: int, tol: float
) -> None:
    """Raise ValueError or TypeError for settings that no problem can have."""
    if isinstance(chosen, str):
        if chosen not in BASES:
            raise ValueError(f"{spec}: basis must be one of {', '.join(BASES)} or a LinearOperator, got {chosen!r}")
    elif not isinstance(chosen, LinearOperator):
        raise TypeError(f"{spec}: basis must be a name or a LinearOperator, got {type(chosen).__name__}")
    elif levels is not None:
        raise ValueError(f"{spec}: levels belongs to a basis given by name; this basis is an operator already")
    if not 0 < tau < 1:
        raise ValueError(f"{spec}: tau is relative to the largest |ΨᵀHᵀy| and must lie between 0 and 1, got {tau}")
    if not isinstance(max_iter, int | np.integer) or max_iter < 1:
        raise ValueError(f"{spec}: max_iter must be a whole number of at least 1, got {max_iter!r}")
    if not 0 <= tol < 1:
        raise ValueError(f"{spec}: tol must lie in [0, 1), got {tol}")


def check_continuation(spec: str, continuation: float) -> None:
    """Raise ValueError for a factor that is not one."""
    if not 0 < continuation <= 1:
        raise ValueError(f"{spec}: continuation must lie in (0, 1], got {continuation}; 1 switches it off")


@dataclass(eq=False)
class SparseProblem:
    """A = HΨ and y, with the one cube that passes between H and Ψ."""

    H: LinearOperator
    basis: LinearOperator
    y: np.ndarray

    @classmethod
    def of(cls, H: LinearOperator, chosen: str | LinearOperator, levels: int | None, y: np.ndarray) -> SparseProblem:
        """The problem in a basis given by name or as an operator."""
        operator = basis(chosen, H.in_shape, levels) if isinstance(chosen, str) else chosen
        if operator.out_shape != H.in_shape:
            raise ValueError(f"the basis gives cubes of shape {operator.out_shape}, the operator takes {H.in_shape}")
        return cls(H, operator, y)

    @cached_property
    def _cube(self) -> np.ndarray:
        return np.empty(self.H.in_shape, self.y.dtype)

    def coefficients(self) -> np.ndarray:
        """Zeros of the coefficients' shape."""
        return np.zeros(self.basis.in_shape, self.y.dtype)

    def forward(self, theta: np.ndarray, out: np.ndarray) -> None:
        """out ← HΨθ."""
        self.H.forward(self.basis.forward(theta, out=self._cube), out=out)

    def adjoint(self, residual: np.ndarray, out: np.ndarray) -> None:
        """out ← ΨᵀHᵀ residual."""
        self.basis.adjoint(self.H.adjoint(residual, out=self._cube), out=out)

    def cube(self, theta: np.ndarray) -> np.ndarray:
        """Ψθ, in the cube that was used between H and Ψ: the last product of a solve."""
        return self.basis.forward(theta, out=self._cube)


def run(kernel: Callable[..., None], first: np.ndarray, *rest: np.ndarray | np.floating, sums: int) -> np.ndarray:
    """Run a pass over flattened arrays and return its per-chunk sums, (chunk, sums) float64."""
    chunks = -(-first.size // kernels.CHUNK)
    table = np.zeros((chunks, sums))
    flat = (a.reshape(-1) if isinstance(a, np.ndarray) else a for a in rest)
    # From four chunks on (0.05 ms), a second thread is worth starting.
    run_chunks(kernel, chunks, 4, first.reshape(-1), *flat, *((table,) if sums else ()))
    return table


def square(a: np.ndarray) -> float:
    """‖a‖², the same for any number of threads."""
    return float(run(kernels.square_sums, a, sums=1).sum())


def largest(a: np.ndarray) -> float:
    """max |a|."""
    return float(max(a.max(), -a.min()))


@dataclass(eq=False)
class Record:
    """Iterations made, and their history."""

    callback: Callback | None
    begun: float = field(default_factory=time.perf_counter)
    history: dict[str, list[float]] = field(
        default_factory=lambda: {name: [] for name in ("objective", "residual", "tau", "nonzeros", "seconds")}
    )

    @property
    def iterations(self) -> int:
        """Iterations recorded."""
        return len(self.history["objective"])

    def add(self, objective: float, residual: float, tau: float, nonzeros: float) -> None:
        """Append an iteration and tell the callback."""
        values = {
            "objective": objective,
            "residual": residual,
            "tau": tau,
            "nonzeros": nonzeros,
            "seconds": time.perf_counter() - self.begun,
        }
        for name, value in values.items():
            self.history[name].append(value)
        if self.callback is not None:
            self.callback(self.iterations, values)

    def solution(self, x: np.ndarray, converged: bool, interrupted: bool) -> Solution:
        """What `solve` returns."""
        seconds = time.perf_counter() - self.begun
        return Solution(x, converged and not interrupted, self.iterations, self.history, interrupted, seconds)


def settled(objectives: list[float], tol: float, window: int = WINDOW) -> bool:
    """Whether the mean decrease of the last `window` iterations is at most tol of the objective."""
    return len(objectives) > window and objectives[-1 - window] - objectives[-1] <= window * tol * objectives[-1]


def path(tau: float, highest: float, factor: float) -> list[float]:
    """Weights from just below `highest`, where the solution is 0, down to `tau`, each at most 1/factor times the next."""
    steps = 0 if factor >= 1 else max(0, int(np.floor(np.log(highest / tau) / -np.log(factor))))
    return [tau * factor**-i for i in range(steps, -1, -1)]
