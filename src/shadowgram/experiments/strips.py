"""Reconstruction of captures that do not fit in memory, by strips of rows that overlap.

Dispersion is along x, so that detector rows are independent in the data; only the spatial prior ties them, over a few rows. A strip
is therefore reconstructed with a halo on each side, all strips with the noise estimated from the same rows, and neighbours pass
into each other smoothly over their halos. Every finished strip is on the disk: whoever runs the same again after an interrupt, a
kill or a power cut goes on from there, to the same bytes. Why so, and what it costs: docs/decisions/0015-strips.md.
"""

from __future__ import annotations

import dataclasses
import fcntl
import hashlib
import json
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

import shadowgram
from shadowgram._threads import thread_count
from shadowgram.scenes.datacube import band_centres, label
from shadowgram.scenes.readers.atomic import replace_file
from shadowgram.solvers.eigen_tv import EigenTV

from . import _strips_plan as planning
from ._strips_blend import Pieces, is_whole
from ._strips_rows import Header, capture_by_rows, detector_rows, read_header, row_ratio
from ._strips_work import NoiseSpec, StripSpec, noise_study, peak_memory, sampled_ranges, strip_study, with_noise
from .dask_run import Cluster, LocalWorkers
from .journal import Journal, open_journal
from .run import Executor, Progress, Summary, Threads, run
from .source import SceneSource
from .study import Study
from .tasks import make_tasks

__all__ = ["StripsReport", "capture_by_rows", "reconstruct_strips"]

PLAN = "plan.json"
MOST_ATTEMPTS = 100


@dataclass(frozen=True, kw_only=True)
class StripsReport:
    """How a reconstruction by strips ended.

    Attributes
    ----------
    path : of the cube; not written if `interrupted`.
    folder : where the finished strips are kept until the cube is written.
    strips, rows, halo : number of strips, their largest number of own rows, and rows of the halo on each side.
    noise : that all strips were told, in the units of the snapshots; None if there is one strip, or none was needed.
    computed, reused : strips computed now, and by an earlier run.
    converged : number of strips whose solver met its criterion.
    interrupted : the user stopped it.
    peak_memory : bytes; largest resident memory of this process and of every worker, summed over them.
    seconds : of this run.
    """

    path: Path
    folder: Path
    strips: int
    rows: int
    halo: int
    noise: float | None
    computed: int
    reused: int
    converged: int
    interrupted: bool
    peak_memory: int
    seconds: float


def reconstruct_strips(
    measurement: str | os.PathLike[str],
    out: str | os.PathLike[str],
    spec: object = None,
    *,
    rows: int | None = None,
    halo: int = 16,
    memory_limit: float = 6e9,
    workers: int | str = 0,
    configuration: str = "",
    progress: Callable[[Progress], None] | None = None,
) -> StripsReport:
    """Reconstruct a measurement of any size within a limit of memory, into a native file.

    Parameters
    ----------
    measurement : file that `shadowgram.measurement.write_measurement` wrote.
    out : ends in ``.nc``; an existing file is replaced in the end. Until then the work is kept in the folder ``out`` + ``.strips``.
    spec : the solver; `EigenTV()` if not given. If it does not know the noise, that is estimated once, from three ranges of rows.
    rows : of the detector, of a strip. By default those of an earlier run that did not end, else as many as the memory allows; a
        measurement that fits is reconstructed in one piece, as `solve` would.
    halo : rows of the detector on each side that a strip shares with its neighbours.
    memory_limit : bytes of this process and its workers together; with an address, of each strip that a worker computes.
    workers : 0 for strips one after the other on all threads of this process; a number of processes of this machine, each with one
        strip on one thread; or the address of a Dask scheduler, whose workers must see both files under the same path.
    configuration : text that is kept in the file, such as the settings of the program.
    progress : called after every strip, and at least once a second.

    Returns
    -------
    StripsReport
        After Ctrl-C, marked as interrupted; the same call goes on.

    Raises
    ------
    OSError
        If a file cannot be read or written, the disk is too small, or the workers are lost.
    ValueError
        If the measurement is damaged, a strip fails, not even the smallest strip fits, or the folder holds work on something else.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import shadowgram as sg
    >>> from shadowgram.experiments.strips import reconstruct_strips
    >>> from shadowgram.measurement import capture, write_measurement
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> cube = sg.scenes.chart(size=48, bands=4, seed=0)
    >>> imager = sg.DualCASSI(cube_shape=cube.shape, wavelengths=(440, 660))
    >>> code = sg.codes.boolean(shots=3, shape=imager.code_shape, seed=0)
    >>> write_measurement(capture(imager, code, cube), folder / "shots.nc")
    >>> report = reconstruct_strips(folder / "shots.nc", folder / "cube.nc", sg.EigenTV(max_iter=20), rows=24, halo=8)
    >>> report.strips, sg.scenes.read(folder / "cube.nc").shape
    (2, (4, 48, 48))
    """
    begun = time.monotonic()
    source, target = Path(measurement).resolve(), Path(out).resolve()
    if target.suffix != ".nc":
        raise ValueError(f"the reconstruction is written to a file that ends in .nc, got {out}")
    spec = _checked(EigenTV() if spec is None else spec, halo, memory_limit)
    header = read_header(source)
    folder = target.with_name(target.name + ".strips")
    with _locked(folder):
        with _executor(workers) as executor, open_journal(folder) as journal:
            plan = _plan(folder, header, _digest(source), spec, rows, _Limits(halo, memory_limit, workers))
            job = _Job(source, target, folder, header, plan, spec, journal, executor, progress or (lambda _state: None))
            job.threads = thread_count() if workers == 0 else 1
            summary = job.reconstruct()
            if not summary.interrupted:
                job.write(configuration)
        report = job.report(summary, time.monotonic() - begun)
        if not report.interrupted:
            shutil.rmtree(folder)
    return report


