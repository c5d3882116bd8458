"""`shadowgram xray dose`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from . import output, running
from .xray_scan import Json, SceneName, Seed
from .xray_simulate import read

if TYPE_CHECKING:
    from shadowgram.xray.dose import ScanDose
    from shadowgram.xray.montecarlo.tallies import Estimate
    from shadowgram.xray.scene import Scene


def dose(
    scene: SceneName,
    shots: Annotated[
        int | None, typer.Option(min=1, help="Of the scan.", show_default="as many as the scene has")
    ] = None,
    transmittance: Annotated[
        float | None, typer.Option(help="%, of a random mask in place of the scene's.", show_default=False)
    ] = None,
    histories: Annotated[
        str | None,
        typer.Option(
            help="Follow so many source photons as well, such as 1e6, for the mean dose in each solid of the target.",
            show_default=False,
        ),
    ] = None,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Say what dose a scan gives to the skin of whoever stands in it.

    Example: shadowgram xray dose cxbi-hand --shots 512 --transmittance 10

    Example: shadowgram xray dose cxbi-man --transmittance 10 --histories 1e6

    The dose is that in skeletal muscle at the front of the target, as a mean over the field; a cell is what one hole of the mask
    lights. With --histories, the mean dose in each solid of the target beside it, in its own material and at all its depths.

    The JSON has title, shots, transmittance, photons and area (of a cell, cm²), pixel, shot, scan (Gy), limit (Gy, of an inspection
    with commercial scanners, from and to), share_of_limit, histories, and simulated: for each solid of the target mean and
    standard_error (Gy a scan), null without --histories.
    """
    number = None if histories is None else running.parse_histories(histories)
    described = _masked(read(scene), transmittance)
    from shadowgram.xray.dose import scan_dose

    found = scan_dose(described, shots=shots, transmittance=None if transmittance is None else transmittance / 100)
    simulated = None if number is None else _simulated(described, found.shots, number, seed)
    output.report(_values(described, found, simulated, number), _lines(described, found, simulated, number), as_json)


def _masked(scene: Scene, transmittance: float | None) -> Scene:
    """The scene, with a random mask in place of its own if a transmittance in % was given."""
    if transmittance is None:
        return scene
    if not 0 < transmittance <= 100:
        raise ValueError(f"--transmittance is the percentage of holes, above 0 and at most 100; got {transmittance:g}")
    from shadowgram.xray.scan import with_transmittance

    return with_transmittance(scene, transmittance / 100)


def _simulated(scene: Scene, shots: int, histories: int, seed: int) -> dict[str, Estimate]:
    """Mean doses of the target's solids in a whole scan, all of whose shots are like the middle one."""
    from shadowgram.xray.simulation import compiled, simulate

    shot = scene.shots // 2
    arrays = compiled(scene, shot)
    with output.progress("photons", histories) as update, running.telling_of_compilation("batch"):
        run = simulate(arrays, histories=histories, seed=seed, shot=shot, progress=lambda state: update(state.done, ""))
    if not run.finished:
        raise output.Interrupted("interrupted: the doses were not found; give a smaller number of --histories")
    names = [solid.name for solid in scene.solids if solid.role == "target" and f"dose/{solid.name}" in run.tallies]
    return {name: run.tallies[f"dose/{name}"].scaled(shots * scene.photons_per_shot, "Gy") for name in names}


def _values(
    scene: Scene, found: ScanDose, simulated: dict[str, Estimate] | None, histories: int | None
) -> dict[str, object]:
    from shadowgram.xray.dose import COMMERCIAL

    return {
        "title": scene.title,
        "shots": found.shots,
        "transmittance": found.transmittance,
        "photons": float(found.photons.mean()),
        "area": float(found.area.mean()),
        "pixel": float(found.pixel.mean()),
        "shot": found.shot,
        "scan": found.scan,
        "limit": COMMERCIAL,
        "share_of_limit": found.share_of_limit,
        "histories": histories,
        "simulated": None
        if simulated is None
        else {
            name: {"mean": float(one.mean), "standard_error": float(one.standard_error)}
            for name, one in simulated.items()
        },
    }


def _lines(scene: Scene, found: ScanDose, simulated: dict[str, Estimate] | None, histories: int | None) -> list[str]:
    from shadowgram.xray.dose import COMMERCIAL

    rows, columns = found.pixel.shape
    low, high = (1e6 * value for value in COMMERCIAL)
    pixel = 1e9 * found.pixel
    cells = f"{100 * found.transmittance:.3g} % of {rows} × {columns} cells open"
    each = f"{found.photons.mean():.0f} photons in a shot on {found.area.mean():.3g} cm² through an open one"
    spread = f"{pixel.min():.3g} to {pixel.max():.3g}; {found.tissue} at the front"
    limit = f"{low:.2g} to {high:.2g} µSv an inspection; the scan is {found.share_of_limit:.2g} times the lower one"
    lines = [
        *([scene.title] if scene.title else []),
        f"{found.shots} shots, {cells}; {each}",
        f"{'an open cell':<18}{pixel.mean():>10.3g} nGy a shot, {spread}",
        f"{'a shot':<18}{1e9 * found.shot:>10.3g} nGy, mean over the field",
        f"{'the scan':<18}{1e6 * found.scan:>10.3g} µGy, mean over the field",
        f"{'commercial':<18}{limit}",
    ]
    if simulated is not None:
        lines.append(f"mean doses of the scan in the target, by {histories} photons followed")
        lines += [
            f"  {name:<16}{1e6 * float(one.mean):>10.3g} ± {1e6 * float(one.standard_error):.1g} µGy"
            for name, one in simulated.items()
        ]
    return lines
