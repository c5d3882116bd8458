"""TIFF and BigTIFF files, OME-TIFF among them: a strict reader of arrays that are kept as pages or as samples.

Every offset and length is compared with the size of the file before it is used, and what is declared before it is
allocated. Formats: TIFF, revision 6.0, Aldus 1992; BigTIFF, libtiff; OME-TIFF in `ome`; decompression in
`tiff_segments`. Why not with a library: docs/decisions/0013-formats.md.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, Literal

import numpy as np

from .contents import Contents, Variable, check_size, unreadable
from .ome import Description, describe
from .tiff_segments import Layout, read_page

MAGICS = (b"II*\0", b"MM\0*", b"II+\0\x08\0\0\0", b"MM\0+\0\x08\0\0")
_CODES = {1: "B", 2: "B", 3: "H", 4: "I", 6: "b", 7: "B", 8: "h", 9: "i", 13: "I", 16: "Q", 17: "q", 18: "Q"}
Numbers = Sequence[int] | np.ndarray
_MOST_PAGES = 100_000
_LONGEST_DESCRIPTION = 16 * 2**20
_REDUCED = 1  # bit of the subfile type: a small copy of another page
_RGB = 2
_PHOTOMETRIC = {3: "a palette", 5: "CMYK", 6: "YCbCr", 8: "CIELab"}
_FAX = "a fax code"
_COMPRESSIONS = {2: _FAX, 3: _FAX, 4: _FAX, 6: "JPEG", 7: "JPEG", 34712: "JPEG 2000"} | {
    34887: "LERC",
    34925: "LZMA",
    50000: "Zstandard",
    50001: "WebP",
}
_READABLE = (1, 5, 8, 32946, 32773)
_WANTED = {
    254: "subfile",
    256: "width",
    257: "height",
    258: "bits",
    259: "compression",
    262: "photometric",
    266: "fill",
    270: "description",
    273: "offsets",
    277: "samples",
    278: "rows",
    279: "counts",
    284: "planar",
    317: "predictor",
    322: "tile_width",
    323: "tile_height",
    324: "offsets",
    325: "counts",
    339: "format",
}
_ONE = {"subfile": 0, "compression": 1, "photometric": 1, "fill": 1, "samples": 1, "planar": 1, "predictor": 1}


@dataclass(frozen=True)
class _Page:
    """A page: how it is laid out, where its pieces lie, and why it cannot be read, if so."""

    layout: Layout
    offsets: np.ndarray
    counts: np.ndarray
    reduced: bool
    photometric: int
    problem: str


class _Tags:
    """The tags of the file's directories, read within limits that a whole file never reaches."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        self._file, self._size = file, size
        self.places: set[tuple[int, int]] = set()  # start and end of what was read
        self._budget = 2**20 + size  # of bytes; directories that overlap could ask for any number
        head = self._at(0, 8)
        self.order: Literal["<", ">"] = "<" if head[:2] == b"II" else ">"
        self.big = head[:4] in (b"II+\0", b"MM\0+")
        self.first = self._number(self._at(8, 8), 0, 8) if self.big else self._number(head, 4, 4)

    def _at(self, offset: int, length: int) -> bytes:
        self._budget -= length
        if length < 0 or offset + length > self._size or self._budget < 0:
            raise ValueError("a directory or a list in it reaches beyond its end; it is truncated or damaged")
        self.places.add((offset, offset + length))
        self._file.seek(offset)
        return self._file.read(length)

    def _number(self, data: bytes, at: int, width: int) -> int:
        if at + width > len(data):
            raise ValueError("it is truncated")
        return struct.unpack_from(self.order + {2: "H", 4: "I", 8: "Q"}[width], data, at)[0]

    def directory(self, offset: int) -> tuple[dict[str, Numbers], int]:
        """The tags of the directory at `offset` that matter, by name, and where the next directory is (0: nowhere)."""
        wide = 8 if self.big else 4
        count = self._number(self._at(offset, 8 if self.big else 2), 0, 8 if self.big else 2)
        if not 0 < count <= 4096:
            raise ValueError(f"a directory in it claims {count} entries; it is damaged")
        entry = 4 + 2 * wide
        start = offset + (8 if self.big else 2)
        body = self._at(start, count * entry + wide)
        tags: dict[str, Numbers] = {}
        for at in range(0, count * entry, entry):
            name = _WANTED.get(self._number(body, at, 2))
            if name is not None:
                if name in tags:
                    raise ValueError(f"a directory in it says its {name} twice; it is damaged")
                tags[name] = self._values(body, at, start + at, name)
        return tags, self._number(body, count * entry, wide)

    def _values(self, body: bytes, at: int, place: int, name: str) -> Numbers:
        wide = 8 if self.big else 4
        kind, count = self._number(body, at + 2, 2), self._number(body, at + 4, wide)
        if kind not in _CODES or (kind == 2) != (name == "description") or count == 0:
            raise ValueError(f"the {name} of a page is of the wrong type; it is damaged")
        if count > 65_535 and name not in ("offsets", "counts", "description"):
            raise ValueError(f"a page has {count} values of its {name}; it is damaged")
        length = count * struct.calcsize(_CODES[kind])
        offset = place + 4 + wide if length <= wide else self._number(body, at + 4 + wide, wide)
        if name == "description":  # only the first is of use, and it may be long
            return (offset, min(length, _LONGEST_DESCRIPTION))
        data = self._at(offset, length)
        if name in ("offsets", "counts"):  # of which there may be millions
            found = np.frombuffer(data, f"{self.order}{_CODES[kind]}")
            if found.dtype.kind != "u":
                raise ValueError(f"the {name} of a page are of the wrong type; it is damaged")
            return np.minimum(found.astype(np.uint64), np.uint64(self._size)).astype(
                np.int64
            )  # what is beyond the end is refused as that is
        return struct.unpack(f"{self.order}{count}{_CODES[kind]}", data)

    def text(self, place: Numbers) -> str:
        """The description at an offset and of a length."""
        return self._at(int(place[0]), int(place[1])).split(b"\0")[0].decode("utf-8", errors="replace")


