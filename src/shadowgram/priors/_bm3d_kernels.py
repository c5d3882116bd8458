"""Kernels of BM3D on one tile. Letters: p position of a block, c one of the 64 coefficients of an 8×8 block, k place in a group.

Images are float32, in units of the noise's standard deviation. The coefficients of the blocks at all positions are computed once,
and groups are gathered from them. Filtered groups are added up as coefficients, so that the inverse transform is done once a
position and not once a block of a group.

Arrays come flat and their indices are unsigned: numba then has no negative ones to think of, so that the inner loops are vectorised
and there is little to compile.
"""

import numpy as np
from numba import njit

from ._bm3d_transforms import SIDE

SIZE = SIDE * SIDE
SPAN = 128  # columns of which distances are computed in one go, at most
OUTSIDE = np.float32(1e15)  # what the guide holds beyond its edges: a block there is like none inside
NONE = np.int64(2**63 - 1)
LEAST = np.float32(1e-6)  # variance that a coefficient has at least, so that nothing is divided by zero

_U = np.uint64
_SIDE, _SIZE, _HALF, _LAST = _U(SIDE), _U(SIZE), _U(SIDE // 2), _U(SIDE - 1)
_ZERO, _ONE, _TWO, _FOUR = _U(0), _U(1), _U(2), _U(4)


@njit(nogil=True, no_cpython_wrapper=True, _nrt=False, fastmath={"contract"})  # pyright: ignore[reportCallIssue]
def _add_mix(matrix, row, source, start, apart, out, to, count):
    """Add to out[to:] the sum of eight runs of `count` numbers, `apart` from each other, that a row of the matrix weighs."""
    s0 = _SIDE * row
    for n in range(count):
        total = out[to + n]
        for k in range(_SIDE):
            total += matrix[s0 + k] * source[start + k * apart + n]
        out[to + n] = total


@njit(cache=True, nogil=True, _nrt=False)  # pyright: ignore[reportCallIssue]
def analyse(matrix, source, row, apart, lines, width, items, planes, out):
    """Transform along one axis: set out (y, x, i, item) to Σₖ matrix[i, k] source[row·y + apart·k + (x, item)].

    Along x, with one item and `apart` 1, this takes an image to rows (y, x, j) of the coefficients of its runs of pixels; along y,
    with these 8 items and `apart` their row, it takes the rows to the coefficients (y, x, i, j) of blocks. `planes` (i, x, item)
    is scratch.
    """
    count = width * items
    for y in range(lines):
        planes[:] = 0
        for i in range(_SIDE):
            _add_mix(matrix, i, source, row * y, apart, planes, i * count, count)
        for x in range(width):
            for i in range(_SIDE):
                to, start = ((y * width + x) * _SIDE + i) * items, i * count + x * items
                for item in range(items):
                    out[to + item] = planes[start + item]


@njit(cache=True, nogil=True, _nrt=False)  # pyright: ignore[reportCallIssue]
def synthesise(matrix, source, row, apart, lines, width, items, planes, out):
    """Transform back along one axis: add Σₖ matrix[i, k] source[y, x, k, item] to out[row·y + apart·i + (x, item)]."""
    count = width * items
    for y in range(lines):
        for x in range(width):
            for k in range(_SIDE):
                start, to = ((y * width + x) * _SIDE + k) * items, k * count + x * items
                for item in range(items):
                    planes[to + item] = source[start + item]
        for i in range(_SIDE):
            _add_mix(matrix, i, planes, _ZERO, count, out, row * y + apart * i, count)


@njit(nogil=True, no_cpython_wrapper=True, _nrt=False, fastmath={"contract"})  # pyright: ignore[reportCallIssue]
def _distances(guide, columns, here, there, span, sums, found):
    """Set found[n] to the squared distance of the blocks that begin at here + n and there + n, n < span."""
    for n in range(span):
        total = np.float32(0)
        for k in range(_SIDE):
            difference = guide[here + k * columns + n] - guide[there + k * columns + n]
            total += difference * difference
        sums[n] = total
    for n in range(span):
        sums[n] += sums[n + _ONE]
    for n in range(span):
        sums[n] += sums[n + _TWO]
    for n in range(span):
        found[n] = sums[n] + sums[n + _FOUR]


@njit(cache=True, nogil=True, _nrt=False)  # pyright: ignore[reportCallIssue]
def match(guide, columns, ys, left, offsets, down, across, last, farthest, most, span, sums, found, bits, worst, keys):
    """Set keys (y, x, k) to the blocks most like those at (ys, left + offsets), nearest first; what is left over is NONE.

    A key is the bits of the squared distance, which are in its order, above the number of the step: one comparison orders both, and
    of equal distances the earlier step wins.

    Parameters
    ----------
    guide, columns : image (y, x) with margins of OUTSIDE to the left and the right, and its columns; `left` counts them.
    down, across : steps (step,) to try, (0, 0) first; those that lead to rows before 0 or after `last` are passed over.
    farthest : squared distance, as the bits of a float32, from which on blocks are not alike.
    span : columns of which distances are computed in one go, which are there in the guide: at least to the end of the last block.
    sums, found, bits, worst : scratch (span + SIDE,) of zeros, (span,), the same memory as int32, and (x,).
    """
    for r in range(ys.size):
        row_keys = keys[r * offsets.size * most : (r + 1) * offsets.size * most]
        row_keys[:] = NONE
        worst[:] = farthest
        for s in range(down.size):
            row = ys[r] + down[s]
            if row < 0 or row > last:
                continue
            _distances(
                guide,
                _U(columns),
                _U(ys[r] * columns + left),
                _U(row * columns + left + across[s]),
                _U(span),
                sums,
                found,
            )
            for i in range(offsets.size):
                distance = bits[offsets[i]]
                if distance < worst[i]:
                    key, k, first = (np.int64(distance) << 32) | s, (i + 1) * most - 1, i * most
                    while k > first and row_keys[k - 1] > key:
                        row_keys[k] = row_keys[k - 1]
                        k -= 1
                    row_keys[k] = key
                    worst[i] = min(worst[i], row_keys[first + most - 1] >> 32)


@njit(nogil=True, _nrt=False, no_cpython_wrapper=True)  # pyright: ignore[reportCallIssue]
def haar(group, start, n, size, backward):
    """Orthonormal Haar transform of the n rows of `size` numbers at start, n a power of two, in place."""
    scale = np.float32(0.5**0.5)
    apart = n // 2 if backward else 1
    while 1 <= apart < n:
        for k in range(0, n, 2 * apart):
            a, b = _U(start + size * k), _U(start + size * (k + apart))
            for c in range(_U(size)):
                total, difference = scale * (group[a + c] + group[b + c]), scale * (group[a + c] - group[b + c])
                group[a + c] = total
                group[b + c] = difference
        apart = apart // 2 if backward else 2 * apart


@njit(nogil=True, _nrt=False, no_cpython_wrapper=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")  # pyright: ignore[reportCallIssue]
def shrink(group, pilot, n, variances, start, threshold):
    """Shrink the coefficients of a group, but not their mean; give the weight of the group, 1/(variance that remains).

    Without a pilot, what is within `threshold` standard deviations is set to zero; else the Wiener filter is applied that the
    pilot gives. The noise's variances (k, c) begin at `start`.
    """
    mean, left, square = group[0], variances[start], threshold * threshold
    group[0] = 0
    if pilot.size == 0:
        for c in range(_U(SIZE * n)):
            value = group[c]
            kept = np.float32(value * value > square * variances[start + c])
            left += kept * variances[start + c]
            group[c] = kept * value
    else:
        pilot[0] = 0
        for c in range(_U(SIZE * n)):
            power = pilot[c] * pilot[c]
            factor = power / (power + variances[start + c])
            left += factor * factor * variances[start + c]
            group[c] *= factor
    group[0] = mean
    return np.float32(1) / left


@njit(nogil=True, _nrt=False, no_cpython_wrapper=True)  # pyright: ignore[reportCallIssue]
def _gather(coefficients, places, first, n, group):
    for k in range(n):
        a, b = _U(SIZE * k), _U(SIZE * places[first + k])
        for c in range(_SIZE):
            group[a + c] = coefficients[b + c]


@njit(cache=True, nogil=True, _nrt=False, fastmath={"contract"})  # pyright: ignore[reportCallIssue]
def filter_groups(places, counts, noisy, pilot, variances, threshold, group, other, sums, weights):
    """Filter groups and add them to the sums (p, c) of coefficients and to the weights (p,).

    Parameters
    ----------
    places, counts : positions (group, k) of blocks, and how many of each group count: a power of two.
    noisy, pilot : coefficients (p, c) of the noisy image and of the first estimate; the latter is empty in the first stage.
    variances : of the noise in the coefficients (k, c) of all groups, or (group, k, c).
    threshold : of the first stage, in standard deviations.
    group, other : scratch (k, c); `other` is empty in the first stage.
    """
    most = places.size // counts.size
    apart = SIZE * most if variances.size > SIZE * most else 0
    for i in range(counts.size):
        n, first = counts[i], i * most
        _gather(noisy, places, first, n, group)
        haar(group, 0, n, SIZE, False)
        if pilot.size > 0:
            _gather(pilot, places, first, n, other)
            haar(other, 0, n, SIZE, False)
        weight = shrink(group, other, n, variances, _U(apart * i), threshold)
        haar(group, 0, n, SIZE, True)
        for k in range(n):
            a, p = _U(SIZE * k), places[first + k]
            b = _U(SIZE * p)
            weights[p] += weight
            for c in range(_SIZE):
                sums[b + c] += weight * group[a + c]


@njit(cache=True, nogil=True, _nrt=False)  # pyright: ignore[reportCallIssue]
def group_variances(places, counts, width, covariances, square, variances):
    """Set variances (group, k, c) to those of the coefficients of groups of blocks whose noise is correlated.

    The covariances of the blocks of a group, `square` (k, k, c), are transformed along both axes: the diagonal is what is wanted.

    Parameters
    ----------
    places, counts : positions (group, k) of blocks, `width` of them in a row, and how many of each group count.
    covariances : (down, across, c), of the noise in a coefficient of two blocks as far apart, the middle for the same block.
    """
    most = places.size // counts.size
    side = round((covariances.size // SIZE) ** 0.5)
    for g in range(counts.size):
        n = counts[g]
        for i in range(n):
            p = places[g * most + i]
            for j in range(n):
                q = places[g * most + j]
                down, across = q // width - p // width + side // 2, q % width - p % width + side // 2
                a, b = _U(SIZE * (n * i + j)), _U(SIZE * (side * down + across))
                for c in range(_SIZE):
                    square[a + c] = covariances[b + c]
            haar(square, SIZE * n * i, n, SIZE, False)
        haar(square, 0, n, SIZE * n, False)
        for k in range(n):
            a, b = _U(SIZE * (n + 1) * k), _U(SIZE * (g * most + k))
            for c in range(_SIZE):
                variances[b + c] = max(square[a + c], LEAST)
