"""What an SSCSI resolves over the position of its mask: the curves of the spectral zoom."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter, MaxNLocator, PercentFormatter

from .style import new_figure

if TYPE_CHECKING:
    from shadowgram.spectral.bench import Bench
    from shadowgram.spectral.resolution import Resolution
    from shadowgram.spectral.sscsi import SSCSI

POSITIONS = 100  # at most: large cameras take a while for each


def over_position(imager: SSCSI, farthest: float, *, bench: Bench | None = None) -> Figure:
    """Band width, number of bands, spatial resolution and throughput over the mask position, the imager's own marked.

    Parameters
    ----------
    imager : gives the geometry, and the position to mark.
    farthest : s, in (0, 1), where the curves end.
    bench : whose reach is shaded, whose distances stand above the curves, and whose pupil sets a limit.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.figures.resolution import over_position
    >>> imager = sg.SSCSI(detector_shape=(64, 64), detector_pitch=10.0, code_pitch=10.0, mask_position=0.125,
    ...                   wavelengths=(450, 650))
    >>> [axes.get_ylabel() for axes in over_position(imager, 0.9).axes]
    ['nm', 'bands', 'pitch on the detector (µm)', 'throughput']
    """
    s, curve = _curve(imager, farthest)
    figure = new_figure(7.6, 5.6 if bench is None else 6.0)
    figure.suptitle(_title(imager, bench), x=0.01, ha="left", fontsize=9)
    panels = figure.subplots(2, 2, sharex=True)
    (width, bands), (pitch, light) = panels
    _draw_width(width, s, curve, bench)
    _draw_bands(bands, s, curve)
    _draw_pitch(pitch, s, curve)
    _draw_light(light, s, curve)
    for axes in panels.flat:
        axes.set_xlim(0, s[-1])
        if bench is not None:
            axes.axvspan(*bench.reachable, color="C0", alpha=0.09, linewidth=0, label="reach of the bench")
    _mark_all(panels, imager)
    for axes in (pitch, light):
        axes.set_xlabel("mask position s")
    if bench is not None:
        for axes in (width, bands):
            above = axes.secondary_xaxis("top", functions=(bench.distance, lambda mm: mm / bench.plane_distance))
            above.set_xlabel("mm from the image plane", fontsize=8)
        _legend(width)
    return figure


def _curve(imager: SSCSI, farthest: float) -> tuple[np.ndarray, list[Resolution]]:
    """Resolutions at positions that divide the range of wavelengths into whole bands, so that no last band is cut."""
    from shadowgram.spectral.sscsi import MOST_BANDS

    at_one = imager.dispersion_ratio * imager.code_shape[1]
    last = max(1, min(math.floor(farthest * at_one), MOST_BANDS))
    columns = np.concatenate([np.geomspace(1, last, POSITIONS // 2), np.linspace(1, last, POSITIONS // 2)])
    columns = np.unique(columns.round())
    s = np.concatenate([[0.0], columns[columns < at_one] / at_one])
    return s, [dataclasses.replace(imager, mask_position=float(p), bands=None).resolution for p in s]


def _title(imager: SSCSI, bench: Bench | None) -> str:
    rows, columns = imager.detector_shape
    low, high = imager.wavelengths
    where = "" if bench is None else f", {bench.distance(imager.mask_position):.3g} mm"
    return (
        f"{rows} × {columns} elements of {imager.detector_pitch:g} µm, code of {imager.code_pitch:g} µm, {low:g} to {high:g} nm,"
        f" β = {imager.dispersion_ratio:.3g}; mask at s = {imager.mask_position:.4g}{where}"
    )


def _draw_width(axes: Axes, s: np.ndarray, curve: list[Resolution], bench: Bench | None) -> None:
    # 1/Δλ is linear in s between the positions of the curve.
    fine = np.linspace(0, s[-1], 500)
    width = 1 / np.interp(fine, s, [1 / r.band_width for r in curve])
    axes.plot(fine, width, label="bound Δc/(sα)")
    axes.set(title="Band width", ylabel="nm", yscale="log", ylim=(width.min() / 1.8, width.max() * 1.6))
    for set_formatter in (axes.yaxis.set_major_formatter, axes.yaxis.set_minor_formatter):
        set_formatter(FuncFormatter(lambda nm, _: f"{nm:g}" if f"{nm:e}"[0] in "125" else ""))
    if bench is not None and math.isfinite(bench.f_number):
        limit = bench.pupil_band_width
        axes.axhline(
            limit, color="C4", linestyle="--", linewidth=1.2, label=f"pupil f/{bench.f_number:g}: {limit:.3g} nm"
        )
        axes.fill_between(fine, width, limit, where=list(width < limit), color="C4", alpha=0.12, linewidth=0)


def _draw_bands(axes: Axes, s: np.ndarray, curve: list[Resolution]) -> None:
    # Steps where every number of bands is in the curve.
    style = "steps-pre" if curve[-1].bands < len(s) else "default"
    axes.plot(s, [r.bands for r in curve], color="C1", drawstyle=style)
    most = curve[-1].bands
    axes.set(title="Number of bands", ylabel="bands", ylim=(-0.07 * most, 1.08 * most))
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_pitch(axes: Axes, s: np.ndarray, curve: list[Resolution]) -> None:
    pitch = [r.x_pitch for r in curve]
    axes.plot(s, pitch, color="C2")
    axes.set(title="Spatial resolution along x", ylabel="pitch on the detector (µm)", ylim=(0, 1.25 * max(pitch)))
    for regime in dict.fromkeys(r.regime for r in curve):
        there = [p for p, r in zip(s, curve, strict=True) if r.regime == regime and p > 0]
        if there and there[-1] - there[0] > 0.2 * s[-1]:
            last = there[-1] == s[-1]
            axes.text(
                there[-1] if last else there[0], 0.05 * max(pitch), regime, ha="right" if last else "left", va="bottom",
                fontsize=8, bbox={"facecolor": axes.figure.get_facecolor(), "edgecolor": "none", "pad": 1.0},
            )  # fmt: skip


def _draw_light(axes: Axes, s: np.ndarray, curve: list[Resolution]) -> None:
    worst = [float(r.throughput.min()) for r in curve]
    axes.plot(s, [r.mean_throughput for r in curve], color="C3", label="mean of the bands")
    if min(worst) < min(r.mean_throughput for r in curve) - 1e-3:
        axes.plot(s, worst, color="C3", linewidth=1.0, linestyle="--", label="worst band")
    low = max(0.0, math.floor(10 * min(worst)) / 10 - 0.2)
    axes.set(title="Light that meets the mask", ylabel="throughput", ylim=(low, 1 + 0.13 * (1 - low)))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    _legend(axes)


def _mark_all(panels: np.ndarray, imager: SSCSI) -> None:
    found = imager.resolution
    light = f"{100 * found.mean_throughput:.3g} %"
    # Labels stand beside their curve: above one that falls, below one that rises.
    for axes, value, text, dy in (
        (panels[0, 0], found.band_width, f"{found.band_width:.4g} nm", 6),
        (panels[0, 1], found.bands, f"{found.bands} band{'s' * (found.bands > 1)}", -12),
        (panels[1, 0], found.x_pitch, f"{found.x_pitch:.4g} µm", -15),
        (panels[1, 1], found.mean_throughput, light, 5),
    ):
        _mark(axes, imager.mask_position, value, text, dy)


def _mark(axes: Axes, s: float, value: float, text: str, dy: float) -> None:
    ink, paper = axes.xaxis.label.get_color(), axes.figure.get_facecolor()
    axes.axvline(s, color=ink, linestyle=":", linewidth=1.0)
    axes.plot(s, value, "o", color=ink, markersize=5, zorder=5, clip_on=False)
    right = s < 0.7 * axes.get_xlim()[1]
    offset = (8, dy) if right else (-8, -8 - dy)
    label = axes.annotate(text, (s, value), offset, textcoords="offset points", weight="bold")
    label.set_horizontalalignment("left" if right else "right")
    label.set_path_effects([withStroke(linewidth=3, foreground=paper)])


def _legend(axes: Axes) -> None:
    paper = axes.figure.get_facecolor()
    axes.legend(loc="best", frameon=True, facecolor=paper, edgecolor="none", framealpha=0.85)
