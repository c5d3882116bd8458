"""Kernels of EigenTV, on a range of rows (y). Letters: L bands, Q shots, V eigenbasis; the other names are those of `eigen_tv`."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, fastmath={"contract"})
def _mix(matrix, rows, out, i):
    """out[m, i] = Σ_k matrix[m, k] rows[k], four bands by four at a time, which halves the traffic."""
    outputs, inputs = matrix.shape
    for m in range(0, outputs - 3, 4):
        c0, c1, c2, c3 = out[m, i], out[m + 1, i], out[m + 2, i], out[m + 3, i]
        c0[:] = 0
        c1[:] = 0
        c2[:] = 0
        c3[:] = 0
        for k in range(0, inputs - 3, 4):
            b0, b1, b2, b3 = rows[k], rows[k + 1], rows[k + 2], rows[k + 3]
            p0, p1, p2, p3 = matrix[m, k], matrix[m, k + 1], matrix[m, k + 2], matrix[m, k + 3]
            q0, q1, q2, q3 = matrix[m + 1, k], matrix[m + 1, k + 1], matrix[m + 1, k + 2], matrix[m + 1, k + 3]
            r0, r1, r2, r3 = matrix[m + 2, k], matrix[m + 2, k + 1], matrix[m + 2, k + 2], matrix[m + 2, k + 3]
            s0, s1, s2, s3 = matrix[m + 3, k], matrix[m + 3, k + 1], matrix[m + 3, k + 2], matrix[m + 3, k + 3]
            for j in range(c0.size):
                c0[j] += p0 * b0[j] + p1 * b1[j] + p2 * b2[j] + p3 * b3[j]
                c1[j] += q0 * b0[j] + q1 * b1[j] + q2 * b2[j] + q3 * b3[j]
                c2[j] += r0 * b0[j] + r1 * b1[j] + r2 * b2[j] + r3 * b3[j]
                c3[j] += s0 * b0[j] + s1 * b1[j] + s2 * b2[j] + s3 * b3[j]
        for k in range(inputs - inputs % 4, inputs):
            b = rows[k]
            p, q, r, s = matrix[m, k], matrix[m + 1, k], matrix[m + 2, k], matrix[m + 3, k]
            for j in range(c0.size):
                c0[j] += p * b[j]
                c1[j] += q * b[j]
                c2[j] += r * b[j]
                c3[j] += s * b[j]
    for m in range(outputs - outputs % 4, outputs):
        c = out[m, i]
        c[:] = 0
        for k in range(inputs):
            b, w = rows[k], matrix[m, k]
            for j in range(c.size):
                c[j] += w * b[j]


@njit(cache=True, nogil=True, fastmath={"contract"})
def _relax(z, correction, relaxation, a, held):
    for j in range(held.size):
        held[j] = a[j] + relaxation * (z[j] - a[j] - correction[j])
        a[j] = held[j]


@njit(cache=True, nogil=True)
def to_eigen(start, stop, basis, z, correction, relaxation, a, c):
    """A += relaxation (z − a − correction), which is the relaxed x + u; c ← basis a."""
    rows = np.empty((z.shape[0], z.shape[2]), z.dtype)
    for i in range(start, stop):
        for k in range(z.shape[0]):
            _relax(z[k, i], correction[k, i], relaxation, a[k, i], rows[k])
        _mix(basis, rows, c, i)


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def _store_row(new, least, z, a, reflected):
    """Set z to max(new, least) and reflected to 2z − a; return Σ(change of z)² and Σz²."""
    change, size = new.dtype.type(0), new.dtype.type(0)
    for j in range(new.size):
        value = max(new[j], least)
        step = value - z[j]
        change += step * step
        size += value * value
        z[j] = value
        reflected[j] = 2 * value - a[j]
    return change, size


@njit(cache=True, nogil=True)
def from_eigen(start, stop, inverse, c, a, least, z, sums):
    """Z ← max(inverse c, least), c ← 2z − a; sums[i] ← (Σ(change of z)², Σz²) of row i."""
    rows = np.empty((c.shape[0], c.shape[2]), c.dtype)
    new = np.empty((z.shape[0], 1, z.shape[2]), z.dtype)
    for i in range(start, stop):
        for k in range(c.shape[0]):
            rows[k] = c[k, i]
        _mix(inverse, rows, new, 0)
        sums[i] = 0
        for k in range(z.shape[0]):
            change, size = _store_row(new[k, 0], least, z[k, i], a[k, i], c[k, i])
            sums[i, 0] += change
            sums[i, 1] += size


@njit(cache=True, nogil=True)
def rotate_duals(start, stop, rotation, p):
    """p[:, axis, i] ← rotation p[:, axis, i]: the duals of one eigenbasis as duals of the next."""
    rows = np.empty((p.shape[0], p.shape[3]), p.dtype)
    new = np.empty((p.shape[0], 1, p.shape[3]), p.dtype)
    for i in range(start, stop):
        for axis in range(2):
            for k in range(p.shape[0]):
                rows[k] = p[k, axis, i]
            _mix(rotation, rows, new, 0)
            for k in range(p.shape[0]):
                p[k, axis, i] = new[k, 0]


@njit(cache=True, nogil=True)
def rescale(start, stop, factor, z, a, reflected):
    """Scale u = a − z: a ← z + factor u, reflected ← z − factor u."""
    for i in range(start, stop):
        for k in range(z.shape[0]):
            zi, ai, ri = z[k, i], a[k, i], reflected[k, i]
            for j in range(zi.size):
                u = factor * (ai[j] - zi[j])
                ai[j] = zi[j] + u
                ri[j] = zi[j] - u


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def _dot(a, b):
    total = a.dtype.type(0)
    for j in range(a.size):
        total += a[j] * b[j]
    return total


@njit(cache=True, nogil=True)
def moments(start, stop, z, sums):
    """sums[i, 0] ← Σ_x z zᵀ of row i and sums[i, 1] ← Σ_x ∇z ∇zᵀ, both (L, L) in float64."""
    bands, height, width = z.shape
    along_x = np.empty((bands, width - 1), z.dtype)
    along_y = np.empty((bands, width), z.dtype)
    for i in range(start, stop):
        below = min(i + 1, height - 1)
        for k in range(bands):
            row, right, next_row = z[k, i], z[k, i, 1:], z[k, below]
            for j in range(width - 1):
                along_x[k, j] = right[j] - row[j]
            for j in range(width):
                along_y[k, j] = next_row[j] - row[j]
        for k in range(bands):
            for m in range(k + 1):
                sums[i, 0, k, m] = sums[i, 0, m, k] = _dot(z[k, i], z[m, i])
                sums[i, 1, k, m] = sums[i, 1, m, k] = _dot(along_x[k], along_x[m]) + _dot(along_y[k], along_y[m])


@njit(cache=True, nogil=True, fastmath={"contract"})
def _eliminate(target, pivot, factor):
    for j in range(target.size):
        target[j] -= factor[j] * pivot[j]


@njit(cache=True, nogil=True)
def invert_gram(start, stop, gram, mu, inverse):
    """inverse[:, :, i] ← (gram + μI)⁻¹ pixel by pixel, by Gauss-Jordan; positive definite matrices need no pivoting."""
    shots = gram.shape[0]
    for i in range(start, stop):
        work = np.empty((shots, shots, gram.shape[3]), gram.dtype)
        for q in range(shots):
            for p in range(shots):
                work[q, p] = gram[q, p, i]
            work[q, q] += mu
        for k in range(shots):
            scale = 1 / work[k, k]
            work[k, k] = 1
            for p in range(shots):
                work[k, p] *= scale
            for q in range(shots):
                if q != k:
                    factor = work[q, k].copy()
                    work[q, k] = 0
                    for p in range(shots):
                        _eliminate(work[q, p], work[k, p], factor)
        for q in range(shots):
            for p in range(shots):
                inverse[q, p, i] = work[q, p]


@njit(cache=True, nogil=True, fastmath={"contract"})
def _add_product(a, b, total):
    for j in range(total.size):
        total[j] += a[j] * b[j]


@njit(cache=True, nogil=True)
def apply_gram(start, stop, matrices, r, out):
    """Fill out with the matrices (Q, Q, y, x) times r (Q, y, x), pixel by pixel."""
    for i in range(start, stop):
        for q in range(r.shape[0]):
            out[q, i] = 0
            for p in range(r.shape[0]):
                _add_product(matrices[q, p, i], r[p, i], out[q, i])
