"""Table 4.1: mean counts in a shot, for three targets and three transmittances; and whether their Poisson noise can be neglected.

The source counts with GATE, air and all, and concludes from the counts that Poisson noise is negligible. Here the counts are
means by transport through the mask with its real holes: what the target adds, what comes from the air, and what the mask
scatters itself. How much a shot differs from the others is what a reconstruction lives on, so the noise is measured by that.
The letters and blocks are the source's; the hand is of our own making, since the source says nothing of its shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study

from . import _common as common
from . import _cxbi_maps as maps

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Curves

SCENES = {"cxbi-ud": "letters", "cxbi-blocks": "squares", "cxbi-hand": "hand"}
PERCENT = (1, 10, 50)
STATED = {"cxbi-ud": (1.3e3, 3.2e3, 1.27e4), "cxbi-blocks": (1.4e3, 4.5e3, 1.9e4), "cxbi-hand": (1.9e3, 8.7e3, 4e4)}
"""Mean number of photons that arrive at the detectors in one measurement, by transmittance."""
AUTHOR = {
    "cxbi-ud": ((123, 1208), (1197, 2050), (6582, 6125)),
    "cxbi-blocks": ((244, 1208), (2473, 2050), (13298, 6125)),
}
"""The same in the author's files (github.com/Edgar-Noita/CXBI), parted: what the target adds, and counts without it."""
NEAR = 0.15
"""Relative difference up to which counts are taken for the same."""
FEW = 100
"""Photons below which, says the source, Poisson noise matters."""
NEGLIGIBLE = 0.1
"""Noise over the scatter of the shots, up to which it is taken for negligible."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """One scene and transmittance in %, so many shots and photons followed for the response."""

    scene: str
    percent: int
    shots: int
    histories: int


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """All targets and transmittances; the quick form leaves out the 50 %."""
    shots, histories = (64, 60_000) if quick else (512, 1_500_000)
    percents = PERCENT[:2] if quick else PERCENT
    return [
        Spec(scene=scene, percent=percent, shots=shots, histories=histories) for scene in SCENES for percent in percents
    ]


def run(spec: Spec, _scene: SceneSource) -> Result:
    """Mean counts by where they come from, and how they differ from shot to shot."""
    photons = maps.photons_per_shot(spec.scene)
    scan = maps.expected(
        spec.scene, percent=spec.percent, seed=0, shots=spec.shots, step=1, histories=spec.histories, photons=photons
    )
    own = photons * maps.own_scatter(spec.scene, spec.percent, spec.histories)
    signal = scan.counts - scan.air
    return Result(
        values={
            "target": float(signal.mean()), "air": float(scan.air.mean()), "mask": own,
            "scatter": float(signal.std()), "fewest": float((scan.counts + own).min()),
            "cell": float(scan.image.max()),
        }
    )  # fmt: skip


def total(record: Record) -> float:
    """Counts in a shot."""
    return sum(record.values[name] for name in ("target", "air", "mask"))


def noise(record: Record) -> float:
    """Standard deviation of the counts less those without the target, shot by shot, as the source subtracts them."""
    return float(np.sqrt(total(record) + record.values["air"] + record.values["mask"]))


def figure(records: Sequence[Record]) -> Figure:
    """Counts beside the source's, where they come from, and signal and noise."""
    from shadowgram.figures.sheet import sheet

    targets = [common.chosen(records, scene=scene) for scene in SCENES]
    return sheet(
        "Counts in a shot (Table 4.1); broad and pale: source",
        [[_counts(own) for own in targets], [_scatter(own) for own in targets]],
    )


def _counts(own: Sequence[Record]) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    x = [r.spec["percent"] for r in own]
    scene = own[0].spec["scene"]
    stated = [STATED[scene][PERCENT.index(p)] for p in x]
    curves = {"_source": Curve(x=x, y=stated, reference=True), "all": Curve(x=x, y=[total(r) for r in own])}
    for number, (name, title) in enumerate({"target": "target", "air": "air", "mask": "mask"}.items(), 1):
        curves[title] = Curve(x=x, y=[r.values[name] for r in own], colour=number, dash=number)
    return Curves(
        title=SCENES[scene], xlabel="open cells (%)", ylabel="counts in a shot", log="xy", curves=curves, bottom=50, top=6e4
    )  # fmt: skip


