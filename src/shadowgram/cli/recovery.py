"""`shadowgram reconstruct`."""

from __future__ import annotations

import dataclasses
import json
import time
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import output
from .cubes import quality_lines, read_cube
from .recovery_solvers import Effort, Solver, Wishes, choose, estimate_seconds, most_iterations
from .recovery_strips import reconstruct_in_strips
from .side_picture import Response, with_picture

if TYPE_CHECKING:
    import numpy as np

    from shadowgram.experiments.quality import Quality
    from shadowgram.measurement import Measurement
    from shadowgram.operators.base import LinearOperator
    from shadowgram.solvers.solution import Solution
    from shadowgram.solvers.uncertainty import Uncertainty

    from .recovery_solvers import Spec

_SAMPLES = 8  # of the uncertainty: the deviation of a voxel is then known to about a quarter


def reconstruct(
    context: typer.Context,
    shots: Annotated[Path, typer.Argument(help="Measurement, as 'capture' writes it.", show_default=False)],
    out: Annotated[Path, typer.Option("-o", "--out", help="Datacube to write, .nc.")],
    solver: Annotated[Solver, typer.Option(help="Algorithm.")] = Solver.eigen_tv,
    quality: Annotated[
        Effort | None, typer.Option(help="eigen-tv: 'best' adds a denoiser where it helps.  [default: fast]")
    ] = None,
    noise: Annotated[float | None, typer.Option(help="eigen-tv: known standard deviation of the shots.")] = None,
    tau: Annotated[float | None, typer.Option(help="gpsr, fista, twist: sparsity relative to |ΨᵀHᵀy|∞.")] = None,
    weight: Annotated[float | None, typer.Option(help="gap-tv, admm-tv: weight of the total variation.")] = None,
    uncertainty: Annotated[Path | None, typer.Option(help="Write standard deviations of the cube, .nc.")] = None,
    side: Annotated[Path | None, typer.Option(help="Ordinary picture of the scene, pixel by pixel.")] = None,
    side_response: Annotated[Response, typer.Option(help="What that picture shows.")] = Response.pan,
    max_iter: Annotated[int | None, typer.Option(help="Largest number of iterations.")] = None,
    tol: Annotated[float | None, typer.Option(help="Relative change at which it has converged.")] = None,
    truth: Annotated[Path | None, typer.Option(help="True datacube, to print the quality.")] = None,
    threads: Annotated[int | None, typer.Option(help="Threads; by default all processors.")] = None,
    strips: Annotated[
        str | None, typer.Option(metavar="ROWS", help="Work by strips of so many detector rows, or 'auto'.")
    ] = None,
    memory: Annotated[float, typer.Option(help="GB that --strips auto may take.")] = 6.0,
    workers: Annotated[int | None, typer.Option(min=1, help="Work on the strips in this many processes.")] = None,
    cluster: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Work on the strips on this Dask scheduler's workers.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Reconstruct the datacube behind a measurement; Ctrl-C keeps the best so far.

    Captures that do not fit in memory are reconstructed by strips, which an interrupted run goes on with.

    Example: shadowgram reconstruct shots.nc -o cube.nc --truth scene.nc
    """
    from shadowgram.experiments.quality import assess

    wishes = Wishes(solver=solver, quality=quality, tau=tau, weight=weight, noise=noise, max_iter=max_iter, tol=tol)
    spec = choose(wishes)
    if strips is not None:
        _check_whole({"--truth": truth, "--uncertainty": uncertainty, "--side": side})
        reconstruct_in_strips(
            context, shots, out, spec, strips=strips, memory=memory, workers=workers, cluster=cluster, threads=threads,
            as_json=as_json,
        )  # fmt: skip
        return
    if workers is not None or cluster is not None:
        raise ValueError("--workers and --cluster share strips among processes; add --strips auto")
    _check_files(shots, out, truth, side, uncertainty)
    measurement, expected = _read(shots, truth)
    with nullcontext() if threads is None else _threads(threads):
        begun = time.perf_counter()
        H, y = _problem(measurement, side, side_response)
        if quality == Effort.best or uncertainty is not None:
            left = estimate_seconds(spec, H, y, 0 if uncertainty is None else _SAMPLES)
            typer.echo(f"shadowgram: this will take about {output.duration(left)}", err=True)
        solution = _solve(spec, H, y)
        seconds = time.perf_counter() - begun
        text = _configuration(context, measurement, spec, solution)
        _write(solution.x, measurement, measurement.scene, text, out)
        output.write_configuration(out, text)
        spread = None
        if uncertainty is not None and not solution.interrupted:
            spread = _uncertainty(spec, H, y, solution, out)
            _write(spread.std, measurement, "standard_deviation", text, uncertainty)
    found = None if expected is None else assess(solution.x, expected)
    _report_solution(solution, found, seconds, out, None if spread is None else uncertainty, as_json)
    if solution.interrupted:
        raise output.Interrupted(f"interrupted after {solution.iterations} iterations; the best so far is in {out}")
    if spread is not None and spread.interrupted:
        raise output.Interrupted(f"interrupted; {uncertainty} is made of {spread.samples} of {_SAMPLES} samples")


def _check_whole(given: dict[str, Path | None]) -> None:
    """Refuse options that need the whole cube in memory."""
    for option, path in given.items():
        if path is not None:
            raise ValueError(f"{option} needs the whole cube in memory, which --strips avoids; leave one of them out")


def _check_files(shots: Path, out: Path, truth: Path | None, side: Path | None, uncertainty: Path | None) -> None:
    output.check_result(out, (".nc",), inputs=[shots, truth, side])
    if uncertainty is not None:
        output.check_output(uncertainty, (".nc",), inputs=[shots, truth, side])
        if uncertainty.resolve() == out.resolve():
            raise ValueError(f"--uncertainty and --out are both {out}; write to two files")


def _read(shots: Path, truth: Path | None) -> tuple[Measurement, np.ndarray | None]:
    from shadowgram.measurement import read_measurement

    measurement = read_measurement(shots)
    return measurement, None if truth is None else _truth(truth, measurement)


def _configuration(context: typer.Context, measurement: Measurement, spec: Spec, solution: Solution) -> str:
    from shadowgram.measurement import imager_to_json

    return output.configuration(
        context,
        imager=json.loads(imager_to_json(measurement.imager)),
        solver={"type": type(spec).__name__, **dataclasses.asdict(spec)},
        iterations=solution.iterations,
        converged=solution.converged,
        interrupted=solution.interrupted,
    )


def _write(values: np.ndarray, measurement: Measurement, name: str, configuration: str, path: Path) -> None:
    from shadowgram.scenes import as_datacube, write

    name = name if name.isidentifier() else "datacube"
    cube = as_datacube(values, measurement.imager.resolution.wavelengths, name)
    write(cube.assign_attrs(configuration=configuration), path)


def _threads(count: int) -> AbstractContextManager[None]:
    from shadowgram import threads

    return threads(count)


def _problem(measurement: Measurement, side: Path | None, response: Response) -> tuple[LinearOperator, np.ndarray]:
    if side is None:
        return measurement.operator, measurement.snapshots
    return with_picture(side, response, measurement)


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


def _solve(spec: Spec, H: LinearOperator, y: np.ndarray) -> Solution:
    from shadowgram.solvers.solution import solve

    with output.progress("reconstructing", most_iterations(spec)) as update:

        def callback(iteration: int, values: dict[str, float]) -> None:
            update(iteration, "  ".join(f"{name} {value:.3g}" for name, value in values.items()))

        return solve(spec, H, y, callback=callback)


def _uncertainty(spec: Spec, H: LinearOperator, y: np.ndarray, solution: Solution, out: Path) -> Uncertainty:
    from shadowgram.solvers.uncertainty import uncertainty

    with output.progress("uncertainty, sample", _SAMPLES) as update:

        def callback(sample: int, iteration: int) -> None:
            update(sample, f"iteration {iteration}")

        try:
            return uncertainty(spec, H, y, solution, seed=0, samples=_SAMPLES, callback=callback)
        except KeyboardInterrupt:
            raise output.Interrupted(f"interrupted before the uncertainty was known; the cube is in {out}") from None


def _report_solution(
    solution: Solution, quality: Quality | None, seconds: float, out: Path, deviations: Path | None, as_json: bool
) -> None:
    whiteness = solution.whiteness
    values = {
        "file": out,
        "iterations": solution.iterations,
        "converged": solution.converged,
        "interrupted": solution.interrupted,
        "seconds": seconds,
        "denoised": solution.denoised,
        "whiteness": None if whiteness is None else dataclasses.asdict(whiteness),
        "uncertainty": deviations,
        "quality": None if quality is None else dataclasses.asdict(quality),
    }
    state = "converged" if solution.converged else "not converged"
    lines = [f"{state} after {solution.iterations} iterations, {seconds:.2f} s; written to {out}"]
    if solution.denoised is not None:
        lines.append("the denoiser was used" if solution.denoised else "the denoiser did not help, and was not used")
    if whiteness is not None:
        lines.append(
            f"residual: correlation of neighbours {whiteness.correlation:+.3f}, white noise gives 0 ± {whiteness.expected:.2g}"
        )
    if deviations is not None:
        lines.append(f"standard deviations written to {deviations}")
    output.report(values, lines + ([] if quality is None else quality_lines(quality)), as_json)
