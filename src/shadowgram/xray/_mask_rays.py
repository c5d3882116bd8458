"""Rays from the source through the cells of a mask, and how many photons they stand for."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from .scene import Mask, Scene

Floats = NDArray[np.float64]


def through_cells(mask: Mask, start: Floats, rays: int = 1) -> Floats:
    """(3, ray, y, x) from the source to places in each cell in view, where light enters the plate, mm.

    One place is the middle. More are a lattice that falls on as many different x and as many different y, evenly: the edge of a
    target along either axis is then seen as finely as so many rays can.
    """
    turn = _coprime(rays)
    i = np.arange(rays)[:, None, None]
    columns = np.arange(mask.columns_in_view) + (i + 0.5) / rays
    rows = np.arange(mask.rows)[:, None] + (i * turn % rays + 0.5) / rays
    x = mask.position[0] + (columns - mask.columns_in_view / 2) * mask.pitch * mask.column_direction
    y = mask.position[1] + (rows - mask.rows / 2) * mask.pitch * mask.row_direction
    z = mask.position[2] - math.copysign(mask.depth / 2, mask.position[2] - start[2])
    return np.stack(np.broadcast_arrays(x - start[0], y - start[1], z - start[2]))


def share_of_source(scene: Scene, mask: Mask, cells: Floats) -> Floats:
    """(ray, y, x) share of the source's photons that go through each cell, were all of it as the place to which the ray leads."""
    length = np.linalg.norm(cells, axis=0)
    axis = np.array(scene.source.direction)
    lit = np.tensordot(axis, cells, 1) / length >= math.cos(scene.source.half_angle)
    return lit * mask.pitch**2 * np.abs(cells[2]) / length**3 / scene.source.solid_angle


def _coprime(count: int) -> int:
    """The number nearest to the golden section of a count that has no divisor in common with it."""
    golden = count * 0.6180339887498949
    return min((n for n in range(1, count + 1) if math.gcd(n, count) == 1), key=lambda n: abs(n - golden))
