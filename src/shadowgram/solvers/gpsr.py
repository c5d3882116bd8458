"""GPSR: gradient projection for sparse reconstruction.

Problem: min_θ ½‖y − HΨθ‖² + τ‖θ‖₁, and x = Ψθ.

Iteration (Barzilai-Borwein, monotone): θ = u − v with u, v ≥ 0; g = ΨᵀHᵀ(HΨθ − y); step from (u, v) along
δu = (u − α(τ + g))₊ − u, δv = (v − α(τ − g))₊ − v, by λ in [0, 1] from an exact line search; α ← δᵀδ / ‖HΨ(δu − δv)‖²;
and the common part of u and v is removed, so that θ alone has to be kept. One forward and one adjoint an iteration.

Continuation: the problem is first solved roughly for large τ, each solution starting the next: for small τ a cold start takes
thousands of iterations.

Source: Figueiredo, Nowak and Wright, IEEE J. Sel. Top. Signal Process. 1 (2007) 586, sections III.B (steps), III.D (continuation)
and III.E (debiasing). Departures: the first α is the exact minimiser along −g instead of 1, so that the units of H do not matter;
intermediate τ are left after one small step, the last after a mean over several.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shadowgram.operators.base import LinearOperator

from . import _sparse_kernels as kernels
from ._sparse import (
    ROUGH,
    WINDOW,
    Record,
    SparseProblem,
    check_continuation,
    check_settings,
    largest,
    path,
    run,
    settled,
    square,
)
from .solution import Callback, Solution, check_problem, solve
from .tau_search import Path, begin

# Of the gradient's norm on the support, where debiasing stops (the squared norm falls by 1e-4, as in the authors' program).
DEBIASED = 1e-2


@dataclass(frozen=True, kw_only=True)
class GPSR:
    """Sparse reconstruction by gradient projection: min ½‖y − HΨθ‖² + τ‖θ‖₁.

    Parameters
    ----------
    basis : Ψ, by name (see `shadowgram.operators.basis`) or as an operator from coefficients to the cube.
    tau : weight of the ℓ1 norm, relative to ‖ΨᵀHᵀy‖∞, above which the solution is 0.
    max_iter : most iterations, all τ of the continuation together; at least half of them are kept for the last τ.
    tol : converged when the objective fell by less than this share an iteration, on the mean of 5 iterations at the last τ.
    continuation : factor from one τ of the path to the next, in (0, 1]; 1 starts cold at `tau`.
    debias : whether to finish with least squares on the support that was found, by at most `max_iter` iterations of
        conjugate gradients. It undoes the shrinkage of the ℓ1 norm where the support is small and the data clean, and fits
        the noise where they are not.
    levels : wavelet levels of a basis given by name; None for its default.

    Notes
    -----
    The history of `solve` has, for every iteration, ``"objective"``, ``"residual"`` ‖HΨθ − y‖₂, ``"tau"`` (absolute; 0 while
    debiasing), ``"nonzeros"`` of θ and ``"seconds"`` since the start. The objective falls monotonically as long as τ stays.

    Examples
    --------
    >>> import shadowgram as sg
    >>> cube = sg.scenes.chart(size=32, bands=4, seed=0).values
    >>> imager = sg.DualCASSI(cube_shape=cube.shape, wavelengths=(450, 650))
    >>> H = imager.operator(sg.codes.boolean(shots=4, shape=imager.code_shape, seed=0))
    >>> found = sg.solve(sg.GPSR(tau=1e-4), H, H.forward(cube))
    >>> bool(sg.metrics.psnr(found.x, cube, peak=1.0) > 25)
    True
    """

    basis: str | LinearOperator = "dct-sym8"
    tau: float = 1e-4
    max_iter: int = 200
    tol: float = 1e-5
    continuation: float = 0.4
    debias: bool = False
    levels: int | None = None

    def __post_init__(self) -> None:
        check_settings("GPSR", self.basis, self.levels, self.tau, self.max_iter, self.tol)
        check_continuation("GPSR", self.continuation)


@solve.register
def _(spec: GPSR, H: LinearOperator, y: np.ndarray, callback: Callback | None = None) -> Solution:
    y = check_problem(H, y)
    record = Record(callback)
    state = _State(SparseProblem.of(H, spec.basis, spec.levels, y))
    converged = interrupted = False
    try:
        converged = state.follow(spec, 1.0, record)
        if spec.debias:
            state.debias(spec.max_iter, record)
    except KeyboardInterrupt:
        interrupted = True
    return record.solution(state.problem.cube(state.theta), converged, interrupted)


@begin.register
def _(spec: GPSR, H: LinearOperator, y: np.ndarray) -> Path:
    if spec.debias:
        raise ValueError("search_tau scores what GPSR finds before debiasing; set debias=False")
    return _State(SparseProblem.of(H, spec.basis, spec.levels, y))


class _State:
    """Where the iteration stands. θ changes in one place only, so that it is whole whenever an interrupt comes."""

    def __init__(self, problem: SparseProblem) -> None:
        self.problem = problem
        self.theta = problem.coefficients()
        self.direction = problem.coefficients()
        self.gradient = problem.coefficients()
        self.residual = -problem.y
        self.change = np.empty_like(problem.y)  # HΨd
        problem.adjoint(self.residual, self.gradient)
        self.highest = largest(self.gradient)  # ‖ΨᵀHᵀy‖∞
        self.alpha = self._first_step() if self.highest > 0 else 1.0
        self.square = square(self.residual)

    def _first_step(self) -> float:
        self.problem.forward(self.gradient, self.change)
        return square(self.gradient) / max(square(self.change), np.finfo(float).tiny)

    def follow(self, spec: GPSR, above: float, record: Record) -> bool:
        """Minimise for relative weights from `above` down to that of `spec`; whether the last one met the criterion."""
        if self.highest == 0:
            return True  # nothing was seen: 0 is the solution
        *rough, last = path(spec.tau, above, spec.continuation)
        begun = record.iterations
        for weight in rough:
            self._minimise(weight * self.highest, ROUGH, 1, spec.max_iter // (2 * len(rough)), record)
        left = spec.max_iter - (record.iterations - begun)
        return self._minimise(last * self.highest, spec.tol, WINDOW, left, record)

    def _minimise(self, tau: float, tol: float, window: int, most: int, record: Record) -> bool:
        magnitude, slope, length, _ = self._step(0.0, tau)
        objectives = [0.5 * self.square + tau * magnitude]
        for _ in range(most):
            self.problem.forward(self.direction, self.change)
            curvature = square(self.change)
            # Without curvature the objective is linear along d: the whole step is best.
            taken = min(max(-slope / curvature, 0.0), 1.0) if curvature > 0 else 1.0
            self.alpha = min(max(length / curvature, 1e-30), 1e30) if curvature > 0 else 1e30
            self._move_residual(taken)
            self.problem.adjoint(self.residual, self.gradient)
            magnitude, slope, length, nonzeros = self._step(taken, tau)
            objectives.append(0.5 * self.square + tau * magnitude)
            record.add(objectives[-1], self.square**0.5, tau, nonzeros)
            if length == 0 or settled(objectives, tol, window):
                return True
        return False

    def debias(self, most: int, record: Record) -> None:
        """Least squares on the support of θ, by conjugate gradients."""
        theta, p, kind = self.theta, self.direction, self.theta.dtype.type
        nonzeros = float(np.count_nonzero(theta))
        before = begun = self._support_square()
        turn = 0.0
        for _ in range(most):
            run(kernels.conjugate_direction, theta, self.gradient, p, kind(turn), sums=0)
            self.problem.forward(p, self.change)
            curvature = square(self.change)
            if curvature == 0:
                break
            taken = before / curvature
            self._move_residual(taken)
            run(kernels.add_scaled, theta, p, kind(taken), sums=1)
            self.problem.adjoint(self.residual, self.gradient)
            record.add(0.5 * self.square, self.square**0.5, 0.0, nonzeros)
            now = self._support_square()
            if now <= DEBIASED**2 * begun:
                break
            turn, before = now / before, now

    def _move_residual(self, taken: float) -> None:
        sums = run(kernels.add_scaled, self.residual, self.change, self.residual.dtype.type(taken), sums=1)
        self.square = float(sums.sum())

    def _support_square(self) -> float:
        return float(run(kernels.support_square, self.theta, self.gradient, sums=1).sum())

    def _step(self, taken: float, tau: float) -> list[float]:
        arrays = self.theta, self.direction, self.gradient
        scalars = (self.theta.dtype.type(a) for a in (taken, tau, self.alpha))
        return run(kernels.gpsr_step, *arrays, *scalars, sums=4).sum(axis=0).tolist()
