"""What the generated scene is made of: spectra of its materials, textures, and the drawings on its cards.

A material is a row of `spectra`; a surface is painted with two of them and a mixing ratio between 0 and 1 per sample.
Plane patterns take coordinates on their surface and give those three things.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np

from . import colour

Paint = tuple[np.ndarray | int, np.ndarray | int, np.ndarray | float]  # first material, second, share of the second

# Rows of `spectra`: the patches of the ColorChecker come first, in its order.
(
    DARK_SKIN,
    LIGHT_SKIN,
    BLUE_SKY,
    FOLIAGE,
    BLUE_FLOWER,
    BLUISH_GREEN,
    ORANGE,
    PURPLISH_BLUE,
    MODERATE_RED,
    PURPLE,
    YELLOW_GREEN,
    ORANGE_YELLOW,
    BLUE,
    GREEN,
    RED,
    YELLOW,
    MAGENTA,
    CYAN,
    WHITE,
    NEUTRAL_8,
    NEUTRAL_65,
    NEUTRAL_5,
    NEUTRAL_35,
    BLACK,
    METAMER,
    LAMP,
) = range(26)
LEDS = ((468, 16), (503, 14), (526, 18), (566, 10), (592, 12), (631, 14))  # peak and full width at half maximum, nm
FIRST_LED = LAMP + 1
BEHIND_GLASS = FIRST_LED + len(LEDS)  # material BEHIND_GLASS + k is material k behind the glass
MATERIALS = 2 * BEHIND_GLASS

# Absorption bands of neodymium and praseodymium in glass: wavelength and full width, nm; optical density.
_DIDYMIUM = (
    (432, 10, 0.35),
    (445, 10, 0.45),
    (473, 9, 0.40),
    (482, 8, 0.30),
    (513, 8, 0.55),
    (527, 10, 0.85),
    (573, 9, 1.00),
    (585, 11, 1.60),
    (625, 8, 0.12),
    (684, 9, 0.30),
    (740, 16, 1.20),
)


def spectra(edges: np.ndarray) -> np.ndarray:
    """Mean radiance of every material over the bands between `edges` (bands + 1,) nm, (material, band), in full light.

    The brightest wavelength of daylight between the edges is 1.
    """
    nm, functions, power = colour.observer()
    patch_nm, patches = colour.colorchecker()
    reflectance = np.stack([np.interp(nm, patch_nm, patch) for patch in patches])
    reflectance = np.vstack([reflectance, _metamer(nm, functions * power, reflectance[NEUTRAL_5])])
    inside = np.union1d(nm[(nm > edges[0]) & (nm < edges[-1])], edges)
    lamp = power / np.interp(inside, nm, power).max()
    leds = [_peak(nm, centre, width) for centre, width in LEDS]
    lit = np.vstack([reflectance * lamp, lamp, leds])
    glass = 0.92 * 10 ** -sum(density * _peak(nm, centre, width) for centre, width, density in _DIDYMIUM)
    return colour.band_means(nm, np.vstack([lit, lit * glass]), edges)


def _peak(nm: np.ndarray, centre: float, width: float) -> np.ndarray:
    return np.exp(-4 * np.log(2) * ((nm - centre) / width) ** 2)


def _metamer(nm: np.ndarray, functions: np.ndarray, grey: np.ndarray) -> np.ndarray:
    """Another reflectance that looks like `grey` in daylight: a ripple that the observer cannot see is added to it."""
    window = np.clip((nm - 455) / 20, 0, 1) * np.clip((645 - nm) / 20, 0, 1)
    ripple = window * np.cos(2 * np.pi * nm / 62)
    basis = window * functions
    ripple -= basis.T @ np.linalg.solve(functions @ basis.T, functions @ ripple)
    return grey * (1 + 0.75 * ripple / np.abs(ripple).max())


def fractal_tile(seed: int, side: int = 512) -> np.ndarray:
    """Seeded 1/f noise that repeats without a seam, (side, side) float32, mean 0 and standard deviation 1."""
    rng = np.random.default_rng([seed, 77])
    frequency = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None, :])
    frequency[0, 0] = np.inf
    phase = rng.uniform(0, 2 * np.pi, frequency.shape)
    tile = np.fft.irfft2(np.exp(1j * phase) / frequency**1.15, s=(side, side))
    return ((tile - tile.mean()) / tile.std()).astype(np.float32)


def sample(tile: np.ndarray, s: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Value of a repeating tile of side 1 at (s, t), linear between its points."""
    side = tile.shape[0]
    x, y = s * side, t * side
    fx, fy = np.floor(x), np.floor(y)
    x, y = x - fx, y - fy
    i0, j0 = fy.astype(np.int32) % side, fx.astype(np.int32) % side
    i1, j1 = (i0 + 1) % side, (j0 + 1) % side
    flat = tile.ravel()
    low = flat[i0 * side + j0] * (1 - x) + flat[i0 * side + j1] * x
    return low * (1 - y) + (flat[i1 * side + j0] * (1 - x) + flat[i1 * side + j1] * x) * y


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products of vectors (3, ...), the first one vector or as many as the second."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def unit(v: np.ndarray) -> np.ndarray:
    """Directions of vectors (3, ...)."""
    return v / np.sqrt(dot(v, v))


