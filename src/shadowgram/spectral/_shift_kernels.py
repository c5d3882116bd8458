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
