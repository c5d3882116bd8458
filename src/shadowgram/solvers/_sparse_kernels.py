"""Kernels of the sparse solvers: every pass over the coefficients updates them and takes all sums that the iteration needs.

Arrays come flat and are cut into chunks of `CHUNK` values, each with its own row of float64 sums, so that results do not depend on
how the chunks are shared among threads. Within a chunk, `BLOCK` values are summed in the arrays' own precision: half the time of
float64 throughout, and the sums agree to 1e-8.
"""

from numba import njit

CHUNK = 16384
BLOCK = 512
FAST = {"contract", "reassoc", "nsz"}  # sums may be taken in any order; NaN and infinity keep their meaning


@njit(cache=True, nogil=True, fastmath=FAST)
def _gpsr_block(theta, d, g, taken, tau, alpha):
    one, zero = theta.dtype.type(1), theta.dtype.type(0)
    magnitude, slope, square, nonzeros = zero, zero, zero, zero
    for i in range(theta.size):
        t = theta[i] + taken * d[i]
        u, v = max(t, zero), max(-t, zero)
        gu, gv = tau + g[i], tau - g[i]
        du, dv = max(u - alpha * gu, zero) - u, max(v - alpha * gv, zero) - v
        theta[i] = t
        d[i] = du - dv
        magnitude += u + v
        slope += du * gu + dv * gv
        square += du * du + dv * dv
        nonzeros += one if t != zero else zero
    return magnitude, slope, square, nonzeros


@njit(cache=True, nogil=True)
def gpsr_step(start, stop, theta, d, g, taken, tau, alpha, sums):
    """Finish one GPSR step and find the direction of the next.

    θ ← θ + taken·d, split as u = θ₊, v = θ₋ (their common part is gone); gradients τ ± g;
    δu = (u − α∇u)₊ − u and δv alike; d ← δu − δv. sums: ‖θ‖₁, δᵀ∇F, δᵀδ, non-zeros of θ.
    """
    for c in range(start, stop):
        for b in range(c * CHUNK, min((c + 1) * CHUNK, theta.size), BLOCK):
            parts = _gpsr_block(theta[b : b + BLOCK], d[b : b + BLOCK], g[b : b + BLOCK], taken, tau, alpha)
            for s in range(4):
                sums[c, s] += parts[s]


@njit(cache=True, nogil=True, fastmath=FAST)
def _fista_block(theta, before, g, momentum, step, threshold):
    one, zero = theta.dtype.type(1), theta.dtype.type(0)
    magnitude, nonzeros = zero, zero
    for i in range(theta.size):
        v = theta[i] + momentum * (theta[i] - before[i]) - step * g[i]
        t = max(v - threshold, zero) - max(-v - threshold, zero)
        before[i] = t
        magnitude += abs(t)
        nonzeros += one if t != zero else zero
    return magnitude, nonzeros


@njit(cache=True, nogil=True)
def fista_step(start, stop, theta, before, g, momentum, step, threshold, sums):
    """before ← soft(z − step·g, threshold) with z = θ + momentum (θ − before). sums: ‖·‖₁ and non-zeros of the new point."""
    for c in range(start, stop):
        for b in range(c * CHUNK, min((c + 1) * CHUNK, theta.size), BLOCK):
            parts = _fista_block(
                theta[b : b + BLOCK], before[b : b + BLOCK], g[b : b + BLOCK], momentum, step, threshold
            )
            sums[c, 0] += parts[0]
            sums[c, 1] += parts[1]


@njit(cache=True, nogil=True, fastmath=FAST)
def _add_block(a, b, factor):
    total = a.dtype.type(0)
    for i in range(a.size):
        s = a[i] + factor * b[i]
        a[i] = s
        total += s * s
    return total


@njit(cache=True, nogil=True)
def add_scaled(start, stop, a, b, factor, sums):
    """a ← a + factor·b; sums: ‖a‖²."""
    for c in range(start, stop):
        for i in range(c * CHUNK, min((c + 1) * CHUNK, a.size), BLOCK):
            sums[c, 0] += _add_block(a[i : i + BLOCK], b[i : i + BLOCK], factor)


@njit(cache=True, nogil=True, fastmath=FAST)
def _square_block(a):
    total = a.dtype.type(0)
    for i in range(a.size):
        total += a[i] * a[i]
    return total


@njit(cache=True, nogil=True)
def square_sums(start, stop, a, sums):
    """sums: ‖a‖²."""
    for c in range(start, stop):
        for b in range(c * CHUNK, min((c + 1) * CHUNK, a.size), BLOCK):
            sums[c, 0] += _square_block(a[b : b + BLOCK])


@njit(cache=True, nogil=True, fastmath=FAST)
def _support_block(theta, g):
    total, zero = theta.dtype.type(0), theta.dtype.type(0)
    for i in range(g.size):
        value = g[i] if theta[i] != zero else zero
        total += value * value
    return total


@njit(cache=True, nogil=True)
def support_square(start, stop, theta, g, sums):
    """sums: ‖g‖² where θ is not zero."""
    for c in range(start, stop):
        for b in range(c * CHUNK, min((c + 1) * CHUNK, theta.size), BLOCK):
            sums[c, 0] += _support_block(theta[b : b + BLOCK], g[b : b + BLOCK])


@njit(cache=True, nogil=True, fastmath=FAST)
def _conjugate_chunk(theta, g, p, turn):
    zero = theta.dtype.type(0)
    for i in range(theta.size):
        p[i] = turn * p[i] - g[i] if theta[i] != zero else zero


@njit(cache=True, nogil=True)
def conjugate_direction(start, stop, theta, g, p, turn):
    """p ← turn·p − g where θ is not zero, else 0: the next direction of conjugate gradients on the support."""
    for c in range(start, stop):
        part = slice(c * CHUNK, min((c + 1) * CHUNK, theta.size))
        _conjugate_chunk(theta[part], g[part], p[part], turn)
