"""What a datacube is: an `xarray.DataArray` with axes (band, y, x) and the wavelength of each band in nm."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

AXES = ("band", "y", "x")


def as_datacube(values: np.ndarray, wavelengths: Sequence[float] | np.ndarray, name: str | None = None) -> xr.DataArray:
    """Label an array as a datacube.

    Parameters
    ----------
    values : (band, y, x) real numbers. Kept as they are, not scaled, but stored as contiguous float32; the memory is
        shared with the caller where it already is that.
    wavelengths : nm. One centre for each band, strictly increasing or decreasing; or a pair (first, last), the centres
        of the first and the last band, with the others evenly between them. One band lies in the middle of its pair.
    name : what the cube is called; it names the variable in files.

    Returns
    -------
    xarray.DataArray
        Axes (band, y, x), float32, with the coordinate `wavelength` (band,) in nm.

    Raises
    ------
    ValueError
        If the values are not a finite, non-empty array of three axes, or the wavelengths do not fit them.

    Examples
    --------
    >>> import numpy as np
    >>> import shadowgram as sg
    >>> cube = sg.scenes.as_datacube(np.zeros((4, 8, 8)), (450, 660))
    >>> cube.wavelength.values
    array([450., 520., 590., 660.])
    """
    array = _numbers(np.asarray(values))
    if array.ndim != 3:
        raise ValueError(f"a datacube has three axes, (band, y, x); got an array of shape {array.shape}")
    centres = band_centres(wavelengths, array.shape[0])
    with np.errstate(over="ignore"):  # what does not fit becomes infinite, and is refused below
        array = np.ascontiguousarray(array, np.float32)
    cube = label(array, centres, name)
    check_cube(cube)
    return cube


def label(array: np.ndarray, centres: np.ndarray, name: str | None = None) -> xr.DataArray:
    """Put the axes and the wavelengths (nm) on an array that is known to be (band, y, x)."""
    wavelength = xr.Variable("band", centres, {"units": "nm"})
    return xr.DataArray(array, dims=AXES, coords={"wavelength": wavelength}, name=name)


def band_centres(wavelengths: Sequence[float] | np.ndarray, bands: int) -> np.ndarray:
    """Centres of the bands, (band,) float64 in nm, from all of them or from the first and the last; checked."""
    try:
        given = np.asarray(wavelengths, np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"wavelengths must be numbers in nm, got {wavelengths!r}") from None
    if given.shape not in ((bands,), (2,)):
        raise ValueError(
            f"the cube has {bands} bands: give {bands} wavelengths in nm, or the first and the last; "
            f"got an array of shape {given.shape}"
        )
    if not np.isfinite(given).all() or (given <= 0).any():
        raise ValueError("wavelengths must be finite and positive, in nm")
    if given.shape != (bands,):
        given = np.linspace(given[0], given[1], bands) if bands > 1 else given.mean(keepdims=True)
    steps = np.diff(given)
    if not ((steps > 0).all() or (steps < 0).all()):
        raise ValueError(
            "wavelengths must increase from band to band (or decrease all along); two are equal or out of order"
        )
    return given


def check_cube(cube: xr.DataArray) -> None:
    """Refuse what is not a datacube of finite real numbers.

    Raises
    ------
    TypeError
        If `cube` is not an `xarray.DataArray`.
    ValueError
        If its axes are not (band, y, x), it is empty, it does not hold real numbers, or some are NaN or infinite; the
        message says how many, and where the first is.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.scenes.datacube import check_cube
    >>> check_cube(sg.scenes.as_datacube([[[0.0, 1.0]]], [550]))
    """
    if not isinstance(cube, xr.DataArray):
        raise TypeError(
            f"a datacube is an xarray.DataArray, got {type(cube).__name__}; "
            "make one with scenes.as_datacube(values, wavelengths)"
        )
    if cube.dims != AXES:
        raise ValueError(f"a datacube has axes (band, y, x), got ({', '.join(map(str, cube.dims))})")
    values = _numbers(cube.values)
    if values.dtype.kind != "f":
        return
    finite = np.isfinite(values)
    if not finite.all():
        band, y, x = np.unravel_index(np.argmin(finite), values.shape)
        raise ValueError(
            f"the datacube has {np.count_nonzero(~finite)} values that are NaN or infinite, the first at band {band}, "
            f"y {y}, x {x}; replace them first"
        )


def _numbers(values: np.ndarray) -> np.ndarray:
    if values.dtype.kind not in "fiub":
        raise ValueError(f"a datacube holds real numbers, got an array of {values.dtype}")
    if values.size == 0:
        raise ValueError(f"the datacube is empty: its shape is {values.shape}")
    return values
