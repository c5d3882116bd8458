"""Figs. 4.5 to 4.7: letters, blocks and a hand through masks of 1, 10 and 50 % open cells, from scans of our own.

The source counts with GATE what comes back from three targets, subtracts the air shot by shot, and reconstructs every 4th and
every 2nd of 512 shots (12.5 and 25 % of the 1024 pixels) by ADMM with BM3D and with FFDNet, σ "chosen such that the best
reconstruction is reached"; the truth is a scan with pencil beams. The same is done here with the package's transport: scans with
the walls of the holes, the air and every scattering, at the source's numbers of photons, and pencil beams as in section 4.5.7. The
oracle searches σ and λ for each case and each measure; "blind" is `shadowgram.xray.reconstruct`, which has nothing to choose. The
figures of a case are means over draws of the photons, each with another choice of rows. The study `cxbi-gate` does this with the
source's own counts.
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
from ._cxbi_ways import ORACLES, Shots, picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Panel
    from shadowgram.xray.scan import Scan

PERCENT = (1, 10, 50)
STEPS = {4: "12.5 %", 2: "25 %"}
WAYS = {"oracle-bm3d": "BM3D, oracle", "oracle-ffdnet": "FFDNet, oracle", "blind": "blind"}
"""What is shown: the source's two, and ours."""
MORE_WAYS = ("ffdnet", "bm3d", "consecutive")
"""Blind with one denoiser, and with as many shots that follow one another."""
DRAWS = 2


@dataclass(frozen=True, kw_only=True)
class Spec:
    """A scan, and all that is made of it. Photons are those that are followed; the counts are the source's."""

    target: str
    percent: int
    steps: tuple[int, ...]
    draws: int
    histories: int
    photons: int
    quick: bool


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """Three targets and three masks."""
    histories, photons = (scans.QUICK_HISTORIES, scans.QUICK_PHOTONS) if quick else (scans.HISTORIES, scans.PHOTONS)
    return [
        Spec(
            target=target, percent=percent, steps=tuple(STEPS)[:1] if quick else tuple(STEPS), draws=1 if quick else DRAWS,
            histories=histories, photons=photons, quick=quick,
        )
        for target in (("letters",) if quick else tuple(scans.TARGETS))
        for percent in ((10,) if quick else PERCENT)
    ]  # fmt: skip


def run(spec: Spec, _scene: SceneSource) -> Result:
    """Scan, draw the photons, reconstruct."""
    scan = scans.scan_of(spec.target, spec.percent, spec.histories)
    truth = scans.truth_of(spec.target, spec.photons)
    assert scan.background is not None
    assert scan.image is not None
    values: dict[str, object] = {
        "counts": round(float(scan.counts.mean()), 3), "air": round(float(scan.background.mean()), 3),
        "brightest": round(float(scan.image.max()), 3),
        "views": round(scans.score(scan.image.clip(min=0), truth.target)[0], 4),
    }  # fmt: skip
    arrays = {"truth": truth.counts.astype(np.float32)}
    for step in spec.steps:
        for way in (*WAYS, *MORE_WAYS):
            draws = [_shots(scan, step, way, draw) for draw in range(spec.draws)]
            found, image = scans.judged(
                draws, "blind" if way == "consecutive" else way, scans.grid_of(scan, 1.0, spec.quick),
                lambda image, pedestal: scans.scores(image, pedestal, truth, scan),
            )  # fmt: skip
            values |= {f"{way}_{step}_{name}": value for name, value in found.items()}
            if way in WAYS:
                arrays[f"{way}_{step}"] = image.astype(np.float32)
    return Result(values=values, arrays=arrays)


def _shots(scan: Scan, step: int, way: str, draw: int) -> Shots:
    """Every `step`-th shot, or as many in a row."""
    count = len(scan.counts) // step
    first = draw * count
    taken = slice(first, first + count) if way == "consecutive" else slice(draw, None, step)
    return scans.drawn(scan, taken, 1.0, draw)


