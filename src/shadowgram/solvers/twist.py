"""TwIST: two-step iterative shrinkage/thresholding.

Problem: min_θ ½‖y − HΨθ‖² + τ‖θ‖₁, and x = Ψθ: the one that `GPSR` and `FISTA` solve.

Iteration: γ = soft(θ_k + s ΨᵀHᵀ(y − HΨθ_k), sτ) with s = 1/(1.02 ‖H‖²); θ₁ = γ, then θ_{k+1} = (1 − α)θ_{k−1} + (α − β)θ_k + βγ.
Parameters: for eigenvalues of s HᵀH from κ to 1, ρ = (1 − √κ)/(1 + √κ), α = 1 + ρ², β = 2α/(1 + κ).
One forward and one adjoint an iteration.

Safeguard (the paper's monotone version): a point that raises the objective is refused, and γ is taken, which cannot raise it.
Its residual follows from those of the three other points, since residuals are affine.

Source: Bioucas-Dias and Figueiredo, IEEE Trans. Image Process. 16 (2007) 2992: the two-step iteration, its α and β for eigenvalues
between two bounds, and the monotone version (MTwIST).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shadowgram.operators.base import LinearOperator
from shadowgram.operators.structure import norm

from . import _twist_kernels as kernels
from ._sparse import (
    Record,
    SparseProblem,
    check_settings,
    largest,
    run,
    settled,
    square,
)
from .fista import MARGIN
from .solution import Callback, Solution, check_problem, solve
from .tau_search import Path, begin


@dataclass(frozen=True, kw_only=True)
class TwIST:
    """Sparse reconstruction by two-step shrinkage: min ½‖y − HΨθ‖² + τ‖θ‖₁.

    Parameters
    ----------
    basis : Ψ with ΨΨᵀ = I, by name (see `shadowgram.operators.basis`) or as an operator from coefficients to the cube.
    tau : weight of the ℓ1 norm, relative to ‖ΨᵀHᵀy‖∞, above which the solution is 0.
    max_iter : most iterations.
    tol : converged when the objective fell by less than this share an iteration, on the mean of 5 iterations.
    conditioning : κ, the least eigenvalue of HᵀH that counts, relative to the largest, in (0, 1). The authors advise 1e-4 for
        severely ill-posed problems and 1e-1 for mildly ill-posed ones; 1 would be the one-step iteration.
    levels : wavelet levels of a basis given by name; None for its default.

    Raises
    ------
    TypeError
        If `basis` is neither a name nor an operator.
    ValueError
        If a parameter is out of its range.

    Notes
    -----
    The history of `solve` is that of `GPSR`. The objective falls monotonically.

    Source: Bioucas-Dias & Figueiredo (2007), "A new TwIST: two-step iterative shrinkage/thresholding algorithms for image
    restoration".

    Examples
    --------
    >>> import shadowgram as sg
    >>> cube = sg.scenes.chart(size=32, bands=4, seed=0).values
    >>> imager = sg.DualCASSI(cube_shape=cube.shape, wavelengths=(450, 650))
    >>> H = imager.operator(sg.codes.boolean(shots=4, shape=imager.code_shape, seed=0))
    >>> found = sg.solve(sg.TwIST(tau=1e-4), H, H.forward(cube))
    >>> bool(sg.metrics.psnr(found.x, cube, peak=1.0) > 25)
    True
    """

    basis: str | LinearOperator = "dct-sym8"
    tau: float = 1e-4
    max_iter: int = 200
    tol: float = 1e-5
    conditioning: float = 1e-4
    levels: int | None = None

    def __post_init__(self) -> None:
        check_settings("TwIST", self.basis, self.levels, self.tau, self.max_iter, self.tol)
        if not 0 < self.conditioning < 1:
            raise ValueError(
                f"TwIST: conditioning is the least eigenvalue that counts, relative to the largest, and must lie between "
                f"0 and 1, got {self.conditioning}"
            )

    def _factors(self) -> tuple[float, float]:
        """α and β."""
        root = self.conditioning**0.5
        alpha = 1 + ((1 - root) / (1 + root)) ** 2
        return alpha, 2 * alpha / (1 + self.conditioning)


@solve.register
def _(spec: TwIST, H: LinearOperator, y: np.ndarray, callback: Callback | None = None) -> Solution:
    y = check_problem(H, y)
    record = Record(callback)
    state = begin(spec, H, y)
    converged = interrupted = False
    try:
        converged = state.follow(spec, 1.0, record)
    except KeyboardInterrupt:
        interrupted = True
    return record.solution(state.problem.cube(state.theta), converged, interrupted)


@begin.register
def _(spec: TwIST, H: LinearOperator, y: np.ndarray) -> Path:
    return _State(SparseProblem.of(H, spec.basis, spec.levels, y))


class _State:
    """The last two points θ and their residuals HΨθ − y. All four are replaced at once, so that θ is whole at any time."""

    def __init__(self, problem: SparseProblem) -> None:
        self.problem = problem
        self.theta, self.before, self.gradient = (problem.coefficients() for _ in range(3))
        self.residual, self.residual_before = -problem.y, -problem.y
        self.step = 1 / max(MARGIN * norm(problem.H) ** 2, np.finfo(problem.y.dtype).tiny)
        problem.adjoint(self.residual, self.gradient)
        self.highest = largest(self.gradient)  # ‖ΨᵀHᵀy‖∞
        self.magnitude = self.nonzeros = 0.0  # of θ

    def follow(self, spec: TwIST, above: float, record: Record) -> bool:  # noqa: ARG002 - it needs no path to its τ
        """Go on at the weight of `spec`; whether the criterion was met."""
        if self.highest == 0:
            return True  # nothing was seen: 0 is the solution
        tau = spec.tau * self.highest
        objectives = [0.5 * square(self.residual) + tau * self.magnitude]
        alpha = beta = 1.0  # one step first: there is no second point yet
        for _ in range(spec.max_iter):
            objective = self._iterate(tau, alpha, beta, objectives[-1])
            # Where even one step raises the objective it is rounding: this is as low as it gets.
            done = objective > objectives[-1]
            objectives.append(min(objective, objectives[-1]))
            record.add(objectives[-1], square(self.residual) ** 0.5, tau, self.nonzeros)
            if done or settled(objectives, spec.tol):
                return True
            alpha, beta = spec._factors()
        return False

    def _iterate(self, tau: float, alpha: float, beta: float, best: float) -> float:
        """Go on to the next point and give its objective; stay, where it would be above `best`."""
        kind = self.theta.dtype.type
        self.problem.adjoint(self.residual, self.gradient)
        arrays = self.theta, self.before, self.gradient
        scalars = (kind(a) for a in (self.step, self.step * tau, 1 - alpha, alpha - beta, beta))
        one_step, two_step = run(kernels.twist_step, *arrays, *scalars, sums=4).sum(axis=0).reshape(2, 2).tolist()
        residual = np.empty_like(self.residual)
        self.problem.forward(self.before, residual)
        residual -= self.problem.y
        objective = 0.5 * square(residual) + tau * two_step[0]
        if objective <= best:
            self.theta, self.before = self.before, self.theta
            self.residual, self.residual_before = residual, self.residual
            self.magnitude, self.nonzeros = two_step
            return objective
        residual -= kind(1 - alpha) * self.residual_before + kind(alpha - beta) * self.residual
        residual /= kind(beta)
        objective = 0.5 * square(residual) + tau * one_step[0]
        if objective <= best:
            self.theta, self.before, self.gradient = self.gradient, self.theta, self.before
            self.residual, self.residual_before = residual, self.residual
            self.magnitude, self.nonzeros = one_step
        return objective
