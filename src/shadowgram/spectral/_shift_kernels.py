"""Kernels of the CASSI family, on a range of rows y: one row of every band at a time, so that all sums stay in cache."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def _load_code_rows(code, y, rows):
    """rows[q] = code[q, y] in the dtype of `rows`."""
    for q in range(rows.shape[0]):
        for u in range(rows.shape[1]):
            rows[q, u] = code[q, y, u]


# Rows are indexed in place, with unsigned offsets: an array view costs atomic reference counts, and an index that may be negative
# keeps a loop scalar.


@njit(cache=True, nogil=True, fastmath={"contract"})
def shift_forward(start, stop, x, code, code_shift, out_shift, out):
    """g[q, y, x + k·out_shift] = Σ_k t[q, y, x + k·code_shift] f[k, y, x]."""
    bands, _, nx = x.shape
    shots = code.shape[0]
    t = np.empty((shots, code.shape[2]), x.dtype)
    for y in range(start, stop):
        _load_code_rows(code, y, t)
        out[:, y] = 0
        for k in range(bands):
            u, v = np.uintp(k * code_shift), np.uintp(k * out_shift)
            for q in range(shots):
                for i in range(nx):
                    out[q, y, v + np.uintp(i)] += t[q, u + np.uintp(i)] * x[k, y, i]


@njit(cache=True, nogil=True, fastmath={"contract"})
def shift_adjoint(start, stop, g, code, code_shift, out_shift, out):
    """f[k, y, x] = Σ_q t[q, y, x + k·code_shift] g[q, y, x + k·out_shift]."""
    bands, _, nx = out.shape
    shots = code.shape[0]
    t = np.empty((shots, code.shape[2]), g.dtype)
    for y in range(start, stop):
        _load_code_rows(code, y, t)
        for k in range(bands):
            u, v = np.uintp(k * code_shift), np.uintp(k * out_shift)
            for i in range(nx):
                out[k, y, i] = t[0, u + np.uintp(i)] * g[0, y, v + np.uintp(i)]
            for q in range(1, shots):
                for i in range(nx):
                    out[k, y, i] += t[q, u + np.uintp(i)] * g[q, y, v + np.uintp(i)]


@njit(cache=True, nogil=True, fastmath={"contract"})
def colored_forward(start, stop, x, code, out_shift, out):
    """g[q, y, x + k·out_shift] = Σ_k t[q, k, y, x] f[k, y, x]."""
    shots, bands, _, nx = code.shape
    for y in range(start, stop):
        out[:, y] = 0
        for k in range(bands):
            v = np.uintp(k * out_shift)
            for q in range(shots):
                for i in range(nx):
                    out[q, y, v + np.uintp(i)] += out.dtype.type(code[q, k, y, i]) * x[k, y, i]


@njit(cache=True, nogil=True, fastmath={"contract"})
def colored_adjoint(start, stop, g, code, out_shift, out):
    """f[k, y, x] = Σ_q t[q, k, y, x] g[q, y, x + k·out_shift]."""
    shots, bands, _, nx = code.shape
    for y in range(start, stop):
        for k in range(bands):
            v = np.uintp(k * out_shift)
            for i in range(nx):
                out[k, y, i] = out.dtype.type(code[0, k, y, i]) * g[0, y, v + np.uintp(i)]
            for q in range(1, shots):
                for i in range(nx):
                    out[k, y, i] += out.dtype.type(code[q, k, y, i]) * g[q, y, v + np.uintp(i)]


# Footprints of several pixels. A row has spare columns on both sides, `margin` of them on the left, and `place[k]` is where band k
# begins in it; the reach[k] weights of a band come in threes, so that a row is read and written once for three of them.


@njit(cache=True, nogil=True, fastmath={"contract"})
def dispersed_forward(start, stop, x, code, place, weights, reach, margin, width, out):
    """g[q, y, x + place[k] − margin + j] = Σ_k Σ_j weights[k, j] t[q, k, y, x] f[k, y, x], or t[q, 0, y, x] if it has one band."""
    bands, _, nx = x.shape
    shots, code_bands = code.shape[:2]
    wide = np.empty((shots, width), x.dtype)
    coded = np.zeros(nx + 4, x.dtype)
    for y in range(start, stop):
        wide[:] = 0
        for k in range(bands):
            b = min(k, code_bands - 1)
            for q in range(shots):
                for i in range(nx):
                    coded[np.uintp(i) + np.uintp(2)] = x.dtype.type(code[q, b, y, i]) * x[k, y, i]
                for j in range(0, reach[k], 3):
                    u, v, w = weights[k, j], weights[k, j + 1], weights[k, j + 2]
                    p = np.uintp(place[k] + j)
                    for m in range(nx + 2):
                        i = np.uintp(m)
                        wide[q, p + i] += u * coded[i + np.uintp(2)] + v * coded[i + np.uintp(1)] + w * coded[i]
        for q in range(shots):
            for i in range(out.shape[2]):
                out[q, y, i] = wide[q, np.uintp(margin) + np.uintp(i)]


@njit(cache=True, nogil=True, fastmath={"contract"})
def dispersed_adjoint(start, stop, g, code, place, weights, reach, margin, width, out):
    """f[k, y, x] = Σ_q t[q, k, y, x] Σ_j weights[k, j] g[q, y, x + place[k] − margin + j], or t[q, 0, y, x] if it has one band."""
    bands, _, nx = out.shape
    shots, code_bands = code.shape[:2]
    wide = np.zeros((shots, width), g.dtype)
    for y in range(start, stop):
        for q in range(shots):
            for i in range(g.shape[2]):
                wide[q, np.uintp(margin) + np.uintp(i)] = g[q, y, i]
        for k in range(bands):
            b = min(k, code_bands - 1)
            out[k, y] = 0
            for q in range(shots):
                for j in range(0, reach[k], 3):
                    u, v, w = weights[k, j], weights[k, j + 1], weights[k, j + 2]
                    p = np.uintp(place[k] + j)
                    for i in range(nx):
                        a = p + np.uintp(i)
                        gathered = u * wide[q, a] + v * wide[q, a + np.uintp(1)] + w * wide[q, a + np.uintp(2)]
                        out[k, y, i] += out.dtype.type(code[q, b, y, i]) * gathered


@njit(cache=True, nogil=True, fastmath={"contract"})
def smeared_forward(start, stop, x, code, place, weights, reach, margin, width, out):
    """g[q, y, x] = Σ_k Σ_j weights[k, j] t[q, y, x + place[k] − margin + j] f[k, y, x]."""
    bands, _, nx = x.shape
    shots = code.shape[0]
    t = np.zeros((shots, width), x.dtype)
    for y in range(start, stop):
        _load_code_rows(code, y, t[:, margin : margin + code.shape[2]])
        out[:, y] = 0
        for k in range(bands):
            for q in range(shots):
                for j in range(0, reach[k], 3):
                    u, v, w = weights[k, j], weights[k, j + 1], weights[k, j + 2]
                    p = np.uintp(place[k] + j)
                    for i in range(nx):
                        a = p + np.uintp(i)
                        seen = u * t[q, a] + v * t[q, a + np.uintp(1)] + w * t[q, a + np.uintp(2)]
                        out[q, y, i] += seen * x[k, y, i]


@njit(cache=True, nogil=True, fastmath={"contract"})
def smeared_adjoint(start, stop, g, code, place, weights, reach, margin, width, out):
    """f[k, y, x] = Σ_q Σ_j weights[k, j] t[q, y, x + place[k] − margin + j] g[q, y, x]."""
    bands, _, nx = out.shape
    shots = code.shape[0]
    t = np.zeros((shots, width), g.dtype)
    for y in range(start, stop):
        _load_code_rows(code, y, t[:, margin : margin + code.shape[2]])
        for k in range(bands):
            out[k, y] = 0
            for q in range(shots):
                for j in range(0, reach[k], 3):
                    u, v, w = weights[k, j], weights[k, j + 1], weights[k, j + 2]
                    p = np.uintp(place[k] + j)
                    for i in range(nx):
                        a = p + np.uintp(i)
                        seen = u * t[q, a] + v * t[q, a + np.uintp(1)] + w * t[q, a + np.uintp(2)]
                        out[k, y, i] += seen * g[q, y, i]
