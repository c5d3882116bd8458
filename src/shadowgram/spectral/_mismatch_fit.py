"""First look at what is wrong with a model, in windows whose brightness is fitted anew for every trial (variable projection).

It finds the dark level, and where the mask is to a whole pixel and across the dispersion. Along the dispersion, a window alone does
not tell a moved mask from another spectrum: that is for `_mismatch_refine`.

Model of a window: P(dy, dx) a + o_q, with P the patterns of the bands and a their brightness. Sources: Golub and Pereyra, Inverse
Problems 19 (2003) R1; steps after Kaufman, BIT 15 (1975) 49.
"""

from __future__ import annotations

import numpy as np

from ._mismatch_windows import LocalFit, Windows, local_fit

MOST_LIT, MOST_ALL, MOST_SEARCHED = 500, 1500, 250  # windows for the place, for the dark level, and for the search
LIT = 0.2  # of the bright windows' light
FLAT = 0.1  # share of the windows whose variance counts as that of the noise
SEARCHED = 2  # px each way
MOST_ROUNDS = 10
STEP = 0.5  # px, at most, in a round
SETTLED = 0.005  # px
CLEAR = 3.0  # standard errors by which another place must fit better


def lit(windows: Windows, offsets: np.ndarray, most: int) -> Windows:
    """At most `most` of the windows that show light, evenly over the detector: dark ones cannot say where a pattern is."""
    light = (windows.values - offsets[windows.shot_of]).mean(axis=1)
    bright = np.flatnonzero(light > LIT * np.quantile(light, 0.95))
    if not bright.size:
        return windows
    return windows.part(bright[np.linspace(0, len(bright) - 1, min(most, len(bright))).astype(int)])


def spread_out(windows: Windows, most: int) -> Windows:
    """At most `most` windows, evenly over the detector."""
    count = len(windows.values)
    return windows.part(np.linspace(0, count - 1, min(most, count)).astype(int))


def fit_at(windows: Windows, place: tuple[float, float], offsets: np.ndarray) -> tuple[LocalFit, np.ndarray]:
    """Fit of the brightness with the patterns (dy, dx) px from their place, and what it leaves (window, value)."""
    fit = local_fit(windows.patterns(*place))
    return fit, fit.rest(windows.values - offsets[windows.shot_of])


def noise_floor(windows: Windows, offsets: np.ndarray) -> float:
    """Variance of the flattest windows: what is below it tells nothing more."""
    fit, rest = fit_at(windows, (0.0, 0.0), offsets)
    return max(float(np.quantile(fit.variance(rest), FLAT)), 1e-12 * float(np.square(windows.values).mean()))


def search(windows: Windows, offsets: np.ndarray, floor: float) -> dict[tuple[int, int], np.ndarray]:
    """(window,) logarithm of the variance that is left, at whole pixels."""
    whole = range(-SEARCHED, SEARCHED + 1)
    scores = {}
    for at in ((dy, dx) for dy in whole for dx in whole):
        fit, rest = fit_at(windows, at, offsets)
        scores[at] = np.log(fit.variance(rest) + floor)
    return scores


def worse_by(other: np.ndarray, best: np.ndarray, tile: np.ndarray) -> float:
    """Standard errors by which the mean of one score is above that of another, with the tiles as samples."""
    difference = other - best
    sums = np.array([difference[tile == t].sum() for t in np.unique(tile)])
    error = np.sqrt(np.square(sums - sums.mean()).sum() * len(sums) / max(len(sums) - 1, 1))
    return float(sums.sum() / error) if error > 0 else 0.0


def fit_offsets(
    windows: Windows, place: tuple[float, float], offsets: np.ndarray, floor: float
) -> tuple[np.ndarray, np.ndarray]:
    """Dark level of each shot, and its standard error; the dark windows decide."""
    errors = np.zeros_like(offsets)
    columns = (windows.shot_of[:, None] == np.arange(windows.shots)).astype(float)
    for _ in range(3):
        fit, rest = fit_at(windows, place, offsets)
        slopes = fit.rest(np.broadcast_to(columns, (*rest.shape, windows.shots)))
        step, errors = weighted_step(slopes, rest, 1 / (fit.variance(rest) + floor), windows.tile)
        offsets = offsets + step
    return offsets, errors


def fit_down(windows: Windows, place: tuple[float, float], offsets: np.ndarray, floor: float) -> tuple[float, float]:
    """Shift of the mask across the dispersion, from a start nearby, and its standard error."""
    (dy, dx), error = place, 0.0
    for _ in range(MOST_ROUNDS):
        pattern, down = windows.patterns_and_slopes(dy, dx)
        fit = local_fit(pattern)
        values = windows.values - offsets[windows.shot_of]
        a, rest = fit.brightness(values), fit.rest(values)
        slopes = fit.rest(down @ a[..., None])
        steps, errors = weighted_step(slopes, rest, 1 / (fit.variance(rest) + floor), windows.tile)
        step, error = float(np.clip(steps[0], -STEP, STEP)), float(errors[0])
        dy += step
        if abs(step) < SETTLED:
            break
    return dy, error


def weighted_step(
    slopes: np.ndarray, rest: np.ndarray, weight: np.ndarray, tile: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Step of weighted least squares, and its standard errors by the scatter between tiles.

    `slopes` is (window, value, parameter), `rest` (window, value), `weight` and `tile` (window,).
    """
    gradient = np.einsum("w,wpm,wp->wm", weight, slopes, rest)
    curvature = np.einsum("w,wpm,wpn->mn", weight, slopes, slopes, optimize=True)
    curvature += max(1e-9 * np.trace(curvature), np.finfo(float).tiny) * np.eye(len(curvature))
    sums = np.stack([gradient[tile == t].sum(axis=0) for t in np.unique(tile)])
    inverse = np.linalg.inv(curvature)
    errors = np.sqrt(np.maximum(np.diag(inverse @ (sums.T @ sums) @ inverse), 0))
    return inverse @ sums.sum(axis=0), errors
