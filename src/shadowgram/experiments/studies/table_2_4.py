"""Spectral resolution measured on the bench, as in the laboratory: Table 2.4 and Fig. 2.23, section 2.5.1.

The source takes two bands for resolved when their patterns on the sensor are one column apart, looks for such bands in a row of
the captures of a white board, and finds Δλ of 40, 28 and 20 nm at s = 0.004, 0.0078 and 0.011. Its theory, eq. (2.18) with β ≈ 3,
gives 43, 22 and 16 nm, and here 45.6, 23.4 and 16.6 nm. Aperture, lamp and width of the bands are not said.

Here the bench stands in the computer: a random code, a white board lit in bands of 4 nm, one after the other, apertures from a
pinhole to f/8, and the sensor of `_bench`. Δλ comes from the captures alone (`measured_resolution`), from the captures and the
known code (`estimate_geometry`), and from one row in whole columns, as the source did it.

What agrees: Δλ as measured is that of theory, at every aperture through which the pattern can be found at all. What the source does
not say: a pattern one column aside is another pattern only if it is not blurred over more. How alike the patterns of two bands are,
over their distance, shows that a wide aperture sets which bands can be told apart, wherever the mask stands.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram import codes
from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study
from shadowgram.spectral.registration import estimate_geometry, measured_resolution

from . import _bench as lab
from . import _common as common

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Curves, Picture
    from shadowgram.spectral.calibration import Calibration
    from shadowgram.spectral.sscsi import SSCSI

ALIKE = 0.25  # likeness of sharp patterns one column apart, on average over their place between the pixels
ZOOM = 28  # pixels a side
APERTURES = (None, 160.0, 64.0, 32.0, 16.0, 8.0)
SHARP, SHOWN = None, 32.0  # f-numbers of the pictures
SHOWN_POSITION = 0.0078


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """One position of the mask and aperture; `mask_position` is that of the whole bench, whatever `size`."""

    mask_position: float
    f_number: float | None
    size: int
    bands: int
    seed: int


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """The source's positions with every aperture, and more for the curve."""
    size, apertures = (64, (None, SHOWN, 8.0)) if quick else (256, APERTURES)
    pairs = [(s, n) for n in apertures for s in lab.SOURCE_TABLE]
    if not quick:
        pairs += [(s, n) for n in (SHARP, SHOWN) for s in (0.0025, 0.0055, 0.016, 0.022)]
    return [Spec(mask_position=s, f_number=n, size=size, bands=35, seed=0) for s, n in pairs]


def run(spec: Spec, _scene: SceneSource) -> Result:
    """Capture the white board band by band, and measure."""
    bench = lab.bench_of(spec.size, spec.f_number)
    imager = bench.imager(lab.like(spec.mask_position, spec.size))
    code = codes.random(shots=1, shape=imager.code_shape, seed=spec.seed)
    light = lab.white_captures(imager, code, bench.pupil, spec.bands)
    edges = np.linspace(*lab.WAVELENGTHS, spec.bands + 1)
    sensor = lab.make_sensor(imager.detector_shape, spec.seed)
    captures = lab.calibrated(sensor, light, (edges[1:] + edges[:-1]) / 2, imager.detector_pitch)
    theory = imager.code_pitch / (imager.mask_position * imager.dispersion)
    distance, likeness = _likeness(captures)
    values: dict[str, object] = {
        "theory": theory,
        "captures": _by_captures(captures, imager),
        "geometry": _by_geometry(captures, code, spec.size),
        "blur": imager.mask_position * bench.pupil / imager.code_pitch,
        "pupil_band_width": bench.pupil_band_width,
        "contrast": float((captures.code.std(axis=(2, 3)) / captures.code.mean(axis=(2, 3))).mean()),
        "by_row": _by_row(captures, distance, spec.seed),
        "looks_like_one": _looks_like_one(distance, likeness),
        "told_apart": _falls_to(distance, likeness[0], ALIKE),
    }
    arrays = _pair(captures, theory) | {"distance": distance, "likeness": likeness[0]}
    return Result(values=values, arrays=arrays)


