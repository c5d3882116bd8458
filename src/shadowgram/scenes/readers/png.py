"""PNG pictures, read and written with the standard library: the package's picture library belongs to `figures`.

Format: Portable Network Graphics (PNG) Specification, 2nd edition, W3C 2003; everything but interlaced pictures.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .contents import Variable, check_size

MAGIC = b"\x89PNG\r\n\x1a\n"
_GREY, _COLOUR, _PALETTE, _GREY_ALPHA, _COLOUR_ALPHA = 0, 2, 3, 4, 6
_SAMPLES = {_GREY: 1, _COLOUR: 3, _PALETTE: 1, _GREY_ALPHA: 2, _COLOUR_ALPHA: 4}  # a pixel
_DEPTHS = {_GREY: (1, 2, 4, 8, 16), _PALETTE: (1, 2, 4, 8)}
_HEAD = 33  # bytes of signature and header chunk


@dataclass(frozen=True)
class _Head:
    width: int
    height: int
    depth: int
    colour: int

    @property
    def stride(self) -> int:
        """Bytes a row."""
        return (self.width * _SAMPLES[self.colour] * self.depth + 7) // 8

    @property
    def dtype(self) -> np.dtype:
        return np.dtype(np.uint16 if self.depth == 16 else np.uint8)


@dataclass(frozen=True, eq=False)
class Picture:
    """Samples (y, x, channel), uint8 or uint16, transparency left out; `full` is the largest that they may be."""

    samples: NDArray[np.unsignedinteger]
    full: int


def png_variables(path: Path) -> dict[str, Variable]:
    """The one grey picture (y, x) of a file, by the file's name; its samples are read as they are stored."""
    with path.open("rb") as file:
        head = _head(file.read(_HEAD), path.stat().st_size)
    shape = (head.height, head.width)
    return {path.stem: Variable(shape, head.dtype, lambda: read_grey(path), ("y", "x"))}


def read_grey(path: Path) -> NDArray[np.unsignedinteger]:
    """Samples (y, x) of a grey picture, or of one in colours that are all grey.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is not a PNG picture, damaged, interlaced or coloured.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from shadowgram.scenes.readers.png import png_bytes, read_grey
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "band.png"
    >>> _ = path.write_bytes(png_bytes(np.array([[0, 40_000]], np.uint16)))
    >>> read_grey(path)
    array([[    0, 40000]], dtype=uint16)
    """
    samples = read_picture(path).samples
    if (samples != samples[..., :1]).any():
        raise ValueError("it is a picture in colours; a grey one is needed")
    return samples[..., 0]


def read_picture(path: Path) -> Picture:
    """Samples of a picture of any kind; a palette's colours are looked up.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is not a PNG picture, damaged, or interlaced.
    """
    data = path.read_bytes()
    head = _head(data[:_HEAD], len(data))
    palette, packed, ended = b"", [], False
    for kind, body in _chunks(data):
        if kind == b"PLTE":
            palette = body
        elif kind == b"IDAT":
            packed.append(body)
        ended = kind == b"IEND"
    if not ended:
        raise ValueError("it is truncated")
    samples = _samples(b"".join(packed), head).reshape(head.height, head.width, -1)
    if head.colour == _PALETTE:
        return Picture(_looked_up(samples[..., 0], palette), 255)
    shown = samples[..., : 3 if head.colour in (_COLOUR, _COLOUR_ALPHA) else 1]
    return Picture(shown, 2**head.depth - 1)


