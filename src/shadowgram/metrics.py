"""How far a reconstruction is from the truth: PSNR, mean spectral RMSE, SSIM and spectral angle.

Every function takes the estimate first and the ground truth second, real arrays of one shape, (band, y, x), and gives a
float; sums are taken in float64. xarray cubes are taken as they lie.
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
