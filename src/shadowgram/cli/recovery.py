"""`shadowgram reconstruct`."""

from __future__ import annotations

import dataclasses
import json
import time
from contextlib import nullcontext
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import output
from .cubes import quality_lines, read_cube

if TYPE_CHECKING:
    import numpy as np

    from shadowgram.experiments.quality import Quality
    from shadowgram.measurement import Measurement
    from shadowgram.solvers.eigen_tv import EigenTV
    from shadowgram.solvers.fista import FISTA
    from shadowgram.solvers.gpsr import GPSR
    from shadowgram.solvers.solution import Solution


class Solver(StrEnum):
    """Reconstruction algorithms."""

    eigen_tv = "eigen-tv"
    gpsr = "gpsr"
    fista = "fista"


def reconstruct(
    context: typer.Context,
    shots: Annotated[Path, typer.Argument(help="Measurement, as 'capture' writes it.", show_default=False)],
    out: Annotated[Path, typer.Option("-o", "--out", help="Datacube to write, .nc.")],
    solver: Annotated[Solver, typer.Option(help="Algorithm.")] = Solver.eigen_tv,
    tau: Annotated[float | None, typer.Option(help="gpsr, fista: weight of sparsity relative to |ΨᵀHᵀy|∞.")] = None,
    max_iter: Annotated[int | None, typer.Option(help="Largest number of iterations.")] = None,
    tol: Annotated[float | None, typer.Option(help="Relative change at which it has converged.")] = None,
    truth: Annotated[Path | None, typer.Option(help="True datacube, to print the quality.")] = None,
    threads: Annotated[int | None, typer.Option(help="Threads; by default all processors.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Reconstruct the datacube behind a measurement; Ctrl-C keeps the best so far.

    Example: shadowgram reconstruct shots.nc -o cube.nc --truth scene.nc
    """
    from shadowgram.experiments.quality import assess
    from shadowgram.measurement import imager_to_json, read_measurement
    from shadowgram.scenes import as_datacube, write

    output.check_result(out, (".nc",), inputs=[shots, truth])
    measurement = read_measurement(shots)
    expected = None if truth is None else _truth(truth, measurement)
    spec = _solver(solver, tau, max_iter, tol)
    begun = time.perf_counter()
    solution = _solve(spec, measurement, threads)
    seconds = time.perf_counter() - begun
    imager = measurement.imager
    text = output.configuration(
        context,
        imager=json.loads(imager_to_json(imager)),
        solver={"type": type(spec).__name__, **dataclasses.asdict(spec)},
        iterations=solution.iterations,
        converged=solution.converged,
        interrupted=solution.interrupted,
    )
    name = measurement.scene if measurement.scene.isidentifier() else "datacube"
    cube = as_datacube(solution.x, imager.resolution.wavelengths, name)
    write(cube.assign_attrs(configuration=text), out)
    output.write_configuration(out, text)
    quality = None if expected is None else assess(cube.values, expected)
    _report_solution(solution, quality, seconds, out, as_json)
    if solution.interrupted:
        raise output.Interrupted(f"interrupted after {solution.iterations} iterations; the best so far is in {out}")


def _truth(path: Path, measurement: Measurement) -> np.ndarray:
    """True cube on the bands of the imager; of a finer cube the means over them."""
    from shadowgram.measurement import band_means, check_cube

    cube = read_cube(path)
    values = cube.values
    bands = measurement.imager.resolution.bands
    if len(values) > bands:
        values = band_means(values, measurement.imager)
    check_cube(values, measurement.imager)
    return values


def _solver(solver: Solver, tau: float | None, max_iter: int | None, tol: float | None) -> EigenTV | FISTA | GPSR:
    """Solver with the options that were given, its own defaults for the others."""
    import shadowgram as sg

    if solver == Solver.eigen_tv and tau is not None:
        raise ValueError("--tau belongs to gpsr and fista; eigen-tv takes its parameters from the noise")
    kind = {Solver.eigen_tv: sg.EigenTV, Solver.gpsr: sg.GPSR, Solver.fista: sg.FISTA}[solver]
    given = {"tau": tau, "max_iter": max_iter, "tol": tol}
    return kind(**{name: value for name, value in given.items() if value is not None})


def _solve(spec: EigenTV | FISTA | GPSR, measurement: Measurement, threads: int | None) -> Solution:
    from shadowgram import threads as use_threads
    from shadowgram.solvers.solution import solve

    with (
        output.progress("reconstructing", spec.max_iter) as update,
        nullcontext() if threads is None else use_threads(threads),
    ):

        def callback(iteration: int, values: dict[str, float]) -> None:
            update(iteration, "  ".join(f"{name} {value:.3g}" for name, value in values.items()))

        return solve(spec, measurement.operator, measurement.snapshots, callback=callback)


def _report_solution(solution: Solution, quality: Quality | None, seconds: float, out: Path, as_json: bool) -> None:
    values = {
        "file": out,
        "iterations": solution.iterations,
        "converged": solution.converged,
        "interrupted": solution.interrupted,
        "seconds": seconds,
        "quality": None if quality is None else dataclasses.asdict(quality),
    }
    state = "converged" if solution.converged else "not converged"
    lines = [f"{state} after {solution.iterations} iterations, {seconds:.2f} s; written to {out}"]
    output.report(values, lines + ([] if quality is None else quality_lines(quality)), as_json)
