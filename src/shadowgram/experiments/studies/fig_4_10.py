"""Fig. 4.10: dose of a scan, over transmittance and shots, and what a hand looks like for it.

The source shows the mass energy-absorption coefficient of muscle, and a hand reconstructed from 12.5 % shots with 1, 10 and 50
% of the cells open, at "0.035, 0.34 and 1.70 · 10⁻⁴ Gy", which it compares with a scan by pencil beams and with the 0.07 µSv of
a commercial scanner. Here the dose is that of muscle at the front of the hand: in an open cell, in a shot, and in a scan, the
mean over the field. The hand's counts come from transport through the mask's real holes, with the Poisson noise of all photons,
air and mask included; `shadowgram.xray.reconstruct` knows ideal cells only. The hand is of our own making.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study

from . import _common as common
from . import _cxbi_maps as maps
from ._cxbi_ways import score

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Curves, Panel

SCENE = "cxbi-hand"
STATED = {1: 0.035e-4, 10: 0.34e-4, 50: 1.70e-4}
"""% of open cells → Gy of the source's scan with 12.5 % shots."""
PERCENT = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
SHOTS = (128, 256, 512)
SCAN = SHOTS[0]
ALL_SHOTS, PIXELS = 512, 1024
DOSE, PENCIL, IMAGE = "dose", "pencil", "image"
COEFFICIENTS = np.geomspace(1, 150, 120)  # keV


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """The doses, those of pencil beams, or images at a transmittance in %, with several strips and noises."""

    what: str
    percent: int = 0
    repeats: int = 0
    histories: int = 0


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """Doses, and the three transmittances of the source; the quick form has an image of one."""
    repeats, histories = (1, 60_000) if quick else (4, 1_500_000)
    return [
        Spec(what=DOSE),
        Spec(what=PENCIL),
        *(
            Spec(what=IMAGE, percent=percent, repeats=repeats, histories=histories)
            for percent in ([10] if quick else STATED)
        ),
    ]


def run(spec: Spec, _scene: SceneSource) -> Result:
    """Doses by the formula, or images."""
    if spec.what == IMAGE:
        return _images(spec)
    return _doses() if spec.what == DOSE else _pencil()


def _doses() -> Result:
    import shadowgram as sg
    from shadowgram.xray.dose import TISSUE

    scene = sg.xray.shipped_scene(SCENE)
    found = [sg.xray.scan_dose(scene, shots=1, transmittance=percent / 100) for percent in PERCENT]
    return Result(
        values={
            "pixel": [float(one.pixel.mean()) for one in found],
            "shot": [one.shot for one in found],
            "photons": [float(one.photons.mean()) for one in found],
            "field": float(found[0].area.sum()),
        },
        arrays={
            "energy": COEFFICIENTS.astype(np.float32),
            "coefficient": sg.xray.material(TISSUE).mass_energy_absorption(COEFFICIENTS).astype(np.float32),
        },
    )


def _pencil() -> Result:
    """Doses of the source's pencil beams: in the spot, and the mean over the field."""
    import shadowgram as sg
    from shadowgram.xray._scan_pencil import DISTANCE, HALF_ANGLE, PHOTONS

    scene = sg.xray.shipped_scene(SCENE)
    spot = math.pi * (DISTANCE * math.tan(HALF_ANGLE)) ** 2 / 100
    spectrum = scene.source.spectrum.spectrum()
    return Result(
        values={
            "photons": PHOTONS, "spot": spot,
            "dose": sg.xray.absorbed_dose(spectrum, spot, photons=PHOTONS),
        }
    )  # fmt: skip


def _images(spec: Spec) -> Result:
    import shadowgram as sg

    photons = maps.photons_per_shot(SCENE)
    own = photons * maps.own_scatter(SCENE, spec.percent, spec.histories)
    rows = []
    image = truth = np.zeros(())
    for seed in range(spec.repeats):
        scan = maps.expected(
            SCENE, percent=spec.percent, seed=seed, shots=ALL_SHOTS, step=ALL_SHOTS // SCAN, histories=spec.histories,
            photons=photons,
        )  # fmt: skip
        rng = np.random.default_rng((seed, spec.percent))
        counts, air = (rng.poisson(mean.clip(min=0) + own) for mean in (scan.counts, scan.air))
        x, truth = sg.xray.reconstruct(scan.codes, counts, air).x, scan.image
        rows.append(score(x, truth))
        image = x if seed == 0 else image
    values: dict[str, object] = dict(zip(("psnr", "ssim"), np.transpose(rows).tolist(), strict=True))
    return Result(values=values, arrays={"image": image.astype(np.float32), "truth": truth.astype(np.float32)})


