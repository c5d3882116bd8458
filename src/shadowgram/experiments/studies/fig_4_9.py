"""Fig. 4.9: the letters through a mask of 1 mm cells, 64 × 64 pixels.

The source halves the pitch of its mask in the same window, keeps the current of 5.12 nA and the compression ratio of 12.5 %, and
finds that "finer details can be seen when using a smaller pitch size; however, due to the fact that the same radiation distributes
over a bigger quantity of pixels, the final obtained contrast abruptly decreases", and before that a smaller pitch recovers finer
details "as long as the radiation per pixel remains the same". Here every 4th of 512 shots is taken through the coarse mask and
every 4th of 2048 through the fine one, on a plate that is as much longer. A third case gives the fine mask four times the current,
so that a cell has as many photons as before. Its holes are twice as deep as they are wide, and near the edge of the window their
walls shade nearly half of the light; "blind, walls" is told so, by `shadowgram.xray.walls`. 10 % of the cells are open, as in Fig.
4.8; the source does not say it here. Scans, truth, oracle and "blind" are those of `fig-4-5`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study

from . import _cxbi_scans as scans
from ._cxbi_ways import AIR_SHARE, Shots, pedestal_of, picture, score

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Panel

TARGET, PERCENT = "letters", 10
COARSE, FINE = 2.0, 1.0
STEP = 4
"""128 of 512 shots and 512 of 2048, 12.5 % of the pixels."""
CASES = {"2 mm": (COARSE, 1.0), "1 mm": (FINE, 1.0), "1 mm, current × 4": (FINE, 4.0)}
WAYS = {"oracle-bm3d": "BM3D, oracle", "oracle-ffdnet": "FFDNet, oracle", "blind": "blind", "walls": "blind, walls"}
WALL_SLOPE = 2 / 150
"""Depth of the holes over their distance from the source."""
DRAWS = 2
ON, OFF = 0.6, 0.1
"""Pixels of the letters and of the ground: above and below these parts of the truth's largest value."""
FEWER = 2
"""The pencil beams of the fine map have as many times fewer photons each."""


@dataclass(frozen=True, kw_only=True)
class Spec:
    """A pitch (mm) and a current in units of 5.12 nA."""

    case: str
    pitch: float
    current: float
    draws: int
    histories: int
    photons: int
    quick: bool


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """The coarse mask, and the fine one with two currents."""
    histories, photons = (scans.QUICK_HISTORIES, scans.QUICK_PHOTONS) if quick else (scans.HISTORIES, scans.PHOTONS)
    return [
        Spec(
            case=case, pitch=pitch, current=current, draws=1 if quick else DRAWS, histories=histories, photons=photons, quick=quick
        )
        for case, (pitch, current) in list(CASES.items())[: 2 if quick else None]
    ]  # fmt: skip


