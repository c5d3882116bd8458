"""A reconstruction from the counts of a coded scan, what the counts were modelled as, and whether to trust it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from .style import BLUE, GREEN, ORANGE, PURPLE, VERMILION, new_figure, style

_UNIT = "counts a shot through an open cell"


@dataclass(frozen=True, kw_only=True, eq=False)
class Shown:
    """What to draw.

    Attributes
    ----------
    title : above all.
    image : (y, x) counts a shot that come through each cell while it is open.
    counts : (shot,) with the target.
    model : (shot,) what the image and the background make them.
    background : (shot,) the modelled counts without the image.
    verdict : a sentence on whether the codes explain the counts; empty if that was not tested.
    trusted : what it says; None if it was not tested.
    """

    title: str
    image: np.ndarray
    counts: np.ndarray
    model: np.ndarray
    background: np.ndarray
    verdict: str = ""
    trusted: bool | None = None


def reconstruction(shown: Shown) -> Figure:
    """Image, counts with the modelled background, and what the model leaves, with the verdict below the title.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.figures.xray_reconstruct import Shown, reconstruction
    >>> line = np.full(20, 9.0)
    >>> figure = reconstruction(
    ...     Shown(title="Scan", image=np.eye(4), counts=line + 1, model=line, background=line - 2, verdict="no", trusted=False)
    ... )
    >>> [axes.get_title(loc="left") for axes in figure.axes if axes.get_title(loc="left")]
    ['Image', 'Counts', 'Counts less model']
    """
    with style():
        figure = new_figure(10.5, 4.6)
        figure.suptitle(shown.title, x=0.01, ha="left", fontsize=11, fontweight="bold")
        left, right = figure.subfigures(1, 2, squeeze=False, width_ratios=(1, 1.35))[0]
        draw_image(figure, left.subplots(), shown.image, "Image")
        counts, rest = right.subplots(2, 1, height_ratios=(1.6, 1), sharex=True)
        _draw_counts(counts, shown)
        _draw_rest(rest, shown)
        if shown.verdict:
            colour = {True: GREEN, False: VERMILION, None: BLUE}[shown.trusted]
            figure.supxlabel(shown.verdict, x=0.01, ha="left", fontsize=9.5, fontweight="bold", color=colour)
    return figure


def draw_image(figure: Figure, axes: Axes, image: np.ndarray, title: str, unit: str = _UNIT) -> None:
    """An image with its colour bar; from 0 if no value is below."""
    drawn = axes.imshow(image, vmin=min(0.0, float(image.min())))
    axes.set(title=title, xlabel="column", ylabel="row")
    axes.grid(visible=False)
    figure.colorbar(drawn, ax=axes, label=unit, shrink=0.85)


def _draw_counts(axes: Axes, shown: Shown) -> None:
    shots = np.arange(len(shown.counts))
    axes.plot(shots, shown.counts, color=BLUE, linewidth=0.9, label="with target")
    axes.plot(shots, shown.model, color=ORANGE, linewidth=0.9, label="model")
    axes.plot(shots, shown.background, color=PURPLE, linewidth=1.3, label="modelled background")
    axes.set(title="Counts", ylabel="counts")
    axes.legend(loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0.2, ncols=3)
    axes.set_xlim(-0.5, len(shots) - 0.5)


def _draw_rest(axes: Axes, shown: Shown) -> None:
    rest = shown.counts - shown.model
    axes.plot(np.arange(len(rest)), rest, color=BLUE, linewidth=0.8)
    axes.axhline(0, color=axes.xaxis.label.get_color(), linewidth=0.6)
    axes.set(title="Counts less model", xlabel="shot", ylabel="counts")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
