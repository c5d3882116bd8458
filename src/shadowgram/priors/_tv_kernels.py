"""Kernels of total variation denoising, on a range of images. Letters: M images, v data, p dual, w weight, x = v − Dᵀp.

D takes forward differences, along x then y, with none across the last column and row. The dual p (M, 2, y, x) is kept in the
units of the weight, |p| ≤ w at every pixel, so that it stays a good start when the weight changes.
Inner loops run over x on slices, without branches, so that they are vectorised.
"""

import numpy as np
from numba import njit

_STEP = np.float32(0.125)  # 1/‖D‖² ≥ 1/8 in two dimensions; a float32 constant keeps float32 images in float32
_TINY = np.float32(1e-30)
_BLOCK = 10  # iterations between two looks at the gap


@njit(cache=True, nogil=True, fastmath={"contract"})
def _primal_row(v, p, i, x):
    """Set x to row i of v − Dᵀp."""
    data, along_x, along_y = v[i], p[0, i], p[1, i]
    x[0] = data[0] + along_x[0] + along_y[0]
    inner, data, left, along_x, along_y = x[1:], data[1:], along_x[:-1], along_x[1:], along_y[1:]
    if i == 0:
        for j in range(inner.size):
            inner[j] = data[j] + (along_x[j] - left[j]) + along_y[j]
    else:
        x[0] -= p[1, i - 1, 0]
        above = p[1, i - 1, 1:]
        for j in range(inner.size):
            inner[j] = data[j] + (along_x[j] - left[j]) + (along_y[j] - above[j])


@njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def _dual_row(x, below, p, r, i, weight, momentum):
    """Row i of p ← projection of r + D x/8 on |p| ≤ weight, and of r ← p + momentum (p − previous p)."""
    last = x.size - 1
    px, py, rx, ry = p[0, i], p[1, i], r[0, i], r[1, i]
    right = x[1:]
    bound = max(weight, _TINY)
    for j in range(last):
        a = rx[j] + _STEP * (right[j] - x[j])
        b = ry[j] + _STEP * (below[j] - x[j])
        shrink = weight / max(bound, np.sqrt(a * a + b * b))
        a *= shrink
        b *= shrink
        rx[j] = a + momentum * (a - px[j])
        ry[j] = b + momentum * (b - py[j])
        px[j] = a
        py[j] = b
    b = ry[last] + _STEP * (below[last] - x[last])
    b = min(max(b, -weight), weight)
    ry[last] = b + momentum * (b - py[last])
    py[last] = b
    rx[last] = 0
    px[last] = 0


@njit(cache=True, nogil=True)
def _iterate(v, p, r, weight, t, iterations, rows):
    """Fast gradient projection; returns the momentum's counter t. `rows` (iterations, 2, x) is scratch.

    Iteration k works on row i as soon as iteration k − 1 has done row i + 1, so that one sweep over the image makes all
    iterations while its rows are in the cache: twice as fast as one sweep each. A row of x is needed before the dual rows that
    it depends on change, so each iteration holds two.
    """
    height = v.shape[0]
    momenta = np.empty(iterations, v.dtype)
    for k in range(iterations):
        t_next = 0.5 * (1 + np.sqrt(1 + 4 * t * t))
        momenta[k] = (t - 1) / t_next
        t = t_next
    for front in range(height + iterations - 1):
        for k in range(max(0, front - height + 1), min(iterations, front + 1)):
            i = front - k
            here, below = rows[k, i % 2], rows[k, (i + 1) % 2]
            if i == 0:
                _primal_row(v, r, 0, here)
            if i + 1 < height:
                _primal_row(v, r, i + 1, below)
            else:
                below[:] = here
            _dual_row(here, below, p, r, i, weight, momenta[k])
    return t


@njit(cache=True, nogil=True)
def _gap(v, p, weight, rows):
    """Duality gap Σ weight |∇x| − ⟨∇x, p⟩ at x = v − Dᵀp, an upper bound of ½‖x − solution‖²."""
    total = 0.0
    here, below = rows[0], rows[1]
    _primal_row(v, p, 0, here)
    for i in range(v.shape[0]):
        if i + 1 < v.shape[0]:
            _primal_row(v, p, i + 1, below)
        else:
            below[:] = here
        last = v.shape[1] - 1
        for j in range(last + 1):
            a = float(here[min(j + 1, last)] - here[j])
            b = float(below[j] - here[j])
            total += weight * np.sqrt(a * a + b * b) - a * p[0, i, j] - b * p[1, i, j]
        here, below = below, here
    return total


@njit(cache=True, nogil=True)
def smooth(start, stop, v, p, weights, iterations, out):
    """A few iterations from the duals p, which are updated: out ← v − Dᵀp. `out` may be v itself."""
    r = np.empty_like(p[0])
    rows = np.empty((max(iterations, 1), 2, v.shape[2]), v.dtype)
    for m in range(start, stop):
        r[:] = p[m]
        _iterate(v[m], p[m], r, weights[m], 1.0, iterations, rows)
        for i in range(v.shape[1]):
            _primal_row(v[m], p[m], i, rows[0, 0])
            out[m, i] = rows[0, 0]


@njit(cache=True, nogil=True)
def solve(start, stop, v, p, weights, bounds, max_iter, out, gaps):
    """Iterate until the gap of an image is at most its bound, or `max_iter` times; gaps[m] is what it came to."""
    r = np.empty_like(p[0])
    rows = np.empty((_BLOCK, 2, v.shape[2]), v.dtype)
    for m in range(start, stop):
        r[:] = p[m]
        t, done = 1.0, 0
        gaps[m] = _gap(v[m], p[m], weights[m], rows[0])
        while gaps[m] > bounds[m] and done < max_iter:
            count = min(_BLOCK, max_iter - done)
            t = _iterate(v[m], p[m], r, weights[m], t, count, rows)
            done += count
            gaps[m] = _gap(v[m], p[m], weights[m], rows[0])
        for i in range(v.shape[1]):
            _primal_row(v[m], p[m], i, rows[0, 0])
            out[m, i] = rows[0, 0]