def at(record: Record, name: str, percent: float) -> float:
    """One of the doses at a transmittance."""
    return record.values[name][PERCENT.index(float(percent))]


def summed(dose: Record, percent: float) -> float:
    """Doses of the open cells of all shots, added up as if they fell on one place: the source's kind of number."""
    return at(dose, "pixel", percent) * percent / 100 * PIXELS * SCAN


def _parts(records: Sequence[Record]) -> tuple[Record, Record, list[Record]]:
    return common.only(records, what=DOSE), common.only(records, what=PENCIL), common.chosen(records, what=IMAGE)


def figure(records: Sequence[Record]) -> Figure:
    """Coefficient, doses beside the limit, and the hand for three of them."""
    from shadowgram.figures.sheet import sheet

    dose, pencil, images = _parts(records)
    return sheet(
        "Dose of a scan, and the hand for it (Fig. 4.10)",
        [[_coefficient(dose), _over_transmittance(dose, pencil)], _pictures(dose, images)],
    )


def _coefficient(dose: Record) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    own = Curve(x=dose.arrays["energy"], y=dose.arrays["coefficient"], dash=4)
    return Curves(
        title="skeletal muscle", xlabel="energy (keV)", ylabel="mass energy-absorption (cm²/g)", log="xy",
        curves={"_": own}, width=0.7,
    )  # fmt: skip


def _over_transmittance(dose: Record, pencil: Record) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves
    from shadowgram.xray.dose import COMMERCIAL

    curves = {
        name: Curve(x=PERCENT, y=[1e6 * limit] * len(PERCENT), reference=True)
        for name, limit in zip(("commercial, 0.07 to 0.1 µSv", "_"), COMMERCIAL, strict=True)
    }
    for number, shots in enumerate(reversed(SHOTS)):
        y = [1e6 * shots * one for one in dose.values["shot"]]
        curves[f"scan of {shots} shots"] = Curve(x=PERCENT, y=y, colour=number)
    curves["pencil beams"] = Curve(x=PERCENT, y=[1e6 * _pencil_mean(dose, pencil)] * len(PERCENT), colour=3, dash=1)
    curves["open cell, one shot"] = Curve(x=PERCENT, y=[1e6 * one for one in dose.values["pixel"]], colour=4, dash=2)
    curves["shot"] = Curve(x=PERCENT, y=[1e6 * one for one in dose.values["shot"]], colour=5, dash=3)
    return Curves(
        title="dose at the front, mean over the field", xlabel="open cells"
        " (%)", ylabel="µGy", log="xy", curves=curves, bottom=1e-10, width=1.3,
    )  # fmt: skip


def _pencil_mean(dose: Record, pencil: Record) -> float:
    """Gy of all pencil beams, the mean over the field."""
    return PIXELS * pencil.values["dose"] * pencil.values["spot"] / dose.values["field"]


def _pictures(dose: Record, images: Sequence[Record]) -> list[Panel | None]:
    from shadowgram.figures.sheet import Picture

    truth = images[0].arrays["truth"]
    peak = float(np.quantile(truth, 0.995))
    panels: list[Panel | None] = [
        Picture(title="truth", picture=np.clip(truth / peak, 0, 1).astype(float), caption=" ")
    ]
    for record in images:
        percent, v = record.spec["percent"], record.values
        panels.append(
            Picture(
                title=f"{percent} % open, {1e6 * SCAN * at(dose, 'shot', percent):.2g} µGy",
                picture=np.clip(record.arrays["image"] / peak, 0, 1).astype(float),
                caption=f"{v['psnr'][0]:.1f} dB, {v['ssim'][0]:.2f}",
            )
        )  # fmt: skip
    return panels


def claims(records: Sequence[Record]) -> list[Claim]:
    """The source's doses, its comparison with pencil beams, the limit, and what the dose buys."""
    dose, pencil, images = _parts(records)
    return [_levels(dose), _less(dose, pencil), _limit(dose), _coefficients(dose), _quality(dose, images)]


