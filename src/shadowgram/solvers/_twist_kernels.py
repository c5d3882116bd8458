"""Kernel of TwIST; chunks and blocks as in `_sparse_kernels`."""

from numba import njit

from ._sparse_kernels import BLOCK, CHUNK, FAST


@njit(cache=True, nogil=True, fastmath=FAST)
def _block(theta, before, g, step, threshold, past, here, there):
    one, zero = theta.dtype.type(1), theta.dtype.type(0)
    size_one, count_one, size_two, count_two = zero, zero, zero, zero
    for i in range(theta.size):
        v = theta[i] - step * g[i]
        s = max(v - threshold, zero) - max(-v - threshold, zero)
        t = past * before[i] + here * theta[i] + there * s
        g[i] = s
        before[i] = t
        size_one += abs(s)
        count_one += one if s != zero else zero
        size_two += abs(t)
        count_two += one if t != zero else zero
    return size_one, count_one, size_two, count_two


@njit(cache=True, nogil=True)
def twist_step(start, stop, theta, before, g, step, threshold, past, here, there, sums):
    """g ← soft(θ − step·g, threshold), the one-step point; before ← past·before + here·θ + there·g, the two-step point.

    sums: ‖·‖₁ and non-zeros of the one-step point, then of the two-step point.
    """
    for c in range(start, stop):
        for b in range(c * CHUNK, min((c + 1) * CHUNK, theta.size), BLOCK):
            part = slice(b, b + BLOCK)
            sizes = _block(theta[part], before[part], g[part], step, threshold, past, here, there)
            for s in range(4):
                sums[c, s] += sizes[s]
