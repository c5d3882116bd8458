"""What a simulation of X-rays found: spectra of pulses, counts by order, images of the detectors, what escaped."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from shadowgram.xray.montecarlo.arrays import FROM_TARGET, ORDERS

from .style import new_figure

if TYPE_CHECKING:
    from shadowgram.xray.montecarlo.run import Run
    from shadowgram.xray.montecarlo.tallies import Estimate

_MOST_LINES = 6  # one for each colour
_MOST_IMAGES = 4  # in a row
_HEIGHT = 3.0  # inches of a row


def tallies(run: Run, title: str = "") -> Figure:
    """Spectra of the pulses of each detector, counts by order, and images where there are pixels.

    Without a detector what left the world is shown. Bands and bars are standard errors.

    Parameters
    ----------
    run : as `shadowgram.xray.simulate` gives it.
    title : of the whole.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.figures.xray_tallies import tallies
    >>> run = sg.xray.simulate(sg.xray.shipped_scene("cxbi-blocks"), histories=2000, variance_reduction=True)
    >>> [axes.get_xlabel() for axes in tallies(run).axes]
    ['pulse height (keV)', 'counts per source photon']
    """
    found = run.tallies
    detectors = [name.removesuffix("/orders") for name in found if name.endswith("/orders")]
    detectors.remove("all")
    images = {name: found[f"{name}/image"] for name in detectors if found[f"{name}/image"].mean.size > 1}
    rows = 1 + -(-len(images) // _MOST_IMAGES)
    figure = new_figure(10.5, _HEIGHT * rows + 0.5)
    heading = f"{title or 'Simulation'}: {run.histories:.4g} photons"
    figure.suptitle(heading, x=0.01, ha="left", fontsize=11, fontweight="bold")
    strips = figure.subfigures(rows, 1, squeeze=False)[:, 0]
    left, right = strips[0].subplots(1, 2, width_ratios=(1.2, 1))
    if detectors:
        _draw_spectra(left, {name: found[f"{name}/spectrum"] for name in detectors}, "Pulses", "pulse height (keV)")
        _draw_orders(right, {name: found[f"{name}/orders"] for name in detectors})
    else:
        sides = {side: found[f"escaped/{side}/spectrum"] for side in ("backward", "forward")}
        _draw_spectra(left, sides, "What left the world", "photon energy (keV)")
        _make_log(left, sides.values())
        _draw_cosines(right, found["escaped/cosine"])
    _draw_images(list(strips[1:]), images)
    return figure


def _draw_spectra(axes: Axes, spectra: Mapping[str, Estimate], title: str, xlabel: str) -> None:
    shown = list(spectra.items())[:_MOST_LINES]
    end = 1.0
    for number, (name, spectrum) in enumerate(shown):
        edges = spectrum.edges[0]
        assert edges is not None  # spectra have bins
        _draw_histogram(axes, edges, spectrum, name, f"C{number}")
        lit = np.flatnonzero(spectrum.mean)
        end = max(end, float(edges[lit[-1] + 1]) if lit.size else 0.0)
    left_out = "" if len(spectra) == len(shown) else f" of the first {len(shown)} of {len(spectra)} detectors"
    axes.set(title=f"{title}{left_out}", xlabel=xlabel, ylabel="per source photon and keV")
    axes.set_xlim(0, end)
    axes.set_ylim(0, None)
    axes.legend()


def _draw_histogram(axes: Axes, edges: np.ndarray, values: Estimate, name: str, colour: str) -> None:
    """Steps with a band of one standard error, over the width of the bins."""
    width = np.diff(edges)
    mean, error = values.mean / width, np.nan_to_num(values.standard_error / width, posinf=0.0)
    axes.stairs(mean, edges, color=colour, linewidth=1.2, label=name)
    low, high = (np.append(bound, bound[-1]) for bound in (np.maximum(mean - error, 0), mean + error))
    axes.fill_between(edges, low, high, step="post", color=colour, alpha=0.25, linewidth=0)


def _draw_orders(axes: Axes, orders: Mapping[str, Estimate]) -> None:
    """Bars of the orders that occur, in the colours of the spectra; those that make the image first."""
    shown = list(orders.items())[:_MOST_LINES]
    present = [i for i in range(len(ORDERS)) if any(one.mean[i] > 0 for _, one in shown)]
    place = np.arange(len(present))
    height = 0.8 / len(shown)
    for number, (name, one) in enumerate(shown):
        mean, error = one.mean[present], np.nan_to_num(one.standard_error[present], posinf=0.0)
        axes.barh(
            place + (number - (len(shown) - 1) / 2) * height, mean, height, xerr=error, color=f"C{number}", label=name,
            error_kw={"elinewidth": 0.9, "ecolor": axes.xaxis.label.get_color()},
        )  # fmt: skip
    axes.set_yticks(place, [ORDERS[i] for i in present])
    axes.invert_yaxis()
    targets = sum(i < FROM_TARGET for i in present)
    if 0 < targets < len(present):
        ink = axes.xaxis.label.get_color()
        axes.axhline(targets - 0.5, color=ink, linestyle=":", linewidth=1.0)
        axes.annotate(
            "from the target", (1, targets - 0.5), (0, 3), xycoords=("axes fraction", "data"), textcoords="offset points",
            ha="right", fontsize=8,
        )  # fmt: skip
    axes.set(title="Counts by what the photon did before", xlabel="counts per source photon")
    axes.ticklabel_format(axis="x", scilimits=(-2, 4))
    axes.grid(visible=False, axis="y")


def _draw_cosines(axes: Axes, cosines: Estimate) -> None:
    edges = cosines.edges[0]
    assert edges is not None
    _draw_histogram(axes, edges, cosines, "", "C0")
    axes.set(
        title="By direction", xlabel="cosine of the angle with the source's axis", ylabel="per source photon and unit"
    )
    axes.set_xlim(-1, 1)
    _make_log(axes, [cosines])


def _make_log(axes: Axes, shown: Iterable[Estimate]) -> None:
    """Logarithmic from the least bin that has anything, where one has."""
    lit = [(one.mean / np.diff(one.edges[0]))[one.mean > 0] for one in shown if one.edges[0] is not None]
    least = min((values.min() for values in lit if values.size), default=0.0)
    if least > 0:
        axes.set_yscale("log")
        axes.set_ylim(0.5 * least, None)


def _draw_images(strips: Sequence[SubFigure], images: Mapping[str, Estimate]) -> None:
    """Images in rows, each with a scale of its own."""
    names = list(images)
    for row, strip in enumerate(strips):
        own = names[row * _MOST_IMAGES : (row + 1) * _MOST_IMAGES]
        places = strip.subplots(1, min(len(names), _MOST_IMAGES), squeeze=False)[0]
        for axes in places[len(own) :]:
            axes.set_axis_off()
        for axes, name in zip(places, own, strict=False):
            shown = axes.imshow(images[name].mean, origin="lower", vmin=0)
            axes.set(title=f"Pulses in {name}", xlabel="pixel along x", ylabel="pixel along y")
            axes.grid(visible=False)
            strip.colorbar(shown, ax=axes, label="per source photon", format="%.2g")
