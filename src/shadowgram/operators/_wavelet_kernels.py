"""Kernels of the 2-D Symlet-8 transform: the lattice, and the moves between rows and lanes.

One level of a 2-channel orthonormal filter bank with 16 taps is 8 plane rotations of the pair (even, odd) of samples, with a
delay of the odd channel by one pair between rotations (a lattice). That is 16 multiply-adds a pair where filtering
takes 32. `step` runs the lattice along the first axis of a 2-D array, many columns ("lanes") at once, which vectorises and needs no
shuffles. Along y the lanes are the columns of an image; along x the rows are turned into lanes by 8 × 8 transpositions.

Pair p holds samples 2p+7 and 2p+8, so that output p of the lattice, from pairs p−7 … p, is coefficient p in the usual
periodised convention. "Split order" of n rows means sample 2p+7 in row p and sample 2p+8 in row n/2 + p: the lattice then
runs in place and leaves low pass above high pass.
"""

from collections.abc import Callable

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

DELAYS = 7  # pairs that the lattice remembers
LANES = 256  # lanes a pass, so that the remembered pairs stay in the first-level cache


def _transpose8_code(typingctx, source, start, pitch, target, to, to_pitch):  # noqa: ARG001 - the signature numba asks for
    """target.flat[to + c·to_pitch + r] = source.flat[start + r·pitch + c] for r, c in 0 … 7.

    The compiler does not find the 24 register shuffles by itself (the best loop takes twice the time), hence LLVM's own words.
    """
    signature = types.void(source, types.intp, types.intp, target, types.intp, types.intp)

    def codegen(context, builder, signature, args):
        data = [context.make_array(signature.args[i])(context, builder, args[i]).data for i in (0, 3)]
        element = context.get_data_type(signature.args[0].dtype)
        alignment = context.get_abi_sizeof(element)
        vector = ir.VectorType(element, 8)

        def address(base, offset):
            return builder.bitcast(builder.gep(base, [offset]), vector.as_pointer())

        def pick(a, b, lanes):
            return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(ir.IntType(32), 8), lanes))

        rows, offset = [], args[1]
        for _ in range(8):
            rows.append(builder.load(address(data[0], offset), align=alignment))
            offset = builder.add(offset, args[2])
        for half in (4, 2, 1):  # swap the off-diagonal blocks of side 4, then 2, then 1
            for r in (r for r in range(8) if not r & half):
                a, b = rows[r], rows[r + half]
                rows[r] = pick(a, b, [c if not c & half else c - half + 8 for c in range(8)])
                rows[r + half] = pick(a, b, [c + half if not c & half else c + 8 for c in range(8)])
        offset = args[4]
        for row in rows:
            builder.store(row, address(data[1], offset), align=alignment)
            offset = builder.add(offset, args[5])
        return context.get_dummy_value()

    return signature, codegen


_transpose8: Callable[..., None] = intrinsic(_transpose8_code)


@njit(cache=True, nogil=True)
def split_row(position, n):
    """Sample that stands in row `position` of n rows in split order."""
    half = n // 2
    return (2 * position + 7) % n if position < half else (2 * (position - half) + 8) % n


@njit(cache=True, nogil=True)
def copy(source, target, n):
    for i in range(n):
        target[i] = source[i]


@njit(cache=True, nogil=True, inline="always")
def _rotate(a, b, t):
    return a + t * b, b - t * a


@njit(cache=True, nogil=True, fastmath={"contract"})
def _one_pair(e, o, to_e, to_o, d, t, scale):
    """All rotations of one pair of rows; d holds the odd channel's delayed rows, 256 apart."""
    for x in range(e.size):
        a, b = _rotate(e[x], o[x], t[0])
        a, f = _rotate(a, d[x], t[1])
        d[x] = b
        a, b = _rotate(a, d[x + 256], t[2])
        d[x + 256] = f
        a, f = _rotate(a, d[x + 512], t[3])
        d[x + 512] = b
        a, b = _rotate(a, d[x + 768], t[4])
        d[x + 768] = f
        a, f = _rotate(a, d[x + 1024], t[5])
        d[x + 1024] = b
        a, b = _rotate(a, d[x + 1280], t[6])
        d[x + 1280] = f
        a, f = _rotate(a, d[x + 1536], t[7])
        d[x + 1536] = b
        to_e[x] = scale * a
        to_o[x] = -scale * f


