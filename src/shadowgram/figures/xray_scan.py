"""What a scan counted, shot by shot, with its code or its truth; and the map of a scan with pencil beams."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from shadowgram.xray.scan import PencilMap, Scan
from shadowgram.xray.scene import parse_scene

from .style import new_figure, style

_FEW = 40  # shots that are drawn with a mark each


def scan(found: Scan) -> Figure:
    """Counts with and without the target, and their difference; beside them what the target gives through each cell, or a code.

    Bands are standard errors; they are what the noise is in counts with noise.

    Parameters
    ----------
    found : as `shadowgram.xray.scan.direct_scan` or `linear_scan` give it.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.figures.xray_scan import scan
    >>> from shadowgram.xray.scan import direct_scan
    >>> found = direct_scan(sg.xray.shipped_scene("cxbi-blocks"), shots=2, histories=4000, background=True)
    >>> [axes.get_title(loc="left") for axes in scan(found).axes]
    ['Counts', 'First code in view', 'With target less without', 'By the holes in view']
    """
    with style():
        whole = found.background is not None
        figure = new_figure(10.5, 5.6 if whole else 3.4)
        kind = "counts" if found.noisy else "mean counts"
        _head(
            figure,
            found.scene,
            f"{len(found.counts)} {found.route} shots of {found.photons_per_shot:.4g} photons, {kind}",
        )
        rows = figure.subplots(2 if whole else 1, 2, squeeze=False, width_ratios=(2.6, 1))
        _draw_counts(rows[0, 0], found)
        if found.background is not None:
            _draw_line(rows[1, 0], found.signal, found.signal_error, "C2", "")
            rows[1, 0].set(title="With target less without", ylabel="counts")
        rows[-1, 0].set_xlabel("shot")
        _draw_mask(figure, rows[0, 1], found)
        if whole:
            _draw_spread(rows[1, 1], found)
    return figure


def pencil(found: PencilMap) -> Figure:
    """The counts of pencil beams, the part of them that came from the target, and the standard errors.

    Parameters
    ----------
    found : as `shadowgram.xray.scan.pencil_scan` gives it.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.figures.xray_scan import pencil
    >>> from shadowgram.xray.scan import pencil_scan
    >>> found = pencil_scan(sg.xray.shipped_scene("cxbi-ud"), shape=(3, 4), pitch=70, photons=200)
    >>> [axes.get_title(loc="left") for axes in pencil(found).axes[:3]]
    ['Counts', 'From the target', 'Standard error']
    """
    with style():
        figure = new_figure(10.5, 3.2)
        kind = "counts" if found.noisy else "mean counts"
        _head(figure, found.scene, f"pencil beams of {found.photons} photons, {found.pitch:g} mm apart, {kind}")
        maps = {"Counts": found.counts, "From the target": found.target, "Standard error": found.standard_error}
        for axes, (title, values) in zip(figure.subplots(1, 3), maps.items(), strict=True):
            _draw_map(figure, axes, values, title)
    return figure


def _head(figure: Figure, scene: str, what: str) -> None:
    title = parse_scene(scene).title
    figure.suptitle(
        f"{title}: {what}" if title else what.capitalize(), x=0.01, ha="left", fontsize=11, fontweight="bold"
    )


def _draw_counts(axes: Axes, found: Scan) -> None:
    _draw_line(axes, found.counts, found.standard_error, "C0", "with target")
    if found.background is not None and found.background_error is not None:
        _draw_line(axes, found.background, found.background_error, "C1", "without")
        axes.legend(loc="upper right", ncols=2)
    axes.set(title="Counts", ylabel="counts in all detectors")
    axes.set_ylim(0, None)


def _draw_line(axes: Axes, values: np.ndarray, error: np.ndarray, colour: str, label: str) -> None:
    shots = np.arange(len(values))
    marker = "o" if len(values) <= _FEW else ""
    axes.plot(shots, values, color=colour, linewidth=0.9, marker=marker, label=label)
    axes.fill_between(shots, values - error, values + error, color=colour, alpha=0.25, linewidth=0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlim(-0.5, len(values) - 0.5)


def _draw_mask(figure: Figure, axes: Axes, found: Scan) -> None:
    if found.image is not None:
        _draw_map(figure, axes, found.image, "From the target, by cell")
        return
    axes.imshow(found.codes[0], cmap="gray", vmin=0, vmax=1)
    axes.set(title="First code in view", xlabel="column", ylabel="row")
    axes.grid(visible=False)


def _draw_map(figure: Figure, axes: Axes, values: np.ndarray, title: str) -> None:
    shown = axes.imshow(values, vmin=0)
    axes.set(title=title, xlabel="column", ylabel="row")
    axes.grid(visible=False)
    figure.colorbar(shown, ax=axes, label="counts")


def _draw_spread(axes: Axes, found: Scan) -> None:
    """The difference over the number of holes, which it follows where the target fills the field."""
    holes = found.codes.sum(axis=(1, 2))
    axes.errorbar(
        holes,
        found.signal,
        found.signal_error,
        fmt=".",
        color="C2",
        ecolor="C2",
        elinewidth=0.6,
        markersize=3,
        alpha=0.6,
    )
    axes.set(title="By the holes in view", xlabel="holes", ylabel="difference")
