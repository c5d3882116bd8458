"""Whether what a reconstruction leaves of the measurement looks like noise, which it does when the model is right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

# (y, x) steps to the neighbours, each pair of elements once.
LAGS = ((0, 1), (1, 0), (1, 1), (1, -1))
# Below this the detector has too few pairs of lit neighbours to say anything.
_LEAST_PAIRS = 30


@dataclass(frozen=True, kw_only=True)
class Whiteness:
    """Autocorrelation of a residual at small lags.

    Attributes
    ----------
    z : the largest of the `scores` in absolute value, with its sign. White noise gives about ±1 to ±3.
    correlation : the autocorrelation with the largest absolute value, −1 to 1; 0 for white noise, up to `expected`. With many
        pixels a very small correlation is significant, and so has a large z; this says whether it is large.
    expected : standard deviation of the correlations for white noise.
    correlations : autocorrelation at each of the `lags`, over all shots.
    scores : the correlations as z-scores: their mean for white noise is 0, their standard deviation 1.
    lags : (y, x) steps of the correlations, in detector elements.
    """

    z: float
    correlation: float
    expected: float
    correlations: tuple[float, ...]
    scores: tuple[float, ...]
    lags: tuple[tuple[int, int], ...] = LAGS


def residual_whiteness(residual: ArrayLike, lit: ArrayLike | None = None) -> Whiteness:
    """Find out how white a residual H x − y is.

    Parameters
    ----------
    residual : (shot, y, x) or (y, x), real numbers.
    lit : which elements of the detector get light, an array of booleans of the residual's shape; by default those where the
        residual is not exactly 0.

    Returns
    -------
    Whiteness
        All zero where there are fewer than 30 pairs of lit neighbours, or the residual is 0.

    Raises
    ------
    TypeError
        If the residual is not real numbers.
    ValueError
        If a shape does not fit, or a value is not finite.

    Notes
    -----
    At lag d the correlation is Σ rᵢ rᵢ₊d / Σ r², with both sums over the pairs of lit elements of all shots, the second over the
    mean of the two squares; the score is Σ rᵢ rᵢ₊d / √(Σ rᵢ² rᵢ₊d²), which has a variance of 1 for independent noise of mean zero
    even where its variance differs from element to element, as that of photons does.

    A reconstruction fits part of the noise as well, which leaves a small correlation where the model is right, a few hundredths.
    Above about 0.1 the model misses something: a mask out of place, a wrong dispersion, blur; or, in data with little noise,
    details of the scene that the prior smoothed away.

    Source: Bartlett (1946), "On the theoretical specification and sampling properties of autocorrelated time-series"; the
    variance without equal variances is that of White (1980).

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.solvers.whiteness import residual_whiteness
    >>> noise = np.random.default_rng(0).standard_normal((2, 64, 64))
    >>> abs(residual_whiteness(noise).z) < 4, residual_whiteness(noise + np.roll(noise, 1, axis=2)).correlation > 0.4
    (True, True)
    """
    r, seen, scale = _checked(residual, lit)
    # Shot by shot, which needs little memory.
    shots = [[_pair_sums(one / scale, there, *lag) for lag in LAGS] for one, there in zip(r, seen, strict=True)]
    count, total, square, fourth = np.array(shots, float).reshape(-1, len(LAGS), 4).sum(axis=0).T
    told = (count >= _LEAST_PAIRS) & (square > 0) & (fourth > 0)
    square, spread = np.where(told, square, 1.0), np.where(told, np.sqrt(fourth), 1.0)
    total = np.where(told, total, 0.0)
    correlations, scores = (total / square).tolist(), (total / spread).tolist()
    return Whiteness(
        z=max(scores, key=abs),
        correlation=max(correlations, key=abs),
        expected=float(np.where(told, spread / square, 0.0).max()),
        correlations=tuple(correlations),
        scores=tuple(scores),
    )


def _checked(residual: ArrayLike, lit: ArrayLike | None) -> tuple[np.ndarray, np.ndarray, np.float64]:
    """Residual (shot, y, x), where it counts, and its largest absolute value."""
    r = np.asarray(residual)
    if r.dtype.kind not in "fiub":
        raise TypeError(f"residual_whiteness takes real numbers, got an array of {r.dtype}")
    if r.ndim not in (2, 3):
        raise ValueError(f"residual_whiteness takes a residual (shot, y, x) or (y, x), got the shape {r.shape}")
    if not np.isfinite(r).all():
        raise ValueError("residual_whiteness takes finite values, got NaN or infinite ones")
    seen = r != 0 if lit is None else np.asarray(lit, bool)
    if seen.shape != r.shape:
        raise ValueError(f"lit must have the residual's shape {r.shape}, got {seen.shape}")
    scale = max(float(r.max(initial=0)), -float(r.min(initial=0))) or 1.0
    return r.reshape(-1, *r.shape[-2:]), seen.reshape(-1, *r.shape[-2:]), np.float64(scale)


def _pair_sums(r: np.ndarray, seen: np.ndarray, down: int, right: int) -> tuple[float, float, float, float]:
    """Of the pairs of lit elements at a lag: how many, Σ rᵢrⱼ, Σ (rᵢ² + rⱼ²)/2 and Σ rᵢ²rⱼ²."""
    rows, columns = r.shape
    first = np.s_[: max(rows - down, 0), max(-right, 0) : columns - max(right, 0)]
    second = np.s_[down:, max(right, 0) : columns + min(right, 0)]
    both = seen[first] & seen[second]
    a, b = np.where(both, r[first], 0), np.where(both, r[second], 0)
    products = a * b
    square = (np.square(a).sum() + np.square(b).sum()) / 2
    return float(np.count_nonzero(both)), float(products.sum()), float(square), float(np.square(products).sum())
