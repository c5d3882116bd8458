"""The main job in one picture: scene → code → snapshot → reconstruction, and two spectra."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from .images import Point, Zoom, frame, mark, show, toned
from .lines import draw_spectra
from .style import new_figure


def overview(
    *,
    scene: np.ndarray,
    code: np.ndarray,
    snapshot: np.ndarray,
    reconstruction: np.ndarray,
    titles: Sequence[str],
    zoom: Zoom,
    points: Sequence[Point],
    wavelengths: np.ndarray,
    truth: Mapping[str, np.ndarray],
    estimate: Mapping[str, np.ndarray],
) -> Figure:
    """Draw the way of the light and back.

    Parameters
    ----------
    scene, reconstruction : (y, x, 3) colours in [0, 1].
    code, snapshot : (y, x), one shot.
    titles : of the four pictures.
    zoom : part that is enlarged below each picture.
    points : labelled pixels.
    wavelengths : (band,) nm.
    truth, estimate : label of a point → (band,) spectrum.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.figures.images import Point, Zoom
    >>> from shadowgram.figures.overview import overview
    >>> rgb, line = np.ones((16, 16, 3)), np.linspace(0, 1, 5)
    >>> figure = overview(scene=rgb, code=rgb[..., 0], snapshot=rgb[..., 0], reconstruction=rgb, titles="abcd",
    ...                   zoom=Zoom(0, 0, 8), points=[Point("T1", 3, 3)], wavelengths=line, truth={"T1": line},
    ...                   estimate={"T1": line})
    >>> len(figure.axes)
    9
    """
    figure = new_figure(12.0, 4.45)
    pictures, curves = figure.subfigures(1, 2, squeeze=False, width_ratios=[9.0, 3.0])[0]
    axes = pictures.subplots(2, 4, gridspec_kw={"wspace": 0.1})
    shown = (scene, code, toned(snapshot), reconstruction)
    for column, (picture, title) in enumerate(zip(shown, titles, strict=True)):
        show(axes[0, column], picture, title)
        frame(axes[0, column], zoom)
        show(axes[1, column], zoom.of(picture))
        if column:
            arrow = {
                "arrowstyle": "-|>,head_width=0.3,head_length=0.5",
                "linewidth": 2.0,
                "color": axes[0, 0].title.get_color(),
            }
            axes[0, column].annotate("", (0.0, 0.5), (-0.11, 0.5), xycoords="axes fraction", arrowprops=arrow)
    for column in (0, 3):
        mark(axes[0, column], points)
    panels = curves.subplots(len(points), 1, sharex=True, squeeze=False)[:, 0]
    for panel, point in zip(panels, points, strict=True):
        draw_spectra(panel, wavelengths, truth[point.label], {"reconstruction": estimate[point.label]})
        panel.set(title=f"Spectrum at {point.label}", ylabel="radiance (relative)")
        panel.label_outer()
    panels[0].legend(loc="best")
    return figure