def _wavelengths(captures: Calibration) -> np.ndarray:
    return np.array(captures.imager.band_centres)


def _by_captures(captures: Calibration, imager: SSCSI) -> dict[str, object]:
    """Δλ from the captures alone, or why there is none."""
    try:
        found = measured_resolution(
            captures.code, wavelengths=captures.imager.band_centres, reference=len(captures.imager.band_centres) // 2,
            pitch_ratio=1 - imager.mask_position,
        )  # fmt: skip
    except ValueError as error:
        return {"refused": str(error)}
    return {
        "band_width": found.band_width, "error": found.band_width_error,
        "shifts": [_number(shift) for shift in found.shifts],
    }  # fmt: skip


def _by_geometry(captures: Calibration, code: np.ndarray, size: int) -> dict[str, object]:
    """Δλ and the mask's place from the captures and the code, or why there are none."""
    try:
        found = estimate_geometry(captures.code, code, wavelengths=captures.imager.band_centres)
    except ValueError as error:
        return {"refused": str(error)}
    return {
        "band_width": 1 / found.dispersion, "error": found.dispersion_error / found.dispersion**2,
        "mask_position": found.mask_position * size / lab.FULL_SIZE, "dispersion_ratio": _number(found.dispersion_ratio),
    }  # fmt: skip


def _number(value: float) -> float | None:
    return None if math.isnan(value) else float(value)


def _likeness(captures: Calibration) -> tuple[np.ndarray, np.ndarray]:
    """Correlation of the captures of two bands, averaged over the pairs at each distance.

    Returns
    -------
    (distance,) nm, and (0, 1 or 2 columns by which the one of the longer wavelength is moved back, distance).
    """
    images = captures.code[0].astype(np.float64)
    trim = images.shape[2] // 16  # columns at the ends may look past the mask
    images = images[:, :, trim:-trim]
    images -= images.mean(axis=(1, 2), keepdims=True)
    images /= images.std(axis=(1, 2), keepdims=True)
    # At longer wavelengths the detector sees the mask further right, and so the pattern further left.
    distances = range(len(images) - 3)
    table = [
        [
            np.mean(images[: len(images) - m, :, columns:] * images[m:, :, : images.shape[2] - columns])
            for m in distances
        ]
        for columns in (0, 1, 2)
    ]
    step = np.diff(_wavelengths(captures)).mean()
    return step * np.arange(len(table[0])), np.array(table)


def _looks_like_one(distance: np.ndarray, likeness: np.ndarray) -> list[float]:
    """Nearest and farthest bands, nm, whose pattern is more like the other moved by one column than by none or two."""
    alike = likeness.argmax(axis=0) == 1
    if not alike.any():
        return []
    first = int(alike.argmax())
    count = int(alike[first:].argmin()) or len(alike) - first
    return [float(distance[first]), float(distance[first + count - 1])]


def _falls_to(distance: np.ndarray, likeness: np.ndarray, level: float) -> float | None:
    """Distance, nm, at which the likeness has fallen to `level`."""
    below = np.flatnonzero(likeness <= level)
    if not len(below):
        return None
    k = int(below[0])
    return float(np.interp(-level, -likeness[k - 1 : k + 1], distance[k - 1 : k + 1]))


def _by_row(captures: Calibration, distance: np.ndarray, seed: int) -> float:
    """Distance, nm, of the bands that agree best in one row, drawn at random, when one is moved by a column: as in the source."""
    row = int(np.random.default_rng(seed).integers(captures.code.shape[2]))
    rows = captures.code[0, :, row]
    first = len(rows) // 5
    agreement = [np.corrcoef(rows[first, 1:], other[:-1])[0, 1] for other in rows[first + 1 :]]
    return float(distance[1] * (1 + np.argmax(agreement)))


