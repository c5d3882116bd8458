"""Figs. 4.5 to 4.7: the author's simulated scans, reconstructed blind and as he did it.

He counts with GATE what comes back from two targets, letters of aluminium ("UD") and four blocks ("box"), through masks of 1, 10
and 50 % open cells, and from the air alone. He subtracts the air shot by shot and reconstructs by ADMM with BM3D or FFDNet, with
"the standard deviation of the noise … chosen such that the best reconstruction is reached". Here that oracle searches a grid of
σ and λ for each case and each measure; `shadowgram.xray.reconstruct` does without it. A case is a target, a transmittance and a
compression ratio; its figures are means over all choices of equidistant rows. The truth is his scan with pencil beams, in which the
air counts too. The data are his, and not shipped: name their folder with ``--data``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from shadowgram.experiments import data_folder
from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study

from . import _common as common
from ._cxbi_ways import AIR_SHARE, ORACLES, Shots, oracle_images, pedestal_of, picture, score, subtracted
from .cxbi_laboratory import ORIGIN, scan_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Panel
    from shadowgram.xray import Reconstruction

TARGETS = {"UD": "UD", "box": "square"}
"""As the counts are called, and the truth."""
PERCENT = (1, 10, 50)
STEPS = {4: "12.5 %", 2: "25 %", 1: "50 %"}
"""Every so manieth of the 512 shots, and their share of the 1024 pixels."""
TABLE_STEPS = (4, 2)
NAMES = {"oracle-bm3d": "BM3D: ", "oracle-ffdnet": "FFDNet: "}
WAYS = {
    "blind": "blind",
    "walls": "blind, with the walls of the holes in the model",
    "least-squares": "blind, least squares in place of the Poisson likelihood",
    "subtracted": "blind, but the air subtracted shot by shot",
    "ffdnet": "blind, FFDNet alone",
    "bm3d": "blind, BM3D alone",
}
SIGMAS, STRENGTHS = (6.0, 9.0, 13.0, 19.0, 28.0, 40.0), (0.3, 1.0, 3.0)
"""The oracle's grid: σ in counts, and λ in units of the variance of the counts. From σ 4 and λ 0.03 on the means are the same."""
WALL_SLOPE = 2 / 150
"""Depth of the holes over their distance from the source."""
TRUTH_DIGEST = "071341b2433fa738"


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """One case and a way of reconstructing it, for all choices of rows or the first `rows` of them."""

    target: str
    percent: int
    step: int
    way: str
    rows: int


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """All cases; the parts of the method are compared in the cases of the table."""
    targets, percents, steps = (("box",), (50,), (4,)) if quick else (tuple(TARGETS), PERCENT, tuple(STEPS))
    return [
        Spec(target=target, percent=percent, step=step, way=way, rows=1 if quick else step)
        for way in ("blind", *ORACLES, *list(WAYS)[1:])
        for target in targets
        for percent in percents
        for step in (steps if way in ("blind", *ORACLES) else [one for one in steps if one in TABLE_STEPS])
    ]


@lru_cache(maxsize=1)
def truths() -> Mapping[str, np.ndarray]:
    """(y, x) counts of the pencil beams, by target."""
    from scipy.io import loadmat

    path = data_folder.find("cxbi/gate/ground_truth_UD_square.mat", TRUTH_DIGEST, ORIGIN)
    held = loadmat(path)
    return {name: held[key].astype(np.float64) for name, key in TARGETS.items()}


def run(spec: Spec, _scene: SceneSource) -> Result:
    """Reconstruct from every choice of rows."""
    found = [_oracle(spec, row) if spec.way in ORACLES else _blind(spec, row) for row in range(spec.rows)]
    scores = np.mean([scores for scores, _, _ in found], axis=0)  # ([setting,] without or with air, measure)
    values: dict[str, object] = {"spread": float(np.std([one[0].reshape(-1, 2, 2)[:, 1, 0].max() for one in found]))}
    best = scores.reshape(-1, 2, 2)
    for i, name in enumerate(("bare", "air")):
        for j, measure in enumerate(("psnr", "ssim")):
            values[f"{measure}_{name}"] = float(best[:, i, j].max())
    setting = int(best[:, 1, 0].argmax())
    if spec.way in ORACLES:
        values["setting"] = [float(one) for one in _grid()[setting]]
    image, details = found[0][1][setting], found[0][2]
    arrays = {"image": image.astype(np.float32), "truth": truths()[spec.target].astype(np.float32)}
    return Result(values=values | details, arrays=arrays)


