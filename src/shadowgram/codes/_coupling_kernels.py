"""Kernels of the fields that couple the elements of a code: a stencil around every open element, and around every meeting pair.

The coupling is Σ_d gains[d] Σ K(Δ) S_d(y, x) S_d(y', x') over unordered pairs of places Δ apart, S_d(y, x) being 1 where the
elements x and x + d of row y are open in the same shot.
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def spread_out(field, y, x, stencil, sign, wrap):
    """Add `sign` times the stencil, centred on (y, x), to the field (y, x); cut at its edges or wrapped around them."""
    ny, nx = field.shape
    half = stencil.shape[0] // 2
    for dy in range(-half, half + 1):
        yy = y + dy
        if wrap:
            yy %= ny
        elif yy < 0 or yy >= ny:
            continue
        weights, row = stencil[dy + half], field[yy]
        if wrap:
            for dx in range(-half, half + 1):
                row[(x + dx) % nx] += sign * weights[dx + half]
        else:
            low, high = max(0, x - half), min(nx, x + half + 1)
            offset = low - x + half
            for i in range(high - low):
                row[low + i] += sign * weights[offset + i]


@njit(cache=True, nogil=True)
def fill_repulsion(field, stencil, code, wrap):
    """Field (shot, y, x) of a code (shot, y, x) of any number of open shots."""
    for shot in range(field.shape[0]):
        for y in range(field.shape[1]):
            for x in range(field.shape[2]):
                if code[shot, y, x]:
                    spread_out(field[shot], y, x, stencil, 1.0, wrap)


@njit(nogil=True)
def add_coupling(field, kernel, gains, row, y, x, at, wrap, scores):
    """Add to scores[q] what the pairs of element x of row y, at `at` in `row`, cost with those around, if it is open in shot q."""
    half, nx, old = kernel.shape[0] // 2, field.shape[2], row[at]
    for distance in range(1, gains.size):
        right, left = row[at + distance], row[at - distance]
        # The pairs to the right and to the left begin `distance` apart in one row: each is in the field of the other.
        apart = min(distance, nx - distance) if wrap else distance
        near = kernel[half, half + apart] if apart <= half else 0.0
        if right >= 0:
            around = field[y, distance, x] - near * np.float64(left == old)
            scores[right] += gains[distance] * around
        if left >= 0:
            around = field[y, distance, (x - distance) % nx] - near * np.float64(right == old)
            scores[left] += gains[distance] * around
            if left == right:
                scores[left] += gains[distance] * near


@njit(nogil=True)
def move_pairs(field, kernel, row, y, x, at, old, new, wrap):
    """Take the pairs that element x makes in shot `old` out of the field and put those of shot `new` in."""
    nx = field.shape[2]
    for distance in range(1, field.shape[1]):
        for side in range(2):
            other = row[at + distance] if side == 0 else row[at - distance]
            begin = x if side == 0 else (x - distance) % nx
            if other == old:
                spread_out(field[:, distance], y, begin, kernel, -1.0, wrap)
            elif other == new:
                spread_out(field[:, distance], y, begin, kernel, 1.0, wrap)


@njit(cache=True, nogil=True)
def fill_coupling(field, kernel, labels, offset, wrap):
    """Field of a whole code."""
    for y in range(field.shape[0]):
        for x in range(field.shape[2]):
            for distance in range(1, field.shape[1]):
                if labels[y, x + offset] == labels[y, x + offset + distance]:
                    spread_out(field[:, distance], y, x, kernel, 1.0, wrap)


@njit(cache=True, nogil=True)
def coupling_cost(field, gains, labels, offset):
    """Coupling of a whole code."""
    total = 0.0
    for y in range(field.shape[0]):
        for distance in range(1, field.shape[1]):
            for x in range(field.shape[2]):
                if labels[y, x + offset] == labels[y, x + offset + distance]:
                    total += 0.5 * gains[distance] * field[y, distance, x]
    return total
