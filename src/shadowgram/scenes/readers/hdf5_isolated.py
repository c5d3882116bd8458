"""Variables of HDF5 files that nobody vouches for, MATLAB 7.3 and foreign NetCDF-4, read by a process of their own.

The HDF5 library can crash, loop or take all memory on a damaged file. Here it runs in a process with limits on time and
memory; what comes back is checked again, and every way of failing is one `ValueError`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO

import numpy as np

from .contents import FREE_BYTES, Variable, check_size, unreadable

_PACKING = ("scale_factor", "add_offset", "_FillValue", "missing_value")
_LONGEST_ANSWER = 64 * 2**20


@dataclass(frozen=True)
class Listing:
    """What a HDF5 file holds: its variables by name, its own attributes, and which software says that it wrote it."""

    variables: dict[str, Variable]
    attrs: dict[str, object]
    provenance: str


@contextmanager
def isolated(path: Path) -> Iterator[Listing]:
    """List the variables of a HDF5 file; they can be loaded inside the `with` block.

    Raises
    ------
    ValueError
        If the file is not HDF5, or the library fails on it, takes too long or too much memory.
    """
    child = _Child(path)
    try:
        yield _listing(child, path.stat().st_size)
    finally:
        child.stop()


class _Child:
    """The process, and the questions it can be asked."""

    def __init__(self, path: Path) -> None:
        size = path.stat().st_size
        seconds = 20 + size // 10_000_000
        request = {
            "path": os.fspath(path),
            "modules": sys.path,
            "seconds": seconds,
            # The libraries alone reserve about half of the first GiB of addresses.
            "memory": 2**30 + FREE_BYTES + 2 * size,
        }
        script = Path(__file__).with_name("_hdf5_child.py")
        self._process = subprocess.Popen(
            [sys.executable, "-I", os.fspath(script), json.dumps(request)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._questions, self._answers = self._process.stdin, self._process.stdout
        # Waiting without computing is not in the processor time, which the process limits by itself.
        self._clock = threading.Timer(10 * seconds, self._process.kill)
        self._clock.daemon = True
        self._clock.start()

    def answer(self) -> dict:
        """The next line of JSON."""
        line = self._answers.readline(_LONGEST_ANSWER)
        try:
            answer = json.loads(line)
        except ValueError:
            answer = None
        if not isinstance(answer, dict):
            raise ValueError(self._failure())
        if "error" in answer:
            said = str(answer["error"])[:200]
            raise ValueError(f"the HDF5 library cannot read it ({said}); it is truncated or damaged")
        return answer

    def array(self, name: str, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
        """The array of this name."""
        try:
            self._questions.write(json.dumps(name).encode() + b"\n")
            self._questions.flush()
        except BrokenPipeError:
            raise ValueError(self._failure()) from None
        array = np.empty(shape, dtype)
        if self.answer() != {"bytes": array.nbytes} or not _fill(self._answers, array):
            raise ValueError(self._failure())
        return array

    def _failure(self) -> str:
        self._process.kill()
        code = self._process.wait()
        why = "crashed on it" if code in (-11, -7, -6, -4, -8) else "did not finish reading it"
        return f"the HDF5 library {why}; it is damaged"

    def stop(self) -> None:
        """End the process; it has nothing to lose."""
        self._clock.cancel()
        self._process.kill()
        self._process.wait()
        self._answers.close()
        with suppress(BrokenPipeError):
            self._questions.close()


def _fill(stream: IO[bytes], array: np.ndarray) -> bool:
    view = array.reshape(-1).view(np.uint8).data
    done = 0
    while done < len(view):
        count = stream.readinto(view[done:])  # pyright: ignore[reportAttributeAccessIssue]
        if not count:
            return False
        done += count
    return True


def _listing(child: _Child, file_size: int) -> Listing:
    answer = child.answer()
    variables = {name: _variable(child, name, found, file_size) for name, found in answer["variables"].items()}
    return Listing(variables, answer["attrs"], answer["provenance"])


def _variable(child: _Child, name: str, found: dict, file_size: int) -> Variable:
    if found["problem"]:
        return unreadable(found["problem"])
    shape, dtype = tuple(found["shape"]), np.dtype(found["dtype"])
    check_size(shape, dtype.itemsize, file_size)
    load = partial(child.array, name, shape, dtype)
    if not found["matlab"]:
        attrs = {key: value for key, value in found["attrs"].items() if key not in _PACKING}
        packing = {key: value for key, value in found["attrs"].items() if key in _PACKING}
        kept = np.dtype(np.float64) if _is_packed(packing) else dtype
        dims = tuple(found["dims"] or ())
        dims = dims if len(set(dims)) == len(shape) else None
        return Variable(shape, kept, lambda: _unpacked(load(), packing), dims, attrs)
    # MATLAB writes its column-major arrays as they lie in memory, so that HDF5 sees the axes in reverse.
    kept = np.dtype(bool) if found["matlab"] == "logical" else dtype
    return Variable(shape[::-1], kept, lambda: load().T.astype(kept, copy=False), None, found["attrs"])


def _is_packed(packing: dict) -> bool:
    return "scale_factor" in packing or "add_offset" in packing


def _unpacked(values: np.ndarray, packing: dict) -> np.ndarray:
    """Values as the CF conventions pack them: value = stored · scale_factor + add_offset, missing ones marked."""
    missing = np.zeros(values.shape, bool)
    for key in ("_FillValue", "missing_value"):
        if isinstance(packing.get(key), (int, float)):
            missing |= values == packing[key]
    if _is_packed(packing):
        values = values * float(packing.get("scale_factor", 1)) + float(packing.get("add_offset", 0))
    if missing.any():
        if values.dtype.kind != "f":
            raise ValueError("some of its values are marked as missing; fill them first")
        values[missing] = np.nan
    return values
