"""Real captures of a single-disperser CASSI, reconstructed whole: with the mask as it was measured, and with the model put right.

Three captures of 660 × 714 pixels, 28 bands two pixels apart, one gray mask (Meng, Ma and Yuan, ECCV 2020). There is no truth; what
can be asked is how well pixels are predicted that a reconstruction was not given, whether what it leaves looks like noise, and what
the pictures show. The data are not ours, and not shipped: name their folder with ``--data``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

import shadowgram as sg
from shadowgram.experiments import data_folder
from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study
from shadowgram.solvers._parts import Weighted

from . import _common as common

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Curves, Panel, Picture
    from shadowgram.operators.base import LinearOperator

ORIGIN = "github.com/mengziyi64/TSA-Net"
FILES = {
    "mask": "d1a1a6e2e8a2f37b", "scene1": "0d2ab5d6a3facb51", "scene3": "8c802f023a46dbbb", "scene4": "5f6c896cdfdfe72a",
}  # fmt: skip
"""Data and their digests."""
WAVELENGTHS = (
    453.5, 457.5, 462.0, 466.0, 471.5, 476.5, 481.5, 487.0, 492.5, 498.0, 504.0, 510.0, 516.0, 522.5, 529.5, 536.5, 544.0, 551.5,
    558.5, 567.5, 575.5, 584.5, 594.5, 604.0, 614.5, 625.0, 636.5, 648.0,
)  # fmt: skip
SCENES = {1: "plant of bricks", 3: "man of bricks", 4: "plants"}
WAYS = ("given", "dark level", "corrected")
"""As captured, with the mask as measured; dark level subtracted; mask moved and blurred too."""
HELD_OUT = 0.05  # share of the pixels
LAGS = 12  # px
POINTS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """One scene, the rows of it that are reconstructed, and for how long."""

    scene: int
    rows: tuple[int, int]
    iterations: int


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """All scenes whole, or a part of one."""
    if quick:
        return [Spec(scene=3, rows=(360, 424), iterations=25)]
    return [Spec(scene=number, rows=(0, 660), iterations=300) for number in SCENES]


def read(name: str) -> np.ndarray:
    """One of the arrays."""
    return sg.scenes.read_array(data_folder.find(f"tsa_real/{name}.mat", FILES[name], ORIGIN))


def camera(rows: int) -> sg.CASSI:
    """The camera, with this many rows."""
    return sg.CASSI(cube_shape=(len(WAVELENGTHS), rows, 660), band_centres=WAVELENGTHS, band_shift=2)


def run(spec: Spec, _scene: SceneSource) -> Result:
    """Estimate the mismatch, and reconstruct in each of the ways."""
    rows = slice(*spec.rows)
    mask, shot = read("mask")[rows], read(f"scene{spec.scene}")[rows][None].astype(np.float32)
    imager = camera(len(mask))
    findings = sg.spectral.check_capture(imager, mask, shot)
    found = sg.spectral.estimate_mismatch(imager, mask, shot)
    kept = (np.random.default_rng(0).random(shot.shape) > HELD_OUT).astype(np.float32)
    given = imager.operator(mask)
    problems = {"given": (given, shot), "dark level": (given, shot - found.offsets[:, None, None].astype(np.float32))}
    problems["corrected"] = found.operator, found.snapshots
    solved = {way: _reconstructed(H, y, kept, spec.iterations) for way, (H, y) in problems.items()}
    cubes = {way: one[0] for way, one in solved.items()}
    exposure = common.exposure_of(cubes["corrected"], WAVELENGTHS)
    points = common.vivid_points(cubes["corrected"], POINTS)
    rest = solved["corrected"][1]
    values = {
        "findings": [str(finding) for finding in findings], "dy": found.dy, "dy_error": found.dy_error, "dx": found.dx,
        "dx_error": found.dx_error, "dispersion": found.dispersion, "dispersion_error": found.dispersion_error,
        "blur": list(found.blur), "blur_errors": list(found.blur_errors), "dark": float(found.offsets[0]),
        "dark_error": float(found.offset_errors[0]),
        "held_out": {way: _error(one[1], kept == 0) for way, one in solved.items()},
        "fitted": {way: _error(one[1], kept == 1) for way, one in solved.items()},
        "points": [list(map(int, point)) for point in points], **_residual(rest, problems["corrected"][1]),
    }  # fmt: skip
    pictures = {f"rgb {way}": common.colours(cube, WAVELENGTHS, exposure) for way, cube in cubes.items()}
    spectra = {f"spectra {way}": np.stack([cube[:, y, x] for y, x in points]) for way, cube in cubes.items()}
    return Result(values=values, arrays={**pictures, **spectra, "capture": shot[0], "rest": rest[0].astype(np.float32)})


def _reconstructed(
    H: LinearOperator, y: np.ndarray, kept: np.ndarray, iterations: int
) -> tuple[np.ndarray, np.ndarray]:
    """Cube from the kept pixels, and what it leaves of all."""
    cube = sg.solve(sg.EigenTV(max_iter=iterations), Weighted(H, kept), y * kept).x
    return cube, y - H.forward(cube)


def _error(rest: np.ndarray, where: np.ndarray) -> float:
    return float(np.sqrt(np.square(rest[where], dtype=np.float64).mean()))


def _residual(rest: np.ndarray, y: np.ndarray) -> dict[str, float | list[float]]:
    """Residual of the dark half and of the brightest tenth, and its correlation with its neighbours along x and y."""
    dark, bright = y <= np.median(y), y >= np.quantile(y, 0.9)
    steps = np.diff(y[0], axis=1)[:, ::2][dark[0][:, 1::2][:, : y.shape[2] // 2]]
    # Neighbours in the dark differ by noise alone, twice its variance.
    noise = float(np.median(np.abs(steps))) / 0.6745 / np.sqrt(2)
    white = rest[0] / np.sqrt(np.square(noise) + np.square(rest[0]).mean())
    return {
        "noise": noise,
        "rest_dark": float(np.median(np.abs(rest[dark]))) / 0.6745,
        "rest_bright": float(np.median(np.abs(rest[bright]))) / 0.6745,
        "light_bright": float(y[bright].mean()),
        "correlation_x": [_correlation(white[:, lag:], white[:, : white.shape[1] - lag]) for lag in range(1, LAGS)],
        "correlation_y": [_correlation(white[lag:], white[: white.shape[0] - lag]) for lag in range(1, LAGS)],
    }


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def figure(records: Sequence[Record]) -> Figure:
    """For each scene: the capture and the pictures; spectra, residual and its correlation."""
    from shadowgram.figures.sheet import sheet

    rows: list[Sequence[Panel | None]] = []
    for record in records:
        rows += [_pictures(record), [_spectra(record), _rest(record), _whiteness(record)]]
    return sheet("Real captures: 28 bands from one shot, with the mask as measured and with the model put right", rows)


def _pictures(record: Record) -> list[Panel | None]:
    from shadowgram.figures.images import Point
    from shadowgram.figures.sheet import Picture

    capture = record.arrays["capture"]
    marks = [Point(str(n + 1), y, x) for n, (y, x) in enumerate(record.values["points"])]
    held_out = record.values["held_out"]
    shown: list[Panel | None] = [
        Picture(
            title=f"{SCENES[record.spec['scene']]}: capture",
            picture=np.clip(capture / np.quantile(capture, 0.995), 0, 1),
        )
    ]
    for way in ("given", "corrected"):
        caption = f"held-out error {held_out[way]:.5f}"
        points = marks if way == "corrected" else ()
        shown.append(Picture(title=way, picture=record.arrays[f"rgb {way}"] / 255, caption=caption, points=points))
    return shown


def _spectra(record: Record) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    curves = {}
    for n, spectrum in enumerate(record.arrays["spectra corrected"]):
        curves[f"{n + 1}"] = Curve(x=WAVELENGTHS, y=spectrum, colour=n)
        curves[f"_{n + 1} given"] = Curve(x=WAVELENGTHS, y=record.arrays["spectra given"][n], colour=n, dash=1)
    return Curves(
        title="spectra (dashed: as given)", xlabel="wavelength (nm)", ylabel="light and response", curves=curves
    )


def _rest(record: Record) -> Picture:
    from shadowgram.figures.sheet import Picture

    rest, noise = record.arrays["rest"], record.values["noise"]
    return Picture(
        title="residual",
        picture=np.clip(rest / (10 * noise) + 0.5, 0, 1),
        caption="black to white: ±5 noise of the dark",
    )


def _whiteness(record: Record) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    lags = list(range(1, LAGS))
    curves = {
        axis: Curve(x=lags, y=record.values[f"correlation_{axis}"], colour=n) for n, axis in enumerate(("x", "y"))
    }
    return Curves(title="residual: correlation", xlabel="lag (px)", ylabel="coefficient", curves=curves)


def claims(records: Sequence[Record]) -> list[Claim]:
    """What the captures say; there is no truth to compare with."""
    return [_seen(records), _fits(records), _dark(records), _white(records)]


def _each(records: Sequence[Record], text: str) -> str:
    """A text for each scene, with its values by name."""
    return "; ".join(f"scene {r.spec['scene']}: " + text.format(**r.values) for r in records)


def _seen(records: Sequence[Record]) -> Claim:
    sure = all(abs(r.values["dy"]) > 3 * r.values["dy_error"] for r in records)
    where = _each(records, "{dy:+.2f} ± {dy_error:.2f} px down, {dx:+.2f} ± {dx_error:.2f} px right")
    more = _each(
        records, "dispersion × {dispersion:.4f} ± {dispersion_error:.4f}, blur {blur[0]:.2f} × {blur[1]:.2f} px²"
    )
    return Claim(
        page=None, says="is the mask where it was measured?",
        found=f"{'no' if sure else 'not surely'}; {where}. Beside that, {more}", agrees=None,
    )  # fmt: skip


def _fits(records: Sequence[Record]) -> Claim:
    parts = []
    for r in records:
        errors = r.values["held_out"]
        better = 100 * (1 - errors["corrected"] / errors["given"])
        parts.append(
            f"scene {r.spec['scene']}: "
            + ", ".join(f"{errors[way]:.5f} {way}" for way in WAYS)
            + f", {better:.0f} % less"
        )
    return Claim(
        page=None, says="does the corrected model predict pixels better that the reconstruction was not given (root mean square)?",
        found="; ".join(parts), agrees=None,
    )  # fmt: skip


def _dark(records: Sequence[Record]) -> Claim:
    return Claim(
        page=None, says="is zero dark?",
        found=_each(records, "the dark level is {dark:.4f} ± {dark_error:.4f}, which without correction is a grey haze"),
        agrees=None,
    )  # fmt: skip


def _white(records: Sequence[Record]) -> Claim:
    parts = []
    for r in records:
        v = r.values
        largest = max(map(abs, (*v["correlation_x"], *v["correlation_y"])))
        parts.append(
            f"scene {r.spec['scene']}: in the dark half {v['rest_dark']:.5f}, where neighbours differ as if the noise were"
            f" {v['noise']:.5f}; in the brightest tenth {100 * v['rest_bright'] / v['light_bright']:.1f} % of the light;"
            f" the largest correlation with a neighbour is {largest:.2f}"
        )
    return Claim(
        page=None, says="is what the reconstruction leaves at the level of the noise, and white?",
        found="; ".join(parts), agrees=None,
    )  # fmt: skip


STUDY = Study(
    name="tsa-real",
    title="Real captures of a single-disperser CASSI, reconstructed whole",
    source="three captures of Meng, Ma and Yuan, ECCV 2020",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
    data=ORIGIN,
)
