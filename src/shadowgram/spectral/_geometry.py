"""Where each detector element looks through the mask: the columns and weights behind both SSCSI models.

Positions along x are in code columns, u = (x (1−s) + offset)/Δc, for a point x on the detector. A *piece* is an interval of u that
belongs to one detector element and one voxel column: a whole detector element when it is narrower than a stretched code element
(detector-limited), else the part of a voxel, one stretched code element wide, that falls on it (super-resolving).
Seen through the mask in a band that starts δ·k columns further right, the transmittance of a piece is the mean of the code over
the piece and over the band; for unit δ only the first column moves with k, the weights do not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Positions that should be whole numbers are so to about 1e-12; sizes in use keep u below 1e5.
ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Pieces:
    """Intervals of u: where they start, how wide they are, which voxel column and detector column they belong to.

    Attributes
    ----------
    start : (piece,) u of the left end.
    width : (piece,) in code columns.
    share : (piece,) part of the voxel that lies in the piece.
    voxel, detector : (piece,) int32 column of the cube and of the snapshot.
    columns : number of voxel columns.
    """

    start: np.ndarray
    width: np.ndarray
    share: np.ndarray
    voxel: np.ndarray
    detector: np.ndarray
    columns: int


def detector_limited_pieces(elements: int, width: float, offset: float) -> Pieces:
    """One piece a detector element, `width` code columns wide, the first at u = `offset`."""
    index = np.arange(elements, dtype=np.int32)
    full = np.ones(elements)
    return Pieces(offset + width * index, width * full, full, index, index, elements)


def super_resolving_pieces(elements: int, width: float, offset: float) -> Pieces:
    """Voxels one code column wide, cut at the edges of detector elements `width` ≥ 1 columns wide (W of eq. 2.12)."""
    first = np.floor(offset + ROUNDING)
    columns = int(np.ceil(offset + width * elements - first - ROUNDING))
    cuts = np.concatenate([first + np.arange(columns + 1), offset + width * np.arange(elements + 1)])
    cuts = np.sort(cuts[(cuts >= offset - ROUNDING) & (cuts <= offset + width * elements + ROUNDING)])
    cuts = cuts[np.append(True, np.diff(cuts) > ROUNDING)]
    start, size = cuts[:-1], np.diff(cuts)
    middle = start + size / 2
    voxel = np.floor(middle - first).astype(np.int32)
    detector = np.floor((middle - offset) / width).astype(np.int32)
    return Pieces(start, size, size, voxel, detector, columns)


@dataclass(frozen=True, eq=False)
class ColumnTable:
    """Code columns and weights of every piece in every band.

    The coefficient of band k and piece p is Σ_j weights[j, k, p] · code[first[k, p] + j]; columns outside the code are closed.
    With `unit_shear`, first[k] = first[0] + k and the weights of all bands are those of band 0.

    Attributes
    ----------
    first : (band, piece) int32.
    weights : (j, band, piece) float64.
    """

    first: np.ndarray
    weights: np.ndarray
    unit_shear: bool


def column_table(pieces: Pieces, bands: int, step: float, shear: str) -> ColumnTable:
    """Columns and weights for `bands` bands, each `step` code columns further right than the one before.

    `shear` says over what a band's code is averaged: "exact" over the whole band, "edge" and "centre" at one wavelength
    (first order; eqs. 2.19 and 2.23 are "edge").
    """
    unit = abs(step - 1) < ROUNDING
    k = np.arange(1 if unit else bands)[:, None] * step
    spread = step if shear == "exact" else 0.0
    start = pieces.start + k + (step / 2 if shear == "centre" else 0.0)
    first = np.floor(start + ROUNDING)
    reach = int(np.ceil((start - first + pieces.width + spread).max() - ROUNDING))
    edges = first + np.arange(reach + 1)[:, None, None] - start
    # Rounding can leave a share of -1e-17, which no transmittance has.
    weights = np.maximum(np.diff(share_below(edges, pieces.width, spread), axis=0), 0) * pieces.share
    first = first.astype(np.int32)
    if unit:
        first = first + np.arange(bands, dtype=np.int32)[:, None]
        weights = np.broadcast_to(weights, (reach, bands, len(pieces.start)))
    return ColumnTable(first, weights, unit)


def share_below(z: np.ndarray, width: np.ndarray, spread: float) -> np.ndarray:
    """Share of box(width) ∗ box(spread), which begins at 0, that lies below z."""

    def ramp(z: np.ndarray) -> np.ndarray:
        return np.clip(z, 0, width) / width

    if spread < ROUNDING:
        return ramp(z)

    def area(z: np.ndarray) -> np.ndarray:
        """Integral of the ramp up to z."""
        inside = np.clip(z, 0, width)
        return inside**2 / (2 * width) + np.maximum(z - width, 0)

    return (area(z) - area(z - spread)) / spread


def light_missed(table: ColumnTable, columns: int) -> np.ndarray:
    """(band,) share of each band's light that falls outside a mask of `columns` columns."""
    j = np.arange(len(table.weights))[:, None, None]
    hit = (table.first + j >= 0) & (table.first + j < columns)
    total = table.weights.sum(axis=(0, 2))
    return 1 - (table.weights * hit).sum(axis=(0, 2)) / total


def interval_means(values: np.ndarray, axis: int, edges: np.ndarray, *, whole: bool = False) -> np.ndarray:
    """Means over the intervals between `edges` along an axis whose cells are 0 to 1, 1 to 2, and so on.

    Over the part of an interval that has cells, or over the `whole` of it, with zeros beyond the cells. float64 stays float64,
    anything else becomes float32.
    """
    values = values.astype(np.float64 if values.dtype == np.float64 else np.float32, copy=False)
    cells = np.arange(values.shape[axis])
    overlap = np.minimum(edges[1:, None], cells + 1) - np.maximum(edges[:-1, None], cells)
    overlap = np.clip(overlap, 0, None)
    length = np.diff(edges)[:, None] if whole else overlap.sum(axis=1, keepdims=True)
    weights = (overlap / length).astype(values.dtype)
    if weights.shape[0] == weights.shape[1] and np.array_equal(weights, np.eye(len(cells))):
        return values
    return np.ascontiguousarray(np.moveaxis(np.tensordot(weights, values, axes=(1, axis)), 0, axis))