def _grid() -> list[tuple[float, float]]:
    return [(sigma, strength) for sigma in SIGMAS for strength in STRENGTHS]


def _rows(spec: Spec, row: int) -> Shots:
    """Every `step`-th shot from `row` on."""
    folder = spec.percent
    scan = scan_of(f"{folder}/code_it1", f"{folder}/y_{spec.target}", f"{folder}/y_air")
    assert scan.background is not None
    taken = slice(row, None, spec.step)
    return Shots(codes=scan.codes[taken], counts=scan.counts[taken], air=scan.background[taken])


Found = tuple[np.ndarray, list[np.ndarray], dict[str, float]]


def _blind(spec: Spec, row: int) -> Found:
    """Scores, image and what the data said of themselves."""
    import shadowgram as sg
    from shadowgram.xray.walls import through_walls

    shots = _rows(spec, row)
    used = through_walls(shots.codes, WALL_SLOPE) if spec.way == "walls" else shots.codes
    denoiser = spec.way if spec.way in ("ffdnet", "bm3d") else ("ffdnet", "bm3d")
    if spec.way == "subtracted":
        x = subtracted(shots)
        return _scores(x, pedestal_of(shots), spec.target)[None], [x], {}
    likelihood = "least-squares" if spec.way == "least-squares" else "poisson"
    found = sg.xray.reconstruct(used, shots.counts, shots.air, denoiser=denoiser, likelihood=likelihood)
    return _scores(found.x, found.pedestal, spec.target)[None], [found.x], _details(found)


def _details(found: Reconstruction) -> dict[str, float]:
    return {
        "chi2": found.chi2, "dispersion": found.dispersion, "pedestal": found.pedestal, "sigma": found.sigma,
        "seconds": float(found.history["seconds"][-1]),
    }  # fmt: skip


def _oracle(spec: Spec, row: int) -> Found:
    """Scores and images of all settings of the grid, with the source's difference of the counts."""
    shots = _rows(spec, row)
    pedestal = pedestal_of(shots)
    images = oracle_images(shots, spec.way, _grid())
    return np.array([_scores(x, pedestal, spec.target) for x in images]), images, {}


def _scores(x: np.ndarray, pedestal: float, target: str) -> np.ndarray:
    """(without or with air, PSNR or SSIM)."""
    return np.array([score(x + share * pedestal, truths()[target]) for share in (0.0, AIR_SHARE)])


def figure(records: Sequence[Record]) -> Figure:
    """For each target and transmittance the truth, and the compression ratios: blind, and the better oracle."""
    from shadowgram.figures.sheet import sheet

    cases = sorted({(r.spec["target"], r.spec["percent"]) for r in records})
    return sheet(
        "The author's scans (Figs. 4.5 to 4.7): blind, and with an oracle", [_row(records, *case) for case in cases]
    )


def _row(records: Sequence[Record], target: str, percent: int) -> list[Panel | None]:
    own = common.chosen(records, target=target, percent=percent)
    steps = sorted({r.spec["step"] for r in own}, reverse=True)
    panels: list[Panel | None] = [picture("truth", own[0].arrays["truth"], f"{target}, {percent} % open")]
    for step in steps:
        better = max((common.only(own, step=step, way=way) for way in ORACLES), key=lambda r: r.values["psnr_air"])
        for record, name in ((common.only(own, step=step, way="blind"), "blind"), (better, "oracle")):
            v, way = record.values, NAMES.get(record.spec["way"], "")
            caption = f"{way}{v['psnr_air']:.1f} dB, {v['ssim_air']:.2f}"
            panels.append(picture(f"{name}, {STEPS[step]}", record.arrays["image"], caption))
    return panels