def run(spec: Spec, _scene: SceneSource) -> Result:
    """Reconstruct, and compare with the truth of the same pixels and with that of the fine ones."""
    scan = scans.scan_of(TARGET, PERCENT, spec.histories, spec.pitch)
    fine = scans.truth_of(TARGET, spec.photons // FEWER, FINE)
    truth = fine if spec.pitch == FINE else scans.truth_of(TARGET, spec.photons, spec.pitch)
    draws = [scans.drawn(scan, slice(draw, None, STEP), spec.current, draw) for draw in range(spec.draws)]
    assert scan.image is not None
    values: dict[str, object] = {
        "counts": round(spec.current * float(scan.counts.mean()), 2),
        "shots": len(draws[0].counts),
        "cell": round(spec.current * float(scan.image[_masks(scan.image)[0]].mean()), 4),
    }
    arrays = {"truth": truth.counts.astype(np.float32)}
    pedestal = pedestal_of(draws[0])
    for way in WAYS:
        used, method = (_with_walls(draws), "blind") if way == "walls" else (draws, way)
        found, image = scans.judged(
            used, method, scans.grid_of(scan, spec.current, spec.quick),
            lambda image, pedestal: scans.scores(image, pedestal, truth, scan),
        )  # fmt: skip
        values |= {f"{way}_{name}": value for name, value in found.items()}
        values |= {f"{way}_{name}": value for name, value in _detail(image + AIR_SHARE * pedestal, fine.counts).items()}
        values |= {f"{way}_{name}": value for name, value in _contrast(image, scan.image).items()}
        arrays[way] = image.astype(np.float32)
    return Result(values=values, arrays=arrays)


def _with_walls(draws: Sequence[Shots]) -> list[Shots]:
    """The same shots, with what the walls of the holes leave of the codes."""
    from shadowgram.xray.walls import through_walls

    return [Shots(codes=through_walls(one.codes, WALL_SLOPE), counts=one.counts, air=one.air) for one in draws]


def _masks(truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of the letters, and of the ground."""
    peak = float(np.quantile(truth, 0.99))
    return truth > ON * peak, truth < OFF * peak


def _contrast(image: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Letters less ground: in parts of the true difference, and over the deviation of the pixels within both."""
    on, off = _masks(truth)
    difference = float(image[on].mean() - image[off].mean())
    right = float(truth[on].mean() - truth[off].mean())
    scale = float(np.vdot(image, truth) / max(np.vdot(image, image), 1e-30))
    spread = float(np.sqrt((np.var(image[on]) + np.var(image[off])) / 2))
    return {"share": round(scale * difference / right, 5), "cnr": round(difference / max(spread, 1e-12), 5)}


def on_fine(image: np.ndarray, cells: int) -> np.ndarray:
    """Image on a finer grid of the same field, linear between the centres of its pixels.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.experiments.studies.fig_4_9 import on_fine
    >>> on_fine(np.array([[0.0, 4.0]] * 2), 4)[0]
    array([0., 1., 3., 4.])
    """
    from scipy.ndimage import zoom

    return np.asarray(zoom(image, cells / image.shape[0], order=1, mode="nearest", grid_mode=True))


def _detail(image: np.ndarray, fine: np.ndarray) -> dict[str, float]:
    """PSNR and SSIM against the fine truth, and how much of what the truth has within 2 × 2 pixels is in the image."""
    shown = on_fine(image, len(fine)) if len(image) < len(fine) else image
    psnr, ssim = score(shown, fine)
    scaled = shown * (np.vdot(shown, fine) / max(np.vdot(shown, shown), 1e-30))
    mine, right = _within(scaled), _within(fine)
    return {
        "psnr_fine": round(psnr, 5), "ssim_fine": round(ssim, 5),
        "detail": round(float(np.vdot(mine, right) / np.vdot(right, right)), 5),
        "likeness": round(float(np.vdot(mine, right) / np.sqrt(max(np.vdot(mine, mine), 1e-30) * np.vdot(right, right))), 5),
    }  # fmt: skip


def _within(image: np.ndarray) -> np.ndarray:
    """What is lost in means over 2 × 2 pixels."""
    ny, nx = image.shape
    means = image.reshape(ny // 2, 2, nx // 2, 2).mean(axis=(1, 3))
    return image - np.kron(means, np.ones((2, 2)))


def figure(records: Sequence[Record]) -> Figure:
    """Truth and images of each case."""
    from shadowgram.figures.sheet import sheet

    return sheet("A finer mask (Fig. 4.9), from scans of our own", [_pictures(record) for record in records])


def _pictures(record: Record) -> list[Panel | None]:
    v = record.values
    size = len(record.arrays["truth"])
    panels: list[Panel | None] = [
        picture(
            f"truth, {size} × {size}",
            record.arrays["truth"],
            f"{record.spec['case']}: {v['cell']:.0f} a cell",
        )
    ]
    for way, name in WAYS.items():
        caption = f"{v[f'{way}_psnr_air']:.1f} dB, {v[f'{way}_ssim_air']:.2f}; C/N {v[f'{way}_cnr']:.1f}"
        panels.append(picture(name, record.arrays[way], caption))
    return panels


def claims(records: Sequence[Record]) -> list[Claim]:
    """Details and contrast with a finer mask."""
    coarse, fine, *more = records
    same = [_same_radiation(coarse, one) for one in more]
    return [_details(coarse, fine), _contrasts(coarse, fine), *same, _every(records)]


def _listed(record: Record, name: str, digits: str) -> str:
    return ", ".join(f"{title} {record.values[f'{way}_{name}']:{digits}}" for way, title in WAYS.items())


def _finer(coarse: Record, fine: Record) -> tuple[bool, str]:
    """Whether every way has more of the fine truth's details, and the numbers."""
    more = all(fine.values[f"{way}_detail"] > coarse.values[f"{way}_detail"] for way in WAYS)
    found = "; ".join(
        f"{r.spec['case']}: {_listed(r, 'detail', '.2f')} of the truth's details within 2 × 2 fine pixels, PSNR (dB) against it"
        f" {_listed(r, 'psnr_fine', '.1f')}"
        for r in (coarse, fine)
    )
    return more, found


def _details(coarse: Record, fine: Record) -> Claim:
    more, found = _finer(coarse, fine)
    return Claim(
        page=80, says="finer details can be seen with a smaller pitch, at the same current",
        found=found, agrees=more,
        why="" if more else "with a quarter of the photons in a cell the prior has to smooth more than the finer cells could show",
    )  # fmt: skip


def _contrasts(coarse: Record, fine: Record) -> Claim:
    ratio = fine.values["cell"] / coarse.values["cell"]
    falls = [fine.values[f"{way}_cnr"] < 0.8 * coarse.values[f"{way}_cnr"] for way in WAYS]
    return Claim(
        page=80, says="the same radiation is spread over more pixels, and the contrast abruptly decreases",
        found=f"a cell of the letters gives {fine.values['cell']:.1f} counts and {coarse.values['cell']:.1f}, {ratio:.2f} times as"
        f" many; letters less ground over the deviation within both, 1 mm: {_listed(fine, 'cnr', '.2f')}; 2 mm:"
        f" {_listed(coarse, 'cnr', '.2f')}; letters less ground in parts of the true difference, 1 mm:"
        f" {_listed(fine, 'share', '.2f')}; 2 mm: {_listed(coarse, 'share', '.2f')}",
        agrees=all(falls),
        why="" if all(falls) else "the counts of a shot fall, but 12.5 % of four times as many pixels are four times as many"
        " shots: the scan is longer, and a pixel has its photons after all",
    )  # fmt: skip


def _same_radiation(coarse: Record, more: Record) -> Claim:
    finer, found = _finer(coarse, more)
    return Claim(
        page=78, says="a smaller pitch recovers finer details as long as the radiation per pixel remains the same",
        found=f"{found}; a cell of the letters gives {more.values['cell']:.1f} counts, and {coarse.values['cell']:.1f}",
        agrees=finer,
        why="" if finer else "the details that the finer cells could show are lost in the reconstruction",
    )  # fmt: skip


def _every(records: Sequence[Record]) -> Claim:
    parts = [
        f"{r.spec['case']}, {r.values['shots']} shots of {r.values['counts']:.0f} counts: "
        + ", ".join(
            f"{name} {r.values[f'{way}_psnr_air']:.1f}/{r.values[f'{way}_ssim_air']:.2f}" for way, name in WAYS.items()
        )
        for r in records
    ]
    return Claim(
        page=None, says="what are PSNR (dB)/SSIM, each against pencil beams of its own pitch?", found="; ".join(parts), agrees=None
    )  # fmt: skip


STUDY = Study(
    name="fig-4-9",
    title="Letters through a finer mask",
    source="Fig. 4.9, pages 78 to 81",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
