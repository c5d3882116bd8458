"""The strips and tiles of a TIFF page: where they go, and how they are decompressed.

Source: TIFF, revision 6.0, Aldus 1992, sections 9 (PackBits), 13 (LZW), 14 (differencing), 15 (tiles); Adobe Photoshop
TIFF Technical Notes 2002 (Deflate) and 3 (differences of floating-point numbers).
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from math import ceil
from typing import IO, Literal

import numpy as np

_TYPES = {1: "u", 2: "i", 3: "f"}


@dataclass(frozen=True)
class Layout:
    """How the samples of a page lie in the file; `piece` is the size (y, x) of a strip or tile."""

    order: Literal["<", ">"]
    height: int
    width: int
    samples: int
    planar: bool
    bits: int
    format: int
    piece: tuple[int, int]
    tiled: bool
    compression: int
    predictor: int
    inverted: bool

    @property
    def dtype(self) -> np.dtype | None:
        """Type of the samples; None where it is not one that arrays have."""
        kind = _TYPES.get(self.format, "u" if self.format == 4 else "")
        if not kind or (kind == "f" and self.bits < 16):
            return None
        if self.bits in (8, 16, 32, 64):
            return np.dtype(f"{kind}{self.bits // 8}")
        return np.dtype(np.uint8 if self.bits < 8 else np.uint16) if self.bits < 16 and kind == "u" else None

    @property
    def interleaved(self) -> bool:
        """Whether the samples of a pixel lie side by side."""
        return self.samples > 1 and not self.planar

    @property
    def shape(self) -> tuple[int, ...]:
        """(y, x), (y, x, sample) or (sample, y, x)."""
        size = (self.height, self.width)
        return size if self.samples == 1 else (self.samples, *size) if self.planar else (*size, self.samples)

    @property
    def across(self) -> int:
        """Samples that lie side by side."""
        return 1 if self.planar else self.samples

    @property
    def grid(self) -> tuple[int, int]:
        """How many pieces there are along y and x."""
        return ceil(self.height / self.piece[0]), ceil(self.width / self.piece[1])

    @property
    def pieces(self) -> int:
        """How many pieces there are."""
        return self.grid[0] * self.grid[1] * (self.samples if self.planar else 1)

    @property
    def row_bytes(self) -> int:
        """Bytes a row of a piece."""
        return (self.piece[1] * self.across * self.bits + 7) // 8

    def rows(self, index: int) -> int:
        """Rows of a piece; the last strip may have fewer than the others, tiles are padded."""
        row = index // self.grid[1] % self.grid[0]
        return self.piece[0] if self.tiled else min(self.piece[0], self.height - row * self.piece[0])

    def piece_bytes(self, index: int) -> int:
        """Bytes of a piece when it is not compressed."""
        return self.rows(index) * self.row_bytes


def read_page(file: IO[bytes], layout: Layout, offsets: np.ndarray, counts: np.ndarray, into: np.ndarray) -> None:
    """Put the pieces of a page, which lie at these places of the file, into an array of the page's shape and type."""
    planes = into if layout.planar else into[None]
    down, along = layout.grid
    for index, (offset, count) in enumerate(zip(offsets.tolist(), counts.tolist(), strict=True)):
        y, x = index // along % down * layout.piece[0], index % along * layout.piece[1]
        file.seek(offset)
        values = _samples(_unpacked(file.read(count), layout, layout.piece_bytes(index)), layout, layout.rows(index))
        place = planes[index // (down * along)][y : y + layout.piece[0], x : x + layout.piece[1]]
        place[...] = values[: place.shape[0], : place.shape[1]].reshape(place.shape)


def _unpacked(data: bytes, layout: Layout, size: int) -> np.ndarray:
    """So many bytes of a piece."""
    if layout.compression == 1:
        raw = np.frombuffer(data, np.uint8)[:size]
    elif layout.compression in (8, 32946):
        raw = np.frombuffer(_inflated(data, size), np.uint8)
    else:
        from . import _tiff_kernels as kernels

        raw = np.empty(size + 1, np.uint8)  # room for one byte more, which would be one too many
        decode = kernels.decode_lzw if layout.compression == 5 else kernels.decode_packbits
        raw = raw[: decode(np.frombuffer(data, np.uint8), raw)]
    if len(raw) != size:
        raise ValueError("the data of a page do not have the length that follows from its size; it is damaged")
    return raw


def _inflated(data: bytes, size: int) -> bytes:
    inflate = zlib.decompressobj()
    try:
        # Room for one byte more, so that zlib reaches the checksum at the end and compares it.
        raw = inflate.decompress(data, size + 1)
    except zlib.error as error:
        raise ValueError(f"the data of a page cannot be decompressed ({error}); it is damaged") from error
    if not inflate.eof:
        raise ValueError("the compressed data of a page do not end where its size does; it is truncated or damaged")
    return raw


def _samples(raw: np.ndarray, layout: Layout, rows: int) -> np.ndarray:
    """(y, x, sample) of a piece."""
    assert layout.dtype is not None
    shape = (rows, layout.piece[1], layout.across)
    if layout.bits < 8 or layout.bits % 8:
        values = _from_bits(raw, layout, rows).reshape(shape)
    elif layout.predictor == 3:
        values = _from_byte_planes(raw, layout, rows).reshape(shape)
    else:
        values = raw.view(np.dtype(layout.dtype).newbyteorder(layout.order)).reshape(shape)
    if layout.predictor == 2:
        whole = np.dtype(f"u{layout.dtype.itemsize}")
        steps = values.astype(layout.dtype).view(whole)
        values = np.add.accumulate(steps, axis=1, dtype=whole).view(layout.dtype)
    if layout.inverted and layout.dtype.kind == "u":  # 0 is white
        values = (2**layout.bits - 1) - values.astype(layout.dtype)
    return values


def _from_bits(raw: np.ndarray, layout: Layout, rows: int) -> np.ndarray:
    """Whole numbers of less than 16 bits, packed in a row without gaps."""
    across = layout.piece[1] * layout.across
    bits = np.unpackbits(raw.reshape(rows, layout.row_bytes), axis=1)[:, : across * layout.bits]
    weights = 1 << np.arange(layout.bits, dtype=layout.dtype)[::-1]
    return bits.reshape(rows, across, layout.bits) @ weights


def _from_byte_planes(raw: np.ndarray, layout: Layout, rows: int) -> np.ndarray:
    """Floating-point numbers whose bytes were sorted, the highest of a row first, and replaced by differences."""
    assert layout.dtype is not None
    steps = raw.reshape(rows, -1, layout.across)
    planes = np.add.accumulate(steps, axis=1, dtype=np.uint8).reshape(rows, layout.dtype.itemsize, -1)
    return np.ascontiguousarray(planes.transpose(0, 2, 1)).view(np.dtype(layout.dtype).newbyteorder(">"))
