"""Figure of the man with a pistol, from the records alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from shadowgram.experiments.study import Record

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Curve, Curves, Panel

SHOTS = (128, 256, 512)
"""3.125, 6.25 and 12.5 % of the pixels, the compression ratios of the source."""
PIXELS = 4096
PICTURED = (0.1, 1.0, 2.5, 5.0, 10.0, 50.0)
ZOOM = 22
GAUSSIAN, POISSON = "gaussian", "poisson"
BLIND, ORACLE = "blind", "oracle-bm3d"
SOLID = 4  # a line through without markers


def chosen(records: Sequence[Record], noise: str = GAUSSIAN, way: str = BLIND, **wanted: float) -> list[Record]:
    """Records of a kind, by transmittance and then by shots."""
    found = [
        r
        for r in records
        if (r.spec["noise"], r.spec["way"]) == (noise, way) and all(r.spec[n] == v for n, v in wanted.items())
    ]
    return sorted(found, key=lambda r: (r.spec["percent"], r.spec["shots"]))


def mean_of(record: Record, name: str) -> tuple[float, float]:
    """Mean over the repetitions, and its standard error; of one alone that is 0.

    Examples
    --------
    >>> from shadowgram.experiments.study import Record
    >>> from shadowgram.experiments.studies._man_panels import mean_of
    >>> mean_of(Record(spec={}, values={"psnr": [20.0, 22.0]}, arrays={}, seconds=1.0), "psnr")
    (21.0, 1.0)
    """
    values = np.array(record.values[name], float)
    error = float(values.std(ddof=1)) / math.sqrt(values.size) if values.size > 1 else 0.0
    return float(values.mean()), error


def compression(record: Record) -> float:
    """% of the pixels that there are shots."""
    return 100 * record.spec["shots"] / PIXELS


def most(records: Sequence[Record]) -> int:
    """Shots of the source's figure of the pistol; in the quick form those with the most transmittances."""
    found = [r.spec["shots"] for r in chosen(records) if r.spec["shots"] in SHOTS]
    return max(set(found), key=lambda shots: (found.count(shots), shots))


def figure(records: Sequence[Record]) -> Figure:
    """Quality over compression and over transmittance, contrast, images and the pistol in them."""
    from shadowgram.figures.sheet import sheet

    rows = [
        [_over_compression(records, *one) for one in (("psnr", "PSNR (dB)"), ("ssim", "SSIM"))],
        [_over_transmittance(records, *one) for one in (("psnr", "PSNR (dB)"), ("ssim", "SSIM"))],
        [_contrast(records), _ways(records)],
        *_pictures(records),
    ]
    return sheet("A man with a pistol (Figs. 4.11 and 4.12); bands: standard error", rows)


def _curve(own: Sequence[Record], name: str, x: Sequence[float], colour: int, *, dash: int = 0) -> Curve:
    from shadowgram.figures.sheet import Curve

    found = [mean_of(r, name) for r in own]
    return Curve(x=x, y=[m for m, _ in found], spread=[e for _, e in found], colour=colour, dash=dash)


def _percents(own: Sequence[Record]) -> list[float]:
    return [r.spec["percent"] for r in own]


def _over_compression(records: Sequence[Record], name: str, label: str) -> Curves:
    from shadowgram.figures.sheet import Curves

    several = sorted({r.spec["percent"] for r in chosen(records) if r.spec["shots"] > most(records)} or {10.0})
    curves = {}
    for number, percent in enumerate(several):
        own = chosen(records, percent=percent)
        curves[f"{percent:g} % open"] = _curve(own, name, [compression(r) for r in own], number)
    return Curves(title=f"{label} over shots", xlabel="shots (% of the pixels)", ylabel=label, curves=curves)


def _over_transmittance(records: Sequence[Record], name: str, label: str) -> Curves:
    from shadowgram.figures.sheet import Curves

    curves = {}
    for number, shots in enumerate(sorted({r.spec["shots"] for r in chosen(records)} & set(SHOTS))):
        own = chosen(records, shots=shots)
        curves[f"{compression(own[0]):g} % shots"] = _curve(own, name, _percents(own), number)
    return Curves(title=f"{label} over transmittance", xlabel="open cells (%)", ylabel=label, log="x", curves=curves)


def _contrast(records: Sequence[Record]) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    own = chosen(records, shots=most(records))
    x = _percents(own)
    truth = Curve(x=x, y=[r.values["true_contrast"] for r in own], reference=True)
    curves = {"truth": truth, "pistol": _curve(own, "contrast", x, 0)}
    curves["its outline elsewhere, at most"] = _curve(own, "elsewhere", x, 3, dash=1)
    oracle = chosen(records, way=ORACLE, shots=most(records))
    if oracle:
        curves["pistol, BM3D with an oracle"] = _curve(oracle, "contrast", _percents(oracle), 1)
    return Curves(
        title=f"contrast (4.16), {compression(own[0]):g} % shots", xlabel="open cells (%)", ylabel="CTR", log="x",
        curves=curves, bottom=0,
    )  # fmt: skip


def _ways(records: Sequence[Record]) -> Curves:
    from shadowgram.figures.sheet import Curves

    names = {
        "blind, σ² = 10⁴": (GAUSSIAN, BLIND),
        "BM3D with an oracle, σ² = 10⁴": (GAUSSIAN, ORACLE),
        "blind, Poisson noise of air and mask": (POISSON, BLIND),
    }
    curves = {}
    for number, (title, (noise, way)) in enumerate(names.items()):
        own = [r for r in chosen(records, noise, way) if r.spec["shots"] in SHOTS]
        own = [r for r in own if r.spec["shots"] == max(one.spec["shots"] for one in own)]
        if own:
            curves[title] = _curve(own, "psnr", _percents(own), number)
    return Curves(
        title="noise and ways of reconstructing", xlabel="open cells (%)", ylabel="PSNR (dB)", log="x", curves=curves
    )


def _pictures(records: Sequence[Record]) -> list[list[Panel | None]]:
    """The truth and images in a row, and the surroundings of the pistol below them."""
    from shadowgram.figures.sheet import Picture

    own = chosen(records, shots=most(records))
    shown = [r for r in own if r.spec["percent"] in PICTURED]
    truth = shown[0].arrays["truth"]
    peak = float(np.quantile(truth, 0.998))
    whole: list[Panel | None] = [
        Picture(title="truth", picture=_grey(truth, peak), caption=f"{truth.max():.0f} counts at most")
    ]
    near: list[Panel | None] = [
        Picture(title="", picture=_near(shown[0], "truth", peak), caption=f"CTR {shown[0].values['true_contrast']:.2f}")
    ]
    for record in shown:
        v = record.values
        whole.append(
            Picture(
                title=f"{record.spec['percent']:g} % open", picture=_grey(record.arrays["image"], peak),
                caption=f"{v['psnr'][0]:.1f} dB, {v['ssim'][0]:.2f}",
            )
        )  # fmt: skip
        near.append(Picture(title="", picture=_near(record, "image", peak), caption=f"CTR {v['contrast'][0]:.2f}"))
    return [whole, near]


def _grey(values: np.ndarray, peak: float) -> np.ndarray:
    return np.clip(values / peak, 0, 1).astype(float)


def _near(record: Record, name: str, peak: float) -> np.ndarray:
    image = record.arrays[name]
    y, x = (
        min(max(0, round(c) - ZOOM // 2), n - ZOOM) for c, n in zip(record.values["centre"], image.shape, strict=True)
    )
    return _grey(image[y : y + ZOOM, x : x + ZOOM], peak)
