"""Patterns of designed codes: Fig. 3.13, section 3.6.5.

As in the source N = 128 and edge shear: 5 shots and s = 0.046, 10 shots and s = 0.093 and 0.1875, each beside a Boolean code. The
source's weight c1 is not known. Shown are codes with c1 = 20, in the middle of the source's range and the same for all s; the
numbers are also given for c1 from 1 to 140 and for our default, 3.5 (L/Q)², which is 5 for the first two and 20 for the last.

How the open elements of a row lie is told by two numbers. Runs: their mean length over that of chance, above 1 where elements
cluster. Pairs: how often two elements a distance apart are open in the same shot, over chance, below 1 where they keep apart.

What agrees, for c1 from 10 to 70: open elements of a row keep apart within the L columns that a detector element sees, but form
clusters of about two, the more the larger s is. With c1 = 1, at the lower end of the source's range, there are no clusters at any
s. What does not: the source explains the clusters by elements of H other than 0 and 1, which it says are negligible for small s.
They are not: of the elements that are not 0, they are four fifths or more at any of these s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram import codes
from shadowgram.codes._design import design
from shadowgram.experiments.source import CHART_RANGE, SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study
from shadowgram.spectral.sscsi import SSCSI

from . import _common as common

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Curves, Picture

CASES = ((0.046, 5), (0.093, 10), (0.1875, 10))
BOOLEAN, OPTIMISED = "boolean", "optimised"
SHOWN, SMALL = 20.0, 1.0
GRID = (1.0, 2.0, 5.0, 10.0, 20.0, 40.0, 70.0, 140.0)
REACH = 30  # columns
LONGEST = 8  # runs that are told apart
SEEN = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """Codes with seeds 0, 1, ... of one kind; c1 None is the default of the designer."""

    mask_position: float
    shots: int
    kind: str
    c1: float | None
    size: int
    seeds: int


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """Every camera with a Boolean code and designs over c1."""
    grid = (SMALL, SHOWN) if quick else GRID
    kinds = [(BOOLEAN, None), (OPTIMISED, None), *((OPTIMISED, c1) for c1 in grid)]
    return [
        Spec(mask_position=s, shots=shots, kind=kind, c1=c1, size=128, seeds=1 if quick else 4)
        for s, shots in CASES
        for kind, c1 in kinds
    ]


def run(spec: Spec, _scene: SceneSource) -> Result:
    """Statistics, means over the seeds, and the first shot of the first code."""
    imager = SSCSI(
        detector_shape=(spec.size, spec.size), detector_pitch=common.PITCH, code_pitch=common.PITCH,
        mask_position=spec.mask_position, wavelengths=CHART_RANGE, shear="edge",
    )  # fmt: skip
    made = [_code(spec, imager, seed) for seed in range(spec.seeds)]
    values = [_statistics(imager, code) for code, _ in made]
    means = {name: float(np.mean([one[name] for one in values])) for name in values[0]}
    runs = [codes.clusters(code) for code, _ in made]
    pairs = np.mean([pair_correlation(code, REACH) for code, _ in made], axis=0)
    bands = imager.resolution.bands
    arrays = {
        "shot": made[0][0][0], "pairs": pairs.astype(np.float32),
        "runs": np.mean([_shares(one.histogram) for one in runs], axis=0).astype(np.float32),
        "chance": np.mean([_shares(one.chance_histogram) for one in runs], axis=0).astype(np.float32),
    }  # fmt: skip
    means |= {"bands": bands, "c1": made[0][1], "near": float(pairs[0]), "apart": float(pairs[2 : bands - 1].mean())}
    return Result(values=means, arrays=arrays)


def _code(spec: Spec, imager: SSCSI, seed: int) -> tuple[np.ndarray, float]:
    """A code and its c1, 0 for a Boolean one."""
    if spec.kind == BOOLEAN:
        return codes.boolean(shots=spec.shots, shape=imager.code_shape, seed=seed), 0.0
    found = design(imager, shots=spec.shots, seed=seed, c1=spec.c1)
    return found.code, found.weights.c1


def _statistics(imager: SSCSI, code: np.ndarray) -> dict[str, float]:
    """Runs along the rows, and elements of H that are neither 0 nor 1: how many, and their share of those that are not 0."""
    runs = codes.clusters(code)
    seen = imager.effective_code(code)
    gray = int(((seen > SEEN) & (seen < 1 - SEEN)).sum())
    return {
        "clustering": runs.clustering, "mean_run": runs.mean_run, "runs_per_row": runs.runs_per_row,
        "chance_runs_per_row": runs.chance_runs_per_row, "gray": gray, "gray_share": gray / int((seen > SEEN).sum()),
    }  # fmt: skip


def _shares(histogram: np.ndarray) -> np.ndarray:
    """Share of runs of 1, 2, ... elements."""
    return histogram[:LONGEST] / histogram.sum()


def pair_correlation(code: np.ndarray, reach: int) -> np.ndarray:
    """How often two elements of a row are open together, over chance, at distances of 1 ... `reach` columns.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.experiments.studies.fig_3_13 import pair_correlation
    >>> pair_correlation(np.tile([1, 0, 0, 0], (1, 2, 10)), 4).round(2)
    array([0., 0., 0., 4.])
    """
    share = code.mean()
    return np.array([(code[..., d:] & code[..., :-d]).mean() / share**2 for d in range(1, reach + 1)])


def _of(records: Sequence[Record], case: tuple[float, int], kind: str, c1: float | None = None) -> Record:
    return common.only(records, mask_position=case[0], shots=case[1], kind=kind, c1=c1)


def _name(case: tuple[float, int]) -> str:
    return f"s = {case[0]:g}, {case[1]} shots"


def figure(records: Sequence[Record]) -> Figure:
    """Patterns with a part enlarged, pairs and runs."""
    from shadowgram.figures.sheet import sheet

    shown = [
        (_of(records, CASES[0], BOOLEAN), "Boolean, 5 shots"),
        (_of(records, CASES[0], OPTIMISED, SHOWN), _name(CASES[0])),
        (_of(records, CASES[1], BOOLEAN), "Boolean, 10 shots"),
        (_of(records, CASES[1], OPTIMISED, SHOWN), _name(CASES[1])),
        (_of(records, CASES[2], OPTIMISED, SHOWN), _name(CASES[2])),
    ]
    return sheet(
        f"First shots of Boolean and of designed codes, c1 = {SHOWN:g} (Fig. 3.13)",
        [
            [_picture(r, title) for r, title in shown],
            [_enlarged(r) for r, _ in shown],
            [_pairs(records, SHOWN), _pairs(records, SMALL), _clustering(records)],
        ],
    )


SIDE = 32  # elements of the enlarged part, which begins there as well


def _picture(record: Record, title: str) -> Picture:
    from shadowgram.figures.images import Zoom
    from shadowgram.figures.sheet import Picture

    return Picture(title=title, picture=record.arrays["shot"].astype(float), zoom=Zoom(SIDE, SIDE, SIDE))


def _enlarged(record: Record) -> Picture:
    from shadowgram.figures.sheet import Picture

    part = record.arrays["shot"][SIDE : 2 * SIDE, SIDE : 2 * SIDE]
    caption = f"runs {record.values['clustering']:.2f} × chance"
    return Picture(title="", picture=part.astype(float), caption=caption)


def _pairs(records: Sequence[Record], c1: float) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    distance = np.arange(1, REACH + 1)
    boolean = _of(records, CASES[1], BOOLEAN)
    curves = {"Boolean": Curve(x=distance, y=boolean.arrays["pairs"], reference=True)}
    for place, case in enumerate(CASES):
        record = _of(records, case, OPTIMISED, c1)
        curves[f"{_name(case)}, {record.values['bands']} bands"] = Curve(
            x=distance, y=record.arrays["pairs"], colour=place
        )
    return Curves(
        title=f"Open in the same shot, c1 = {c1:g}", xlabel="distance along the row (elements)", ylabel="pairs / chance",
        curves=curves, bottom=0,
    )  # fmt: skip


def _clustering(records: Sequence[Record]) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    curves = {}
    for place, case in enumerate(CASES):
        found = _over_c1(records, case, "clustering")
        curves[_name(case)] = Curve(x=list(found), y=list(found.values()), colour=place)
    chance = [GRID[0], GRID[-1]]
    curves["chance"] = Curve(x=chance, y=[1, 1], reference=True)
    return Curves(title="Clusters over c1", xlabel="c1", ylabel="mean run / chance", curves=curves, log="x")


def _over_c1(records: Sequence[Record], case: tuple[float, int], name: str) -> dict[float, float]:
    there = common.chosen(records, mask_position=case[0], shots=case[1], kind=OPTIMISED)
    return {r.values["c1"]: r.values[name] for r in sorted(there, key=lambda r: r.values["c1"])}


def claims(records: Sequence[Record]) -> list[Claim]:
    """Spread and clusters, what happens with s, the source's reason, and what c1 does."""
    return [_spread(records), _some_clusters(records), _more_with_s(records), _gray(records), _question(records)]


