"""By how much one image of a code is shifted against another, to a small part of a pixel.

A detector integrates over its pixels, so the correlation of two images, seen as a function of a continuous shift, is convolved with
a triangle two pixels wide. Its spectrum has double zeros at the multiples of the sampling rate: smoothed by a wide Gaussian, the
sampled correlation has its maximum where the continuous one has, whatever the code, its blur and its place between the pixels.
A parabola through three samples is off by 0.15 pixels with sharp codes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

LOCAL = 15  # pixels; side of the window of the local mean
DIM = 0.5  # of the mean; below, the local mean is of a region that the mask or the scene leaves dark
SHARP = 1.0  # standard deviation, pixels: keeps the peak apart from chance
WIDE = 2.0  # standard deviation, pixels: 0.005 px rms at 128 × 128, against 0.010 with 1.5
MARGIN = 7  # lags: three and a half widths
SIGNIFICANT = 5.5  # standard deviations; the largest of 600 lags reaches 4.9 by chance (32 × 32 and more)


def local_contrast(images: np.ndarray) -> np.ndarray:
    """Images (…, y, x) over their local mean, less 1: the code without what is smooth in the scene or the light."""
    from scipy.ndimage import uniform_filter

    images = images.astype(np.float64)
    mean = uniform_filter(images, LOCAL, mode="nearest", axes=(-2, -1))
    lit = mean > np.maximum(DIM * images.mean(axis=(-2, -1), keepdims=True), np.finfo(float).tiny)
    return np.where(lit, images / np.where(lit, mean, 1) - 1, 0)


@dataclass(frozen=True, eq=False)
class Correlation:
    """Mean product of two images at whole lags, (lag y, lag x), each from −n to n; `samples` is how many went into each."""

    values: np.ndarray
    samples: np.ndarray

    @property
    def lags(self) -> tuple[np.ndarray, np.ndarray]:
        """Lags along y and x."""
        ny, nx = (n // 2 for n in self.values.shape)
        return np.arange(-ny, ny + 1), np.arange(-nx, nx + 1)

    def at(self, dy: float, dx: float, sigma: float) -> float:
        """Smoothed by a Gaussian, at any shift."""
        return float((self.values * self._window(dy, dx, sigma)).sum())

    def climb(self, dy: float, dx: float) -> tuple[float, float]:
        """Maximum of the widely smoothed correlation from a start nearby, by the mean shift."""
        lag_y, lag_x = self.lags
        for _ in range(200):
            weight = self.values * self._window(dy, dx, WIDE)
            total = weight.sum()
            if not total > 0:
                break
            new_y, new_x = float((weight.sum(axis=1) @ lag_y) / total), float((weight.sum(axis=0) @ lag_x) / total)
            settled = abs(new_y - dy) + abs(new_x - dx) < 1e-6
            dy, dx = new_y, new_x
            if settled:
                break
        return dy, dx

    def _window(self, dy: float, dx: float, sigma: float) -> np.ndarray:
        lag_y, lag_x = self.lags
        along_y, along_x = (np.exp(-((lag - d) ** 2) / (2 * sigma**2)) for lag, d in ((lag_y, dy), (lag_x, dx)))
        return along_y[:, None] * along_x


def correlate(a: np.ndarray, b: np.ndarray, lag_y: int, lag_x: int) -> Correlation:
    """Mean over (…, y, x) of a(y, x) b(y + lag, x + lag), over where the two overlap."""
    ny, nx = a.shape[-2:]
    # No lag may wrap around; multiples of 32 are quick to transform.
    size = -(-(ny + lag_y) // 32) * 32, -(-(nx + lag_x) // 32) * 32
    spectrum = np.zeros((size[0], size[1] // 2 + 1), np.complex128)
    for one, other in zip(a.reshape(-1, ny, nx), b.reshape(-1, ny, nx), strict=True):
        spectrum += np.conj(np.fft.rfft2(one, size)) * np.fft.rfft2(other, size)
    lags = np.arange(-lag_y, lag_y + 1)[:, None], np.arange(-lag_x, lag_x + 1)
    samples = (ny - np.abs(lags[0])) * (nx - np.abs(lags[1])) * (a.size // (ny * nx))
    return Correlation(np.fft.irfft2(spectrum, size)[lags] / samples, samples)


def peak(correlation: Correlation) -> tuple[float, float] | None:
    """Lags (y, x) of the correlation's maximum, or None if it is not above chance."""
    from scipy.ndimage import gaussian_filter

    # One row of lags is one-dimensional: nothing to smooth along y.
    sigma = SHARP if len(correlation.values) > 1 else (0, SHARP)
    # Fewer samples, more chance: this way it is the same at all lags.
    score = gaussian_filter(correlation.values, sigma, mode="constant") * np.sqrt(correlation.samples)
    row, column = np.unravel_index(int(score.argmax()), score.shape)
    elsewhere = np.ones(score.shape, bool)
    elsewhere[max(row - 4, 0) : row + 5, max(column - 4, 0) : column + 5] = False
    chance = np.sqrt(np.mean(score[elsewhere] ** 2)) if elsewhere.any() else 0.0
    if not score[row, column] > SIGNIFICANT * chance:
        return None
    lag_y, lag_x = correlation.lags
    return float(lag_y[row]), float(lag_x[column])


def locate(a: np.ndarray, b: np.ndarray, lag_y: int, lag_x: int) -> tuple[float, float] | None:
    """(dy, dx) by which `b` shows the contrast of `a` further down and right, or None if it does not within these lags."""
    start = peak(correlate(a, b, lag_y, lag_x))
    if start is None:
        return None
    whole = round(start[0]), round(start[1])
    rest = correlate(*tapered(a, b, whole), min(lag_y, MARGIN), MARGIN).climb(0.0, 0.0)
    return whole[0] + rest[0], whole[1] + rest[1]


def similarity(a: np.ndarray, b: np.ndarray, dy: float, dx: float) -> float:
    """Correlation coefficient of two contrasts, slightly smoothed, one of them shifted."""
    whole = round(dy), round(dx)
    a, b = tapered(a, b, whole)
    both, one, other = (correlate(p, q, MARGIN, MARGIN) for p, q in ((a, b), (a, a), (b, b)))
    norm = math.sqrt(one.at(0, 0, SHARP) * other.at(0, 0, SHARP))
    return both.at(dy - whole[0], dx - whole[1], SHARP) / norm if norm > 0 else 0.0


def tapered(a: np.ndarray, b: np.ndarray, shift: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """What two images have in common when `b` is shifted by whole pixels, fading out towards the edges.

    At the edges the local mean is of half a window, and one image shows what the other does not: that moves the maximum by up to
    0.06 px.
    """
    (ny, nx), (dy, dx) = a.shape[-2:], shift
    a = a[..., max(-dy, 0) : ny - max(dy, 0), max(-dx, 0) : nx - max(dx, 0)]
    b = b[..., max(dy, 0) : ny + min(dy, 0), max(dx, 0) : nx + min(dx, 0)]
    fade = np.hanning(a.shape[-2] + 2)[1:-1, None] * np.hanning(a.shape[-1] + 2)[1:-1]
    return a * fade, b * fade
