"""FISTA: accelerated proximal gradient for the ℓ1-regularised problem.

Problem: min_θ ½‖y − HΨθ‖² + τ‖θ‖₁, and x = Ψθ: the one that `GPSR` solves.

Iteration: z = θ_k + (t_{k−1} − 1)/t_k (θ_k − θ_{k−1}), θ_{k+1} = soft(z − s ΨᵀHᵀ(HΨz − y), sτ), t_{k+1} = (1 + √(1 + 4t_k²))/2.
Condition: s ≤ 1/‖H‖² (ΨΨᵀ = I, so that ‖HΨ‖ = ‖H‖). One forward and one adjoint an iteration.

Restart: a point that raises the objective is refused, and the momentum starts anew from the last good one, so that the objective
falls monotonically. There is no continuation in τ: from a cold start the accelerated steps need no more iterations than with it.

Source: Beck and Teboulle, SIAM J. Imaging Sci. 2 (2009) 183, eqs. (4.1)-(4.3); restart by function value: O'Donoghue and Candès,
Found. Comput. Math. 15 (2015) 715, section 3.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shadowgram.operators.base import LinearOperator
from shadowgram.operators.structure import norm

from . import _sparse_kernels as kernels
from ._sparse import Record, SparseProblem, check_settings, largest, run, settled, square
from .solution import Callback, Solution, check_problem, solve

# ‖H‖² is known to 2 % from below where it comes from power iteration.
MARGIN = 1.02


@dataclass(frozen=True, kw_only=True)
class FISTA:
    """Sparse reconstruction by accelerated proximal gradient steps: min ½‖y − HΨθ‖² + τ‖θ‖₁.

    Parameters
    ----------
    basis : Ψ with ΨΨᵀ = I, by name (see `shadowgram.operators.basis`) or as an operator from coefficients to the cube.
    tau : weight of the ℓ1 norm, relative to ‖ΨᵀHᵀy‖∞, above which the solution is 0.
    max_iter : most iterations.
    tol : converged when the objective fell by less than this share an iteration, on the mean of 5 iterations.
    levels : wavelet levels of a basis given by name; None for its default.

    Notes
    -----
    The history of `solve` is that of `GPSR`.

    Examples
    --------
    >>> import shadowgram as sg
    >>> cube = sg.scenes.chart(size=32, bands=4, seed=0).values
    >>> imager = sg.DualCASSI(cube_shape=cube.shape, wavelengths=(450, 650))
    >>> H = imager.operator(sg.codes.boolean(shots=4, shape=imager.code_shape, seed=0))
    >>> found = sg.solve(sg.FISTA(tau=1e-4), H, H.forward(cube))
    >>> bool(sg.metrics.psnr(found.x, cube, peak=1.0) > 25)
    True
    """

    basis: str | LinearOperator = "dct-sym8"
    tau: float = 1e-4
    max_iter: int = 200
    tol: float = 1e-5
    levels: int | None = None

    def __post_init__(self) -> None:
        check_settings("FISTA", self.basis, self.levels, self.tau, self.max_iter, self.tol)


@solve.register
def _(spec: FISTA, H: LinearOperator, y: np.ndarray, callback: Callback | None = None) -> Solution:
    y = check_problem(H, y)
    record = Record(callback)
    state = _State(SparseProblem.of(H, spec.basis, spec.levels, y), y)
    converged = interrupted = False
    try:
        converged = state.minimise(spec.tau * state.highest, spec.tol, spec.max_iter, record)
    except KeyboardInterrupt:
        interrupted = True
    return record.solution(state.problem.cube(state.theta), converged, interrupted)


class _State:
    """The last two points θ and what HΨ makes of them, so that HΨz needs no product of its own."""

    def __init__(self, problem: SparseProblem, y: np.ndarray) -> None:
        self.problem = problem
        self.theta, self.before = problem.coefficients(), problem.coefficients()
        self.gradient = problem.coefficients()
        self.residual, self.residual_before = -y, -y
        self.step = 1 / max(MARGIN * norm(problem.H) ** 2, np.finfo(y.dtype).tiny)
        problem.adjoint(self.residual, self.gradient)
        self.highest = largest(self.gradient)  # ‖ΨᵀHᵀy‖∞

    def minimise(self, tau: float, tol: float, most: int, record: Record) -> bool:
        """Iterate at the absolute weight `tau`; whether the criterion was met."""
        if self.highest == 0:
            return True  # nothing was seen: 0 is the solution
        kind = self.theta.dtype.type
        objectives = [0.5 * square(self.residual)]
        nonzeros, t, momentum = 0.0, 1.0, 0.0
        for _ in range(most):
            # r(z) = r(θ) + momentum (r(θ) − r(θ before)), since r is affine.
            at_z = self.residual + kind(momentum) * (self.residual - self.residual_before)
            self.problem.adjoint(at_z, self.gradient)
            arrays = self.theta, self.before, self.gradient
            sums = run(kernels.fista_step, *arrays, kind(momentum), kind(self.step), kind(self.step * tau), sums=2)
            magnitude, count = sums.sum(axis=0).tolist()
            seen = at_z  # its memory, not its values
            self.problem.forward(self.before, seen)
            seen -= self.problem.y
            objective = 0.5 * square(seen) + tau * magnitude
            if objective <= objectives[-1]:
                self.theta, self.before = self.before, self.theta
                self.residual, self.residual_before = seen, self.residual
                after = (1 + np.sqrt(1 + 4 * t * t)) / 2
                t, momentum = after, (t - 1) / after
                nonzeros = count
                objectives.append(objective)
                done = settled(objectives, tol)
            else:
                # Without momentum even a plain step that raises the objective is rounding: this is as low as it gets.
                done = momentum == 0
                t, momentum = 1.0, 0.0
            record.add(objectives[-1], square(self.residual) ** 0.5, tau, nonzeros)
            if done:
                return True
        return False
