"""The run over the groups of cases, and its results as one dictionary."""

from __future__ import annotations

import datetime as dt
import platform
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from importlib import metadata

from . import codes, denoisers, memory, operators, peers, scaling, solvers, transport
from . import machine as machines
from .machine import Machine
from .spec import BenchSpec, Row
from .timing import limited_threads

GROUPS = (
    "operators", "basis", "iteration", "reconstruction", "codes", "transport", "denoisers", "scaling", "threads", "memory",
)  # fmt: skip
LIBRARIES = ("shadowgram", "numpy", "numba", "scipy", "pywavelets")


@dataclass(kw_only=True)
class Results:
    """What a run found: the machine, and records of figures, group by group.

    Attributes
    ----------
    cases, scaling, threads, memory, peers : records, as `Row`, `Scaling`, `Speedup`, `Memory` and `Peer` give them.
    """

    date: str
    machine: Machine
    spec: BenchSpec
    versions: dict[str, str]
    cases: list[dict[str, object]] = field(default_factory=list)
    scaling: list[dict[str, object]] = field(default_factory=list)
    threads: list[dict[str, object]] = field(default_factory=list)
    memory: list[dict[str, object]] = field(default_factory=list)
    peers: list[dict[str, object]] = field(default_factory=list)


def run(spec: BenchSpec, groups: Iterable[str], peers_python: str | None, step: Callable[[str], None]) -> Results:
    """Run groups of cases on one thread (the speed-up: on one and two).

    Parameters
    ----------
    spec : settings.
    groups : of `GROUPS`.
    peers_python : Python of an environment with other packages, which are timed on the cases of the groups; None for none.
    step : called with a few words before each group.

    Raises
    ------
    ValueError
        If a group is not known.
    """
    chosen = list(groups)
    for name in chosen:
        if name not in GROUPS:
            raise ValueError(f"there is no benchmark {name!r}; there are {', '.join(GROUPS)}")
    with limited_threads(1):
        step("machine")
        limits = machines.measure(spec.seconds)
        results = Results(
            date=dt.datetime.now(dt.UTC).date().isoformat(),
            machine=limits,
            spec=spec,
            versions={"python": platform.python_version(), **dict(_versions())},
        )
        rows: dict[str, Row] = {}
        for name in chosen:
            step(name)
            _run_group(name, results, rows)
        if peers_python is not None:
            step("peers")
            results.peers = [peer.record() for peer in peers.compare(spec, rows, peers_python)]
            results.peers += transport.compare(rows, peers_python)
            results.peers += denoisers.compare(rows, peers_python)
            results.peers += solvers.compare(spec, rows, peers_python)
    return results


def _run_group(name: str, results: Results, rows: dict[str, Row]) -> None:
    spec, limits = results.spec, results.machine
    if name == "scaling":
        results.scaling = [record.record() for record in scaling.scaling(spec)]
    elif name == "threads":
        results.threads = [record.record() for record in scaling.two_threads(spec)]
    elif name == "memory":
        results.memory = [record.record() for record in memory.peak_memory(spec)]
    else:
        cases = {
            "operators": operators.operator_cases,
            "basis": operators.basis_cases,
            "iteration": solvers.iteration_cases,
            "reconstruction": solvers.reconstruction_cases,
            "codes": codes.design_cases,
            "transport": transport.transport_cases,
            "denoisers": denoisers.denoiser_cases,
        }[name]
        for row in cases(spec, limits):
            rows[row.case] = row
            results.cases.append(row.record())


def _versions() -> Iterator[tuple[str, str]]:
    for name in LIBRARIES:
        try:
            yield name, metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