def _listed(records: Sequence[Record], name: str, c1: float | None) -> list[float]:
    return [_of(records, case, OPTIMISED, c1).values[name] for case in CASES]


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.2f}" for value in values)


def _three(records: Sequence[Record], name: str) -> str:
    """A value of the three cameras for three c1, in a sentence."""
    default = ", ".join(f"{c1:.3g}" for c1 in _listed(records, "c1", None))
    return (
        f"{_numbers(_listed(records, name, SHOWN))} (s = 0.046, 0.093, 0.1875; c1 = {SHOWN:g}),"
        f" {_numbers(_listed(records, name, None))} (default, c1 = {default}),"
        f" {_numbers(_listed(records, name, SMALL))} (c1 = {SMALL:g})"
    )


def _spread(records: Sequence[Record]) -> Claim:
    return Claim(
        page=61, says="along a row of the optimal patterns open elements are widely spread",
        found="pairs open 3 to L − 1 columns apart, over chance: " + _three(records, "apart"),
        agrees=all(value < 0.8 for value in _listed(records, "apart", SHOWN)),
    )  # fmt: skip


def _some_clusters(records: Sequence[Record]) -> Claim:
    agrees = all(value > 1.05 for value in _listed(records, "clustering", SHOWN))
    counts = "; ".join(
        f"{_of(records, case, OPTIMISED, SHOWN).values['runs_per_row']:.1f} instead of"
        f" {_of(records, case, OPTIMISED, SHOWN).values['chance_runs_per_row']:.1f} runs in a row of a shot"
        for case in CASES
    )
    return Claim(
        page=61, says="some clusters of open elements are present",
        found=f"mean run over chance {_three(records, 'clustering')}; with c1 = {SHOWN:g} {counts}",
        agrees=agrees,
        why="only if c1 is large enough, about 10 for these numbers of bands and shots",
    )  # fmt: skip