@njit(cache=True, nogil=True, fastmath={"contract"})
def _two_pairs(e, o, e2, o2, d, t, scale):
    """Two successive pairs, in place: what the first leaves for the second stays in registers."""
    for x in range(e.size):
        a, b = _rotate(e[x], o[x], t[0])
        A, B = _rotate(e2[x], o2[x], t[0])
        a, f = _rotate(a, d[x], t[1])
        A, F = _rotate(A, b, t[1])
        d[x] = B
        a, b = _rotate(a, d[x + 256], t[2])
        A, B = _rotate(A, f, t[2])
        d[x + 256] = F
        a, f = _rotate(a, d[x + 512], t[3])
        A, F = _rotate(A, b, t[3])
        d[x + 512] = B
        a, b = _rotate(a, d[x + 768], t[4])
        A, B = _rotate(A, f, t[4])
        d[x + 768] = F
        a, f = _rotate(a, d[x + 1024], t[5])
        A, F = _rotate(A, b, t[5])
        d[x + 1024] = B
        a, b = _rotate(a, d[x + 1280], t[6])
        A, B = _rotate(A, f, t[6])
        d[x + 1280] = F
        a, f = _rotate(a, d[x + 1536], t[7])
        A, F = _rotate(A, b, t[7])
        d[x + 1536] = B
        e[x] = scale * a
        o[x] = -scale * f
        e2[x] = scale * A
        o2[x] = -scale * F


@njit(cache=True, nogil=True)
def lattice(a, even, odd, stride, pairs, width, taps, scale):
    """Run the lattice in place over rows even + p·stride and odd + p·stride, p = 0 … pairs−1, of columns 0 … width−1.

    With the minus sign of the last output, the transpose (synthesis) is the same lattice with the rotations in reversed order and
    p descending: give the last rows and a negative stride.
    """
    delayed = np.zeros((DELAYS + 2) * LANES, a.dtype)
    unused = delayed[DELAYS * LANES :]
    for c in range(0, width, LANES):
        stop = min(c + LANES, width)
        # The rows before the first are the last ones, by periodisation; they are read here before they are written.
        for i in range(-DELAYS, 0):
            p = (i % pairs) * stride
            _one_pair(a[even + p, c:stop], a[odd + p, c:stop], unused, unused[LANES:], delayed, taps, scale)
        for i in range(0, pairs - 1, 2):
            p, q = i * stride, (i + 1) * stride
            _two_pairs(
                a[even + p, c:stop], a[odd + p, c:stop], a[even + q, c:stop], a[odd + q, c:stop], delayed, taps, scale
            )
        if pairs % 2:
            p = (pairs - 1) * stride
            e, o = a[even + p, c:stop], a[odd + p, c:stop]
            _one_pair(e, o, unused, unused[LANES:], delayed, taps, scale)
            e[:] = unused[: stop - c]
            o[:] = unused[LANES : LANES + stop - c]


