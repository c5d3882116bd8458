"""Kernels of the SSCSI operator, on a range of detector rows. Letters: Q shots, L bands, P pieces, r code rows a detector row."""

import numpy as np
from numba import njit

GRAY_TILE = 64  # pieces whose blended bands stay in the first-level cache


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
def _load_tile(x, n, begin, voxel, tile):
    """tile[k + 2, i] = x[k, n, voxel[begin + i]]; what is past the last piece stays as it was, and reaches no result."""
    size = min(tile.shape[1], voxel.size - begin)
    whole = voxel.size == x.shape[2]  # the pieces are the voxels, in order
    n, offset = np.uintp(n), np.uintp(begin)  # unsigned: an index that may be negative would keep the loop scalar
    for k in range(x.shape[0]):
        if whole:
            for i in range(size):
                tile[k + 2, i] = x[k, n, offset + np.uintp(i)]
        else:
            for i in range(size):
                tile[k + 2, i] = x[k, n, voxel[begin + i]]


@njit(cache=True, nogil=True, fastmath={"contract"})
def _blend_tile(tile, weights, t, blended):
    """blended[c] = Σ_j weights[t, j] tile[c − j + 2]: the bands between two rows of zeros on either side."""
    for c in range(blended.shape[0]):
        for i in range(blended.shape[1]):
            blended[c, i] = (
                weights[t, 0, i] * tile[c + 2, i] + weights[t, 1, i] * tile[c + 1, i] + weights[t, 2, i] * tile[c, i]
            )


@njit(cache=True, nogil=True, fastmath={"contract"})
def _add_masked(masks, n, g, t, values, sums):
    """sums[8g + q] += 2^q values[c] where bit q of masks[c] is set. The factor saves a shift; `_store_sums` divides it out."""
    kind = values.dtype.type
    columns, size = values.shape
    shots = min(8, sums.shape[0] - 8 * g)
    for q in range(0, shots - 2, 3):
        one, two, four, s = np.uint8(1 << q), np.uint8(2 << q), np.uint8(4 << q), 8 * g + q
        for c in range(columns):
            for i in range(size):
                v, m = values[c, i], masks[n, g, t, c, i]
                sums[s, i] += v * kind(m & one)
                sums[s + 1, i] += v * kind(m & two)
                sums[s + 2, i] += v * kind(m & four)
    for q in range(shots - shots % 3, shots):
        one, s = np.uint8(1 << q), 8 * g + q
        for c in range(columns):
            for i in range(size):
                sums[s, i] += values[c, i] * kind(masks[n, g, t, c, i] & one)


@njit(cache=True, nogil=True)
def _store_sums(sums, m, begin, detector, out):
    """out[q, m, detector[begin + i]] = sums[q, i] / 2^(q mod 8), summed over the pieces of a detector element."""
    size = min(sums.shape[1], detector.size - begin)
    m, offset = np.uintp(m), np.uintp(begin)
    for q in range(out.shape[0]):
        scale = sums.dtype.type(1 / (1 << (q % 8)))
        if detector.size == out.shape[2]:
            for i in range(size):
                out[q, m, offset + np.uintp(i)] = sums[q, i] * scale
        else:
            for i in range(size):
                out[q, m, detector[begin + i]] += sums[q, i] * scale


@njit(cache=True, nogil=True)
def packed_forward(start, stop, x, masks, weights, voxel, detector, out):
    """g[q, m] = Σ_p∈m Σ_c t_q[first[p] + c] Σ_j w[j, p] f[c − j, p], summed over the code rows of each detector row.

    The weights come by tiles, (tile, 3, T). Rows are indexed in place: an array view costs atomic reference counts.
    """
    code_rows, groups, tiles, columns, size = masks.shape
    shots, r = out.shape[0], code_rows // out.shape[1]
    tile = np.zeros((x.shape[0] + 4, size), x.dtype)
    blended = np.empty((columns, size), x.dtype)
    sums = np.empty((shots, size), x.dtype)
    for m in range(start, stop):
        out[:, m] = 0
        for t in range(tiles):
            sums[:] = 0
            for n in range(m * r, (m + 1) * r):
                _load_tile(x, n, t * size, voxel, tile)
                _blend_tile(tile, weights, t, blended)
                for g in range(groups):
                    _add_masked(masks, n, g, t, blended, sums)
            _store_sums(sums, m, t * size, detector, out)


