"""The 8×8 transforms of BM3D, and what noise of a known spectrum has in their coefficients."""

from __future__ import annotations

from functools import cache

import numpy as np

SIDE = 8  # pixels of a block
# Cohen, Daubechies and Feauveau (1992), table 6.1: the low-pass filter that goes with the two taps of the Haar wavelet.
_LOW_PASS = np.array([3, -3, -22, 22, 128, 128, 22, -22, -3, 3]) / 256


@cache
def cosine() -> np.ndarray:
    """Orthonormal DCT-II, (coefficient, pixel)."""
    k, n = np.mgrid[:SIDE, :SIDE]
    matrix = np.sqrt(2 / SIDE) * np.cos(np.pi * k * (2 * n + 1) / (2 * SIDE))
    matrix[0] = np.sqrt(1 / SIDE)
    return matrix


@cache
def biorthogonal() -> np.ndarray:
    """Wavelet transform bior1.5 down to one mean, periodic, (coefficient, pixel), with rows of unit norm."""
    matrix = np.eye(SIDE)
    length = SIDE
    while length > 1:
        matrix[:length] = _wavelet_step(length) @ matrix[:length]
        length //= 2
    return matrix / np.linalg.norm(matrix, axis=1, keepdims=True)


def _wavelet_step(length: int) -> np.ndarray:
    """One level: means of `length` periodic samples in the upper half, differences of neighbours in the lower one."""
    half = length // 2
    step = np.zeros((length, length))
    for i in range(half):
        for tap, value in enumerate(_LOW_PASS):
            step[i, (2 * i + tap - 4) % length] += value
        step[half + i, 2 * i] += 1
        step[half + i, 2 * i + 1] -= 1
    return step


def noise_covariances(matrix: np.ndarray, spectrum: np.ndarray, reach: int) -> np.ndarray:
    """Covariances (down, across, c), flat float32, of a coefficient of two blocks that are −2·reach to 2·reach apart.

    A coefficient is Σ b(n) z(n), with noise z of variance 1, so that of blocks d apart the covariance is
    Σ_l r(d + l) Σ_n b(n) b(n + l), where r is the noise's autocovariance, the Fourier transform of its power spectral density
    (ky, kx); b is a product of two rows of the matrix.
    """
    lags = np.arange(1 - SIDE - 2 * reach, SIDE + 2 * reach)
    covariance = np.fft.ifft2(spectrum).real
    covariance = covariance[np.ix_(lags % spectrum.shape[0], lags % spectrum.shape[1])] / covariance[0, 0]
    row = np.stack([np.correlate(one, one, "full") for one in matrix])
    near = np.lib.stride_tricks.sliding_window_view(covariance, row.shape[1], axis=0) @ row.T  # (down, lag, i)
    both = np.lib.stride_tricks.sliding_window_view(near, row.shape[1], axis=1) @ row.T  # (down, across, i, j)
    return both.astype(np.float32).ravel()
