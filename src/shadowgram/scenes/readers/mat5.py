"""Variables of MATLAB 5 to 7 `.mat` files: a strict reader of numeric arrays and short texts, in plain Python.

Every length is compared with what is there before it is used, so that a damaged file gives a `ValueError` and nothing
worse.
Format: "MAT-File Level 5 File Format", The MathWorks.
"""

from __future__ import annotations

import io
import re
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from math import prod
from pathlib import Path
from typing import IO, Literal

import numpy as np

from .contents import Variable, check_size, unreadable

_MATRIX, _COMPRESSED = 14, 15
_INT8, _INT32, _UINT32 = 1, 5, 6
_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_NUMERIC = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
_TEXT, _DOUBLE = 4, 6
_SMALL = {2: "u1", 4: "u2"}
_TEXT_CODES = {1: "utf-8", 2: "utf-8", 3: "utf-16", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_OTHERS = {
    1: "a cell array; save the array inside it as a variable of its own",
    2: "a struct; save its fields as variables, save(file, '-struct', ...)",
    3: "an object; save its values as an array",
    5: "a sparse array; save full(...) of it",
    16: "a function",
    17: "an object; save its values as an array",
}
_COMPLEX = "complex numbers; save real(...) or abs(...) of them"
_HEAD = 1024  # more than any variable's type, dimensions and name take


@dataclass(frozen=True)
class _Head:
    """What comes before a variable's values, and where in its element they begin."""

    kind: int
    complex: bool
    logical: bool
    shape: tuple[int, ...]
    name: str
    values: int


def mat5_variables(path: Path) -> dict[str, Variable]:
    """The variables of a MATLAB 5 file by name."""
    size = path.stat().st_size
    variables = {}
    with path.open("rb") as file:
        order = _byte_order(file.read(128))
        for kind, start, length in _elements(file, size, order):
            file.seek(start)
            body = file.read(min(length, 2 * _HEAD))
            if kind == _COMPRESSED:
                body = _inflated_start(body)
            head = _head(body[:_HEAD], order)
            if head.name:  # what has no name belongs to MATLAB's objects
                element = partial(_whole, path, kind, start, length, order, size)
                variables[head.name] = _variable(head, element, _stored_kind(body[:_HEAD], head, order), order, size)
    return variables


def _byte_order(header: bytes) -> Literal["<", ">"]:
    marks: dict[bytes, Literal["<", ">"]] = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}
    if header[124:128] not in marks:
        raise ValueError("its MATLAB header is truncated or damaged")
    return marks[header[124:128]]


def _elements(file: IO[bytes], size: int, order: str) -> Iterator[tuple[int, int, int]]:
    """Kind, start and length of each top-level element; a matrix starts at its tag, as it does when compressed."""
    at = 128
    while at < size:
        file.seek(at)
        tag = file.read(8)
        if len(tag) < 8:
            raise ValueError("it ends in the middle of a variable; it is truncated or damaged")
        kind, length = struct.unpack(order + "II", tag)
        if kind not in (_MATRIX, _COMPRESSED) or length > size - at - 8:
            raise ValueError("a variable in it is longer than the file or of no known kind; it is truncated or damaged")
        yield (kind, at + 8, length) if kind == _COMPRESSED else (kind, at, length + 8)
        at += 8 + length


def _inflated_start(body: bytes) -> bytes:
    """The first bytes of what was compressed."""
    try:
        return zlib.decompressobj().decompress(body, _HEAD)
    except zlib.error as error:
        raise ValueError(f"a variable in it cannot be decompressed ({error}); it is damaged") from error