def _more_with_s(records: Sequence[Record]) -> Claim:
    runs = _listed(records, "clustering", SHOWN)
    mean = _listed(records, "mean_run", SHOWN)
    return Claim(
        page=61, says="the clusters become more noticeable as s increases",
        found=f"mean run over chance {_three(records, 'clustering')}; runs of {_numbers(mean)} elements with c1 = {SHOWN:g}",
        agrees=runs == sorted(runs),
    )  # fmt: skip


def _gray(records: Sequence[Record]) -> Claim:
    boolean = [_of(records, case, BOOLEAN).values for case in CASES]
    count = ", ".join(f"{v['gray']:.0f}" for v in boolean)
    share = _numbers([v["gray_share"] for v in boolean])
    designed = _numbers(_listed(records, "gray_share", SHOWN))
    return Claim(
        page=61, says="the clusters grow with s because the elements of H other than 0 and 1 do, negligible for small s",
        found=f"of a Boolean code {count} elements (s = 0.046, 0.093, 0.1875), which are {share} of those that are not 0;"
        f" {designed} after the design with c1 = {SHOWN:g}",
        agrees=boolean[0]["gray_share"] < 0.5 * boolean[-1]["gray_share"],
        why="their number grows because there are more bands. But a voxel sees a window 1 − s columns wide, which lies across an"
        " edge the more often the smaller s is",
    )  # fmt: skip


def _question(records: Sequence[Record]) -> Claim:
    parts = []
    for case in CASES:
        found = _over_c1(records, case, "clustering")
        parts.append(f"{_name(case)}: " + ", ".join(f"{c1:.3g}: {value:.2f}" for c1, value in found.items()))
    return Claim(
        page=None,
        says="how much does c1 decide?",
        found="mean run over chance, over c1: " + "; ".join(parts),
        agrees=None,
    )


STUDY = Study(
    name="fig-3-13",
    title="Patterns of designed codes",
    source="Fig. 3.13, pages 61 to 63",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