@njit(cache=True, nogil=True)
def _load_values(y, m, begin, detector, values):
    """values[q, i] = y[q, m, detector[begin + i]] / 2^(q mod 8)."""
    size = min(values.shape[1], detector.size - begin)
    m, offset = np.uintp(m), np.uintp(begin)
    for q in range(y.shape[0]):
        scale = values.dtype.type(1 / (1 << (q % 8)))
        if detector.size == y.shape[2]:
            for i in range(size):
                values[q, i] = y[q, m, offset + np.uintp(i)] * scale
        else:
            for i in range(size):
                values[q, i] = y[q, m, detector[begin + i]] * scale


@njit(cache=True, nogil=True, fastmath={"contract"})
def _sum_masked(masks, n, g, t, values, summed):
    """summed[c] += Σ_q 2^q values[8g + q] where bit q of masks[c] is set."""
    kind = values.dtype.type
    columns, size = masks.shape[3:]
    shots = min(8, values.shape[0] - 8 * g)
    for q in range(0, shots - 2, 3):
        one, two, four, s = np.uint8(1 << q), np.uint8(2 << q), np.uint8(4 << q), 8 * g + q
        for c in range(columns):
            for i in range(size):
                m = masks[n, g, t, c, i]
                near = values[s, i] * kind(m & one) + values[s + 1, i] * kind(m & two)
                summed[c, i] += near + values[s + 2, i] * kind(m & four)
    for q in range(shots - shots % 3, shots):
        one, s = np.uint8(1 << q), 8 * g + q
        for c in range(columns):
            for i in range(size):
                summed[c, i] += values[s, i] * kind(masks[n, g, t, c, i] & one)


@njit(cache=True, nogil=True, fastmath={"contract"})
def _unblend_tile(summed, weights, t, n, begin, voxel, out):
    """out[k, n, voxel[begin + i]] = Σ_j weights[t, j] summed[k + j], summed over the pieces of a voxel."""
    size = min(summed.shape[1], voxel.size - begin)
    n, offset = np.uintp(n), np.uintp(begin)
    for k in range(out.shape[0]):
        if voxel.size == out.shape[2]:
            for i in range(size):
                near = weights[t, 0, i] * summed[k, i] + weights[t, 1, i] * summed[k + 1, i]
                out[k, n, offset + np.uintp(i)] = near + weights[t, 2, i] * summed[k + 2, i]
        else:
            for i in range(size):
                near = weights[t, 0, i] * summed[k, i] + weights[t, 1, i] * summed[k + 1, i]
                out[k, n, voxel[begin + i]] += near + weights[t, 2, i] * summed[k + 2, i]


@njit(cache=True, nogil=True)
def packed_adjoint(start, stop, y, masks, weights, voxel, detector, out):
    """f[k, p] = Σ_j w[j, p] Σ_q t_q[first[p] + k + j] g[q, detector[p]]; the weights as in `packed_forward`."""
    code_rows, groups, tiles, columns, size = masks.shape
    shots, r = y.shape[0], code_rows // y.shape[1]
    values = np.zeros((shots, size), y.dtype)
    summed = np.zeros((out.shape[0] + 2, size), y.dtype)
    for m in range(start, stop):
        if voxel.size != out.shape[2]:
            out[:, m * r : (m + 1) * r] = 0
        for t in range(tiles):
            _load_values(y, m, t * size, detector, values)
            for n in range(m * r, (m + 1) * r):
                summed[:columns] = 0
                for g in range(groups):
                    _sum_masked(masks, n, g, t, values, summed)
                _unblend_tile(summed, weights, t, n, t * size, voxel, out)


@njit(cache=True, nogil=True)
def _weigh_code(code_row, first, weights, seen):
    """seen[p] = Σ_j weights[j, p] code_row[first[p] + j]."""
    for p in range(seen.size):
        total = 0.0
        for j in range(weights.shape[0]):
            total += weights[j, p] * code_row[first[p] + j]
        seen[p] = total


@njit(cache=True, nogil=True, fastmath={"contract"})
def _blend_columns(x, n, begin, ahead, weights, voxel, blended):
    """blended[i, c] = light of all bands of row n that piece begin + i sees through its code column number c."""
    blended[:] = 0
    size, n = min(blended.shape[0], voxel.size - begin), np.uintp(n)
    for k in range(ahead.shape[0]):
        for i in range(size):
            p = np.uintp(begin + i)
            v, c = x[k, n, np.uintp(voxel[p])], np.uintp(ahead[k, p])
            for j in range(weights.shape[0]):
                blended[np.uintp(i), c + np.uintp(j)] += weights[j, k, p] * v


