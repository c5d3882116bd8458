"""`shadowgram import`."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import output
from .arguments import band_range, parse_range
from .cameras import AsJson, Camera, DetectorPitch

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

    from shadowgram.measurement import Measurement
    from shadowgram.spectral.capture_checks import Finding
    from shadowgram.spectral.mismatch import Mismatch, MovableImager

CAMERAS = (Camera.cassi, Camera.colored, Camera.colored4)


def import_shots(
    context: typer.Context,
    shots: Annotated[
        list[Path],
        typer.Argument(help="Files with shots, or one folder that a capture.toml describes.", show_default=False),
    ],
    mask: Annotated[Path, typer.Option(help="File with the mask, captured or designed: y x x, or shot x y x x.")],
    wavelengths: Annotated[
        str, typer.Option(help="Centres of the bands, nm: a text file, a list 450,460,475, or with --bands first:last.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="Measurement to write, .nc.")],
    camera: Annotated[Camera, typer.Option(help="Imager: cassi, or colored for masks with bands.")] = Camera.cassi,
    band_shift: Annotated[float, typer.Option(help="Pixels of dispersion a band, to the right.")] = 1.0,
    bands: Annotated[
        int | None, typer.Option(min=2, help="Number of bands, where --wavelengths is first:last.")
    ] = None,
    variable: Annotated[str | None, typer.Option(help="Variable with the shots, where a file has several.")] = None,
    mask_variable: Annotated[str | None, typer.Option(help="Variable with the mask, likewise.")] = None,
    detector_pitch: DetectorPitch = 10.0,
    saturation: Annotated[float | None, typer.Option(help="Value of a saturated pixel.")] = None,
    correct: Annotated[
        bool,
        typer.Option(
            "--correct", help="Estimate the dark level and what is wrong with the mask's place, and correct it."
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Make a measurement of shots that a camera took, for 'reconstruct', and check them.

    Example: shadowgram import scene3.mat --mask mask.mat --band-shift 2 --wavelengths nm.txt --correct -o shots.nc
    """
    from shadowgram.measurement import Measurement, imager_to_json, write_measurement
    from shadowgram.scenes import read_array
    from shadowgram.spectral import check_capture, estimate_mismatch

    output.check_result(out, (".nc",), inputs=[*(s for s in shots if s.is_file()), mask])
    if camera not in CAMERAS:
        raise ValueError(
            f"captured shots are imported for a camera of the kinds {', '.join(CAMERAS)}, not {camera.value}"
        )
    centres = band_centres(wavelengths, bands)
    values = read_shots(shots, variable)
    code = read_array(mask, mask_variable)
    imager = camera_of(camera, code, centres, band_shift, detector_pitch)
    with output.progress("checking"):
        findings = check_capture(imager, code, values, saturation=saturation)
    tell(findings)
    found = None
    if correct:
        with output.progress("estimating the mismatch"):
            found = estimate_mismatch(imager, code, values)
    name = shots[0].stem
    measurement = (
        Measurement(imager=imager, code=code, snapshots=values, scene=name)
        if found is None
        else Measurement(imager=found.imager, code=found.code, snapshots=found.snapshots, scene=name)
    )
    text = output.configuration(context, imager=json.loads(imager_to_json(measurement.imager)))
    write_measurement(measurement, out, configuration=text)
    output.write_configuration(out, text)
    _report(measurement, findings, found, out, as_json)


def band_centres(text: str, bands: int | None) -> tuple[float, ...]:
    """Wavelengths of the bands from a file, a list, or a range and a number of bands."""
    import numpy as np

    path = Path(text)
    if path.is_file():
        numbers = _numbers(path.read_text(encoding="utf-8"), f"the wavelengths in {path}")
    elif ":" in text:
        if bands is None:
            raise ValueError("with --wavelengths first:last, say the number of bands with --bands")
        first, last = parse_range("--wavelengths", text)
        return tuple(np.linspace(first, last, bands).tolist())
    else:
        numbers = _numbers(text, "--wavelengths, which is no file here,")
    if bands is not None and bands != len(numbers):
        raise ValueError(
            f"--bands is {bands}, and --wavelengths has {len(numbers)}: leave out --bands or correct the list"
        )
    return numbers


def _numbers(text: str, what: str) -> tuple[float, ...]:
    words = " ".join(line.split("#")[0] for line in text.splitlines()).replace(",", " ").split()
    try:
        return tuple(map(float, words))
    except ValueError:
        raise ValueError(f"{what} must be numbers in nm, with commas or spaces between them") from None


def read_shots(paths: Sequence[Path], variable: str | None) -> np.ndarray:
    """Shots (shot, y, x) from files, one or more shots each, or from a folder of a camera."""
    import numpy as np

    from shadowgram.scenes import read_array, read_frames

    if len(paths) == 1 and paths[0].is_dir():
        frames = read_frames(paths[0])
        return frames.snapshots
    stacks = [read_array(path, variable) for path in paths]
    stacks = [one[None] if one.ndim == 2 else one for one in stacks]
    sizes = {one.shape[1:] for one in stacks}
    if len(sizes) > 1:
        raise ValueError(
            f"the shots must have one size, got {', '.join(f'{y} × {x}' for y, x in sorted(sizes))} (y × x): crop them alike"
        )
    return np.concatenate(stacks)


def camera_of(
    camera: Camera, code: np.ndarray, centres: tuple[float, ...], band_shift: float, pitch: float
) -> MovableImager:
    """Imager whose scene has the size of the mask."""
    import numpy as np

    from shadowgram.spectral.cassi import CASSI
    from shadowgram.spectral.colored import ColoredCASSI

    band_range(np.array(centres))  # one band has no width
    kind = CASSI if camera == Camera.cassi else ColoredCASSI
    ny, nx = code.shape[-2:]
    return kind(cube_shape=(len(centres), ny, nx), band_centres=centres, band_shift=band_shift, pitch=pitch)


def tell(findings: Sequence[Finding]) -> None:
    """Refuse what cannot be reconstructed, and warn of the rest."""
    for finding in findings:
        if finding.fatal:
            raise ValueError(str(finding))
        warnings.warn(str(finding), UserWarning, stacklevel=2)


def _report(m: Measurement, findings: Sequence[Finding], found: Mismatch | None, out: Path, as_json: bool) -> None:
    shots, rows, columns = m.snapshots.shape
    bands, ny, nx = m.imager.resolution.cube_shape
    values: dict[str, object] = {
        "file": out,
        "imager": type(m.imager).__name__,
        "datacube": [bands, ny, nx],
        "snapshots": [shots, rows, columns],
        "findings": [str(finding) for finding in findings],
    }
    lines = [f"{shots} × {rows} × {columns} (shots × y × x) of {bands} bands × {ny} × {nx} → {out}"]
    if found is not None:
        names = ("dy", "dy_error", "dx", "dx_error", "dispersion", "dispersion_error", "blur", "held_out")
        values["mismatch"] = {name: getattr(found, name) for name in names} | {
            "offsets": found.offsets.tolist(),
            "gains": found.gains.tolist(),
        }
        lines.append(str(found))
    output.report(values, lines, as_json)
