"""`shadowgram codes analyse`."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from . import code_imager, output
from .arguments import read_code
from .code_imager import Geometry, Kind, make_imager

if TYPE_CHECKING:
    import numpy as np

    from shadowgram.operators.base import LinearOperator
    from shadowgram.operators.sensing import Coherence

    from .code_imager import Camera

EDGES = (0.125, 0.25)  # cycles/element, between which powers are added up
VOXELS = 100_000  # of a part of the imager that is worked on column by column
COLUMNS = 6_000  # of the sensing matrix that are made one by one
WINDOW = 3  # pixels
MOST_GROUPS = 50
SPARSITY, TRIALS = 50, 20
SIDE = 8  # elements that a sub-region of a spectrum should have, each way
ZERO = 1e-9  # of the largest singular value


def analyse(
    file: Annotated[Path, typer.Argument(metavar="CODE", help="Code: .nc, .npy or .png.", show_default=False)],
    imager: Annotated[Kind | None, typer.Option(help="Imager whose sensing matrix is analysed, too.")] = None,
    detector_shape: Annotated[
        str | None,
        typer.Option(
            help="SSCSI: detector elements y x x; CASSIs: pixels of the scene.", show_default="what the code covers"
        ),
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
    blocks: Annotated[int, typer.Option(help="Sub-regions over which the spectrum is averaged, a square number.")] = 16,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the places and supports that are tried.")] = 0,
    png: Annotated[Path | None, typer.Option(help="Show the code and what was found in this PNG.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Say what a code is like: its light, its spectrum, its clusters, and how well an imager senses scenes with it.

    Example: shadowgram codes analyse code.nc --bands 24 --png sheet.png

    The imager is the one of the options, an SSCSI if they do not say which; without any, that for which the code was designed.

    The JSON has transmittance (of each shot), open_shots (in how many an element is open: least, mean, most, and the share open in
    exactly one), spectrum (shares of power over frequencies along x, along y and in the plane, beside those of a flat spectrum, and
    the noise's colour), runs (of open elements along x, and what chance gives; null for gray codes) and sensing (null without an
    imager): imager, voxels (shares sensed never, partly, once, repeatedly), gram_deviation, isometry, coherence and
    singular_values. What is too large to compute is null.
    """
    if png is not None:
        output.check_output(png, (".png",), inputs=[file])
    options = Geometry(
        kind=imager, detector_shape=detector_shape, detector_pitch=detector_pitch, code_pitch=code_pitch,
        mask_position=mask_position, bands=bands, wavelengths=wavelengths, dispersion_ratio=dispersion_ratio,
        shear=shear, band_shift=band_shift, dispersion=dispersion, bench=bench,
    )  # fmt: skip
    code = _checked(read_code(file), file)
    camera = make_imager(options, code.shape[1:]) if options.given() else _designed_for(file)
    H = None if camera is None else camera.operator(code)
    pattern = _pattern(code, blocks)
    with output.progress("analysing"):
        sensing, curves = (None, {}) if camera is None or H is None else _sensing(camera, code, H, seed)
    if png is not None:
        write_sheet(png, code, file.name, blocks=blocks, **curves)
    values = {"file": file, "shape": list(code.shape), **pattern, "sensing": sensing}
    output.report(values, _lines(values), as_json)


