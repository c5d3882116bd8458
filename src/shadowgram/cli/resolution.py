"""`shadowgram resolution`."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import output
from .arguments import parse_size, parse_wavelengths

if TYPE_CHECKING:
    from shadowgram.spectral.bench import Bench
    from shadowgram.spectral.resolution import Resolution
    from shadowgram.spectral.sscsi import SSCSI

ROWS = 9  # of the table over a bench's reach


def resolution(
    mask_position: Annotated[
        float | None,
        typer.Option(
            help="s in [0, 1): 0 on the detector, 1 on the spectral plane; with --bench by default as far as it reaches."
        ),
    ] = None,
    band_width: Annotated[
        float | None,
        typer.Option(help="Instead of --mask-position: bands so wide, nm; says where the mask must stand."),
    ] = None,
    bench: Annotated[
        str | None,
        typer.Option(metavar="FILE|NAME", help="TOML file of a bench, or salazar2022; instead of the geometry below."),
    ] = None,
    wavelengths: Annotated[
        str | None, typer.Option(help="Shortest and longest wavelength, nm, such as 451:642.")
    ] = None,
    detector_shape: Annotated[str | None, typer.Option(help="Detector elements y x x.", show_default="256x256")] = None,
    detector_pitch: Annotated[
        float | None, typer.Option(help="Side of a detector element, µm.", show_default="10")
    ] = None,
    code_pitch: Annotated[
        float | None, typer.Option(help="Side of a code element, µm; by default that of the detector.")
    ] = None,
    dispersion_ratio: Annotated[
        float | None, typer.Option(help="Length of the spectral plane over that of the mask, β.", show_default="1")
    ] = None,
    png: Annotated[Path | None, typer.Option(help="Show the resolution over the mask position in this PNG.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Say what an SSCSI resolves, or where its mask must stand to resolve bands of a given width.

    Example: shadowgram resolution --mask-position 0.09375 --wavelengths 451:642

    Example: shadowgram resolution --bench salazar2022 --band-width 20 --json

    The JSON has mask_position (s), regime, cube_shape (band, y, x), bands, band_width and spectral_extents (nm), band_edges and
    wavelengths (nm), x_pitch and y_pitch (µm on the detector), throughput and vignetted of each band, mean_throughput,
    vignetted_bands and imager (the geometry). With a bench also distance (mm from the image plane), bench (its parts, and
    dispersion in µm/nm, dispersion_ratio, nonlinearity in nm, plane_distance and exit_pupil in mm, reachable s,
    pupil_band_width in nm, diffraction_spot and blur in µm on the mask) and reach (the table over its mask positions).
    What is infinite is null.

    A bench's keys: grating_lines (1/mm), relay_focal_lengths (two, mm), wavelengths (two, nm), detector_shape (y, x),
    detector_pitch and code_pitch (µm), mask_distances (nearest, farthest, mm), pupil_distance (mm) or measured_ratio (β);
    optional f_number, magnification, order. `shadowgram.spectral.bench` has the physics.
    """
    if png is not None:
        output.check_output(png, (".png",), inputs=[None if bench is None else Path(bench)])
    if mask_position is not None and band_width is not None:
        raise ValueError("--mask-position and --band-width say the same thing: give one of them")
    geometry = {
        "--wavelengths": wavelengths,
        "--detector-shape": detector_shape,
        "--detector-pitch": detector_pitch,
        "--code-pitch": code_pitch,
        "--dispersion-ratio": dispersion_ratio,
    }
    if bench is None:
        camera = _camera(wavelengths, detector_shape, detector_pitch, code_pitch, dispersion_ratio)
        parts, imager = None, _placed(camera, mask_position, band_width)
    else:
        parts = _bench(bench, geometry)
        imager = _placed_on(parts, mask_position, band_width)
    if png is not None:
        _picture(imager, parts, png)
    output.report(_values(imager, parts), _lines(imager, parts), as_json)


def _camera(
    wavelengths: str | None,
    detector_shape: str | None,
    detector_pitch: float | None,
    code_pitch: float | None,
    dispersion_ratio: float | None,
) -> SSCSI:
    """SSCSI of this geometry, its mask still on the detector."""
    from shadowgram.spectral.sscsi import SSCSI

    if wavelengths is None:
        raise ValueError("say the --wavelengths of the camera, such as 451:642 in nm, or its --bench")
    pitch = 10.0 if detector_pitch is None else detector_pitch
    return SSCSI(
        detector_shape=parse_size("--detector-shape", detector_shape or "256x256"),
        detector_pitch=pitch,
        code_pitch=pitch if code_pitch is None else code_pitch,
        mask_position=0.0,
        wavelengths=parse_wavelengths(wavelengths),
        dispersion_ratio=1.0 if dispersion_ratio is None else dispersion_ratio,
    )


def _placed(camera: SSCSI, mask_position: float | None, band_width: float | None) -> SSCSI:
    from shadowgram.spectral.resolution import position_for

    if band_width is not None:
        mask_position = position_for(camera, band_width=band_width)
    if mask_position is None:
        raise ValueError("say where the mask stands, --mask-position, or what it must resolve, --band-width")
    return dataclasses.replace(camera, mask_position=mask_position)


def _bench(bench: str, geometry: Mapping[str, object]) -> Bench:
    from shadowgram.spectral.bench import read_bench

    if given := [option for option, value in geometry.items() if value is not None]:
        raise ValueError(f"a bench has its own geometry: leave out {', '.join(given)}, or --bench")
    return read_bench(bench)


def _placed_on(bench: Bench, mask_position: float | None, band_width: float | None) -> SSCSI:
    from shadowgram.spectral.resolution import position_for

    if band_width is not None:
        mask_position = position_for(bench, band_width=band_width)
    return bench.imager(bench.reachable[1] if mask_position is None else mask_position)


