"""Several cameras on one scene, as one operator: coded shots and side information, such as a panchromatic picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .base import LinearOperator, Shape
from .structure import pixel_gram, shot_gram


def stack(H: LinearOperator, *others: LinearOperator, noise: Sequence[float] | None = None) -> Stack:
    """Put operators on the same scene on top of each other: one operator to the shots of all of them.

    Parameters
    ----------
    H, *others : operators from the same datacube (band, y, x) to images (shot, y, x), such as an imager's and a
        `SpectralResponse`.
    noise : standard deviation of the noise of each part, in the units of its images; each part is divided by it, so that the
        noise is 1 everywhere, which ``EigenTV(noise=1)`` is to be told. Only ratios matter for how the parts are weighed; a part
        whose model is less certain deserves a larger figure. By default the parts count as they are.

    Returns
    -------
    Stack
        With `join`, which makes its measurements from those of the parts, and `split`, which takes them apart.

    Raises
    ------
    ValueError
        If the scenes differ, or a noise is not positive.

    Notes
    -----
    Where detectors differ in size, as that of a CASSI, which is wider than the scene, smaller images are framed by zeros, centred.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> imager = sg.CASSI(cube_shape=(4, 16, 16), wavelengths=(450, 650))
    >>> H = imager.operator(sg.codes.random(shots=1, shape=imager.code_shape, seed=0))
    >>> pan = sg.operators.SpectralResponse.pan(H.in_shape)
    >>> both = sg.operators.stack(H, pan, noise=(0.02, 0.01))
    >>> both.out_shape
    (2, 16, 19)
    >>> y = both.join([np.ones((1, 16, 19)), np.ones((1, 16, 16))])
    >>> [part.shape for part in both.split(y)]
    [(1, 16, 19), (1, 16, 16)]
    >>> solution = sg.solve(sg.EigenTV(noise=1, max_iter=5), both, y)
    """
    parts = (H, *others)
    for part in parts:
        if part.in_shape != H.in_shape:
            raise ValueError(
                f"stack needs operators on the same scene, but one takes {H.in_shape} and another {part.in_shape}"
            )
        if len(part.out_shape) != 3:
            raise ValueError(
                f"stack needs operators that give images (shot, y, x), got one that gives {part.out_shape}"
            )
    levels = (1.0,) * len(parts) if noise is None else tuple(float(level) for level in noise)
    if len(levels) != len(parts):
        raise ValueError(
            f"stack: noise must hold one standard deviation for each of {len(parts)} parts, got {len(levels)}"
        )
    if not all(0 < level < math.inf for level in levels):
        raise ValueError(
            f"stack: noise must be positive, got {levels}; for parts without noise leave it out, or give their relative weights"
        )
    return Stack(parts, levels)


@dataclass(frozen=True, eq=False)
class Stack(LinearOperator):
    """Operators on top of each other, made by `stack`: g[shots of part i] = Hᵢ f / noiseᵢ, framed by zeros.

    Attributes
    ----------
    parts : operators from the same scene to (shot, y, x).
    noise : what each part is divided by.
    """

    parts: tuple[LinearOperator, ...]
    noise: tuple[float, ...]

    @property
    def in_shape(self) -> Shape:
        """(band, y, x) of the datacube."""
        return self.parts[0].in_shape

    @property
    def out_shape(self) -> Shape:
        """(shot, y, x): the shots of all parts, as high and wide as the largest."""
        shapes = [part.out_shape for part in self.parts]
        return sum(s[0] for s in shapes), max(s[1] for s in shapes), max(s[2] for s in shapes)

    @cached_property
    def _places(self) -> tuple[tuple[slice, slice, slice], ...]:
        """Where the images of each part lie."""
        places, first = [], 0
        for part in self.parts:
            shots, rows, columns = part.out_shape
            top, left = (self.out_shape[1] - rows) // 2, (self.out_shape[2] - columns) // 2
            places.append(np.s_[first : first + shots, top : top + rows, left : left + columns])
            first += shots
        return tuple(places)

    def join(self, parts: Sequence[np.ndarray]) -> np.ndarray:
        """Measurements of the stack from those of its parts, (shot, y, x) each, in their own units.

        Raises
        ------
        ValueError
            If the number of parts or a shape does not fit.
        """
        if len(parts) != len(self.parts):
            raise ValueError(f"join takes the images of {len(self.parts)} parts, got {len(parts)}")
        images = [np.asarray(part) for part in parts]
        for image, operator in zip(images, self.parts, strict=True):
            if image.shape != operator.out_shape:
                raise ValueError(f"join needs images of shape {operator.out_shape} from this part, got {image.shape}")
        double = any(image.dtype == np.float64 for image in images)
        y = np.zeros(self.out_shape, np.float64 if double else np.float32)
        for place, level, image in zip(self._places, self.noise, images, strict=True):
            y[place] = image / y.dtype.type(level)
        return y

    def split(self, y: np.ndarray) -> list[np.ndarray]:
        """Take measurements of the stack apart: the images of each part, in its own units and without the frame.

        Raises
        ------
        ValueError
            If the shape does not fit.
        """
        if y.shape != self.out_shape:
            raise ValueError(f"split takes an array of shape {self.out_shape}, got {y.shape}")
        return [y[place] * y.dtype.type(level) for place, level in zip(self._places, self.noise, strict=True)]

    def _forward(self, x: np.ndarray, out: np.ndarray) -> None:
        out[:] = 0
        for part, place, level in zip(self.parts, self._places, self.noise, strict=True):
            np.divide(part.forward(x), x.dtype.type(level), out=out[place])

    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None:
        scratch = np.empty_like(out) if len(self.parts) > 1 else out
        for i, (part, place, level) in enumerate(zip(self.parts, self._places, self.noise, strict=True)):
            seen = np.ascontiguousarray(y[place] / y.dtype.type(level))
            part._adjoint(seen, out if i == 0 else scratch)
            if i > 0:
                out += scratch


@shot_gram.register
def _(A: Stack) -> np.ndarray | None:
    """With the terms across parts, if every element of every part sees the one pixel at its place."""
    return pixel_gram(A)
