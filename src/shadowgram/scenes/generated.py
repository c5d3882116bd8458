"""A generated scene: a still life under daylight, made of measured reflectances.

Beads on a wooden table, a ColorChecker and a resolution card leaning against a woven backdrop, a didymium glass and a
row of LEDs. Every material has a spectrum at 1 nm and the bands are exact means of it, and every pixel is the mean of
many samples, so that the same scene can be had at any resolution, in space and in wavelength.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import xarray as xr

from shadowgram._threads import run_chunks

from . import _chart_parts as parts
from ._chart_parts import unit
from ._chart_render import RING_RADIUS, Ball, Camera, Card, StillLife, render
from .datacube import as_datacube

_VISIBLE = (360.0, 780.0)  # nm, where the tables of daylight and observer are
_SAMPLES_AT_ONCE = 2**19


def chart(
    size: int | tuple[int, int] = 256,
    bands: int = 24,
    seed: int = 0,
    wavelengths: tuple[float, float] = (450.0, 650.0),
) -> xr.DataArray:
    """Generate a still life under D65, hard in space and in wavelength.

    Shaded glossy beads and a ColorChecker with measured reflectances, wood and woven cloth, a Siemens star, bars and
    print down to below a pixel, highlights of the lamp, LEDs 10 to 18 nm wide, a didymium glass, and a word printed in
    a metamer of its ground, which a colour camera cannot read.

    Parameters
    ----------
    size : pixels a side, or (y, x). The shorter side shows the same part of the scene at every size.
    bands : number of bands.
    seed : whole number ≥ 0. Places and colours of the beads, textures, and the turn of the cards.
    wavelengths : (shortest, longest) nm, within 360 to 780. The range that the bands cover together: each is as wide as
        the others, and its radiance is the mean over its interval.

    Returns
    -------
    xarray.DataArray
        (band, y, x) float32 radiance in [0, 1] with coordinate `wavelength`, the centres of the bands, in nm. 1 is the
        brightest wavelength of the lamp, in a highlight.

    Raises
    ------
    ValueError
        If a number of pixels or bands is not positive, or the wavelengths are not a rising pair within 360 to 780 nm.

    Notes
    -----
    A cube with n times as many bands, averaged over n, is the cube with fewer bands; likewise for pixels, up to
    sampling. Reflectances beyond the table's 380 and 730 nm are those at its ends. Sources: tables of the CIE and of D.
    Pascale, see `tables/LICENSE-colour`.

    Examples
    --------
    >>> import shadowgram as sg
    >>> scene = sg.scenes.chart(size=(24, 32), bands=4, seed=0, wavelengths=(440, 680))
    >>> scene.shape
    (4, 24, 32)
    >>> scene.wavelength.values
    array([470., 530., 590., 650.])
    """
    ny, nx = _checked_size(size)
    edges = _checked_edges(bands, wavelengths)
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise ValueError(f"seed is a whole number of at least 0, got {seed!r}")
    spectra = parts.spectra(edges).astype(np.float32)
    still_life = _arrange(int(seed))
    factor = int(np.clip(-(-1024 // max(ny, nx)), 2, 8))
    values = np.empty((bands, ny, nx), np.float32)
    step = max(1, _SAMPLES_AT_ONCE // (nx * factor**2))

    def fill(first: int, last: int) -> None:
        for strip in range(first, last):
            rows = slice(strip * step, min((strip + 1) * step, ny))
            abundances = render(still_life, (ny, nx), rows, factor)
            values[:, rows] = np.tensordot(spectra.T, abundances, 1)

    run_chunks(fill, -(-ny // step), 1)
    return as_datacube(values, 0.5 * (edges[1:] + edges[:-1]), name="chart")


def _checked_size(size: int | tuple[int, int]) -> tuple[int, int]:
    pair = size if isinstance(size, tuple | list) else (size, size)
    if len(pair) != 2 or not all(isinstance(n, int | np.integer) and n > 0 for n in pair):
        raise ValueError(f"size is a positive number of pixels, or a pair (y, x) of them, got {size!r}")
    return int(pair[0]), int(pair[1])


def _checked_edges(bands: int, wavelengths: tuple[float, float]) -> np.ndarray:
    if not isinstance(bands, int | np.integer) or bands < 1:
        raise ValueError(f"bands is a positive whole number, got {bands!r}")
    if np.shape(wavelengths) != (2,):
        raise ValueError(f"wavelengths is a pair (shortest, longest) in nm, got {wavelengths!r}")
    low, high = map(float, wavelengths)
    if not _VISIBLE[0] <= low < high <= _VISIBLE[1]:
        raise ValueError(
            f"wavelengths is a rising pair within {_VISIBLE[0]:g} to {_VISIBLE[1]:g} nm, where daylight is tabulated; "
            f"got {low:g} to {high:g}"
        )
    return np.linspace(low, high, int(bands) + 1)


# Colours of beads, each a material and what it shades into.
_BEADS = (
    (parts.RED, parts.MODERATE_RED),
    (parts.ORANGE, parts.ORANGE_YELLOW),
    (parts.YELLOW, parts.YELLOW_GREEN),
    (parts.GREEN, parts.YELLOW_GREEN),
    (parts.CYAN, parts.BLUISH_GREEN),
    (parts.BLUE, parts.PURPLISH_BLUE),
    (parts.PURPLE, parts.MAGENTA),
    (parts.MAGENTA, parts.MODERATE_RED),
    (parts.WHITE, parts.LIGHT_SKIN),
    (parts.BLUISH_GREEN, parts.BLUE_SKY),
    (parts.BLACK, parts.NEUTRAL_35),
    (parts.BLUE_FLOWER, parts.PURPLISH_BLUE),
)
_STRIPES = (
    (parts.WHITE, parts.RED),
    (parts.YELLOW, parts.BLUE),
    (parts.WHITE, parts.CYAN),
    (parts.BLACK, parts.ORANGE),
    (parts.WHITE, parts.GREEN),
)
_THREADS = (
    (parts.PURPLISH_BLUE, parts.NEUTRAL_65),
    (parts.FOLIAGE, parts.NEUTRAL_65),
    (parts.BLUE_FLOWER, parts.NEUTRAL_5),
    (parts.NEUTRAL_5, parts.BLUE_SKY),
)


def _arrange(seed: int) -> StillLife:
    rng = np.random.default_rng([seed, 10])  # the second word chose the picture of seed 0
    lamp = unit(np.array([-0.62, 1.0, 0.72]) + rng.uniform(-0.08, 0.08, 3)).astype(np.float32)
    checker = _leaning(parts.colorchecker, (-0.99, 0.0, -0.95), 1.92, 1.36, *rng.uniform((0.06, 0.20), (0.18, 0.30)))
    target = _leaning(parts.resolution_card, (0.98, 0.0, -0.90), 1.74, 1.74, *rng.uniform((-0.16, 0.18), (-0.04, 0.26)))
    board = Card(
        corner=np.array([-1.27, 0.01, 2.10]),
        along=np.array([1.26, 0.0, 0.10]),
        upward=np.array([0.019, 0.0, -0.24]),
        drawing=parts.circuit_board,
    )
    leds = _row_of_leds(board, rng)
    glass = np.array([rng.uniform(-0.50, -0.30), RING_RADIUS, rng.uniform(-0.25, -0.10)])
    # The LEDs are not to be hidden by what lies before them.
    taken = [(led.centre[0], led.centre[2] + before, 0.15) for led in leds for before in (0, 0.25)]
    return StillLife(
        camera=Camera.looking((0.0, 2.75, 6.4), (0.0, 0.52, 0.0), 0.292),
        lamp=lamp,
        tile=parts.fractal_tile(seed),
        threads=_THREADS[rng.integers(len(_THREADS))],
        cards=(checker, target, board),
        glass=glass,
        beads=_scattered_beads([*taken, (glass[0], glass[2], RING_RADIUS)], rng),
        leds=leds,
    )


def _leaning(
    drawing: Callable[[np.ndarray, np.ndarray], parts.Paint],
    foot: tuple[float, float, float],
    width: float,
    height: float,
    yaw: float,
    lean: float,
) -> Card:
    """A card that stands with the middle of its lower side at `foot`, turned and leaning back by angles in rad."""
    along = width * np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
    upward = height * np.array([-np.sin(lean) * np.sin(yaw), np.cos(lean), -np.sin(lean) * np.cos(yaw)])
    return Card(np.array(foot) - 0.5 * along, along, upward, drawing)


def _row_of_leds(board: Card, rng: np.random.Generator) -> tuple[Ball, ...]:
    count = len(parts.LEDS)
    radius = 0.062
    start = board.corner + 0.5 * board.upward + [0.0, radius, 0.0]
    return tuple(
        Ball(
            centre=start + (place + 0.5) / count * board.along,
            radius=radius,
            materials=(parts.FIRST_LED + int(led), parts.WHITE),
            pattern="led",
            axis=np.array([0.0, 1.0, 0.0]),
            drilled=False,
        )
        for place, led in enumerate(rng.permutation(count))
    )


def _scattered_beads(taken: list[tuple[float, float, float]], rng: np.random.Generator) -> tuple[Ball, ...]:
    """Beads of falling size, thrown on the table until each finds a place outside of the circles (x, z, radius) `taken`."""
    middle = [0.33, 0.29, 0.26] + [0.22] * 4 + [0.165] * 9 + [0.115] * 18 + [0.075] * 30 + [0.048] * 20
    wings = [0.30, 0.22, 0.22, 0.165, 0.165, 0.115, 0.115, 0.115, 0.075, 0.075] * 4  # seen in wide pictures only
    beads: list[Ball] = []
    for radius, nearest, farthest in [(r, 0.0, 1.75) for r in middle] + [(r, 1.8, 6.0) for r in wings]:
        for _ in range(60):
            x = rng.choice((-1, 1)) * rng.uniform(nearest, farthest)
            z = rng.uniform(4.2 * radius - 0.45, 2.5)  # large beads stay away from the cards
            if _is_free(x, z, radius, taken, beads):
                beads.append(_bead(np.array([x, radius, z]), radius, rng))
                break
    return tuple(beads)


def _is_free(x: float, z: float, radius: float, taken: list[tuple[float, float, float]], beads: list[Ball]) -> bool:
    # Two balls on a table touch when their feet are 2 √(r₁ r₂) apart.
    return all(np.hypot(x - p, z - q) > r + radius for p, q, r in taken) and all(
        np.hypot(x - b.centre[0], z - b.centre[2]) > 2.02 * np.sqrt(radius * b.radius) for b in beads
    )


def _bead(centre: np.ndarray, radius: float, rng: np.random.Generator) -> Ball:
    pattern = ("plain", "plain", "marble", "stripes")[rng.integers(4)]
    colours = _STRIPES if pattern == "stripes" else _BEADS
    return Ball(
        centre=centre,
        radius=radius,
        materials=colours[rng.integers(len(colours))],
        pattern=pattern,
        axis=unit(rng.normal([0, 0.6, 0.9])),
        drilled=bool(rng.random() < 0.6),
    )
