"""The SSCSI as a matrix-free operator.

Two kernels: binary codes with one column of shear a band (the imager's own bands) sum masks of one bit a shot over a cube
that was blended along the bands; gray codes and other shears weigh the code itself. See docs/decisions/0005-sscsi-kernels.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from shadowgram._threads import run_chunks
from shadowgram.operators.base import LinearOperator, Shape
from shadowgram.operators.structure import shot_gram

from . import _sscsi_kernels as kernels
from ._geometry import ColumnTable, Pieces
from .resolution import DETECTOR_LIMITED

if TYPE_CHECKING:
    from .sscsi import SSCSI


TILE = 256  # pieces whose bands, blended bands and sums fit the second-level cache together


def _tiling(pieces: int) -> tuple[int, int]:
    """(tiles, pieces in a tile): as even as can be, in whole vectors of 8."""
    tiles = -(-pieces // TILE)
    return tiles, -(-pieces // (8 * tiles)) * 8


@dataclass(frozen=True, eq=False)
class PieceOperator(LinearOperator):
    """Datacube → snapshots (shot, y, x) for any code, shear and pieces: each piece of a row sees its own columns of the code.

    Attributes
    ----------
    code : (shot, y, x) transmittance, with a row for every row of the cube.
    pieces : intervals of a row, each in a column of the cube and of the detector.
    table : columns and weights of every piece in every band.
    cube_shape : (band, y, x).
    detector_shape : (y, x) elements.
    """

    code: np.ndarray
    pieces: Pieces
    table: ColumnTable
    cube_shape: Shape
    detector_shape: tuple[int, int]

    @property
    def in_shape(self) -> Shape:
        """(band, y, x) of the datacube."""
        return self.cube_shape

    @property
    def out_shape(self) -> Shape:
        """(shot, y, x) of the snapshots."""
        return (len(self.code), *self.detector_shape)

    @cached_property
    def _padded(self) -> tuple[np.ndarray, np.ndarray]:
        """The code with closed columns beside it, and the first column of every (band, piece) in it."""
        reach = self.table.weights.shape[0]
        code = np.pad(self.code, ((0, 0), (0, 0), (reach, reach)))
        return code, np.clip(self.table.first, -reach, self.code.shape[2]) + reach

    @cached_property
    def _by_shots(self) -> np.ndarray:
        """The padded code as (group, y, x, 8 shots) float32: eight shots of one element side by side."""
        code = self._padded[0]
        groups = -(-len(code) // 8)
        grouped = np.zeros((groups, *code.shape[1:], 8), np.float32)
        for q, shot in enumerate(code):
            grouped[q // 8, ..., q % 8] = shot
        return grouped

    def _forward(self, x: np.ndarray, out: np.ndarray) -> None:
        run_chunks(kernels.gray_forward, self.detector_shape[0], 8, x, *self._geometry(x.dtype), out)

    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None:
        run_chunks(kernels.gray_adjoint, self.detector_shape[0], 8, y, *self._geometry(y.dtype), out)

    def _geometry(self, dtype: np.dtype) -> tuple[np.ndarray, ...]:
        weights = np.ascontiguousarray(self.table.weights, dtype)
        return self._by_shots, *self._columns, weights, self.pieces.voxel, self.pieces.detector

    @cached_property
    def _columns(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """First column of every piece, how many it sees in all bands, and how far ahead (band, piece) each band begins."""
        first = self._padded[1]
        ahead = first - first[0]
        return first[0], ahead[-1] + self.table.weights.shape[0], ahead


@dataclass(frozen=True, eq=False)
class SSCSIOperator(LinearOperator):
    """Datacube (band, y, x) → snapshots (shot, y, x) through an `SSCSI` and a code (shot, y, x)."""

    imager: SSCSI
    code: np.ndarray

    @property
    def in_shape(self) -> Shape:
        """(band, y, x) of the datacube."""
        return self.imager.resolution.cube_shape

    @property
    def out_shape(self) -> Shape:
        """(shot, y, x) of the snapshots."""
        return (len(self.code), *self.imager.detector_shape)

    @property
    def _packed(self) -> bool:
        return self.imager._table.unit_shear and self.code.dtype == np.uint8

    @cached_property
    def _masks(self) -> np.ndarray:
        """(y, group, tile, column, piece) uint8: bit q of group g is the mask of shot 8g + q at first[0, piece] + column."""
        table = self.imager._table
        columns = table.first.shape[0] + table.weights.shape[0] - 1
        packed = np.packbits(self.code, axis=0, bitorder="little")
        tiles, size = _tiling(table.first.shape[1])
        masks = np.empty((packed.shape[1], packed.shape[0], tiles, columns, size), np.uint8)
        run_chunks(kernels.pack_masks, packed.shape[1], 16, packed, table.first[0], masks)
        return masks

    @cached_property
    def _band_weights(self) -> np.ndarray:
        """(tile, 3, piece) float64 weights, the same in every band: a piece and a band of one column reach three columns."""
        weights = self.imager._table.weights[:, 0]
        reach, pieces = weights.shape
        tiles, size = _tiling(pieces)
        padded = np.pad(weights, ((0, 3 - reach), (0, tiles * size - pieces)))
        return np.ascontiguousarray(padded.reshape(3, tiles, size).swapaxes(0, 1))

    @cached_property
    def _gray(self) -> PieceOperator:
        """The same operator by the kernels for any code and shear."""
        imager = self.imager
        return PieceOperator(self.code, imager._pieces, imager._table, self.in_shape, imager.detector_shape)

    def _forward(self, x: np.ndarray, out: np.ndarray) -> None:
        if not self._packed:
            self._gray._forward(x, out)
            return
        pieces, weights = self.imager._pieces, self._band_weights.astype(x.dtype)
        rows = self.out_shape[1]
        run_chunks(kernels.packed_forward, rows, 8, x, self._masks, weights, pieces.voxel, pieces.detector, out)

    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None:
        if not self._packed:
            self._gray._adjoint(y, out)
            return
        pieces, weights = self.imager._pieces, self._band_weights.astype(y.dtype)
        rows = self.out_shape[1]
        run_chunks(kernels.packed_adjoint, rows, 8, y, self._masks, weights, pieces.voxel, pieces.detector, out)


@shot_gram.register
def _(A: SSCSIOperator) -> np.ndarray | None:
    if A.imager.resolution.regime != DETECTOR_LIMITED:
        return None  # a voxel can fall on two detector elements, which couples them
    shots, rows, columns = A.out_shape
    gram = np.empty((shots, shots, rows, columns))
    code, first = A._gray._padded
    run_chunks(kernels.gray_gram, rows, 8, code, first, A.imager._table.weights, gram)
    return gram
