"""Panels of the studies' figures."""

import numpy as np

from shadowgram.figures.images import Point, Zoom
from shadowgram.figures.sheet import Curve, Curves, Heat, Picture, sheet
from shadowgram.figures.style import png, style


def panels():
    x = np.arange(1, 6.0)
    curves = {
        "truth": Curve(x=x, y=x, reference=True),
        "GPSR": Curve(x=x, y=x**2),
        "_same": Curve(x=x, y=2 * x, dash=1),
    }
    return [
        Curves(title="a", xlabel="s", ylabel="PSNR (dB)", curves=curves, log="xy", marks={2.0: "here"}),
        Heat(
            title="b", values=np.eye(4), extent=(0, 4, 0, 4), xlabel="x", ylabel="y", unit="share",
            lines=[np.array([[0, 0], [4, 4]])],
        ),
        None,
    ]  # fmt: skip


def test_every_kind_of_panel_is_drawn():
    picture = Picture(
        title="c", picture=np.ones((6, 12, 3)), caption="a line", zoom=Zoom(1, 1, 3), points=[Point("T", 2, 2)]
    )
    with style():
        figure = sheet("title", [panels(), [picture, picture]])
        assert len(png(figure)) > 10_000
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert {"a", "b", "c"} <= set(titles)
    curves = figure.axes[0]
    assert curves.get_xscale() == curves.get_yscale() == "log"
    assert [text.get_text() for text in curves.get_legend().get_texts()] == ["truth", "GPSR"]


def test_rows_of_pictures_are_as_high_as_their_pictures():
    wide, tall = (Picture(title="", picture=np.ones(shape)) for shape in ((10, 40), (40, 10)))
    heights = [sheet("", [[picture, picture]]).get_size_inches()[1] for picture in (wide, tall)]
    assert heights[1] > 10 * heights[0]


def test_the_same_panels_give_the_same_bytes():
    with style():
        assert png(sheet("title", [panels()])) == png(sheet("title", [panels()]))
