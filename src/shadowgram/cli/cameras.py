"""`shadowgram capture`."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import output
from .arguments import band_range, parse_size, read_code, read_curve
from .cubes import read_cube
from .masks import Kind, make_code

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr

    from shadowgram.measurement import Imager, Measurement
    from shadowgram.spectral.sscsi import SSCSI


class Camera(StrEnum):
    """Imagers, by the name that the options have for them."""

    sscsi = "sscsi"
    cassi = "cassi"
    dual = "dual"
    colored = "colored"
    colored4 = "colored4"


class Shear(StrEnum):
    """How an SSCSI model averages the code of a band."""

    exact = "exact"
    centre = "centre"
    edge = "edge"


DetectorPitch = Annotated[float, typer.Option(help="Side of a detector element, µm.")]
CodePitch = Annotated[float | None, typer.Option(help="Side of a code element, µm; by default that of the detector.")]
DispersionRatio = Annotated[float, typer.Option(help="Length of the spectral plane over that of the mask, β.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of code and noise.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


def capture(
    context: typer.Context,
    scene: Annotated[Path, typer.Argument(help="Datacube to take snapshots of.", show_default=False)],
    out: Annotated[Path, typer.Option("-o", "--out", help="Measurement to write, .nc.")],
    imager: Annotated[Camera, typer.Option(help="Imager; colored4 has the four filters.")] = Camera.sscsi,
    shots: Annotated[int, typer.Option(help="Number of snapshots.")] = 3,
    code: Annotated[str, typer.Option(help="boolean, random, or a file with the code.")] = "boolean",
    snr: Annotated[float | None, typer.Option(help="Signal-to-noise ratio, dB; by default no noise.")] = None,
    seed: Seed = 0,
    wavelengths: Annotated[
        str | None, typer.Option(help="First and last band of the scene, nm; where its file does not say.")
    ] = None,
    mask_position: Annotated[
        float | None, typer.Option(help="SSCSI: s in [0, 1); by default what resolves the bands of the scene.")
    ] = None,
    detector_shape: Annotated[str | None, typer.Option(help="SSCSI: elements y x x; by default the scene's.")] = None,
    detector_pitch: DetectorPitch = 10.0,
    code_pitch: CodePitch = None,
    dispersion_ratio: DispersionRatio = 1.0,
    shear: Annotated[
        Shear | None,
        typer.Option(
            help="How the model spreads a band: SSCSI exact, centre or edge; CASSIs centre or exact (higher order).",
            show_default="exact; CASSIs centre",
        ),
    ] = None,
    band_shift: Annotated[
        float | None, typer.Option(help="CASSIs: pixels of dispersion a band, any positive number.", show_default="1")
    ] = None,
    dispersion: Annotated[
        Path | None, typer.Option(help="CASSIs: measured curve instead, a text file of lines 'nm, px'.")
    ] = None,
    bands: Annotated[
        int | None, typer.Option(min=1, help="CASSIs with --fine: bands to resolve, of which the scene has a multiple.")
    ] = None,
    fine: Annotated[
        bool,
        typer.Option(
            "--fine", help="The scene is finer than what the imager resolves; measure all of it where it falls."
        ),
    ] = False,
    pupil: Annotated[
        float,
        typer.Option(
            min=0, help="SSCSI with --fine: image of the lens aperture on the spectral plane, µm; blurs the mask."
        ),
    ] = 0.0,
    png: Annotated[Path | None, typer.Option(help="Show codes and snapshots in this PNG.")] = None,
    as_json: AsJson = False,
) -> None:
    """Simulate the snapshots that an imager takes of a scene.

    Example: shadowgram capture scene.nc -o shots.nc --shots 3 --snr 40
    """
    from shadowgram.measurement import AWGN, imager_to_json, write_measurement
    from shadowgram.measurement import capture as measure

    output.check_result(out, (".nc",), inputs=[scene, _code_file(code)])
    if png is not None:
        output.check_output(png, (".png",), inputs=[scene])
    cube = read_cube(scene, wavelengths=wavelengths)
    if imager == Camera.sscsi:
        size = None if detector_shape is None else parse_size("--detector-shape", detector_shape)
        if bands is not None:
            raise ValueError("--bands belongs to the CASSIs; an SSCSI resolves what --mask-position says")
        if band_shift is not None or dispersion is not None:
            raise ValueError(
                "--band-shift and --dispersion belong to the CASSIs; an SSCSI disperses by --mask-position"
            )
        model: Imager = _sscsi(
            cube, size, detector_pitch, code_pitch, mask_position, dispersion_ratio, shear or Shear.exact
        )
    else:
        if mask_position is not None or detector_shape is not None:
            raise ValueError("--mask-position and --detector-shape belong to the imager sscsi")
        model = _cassi(imager, cube, detector_pitch, bands, shear or Shear.centre, band_shift, dispersion)
    mask = _code(code, imager, model, shots, seed)
    noise = None if snr is None else AWGN(snr_db=snr, seed=seed)
    with output.progress("measuring"):
        measurement = measure(
            model, mask, cube, noise=noise, fine=fine, pupil=pupil, scene=str(cube.name or scene.stem)
        )
    text = output.configuration(context, imager=json.loads(imager_to_json(model)))
    write_measurement(measurement, out, configuration=text)
    output.write_configuration(out, text)
    if png is not None:
        _picture(measurement, png)
    _report_capture(measurement, out, as_json)


def _sscsi(
    cube: xr.DataArray,
    detector_shape: tuple[int, int] | None,
    detector_pitch: float,
    code_pitch: float | None,
    mask_position: float | None,
    dispersion_ratio: float,
    shear: Shear,
) -> SSCSI:
    from shadowgram.spectral.sscsi import SSCSI

    if code_pitch is None:
        code_pitch = detector_pitch
    elif code_pitch != detector_pitch and detector_shape is None:
        raise ValueError("with a code finer than the detector, say --detector-shape and --mask-position")
    if detector_shape is None:
        detector_shape = (cube.sizes["y"], cube.sizes["x"])
    if mask_position is None:
        mask_position = cube.sizes["band"] * code_pitch / (dispersion_ratio * detector_shape[1] * detector_pitch)
        if mask_position >= 1:
            raise ValueError(
                f"{cube.sizes['band']} bands cannot be resolved with {detector_shape[1]} detector columns: no mask position"
                " disperses them far enough; crop fewer bands or say --mask-position"
            )
    return SSCSI(
        detector_shape=detector_shape,
        detector_pitch=detector_pitch,
        code_pitch=code_pitch,
        mask_position=mask_position,
        wavelengths=band_range(cube.wavelength.values),
        dispersion_ratio=dispersion_ratio,
        shear=shear.value,
    )


def _cassi(
    camera: Camera,
    cube: xr.DataArray,
    pitch: float,
    wanted: int | None,
    shear: Shear,
    band_shift: float | None,
    dispersion: Path | None,
) -> Imager:
    from shadowgram.spectral.cassi import CASSI, DualCASSI
    from shadowgram.spectral.colored import ColoredCASSI

    kind = {Camera.cassi: CASSI, Camera.dual: DualCASSI}.get(camera, ColoredCASSI)
    bands, ny, nx = cube.shape
    bands = wanted or bands
    return kind(
        cube_shape=(bands, ny, nx),
        wavelengths=band_range(cube.wavelength.values),
        pitch=pitch,
        shear=shear.value,
        band_shift=band_shift,
        dispersion=None if dispersion is None else read_curve(dispersion),
    )


def _code_file(code: str) -> Path | None:
    return None if code in (Kind.boolean, Kind.random) else Path(code)


def _code(code: str, camera: Camera, imager: Imager, shots: int, seed: int) -> np.ndarray:
    path = _code_file(code)
    if path is not None:
        if not path.suffix:
            raise ValueError(f"--code takes boolean, random or a file (.nc, .npy, .png), got {code!r}")
        return read_code(path)
    *bands, ny, nx = imager.code_shape
    if not bands:
        return make_code(Kind(code), shots, (ny, nx), None, 0.5, seed)
    if code == Kind.random:
        raise ValueError("a colored code is boolean, or comes from a file")
    return make_code(Kind.four if camera == Camera.colored4 else Kind.ideal, shots, (ny, nx), bands[0], 0.5, seed)


def _picture(measurement: Measurement, png: Path) -> None:
    from shadowgram.figures import images, style

    with style.style():
        output.write_bytes(png, style.png(images.shots(measurement.code, measurement.snapshots)))


def _report_capture(m: Measurement, out: Path, as_json: bool) -> None:
    bands, ny, nx = m.imager.resolution.cube_shape
    ratio = m.snapshots.size / (bands * ny * nx)
    values = {
        "file": out,
        "imager": type(m.imager).__name__,
        "datacube": [bands, ny, nx],
        "snapshots": list(m.snapshots.shape),
        "compression": ratio,
        "vignetted": list(m.imager.resolution.vignetted),
    }
    shots, rows, columns = m.snapshots.shape
    lines = [
        f"{type(m.imager).__name__}: {bands} bands × {ny} × {nx} → {shots} × {rows} × {columns} (shots × y × x)",
        f"{100 * ratio:.1f} % as many numbers as the datacube; written to {out}",
    ]
    if lost := m.imager.resolution.vignetted_bands:
        lines.append(
            f"{len(lost)} of {bands} bands lose light beside the mask, up to {100 * max(m.imager.resolution.vignetted):.0f} %"
        )
    output.report(values, lines, as_json)