@dataclass(frozen=True)
class _Limits:
    halo: int
    memory: float
    workers: int | str

    @property
    def processes(self) -> int:
        """Besides this one; those of a scheduler have memory of their own."""
        return self.workers if isinstance(self.workers, int) else 0


@dataclass(frozen=True, kw_only=True)
class _Plan:
    """What decides the bytes of the result; kept in the folder, and not to be changed between two runs."""

    measurement: str
    version: str
    solver: dict[str, Any]
    rows: int
    halo: int


class _Job:
    """One reconstruction: noise, strips, cube."""

    def __init__(
        self,
        source: Path,
        target: Path,
        folder: Path,
        header: Header,
        plan: _Plan,
        spec: EigenTV,
        journal: Journal,
        executor: Executor,
        progress: Callable[[Progress], None],
    ) -> None:
        self.source, self.target, self.folder, self.header = source, target, folder, header
        self.plan, self.spec, self.journal = plan, spec, journal
        self.executor, self.progress = executor, progress
        self.threads = 1
        self.noise = spec.noise
        self.strips = planning.strips(detector_rows(header.imager), plan.rows, plan.halo)
        low, high = header.imager.wavelengths
        self.scene = SceneSource(name=header.scene or "datacube", digest=plan.measurement, wavelengths=(low, high))
        self.found: list[Mapping[str, Any]] = []  # what tasks found, those of earlier runs too

    def reconstruct(self) -> Summary:
        """Compute what is missing."""
        self._check_disk()
        if len(self.strips) > 1 and self.noise is None:
            summary = self._estimate_noise()
            if summary.interrupted:
                return summary
        spec = with_noise(self.spec, self.noise)
        specs = [
            self._next_attempt(StripSpec(strip=one, solver=spec, version=self.plan.version)) for one in self.strips
        ]
        study = strip_study(specs, self.source, self.folder, self.threads)
        summary = self._run(study, self._tell)
        self.found += self._values(study)
        return summary

    def _tell(self, state: Progress) -> None:
        """Pass on where the run stands, without the specification of a strip; but that it waits for a worker."""
        waits = bool(state.label) and not self.executor.slots()
        self.progress(state if waits else dataclasses.replace(state, label=""))

    def _estimate_noise(self) -> Summary:
        longest = max(strip.last - strip.first for strip in self.strips)
        ranges = sampled_ranges(detector_rows(self.header.imager), min(longest, 192))
        spec = NoiseSpec(ranges=ranges, solver=self.spec, version=self.plan.version)
        study = noise_study(spec, self.source, self.threads)
        first = Progress(done=0, total=len(self.strips), label="estimating the noise", seconds_left=None)
        summary = self._run(study, lambda _state: self.progress(first))
        for values in self._values(study):
            self.noise = float(values["noise"])
            self.found.append(values)
        return summary

    def _next_attempt(self, spec: StripSpec) -> StripSpec:
        """The specification of a strip, or another one of the same strip if the file of that one is gone or damaged."""
        for attempt in range(MOST_ATTEMPTS):
            spec = dataclasses.replace(spec, attempt=attempt)
            values = self._values(strip_study([spec], self.source, self.folder, 1))
            if not values or is_whole(self.folder, spec.strip, values[0]):
                return spec
        raise OSError(f"files in {self.folder} do not stay as they are written; check the disk")

    def _run(self, study: Study, progress: Callable[[Progress], None]) -> Summary:
        summary = run(study, self.scene, False, self.journal, executor=self.executor, progress=progress)
        if summary.failed and not summary.interrupted:
            label, error = summary.failed[0]
            raise ValueError(
                f"{len(summary.failed)} of {summary.total} parts of the reconstruction failed, the first{label and f' ({label})'}:"
                f" {error}; what is finished is in {self.folder}"
            )
        return summary

    def _values(self, study: Study) -> list[Mapping[str, Any]]:
        keys = [task.key for task in make_tasks(study, self.scene, False)]
        return [record.values for record in self.journal.records(keys).values()]

    def _check_disk(self) -> None:
        """Raise an OSError if strips and cube together are too large for the disk."""
        bands, rows, columns = self.header.imager.resolution.cube_shape
        kept = sum(one.stat().st_size for one in self.folder.glob("*.f32"))
        strips = row_ratio(self.header.imager) * sum(strip.last - strip.first for strip in self.strips)
        needed = 4 * bands * columns * (strips + rows) - kept
        free = shutil.disk_usage(self.folder).free
        if needed > free:
            raise OSError(
                f"strips and cube take {needed / 1e9:.3g} GB in {self.target.parent}, {free / 1e9:.3g} GB are free;"
                " make room, or write to another disk"
            )

    def write(self, configuration: str) -> None:
        """Put the strips together, a few rows at a time."""
        from shadowgram.scenes.readers.native_parts import write_rows

        shape = self.header.imager.resolution.cube_shape
        pieces = Pieces(
            folder=self.folder,
            strips=self.strips,
            ratio=row_ratio(self.header.imager),
            bands=shape[0],
            columns=shape[2],
        )
        name = self.header.scene if self.header.scene.isidentifier() else "datacube"
        centres = band_centres(self.header.imager.resolution.wavelengths, shape[0])
        cube = label(np.broadcast_to(np.float32(0), shape), centres, name)
        cube.attrs = self._attributes(configuration)
        write_rows(xr.Dataset({name: cube}), self.target, name, pieces.rows, temporary=self.folder / "cube.part")

    def _attributes(self, configuration: str) -> dict[str, object]:
        attributes: dict[str, object] = {"configuration": configuration} if configuration else {}
        if len(self.strips) > 1:
            attributes |= {"strip_rows": self.plan.rows, "strip_halo": self.plan.halo, "noise": self.noise}
        return attributes

    def report(self, summary: Summary, seconds: float) -> StripsReport:
        """What happened."""
        peaks: dict[str, int] = {}
        for values in self.found:
            peaks[values["process"]] = max(peaks.get(values["process"], 0), values["peak_memory"])
        peaks.update({name: 0 for name in peaks if name.endswith(f":{os.getpid()}")})
        return StripsReport(
            path=self.target,
            folder=self.folder,
            strips=len(self.strips),
            rows=max(strip.stop - strip.start for strip in self.strips),
            halo=self.plan.halo,
            noise=self.noise,
            computed=summary.computed if summary.total == len(self.strips) else 0,
            reused=summary.reused if summary.total == len(self.strips) else 0,
            converged=sum(bool(values.get("converged")) for values in self.found),
            interrupted=summary.interrupted,
            peak_memory=peak_memory() + sum(peaks.values()),
            seconds=seconds,
        )


