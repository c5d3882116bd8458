"""Rectangles that cover the open or the closed elements of a code, in whole nanometres."""

from __future__ import annotations

import numpy as np


def rectangles(opened: np.ndarray, side: int, bias: int, *, closed: bool) -> np.ndarray:
    """Cover the open areas of one shot, or what is left of its area, once.

    Parameters
    ----------
    opened : (y, x) bool.
    side : of an element, nm.
    bias : nm by which the edges of the open areas move inwards; less than half of `side`.
    closed : cover what is not open.

    Returns
    -------
    (n, 4) int64 array of top, bottom, left, right, nm from the upper left corner, row by row.
    """
    pattern, cuts = (
        (_shrunk(opened), np.array([0, bias, side - bias])) if bias else (opened, np.zeros(1, dtype=np.int64))
    )
    y, x = (np.append((np.arange(n)[:, None] * side + cuts).ravel(), n * side) for n in opened.shape)
    top, bottom, left, right = merged(~pattern if closed else pattern).T
    return np.stack([y[top], y[bottom], x[left], x[right]], axis=1)


def _shrunk(opened: np.ndarray) -> np.ndarray:
    """(3y, 3x): each element in an inner part and a rim of strips and corners, which is open where all that it touches is."""
    rows, columns = opened.shape
    around = np.pad(opened, 1)
    parts = np.empty((rows, 3, columns, 3), dtype=bool)
    for i in range(3):
        for j in range(3):
            # The part (i, j) touches the elements from here to one step up or down, left or right, or none of these.
            above, beside = around[i : i + rows, 1 : columns + 1], around[1 : rows + 1, j : j + columns]
            parts[:, i, :, j] = opened & above & beside & around[i : i + rows, j : j + columns]
    return parts.reshape(3 * rows, 3 * columns)


def merged(pattern: np.ndarray) -> np.ndarray:
    """(n, 4) top, bottom, left, right of rectangles that cover every True element of (y, x) once, row by row."""
    steps = np.diff(pattern.astype(np.int8), axis=1, prepend=0, append=0)
    row, left = np.nonzero(steps == 1)
    right = np.nonzero(steps == -1)[1]
    order = np.lexsort((row, right, left))
    row, left, right = row[order], left[order], right[order]
    begins = np.ones(len(row), dtype=bool)
    begins[1:] = (np.diff(row) != 1) | (np.diff(left) != 0) | (np.diff(right) != 0)
    ends = np.roll(begins, -1)
    found = np.stack([row[begins], row[ends] + 1, left[begins], right[begins]], axis=1)
    return found[np.lexsort((found[:, 2], found[:, 0]))]
