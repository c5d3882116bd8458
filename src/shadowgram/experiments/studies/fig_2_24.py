"""A scene from two shots of the calibrated bench, over the position of the mask: Figs. 2.24 to 2.26, sections 2.5.2 and 2.5.3.

The source calibrates its bench with a white board, one band and shot at a time, records a scene through two complementary codes at
s ≈ 0, 0.004 and 0.0078, and shows its colours, single bands and three spectra. It sees more spectral information as s grows, and
more artefacts, which it explains by the finite aperture. How many bands it recovers, and the f-number, are not said.

Here the bench stands in the computer, with 8 bands for every s (17.5 nm each, or less for a scene that does not cover 480 to
620 nm), before a finely resolved scene; s ≈ 0 is 10⁻⁴, since exactly 0 is the border of the regimes. Aperture, noise and faults of
the sensor are as in `_bench`. The operator is assembled from captures of a white board, as in the source; and, to see what that
gains, from the code as it was designed, with the mask where it is and with the mask taken to be a column beside it.

What agrees: spectra come with s, and the errors that a finite aperture adds grow with s, so that at f/32 spectra are best at about
s = 0.004. With a calibrated operator these errors are small; the designed code, which the aperture blurs, is of no use. What does
not agree: this near the detector hardly any light misses the mask.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from shadowgram import codes
from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study

from . import _bench as lab
from . import _common as common

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.images import Point, Zoom
    from shadowgram.figures.sheet import Curves, Picture
    from shadowgram.operators import LinearOperator
    from shadowgram.spectral.sscsi import SSCSI

SHOTS = 2
POINTS = ("T5", "T6", "T7")
SOURCE_POSITIONS = (1e-4, 0.004, 0.0078)
CALIBRATED, DESIGNED, BESIDE = "calibrated", "designed", "beside"
"""Where the operator comes from: white captures, the designed code, the same a column off."""
SHOWN = 32.0  # f-number of the pictures


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """One position of the mask and aperture; `mask_position` is that of the whole bench, whatever `size`."""

    mask_position: float
    f_number: float | None
    size: int
    bands: int
    sub_bands: int
    seed: int


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """The source's positions, and some more for the curves; the ideal aperture (None) and finite ones."""
    positions = SOURCE_POSITIONS if quick else (1e-4, 0.002, 0.004, 0.0078, 0.011)
    size, sub_bands = (64, 4) if quick else (256, 8)
    return [
        Spec(mask_position=s, f_number=n, size=size, bands=8, sub_bands=sub_bands, seed=0)
        for n in ((None, SHOWN) if quick else (None, 160.0, 64.0, SHOWN))
        for s in positions
    ]


def _models(session: lab.Session, imager: SSCSI, code: np.ndarray) -> dict[str, tuple[LinearOperator, np.ndarray]]:
    """Operators, each with the snapshots in its units."""
    plain = session.snapshots / np.float32(session.level)
    return {
        CALIBRATED: (session.calibration.operator, session.snapshots),
        DESIGNED: (common.stored_operator(imager, code), plain),
        BESIDE: (common.stored_operator(imager, np.roll(code, 1, axis=2)), plain),
    }


def run(spec: Spec, scene: SceneSource) -> Result:
    """Calibrate, record and reconstruct: EigenTV with every operator, GPSR with the calibrated one."""
    bench = lab.bench_of(spec.size, spec.f_number, lab.range_of(scene))
    imager = replace(bench.imager(lab.like(spec.mask_position, spec.size)), bands=spec.bands)
    code = codes.boolean(shots=SHOTS, shape=imager.code_shape, seed=spec.seed)
    session = lab.record(scene, imager, code, pupil=bench.pupil, bands=spec.bands * spec.sub_bands, seed=spec.seed)
    models = _models(session, imager, code)
    estimates = {name: common.reconstruct("eigen-tv", *model, session.truth) for name, model in models.items()}
    estimates["gpsr"] = common.reconstruct("gpsr", *models[CALIBRATED], session.truth)
    values: dict[str, object] = {name: estimate.values for name, estimate in estimates.items()}
    arrays: dict[str, np.ndarray] = {}
    if spec.mask_position in SOURCE_POSITIONS:  # the others are for curves
        points = _points(session.truth)
        arrays = _shown(session.truth, estimates, imager, points)
        values["points"] = points
    return Result(values=values | _facts(session, imager), arrays=arrays)