def write_sheet(
    png: Path,
    code: np.ndarray,
    title: str,
    *,
    blocks: int | None = None,
    likeness: np.ndarray | None = None,
    singular_values: np.ndarray | None = None,
) -> None:
    """Write the sheet of a code, of the middle band of a colored one; parameters as of `figures.codes.sensing_sheet`."""
    from shadowgram.figures import style
    from shadowgram.figures.codes import sensing_sheet

    if code.ndim == 4:
        band = code.shape[1] // 2
        title, code = f"{title}, band {band + 1} of {code.shape[1]}", code[:, band]
    if blocks is None:
        blocks = max(1, min(4, min(code.shape[1:]) // SIDE)) ** 2
    with style.style():
        drawn = sensing_sheet(code, title=title, blocks=blocks, likeness=likeness, singular_values=singular_values)
        output.write_bytes(png, style.png(drawn))


def _checked(code: np.ndarray, file: Path) -> np.ndarray:
    from shadowgram.codes import check_code

    if code.ndim == 2:
        code = code[None]
    if code.ndim not in (3, 4):
        raise ValueError(f"{file} must hold a code (shot, y, x) or (shot, band, y, x), got the shape {code.shape}")
    return check_code(code, code.shape[1:])


def _designed_for(file: Path) -> Camera | None:
    """Imager that the file says the code was designed for."""
    from shadowgram.measurement import imager_from_json
    from shadowgram.scenes.readers.native import read_dataset
    from shadowgram.spectral.calibration import CalibratedImager

    described = read_dataset(file).attrs.get("imager") if file.suffix.lower() == ".nc" else None
    if not isinstance(described, str):
        return None
    camera = imager_from_json(described)
    return None if isinstance(camera, CalibratedImager) else camera


def _pattern(code: np.ndarray, blocks: int) -> dict[str, Any]:
    """Light, spectrum and runs; bands of a colored code count as shots do."""
    import numpy as np

    from shadowgram.codes import analysis

    opened = code.sum(axis=0, dtype=np.float64)
    flat = code.reshape(-1, *code.shape[-2:])
    once = np.abs(opened - 1) < 1e-6
    # The last of complementary shots follows from the others, and filters make bands alike.
    shots = len(code) - 1 if len(code) > 1 and once.all() else len(code)
    elements = shots * flat[0].size
    density = analysis.bartlett(flat, blocks)
    spectra = {"x": density.mean(axis=0), "y": density.mean(axis=1), "plane": density}
    runs = None
    if flat.dtype == np.uint8:
        found = analysis.clusters(flat)
        runs = {
            "mean": found.mean_run,
            "per_row": found.runs_per_row,
            "chance_mean": found.chance_mean_run,
            "chance_per_row": found.chance_runs_per_row,
            "clustering": found.clustering,
        }
    return {
        "transmittance": code.reshape(len(code), -1).mean(axis=1).tolist(),
        "open_shots": {
            "least": float(opened.min()),
            "mean": float(opened.mean()),
            "most": float(opened.max()),
            "once": float(once.mean()),
        },
        "spectrum": {name: _powers(spectrum, elements) for name, spectrum in spectra.items()},
        "runs": runs,
    }


def _powers(spectrum: np.ndarray, elements: int) -> dict[str, object]:
    import numpy as np

    from shadowgram.codes.analysis import band_power, noise_colour

    ranges = ((0.0, EDGES[0]), EDGES, (EDGES[1], 1.0))
    return {
        "power": [band_power(spectrum, *limits) for limits in ranges],
        "flat": [band_power(np.ones_like(spectrum), *limits) for limits in ranges],
        "noise": noise_colour(spectrum, elements=elements),
    }


def _sensing(
    camera: Camera, code: np.ndarray, H: LinearOperator, seed: int
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Statistics of the sensing matrix, and those that are drawn."""
    import scipy.linalg  # noqa: F401 - the limit holds only for libraries that are loaded
    import threadpoolctl

    from shadowgram.measurement import imager_to_json
    from shadowgram.operators import basis, sensing

    with threadpoolctl.threadpool_limits(1):
        found = sensing.sensed(H)
        part = _rows(camera, code, max(WINDOW, VOXELS // (H.in_shape[0] * H.in_shape[2] * _rows_each(camera))))
        few = sensing.isometry(
            part,
            basis=basis("dct-sym8", part.in_shape),
            sparsity=min(SPARSITY, math.prod(part.in_shape)),
            trials=TRIALS,
            seed=seed,
        )
        coherence, spectrum = _one_row(_rows(camera, code, 1))
        values = {
            "imager": json.loads(imager_to_json(camera)),
            "voxels": {name: getattr(found, name) for name in ("never", "partly", "once", "repeatedly")},
            "gram_deviation": _gram(part, seed),
            "isometry": {
                "sparsity": few.sparsity,
                "trials": TRIALS,
                "mean": float(few.deviations.mean()),
                "largest": few.lower_bound,
            },
            "coherence": None if coherence is None else _coherence(coherence),
            "singular_values": None if spectrum is None else _spectrum(spectrum),
        }
    curves = {"likeness": None if coherence is None else coherence.histogram, "singular_values": spectrum}
    return values, {name: curve for name, curve in curves.items() if curve is not None}


def _rows_each(camera: Camera) -> int:
    """Code rows a detector row."""
    return getattr(camera, "pitch_ratio", 1)


def _rows(camera: Camera, code: np.ndarray, count: int) -> LinearOperator:
    """Forward model of the middle detector rows; rows share no light."""
    from shadowgram.spectral.sscsi import SSCSI

    each = _rows_each(camera)
    rows = code.shape[-2] // each
    count = min(count, rows)
    first = (rows - count) // 2
    if isinstance(camera, SSCSI):
        part = dataclasses.replace(camera, detector_shape=(count, camera.detector_shape[1]))
    else:
        bands, _, columns = camera.cube_shape
        part = dataclasses.replace(camera, cube_shape=(bands, count, columns))
    return part.operator(code[..., first * each : (first + count) * each, :])


def _gram(H: LinearOperator, seed: int) -> dict[str, Any]:
    from shadowgram.operators.sensing import gram_deviation, pixel_groups

    bands, ny, nx = H.in_shape
    window = (min(WINDOW, ny), min(WINDOW, nx))
    count = max(2, min(MOST_GROUPS, COLUMNS // (bands * window[0] * window[1])))
    deviations = gram_deviation(H, pixel_groups((bands, ny, nx), count=count, window=window, seed=seed))
    return {
        "window": list(window),
        "groups": count,
        "mean": float(deviations.mean()),
        "deviation": float(deviations.std()),
        "largest": float(deviations.max()),
    }


def _one_row(H: LinearOperator) -> tuple[Coherence | None, np.ndarray | None]:
    """Coherence and singular values of a detector row, where its matrix is small enough."""
    from shadowgram.operators import sensing

    rows, columns = math.prod(H.out_shape), math.prod(H.in_shape)
    fits = rows * columns <= sensing.MOST_NUMBERS
    return (
        sensing.coherence(H) if fits and columns <= sensing.MOST_COLUMNS else None,
        sensing.singular_values(H) if fits and min(rows, columns) <= sensing.MOST_VALUES else None,
    )


def _coherence(found: Coherence) -> dict[str, Any]:
    return {
        "rms": found.rms,
        "median": found.quantile(0.5),
        "quantile_90": found.quantile(0.9),
        "quantile_99": found.quantile(0.99),
        "mutual": found.mutual,
        "pairs": found.pairs,
        "unsensed": found.unsensed,
    }


def _spectrum(values: np.ndarray) -> dict[str, Any]:
    kept = values[values > ZERO * values[0]]
    return {
        "count": values.size,
        "zero": values.size - kept.size,
        "largest": float(values[0]),
        "median": float(values[values.size // 2]),
        "smallest": float(kept[-1]) if kept.size else 0.0,
    }


def _lines(values: Mapping[str, Any]) -> list[str]:
    shown = " × ".join(map(str, values["shape"]))
    axes = "shots × y × x" if len(values["shape"]) == 3 else "shots × bands × y × x"
    light, opened = values["transmittance"], values["open_shots"]
    low, high = (f"{100 * share:.3g}" for share in (min(light), max(light)))
    lines = [
        f"code          {shown} ({axes})",
        f"light         {low if low == high else f'{low} to {high}'} % of the elements are open in a shot",
        f"elements      {_counts(opened)}",
        "",
        *_spectrum_lines(values["spectrum"]),
        "",
    ]
    if runs := values["runs"]:
        lines.append(
            f"runs along x  {runs['mean']:.3g} elements long, by chance {runs['chance_mean']:.3g};"
            f" {runs['per_row']:.4g} in a row, by chance {runs['chance_per_row']:.4g}"
        )
    return lines if values["sensing"] is None else [*lines, *_sensing_lines(values["sensing"])]


def _spectrum_lines(spectra: Mapping[str, Any]) -> list[str]:
    head = [f"0 to {EDGES[0]:g}", f"to {EDGES[1]:g}", "higher", "noise"]
    lines = [f"{'share of power at cycles/element':<32}" + "".join(f"{text:>12}" for text in head)]
    names = {"x": "along x, mean over rows", "y": "along y, mean over columns", "plane": "in the plane"}
    for name, text in names.items():
        found = spectra[name]
        lines.append(f"  {text:<30}{_row(found['power'])}{found['noise']:>12}")
    for name, text in {"x": "without order, along an axis", "plane": "without order, in the plane"}.items():
        lines.append(f"  {text:<30}{_row(spectra[name]['flat'])}")
    return lines


def _row(powers: Sequence[float]) -> str:
    return "".join(f"{100 * power:10.1f} %" for power in powers)


def _sensing_lines(found: Mapping[str, Any]) -> list[str]:
    voxels, gram, few = found["voxels"], found["gram_deviation"], found["isometry"]
    shares = ", ".join(f"{_percent(share)} {name}" for name, share in voxels.items())
    window = " × ".join(map(str, gram["window"]))
    lines = [
        f"imager        {found['imager']['type']}",
        f"voxels        sensed {shares}",
        f"‖HᵀH − I‖     {gram['mean']:.4g} ± {gram['deviation']:.2g} over all bands of {window} pixels ({gram['groups']} places)",
        f"isometry      {few['mean']:.3g}, at most {few['largest']:.3g}, of {few['sparsity']} coefficients ({few['trials']} draws)",
    ]
    if pairs := found["coherence"]:
        lines.append(
            f"coherence     rms {pairs['rms']:.3g}, median {pairs['median']:.3g}, 99 % below {pairs['quantile_99']:.3g},"
            f" of {pairs['pairs']} voxel pairs of a row"
        )
    if spectrum := found["singular_values"]:
        zero = f"; {spectrum['zero']} of {spectrum['count']} are 0" if spectrum["zero"] else ""
        lines.append(
            f"singular      {spectrum['largest']:.3g} to {spectrum['smallest']:.2g}, median {spectrum['median']:.3g}{zero}"
        )
    missing = [name.replace("_", " ") for name in ("coherence", "singular_values") if found[name] is None]
    return [*lines, *([f"not computed  {' and '.join(missing)}: a detector row is too large"] if missing else [])]


def _counts(opened: Mapping[str, float]) -> str:
    if opened["once"] == 1:
        return "every one is open in one shot"
    low, high, once = opened["least"], opened["most"], _percent(opened["once"])
    return f"open in {low:g} to {high:g} shots, {opened['mean']:.3g} on average; {once} in exactly one"


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"
