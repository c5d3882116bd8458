"""Kernels of GAP-TV and ADMM-TV, on a range of bands: all that an iteration does to a band, while it is in the cache.

Letters: z the estimate, v what it is the proximal map of, p dual images (band, 2, y, x) of the total variation, w its weight,
x = max(v − Dᵀp, least); D takes forward differences, along x then y, with none across the last column and row.

The proximal map is a few steps of projected gradients on the dual, p ← projection of p + s Dx on |p| ≤ w at every pixel. Momentum
would begin anew in every call, and does nothing for the first two steps.
Inner loops run over x on slices, without branches, so that they are vectorised.
"""

import numpy as np
from numba import njit

# s = 1/8 ≤ 1/‖D‖². Steps up to twice as long converge for one image, but not from call to call while the image changes.
_STEP = np.float32(0.125)  # a float32 constant keeps float32 images in float32
_TINY = np.float32(1e-30)


@njit(cache=True, nogil=True, fastmath={"contract"})
def _primal_row(v, along_x, along_y, above, least, x):
    """x ← max(v − Dᵀp, least) on a row; `above` is p along y of the row before it."""
    x[0] = max(v[0] + along_x[0] + along_y[0] - above[0], least)
    inner, v, left, along_x, along_y, above = x[1:], v[1:], along_x[:-1], along_x[1:], along_y[1:], above[1:]
    for j in range(inner.size):
        inner[j] = max(v[j] + (along_x[j] - left[j]) + (along_y[j] - above[j]), least)


@njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def _dual_row(x, below, weight, along_x, along_y):
    """p ← projection of p + s Dx on |p| ≤ weight on a row."""
    last = x.size - 1
    bound = max(weight, _TINY)
    right, px, py = x[1:], along_x[:last], along_y[:last]
    for j in range(last):
        a = px[j] + _STEP * (right[j] - x[j])
        b = py[j] + _STEP * (below[j] - x[j])
        shrink = weight / max(bound, np.sqrt(a * a + b * b))
        px[j] = a * shrink
        py[j] = b * shrink
    along_y[last] = min(max(along_y[last] + _STEP * (below[last] - x[last]), -weight), weight)


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def _store_row(new, z):
    """Set z to new; return Σ(change of z)² and Σz²."""
    change, size = new.dtype.type(0), new.dtype.type(0)
    for j in range(new.size):
        step = new[j] - z[j]
        change += step * step
        size += new[j] * new[j]
        z[j] = new[j]
    return change, size


@njit(cache=True, nogil=True)
def _proximal(v, p, weight, iterations, least, rows, z, sums):
    """Improve p, z ← max(v − Dᵀp, least); sums[:2] ← Σ(change of z)² and Σz².

    All in one sweep over the band: step k works on row i as soon as step k − 1 has done row i + 1, and z follows the last step.
    A row of x is needed before the dual rows that it depends on change, so each step holds two, in `rows` (iterations + 1, 2, x);
    the last pair is zeros, for p beyond the edge, and the new row of z.
    """
    height = v.shape[0]
    along_x, along_y = p[0], p[1]
    edge, new = rows[iterations, 0], rows[iterations, 1]
    edge[:] = 0
    sums[:2] = 0
    for front in range(height + iterations - 1):
        for k in range(max(0, front - height + 1), min(iterations, front + 1)):
            i = front - k
            here, below = rows[k, i % 2], rows[k, (i + 1) % 2]
            if i == 0:
                _primal_row(v[0], along_x[0], along_y[0], edge, least, here)
            if i + 1 < height:
                _primal_row(v[i + 1], along_x[i + 1], along_y[i + 1], along_y[i], least, below)
            else:
                below[:] = here
            _dual_row(here, below, weight, along_x[i], along_y[i])
        i = front - iterations + 1
        if i >= 0:
            _primal_row(v[i], along_x[i], along_y[i], along_y[i - 1] if i > 0 else edge, least, new)
            change, size = _store_row(new, z[i])
            sums[0] += change
            sums[1] += size


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def _variation_row(here, below):
    """Σ |∇x| of a row of x and the one below."""
    last = here.size - 1
    right = here[1:]
    total = abs(below[last] - here[last])
    for j in range(last):
        a, b = right[j] - here[j], below[j] - here[j]
        total += np.sqrt(a * a + b * b)
    return total


@njit(cache=True, nogil=True, fastmath={"contract"})
def _add(z, c, v):
    for j in range(z.size):
        v[j] = z[j] + c[j]


@njit(cache=True, nogil=True)
def project_and_smooth(start, stop, z, correction, p, weight, iterations, least, sums):
    """Z ← proximal map of z + correction, the projection of z; sums[m] ← Σ(change of z)², Σz²."""
    rows = np.empty((iterations + 1, 2, z.shape[2]), z.dtype)
    projected = np.empty_like(z[0])
    for m in range(start, stop):
        for i in range(z.shape[1]):
            _add(z[m, i], correction[m, i], projected[i])
        _proximal(projected, p[m], weight, iterations, least, rows, z[m], sums[m])


@njit(cache=True, nogil=True, fastmath={"contract"})
def _relax(z, c, relaxation, a):
    for j in range(z.size):
        a[j] += relaxation * (z[j] - a[j] - c[j])


@njit(cache=True, nogil=True, fastmath={"contract"})
def _reflect(z, a, c):
    for j in range(z.size):
        c[j] = 2 * z[j] - a[j]


@njit(cache=True, nogil=True)
def relax_and_smooth(start, stop, z, correction, relaxation, a, p, weight, iterations, least, sums):
    """A += relaxation (z − a − correction), the relaxed x + u; z ← its proximal map; correction ← 2z − a.

    sums[m] ← Σ(change of z)², Σz², TV(z).
    """
    rows = np.empty((iterations + 1, 2, z.shape[2]), z.dtype)
    below = z.shape[1] - 1
    for m in range(start, stop):
        for i in range(z.shape[1]):
            _relax(z[m, i], correction[m, i], relaxation, a[m, i])
        _proximal(a[m], p[m], weight, iterations, least, rows, z[m], sums[m])
        sums[m, 2] = 0
        for i in range(z.shape[1]):
            _reflect(z[m, i], a[m, i], correction[m, i])
            sums[m, 2] += _variation_row(z[m, i], z[m, min(i + 1, below)])
