"""Cost of a sweep of the design over N, L and Q: Table 3.1, section 3.6.1.

Two ways through the same sweep: Algorithm 1 as it is printed (`_plain.PlainBoard`), which evaluates the local cost anew for every
shot of every element, and `shadowgram.codes.design`, which looks the cost of pairs up in tables and keeps the fields of the
repulsion up to date. Both visit the same elements in the same order and must find the same code. Measured is the processor time
of the thread, in turn and after a warm-up, the least of several rounds: of one sweep and the whole cost (lines 4 to 15) of the
plain way, and of the mean of the first six sweeps of ours. s = L/N, edge shear.

What agrees: the plain way grows as the table says. One thing it passes over: line 10 sums over the shots, which would be another
factor Q; it can be spared because an element is open in one shot. Our way finds the same codes, grows about like L and hardly
with Q. With repulsion it grows faster than N² at large N, where the fields of all shots outgrow the caches of the processor.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from shadowgram import codes
from shadowgram.codes._design import default_c1
from shadowgram.experiments.source import CHART_RANGE, SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study
from shadowgram.spectral.sscsi import SSCSI

from . import _common as common

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Curves

PLAIN, TABLES, ALONE = "plain", "tables", "alone"
NAMES = {PLAIN: "Algorithm 1 as printed", TABLES: "shadowgram", ALONE: "shadowgram, no repulsion"}
AXES = {"size": "N", "bands": "L", "shots": "Q"}
LEAST = 2  # rounds
SWEEPS = 6  # of ours, whose later ones are cheaper; the source needs 6 to 8
MOST_BANDS = 24  # with which the plain way takes a few seconds


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """One size, and the seconds to spend on it, at least."""

    size: int
    bands: int
    shots: int
    seconds: float
    seed: int


def sizes(quick: bool) -> dict[str, list[tuple[int, int, int]]]:
    """Axis → (N, L, Q); each varies one of them."""
    if quick:
        return {
            "size": [(n, 8, 4) for n in (32, 64, 128)],
            "bands": [(64, bands, 4) for bands in (4, 8, 16)],
            "shots": [(64, 8, q) for q in (2, 4, 8)],
        }
    return {
        "size": [(n, 12, 8) for n in (64, 128, 256, 512)],
        "bands": [(256, bands, 8) for bands in (6, 12, 24, 48)],
        "shots": [(128, 12, q) for q in (2, 4, 8, 16)],
    }


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """Every size once."""
    every = list(dict.fromkeys(size for axis in sizes(quick).values() for size in axis))
    return [Spec(size=n, bands=bands, shots=q, seconds=0.1 if quick else 3.0, seed=0) for n, bands, q in every]


def run(spec: Spec, _scene: SceneSource) -> Result:
    """Seconds of a sweep in every way, measured in turn so that what disturbs one disturbs all; and whether they find the same."""
    boards, orders = _boards(spec), _orders(spec)
    for new in boards.values():
        _warm(new(), orders[0][0])
    taken: dict[str, list[float]] = {way: [] for way in (*boards, "cost")}
    found: dict[str, Any] = {}
    rounds, begun = 0, time.thread_time()
    while rounds < LEAST or time.thread_time() - begun < spec.seconds:
        for way, new in boards.items():
            found[way] = new()
            if way == PLAIN:
                taken[way].append(_seconds(found[way], orders[:1]))
                taken["cost"].append(_cost_seconds(found[way]))
            else:
                taken[way].append(_seconds(found[way], orders) / SWEEPS)
        rounds += 1
    values: dict[str, Any] = {way: min(seconds) for way, seconds in taken.items() if seconds}
    if PLAIN in values:
        values[PLAIN] += values["cost"]  # lines 4 to 15
        values |= _compared(found[PLAIN], boards[TABLES](), orders[0])
    return Result(values=values | {"rounds": rounds})


def _boards(spec: Spec) -> dict[str, Callable[[], Any]]:
    """Way → what makes a new board of it, with the Boolean code that the designs begin with."""
    from shadowgram.codes._board import Board

    from ._plain import PlainBoard

    imager = SSCSI(
        detector_shape=(spec.size, spec.size), detector_pitch=common.PITCH, code_pitch=common.PITCH,
        mask_position=spec.bands / spec.size, wavelengths=CHART_RANGE, shear="edge",
    )  # fmt: skip
    start = codes.boolean(shots=spec.shots, shape=imager.code_shape, seed=spec.seed)
    c1, table = default_c1(spec.bands, spec.shots), imager.pair_table()
    ours: dict[str, Callable[[], Any]] = {
        TABLES: lambda: Board(table, start, c1=c1, repulsion=1.0, coupling=0.0, wrap=False),
        ALONE: lambda: Board(table, start, c1=c1, repulsion=0.0, coupling=0.0, wrap=False),
    }
    if spec.bands > MOST_BANDS:
        return ours
    return {
        PLAIN: lambda: PlainBoard(
            start, mask_position=imager.mask_position, bands=imager.resolution.bands, c1=c1, repulsion=1.0
        )
    } | ours


def _orders(spec: Spec) -> list[tuple[np.ndarray, np.ndarray]]:
    """Order of the visits, and state of the random numbers, of every sweep."""
    rng = np.random.default_rng(spec.seed)
    return [(rng.permutation(spec.size**2), rng.integers(1 << 63, size=1, dtype=np.uint64)) for _ in range(SWEEPS)]


def _warm(board: Any, order: np.ndarray) -> None:
    """Compile, and fill the caches."""
    board.sweep(order[: len(order) // 16], np.zeros(1, np.uint64))
    board.cost()


def _seconds(board: Any, orders: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    begun = time.thread_time()
    for order, state in orders:
        board.sweep(order, state.copy())
    return time.thread_time() - begun


def _cost_seconds(board: Any) -> float:
    begun = time.thread_time()
    board.cost()
    return time.thread_time() - begun


def _compared(plain: Any, ours: Any, first: tuple[np.ndarray, np.ndarray]) -> dict[str, float | int | bool]:
    """Whether ours finds the code and the cost that the plain way has found in its sweep; and how many voxels a move affects."""
    ours.sweep(first[0], first[1].copy())
    affected = plain.affected()
    return {
        "same_code": bool(np.array_equal(plain.code, ours.code)), "cost_error": abs(ours.cost() / plain.cost() - 1),
        "affected": float(affected.mean()), "most_affected": int(affected.max()),
    }  # fmt: skip


def formula(size: int, bands: int, shots: int) -> float:
    """Operations of an iteration, Table 3.1: 2N²L²(1 + Q).

    Examples
    --------
    >>> from shadowgram.experiments.studies.table_3_1 import formula
    >>> formula(128, 12, 8)
    42467328
    """
    return 2 * size**2 * bands**2 * (1 + shots)


def _along(records: Sequence[Record], axis: str, value: str) -> tuple[list[int], list[float]]:
    """Sizes along an axis, and a value at each that has it."""
    x, y = [], []
    for n, bands, shots in sizes(_quick(records))[axis]:
        record = common.only(records, size=n, bands=bands, shots=shots)
        if value in record.values:
            x.append(record.spec[axis])
            y.append(record.values[value])
    return x, y


def _quick(records: Sequence[Record]) -> bool:
    return max(r.spec["size"] for r in records) < 256


def _plain(records: Sequence[Record]) -> list[Record]:
    """Records of sizes that the plain way was tried at."""
    return [r for r in records if PLAIN in r.values]


def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Exponent of the growth of y with x, by least squares of the logarithms.

    Examples
    --------
    >>> from shadowgram.experiments.studies.table_3_1 import slope
    >>> round(slope([1, 2, 4], [3, 12, 48]), 6)
    2.0
    """
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def figure(records: Sequence[Record]) -> Figure:
    """Times over N, L and Q, in those of the plain way at one size, with the growth of the formula."""
    from shadowgram.figures.sheet import sheet

    unit = f"Algorithm 1 takes 1 at {_size(_unit(records))}"
    drawn = sheet(
        f"Processor time of a sweep of the design (Table 3.1): {unit}", [[_panel(records, axis) for axis in AXES]]
    )
    for axes, axis in zip(drawn.axes, AXES, strict=True):
        _exponents(axes, records, axis)
    return drawn


