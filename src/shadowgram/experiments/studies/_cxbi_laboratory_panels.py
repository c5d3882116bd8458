"""Panels of the study of the laboratory scan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from shadowgram.experiments.study import Record

from . import _common as common

if TYPE_CHECKING:
    from shadowgram.figures.sheet import Curves, Heat

PARTS = ("difference", "drift", "rest")
"""What is reconstructed: counts with less those without target, their drift alone, and what is left without it."""
AUTO = -1
"""Order of a drift that is chosen by the criterion."""
SOLID = 4  # a line through without markers


def count_panels(counts: Record) -> list[Curves | None]:
    """Counts of both runs and their difference, with the drifts."""
    from shadowgram.figures.sheet import Curve, Curves

    panels: list[Curves | None] = []
    for colour, (name, title) in enumerate(
        {"empty": "no target", "target": "with target", "difference": "with less without"}.items()
    ):
        values = counts.arrays[name]
        shots = np.arange(len(values))
        curves = {
            "_counts": Curve(x=shots, y=values, colour=colour, dash=SOLID),
            f"drift, order {counts.values['orders'][name]}": Curve(x=shots, y=counts.arrays[f"drift_{name}"], colour=4, dash=SOLID),
        }  # fmt: skip
        panels.append(Curves(title=title, xlabel="shot", ylabel="counts / 1000", curves=curves))
    return panels


def image(record: Record, part: str) -> Heat:
    """A reconstruction, on one scale with those of the same method."""
    from shadowgram.figures.sheet import Heat

    values = record.arrays[part]
    rows, columns = values.shape
    titles = {"difference": "from the difference", "drift": "from its drift alone", "rest": "without the drift"}
    top = max(float(record.arrays[name].max()) for name in PARTS)
    return Heat(
        title=f"{titles[part]}, {record.spec['name']}", values=values[::-1],
        extent=(-0.5, columns - 0.5, rows - 0.5, -0.5), xlabel="column", ylabel="row", unit="counts / 1000",
        low=0.0, high=top, aspect="equal",
    )  # fmt: skip


def null_panel(records: Sequence[Record]) -> Curves:
    """How well shifted codes do, and those in their place."""
    from shadowgram.figures.sheet import Curve, Curves

    test = common.only(records, what="test", order=AUTO)
    null = np.sort(100 * test.arrays["null"])
    share = np.arange(1, len(null) + 1) / len(null) * 100
    return Curves(
        title=f"codes in their place and shifted, p = {test.values['p']:.2f}",
        xlabel="variance predicted (%)", ylabel="shifted codes below (%)",
        curves={"shifted codes": Curve(x=null, y=share, dash=SOLID)},
        marks={100 * test.values["statistic"]: "in place"},
    )  # fmt: skip


def order_panel(records: Sequence[Record]) -> Curves:
    """p-values by the order of the drift."""
    from shadowgram.figures.sheet import Curve, Curves

    tests = [r for r in records if r.spec["what"] == "test" and r.spec["order"] != AUTO]
    orders = [r.spec["order"] for r in tests]
    chosen = common.only(records, what="test", order=AUTO).values["order"]
    return Curves(
        title=f"by the order of the drift ({chosen} is chosen)", xlabel="order of the polynomial", ylabel="p", bottom=0, top=1.35,
        curves={
            "laboratory": Curve(x=orders, y=[r.values["p"] for r in tests]),
            "5 %": Curve(x=[0, max(orders)], y=[0.05, 0.05], reference=True),
        },
    )  # fmt: skip


def power_panel(records: Sequence[Record]) -> Curves:
    """How often targets of several sizes would be found."""
    from shadowgram.figures.sheet import Curve, Curves

    curves = {
        f"{size_of(r)} cells": Curve(
            x=[100 * c for c in r.values["contrasts"]], y=[100 * p for p in r.values["power"]], colour=i
        )
        for i, r in enumerate(powers(records))
    }
    return Curves(
        title="what the test would find", xlabel="target's share of the net counts (%)", ylabel="found (%)",
        curves=curves, log="x", bottom=0, top=150,
    )  # fmt: skip


def powers(records: Sequence[Record]) -> list[Record]:
    """Records of the power, the smallest target first."""
    return sorted((r for r in records if r.spec["what"] == "power"), key=lambda r: r.spec["size"])


def size_of(record: Record) -> str:
    """Size of the target that a power is of, in words."""
    return " × ".join(map(str, record.spec["size"]))