def _pair(captures: Calibration, theory: float) -> dict[str, np.ndarray]:
    """Parts of the captures of two bands that are one column apart, (2, y, x), and their wavelengths."""
    wavelengths = _wavelengths(captures)
    apart = min(round(theory / float(wavelengths[1] - wavelengths[0])), len(wavelengths) - 1)
    first = (len(wavelengths) - apart) // 2
    ny, nx = captures.code.shape[2:]
    y, x = (ny - ZOOM) // 2, (nx - ZOOM) // 2
    both = captures.code[0, [first, first + apart]]
    return {
        "wavelengths": wavelengths, "pair": wavelengths[[first, first + apart]],
        "zoom": both[:, y : y + ZOOM, x - 1 : x + ZOOM + 1],
    }  # fmt: skip


def figure(records: Sequence[Record]) -> Figure:
    """Patterns one column apart, in pictures and rows; shifts, Δλ over s, and bands told apart over the aperture."""
    from shadowgram.figures.sheet import sheet

    apertures = sorted({r.spec["f_number"] for r in records} - {None}, reverse=True)
    sharp = common.only(records, mask_position=SHOWN_POSITION, f_number=SHARP)
    blurred = common.only(records, mask_position=SHOWN_POSITION, f_number=SHOWN)
    return sheet(
        "Spectral resolution measured on the bench (Table 2.4, Fig. 2.23)",
        [
            _pictures(sharp, blurred),
            _rows(sharp),
            [_shift_panel(records), _width_panel(records), _likeness_panel(records, apertures)],
        ],
    )


def _pictures(sharp: Record, blurred: Record) -> list[Picture]:
    from shadowgram.figures.sheet import Picture

    (first, second), (one, other) = sharp.arrays["pair"], sharp.arrays["zoom"]
    hazy = blurred.arrays["zoom"][0]
    s = f"s = {sharp.spec['mask_position']:g}"
    return [
        Picture(title=f"{first:.0f} nm", picture=_grey(one[:, 1:-1]), caption=f"{s}, ideal aperture"),
        Picture(title=f"{second:.0f} nm", picture=_grey(other[:, 1:-1]), caption="as captured"),
        Picture(title=f"{second:.0f} nm, one column back", picture=_grey(other[:, :-2]), caption="as the first"),
        Picture(
            title=f"{first:.0f} nm at f/{blurred.spec['f_number']:g}", picture=_grey(hazy[:, 1:-1]),
            caption=f"blurred over {blurred.values['blur']:.1f} columns",
        ),
    ]  # fmt: skip


def _grey(picture: np.ndarray) -> np.ndarray:
    return np.clip(picture / np.quantile(picture, 0.99), 0, 1)


