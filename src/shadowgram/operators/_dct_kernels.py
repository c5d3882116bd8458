"""Kernels of the DCT along bands, joined with the first wavelet level along x so that the cube is crossed once.

The DCT-II of L bands is two products with half-size matrices: even coefficients see x[b] + x[L−1−b], odd ones x[b] − x[L−1−b].
"""

import numpy as np
from numba import njit

from ._wavelet_kernels import (
    analyse_lanes,
    copy,
    halves_to_lanes,
    lane_rows,
    lanes_to_halves,
    lanes_to_rows,
    row_pitch,
    rows_to_lanes,
    split_row,
    synthesise_lanes,
)

ROWS = 8  # a block
COLUMNS = 256  # of the tiles that the matrix products work on


@njit(cache=True, nogil=True, fastmath={"contract"})
def _multiply(matrix, source, rows, target, to_rows, n):
    """target[to_rows[k], x] = Σ_b matrix[k, b] source[rows[b], x] for x < n.

    Four outputs and three inputs at once keep 12 matrix elements in registers. The matrix is padded with zeros to these multiples;
    the padded ends of `rows` and `to_rows` name any row that may be read, or overwritten.
    """
    for k in range(0, matrix.shape[0], 4):
        w, x, y, z = to_rows[k], to_rows[k + 1], to_rows[k + 2], to_rows[k + 3]
        for b in range(0, matrix.shape[1], 3):
            r, s, t = rows[b], rows[b + 1], rows[b + 2]
            w0, w1, w2 = matrix[k, b], matrix[k, b + 1], matrix[k, b + 2]
            x0, x1, x2 = matrix[k + 1, b], matrix[k + 1, b + 1], matrix[k + 1, b + 2]
            y0, y1, y2 = matrix[k + 2, b], matrix[k + 2, b + 1], matrix[k + 2, b + 2]
            z0, z1, z2 = matrix[k + 3, b], matrix[k + 3, b + 1], matrix[k + 3, b + 2]
            if b == 0:
                for i in range(n):
                    f, g, h = source[r, i], source[s, i], source[t, i]
                    target[w, i] = w0 * f + w1 * g + w2 * h
                    target[x, i] = x0 * f + x1 * g + x2 * h
                    target[y, i] = y0 * f + y1 * g + y2 * h
                    target[z, i] = z0 * f + z1 * g + z2 * h
            else:
                for i in range(n):
                    f, g, h = source[r, i], source[s, i], source[t, i]
                    target[w, i] += w0 * f + w1 * g + w2 * h
                    target[x, i] += x0 * f + x1 * g + x2 * h
                    target[y, i] += y0 * f + y1 * g + y2 * h
                    target[z, i] += z0 * f + z1 * g + z2 * h


@njit(cache=True, nogil=True)
def _fold(cube, y, first, n, sums):
    """Sums of mirrored bands into the first half of `sums`, differences into the second; the middle band is a sum."""
    bands = cube.shape[0]
    half, whole = bands // 2, bands - bands // 2
    for b in range(half):
        front, back = cube[b, y, first : first + n], cube[bands - 1 - b, y, first : first + n]
        plus, minus = sums[b], sums[whole + b]
        for i in range(n):
            plus[i] = front[i] + back[i]
            minus[i] = front[i] - back[i]
    if whole > half:
        sums[half, :n] = cube[half, y, first : first + n]


@njit(cache=True, nogil=True)
def _unfold(sums, cube, y, first, n):
    """Transpose of `_fold`."""
    bands = cube.shape[0]
    half, whole = bands // 2, bands - bands // 2
    for b in range(half):
        front, back = cube[b, y, first : first + n], cube[bands - 1 - b, y, first : first + n]
        plus, minus = sums[b], sums[whole + b]
        for i in range(n):
            front[i] = plus[i] + minus[i]
            back[i] = plus[i] - minus[i]
    if whole > half:
        cube[half, y, first : first + n] = sums[half, :n]