def ramp(x: np.ndarray, low: float, high: float) -> np.ndarray:
    """0 below `low`, 1 above `high`, smooth between."""
    x = np.clip((x - low) / (high - low), 0, 1)
    return x * x * (3 - 2 * x)


def wood(x: np.ndarray, z: np.ndarray, tile: np.ndarray) -> tuple[Paint, np.ndarray]:
    """Planks along x: paint, and a factor on the light."""
    plank = np.floor(z / 0.62)
    across = z / 0.62 - plank
    x = x + 1.37 * plank
    slow = sample(tile, 0.05 * x + 0.31 * plank, 0.22 * z)
    fibres = sample(tile, 0.06 * x, 1.9 * z + 0.37 * plank)
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * (5.5 * z + 0.55 * slow + 0.9 * plank))
    share = np.clip(0.30 + 0.32 * rings + 0.13 * fibres + 0.10 * np.sin(4.1 * plank), 0, 1)
    gap = ramp(np.abs(across - 0.5), 0.485, 0.497)
    return (DARK_SKIN, ORANGE_YELLOW, 0.62 * share * (1 - gap)), (0.72 + 0.06 * fibres + 0.03 * slow) * (1 - 0.8 * gap)


def weave(x: np.ndarray, y: np.ndarray, tile: np.ndarray, threads: tuple[int, int]) -> tuple[Paint, np.ndarray]:
    """Plain weave of two threads, the warp and the weft: paint, and a factor on the light."""
    pitch = 0.052
    slub = sample(tile, 0.35 * x, 0.9 * y)
    u, v = x / pitch + 0.08 * slub, y / pitch + 0.10 * sample(tile, 0.8 * y, 0.3 * x)
    i, j = np.floor(u), np.floor(v)
    along_u, along_v = u - i - 0.5, v - j - 0.5
    warp_on_top = ((i + j) % 2) > 0.5
    across = np.where(warp_on_top, along_u, along_v)
    along = np.where(warp_on_top, along_v, along_u)
    height = np.sqrt(np.maximum(1 - (2 * across) ** 2, 0)) * (1 - 1.2 * along**2)
    share = np.clip(np.where(warp_on_top, 0.88, 0.12) + 0.08 * slub, 0, 1)
    folds = 1 + 0.13 * np.sin(2.6 * x + 0.35 * y + 0.8 * sample(tile, 0.11 * x, 0.04 * y))
    return (threads[0], threads[1], share), (0.45 + 0.55 * height) * (1 + 0.06 * slub) * folds


def bead(
    pattern: str, materials: tuple[int, int], axis: np.ndarray, drilled: bool, normals: np.ndarray, veins: np.ndarray
) -> tuple[Paint, np.ndarray]:
    """Paint of a bead at `normals` (3, n), and how much of its surface lies in the dark of the hole."""
    height = dot(axis.astype(np.float32), normals)
    if pattern == "stripes":
        share = ramp(np.sin(9.5 * height + 0.3 * veins), -0.15, 0.15)
    elif pattern == "marble":
        share = ramp(veins, -0.9, 1.1)
    else:
        share = np.clip(0.12 + 0.06 * veins, 0, 1)
    dark = ramp(height, 0.955, 0.972) if drilled else np.zeros_like(height)
    return (*materials, share), dark


def colorchecker(s: np.ndarray, t: np.ndarray) -> Paint:
    """Four rows of six patches in a black frame; s and t run from 0 to 1, right and up."""
    u, v = s * 6.5 - 0.25, (1 - t) * 4.5 - 0.25
    column, row = np.clip(np.floor(u), 0, 5), np.clip(np.floor(v), 0, 3)
    inside = (np.abs(u - column - 0.5) < 0.43) & (np.abs(v - row - 0.5) < 0.43)
    return np.where(inside, (6 * row + column).astype(np.int32), BLACK), BLACK, 0.0


def resolution_card(s: np.ndarray, t: np.ndarray) -> Paint:
    """Star, bars, print, and a word that only a spectral camera can read; s and t run from 0 to 1, right and up."""
    ink = np.full(s.shape, WHITE)
    radius, angle = np.hypot(s - 0.285, t - 0.70), np.arctan2(t - 0.70, s - 0.285)
    ink[(radius < 0.235) & (np.sin(32 * angle) > 0)] = BLACK
    ink[radius < 0.012] = BLACK
    ink[_bars(s, t)] = BLACK
    for text, left, base, height, colour_of_ink in _PRINT:
        ink[_print(text, s, t, left, base, height)] = colour_of_ink
    strip = (s > 0.05) & (s < 0.95) & (t > 0.045) & (t < 0.145)
    ink[strip] = NEUTRAL_5
    ink[strip & _print("SPECTRUM", s, t, 0.12, 0.062, 0.066, bold=1.25)] = METAMER
    return ink, WHITE, 0.0


