"""One way into files of all formats: told apart by their first bytes, listed as variables, loaded when asked for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .contents import Contents, Variable
from .envi import MAGIC as ENVI_MAGIC
from .envi import envi_contents, header_beside
from .mat5 import mat5_variables
from .numpy_files import MAGIC as NPY_MAGIC
from .numpy_files import npy_variables, npz_variables
from .png import MAGIC as PNG_MAGIC
from .png import png_variables
from .png_folder import folder_contents
from .tiff import MAGICS as TIFF_MAGICS
from .tiff import tiff_contents

if TYPE_CHECKING:
    import xarray as xr

_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_FORMATS = "native or NetCDF-4 (.nc), MATLAB 5 to 7.3 (.mat), NumPy (.npy, .npz), ENVI (.hdr), TIFF, PNG"
_LISTERS = {"mat5": mat5_variables, "npy": npy_variables, "npz": npz_variables, "png": png_variables}


def check_file(path: Path, *, folder: bool = False) -> None:
    """Raise an OSError that says what is there, unless there is a file, or a folder where one is of use."""
    if path.is_dir():
        if folder:
            return
        raise IsADirectoryError(f"{path} is a folder; give a file in it")
    if not path.exists():
        raise FileNotFoundError(f"there is no file {path}")
    if not path.is_file():
        raise OSError(f"{path} is not a file")


@contextmanager
def opened(path: Path, *, wavelengths_said: bool = False) -> Iterator[Contents]:
    """List the variables of a file, or of a folder of PNG pictures; they can be loaded inside the `with` block.

    `wavelengths_said`: the caller knows the wavelengths, so that the numbers of the pictures need not tell them.

    Raises
    ------
    ValueError
        If the file is damaged or of no known format.
    OSError
        If it cannot be opened.
    """
    kind = "folder" if path.is_dir() else file_kind(path)
    if kind == "folder":
        yield folder_contents(path, wavelengths_said=wavelengths_said)
    elif kind == "hdf5":
        from .hdf5_isolated import isolated
        from .native import check_provenance, read_intact

        ds = read_intact(path)
        if ds is not None:
            yield Contents(dataset_variables(ds))
            return
        with isolated(path) as listing:
            check_provenance(listing)
            yield Contents(listing.variables)
    elif kind == "tiff":
        yield tiff_contents(path)
    elif kind == "envi":
        yield envi_contents(path)
    elif kind == "envi data":
        header = header_beside(path)
        assert header is not None
        yield envi_contents(header, path)
    else:
        yield Contents(_LISTERS[kind](path))


def file_kind(path: Path) -> str:
    """Name of the format that a file begins like."""
    with path.open("rb") as file:
        head = file.read(520)
    if not head:
        raise ValueError("it is empty")
    if is_hdf5(head):
        return "hdf5"
    if head.startswith(NPY_MAGIC):
        return "npy"
    if head.startswith((b"PK\x03\x04", b"PK\x05\x06")):
        return "npz"
    if head[124:128] in (b"\x00\x01IM", b"\x01\x00MI"):
        return "mat5"
    if head.startswith(PNG_MAGIC):
        return "png"
    if head.startswith(TIFF_MAGICS):
        return "tiff"
    if head.startswith(ENVI_MAGIC) and path.suffix.lower() == ".hdr":
        return "envi"
    if header_beside(path) is not None:
        return "envi data"
    if head.startswith(b"CDF"):
        raise ValueError("it is a classic NetCDF file; convert it with `nccopy -k netCDF-4 IN OUT`")
    raise ValueError(f"it does not begin like a file of a known format ({_FORMATS}), or its beginning is damaged")


def is_hdf5(head: bytes) -> bool:
    """Whether a file of these first 520 bytes is HDF5; MATLAB 7.3 puts 512 bytes of its own before it."""
    return head.startswith(_HDF5_MAGIC) or head[512:520] == _HDF5_MAGIC


def dataset_variables(ds: xr.Dataset) -> dict[str, Variable]:
    """The variables of a dataset that was read already."""
    return {
        str(name): Variable(one.shape, one.dtype, one.to_numpy, tuple(map(str, one.dims)))
        for name, one in ds.data_vars.items()
    }


def load_checked(variable: Variable, name: str) -> np.ndarray:
    """The values of a variable, refused where some are NaN or infinite."""
    values = variable.load()
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise ValueError(f"'{name}' has {np.count_nonzero(~np.isfinite(values))} values that are NaN or infinite")
    return values
