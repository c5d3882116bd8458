"""Figures of simulations: what they show is what was found."""

import numpy as np
import pytest

from shadowgram.figures.style import png, style
from shadowgram.figures.xray_tallies import tallies
from shadowgram.xray.montecarlo.arrays import ORDERS
from shadowgram.xray.montecarlo.run import Run
from shadowgram.xray.montecarlo.tallies import Estimate

BINS = np.arange(0, 21.0)


def estimate(mean, axes=(), edges=()):
    mean = np.asarray(mean, float)
    return Estimate(mean=mean, standard_error=0.1 * mean, unit="counts", axes=axes, edges=edges)


def run(pixels, seed=0):
    """A run with a detector for each shape of an image."""
    rng = np.random.default_rng(seed)
    found = {"all": estimate(1), "all/orders": estimate(np.ones(9), ("order",), (None,))}
    for i, shape in enumerate(pixels):
        name = f"plate {i}"
        orders = rng.random(9) * (np.arange(9) != ORDERS.index("fluorescence"))
        spectrum = rng.random(20) * (BINS[:-1] < 15)
        found[name] = estimate(orders.sum())
        found[f"{name}/orders"] = estimate(orders, ("order",), (None,))
        found[f"{name}/spectrum"] = estimate(spectrum, ("energy",), (2 * BINS,))
        found[f"{name}/image"] = estimate(rng.random(shape), ("y", "x"), (None, None))
    for side in ("backward", "forward"):
        found[f"escaped/{side}/spectrum"] = estimate(rng.random(20) * (BINS[:-1] > 3), ("energy",), (BINS,))
    found["escaped/cosine"] = estimate(rng.random(80), ("cosine",), (np.linspace(-1, 1, 81),))
    return Run(tallies=found, histories=1000, seconds=1.0, finished=True)


def titles(figure):
    return [axes.get_title(loc="left") for axes in figure.axes if axes.get_title(loc="left")]


def test_spectra_and_orders_of_detectors():
    found = run([(1, 1), (1, 1)])
    with style():
        figure = tallies(found, "A scene")
        assert len(png(figure)) > 10_000
    assert titles(figure) == ["Pulses", "Counts by what the photon did before"]
    assert figure.get_suptitle() == "A scene: 1000 photons"
    left, right = figure.axes
    heights, edges, _ = left.patches[0].get_data()
    np.testing.assert_allclose(heights, found.tallies["plate 0/spectrum"].mean / 2)
    np.testing.assert_array_equal(edges, 2 * BINS)
    assert left.get_xlim() == (0, 30)
    assert [text.get_text() for text in right.get_yticklabels()] == [one for one in ORDERS if one != "fluorescence"]
    widths = [patch.get_width() for patch in right.patches]
    expected = [np.delete(found.tallies[f"plate {i}/orders"].mean, ORDERS.index("fluorescence")) for i in (0, 1)]
    np.testing.assert_allclose(widths, np.concatenate(expected))
    bars = right.containers[0].lines[2][0].get_segments()
    np.testing.assert_allclose([np.ptp(segment[:, 0]) for segment in bars], 0.2 * expected[0])


@pytest.mark.parametrize(("shapes", "rows"), [([(4, 3)], 1), ([(4, 3), (1, 1), (8, 8)], 1), ([(2, 2)] * 5, 2)])
def test_images_of_detectors_with_pixels(shapes, rows):
    found = run(shapes)
    with style():
        figure = tallies(found)
    shown = [i for i, shape in enumerate(shapes) if shape != (1, 1)]
    assert titles(figure)[2:] == [f"Pulses in plate {i}" for i in shown]
    images = [axes.images[0] for axes in figure.axes if axes.images]
    for i, image in zip(shown, images, strict=True):
        np.testing.assert_array_equal(image.get_array(), found.tallies[f"plate {i}/image"].mean)
        assert image.origin == "lower"
    assert figure.get_figheight() == pytest.approx(3.5 + 3 * rows)


def test_what_escapes_where_there_is_no_detector():
    with style():
        figure = tallies(run([]))
    assert titles(figure) == ["What left the world", "By direction"]
    assert [axes.get_yscale() for axes in figure.axes] == ["log", "log"]


def test_nothing_found_is_drawn_too():
    found = run([(1, 1)])
    nothing = {
        name: Estimate(
            mean=0 * one.mean, standard_error=np.full(one.mean.shape, np.inf), unit="", axes=one.axes, edges=one.edges
        )
        for name, one in found.tallies.items()
    }
    with style():
        for kept in (nothing, {name: one for name, one in nothing.items() if not name.startswith("plate")}):
            assert png(tallies(Run(tallies=kept, histories=2, seconds=0.0, finished=False)))
