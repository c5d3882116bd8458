"""`shadowgram codes design`."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from . import code_imager, output
from .arguments import parse_size
from .code_analysis import write_sheet
from .code_imager import Geometry, Kind, make_imager
from .code_search import Search

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr

    from shadowgram.codes import Design

    from .code_imager import Camera

SAME = 1e-9  # shots; open shots of an element nearer to 1 than this are 1


def design(
    context: typer.Context,
    out: Annotated[Path, typer.Option("-o", "--out", help="Code to write, .nc.")],
    shots: Annotated[int, typer.Option(help="Number of snapshots, at least 2.", show_default=False)],
    imager: Annotated[Kind, typer.Option(help="Imager that the code is for.")] = Kind.sscsi,
    detector_shape: Annotated[
        str | None,
        typer.Option(help="SSCSI: detector elements y x x; CASSIs: pixels of the scene.", show_default="256x256"),
    ] = None,
    detector_pitch: code_imager.DetectorPitch = None,
    code_pitch: code_imager.CodePitch = None,
    mask_position: code_imager.MaskPosition = None,
    bands: code_imager.Bands = None,
    wavelengths: code_imager.Wavelengths = None,
    dispersion_ratio: code_imager.DispersionRatio = None,
    shear: code_imager.ShearOption = None,
    band_shift: code_imager.BandShift = None,
    dispersion: code_imager.Dispersion = None,
    bench: code_imager.BenchOption = None,
    c1: Annotated[
        float | None,
        typer.Option("--c1", help="Weight of the diagonal of HᵀH.", show_default="by bands and shots"),
    ] = None,
    repulsion: Annotated[float, typer.Option(help="Weight of 1/distance between open elements of a shot.")] = 1.0,
    coupling: Annotated[
        float, typer.Option(help="Weight of columns that meet in one shot at neighbouring places.")
    ] = 0.0,
    transmittance: Annotated[
        float | None, typer.Option(help="Share of shots in which an element is open.", show_default="1/Q")
    ] = None,
    tile: Annotated[
        str | None, typer.Option(help="Elements y x x of a tile that repeats over the mask.", show_default=False)
    ] = None,
    starts: Annotated[
        int, typer.Option(min=1, help="Designs from different starts, side by side; the best is kept.")
    ] = 1,
    exchange: Annotated[
        bool, typer.Option("--exchange", help="Then exchange neighbouring elements of the best: little gained, slow.")
    ] = False,
    tolerance: Annotated[
        float, typer.Option(help="A sweep that changes the cost by less, of that of the start, is the last.")
    ] = 1e-3,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first start; the next ones have the next numbers.")] = 0,
    png: Annotated[Path | None, typer.Option(help="Show the code, its spectrum and its clusters in this PNG.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with a design that was interrupted.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Design a code for an imager: few voxels that share a detector element are open in the same shot.

    Example: shadowgram codes design -o code.nc --shots 6 --bands 24

    After every sweep over the code, all of it is kept in a file beside the output, code.design.nc, until the design is done. After
    Ctrl-C, or whatever ended it, the same command with --resume goes on, and the result is that of a design never interrupted.

    The code is written as by 'codes make', with the costs and moves of the sweeps; 'codes analyse' knows its imager from the file.
    """
    output.check_result(out, (".nc",))
    if png is not None:
        output.check_output(png, (".png",), inputs=[out])
    camera = make_imager(
        Geometry(
            kind=imager, detector_shape=detector_shape, detector_pitch=detector_pitch, code_pitch=code_pitch,
            mask_position=mask_position, bands=bands, wavelengths=wavelengths, dispersion_ratio=dispersion_ratio,
            shear=shear, band_shift=band_shift, dispersion=dispersion, bench=bench,
        )
    )  # fmt: skip
    options: dict[str, Any] = {
        "shots": shots,
        "c1": c1,
        "repulsion": repulsion,
        "coupling": coupling,
        "transmittance": transmittance,
        "tile": None if tile is None else parse_size("--tile", tile),
        "tolerance": tolerance,
    }
    _check_exchange(exchange, imager, shots, transmittance)
    begun = time.monotonic()
    search = Search(camera, options, seed=seed, starts=starts, exchange=exchange, out=out, resume=resume)
    with output.progress("designing") as update:
        found = search.run(update)
    context.params.pop("resume")  # a design that was interrupted is the same design
    _write(context, camera, search, found, out)
    if png is not None:
        write_sheet(png, search.mask(found), f"Code designed for {_name(camera)}, {shots} shots")
    search.remove_file()
    parts = _parts(camera, options, found)
    _report(camera, search, found, parts, out, time.monotonic() - begun, as_json)


