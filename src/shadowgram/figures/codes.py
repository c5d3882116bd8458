"""What a coded aperture is like, on one sheet: the pattern, its power spectrum and its clusters."""

from __future__ import annotations

import math

import matplotlib as mpl
import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from shadowgram.codes.analysis import bartlett, clusters, frequencies, noise_colour
from shadowgram.codes.patterns import check_code

from .sheet import LINE_STYLES, Curve, Curves, Heat, Panel, Picture, sheet
from .style import BLUE, GREEN, MAP, ORANGE, PURPLE, SKY, VERMILION, YELLOW

LABELS = (BLUE, ORANGE, GREEN, YELLOW, PURPLE, SKY, VERMILION)
PLACES = 4  # pictures in a row
LONGEST = 20  # runs that are shown
UNMARKED = len(LINE_STYLES)  # dash of a line drawn through, without markers


def code_sheet(code: np.ndarray, *, title: str, blocks: int = 16, crop: int = 32) -> Figure:
    """Pattern, spectrum and clusters of a code.

    The upper row shows the upper left corner of the first shots, element by element, and of a complementary code all shots as one
    picture, in which a colour stands for the shot that opens an element. The lower row shows Bartlett's spectrum without the
    constant term, its mean over rows and over columns against the level of a pattern without order, and how long the runs of open
    elements along x are, against chance; gray codes have no runs.

    Parameters
    ----------
    code : (shot, y, x) or (y, x), transmittance in [0, 1].
    title : of the sheet.
    blocks : number of sub-regions of the spectrum, a square number.
    crop : side of the corner shown, elements.

    Raises
    ------
    ValueError
        If the code is not one, or is the same everywhere.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.figures.codes import code_sheet
    >>> figure = code_sheet(sg.codes.boolean(shots=3, shape=(64, 64), seed=0), title="Boolean code, 3 shots")
    >>> len(figure.axes)
    8
    """
    return sheet(title, _rows(code, blocks, crop))


def sensing_sheet(
    code: np.ndarray,
    *,
    title: str,
    likeness: np.ndarray | None = None,
    singular_values: np.ndarray | None = None,
    blocks: int = 16,
    crop: int = 32,
) -> Figure:
    """The sheet of a code, and below it what its sensing matrix is like.

    Parameters
    ----------
    code, title, blocks, crop : as for `code_sheet`.
    likeness : (bin,) number of voxel pairs over equal bins of likeness from 0 to 1, such as `Coherence.histogram`.
    singular_values : of the sensing matrix, largest first.

    Raises
    ------
    ValueError
        As `code_sheet`.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.figures.codes import sensing_sheet
    >>> code = sg.codes.boolean(shots=3, shape=(64, 64), seed=0)
    >>> figure = sensing_sheet(code, title="Boolean code", likeness=[30, 20, 10], singular_values=[2.0, 1.5, 0.1])
    >>> len(figure.axes)
    10
    """
    panels: list[Panel | None] = []
    if likeness is not None:
        share = np.asarray(likeness, float) / max(np.sum(likeness), 1)
        middle = (np.arange(share.size) + 0.5) / share.size
        panels.append(
            Curves(
                title="Likeness of voxels that share a detector element",
                xlabel="|⟨a, b⟩| / (‖a‖ ‖b‖)",
                ylabel="share of pairs",
                curves={"_": Curve(x=middle, y=share, dash=UNMARKED)},
                bottom=0.0,
            )
        )
    if singular_values is not None:
        number = np.arange(1, len(singular_values) + 1)
        panels.append(
            Curves(
                title="Singular values",
                xlabel="number",
                ylabel="singular value",
                curves={"_": Curve(x=number, y=singular_values, colour=1, dash=UNMARKED)},
                bottom=0.0,
            )
        )
    return sheet(title, [*_rows(code, blocks, crop), panels] if panels else _rows(code, blocks, crop))


def _rows(code: np.ndarray, blocks: int, crop: int) -> list[list[Panel | None]]:
    density = bartlett(code, blocks)
    code = check_code(code, np.shape(code)[-2:])
    spectra: list[Panel | None] = [_spectrum(density), _axial(density, _independent(code))]
    if code.dtype == np.uint8:
        spectra.append(_runs(code))
    return [_pictures(code, crop), spectra]


