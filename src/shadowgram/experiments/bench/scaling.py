"""Cost per voxel from small to large problems, and two threads against one."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from shadowgram._threads import threads
from shadowgram.operators.base import LinearOperator
from shadowgram.operators.transforms import basis
from shadowgram.solvers.solution import solve

from .solvers import gpsr, iteration_timing, problem
from .spec import BenchSpec
from .timing import alternate


@dataclass(frozen=True, kw_only=True)
class Scaling:
    """Cost per voxel of one case.

    Attributes
    ----------
    case : what was timed.
    ns_per_voxel : side in pixels → ns.
    deviation : largest distance from the mean, relative to it.
    """

    case: str
    ns_per_voxel: dict[int, float]

    @property
    def deviation(self) -> float:
        """Largest distance from the mean, relative to it."""
        costs = list(self.ns_per_voxel.values())
        mean = sum(costs) / len(costs)
        return max(abs(cost / mean - 1) for cost in costs)

    def record(self) -> dict[str, object]:
        """All figures by name."""
        return {"case": self.case, "ns_per_voxel": self.ns_per_voxel, "deviation": self.deviation}


@dataclass(frozen=True, kw_only=True)
class Speedup:
    """One case on one thread and on two, ms."""

    case: str
    one_ms: float
    two_ms: float

    def record(self) -> dict[str, object]:
        """All figures by name."""
        return {"case": self.case, "one_ms": self.one_ms, "two_ms": self.two_ms, "speedup": self.one_ms / self.two_ms}


def scaling(spec: BenchSpec) -> Iterator[Scaling]:
    """Cost per voxel of operator, basis and GPSR iteration for each of `spec.sizes`, with the same bands and shots."""
    costs: dict[str, dict[int, float]] = {}
    for size in spec.sizes:
        H, y, truth = problem(spec, size)
        voxels = truth.size
        for case, function in _calls(H, y, truth).items():
            ms = alternate({case: function}, spec.seconds / 4)[case].ms
            costs.setdefault(case, {})[size] = 1e6 * ms / voxels
        ms = iteration_timing(H, y, 12).ms
        costs.setdefault("GPSR iteration", {})[size] = 1e6 * ms / voxels
    for case, by_size in costs.items():
        yield Scaling(case=case, ns_per_voxel=by_size)


def _calls(H: LinearOperator, y: np.ndarray, x: np.ndarray) -> dict[str, Callable[[], object]]:
    """The operator and the basis both ways, as functions without arguments."""
    psi = basis("dct-sym8", H.in_shape)
    snapshots, cube = np.empty_like(y), np.empty_like(x)
    z = psi.adjoint(x)
    coefficients = np.empty_like(z)
    return {
        "SSCSI forward": lambda: H.forward(x, out=snapshots),
        "SSCSI adjoint": lambda: H.adjoint(y, out=cube),
        "basis synthesis": lambda: psi.forward(z, out=cube),
        "basis analysis": lambda: psi.adjoint(x, out=coefficients),
    }


def two_threads(spec: BenchSpec) -> Iterator[Speedup]:
    """Two threads against one; nothing on a machine with one processor."""
    if (os.cpu_count() or 1) < 2:
        return
    H, y, truth = problem(spec, spec.size)
    for case, function in _calls(H, y, truth).items():
        yield _speedup(case, function, spec.seconds)
    yield _speedup("GPSR, 20 iterations", lambda: solve(gpsr(20), H, y), 2 * spec.seconds)


def _speedup(case: str, function: Callable[[], object], seconds: float) -> Speedup:
    def on(count: int) -> None:
        with threads(
            count
        ):  # BLAS is limited by whoever runs the benchmarks: to do it here would cost a millisecond a call
            function()

    timings = alternate({"one": lambda: on(1), "two": lambda: on(2)}, seconds)
    return Speedup(case=case, one_ms=timings["one"].ms, two_ms=timings["two"].ms)