def tiff_contents(path: Path) -> Contents:
    """The arrays of a file: pages of one size and type together, as bands; the wavelengths where it says them."""
    size = path.stat().st_size
    with path.open("rb") as file:
        tags = _Tags(file, size)
        pages, text = _pages(tags, size)
    groups: dict[tuple, list[_Page]] = {}
    for page in pages:
        layout = page.layout
        key = (layout.shape, layout.dtype, layout.bits, layout.inverted, page.problem)
        groups.setdefault(key, []).append(page)
    said = describe(text)
    notes = list(said.notes)
    names = [said.name or path.stem] if len(groups) == 1 else [f"image{i}" for i in range(1, len(groups) + 1)]
    main = max(groups.values(), key=len)
    if said.planes not in (0, len(main), len(main) * main[0].layout.samples):
        raise ValueError(
            f"its description says {said.planes} planes, and there are {len(main)} pages of one kind; "
            "it is truncated, or the others are in other files"
        )
    variables: dict[str, Variable] = {}
    for name, group in zip(names, groups.values(), strict=True):
        variables[name] = _variable(path, size, group, said if group is main else Description())
    if said.wavelengths is not None:
        centres = np.array(said.wavelengths)
        variables["wavelength"] = Variable(centres.shape, centres.dtype, lambda: centres, attrs={"units": "nm"})
    return Contents(variables, notes)


def _pages(tags: _Tags, size: int) -> tuple[list[_Page], str]:
    """All pages but small copies of others, and the description of the first."""
    pages: list[_Page] = []
    seen: set[int] = set()
    text, at = "", tags.first
    while at:
        if at in seen or len(seen) >= _MOST_PAGES:
            raise ValueError("its directories go round in a circle; it is damaged")
        seen.add(at)
        found, at = tags.directory(at)
        if len(seen) == 1 and "description" in found:
            text = tags.text(found["description"])
        pages.append(_page(found, tags.order, size))
    _check_overlaps(pages, tags.places)
    kept = [page for page in pages if not page.reduced] or pages
    if not kept:
        raise ValueError("there are no pages in it; it is truncated or damaged")
    return kept, text


def _check_overlaps(pages: list[_Page], places: set[tuple[int, int]]) -> None:
    """Refuse data that lie over each other or over the directories; they may be the same altogether."""
    read = [page for page in pages if not page.problem]
    if not read:
        return
    starts = np.concatenate([page.offsets for page in read])
    sizes = [_stored_bytes(page.layout) if page.layout.compression == 1 else page.counts for page in read]
    data = np.unique(np.column_stack([starts, starts + np.concatenate(sizes)]), axis=0)
    others = np.array(sorted(places), np.int64)
    both = np.concatenate([data, others])
    is_data = np.arange(len(both)) < len(data)
    order = np.lexsort((both[:, 1], both[:, 0]))
    both, is_data = both[order], is_data[order]
    for stops, against in ((both[:, 1], is_data), (np.where(is_data, both[:, 1], 0), np.ones(len(both), bool))):
        end = np.maximum.accumulate(stops)[:-1]
        if (against[1:] & (both[1:, 0] < end)).any():
            raise ValueError("the data of its pages lie over each other or over its directories; it is damaged")


def _stored_bytes(layout: Layout) -> np.ndarray:
    """Bytes of each piece when it is not compressed."""
    rows = np.full(layout.grid[0], layout.piece[0])
    if not layout.tiled:
        rows[-1] = layout.height - (layout.grid[0] - 1) * layout.piece[0]
    return np.tile(
        np.repeat(rows * layout.row_bytes, layout.grid[1]), layout.pieces // (layout.grid[0] * layout.grid[1])
    )


