"""Cases: an iteration of GPSR, and whole reconstructions of the generated scene."""

from __future__ import annotations

import time
from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from shadowgram import scenes
from shadowgram.metrics import psnr
from shadowgram.operators.base import LinearOperator
from shadowgram.solvers.eigen_tv import EigenTV
from shadowgram.solvers.gpsr import GPSR
from shadowgram.solvers.solution import Solution, solve

from . import work
from .machine import Machine
from .operators import NO_WAVELETS, sscsi_references, wavelet_reference
from .references import GPSRSteps
from .spec import OURS, WAVELENGTHS, BenchSpec, Row, make_row, sscsi_operator
from .timing import Timing, alternate

if TYPE_CHECKING:
    from shadowgram.spectral._sscsi_operator import SSCSIOperator

REFERENCE = "NumPy + PyWavelets + scipy.fft"
RUNS = 2  # of a whole reconstruction, after one that compiles


def problem(spec: BenchSpec, size: int) -> tuple[SSCSIOperator, np.ndarray, np.ndarray]:
    """Operator, snapshots and truth: the generated scene seen by the SSCSI."""
    H = sscsi_operator(spec, size)
    truth = scenes.chart(size=size, bands=spec.bands, seed=0, wavelengths=WAVELENGTHS).values.astype(np.float32)
    return H, H.forward(truth), truth


def gpsr(iterations: int = 200) -> GPSR:
    """The settings that are timed."""
    return GPSR(basis="dct-sym8", tau=1e-4, max_iter=iterations, tol=1e-5)


def iteration_timing(H: LinearOperator, y: np.ndarray, iterations: int) -> Timing:
    """Time between one iteration of GPSR and the next."""
    at: list[tuple[int, float]] = []
    solve(gpsr(iterations), H, y, callback=lambda iteration, _values: at.append((iteration, time.perf_counter())))
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
    """Whole reconstructions by GPSR and EigenTV."""
    H, y, truth = problem(spec, spec.size)
    for name, solver in (("GPSR", gpsr()), ("EigenTV", EigenTV())):
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
