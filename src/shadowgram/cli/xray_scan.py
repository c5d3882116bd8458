"""`shadowgram xray scan` and `shadowgram xray pencil`."""

from __future__ import annotations

import dataclasses
import math
import time
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from . import output, running, xray_scan_results
from .arguments import parse_size, read_code
from .xray_simulate import read

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.figure import Figure

    from shadowgram.experiments.run import Executor, Summary
    from shadowgram.xray._scan_blocks import Block, Plan
    from shadowgram.xray.scan import PencilMap, Scan
    from shadowgram.xray.scene import Scene

FAILED = 1

Whole = TypeVar("Whole")


class RouteName(StrEnum):
    """Ways to the counts."""

    direct = "direct"
    linear = "linear"


SceneName = Annotated[
    str, typer.Argument(metavar="SCENE|NAME", help="TOML file of a scene, or one that comes with the package.")
]
Seed = Annotated[int, typer.Option(min=0, help="Of the random numbers.")]
Workers = Annotated[
    int | None, typer.Option(min=1, help="Compute in this many processes; by default in threads of one.")
]
ClusterAddress = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Compute on the workers of this Dask scheduler.")
]
JournalFolder = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Folder that keeps what is finished; the same command goes on from it.",
        show_default="beside OUT",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


def scan(
    context: typer.Context,
    scene: SceneName,
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write, .nc.", show_default=False)],
    shots: Annotated[
        int | None, typer.Option(min=1, help="How many; by default as many as the scene or the code has.")
    ] = None,
    transmittance: Annotated[
        float | None, typer.Option(help="%, of a random mask in place of the scene's.", show_default=False)
    ] = None,
    code: Annotated[
        Path | None,
        typer.Option(
            help="Code in place of the scene's: a strip (y, x) that slides, or one (shot, y, x) for each shot; "
            ".nc, .npy, .npz, .mat, .csv or .png.",
            show_default=False,
        ),
    ] = None,
    route: Annotated[
        RouteName, typer.Option(help="Follow photons in every shot, or tally what each cell of the mask gives.")
    ] = RouteName.direct,
    histories: Annotated[
        str | None,
        typer.Option(
            help="Source photons of all shots together, such as 1e8; of a linear scan, those of the response.",
            show_default="as many as the source emits; linear 20000 a cell, at most 2.4e7",
        ),
    ] = None,
    seed: Seed = 0,
    background: Annotated[
        bool, typer.Option("--background", help="Take the shots without the target as well.")
    ] = False,
    means: Annotated[
        bool,
        typer.Option("--means", help="Mean counts in place of counts with noise; direct ones with variance reduction."),
    ] = False,
    workers: Workers = None,
    cluster: ClusterAddress = None,
    journal: JournalFolder = None,
    plot: Annotated[Path | None, typer.Option(help="Show counts and code in this PNG.", show_default=False)] = None,
    as_json: Json = False,
) -> None:
    """Take the shots of a coded mask that slides in front of a scene, and count what comes back.

    Example: shadowgram xray scan cxbi-blocks --shots 8 --histories 1e6 -o y.nc --plot y.png

    Example: shadowgram xray scan cxbi-blocks --shots 512 --transmittance 10 --route linear --background -o y.nc

    A direct scan is a function of scene, codes, seed and histories alone; Ctrl-C leaves what is finished in the journal. Its counts
    are those of histories / shots photons, as they came. A linear scan has those of the scene's exposure, and Poisson noise.

    The JSON has file, route, noisy, shots, photons_per_shot, exposure (s), open (share of the cells), counts, standard_error,
    background and background_error (lists, a number a shot; null if not taken), orders (mean counts per shot by what the photon did
    before), journal and seconds.
    """
    begun = time.monotonic()
    number = None if histories is None else running.parse_histories(histories)
    output.check_result(out, (".nc",), inputs=[Path(scene), code])
    if plot is not None:
        output.check_output(plot, (".png",), inputs=[Path(scene), code])
    described, codes = _coded(read(scene), transmittance, code)
    if route is RouteName.linear:
        _refuse_elsewhere(workers, cluster, journal)
        found, folder = _linear(described, codes, shots, number, seed, means, background), None
    else:
        from shadowgram.xray.scan import direct_plan

        executor = running.executor(workers, cluster)
        plan = direct_plan(
            described, codes, shots=shots, histories=number, seed=seed, variance_reduction=means, background=background
        )
        folder = journal or out.with_suffix(".journal")
        found = _run(plan, folder, executor, "scan")
    _write_scan(found, out, context)
    if plot is not None:
        from shadowgram.figures import xray_scan

        _plot(xray_scan.scan(found), plot)
    values = xray_scan_results.scan_values(found, out, folder, time.monotonic() - begun)
    output.report(values, xray_scan_results.scan_lines(found, out, described), as_json)


