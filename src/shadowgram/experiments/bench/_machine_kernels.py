"""Kernels that run into the machine's limits: memory bandwidth, and fused multiply-adds."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def copy(a, b):
    for i in range(a.size):
        b[i] = a[i]


@njit(cache=True, nogil=True, fastmath={"contract"})
def triad(a, b, c):
    """Sum a + ½b into c."""
    for i in range(a.size):
        c[i] = a[i] + np.float32(0.5) * b[i]


@njit(fastmath={"contract"}, inline="always")
def _step(z, v, w):
    a, b, c, d, e, f, g, h, p, q = z
    return (a * v + w, b * v + w, c * v + w, d * v + w, e * v + w,
            f * v + w, g * v + w, h * v + w, p * v + w, q * v + w)  # fmt: skip


@njit(fastmath={"contract"}, inline="always")
def _four_steps(z, v, w):
    return _step(_step(_step(_step(z, v, w), v, w), v, w), v, w)


CHAINS, STEPS = 10, 32
FLOPS = CHAINS * STEPS * 2 + 2 * (
    CHAINS - 1
)  # for each element and repetition, with the start and the sum of the chains


# Not cached: the assembly of a kernel from the cache cannot be read.
@njit(nogil=True, fastmath={"contract"})
def multiply_add(repetitions, x, out):
    """Ten independent chains an element: more than the latency of a multiply-add times the two that a core issues a cycle.

    The chains differ, or the compiler would merge them; written out, it keeps them in registers, one vector of elements each.
    """
    w = np.float32(0.5)
    for _ in range(repetitions):
        for i in range(x.size):
            v = x[i]
            z = (v, v + np.float32(1), v + np.float32(2), v + np.float32(3), v + np.float32(4),
                 v + np.float32(5), v + np.float32(6), v + np.float32(7), v + np.float32(8), v + np.float32(9))  # fmt: skip
            z = _four_steps(_four_steps(_four_steps(_four_steps(z, v, w), v, w), v, w), v, w)
            z = _four_steps(_four_steps(_four_steps(_four_steps(z, v, w), v, w), v, w), v, w)
            a, b, c, d, e, f, g, h, p, q = z
            out[i] = (a + b + c + d + e) + (f + g + h + p + q)
