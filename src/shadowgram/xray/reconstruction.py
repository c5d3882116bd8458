"""From the counts of a scan to its image, with nothing to choose: all parameters follow from the noise of the counts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shadowgram.priors.denoiser import LEAST_SIDE, Denoiser, get

from ._background import Background, fit_background, fit_poisson
from ._blind import Callback, Splitting, noise_unit
from .captured import checked_counts
from .cxbi import CXBI

if TYPE_CHECKING:
    from shadowgram.operators.base import LinearOperator

Floats = NDArray[np.float64]
Likelihood = Literal["poisson", "least-squares"]

_SMALL = 128 * 128  # pixels
_ITERATIONS, _LARGE_ITERATIONS = 100, 40
_NOISELESS = 1e-9  # of the mean
_SETTLED = 0.05  # relative change in the last iteration
_REWEIGHTED = (0.5, 0.75)  # after these shares of the iterations the variances are those of the estimate


@dataclass(frozen=True, kw_only=True, eq=False)
class Reconstruction:
    """An image, and what it was made with.

    Attributes
    ----------
    x : (y, x) counts a shot that the target gives through each open cell; not negative. The air is not in it.
    pedestal : counts that the air gives through each open cell, by the run without target; `x` + `pedestal` is what a pencil beam
        through one cell would count. 0 without such a run.
    background : (shot,) counts without target, as modelled.
    deviation : (shot,) standard deviation of the counts, as modelled.
    dispersion : variance of the counts over their mean, by the run without target: 1 for pure Poisson noise. It scales `deviation`.
    sigma : last σ of the denoiser, in the units of `x`.
    chi2 : mean square of the counts' distance from the model, in units of their variance.
    converged : whether the image has settled in the last iteration.
    history : for each iteration ``"sigma"``, ``"primal"`` ‖x − z‖/‖z‖, ``"change"`` of z, ``"residual"`` in standard deviations,
        ``"seconds"`` since the start.
    """

    x: Floats
    pedestal: float
    background: Floats
    deviation: Floats
    dispersion: float
    sigma: float
    chi2: float
    converged: bool
    history: Mapping[str, Sequence[float]]


def reconstruct(
    codes: ArrayLike,
    counts: ArrayLike,
    background: ArrayLike | None = None,
    *,
    imager: CXBI | None = None,
    denoiser: str | Denoiser | tuple[str | Denoiser, ...] = ("ffdnet", "bm3d"),
    likelihood: Likelihood = "poisson",
    iterations: int | None = None,
    callback: Callback | None = None,
) -> Reconstruction:
    """Reconstruct the image of a backscatter scan from its counts.

    Parameters
    ----------
    codes : transmittances from 0 to 1, 1 = open: one code a shot (shot, y, x), or a mask (y, x + shots − 1) that slides by a column
        a shot. `shadowgram.xray.walls.through_walls` makes them of a thick mask.
    counts : (shot,) of all detectors together, as they were measured.
    background : (shot,) counts of the same shots without the target, which are modelled and not subtracted one by one; None if
        there is nothing to subtract.
    imager : for leakage, penumbra and sensitivity; by default ``CXBI`` without them.
    denoiser : name or callable ``(image, sigma) → image``, see `shadowgram.priors.get`. Of several the first works alone and the
        mean of all in the last 30 % of the iterations.
    likelihood : ``"poisson"`` takes the variances from the estimate, which makes the fixed point one of the Poisson likelihood with
        the background in its mean; ``"least-squares"`` takes them from a smooth fit of the counts.
    iterations : by default 100, and 40 for images of more than 128 × 128 pixels.
    callback : called with the number of each iteration and its values, see `Reconstruction.history`.

    Returns
    -------
    Reconstruction

    Raises
    ------
    TypeError
        If a denoiser is neither a name nor a callable.
    ValueError
        If there is not a count for each code, counts are negative or not finite, the background is not of the same shots, a code
        has no open cell or values outside 0 to 1, or a parameter is out of its range.

    Notes
    -----
    Minimises the weighted squares of ``counts − background − A x`` with plug-and-play ADMM (`shadowgram.ADMM` says how), x ≥ 0, for
    whitened counts. Nothing is tuned to an image: the σ of the denoiser goes from 4 ν to 0.35 ν and λ = 1/2, with ν the noise of a
    pixel in the counts' correlation with the codes. With the identity link a step of Fisher scoring for the Poisson likelihood is a
    least-squares fit of the counts with the weights 1/mean, so that new weights are all it takes.

    Sources: Salazar (2022), eqs. (4.4) and (4.10) to (4.13); McCullagh and Nelder, Generalized Linear Models (1989), section 2.5.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> rng = np.random.default_rng(0)
    >>> truth = np.zeros((16, 16))
    >>> truth[4:12, 6:10] = 40
    >>> mask = (rng.random((16, 16 + 127)) < 0.3).astype(np.uint8)
    >>> A = sg.CXBI(shape=truth.shape).operator(mask)
    >>> y, air = rng.poisson(500 + A.forward(truth)), rng.poisson(500, 128)
    >>> found = sg.xray.reconstruct(mask, y, background=air)
    >>> bool(np.corrcoef(found.x.ravel(), truth.ravel())[0, 1] > 0.95)
    True
    """
    codes = _checked_codes(codes, counts)
    y = checked_counts("the counts", counts, _shots(codes, np.size(counts)))
    operator = _operator(codes, y.size, imager)
    denoisers = [get(one) if isinstance(one, str) else one for one in _several(denoiser)]
    if likelihood not in ("poisson", "least-squares"):
        raise ValueError(f"likelihood is 'poisson' or 'least-squares', got {likelihood!r}")
    steps = _checked_iterations(iterations, operator)
    area = operator.forward(np.ones(operator.in_shape))
    model = fit_background(np.zeros(y.size) if background is None else _checked_background(background, y.size), area)
    mean = fit_poisson(y, model.terms)[1] if y.any() else np.ones(y.size)
    dispersion = _dispersion(model, y)
    deviation = np.sqrt(dispersion * mean)
    state = Splitting(
        operator=operator, counts=y - model.values, unit=noise_unit(codes, deviation), denoisers=denoisers, iterations=steps
    )  # fmt: skip
    shares = _REWEIGHTED if likelihood == "poisson" else ()
    edges = [0, *(round(share * steps) for share in shares), steps]
    for start, stop in pairwise(edges):
        if start > 0:
            # If the estimate is the truth; never far below the smooth fit.
            means = np.maximum(model.values + operator.forward(state.z), 0.2 * mean)
            deviation = np.sqrt(dispersion * means)
        state.run(deviation, start, stop, callback)
    return _result(state, model, dispersion, deviation)


def _dispersion(model: Background, counts: Floats) -> float:
    """Variance of the counts over their mean: what the background shows, and at least 1 for whole counts.

    A background without noise, such as a model or the mean of many runs, shows nothing.
    """
    if (counts == np.round(counts)).all():
        return max(model.dispersion, 1.0)
    return model.dispersion if model.dispersion > _NOISELESS * float(counts.mean()) else 1.0


def _result(state: Splitting, model: Background, dispersion: float, deviation: Floats) -> Reconstruction:
    rest = (state.counts - state.operator.forward(state.z)) / deviation
    return Reconstruction(
        x=state.z,
        pedestal=max(model.pedestal, 0.0),
        background=model.values,
        deviation=deviation,
        dispersion=dispersion,
        sigma=state.history["sigma"][-1],
        chi2=float(np.mean(rest**2)),
        converged=state.history["change"][-1] <= _SETTLED,
        history=state.history,
    )


def _checked_codes(codes: ArrayLike, counts: ArrayLike) -> np.ndarray:
    try:
        array = np.asarray(codes)
    except ValueError:
        raise ValueError("the codes of a scan must all have the same size") from None
    if array.dtype.kind not in "fiub" or array.ndim not in (2, 3) or not array.size:
        raise ValueError(
            "codes are numbers (shot, y, x), or one sliding mask (y, x + shots − 1);"
            f" got {array.dtype} of shape {array.shape}"
        )
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise ValueError("codes must hold transmittances from 0 to 1, got NaN or infinite ones")
    if array.ndim == 2 and array.shape[1] - np.size(counts) + 1 < LEAST_SIDE:
        raise ValueError(
            f"a sliding mask of {array.shape[1]} columns has no window of at least {LEAST_SIDE} for {np.size(counts)} counts;"
            " give one count for each position of the mask"
        )
    if min(array.shape[-2:]) < LEAST_SIDE:
        raise ValueError(
            f"images of fewer than {LEAST_SIDE}×{LEAST_SIDE} pixels cannot be reconstructed; the codes have {array.shape}"
        )
    return array


def _shots(codes: np.ndarray, counts: int) -> int:
    return len(codes) if codes.ndim == 3 else counts


def _operator(codes: np.ndarray, shots: int, imager: CXBI | None) -> LinearOperator:
    shape = (codes.shape[1], codes.shape[2]) if codes.ndim == 3 else (codes.shape[0], codes.shape[1] - shots + 1)
    chosen = CXBI(shape=shape) if imager is None else imager
    if chosen.shape != shape:
        raise ValueError(f"the imager has {chosen.shape} cells, but codes and counts belong to {shape}")
    return chosen.operator(codes)


def _several(denoiser: str | Denoiser | tuple[str | Denoiser, ...]) -> tuple[str | Denoiser, ...]:
    several = denoiser if isinstance(denoiser, tuple) else (denoiser,)
    if not several or not all(isinstance(one, str) or callable(one) for one in several):
        raise TypeError(f"denoiser is a name, a callable (image, sigma) → image, or several of them; got {denoiser!r}")
    return several


def _checked_background(background: ArrayLike, shots: int) -> Floats:
    array = np.asarray(background)
    if array.ndim == 1 and len(array) != shots:
        raise ValueError(
            f"the background is {'longer' if len(array) > shots else 'shorter'} than the scan: {len(array)} shots and {shots};"
            " give the counts without target of the same shots"
        )
    return checked_counts("the background", array, shots)


def _checked_iterations(iterations: int | None, operator: LinearOperator) -> int:
    if iterations is None:
        return _ITERATIONS if np.prod(operator.in_shape) <= _SMALL else _LARGE_ITERATIONS
    if not isinstance(iterations, int | np.integer) or iterations < 4:
        raise ValueError(f"iterations must be a whole number of at least 4, got {iterations!r}")
    return int(iterations)
