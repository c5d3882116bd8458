"""The two doors for datacubes in files."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr

from shadowgram.scenes.datacube import AXES, band_centres, check_cube

from .atomic import replace_file
from .choose import choose_cube, list_contents, parse_axes
from .contents import Variable
from .mat5 import mat5_bytes, mat5_variables
from .numpy_files import MAGIC as NPY_MAGIC
from .numpy_files import npy_bytes, npy_variables, npz_bytes, npz_variables

_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_FORMATS = "native or NetCDF-4 (.nc), MATLAB 5 to 7.3 (.mat), NumPy (.npy, .npz)"


def read(
    path: str | os.PathLike[str],
    *,
    variable: str | None = None,
    axes: str | Sequence[str] | None = None,
    wavelengths: Sequence[float] | np.ndarray | None = None,
) -> xr.DataArray:
    """Read a datacube: native or NetCDF-4, MATLAB 5 to 7.3, `.npy` or `.npz`, told apart by their contents.

    A native file comes back as it was written. From others, images of 8 and 16 bits (uint8, uint16) are divided by
    their full scale, 255 or 65535, which is kept as the attribute `scale`; other whole numbers become float32, and
    float32 and float64 stay as they are. Doubles that MATLAB found to be whole numbers and stored in 8 or 16 bits count
    as images, unless they are all zeros and ones.

    Parameters
    ----------
    path : the file.
    variable : name of the cube in the file; else the only one with three axes.
    axes : order of the axes in the file, "y,x,band" or ("y", "x", "band"); else what the file says, or the shortest
        axis is taken for the bands. MATLAB's order is the one that MATLAB shows.
    wavelengths : nm. The centre of each band, or of the first and the last; else what the file says, or a variable with
        a name like `wavelength_nm`, `lambda` or `bands`, or 400 to 700 nm.

    Returns
    -------
    xarray.DataArray
        Axes (band, y, x), with the coordinate `wavelength` in nm.

    Warns
    -----
    UserWarning
        If something had to be guessed; it says what, in the words in which it can be said.

    Raises
    ------
    ValueError
        If the file is damaged, of no known format, does not hold the variable, or holds no cube of finite numbers.
    OSError
        If there is no such file, or it cannot be opened.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import shadowgram as sg
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "cube.nc"
    >>> sg.scenes.write(sg.scenes.as_datacube([[[0.25, 0.5]]] * 3, (450, 650)), path)
    >>> sg.scenes.read(path).wavelength.values
    array([450., 550., 650.])
    """
    path = Path(path)
    _check_file(path)
    try:
        kind = _kind(path)
        if kind == "hdf5":
            cube, guesses = _read_hdf5(path, variable, axes, wavelengths)
        else:
            variables = {"mat5": mat5_variables, "npy": npy_variables, "npz": npz_variables}[kind](path)
            cube, guesses = choose_cube(variables, variable, axes, wavelengths)
        check_cube(cube)
    except ValueError as error:
        raise ValueError(f"cannot read {path}: {error}") from error
    if guesses:
        warnings.warn(f"{path.name}: guessed {'; '.join(guesses)}. Pass to read what is otherwise", stacklevel=2)
    return cube


def write(cube: xr.DataArray, path: str | os.PathLike[str]) -> None:
    """Write a datacube, in the format that the suffix names, in place of what is there, all or nothing.

    ========  =====================================================================================================
    ``.nc``   the native file: everything, exactly, with a checksum; a cube without a name is called `datacube`
    ``.npz``  values (band, y, x), `wavelength` in nm and the order of the axes; no other coordinates, no attributes
    ``.mat``  MATLAB 5: values (y, x, band), `wavelength` in nm and the order of the axes; no attributes
    ``.npy``  values (band, y, x) and nothing else
    ========  =====================================================================================================

    Parameters
    ----------
    cube : (band, y, x) finite real numbers.
    path : the file.

    Raises
    ------
    ValueError
        If the cube is not one, or the suffix or something in the cube is not what the format keeps.
    OSError
        If the file cannot be written; what was there before stays.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import shadowgram as sg
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "cube.npz"
    >>> sg.scenes.write(sg.scenes.as_datacube([[[0.25, 0.5]]] * 3, (450, 650)), path)
    >>> sg.scenes.read(path).wavelength.values
    array([450., 550., 650.])
    """
    check_cube(cube)
    suffix = Path(path).suffix.lower()
    if suffix == ".nc":
        from .native import write_dataset

        write_dataset(cube.to_dataset(name=cube.name or "datacube"), path)
    elif suffix == ".npz":
        replace_file(path, [npz_bytes(_named_arrays(cube, AXES))])
    elif suffix == ".mat":
        replace_file(path, [mat5_bytes(_named_arrays(cube, ("y", "x", "band")))])
    elif suffix == ".npy":
        replace_file(path, [npy_bytes(cube.values)])
    else:
        raise ValueError(f"cannot write {path}: its name must end with .nc, .mat, .npz or .npy")


def _check_file(path: Path) -> None:
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder; give a file in it")
    if not path.exists():
        raise FileNotFoundError(f"there is no file {path}")
    if not path.is_file():
        raise OSError(f"{path} is not a file")


def _kind(path: Path) -> str:
    with path.open("rb") as file:
        head = file.read(520)
    if not head:
        raise ValueError("it is empty")
    # MATLAB 7.3 puts 512 bytes of its own before the HDF5 file.
    if head.startswith(_HDF5_MAGIC) or head[512:] == _HDF5_MAGIC:
        return "hdf5"
    if head.startswith(NPY_MAGIC):
        return "npy"
    if head.startswith((b"PK\x03\x04", b"PK\x05\x06")):
        return "npz"
    if head[124:128] in (b"\x00\x01IM", b"\x01\x00MI"):
        return "mat5"
    if head.startswith(b"CDF"):
        raise ValueError("it is a classic NetCDF file; convert it with `nccopy -k netCDF-4 IN OUT`")
    raise ValueError(f"it does not begin like a file of a known format ({_FORMATS}), or its beginning is damaged")


def _read_hdf5(
    path: Path,
    variable: str | None,
    axes: str | Sequence[str] | None,
    wavelengths: Sequence[float] | np.ndarray | None,
) -> tuple[xr.DataArray, list[str]]:
    from .hdf5_isolated import isolated
    from .native import check_provenance, read_intact

    ds = read_intact(path)
    if ds is not None:
        return _stored_cube(ds, variable, axes, wavelengths), []
    with isolated(path) as listing:
        check_provenance(listing)
        return choose_cube(listing.variables, variable, axes, wavelengths)


def _stored_cube(
    ds: xr.Dataset,
    variable: str | None,
    axes: str | Sequence[str] | None,
    wavelengths: Sequence[float] | np.ndarray | None,
) -> xr.DataArray:
    """The cube of a native file, exactly as it was written but for what the caller wants otherwise."""
    names = [name for name, one in ds.data_vars.items() if set(one.dims) == set(AXES)]
    if variable is None and len(names) == 1:
        variable = str(names[0])
    contents = {
        str(name): Variable(one.shape, one.dtype, lambda: np.empty(0), tuple(map(str, one.dims)))
        for name, one in ds.data_vars.items()
    }
    if variable is None or variable not in contents:
        wanted = "several datacubes in it; say which with variable=" if names else "no datacube in it"
        raise ValueError(
            f"there is {wanted if variable is None else f'no variable {variable!r} in it'}; {list_contents(contents)}"
        )
    cube = ds[variable]
    if axes is not None and cube.ndim == 3:
        cube = cube.rename(dict(zip(cube.dims, parse_axes(axes), strict=True))).transpose(*AXES)
    if wavelengths is not None:
        check_cube(cube)
        cube = cube.assign_coords(wavelength=("band", band_centres(wavelengths, cube.sizes["band"]), {"units": "nm"}))
    return cube


def _named_arrays(cube: xr.DataArray, axes: tuple[str, ...]) -> dict[str, np.ndarray]:
    """What goes into a file that is a set of named arrays."""
    name = str(cube.name)
    if cube.name is None or name in ("axes", "wavelength") or not re.fullmatch(r"[A-Za-z]\w{0,30}", name, re.ASCII):
        name = "datacube"
    arrays = {name: cube.transpose(*axes).values, "axes": np.array(",".join(axes))}
    if "wavelength" in cube.coords:
        arrays["wavelength"] = cube.wavelength.values
    return arrays
