"""The door for arrays that are no datacubes: masks, snapshots, frames of a camera."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from .choose import list_contents
from .contents import Variable
from .opened import check_file, load_checked, opened


def read_array(path: str | os.PathLike[str], variable: str | None = None) -> np.ndarray:
    """Read an array of two or three axes from a file: a mask, a snapshot, a stack of them.

    Values, types and the order of the axes are those of the file: nothing is scaled, and a picture of 8 bits comes back
    as uint8. MATLAB's order is the one that MATLAB shows.

    Parameters
    ----------
    path : MATLAB 5 to 7.3, `.npy`, `.npz`, NetCDF-4, TIFF or a grey PNG, told apart by their contents.
    variable : name of the array in the file; else the only one of two or three axes. Numbers and lists of them, which
        MATLAB keeps as arrays of one row, do not count where there is anything else.

    Returns
    -------
    numpy.ndarray
        Finite real numbers, (a, b) or (a, b, c).

    Raises
    ------
    ValueError
        If the file is damaged, of no known format, has no such array or several, or some values are NaN or infinite.
    OSError
        If there is no such file, or it cannot be opened.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> import shadowgram as sg
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "mask.npz"
    >>> np.savez(path, mask=np.eye(2, dtype=np.uint8), pitch=7.4)
    >>> sg.scenes.read_array(path)
    array([[1, 0],
           [0, 1]], dtype=uint8)
    """
    path = Path(path)
    check_file(path)
    try:
        with opened(path) as contents:
            name = variable if variable is not None else _only_array(contents.variables)
            return load_checked(_named(contents.variables, name), name)
    except ValueError as error:
        raise ValueError(f"cannot read {path}: {error}") from error


def _is_array(variable: Variable) -> bool:
    return variable.dtype is not None and variable.dtype.kind in "fiub" and len(variable.shape) in (2, 3)


def _only_array(variables: Mapping[str, Variable]) -> str:
    fitting = {name: one for name, one in variables.items() if _is_array(one) and min(one.shape) > 0}
    areas = {name: one for name, one in fitting.items() if sum(count > 1 for count in one.shape) > 1}
    names = list(areas or fitting)
    if len(names) != 1:
        which = "are several arrays" if names else "is no array"
        what = "; say which with variable=" if names else ""
        raise ValueError(f"there {which} of two or three axes in it{what}; {list_contents(variables)}")
    return names[0]


def _named(variables: Mapping[str, Variable], name: str) -> Variable:
    if name not in variables:
        raise ValueError(f"there is no variable '{name}' in it; {list_contents(variables)}")
    chosen = variables[name]
    if not _is_array(chosen) or min(chosen.shape) == 0:
        raise ValueError(f"variable '{name}' is not an array of two or three axes; it is {chosen.describe()}")
    return chosen
