"""Kernels of the CASSI family, on a range of rows y: one row of every band at a time, so that all sums stay in cache."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def _load_code_rows(code, y, rows):
    """rows[q] = code[q, y] in the dtype of `rows`."""
    for q in range(rows.shape[0]):
        for u in range(rows.shape[1]):
            rows[q, u] = code[q, y, u]


@njit(cache=True, nogil=True, fastmath={"contract"})
def _multiply_add(a, b, total):
    for i in range(total.size):
        total[i] += total.dtype.type(a[i]) * b[i]


@njit(cache=True, nogil=True, fastmath={"contract"})
def _multiply(a, b, product):
    for i in range(product.size):
        product[i] = product.dtype.type(a[i]) * b[i]


@njit(cache=True, nogil=True)
def shift_forward(start, stop, x, code, code_shift, out_shift, out):
    """g[q, y, x + k·out_shift] = Σ_k t[q, y, x + k·code_shift] f[k, y, x]."""
    bands, _, nx = x.shape
    shots = code.shape[0]
    t = np.empty((shots, code.shape[2]), x.dtype)
    for y in range(start, stop):
        _load_code_rows(code, y, t)
        out[:, y] = 0
        for k in range(bands):
            u, v = k * code_shift, k * out_shift
            for q in range(shots):
                _multiply_add(t[q, u : u + nx], x[k, y], out[q, y, v : v + nx])


@njit(cache=True, nogil=True)
def shift_adjoint(start, stop, g, code, code_shift, out_shift, out):
    """f[k, y, x] = Σ_q t[q, y, x + k·code_shift] g[q, y, x + k·out_shift]."""
    bands, _, nx = out.shape
    shots = code.shape[0]
    t = np.empty((shots, code.shape[2]), g.dtype)
    for y in range(start, stop):
        _load_code_rows(code, y, t)
        for k in range(bands):
            u, v = k * code_shift, k * out_shift
            _multiply(t[0, u : u + nx], g[0, y, v : v + nx], out[k, y])
            for q in range(1, shots):
                _multiply_add(t[q, u : u + nx], g[q, y, v : v + nx], out[k, y])


@njit(cache=True, nogil=True)
def colored_forward(start, stop, x, code, out_shift, out):
    """g[q, y, x + k·out_shift] = Σ_k t[q, k, y, x] f[k, y, x]."""
    shots, bands, _, nx = code.shape
    for y in range(start, stop):
        out[:, y] = 0
        for k in range(bands):
            v = k * out_shift
            for q in range(shots):
                _multiply_add(code[q, k, y], x[k, y], out[q, y, v : v + nx])


@njit(cache=True, nogil=True)
def colored_adjoint(start, stop, g, code, out_shift, out):
    """f[k, y, x] = Σ_q t[q, k, y, x] g[q, y, x + k·out_shift]."""
    shots, bands, _, nx = code.shape
    for y in range(start, stop):
        for k in range(bands):
            v = k * out_shift
            _multiply(code[0, k, y], g[0, y, v : v + nx], out[k, y])
            for q in range(1, shots):
                _multiply_add(code[q, k, y], g[q, y, v : v + nx], out[k, y])