def figure(records: Sequence[Record]) -> Figure:
    """For each target and mask the truth, and the images of two compression ratios; PSNR and SSIM over the open cells."""
    from shadowgram.figures.sheet import sheet

    rows: list[list[Panel | None]] = [_pictures(record) for record in records]
    return sheet(
        "Three targets through three masks (Figs. 4.5 to 4.7), from scans of our own; BM3D and FFDNet with an oracle",
        [*rows, _curves(records)],
    )


def _pictures(record: Record) -> list[Panel | None]:
    spec, values = record.spec, record.values
    panels: list[Panel | None] = [
        picture("truth", record.arrays["truth"], f"{spec['target']}, {spec['percent']} % open")
    ]
    for step in spec["steps"]:
        for way, name in WAYS.items():
            caption = f"{values[f'{way}_{step}_psnr_air']:.1f} dB, {values[f'{way}_{step}_ssim_air']:.2f}"
            panels.append(picture(f"{name.partition(',')[0]}, {STEPS[step]}", record.arrays[f"{way}_{step}"], caption))
    return panels


def _curves(records: Sequence[Record]) -> list[Panel | None]:
    from shadowgram.figures.sheet import Curve, Curves

    percents = sorted({r.spec["percent"] for r in records})
    panels: list[Panel | None] = []
    for measure, label in (("psnr", "PSNR (dB)"), ("ssim", "SSIM")):
        curves = {
            f"{name}, {STEPS[step]}": Curve(
                x=percents,
                y=[_mean(common.chosen(records, percent=p), way, step, measure) for p in percents],
                colour=i,
                dash=dash,
            )
            for dash, step in enumerate(records[0].spec["steps"])
            for i, (way, name) in enumerate(WAYS.items())
        }
        panels.append(
            Curves(title="mean of the targets", xlabel="open cells (%)", ylabel=label, curves=curves, log="x")
        )
    return panels


def _mean(records: Sequence[Record], way: str, step: int, measure: str, kind: str = "air") -> float:
    return float(np.mean([r.values[f"{way}_{step}_{measure}_{kind}"] for r in records]))


def _both(records: Sequence[Record], ways: Sequence[str], steps: Sequence[int], kind: str = "air") -> str:
    """Mean PSNR and SSIM over cases, the better way in each of them."""
    psnr, ssim = (
        float(np.mean([max(r.values[f"{way}_{s}_{m}_{kind}"] for way in ways) for r in records for s in steps]))
        for m in scans.MEASURES
    )
    return f"{psnr:.2f}/{ssim:.3f}"


def claims(records: Sequence[Record]) -> list[Claim]:
    """The source says little of these figures in words; the questions are ours."""
    return [
        _adjacent(records), _pencil(records), _blind(records), _denoisers(records), _transmittance(records), _ratio(records),
        _gate(records),
    ]  # fmt: skip


def _steps(records: Sequence[Record]) -> Sequence[int]:
    return records[0].spec["steps"]


def _adjacent(records: Sequence[Record]) -> Claim:
    gains = [
        r.values[f"blind_{s}_psnr_cell"] - r.values[f"consecutive_{s}_psnr_cell"]
        for r in records
        for s in _steps(records)
    ]
    mean, error = float(np.mean(gains)), float(np.std(gains) / np.sqrt(len(gains)))
    better = mean > max(2 * error, 0.1) and len(gains) > 1
    return Claim(
        page=78, says="equidistant patterns are chosen because adjacent ones are correlated",
        found=f"equidistant shots give {mean:+.2f} ± {error:.2f} dB against as many that follow one another, in the mean of"
        f" {len(gains)} cases",
        agrees=better if len(gains) > 1 else None,
        why="" if better else "the scene tells a mask from one that is shifted by a column here",
    )  # fmt: skip


def _pencil(records: Sequence[Record]) -> Claim:
    own = {r.spec["target"]: r for r in records}
    found = "; ".join(f"{target}: {r.values['views']:.1f} dB" for target, r in own.items())
    return Claim(
        page=None, says="how near is the truth of pencil beams (section 4.5.7) to what comes back through each cell of the mask?",
        found=f"PSNR, the air left out of both: {found}. Beams are parallel and narrower than a cell's light, which comes from one"
        " point; no reconstruction can be expected to come nearer",
        agrees=None,
    )  # fmt: skip