def code_dataset(code: np.ndarray, text: str, attributes: Mapping[str, str]) -> xr.Dataset:
    """Dataset of a code and its configuration, as all commands write it."""
    import xarray as xr

    from shadowgram import __version__

    axes = ("shot", "y", "x") if code.ndim == 3 else ("shot", "band", "y", "x")
    common = {"kind": "code", "configuration": text, "shadowgram_version": __version__}
    return xr.Dataset({"code": (axes, code)}, attrs={**common, **attributes})


def _check_exchange(exchange: bool, imager: Kind, shots: int, transmittance: float | None) -> None:
    """Refuse what the exchanges would refuse, before the design and not after it."""
    if exchange and (imager == Kind.colored or (transmittance is not None and abs(transmittance * shots - 1) >= SAME)):
        raise ValueError(
            "--exchange is for codes of one mask whose elements are open in one shot: leave it out, or --transmittance and"
            " --imager colored"
        )


def _write(context: typer.Context, camera: Camera, search: Search, found: Design, out: Path) -> None:
    from shadowgram.measurement import imager_to_json
    from shadowgram.scenes.readers.native import write_dataset

    described = imager_to_json(camera)
    text = output.configuration(
        context,
        imager=json.loads(described),
        design={
            "weights": dataclasses.asdict(found.weights),
            "seed": found.seed,
            "converged": found.converged,
            "exchange_sweeps": search.exchanges,
            "costs_of_starts": search.costs,
        },
    )
    dataset = code_dataset(search.mask(found), text, {"imager": described})
    write_dataset(dataset.assign(costs=("cost", list(found.costs)), moves=("sweep", list(found.moves))), out)
    output.write_configuration(out, text)


def _parts(camera: Camera, options: Mapping[str, Any], found: Design) -> dict[str, float] | None:
    """Terms of the cost; None where elements are open in several shots, of which the costs cannot be had one by one."""
    from shadowgram.codes._design import design as begin

    if (found.code.sum(axis=0) != 1).any():
        return None

    def cost(c1: float = 0.0, coupling: float = 0.0) -> float:
        first = begin(
            camera, shots=len(found.code), seed=found.seed, tile=options["tile"], start=found.code, max_sweeps=0,
            c1=c1, repulsion=0.0, coupling=coupling,
        )  # fmt: skip
        return first.costs[0]

    pairs, weights = cost(), found.weights
    diagonal = cost(c1=weights.c1) - pairs if weights.c1 else 0.0
    coupling = cost(coupling=weights.coupling) - pairs if weights.coupling else 0.0
    repulsion = found.costs[-1] - pairs - diagonal - coupling if weights.repulsion else 0.0
    return {"pairs": pairs, "diagonal": diagonal, "repulsion": repulsion, "coupling": coupling}


def _name(camera: Camera) -> str:
    bands, ny, nx = camera.resolution.cube_shape
    return f"{type(camera).__name__} of {bands} bands × {ny} × {nx}"


def _report(
    camera: Camera,
    search: Search,
    found: Design,
    parts: Mapping[str, float] | None,
    out: Path,
    seconds: float,
    as_json: bool,
) -> None:
    code = search.mask(found)
    light = [float(share) for share in code.reshape(len(code), -1).mean(axis=1)]
    first, last = found.costs[0], found.costs[-1]
    values = {
        "file": out,
        "imager": type(camera).__name__,
        "shape": list(code.shape),
        "sweeps": found.sweeps,
        "exchange_sweeps": search.exchanges,
        "converged": found.converged,
        "costs": list(found.costs),
        "parts": parts,
        "seed": found.seed,
        "costs_of_starts": search.costs,
        "light": light,
        "seconds": seconds,
    }
    state = "converged" if found.converged else "not converged"
    exchanged = f", {search.exchanges} of them exchanges" if search.exchanges else ""
    shown = " × ".join(map(str, code.shape))
    lines = [
        f"{_name(camera)}: code {shown} ({'shots × y × x' if code.ndim == 3 else 'shots × bands × y × x'})",
        f"{state} after {found.sweeps} sweeps{exchanged}, {output.duration(seconds)}; written to {out}",
        f"cost    {first:.6g} → {last:.6g} ({_percent(last, first)}){_shown(parts)}",
        f"light   {_shares(light)} of the elements are open in a shot",
    ]
    if len(search.costs) > 1:
        lines.append(
            f"starts  best of {len(search.costs)}, seed {found.seed}; costs {min(search.costs):.6g} to {max(search.costs):.6g}"
        )
    output.report(values, lines, as_json)


def _percent(value: float, reference: float) -> str:
    change = 100 * (value / reference - 1) if reference else 0.0
    return f"{change:+.2f} %".replace("-", "−")


def _shown(parts: Mapping[str, float] | None) -> str:
    return "" if parts is None else ": " + ", ".join(f"{name} {part:.4g}" for name, part in parts.items() if part)


def _shares(light: list[float]) -> str:
    low, high = 100 * min(light), 100 * max(light)
    return f"{low:.2f} %" if math.isclose(low, high, abs_tol=0.005) else f"{low:.2f} to {high:.2f} %"
