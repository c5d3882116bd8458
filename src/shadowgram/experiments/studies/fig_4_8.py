"""Fig. 4.8: the letters with less current in the tube.

The source lowers the current of its tube from 5.12 to 2.56 and 1.28 nA, with 10 % open cells and 12.5 and 25 % of the shots, and
sees that "when the radiation is not enough, details in the reconstruction are missed; this is reflected in the SSIM and PSNR".
Photons are in proportion to the current. Here the counts are drawn from the means of one scan of our own, for its three currents
and for others on either side. Scans, truth, oracle and "blind" are those of `fig-4-5`; the figures are means over draws of the
photons, each with another choice of rows.
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
from ._cxbi_ways import picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Panel

TARGET, PERCENT, FULL = "letters", 10, 5.12
STATED = (1.28, 2.56, 5.12)
MORE = (0.32, 20.48)
"""Currents in nA, the source's and others."""
STEPS = {4: "12.5 %", 2: "25 %"}
WAYS = {"oracle-bm3d": "BM3D, oracle", "oracle-ffdnet": "FFDNet, oracle", "blind": "blind"}
DRAWS = 2


@dataclass(frozen=True, kw_only=True)
class Spec:
    """One current and compression ratio; photons are those that are followed."""

    current: float
    step: int
    draws: int
    histories: int
    photons: int
    quick: bool


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """The source's currents first."""
    histories, photons = (scans.QUICK_HISTORIES, scans.QUICK_PHOTONS) if quick else (scans.HISTORIES, scans.PHOTONS)
    return [
        Spec(current=current, step=step, draws=1 if quick else DRAWS, histories=histories, photons=photons, quick=quick)
        for current in (STATED[::2] if quick else STATED + MORE)
        for step in (tuple(STEPS)[:1] if quick else STEPS)
    ]


def run(spec: Spec, _scene: SceneSource) -> Result:
    """Draw the photons of this current, and reconstruct."""
    scan = scans.scan_of(TARGET, PERCENT, spec.histories)
    truth = scans.truth_of(TARGET, spec.photons)
    dose = spec.current / FULL
    values: dict[str, object] = {"counts": round(dose * float(scan.counts.mean()), 2)}
    arrays = {"truth": truth.counts.astype(np.float32)}
    draws = [scans.drawn(scan, slice(draw, None, spec.step), dose, draw) for draw in range(spec.draws)]
    for way in WAYS:
        found, image = scans.judged(
            draws, way, scans.grid_of(scan, dose, spec.quick),
            lambda image, pedestal: scans.scores(image, pedestal, truth, scan),
        )  # fmt: skip
        values |= {f"{way}_{name}": value for name, value in found.items()}
        arrays[way] = image.astype(np.float32)
    return Result(values=values, arrays=arrays)


def figure(records: Sequence[Record]) -> Figure:
    """The images of the source's currents, and PSNR and SSIM over all currents."""
    from shadowgram.figures.sheet import sheet

    steps = sorted({r.spec["step"] for r in records}, reverse=True)
    rows: list[list[Panel | None]] = [_pictures(records, current, steps) for current in STATED if _of(records, current)]
    return sheet(
        "Letters with less current (Fig. 4.8), from scans of our own; BM3D and FFDNet with an oracle",
        [*rows, _curves(records, steps)],
    )


def _of(records: Sequence[Record], current: float) -> list[Record]:
    return common.chosen(records, current=current)


def _pictures(records: Sequence[Record], current: float, steps: Sequence[int]) -> list[Panel | None]:
    own = _of(records, current)
    panels: list[Panel | None] = [picture("truth", own[0].arrays["truth"], f"{current:g} nA")]
    for step in steps:
        record = common.only(own, step=step)
        for way, name in WAYS.items():
            v = record.values
            caption = f"{v[f'{way}_psnr_air']:.1f} dB, {v[f'{way}_ssim_air']:.2f}"
            panels.append(picture(f"{name.partition(',')[0]}, {STEPS[step]}", record.arrays[way], caption))
    return panels


def _curves(records: Sequence[Record], steps: Sequence[int]) -> list[Panel | None]:
    from shadowgram.figures.sheet import Curve, Curves

    panels: list[Panel | None] = []
    for measure, label in (("psnr", "PSNR (dB)"), ("ssim", "SSIM")):
        curves = {}
        for dash, step in enumerate(steps):
            own = sorted(common.chosen(records, step=step), key=lambda r: r.spec["current"])
            curves |= {
                f"{name}, {STEPS[step]}": Curve(
                    x=[r.spec["current"] for r in own],
                    y=[r.values[f"{way}_{measure}_air"] for r in own],
                    colour=i,
                    dash=dash,
                )
                for i, (way, name) in enumerate(WAYS.items())
            }
        panels.append(Curves(title="", xlabel="current (nA)", ylabel=label, curves=curves, log="x"))
    return panels


def claims(records: Sequence[Record]) -> list[Claim]:
    """What less radiation does."""
    return [_falls(records), _every(records, "air"), _every(records, "cell")]


def _falls(records: Sequence[Record]) -> Claim:
    stated = [r for r in records if r.spec["current"] in STATED]
    falls, found = {}, []
    for measure, unit in zip(scans.MEASURES, (" dB", ""), strict=True):
        digits = ".2f" if measure == "psnr" else ".3f"
        falls[measure] = [
            common.only(stated, current=FULL, step=r.spec["step"]).values[f"{way}_{measure}_air"]
            - r.values[f"{way}_{measure}_air"]
            for r in stated
            if r.spec["current"] == STATED[0]
            for way in WAYS
        ]
        found.append(f"{measure.upper()} {min(falls[measure]):{digits}} to {max(falls[measure]):{digits}}{unit}")
    counts = {r.spec["current"]: r.values["counts"] for r in stated}
    agrees = all(min(one) > 0 for one in falls.values())
    return Claim(
        page=78, says="with less radiation details are missed, and SSIM and PSNR fall",
        found=f"from {FULL:g} to {STATED[0]:g} nA every way loses: {', '.join(found)}; counts of a shot:"
        f" {', '.join(f'{count:.0f} ({current:g} nA)' for current, count in counts.items())}",
        agrees=agrees,
        why="" if agrees else "the fall is less than what draws of the photons differ by, for some of the ways",
    )  # fmt: skip


def _every(records: Sequence[Record], kind: str) -> Claim:
    against = {"air": "pencil beams, as the source's", "cell": "the counts through each cell, without air"}[kind]
    parts = []
    for step in sorted({r.spec["step"] for r in records}, reverse=True):
        own = sorted(common.chosen(records, step=step), key=lambda r: r.spec["current"])
        for way, name in WAYS.items():
            values = ", ".join(
                f"{r.values[f'{way}_psnr_{kind}']:.1f}/{r.values[f'{way}_ssim_{kind}']:.2f} ({r.spec['current']:g})"
                for r in own
            )
            parts.append(f"{name}, {STEPS[step]}: {values}")
    return Claim(
        page=None, says=f"what are PSNR (dB)/SSIM at each current (nA), with {against} as the truth?",
        found="; ".join(parts), agrees=None,
    )  # fmt: skip


STUDY = Study(
    name="fig-4-8",
    title="Letters with less current in the tube",
    source="Fig. 4.8, pages 78 and 81",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
