"""The native file: NetCDF-4 that any NetCDF or HDF5 software opens, with a checksum of the whole file at its end.

The last 64 bytes are not part of the HDF5 file: `MAGIC`, the number of bytes before them (8 bytes, little endian) and
their SHA-256 digest. HDF5 ignores what follows its own end. The digest is compared before the HDF5 library sees a byte,
because that library can crash on a damaged file, and because HDF5's own checksums do not cover all of it.
Why so: docs/decisions/0002-native-file.md.
"""

from __future__ import annotations

import hashlib
import io
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import h5netcdf
import h5py
import numpy as np
import xarray as xr

from .atomic import replace_file
from .hdf5_isolated import Listing, isolated

MAGIC = b"\x89shadowgram sha-256 v1\r\n"
TRAILER = 64
IN_MEMORY = 2**28  # bytes of a dataset whose file is made in memory; that of a larger one is made on the disk
_CHUNK_BYTES = 2**20
_DIMENSION_ONLY = b"This is a netCDF dimension but not a netCDF variable"
Rows = Callable[[int, int], np.ndarray]
_RESERVED = frozenset(
    {
        *("CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST", "coordinates", "_FillValue"),
        *("_NCProperties", "_Netcdf4Coordinates", "_Netcdf4Dimid", "_nc3_strict"),
    }
)


@dataclass(frozen=True)
class Streamed:
    """A variable whose values come as rows(start, stop) along one of its axes."""

    variable: str
    axis: str
    rows: Rows