def _unit(records: Sequence[Record]) -> Record:
    """The size on two axes where the plain way takes 1."""
    first, _, last = sizes(_quick(records)).values()
    n, bands, shots = next(one for one in first if one in last)
    return common.only(records, size=n, bands=bands, shots=shots)


def _panel(records: Sequence[Record], axis: str) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    unit = _unit(records).values[PLAIN]
    every = sizes(_quick(records))[axis]
    stated = np.array([formula(*size) for size in every])
    x, y = _along(records, axis, PLAIN)
    whole, _ = _along(records, axis, TABLES)
    curves = {"2N²L²(1 + Q)": Curve(x=whole, y=stated * y[0] / unit / stated[0], reference=True)}
    for number, (way, name) in enumerate(NAMES.items()):
        x, y = _along(records, axis, way)
        curves[name] = Curve(x=x, y=np.array(y) / unit, colour=number)
    others = ", ".join(f"{name} = {every[0][place]}" for place, (one, name) in enumerate(AXES.items()) if one != axis)
    hidden = "" if axis == "shots" else "_"  # one legend is enough
    return Curves(
        title=f"over {AXES[axis]}, {others}", xlabel=AXES[axis], ylabel="processor time of a sweep",
        curves={hidden + name: curve for name, curve in curves.items()}, log="xy",
    )  # fmt: skip


