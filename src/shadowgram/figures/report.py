"""The demo's report: one HTML file that needs nothing else, no network and no scripts."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from .images import Point, Zoom, toned
from .style import MAP, picture_png, png

# Largest side of an embedded picture; a scene beyond it is thinned out, since a page shows no more.
LARGEST = 512


@dataclass(frozen=True, kw_only=True)
class CameraView:
    """What the report shows of one imager.

    Attributes
    ----------
    name, note : title, and a sentence on how it works.
    score : line below the reconstruction.
    code : (y, x) transmittance or (y, x, 3) colours; of the first shot.
    snapshot : (y, x); the first shot.
    reconstruction : (y, x, 3) colours.
    error : (y, x) RMS error over the bands.
    """

    name: str
    note: str
    score: str
    code: np.ndarray
    snapshot: np.ndarray
    reconstruction: np.ndarray
    error: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Table:
    """Columns with their units, and rows of cells.

    Attributes
    ----------
    texts : number of columns at the left that hold words, not numbers.
    best : cells (row, column) that are the best of their column.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    texts: int
    best: frozenset[tuple[int, int]] = frozenset()


@dataclass(frozen=True, kw_only=True)
class Report:
    """Contents of the page.

    Attributes
    ----------
    title, lead : heading and first paragraph.
    facts : (value, what it is), the few numbers at the top.
    truth : (y, x, 3) colours of the scene.
    views : one an imager.
    zoom : part that is enlarged.
    points : labelled pixels.
    spectra : the same figure on light and on dark paper.
    quality : all reconstructions.
    quality_note : what the table means.
    model_error : the same measurement, reconstructed with different models.
    model_error_note : what the table means.
    settings : (name, value).
    command : that makes this report again.
    """

    title: str
    lead: str
    facts: Sequence[tuple[str, str]]
    truth: np.ndarray
    views: Sequence[CameraView]
    zoom: Zoom
    points: Sequence[Point]
    spectra: tuple[Figure, Figure]
    quality: Table
    quality_note: str
    model_error: Table
    model_error_note: str
    settings: Sequence[tuple[str, str]]
    command: str


def render(report: Report) -> str:
    """HTML text of the report, pictures embedded."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("shadowgram.figures"), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )  # fmt: skip
    worst = max(float(np.percentile(view.error, 99)) for view in report.views)
    ramp = np.linspace(0, 1, 128)[None]
    return environment.get_template("report.html").render(
        report=report,
        height=report.truth.shape[0],
        width=report.truth.shape[1],
        truth=_uri(picture_png(_thinned(report.truth))),
        truth_zoom=_uri(picture_png(report.zoom.of(report.truth))),
        spectra=[_uri(png(figure, transparent=True)) for figure in report.spectra],
        views=[(view, _pictures(view, report.zoom, worst)) for view in report.views],
        worst=worst,
        ramp=_uri(picture_png(ramp, colours=MAP)),
    )


def _pictures(view: CameraView, zoom: Zoom, worst: float) -> dict[str, str]:
    snapshot = toned(view.snapshot)
    return {
        "reconstruction": _uri(picture_png(_thinned(view.reconstruction))),
        "reconstruction_zoom": _uri(picture_png(zoom.of(view.reconstruction))),
        "error": _uri(picture_png(_thinned(view.error), high=worst, colours=MAP)),
        "code": _uri(picture_png(_thinned(view.code))),
        "code_zoom": _uri(picture_png(zoom.of(view.code))),
        "snapshot": _uri(picture_png(_thinned(snapshot))),
        "snapshot_zoom": _uri(picture_png(zoom.of(snapshot))),
    }


def _thinned(picture: np.ndarray) -> np.ndarray:
    step = -(-max(picture.shape[:2]) // LARGEST)
    return picture[::step, ::step]


def _uri(data: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(data).decode("ascii")
