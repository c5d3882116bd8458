"""One look for all figures: colours that colour-blind people can tell apart, quiet axes, light or dark paper."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from cycler import cycler
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread, imsave

# Okabe and Ito, "Color Universal Design" (2008), in an order in which neighbours differ in lightness too.
BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILION, YELLOW = (
    "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442",
)  # fmt: skip
CYCLE = (BLUE, ORANGE, GREEN, PURPLE, VERMILION, SKY)
# On dark paper the blue is too dark to read as a line.
CYCLE_DARK = (SKY, ORANGE, GREEN, PURPLE, VERMILION, YELLOW)
MAP = "cividis"
MARKERS = ("o", "s", "^", "D", "v", "P")

INK, PAPER = "#1b1f24", "#ffffff"
INK_DARK, PAPER_DARK = "#e6e9ed", "#16191d"


@contextmanager
def style(*, dark: bool = False) -> Iterator[None]:
    """Use the look inside the ``with`` block, for figures made there.

    Parameters
    ----------
    dark : light ink for dark paper.

    Examples
    --------
    >>> from shadowgram.figures.style import new_figure, style
    >>> with style(dark=True):
    ...     axes = new_figure(3, 2).subplots()
    """
    ink, paper = (INK_DARK, PAPER_DARK) if dark else (INK, PAPER)
    settings: dict[Any, object] = {
        "font.family": "sans-serif",
        "font.sans-serif": ["DejaVu Sans"],  # comes with matplotlib: the same picture on every machine
        "font.size": 9.0,
        "axes.titlesize": 9.5,
        "axes.titleweight": "bold",
        "axes.titlelocation": "left",
        "axes.labelsize": 9.0,
        "axes.edgecolor": ink,
        "axes.labelcolor": ink,
        "axes.facecolor": "none",
        "axes.linewidth": 0.7,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.color": ink,
        "grid.alpha": 0.12,
        "grid.linewidth": 0.6,
        "axes.prop_cycle": cycler(color=CYCLE_DARK if dark else CYCLE),
        "xtick.color": ink,
        "ytick.color": ink,
        "xtick.labelsize": 8.0,
        "ytick.labelsize": 8.0,
        "text.color": ink,
        "figure.facecolor": paper,
        "figure.edgecolor": paper,
        "savefig.facecolor": paper,
        "legend.frameon": False,
        "legend.fontsize": 8.0,
        "lines.linewidth": 1.5,
        "lines.markersize": 4.0,
        "image.cmap": MAP,
        "image.interpolation": "nearest",
    }
    with mpl.rc_context(settings):
        yield


def new_figure(width: float, height: float) -> Figure:
    """Figure of `width` × `height` inches that draws with Agg and needs no pyplot."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def png(figure: Figure, *, dpi: float = 160, transparent: bool = False) -> bytes:
    """PNG file of a figure; `transparent` leaves the paper out."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, transparent=transparent)
    return buffer.getvalue()


def picture_png(picture: np.ndarray, *, low: float = 0.0, high: float = 1.0, colours: str = "gray") -> bytes:
    """PNG file of an image, a file pixel a pixel.

    Parameters
    ----------
    picture : (y, x, 3) colours, uint8 or in [0, 1]; or (y, x) values, shown from `low` to `high` in `colours`.
    low, high : values of the first and the last colour.
    colours : matplotlib colour map.
    """
    buffer = io.BytesIO()
    if picture.ndim == 3:
        imsave(buffer, picture if picture.dtype == np.uint8 else np.clip(picture, 0, 1), format="png")
    else:
        imsave(buffer, picture, vmin=low, vmax=high, cmap=colours, format="png")
    return buffer.getvalue()


def read_grey(path: Path) -> np.ndarray:
    """Grey picture (y, x) in [0, 1] from a PNG file; of a coloured one the mean of the colours.

    Raises
    ------
    ValueError
        If the file is not a picture.
    """
    try:
        picture = imread(path)
    except (SyntaxError, ValueError) as error:
        raise ValueError(f"{path} is not a PNG picture: {error}") from error
    return picture if picture.ndim == 2 else picture[..., :3].mean(axis=2)
