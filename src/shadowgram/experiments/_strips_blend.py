"""The cube made of the files of its strips: a few rows at a time, and between neighbours a smooth passage."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ._strips_plan import Strip
from ._strips_work import piece_path


@dataclass(frozen=True, kw_only=True)
class Pieces:
    """Files with the rows of strips.

    Attributes
    ----------
    folder : where they are.
    strips : which rows of the detector they hold, in order.
    ratio : rows of the cube for a row of the detector.
    bands, columns : of the cube.
    """

    folder: Path
    strips: Sequence[Strip]
    ratio: int
    bands: int
    columns: int

    def rows(self, start: int, stop: int) -> np.ndarray:
        """(band, stop − start, x) float32; rows of the cube, where strips overlap the weighted mean of them."""
        total = np.zeros((self.bands, stop - start, self.columns), np.float32)
        weights = np.zeros(stop - start)
        for strip in self.strips:
            a, b = max(start, self.ratio * strip.first), min(stop, self.ratio * strip.last)
            if a < b:
                weights[a - start : b - start] += self._weights(strip)[a - self.ratio * strip.first :][: b - a]
        for strip in self.strips:
            a, b = max(start, self.ratio * strip.first), min(stop, self.ratio * strip.last)
            if a < b:
                share = self._weights(strip)[a - self.ratio * strip.first :][: b - a] / weights[a - start : b - start]
                # A share of 1 leaves the values as they are, to the last bit.
                total[:, a - start : b - start] += share.astype(np.float32)[:, None] * self._read(strip, a, b)
        return total

    def _weights(self, strip: Strip) -> np.ndarray:
        """Of each row of a strip: falling to its ends as sin², over its own halo and as far into its neighbour's share of rows."""
        rows = np.arange(self.ratio * (strip.last - strip.first)) + 0.5
        weights = np.ones(rows.size)
        if strip.first > 0:
            weights *= _ramp(rows, 2 * self.ratio * (strip.start - strip.first))
        if strip.last < self.strips[-1].last:
            weights *= _ramp(rows.size - rows, 2 * self.ratio * (strip.last - strip.stop))
        return weights

    def _read(self, strip: Strip, start: int, stop: int) -> np.ndarray:
        """(band, stop − start, x) float32; these rows of the cube from the file of a strip."""
        rows = self.ratio * (strip.last - strip.first)
        first = start - self.ratio * strip.first
        values = np.empty((self.bands, stop - start, self.columns), "<f4")
        with piece_path(self.folder, strip).open("rb") as file:
            for k in range(self.bands):
                file.seek(4 * self.columns * (k * rows + first))
                if file.readinto(values[k].data.cast("B")) < values[k].nbytes:
                    raise ValueError(f"{piece_path(self.folder, strip)} is cut; run again to compute it anew")
        return values


def _ramp(distance: np.ndarray, width: int) -> np.ndarray:
    if width == 0:
        return np.ones(distance.size)
    return np.sin(math.pi / 2 * np.clip(distance / width, 0, 1)) ** 2


def is_whole(folder: Path, strip: Strip, values: Mapping[str, object]) -> bool:
    """Whether the file of a strip is there, and as it was written."""
    path = piece_path(folder, strip)
    if not path.exists():
        return False
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest() == values["sha256"]
