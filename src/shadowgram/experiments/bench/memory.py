"""Peak memory of a reconstruction, in datacubes, measured in a process of its own: ``python -m ...bench.memory SOLVER SPEC``.

Two figures: what NumPy and Python allocate (tracemalloc, to which NumPy reports every array; arrays made inside numba kernels,
a few rows, do not show), and by how much the process's resident memory rose at its peak.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tracemalloc
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from .spec import BenchSpec

SOLVERS = ("GPSR", "EigenTV")
STATUS = Path("/proc/self/status")  # Linux


@dataclass(frozen=True, kw_only=True)
class Memory:
    """Peak memory of one reconstruction, beyond what the problem itself takes.

    Attributes
    ----------
    case : the solver.
    cube_mb : size of the datacube, MB.
    traced_cubes : peak of what was allocated, in datacubes.
    resident_cubes : rise of the resident memory, in datacubes.
    """

    case: str
    cube_mb: float
    traced_cubes: float
    resident_cubes: float

    def record(self) -> dict[str, object]:
        """All figures by name."""
        return asdict(self)


def peak_memory(spec: BenchSpec) -> Iterator[Memory]:
    """Peak memory of reconstructions by GPSR and EigenTV, each in a new process.

    Raises
    ------
    ValueError
        If the process fails; with its last words.
    """
    for solver in SOLVERS:
        command = [sys.executable, "-m", __name__, solver, json.dumps(asdict(spec))]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise ValueError(f"the memory benchmark failed: {done.stderr.strip().splitlines()[-1:]}")
        yield Memory(**json.loads(done.stdout))


def measure(solver: str, spec: BenchSpec) -> Memory:
    """Run one reconstruction in this process and see what it takes."""
    from shadowgram.solvers.eigen_tv import EigenTV
    from shadowgram.solvers.solution import solve

    from .solvers import gpsr, problem
    from .timing import limited_threads

    chosen = gpsr(60) if solver == "GPSR" else EigenTV()
    with limited_threads(1):
        small = BenchSpec(size=spec.bands + 8, bands=spec.bands, shots=spec.shots)
        solve(chosen, *problem(small, small.size)[:2])  # kernels loaded: not memory of the reconstruction
        H, y, truth = problem(spec, spec.size)
        cube = truth.nbytes
        del truth
        before = resident()
        solve(chosen, H, y)
        risen = max(0, peak_resident() - before)
        tracemalloc.start()  # in a second run: it takes memory itself
        solve(chosen, H, y)
        traced = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return Memory(case=solver, cube_mb=cube / 1e6, traced_cubes=traced / cube, resident_cubes=risen / cube)


def resident() -> int:
    """Bytes resident now; from here on `peak_resident` begins anew, where the system lets it."""
    if not STATUS.exists():
        return peak_resident()
    Path("/proc/self/clear_refs").write_text("5")
    return _status("VmRSS")


def peak_resident() -> int:
    """Bytes resident at most."""
    # A child's ru_maxrss begins with what its parent held when it forked; VmHWM is its own.
    return _status("VmHWM") if STATUS.exists() else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _status(field: str) -> int:
    line = next(line for line in STATUS.read_text().splitlines() if line.startswith(f"{field}:"))
    return int(line.split()[1]) * 1024


if __name__ == "__main__":
    settings = json.loads(sys.argv[2])
    print(json.dumps(measure(sys.argv[1], BenchSpec(**settings)).record()))  # noqa: T201 - the parent reads it
