"""Native files larger than the memory: written and read in parts.

The file is the same as `native` makes: on the disk instead of in memory, in chunks that are written once, and then read once more
for its digest. Why: docs/decisions/0015-strips.md.
"""

from __future__ import annotations

import io
import os
import secrets
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import h5py
import xarray as xr

from .atomic import _check_target, _permissions, _sync_folder
from .native import Rows, Streamed, digest, fill, is_intact, stored_bytes, stored_dataset, trailer


def write_rows(
    ds: xr.Dataset,
    path: str | os.PathLike[str],
    variable: str,
    rows: Rows,
    *,
    axis: str = "y",
    temporary: Path | None = None,
) -> None:
    """Write a dataset, one variable of which is never whole in memory, to a native file; all or nothing.

    Parameters
    ----------
    ds : as for `write_dataset`. Of `variable` only axes, shape, type and attributes count, so that its values may be those of one
        number: ``np.broadcast_to(np.float32(0), shape)``.
    path : the file.
    variable : float32, float64 or whole numbers.
    rows : called as ``rows(start, stop)`` for the values of `variable` from `start` to `stop` along `axis`, in order from 0 on, as
        many at a time as the file stores together (about a MB for each element of the axes before it).
    axis : of `variable`.
    temporary : file in which it is made, in the file system of `path`, and which is then renamed; one that is there is replaced.
        By default one with a random name beside `path`.

    Raises
    ------
    ValueError
        If the dataset holds what the file cannot keep, or rows come in another shape.
    OSError
        If the file cannot be written; what was there before stays.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np, xarray as xr
    >>> from shadowgram.scenes.readers.native import read_dataset
    >>> from shadowgram.scenes.readers.native_parts import write_rows
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "ramp.nc"
    >>> shape = xr.Dataset({"ramp": (("y", "x"), np.broadcast_to(np.float32(0), (1000, 600)))})
    >>> write_rows(shape, path, "ramp", lambda start, stop: np.arange(start, stop)[:, None] + np.zeros(600))
    >>> float(read_dataset(path)["ramp"][437, 5])
    437.0
    """
    write_on_disk(ds, path, Streamed(variable, axis, rows), temporary)


def read_part(path: str | os.PathLike[str], part: Mapping[str, slice]) -> xr.Dataset:
    """Read a part of a native file, after comparing the checksum of all of it.

    Parameters
    ----------
    path : the file.
    part : axis → ``slice(start, stop)`` of it, counted from 0; other axes are read whole. Variables without such an axis are whole.

    Returns
    -------
    xarray.Dataset
        As `read_dataset` gives it, cut along the axes of `part`.

    Raises
    ------
    ValueError
        If the file is damaged, is no native file, or does not reach that far.
    OSError
        If it cannot be opened.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import shadowgram as sg
    >>> from shadowgram.scenes.readers.native_parts import read_part
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "cube.nc"
    >>> sg.scenes.write(sg.scenes.chart(size=32, bands=3, seed=0), path)
    >>> dict(read_part(path, {"y": slice(8, 12)}).sizes)
    {'band': 3, 'y': 4, 'x': 32}
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            if not is_intact(file):
                raise ValueError(
                    "it has no checksum, so that shadowgram did not write it; read all of it and write it anew"
                )
            with h5py.File(file, "r") as opened:
                return stored_dataset(opened, part)
    except ValueError as error:
        raise ValueError(f"cannot read {path}: {error}") from error


def write_on_disk(
    ds: xr.Dataset, path: str | os.PathLike[str], streamed: Streamed | None = None, temporary: Path | None = None
) -> None:
    """Make the file on the disk, where it may be larger than the memory; otherwise as `replace_file` does."""
    target = Path(path).resolve()
    temporary = temporary or target.with_name(f".{target.name[:100]}.{secrets.token_hex(6)}.part")
    try:
        _check_target(target)
        try:
            with temporary.open("w+b") as file:
                growing = _Reserved(file, ds)
                fill(growing, ds, streamed)
                _seal(file, growing.size)
            if (permissions := _permissions(target)) is not None:
                temporary.chmod(permissions)
            temporary.replace(target)
        except BaseException:
            with suppress(OSError):
                temporary.unlink()
            raise
    except OSError as error:
        raise OSError(f"cannot write {path}: {error.strerror or error}; nothing was changed") from error
    _sync_folder(target.parent)


class _Reserved(io.RawIOBase):
    """A file that grows into space that was taken beforehand: HDF5 crashes if the disk is full while it writes."""

    def __init__(self, file: IO[bytes], ds: xr.Dataset) -> None:
        super().__init__()
        self.file, self.size = file, 0
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file.fileno(), 0, stored_bytes(ds))

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        start = {io.SEEK_SET: 0, io.SEEK_CUR: self.file.tell(), io.SEEK_END: self.size}[whence]
        return self.file.seek(start + offset)

    def tell(self) -> int:
        return self.file.tell()

    def readinto(self, buffer: Any) -> int:
        left = max(0, self.size - self.file.tell())
        return self.file.readinto(memoryview(buffer).cast("B")[:left])  # type: ignore[attr-defined]  # a file has it

    def write(self, data: Any) -> int:
        count = self.file.write(data)
        self.size = max(self.size, self.file.tell())
        return count

    def truncate(self, size: int | None = None) -> int:
        self.size = self.file.tell() if size is None else size
        return self.size


def _seal(file: IO[bytes], size: int) -> None:
    """Put the trailer behind an HDF5 file of so many bytes and force all to the disk."""
    file.truncate(size)
    file.seek(0)
    end = trailer(size, digest(file, size))
    file.seek(size)
    file.write(end)
    file.flush()
    os.fsync(file.fileno())
