"""Which voxels of a row a disperser lays on the same detector elements, for the design of codes in front of it."""

from __future__ import annotations

import numpy as np

from shadowgram.codes._colored_board import VoxelPairs
from shadowgram.codes._pairs import PairTable

from ._dispersion import Dispersion


def _products(dispersion: Dispersion, columns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Voxels v, v' and (DᵀD)_vv' of all that share a detector element, by v; voxel (band, x) has the number band·columns + x."""
    from scipy.sparse import csr_array

    prints = dispersion.footprints
    bands, reach = prints.weights.shape
    band, x, j = np.meshgrid(np.arange(bands), np.arange(columns), np.arange(reach), indexing="ij")
    element, weight = x + prints.first[band] + j, prints.weights[band, j]
    on = (element >= 0) & (element < columns + dispersion.extra_columns) & (weight > 0)
    size = (columns + dispersion.extra_columns, bands * columns)
    D = csr_array((weight[on], (element[on], (band * columns + x)[on])), shape=size)
    found = (D.T @ D).tocsr()
    found.sort_indices()
    return np.repeat(np.arange(size[1]), np.diff(found.indptr)), found.indices.astype(np.int64), found.data


def voxel_pairs(dispersion: Dispersion, shape: tuple[int, int, int]) -> VoxelPairs:
    """Pairs of voxels of a colored CASSI of `shape` (band, y, x)."""
    voxel, partner, value = _products(dispersion, shape[2])
    voxels, other = shape[0] * shape[2], voxel != partner
    own = np.zeros(voxels)
    own[voxel[~other]] = value[~other]
    start = np.searchsorted(voxel[other], np.arange(voxels + 1))
    return VoxelPairs(start, partner[other], value[other] ** 2, own, shape)


def code_pairs(dispersion: Dispersion, shape: tuple[int, int], bands: int) -> PairTable:
    """Table of a CASSI whose code (y, x) all bands see alike: an element's voxels are those of its column."""
    voxel, partner, value = _products(dispersion, shape[1])
    column, distance = voxel % shape[1], partner % shape[1] - voxel % shape[1]
    same, ahead = voxel == partner, (distance >= 0) & (voxel != partner)
    reach = int(distance.max()) + 1
    twice = np.where(distance > 0, 2.0, 1.0)  # the pair in the other order has a negative distance
    squares = np.bincount((column * reach + distance)[ahead], (twice * value**2)[ahead], shape[1] * reach)
    squares = squares.astype(float)  # bincount of nothing counts in whole numbers
    own, linear = (np.bincount(column[same], value[same] ** power, shape[1]) for power in (2, 1))
    return PairTable(
        first=0,
        pairs=squares.reshape(shape[1], reach, 1, 1),
        own=own.reshape(-1, 1, 1),
        own_linear=linear.reshape(-1, 1),
        own_count=np.full(shape[1], float(bands)),
        rows=1,
        bands=bands,
        shape=shape,
    )