def _checked(spec: object, halo: int, memory_limit: float) -> EigenTV:
    if not isinstance(spec, EigenTV):
        raise TypeError(
            f"strips take EigenTV, whose weights can be the same in all, not {type(spec).__name__}; reconstruct in one piece"
        )
    if not isinstance(halo, int) or halo < 0:
        raise ValueError(f"halo is a number of rows, 0 or more, got {halo!r}")
    if not memory_limit > 0:
        raise ValueError(f"memory_limit is a number of bytes, such as 6e9, got {memory_limit!r}")
    return spec


def _executor(workers: int | str) -> Executor:
    """One strip after the other in this process, or what workers offer."""
    if isinstance(workers, str):
        return Cluster(workers)
    return LocalWorkers(workers) if workers else Threads(1)


def _plan(folder: Path, header: Header, digest: str, spec: EigenTV, rows: int | None, limits: _Limits) -> _Plan:
    """The plan that is in the folder, if it is for the same; else a new one, which is put there."""
    path = folder / PLAN
    begun = json.loads(path.read_text()) if path.exists() else None
    if rows is None and begun is not None:
        rows = int(begun["rows"])
    if rows is None:
        rows = planning.choose_rows(header, limits.halo, limits.memory, limits.processes)
    else:
        if not isinstance(rows, int) or rows < 1:
            raise ValueError(f"rows is the number of rows of a strip, got {rows!r}")
        planning.check_rows(header, rows, limits.halo, limits.memory, limits.processes)
    rows = min(rows, detector_rows(header.imager))
    plan = _Plan(
        measurement=digest,
        version=shadowgram.__version__,
        solver=json.loads(json.dumps(dataclasses.asdict(spec))),
        rows=rows,
        halo=limits.halo,
    )
    fields = dataclasses.asdict(plan)
    if begun is None:
        replace_file(path, [json.dumps(fields, indent=2).encode()])
    elif begun != fields:
        other = next(name for name in fields if begun.get(name) != fields[name])
        raise ValueError(
            f"{folder} holds the beginning of a reconstruction with another {other} ({begun.get(other)}, now {fields[other]});"
            " give the same again, remove that folder, or write to another file"
        )
    return plan


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Make the folder, and let no other process work in it."""
    if not folder.parent.is_dir():
        raise FileNotFoundError(f"there is no folder {folder.parent}; make it first, or write elsewhere")
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise OSError(f"another process is reconstructing into {folder}; wait for it, or write elsewhere") from None
        try:
            yield
        finally:
            if not any(folder.glob("*.f32")):  # nothing is finished
                shutil.rmtree(folder, ignore_errors=True)


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