def _rows(record: Record) -> list[Curves]:
    """The middle row of both patterns, before and after one is moved."""
    from shadowgram.figures.sheet import Curve, Curves

    one, other = record.arrays["zoom"][:, record.arrays["zoom"].shape[1] // 2]
    names = [f"{wavelength:.0f} nm" for wavelength in record.arrays["pair"]]
    column = np.arange(len(one) - 2)

    def panel(title: str, moved: np.ndarray) -> Curves:
        alike = np.corrcoef(one[1:-1], moved)[0, 1]
        return Curves(
            title=f"{title}: correlation {alike:.2f}", xlabel="column", ylabel="transmittance seen", top=1.4,
            curves={names[0]: Curve(x=column, y=one[1:-1]), names[1]: Curve(x=column, y=moved, colour=1)},
        )  # fmt: skip

    return [panel("A row of both, as captured", other[1:-1]), panel("The same, one moved by a column", other[:-2])]


def _shift_panel(records: Sequence[Record]) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    curves = {}
    for number, s in enumerate(lab.SOURCE_TABLE):
        record = common.only(records, mask_position=s, f_number=SHARP)
        wavelengths = record.arrays["wavelengths"]
        shifts = np.array(record.values["captures"]["shifts"], dtype=float)  # None becomes NaN
        seen = np.isfinite(shifts)
        line = np.polyfit(wavelengths[seen], shifts[seen], 1)
        curves[f"_line {s}"] = Curve(x=wavelengths, y=np.polyval(line, wavelengths), reference=True)
        curves[f"s = {s:g}: {abs(1 / line[0]):.1f} nm a column"] = Curve(
            x=wavelengths[seen][::2], y=shifts[seen][::2], colour=number
        )
    return Curves(
        title="Shift of the pattern, ideal aperture", xlabel="wavelength (nm)", ylabel="columns", curves=curves
    )


def _width_panel(records: Sequence[Record]) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    s = np.array(list(lab.SOURCE_TABLE))
    known = [r for r in records if r.spec["f_number"] is None]
    largest, smallest = (f(r.spec["mask_position"] for r in known) for f in (max, min))
    fine = np.geomspace(smallest, largest, 100)
    scale = known[0].values["theory"] * known[0].spec["mask_position"]
    curves = {"theory, Δc/(sα)": Curve(x=fine, y=scale / fine, reference=True)}
    for number, n in enumerate((SHARP, SHOWN)):
        width = _measured(records, n, "captures")
        curves[f"simulated, {lab.aperture_name(n)}"] = Curve(x=list(width), y=list(width.values()), colour=number)
    columns = zip(*lab.SOURCE_TABLE.values(), strict=True)
    for number, (name, column) in enumerate(zip(("theory", "experiment"), columns, strict=True)):
        curves[f"source, {name}"] = Curve(x=s, y=column, colour=2 + number)
    return Curves(
        title="Wavelengths one column apart", xlabel="mask position s", ylabel="Δλ (nm)", curves=curves, bottom=0
    )


def _likeness_panel(records: Sequence[Record], apertures: Sequence[float]) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    curves, theory = {}, math.nan
    for number, n in enumerate((None, *apertures)):
        record = common.only(records, mask_position=SHOWN_POSITION, f_number=n)
        theory = record.values["theory"]
        if "refused" not in record.values["captures"]:
            curves[lab.aperture_name(n)] = Curve(
                x=record.arrays["distance"][::2], y=record.arrays["likeness"][::2], colour=number
            )
    return Curves(
        title=f"Likeness of two bands, s = {SHOWN_POSITION:g}", xlabel="distance of the bands (nm)",
        ylabel="correlation", curves=curves, marks={theory: "one column"}, bottom=-0.1,
    )  # fmt: skip


def _measured(records: Sequence[Record], f_number: float | None, way: str) -> dict[float, float]:
    """s → Δλ, where it could be measured."""
    chosen = sorted(common.chosen(records, f_number=f_number), key=lambda r: r.spec["mask_position"])
    return {r.spec["mask_position"]: r.values[way]["band_width"] for r in chosen if "refused" not in r.values[way]}


def claims(records: Sequence[Record]) -> list[Claim]:
    """The criterion, the two columns of the table, and the apertures that allow them."""
    apertures = sorted({r.spec["f_number"] for r in records} - {None}, reverse=True)
    return [_criterion(records, apertures), _theory(records), _experiment(records, apertures)]


def _at_one_column(record: Record) -> float:
    """Likeness of two bands that are one column apart."""
    return float(np.interp(record.values["theory"], record.arrays["distance"], record.arrays["likeness"]))


def _criterion(records: Sequence[Record], apertures: Sequence[float]) -> Claim:
    found, sharp = [], []
    for n in (None, *apertures):
        mine = [common.only(records, mask_position=s, f_number=n) for s in lab.SOURCE_TABLE]
        alike = [_at_one_column(r) for r in mine]
        sharp = alike if n is None else sharp
        apart = ", ".join("–" if (nm := r.values["told_apart"]) is None else f"{nm:.0f}" for r in mine)
        found.append(f"{lab.aperture_name(n)} " + ", ".join(f"{a:.2f}" for a in alike) + f" ({apart} nm)")
    return Claim(
        page=36,
        says="two adjacent bands are resolvable if their patterns on the sensor are one column apart",
        found=f"correlation of patterns one column apart at s = {', '.join(f'{s:g}' for s in lab.SOURCE_TABLE)}, and in brackets"
        f" the distance of bands at which it has fallen to {ALIKE}: " + "; ".join(found),
        agrees=max(sharp) < ALIKE + 0.05,
        why="true of sharp patterns; with a finite aperture they are blurred over s·pupil, patterns one column apart grow alike,"
        " and in the end the aperture alone sets which bands can be told apart, whatever s",
    )


def _theory(records: Sequence[Record]) -> Claim:
    ours = {s: common.only(records, mask_position=s, f_number=SHARP).values["theory"] for s in lab.SOURCE_TABLE}
    off = max(abs(ours[s] / printed - 1) for s, (printed, _) in lab.SOURCE_TABLE.items())
    return Claim(
        page=36,
        says="theory, β = 3: Δλ = 43, 22 and 16 nm at s = 0.004, 0.0078 and 0.011",
        found=f"140 nm/(256·3·s): {', '.join(f'{nm:.1f}' for nm in ours.values())} nm; at most {100 * off:.0f} % from the source",
        agrees=off < 0.08,
        why="the source's numbers follow from β between 3.1 and 3.2; it says β ≈ 3",
    )


def _experiment(records: Sequence[Record], apertures: Sequence[float]) -> Claim:
    found, within = [], {}
    for n in (None, *apertures):
        width = _measured(records, n, "captures")
        widths = {s: width.get(s) for s in lab.SOURCE_TABLE}
        found.append(
            f"{lab.aperture_name(n)} " + ", ".join("none" if w is None else f"{w:.1f}" for w in widths.values())
        )
        within[n] = all(w is not None and _close(records, s, w) for s, w in widths.items())
    lost = [lab.aperture_name(n) for n, good in within.items() if not good]
    ranges = [common.only(records, mask_position=s, f_number=SHARP).values["looks_like_one"] for s in lab.SOURCE_TABLE]
    inside = all(
        alike and alike[0] <= measured <= alike[1]
        for (_, measured), alike in zip(lab.SOURCE_TABLE.values(), ranges, strict=True)
    )
    alike = ", ".join(f"{one[0]:g} to {one[1]:g}" for one in ranges if one)
    return Claim(
        page=36,
        says="experiment: Δλ = 40, 28 and 20 nm at s = 0.004, 0.0078 and 0.011 (compared to 30 %)",
        found="from simulated captures: " + "; ".join(found) + f" nm. {_breakdown(records, lost)}",
        agrees=within[None],
        why=f"with an ideal aperture {'' if within[None] else 'not '}within 30 % of source and theory. A pattern looks more"
        f" like one moved by one column than by none or two for bands {alike} nm apart:"
        f" in whole columns the source's numbers are {'all' if inside else 'not all'} possible",
    )  # fmt: skip


def _close(records: Sequence[Record], s: float, width: float) -> bool:
    theory = common.only(records, mask_position=s, f_number=SHARP).values["theory"]
    return all(abs(width / other - 1) < 0.3 for other in (theory, lab.SOURCE_TABLE[s][1]))


def _breakdown(records: Sequence[Record], lost: Sequence[str]) -> str:
    """From which blur on there is nothing to measure."""
    seen = [r.values["blur"] for r in records if "refused" not in r.values["captures"]]
    unseen = [r.values["blur"] for r in records if "refused" in r.values["captures"]]
    if not unseen:
        return "No aperture hides the pattern"
    return (
        f"Not at every s with {' and '.join(lost)}: a pattern blurred over {max(seen):.1f} columns is found, over"
        f" {min(unseen):.1f} not"
    )


STUDY = Study(
    name="table-2-4",
    title="Spectral resolution measured on the bench",
    source="Table 2.4 and Fig. 2.23, pages 35 and 36",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
