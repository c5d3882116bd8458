"""Variables of `.npy` and `.npz` files, without pickle and without trust in what their headers say.

Format: NumPy Enhancement Proposal 1 and `numpy.lib.format`, versions 1.0 and 2.0.
"""

from __future__ import annotations

import ast
import io
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from math import prod
from pathlib import Path
from typing import IO

import numpy as np

from .contents import Variable, check_size, unreadable

Opener = Callable[[], AbstractContextManager[IO[bytes]]]
MAGIC = b"\x93NUMPY"
_LONGEST_HEADER = 10_000
_DESCR = re.compile(r"[<>|=](?:[iu][1248]|f[248]|b1|U\d{1,3})")
_COMPLEX = "complex numbers; save their real part or their magnitude"
_OBJECTS = "Python objects or records, not an array of real numbers"
# What zipfile, and the compression under it, raise on files that are not what they say.
_ZIP_ERRORS = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    KeyError,
    IndexError,
    NotImplementedError,
    OverflowError,
    RuntimeError,
    UnicodeDecodeError,
)


def npy_variables(path: Path) -> dict[str, Variable]:
    """The one variable of a `.npy` file, called by the file's name."""
    size = path.stat().st_size
    with path.open("rb") as file:
        variable, declared = _variable(file, size, lambda: path.open("rb"))
    if variable.dtype is not None and declared != size:
        raise ValueError(f"its header declares {declared} bytes but it has {size}; it is truncated or damaged")
    return {path.stem: variable}


def npz_variables(path: Path) -> dict[str, Variable]:
    """The variables of a `.npz` file; members that are not `.npy` are left out."""
    size = path.stat().st_size
    variables = {}
    try:
        with zipfile.ZipFile(path) as archive:
            for member in archive.infolist():
                if member.filename.endswith(".npy"):
                    name = member.filename.removesuffix(".npy")
                    variables[name] = _member(path, archive, member, size)
    except (*_ZIP_ERRORS, OSError) as error:
        raise ValueError(_zip_damage(error)) from error
    return variables


def _member(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo, size: int) -> Variable:
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        return unreadable("compressed in a way that NumPy does not use")
    with archive.open(member) as file:
        variable, declared = _variable(file, size, lambda: _open_member(path, member))
    if variable.dtype is not None and declared != member.file_size:
        raise ValueError(f"{member.filename} does not have the size that its header declares; the file is damaged")
    return variable


@contextmanager
def _open_member(path: Path, member: zipfile.ZipInfo) -> Iterator[IO[bytes]]:
    with zipfile.ZipFile(path) as archive, archive.open(member) as file:
        yield file


def _variable(file: IO[bytes], file_size: int, again: Opener) -> tuple[Variable, int]:
    """The array whose header `file` begins with, and how many bytes header and array take."""
    descr, fortran, shape, start = _header(file)
    if not isinstance(descr, str) or not _DESCR.fullmatch(descr):
        return unreadable(_COMPLEX if re.fullmatch(r"[<>]c\d+", str(descr)) else _OBJECTS), 0
    dtype = np.dtype(descr)
    total = start + check_size(shape, dtype.itemsize, file_size)

    def load() -> np.ndarray:
        try:
            with again() as data:
                data.read(start)
                array = np.empty(prod(shape), dtype)
                _fill(data, array)
        except (*_ZIP_ERRORS, OSError) as error:
            raise ValueError(_zip_damage(error)) from error
        return array.reshape(shape, order="F" if fortran else "C")

    return Variable(shape, dtype, load), total


def _header(file: IO[bytes]) -> tuple[object, bool, tuple[int, ...], int]:
    """Type as NumPy describes it, column-major or not, shape, and where the values start."""
    start = file.read(8)
    if len(start) < 8 or start[:6] != MAGIC or start[6] not in (1, 2):
        raise ValueError("it does not begin like a NumPy array of version 1 or 2; it is truncated or damaged")
    width = 2 if start[6] == 1 else 4
    length = int.from_bytes(file.read(width), "little")
    if length > _LONGEST_HEADER:
        raise ValueError(f"its NumPy header claims {length} bytes; it is damaged")
    text = file.read(length)
    try:
        fields = ast.literal_eval(text.decode("latin-1").strip())
        descr, fortran, shape = fields["descr"], fields["fortran_order"], fields["shape"]
    except (ValueError, TypeError, KeyError, SyntaxError, MemoryError, RecursionError):
        raise ValueError("its NumPy header cannot be understood; it is damaged") from None
    plain = isinstance(shape, tuple) and all(type(n) is int and 0 <= n < 2**40 for n in shape) and len(shape) <= 32
    if len(text) < length or not plain or not isinstance(fortran, bool):
        raise ValueError("its NumPy header cannot be understood; it is truncated or damaged")
    return descr, fortran, shape, 8 + width + length


def _fill(file: IO[bytes], array: np.ndarray) -> None:
    view = array.view(np.uint8).data
    done = 0
    while done < len(view):
        count = file.readinto(view[done:])  # pyright: ignore[reportAttributeAccessIssue]
        if not count:
            raise EOFError("it ends before the array does")
        done += count
    if file.read(1):  # reaching the end is what makes zipfile compare its checksum
        raise ValueError("there is more in it than its header declares; it is damaged")


def _zip_damage(error: BaseException) -> str:
    said = str(error) or type(error).__name__
    return f"it is truncated or damaged ({said.rstrip('.')})"


def npy_bytes(values: np.ndarray) -> memoryview:
    """A `.npy` file."""
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.ascontiguousarray(values), allow_pickle=False)
    return buffer.getbuffer()


def npz_bytes(variables: dict[str, np.ndarray]) -> memoryview:
    """A `.npz` file, not compressed."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **variables)
    return buffer.getbuffer()
