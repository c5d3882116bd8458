"""EigenPnP: `EigenTV`, and then a denoiser on the leading eigen-images; the symbols are those of `_eigen_splitting`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from shadowgram._threads import run_chunks
from shadowgram.operators.base import LinearOperator
from shadowgram.priors import _tv_kernels
from shadowgram.priors.denoiser import LEAST_SIDE, Denoiser, get

from ._eigen_run import EigenRun
from ._eigen_splitting import TV_ITERATIONS
from ._parts import Weighted
from .eigen_tv import check_settings
from .solution import Callback, Solution, solve

# Standard deviation of the noise that a weight of the total variation takes out about as strongly. docs/decisions/0004-eigen-tv.md.
_SIGMA = 1.5
_HELD_OUT = 0.1


@dataclass(frozen=True, kw_only=True)
class EigenPnP:
    """Specification of a reconstruction by `EigenTV` with a stage of plug-and-play on the eigen-images.

    Parameters
    ----------
    denoiser : ``"ffdnet"``, ``"bm3d"``, ``"tv"`` (see `shadowgram.priors.get`), or any callable ``(image, sigma) → image``.
    images : how many of the eigen-images it denoises, the leading ones; the others keep their total variation.
    stage : iterations with the denoiser.
    noise, nonnegative : as for `EigenTV`.
    max_iter, tol : as for `EigenTV`, of the iterations without the denoiser.

    Raises
    ------
    TypeError
        If the denoiser is neither a name nor a callable.
    ValueError
        If a parameter is out of its range.

    Notes
    -----
    After `EigenTV`, the proximal map of the total variation of a leading eigen-image gives way to the denoiser, with a σ that
    matches the map's weight: σ_m = 1.5 (m + 1)^p λ/μ, which follows the noise of the snapshots as λ does. V, λ and μ stay.

    Whether it harms is found without a truth: both ways are tried on 90 % of the detector's elements, always the same ones, and
    the denoiser is left out if its cube predicts the other 10 % worse by more than two standard errors. That doubles the time.
    A difference of half a decibel is below that with noise, and so a small harm may pass. Cubes with a side below 8 pixels have
    no such stage.

    The history is that of `EigenTV`, and goes on through the stage that is used; trials are not part of it. ``Solution.denoised``
    says whether the denoiser was used. Converged means that the first stage was.

    Sources: Venkatakrishnan, Bouman and Wohlberg, GlobalSIP (2013) 945 (a denoiser as the prior); Stone, J. R. Stat. Soc. B 36
    (1974) 111 (the choice by prediction).

    Examples
    --------
    >>> import shadowgram as sg
    >>> cube = sg.scenes.chart(size=32, bands=4, seed=0).values
    >>> imager = sg.DualCASSI(cube_shape=cube.shape, wavelengths=(450, 650))
    >>> H = imager.operator(sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0))
    >>> solution = sg.solve(sg.EigenPnP(stage=4), H, H.forward(cube))
    >>> sg.metrics.psnr(solution.x, cube, peak=1.0) > 25
    True
    """

    denoiser: str | Denoiser = "ffdnet"
    images: int = 4
    stage: int = 12
    noise: float | None = None
    nonnegative: bool = True
    max_iter: int = 150
    tol: float = 5e-4

    def __post_init__(self) -> None:
        check_settings("EigenPnP", self.noise, self.max_iter, self.tol)
        if not isinstance(self.denoiser, str) and not callable(self.denoiser):
            raise TypeError(f"EigenPnP: denoiser is a name or a callable (image, sigma) → image, got {self.denoiser!r}")
        for name in ("images", "stage"):
            value = getattr(self, name)
            if not isinstance(value, int | np.integer) or value < 1:
                raise ValueError(f"EigenPnP: {name} must be a whole number of at least 1, got {value!r}")


@solve.register
def _(spec: EigenPnP, H: LinearOperator, y: np.ndarray, callback: Callback | None = None) -> Solution:
    denoise = get(spec.denoiser) if isinstance(spec.denoiser, str) else spec.denoiser
    run = EigenRun("EigenPnP", H, y, spec.noise, spec.nonnegative, callback)
    converged = interrupted = denoised = False
    try:
        converged = run.minimise(spec.max_iter, spec.tol)
        denoised = not _harms(spec, denoise, run, y)
        if denoised:
            _plug_in(spec, denoise, run)
    except KeyboardInterrupt:
        interrupted = True
    return run.solution(converged and not interrupted, interrupted, denoised)


def _harms(spec: EigenPnP, denoise: Denoiser, full: EigenRun, y: np.ndarray) -> bool:
    """Whether elements of the detector that were held out are predicted worse with the denoiser than without, or cannot be."""
    H, dtype = full.H, full.dtype
    kept = np.random.default_rng(0).random(H.out_shape) >= _HELD_OUT
    held_out = full.lit & ~kept
    if full.state is None or min(H.in_shape[1:]) < LEAST_SIDE or not held_out.any():
        return True

    def errors() -> np.ndarray:
        assert trial.state is not None
        estimate = trial.state.z * dtype.type(trial.state.amplitude)
        return np.square((H.forward(estimate) - y)[held_out], dtype=np.float64)

    snapshots = np.where(kept, y, 0).astype(dtype)
    trial = EigenRun("EigenPnP", Weighted(H, kept), snapshots, spec.noise, spec.nonnegative)
    if trial.state is None:
        return True
    trial.minimise(spec.max_iter, spec.tol)
    harm = -errors()
    _plug_in(spec, denoise, trial)
    harm += errors()
    return bool(harm.mean() > 2 * harm.std() / math.sqrt(harm.size))


def _plug_in(spec: EigenPnP, denoise: Denoiser, run: EigenRun) -> None:
    """The stage with the denoiser."""
    state = run.state
    assert state is not None
    leading = min(spec.images, len(state.z))

    def prior(images: np.ndarray) -> None:
        weights = state.weights()
        for m in range(leading):
            images[m] = denoise(images[m], float(_SIGMA * weights[m]))
        rest = images[leading:]
        run_chunks(_tv_kernels.smooth, len(rest), 1, rest, state.p[leading:], weights[leading:], TV_ITERATIONS, rest)

    for _ in range(spec.stage):
        run.step(state, prior)
