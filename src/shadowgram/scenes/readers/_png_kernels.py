"""Undoing the filters of PNG rows, which depend on the bytes before them one after the other."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def undo_filters(kinds: np.ndarray, rows: np.ndarray, step: int) -> None:
    """Replace filtered bytes (row, byte) by what they stand for; `step` bytes lie between a byte and the one left of it.

    The filters are 0 none, 1 left, 2 above, 3 mean of both, 4 Paeth's choice of left, above and corner (PNG
    Specification, chapter 9).
    """
    count, stride = rows.shape
    for i in range(count):
        kind = kinds[i]
        for j in range(stride):
            left = np.int64(rows[i, j - step]) if j >= step else np.int64(0)
            above = np.int64(rows[i - 1, j]) if i else np.int64(0)
            guess = np.int64(0)
            if kind == 1:
                guess = left
            elif kind == 2:
                guess = above
            elif kind == 3:
                guess = (left + above) // 2
            elif kind == 4:
                corner = np.int64(rows[i - 1, j - step]) if i and j >= step else np.int64(0)
                guess = _paeth(left, above, corner)
            rows[i, j] = np.uint8((np.int64(rows[i, j]) + guess) & 255)


@njit(cache=True, nogil=True)
def _paeth(left: np.int64, above: np.int64, corner: np.int64) -> np.int64:
    to_left, to_above, to_corner = abs(above - corner), abs(left - corner), abs(left + above - 2 * corner)
    if to_left <= to_above and to_left <= to_corner:
        return left
    return above if to_above <= to_corner else corner