def _values(imager: SSCSI, bench: Bench | None) -> dict[str, object]:
    found = imager.resolution
    values: dict[str, object] = {
        "mask_position": imager.mask_position,
        **dataclasses.asdict(found),
        "bands": found.bands,
        "band_edges": found.band_edges.tolist(),
        "wavelengths": found.wavelengths.tolist(),
        "throughput": found.throughput.tolist(),
        "mean_throughput": found.mean_throughput,
        "vignetted_bands": found.vignetted_bands,
        "imager": dataclasses.asdict(imager),
    }
    if bench is None:
        return values
    derived = {
        "dispersion": bench.dispersion,
        "dispersion_ratio": bench.dispersion_ratio,
        "nonlinearity": bench.nonlinearity,
        "plane_distance": bench.plane_distance,
        "exit_pupil": bench.exit_pupil,
        "reachable": bench.reachable,
        "pupil_band_width": bench.pupil_band_width,
        "diffraction_spot": bench.diffraction_spot,
        "blur": bench.blur(imager.mask_position),
    }
    reach = [
        {
            "mask_position": s,
            "distance": bench.distance(s),
            "band_width": r.band_width,
            "bands": r.bands,
            "x_pitch": r.x_pitch,
            "mean_throughput": r.mean_throughput,
        }
        for s, r in _over_reach(bench)
    ]
    return {
        **values,
        "distance": bench.distance(imager.mask_position),
        "bench": {**dataclasses.asdict(bench), **derived},
        "reach": reach,
    }


def _over_reach(bench: Bench) -> list[tuple[float, Resolution]]:
    nearest, farthest = bench.reachable
    positions = [nearest + (farthest - nearest) * n / (ROWS - 1) for n in range(ROWS)]
    return [(s, bench.imager(s).resolution) for s in positions]


def _lines(imager: SSCSI, bench: Bench | None) -> list[str]:
    rows, columns = imager.code_shape
    s = imager.mask_position
    where = "" if bench is None else f", {bench.distance(s):.4g} mm from the image plane"
    beyond = imager.resolution.band_edges[-1] > imager.wavelengths[1] * (1 + 1e-9)
    lines = [
        f"mask           s = {s:.4g}{where}",
        *_blurred(imager, bench),
        *str(imager.resolution).splitlines(),
        f"code           {rows} × {columns} elements (y × x) of {imager.code_pitch:g} µm"
        + ("" if bench is None else f" on the detector, {bench.code_pitch:g} µm on the mask"),
        *([f"range          the last band reaches beyond {imager.wavelengths[1]:g} nm"] if beyond else []),
    ]
    return lines if bench is None else [*lines, "", *_bench_lines(bench, imager), "", *_table(bench)]


def _blurred(imager: SSCSI, bench: Bench | None) -> list[str]:
    """A warning, where the aperture keeps fewer bands apart than the mask."""
    if bench is None or bench.pupil_band_width <= imager.resolution.band_width:
        return []
    low, high = bench.wavelengths
    apart = max(1, int((high - low) / bench.pupil_band_width))
    bands = imager.resolution.bands
    return [
        f"warning        the mask would resolve {bands} bands, but f/{bench.f_number:g} keeps only about {apart} apart"
    ]


def _bench_lines(bench: Bench, imager: SSCSI) -> list[str]:
    low, high = bench.wavelengths
    nearest, farthest = bench.reachable
    near, far = bench.mask_distances
    length = bench.dispersion * (high - low) / 1000
    lines = {
        "dispersion": f"α = {bench.dispersion:.4g} µm/nm within {bench.nonlinearity:.2g} nm, β = {bench.dispersion_ratio:.4g}",
        "spectrum": f"{length:.4g} mm long on the spectral plane, {bench.plane_distance:.4g} mm from the image plane",
        "exit pupil": f"{bench.exit_pupil:.4g} mm from the grating",
        "reach": f"s from {nearest:.4g} to {farthest:.4g}, {near:g} to {far:g} mm from the image plane",
        "aperture": _aperture(bench, imager),
    }
    return [f"{name:<15}{text}" for name, text in lines.items()]


def _aperture(bench: Bench, imager: SSCSI) -> str:
    width = imager.resolution.band_width
    need = f"bands of {width:.4g} nm need f/{math.ceil(bench.f_number_for(width))}"
    if math.isinf(bench.f_number):
        return f"taken for a pinhole, as the bench has no f_number; {need}"
    return (
        f"f/{bench.f_number:g} keeps apart {bench.pupil_band_width:.4g} nm wherever the mask stands, {need};"
        f" it blurs the mask by {bench.blur(imager.mask_position):.3g} µm here,"
        f" and diffraction a point by {bench.diffraction_spot:.3g} µm"
    )


def _table(bench: Bench) -> list[str]:
    rows = [
        f"{s:9.5f}{bench.distance(s):9.3f}{r.band_width:12.4g}{r.bands:7d}{r.x_pitch:14.4g}{100 * r.mean_throughput:12.1f} %"
        for s, r in _over_reach(bench)
    ]
    return [f"{'s':>9}{'mm':>9}{'band nm':>12}{'bands':>7}{'pitch x µm':>14}{'throughput':>14}", *rows]


def _picture(imager: SSCSI, bench: Bench | None, png: Path) -> None:
    from shadowgram.figures import resolution as figure
    from shadowgram.figures import style

    farthest = 0.95 if bench is None else min(0.95, 1.5 * bench.reachable[1])
    with style.style():
        drawn = figure.over_position(imager, max(farthest, imager.mask_position), bench=bench)
        output.write_bytes(png, style.png(drawn))
