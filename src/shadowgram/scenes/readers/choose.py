"""Which variable of a file is the cube, which of its axes are the bands, and where their wavelengths are.

What the caller or the file says is taken; the rest is guessed, and each guess is put into words for a warning.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from shadowgram.scenes.datacube import AXES, band_centres, label

from .contents import Variable

_WAVELENGTH_NAME = re.compile(r"wave|lambda|^wl|^bands?$|cent(er|re)s?|^nm$", re.IGNORECASE)
_ASSUMED = (400.0, 700.0)  # nm, where nothing is said: the visible


def choose_cube(
    variables: Mapping[str, Variable],
    variable: str | None,
    axes: str | Sequence[str] | None,
    wavelengths: Sequence[float] | np.ndarray | None,
) -> tuple[xr.DataArray, list[str]]:
    """The cube among the variables of a file, and what had to be guessed."""
    guesses: list[str] = []
    name = variable if variable is not None else _only_cube(variables, guesses)
    chosen = _named(variables, name)
    found = _wavelength_variables(variables)
    count = 0 if wavelengths is None else len(np.atleast_1d(np.asarray(wavelengths)))
    lengths = {count} if count > 2 else {int(np.prod(variables[one].shape)) for one in found}
    order = _stated_axes(variables, chosen)
    if order:
        guesses.clear()  # a file that names the axes of its only cube leaves nothing to guess about it
    if axes is not None:
        order = parse_axes(axes)
    order = order or _guess_axes(chosen, lengths, guesses)
    values, scale = _as_float(chosen.load().transpose([order.index(axis) for axis in AXES]))
    if wavelengths is None and not found and "colours" in chosen.attrs:
        raise ValueError("it is a picture in red, green and blue; say wavelengths= if they are bands of a datacube")
    if wavelengths is None:
        wavelengths = _find_wavelengths(variables, found, len(values), guesses)
    cube = label(values, band_centres(wavelengths, len(values)), name)
    if scale or "scale" in chosen.attrs:
        cube.attrs["scale"] = scale or chosen.attrs["scale"]
    return cube, guesses


def parse_axes(axes: str | Sequence[str]) -> tuple[str, ...]:
    """Axes as the caller says them, "y,x,band" or a sequence of names; checked."""
    order = tuple(part.strip() for part in (axes.split(",") if isinstance(axes, str) else axes))
    if sorted(order) != sorted(AXES):
        raise ValueError(f"axes must name band, y and x in the order of the file, such as 'y,x,band'; got {axes!r}")
    return order


def list_contents(variables: Mapping[str, Variable]) -> str:
    """What a file holds, in words."""
    parts = [f"'{name}' ({variable.describe()})" for name, variable in variables.items()]
    more = f" and {len(parts) - 12} more" if len(parts) > 12 else ""
    return f"it holds {', '.join(parts[:12])}{more}" if parts else "it holds no variables"


def _only_cube(variables: Mapping[str, Variable], guesses: list[str]) -> str:
    names = [name for name, one in variables.items() if _is_real(one) and len(one.shape) == 3]
    if len(names) != 1:
        which = "several arrays" if names else "no array"
        what = "; say which with variable=" if names else ""
        raise ValueError(f"there is {which} of three axes in it{what}; {list_contents(variables)}")
    guesses.append(f"variable='{names[0]}' ({variables[names[0]].describe()})")
    return names[0]


def _named(variables: Mapping[str, Variable], name: str) -> Variable:
    if name not in variables:
        raise ValueError(f"there is no variable '{name}' in it; {list_contents(variables)}")
    chosen = variables[name]
    if not _is_real(chosen):
        raise ValueError(f"variable '{name}' is {chosen.problem or 'text'}, and a datacube is an array of real numbers")
    if len(chosen.shape) != 3:
        raise ValueError(f"variable '{name}' ({chosen.describe()}) has {len(chosen.shape)} axes; a datacube has three")
    if 0 in chosen.shape:
        raise ValueError(f"variable '{name}' is empty: {chosen.describe()}")
    return chosen


def _is_real(variable: Variable) -> bool:
    return variable.dtype is not None and variable.dtype.kind in "fiub"


def _stated_axes(variables: Mapping[str, Variable], chosen: Variable) -> tuple[str, ...] | None:
    """Axes that the file itself names: NetCDF dimensions, or the text `axes` that `write` adds."""
    if chosen.dims is not None:
        if "shot" in chosen.dims:
            raise ValueError(f"it holds snapshots with axes ({', '.join(chosen.dims)}), not a datacube")
        spectral = [one for one in chosen.dims if _WAVELENGTH_NAME.search(one)]
        if len(spectral) == 1:
            rest = iter(
                [one for one in chosen.dims if one in ("y", "x")] if set(chosen.dims) >= {"y", "x"} else ("y", "x")
            )
            return tuple("band" if one in spectral else next(rest) for one in chosen.dims)
    said = variables.get("axes")
    if said is not None and said.dtype is not None and said.dtype.kind == "U" and not said.shape:
        return parse_axes(str(said.load()[()]))
    return None


def _guess_axes(chosen: Variable, lengths: set[int], guesses: list[str]) -> tuple[str, ...]:
    shape = chosen.shape
    fitting = [i for i in range(3) if shape[i] in lengths]
    why = "as many as there are wavelengths"
    if len(fitting) != 1:
        fitting = [i for i in range(3) if shape[i] == min(shape)]
        why = "the shortest axis"
    if len(fitting) != 1:
        raise ValueError(
            f"it cannot be told which axis of {' × '.join(map(str, shape))} is the band; "
            "say it with axes=, such as axes='y,x,band'"
        )
    order = ["y", "x"]
    order.insert(fitting[0], "band")
    guesses.append(f"axes='{','.join(order)}' (the bands are {why})")
    return tuple(order)


def _as_float(values: np.ndarray) -> tuple[np.ndarray, int]:
    """Contiguous floats, and the full scale that whole numbers were divided by (0: none).

    Images of 8 and 16 bits become shares of their full scale; other whole numbers have none that is known.
    """
    if values.dtype in (np.uint8, np.uint16):
        scale = int(np.iinfo(values.dtype).max)
        return np.divide(values, np.float32(scale), out=np.empty(values.shape, np.float32)), scale
    dtype = np.float64 if values.dtype.kind == "f" and values.dtype.itemsize > 4 else np.float32
    return np.ascontiguousarray(values, dtype), 0


def _wavelength_variables(variables: Mapping[str, Variable]) -> list[str]:
    return [
        name
        for name, one in variables.items()
        if _WAVELENGTH_NAME.search(name)
        and _is_real(one)
        and 1 <= len(one.shape) <= 2
        and (2 if name != "wavelength" else 1) <= max(one.shape) == np.prod(one.shape)
    ]


def _find_wavelengths(
    variables: Mapping[str, Variable], found: list[str], bands: int, guesses: list[str]
) -> Sequence[float] | np.ndarray:
    for name in sorted(found, key=lambda one: one != "wavelength"):
        if int(np.prod(variables[name].shape)) != bands:
            continue
        values = np.asarray(variables[name].load(), np.float64).ravel()
        if name == "wavelength" and variables[name].attrs.get("units") == "nm":
            return values
        centres, unit = _in_nm(values)
        if centres is not None:
            if name != "wavelength" or unit != "nm":
                guesses.append(f"wavelengths from '{name}' in {unit} ({centres[0]:g} to {centres[-1]:g} nm)")
            return centres
    guesses.append(f"wavelengths=({_ASSUMED[0]:g}, {_ASSUMED[1]:g}) nm, as the file has none")
    return _ASSUMED


def _in_nm(values: np.ndarray) -> tuple[np.ndarray | None, str]:
    """Wavelengths in nm from numbers that may be nm or µm; None where they look like neither, such as band numbers."""
    low, high = float(np.min(values)), float(np.max(values))
    steps = np.diff(values)
    if not ((steps > 0).all() or (steps < 0).all()):
        return None, ""
    if low >= 100 and high <= 30_000:
        return values, "nm"
    if low >= 0.1 and high <= 30 and (values % 1).any():
        return values * 1000, "µm"
    return None, ""
