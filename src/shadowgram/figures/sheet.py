"""Figures of the studies: panels with curves, pictures and maps, in rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from .images import Point, Zoom, frame, mark, show
from .style import MAP, MARKERS, new_figure

_WIDTH = 10.5  # inches
LINE_STYLES = ("-", "--", ":", "-.")


@dataclass(frozen=True, kw_only=True)
class Curve:
    """A line of a panel.

    Attributes
    ----------
    x, y : (n,) values.
    colour : number of the colour; lines of one kind share it.
    dash : number of the line style, and whether it has markers: 0 is drawn through with markers.
    reference : drawn broad and pale, below the others: the truth.
    spread : (n,) half width of a shaded band about the line, such as a standard deviation.
    """

    x: np.ndarray | Sequence[float]
    y: np.ndarray | Sequence[float]
    colour: int = 0
    dash: int = 0
    reference: bool = False
    spread: np.ndarray | Sequence[float] | None = None


@dataclass(frozen=True, kw_only=True)
class Curves:
    """Panel of lines, name → curve; a name that begins with "_" does not stand in the legend.

    Attributes
    ----------
    bottom, top : limits of y, where they are to be fixed.
    log : logarithmic axes, "", "x", "y" or "xy".
    marks : x places of vertical lines → what stands beside them.
    """

    title: str
    xlabel: str
    ylabel: str
    curves: Mapping[str, Curve]
    bottom: float | None = None
    top: float | None = None
    log: str = ""
    marks: Mapping[float, str] = field(default_factory=dict)
    width: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Picture:
    """Panel with a picture, (y, x, 3) colours or (y, x) grey in [0, 1], and a line below it."""

    title: str
    picture: np.ndarray
    caption: str = ""
    zoom: Zoom | None = None
    points: Sequence[Point] = ()
    width: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Heat:
    """Panel with values in colours and a scale.

    Attributes
    ----------
    values : (row, column).
    extent : (left, right, bottom, top) in the units of the axes.
    lines : polylines over it, each (n, 2) of x and y; the last ones of the style's colours.
    """

    title: str
    values: np.ndarray
    extent: tuple[float, float, float, float]
    xlabel: str
    ylabel: str
    unit: str
    low: float | None = None
    high: float | None = None
    colours: str = MAP
    aspect: Literal["auto", "equal"] = "auto"
    lines: Sequence[np.ndarray] = ()
    width: float = 1.0


Panel = Curves | Picture | Heat


def sheet(title: str, rows: Sequence[Sequence[Panel | None]]) -> Figure:
    """Panels in rows, under a title.

    Parameters
    ----------
    title : of the whole.
    rows : of panels; None leaves a place empty. Widths within a row are in proportion to the panels' `width`.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.figures.sheet import Curve, Curves, Picture, sheet
    >>> line = Curves(title="Quality", xlabel="shots", ylabel="PSNR (dB)", curves={"SSCSI": Curve(x=[1, 2], y=[30, 32])})
    >>> len(sheet("A study", [[line, Picture(title="scene", picture=np.ones((4, 4)))]]).axes)
    2
    """
    heights = [_height(row) for row in rows]
    figure = new_figure(_WIDTH, sum(heights) + 0.4)
    figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold")
    strips = figure.subfigures(len(rows), 1, squeeze=False, height_ratios=heights)[:, 0]
    for strip, row in zip(strips, rows, strict=True):
        widths = [1.0 if panel is None else panel.width for panel in row]
        for axes, panel in zip(strip.subplots(1, len(row), squeeze=False, width_ratios=widths)[0], row, strict=True):
            if panel is None:
                axes.set_axis_off()
            else:
                _draw(axes, panel)
    return figure


def _height(row: Sequence[Panel | None]) -> float:
    """Inches that a row takes: 2.7 for curves and maps, else what pictures need at their width, with title and caption."""
    whole = sum(1.0 if panel is None else panel.width for panel in row)
    heights = [2.7 if any(isinstance(panel, Curves | Heat) for panel in row) else 0.0]
    for panel in row:
        if isinstance(panel, Picture):
            ny, nx = panel.picture.shape[:2]
            text = 0.1 + 0.3 * bool(panel.title) + 0.25 * bool(panel.caption)
            heights.append((_WIDTH / whole * panel.width - 0.15) * ny / nx + text)
    return max(heights) if heights[0] == 0 else heights[0]


def _draw(axes: Axes, panel: Panel) -> None:
    if isinstance(panel, Curves):
        _draw_curves(axes, panel)
    elif isinstance(panel, Picture):
        show(axes, panel.picture, panel.title)
        axes.set_xlabel(panel.caption)
        if panel.zoom is not None:
            frame(axes, panel.zoom)
        mark(axes, panel.points)
    else:
        _draw_heat(axes, panel)


def _draw_curves(axes: Axes, panel: Curves) -> None:
    ink = axes.xaxis.label.get_color()
    for name, curve in panel.curves.items():
        label = None if name.startswith("_") else name
        if curve.reference:
            axes.plot(curve.x, curve.y, color=ink, linewidth=5, alpha=0.28, solid_capstyle="round", label=label)
            continue
        marker = MARKERS[curve.colour % len(MARKERS)] if curve.dash == 0 else ""
        dash = LINE_STYLES[curve.dash % len(LINE_STYLES)]
        axes.plot(curve.x, curve.y, color=f"C{curve.colour % 6}", linestyle=dash, marker=marker, label=label)
        if curve.spread is not None:
            low, high = np.subtract(curve.y, curve.spread), np.add(curve.y, curve.spread)
            axes.fill_between(curve.x, low, high, color=f"C{curve.colour % 6}", alpha=0.18, linewidth=0)
    axes.set(title=panel.title, xlabel=panel.xlabel, ylabel=panel.ylabel)
    if "x" in panel.log:
        axes.set_xscale("log")
    elif all(np.equal(np.mod(curve.x, 1), 0).all() for curve in panel.curves.values()):
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))  # there is no half of a shot
    if "y" in panel.log:
        axes.set_yscale("log")
    axes.set_ylim(panel.bottom, panel.top)
    for x, text in panel.marks.items():
        axes.axvline(x, color=ink, linestyle=":", linewidth=1.0)
        axes.annotate(text, (x, 1), (3, -10), xycoords=("data", "axes fraction"), textcoords="offset points")
    if any(not name.startswith("_") for name in panel.curves):
        axes.legend(loc="best")


def _draw_heat(axes: Axes, panel: Heat) -> None:
    image = axes.imshow(
        panel.values, extent=panel.extent, origin="lower", aspect=panel.aspect, vmin=panel.low, vmax=panel.high,
        cmap=panel.colours,
    )  # fmt: skip
    for number, line in enumerate(panel.lines):
        axes.plot(line[:, 0], line[:, 1], color=f"C{(1 + number) % 6}", linewidth=1.6)
    axes.set(title=panel.title, xlabel=panel.xlabel, ylabel=panel.ylabel)
    axes.set_xlim(*panel.extent[:2])
    axes.set_ylim(*panel.extent[2:])
    axes.grid(visible=False)
    axes.figure.colorbar(image, ax=axes, label=panel.unit)