def _points(truth: np.ndarray) -> list[tuple[int, int]]:
    """Vivid pixels, of colours that differ most."""
    candidates = common.vivid_points(truth, 2 * len(POINTS))
    spectra = np.array([truth[:, y, x] / np.linalg.norm(truth[:, y, x]) for y, x in candidates], float)
    chosen = [0]
    while len(chosen) < len(POINTS):
        alike = (spectra @ spectra[chosen].T).max(axis=1)
        chosen.append(int(alike.argmin()))
    return [candidates[k] for k in chosen]


def _facts(session: lab.Session, imager: SSCSI) -> dict[str, object]:
    """What the geometry says."""
    return {
        "blur": session.blur,
        "columns": imager.spectral_columns,
        "dispersion_ratio": imager.dispersion_ratio,
        "vignetted": list(imager.resolution.vignetted),
        "resolved": imager.code_pitch / (imager.mask_position * imager.dispersion),
    }


def _shown(
    truth: np.ndarray, estimates: Mapping[str, common.Estimate], imager: SSCSI, points: Sequence[tuple[int, int]]
) -> dict[str, np.ndarray]:
    """Colours, bands thinned out, and spectra."""
    wavelengths = imager.resolution.wavelengths
    exposure, brightest = common.exposure_of(truth, wavelengths), np.quantile(truth, 0.998)
    step = max(1, truth.shape[1] // 128)
    arrays = {"wavelengths": wavelengths}
    for name, cube in {"truth": truth, **{name: e.x for name, e in estimates.items()}}.items():
        arrays[f"{name}_spectra"] = np.array([cube[:, y, x] for y, x in points], np.float32)
        arrays[f"{name}_picture"] = common.colours(cube, wavelengths, exposure)
        if name in ("truth", CALIBRATED):
            grey = np.clip(cube[:, ::step, ::step] / brightest, 0, 1) ** (1 / 2.2)
            arrays[f"{name}_bands"] = np.rint(255 * grey).astype(np.uint8)
    return arrays


def figure(records: Sequence[Record]) -> Figure:
    """Quality over s; colours and details; single bands; spectra."""
    from shadowgram.figures.images import Point
    from shadowgram.figures.sheet import sheet

    shown = [common.only(records, mask_position=s, f_number=SHOWN) for s in SOURCE_POSITIONS]
    points = [Point(label, y, x) for label, (y, x) in zip(POINTS, shown[0].values["points"], strict=True)]
    zoom = _colourful_part(shown[0].arrays["truth_picture"])
    return sheet(
        "A scene from two shots of the calibrated bench (Figs. 2.24 to 2.26)",
        [
            _quality(records),
            *_pictures(shown, points, zoom),
            _other_ways(records),
            [_bands(shown)],
            _spectra(shown),
        ],
    )


def _colourful_part(picture: np.ndarray) -> Zoom:
    """The part, a quarter of the side, in which the colours change most."""
    from scipy.ndimage import uniform_filter

    from shadowgram.figures.images import Zoom

    side = len(picture) // 4
    colour = picture.astype(float) - picture.mean(axis=2, keepdims=True)
    change = np.abs(np.diff(colour, axis=1, append=colour[:, -1:])) + np.abs(
        np.diff(colour, axis=0, append=colour[-1:])
    )
    score = uniform_filter(change.sum(axis=2), side)[side // 2 : side // 2 - side, side // 2 : side // 2 - side]
    y, x = np.unravel_index(int(score.argmax()), score.shape)
    return Zoom(int(y), int(x), side)


def _apertures(records: Sequence[Record]) -> list[float | None]:
    """Ideal, then from small to large."""
    return [None, *sorted({r.spec["f_number"] for r in records} - {None}, reverse=True)]


def _over_s(records: Sequence[Record], f_number: float | None, way: str, measure: str) -> dict[float, float]:
    """s → a measure of quality."""
    chosen = sorted(common.chosen(records, f_number=f_number), key=lambda r: r.spec["mask_position"])
    return {r.spec["mask_position"]: r.values[way][measure] for r in chosen}


def _quality(records: Sequence[Record]) -> list[Curves]:
    from shadowgram.figures.sheet import Curve, Curves

    def panel(title: str, unit: str, ways: Sequence[str], measure: str) -> Curves:
        curves = {}
        for dash, way in enumerate(ways):
            for number, n in enumerate(_apertures(records)):
                curve = _over_s(records, n, way, measure)
                name = ("" if dash == 0 else "_") + lab.aperture_name(n) + way
                curves[name.removesuffix(way) if dash == 0 else name] = Curve(
                    x=list(curve), y=list(curve.values()), colour=number, dash=dash
                )
        return Curves(title=title, xlabel="mask position s", ylabel=unit, curves=curves)

    return [
        panel("EigenTV; dashed: GPSR", "PSNR (dB)", (CALIBRATED, "gpsr"), "psnr"),
        panel("EigenTV; dashed: GPSR", "spectral angle (rad)", (CALIBRATED, "gpsr"), "sam"),
        panel("Calibrated; dashed: designed code", "PSNR (dB)", (CALIBRATED, DESIGNED), "psnr"),
    ]


def _name(record: Record) -> str:
    s = record.spec["mask_position"]
    return "s ≈ 0" if s == SOURCE_POSITIONS[0] else f"s = {s:g}"


def _pictures(shown: Sequence[Record], points: Sequence[Point], zoom: Zoom) -> list[list[Picture]]:
    """The scene and the three positions, and a part of each."""
    from shadowgram.figures.sheet import Picture

    truth = shown[0].arrays["truth_picture"]
    whole = [Picture(title="scene", picture=truth, points=points, zoom=zoom)]
    part = [Picture(title="part of it", picture=zoom.of(truth))]
    for r in shown:
        picture, quality = r.arrays[f"{CALIBRATED}_picture"], r.values[CALIBRATED]
        whole.append(
            Picture(
                title=f"{_name(r)}, {lab.aperture_name(SHOWN)}", picture=picture, zoom=zoom,
                caption=f"{quality['psnr']:.1f} dB, {quality['sam']:.2f} rad",
            )
        )  # fmt: skip
        part.append(
            Picture(
                title=_name(r), picture=zoom.of(picture), caption=f"mask blurred over {r.values['blur']:.1f} columns"
            )
        )
    return [whole, part]


def _other_ways(records: Sequence[Record]) -> list[Picture]:
    """The largest of the source's positions, seen and reconstructed otherwise."""
    from shadowgram.figures.sheet import Picture

    s = SOURCE_POSITIONS[-1]
    ideal, finite = (common.only(records, mask_position=s, f_number=n) for n in (None, SHOWN))
    finitely = lab.aperture_name(SHOWN)
    ways = (
        (f"s = {s:g}, ideal aperture", "calibrated", ideal, CALIBRATED), (f"{finitely}, GPSR", "calibrated", finite, "gpsr"),
        (f"{finitely}, designed code", "EigenTV", finite, DESIGNED),
        ("a column off", "ideal aperture, designed code", ideal, BESIDE),
    )  # fmt: skip
    return [
        Picture(title=title, picture=r.arrays[f"{way}_picture"], caption=f"{how}, {r.values[way]['psnr']:.1f} dB")
        for title, how, r, way in ways
    ]


def _bands(shown: Sequence[Record]) -> Picture:
    """All bands in grey, one row for the scene and one for each position."""
    from shadowgram.figures.sheet import Picture

    rows = [shown[0].arrays["truth_bands"], *(r.arrays[f"{CALIBRATED}_bands"] for r in shown)]
    gap = 2
    padded = (
        np.concatenate([np.pad(row, ((0, 0), (0, gap), (0, gap)), constant_values=255) for row in rows], axis=1) / 255
    )
    mosaic = np.concatenate(list(padded), axis=1)[:-gap, :-gap]
    wavelengths = shown[0].arrays["wavelengths"]
    return Picture(
        title=f"Bands, {', '.join(f'{nm:.0f}' for nm in wavelengths)} nm",
        picture=mosaic,
        caption=f"from top to bottom: scene, {', '.join(_name(r) for r in shown)}, all at {lab.aperture_name(SHOWN)}",
    )


def _spectra(shown: Sequence[Record]) -> list[Curves]:
    from shadowgram.figures.sheet import Curve, Curves

    wavelengths = shown[0].arrays["wavelengths"]
    return [
        Curves(
            title=f"spectrum at {label}", xlabel="wavelength (nm)", ylabel="reflectance", bottom=0,
            curves={"scene": Curve(x=wavelengths, y=shown[0].arrays["truth_spectra"][k], reference=True)}
            | {
                _name(r): Curve(x=wavelengths, y=r.arrays[f"{CALIBRATED}_spectra"][k], colour=number)
                for number, r in enumerate(shown)
            },
        )
        for k, label in enumerate(POINTS)
    ]  # fmt: skip


def claims(records: Sequence[Record]) -> list[Claim]:
    """Calibration, spectral information, artefacts, and light beside the mask."""
    return [_calibration(records), _spectral(records), _blur(records), _artefacts(records), _beside_the_mask(records)]


def _calibration(records: Sequence[Record]) -> Claim:
    found, gains = [], {}
    for n in _apertures(records):
        known, designed = (_over_s(records, n, way, "psnr") for way in (CALIBRATED, DESIGNED))
        gains[n] = {s: known[s] - designed[s] for s in SOURCE_POSITIONS[1:]}
        found.append(f"{lab.aperture_name(n)} " + ", ".join(f"{gain:.1f}" for gain in gains[n].values()))
    off = [_over_s(records, None, way, "psnr") for way in (CALIBRATED, BESIDE)]
    lost = min(off[0][s] - off[1][s] for s in SOURCE_POSITIONS[1:])
    return Claim(
        page=None,
        says="what is gained by assembling the sensing matrix from captures of a white board, one a band and shot (page 36)?",
        found=f"gain over the designed code at s = {', '.join(f'{s:g}' for s in SOURCE_POSITIONS[1:])}: {'; '.join(found)} dB;"
        f" a mask one column beside its place costs {lost:.0f} dB or more with the designed code",
        agrees=None,
        why="nothing is gained with an ideal aperture and a mask that is exactly in its place, which no bench has",
    )


def _spectral(records: Sequence[Record]) -> Claim:
    found: list[str] = []
    worse: list[str] = []  # than at s ≈ 0
    back: list[str] = []  # from 0.004 to 0.0078
    for n in (None, SHOWN):
        for way, solver in ((CALIBRATED, "EigenTV"), ("gpsr", "GPSR")):
            name, over_s = f"{solver}, {lab.aperture_name(n)}", _over_s(records, n, way, "sam")
            angles = [over_s[s] for s in SOURCE_POSITIONS]
            found.append(f"{name} " + ", ".join(f"{angle:.3f}" for angle in angles))
            if max(angles[1:]) >= angles[0]:
                worse.append(name)
            elif angles[2] > angles[1]:
                back.append(name)
    shown = (common.only(records, mask_position=s, f_number=SHOWN) for s in SOURCE_POSITIONS)
    at_points = ", ".join(f"{100 * _error_at_points(r):.0f}" for r in shown)
    why = [f"not better than at s ≈ 0 with {'; '.join(worse)}"] if worse else []
    why += [f"best at s = 0.004 with {'; '.join(back)}"] if back else []
    return Claim(
        page=37,
        says="spectral information becomes more noticeable as s grows",
        found=f"spectral angle (rad) at s ≈ 0, 0.004, 0.0078: {'; '.join(found)}. Error of the spectra at {', '.join(POINTS)},"
        f" EigenTV at {lab.aperture_name(SHOWN)}: {at_points} %",
        agrees=not worse,
        why=", and ".join(why),
    )


def _error_at_points(record: Record) -> float:
    """Relative error of the spectra at the points."""
    truth, found = (record.arrays[f"{name}_spectra"].astype(float) for name in ("truth", CALIBRATED))
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))


