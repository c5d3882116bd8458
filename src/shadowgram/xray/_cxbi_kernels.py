"""Kernels of the sliding-mask and code-list operators; every element of the result is summed by one thread in one order.

The strip comes in phases, P[p, m] = T[i, r·m + ρ] with p = (i, ρ), so that a step of r columns a shot becomes one of 1: shots are
then neighbours in memory. Loops over four elements at once save loads and stores of the sums.
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, fastmath={"contract"})
def slide_forward(start, stop, strip, image, out):
    """y[q] = Σ_p Σ_m P[p, q + m] F[p, m], for shots from start to stop."""
    phases, width = image.shape
    out[start:stop] = 0
    a, shots = np.uintp(start), np.uintp(stop - start)
    for p in range(phases):
        m = 0
        while m + 4 <= width:
            f0, f1, f2, f3 = image[p, m], image[p, m + 1], image[p, m + 2], image[p, m + 3]
            c = a + np.uintp(m)
            for q in range(shots):
                k = c + np.uintp(q)
                out[a + np.uintp(q)] += (strip[p, k] * f0 + strip[p, k + np.uintp(1)] * f1) + (
                    strip[p, k + np.uintp(2)] * f2 + strip[p, k + np.uintp(3)] * f3
                )
            m += 4
        for n in range(m, width):
            f0, c = image[p, n], a + np.uintp(n)
            for q in range(shots):
                out[a + np.uintp(q)] += strip[p, c + np.uintp(q)] * f0


@njit(cache=True, nogil=True, fastmath={"contract"})
def slide_adjoint(start, stop, strip, y, out):
    """F[p, m] = Σ_q P[p, q + m] y[q], for phases from start to stop."""
    width, shots = np.uintp(out.shape[1]), y.shape[0]
    for p in range(start, stop):
        for m in range(width):
            out[p, np.uintp(m)] = 0
        q = 0
        while q + 4 <= shots:
            y0, y1, y2, y3 = y[q], y[q + 1], y[q + 2], y[q + 3]
            c = np.uintp(q)
            for m in range(width):
                k = c + np.uintp(m)
                out[p, np.uintp(m)] += (strip[p, k] * y0 + strip[p, k + np.uintp(1)] * y1) + (
                    strip[p, k + np.uintp(2)] * y2 + strip[p, k + np.uintp(3)] * y3
                )
            q += 4
        for n in range(q, shots):
            y0, c = y[n], np.uintp(n)
            for m in range(width):
                out[p, np.uintp(m)] += strip[p, c + np.uintp(m)] * y0


@njit(cache=True, nogil=True, fastmath={"contract"})
def correlate_spectra(start, stop, strip, image, out):
    """Ŷ[s, w] = Σ_p P̂[s, p, w] F̂*[p, w], for blocks of shots from start to stop; all complex."""
    phases, frequencies = image.shape
    for s in range(start, stop):
        out[s] = 0
        for p in range(phases):
            for w in range(frequencies):
                out[s, w] += strip[s, p, w] * image[p, w].conjugate()


@njit(cache=True, nogil=True, fastmath={"contract"})
def back_spectra(start, stop, strip, y, out):
    """F̂[p, w] = Σ_s P̂[s, p, w] Ŷ*[s, w], for phases from start to stop; all complex."""
    blocks, frequencies = y.shape
    for p in range(start, stop):
        out[p] = 0
        for s in range(blocks):
            for w in range(frequencies):
                out[p, w] += strip[s, p, w] * y[s, w].conjugate()


@njit(cache=True, nogil=True, fastmath={"contract"})
def list_forward(start, stop, codes, image, out):
    """y[q] = Σ_n C[q, n] F[n], for shots from start to stop; sums of eight lanes."""
    cells = codes.shape[1]
    lanes = np.empty(8, image.dtype)
    for q in range(start, stop):
        lanes[:] = 0
        n = 0
        while n + 8 <= cells:
            for lane in range(np.uintp(8)):
                k = np.uintp(n) + np.uintp(lane)
                lanes[np.uintp(lane)] += codes[q, k] * image[k]
            n += 8
        for k in range(n, cells):
            lanes[0] += codes[q, k] * image[k]
        out[q] = lanes.sum()


@njit(cache=True, nogil=True, fastmath={"contract"})
def list_adjoint(start, stop, codes, y, out):
    """F[n] = Σ_q C[q, n] y[q], for cells from start to stop."""
    a, cells = np.uintp(start), np.uintp(stop - start)
    out[start:stop] = 0
    for q in range(codes.shape[0]):
        value = y[q]
        for n in range(cells):
            out[a + np.uintp(n)] += codes[q, a + np.uintp(n)] * value
