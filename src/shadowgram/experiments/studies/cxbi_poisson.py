"""The air in the counts: modelled, or subtracted shot by shot, at doses from a thirtieth to ten times the source's.

The source takes its scan once more without the target and subtracts the counts one from the other (4.5.6); at 1 % open cells most
of the counts are air. It holds the noise of photons to be negligible (4.6.2) and independent of the signal (4.4.2). Here the
counts are drawn from scans of our own (`fig-4-5`), every 4th shot, at several doses and through masks of 1, 10 and 50 % open
cells, and are reconstructed with the same prior and schedule in four ways: with the air modelled, smooth in the shot and linear in
the open area, which is `shadowgram.xray.reconstruct`; with the air subtracted shot by shot; with the air's means, which no
measurement could know better; and from counts without any noise. At the source's dose also with least squares in place of the
Poisson likelihood. Images are compared with the counts that come back through each cell. `cxbi-gate` does it with the source's own
counts, at its one dose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study

from . import _common as common
from . import _cxbi_scans as scans
from ._cxbi_ways import Shots, picture, score

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Panel
    from shadowgram.xray.scan import Scan

TARGETS = ("letters", "blocks")
PERCENT = (1, 10, 50)
DOSES = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
"""Photons in units of the source's: 5.12 nA for 15.6 ms a shot."""
HISTORIES = 12_000_000
"""Photons that are followed. With fewer the air's means differ from cell to cell by more than the noise of the largest dose."""
STEP = 4
WAYS = {"blind": "air modelled", "subtracted": "air subtracted", "known": "air known"}
DRAWS = 4
MATTERS = 0.3
"""dB below which a gain is not worth a word; draws of the photons differ by as much."""
NEGLIGIBLE = 0.5
"""dB that noise may cost and still be negligible."""


@dataclass(frozen=True, kw_only=True)
class Spec:
    """A target and a mask, at all doses."""

    target: str
    percent: int
    doses: tuple[float, ...]
    draws: int
    histories: int


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """A task for each target and mask."""
    return [
        Spec(
            target=target, percent=percent, doses=DOSES[1:4:2] if quick else DOSES, draws=1 if quick else DRAWS,
            histories=scans.QUICK_HISTORIES if quick else HISTORIES,
        )
        for target in (TARGETS[:1] if quick else TARGETS)
        for percent in ((10,) if quick else PERCENT)
    ]  # fmt: skip


def run(spec: Spec, _scene: SceneSource) -> Result:
    """Reconstruct in all ways, at all doses."""
    scan = scans.scan_of(spec.target, spec.percent, spec.histories)
    assert scan.background is not None
    assert scan.image is not None
    truth = scan.image.clip(min=0)
    values: dict[str, object] = {
        "counts": round(float(scan.counts.mean()), 3), "air": round(float(scan.background.mean()), 3),
        "variation": round(float(scan.counts.std() / scan.counts.mean()), 5),
    }  # fmt: skip
    arrays = {"truth": truth.astype(np.float32)}
    for dose in spec.doses:
        for way in (*WAYS, "least-squares") if dose == 1 else WAYS:
            found = [_image(scan, way, dose, draw) for draw in range(spec.draws)]
            psnr, ssim = np.mean([score(image, truth) for image in found], axis=0)
            values |= {f"{way}_{dose:g}_psnr": round(float(psnr), 5), f"{way}_{dose:g}_ssim": round(float(ssim), 5)}
            if dose == 1:
                arrays[way] = found[0].astype(np.float32)
    clean = [score(_noiseless(scan, draw), truth) for draw in range(spec.draws)]
    values["clean_psnr"], values["clean_ssim"] = (round(float(one), 5) for one in np.mean(clean, axis=0))
    return Result(values=values, arrays=arrays)


def _image(scan: Scan, way: str, dose: float, draw: int) -> np.ndarray:
    taken = slice(draw, None, STEP)
    shots = scans.drawn(scan, taken, dose, draw)
    if way == "known":
        assert scan.background is not None
        shots = Shots(codes=shots.codes, counts=shots.counts, air=dose * scan.background[taken])
    images, _ = scans.tried(shots, "blind" if way == "known" else way, [])
    return images[0]


