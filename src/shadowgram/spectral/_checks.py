"""Checks that the imagers share: what a geometry must be, in the user's words."""

from __future__ import annotations

import math
from collections.abc import Sequence

LEAST_WAVELENGTH = 50.0  # nm; below, there are no lenses and gratings of these kinds


def check_count(name: str, value: object) -> None:
    """Raise unless `value` is a whole number of at least 1."""
    if not _is_count(value):
        raise ValueError(f"{name} must be a whole number of at least 1, got {value!r}")


def check_shape(name: str, shape: object, axes: tuple[str, ...]) -> None:
    """Raise unless `shape` gives a positive whole number for each of `axes`."""
    if not (isinstance(shape, Sequence) and len(shape) == len(axes) and all(map(_is_count, shape))):
        raise ValueError(f"{name} must be ({', '.join(axes)}), positive whole numbers, got {shape!r}")


def check_pitch(name: str, pitch: float) -> None:
    """Raise unless `pitch` is a positive length."""
    if not (math.isfinite(pitch) and pitch > 0):
        raise ValueError(f"{name} must be a positive length in µm, got {pitch}")


def check_wavelengths(wavelengths: tuple[float, float]) -> None:
    """Raise unless `wavelengths` is an ascending pair of positive wavelengths."""
    if (
        len(wavelengths) != 2
        or not all(math.isfinite(w) for w in wavelengths)
        or not 0 < wavelengths[0] < wavelengths[1]
    ):
        raise ValueError(f"wavelengths must be (shortest, longest) in nm, ascending, got {tuple(wavelengths)}")
    check_nanometres(wavelengths)


def check_nanometres(wavelengths: Sequence[float]) -> None:
    """Raise if wavelengths seem to be in µm."""
    if max(wavelengths) < LEAST_WAVELENGTH:
        raise ValueError(
            f"wavelengths are in nm, got {min(wavelengths):g} to {max(wavelengths):g}: are these µm? Then multiply by 1000"
        )


def check_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    """Raise unless `value` is one of `choices`."""
    if value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(map(repr, choices))}, got {value!r}")


def shortened(value: object) -> str:
    """Value in at most 60 characters of a line, for messages."""
    shown = " ".join(repr(value).split())
    return shown if len(shown) <= 60 else shown[:57] + "..."


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 1
