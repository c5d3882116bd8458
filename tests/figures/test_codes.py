"""The sheet of a code."""

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.codes.analysis import aapsd, clusters
from shadowgram.figures.codes import code_sheet
from shadowgram.figures.style import png, style


def titles(figure):
    return [axes.get_title(loc="left") for axes in figure.axes if axes.get_title(loc="left")]


def panel(figure, title):
    return next(axes for axes in figure.axes if axes.get_title(loc="left").startswith(title))


@pytest.fixture(scope="module")
def drawn():
    code = sg.codes.boolean(shots=5, shape=(64, 96), seed=0)
    with style():
        figure = code_sheet(code, title="Boolean", crop=20)
        assert len(png(figure)) > 20_000
    return code, figure


def test_pictures_are_the_code(drawn):
    code, figure = drawn
    assert titles(figure)[:4] == ["Shot 1 of 5", "Shot 2 of 5", "Shot 3 of 5", "All 5 shots"]
    assert np.array_equal(panel(figure, "Shot 2").images[0].get_array(), code[1, :20, :20])
    labels = np.asarray(panel(figure, "All").images[0].get_array()).reshape(-1, 3)
    colours, place = np.unique(labels, axis=0, return_inverse=True)
    assert len(colours) == 5
    for shot in range(5):
        assert len(set(place.ravel()[code[shot, :20, :20].ravel() == 1])) == 1


def test_curves_are_the_spectra_and_runs(drawn):
    code, figure = drawn
    rows, columns = aapsd(code)
    white, along_x, along_y = panel(figure, "Axially").lines
    np.testing.assert_allclose(along_x.get_xydata(), np.stack([np.arange(1, 13) / 24, rows[1:13]], 1))
    np.testing.assert_allclose(along_y.get_xydata(), np.stack([np.arange(1, 9) / 16, columns[1:9]], 1))
    # With E = |DFT|²/energy, a shot that opens 1/5 of a sub-region has 1 − 1/5 of it in each other term, up to its own chance.
    assert white.get_ydata()[0] == pytest.approx(0.8, abs=0.01)
    assert [line.get_label().split(": ")[-1] for line in (along_x, along_y)] == ["white", "white"]
    found = clusters(code)
    chance, runs = panel(figure, "Runs").lines
    np.testing.assert_allclose(runs.get_ydata(), found.histogram[: len(runs.get_ydata())] / found.histogram.sum())
    assert runs.get_ydata().sum() == pytest.approx(1)
    assert chance.get_ydata()[0] == pytest.approx(0.8, abs=0.02)


def test_spectrum_has_its_frequencies_and_no_constant_term():
    y, x = np.mgrid[:40, :60]
    with style():
        figure = code_sheet((y + 2 * x) % 5 == 0, title="diagonals", blocks=4)
    image = panel(figure, "Power").images[0]
    values, (left, right, bottom, top) = image.get_array(), image.get_extent()
    row, column = np.unravel_index(np.nanargmax(values), values.shape)
    fx = left + (right - left) * (column + 0.5) / values.shape[1]
    fy = bottom + (top - bottom) * (row + 0.5) / values.shape[0]
    assert abs(fx * 5 - round(fx * 5)) < 1e-9
    assert abs(fy * 5 - round(fy * 5)) < 1e-9
    assert (2 * fy * 5 - fx * 5) % 5 == pytest.approx(
        0, abs=1e-9
    )  # fx = 2 fy up to whole cycles: both grow to the lower right
    assert bottom > top
    hidden = np.isnan(np.ma.filled(values, np.nan))
    # of 20 rows, from fy = 0.45 to −0.5, and of 30 columns, from fx = −0.5 up
    assert np.argwhere(hidden).tolist() == [[9, 15]]


@pytest.mark.parametrize(
    ("code", "wanted"),
    [
        (sg.codes.random(shots=1, shape=(16, 16), seed=0), ["Shot 1 of 1"]),
        (sg.codes.random(shots=6, shape=(40, 40), seed=0), [f"Shot {k} of 6" for k in (1, 2, 3, 4)]),
        (sg.codes.boolean(shots=12, shape=(40, 40), seed=0), [*(f"Shot {k} of 12" for k in (1, 2, 3)), "All 12 shots"]),
        (np.random.default_rng(0).random((2, 32, 70)), ["Shot 1 of 2", "Shot 2 of 2"]),
        (sg.codes.random(shots=1, shape=(64, 200), seed=0)[0], ["Shot 1 of 1"]),
    ],
)
def test_other_codes(code, wanted):
    with style(dark=True):
        figure = code_sheet(code, title="code")
        assert len(png(figure, dpi=40)) > 3_000
    shown = titles(figure)
    assert shown[: len(wanted)] == wanted
    assert ("Runs of open elements along x" in shown) == (code.dtype == np.uint8)


def test_codes_without_a_pattern():
    with pytest.raises(ValueError, match="the same everywhere"):
        code_sheet(np.ones((2, 32, 32)), title="open")
    with pytest.raises(ValueError, match="closed everywhere"):
        code_sheet(np.zeros((32, 32)), title="closed")
