"""Files of captured scans: codes, counts, and a run without target, from MATLAB, NumPy or a native scan.

| file | codes | counts |
|---|---|---|
| .mat (5 to 7.3) | a cell array with a code in each cell (``codes_bin``), or one array | ``y``, ``y_target``, ``air`` … |
| .npz, .npy | (shot, y, x), or (shot, pixel) with a shape | (shot,), or images (shot, y, x) that are summed |
| .nc | a scan by `shadowgram.xray.write_scan`, with all three | |

Of several arrays that would do, one with a usual name is taken. Nothing is unpickled, and a damaged file is a ``ValueError``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from shadowgram.scenes.readers.choose import list_contents
from shadowgram.scenes.readers.contents import Variable
from shadowgram.scenes.readers.numpy_files import npy_variables, npz_variables
from shadowgram.scenes.readers.opened import is_hdf5

from . import captured
from .patterns import check_file

CODES = ("codes", "code_shift", "codes_bin", "code", "mask")
COUNTS = ("counts", "y", "y_target", "target")
BACKGROUND = ("background", "air", "y_empty", "y_air", "empty")
"""Usual names, the first ones first."""


def read_capture(
    codes: str | Path,
    counts: str | Path | None = None,
    background: str | Path | None = None,
    *,
    shape: tuple[int, int] | None = None,
    block: float | None = None,
) -> captured.Capture:
    """Read a scan that was captured, from one file to three.

    Parameters
    ----------
    codes : file of the codes; a native scan (.nc) has counts and background, too.
    counts : file of the counts; None where `codes` has them.
    background : file of the run without target, if there was one.
    shape : (y, x) of the codes, where they are kept as (shot, pixel), rows after rows.
    block : detector pixels a cell, where the codes are images of them; see `shadowgram.xray.captured.block_means`.

    Raises
    ------
    OSError
        If a file cannot be read.
    ValueError
        If one is damaged, holds no such array or several, or they do not fit together; the message names the file.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from shadowgram.xray.capture_files import read_capture
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "scan.npz"
    >>> np.savez(path, codes=np.ones((3, 4, 4), np.uint8), y=np.array([5, 4, 6]), air=np.array([2, 2, 1]))
    >>> scan = read_capture(path)
    >>> scan.counts, scan.background
    (array([5., 4., 6.]), array([2., 2., 1.]))
    """
    first = Path(codes)
    if first.suffix.lower() == ".nc":
        return _native(first, counts, background)
    there = _variables(first)
    y = _numbers(first, there, COUNTS, images=False) if counts is None else _read_numbers(Path(counts), COUNTS)
    if background is not None:
        air = _read_numbers(Path(background), (*BACKGROUND, *COUNTS))
    else:
        air = None if counts is not None else _named_numbers(first, there, BACKGROUND)
    patterns = _codes(first, there, len(y), shape, block)
    return captured.Capture(codes=patterns, counts=y, background=air)


def _native(path: Path, counts: str | Path | None, background: str | Path | None) -> captured.Capture:
    from .scan_file import read_scan

    if counts is not None:
        raise ValueError(f"{path} is a scan with counts of its own; give no other file of counts")
    scan = read_scan(path)
    air = scan.background if background is None else _read_numbers(Path(background), (*BACKGROUND, *COUNTS))
    return captured.Capture(codes=scan.codes, counts=scan.counts, background=air)


def _read_numbers(path: Path, names: tuple[str, ...]) -> np.ndarray:
    return _numbers(path, _variables(path), names)


def _variables(path: Path) -> dict[str, Variable]:
    """What is in a file, by name."""
    check_file(path)
    suffix = path.suffix.lower()
    try:
        if suffix == ".npz":
            return npz_variables(path)
        if suffix == ".npy":
            return npy_variables(path)
        if suffix == ".mat":
            return _matlab(path)
    except ValueError as error:
        raise ValueError(f"cannot read {path}: {error}") from error
    raise ValueError(f"{path} must be a .mat, .npz, .npy or .nc file")


def _matlab(path: Path) -> dict[str, Variable]:
    from shadowgram.scenes.readers.hdf5_isolated import isolated
    from shadowgram.scenes.readers.mat5 import mat5_variables

    from ._captured_cells import hdf5_cells, mat5_cells

    with path.open("rb") as file:
        head = file.read(520)
    if not is_hdf5(head):
        return mat5_variables(path) | mat5_cells(path)
    with isolated(path) as listing:
        # They can be loaded only here, and a scan has no large ones that are not needed.
        plain = {name: _loaded(one) for name, one in listing.variables.items()}
    return plain | hdf5_cells(path)


def _loaded(variable: Variable) -> Variable:
    if variable.dtype is None or variable.dtype.kind not in "biuf":
        return variable
    values = variable.load()
    return Variable(variable.shape, variable.dtype, lambda: values)


def _chosen(path: Path, fitting: Mapping[str, Variable], names: tuple[str, ...], what: str, all_of: str) -> str:
    """Name of the only variable that fits, or of the one with the most usual name."""
    for name in names:
        if name in fitting:
            return name
    if len(fitting) == 1:
        return next(iter(fitting))
    if fitting:
        raise ValueError(f"{path} has several arrays that may be {what}; call the right one '{names[0]}'; {all_of}")
    raise ValueError(f"{path} holds no {what}; {all_of}")


def _load(path: Path, variable: Variable) -> np.ndarray:
    try:
        return variable.load()
    except ValueError as error:
        raise ValueError(f"cannot read {path}: {error}") from error


def _is_real(variable: Variable) -> bool:
    return variable.dtype is not None and variable.dtype.kind in "biuf" and min(variable.shape, default=0) > 0


def _is_line(variable: Variable) -> bool:
    return len([n for n in variable.shape if n > 1]) == 1


def _fits_counts(variable: Variable) -> bool:
    """One number a shot, or an image a shot."""
    return _is_real(variable) and (_is_line(variable) or (len(variable.shape) == 3 and min(variable.shape) > 1))


def _numbers(path: Path, there: Mapping[str, Variable], names: tuple[str, ...], *, images: bool = True) -> np.ndarray:
    """Counts (shot,) of a file; with `images` perhaps as sums of a detector's images, for which codes must not be taken."""
    fitting = {name: one for name, one in there.items() if _fits_counts(one)}
    fitting = {name: one for name, one in fitting.items() if _is_line(one) or (images and name not in CODES)}
    lines = {name: one for name, one in fitting.items() if _is_line(one)}
    what = "counts (a number a shot)"
    name = _chosen(path, lines or fitting, names, what, list_contents(there))
    values = _load(path, there[name])
    if lines:
        return values.ravel()
    return captured.summed(values, divisor=1.0)


