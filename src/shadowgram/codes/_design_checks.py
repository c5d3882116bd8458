"""What a design begins with, and whether it can."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np

from .patterns import boolean, check_code

if TYPE_CHECKING:
    from ._colored_board import VoxelPairs
    from ._pairs import PairTable


class MaskImager(Protocol):
    """An imager with one mask for all bands, whose code can be designed."""

    @property
    def code_shape(self) -> tuple[int, int]:
        """(y, x) elements."""
        ...

    def pair_table(self) -> PairTable:
        """What its voxels see of the code."""
        ...


class FilterImager(Protocol):
    """An imager with a colored code that can be designed."""

    @property
    def code_shape(self) -> tuple[int, int, int]:
        """(band, y, x) elements."""
        ...

    def voxel_pairs(self) -> VoxelPairs:
        """Voxels that share detector elements."""
        ...


def is_colored(imager: MaskImager | FilterImager) -> bool:
    return hasattr(imager, "voxel_pairs")


def band_count(imager: MaskImager | FilterImager) -> int:
    """L of an imager."""
    return pairs_of(imager).bands


def pairs_of(imager: MaskImager | FilterImager) -> PairTable | VoxelPairs:
    """What an imager tells a designer."""
    if is_colored(imager):
        return cast("FilterImager", imager).voxel_pairs()
    return cast("MaskImager", imager).pair_table()


def checked_shape(imager: MaskImager | FilterImager, shots: int, tile: tuple[int, int] | None) -> tuple[int, ...]:
    """Shape of one shot of the code to be designed."""
    if isinstance(imager, type) or not (is_colored(imager) or hasattr(imager, "pair_table")):
        name = imager.__name__ if isinstance(imager, type) else type(imager).__name__
        hint = ": make one of it first" if isinstance(imager, type) else ""
        raise TypeError(f"codes are designed for an SSCSI, CASSI, DualCASSI or ColoredCASSI, got {name}{hint}")
    shape, bands = imager.code_shape, band_count(imager)
    if not isinstance(shots, int | np.integer) or shots < 2:
        raise ValueError(f"a code is designed for 2 shots or more, got {shots!r}: with one, every element is open")
    if bands > shape[-1]:
        raise ValueError(f"the imager has {bands} bands, more than its mask has columns ({shape[-1]})")
    if tile is not None:
        if is_colored(imager):
            raise ValueError("colored codes are designed whole: leave the tile out")
        sides = tuple(tile) if isinstance(tile, tuple | list | np.ndarray) else ()
        whole = len(sides) == 2 and all(isinstance(side, int | np.integer) for side in sides)
        if not whole or not all(1 <= side <= most for side, most in zip(sides, shape, strict=True)):
            raise ValueError(f"a tile must be (y, x) whole elements, at most those of the mask {shape}, got {tile!r}")
        y, x = map(int, sides)
        shape = (y, x)
    if shots > math.prod(shape):
        raise ValueError(f"{shots} shots are more than the code has elements ({math.prod(shape)})")
    return shape


def checked_start(start: np.ndarray, shots: int, shape: tuple[int, ...]) -> np.ndarray:
    code = check_code(start, shape)
    if len(code) != shots:
        raise ValueError(f"the start must have {shots} shots, got {len(code)}")
    if code.dtype != np.uint8:
        raise ValueError(
            "the start must be binary, every element open (1) or closed (0) in a shot; it has gray elements"
        )
    opened = code.sum(axis=0)
    if (opened != 1).any():
        raise ValueError(
            "the start must be complementary, every element open in one shot and closed in the others;"
            f" {int((opened != 1).sum())} of {opened.size} elements are not"
        )
    return code


def is_number(value: object) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def check_limits(tolerance: float, max_sweeps: int) -> None:
    if not is_number(tolerance) or not 0 <= tolerance < 1:
        raise ValueError(f"tolerance must lie in [0, 1), a share of the cost of the start, got {tolerance!r}")
    if not isinstance(max_sweeps, int | np.integer) or isinstance(max_sweeps, bool) or max_sweeps < 0:
        raise ValueError(f"max_sweeps must be a whole number of at least 0, got {max_sweeps!r}")


def first_code(shots: int, shape: tuple[int, ...], transmittance: float | None, seed: int) -> np.ndarray:
    if transmittance is None or (is_number(transmittance) and abs(transmittance * shots - 1) < 1e-9):
        first = boolean(shots=shots, shape=(1, math.prod(shape)), seed=seed)
        return first.reshape(shots, *shape)
    from ._budget import MOST_SHOTS, budget_start

    if len(shape) != 2:
        raise ValueError("a colored code is designed complementary: leave the transmittance out")
    if not is_number(transmittance) or not 1 / shots < transmittance < 1:
        raise ValueError(
            f"with {shots} shots the transmittance must lie between 1/{shots}, the complementary code, and 1, got"
            f" {transmittance}"
        )
    if shots > MOST_SHOTS:
        raise ValueError(f"a transmittance can be chosen for at most {MOST_SHOTS} shots, got {shots}")
    return budget_start(shots, (shape[0], shape[1]), transmittance, np.random.default_rng(seed))