def _head(body: bytes, order: str) -> _Head:
    """Type, dimensions and name of the matrix whose tag `body` begins with."""
    if len(body) < 16 or struct.unpack_from(order + "I", body)[0] != _MATRIX:
        raise ValueError("a variable in it does not begin like an array; it is damaged")
    kind, flags, at = _part(body, 8, order)
    if kind != _UINT32 or len(flags) != 8:
        raise ValueError("the type of a variable in it is damaged")
    (word,) = struct.unpack_from(order + "I", flags)
    kind, dims, after = _part(body, at, order)
    shape: tuple[int, ...] = ()
    if kind == _INT32:  # MATLAB's newer objects have no dimensions
        shape = struct.unpack(f"{order}{len(dims) // 4}i", dims[: len(dims) // 4 * 4])
        at = after
    kind, name, at = _part(body, at, order)
    if kind != _INT8 or any(n < 0 for n in shape) or not re.fullmatch(rb"[A-Za-z_0-9]*", name.rstrip(b"\0")):
        raise ValueError("the name or the size of a variable in it is damaged")
    return _Head(word & 0xFF, bool(word & 0x800), bool(word & 0x200), shape, name.rstrip(b"\0").decode("ascii"), at)


def _part(body: bytes, at: int, order: str) -> tuple[int, bytes, int]:
    """Kind and bytes of a short element at `at`, and where the next one begins."""
    kind, start, length, after = _tag(body, at, order)
    if start + length > len(body):
        raise ValueError("the description of a variable in it is truncated or damaged")
    return kind, body[start : start + length], after


def _tag(body: bytes, at: int, order: str) -> tuple[int, int, int, int]:
    """Kind, start, length of the element whose tag is at `at`, and where the next one begins."""
    if at + 8 > len(body):
        raise ValueError("a variable in it is truncated or damaged")
    kind, length = struct.unpack_from(order + "II", body, at)
    if kind >> 16:  # up to four bytes are packed into the tag itself
        kind, length = kind & 0xFFFF, kind >> 16
        if length > 4:
            raise ValueError("a variable in it is damaged")
        return kind, at + 4, length, at + 8
    return kind, at + 8, length, at + 8 + (length + 7) // 8 * 8


def _stored_kind(body: bytes, head: _Head, order: str) -> int:
    return _tag(body, head.values, order)[0] if head.kind == _DOUBLE else 0


def _variable(head: _Head, element: partial[bytes], stored: int, order: str, size: int) -> Variable:
    if head.complex:
        return unreadable(_COMPLEX)
    if head.kind == _TEXT:
        if len(head.shape) != 2 or head.shape[0] != 1 or head.shape[1] > _HEAD:
            return unreadable("text")
        return Variable((), np.dtype("U"), lambda: _text(element(), head, order))
    if head.kind not in _NUMERIC:
        return unreadable(_OTHERS.get(head.kind, "of a kind that is not known"))
    # MATLAB keeps doubles that are all small whole numbers as 8 or 16 bits, and images of so many bits come as doubles.
    dtype = np.dtype(bool) if head.logical else np.dtype(_SMALL.get(stored) or _NUMERIC[head.kind])
    check_size(head.shape, dtype.itemsize, size)
    return Variable(head.shape, dtype, lambda: _numbers(element(), head, dtype, order))


def _whole(path: Path, kind: int, start: int, length: int, order: str, size: int) -> bytes:
    """A matrix element with its tag, decompressed."""
    with path.open("rb") as file:
        file.seek(start)
        body = file.read(length)
    if kind == _MATRIX:
        return body
    try:
        inflate = zlib.decompressobj()
        tag = inflate.decompress(body, 8)
        declared = struct.unpack_from(order + "I", tag.ljust(8, b"\0"), 4)[0]
        check_size((declared,), 1, size)
        # Room for one byte more than declared, so that zlib reaches the checksum at the end and compares it.
        element = tag + inflate.decompress(inflate.unconsumed_tail, declared + 1)
    except zlib.error as error:
        raise ValueError(f"a variable in it cannot be decompressed ({error}); it is damaged") from error
    if not inflate.eof or len(element) != declared + 8:
        raise ValueError("a compressed variable in it has the wrong length; it is truncated or damaged")
    return element


def _numbers(element: bytes, head: _Head, dtype: np.dtype, order: str) -> np.ndarray:
    kind, start, length, _ = _tag(element, head.values, order)
    stored = np.dtype(order + _STORED[kind]) if kind in _STORED else None
    if stored is None or (stored.kind == "f" and dtype.kind != "f"):
        raise ValueError(f"the values of '{head.name}' are of a type that does not fit; it is damaged")
    count = prod(head.shape)
    if length != count * stored.itemsize or start + length > len(element):
        raise ValueError(
            f"the values of '{head.name}' do not have the size that is declared; it is truncated or damaged"
        )
    values = np.frombuffer(element, stored, count, start)
    if head.kind == _DOUBLE and dtype.kind == "u" and count and values.max() <= 1:
        dtype = np.dtype(np.float64)  # zeros and ones are no image of 8 bits
    return values.astype(dtype, copy=False).reshape(head.shape, order="F")


def _text(element: bytes, head: _Head, order: str) -> np.ndarray:
    kind, start, length, _ = _tag(element, head.values, order)
    if kind not in _TEXT_CODES or start + length > len(element):
        raise ValueError(f"the text '{head.name}' is damaged")
    code = _TEXT_CODES[kind]
    if code != "utf-8":
        code += "-le" if order == "<" else "-be"
    return np.array(element[start : start + length].decode(code, errors="replace"))


def mat5_bytes(variables: Mapping[str, np.ndarray]) -> memoryview:
    """A MATLAB 5 file, not compressed.

    Raises
    ------
    ValueError
        If a variable is larger than the format can hold.
    """
    from scipy.io import savemat
    from scipy.io.matlab import MatWriteError

    buffer = io.BytesIO()
    try:
        savemat(buffer, dict(variables), oned_as="row")
    except MatWriteError as error:
        raise ValueError("the cube is too large for a MATLAB 5 file (4 GB); write .nc or .npz instead") from error
    return buffer.getbuffer()