def _pictures(code: np.ndarray, crop: int) -> list[Panel | None]:
    """Shots and labels, as wide together as the code allows."""
    whole = _complementary(code)
    count = min(len(code) + whole, PLACES)
    side = min(crop, *code.shape[1:])
    across = min(side * PLACES // count, code.shape[2])
    corner, width = code[:, :side, :across], across / side
    panels: list[Panel | None] = [
        Picture(
            title=f"Shot {shot + 1} of {len(code)}",
            picture=corner[shot].astype(np.float64),
            caption=f"{100 * code[shot].mean():.3g} % open",
            width=width,
        )
        for shot in range(count - whole)
    ]
    if whole:
        labels = _label_colours(len(code))[corner.argmax(axis=0)]
        panels.append(Picture(title=f"All {len(code)} shots", picture=labels, caption="one colour a shot", width=width))
    return panels + [None] * math.floor(PLACES - count * width)


def _complementary(code: np.ndarray) -> bool:
    """Every element is open in one shot, and there is more than one."""
    return code.dtype == np.uint8 and len(code) > 1 and bool((code.sum(axis=0, dtype=int) == 1).all())


def _independent(code: np.ndarray) -> int:
    """Elements that chance could set: the last of complementary shots follows from the others."""
    return code.size - code[0].size if _complementary(code) else code.size


def _label_colours(count: int) -> np.ndarray:
    """(count, 3) colours in [0, 1] that colour-blind people can tell apart: named ones, or as many steps of a scale."""
    if count <= len(LABELS):
        return np.array([to_rgb(colour) for colour in LABELS[:count]])
    return mpl.colormaps[MAP](np.linspace(0, 1, count))[:, :3]


def _spectrum(density: np.ndarray) -> Heat:
    values = density.copy()
    values[0, 0] = np.nan
    values = np.fft.fftshift(values)
    lowest_y, lowest_x = (-(n // 2 + 0.5) / n for n in density.shape)
    return Heat(
        title="Power spectrum, |DFT|² / energy",
        values=values[::-1],  # fy grows downwards, as y does in the pictures
        extent=(lowest_x, lowest_x + 1, lowest_y + 1, lowest_y),
        xlabel="fx (cycles/element)",
        ylabel="fy (cycles/element)",
        unit="",
        low=0.0,
        high=max(float(np.nanpercentile(values, 99.5)), 1.5 * float(np.nanmean(values))),
        aspect="equal",
    )


def _axial(density: np.ndarray, elements: int) -> Curves:
    white = (density.sum() - density[0, 0]) / (density.size - 1)
    curves = {"a pattern without order": Curve(x=[0, 0.5], y=[white, white], reference=True)}
    for number, (name, axis) in enumerate({"along x, mean over rows": 0, "along y, mean over columns": 1}.items()):
        spectrum = density.mean(axis=axis)
        half = np.arange(1, len(spectrum) // 2 + 1)
        colour = noise_colour(spectrum, elements=elements)
        curves[f"{name}: {colour}"] = Curve(x=np.abs(frequencies(len(spectrum))[half]), y=spectrum[half], colour=number)
    return Curves(
        title="Axially averaged spectrum",
        xlabel="frequency (cycles/element)",
        ylabel="|DFT|² / energy",
        curves=curves,
        bottom=0.0,
        top=1.45 * max(float(np.max(curve.y)) for curve in curves.values()),  # room for the legend
    )


def _runs(code: np.ndarray) -> Curves:
    found = clusters(code)
    most = min(max(int(np.flatnonzero(found.histogram)[-1]) + 2, 3), LONGEST, code.shape[2])
    length = np.arange(1, most + 1)
    share = found.histogram[:most] / found.histogram.sum()
    chance = found.chance_histogram[:most] / found.chance_histogram.sum()
    return Curves(
        title="Runs of open elements along x",
        xlabel="length of a run (elements)",
        ylabel="share of runs",
        curves={
            f"by chance, mean {found.chance_mean_run:.3g}": Curve(x=length, y=chance, reference=True),
            f"this code, mean {found.mean_run:.3g}": Curve(x=length, y=share, colour=2),
        },
        bottom=0.0,
    )
