"""What a smooth picture can do to the counts of a scan: its covariance over the shots.

The picture is taken for a Gaussian random field that is smooth over 1/16 of the field, with no mean: codes lose the share of a
flat picture, which their open area tells. Ridge regression and marginal likelihoods of all such pictures need this matrix only.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_FINEST = 64  # cells a side; beyond that a smooth picture is the same on blocks of cells
_SMOOTH = 1 / 16  # of the longer side of the field
_ROW_VALUES = 8_000_000  # numbers in the rows that the self-correlation is taken from


def covariance(codes: NDArray) -> Floats:
    """(shot, shot) covariance of the counts of a random smooth picture, 1 on the diagonal on average.

    Raises
    ------
    ValueError
        If the codes do not change.
    """
    found = _responses(codes)
    whole = float((found * found).sum())
    found -= found.mean(axis=0)
    matrix = found @ found.T
    power = float(np.trace(matrix))
    if power <= 1e-20 * whole:
        raise ValueError("the codes are the same in every shot, so they cannot tell one picture from another")
    return matrix * (len(matrix) / power)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep BLAS to one thread, since several wait for each other under load; also a decorator."""
    import threadpoolctl

    with threadpoolctl.threadpool_limits(limits=1, user_api="blas"):
        yield


def _responses(codes: NDArray) -> Floats:
    """(shot, pixel) what unit pictures of the random field add to the counts, in which a flat one is left out."""
    from scipy.ndimage import gaussian_filter

    coarse = _coarse(codes)
    width = max(1.0, _SMOOTH * max(coarse.shape[1:]))
    smooth = gaussian_filter(coarse, (0, width, width), mode="reflect").reshape(len(coarse), -1)
    return smooth - smooth.mean(axis=1, keepdims=True)


def _coarse(codes: NDArray) -> Floats:
    """Means over blocks of whole cells, at most `_FINEST` of them a side; cells that fill no block are left out."""
    side = math.ceil(max(codes.shape[1:]) / _FINEST)
    if side == 1:
        return codes.astype(np.float64)
    shots, rows, columns = codes.shape
    tall, wide = min(side, rows), min(side, columns)
    rows, columns = rows // tall, columns // wide
    cut = codes[:, : rows * tall, : columns * wide]
    return cut.reshape(shots, rows, tall, columns, wide).mean(axis=(2, 4), dtype=np.float64)


def self_correlation(codes: NDArray) -> Floats:
    """(lag,) how much the codes resemble themselves so many shots later, in a circle, moved along x or y by what suits best."""
    open_shares = codes.mean(axis=(1, 2), dtype=np.float64)
    return np.maximum(_moved(codes, open_shares), _moved(codes.transpose(0, 2, 1), open_shares))


def _moved(codes: NDArray, open_shares: Floats) -> Floats:
    """The same for moves along the last axis, from some rows of large codes."""
    shots, rows, columns = codes.shape
    some = np.unique(np.linspace(0, rows - 1, min(rows, max(4, _ROW_VALUES // (shots * columns)))).astype(int))
    power = np.zeros((shots, columns + 1))
    for row in some:
        # Twice as long, so that what leaves on one side does not come in on the other.
        spectrum = np.fft.rfft(codes[:, row] - open_shares[:, None], 2 * columns, axis=1)
        power += np.abs(np.fft.fft(spectrum, axis=0)) ** 2
    found = np.fft.irfft(np.fft.ifft(power, axis=0), 2 * columns, axis=1)
    return found.max(axis=1) / max(float(found[0, 0]), 1e-30)