def _head(start: bytes, file_size: int) -> _Head:
    if not start.startswith(MAGIC):
        raise ValueError("it does not begin like a PNG picture")
    if len(start) < _HEAD:
        raise ValueError("it is truncated")
    if start[8:16] != b"\0\0\0\x0dIHDR" or zlib.crc32(start[12:29]) != int.from_bytes(start[29:], "big"):
        raise ValueError("its header is damaged")
    width, height, depth, colour, packing, filtering, interlaced = struct.unpack(">IIBBBBB", start[16:29])
    if interlaced == 1:
        raise ValueError("it is interlaced; save it without interlacing")
    if depth not in _DEPTHS.get(colour, (8, 16)) or colour not in _SAMPLES or packing or filtering or interlaced:
        raise ValueError("its header is damaged")
    if not 0 < width < 2**31 or not 0 < height < 2**31:
        raise ValueError("it has no pixels")
    head = _Head(width, height, depth, colour)
    check_size((height, head.stride + 1), 1 if depth >= 8 else 8 // depth, file_size)
    return head


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = len(MAGIC)
    while at < len(data):
        if at + 12 > len(data):
            raise ValueError("it is truncated")
        length, kind = struct.unpack_from(">I4s", data, at)
        body = data[at + 8 : at + 8 + length]
        check = data[at + 8 + length : at + 12 + length]
        if len(check) < 4 or zlib.crc32(kind + body) != int.from_bytes(check, "big"):
            raise ValueError("it is truncated or damaged")
        yield kind, body
        at += 12 + length


def _samples(packed: bytes, head: _Head) -> NDArray[np.unsignedinteger]:
    """(row, sample) of the picture data."""
    size = head.height * (head.stride + 1)
    inflate = zlib.decompressobj()
    try:
        # Room for one byte more, so that zlib reaches the checksum at the end and compares it.
        raw = inflate.decompress(packed, size + 1)
    except zlib.error as error:
        raise ValueError(f"its picture data are damaged ({error})") from error
    if len(raw) != size or not inflate.eof:
        raise ValueError("its picture data do not end where the picture does; it is truncated or damaged")
    whole = _unfiltered(np.frombuffer(raw, np.uint8).reshape(head.height, head.stride + 1), head)
    if head.depth == 16:
        return whole.view(">u2").astype(np.uint16)
    if head.depth == 8:
        return whole
    bits = np.unpackbits(whole, axis=1)[:, : head.width * head.depth].reshape(head.height, head.width, head.depth)
    return (bits @ (1 << np.arange(head.depth)[::-1])).astype(np.uint8)


def _unfiltered(lines: NDArray[np.uint8], head: _Head) -> NDArray[np.uint8]:
    """Rows with their filters undone."""
    kinds = np.ascontiguousarray(lines[:, 0])
    whole = lines[:, 1:].copy()
    if kinds.max() > 4:
        raise ValueError("its picture data are damaged")
    if kinds.any():
        from ._png_kernels import undo_filters

        undo_filters(kinds, whole, max(1, _SAMPLES[head.colour] * head.depth // 8))
    return whole


def _looked_up(index: NDArray[np.unsignedinteger], palette: bytes) -> NDArray[np.uint8]:
    colours = np.frombuffer(palette[: len(palette) // 3 * 3], np.uint8).reshape(-1, 3)
    if index.max() >= len(colours):
        raise ValueError("its palette is damaged")
    return colours[index]


def png_bytes(picture: NDArray[np.unsignedinteger]) -> bytes:
    """A grey PNG of 8 or 16 bits from (y, x) uint8 or uint16."""
    height, width = picture.shape
    depth = 8 * picture.dtype.itemsize
    rows = np.ascontiguousarray(picture, f">u{depth // 8}").view(np.uint8)
    lines = np.full((height, rows.shape[1] + 1), 2, np.uint8)  # filter 2: the difference from the row above
    lines[0, 1:] = rows[0]
    np.subtract(rows[1:], rows[:-1], out=lines[1:, 1:])
    head = struct.pack(">IIBBBBB", width, height, depth, _GREY, 0, 0, 0)
    return MAGIC + b"".join(
        _chunk(kind, body)
        for kind, body in ((b"IHDR", head), (b"IDAT", zlib.compress(lines.tobytes(), 4)), (b"IEND", b""))
    )


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
