"""Cases: an iteration of GPSR and of GAP-TV, and whole reconstructions of the generated scene."""

from __future__ import annotations

import json
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from shadowgram import scenes
from shadowgram.metrics import psnr
from shadowgram.operators.base import LinearOperator
from shadowgram.operators.structure import norm
from shadowgram.solvers.admm_tv import ADMMTV
from shadowgram.solvers.eigen_tv import EigenTV
from shadowgram.solvers.gap_tv import GAPTV
from shadowgram.solvers.gpsr import GPSR
from shadowgram.solvers.solution import Solution, solve
from shadowgram.solvers.twist import TwIST

from . import work
from .machine import Machine
from .operators import NO_WAVELETS, sscsi_references, wavelet_reference
from .peers import HOUR
from .references import GPSRSteps
from .spec import OURS, WAVELENGTHS, BenchSpec, Row, make_row, sscsi_operator
from .timing import Timing, alternate

if TYPE_CHECKING:
    from shadowgram.spectral._sscsi_operator import SSCSIOperator

REFERENCE = "NumPy + PyWavelets + scipy.fft"
RUNS = 2  # of a whole reconstruction, after one that compiles
SCRIPT = Path(__file__).parents[4] / "benchmarks" / "gap_tv_peers.py"
GAP_TV = "GAP-TV iteration, 4 shots"
GAP_TV_SHOTS = 4


def problem(spec: BenchSpec, size: int) -> tuple[SSCSIOperator, np.ndarray, np.ndarray]:
    """Operator, snapshots and truth: the generated scene seen by the SSCSI."""
    H = sscsi_operator(spec, size)
    truth = scenes.chart(size=size, bands=spec.bands, seed=0, wavelengths=WAVELENGTHS).values.astype(np.float32)
    return H, H.forward(truth), truth


def gpsr(iterations: int = 200) -> GPSR:
    """The settings that are timed."""
    return GPSR(basis="dct-sym8", tau=1e-4, max_iter=iterations, tol=1e-5)


SOLVERS = {
    "GPSR": gpsr(),
    "TwIST": TwIST(tau=1e-4, max_iter=200, tol=1e-5),
    "GAP-TV": GAPTV(),
    "ADMM-TV": ADMMTV(),
    "EigenTV": EigenTV(),
}


def iteration_timing(H: LinearOperator, y: np.ndarray, iterations: int, solver: GPSR | GAPTV | None = None) -> Timing:
    """Time between one iteration of a solver, or else of GPSR, and the next."""
    at: list[tuple[int, float]] = []
    solve(
        solver or gpsr(iterations),
        H,
        y,
        callback=lambda iteration, _values: at.append((iteration, time.perf_counter())),
    )
    steps = [(t - s) / (j - i) for (i, s), (j, t) in pairwise(at) if j > i]
    return Timing.of(steps)


def iteration_case(spec: BenchSpec, machine: Machine) -> Iterator[Row]:
    """One full iteration of GPSR: forward, adjoint, synthesis, analysis and the updates."""
    H, y, _truth = problem(spec, spec.size)
    iteration_timing(H, y, 3)
    timings = {OURS: iteration_timing(H, y, 60)}
    reference = _reference_timing(spec, H, y)
    if reference is not None:
        timings[REFERENCE] = reference
    needs = work.gpsr_iteration(spec.bands, spec.size, spec.shots)
    arithmetic = needs.flops / machine.peak / 1e6
    note = f"arithmetic alone: {arithmetic:.2f} ms, of which we reach {arithmetic / timings[OURS].ms:.0%}"
    if reference is None:
        note = f"{NO_WAVELETS}; {note}"
    yield make_row("GPSR iteration", timings, needs, machine, note)


def gap_tv_case(spec: BenchSpec, machine: Machine) -> Iterator[Row]:
    """One full iteration of GAP-TV: forward, adjoint, the small systems, and total variation of every band."""
    spec = replace(spec, shots=GAP_TV_SHOTS)
    H, y, _truth = problem(spec, spec.size)
    solver = GAPTV(max_iter=60, tol=0)
    iteration_timing(H, y, 3, replace(solver, max_iter=3))
    timings = {OURS: iteration_timing(H, y, 60, solver)}
    yield make_row(
        GAP_TV, timings, work.gap_tv_iteration(spec.bands, spec.size, spec.shots, solver.tv_iterations), machine
    )


def iteration_cases(spec: BenchSpec, machine: Machine) -> Iterator[Row]:
    """One iteration of GPSR, and one of GAP-TV."""
    yield from iteration_case(spec, machine)
    yield from gap_tv_case(spec, machine)


def compare(spec: BenchSpec, rows: Mapping[str, Row], python: str) -> Iterator[dict[str, object]]:
    """Records, as `peers.Peer` gives them, of scico's steps with total variation beside our iteration of GAP-TV, if it is there.

    Raises
    ------
    ValueError
        If the script fails; with its last words.
    """
    if GAP_TV not in rows:
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "problem.npz"
        np.savez(path, allow_pickle=False, **_peer_problem(replace(spec, shots=GAP_TV_SHOTS)))
        command = [python, str(SCRIPT), str(path)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=HOUR, check=False)
    if done.returncode:
        raise ValueError(f"the peers failed: {' '.join(done.stderr.strip().splitlines()[-1:])}")
    ours = rows[GAP_TV].ms
    for found in json.loads(done.stdout):
        ratio = None if found["ms"] is None else found["ms"] / ours
        yield {"case": GAP_TV, **found, "ours_ms": ours, "ratio": ratio}


def _peer_problem(spec: BenchSpec) -> dict[str, np.ndarray]:
    """Effective code, cube and snapshots, and settings that suit them."""
    H, y, truth = problem(spec, spec.size)
    settings = {"weight": 0.1, "rho": 1.0, "lipschitz": norm(H) ** 2}
    code = H.imager.effective_code(H.code).astype(np.float32)
    return {"code": code, "cube": truth, "snapshots": y} | {name: np.array(value) for name, value in settings.items()}


def _reference_timing(spec: BenchSpec, H: SSCSIOperator, y: np.ndarray) -> Timing | None:
    """The fastest of the NumPy forms of the operator, with the basis of PyWavelets and SciPy."""
    basis = wavelet_reference(spec)
    if basis is None:
        return None
    effective = H.imager.effective_code(H.code).astype(np.float32)
    steps = {
        name: GPSRSteps(operator, basis, y, tau=1e-4).step for name, operator in sscsi_references(effective).items()
    }
    return min(alternate(steps, spec.seconds).values(), key=lambda timing: timing.ms)


def reconstruction_cases(spec: BenchSpec, machine: Machine) -> Iterator[Row]:
    """Whole reconstructions by every solver."""
    H, y, truth = problem(spec, spec.size)
    for name, solver in SOLVERS.items():
        solution = solve(solver, H, y)
        seconds = []
        for _ in range(RUNS):
            begun = time.perf_counter()
            solution = solve(solver, H, y)
            seconds.append(time.perf_counter() - begun)
        timings = {OURS: Timing.of(seconds)}
        yield make_row(f"{name} reconstruction", timings, None, machine, _outcome(solution, truth))


def _outcome(solution: Solution, truth: np.ndarray) -> str:
    ended = "converged" if solution.converged else "stopped"
    return f"{ended} after {solution.iterations} iterations, PSNR {psnr(solution.x, truth, peak=1.0):.1f} dB"