def _scatter(own: Sequence[Record]) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    x = [r.spec["percent"] for r in own]
    return Curves(
        title=f"{SCENES[own[0].spec['scene']]}: from shot to shot", xlabel="open cells (%)",
        ylabel="standard deviation (counts)", log="xy", bottom=10, top=2e3,
        curves={
            "what the target gives": Curve(x=x, y=[r.values["scatter"] for r in own], colour=1),
            "Poisson noise": Curve(x=x, y=[noise(r) for r in own], colour=3, dash=1),
        },
    )  # fmt: skip


def claims(records: Sequence[Record]) -> list[Claim]:
    """The rows of the table, and what the source concludes from them."""
    return [
        *(_row(common.chosen(records, scene=scene)) for scene in SCENES),
        _many(records),
        _negligible(records),
        _parted(records),
    ]


def _row(own: Sequence[Record]) -> Claim:
    scene = own[0].spec["scene"]
    parts, apart = [], []
    for record in own:
        stated, v = STATED[scene][PERCENT.index(record.spec["percent"])], record.values
        apart.append(total(record) / stated - 1)
        parts.append(
            f"{record.spec['percent']} %: {total(record):.0f} ({v['target']:.0f} of the target, {v['air']:.0f} of the air and"
            f" {v['mask']:.0f} of the mask itself) beside {stated:.0f}, {100 * apart[-1]:+.0f} %"
        )
    agrees = all(abs(one) <= NEAR for one in apart)
    listed = ", ".join(f"{stated:.0f}" for stated in STATED[scene])
    return Claim(
        page=82, says=f"{SCENES[scene]}: {listed} photons arrive in one measurement at 1, 10 and 50 % transmittance",
        found="; ".join(parts), agrees=agrees, why="" if agrees else _why(scene),
    )  # fmt: skip


def _why(scene: str) -> str:
    """What is known of a difference."""
    if scene in AUTHOR:
        return f"they are apart by more than {100 * NEAR:g} %"
    return "what the target gives goes with its area and thickness, and the source says neither; the hand of the scene is ours"


def _parted(records: Sequence[Record]) -> Claim:
    parts = []
    for scene, author in AUTHOR.items():
        for record in common.chosen(records, scene=scene):
            v, (target, without) = record.values, author[PERCENT.index(record.spec["percent"])]
            ours = v["air"] + v["mask"]
            parts.append(
                f"{SCENES[scene]} {record.spec['percent']} %: {v['target']:.0f} of the target beside {target}, and {ours:.0f}"
                f" beside {without}"
            )
    return Claim(
        page=None, says="are the counts of the target, and those without it, what the author's own files have?",
        found="; ".join(parts), agrees=None,
    )  # fmt: skip


def _many(records: Sequence[Record]) -> Claim:
    fewest = min(r.values["fewest"] for r in records)
    return Claim(
        page=80, says=f"the photons in a measurement are more than the {FEW} below which their noise is of Poisson's kind",
        found=f"{fewest:.0f} counts in the poorest of all shots", agrees=fewest > FEW,
        why="" if fewest > FEW else "few holes are in view in some shots",
    )  # fmt: skip


def _negligible(records: Sequence[Record]) -> Claim:
    parts, worst = [], 0.0
    for record in records:
        worst = max(worst, noise(record) / record.values["scatter"])
        parts.append(
            f"{SCENES[record.spec['scene']]} {record.spec['percent']} %: {noise(record):.0f} and {record.values['scatter']:.0f}"
        )
    agrees = worst <= NEGLIGIBLE
    return Claim(
        page=80, says="Poisson noise can safely be neglected, even for the smallest transmittance",
        found="noise of a shot less its air, and standard deviation from shot to shot of what the target gives: " + ","
        " ".join(parts),
        agrees=agrees,
        why="" if agrees else "a count of thousands has a small relative error, but most of it is the same in all shots; the"
        f" picture is in the differences, of which the noise is up to {100 * worst:.0f} %",
    )  # fmt: skip


STUDY = Study(
    name="table-4-1",
    title="Counts in a shot, and their noise",
    source="Table 4.1 and section 4.6.2, pages 80 to 82",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
