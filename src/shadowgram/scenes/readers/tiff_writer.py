"""Writing a datacube as an OME-TIFF: a page a band, one strip a page, not compressed."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence

import numpy as np

from .ome import ome_type, ome_xml

_SHORT, _LONG, _ASCII, _LONG8 = 3, 4, 2, 16
_FORMATS = {"u": 1, "b": 1, "i": 2, "f": 3}
_SMALL = 2**32 - 2**24  # bytes; larger files are BigTIFF


def ome_tiff(
    values: np.ndarray, wavelengths: Sequence[float] | np.ndarray | None, name: str
) -> Iterator[bytes | memoryview]:
    """The parts of a file, one after the other: header, description, pages, directories.

    Parameters
    ----------
    values : (band, y, x) real numbers.
    wavelengths : (band,) nm, or None where they are not known.
    name : what the picture is called.
    """
    dtype = ome_type(values.dtype).newbyteorder("<")
    bands, height, width = values.shape
    text = ome_xml(values.shape, dtype, wavelengths, name) + b"\0"
    text += b"\0" * (-len(text) % 16)
    page = height * width * dtype.itemsize
    big = 16 + len(text) + bands * (page + 512) > _SMALL
    first_page = 16 + len(text)
    directories = first_page + bands * page + (-bands * page) % 16
    yield _header(big, directories)
    yield text
    for band in values:
        yield np.ascontiguousarray(band, dtype).view(np.uint8).data
    yield b"\0" * ((-bands * page) % 16)
    at = directories
    for i in range(bands):
        tags = [
            *((256, _LONG, 1, width), (257, _LONG, 1, height), (258, _SHORT, 1, 8 * dtype.itemsize)),
            *((259, _SHORT, 1, 1), (262, _SHORT, 1, 1)),
            *([(270, _ASCII, len(text), 16)] if i == 0 else []),
            (273, _LONG8 if big else _LONG, 1, first_page + i * page),
            *((277, _SHORT, 1, 1), (278, _LONG, 1, height)),
            (279, _LONG8 if big else _LONG, 1, page),
            (339, _SHORT, 1, _FORMATS[dtype.kind]),
        ]
        length = 16 + 20 * len(tags) if big else 6 + 12 * len(tags)
        length += -length % 8
        yield _directory(tags, big, 0 if i == bands - 1 else at + length).ljust(length, b"\0")
        at += length


def _header(big: bool, first: int) -> bytes:
    return struct.pack("<2sHHHQ", b"II", 43, 8, 0, first) if big else struct.pack("<2sHIQ", b"II", 42, first, 0)


def _directory(tags: list[tuple[int, int, int, int]], big: bool, following: int) -> bytes:
    count, entry, last = ("<Q", "<HHQ", "<Q") if big else ("<H", "<HHI", "<I")
    parts = [struct.pack(count, len(tags))]
    for tag, kind, number, value in tags:
        short = struct.pack({_SHORT: "<H", _LONG8: "<Q"}.get(kind, "<Q" if big and kind == _ASCII else "<I"), value)
        parts.append(struct.pack(entry, tag, kind, number) + short.ljust(8 if big else 4, b"\0"))
    return b"".join(parts) + struct.pack(last, following)