@njit(cache=True, nogil=True, fastmath={"contract"})
def _sum_columns(code, g, n, begin, first, count, blended, sums):
    """sums[i, q] += Σ_c blended[i, c] code[g, n, first + c, q], eight shots at a time."""
    g, n = np.uintp(g), np.uintp(n)
    for i in range(min(sums.shape[0], first.size - begin)):
        i, p = np.uintp(i), np.uintp(begin + i)
        u = np.uintp(first[p])
        for c in range(count[p]):
            v = blended[i, np.uintp(c)]
            for q in range(8):  # a constant number, so that it becomes one vector operation
                sums[i, np.uintp(q)] += v * code[g, n, u + np.uintp(c), np.uintp(q)]


@njit(cache=True, nogil=True)
def gray_forward(start, stop, x, code, first, count, ahead, weights, voxel, detector, out):
    """g[q, m] = Σ_p∈m Σ_k t̂_q[k, p] f[k, p] for any code and shear.

    The bands are first blended into the code columns through which a piece sees them, once for all shots. The code comes as (group,
    row, column, 8 shots) with closed columns beside it; piece p sees count[p] columns from first[p] on, and band k those from
    first[p] + ahead[k, p] on.
    """
    shots, r = out.shape[0], code.shape[1] // out.shape[1]
    blended = np.empty((GRAY_TILE, count.max()), x.dtype)
    sums = np.empty((code.shape[0], GRAY_TILE, 8), x.dtype)
    for m in range(start, stop):
        out[:, m] = 0
        for begin in range(0, voxel.size, GRAY_TILE):
            sums[:] = 0
            for n in range(m * r, (m + 1) * r):
                _blend_columns(x, n, begin, ahead, weights, voxel, blended)
                for g in range(code.shape[0]):
                    _sum_columns(code, g, n, begin, first, count, blended, sums[g])
            for q in range(shots):
                for i in range(min(GRAY_TILE, voxel.size - begin)):
                    out[q, m, detector[begin + i]] += sums[q // 8, i, q % 8]


@njit(cache=True, nogil=True, fastmath={"contract"})
def _spread_shots(code, g, n, begin, first, count, values, blended):
    """blended[i, c] += Σ_q code[g, n, first + c, q] values[i, q]."""
    g, n = np.uintp(g), np.uintp(n)
    for i in range(min(values.shape[0], first.size - begin)):
        i, p = np.uintp(i), np.uintp(begin + i)
        u = np.uintp(first[p])
        for c in range(count[p]):
            c = np.uintp(c)
            near = blended.dtype.type(0)
            far = blended.dtype.type(0)
            # Two running sums: the order is fixed, and they go on side by side.
            for q in range(4):
                near += values[i, np.uintp(q)] * code[g, n, u + c, np.uintp(q)]
                far += values[i, np.uintp(q + 4)] * code[g, n, u + c, np.uintp(q + 4)]
            blended[i, c] += near + far


@njit(cache=True, nogil=True, fastmath={"contract"})
def _unblend_columns(blended, n, begin, ahead, weights, voxel, out):
    """out[k, n, voxel[begin + i]] += Σ_j weights[j, k] blended[i, ahead[k] + j]."""
    size, n = min(blended.shape[0], voxel.size - begin), np.uintp(n)
    for k in range(ahead.shape[0]):
        for i in range(size):
            p = np.uintp(begin + i)
            c = np.uintp(ahead[k, p])
            total = out.dtype.type(0)
            for j in range(weights.shape[0]):
                total += weights[j, k, p] * blended[np.uintp(i), c + np.uintp(j)]
            out[k, n, np.uintp(voxel[p])] += total


@njit(cache=True, nogil=True)
def gray_adjoint(start, stop, y, code, first, count, ahead, weights, voxel, detector, out):
    """f[k, p] = Σ_q t̂_q[k, p] g[q, detector[p]]; the code and columns as in `gray_forward`."""
    shots, r = y.shape[0], code.shape[1] // y.shape[1]
    blended = np.empty((GRAY_TILE, count.max()), y.dtype)
    values = np.zeros((code.shape[0], GRAY_TILE, 8), y.dtype)
    for m in range(start, stop):
        out[:, m * r : (m + 1) * r] = 0
        for begin in range(0, voxel.size, GRAY_TILE):
            for q in range(shots):
                for i in range(min(GRAY_TILE, voxel.size - begin)):
                    values[q // 8, i, q % 8] = y[q, m, detector[begin + i]]
            for n in range(m * r, (m + 1) * r):
                blended[:] = 0
                for g in range(code.shape[0]):
                    _spread_shots(code, g, n, begin, first, count, values[g], blended)
                _unblend_columns(blended, n, begin, ahead, weights, voxel, out)


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
