"""How many rows a strip has, and which: as many as the memory allows, with a halo that neighbours share."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

from shadowgram.measurement import Imager
from shadowgram.spectral._disperser import Disperser
from shadowgram.spectral.sscsi import SSCSI

from ._strips_rows import Header, detector_rows, imager_rows

# Peak of a strip's reconstruction: so many cubes of its size (the six arrays of EigenTV and another when it begins), and arrays of
# float64 with the axes (shot, shot, y, x) and (shot, y, x). tests/experiments/test_strips.py compares that with what is allocated.
CUBES = 7.5
GRAMS = 2.0
SNAPSHOTS = 3.0
PROCESS = 0.35e9  # bytes of a process with its libraries and compiled kernels


@dataclass(frozen=True, kw_only=True)
class Strip:
    """Rows of the detector, from `first` to `last` (after the last) as reconstructed, of which `start` to `stop` are its own."""

    first: int
    start: int
    stop: int
    last: int


def strips(rows_in_all: int, rows: int, halo: int) -> list[Strip]:
    """Strips of at most `rows` rows each, as even as can be, and up to `halo` more on each side.

    Examples
    --------
    >>> from shadowgram.experiments._strips_plan import strips
    >>> strips(100, 64, 8)
    [Strip(first=0, start=0, stop=50, last=58), Strip(first=42, start=50, stop=100, last=100)]
    """
    count = math.ceil(rows_in_all / rows)
    edges = [rows_in_all * i // count for i in range(count + 1)]
    return [Strip(first=max(0, a - halo), start=a, stop=b, last=min(rows_in_all, b + halo)) for a, b in pairwise(edges)]


def memory(header: Header, rows: int) -> float:
    """Bytes that the reconstruction of so many rows takes at its peak, besides those of the process.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.experiments._strips_plan import memory
    >>> from shadowgram.experiments._strips_rows import Header
    >>> imager = sg.CASSI(cube_shape=(48, 4096, 4096), wavelengths=(450, 650))
    >>> round(memory(Header(imager=imager, shots=2, scene="", double=False, code_bytes=1), 400) / 1e9, 1)
    2.6
    """
    part, shots = imager_rows(header.imager, rows), header.shots
    size = 8 if header.double else 4
    voxels = math.prod(part.resolution.cube_shape)
    elements = rows * _detector_columns(part)
    code = math.prod(part.code_shape)
    # An SSCSI packs its code anew: a bit a shot, or a group of eight shots as float32.
    packed = 32 * -(-shots // 8) if isinstance(part, SSCSI) else 0
    bands, cube_rows, _ = part.resolution.cube_shape
    moments = 16 * bands**2 * cube_rows
    grams = (GRAMS * shots**2 + SNAPSHOTS * shots) * 8 * elements
    return CUBES * size * voxels + moments + grams + (shots * header.code_bytes + packed) * code


def choose_rows(header: Header, halo: int, limit: float, processes: int) -> int:
    """Rows of a strip that keep `processes` reconstructions at once below `limit` bytes, the driver included.

    Raises
    ------
    ValueError
        If not even the smallest strip fits.
    """
    whole, each = detector_rows(header.imager), available(limit, processes)
    if memory(header, whole) <= each:
        return whole
    per_row, least = memory(header, 1), least_rows(halo)
    rows = int(each / per_row) - 2 * halo
    if rows < least:
        needed = needed_limit(per_row * (least + 2 * halo), processes)
        raise ValueError(
            f"the smallest strips, of {least} rows and a halo of {halo} on each side, need {needed / 1e9:.2g} GB in"
            f" {_processes(processes)}, the limit is {limit / 1e9:.2g} GB: allow more, or take fewer workers or a smaller halo"
        )
    return rows


def check_rows(header: Header, rows: int, halo: int, limit: float, processes: int) -> None:
    """Raise a ValueError if strips of `rows` rows are too small for the halo, or too large for the memory."""
    whole = detector_rows(header.imager)
    if rows < whole and rows < least_rows(halo):
        raise ValueError(
            f"strips with a halo of {halo} rows on each side have at least {least_rows(halo)} of their own, got {rows}: most of the"
            " work would be done twice"
        )
    taken = memory(header, min(whole, rows + 2 * halo))
    if taken > available(limit, processes):
        raise ValueError(
            f"strips of {rows} rows need {needed_limit(taken, processes) / 1e9:.2g} GB in {_processes(processes)},"
            f" the limit is {limit / 1e9:.2g} GB: take smaller strips, fewer workers or more memory"
        )


def least_rows(halo: int) -> int:
    """Rows below which most of the work would be done twice."""
    return max(8, 2 * halo)


def available(limit: float, processes: int) -> float:
    """Bytes for one reconstruction. With no processes besides this one, they are in this one."""
    return (limit - PROCESS * (1 + processes)) / max(1, processes)


def needed_limit(each: float, processes: int) -> float:
    """Limit that gives every reconstruction `each` bytes."""
    return each * max(1, processes) + PROCESS * (1 + processes)


def _processes(count: int) -> str:
    return "this process" if count == 0 else f"{count} worker{'s' * (count > 1)} and this process"


def _detector_columns(imager: Imager) -> int:
    if isinstance(imager, SSCSI):
        return imager.detector_shape[1]
    extra = math.ceil(imager.displacements.max()) if isinstance(imager, Disperser) else 0
    return imager.cube_shape[2] + extra
