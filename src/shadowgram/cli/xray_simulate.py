"""`shadowgram xray simulate` and `shadowgram xray scene`."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import output, running, xray_results

if TYPE_CHECKING:
    from shadowgram.xray._compile import Compiled
    from shadowgram.xray.montecarlo.run import Run, State
    from shadowgram.xray.scene import Scene


SceneName = Annotated[
    str, typer.Argument(metavar="SCENE|NAME", help="TOML file of a scene, or one that comes with the package.")
]


def simulate(
    context: typer.Context,
    scene: SceneName,
    histories: Annotated[str, typer.Option(help="Source photons, such as 1000000 or 1e6; with --stop-at at most.")],
    seed: Annotated[int, typer.Option(min=0, help="Of the random numbers.")] = 0,
    shot: Annotated[int, typer.Option(min=0, help="Of a scene with a sliding mask: where the mask is.")] = 0,
    variance_reduction: Annotated[
        bool,
        typer.Option(
            "--variance-reduction",
            help="Send photons to target and detectors: smaller errors of the counts, same means.",
        ),
    ] = False,
    stop_at: Annotated[
        float | None,
        typer.Option(help="Stop at this relative standard error of the counts of all detectors, such as 0.01."),
    ] = None,
    checkpoint: Annotated[
        Path | None, typer.Option(help="File that keeps what was found; the same command goes on from it.")
    ] = None,
    phase_space: Annotated[
        Path | None,
        typer.Option(help="Write the photons that enter detectors: .npz, .h5 or .mcpl. Takes as long again."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Write all tallies: .json or .nc.", show_default=False)
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Show spectra, orders and images in this PNG.", show_default=False)
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Follow photons from the source of a scene to its detectors, and count them.

    Example: shadowgram xray simulate cxbi-blocks --histories 1e6 --variance-reduction --plot counts.png

    Example: shadowgram xray simulate mine.toml --histories 1e9 --stop-at 0.01 --checkpoint run.npz -o tallies.json

    The result depends on scene, seed and histories alone. Ctrl-C ends the run and keeps what was found. The JSON has title,
    histories, seconds, finished, photons_per_shot, and tallies: for each name mean, standard_error, unit, and for lists of numbers
    axes and edges of the bins. Names are "all" and the detectors (pulses above threshold), with /orders, /spectrum and /image;
    deposited/SOLID (keV), dose/SOLID (Gy), escaped/backward, escaped/forward and escaped/cosine. Means are per source photon; times
    photons_per_shot they are per shot.
    """
    number = running.parse_histories(histories)
    given = Path(scene)
    _check_files(given, out, plot, phase_space, checkpoint)
    described = read(scene)
    if phase_space is not None and not described.detectors:
        raise ValueError("the scene has no detector that photons could enter: leave out --phase-space, or add one")
    found = _run(described, number, seed, shot, variance_reduction, stop_at, checkpoint)
    values = xray_results.values(found, described)
    if out is not None:
        _write(out, context, found, described, values)
    if plot is not None:
        _plot(found, described, plot)
    output.report(values, _lines(found, described, shot), as_json)
    if not found.finished:
        raise output.Interrupted(_interrupted(found, number, checkpoint, phase_space))
    if phase_space is not None:
        _write_phase_space(described, found.histories, seed, shot, variance_reduction, phase_space)


def read(scene: str) -> Scene:
    """The scene of a file, or of the package.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If there is no such scene, or it cannot be.
    """
    from shadowgram.xray.scene import read_scene, shipped_scene, shipped_scenes

    if scene in shipped_scenes():
        return shipped_scene(scene)
    path = Path(scene)
    if path.suffix.lower() != ".toml" and not path.exists():
        raise ValueError(f"there is no scene {scene!r}: give a TOML file, or one of {', '.join(shipped_scenes())}")
    return read_scene(path)


def _check_files(
    scene: Path, out: Path | None, plot: Path | None, phase_space: Path | None, checkpoint: Path | None
) -> None:
    if out is not None:
        check = output.check_result if out.suffix.lower() == ".nc" else output.check_output
        check(out, (".json", ".nc"), inputs=[scene])
    if plot is not None:
        output.check_output(plot, (".png",), inputs=[scene])
    if phase_space is not None:
        output.check_output(phase_space, (".npz", ".h5", ".mcpl"), inputs=[scene])
    if checkpoint is not None:
        output.check_output(checkpoint, (".npz",), inputs=[scene])
    if checkpoint is not None and phase_space is not None and checkpoint.resolve() == phase_space.resolve():
        raise ValueError(f"{checkpoint} cannot be both --checkpoint and --phase-space; name two files")


def _run(
    scene: Scene,
    histories: int,
    seed: int,
    shot: int,
    variance_reduction: bool,
    stop_at: float | None,
    checkpoint: Path | None,
) -> Run:
    from shadowgram.xray.simulation import compiled
    from shadowgram.xray.simulation import simulate as follow

    arrays = compiled(scene, shot)
    with output.progress("photons", histories) as update, running.telling_of_compilation("batch"):
        return follow(
            arrays,
            histories=histories,
            seed=seed,
            shot=shot,
            variance_reduction=variance_reduction,
            stop_at=stop_at,
            checkpoint=checkpoint,
            progress=_Watch(update, stop_at),
        )


class _Watch:
    """Says how far a run is; what was compiled before the first photons does not count for the time left."""

    def __init__(self, update: output.Update, stop_at: float | None) -> None:
        self._update, self._stop_at = update, stop_at
        self._first: tuple[float, int] | None = None

    def __call__(self, state: State) -> None:
        """After a batch."""
        now = time.monotonic()
        error = state.relative_error
        if self._first is None:
            self._first = now, state.done
        begun, before = self._first
        wanted = float(state.total)
        if self._stop_at is not None and math.isfinite(error):
            wanted = min(wanted, state.done * (error / self._stop_at) ** 2)
        left = (now - begun) * max(0.0, wanted - state.done) / (state.done - before) if state.done > before else None
        self._update(state.done, f"± {100 * error:.2g} %" if math.isfinite(error) else "", left)


