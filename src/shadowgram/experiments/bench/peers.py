"""Other packages on the same problems, in a Python of their own: writes the problem, runs ``benchmarks/peers.py`` there."""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from shadowgram.operators.transforms import default_levels

from .operators import cassi_code, cassi_problem
from .spec import BenchSpec, Row, random_array, sscsi_operator

SCRIPT = Path(__file__).parents[4] / "benchmarks" / "peers.py"
CASES = (
    "CASSI forward", "CASSI adjoint", "SSCSI exact forward", "SSCSI exact adjoint", "basis synthesis", "basis analysis",
)  # fmt: skip
HOUR = 3600  # s; a package may need half a minute for one application


@dataclass(frozen=True, kw_only=True)
class Peer:
    """Another package's time on one case.

    Attributes
    ----------
    case, peer : what was timed, of which package and version.
    ms, median_ms : minimum and median over repeats; None where the package could not be used.
    ours_ms : our minimum in the same run.
    error : largest difference from our result, relative to the largest value; None where it cannot be compared.
    skipped : why there is no time.
    """

    case: str
    peer: str
    ms: float | None = None
    median_ms: float | None = None
    ours_ms: float
    error: float | None = None
    skipped: str = ""

    def record(self) -> dict[str, object]:
        """All figures by name."""
        return {**asdict(self), "ratio": None if self.ms is None else self.ms / self.ours_ms}


def check(python: str) -> None:
    """Raise a ValueError unless `python` and the script are there."""
    if not SCRIPT.is_file():
        raise ValueError(f"--peers needs a checkout of the repository: {SCRIPT} is not there")
    try:
        subprocess.run([python, "-c", ""], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        raise ValueError(
            f"--peers takes the Python of an environment with the packages of {SCRIPT.with_suffix('.txt')}, got {python}"
        ) from None


def compare(spec: BenchSpec, rows: Mapping[str, Row], python: str) -> Iterator[Peer]:
    """Time the packages of the environment of `python` on those of `CASES` that are among our `rows`, by case.

    Raises
    ------
    ValueError
        If the script fails; with its last words.
    """
    cases = [case for case in CASES if case in rows]
    if not cases:
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "problem.npz"
        np.savez(path, allow_pickle=False, **problem(spec))
        done = subprocess.run(
            [python, str(SCRIPT), str(path), *cases], capture_output=True, text=True, timeout=HOUR, check=False
        )
    if done.returncode:
        raise ValueError(f"the peers failed: {' '.join(done.stderr.strip().splitlines()[-1:])}")
    for result in json.loads(done.stdout):
        yield Peer(**result, ours_ms=rows[result["case"]].ms)


def problem(spec: BenchSpec) -> dict[str, np.ndarray]:
    """What the peers compute with, and what must come out, float32."""
    cassi, _ = cassi_problem(spec)
    sscsi = sscsi_operator(spec, spec.size)
    effective = sscsi.imager.effective_code(sscsi.code)
    cassi_cube, sscsi_cube = random_array(cassi.in_shape), random_array(sscsi.in_shape)
    cassi_snapshot, sscsi_snapshots = cassi.forward(cassi_cube), sscsi.forward(sscsi_cube)
    return {
        "cassi_code": cassi_code(spec)[0].astype(np.float32),
        "cassi_cube": cassi_cube,
        "cassi_snapshot": cassi_snapshot[0],
        "cassi_back": cassi.adjoint(cassi_snapshot),
        "sscsi_code": effective.astype(np.float32),
        "sscsi_cube": sscsi_cube,
        "sscsi_snapshots": sscsi_snapshots,
        "sscsi_back": sscsi.adjoint(sscsi_snapshots),
        "levels": np.array(default_levels(sscsi.in_shape)),
    }
