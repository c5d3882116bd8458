"""ADMM-TV: alternating directions with the total variation of each band.

Problem: min over x of ½‖Hx − y‖² + λ Σ_k TV(x_k), and x ≥ 0.

| symbol | meaning |
|---|---|
| H, y | the imager's operator, cube (band, y, x) → snapshots (shot, y, x), and the snapshots |
| λ, ρ | weight of the prior, and of the penalty that splits data from prior |
| h | mean diagonal element of H Hᵀ: what a detector element gathers |
| x, z, u | estimate that follows the data, estimate that follows the prior, scaled multiplier |
| a | x + u, over-relaxed; the prior's input |
| p | dual images of the total variation, kept from one iteration to the next |
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from shadowgram._threads import run_chunks
from shadowgram.operators.base import LinearOperator

from . import _band_tv_kernels as kernels
from ._band_tv import Log, check_cubes, check_iterations, check_weight, scene_scale
from ._data_step import data_step, energy
from ._noise_level import noise_level
from .solution import Callback, Solution, check_problem, solve

_RELAXATION = 1.6
# λ/h of the noise of a voxel, amplitudes in units of the mean scene value: two real cubes, 2 and 4 shots, 20 dB to noise-free.
_FACTOR, _POWER, _LEAST = 0.5, 1.25, 5e-3
_PENALTY = 5.0  # ρ over λ/h, both over h; for λ/h from 0.01 to 0.1, 2 to 10 was fastest


@dataclass(frozen=True, kw_only=True)
class ADMMTV:
    """Reconstruction by total variation, band by band: min over x ≥ 0 of ½‖Hx − y‖² + λ Σ_k TV(x_k).

    The plain form of what `EigenTV` does on eigen-images: convex, and blind to what the bands have in common.

    Parameters
    ----------
    weight : λ/h, with h the mean diagonal of HHᵀ, in units of the mean value of the scene (as estimated from the snapshots), so
        that the units of y and H do not matter. By default 0.5 (σ/√h)^1.25 and at least 0.005, with σ the noise of the
        snapshots as their flattest parts show it, in the same units.
    rho : ρ/h of the penalty, above 0; by default 5 times `weight`. The result does not depend on it, the time does.
    nonnegative : whether no value of the cube can be below zero, as for reflectance and radiance.
    tv_iterations : of the proximal map, in every iteration.
    max_iter : most iterations.
    tol : converged when the relative change of the cube in one iteration falls below this.

    Raises
    ------
    ValueError
        If a parameter is out of its range.

    Notes
    -----
    Iteration (over-relaxed by 1.6): x ← z − u − Hᵀ(HHᵀ + ρI)⁻¹(H(z − u) − y), which is exact, by one shot × shot matrix a
    detector element where `shot_gram` knows them and by conjugate gradients elsewhere; z ← argmin ½‖z − x − u‖² + (λ/ρ) Σ_k TV(z_k)
    over z ≥ 0, with the isotropic total variation of `shadowgram.priors.tv`, a few iterations from the previous dual images;
    u ← u + x − z.

    The history of `solve` has ``"objective"``, ``"residual"`` ‖Hx − y‖₂, ``"change"`` ‖x − previous x‖/‖x‖, ``"lambda"`` and
    ``"seconds"`` since the start, for every iteration. Ctrl-C gives the cube of the last whole iteration.

    Sources: Boyd et al. (2011), sections 3.1 and 3.4.3 (the splitting, over-relaxation); Beck & Teboulle (2009), "Fast
    gradient-based algorithms for constrained total variation image denoising" (the proximal map with its constraint).

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> truth = np.ones((4, 16, 16), np.float32)
    >>> truth[:, 4:12, 4:12] = np.array([0.2, 0.5, 0.7, 0.3])[:, None, None]
    >>> imager = sg.DualCASSI(cube_shape=truth.shape, wavelengths=(450, 650))
    >>> H = imager.operator(sg.codes.boolean(shots=3, shape=imager.code_shape, seed=0))
    >>> sg.metrics.psnr(sg.solve(sg.ADMMTV(), H, H.forward(truth)).x, truth, peak=1.0) > 30
    True
    """

    weight: float | None = None
    rho: float | None = None
    nonnegative: bool = True
    tv_iterations: int = 2
    max_iter: int = 150
    tol: float = 5e-4

    def __post_init__(self) -> None:
        if self.weight is not None:
            check_weight("ADMMTV", "weight", self.weight)
        if self.rho is not None:
            check_weight("ADMMTV", "rho", self.rho)
        check_iterations("ADMMTV", self.tv_iterations, self.max_iter, self.tol)


@solve.register
def _(spec: ADMMTV, H: LinearOperator, y: np.ndarray, callback: Callback | None = None) -> Solution:
    log = Log(callback)
    y = check_problem(H, y)
    check_cubes("ADMMTV", H)
    scale = scene_scale(H, y)
    if scale == 0:
        return log.solution(np.zeros(H.in_shape, y.dtype), True, False)
    state = _Splitting(spec, H, y / y.dtype.type(scale))
    converged = interrupted = False
    try:
        for _ in range(spec.max_iter):
            state.iterate()
            squares = energy(state.residual)
            objective = 0.5 * squares + state.strength * state.variation
            log.add({
                "objective": objective * scale**2, "residual": math.sqrt(squares) * scale, "change": state.change,
                "lambda": state.strength * scale,
            })  # fmt: skip
            converged = state.change < spec.tol
            if converged:
                break
    except KeyboardInterrupt:
        interrupted = True
    state.z *= y.dtype.type(scale)
    return log.solution(state.z, converged and not interrupted, interrupted)


class _Splitting:
    """Where the iteration stands. The snapshots are in units in which the scene's mean value is about 1.

    The data step needs r = H(2z − a) − y; with Ha − y kept beside a, that gives the residual of z without another H.
    """

    def __init__(self, spec: ADMMTV, H: LinearOperator, y: np.ndarray) -> None:
        self.spec, self.H, self.y = spec, H, y
        self.z, self.a, self.correction = (np.zeros(H.in_shape, y.dtype) for _ in range(3))
        self.p = np.zeros((H.in_shape[0], 2, *H.in_shape[1:]), y.dtype)
        self.residual, self.residual_of_a, self.r = -y, -y, -y
        self.w = np.zeros_like(y)
        self.solver = data_step(H, self.correction)
        gain = self.solver.gain
        weight = _blind_weight(H, y, gain) if spec.weight is None else spec.weight
        self.strength = weight * gain
        self.rho = gain * (_PENALTY * weight if spec.rho is None else spec.rho)
        self.solver.prepare(self.rho)
        self.sums = np.zeros((H.in_shape[0], 3))
        self.change, self.variation = math.inf, 0.0

    def iterate(self) -> None:
        """One iteration, from the data step to the residual of the new z."""
        dtype = self.z.dtype
        relaxation, weight = dtype.type(_RELAXATION), dtype.type(self.strength / self.rho)
        least = dtype.type(0 if self.spec.nonnegative else -math.inf)
        seen = self.solver.solve(self.r, self.w)
        self.H.adjoint(self.w, out=self.correction)
        self.residual_of_a += relaxation * (self.residual - self.residual_of_a - seen)
        arrays = self.z, self.correction, relaxation, self.a, self.p
        last = weight, self.spec.tv_iterations, least, self.sums
        run_chunks(kernels.relax_and_smooth, len(self.z), 1, *arrays, *last)
        self.H.forward(self.correction, out=self.r)
        self.r -= self.y
        self.residual = (self.r + self.residual_of_a) / 2
        change, size, self.variation = self.sums.sum(axis=0).tolist()
        self.change = math.sqrt(change / size) if size > 0 else 0.0


def _blind_weight(H: LinearOperator, y: np.ndarray, gain: float) -> float:
    """λ/h by the noise of a voxel: that of the snapshots over √h."""
    return max(_FACTOR * (noise_level(H, y) / math.sqrt(gain)) ** _POWER, _LEAST)