def _bars(s: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Groups of three bars, upright on the left and lying on the right, each group finer by 2^(1/2)."""
    black = np.zeros(s.shape, bool)
    top, pitch = 0.935, 0.046
    for _ in range(7):
        side = 2.5 * pitch  # bar, space, bar, space, bar
        for across, along in ((s - 0.57, top - t), (top - t, s - 0.78)):
            black |= (across >= 0) & (across < side) & (across % pitch < 0.5 * pitch) & (along >= 0) & (along < side)
        top -= side + 0.022
        pitch /= 2**0.5
    return black


_PRINT = (
    ("SHADOWGRAM", 0.05, 0.355, 0.070, BLACK),
    ("CODED APERTURES", 0.05, 0.278, 0.050, RED),
    ("FROM VISIBLE LIGHT TO X-RAYS", 0.05, 0.225, 0.030, BLUE),
    ("THE QUICK BROWN FOX JUMPS OVER THE LAZY DOG", 0.05, 0.190, 0.0205, BLACK),
    ("0123456789", 0.775, 0.355, 0.018, GREEN),
    ("PACK MY BOX WITH FIVE DOZEN LIQUOR JUGS 31415926535897932384", 0.05, 0.165, 0.0145, BLACK),
)

# Strokes on a grid 4 wide and 6 high: each word is a line through points, two digits a point.
_GLYPHS = {
    "A": "002640 1232",
    "B": "00063645443303 3342413000",
    "C": "4536160501103041",
    "D": "00062644422000",
    "E": "40000646 0333",
    "F": "000646 0333",
    "G": "45361605011030414323",
    "H": "0006 4046 0343",
    "I": "2026",
    "J": "4641301001",
    "K": "0006 4602 1340",
    "L": "060040",
    "M": "0006234640",
    "N": "00064046",
    "O": "100105163645413010",
    "P": "00063645443303",
    "Q": "100105163645413010 2240",
    "R": "00063645443303 2340",
    "S": "453616050413334241301001",
    "T": "0646 2620",
    "U": "060110304146",
    "V": "062046",
    "W": "0610233046",
    "X": "0046 0640",
    "Y": "062346 2320",
    "Z": "06460040",
    "0": "100105163645413010 1135",
    "1": "142620 1030",
    "2": "05163645440040",
    "3": "064623334241301001",
    "4": "30360242",
    "5": "460603334241301001",
    "6": "453616050110304142331302",
    "7": "064610",
    "8": "13040516364544331302011030414233",
    "9": "011030414536160504133344",
    "-": "1333",
}


def circuit_board(s: np.ndarray, t: np.ndarray) -> Paint:
    """Dark strip with a conductor along each side, on which the LEDs sit; s and t from 0 to 1."""
    copper = np.abs(np.abs(t - 0.5) - 0.36) < 0.05
    pads = np.hypot((len(LEDS) * s) % 1 - 0.5, 0.9 * (t - 0.5)) < 0.33
    return np.where(copper | pads, ORANGE_YELLOW, GREEN), BLACK, np.where(copper | pads, 0.45, 0.8)


@cache
def _strokes() -> tuple[dict[str, int], np.ndarray]:
    """Number of each character, and its strokes (character, stroke, 4), x0 y0 x1 y1; number 0 is blank."""
    lines = [[]]
    for words in _GLYPHS.values():
        points = [[(int(w[k]), int(w[k + 1])) for k in range(0, len(w), 2)] for w in words.split()]
        lines.append([(*p, *q) for line in points for p, q in pairwise(line)])
    table = np.full((len(lines), max(map(len, lines)), 4), -99.0, np.float32)
    for number, strokes in enumerate(lines):
        table[number, : len(strokes)] = np.reshape(strokes, (-1, 4))
    return {character: number + 1 for number, character in enumerate(_GLYPHS)}, table


def _print(
    text: str, s: np.ndarray, t: np.ndarray, left: float, base: float, height: float, bold: float = 1.0
) -> np.ndarray:
    """Where the pen went, writing `text` from (left, base) with letters of this height."""
    unit = height / 6
    x, y = (s - left) / unit, (t - base) / unit
    near = np.flatnonzero((x > -1) & (x < 6 * len(text)) & (y > -1) & (y < 7))
    x, y = x.ravel()[near] + 1, y.ravel()[near]
    place = np.clip((x / 6).astype(np.int32), 0, len(text) - 1)
    x -= 6 * place + 1
    numbers, table = _strokes()
    strokes = table[np.array([numbers.get(character, 0) for character in text])[place]]
    inked = np.zeros(x.shape, bool)
    for k in range(table.shape[1]):
        x0, y0, x1, y1 = strokes[:, k].T
        dx, dy = x1 - x0, y1 - y0
        along = np.clip(((x - x0) * dx + (y - y0) * dy) / np.maximum(dx * dx + dy * dy, 1e-6), 0, 1)
        inked |= (x - x0 - along * dx) ** 2 + (y - y0 - along * dy) ** 2 < (0.42 * bold) ** 2
    out = np.zeros(s.shape, bool)
    out.ravel()[near] = inked
    return out
