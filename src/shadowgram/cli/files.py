"""`shadowgram info`, `convert` and `compare`."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import output
from .arguments import parse_crop, parse_range
from .cubes import quality_lines, read_cube, side_by_side

if TYPE_CHECKING:
    import xarray as xr

InputFile = Annotated[
    Path, typer.Argument(help="File to read, or folder with a PNG picture a band.", show_default=False)
]
Variable = Annotated[str | None, typer.Option(help="Variable to read, where the file has several.")]
Axes = Annotated[str | None, typer.Option(help="Order of the axes in the file, such as y,x,band.")]
Wavelengths = Annotated[
    str | None, typer.Option(help="First and last band, nm, such as 451:642; where the file does not say.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


def info(
    file: InputFile,
    variable: Variable = None,
    axes: Axes = None,
    wavelengths: Wavelengths = None,
    as_json: AsJson = False,
) -> None:
    """Say what a file holds: a datacube, a measurement, a code, an X-ray scan or its image, or a folder of camera frames.

    Example: shadowgram info cube.nc
    """
    values = _native_contents(file) if file.suffix == ".nc" else _frames_contents(file) if file.is_dir() else None
    if values is None:
        values = _cube_contents(read_cube(file, variable=variable, axes=axes, wavelengths=wavelengths))
    lines = [f"{name.replace('_', ' '):<18}{_shown(value)}" for name, value in values.items()]
    output.report(values, lines, as_json)


def convert(
    context: typer.Context,
    source: Annotated[Path, typer.Argument(metavar="IN", help="Datacube to read.", show_default=False)],
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            help="File to write; its ending says the format: .nc, .mat, .npz, .npy, .hdr (ENVI) or .tif (OME-TIFF); "
            "without one a new folder of PNG pictures is made.",
            show_default=False,
        ),
    ],
    variable: Variable = None,
    axes: Axes = None,
    wavelengths: Wavelengths = None,
    crop: Annotated[str | None, typer.Option(help="Part to keep, y0:y1,x0:x1 in pixels.")] = None,
    bands: Annotated[str | None, typer.Option(help="Bands to keep, shortest:longest in nm.")] = None,
    as_json: AsJson = False,
) -> None:
    """Convert a datacube from one format to another.

    Example: shadowgram convert lego.mat lego.nc --wavelengths 451:642
    """
    from shadowgram.scenes import write

    _check_cube_path(out, source)
    cube = read_cube(source, variable=variable, axes=axes, wavelengths=wavelengths)
    if crop is not None:
        rows, columns = parse_crop(crop)
        if rows.stop > cube.sizes["y"] or columns.stop > cube.sizes["x"]:
            raise ValueError(
                f"--crop {crop} reaches beyond the cube's {cube.sizes['y']} × {cube.sizes['x']} pixels (y × x)"
            )
        cube = cube[:, rows, columns]
    if bands is not None:
        low, high = parse_range("--bands", bands)
        kept = (cube.wavelength.values >= low) & (cube.wavelength.values <= high)
        if not kept.any():
            raise ValueError(
                f"--bands {bands} keeps none of the bands at {cube.wavelength.values[0]:.4g} to {cube.wavelength.values[-1]:.4g} nm"
            )
        cube = cube[kept]
    text = output.configuration(context)
    with output.progress("writing"):
        write(cube.assign_attrs(configuration=text), out)
    output.write_configuration(out, text)
    values = {"file": out, **_cube_contents(cube)}
    output.report(values, [f"{source} → {out}", _size_line(cube)], as_json)


def compare(
    estimate: Annotated[Path, typer.Argument(help="Reconstruction.", show_default=False)],
    truth: Annotated[Path, typer.Argument(help="Datacube to compare it with.", show_default=False)],
    peak: Annotated[
        float | None,
        typer.Option(
            help="Largest possible value, for PSNR and SSIM; by default 1, or TRUTH's largest value if above 1."
        ),
    ] = None,
    wavelengths: Wavelengths = None,
    png: Annotated[Path | None, typer.Option(help="Write both in true colour, with a zoom, to this PNG.")] = None,
    as_json: AsJson = False,
) -> None:
    """Compare two datacubes: PSNR, mean spectral RMS error, SSIM and spectral angle.

    Example: shadowgram compare cube.nc scene.nc --png both.png
    """
    from shadowgram.experiments.quality import assess

    if png is not None:
        output.check_output(png, (".png",), inputs=[estimate, truth])
    a, b = (read_cube(path, wavelengths=wavelengths) for path in (estimate, truth))
    if a.shape != b.shape:
        raise ValueError(f"the cubes must have one shape (band, y, x); {estimate} has {a.shape}, {truth} has {b.shape}")
    with output.progress("comparing"):
        quality = assess(a.values, b.values, peak)
    if png is not None:
        output.write_bytes(png, side_by_side({truth.name: b, estimate.name: a}, f"PSNR {quality.psnr:.1f} dB"))
    output.report(dataclasses.asdict(quality), quality_lines(quality), as_json)


def _native_contents(file: Path) -> dict[str, object] | None:
    """What a measurement, a code or a scan says of itself; None for anything else."""
    from shadowgram.scenes.readers.native import read_dataset

    dataset = read_dataset(file)
    kind = dataset.attrs.get("kind")
    if kind == "measurement":
        from shadowgram.measurement import imager_to_json, read_measurement

        m = read_measurement(file)
        shape = m.imager.resolution.cube_shape
        return {
            "kind": kind,
            "imager": json.loads(imager_to_json(m.imager)),
            "code": list(m.code.shape),
            "snapshots": list(m.snapshots.shape),
            "range": [float(m.snapshots.min()), float(m.snapshots.max())],
            "noise": None if m.noise is None else dataclasses.asdict(m.noise),
            "scene": m.scene,
            "datacube": list(shape),
            "compression": m.snapshots.size / (shape[0] * shape[1] * shape[2]),
        }
    if kind == "code" and "code" in dataset.data_vars:
        code = dataset["code"].values
        return {"kind": kind, "shape": list(code.shape), "dtype": str(code.dtype), "open": float(code.mean())}
    if kind in ("xray-scan", "xray-pencil-scan"):
        from shadowgram.xray.scan_file import read_pencil_map, read_scan

        found = read_scan(file) if kind == "xray-scan" else read_pencil_map(file)
        counts = found.counts
        values = {"kind": kind, "shape": list(counts.shape), "range": [float(counts.min()), float(counts.max())]}
        settings = ("route", "noisy", "photons_per_shot", "exposure", "photons", "seed")
        return values | {"mean": float(counts.mean())} | {n: getattr(found, n) for n in settings if hasattr(found, n)}
    if kind == "xray-image" and "image" in dataset.data_vars:
        image, shots = dataset["image"].values, dataset.sizes.get("shot")
        said = ("verdict", "p_value", "pedestal", "chi_square")
        values = {"kind": kind, "shape": list(image.shape), "range": [float(image.min()), float(image.max())]}
        return values | {"shots": shots} | {name: dataset.attrs[name] for name in said if name in dataset.attrs}
    return None


def _frames_contents(folder: Path) -> dict[str, object] | None:
    """What a folder of camera frames holds; None where nothing in it describes them."""
    from shadowgram.scenes import read_frames
    from shadowgram.scenes.readers.capture_notes import NAMES

    if not any((folder / name).is_file() for name in NAMES):
        return None
    frames = read_frames(folder)
    return {
        "kind": "frames",
        "shape": list(frames.snapshots.shape),
        "exposures_s": frames.exposures.tolist(),
        "range_per_s": [float(frames.snapshots.min()), float(frames.snapshots.max())],
        "saturated": int(frames.saturated.sum()),
    }


def _check_cube_path(out: Path, source: Path) -> None:
    """Refuse a path for a cube that cannot be written, or that would replace what is read, before any work is done."""
    if not out.suffix and out.name:
        if out.exists():
            raise ValueError(f"{out} is there already; a folder of PNG pictures must be new")
        output.check_folder(out.parent)
        return
    output.check_result(out, (".nc", ".mat", ".npz", ".npy", ".hdr", ".tif", ".tiff"), inputs=[source])
    if out.suffix.lower() == ".hdr":
        output.check_output(out.with_suffix(".dat"), (".dat",), inputs=[source])


def _cube_contents(cube: xr.DataArray) -> dict[str, object]:
    nm = cube.wavelength.values
    return {
        "kind": "datacube",
        "name": cube.name,
        "shape": list(cube.shape),
        "wavelengths_nm": [float(nm[0]), float(nm[-1])],
        "dtype": str(cube.dtype),
        "range": [float(cube.min()), float(cube.max())],
        "mean": float(cube.mean()),
    }


def _size_line(cube: xr.DataArray) -> str:
    bands, ny, nx = cube.shape
    return f"{bands} bands × {ny} × {nx} (y × x), {float(cube.wavelength[0]):g} to {float(cube.wavelength[-1]):g} nm"


def _shown(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {_shown(part)}" for name, part in value.items() if part is not None)
    if isinstance(value, list) and value and isinstance(value[0], list):  # pairs, as of a dispersion curve
        return ", ".join(": ".join(_shown(part) for part in pair) for pair in value)
    if isinstance(value, list) and len(value) > 3:
        return f"{len(value)} values, {_shown(value[0])} to {_shown(value[-1])}"
    if isinstance(value, list):
        return (" to " if any(isinstance(v, float) for v in value) else " × ").join(_shown(v) for v in value)
    if isinstance(value, float):
        return f"{value:.5g}"
    return "none" if value is None else str(value)
