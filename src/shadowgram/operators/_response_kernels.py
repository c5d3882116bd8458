"""Kernels of spectral responses, on a range of rows y: one row of every band at a time, so that all sums stay in cache."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, fastmath={"contract"})
def respond(start, stop, x, weights, out):
    """out[c, y, x] = Σ_k weights[c, k] x[k, y, x]."""
    channels, bands = weights.shape
    for y in range(start, stop):
        out[:, y] = 0
        for k in range(bands):
            for c in range(channels):
                w = weights[c, k]
                for i in range(x.shape[2]):
                    out[c, y, np.uintp(i)] += w * x[k, y, np.uintp(i)]
