"""Block letters as polygons: straight strokes, and octagons for curves."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

_HEIGHT = 14
_GAP = 3
_SPACE = 6

# Loops of points "xy", each coordinate a hexadecimal digit, on a grid 14 high where a stroke is about 2 wide.
_SHAPES = {
    "A": ("00 20 26 86 80 A0 AB 7E 3E 0B", "28 88 8A 6C 4C 2A"),
    "B": ("00 70 A3 A5 87 A9 AB 7E 0E", "22 62 84 66 26", "28 68 8A 6C 2C"),
    "C": ("A4 A3 70 30 03 0B 3E 7E AB AA 8A 6C 4C 2A 24 42 62 84",),
    "D": ("00 70 A3 AB 7E 0E", "22 62 84 8A 6C 2C"),
    "E": ("00 90 92 22 26 76 78 28 2C 9C 9E 0E",),
    "F": ("00 20 26 76 78 28 2C 9C 9E 0E",),
    "G": ("AB 7E 3E 0B 03 30 70 A3 A7 57 55 85 84 62 42 24 2A 4C 6C 8A AA",),
    "H": ("00 20 26 86 80 A0 AE 8E 88 28 2E 0E",),
    "I": ("00 20 2E 0E",),
    "J": ("03 30 60 93 9E 7E 74 52 42 24 04",),
    "K": ("00 20 25 70 A0 37 AE 7E 29 2E 0E",),
    "L": ("00 80 82 22 2E 0E",),
    "M": ("00 20 2B 76 CB C0 E0 EE CE 79 2E 0E",),
    "N": ("00 20 2A 80 A0 AE 8E 84 2E 0E",),
    "O": ("30 70 A3 AB 7E 3E 0B 03", "42 62 84 8A 6C 4C 2A 24"),
    "P": ("00 20 25 75 A8 AB 7E 0E", "27 67 89 8A 6C 2C"),
    "Q": ("30 70 81 90 C0 A2 A3 AB 7E 3E 0B 03", "42 62 84 8A 6C 4C 2A 24"),
    "R": ("00 20 25 45 70 A0 75 A8 AB 7E 0E", "27 67 89 8A 6C 2C"),
    "S": ("4C 6C 8A AA AB 7E 3E 0B 09 36 66 84 62 42 24 04 03 30 70 A3 A5 78 48 2A",),
    "T": ("40 60 6C AC AE 0E 0C 4C",),
    "U": ("0E 03 30 70 A3 AE 8E 84 62 42 24 2E",),
    "V": ("40 60 AE 8E 54 2E 0E",),
    "W": ("0E 2E 23 78 C3 CE EE E0 C0 75 20 00",),
    "X": ("00 30 54 70 A0 77 AE 7E 5A 3E 0E 37",),
    "Y": ("40 60 66 AE 7E 5A 3E 0E 46",),
    "Z": ("00 A0 A2 32 AC AE 0E 0C 7C 02",),
    "0": ("30 60 93 9B 6E 3E 0B 03", "42 52 74 7A 5C 4C 2A 24"),
    "1": ("30 50 5E 3E 0B 08 3B",),
    "2": ("00 A0 A2 32 A9 AB 7E 3E 0B 0A 2A 4C 6C 8A 02",),
    "3": ("03 30 70 A3 A5 87 A9 AB 7E 3E 0B 0A 2A 4C 6C 8A 68 48 46 66 84 62 42 24 04",),
    "4": ("60 80 84 A4 A6 86 8E 6E 06 04 64", "36 66 6A"),
    "5": ("2C 9C 9E 0E 06 66 84 62 42 24 04 03 30 70 A3 A5 78 28",),
    "6": ("30 70 A3 A5 78 28 2A 4C 6C 8A AA AB 7E 3E 0B 03", "42 62 84 66 26 24"),
    "7": ("20 50 AC AE 0E 0C 7C",),
    "8": ("30 70 A3 A5 87 A9 AB 7E 3E 0B 09 27 05 03", "42 62 84 66 46 24", "48 68 8A 6C 4C 2A"),
    "9": ("7E 3E 0B 09 36 86 84 62 42 24 04 03 30 70 A3 AB", "6C 4C 2A 48 88 8A"),
}


def letter_outline(text: str, height: float) -> list[NDArray[np.float64]]:
    """Loops of block letters, for `build_outlines`: A to Z, 0 to 9 and spaces, one after another along x, centred at the origin.

    Parameters
    ----------
    text : what to write; small letters are written as capitals.
    height : of a letter, mm; a stroke is about a seventh of it.

    Returns
    -------
    list of (point, 2)
        Loops in mm; those inside others are holes.

    Raises
    ------
    ValueError
        If there is nothing to write, a character has no shape, or the height is not a positive length.

    Examples
    --------
    >>> loops = letter_outline("UD", 129.0)
    >>> len(loops), float(loops[0].min(axis=0)[1])
    (3, -64.5)
    """
    if not (math.isfinite(height) and height > 0):
        raise ValueError(f"height must be a positive length in mm, got {height}")
    unknown = sorted(set(text.upper()) - set(_SHAPES) - {" "})
    if unknown:
        raise ValueError(f"there are letters for A to Z and 0 to 9 only, not for {unknown[0]!r}")
    if not text.strip():
        raise ValueError("text must hold at least one letter or digit")
    loops, place = [], 0
    for letter in text.strip().upper():
        if letter == " ":
            place += _SPACE
            continue
        shape = [_points(loop) for loop in _SHAPES[letter]]
        loops += [points + np.array((place, 0)) for points in shape]
        place += max(int(points[:, 0].max()) for points in shape) + _GAP
    middle = ((place - _GAP) / 2, _HEIGHT / 2)
    return [(points - middle) * (height / _HEIGHT) for points in loops]


def _points(loop: str) -> NDArray[np.float64]:
    return np.array([[int(x, 16), int(y, 16)] for x, y in loop.split()], np.float64)