def write_dataset(ds: xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Write a dataset to a native file, in place of what is there, all or nothing.

    Parameters
    ----------
    ds : variables and coordinates of real numbers (float32, float64, whole numbers of 8 to 64 bits, bool), with
        attributes that are texts, numbers or lists of numbers. All of it comes back from `read_dataset` as it was, but
        that lists come back as arrays.
    path : the file.

    Raises
    ------
    ValueError
        If the dataset holds what the file cannot keep; the message names it.
    OSError
        If the file cannot be written; what was there before stays.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> import xarray as xr
    >>> from shadowgram.scenes.readers.native import read_dataset, write_dataset
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "shots.nc"
    >>> shots = xr.Dataset({"snapshots": (("shot", "y", "x"), [[[1.0, 2.0]]])}, attrs={"imager": '{"kind": "CASSI"}'})
    >>> write_dataset(shots, path)
    >>> read_dataset(path).identical(shots)
    True
    """
    if ds.nbytes > IN_MEMORY:
        from .native_parts import write_on_disk

        write_on_disk(ds, path)
        return
    image = _image(ds)
    replace_file(path, [image, trailer(len(image), hashlib.sha256(image).digest())])


def read_dataset(path: str | os.PathLike[str]) -> xr.Dataset:
    """Read all of a native file, after comparing its checksum; or the numbers in a NetCDF-4 file of other software.

    Raises
    ------
    ValueError
        If the file is damaged, or not a NetCDF-4 file.
    OSError
        If it cannot be opened.
    """
    path = Path(path)
    try:
        ds = read_intact(path)
        if ds is not None:
            return ds
        with isolated(path) as listing:
            check_provenance(listing)
            return _foreign_dataset(listing)
    except ValueError as error:
        raise ValueError(f"cannot read {path}: {error}") from error


def read_intact(path: Path) -> xr.Dataset | None:
    """All of a file with a right checksum; None where it has none; a wrong one is a `ValueError`."""
    with path.open("rb") as file:
        if not is_intact(file):
            return None
        with h5py.File(file, "r") as opened:
            return stored_dataset(opened)


def is_intact(file: IO[bytes]) -> bool:
    """Whether the file ends with a checksum (False: other software wrote it); damage is a `ValueError`."""
    size = file.seek(0, io.SEEK_END)
    file.seek(max(size - TRAILER, 0))
    found = file.read(TRAILER)
    file.seek(0)
    if not found.startswith(MAGIC):
        return False
    right = trailer(size - TRAILER, digest(file, size - TRAILER))
    file.seek(0)
    if found != right:
        raise ValueError(
            "it is damaged, or other software changed it: its contents do not match the checksum at its end"
        )
    return True


def digest(file: IO[bytes], left: int) -> bytes:
    """SHA-256 of the next `left` bytes."""
    sha = hashlib.sha256()
    block = memoryview(bytearray(2**20))
    while left and (count := file.readinto(block[: min(left, len(block))])):  # pyright: ignore[reportAttributeAccessIssue]
        sha.update(block[:count])
        left -= count
    return sha.digest()


def trailer(size: int, digest: bytes) -> bytes:
    """The last bytes of a native file whose HDF5 file has this size and SHA-256 digest."""
    return MAGIC + size.to_bytes(8, "little") + digest


def check_provenance(listing: Listing) -> None:
    """Refuse a native file that lost its checksum; call it for HDF5 files that have none."""
    if "shadowgram=" in listing.provenance:
        raise ValueError(
            "it is damaged: the checksum that was written with it is gone. If other software changed it on purpose, "
            "let that software save a copy under a new name"
        )


def _image(ds: xr.Dataset) -> memoryview:
    """The bytes of the NetCDF-4 file, made in memory: then the disk is written in one way for all formats."""
    buffer = io.BytesIO()
    fill(buffer, ds, None)
    return buffer.getbuffer()


def fill(buffer: IO[bytes] | io.RawIOBase, ds: xr.Dataset, streamed: Streamed | None) -> None:
    """Write the NetCDF-4 file, without the trailer, into an empty file that can be read and written."""
    _check_names(ds)
    with h5netcdf.File(buffer, "w", libver="v110") as file:
        file.dimensions = {str(name): size for name, size in ds.sizes.items()}
        covered: set[str] = set()
        for name, variable in ds.variables.items():
            attrs = _attributes(variable.attrs, f"'{name}'")
            if name not in ds.coords and (names := _coordinates_along(ds, variable)):
                attrs["coordinates"] = " ".join(names)
                covered.update(names)
            given = streamed if streamed is not None and name == streamed.variable else None
            _add_variable(file, str(name), variable, attrs, given)
        file.attrs.update(_attributes(ds.attrs, "the dataset"))
        if names := [str(name) for name in ds.coords if name not in ds.sizes and name not in covered]:
            file.attrs["coordinates"] = " ".join(names)
    with h5py.File(buffer, "r+", libver="v110") as file:
        # Where NetCDF software writes its name. Others put theirs when they copy a file, so that a file with this mark
        # and no checksum is damaged.
        made = f"version=2,shadowgram=1,h5netcdf={h5netcdf.__version__},hdf5={h5py.version.hdf5_version}"
        file.attrs["_NCProperties"] = np.bytes_(made)


def _check_names(ds: xr.Dataset) -> None:
    for name in (*ds.variables, *ds.sizes):
        if not isinstance(name, str) or not re.fullmatch(r"[^\s/\0]+", name) or name == ".":
            raise ValueError(f"names of variables and axes must be texts without spaces and slashes, got {name!r}")
    for name, size in ds.sizes.items():
        if size == 0:
            raise ValueError(f"there is nothing to write: axis '{name}' has length 0")


def _coordinates_along(ds: xr.Dataset, variable: xr.Variable) -> list[str]:
    """Coordinates that belong to a variable, other than those of the axes themselves; CF's `coordinates`."""
    return [str(name) for name, c in ds.coords.items() if name not in ds.sizes and set(c.dims) <= set(variable.dims)]


def _add_variable(
    file: h5netcdf.File, name: str, variable: xr.Variable, attrs: dict[str, object], streamed: Streamed | None
) -> None:
    values = np.asarray(variable.values)
    if values.dtype.kind not in "fiub" or values.dtype.itemsize not in (1, 2, 4, 8) or values.dtype == np.float16:
        raise ValueError(f"'{name}' holds {values.dtype}; a file keeps float32, float64, whole numbers and bool")
    if values.dtype == bool:  # NetCDF has none; this is how xarray marks it
        values, attrs = values.astype(np.int8), attrs | {"dtype": "bool"}
    elif attrs.get("dtype") == "bool":
        raise ValueError(f"attribute 'dtype' of '{name}' says bool but it holds {values.dtype}; remove the attribute")
    options: dict[str, object] = {"fletcher32": True, "chunks": _chunks(values)} if values.ndim else {}
    stored = file.create_variable(name, tuple(map(str, variable.dims)), values.dtype, **options)
    if streamed is None:
        stored[...] = values
    else:
        _store_rows(stored, values, variable.dims.index(streamed.axis), streamed.rows)
    stored.attrs.update(attrs)


def _store_rows(stored: h5netcdf.Variable, like: np.ndarray, axis: int, rows: Rows) -> None:
    """Fill a variable by whole chunks, which are then written once."""
    length, step = like.shape[axis], _chunks(like)[axis]
    for start in range(0, length, step):
        stop = min(start + step, length)
        block = np.asarray(rows(start, stop))
        wanted = (*like.shape[:axis], stop - start, *like.shape[axis + 1 :])
        if block.shape != wanted:
            raise ValueError(f"rows {start} to {stop} must have the shape {wanted}, got {block.shape}")
        stored[(slice(None),) * axis + (slice(start, stop),)] = block


def _chunks(values: np.ndarray) -> tuple[int, ...]:
    """Whole trailing axes in even pieces of up to a MB; HDF5 checks one checksum for each piece, and stores the last one whole."""
    chunks = list(values.shape)
    for axis, length in enumerate(values.shape):
        others = values.itemsize * int(np.prod(chunks)) // chunks[axis]
        pieces = -(-length // max(1, _CHUNK_BYTES // others))
        chunks[axis] = -(-length // pieces)
    return tuple(chunks)


def stored_bytes(ds: xr.Dataset) -> int:
    """About as many bytes as the file has, or some more."""
    _check_names(ds)
    total = 2**20
    for variable in ds.variables.values():
        chunks = _chunks(variable.values) if variable.ndim else ()
        counts = [-(-length // chunk) for length, chunk in zip(variable.shape, chunks, strict=True)]
        # A checksum, and its place in the index, for each chunk.
        total += int(np.prod(counts)) * (variable.dtype.itemsize * int(np.prod(chunks)) + 128)
    return total


def _attributes(attrs: dict, owner: str) -> dict[str, object]:
    kept = {}
    for name, value in attrs.items():
        if not isinstance(name, str) or not name or name in _RESERVED or "\0" in name or "/" in name:
            raise ValueError(f"attribute {name!r} of {owner} cannot be kept: the name is not a text, or NetCDF uses it")
        numbers = value if isinstance(value, str) else np.asarray(value)
        if "\0" in numbers if isinstance(numbers, str) else not _is_plain(numbers):
            raise ValueError(
                f"attribute '{name}' of {owner} is {value!r}; "
                "a file keeps texts, numbers and lists of numbers: write others as text"
            )
        kept[name] = numbers
    return kept


def _is_plain(numbers: np.ndarray) -> bool:
    return numbers.dtype.kind in "fiu" and numbers.dtype != np.float16 and numbers.ndim <= 1 and numbers.size > 0


def stored_dataset(file: h5py.File, part: Mapping[str, slice] | None = None) -> xr.Dataset:
    """The dataset in a file whose checksum was right, or a part of it."""
    variables = {
        name: _variable(dims := _dimensions(name, item), item[_index(item, dims, part or {})], _kept(item.attrs))
        for name, item in file.items()
        if not bytes(item.attrs.get("NAME", b"")).startswith(_DIMENSION_ONLY)
    }
    attrs = _kept(file.attrs)
    names = _take_coordinates(attrs, *(variable.attrs for variable in variables.values()))
    return xr.Dataset(variables, attrs=attrs).set_coords(names)


def _index(item: h5py.Dataset, dims: tuple[str, ...], part: Mapping[str, slice]) -> Any:
    for dim, size in zip(dims, item.shape, strict=True):
        cut = part.get(dim)
        if cut is not None and not 0 <= cut.start < cut.stop <= size:
            raise ValueError(f"axis '{dim}' has the length {size}; there is no part from {cut.start} to {cut.stop}")
    return tuple(part.get(dim, slice(None)) for dim in dims) or ...


def _variable(dims: tuple[str, ...], values: np.ndarray, attrs: dict[str, object]) -> xr.Variable:
    if attrs.get("dtype") == "bool" and values.dtype == np.int8:
        values = values.astype(bool)
        del attrs["dtype"]
    return xr.Variable(dims, values, attrs)


def _take_coordinates(*owners: dict) -> set[str]:
    """Names of the coordinates, which CF files have as attributes of what they belong to."""
    return {name for attrs in owners for name in str(attrs.pop("coordinates", "")).split()}


def _dimensions(name: str, item: h5py.Dataset) -> tuple[str, ...]:
    if item.attrs.get("CLASS") == b"DIMENSION_SCALE":
        return (name,)
    return tuple(str(axis[0].name).removeprefix("/") for axis in item.dims)


def _kept(attrs: Mapping[str, Any]) -> dict[str, object]:
    """Attributes as they were written, without those of HDF5 and NetCDF themselves."""
    kept = {}
    for name, value in attrs.items():
        if name in _RESERVED and name != "coordinates":
            continue
        if isinstance(value, h5py.Empty):
            kept[name] = ""
        else:
            kept[name] = value.item() if type(value) in (np.int64, np.float64) else value
    return kept


def _foreign_dataset(listing: Listing) -> xr.Dataset:
    variables = {
        name: _variable(
            variable.dims or tuple(f"{name}_axis_{i}" for i in range(len(variable.shape))),
            variable.load(),
            _kept(variable.attrs),
        )
        for name, variable in listing.variables.items()
        if variable.dtype is not None
    }
    attrs = _kept(listing.attrs)
    names = _take_coordinates(attrs, *(variable.attrs for variable in variables.values()))
    return xr.Dataset(variables, attrs=attrs).set_coords([name for name in names if name in variables])