@njit(cache=True, nogil=True)
def _scratch(bands, wide, dtype):
    """Sums over mirrored bands; a block after the DCT, band by band; the same as lanes; rows on the way to or from lanes."""
    sums = np.zeros((bands + 3, COLUMNS + 8), dtype)
    mixed = np.zeros((ROWS * bands + 7, COLUMNS + 8), dtype)
    lanes = np.zeros((lane_rows(wide), (ROWS * bands + 7) // 8 * 8), dtype)
    return sums, mixed, lanes, np.zeros((8, row_pitch(wide)), dtype)


@njit(cache=True, nogil=True)
def _product_rows(count, padded, first, stride):
    """Rows first, first + stride, …; the padding repeats the last one."""
    rows = np.empty(padded, np.intp)
    for i in range(padded):
        rows[i] = first + stride * min(i, count - 1)
    return rows


@njit(cache=True, nogil=True)
def _target_rows(count, padded, first, stride, spare):
    """Rows first, first + stride, …; the padding goes to the (up to 3) rows from `spare` on."""
    rows = _product_rows(count, padded, first, stride)
    for i in range(count, padded):
        rows[i] = spare + i - count
    return rows


@njit(cache=True, nogil=True)
def analyse_rows(start, stop, cube, even, odd, taps, scale, out):
    """DCT along bands and first wavelet level along x, for blocks of `ROWS` rows of `out`, whose rows are in split order.

    cube (band, y, x); out (band, padded y, padded x); even, odd: the halves of the DCT matrix, padded as `_multiply` asks.
    """
    bands, ny, nx = cube.shape
    whole, half = bands - bands // 2, bands // 2
    wide = out.shape[2]
    sums, mixed, lanes, rows = _scratch(bands, wide, cube.dtype)
    from_even = _product_rows(whole, even.shape[1], 0, 1)
    from_odd = _product_rows(half, odd.shape[1], whole, 1)
    for block in range(start, stop):
        first = ROWS * block
        count = min(ROWS, out.shape[1] - first)
        for begin in range(0, wide, COLUMNS):
            n = max(0, min(COLUMNS, nx - begin))
            # Where the scene is padded, below and to the right, the adjoint of cropping gives zeros.
            if n < min(COLUMNS, wide - begin):
                mixed[:] = 0
            for r in range(count):
                y = split_row(first + r, out.shape[1])
                if y < ny and n > 0:
                    _fold(cube, y, begin, n, sums)
                    to = _target_rows(whole, even.shape[0], r, 2 * ROWS, ROWS * bands)
                    _multiply(even, sums, from_even, mixed, to, n)
                    to = _target_rows(half, odd.shape[0], ROWS + r, 2 * ROWS, ROWS * bands)
                    _multiply(odd, sums, from_odd, mixed, to, n)
                else:
                    mixed[r : ROWS * bands : ROWS] = 0
            for lane in range(0, lanes.shape[1], 8):
                rows_to_lanes(mixed, lane, min(COLUMNS, wide - begin), lanes[begin:], lane)
        analyse_lanes(lanes, wide, taps, scale)
        for lane in range(0, lanes.shape[1], 8):
            lanes_to_halves(lanes, lane, wide // 2, rows)
            for i in range(lane, min(lane + 8, ROWS * bands)):
                if i % ROWS < count:
                    copy(rows[i - lane], out[i // ROWS, first + i % ROWS], wide)


@njit(cache=True, nogil=True)
def synthesise_rows(start, stop, planes, even, odd, taps, scale, cube):
    """Inverse of `analyse_rows`, cropped to the cube, but for blocks of rows in natural order: `planes` may be `cube`.

    even, odd: the transposed halves of the DCT matrix; `taps`: the reversed ones.
    """
    bands, ny, nx = cube.shape
    whole, half = bands - bands // 2, bands // 2
    wide = planes.shape[2]
    sums, mixed, lanes, rows = _scratch(bands, wide, cube.dtype)
    to_even = _target_rows(whole, even.shape[0], 0, 1, bands)
    to_odd = _target_rows(half, odd.shape[0], whole, 1, bands)
    for block in range(start, stop):
        first = ROWS * block
        count = min(ROWS, ny - first)
        for lane in range(0, lanes.shape[1], 8):
            for i in range(lane, min(lane + 8, ROWS * bands)):
                if i % ROWS < count:
                    copy(planes[i // ROWS, first + i % ROWS], rows[i - lane], wide)
            halves_to_lanes(rows, wide // 2, lanes, lane)
        synthesise_lanes(lanes, wide, taps, scale)
        for begin in range(0, nx, COLUMNS):
            n = min(COLUMNS, nx - begin)
            for lane in range(0, lanes.shape[1], 8):
                lanes_to_rows(lanes[begin:], lane, n, mixed, lane)
            for r in range(count):
                _multiply(even, mixed, _product_rows(whole, even.shape[1], r, 2 * ROWS), sums, to_even, n)
                _multiply(odd, mixed, _product_rows(half, odd.shape[1], ROWS + r, 2 * ROWS), sums, to_odd, n)
                _unfold(sums, cube, first + r, begin, n)
