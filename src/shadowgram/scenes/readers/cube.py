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

from .atomic import replace_file, replace_files
from .choose import choose_cube, list_contents, parse_axes
from .envi import data_files, envi_parts
from .mat5 import mat5_bytes
from .numpy_files import npy_bytes, npz_bytes
from .opened import check_file, dataset_variables, file_kind, opened
from .png_folder import write_folder
from .tiff_writer import ome_tiff


def read(
    path: str | os.PathLike[str],
    *,
    variable: str | None = None,
    axes: str | Sequence[str] | None = None,
    wavelengths: Sequence[float] | np.ndarray | None = None,
) -> xr.DataArray:
    """Read a datacube: native, NetCDF-4, MATLAB, NumPy, ENVI, TIFF or a folder of PNG, told apart by their contents.

    A native file comes back as it was written. From others, images of 8 and 16 bits (uint8, uint16) are divided by
    their full scale, 255 or 65535, which is kept as the attribute `scale`; other whole numbers become float32, and
    float32 and float64 stay as they are. Doubles that MATLAB found to be whole numbers and stored in 8 or 16 bits count
    as images, unless they are all zeros and ones.

    Parameters
    ----------
    path : the file; of ENVI the header or the data; or a folder with a grey PNG picture a band, `ms_01.png`, …, or
        `scene_450nm.png`, … Of a TIFF file, the bands are the pages, or the samples of a single page.
    variable : name of the cube in the file; else the only one with three axes.
    axes : order of the axes in the file, "y,x,band" or ("y", "x", "band"); else what the file says, or the shortest
        axis is taken for the bands. MATLAB's order is the one that MATLAB shows.
    wavelengths : nm. The centre of each band, or of the first and the last; else what the file says, or a variable with
        a name like `wavelength_nm`, `lambda` or `bands`, or 400 to 700 nm. ENVI headers, OME-TIFF and names of pictures
        say them, too.

    Returns
    -------
    xarray.DataArray
        Axes (band, y, x), with the coordinate `wavelength` in nm.

    Warns
    -----
    UserWarning
        If something had to be guessed; it says what, in the words in which it can be said. Also if the file marks bands
        as bad, which are kept, or values as missing, which become 0; and if something that it says was left out.

    Raises
    ------
    ValueError
        If the file is damaged, of no known format, does not hold the variable, or holds no cube of finite numbers.
    OSError
        If there is no such file, it cannot be opened, or an ENVI header has no data file.

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
    check_file(path, folder=True)
    notes: list[str] = []
    try:
        if path.is_file() and file_kind(path) == "hdf5" and (ds := _intact(path)) is not None:
            cube, guesses = _stored_cube(ds, variable, axes, wavelengths), []
        else:
            with opened(path, wavelengths_said=wavelengths is not None) as contents:
                cube, guesses = choose_cube(contents.variables, variable, axes, wavelengths)
                notes = contents.notes
        check_cube(cube)
    except ValueError as error:
        raise ValueError(f"cannot read {path}: {error}") from error
    if notes:
        warnings.warn(f"{path.name}: {'; '.join(notes)}", stacklevel=2)
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
    ``.hdr``  ENVI: values (band, y, x) in a file ``.dat`` beside it, and `wavelength` in nm; no attributes
    ``.tif``  OME-TIFF (also ``.tiff``): a page a band, and `wavelength` in nm; no attributes
    (none)    a new folder with a PNG picture a band, its number and wavelength in the name: values in [0, 1] as 16
              bits, whole numbers of 8 or 16 bits as they are
    ========  =====================================================================================================

    Types that a format does not have, such as bool in most of them, become floats.

    Parameters
    ----------
    cube : (band, y, x) finite real numbers.
    path : the file, or for PNG pictures the folder.

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
    elif suffix == ".hdr":
        _write_envi(cube, Path(path))
    elif suffix in (".tif", ".tiff"):
        replace_file(path, ome_tiff(cube.values, _centres(cube), _plain_name(cube)))
    elif not suffix and Path(path).name:
        try:
            write_folder(cube.values, _centres(cube), _plain_name(cube), path)
        except ValueError as error:
            raise ValueError(f"cannot write {path}: {error}") from error
    else:
        raise ValueError(
            f"cannot write {path}: its name must end with .nc, .mat, .npz, .npy, .hdr or .tif, "
            "or have no ending for a folder of PNG pictures"
        )


def _intact(path: Path) -> xr.Dataset | None:
    from .native import read_intact

    return read_intact(path)


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
    contents = dataset_variables(ds)
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


def _write_envi(cube: xr.DataArray, header: Path) -> None:
    data = header.with_suffix(".dat")
    for other in data_files(header):
        if other != data:
            raise ValueError(f"cannot write {header}: {other.name} would be taken for its data; choose another name")
    values, text = envi_parts(cube.values, _centres(cube), _plain_name(cube))
    replace_files([(data, [values.reshape(-1).view(np.uint8).data]), (header, [text])])


def _centres(cube: xr.DataArray) -> np.ndarray | None:
    """Wavelengths (band,) in nm, None where the cube has none; checked, as they may have been changed."""
    return band_centres(cube.wavelength.values, cube.sizes["band"]) if "wavelength" in cube.coords else None


def _plain_name(cube: xr.DataArray) -> str:
    """The cube's name, or `datacube` where it has none or one that is no plain word."""
    name = str(cube.name)
    if cube.name is None or name in ("axes", "wavelength") or not re.fullmatch(r"[A-Za-z]\w{0,30}", name, re.ASCII):
        return "datacube"
    return name


def _named_arrays(cube: xr.DataArray, axes: tuple[str, ...]) -> dict[str, np.ndarray]:
    """What goes into a file that is a set of named arrays."""
    arrays = {_plain_name(cube): cube.transpose(*axes).values, "axes": np.array(",".join(axes))}
    if "wavelength" in cube.coords:
        arrays["wavelength"] = cube.wavelength.values
    return arrays