def _levels(dose: Record) -> Claim:
    parts, apart = [], []
    for percent, stated in STATED.items():
        mean = SCAN * at(dose, "shot", percent)
        apart.append(mean / stated)
        parts.append(
            f"{percent} %: {1e6 * mean:.3g} µGy, the mean over the field; {1e6 * summed(dose, percent):.3g} µGy if the doses of all"
            f" open cells are added up, beside {1e6 * stated:.3g} µGy"
        )
    agrees = all(0.5 < one < 2 for one in apart)
    return Claim(
        page=83, says="a scan with 12.5 % shots gives 0.035, 0.34 and 1.70 · 10⁻⁴ Gy at 1, 10 and 50 % transmittance",
        found="; ".join(parts), agrees=agrees,
        why="" if agrees else "the source adds up the doses of pixels that lie beside one another; dose is energy over mass, and"
        f" a field's is their mean, {PIXELS} times less. Its sums are {100 * STATED[10] / summed(dose, 10):.0f} % of ours: they"
        f" have {1e9 * STATED[10] / (PIXELS * SCAN * 0.1):.1f} nGy in an open cell, ours {1e9 * at(dose, 'pixel', 10):.1f},"
        " Table 4.2 7.1",
    )  # fmt: skip


def _less(dose: Record, pencil: Record) -> Claim:
    mean = _pencil_mean(dose, pencil)
    added = PIXELS * pencil.values["dose"]
    parts = [
        f"{percent} %: {SCAN * at(dose, 'shot', percent) / mean:.2g} times the mean over the field,"
        f" {summed(dose, percent) / added:.2g} times the sum of the pixels' doses"
        for percent in STATED
    ]
    agrees = all(SCAN * at(dose, "shot", percent) < mean for percent in STATED)
    return Claim(
        page=83, says="in all cases the absorbed dose is less than the one that the pencil beams of the truth need",
        found=f"{1e6 * mean:.2g} µGy for the pencil beams, {pencil.values['photons']} photons a pixel,"
        f" {1e9 * pencil.values['dose']:.0f} nGy in the spot of {pencil.values['spot']:.2f} cm²; the scans: {'; '.join(parts)}",
        agrees=agrees,
        why="" if agrees else f"at p % open each pixel is lit in p % of the {SCAN} shots, at"
        f" {at(dose, 'photons', 10):.0f} photons each time, and by the pencil beam once; a pencil beam only puts its photons on a"
        " smaller spot",
    )  # fmt: skip


def _limit(dose: Record) -> Claim:
    from shadowgram.xray.dose import COMMERCIAL

    # The dose is proportional to the open cells but for the walls of the holes.
    parts = [
        f"{shots} shots: {100 * COMMERCIAL[0] / (shots * at(dose, 'shot', 10) * 10):.2g} % open cells"
        for shots in SHOTS
    ]
    return Claim(
        page=None, says="up to which transmittance is a scan below the 0.07 µSv of a commercial scanner (p. 82)?",
        found=f"{', '.join(parts)}; a scan of {ALL_SHOTS} shots with 10 % has {1e6 * ALL_SHOTS * at(dose, 'shot', 10):.2g} µGy."
        " That is the mean over the field of 28 × 28 cm, as if the whole body got it",
        agrees=None,
    )  # fmt: skip


def _coefficients(dose: Record) -> Claim:
    energy, value = (dose.arrays[name].astype(float) for name in ("energy", "coefficient"))
    shown = ", ".join(
        f"{np.exp(np.interp(np.log(e), np.log(energy), np.log(value))):.3g} at {e} keV" for e in (10, 30, 60, 100)
    )
    return Claim(
        page=None, says="how strongly does muscle absorb, by energy (Fig. 4.10, left)?", found=f"cm²/g, {shown}", agrees=None
    )  # fmt: skip


def _quality(dose: Record, images: Sequence[Record]) -> Claim:
    parts = []
    for record in images:
        percent = record.spec["percent"]
        numbers = [
            f"{np.mean(record.values[name]):{f}} ± {np.std(record.values[name]):{f}}"
            for name, f in (("psnr", ".1f"), ("ssim", ".3f"))
        ]
        parts.append(f"{1e6 * SCAN * at(dose, 'shot', percent):.2g} µGy ({percent} %): {numbers[0]} dB, {numbers[1]}")
    return Claim(
        page=None, says="what does the dose buy, in PSNR and SSIM of the hand, with 12.5 % shots?",
        found=f"{'; '.join(parts)} (± over strips and noises)", agrees=None,
    )  # fmt: skip


STUDY = Study(
    name="fig-4-10",
    title="Dose of a scan, and the hand for it",
    source="Fig. 4.10 and section 4.7, pages 82 to 84",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
