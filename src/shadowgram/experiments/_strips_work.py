"""What is computed of a strip, wherever that is, and what is kept of it: a file with its rows, and a row in the journal."""

from __future__ import annotations

import hashlib
import math
import os
import platform
import resource
import sys
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from shadowgram._threads import threads
from shadowgram.operators.base import LinearOperator
from shadowgram.scenes.readers.atomic import replace_file
from shadowgram.solvers import _eigen_splitting as rule
from shadowgram.solvers._data_step import data_step, energy
from shadowgram.solvers.eigen_tv import EigenTV
from shadowgram.solvers.solution import solve

from ._strips_plan import Strip
from ._strips_rows import Range, read_header, read_rows
from .source import SceneSource
from .study import Result, Study

REVISION = 1
SAMPLED = 3  # ranges of rows that the noise is estimated from


@dataclass(frozen=True, kw_only=True)
class StripSpec:
    """A strip to be reconstructed.

    Attributes
    ----------
    strip : its rows.
    solver : with the noise of all strips.
    version : of shadowgram; another one may give other numbers, and would make a seam.
    attempt : raised by one when the file of an earlier one is gone or damaged.
    """

    strip: Strip
    solver: EigenTV
    version: str
    attempt: int = 0


@dataclass(frozen=True, kw_only=True)
class NoiseSpec:
    """Rows of which the noise is estimated, and by which solver."""

    ranges: tuple[Range, ...]
    solver: EigenTV
    version: str


def piece_path(folder: Path, strip: Strip) -> Path:
    """File with the rows of a strip, halo included: float32 (band, y, x) and nothing else."""
    return folder / f"rows-{strip.first:06d}-{strip.last:06d}.f32"


def strip_study(specs: list[StripSpec], source: Path, folder: Path, count: int) -> Study:
    """The strips as tasks of a study; each uses `count` threads."""
    run = partial(reconstruct_strip, source=source, folder=folder, count=count)
    return _study("strips", "Strips of a reconstruction", specs, run)


def noise_study(spec: NoiseSpec, source: Path, count: int) -> Study:
    """The noise as the one task of a study."""
    return _study("strips-noise", "Noise of a measurement", [spec], partial(estimate_noise, source=source, count=count))


def _study(name: str, title: str, specs: list, run: partial[Result]) -> Study:
    def no_figure(records: object) -> None:  # noqa: ARG001 - what a study needs
        raise AssertionError

    return Study(
        name=name,
        title=title,
        source="",
        revision=REVISION,
        specs=lambda _scene, _quick: specs,
        run=run,
        figure=no_figure,  # type: ignore[arg-type]  # nobody draws one
        claims=lambda _records: (),
    )


def reconstruct_strip(spec: StripSpec, scene: SceneSource, *, source: Path, folder: Path, count: int) -> Result:  # noqa: ARG001
    """Reconstruct a strip and put its rows into a file of `folder`, which is on the disk before this returns."""
    strip = spec.strip
    measurement = read_rows(source, read_header(source), [(strip.first, strip.last)])
    with threads(count):
        solution = solve(spec.solver, measurement.operator, measurement.snapshots)
    if solution.interrupted:
        raise RuntimeError("the reconstruction was interrupted")
    rows = np.ascontiguousarray(solution.x, "<f4")
    replace_file(piece_path(folder, strip), [rows.data.cast("B")])
    values = {
        "sha256": hashlib.sha256(rows.data).hexdigest(),
        "iterations": solution.iterations,
        "converged": solution.converged,
        "process": f"{platform.node()}:{os.getpid()}",
        "peak_memory": peak_memory(),
    }
    return Result(values=values)


def estimate_noise(spec: NoiseSpec, scene: SceneSource, *, source: Path, count: int) -> Result:  # noqa: ARG001
    """The noise of which `EigenTV`, told of it, makes the λ that it finds for some rows by itself."""
    measurement = read_rows(source, read_header(source), spec.ranges)
    H, y = measurement.operator, measurement.snapshots
    with threads(count):
        found = solve(spec.solver, H, y).history["lambda"]
        noise = _noise_behind(found[-1], H, y) if found else 0.0
    values = {"noise": noise, "process": f"{platform.node()}:{os.getpid()}", "peak_memory": peak_memory()}
    return Result(values=values)


def _noise_behind(weight: float, H: LinearOperator, y: np.ndarray) -> float:
    """Standard deviation σ with λ = 0.45 h A (c 0.87 σ / (A √h))^1.25, A the mean scene value; the rule of `EigenTV`."""
    ones = np.ones(H.in_shape, y.dtype)
    amplitude = math.sqrt(energy(y) / energy(H.forward(ones)))
    gain = data_step(H, ones).gain
    of_voxel = (weight / (gain * amplitude * rule._LAMBDA_FACTOR)) ** (1 / rule._LAMBDA_POWER)
    caution = rule._caution(H)
    return of_voxel * math.sqrt(gain) * amplitude / (caution * rule._FITTED_NOISE)


def sampled_ranges(rows: int, most: int) -> tuple[Range, ...]:
    """Ranges of rows, spread evenly, which are `most` rows together or a few less.

    Examples
    --------
    >>> from shadowgram.experiments._strips_work import sampled_ranges
    >>> sampled_ranges(600, 96)
    ((84, 116), (284, 316), (484, 516))
    """
    each = max(1, min(most, rows) // SAMPLED)
    middles = [(2 * i + 1) * rows / (2 * SAMPLED) for i in range(SAMPLED)]
    firsts = [math.floor(middle - each / 2) for middle in middles]
    return tuple((first, first + each) for first in firsts)


def with_noise(spec: EigenTV, noise: float | None) -> EigenTV:
    """The solver as told of the noise, if it is known."""
    return spec if noise is None else replace(spec, noise=noise)


def peak_memory() -> int:
    """Largest resident memory that this process ever had, bytes."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else 1024 * peak
