"""Shapes of a scene where they stand: in the numbers of the transport kernels, and asked for their volume and what lies in them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import singledispatch
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._bodies import build_outlines, check_mesh, letter_outline, read_mesh
from ._solids import Box, Cylinder, Ellipsoid, Mesh, Outline, Voxels
from .montecarlo import arrays
from .patterns import check_file, only_array

Floats = NDArray[np.float64]

_MARGIN = 1e-6  # mm around boxes that are not the solid itself, against rounding


@dataclass(frozen=True, kw_only=True, eq=False)
class Placed:
    """A shape where it stands.

    Attributes
    ----------
    kind : one of `BOX` … `VOXELS` of the kernels.
    turn, origin, size : the frame and the size of the kernels: p of the world is turn · (p − origin) in the shape's own frame.
    low, high : corners of the smallest box around it, mm.
    loops : of an outline, each (point, 2), anticlockwise around material; of others none.
    vertices, faces : of a mesh, in the world; of others none.
    cells, pitch : (x, y, z) and mm, of voxels; of others none.
    """

    kind: int
    turn: Floats
    origin: Floats
    size: Floats
    low: Floats
    high: Floats
    loops: tuple[Floats, ...] = ()
    vertices: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    faces: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    cells: NDArray[np.int16] = field(default_factory=lambda: np.zeros((0, 0, 0), np.int16))
    pitch: Floats = field(default_factory=lambda: np.zeros(3))

    @property
    def turned(self) -> bool:
        """Whether its frame is not that of the world."""
        return not np.array_equal(self.turn, np.eye(3))

    @property
    def box(self) -> Floats:
        """(6,) box for the kernels: lower x, y, z and upper x, y, z."""
        exact = self.kind in (arrays.BOX, arrays.VOXELS) and not self.turned
        margin = 0.0 if exact else _MARGIN
        return np.concatenate([self.low - margin, self.high + margin])


def rotation_matrix(angles: ArrayLike) -> Floats:
    """(3, 3) matrix of turns about the fixed axes x, then y, then z, rad.

    Examples
    --------
    >>> import math
    >>> from shadowgram.xray._placed import rotation_matrix
    >>> (rotation_matrix((0, 0, math.pi / 2)) @ [1, 0, 0]).round(12)
    array([0., 1., 0.])
    """
    matrix = np.eye(3)
    for axis, angle in enumerate(np.asarray(angles, np.float64)):
        if angle:
            turn = np.eye(3)
            i, j = (axis + 1) % 3, (axis + 2) % 3
            turn[i, i] = turn[j, j] = math.cos(angle)
            turn[j, i] = math.sin(angle)
            turn[i, j] = -turn[j, i]
            matrix = turn @ matrix
    return matrix


@singledispatch
def place(shape: object) -> Placed:
    """Put a shape of a scene where it belongs.

    Raises
    ------
    OSError
        If it comes from a file that cannot be read.
    ValueError
        If its outline crosses itself, its mesh is not closed, or its file does not hold what it should.
    """
    raise TypeError(f"{type(shape).__name__} is not a shape")


@place.register
def _(shape: Box) -> Placed:
    turn, half = rotation_matrix(shape.rotation).T, np.array(shape.size) / 2
    return _around(arrays.BOX, turn, shape.centre, half, np.abs(turn.T) @ half)


@place.register
def _(shape: Ellipsoid) -> Placed:
    turn, axes = rotation_matrix(shape.rotation).T, np.array(shape.semi_axes)
    return _around(arrays.ELLIPSOID, turn, shape.centre, axes, np.sqrt((turn.T * axes) ** 2 @ np.ones(3)))


@place.register
def _(shape: Cylinder) -> Placed:
    centre, axis, length = _cylinder_axis(shape)
    axis = rotation_matrix(shape.rotation) @ axis
    turn = np.eye(3) if axis[2] == 1 else np.stack([*across(axis), axis])
    size = np.array([shape.radius, 0.0, length / 2])
    return _around(
        arrays.CYLINDER,
        turn,
        centre,
        size,
        length / 2 * np.abs(axis) + shape.radius * np.sqrt(np.clip(1 - axis**2, 0, None)),
    )


@place.register
def _(shape: Outline) -> Placed:
    turn, size = rotation_matrix(shape.rotation).T, np.array([0.0, 0.0, shape.thickness / 2])
    if shape.text is not None and shape.height is not None:
        drawn: list[ArrayLike] = list(letter_outline(shape.text, shape.height))
    else:
        drawn = [np.array(loop) for loop in (shape.points or (), *shape.holes)]
    loops = _oriented(drawn)
    flat = np.concatenate(loops)
    corners = np.concatenate([np.c_[flat, np.full(len(flat), z)] for z in (-size[2], size[2])])
    moved = corners @ turn + np.array(shape.centre)
    return Placed(
        kind=arrays.OUTLINE,
        turn=turn,
        origin=np.array(shape.centre),
        size=size,
        low=moved.min(axis=0),
        high=moved.max(axis=0),
        loops=loops,
    )


@place.register
def _(shape: Mesh) -> Placed:
    vertices, faces = check_mesh(*read_mesh(shape.file, shape.scale), name=f"the mesh {Path(shape.file).name}")
    vertices = vertices @ rotation_matrix(shape.rotation).T + np.array(shape.translation)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre = (low + high) / 2
    half = (high - low) / 2
    return Placed(
        kind=arrays.MESH, turn=np.eye(3), origin=centre, size=half, low=low, high=high, vertices=vertices, faces=faces
    )


@place.register
def _(shape: Voxels) -> Placed:
    turn, pitch = rotation_matrix(shape.rotation).T, np.array(shape.pitch)
    cells = _read_cells(Path(shape.file), len(shape.materials))
    size = np.array(cells.shape) * pitch
    corners = np.array([[x, y, z] for x in (0, size[0]) for y in (0, size[1]) for z in (0, size[2])])
    moved = corners @ turn + np.array(shape.corner)
    return Placed(
        kind=arrays.VOXELS,
        turn=turn,
        origin=np.array(shape.corner),
        size=size,
        low=moved.min(axis=0),
        high=moved.max(axis=0),
        cells=cells,
        pitch=pitch,
    )


def _around(kind: int, turn: Floats, centre: ArrayLike, size: Floats, half: Floats) -> Placed:
    """A shape with as much on one side of its centre as on the other."""
    origin = np.array(centre, np.float64)
    return Placed(kind=kind, turn=turn, origin=origin, size=size, low=origin - half, high=origin + half)


def _cylinder_axis(shape: Cylinder) -> tuple[Floats, Floats, float]:
    """(Centre, axis, length)."""
    if shape.start is not None and shape.end is not None:
        start, end = np.array(shape.start), np.array(shape.end)
        length = float(np.linalg.norm(end - start))
        return (start + end) / 2, (end - start) / length, length
    centre = (0.0, 0.0, 0.0) if shape.centre is None else shape.centre
    axis = (0.0, 0.0, 1.0) if shape.axis is None else shape.axis
    return np.array(centre), np.array(axis), shape.length or 0.0


def across(axis: Floats) -> tuple[Floats, Floats]:
    """Two directions across a third, which they make a right-handed frame with: along x and y where it is z.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.xray._placed import across
    >>> [direction.tolist() for direction in across(np.array([0.0, 0.0, 1.0]))]
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    """
    near_x = abs(axis[0]) > 0.9
    side = np.array([0.0, 1.0, 0.0]) if near_x else np.array([1.0, 0.0, 0.0])
    first = side - (side @ axis) * axis
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def _oriented(drawn: list[ArrayLike]) -> tuple[Floats, ...]:
    """The loops, checked and run as the kernels want them."""
    try:
        edges = build_outlines([drawn]).edge
    except ValueError as error:
        raise ValueError(str(error).replace(" of outline 0", " of the outline")) from None
    loops, first = [], 0
    for i in range(len(edges)):
        if np.array_equal(edges[i, 2:], edges[first, :2]):
            loops.append(edges[first : i + 1, :2])
            first = i + 1
    return tuple(loops)


def _read_cells(path: Path, materials: int) -> NDArray[np.int16]:
    check_file(path)
    try:
        cells = only_array(path, axes=(3,))
    except ValueError as error:
        raise ValueError(f"cannot read the voxels {path}: {error}") from error
    if cells.dtype.kind not in "iub":
        raise ValueError(f"the voxels {path} must be whole numbers, got {cells.dtype}")
    low, high = int(cells.min()), int(cells.max())
    if low < 0 or high >= materials:
        raise ValueError(
            f"the voxels {path} hold numbers from {low} to {high}, but there are materials for 0 to {materials - 1}"
        )
    return cells.astype(np.int16)


def contains(placed: Placed, points: ArrayLike) -> NDArray[np.bool_]:
    """(point,) whether each of (point, 3) lies in the shape."""
    own = (np.asarray(points, np.float64) - placed.origin) @ placed.turn.T
    return _CONTAINS[placed.kind](placed, own)


def _in_box(placed: Placed, own: Floats) -> NDArray[np.bool_]:
    return np.all(np.abs(own) < placed.size, axis=-1)


def _in_ellipsoid(placed: Placed, own: Floats) -> NDArray[np.bool_]:
    return ((own / placed.size) ** 2).sum(axis=-1) < 1


def _in_cylinder(placed: Placed, own: Floats) -> NDArray[np.bool_]:
    return (np.hypot(own[:, 0], own[:, 1]) < placed.size[0]) & (np.abs(own[:, 2]) < placed.size[2])


def _in_outline(placed: Placed, own: Floats) -> NDArray[np.bool_]:
    inside = np.zeros(len(own), bool)
    for loop in placed.loops:  # an odd number of edges to one side
        (x0, y0), (x1, y1) = (
            loop.T[:, None, :] - own.T[:2, :, None],
            np.roll(loop, -1, axis=0).T[:, None, :] - own.T[:2, :, None],
        )
        crossing = ((y0 >= 0) != (y1 >= 0)) & ((x0 * y1 - x1 * y0 > 0) == (y1 > y0))
        inside ^= crossing.sum(axis=-1) % 2 == 1
    return inside & (np.abs(own[:, 2]) < placed.size[2])


def _in_mesh(placed: Placed, own: Floats) -> NDArray[np.bool_]:
    """By the solid angle that all faces together fill (van Oosterom and Strackee, IEEE Trans. Biomed. Eng. 30, 125, 1983)."""
    corners = placed.vertices[placed.faces] - placed.origin
    inside = np.zeros(len(own), bool)
    for i in np.flatnonzero((np.abs(own) < placed.size).all(axis=-1)):
        a, b, c = np.moveaxis(corners - own[i], 1, 0)
        la, lb, lc = (np.linalg.norm(side, axis=-1) for side in (a, b, c))
        volume = (a * np.cross(b, c)).sum(axis=-1)
        flat = la * lb * lc + (a * b).sum(axis=-1) * lc + (b * c).sum(axis=-1) * la + (c * a).sum(axis=-1) * lb
        inside[i] = np.arctan2(volume, flat).sum() > math.pi  # half of the 2π of a point inside
    return inside


def _in_voxels(placed: Placed, own: Floats) -> NDArray[np.bool_]:
    return np.all((own > 0) & (own < placed.size), axis=-1)


_CONTAINS: dict[int, Callable[[Placed, Floats], NDArray[np.bool_]]] = {
    arrays.BOX: _in_box,
    arrays.ELLIPSOID: _in_ellipsoid,
    arrays.CYLINDER: _in_cylinder,
    arrays.OUTLINE: _in_outline,
    arrays.MESH: _in_mesh,
    arrays.VOXELS: _in_voxels,
}


def volume(placed: Placed) -> float:
    """Volume, mm³."""
    a, b, c = placed.size
    match placed.kind:
        case arrays.BOX:
            return float(8 * a * b * c)
        case arrays.ELLIPSOID:
            return float(4 / 3 * math.pi * a * b * c)
        case arrays.CYLINDER:
            return float(math.pi * a**2 * 2 * c)
        case arrays.OUTLINE:
            return float(2 * c * sum(_area(loop) for loop in placed.loops))
        case arrays.MESH:
            first, second, third = np.moveaxis((placed.vertices - placed.origin)[placed.faces], 1, 0)
            return float((first * np.cross(second, third)).sum() / 6)
        case _:
            return float(a * b * c)


def _area(loop: Floats) -> float:
    x, y = loop.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