def _named_numbers(path: Path, there: Mapping[str, Variable], names: tuple[str, ...]) -> np.ndarray | None:
    for name in names:
        if name in there and _fits_counts(there[name]):
            values = _load(path, there[name])
            return (
                captured.summed(values, divisor=1.0) if values.ndim == 3 and min(values.shape) > 1 else values.ravel()
            )
    return None


def _codes(
    path: Path, there: Mapping[str, Variable], shots: int, shape: tuple[int, int] | None, block: float | None
) -> np.ndarray:
    axes = 3 if shape is None else 2
    fitting = {name: one for name, one in there.items() if _is_real(one) and len(one.shape) == axes}
    what = "codes (shot, y, x)" if shape is None else "codes (shot, pixel)"
    name = _chosen(path, fitting, CODES, what, list_contents(there))
    values = _by_shot(path, _load(path, there[name]), shots)
    if shape is not None:
        if values.shape[1] != shape[0] * shape[1]:
            raise ValueError(
                f"the codes of {path} have {values.shape[1]} pixels, which are not {shape[0]} × {shape[1]}; give their shape"
            )
        values = values.reshape(len(values), *shape)
    try:
        if block is not None:
            return captured.binary_codes(captured.block_means(values, block))
        return captured.checked_codes(values)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _by_shot(path: Path, values: np.ndarray, shots: int) -> np.ndarray:
    """Codes with the shots first; MATLAB's come last where they are one array."""
    if len(values) == shots:
        return values
    if values.ndim == 3 and values.shape[2] == shots:
        return np.moveaxis(values, 2, 0)
    count = len(values) if path.suffix.lower() != ".mat" or values.ndim == 2 else max(len(values), values.shape[2])
    raise ValueError(f"there are {count} codes in {path} and {shots} counts; give one for each code")
