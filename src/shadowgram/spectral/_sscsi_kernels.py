"""Kernels of the SSCSI operator, on a range of detector rows. Letters: Q shots, L bands, P pieces, r code rows a detector row."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def pack_masks(start, stop, packed, first, masks):
    """masks[n, g, tile, c, i] = packed[g, n, first[p] + c] for piece p = tile·T + i of code rows n; 0 outside the code."""
    _, groups, tiles, columns, size = masks.shape
    width = packed.shape[2]
    for n in range(start, stop):
        for g in range(groups):
            for tile in range(tiles):
                for c in range(columns):
                    for i in range(size):
                        p = tile * size + i
                        u = first[p] + c if p < first.size else -1
                        masks[n, g, tile, c, i] = packed[g, n, u] if 0 <= u < width else 0


@njit(cache=True, nogil=True)
def _load_tile(x, n, begin, voxel, whole, tile):
    """tile[k, i] = x[k, n, voxel[begin + i]], zero past the last piece; `whole` says that the pieces are the voxels, in order."""
    size = min(tile.shape[1], voxel.size - begin)
    n, offset = np.uintp(n), np.uintp(begin)  # unsigned: an index that may be negative would keep the loop scalar
    for k in range(tile.shape[0]):
        if whole:
            for i in range(size):
                tile[k, i] = x[k, n, offset + np.uintp(i)]
        else:
            for i in range(size):
                tile[k, i] = x[k, n, voxel[begin + i]]
        for i in range(size, tile.shape[1]):
            tile[k, i] = 0


@njit(cache=True, nogil=True)
def _store_tile(tile, n, begin, voxel, whole, out):
    """out[k, n, voxel[begin + i]] = tile[k, i], summed over the pieces of a voxel."""
    size = min(tile.shape[1], voxel.size - begin)
    n, offset = np.uintp(n), np.uintp(begin)
    for k in range(tile.shape[0]):
        if whole:
            for i in range(size):
                out[k, n, offset + np.uintp(i)] = tile[k, i]
        else:
            for i in range(size):
                out[k, n, voxel[begin + i]] += tile[k, i]


@njit(cache=True, nogil=True, fastmath={"contract"})
def _add_weighted(weights, row, total):
    for i in range(total.size):
        total[i] += weights[i] * row[i]


@njit(cache=True, nogil=True, fastmath={"contract"})
def _add_three(weights, a, b, c, total):
    w, v, u = weights[0], weights[1], weights[2]
    for i in range(total.size):
        total[i] = w[i] * a[i] + v[i] * b[i] + u[i] * c[i]


@njit(cache=True, nogil=True)
def _blend_tile(tile, weights, blended):
    """blended[c] = Σ_j weights[j] tile[c − j]."""
    bands, reach = tile.shape[0], weights.shape[0]
    for c in range(blended.shape[0]):
        row = blended[c]
        if reach == 3 and 2 <= c < bands:  # nearly all rows of the exact shear, in one pass
            _add_three(weights, tile[c], tile[c - 1], tile[c - 2], row)
        else:
            row[:] = 0
            for j in range(max(0, c - bands + 1), min(reach, c + 1)):
                _add_weighted(weights[j], tile[c - j], row)


@njit(cache=True, nogil=True)
def _unblend_tile(summed, weights, tile):
    """tile[k] = Σ_j weights[j] summed[k + j], the transpose of `_blend_tile`."""
    reach = weights.shape[0]
    for k in range(tile.shape[0]):
        row = tile[k]
        if reach == 3:
            _add_three(weights, summed[k], summed[k + 1], summed[k + 2], row)
        else:
            row[:] = 0
            for j in range(reach):
                _add_weighted(weights[j], summed[k + j], row)


@njit(cache=True, nogil=True, fastmath={"contract"})
def _add_masked(masks, values, sums):
    """sums[q] += 2^q values[c] where bit q of masks[c] is set. The factor saves a shift; the caller divides it out, exactly."""
    kind = values.dtype.type
    shots = sums.shape[0]
    for q in range(0, shots - 2, 3):
        one, two, four = np.uint8(1 << q), np.uint8(2 << q), np.uint8(4 << q)
        s, t, u = sums[q], sums[q + 1], sums[q + 2]
        for c in range(values.shape[0]):
            v, m = values[c], masks[c]
            for i in range(s.size):
                s[i] += v[i] * kind(m[i] & one)
                t[i] += v[i] * kind(m[i] & two)
                u[i] += v[i] * kind(m[i] & four)
    for q in range(shots - shots % 3, shots):
        one, s = np.uint8(1 << q), sums[q]
        for c in range(values.shape[0]):
            v, m = values[c], masks[c]
            for i in range(s.size):
                s[i] += v[i] * kind(m[i] & one)


@njit(cache=True, nogil=True, fastmath={"contract"})
def _sum_masked(masks, values, summed):
    """summed[c] += Σ_q 2^q values[q] where bit q of masks[c] is set."""
    kind = values.dtype.type
    shots = values.shape[0]
    for q in range(0, shots - 2, 3):
        one, two, four = np.uint8(1 << q), np.uint8(2 << q), np.uint8(4 << q)
        s, t, u = values[q], values[q + 1], values[q + 2]
        for c in range(summed.shape[0]):
            row, m = summed[c], masks[c]
            for i in range(row.size):
                row[i] += s[i] * kind(m[i] & one) + t[i] * kind(m[i] & two) + u[i] * kind(m[i] & four)
    for q in range(shots - shots % 3, shots):
        one, s = np.uint8(1 << q), values[q]
        for c in range(summed.shape[0]):
            row, m = summed[c], masks[c]
            for i in range(row.size):
                row[i] += s[i] * kind(m[i] & one)


@njit(cache=True, nogil=True)
def packed_forward(start, stop, x, masks, weights, voxel, detector, whole, out):
    """g[q, m] = Σ_p∈m Σ_c t_q[first[p] + c] Σ_j w[j, p] f[c − j, p], summed over the code rows of each detector row.

    The weights come by tiles, (tile, j, T).
    """
    code_rows, groups, tiles, columns, size = masks.shape
    shots, r = out.shape[0], code_rows // out.shape[1]
    tile = np.empty((x.shape[0], size), x.dtype)
    blended = np.empty((columns, size), x.dtype)
    sums = np.empty((shots, size), x.dtype)
    for m in range(start, stop):
        out[:, m] = 0
        for t in range(tiles):
            sums[:] = 0
            for n in range(m * r, (m + 1) * r):
                _load_tile(x, n, t * size, voxel, whole, tile)
                _blend_tile(tile, weights[t], blended)
                for g in range(groups):
                    _add_masked(masks[n, g, t], blended, sums[8 * g : 8 * g + 8])
            for q in range(shots):
                scale = x.dtype.type(1 / (1 << (q % 8)))
                for i in range(min(size, detector.size - t * size)):
                    out[q, m, detector[t * size + i]] += sums[q, i] * scale


@njit(cache=True, nogil=True)
def packed_adjoint(start, stop, y, masks, weights, voxel, detector, whole, out):
    """f[k, p] = Σ_j w[j, p] Σ_q t_q[first[p] + k + j] g[q, detector[p]]."""
    code_rows, groups, tiles, columns, size = masks.shape
    shots, r = y.shape[0], code_rows // y.shape[1]
    values = np.zeros((shots, size), y.dtype)
    summed = np.empty((columns, size), y.dtype)
    tile = np.empty((out.shape[0], size), y.dtype)
    for m in range(start, stop):
        if not whole:
            out[:, m * r : (m + 1) * r] = 0
        for t in range(tiles):
            for q in range(shots):
                scale = y.dtype.type(1 / (1 << (q % 8)))
                for i in range(min(size, detector.size - t * size)):
                    values[q, i] = y[q, m, detector[t * size + i]] * scale
            for n in range(m * r, (m + 1) * r):
                summed[:] = 0
                for g in range(groups):
                    _sum_masked(masks[n, g, t], values[8 * g : 8 * g + 8], summed)
                _unblend_tile(summed, weights[t], tile)
                _store_tile(tile, n, t * size, voxel, whole, out)


@njit(cache=True, nogil=True)
def _spread(x, k, n, voxel, row):
    """row[p] = x[k, n, voxel[p]]."""
    for p in range(voxel.size):
        row[p] = x[k, n, voxel[p]]


@njit(cache=True, nogil=True)
def _collect(row, voxel, out, k, n):
    """out[k, n, v] = sum of row over the pieces of voxel v."""
    for v in range(out.shape[2]):
        out[k, n, v] = 0
    for p in range(voxel.size):
        out[k, n, voxel[p]] += row[p]


@njit(cache=True, nogil=True)
def _weigh_code(code_row, first, weights, seen):
    """seen[p] = Σ_j weights[j, p] code_row[first[p] + j]."""
    for p in range(seen.size):
        total = 0.0
        for j in range(weights.shape[0]):
            total += weights[j, p] * code_row[first[p] + j]
        seen[p] = total


@njit(cache=True, nogil=True, fastmath={"contract"})
def gray_forward(start, stop, x, code, first, weights, voxel, detector, out):
    """g[q, m] = Σ_p∈m Σ_k t̂_q[k, p] f[k, p] for any code and shear; `code` has closed columns beside it."""
    bands, pieces = first.shape
    shots, r = out.shape[0], code.shape[1] // out.shape[1]
    row, seen = np.empty(pieces, x.dtype), np.empty(pieces, x.dtype)
    sums = np.empty((shots, pieces), x.dtype)
    for m in range(start, stop):
        sums[:] = 0
        for n in range(m * r, (m + 1) * r):
            for k in range(bands):
                _spread(x, k, n, voxel, row)
                for q in range(shots):
                    _weigh_code(code[q, n], first[k], weights[:, k], seen)
                    for p in range(pieces):
                        sums[q, p] += seen[p] * row[p]
        for q in range(shots):
            out[q, m] = 0
            for p in range(pieces):
                out[q, m, detector[p]] += sums[q, p]


@njit(cache=True, nogil=True, fastmath={"contract"})
def gray_adjoint(start, stop, y, code, first, weights, voxel, detector, out):
    """f[k, p] = Σ_q t̂_q[k, p] g[q, detector[p]]."""
    bands, pieces = first.shape
    shots, r = y.shape[0], code.shape[1] // y.shape[1]
    values = np.empty((shots, pieces), y.dtype)
    seen, row = np.empty(pieces, y.dtype), np.empty(pieces, y.dtype)
    for m in range(start, stop):
        for q in range(shots):
            for p in range(pieces):
                values[q, p] = y[q, m, detector[p]]
        for n in range(m * r, (m + 1) * r):
            for k in range(bands):
                row[:] = 0
                for q in range(shots):
                    _weigh_code(code[q, n], first[k], weights[:, k], seen)
                    for p in range(pieces):
                        row[p] += seen[p] * values[q, p]
                _collect(row, voxel, out, k, n)


@njit(cache=True, nogil=True)
def gray_gram(start, stop, code, first, weights, gram):
    """gram[a, b, m, p] = Σ_k Σ_n t̂_a t̂_b, when the pieces are the detector elements."""
    bands, pieces = first.shape
    shots, r = gram.shape[0], code.shape[1] // gram.shape[2]
    seen = np.empty((shots, pieces))
    for m in range(start, stop):
        gram[:, :, m] = 0
        for n in range(m * r, (m + 1) * r):
            for k in range(bands):
                for q in range(shots):
                    _weigh_code(code[q, n], first[k], weights[:, k], seen[q])
                for a in range(shots):
                    for b in range(a + 1):
                        for p in range(pieces):
                            gram[a, b, m, p] += seen[a, p] * seen[b, p]
        for a in range(shots):
            for b in range(a):
                gram[b, a, m] = gram[a, b, m]