def _write(out: Path, context: typer.Context, run: Run, scene: Scene, values: dict[str, object]) -> None:
    if out.suffix.lower() == ".json":
        output.write_bytes(out, (output.configuration(context, **values) + "\n").encode())
        return
    from shadowgram.scenes.readers.native import write_dataset

    counted = {name: value for name, value in values.items() if name != "tallies"}
    settings = output.configuration(context, **counted)
    write_dataset(xray_results.dataset(run, scene, settings), out)
    output.write_configuration(out, settings)


def _plot(run: Run, scene: Scene, file: Path) -> None:
    from shadowgram.figures import style, xray_tallies

    with style.style():
        output.write_bytes(file, style.png(xray_tallies.tallies(run, scene.title)))


def _lines(run: Run, scene: Scene, shot: int) -> list[str]:
    of = f", shot {shot} of {scene.shots}" if scene.shots > 1 else ""
    rate = f" ({run.histories / run.seconds:.3g} a second)" if run.seconds > 0 else ""
    return [
        *([f"{scene.title}{of}"] if scene.title or of else []),
        f"{run.histories} photons followed in {output.duration(run.seconds)}{rate}",
        "",
        *xray_results.table(run, scene),
    ]


def _interrupted(run: Run, histories: int, checkpoint: Path | None, phase_space: Path | None) -> str:
    kept = "" if checkpoint is None else f"; {checkpoint} keeps it, and the same command goes on"
    left_out = "" if phase_space is None else f"; {phase_space} was not written"
    return f"interrupted: this is what {run.histories} of {histories} photons gave{kept}{left_out}"


def _write_phase_space(
    scene: Scene, histories: int, seed: int, shot: int, variance_reduction: bool, path: Path
) -> None:
    from shadowgram.xray.phase_space import phase_space, write_phase_space

    with output.progress("phase space", histories) as update:
        found = phase_space(
            scene,
            histories=histories,
            seed=seed,
            shot=shot,
            variance_reduction=variance_reduction,
            progress=lambda done: update(done, ""),
        )
    write_phase_space(path, found)
    typer.echo(f"shadowgram: {path} has {len(found)} photons", err=True)


def scene(
    name: Annotated[
        str | None,
        typer.Argument(metavar="SCENE|NAME", help="TOML file of a scene, or one of --list.", show_default=False),
    ] = None,
    shot: Annotated[int, typer.Option(min=0, help="Where a sliding mask is.")] = 0,
    plot: Annotated[Path | None, typer.Option(help="Show the scene in this PNG.", show_default=False)] = None,
    as_toml: Annotated[
        bool, typer.Option("--toml", help="Print the whole scene as TOML, to begin one's own with.")
    ] = False,
    list_all: Annotated[bool, typer.Option("--list", help="List the scenes that come with the package.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Say what a scene consists of, and whether it can be: its files are read and its solids are put together.

    Example: shadowgram xray scene cxbi-hand --plot hand.png

    Example: shadowgram xray scene cxbi-blocks --toml > mine.toml

    The JSON has scene (all that the TOML file may say, mm, keV, rad, s), photons_per_second, photons_per_shot, solid_angle (sr),
    mean_energy (keV), and solids: name, role, lower and upper corner of a box around it (mm), and mass (g; null for the world, and
    where another solid cuts into it). With --list: scenes, name and title.
    """
    if list_all:
        _list(as_json)
        return
    if name is None:
        raise ValueError("say which scene, a TOML file or one of those that --list names")
    if as_toml and as_json:
        raise ValueError("--toml and --json are two ways of printing: give one of them")
    if plot is not None:
        output.check_output(plot, (".png",), inputs=[Path(name)])
    described = read(name)
    from shadowgram.xray.simulation import compiled

    arrays = compiled(described, shot)
    if plot is not None:
        from shadowgram.figures.xray_scene import draw

        draw(described, plot, shot=shot)
    if as_toml:
        typer.echo(described.toml().rstrip("\n"))
    else:
        output.report(_scene_values(described, arrays), _scene_lines(described, arrays), as_json)


def _list(as_json: bool) -> None:
    from shadowgram.xray.scene import shipped_scene, shipped_scenes

    titles = {name: shipped_scene(name).title for name in shipped_scenes()}
    width = max(map(len, titles)) + 2
    values = {"scenes": [{"name": name, "title": title} for name, title in titles.items()]}
    output.report(values, [f"{name:<{width}}{title}" for name, title in titles.items()], as_json)


def _scene_values(scene: Scene, arrays: Compiled) -> dict[str, object]:
    roles = {solid.name: solid.role for solid in scene.solids} | {one.name: "detector" for one in scene.detectors}
    solids = [
        {
            "name": name,
            "role": roles.get(name, name),
            "lower": box[:3].tolist(),
            "upper": box[3:].tolist(),
            "mass": float(mass),
        }
        for name, box, mass in zip(arrays.solid_names, arrays.geometry.box, arrays.masses, strict=True)
    ]
    return {
        "scene": scene.model_dump(mode="json", exclude_none=True),
        "photons_per_second": scene.source.photons_per_second,
        "photons_per_shot": scene.photons_per_shot,
        "solid_angle": scene.source.solid_angle,
        "mean_energy": scene.source.spectrum.spectrum().mean_energy,
        "solids": solids,
    }


def _scene_lines(scene: Scene, arrays: Compiled) -> list[str]:
    from .xray_scene_lines import lines

    return lines(scene, arrays)
