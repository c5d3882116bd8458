"""How far a reconstruction is from the truth: PSNR, mean spectral RMSE, SSIM and spectral angle; and the contrast of what it shows.

Every function but the contrast takes the estimate first and the ground truth second, real arrays of one shape, (band, y, x), and
gives a float; sums are taken in float64. xarray cubes are taken as they lie.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

# Wang et al. (2004), section III.B and the values they recommend: an 11 × 11 circular-symmetric Gaussian window.
_SSIM_RADIUS = 5
_SSIM_SIGMA = 1.5
_SSIM_K1 = 0.01
_SSIM_K2 = 0.03


def psnr(x: ArrayLike, truth: ArrayLike, *, peak: float) -> float:
    """Peak signal-to-noise ratio, 10 log₁₀(peak² / mean squared error), in dB.

    Parameters
    ----------
    x, truth : arrays of one shape, (band, y, x) or (y, x). Estimate and ground truth.
    peak : the largest value that the image could have, in its own units: 1.0 for a cube scaled to [0, 1], 255 for 8
        bits. It is not taken from the data, because figures with different peaks cannot be compared.

    Returns
    -------
    float
        In dB; infinite where the two are equal.

    Raises
    ------
    ValueError
        If the shapes differ, a value is not finite, or `peak` is not positive.

    Notes
    -----
    Source: Salazar (2022), eq. (2.32), 20 log₁₀(max / MSE^½) with "the maximum possible value of the image".

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram import metrics
    >>> truth = np.zeros((3, 8, 8))
    >>> round(metrics.psnr(truth + 0.1, truth, peak=1.0), 3)
    20.0
    """
    a, b = _pair(x, truth, "psnr", (2, 3))
    _check_peak(peak)
    mse = float(np.mean(np.square(a - b)))
    return 10.0 * math.log10(peak**2 / mse) if mse > 0 else math.inf


def rms(x: ArrayLike, truth: ArrayLike) -> float:
    """Spectral root-mean-square error of a pixel, averaged over the pixels; in the units of the cube.

    Parameters
    ----------
    x, truth : (band, y, x). Estimate and ground truth.

    Returns
    -------
    float
        mean over (y, x) of √(mean over band of (x − truth)²). Never above √MSE of the whole cube, and equal to it where
        all pixels are equally wrong.

    Raises
    ------
    ValueError
        If the shapes differ, there is no band axis, or a value is not finite.

    Notes
    -----
    Source: Salazar (2022), section 3.6, "averaged spectral root mean squared error".

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram import metrics
    >>> truth = np.zeros((4, 1, 2))
    >>> x = truth.copy()
    >>> x[:, 0, 0] = 0.2
    >>> round(metrics.rms(x, truth), 6)
    0.1
    """
    a, b = _pair(x, truth, "rms", (3,))
    return float(np.sqrt(np.mean(np.square(a - b), axis=0)).mean())


def ssim(x: ArrayLike, truth: ArrayLike, *, peak: float) -> float:
    """Structural similarity, averaged over the bands; 1 for equal images.

    Parameters
    ----------
    x, truth : (band, y, x) or (y, x), at least 11 × 11 pixels. Estimate and ground truth.
    peak : the largest value that the image could have, as in `psnr`.

    Returns
    -------
    float
        At most 1.

    Raises
    ------
    ValueError
        If the shapes differ, the images are smaller than the window, a value is not finite, or `peak` is not positive.

    Notes
    -----
    Source: Wang, Bovik, Sheikh and Simoncelli, "Image quality assessment: from error visibility to structural
    similarity", IEEE Trans. Image Process. 13 (2004), eq. (13), with their 11 × 11 Gaussian window of σ = 1.5 pixels,
    K₁ = 0.01, K₂ = 0.03 and weighted (population) variances. The mean is over the pixels whose window lies inside the
    image, which is what scikit-image gives with ``gaussian_weights=True, sigma=1.5, use_sample_covariance=False``.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram import metrics
    >>> image = np.random.default_rng(0).random((16, 16))
    >>> metrics.ssim(image, image, peak=1.0)
    1.0
    """
    a, b = _pair(x, truth, "ssim", (2, 3))
    _check_peak(peak)
    window = 2 * _SSIM_RADIUS + 1
    if min(a.shape[-2:]) < window:
        raise ValueError(f"ssim needs images of at least {window} × {window} pixels, got {a.shape[-2]} × {a.shape[-1]}")
    bands = zip(a.reshape(-1, *a.shape[-2:]), b.reshape(-1, *b.shape[-2:]), strict=True)
    return float(np.mean([_ssim_band(one, other, peak) for one, other in bands]))


def sam(x: ArrayLike, truth: ArrayLike) -> float:
    """Spectral angle between estimate and truth, averaged over the pixels; in rad.

    Parameters
    ----------
    x, truth : (band, y, x). Estimate and ground truth.

    Returns
    -------
    float
        In [0, π], blind to the brightness of a pixel. The angle to a zero spectrum is taken as π/2, between two of them
        as 0.

    Raises
    ------
    ValueError
        If the shapes differ, there is no band axis, or a value is not finite.

    Notes
    -----
    Source: Kruse et al., "The spectral image processing system (SIPS)", Remote Sens. Environ. 44 (1993), with the arc
    cosine replaced by 2 atan2(|u − v|, |u + v|) of the unit spectra u and v (Kahan), which keeps small angles exact.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram import metrics
    >>> x = np.array([1.0, 0.0]).reshape(2, 1, 1)
    >>> truth = np.array([3.0, 3.0]).reshape(2, 1, 1)
    >>> round(metrics.sam(x, truth) / np.pi, 6)
    0.25
    """
    a, b = _pair(x, truth, "sam", (3,))
    u, a_zero = _unit_spectra(a)
    v, b_zero = _unit_spectra(b)
    angle = 2 * np.arctan2(np.linalg.norm(u - v, axis=0), np.linalg.norm(u + v, axis=0))
    angle[a_zero ^ b_zero] = np.pi / 2
    return float(angle.mean())


def contrast(x: ArrayLike, target: ArrayLike, background: ArrayLike) -> float:
    """Contrast of a region against its background, |mean of the target − mean of the background| / mean of the background.

    Parameters
    ----------
    x : (y, x) image.
    target, background : (y, x) bool, the pixels of either.

    Returns
    -------
    float
        Not negative.

    Raises
    ------
    ValueError
        If shapes differ, a region is empty or both share a pixel, a value is not finite, or the mean of the background is not
        positive.

    Notes
    -----
    Source: Salazar (2022), eq. (4.16). A reconstruction without its air or dark level has a smaller background, and so a larger
    contrast.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram import metrics
    >>> image = np.full((8, 8), 100.0)
    >>> image[2:4, 2:4] = 60.0
    >>> gun = image < 80
    >>> metrics.contrast(image, gun, ~gun), round(metrics.contrast_error(image, gun, ~gun), 4)
    (0.4, 0.0395)
    """
    inside, outside = _regions(x, target, background)
    return abs(float(inside.mean() / outside.mean()) - 1)


def contrast_error(counts: ArrayLike, target: ArrayLike, background: ArrayLike) -> float:
    """Standard error of `contrast` from Poisson noise, where every pixel is a number of counts of its own.

    It holds for images of counts, such as of pencil beams. Pixels of a reconstruction are not independent: repeat such scans.

    Parameters
    ----------
    counts : (y, x) image of counts.
    target, background : as for `contrast`.

    Returns
    -------
    float
        To first order, r √(1/N_t + 1/N_b) with r the ratio of the means and N the counts of a whole region.

    Raises
    ------
    ValueError
        As `contrast`, and if counts are negative.
    """
    inside, outside = _regions(counts, target, background)
    if min(inside.min(), outside.min()) < 0:
        raise ValueError(
            "counts cannot be negative; the error of a contrast by Poisson's law needs counts as they came"
        )
    ratio = inside.mean() / outside.mean()
    return math.sqrt(float(ratio / inside.size / outside.mean() + ratio**2 / outside.sum()))


def _regions(x: ArrayLike, target: ArrayLike, background: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Values of the pixels of both regions."""
    image, inside, outside = np.asarray(x), np.asarray(target), np.asarray(background)
    if image.ndim != 2 or not image.shape == inside.shape == outside.shape:
        raise ValueError(
            f"contrast takes an image (y, x) and two masks of its shape, got {image.shape}, {inside.shape} and {outside.shape}"
        )
    if inside.dtype != bool or outside.dtype != bool:
        raise ValueError("the regions of a contrast are masks of True and False, such as image > 5")
    if not (inside.any() and outside.any()):
        raise ValueError("the target and the background of a contrast need at least a pixel each")
    if (inside & outside).any():
        raise ValueError("the target and the background of a contrast share pixels; take them out of one")
    values = image[inside].astype(np.float64), image[outside].astype(np.float64)
    if not all(np.isfinite(part).all() for part in values):
        raise ValueError("contrast needs finite numbers, but the regions hold NaN or infinity")
    if not values[1].mean() > 0:
        raise ValueError(f"the mean of the background must be positive for a contrast, got {values[1].mean():g}")
    return values


