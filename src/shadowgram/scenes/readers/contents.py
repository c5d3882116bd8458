"""What every reader gives: the variables of a file, listed before anything large is read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import prod

import numpy as np

FREE_BYTES = 256 * 2**20
LARGEST_RATIO = 100


@dataclass(frozen=True, eq=False)
class Variable:
    """One variable of a file, not yet read.

    `dtype` is None, and `problem` says why in a few words, for what cannot be read as an array of real numbers. `dims`
    are the names of the axes where the file has them.
    """

    shape: tuple[int, ...]
    dtype: np.dtype | None
    load: Callable[[], np.ndarray]
    dims: tuple[str, ...] | None = None
    attrs: Mapping[str, object] = field(default_factory=dict)
    problem: str = ""

    def describe(self) -> str:
        """Shape and type in words, "256 × 256 × 24 uint8"."""
        if self.dtype is not None and self.dtype.kind == "U":
            return "text"
        size = " × ".join(map(str, self.shape)) if self.shape else "single"
        return self.problem or f"{size} {self.dtype}"


@dataclass(frozen=True, eq=False)
class Contents:
    """The variables of a file by name, and what its reader has to say about them, which may grow as they are loaded."""

    variables: Mapping[str, Variable]
    notes: list[str] = field(default_factory=list)


def unreadable(problem: str) -> Variable:
    """A variable that is there but cannot be read, and why."""

    def load() -> np.ndarray:
        raise ValueError(problem)

    return Variable((), None, load, problem=problem)


def check_size(shape: tuple[int, ...], itemsize: int, file_size: int) -> int:
    """Bytes of an array, refused where they are out of proportion to the file that is said to hold them.

    Compressed cubes shrink a few times, nearly blank ones a few tens of times; a file that claims more than a hundred
    is damaged, or made to fill the memory. Small arrays are let through.
    """
    size = prod(shape) * itemsize
    if size > FREE_BYTES + LARGEST_RATIO * file_size:
        raise ValueError(
            f"it declares an array of {size / 2**30:.3g} GiB in a file of {file_size} bytes; "
            "it is damaged, or not a datacube"
        )
    return size