def pencil(
    context: typer.Context,
    scene: SceneName,
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write, .nc.", show_default=False)],
    shape: Annotated[str, typer.Option(help="Rows x columns of the map.")] = "32x32",
    pitch: Annotated[float, typer.Option(help="From beam to beam, mm.")] = 8.71,
    distance: Annotated[float, typer.Option(help="From the source to the front of the target, mm.")] = 250.0,
    half_angle: Annotated[float, typer.Option(min=0, max=90, help="Of the beam, degrees.")] = 0.4,
    photons: Annotated[int, typer.Option(min=2, help="For each pixel.")] = 5000,
    analog: Annotated[
        bool, typer.Option("--analog", help="Counts with their noise in place of means with variance reduction.")
    ] = False,
    seed: Seed = 0,
    workers: Workers = None,
    cluster: ClusterAddress = None,
    journal: JournalFolder = None,
    plot: Annotated[Path | None, typer.Option(help="Show the map in this PNG.", show_default=False)] = None,
    as_json: Json = False,
) -> None:
    """Scan the target with narrow parallel beams in place of the mask: the truth that a reconstruction is compared with.

    Example: shadowgram xray pencil cxbi-ud -o truth.nc --photons 200 --plot truth.png

    Rows and columns run as those of the scene's mask. The JSON has file, noisy, shape, photons, counts, standard_error and target
    (lists of rows; the part of the counts that is not air), journal and seconds.
    """
    begun = time.monotonic()
    output.check_result(out, (".nc",), inputs=[Path(scene)])
    if plot is not None:
        output.check_output(plot, (".png",), inputs=[Path(scene)])
    from shadowgram.xray.scan import pencil_plan

    executor = running.executor(workers, cluster)
    described = read(scene)
    plan = pencil_plan(
        described,
        shape=parse_size("--shape", shape),
        pitch=pitch,
        distance=distance,
        half_angle=math.radians(half_angle),
        photons=photons,
        seed=seed,
        variance_reduction=not analog,
    )
    folder = journal or out.with_suffix(".journal")
    found = _run(plan, folder, executor, "pencil beams")
    _write_pencil(found, out, context)
    if plot is not None:
        from shadowgram.figures import xray_scan

        _plot(xray_scan.pencil(found), plot)
    values = xray_scan_results.pencil_values(found, out, folder, time.monotonic() - begun)
    output.report(values, xray_scan_results.pencil_lines(found, out), as_json)


def _coded(scene: Scene, transmittance: float | None, code: Path | None) -> tuple[Scene, np.ndarray | None]:
    """The scene, and codes in place of its own if a file was given."""
    if transmittance is not None and code is not None:
        raise ValueError("--transmittance makes a random code and --code reads one: give one of them")
    if code is not None:
        return scene, _read_codes(code)
    if transmittance is None:
        return scene, None
    if not 0 < transmittance <= 100:
        raise ValueError(f"--transmittance is the percentage of holes, above 0 and at most 100; got {transmittance:g}")
    from shadowgram.xray.scan import with_transmittance

    return with_transmittance(scene, transmittance / 100), None


def _read_codes(path: Path) -> np.ndarray:
    from shadowgram.xray.patterns import check_file, only_array, read_pattern

    check_file(path)
    suffix = path.suffix.lower()
    if suffix == ".nc":
        return read_code(path)
    if suffix in (".npy", ".npz", ".mat"):
        try:
            return only_array(path, axes=(3, 2))
        except ValueError as error:
            raise ValueError(f"cannot read the code {path}: {error}") from error
    return read_pattern(path)


def _refuse_elsewhere(workers: int | None, cluster: str | None, journal: Path | None) -> None:
    if workers is not None or cluster is not None or journal is not None:
        raise ValueError(
            "--workers, --cluster and --journal belong to --route direct; a linear scan takes a minute here"
        )


def _linear(
    scene: Scene,
    codes: np.ndarray | None,
    shots: int | None,
    histories: int | None,
    seed: int,
    means: bool,
    background: bool,
) -> Scan:
    from shadowgram.xray.scan import linear_scan

    with output.progress("scan", 100) as update, running.telling_of_compilation("response_batch"):
        return linear_scan(
            scene,
            codes,
            shots=shots,
            histories=histories,
            seed=seed,
            noise=not means,
            background=background,
            progress=lambda done, total: update(100 * done // total, ""),
        )


def _run(plan: Plan[Whole], folder: Path, executor: Executor, what: str) -> Whole:
    """The result of a plan, whose parts a journal in `folder` keeps."""
    from shadowgram.experiments.journal import open_journal
    from shadowgram.experiments.xray_scan import run_plan

    _try(plan.blocks[0])
    folder.mkdir(parents=True, exist_ok=True)
    output.check_folder(folder)
    with open_journal(folder) as journal, executor, output.progress(what, len(plan.blocks)) as update:
        outcome = run_plan(
            plan, journal, executor=executor, progress=lambda state: update(state.done, "", state.seconds_left)
        )
        path = journal.path
    if outcome.result is None:
        _give_up(outcome.summary, path)
    return outcome.result  # type: ignore[return-value]  # it is there, or this line is not reached


def _give_up(summary: Summary, journal: Path) -> None:
    there = f"{summary.computed + summary.reused} of {summary.total} parts are in {journal}"
    if summary.failed and not summary.interrupted:
        output.complain(f"{len(summary.failed)} parts failed, the first with {summary.failed[0][1]}; {there}")
        raise typer.Exit(FAILED)
    raise output.Interrupted(f"interrupted: {there}, and the same command goes on")


def _try(block: Block) -> None:
    """Follow two photons, so that what is wrong with the scene is known at once, and the kernels are compiled once for all."""
    from shadowgram.xray._scan_blocks import follow

    with running.telling_of_compilation("batch"):
        follow(dataclasses.replace(block, histories=2, steps=block.steps[:1]))


def _write_scan(found: Scan, out: Path, context: typer.Context) -> None:
    from shadowgram.xray.scan_file import write_scan

    text = output.configuration(context, photons_per_shot=found.photons_per_shot, exposure=found.exposure)
    write_scan(found, out, configuration=text)
    output.write_configuration(out, text)


def _write_pencil(found: PencilMap, out: Path, context: typer.Context) -> None:
    from shadowgram.xray.scan_file import write_pencil_map

    text = output.configuration(context)
    write_pencil_map(found, out, configuration=text)
    output.write_configuration(out, text)


def _plot(figure: Figure, file: Path) -> None:
    from shadowgram.figures import style

    output.write_bytes(file, style.png(figure))