def _noiseless(scan: Scan, draw: int) -> np.ndarray:
    """From the means, in whole numbers, which are taken to have the noise of photons: the prior does as much as at dose 1."""
    from shadowgram.xray import reconstruct

    assert scan.background is not None
    taken = slice(draw, None, STEP)
    return reconstruct(scan.codes[taken], np.round(scan.counts[taken]), np.round(scan.background[taken])).x


def figure(records: Sequence[Record]) -> Figure:
    """PSNR over dose for each mask, the gain, and the images at the source's dose."""
    from shadowgram.figures.sheet import sheet

    percents = sorted({r.spec["percent"] for r in records})
    curves: list[Panel | None] = [_curves(common.chosen(records, percent=p), p) for p in percents]
    rows = [_pictures(record) for record in records if record.spec["target"] == records[0].spec["target"]]
    return sheet(
        "The air in the counts: modelled or subtracted; images at the source's dose", [curves, _gains(records), *rows]
    )


def _doses(records: Sequence[Record]) -> list[float]:
    return list(records[0].spec["doses"])


def _mean(records: Sequence[Record], name: str) -> float:
    return float(np.mean([r.values[name] for r in records]))


def _curves(records: Sequence[Record], percent: int) -> Panel:
    from shadowgram.figures.sheet import Curve, Curves

    doses = _doses(records)
    curves = {
        name: Curve(x=doses, y=[_mean(records, f"{way}_{dose:g}_psnr") for dose in doses], colour=i)
        for i, (way, name) in enumerate(WAYS.items())
    }
    clean = Curve(x=[doses[0], doses[-1]], y=[_mean(records, "clean_psnr")] * 2, reference=True)
    return Curves(
        title=f"{percent} % open, {100 * _mean(records, 'air') / _mean(records, 'counts'):.0f} % of the counts air",
        xlabel="photons (source's = 1)", ylabel="PSNR (dB)", log="x", curves={"counts without noise": clean, **curves},
    )  # fmt: skip


def _gains(records: Sequence[Record]) -> list[Panel | None]:
    from shadowgram.figures.sheet import Curve, Curves

    doses = _doses(records)
    percents = sorted({r.spec["percent"] for r in records})
    panels: list[Panel | None] = []
    for measure, label in (("psnr", "gain in PSNR (dB)"), ("ssim", "gain in SSIM")):
        curves = {
            f"{p} % open": Curve(
                x=doses, y=[_gain(common.chosen(records, percent=p), dose, measure) for dose in doses], colour=i
            )
            for i, p in enumerate(percents)
        }
        zero = Curve(x=[doses[0], doses[-1]], y=[0, 0], reference=True)
        panels.append(
            Curves(
                title="air modelled, against subtracted", xlabel="photons (source's = 1)", ylabel=label, log="x",
                curves={"_": zero, **curves},
            )
        )  # fmt: skip
    return panels


def _gain(records: Sequence[Record], dose: float, measure: str = "psnr", over: str = "subtracted") -> float:
    return _mean(records, f"blind_{dose:g}_{measure}") - _mean(records, f"{over}_{dose:g}_{measure}")


def _pictures(record: Record) -> list[Panel | None]:
    panels: list[Panel | None] = [
        picture("truth", record.arrays["truth"], f"{record.spec['target']}, {record.spec['percent']} % open")
    ]
    for way, name in (WAYS | {"least-squares": "least squares"}).items():
        v = record.values
        panels.append(picture(name, record.arrays[way], f"{v[f'{way}_1_psnr']:.1f} dB, {v[f'{way}_1_ssim']:.2f}"))
    return panels


def claims(records: Sequence[Record]) -> list[Claim]:
    """What the source says of air and noise, and what a model of the air gains."""
    return [
        _negligible(records),
        _independent(records),
        _gain_over_dose(records),
        _left(records),
        _least_squares(records),
    ]


def _percents(records: Sequence[Record]) -> list[tuple[int, list[Record]]]:
    return [(p, common.chosen(records, percent=p)) for p in sorted({r.spec["percent"] for r in records})]


