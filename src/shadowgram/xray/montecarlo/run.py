"""The only door to the kernels: batches of histories on threads, added up in order, saved on the way."""

from __future__ import annotations

import hashlib
import io
import math
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from shadowgram._threads import thread_count
from shadowgram.scenes.readers.atomic import replace_file

from .arrays import Detectors, Floats, Geometry, Physics, Rules, Source, Tally, desk
from .tallies import Estimate, Sums, as_vector, empty_tally, named_estimates

BATCHES = 128
"""At least so many batches, for standard errors good to 6 %."""
LARGEST_BATCH = 200_000
"""Histories: a tenth of a second, after which an interrupt is heard."""
SAVE_EVERY = 10.0
"""s between two checkpoints."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Setup:
    """All that the kernels need of a scene.

    Attributes
    ----------
    geometry, physics, source, detectors, rules : arrays.
    detector_names, solid_names : what the tallies are called.
    masses : (solid) g, NaN where unknown.
    bins : of the spectrum tallies.
    """

    geometry: Geometry
    physics: Physics
    source: Source
    detectors: Detectors
    rules: Rules
    detector_names: tuple[str, ...]
    solid_names: tuple[str, ...]
    masses: Floats
    bins: int

    def empty_tally(self) -> Tally:
        """Sums of nothing."""
        return empty_tally(len(self.solid_names), self.detectors, self.bins)

    def digest(self) -> str:
        """A name for all numbers in here: two setups with the same digest give the same results."""
        hashed = hashlib.sha256()
        for value in _leaves((self.geometry, self.physics, self.source, self.detectors, self.rules, self.bins)):
            if not isinstance(value, np.ndarray):
                hashed.update(repr(value).encode())
                continue
            hashed.update(f"{value.dtype}{value.shape}".encode())
            hashed.update(np.ascontiguousarray(value).tobytes())
        return hashed.hexdigest()


def _leaves(value: object) -> Iterator[object]:
    if isinstance(value, tuple):
        for one in value:
            yield from _leaves(one)
    else:
        yield value


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """What a simulation found.

    Attributes
    ----------
    tallies : `Estimate` by name: ``"all"`` and one for every detector (counts above threshold), with ``/orders``,
        ``/spectrum`` and ``/image``; ``"deposited/SOLID"``, ``"dose/SOLID"``; ``"escaped/backward"``,
        ``"escaped/forward"`` with ``/spectrum``, ``"escaped/cosine"``.
    histories : source photons that were followed.
    seconds : of computing, over all sessions of a resumed run.
    finished : whether it came to its end, and was not interrupted.
    """

    tallies: dict[str, Estimate]
    histories: int
    seconds: float
    finished: bool


@dataclass(frozen=True, kw_only=True)
class State:
    """Where a run stands, for a progress bar.

    Attributes
    ----------
    done, total : histories.
    relative_error : of the counts of all detectors together.
    """

    done: int
    total: int
    relative_error: float


def batch_edges(histories: int) -> list[int]:
    """Where batches of nearly equal size begin and end."""
    count = max(min(BATCHES, histories), -(-histories // LARGEST_BATCH))
    return [histories * i // count for i in range(count + 1)]


def batch_vector(setup: Setup, seed: int, first: int, last: int) -> Floats:
    """The sums of histories `first` to `last` − 1, in one row.

    Raises
    ------
    RuntimeError
        If one history made more photons than there is room for.
    """
    return _follow(setup, seed, first, last, 0)[0]


def batch_phase_space(setup: Setup, seed: int, first: int, last: int) -> Floats:
    """(row, 10) photons of histories `first` to `last` − 1 that entered a detector, as `Desk.phase` has them."""
    rows = last - first + 1000
    while True:
        _, found, count = _follow(setup, seed, first, last, rows)
        if count <= rows:
            return found[:count]
        # Histories can be repeated exactly, so a second look costs time and nothing else.
        rows = count


def _follow(setup: Setup, seed: int, first: int, last: int, phase_rows: int) -> tuple[Floats, Floats, int]:
    from ._history_kernels import batch

    tally = setup.empty_tally()
    scratch = desk(len(setup.solid_names), len(setup.detector_names), phase_rows)
    arrays = (setup.geometry, setup.physics, setup.source, setup.detectors, setup.rules)
    stopped = batch(*arrays, scratch, tally, seed, first, last)
    if stopped >= 0:
        raise RuntimeError(f"history {stopped} made more photons than there is room for; raise the cut-off energy")
    return as_vector(tally), scratch.phase, int(scratch.level[2])


def run_setup(
    setup: Setup,
    *,
    histories: int,
    seed: int,
    threads: int | None = None,
    stop_at: float | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Callable[[State], None] = lambda _: None,
) -> Run:
    """Follow histories; what `shadowgram.xray.simulate` does with a compiled scene.

    An interrupt (Ctrl-C) ends the run after the batches that are being computed; what was found is returned, and saved
    if there is a checkpoint.

    Raises
    ------
    ValueError
        If the number of histories, the seed, the threads or the wanted error make no sense, or the checkpoint belongs
        to another run.
    OSError
        If the checkpoint cannot be written.
    """
    from ._jit import SOURCES

    _check(histories, seed, threads, stop_at)
    histories, seed = int(histories), int(seed)
    begun = time.monotonic()
    edges = batch_edges(histories)
    sums = Sums.of_size(as_vector(setup.empty_tally()).size)
    # With other kernels a run would go on with other physics.
    label = f"{setup.digest()} {SOURCES} {seed} {histories}"
    before = 0.0
    if checkpoint is not None and Path(checkpoint).exists():
        sums, before = _load(Path(checkpoint), label, sums)
    saved = begun
    finished = True
    try:
        last = sums.batches if _is_enough(sums, stop_at) else len(edges) - 1
        for vector, count in _in_order(setup, seed, edges[: last + 1], sums.batches, threads or thread_count()):
            sums.add(vector, count)
            now = time.monotonic()
            if checkpoint is not None and now - saved > SAVE_EVERY:
                _save(Path(checkpoint), label, sums, before + now - begun)
                saved = now
            progress(State(done=sums.histories, total=histories, relative_error=_relative_error(sums)))
            if _is_enough(sums, stop_at):
                break
    except KeyboardInterrupt:
        if sums.batches == 0:
            raise
        finished = False
    seconds = before + time.monotonic() - begun
    if checkpoint is not None:
        _save(Path(checkpoint), label, sums, seconds)
    tallies = named_estimates(
        sums,
        setup.empty_tally(),
        setup.detectors,
        setup.detector_names,
        setup.solid_names,
        setup.masses,
        setup.rules.bin_width,
    )
    return Run(tallies=tallies, histories=sums.histories, seconds=seconds, finished=finished)


def _check(histories: int, seed: int, threads: int | None, stop_at: float | None) -> None:
    for name, value, least in (("histories", histories, 2), ("seed", seed, 0), ("threads", threads, 1)):
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least):
            raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r}")
    if seed >= 2**63:
        raise ValueError(f"seed must be below 2**63, got {seed}")
    if stop_at is not None and not 0 < stop_at < 1:
        raise ValueError(f"stop_at is a relative standard error between 0 and 1, got {stop_at!r}")


def _relative_error(sums: Sums) -> float:
    if sums.batches < 2 or sums.total[0] <= 0:
        return math.inf
    n = sums.batches
    return math.sqrt(max(sums.squares[0] - sums.total[0] ** 2 / n, 0.0) * n / (n - 1)) / float(sums.total[0])


def _is_enough(sums: Sums, stop_at: float | None) -> bool:
    return stop_at is not None and sums.batches >= BATCHES // 2 and _relative_error(sums) <= stop_at


def _in_order(setup: Setup, seed: int, edges: list[int], first: int, threads: int) -> Iterator[tuple[Floats, int]]:
    """Batch vectors from batch `first` on, in order, computed a few ahead on threads."""
    batches = len(edges) - 1
    with ThreadPoolExecutor(threads, thread_name_prefix="shadowgram-xray") as pool:
        waiting: list[Future[Floats]] = []
        upcoming = first
        try:
            for number in range(first, batches):
                while upcoming < batches and len(waiting) < 2 * threads:
                    waiting.append(pool.submit(batch_vector, setup, seed, edges[upcoming], edges[upcoming + 1]))
                    upcoming += 1
                yield waiting.pop(0).result(), edges[number + 1] - edges[number]
        finally:
            for one in waiting:
                one.cancel()


def _save(path: Path, label: str, sums: Sums, seconds: float) -> None:
    buffer = io.BytesIO()
    counts = np.array([sums.batches, sums.histories], np.int64)
    parts = {"total": sums.total, "squares": sums.squares, "counts": counts}
    np.savez(buffer, label=np.array(label), seconds=np.array(seconds), **parts)
    content = buffer.getvalue()
    replace_file(path, [content, hashlib.sha256(content).digest()])


def _load(path: Path, label: str, empty: Sums) -> tuple[Sums, float]:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ValueError(f"the checkpoint {path} cannot be read: {error}; remove it or name another file") from error
    size = hashlib.sha256().digest_size
    content, digest = data[:-size], data[-size:]
    # What is whole was written here, so that nothing below can fail.
    if hashlib.sha256(content).digest() != digest:
        raise ValueError(f"{path} is no checkpoint of a simulation, or is damaged; remove it or name another file")
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        found, seconds, counts = str(file["label"]), float(file["seconds"]), file["counts"]
        total, squares = file["total"], file["squares"]
    if found != label or total.shape != empty.total.shape:
        raise ValueError(
            f"the checkpoint {path} belongs to another scene, seed or number of histories; remove it or name another file"
        )
    return Sums(total=total, squares=squares, batches=int(counts[0]), histories=int(counts[1])), seconds