def _ssim_band(a: np.ndarray, b: np.ndarray, peak: float) -> float:
    # The second moments are taken about the bands' means: the difference E[a²] − E[a]² would lose digits otherwise.
    a0, b0 = a.mean(), b.mean()
    a, b = a - a0, b - b0
    mean_a, mean_b = _blur(a), _blur(b)
    var_sum = _blur(a * a + b * b) - mean_a**2 - mean_b**2
    cov = _blur(a * b) - mean_a * mean_b
    mean_a += a0
    mean_b += b0
    c1, c2 = (_SSIM_K1 * peak) ** 2, (_SSIM_K2 * peak) ** 2
    luminance = (2 * mean_a * mean_b + c1) / (mean_a**2 + mean_b**2 + c1)
    return float(np.mean(luminance * (2 * cov + c2) / (var_sum + c2)))


def _blur(image: np.ndarray) -> np.ndarray:
    """Weighted mean over the window, at the pixels whose window lies inside the image."""
    offset = np.arange(-_SSIM_RADIUS, _SSIM_RADIUS + 1)
    weights = np.exp(-0.5 * (offset / _SSIM_SIGMA) ** 2)
    weights /= weights.sum()
    ny, nx = image.shape[0] - 2 * _SSIM_RADIUS, image.shape[1] - 2 * _SSIM_RADIUS
    columns = np.zeros((ny, image.shape[1]))
    for i, weight in enumerate(weights):
        columns += weight * image[i : i + ny]
    mean = np.zeros((ny, nx))
    for i, weight in enumerate(weights):
        mean += weight * columns[:, i : i + nx]
    return mean


