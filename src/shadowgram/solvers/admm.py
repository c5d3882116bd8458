"""ADMM with a denoiser in the place of the prior (plug-and-play).

| symbol | meaning |
|---|---|
| H, y | the imager's operator, and what it measured |
| x, z, u | estimate that follows the data, estimate that follows the denoiser, scaled multiplier |
| D, σ | the denoiser, and the standard deviation that it removes |
| λ, ρ | strength of the prior, and the penalty ρ = λ/σ² that ties x to z |
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from shadowgram.operators.base import LinearOperator
from shadowgram.priors.denoiser import Denoiser, get

from ._admm_data import data_step, length
from .solution import Callback, Solution, check_problem, solve

# Share of ‖z‖ that the dual residual is compared with where the multiplier is smaller, as for data without noise.
_FLOOR = 0.01
# Growth of the estimate since the first iteration, after which it is not going to come back.
_RUNAWAY = 1e9


@dataclass(frozen=True, kw_only=True)
class ADMM:
    """Specification of a reconstruction by alternating directions with a denoiser as the prior.

    Iteration: x ← argmin ½‖Hx − y‖² + ρ/2‖x − z + u‖²; z ← D(x + u, σ), with σ² = λ/ρ; u ← u + x − z.

    Parameters
    ----------
    denoiser : ``"bm3d"``, ``"ffdnet"``, ``"tv"`` (see `shadowgram.priors.get`), or any callable ``(image, sigma) → image`` for
        images (y, x). Each band of a cube is denoised by itself.
    sigma : σ, above 0, in the units of the image: how much the denoiser takes out in one iteration. A pair ``(first, last)`` goes
        from one to the other in equal ratios and then stays; a large first one finds the coarse image quickly.
    strength : λ, above 0, in the units of y². The Bayesian reading is λ = s² for noise of standard deviation s in y. Denoisers are
        not exactly such priors: on measured backscatter scans, with the last σ 0.3 to 1.2 of the mean of the image, 0.1 s² to s²
        was best, the more the larger σ.
    nonnegative : whether no value of the image can be below zero, as for reflectance, radiance and counts.
    schedule : iterations from the first σ to the last, if there are two; by default half of `max_iter`.
    max_iter : most iterations.
    tol : converged when both residuals are below this share of what they are compared with, with σ at its last value.

    Raises
    ------
    TypeError
        If a parameter is of the wrong kind.
    ValueError
        If a parameter is out of its range.

    Notes
    -----
    The data step is exact. With v = z − u it is x = v − Hᵀ(HHᵀ + ρI)⁻¹(Hv − y), by one shot × shot matrix a detector element where
    `shot_gram` knows them; by one eigendecomposition of HHᵀ or HᵀH, whichever is smaller, up to 2048 rows or columns; and by
    conjugate gradients elsewhere, from the previous solution and ten times more accurate than the residuals. The multiplier ρu is
    carried over when ρ changes.

    The history of `solve` has, for every iteration, ``"primal"`` ‖x − z‖, ``"dual"`` ρ‖z − previous z‖, ``"residual"`` ‖Hx − y‖₂,
    ``"rho"``, ``"sigma"`` and ``"seconds"`` since the start. Converged means ‖x − z‖ ≤ tol max(‖x‖, ‖z‖) and ‖z − previous z‖ ≤
    tol max(‖u‖, ‖z‖/100). A denoiser that is a proximal map of a convex function leads there; others may cycle or diverge. If they
    do, or the iterations run out, the result is not converged, and is the z whose larger relative residual was least since σ
    reached its last value.

    The result of a fixed point with ``TVDenoiser(weight=w)`` minimises ½‖Hx − y‖² + (wλ/σ) TV(x).

    Sources: Salazar (2022), eq. (4.4); Venkatakrishnan, Bouman and Wohlberg, GlobalSIP (2013) 945 (a denoiser as the prior); Boyd
    et al., Found. Trends Mach. Learn. 3 (2011) 1, sections 3.1 and 3.3 (scaled form, residuals).

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> truth = np.ones((4, 16, 16), np.float32)
    >>> truth[:, 4:12, 4:12] = np.array([0.2, 0.5, 0.7, 0.3])[:, None, None]
    >>> imager = sg.DualCASSI(cube_shape=truth.shape, wavelengths=(450, 650))
    >>> H = imager.operator(sg.codes.boolean(shots=3, shape=imager.code_shape, seed=0))
    >>> solver = sg.ADMM(denoiser="tv", sigma=(0.5, 0.02), strength=1e-4)
    >>> sg.metrics.psnr(sg.solve(solver, H, H.forward(truth)).x, truth, peak=1.0) > 30
    True
    """

    denoiser: str | Denoiser = "bm3d"
    sigma: float | tuple[float, float]
    strength: float
    nonnegative: bool = True
    schedule: int | None = None
    max_iter: int = 100
    tol: float = 1e-3

    def __post_init__(self) -> None:
        if not isinstance(self.denoiser, str) and not callable(self.denoiser):
            raise TypeError(f"ADMM: denoiser is a name or a callable (image, sigma) → image, got {self.denoiser!r}")
        sigmas = self.sigma if isinstance(self.sigma, tuple) else (self.sigma,)
        if len(sigmas) not in (1, 2) or not all(_positive(one) for one in sigmas):
            raise ValueError(
                f"ADMM: sigma is a standard deviation above 0 in the image's units, or a pair of them (first, last), "
                f"got {self.sigma!r}"
            )
        if not _positive(self.strength):
            raise ValueError(f"ADMM: strength is λ in the units of y² and must be above 0, got {self.strength!r}")
        if not _whole(self.max_iter):
            raise ValueError(f"ADMM: max_iter must be a whole number of at least 1, got {self.max_iter!r}")
        if self.schedule is not None and len(sigmas) == 1:
            raise ValueError("ADMM: schedule belongs to a pair of sigmas (first, last); there is one sigma only")
        if self.schedule is not None and not (_whole(self.schedule) and self.schedule <= self.max_iter):
            raise ValueError(
                f"ADMM: schedule is a whole number of iterations, from 1 to max_iter = {self.max_iter}, got {self.schedule!r}"
            )
        if not 0 <= self.tol < 1:
            raise ValueError(f"ADMM: tol is a relative residual and must lie in [0, 1), got {self.tol}")

    def _sigma(self, iteration: int) -> tuple[float, bool]:
        """σ of an iteration, counted from 0, and whether it is the last value."""
        if not isinstance(self.sigma, tuple):
            return float(self.sigma), True
        first, last = self.sigma[0], self.sigma[-1]
        steps = (max(self.max_iter // 2, 1) if self.schedule is None else self.schedule) - 1
        if iteration >= steps:
            return float(last), True
        return float(first * (last / first) ** (iteration / steps)), False


def _positive(value: object) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and bool(0 < value < math.inf)


def _whole(value: object) -> bool:
    return isinstance(value, int | np.integer) and bool(value >= 1)


@solve.register
def _(spec: ADMM, H: LinearOperator, y: np.ndarray, callback: Callback | None = None) -> Solution:
    begun = time.perf_counter()
    y = check_problem(H, y)
    if len(H.in_shape) not in (2, 3):
        raise ValueError(f"ADMM reconstructs images (y, x) or cubes (band, y, x), but the operator takes {H.in_shape}")
    history: dict[str, list[float]] = {name: [] for name in ("primal", "dual", "residual", "rho", "sigma", "seconds")}
    state = _Splitting(spec, H, y)
    converged = interrupted = False
    try:
        for iteration in range(spec.max_iter):
            sigma, settled = spec._sigma(iteration)
            values = state.iterate(sigma, settled)
            if values is None:
                break
            values["seconds"] = time.perf_counter() - begun
            for name, value in values.items():
                history[name].append(value)
            if callback is not None:
                callback(iteration + 1, dict(values))
            converged = settled and state.error <= spec.tol and state.data.exact
            if converged:
                break
    except KeyboardInterrupt:
        interrupted = True
    x = state.z if converged or state.best is None else state.best
    return Solution(x, converged, len(history["seconds"]), history, interrupted, time.perf_counter() - begun)


class _Splitting:
    """Where the iteration stands. z is replaced as a whole, so that it can be given back at any time."""

    def __init__(self, spec: ADMM, H: LinearOperator, y: np.ndarray) -> None:
        self.prior = _Prior(spec)
        self.strength = spec.strength
        self.data = data_step(H, y)
        self.z, self.u = np.zeros(H.in_shape, y.dtype), np.zeros(H.in_shape, y.dtype)
        self.rho = math.nan
        self.limit = math.inf  # of ‖x + u‖
        self.error = self.least = math.inf  # larger relative residual: now, and the least since σ settled
        self.best: np.ndarray | None = None

    def iterate(self, sigma: float, settled: bool) -> dict[str, float] | None:
        """One iteration; the values for the history, or None where the estimate has run away."""
        rho = self.strength / sigma**2
        if rho != self.rho and not math.isnan(self.rho):
            self.u *= self.u.dtype.type(self.rho / rho)
        self.rho = rho
        accuracy = 0.1 * min(max(self.error, 1e-7), 1e-2)
        with np.errstate(over="ignore", invalid="ignore"):
            x, residual = self.data.solve(self.z - self.u, rho, accuracy)
            noisy = x + self.u
            if not length(noisy) < self.limit:  # or NaN
                return None
        z = self.prior(noisy, sigma)
        before, self.z = self.z, z
        self.u += x - z
        primal, change, size = length(x - z), length(z - before), max(length(x), length(z))
        self.limit = min(self.limit, _RUNAWAY * size) if size > 0 else self.limit
        self._judge(primal, change, size, settled)
        return {"primal": primal, "dual": rho * change, "residual": residual, "rho": rho, "sigma": sigma}

    def _judge(self, primal: float, change: float, size: float, settled: bool) -> None:
        scale = max(length(self.u), _FLOOR * size)
        # Where both x and z are zero, nothing is left to compare.
        self.error = max(primal / size, change / scale) if size > 0 else 0.0
        if settled and self.error < self.least:
            self.least, self.best = self.error, self.z


@dataclass
class _Prior:
    """D, band by band, and no value below zero where none can be."""

    spec: ADMM
    denoise: Callable[[np.ndarray, float], np.ndarray] = field(init=False)
    name: str = field(init=False)

    def __post_init__(self) -> None:
        chosen = self.spec.denoiser
        self.denoise = get(chosen) if isinstance(chosen, str) else chosen
        self.name = chosen if isinstance(chosen, str) else getattr(chosen, "__name__", type(chosen).__name__)

    def __call__(self, noisy: np.ndarray, sigma: float) -> np.ndarray:
        bands = noisy.reshape(-1, *noisy.shape[-2:])
        z = np.stack([self._checked(self.denoise(band, sigma), band.shape) for band in bands])
        z = z.reshape(noisy.shape).astype(noisy.dtype)
        return np.maximum(z, 0) if self.spec.nonnegative else z

    def _checked(self, found: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        found = np.asarray(found)
        if found.shape != shape or found.dtype.kind not in "fiub":
            what = f"shape {found.shape}" if found.shape != shape else f"type {found.dtype}"
            raise ValueError(
                f"ADMM: the denoiser {self.name} must give real numbers of shape {shape}, got an array of {what}"
            )
        if not np.isfinite(found).all():
            raise ValueError(
                f"ADMM: the denoiser {self.name} gave values that are not finite for an image whose values are"
            )
        return found
