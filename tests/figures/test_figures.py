"""Figures: arrays in, self-standing figures out, nothing global changed."""

import io
import subprocess
import sys

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.image import imread

from shadowgram.figures import images, lines, overview, style
from shadowgram.figures.images import Point, Zoom

RGB = np.random.default_rng(0).integers(256, size=(24, 32, 3), dtype=np.uint8)


def pixels(data):
    return imread(io.BytesIO(data))


def test_style_is_gone_afterwards():
    before = dict(mpl.rcParams)
    with style.style(dark=True):
        assert mpl.rcParams["text.color"] == style.INK_DARK
    assert dict(mpl.rcParams) == before


def test_no_window_and_no_pyplot():
    code = (
        "import sys, numpy as np; from shadowgram.figures import images, style\n"
        "with style.style(): style.png(images.gallery({'a': np.ones((8, 8))}))\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_picture_png_is_exact():
    assert np.array_equal(np.rint(255 * pixels(style.picture_png(RGB))[..., :3]), RGB)
    grey = np.array([[0.0, 0.5], [1.0, 2.0]])
    shown = pixels(style.picture_png(grey))[..., 0]
    assert np.allclose(shown, [[0, 0.5], [1, 1]], atol=1 / 255)


def test_read_grey_gives_back_a_code(tmp_path):
    code = np.random.default_rng(0).integers(2, size=(9, 7))
    (tmp_path / "code.png").write_bytes(style.picture_png(code))
    assert np.array_equal(style.read_grey(tmp_path / "code.png"), code)


def test_read_grey_refuses_what_is_no_picture(tmp_path):
    (tmp_path / "code.png").write_text("no picture")
    with pytest.raises(ValueError, match=r"code\.png is not a PNG picture"):
        style.read_grey(tmp_path / "code.png")


def test_dark_figure_is_dark():
    def corner(dark):
        with style.style(dark=dark):
            figure = style.new_figure(2, 2)
            figure.subplots()
            return pixels(style.png(figure, dpi=40))[0, 0, 0]

    assert corner(False) > 0.9
    assert corner(True) < 0.2


def test_gallery_shows_the_pictures_and_their_zoom():
    figure = images.gallery(
        {"a": RGB, "b": RGB[::-1]}, zoom=Zoom(4, 6, 8), points=[Point("T1", 3, 5)], captions={"b": "20 dB"}
    )
    shown = [axes.images[0].get_array() for axes in figure.axes]
    assert np.array_equal(shown[0], RGB)
    assert np.array_equal(shown[2], RGB[4:12, 6:14])
    assert np.array_equal(shown[3], RGB[::-1][4:12, 6:14])
    assert [axes.get_title(loc="left") or axes.get_title() for axes in figure.axes[:2]] == ["a", "b"]
    assert figure.axes[3].get_xlabel() == "20 dB"
    assert [text.get_text() for text in figure.axes[0].texts] == ["T1"]


@pytest.mark.parametrize("shape", [(6, 12, 16), (6, 5, 12, 16)], ids=["code", "colored code"])
def test_shots_shows_at_most_four(shape):
    figure = images.shots(np.ones(shape), np.ones((6, 12, 20)))
    assert len(figure.axes) == 8


def test_toned_is_monotone_and_bounded():
    snapshots = np.linspace(-1, 5, 1000).reshape(10, 10, 10)
    shown = images.toned(snapshots)
    assert shown.min() == 0
    assert shown.max() == 1
    assert (np.diff(shown.ravel()) >= 0).all()
    assert (images.toned(np.zeros((1, 4, 4))) == 0).all()


def test_busiest_part_lies_in_the_picture():
    for size in (1, 5, 23):
        zoom = images.busiest(RGB, size)
        assert zoom.of(RGB).shape[:2] == (size, size)


def test_spectra_draws_truth_and_estimates_with_units():
    nm = np.linspace(450, 650, 7)
    truth = {"T1": np.ones(7), "T2": np.zeros(7)}
    figure = lines.spectra(nm, truth, {"SSCSI": truth, "CASSI": truth}, {"SSCSI": nm / 20, "CASSI": nm / 30})
    first, _, quality = figure.axes
    assert [line.get_label() for line in first.lines] == ["truth", "SSCSI", "CASSI"]
    assert np.array_equal(first.lines[0].get_xdata(), nm)
    assert first.get_xlabel() == "wavelength (nm)"
    assert quality.get_ylabel() == "PSNR (dB)"


def test_overview_has_four_pictures_and_a_panel_for_each_point():
    line = np.linspace(0, 1, 5)
    figure = overview.overview(
        scene=RGB, code=RGB[..., 0] / 255, snapshot=RGB[..., 0] / 255, reconstruction=RGB, titles=("a", "b", "c", "d"),
        zoom=Zoom(2, 3, 8), points=[Point("T1", 3, 3), Point("T2", 9, 9)], wavelengths=line,
        truth={"T1": line, "T2": line}, estimate={"T1": line, "T2": line},
    )  # fmt: skip
    assert len(figure.axes) == 10
    with style.style():
        assert style.png(figure, dpi=30).startswith(b"\x89PNG")
