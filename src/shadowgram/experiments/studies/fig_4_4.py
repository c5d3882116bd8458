"""Fig. 4.4: the sensing matrix of a backscatter imager with a sliding mask, and what the choice of rows does to it.

The source writes A as its codes, one below the other, C_q = T B_q with T the mask and B_q a selection of N of its columns ((4.10)
to (4.12)), and shows it for 10 shots of a scene of 16 × 16 pixels, whose rows are shifted against each other. Here the matrix of
`shadowgram.CXBI` is compared with that product, number by number. Further on the source takes every 4th or every 2nd of 512 shots
"in order to decrease the correlation between adjacent masks". As vectors, adjacent rows are no more alike than others; but a scene
that changes little from column to column does not tell a mask from one that is shifted by a column. Both correlations are given,
and those of columns and the condition of A, for consecutive and equidistant shots of one mask and for codes that share no cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study

from . import _common as common

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Panel

SHOWN_CELLS, SHOWN_SHOTS, SHOWN_PERCENT = 16, 10, 50
"""Of the picture; the source does not say the transmittance."""
CELLS = 32
PERCENT = (1, 10, 50)
CHOICES = {"consecutive": 1, "every 2nd": 2, "every 4th": 4, "separate codes": 32}
"""How the shots are chosen, and by how many columns the mask moves from one to the next."""
SHOTS = 128
SMOOTH = 4
"""Columns over which a scene is taken to be even."""
MASKS, QUICK_MASKS = 4, 1
ZOOM = 6, 40
"""Rows and columns of the enlarged corner."""


@dataclass(frozen=True, kw_only=True)
class Spec:
    """A matrix: "shown" is that of the picture. Statistics are means over so many masks."""

    kind: str
    percent: int
    shots: int
    choice: str = "consecutive"
    masks: int = 1


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """The picture, and rows chosen in four ways."""
    masks = QUICK_MASKS if quick else MASKS
    return [Spec(kind="shown", percent=SHOWN_PERCENT, shots=SHOWN_SHOTS)] + [
        Spec(kind="statistics", percent=percent, shots=SHOTS, choice=choice, masks=masks)
        for percent in (PERCENT[-1:] if quick else PERCENT)
        for choice in CHOICES
    ]


def run(spec: Spec, _scene: SceneSource) -> Result:
    """Make the matrix, and say how alike its rows and its columns are."""
    if spec.kind == "shown":
        return _shown(spec)
    found = [_statistics(_matrix(spec, seed)) for seed in range(spec.masks)]
    return Result(values={name: round(float(np.mean([one[name] for one in found])), 6) for name in found[0]})


def _mask(rows: int, columns: int, percent: int, seed: int) -> np.ndarray:
    return (np.random.default_rng((seed, percent)).random((rows, columns)) < percent / 100).astype(np.uint8)


def _matrix(spec: Spec, seed: int, cells: int = CELLS) -> np.ndarray:
    """A (shot, pixel) by the package."""
    import shadowgram as sg
    from shadowgram.operators import as_matrix

    step = CHOICES[spec.choice]
    mask = _mask(cells, cells + step * (spec.shots - 1), spec.percent, seed)
    windows = np.lib.stride_tricks.sliding_window_view(mask.any(axis=0), cells)[::step]
    if not windows.any(axis=1).all():  # a shot through a closed mask measures nothing
        return _matrix(spec, seed + MASKS, cells)
    return as_matrix(sg.CXBI(shape=(cells, cells)).operator(mask, step=step))


def plain_matrix(mask: np.ndarray, shots: int) -> np.ndarray:
    """A (shot, pixel) by (4.10) to (4.12), the pixels row by row.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.experiments.studies.fig_4_4 import plain_matrix
    >>> plain_matrix(np.array([[1, 0, 0], [0, 1, 1]]), 2)
    array([[1., 0., 0., 1.],
           [0., 0., 1., 1.]])
    """
    cells = mask.shape[1] - shots + 1
    rows = []
    for q in range(shots):
        chosen = np.zeros((mask.shape[1], cells))
        chosen[q : q + cells] = np.eye(cells)
        rows.append((mask @ chosen).ravel())
    return np.array(rows)


def _shown(spec: Spec) -> Result:
    mask = _mask(SHOWN_CELLS, SHOWN_CELLS + spec.shots - 1, spec.percent, 0)
    ours, plain = _matrix(spec, 0, SHOWN_CELLS), plain_matrix(mask, spec.shots)
    cube = ours.reshape(spec.shots, SHOWN_CELLS, SHOWN_CELLS)
    moved = cube[:-1, :, 1:] == cube[1:, :, :-1]
    new = cube[1:, :, -1]
    values = {
        "shape": list(ours.shape),
        "difference": float(np.abs(ours - plain).max()),
        "code_rows": float(np.mean([np.array_equal(cube[q], mask[:, q : q + SHOWN_CELLS]) for q in range(spec.shots)])),
        "moved": float(moved.mean()),
        "moved_entries": int(moved.size),
        "new_entries": int(new.size),
    }
    return Result(values=values, arrays={"matrix": ours.astype(np.float32), "mask": mask.astype(np.float32)})


def _statistics(matrix: np.ndarray) -> dict[str, float]:
    """Correlations, and the condition of the rows without their means, which say only how bright the scene is."""
    rows, columns = _correlations(matrix), _correlations(matrix[:, matrix.std(axis=0) > 0].T)
    seen = _correlations(_smooth(matrix))
    values = np.linalg.svd(matrix - matrix.mean(axis=1, keepdims=True), compute_uv=False)
    return {
        "adjacent_rows": float(np.sqrt(np.mean(np.diagonal(rows, 1) ** 2))),
        "adjacent_seen": float(np.sqrt(np.mean(np.diagonal(seen, 1) ** 2))),
        "coherence": float(np.abs(columns - np.eye(len(columns))).max()),
        "all_columns": _off_diagonal(columns),
        "condition": float(values[0] / values[-1]),
    }


def _smooth(matrix: np.ndarray) -> np.ndarray:
    """(shot, group) rows as a scene sees them that is even over some columns, wherever its groups of columns begin."""
    codes = matrix.reshape(len(matrix), CELLS, CELLS)
    sums = np.lib.stride_tricks.sliding_window_view(codes, SMOOTH, axis=2).sum(axis=-1)
    return sums.reshape(len(matrix), -1)


def _correlations(vectors: np.ndarray) -> np.ndarray:
    apart = vectors - vectors.mean(axis=1, keepdims=True)
    apart /= np.linalg.norm(apart, axis=1, keepdims=True)
    return apart @ apart.T


def _off_diagonal(matrix: np.ndarray) -> float:
    """Root mean square of what is not on the diagonal."""
    return float(np.sqrt(np.mean(matrix[~np.eye(len(matrix), dtype=bool)] ** 2)))


def figure(records: Sequence[Record]) -> Figure:
    """The mask, two of its codes, A and its enlarged corner; the statistics."""
    from shadowgram.figures.sheet import sheet

    shown = common.only(records, kind="shown")
    return sheet(
        "The sensing matrix of a sliding mask (Fig. 4.4)", [_codes(shown), [_whole(shown)], [_corner(shown)], *_curves(records)]
    )  # fmt: skip


def _codes(shown: Record) -> list[Panel | None]:
    from shadowgram.figures.sheet import Picture

    mask = shown.arrays["mask"]
    codes = [
        Picture(title=f"code of shot {q}", picture=mask[:, q : q + SHOWN_CELLS].astype(float), caption="in view")
        for q in (0, 1, SHOWN_SHOTS - 1)
    ]
    whole = Picture(
        title="mask T", picture=mask.astype(float), caption="slides by a column a shot", width=mask.shape[1] / 16
    )
    return [whole, *codes]


def _whole(shown: Record) -> Panel:
    return _pixels("A, a row for each shot", shown.arrays["matrix"])


def _corner(shown: Record) -> Panel:
    rows, columns = ZOOM
    return _pixels(
        f"its first {columns} columns: rows of the code, which move on", shown.arrays["matrix"][:rows, :columns]
    )


def _pixels(title: str, matrix: np.ndarray) -> Panel:
    from shadowgram.figures.sheet import Heat

    shots, pixels = matrix.shape
    return Heat(
        title=title, values=matrix[::-1].astype(float), extent=(-0.5, pixels - 0.5, shots - 0.5, -0.5),
        xlabel="pixel, row by row", ylabel="shot", unit="", low=0, high=1, colours="gray",
    )  # fmt: skip


def _curves(records: Sequence[Record]) -> list[list[Panel | None]]:
    from shadowgram.figures.sheet import Curve, Curves

    statistics = common.chosen(records, kind="statistics")
    percents = sorted({r.spec["percent"] for r in statistics})
    kinds = {
        "adjacent_rows": ("adjacent rows of A", "correlation (rms)"),
        "adjacent_seen": (f"seen by scenes even over {SMOOTH} columns", "correlation (rms)"),
        "condition": ("condition of A", "largest over smallest σ"),
    }
    return [
        [
            Curves(
                title=title, xlabel=f"columns from shot to shot, {SHOTS} shots", ylabel=label, log="x", bottom=0,
                top=0.85 if name.startswith("adjacent") else None,
                curves={
                    f"{percent} % open": Curve(
                        x=[CHOICES[r.spec["choice"]] for r in common.chosen(statistics, percent=percent)],
                        y=[r.values[name] for r in common.chosen(statistics, percent=percent)], colour=i,
                    )
                    for i, percent in enumerate(percents)
                },
            )
            for name, (title, label) in kinds.items()
        ]
    ]  # fmt: skip


def claims(records: Sequence[Record]) -> list[Claim]:
    """What (4.10) to (4.12) and the figure say, and the correlation of masks."""
    shown, statistics = common.only(records, kind="shown"), common.chosen(records, kind="statistics")
    return [_size(shown), _product(shown), _movement(shown), _correlation(statistics), _condition(statistics)]


def _size(shown: Record) -> Claim:
    shots, pixels = shown.values["shape"]
    return Claim(
        page=74, says="for 10 shots of a scene of 16 × 16 pixels A is 10 × 256", found=f"{shots} × {pixels}",
        agrees=(shots, pixels) == (10, 256),
    )  # fmt: skip


def _product(shown: Record) -> Claim:
    v = shown.values
    return Claim(
        page=73, says="the rows of A are the codes T B_q, of (4.10) to (4.12)",
        found=f"the matrix of CXBI and the product differ by {v['difference']:g} at most; {100 * v['code_rows']:g} % of the rows"
        " are windows of the mask, read row by row",
        agrees=v["difference"] == 0 and v["code_rows"] == 1,
    )  # fmt: skip


def _movement(shown: Record) -> Claim:
    v = shown.values
    return Claim(
        page=74, says="patterns relate to each other by the translation of the mask",
        found=f"A[q + 1, i, j] = A[q, i, j + 1] in {100 * v['moved']:g} % of {v['moved_entries']} entries; the other"
        f" {v['new_entries']} are columns that come into view",
        agrees=v["moved"] == 1,
    )  # fmt: skip


def _each(statistics: Sequence[Record], name: str, digits: str) -> str:
    parts = []
    for percent in sorted({r.spec["percent"] for r in statistics}):
        own = common.chosen(statistics, percent=percent)
        parts.append(f"{percent} %: " + ", ".join(f"{r.values[name]:{digits}} ({r.spec['choice']})" for r in own))
    return "; ".join(parts)


def _correlation(statistics: Sequence[Record]) -> Claim:
    fall = [
        r.values["adjacent_seen"]
        - common.only(statistics, percent=r.spec["percent"], choice="every 4th").values["adjacent_seen"]
        for r in common.chosen(statistics, choice="consecutive")
    ]
    return Claim(
        page=78, says="equidistant patterns have less correlation between adjacent masks than consecutive ones",
        found=f"root mean square of the correlation of adjacent rows, as a scene sees them that is even over {SMOOTH} columns,"
        f" {_each(statistics, 'adjacent_seen', '.3f')}; of the rows themselves, which are random either way,"
        f" {_each(statistics, 'adjacent_rows', '.3f')}",
        agrees=min(fall) > 0.2,
        why="" if min(fall) > 0.2 else "there is no difference that a scene of such a kind would see",
    )  # fmt: skip


def _condition(statistics: Sequence[Record]) -> Claim:
    return Claim(
        page=None, says="do equidistant shots change the columns of A, or its condition?",
        found=f"root mean square of the correlation of columns, {_each(statistics, 'all_columns', '.3f')}. Largest one,"
        f" {_each(statistics, 'coherence', '.2f')}. Condition of the rows without their means,"
        f" {_each(statistics, 'condition', '.2f')}",
        agrees=None,
    )  # fmt: skip


STUDY = Study(
    name="fig-4-4",
    title="The sensing matrix of a sliding mask",
    source="Fig. 4.4 and section 4.4.2, pages 73 to 75",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