def claims(records: Sequence[Record]) -> list[Claim]:
    """The source's trends, and the comparisons that it does not make."""
    table = [r for r in records if r.spec["step"] in TABLE_STEPS]
    return [
        _against_oracle(table, "air", "with the air of the pencil beams added to both"),
        _against_oracle(table, "bare", "as they are, without the air that is in the truth"),
        _parts(table),
        _air(table),
        _transmittance(records),
        _all_shots(records),
    ]


def _mean(records: Sequence[Record], way: str, kind: str = "air") -> str:
    own = common.chosen(records, way=way)
    return "/".join(
        f"{np.mean([r.values[f'{m}_{kind}'] for r in own]):{digits}}"
        for m, digits in (("psnr", ".2f"), ("ssim", ".3f"))
    )


def _against_oracle(table: Sequence[Record], kind: str, how: str) -> Claim:
    blind = common.chosen(table, way="blind")
    won = {"psnr": 0, "ssim": 0}
    cases = []
    for record in blind:
        case = {name: record.spec[name] for name in ("target", "percent", "step")}
        better = {m: max(common.only(table, way=way, **case).values[f"{m}_{kind}"] for way in ORACLES) for m in won}
        for m in won:
            won[m] += record.values[f"{m}_{kind}"] > better[m]
        v = record.values
        cases.append(
            f"{case['target']} {case['percent']} % {STEPS[case['step']]}: {v[f'psnr_{kind}']:.1f}/{v[f'ssim_{kind}']:.2f}"
            f" against {better['psnr']:.1f}/{better['ssim']:.2f}"
        )
    means = ", ".join(f"{way} {_mean(table, way, kind)}" for way in ("blind", *ORACLES))
    return Claim(
        page=None, says=f"is a blind reconstruction better than the published method with an oracle, images compared {how}?",
        found=f"PSNR (dB)/SSIM, means: {means}; better than the better oracle in {won['psnr']} and {won['ssim']} of"
        f" {len(blind)} cases; {'; '.join(cases)}",
        agrees=None,
    )  # fmt: skip


def _parts(table: Sequence[Record]) -> Claim:
    found = "; ".join(f"{title}: {_mean(table, way)}" for way, title in WAYS.items())
    return Claim(
        page=None, says="what is each part of the method worth, in mean PSNR (dB)/SSIM?", found=found, agrees=None
    )


def _air(table: Sequence[Record]) -> Claim:
    gains = []
    for percent in sorted({r.spec["percent"] for r in table}):
        psnr, ssim = (
            [
                np.mean([r.values[f"{m}_air"] for r in common.chosen(table, way=way, percent=percent)])
                for way in ("blind", "subtracted")
            ]
            for m in ("psnr", "ssim")
        )
        gains.append(f"{percent} %: {psnr[0] - psnr[1]:+.2f}/{ssim[0] - ssim[1]:+.3f}")
    return Claim(
        page=None, says="what is gained by modelling the air instead of subtracting it shot by shot (p. 77), in PSNR (dB)/SSIM?",
        found="; ".join(gains), agrees=None,
    )  # fmt: skip


def _transmittance(records: Sequence[Record]) -> Claim:
    blind = common.chosen(records, way="blind")
    percents = sorted({r.spec["percent"] for r in blind})
    found = "; ".join(f"{p} %: {_mean(common.chosen(blind, percent=p), 'blind')}" for p in percents)
    return Claim(
        page=None, says="how do PSNR (dB)/SSIM follow the transmittance, in the mean over targets and compression ratios?",
        found=found, agrees=None,
    )  # fmt: skip


def _all_shots(records: Sequence[Record]) -> Claim:
    steps = sorted({r.spec["step"] for r in records}, reverse=True)
    found = "; ".join(
        f"{STEPS[s]}: "
        + ", ".join(f"{way} {_mean(common.chosen(records, step=s), way)}" for way in ("blind", *ORACLES))
        for s in steps
    )
    return Claim(
        page=None, says="how do PSNR (dB)/SSIM follow the compression ratio, all 512 shots included?", found=found, agrees=None
    )  # fmt: skip


STUDY = Study(
    name="cxbi-gate",
    title="The author's simulated scans, reconstructed blind",
    source="Figs. 4.5 to 4.7, pages 79 and 80",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
    data=ORIGIN,
)
