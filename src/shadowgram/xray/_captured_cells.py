"""Cell arrays of MATLAB files whose cells are arrays of one shape, such as a code a shot; as one array (cell, row, column).

`shadowgram.scenes.readers.mat5` reads everything else. A file of version 7.3 is opened in a process of its own, as
`shadowgram.scenes.readers.hdf5_isolated` does, because the HDF5 library can crash on a damaged file.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from functools import partial
from math import prod
from pathlib import Path

import numpy as np

from shadowgram.scenes.readers import mat5
from shadowgram.scenes.readers.contents import FREE_BYTES, Variable, check_size

_CELL = 1  # of the kinds of MATLAB arrays
_MOST = 100_000  # cells


def mat5_cells(path: Path) -> dict[str, Variable]:
    """The cell arrays of a MATLAB 5 file by name; those that hold anything but arrays of one shape cannot be loaded.

    Raises
    ------
    ValueError
        If the file is damaged.
    """
    size = path.stat().st_size
    found = {}
    with path.open("rb") as file:
        order = mat5._byte_order(file.read(128))
        for kind, start, length in mat5._elements(file, size, order):
            file.seek(start)
            body = file.read(min(length, 2 * mat5._HEAD))
            if kind == mat5._COMPRESSED:
                body = mat5._inflated_start(body)
            head = mat5._head(body[: mat5._HEAD], order)
            if head.kind == _CELL and head.name and prod(head.shape) > 0:
                element = partial(mat5._whole, path, kind, start, length, order, size)
                shape = (prod(head.shape), *_first_shape(element(), head, order))
                check_size(shape, 1, size)
                found[head.name] = Variable(shape, np.dtype(np.float64), partial(_cells, element, head, order, size))
    return found


def _first_shape(element: bytes, head: mat5._Head, order: str) -> tuple[int, ...]:
    body, _ = _next(element, head.values, order)
    return mat5._head(body, order).shape


def _cells(element: partial[bytes], head: mat5._Head, order: str, size: int) -> np.ndarray:
    whole, at = element(), head.values
    count = prod(head.shape)
    if count > _MOST:
        raise ValueError(f"'{head.name}' has {count} cells, more than {_MOST}")
    found: list[np.ndarray] = []
    for _ in range(count):
        body, at = _next(whole, at, order)
        found.append(_cell(body, head.name, order, size))
        if found[-1].shape != found[0].shape:
            raise ValueError(
                f"the cells of '{head.name}' must be arrays of one shape, got {found[0].shape} and {found[-1].shape}"
            )
    # The reader makes floats of bytes that are all 0 and 1, and a code may have no open cell.
    return np.stack(found)


def _next(element: bytes, at: int, order: str) -> tuple[bytes, int]:
    """A cell with its tag, and where the next one begins."""
    kind, start, length, after = mat5._tag(element, at, order)
    if kind != mat5._MATRIX or start != at + 8 or start + length > len(element):
        raise ValueError("a cell in it is truncated or damaged")
    return element[at : start + length], after


def _cell(body: bytes, name: str, order: str, size: int) -> np.ndarray:
    head = mat5._head(body, order)
    if head.kind not in mat5._NUMERIC or head.complex:
        raise ValueError(f"the cells of '{name}' must be arrays of real numbers")
    dtype = np.dtype(bool) if head.logical else np.dtype(mat5._NUMERIC[head.kind])
    check_size(head.shape, dtype.itemsize, size)
    return mat5._numbers(body, head, dtype, order)


def hdf5_cells(path: Path) -> dict[str, Variable]:
    """The same for a MATLAB file of version 7.3."""
    answer, values = _ask(path)
    found = {}
    at = 0
    for one in answer["cells"]:
        shape, dtype = tuple(one["shape"]), np.dtype(one["dtype"])
        count = prod(shape) * dtype.itemsize
        if dtype.kind not in "biuf" or at + count > len(values):
            raise ValueError("a cell array in it is damaged")
        array = np.frombuffer(values, dtype, prod(shape), at).reshape(shape)
        # MATLAB's columns come first in the file.
        array = array.transpose(0, *range(array.ndim - 1, 0, -1))
        found[str(one["name"])] = Variable(array.shape, array.dtype, partial(np.asarray, array))
        at += count
    return found


def _ask(path: Path) -> tuple[dict, memoryview]:
    size = path.stat().st_size
    seconds = 20 + size // 10_000_000
    request = {
        "path": os.fspath(path),
        "modules": sys.path,
        "seconds": seconds,
        "memory": 2**30 + 3 * FREE_BYTES + 20 * size,
        "most": FREE_BYTES + 10 * size,
    }
    script = Path(__file__).with_name("_captured_hdf5_child.py")
    try:
        done = subprocess.run(
            [sys.executable, "-I", os.fspath(script), json.dumps(request)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            timeout=10 * seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise ValueError("the HDF5 library did not finish reading it; it is damaged") from None
    line, _, rest = done.stdout.partition(b"\n")
    try:
        answer = json.loads(line)
    except ValueError:
        answer = None
    if not isinstance(answer, dict):
        raise ValueError("the HDF5 library crashed on it; it is damaged")
    if "error" in answer:
        raise ValueError(f"the HDF5 library cannot read it ({str(answer['error'])[:200]}); it is truncated or damaged")
    return answer, memoryview(rest)
