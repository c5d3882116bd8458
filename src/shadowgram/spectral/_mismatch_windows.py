"""Small windows of a capture, in each of which every band has one brightness: what model errors show without a reconstruction.

Over a window of a few pixels, what a band lets through is its pattern, the snapshot of a scene that is 1 in that band, times the
brightness of the scene there. Least squares over the window finds the brightness of all bands, whatever the scene; what it leaves
depends on where the patterns lie, and so says how far they have moved.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from shadowgram.operators.base import LinearOperator

FREEDOM = 2.5  # values in a window, at least, for each brightness that is fitted to them
RIDGE = 1e-3  # of a band's mean energy: bands that do not reach a window stay at zero
TILES = 6  # each way; windows in one tile may share an error, and count as one in the scatter

Spline = Callable[[float], tuple[float, ...]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Windows:
    """Windows of a capture, and the patterns of the bands as cubic splines.

    Attributes
    ----------
    splines : (band, shot, y, x) float32 coefficients of the patterns.
    values : (window, value) float64; the snapshots, shot by shot.
    rows, columns : (window, pixel) int64.
    tile : (window,) int64; which part of the detector.
    """

    splines: np.ndarray
    values: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    tile: np.ndarray

    @property
    def shots(self) -> int:
        """Number of shots."""
        return self.splines.shape[1]

    @cached_property
    def shot_of(self) -> np.ndarray:
        """(value,) shot that each value of a window belongs to."""
        return np.repeat(np.arange(self.shots), self.rows.shape[1])

    def part(self, chosen: np.ndarray) -> Windows:
        """Windows by index or mask."""
        return Windows(
            splines=self.splines,
            values=self.values[chosen],
            rows=self.rows[chosen],
            columns=self.columns[chosen],
            tile=self.tile[chosen],
        )

    def patterns(self, dy: float, dx: float) -> np.ndarray:
        """(window, value, band) patterns that have moved down and right."""
        return self._placed(dy, dx, ((_weights, _weights),))[0]

    def patterns_and_slopes(self, dy: float, dx: float) -> tuple[np.ndarray, np.ndarray]:
        """The moved patterns, and how they change as they move on down."""
        pattern, down = self._placed(dy, dx, ((_weights, _weights), (_slopes, _weights)))
        return pattern, down

    def _placed(self, dy: float, dx: float, kinds: Sequence[tuple[Spline, Spline]]) -> list[np.ndarray]:
        bands, shots, ny, nx = self.splines.shape
        side = math.isqrt(self.rows.shape[1])
        # A window and what the spline needs around it; past the detector's edge, the edge.
        reach = np.arange(side + 3) - 2
        whole_y, whole_x = math.floor(dy), math.floor(dx)
        rows = np.clip(self.rows[:, :1] - whole_y + reach, 0, ny - 1)
        columns = np.clip(self.columns[:, :1] - whole_x + reach, 0, nx - 1)
        found = [np.empty((*self.values.shape, bands)) for _ in kinds]
        for band, spline in enumerate(self.splines):
            patch = spline[:, rows[:, :, None], columns[:, None, :]]
            for (along_y, along_x), out in zip(kinds, found, strict=True):
                tall = sum((w * patch[:, :, i : i + side] for i, w in enumerate(along_y(dy - whole_y))), np.zeros(()))
                cut = sum((w * tall[..., i : i + side] for i, w in enumerate(along_x(dx - whole_x))), np.zeros(()))
                out[:, :, band] = cut.swapaxes(0, 1).reshape(len(self.rows), shots * side * side)
        return found


def _weights(t: float) -> tuple[float, ...]:
    """Cubic B-spline at the four knots around a point that has moved by t, 0 ≤ t < 1, to the right."""
    u = 1 - t
    return ((1 - u) ** 3 / 6, (3 * u**3 - 6 * u**2 + 4) / 6, (-3 * u**3 + 3 * u**2 + 3 * u + 1) / 6, u**3 / 6)


def _slopes(t: float) -> tuple[float, ...]:
    """Derivatives of `_weights` by t."""
    u = 1 - t
    return ((1 - u) ** 2 / 2, -(3 * u**2 - 4 * u) / 2, -(-3 * u**2 + 2 * u + 1) / 2, -(u**2) / 2)


def side_for(bands: int, shots: int) -> int:
    """Pixels along a side of a window that tells the brightness of all bands."""
    side = 3
    while side * side * shots < FREEDOM * bands:
        side += 1
    return side


def windows_of(H: LinearOperator, snapshots: np.ndarray, most: int) -> Windows:
    """At most `most` windows, evenly over the detector, and the patterns of the operator's bands.

    Raises
    ------
    ValueError
        If the detector is too small for windows.
    """
    from scipy.ndimage import spline_filter

    bands, (shots, ny, nx) = H.in_shape[0], snapshots.shape
    side = side_for(bands, shots)
    if min(ny, nx) < 4 * side:
        raise ValueError(
            f"the captures are too small to say anything about the model: {bands} bands and {shots} shots take {4 * side} pixels a"
            f" side or more, got {ny} × {nx} (y × x)"
        )
    top, left = np.meshgrid(np.arange(0, ny - side + 1, side), np.arange(0, nx - side + 1, side), indexing="ij")
    chosen = np.unique(np.linspace(0, top.size - 1, min(top.size, most)).astype(int))
    top, left = top.ravel()[chosen, None], left.ravel()[chosen, None]
    dy, dx = np.mgrid[:side, :side]
    rows, columns = top + dy.ravel(), left + dx.ravel()
    splines = np.empty((bands, *H.out_shape), np.float32)
    one_band = np.zeros(H.in_shape, np.float32)
    for band in range(bands):
        one_band[band] = 1
        for shot, pattern in enumerate(H.forward(one_band)):
            splines[band, shot] = spline_filter(pattern.astype(np.float64), order=3)
        one_band[band] = 0
    values = snapshots[:, rows, columns].astype(np.float64).swapaxes(0, 1).reshape(len(rows), -1)
    tile = (top[:, 0] * TILES // ny) * TILES + left[:, 0] * TILES // nx
    return Windows(splines=splines, values=values, rows=rows, columns=columns, tile=tile)


@dataclass(frozen=True, eq=False)
class LocalFit:
    """Least squares over each window.

    Attributes
    ----------
    design : (window, value, band) patterns.
    inverse : (window, band, value), from values to brightness.
    """

    design: np.ndarray
    inverse: np.ndarray

    @cached_property
    def freedom(self) -> np.ndarray:
        """(window,) values that are left to tell the noise."""
        return self.design.shape[1] - np.einsum("wpk,wkp->w", self.design, self.inverse)

    def brightness(self, values: np.ndarray) -> np.ndarray:
        """(window, band)."""
        return (self.inverse @ values[..., None])[..., 0]

    def rest(self, values: np.ndarray) -> np.ndarray:
        """What the fit leaves of values (window, value) or (window, value, column)."""
        columns = values if values.ndim == 3 else values[..., None]
        return (columns - self.design @ (self.inverse @ columns)).reshape(values.shape)

    def variance(self, rest: np.ndarray) -> np.ndarray:
        """(window,) of the noise, by what the fit leaves."""
        return np.square(rest).sum(axis=1) / self.freedom


def local_fit(design: np.ndarray) -> LocalFit:
    """Prepare least squares over windows whose patterns are `design`."""
    gram = design.swapaxes(1, 2) @ design
    bands = design.shape[2]
    gram += RIDGE * np.trace(gram, axis1=1, axis2=2).mean() / bands * np.eye(bands)
    return LocalFit(design, np.linalg.solve(gram, design.swapaxes(1, 2)))
