"""Patterns of coded masks: which cells are holes, from a file, at random, or written out.

A pattern is (row, column) uint8, 1 = hole.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shadowgram.codes.patterns import random
from shadowgram.scenes.readers.choose import list_contents
from shadowgram.scenes.readers.contents import Variable

from ._png import read_png

Pattern = NDArray[np.uint8]

_LARGEST_TEXT = 50_000_000  # bytes


def random_pattern(rows: int, columns: int, transmittance: float, seed: int) -> Pattern:
    """Independent cells, each a hole with probability `transmittance`: one shot of `shadowgram.codes.random`.

    Examples
    --------
    >>> from shadowgram.xray.patterns import random_pattern
    >>> random_pattern(32, 543, 0.1, seed=0).mean().round(2)
    np.float64(0.1)
    """
    return random(shots=1, shape=(rows, columns), seed=seed, transmittance=transmittance)[0]


def check_pattern(values: ArrayLike) -> Pattern:
    """A pattern from any array (row, column), or one shot (1, row, column), of two values, the larger one open.

    Raises
    ------
    ValueError
        If it is not such an array.

    Examples
    --------
    >>> from shadowgram.xray.patterns import check_pattern
    >>> check_pattern([[0, 255], [255, 0]]).tolist()
    [[0, 1], [1, 0]]
    """
    array = np.asarray(values)
    if array.ndim == 3 and len(array) == 1:
        array = array[0]
    if array.ndim != 2 or not array.size or array.dtype.kind not in "biuf":
        raise ValueError(f"a pattern has rows and columns of numbers, got {array.dtype} of shape {array.shape}")
    found = np.unique(array)
    if len(found) > 2 or found[0] not in (0, found[-1]) or not (np.isfinite(found).all() and found[-1] >= 0):
        raise ValueError(
            f"a pattern has two values, 0 for closed and one for holes, got {len(found)} from {found[0]:g} to {found[-1]:g}"
        )
    return (array > 0).astype(np.uint8)


def written(pattern: ArrayLike) -> tuple[str, ...]:
    """A pattern as one text of 0 and 1 a row, as a scene keeps it.

    Examples
    --------
    >>> from shadowgram.xray.patterns import read_written, written
    >>> written([[0, 1, 1], [1, 0, 0]])
    ('011', '100')
    >>> read_written(("011", "100")).tolist()
    [[0, 1, 1], [1, 0, 0]]
    """
    return tuple("".join("01"[cell] for cell in row) for row in check_pattern(pattern))


def read_written(rows: Sequence[str]) -> Pattern:
    """The pattern that `written` wrote.

    Raises
    ------
    ValueError
        If the rows differ in length or hold anything but 0 and 1.
    """
    for row in rows:
        if not row or len(row) != len(rows[0]) or row.strip("01"):
            raise ValueError("the rows of a pattern must be texts of 0 and 1 of one length, such as '0110'")
    return np.array([list(map(int, row)) for row in rows], np.uint8)


def read_pattern(path: str | Path) -> Pattern:
    r"""Read a pattern from a file.

    Parameters
    ----------
    path : .npy; .npz, .mat or .nc with one array of rows and columns; .csv, a row a line; or .png, holes white.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is of another kind, damaged, or holds no pattern.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from shadowgram.xray.patterns import read_pattern
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "mask.csv"
    >>> _ = path.write_text("0, 1, 1\n1, 0, 0\n")
    >>> read_pattern(path).tolist()
    [[0, 1, 1], [1, 0, 0]]
    """
    path = Path(path)
    check_file(path)
    suffix = path.suffix.lower()
    try:
        if suffix == ".png":
            return check_pattern(read_png(path))
        if suffix in (".csv", ".txt"):
            return check_pattern(_read_table(path))
        return check_pattern(only_array(path, axes=(2, 3)))
    except ValueError as error:
        raise ValueError(f"cannot read the pattern {path}: {error}") from error


def check_file(path: Path) -> None:
    """Raise an OSError that says what is there, unless there is a file."""
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder; give a file in it")
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")


def only_array(path: Path, axes: tuple[int, ...]) -> np.ndarray:
    """The only array of real numbers with so many axes in a .npy, .npz, .mat or .nc file.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is of another kind, damaged, or has no such array or several.
    """
    from shadowgram.scenes.readers.mat5 import mat5_variables
    from shadowgram.scenes.readers.numpy_files import npy_variables, npz_variables

    listers: dict[str, Callable[[Path], Mapping[str, Variable]]] = {
        ".npy": npy_variables,
        ".npz": npz_variables,
        ".mat": mat5_variables,
    }
    suffix = path.suffix.lower()
    if suffix in (".nc", ".h5") or (suffix == ".mat" and not _is_matlab5(path)):
        from shadowgram.scenes.readers.hdf5_isolated import isolated

        with isolated(path) as listing:
            return _chosen(listing.variables, axes).load()
    if suffix not in listers:
        raise ValueError(f"arrays are read from .npy, .npz, .mat and .nc files, not from {suffix or 'this one'}")
    return _chosen(listers[suffix](path), axes).load()


def _is_matlab5(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(128)[124:] in (b"\x00\x01IM", b"\x01\x00MI")


def _chosen(variables: Mapping[str, Variable], axes: tuple[int, ...]) -> Variable:
    for count in axes:
        fitting = [
            one
            for one in variables.values()
            if one.dtype is not None and one.dtype.kind in "biuf" and len(one.shape) == count and min(one.shape) > 0
        ]
        # A MATLAB number is an array of two axes too.
        fitting = [one for one in fitting if max(one.shape) > 1] or fitting
        if len(fitting) == 1:
            return fitting[0]
        if fitting:
            raise ValueError(f"there are several arrays of {count} axes in it; {list_contents(variables)}")
    raise ValueError(f"there is no array of {' or '.join(map(str, axes))} axes in it; {list_contents(variables)}")


def _read_table(path: Path) -> list[list[float]]:
    if path.stat().st_size > _LARGEST_TEXT:
        raise ValueError("it is too large for a pattern")
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise ValueError("it is not a text file") from None
    rows: list[list[float]] = []
    for number, line in enumerate(lines, 1):
        words = re.split(r"[,;\s]+", line.split("#")[0].strip())
        if words == [""]:
            continue
        try:
            rows.append([float(word) for word in words])
        except ValueError:
            raise ValueError(f"line {number} must be numbers, got {line[:60]!r}") from None
        if len(rows[-1]) != len(rows[0]):
            raise ValueError(f"line {number} has {len(rows[-1])} columns, and the first one {len(rows[0])}")
    return rows