def _artefacts(records: Sequence[Record]) -> Claim:
    found, grows, steady = [], [], []
    positions = sorted({r.spec["mask_position"] for r in records})
    for n in _apertures(records)[1:]:
        for way, solver in ((CALIBRATED, "EigenTV"), ("gpsr", "GPSR")):
            finite, ideal = (_over_s(records, aperture, way, "psnr") for aperture in (n, None))
            loss = [ideal[s] - finite[s] for s in positions]
            found.append(f"{solver} {lab.aperture_name(n)} " + ", ".join(f"{value:.1f}" for value in loss))
            grows.append(loss[-1] > loss[0] + 0.5)
            steady.append(min(np.diff(loss)) > 0)
    return Claim(
        page=39,
        says="the artefacts that the finite aperture brings into the reconstruction are directly proportional to s",
        found=f"PSNR lost to the aperture at s = {', '.join(f'{s:g}' for s in positions)} (dB): {'; '.join(found)}",
        agrees=all(grows) and all(steady),
        why=("they grow with s" if all(grows) else "they do not grow with s everywhere")
        + ("" if all(steady) else ", but not always from one s to the next"),
    )


def _blur(records: Sequence[Record]) -> Claim:
    """Proportional to s by geometry; the records say how much it is."""
    blur = {r.spec["mask_position"]: r.values["blur"] for r in common.chosen(records, f_number=SHOWN)}
    rates = [width / s for s, width in blur.items() if s > 0]
    return Claim(
        page=39,
        says="the finite aperture introduces blurring that is directly proportional to s",
        found=f"mask blurred at {lab.aperture_name(SHOWN)} over {', '.join(f'{width:.2g}' for width in blur.values())} columns at"
        f" s = {', '.join(f'{s:g}' for s in blur)}",
        agrees=max(rates) < 1.01 * min(rates),
    )


def _beside_the_mask(records: Sequence[Record]) -> Claim:
    ideal = sorted(common.chosen(records, f_number=None), key=lambda r: r.spec["mask_position"])
    worst = {r.spec["mask_position"]: max(r.values["vignetted"]) for r in ideal}
    ratio = ideal[0].values["dispersion_ratio"]
    shares = ", ".join(f"{s:g}: {100 * share:.2f} %" for s, share in worst.items())
    return Claim(
        page=39,
        says="the spectral plane is three times as wide as the mask, so that extreme wavelengths miss the mask and are lost",
        found=f"light of the outermost band that misses the mask, over s: {shares}",
        agrees=max(worst.values()) > 0.1,
        why="the outermost wavelengths are aside by s(β−1)/2 of the mask's width, which is little near the detector, and miss the"
        f" mask altogether from s = 2/(β+1) = {2 / (ratio + 1):.2f} on; on the bench something else must have cut them",
    )


STUDY = Study(
    name="fig-2-24",
    title="A scene from two shots of the calibrated bench",
    source="Figs. 2.24 to 2.26, pages 36 to 39",
    revision=2,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