def _exponents(axes: Axes, records: Sequence[Record], axis: str) -> None:
    """Exponents at the ends of the lines, and the sizes below."""
    unit = _unit(records).values[PLAIN]
    for number, way in enumerate(NAMES):
        x, y = _along(records, axis, way)
        text = f"${AXES[axis]}^{{{slope(x, y):.2f}}}$"
        axes.annotate(
            text, (x[-1], y[-1] / unit), (6, 0), textcoords="offset points", color=f"C{number}", va="center", fontsize=9
        )
    x, _ = _along(records, axis, TABLES)
    axes.set_xticks(x, [str(value) for value in x])
    axes.set_xticks([], minor=True)
    axes.set_xlim(x[0] / 1.15, x[-1] * (x[-1] / x[0]) ** 0.25)


def _size(record: Record) -> str:
    return ", ".join(f"{name} = {record.spec[axis]}" for axis, name in AXES.items())


def claims(records: Sequence[Record]) -> list[Claim]:
    """Growth of the plain way beside the table's, and ours."""
    return [_whole_cost(records), _affected(records), _algorithm(records), _ours(records)]


def _slopes(records: Sequence[Record], value: str) -> dict[str, float]:
    return {name: slope(*_along(records, axis, value)) for axis, name in AXES.items()}


def _stated(records: Sequence[Record]) -> dict[str, float]:
    every = sizes(_quick(records))
    return {
        name: slope([size[place] for size in every[axis]], [formula(*size) for size in every[axis]])
        for place, (axis, name) in enumerate(AXES.items())
    }


def _powers(slopes: dict[str, float]) -> str:
    return " ".join(f"{name}^{power:.2f}" for name, power in slopes.items())


def _whole_cost(records: Sequence[Record]) -> Claim:
    found = _slopes(records, "cost")
    return Claim(
        page=57, says="Eq. (3.17) takes O(N²L²), lines 2 and 15",
        found=f"its processor time grows like {_powers(found)}",
        agrees=abs(found["N"] - 2) < 0.3 and abs(found["L"] - 2) < 0.3 and abs(found["Q"]) < 0.3,
    )  # fmt: skip


def _affected(records: Sequence[Record]) -> Claim:
    plain = _plain(records)
    nearest, furthest = (pick(plain, key=lambda r: r.spec["bands"] / r.spec["size"]) for pick in (min, max))
    mean = [r.values["affected"] / (2 * r.spec["bands"]) for r in plain]
    return Claim(
        page=56, says="an element affects a set I of 2L voxels",
        found=f"on average over the elements {np.mean(mean):.3f} × 2L, and at most "
        + " and ".join(
            f"{r.values['most_affected'] / (2 * r.spec['bands']):.2f} × 2L (s = {r.spec['bands'] / r.spec['size']:.3g})"
            for r in (nearest, furthest)
        ),
        agrees=all(abs(value - 1) < 0.05 for value in mean),
        why="every voxel sees two elements; in the middle of the code there are 2L/(1 − s), towards its ends fewer",
    )  # fmt: skip


def _algorithm(records: Sequence[Record]) -> Claim:
    found, stated = _slopes(records, PLAIN), _stated(records)
    return Claim(
        page=57, says="an iteration takes O(2N²L²(1 + Q))",
        found=f"the processor time of Algorithm 1 as printed grows like {_powers(found)}, the formula like {_powers(stated)}"
        " over the same sizes",
        agrees=all(abs(found[name] - stated[name]) < 0.3 for name in stated),
        why="if the inner products over the shots are read from which shot is open; summed, as line 10 has them, they are another"
        " factor Q",
    )  # fmt: skip


def _ours(records: Sequence[Record]) -> Claim:
    plain = _plain(records)
    same = sum(r.values["same_code"] for r in plain)
    ratios = {_size(r): r.values[PLAIN] / r.values[TABLES] for r in plain}
    low, high = (pick(ratios, key=lambda size: ratios[size]) for pick in (min, max))
    return Claim(
        page=None, says="what does it take to keep the cost up to date instead?",
        found=f"the same code after a sweep in {same} of {len(plain)} cases, costs equal to"
        f" {max(r.values['cost_error'] for r in plain):.0e}; the time of a sweep grows like {_powers(_slopes(records, TABLES))},"
        f" without repulsion like {_powers(_slopes(records, ALONE))}. Algorithm 1 as printed takes {ratios[low]:.0f} ({low}) to"
        f" {ratios[high]:.0f} times as long ({high})",
        agrees=None,
    )  # fmt: skip


STUDY = Study(
    name="table-3-1",
    title="Cost of a sweep of the design",
    source="Table 3.1, pages 56 and 57",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
