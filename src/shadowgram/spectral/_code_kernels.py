"""Kernels of T(t, f, g) = Σ w t f g, which is linear in code t, cube f and snapshots g: its derivative in each of them.

Along a row, the terms come in runs: run i has length[i] terms, with weights from start[i] on, and takes code columns from u[i] on,
voxels of band k[i] from v[i] on, and detector columns from d[i] on. The code is (shot, band or 1, row, column); each detector row
takes r rows of the code and of the cube. Kernels work on a range of detector rows.
"""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def _run(runs, i):
    """Indices of a run, unsigned: an index that may be negative would keep a loop scalar."""
    k, u, v, d, at = runs[i, 0], runs[i, 1], runs[i, 2], runs[i, 3], runs[i, 4]
    return np.uintp(k), np.uintp(u), np.uintp(v), np.uintp(d), np.uintp(at), runs[i, 5]


@njit(cache=True, nogil=True, fastmath={"contract"})
def snapshots(start, stop, runs, weights, code, cube, out):
    """∂T/∂g: out[q, m, d] = Σ w t[q, k, n, u] f[k, n, v]."""
    r = code.shape[2] // out.shape[1]
    for m in range(start, stop):
        for q in range(out.shape[0]):
            out[q, m] = 0
            for n in range(m * r, (m + 1) * r):
                for run in range(runs.shape[0]):
                    b = min(runs[run, 0], code.shape[1] - 1)
                    k, u, v, d, at, length = _run(runs, run)
                    for i in range(length):
                        i = np.uintp(i)
                        out[q, m, d + i] += weights[at + i] * code[q, b, n, u + i] * cube[k, n, v + i]


@njit(cache=True, nogil=True, fastmath={"contract"})
def cube(start, stop, runs, weights, code, snaps, out):
    """∂T/∂f: out[k, n, v] = Σ w t[q, k, n, u] g[q, m, d]."""
    r = code.shape[2] // snaps.shape[1]
    for m in range(start, stop):
        for n in range(m * r, (m + 1) * r):
            out[:, n] = 0
            for run in range(runs.shape[0]):
                b = min(runs[run, 0], code.shape[1] - 1)
                k, u, v, d, at, length = _run(runs, run)
                for q in range(snaps.shape[0]):
                    for i in range(length):
                        i = np.uintp(i)
                        out[k, n, v + i] += weights[at + i] * code[q, b, n, u + i] * snaps[q, m, d + i]


@njit(cache=True, nogil=True, fastmath={"contract"})
def code(start, stop, runs, weights, cube, snaps, out):
    """∂T/∂t: out[q, k, n, u] = Σ w f[k, n, v] g[q, m, d]."""
    r = out.shape[2] // snaps.shape[1]
    for m in range(start, stop):
        for n in range(m * r, (m + 1) * r):
            for q in range(out.shape[0]):
                out[q, :, n] = 0
                for run in range(runs.shape[0]):
                    b = min(runs[run, 0], out.shape[1] - 1)
                    k, u, v, d, at, length = _run(runs, run)
                    for i in range(length):
                        i = np.uintp(i)
                        out[q, b, n, u + i] += weights[at + i] * cube[k, n, v + i] * snaps[q, m, d + i]