def _page(found: dict[str, Numbers], order: Literal["<", ">"], size: int) -> _Page:
    for name in ("width", "height", "offsets", "counts"):
        if name not in found:
            raise ValueError(f"the {name} of a page is not said in it; it is damaged")
    one = {name: int(found.get(name, (missing,))[0]) for name, missing in _ONE.items()}
    for name in (*_ONE, "width", "height", "rows", "tile_width", "tile_height"):
        if len(found.get(name, (0,))) != 1:
            raise ValueError(f"the {name} of a page must be one number; it is damaged")
    layout = _layout(found, one, order)
    check_size((layout.height, layout.width, layout.samples), max(1, layout.bits // 8), size)
    check_size((layout.piece[0], layout.row_bytes), 1, size)
    problem = _problem(layout, one["photometric"], one["fill"])
    offsets, counts = np.asarray(found["offsets"]), np.asarray(found["counts"])
    if not problem:
        _check_pieces(layout, offsets, counts, size)
    return _Page(layout, offsets, counts, bool(one["subfile"] & _REDUCED), one["photometric"], problem)


def _layout(found: dict[str, Numbers], one: dict[str, int], order: Literal["<", ">"]) -> Layout:
    height, width, samples = int(found["height"][0]), int(found["width"][0]), one["samples"]
    tiled = "tile_width" in found or "tile_height" in found
    strip = (min(int(found.get("rows", (height,))[0]), height), width)
    tile = (int(found.get("tile_height", (0,))[0]), int(found.get("tile_width", (0,))[0]))
    piece = tile if tiled else strip
    bits, formats = set(found.get("bits", (1,))), set(found.get("format", (1,)))
    if min(height, width, samples, *piece) < 1 or len(bits) != 1 or samples > 65535 or one["planar"] not in (1, 2):
        raise ValueError("the size of a page, or the number or the kind of its samples, is damaged")
    return Layout(
        order=order,
        height=height,
        width=width,
        samples=samples,
        planar=one["planar"] == 2 and samples > 1,
        bits=int(next(iter(bits))),
        format=int(next(iter(formats))) if len(formats) == 1 else 0,
        piece=piece,
        tiled=tiled,
        compression=one["compression"],
        predictor=one["predictor"],
        inverted=one["photometric"] == 0,
    )


def _problem(layout: Layout, photometric: int, fill: int) -> str:
    if layout.compression not in _READABLE:
        how = _COMPRESSIONS.get(layout.compression, f"method {layout.compression}")
        return f"compressed with {how}, which is not read; save it without compression, or with LZW or Deflate"
    if photometric in _PHOTOMETRIC:
        return f"a picture in colours of the kind {_PHOTOMETRIC[photometric]}; save it in grey"
    if layout.format in (5, 6):
        return "complex numbers; save their real part or their magnitude"
    if layout.dtype is None or fill != 1 or layout.predictor not in (1, 2, 3):
        return f"samples of {layout.bits} bits of a kind that is not read; save it with 8 or 16 bits, or as float32"
    if layout.predictor == 3 and layout.dtype.kind != "f":
        return "compressed with a predictor that does not fit its samples; it is damaged"
    return ""


def _check_pieces(layout: Layout, offsets: np.ndarray, counts: np.ndarray, size: int) -> None:
    if len(offsets) != layout.pieces or len(counts) != layout.pieces:
        raise ValueError(
            f"a page has {len(offsets)} pieces of data where there should be {layout.pieces}; it is truncated or damaged"
        )
    wrong = (offsets < 8) | (counts < 1) | (counts > size - offsets)
    if layout.compression == 1:
        # The last strip may be padded to the size of the others, and any to a multiple of four bytes.
        wrong |= (counts < _stored_bytes(layout)) | (counts > layout.piece[0] * layout.row_bytes + 4)
    if wrong.any():
        raise ValueError("the data of a page are missing or reach beyond its end; it is truncated or damaged")


def _variable(path: Path, size: int, pages: list[_Page], said: Description) -> Variable:
    layout = pages[0].layout
    if pages[0].problem or layout.dtype is None:
        return unreadable(pages[0].problem)
    if len(pages) > 1 and layout.samples > 1:
        return unreadable(f"{len(pages)} pages of {layout.samples} samples a pixel; save a page a band")
    if said.stacks > 1:
        return unreadable("a stack of more than three axes (channels, planes, times); save one of them")
    one_band = len(pages) == 1 and layout.samples == 1 and said.wavelengths is None
    shape = (len(pages), *layout.shape) if layout.samples == 1 and not one_band else layout.shape
    dims = (
        ("y", "x") if one_band else ("y", "x", "band") if len(shape) == 3 and layout.interleaved else ("band", "y", "x")
    )
    check_size(shape, layout.dtype.itemsize, size)
    attrs = {"colours": "RGB"} if pages[0].photometric == _RGB and layout.samples in (3, 4) else {}
    return Variable(shape, layout.dtype, partial(_load, path, pages, shape), dims, attrs)


def _load(path: Path, pages: list[_Page], shape: tuple[int, ...]) -> np.ndarray:
    layout = pages[0].layout
    assert layout.dtype is not None
    values = np.empty((len(pages), *layout.shape), layout.dtype)
    with path.open("rb") as file:
        for page, into in zip(pages, values, strict=True):
            read_page(file, page.layout, page.offsets, page.counts, into)
    return values.reshape(shape)