@njit(cache=True, nogil=True)
def analyse_lanes(lanes, n, taps, scale):
    """Lattice along the first axis of lanes[0 … n−1]; afterwards lanes[7 + 2p] is low and lanes[8 + 2p] high."""
    for i in range(8):
        copy(lanes[i % n], lanes[n + i], lanes.shape[1])
    lattice(lanes, 7, 8, 2, n // 2, lanes.shape[1], taps, scale)


@njit(cache=True, nogil=True)
def synthesise_lanes(lanes, n, taps, scale):
    """Inverse (and transpose) of `analyse_lanes`; `taps` are the reversed ones."""
    lattice(lanes, 5 + n, 6 + n, -2, n // 2, lanes.shape[1], taps, scale)
    for i in range(6, -1, -1):
        copy(lanes[n + i], lanes[i], lanes.shape[1])


@njit(cache=True, nogil=True)
def rows_to_lanes(rows, first, n, lanes, lane):
    """lanes[x, lane + r] = rows[first + r, x] for r < 8, x < n; both have room up to a multiple of 8."""
    pitch, width = rows.shape[1], lanes.shape[1]
    for x in range(0, n, 8):
        _transpose8(rows, first * pitch + x, pitch, lanes, x * width + lane, width)


@njit(cache=True, nogil=True)
def lanes_to_rows(lanes, lane, n, rows, first):
    """Inverse of `rows_to_lanes`."""
    pitch, width = rows.shape[1], lanes.shape[1]
    for x in range(0, n, 8):
        _transpose8(lanes, x * width + lane, width, rows, first * pitch + x, pitch)


@njit(cache=True, nogil=True)
def lanes_to_halves(lanes, lane, half, rows):
    """rows[r, p] = low, rows[r, half + p] = high of lane + r, for r < 8 and p < half; rows have 8 columns to spare."""
    pitch, width = rows.shape[1], lanes.shape[1]
    for side in range(2):
        for p in range(0, half, 8):
            _transpose8(lanes, (7 + 2 * p + side) * width + lane, 2 * width, rows, side * half + p, pitch)


@njit(cache=True, nogil=True)
def halves_to_lanes(rows, half, lanes, lane):
    """Inverse of `lanes_to_halves`."""
    pitch, width = rows.shape[1], lanes.shape[1]
    for side in range(2):
        for p in range(0, half, 8):
            _transpose8(rows, side * half + p, pitch, lanes, (7 + 2 * p + side) * width + lane, 2 * width)


@njit(cache=True, nogil=True)
def lane_rows(n):
    """Rows that an array of lanes needs for n samples: the periodic continuation, and whole blocks of 8 pairs."""
    return 16 * ((n // 2 + 7) // 8) + 8


@njit(cache=True, nogil=True)
def row_pitch(n):
    """Length of scratch rows for n samples: 7 or more to spare, and an odd multiple of 8, which spreads rows over the cache."""
    return (n + 15) // 16 * 16 + 8


@njit(cache=True, nogil=True)
def analyse_planes(start, stop, planes, levels, taps, scale):
    """Finish the transform of planes whose first level along x is done, with rows in split order."""
    _, ny, nx = planes.shape
    ny, nx = ny // 2, nx // 2
    saved = np.zeros((ny + 7, row_pitch(nx)), planes.dtype)
    lanes = np.zeros((lane_rows(nx), min(128, (ny + 7) // 8 * 8)), planes.dtype)
    rows = np.zeros((8, row_pitch(nx)), planes.dtype)
    for b in range(start, stop):
        plane = planes[b]
        lattice(plane, 0, ny, 1, ny, 2 * nx, taps, scale)
        my, mx = ny, nx
        for _ in range(1, levels):
            for r in range(my):
                copy(plane[split_row(r, my)], saved[r], mx)
            for first in range(0, my, lanes.shape[1]):
                size = min(lanes.shape[1], my - first)
                for r in range(0, size, 8):
                    rows_to_lanes(saved, first + r, mx, lanes, r)
                analyse_lanes(lanes, mx, taps, scale)
                for r in range(0, size, 8):
                    lanes_to_halves(lanes, r, mx // 2, rows)
                    for i in range(min(8, size - r)):
                        copy(rows[i], plane[first + r + i], mx)
            lattice(plane, 0, my // 2, 1, my // 2, mx, taps, scale)
            my, mx = my // 2, mx // 2


@njit(cache=True, nogil=True)
def synthesise_planes(start, stop, source, planes, levels, taps, scale):
    """Inverse of `analyse_planes`, from `source` into `planes`, rows in natural order; `taps` are the reversed ones."""
    _, ny, nx = planes.shape
    plane = np.empty((ny, nx), planes.dtype)
    saved = np.zeros((ny // 2 + 7, row_pitch(nx // 2)), planes.dtype)
    lanes = np.zeros((lane_rows(nx // 2), min(128, (ny // 2 + 7) // 8 * 8)), planes.dtype)
    rows = np.zeros((8, row_pitch(nx // 2)), planes.dtype)
    for b in range(start, stop):
        for r in range(ny):
            copy(source[b, r], plane[r], nx)
        for level in range(levels - 1, 0, -1):
            my, mx = ny >> level, nx >> level
            lattice(plane, my // 2 - 1, my - 1, -1, my // 2, mx, taps, scale)
            for first in range(0, my, lanes.shape[1]):
                size = min(lanes.shape[1], my - first)
                for r in range(0, size, 8):
                    for i in range(min(8, size - r)):
                        copy(plane[first + r + i], rows[i], mx)
                    halves_to_lanes(rows, mx // 2, lanes, r)
                synthesise_lanes(lanes, mx, taps, scale)
                for r in range(0, size, 8):
                    lanes_to_rows(lanes, r, mx, saved, first + r)
            for r in range(my):
                copy(saved[r], plane[split_row(r, my)], mx)
        lattice(plane, ny // 2 - 1, ny - 1, -1, ny // 2, nx, taps, scale)
        for r in range(ny):
            copy(plane[r], planes[b, split_row(r, ny)], nx)