def _unit_spectra(cube: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Spectra of length 1, and which pixels have none."""
    largest = np.abs(cube).max(axis=0)  # taken out first, so that squares neither overflow nor underflow
    none = largest == 0
    cube = cube / np.where(none, 1.0, largest)
    return cube / np.where(none, 1.0, np.linalg.norm(cube, axis=0)), none


def _pair(x: ArrayLike, truth: ArrayLike, name: str, dimensions: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    a, b = np.asarray(x), np.asarray(truth)
    if a.shape != b.shape:
        raise ValueError(
            f"{name} compares arrays of one shape, got {a.shape} for the estimate and {b.shape} for the truth"
        )
    if a.ndim not in dimensions or a.size == 0:
        kinds = " or ".join({2: "(y, x)", 3: "(band, y, x)"}[d] for d in reversed(dimensions))
        raise ValueError(f"{name} takes non-empty arrays {kinds}, got shape {a.shape}")
    for array, role in ((a, "estimate"), (b, "truth")):
        if array.dtype.kind not in "fiub":
            raise TypeError(f"{name} takes real numbers, got an {role} of {array.dtype}")
        if not np.isfinite(array).all():
            raise ValueError(
                f"{name} needs finite numbers, but the {role} holds NaN or infinity; mask or crop these pixels"
            )
    return a.astype(np.float64), b.astype(np.float64)


def _check_peak(peak: float) -> None:
    if not (math.isfinite(peak) and peak > 0):
        raise ValueError(f"peak is the largest value that the image could have, a positive number; got {peak!r}")