def _negligible(records: Sequence[Record]) -> Claim:
    losses, parts = [], []
    for percent, own in _percents(records):
        clean = _mean(own, "clean_psnr")
        both = [clean - _mean(own, f"{way}_1_psnr") for way in ("subtracted", "blind")]
        losses.append(both[0])
        parts.append(
            f"{percent} %: {clean:.1f} dB without noise, {both[0]:.1f} dB less with air subtracted shot by shot,"
            f" {both[1]:.1f} dB less with air modelled, at {_mean(own, 'counts'):.0f} counts a shot"
        )
    agrees = max(losses) < NEGLIGIBLE
    return Claim(
        page=80, says="there are enough photons in a shot to neglect Poisson noise, even for the smallest transmittance",
        found="; ".join(parts), agrees=agrees,
        why="" if agrees else "thousands of counts have a noise of a few percent, but what tells one code from another is a few"
        " percent of them too: most of a count is air, or the mean of the target, which is the same in every shot",
    )  # fmt: skip


def _independent(records: Sequence[Record]) -> Claim:
    variation = {percent: 100 * _mean(own, "variation") for percent, own in _percents(records)}
    apart = max(abs(_gain(own, 1.0, over="least-squares")) for _, own in _percents(records))
    agrees = apart < MATTERS
    return Claim(
        page=74, says="the noise is independent of the signal",
        found="counts differ from shot to shot by "
        + ", ".join(f"{value:.1f} % ({percent} % open)" for percent, value in variation.items())
        + f", and the deviation of their noise by half of that; weights that follow the signal change PSNR by {apart:.2f} dB"
        " at most",
        agrees=agrees,
        why="" if agrees else "the counts of the shots differ too much",
    )  # fmt: skip


def _gain_over_dose(records: Sequence[Record]) -> Claim:
    doses, parts = _doses(records), []
    for percent, own in _percents(records):
        gains = {dose: _gain(own, dose) for dose in doses}
        worth = [dose for dose, gain in gains.items() if gain >= MATTERS]
        where = f"from {min(worth):g} to {max(worth):g} times the source's photons" if worth else "nowhere"
        each = ", ".join(f"{gain:+.2f} ({dose:g})" for dose, gain in gains.items())
        parts.append(f"{percent} % open: {each}; {MATTERS:g} dB or more {where}")
    return Claim(
        page=None, says="what is gained by modelling the air instead of subtracting it (p. 77), in dB by photons, and where does it"
        " stop mattering?",
        found=". ".join(parts), agrees=None,
    )  # fmt: skip


def _left(records: Sequence[Record]) -> Claim:
    parts = []
    for percent, own in _percents(records):
        left = ", ".join(f"{-_gain(own, dose, over='known'):+.2f} ({dose:g})" for dose in _doses(records))
        parts.append(f"{percent} % open: {left}")
    return Claim(
        page=None, says="what would be gained beyond that, in dB by photons, if the air's means were known?",
        found="; ".join(parts), agrees=None,
    )  # fmt: skip


def _over_dose(records: Sequence[Record]) -> Claim:
    parts = []
    for percent, own in _percents(records):
        each = ", ".join(f"{_mean(own, f'blind_{dose:g}_psnr'):.1f} ({dose:g})" for dose in _doses(records))
        parts.append(f"{percent} % open: {each}; without noise {_mean(own, 'clean_psnr'):.1f}")
    return Claim(
        page=None, says="how does PSNR (dB) follow the photons, with the air modelled?",
        found="; ".join(parts) + ". What is missing without noise is due to the few shots, the prior and the model",
        agrees=None,
    )  # fmt: skip


def _least_squares(records: Sequence[Record]) -> Claim:
    parts = [f"{percent} % open: {_gain(own, 1.0, over='least-squares'):+.2f}" for percent, own in _percents(records)]
    return Claim(
        page=None, says="what does the Poisson likelihood gain over least squares, both with the air modelled, in dB?",
        found="; ".join(parts), agrees=None,
    )  # fmt: skip


STUDY = Study(
    name="cxbi-poisson",
    title="The air in the counts: modelled or subtracted",
    source="Sections 4.4.2, 4.5.6 and 4.6.2, pages 74 to 82",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