def _blind(records: Sequence[Record]) -> Claim:
    cases = [(r, s) for r in records for s in _steps(records)]
    won = [
        sum(r.values[f"blind_{s}_{m}_air"] > max(r.values[f"{way}_{s}_{m}_air"] for way in ORACLES) for r, s in cases)
        for m in scans.MEASURES
    ]
    each = "; ".join(
        f"{r.spec['target']} {r.spec['percent']} % {STEPS[s]}: {_both([r], ['blind'], [s])} against {_both([r], ORACLES, [s])}"
        for r, s in cases
    )
    means = ", ".join(f"{name} {_both(records, [way], _steps(records))}" for way, name in WAYS.items())
    return Claim(
        page=None, says="is a blind reconstruction better than the published method with an oracle?",
        found=f"PSNR (dB)/SSIM, means: {means}; better than the better oracle in {won[0]} and {won[1]} of {len(cases)} cases;"
        f" {each}; against the counts through each cell: "
        + ", ".join(f"{name} {_both(records, [way], _steps(records), 'cell')}" for way, name in WAYS.items()),
        agrees=None,
    )  # fmt: skip


def _denoisers(records: Sequence[Record]) -> Claim:
    names = {
        "oracle-bm3d": "oracle BM3D",
        "oracle-ffdnet": "oracle FFDNet",
        "bm3d": "blind BM3D",
        "ffdnet": "blind FFDNet",
        "blind": "blind, both",
    }
    return Claim(
        page=None, says="which denoiser is the better one, BM3D or FFDNet, in mean PSNR (dB)/SSIM?",
        found="; ".join(f"{name}: {_both(records, [way], _steps(records))}" for way, name in names.items()), agrees=None,
    )  # fmt: skip


def _by_percent(records: Sequence[Record], way: str, kind: str = "air") -> str:
    percents = sorted({r.spec["percent"] for r in records})
    return ", ".join(
        f"{p} % {_both(common.chosen(records, percent=p), [way], _steps(records), kind)}" for p in percents
    )


def _transmittance(records: Sequence[Record]) -> Claim:
    targets = sorted({r.spec["target"] for r in records})
    found = "; ".join(f"{t}: {_by_percent(common.chosen(records, target=t), 'blind')}" for t in targets)
    ways = "; ".join(f"{name}: {_by_percent(records, way)}" for way, name in WAYS.items())
    cell = _by_percent(records, "blind", "cell")
    return Claim(
        page=None, says="how do PSNR (dB)/SSIM follow the transmittance?",
        found=f"{ways}; blind, {found}; blind, against the counts through each cell: {cell}", agrees=None,
    )  # fmt: skip


def _ratio(records: Sequence[Record]) -> Claim:
    found = "; ".join(
        f"{STEPS[s]}: " + ", ".join(f"{name} {_both(records, [way], [s])}" for way, name in WAYS.items())
        for s in _steps(records)
    )
    return Claim(page=None, says="how do PSNR (dB)/SSIM follow the compression ratio?", found=found, agrees=None)


def _gate(records: Sequence[Record]) -> Claim:
    own = [r for r in records if r.spec["target"] != "hand"]
    counts = "; ".join(
        f"{r.spec['target']} {r.spec['percent']} %: {r.values['counts']:.0f}, of the air {r.values['air']:.0f}"
        for r in own
    )
    return Claim(
        page=None, says="do our scans behave as the author's do, of letters and blocks, blind?",
        found=f"PSNR (dB)/SSIM, ours: {_by_percent(own, 'blind')} (his: study cxbi-gate); mean counts of a shot, ours: {counts}",
        agrees=None,
    )  # fmt: skip


STUDY = Study(
    name="fig-4-5",
    title="Three targets through three masks",
    source="Figs. 4.5 to 4.7, pages 77 to 80",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
