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
from collections.abc import Mapping
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
_CHUNK_BYTES = 2**20
_DIMENSION_ONLY = b"This is a netCDF dimension but not a netCDF variable"
_RESERVED = frozenset(
    {
        *("CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST", "coordinates", "_FillValue"),
        *("_NCProperties", "_Netcdf4Coordinates", "_Netcdf4Dimid", "_nc3_strict"),
    }
)


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
    image = _image(ds)
    digest = hashlib.sha256(image).digest()
    replace_file(path, [image, MAGIC + len(image).to_bytes(8, "little") + digest])


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
        if not _is_intact(file):
            return None
        with h5py.File(file, "r") as opened:
            return _dataset(opened)


def _is_intact(file: IO[bytes]) -> bool:
    """Whether the file ends with a checksum (False: other software wrote it); damage is a `ValueError`."""
    size = file.seek(0, io.SEEK_END)
    file.seek(max(size - TRAILER, 0))
    trailer = file.read(TRAILER)
    file.seek(0)
    if not trailer.startswith(MAGIC):
        return False
    sha = hashlib.sha256()
    left = size - TRAILER
    block = memoryview(bytearray(2**20))
    while left and (count := file.readinto(block[: min(left, len(block))])):  # pyright: ignore[reportAttributeAccessIssue]
        sha.update(block[:count])
        left -= count
    file.seek(0)
    if trailer[len(MAGIC) :] != (size - TRAILER).to_bytes(8, "little") + sha.digest():
        raise ValueError(
            "it is damaged, or other software changed it: its contents do not match the checksum at its end"
        )
    return True


def check_provenance(listing: Listing) -> None:
    """Refuse a native file that lost its checksum; call it for HDF5 files that have none."""
    if "shadowgram=" in listing.provenance:
        raise ValueError(
            "it is damaged: the checksum that was written with it is gone. If other software changed it on purpose, "
            "let that software save a copy under a new name"
        )


def _image(ds: xr.Dataset) -> memoryview:
    """The bytes of the NetCDF-4 file, made in memory: then the disk is written in one way for all formats."""
    _check_names(ds)
    buffer = io.BytesIO()
    with h5netcdf.File(buffer, "w", libver="v110") as file:
        file.dimensions = {str(name): size for name, size in ds.sizes.items()}
        covered: set[str] = set()
        for name, variable in ds.variables.items():
            attrs = _attributes(variable.attrs, f"'{name}'")
            if name not in ds.coords and (names := _coordinates_along(ds, variable)):
                attrs["coordinates"] = " ".join(names)
                covered.update(names)
            _add_variable(file, str(name), variable, attrs)
        file.attrs.update(_attributes(ds.attrs, "the dataset"))
        if names := [str(name) for name in ds.coords if name not in ds.sizes and name not in covered]:
            file.attrs["coordinates"] = " ".join(names)
    with h5py.File(buffer, "r+", libver="v110") as file:
        # Where NetCDF software writes its name. Others put theirs when they copy a file, so that a file with this mark
        # and no checksum is damaged.
        made = f"version=2,shadowgram=1,h5netcdf={h5netcdf.__version__},hdf5={h5py.version.hdf5_version}"
        file.attrs["_NCProperties"] = np.bytes_(made)
    return buffer.getbuffer()


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


def _add_variable(file: h5netcdf.File, name: str, variable: xr.Variable, attrs: dict[str, object]) -> None:
    values = np.asarray(variable.values)
    if values.dtype.kind not in "fiub" or values.dtype.itemsize not in (1, 2, 4, 8) or values.dtype == np.float16:
        raise ValueError(f"'{name}' holds {values.dtype}; a file keeps float32, float64, whole numbers and bool")
    if values.dtype == bool:  # NetCDF has none; this is how xarray marks it
        values, attrs = values.astype(np.int8), attrs | {"dtype": "bool"}
    elif attrs.get("dtype") == "bool":
        raise ValueError(f"attribute 'dtype' of '{name}' says bool but it holds {values.dtype}; remove the attribute")
    options: dict[str, object] = {"fletcher32": True, "chunks": _chunks(values)} if values.ndim else {}
    stored = file.create_variable(name, tuple(map(str, variable.dims)), values.dtype, **options)
    stored[...] = values
    stored.attrs.update(attrs)


def _chunks(values: np.ndarray) -> tuple[int, ...]:
    """Whole trailing axes in pieces of about a MB; HDF5 checks one checksum for each piece."""
    chunks = list(values.shape)
    for axis in range(len(chunks)):
        others = values.itemsize * int(np.prod(chunks)) // chunks[axis]
        chunks[axis] = min(chunks[axis], max(1, _CHUNK_BYTES // others))
    return tuple(chunks)


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


def _dataset(file: h5py.File) -> xr.Dataset:
    """The dataset in a file whose checksum was right."""
    variables = {
        name: _variable(_dimensions(name, item), item[...], _kept(item.attrs))
        for name, item in file.items()
        if not bytes(item.attrs.get("NAME", b"")).startswith(_DIMENSION_ONLY)
    }
    attrs = _kept(file.attrs)
    names = _take_coordinates(attrs, *(variable.attrs for variable in variables.values()))
    return xr.Dataset(variables, attrs=attrs).set_coords(names)


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
