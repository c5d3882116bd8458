"""Pictures of cubes, codes and snapshots, as figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from .style import YELLOW, new_figure


@dataclass(frozen=True)
class Zoom:
    """Square part of a picture: its upper left pixel and its side, in pixels."""

    y: int
    x: int
    size: int

    def of(self, picture: np.ndarray) -> np.ndarray:
        """Cut it out of a picture (y, x) or (y, x, colour)."""
        return picture[self.y : self.y + self.size, self.x : self.x + self.size]


@dataclass(frozen=True)
class Point:
    """Labelled pixel of a picture."""

    label: str
    y: int
    x: int


def gallery(
    pictures: Mapping[str, np.ndarray],
    *,
    captions: Mapping[str, str] | None = None,
    zoom: Zoom | None = None,
    points: Sequence[Point] = (),
) -> Figure:
    """Pictures side by side, each with the same part enlarged below it.

    Parameters
    ----------
    pictures : title → (y, x, 3) colours or (y, x) grey values, uint8 or in [0, 1]; all of one size.
    captions : title → a line to stand below.
    zoom : part to enlarge.
    points : pixels to label in the first picture.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.figures.images import Zoom, gallery
    >>> rgb = np.random.default_rng(0).random((16, 16, 3))
    >>> len(gallery({"original": rgb, "estimate": rgb}, zoom=Zoom(4, 4, 8)).axes)
    4
    """
    rows = 1 if zoom is None else 2
    figure = new_figure(2.3 * len(pictures), 2.3 * rows + 0.5)
    axes = figure.subplots(rows, len(pictures), squeeze=False)
    for column, (title, picture) in enumerate(pictures.items()):
        show(axes[0, column], picture, title)
        axes[-1, column].set_xlabel((captions or {}).get(title, ""))
        if zoom is not None:
            frame(axes[0, column], zoom)
            show(axes[1, column], zoom.of(picture))
    mark(axes[0, 0], points)
    return figure


def shots(code: np.ndarray, snapshots: np.ndarray, *, most: int = 4) -> Figure:
    """Codes above the snapshots that were taken through them.

    Parameters
    ----------
    code : (shot, y, x), or (shot, band, y, x): then its middle band is shown.
    snapshots : (shot, y, x), on one grey scale.
    most : largest number of shots to show.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.figures.images import shots
    >>> len(shots(np.ones((2, 8, 8)), np.ones((2, 8, 10))).axes)
    4
    """
    count = min(most, len(snapshots))
    figure = new_figure(2.6 * count, 5.4)
    axes = figure.subplots(2, count, squeeze=False)
    grey = toned(snapshots)
    for shot in range(count):
        shown = code[shot] if code.ndim == 3 else code[shot, code.shape[1] // 2]
        band = "" if code.ndim == 3 else f", band {code.shape[1] // 2 + 1} of {code.shape[1]}"
        show(axes[0, shot], shown, f"Code {shot + 1} of {len(code)}{band}", cmap="gray")
        show(axes[1, shot], grey[shot], f"Snapshot {shot + 1}", cmap="gray")
    return figure


def show(axes: Axes, picture: np.ndarray, title: str = "", cmap: str = "gray") -> None:
    """Draw a picture, uint8 or in [0, 1], without axes."""
    if picture.dtype != np.uint8 or picture.ndim == 2:
        picture = np.clip(picture, 0, 1)
    axes.imshow(picture, vmin=0, vmax=1, cmap=cmap)
    axes.set(title=title, xticks=[], yticks=[])
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)


def frame(axes: Axes, zoom: Zoom) -> None:
    """Outline a part of a picture, dark on light so that it shows everywhere."""
    for colour, width in (("black", 2.4), (YELLOW, 1.2)):
        corner = (zoom.x - 0.5, zoom.y - 0.5)
        axes.add_patch(Rectangle(corner, zoom.size, zoom.size, fill=False, edgecolor=colour, linewidth=width))


def mark(axes: Axes, points: Sequence[Point]) -> None:
    """Ring and label pixels of a picture."""
    for point in points:
        for colour, width in (("black", 2.8), ("white", 1.3)):
            axes.plot(point.x, point.y, "o", ms=8, mfc="none", mec=colour, mew=width)
        axes.annotate(
            point.label, (point.x, point.y), (7, 4), textcoords="offset points", color="white", weight="bold",
            bbox={"boxstyle": "round,pad=0.15", "facecolor": "black", "edgecolor": "none", "alpha": 0.65},
        )  # fmt: skip


def toned(snapshots: np.ndarray) -> np.ndarray:
    """Snapshots as grey values in [0, 1], with the tone curve of a photograph.

    The square root is shown, as screens expect it of light; the 99.9th percentile is white, so that a few highlights do not
    darken the rest.
    """
    white = float(np.percentile(snapshots, 99.9)) or 1.0
    return np.sqrt(np.clip(snapshots / white, 0, 1))


def busiest(picture: np.ndarray, size: int) -> Zoom:
    """Square part with the most fine detail in it, to zoom into.

    Parameters
    ----------
    picture : (y, x, 3) or (y, x).
    size : side of the part, pixels.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.figures.images import busiest
    >>> picture = np.zeros((32, 32)); picture[20:28:2, 4:12] = 1
    >>> busiest(picture, 12)
    Zoom(y=18, x=2, size=12)
    """
    values = np.asarray(picture, dtype=np.float64)
    grey = values.mean(axis=2) if values.ndim == 3 else values
    detail = np.zeros(grey.shape)
    detail[1:] += np.abs(np.diff(grey, axis=0))
    detail[:, 1:] += np.abs(np.diff(grey, axis=1))
    total = np.pad(detail, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    inside = total[size:, size:] - total[:-size, size:] - total[size:, :-size] + total[:-size, :-size]
    best = np.argwhere(inside >= inside.max() * (1 - 1e-9)).mean(axis=0)
    return Zoom(int(best[0]), int(best[1]), size)
