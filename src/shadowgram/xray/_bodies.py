"""The arrays of bodies that are not simple shapes: closed meshes, extruded outlines and voxel volumes.

Meshes come from files through `read_mesh`, are made bodies by `check_mesh`, moved to their place in the world by the caller, and
built into trees here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._letters import letter_outline as letter_outline
from ._mesh_checks import Mesh
from ._mesh_checks import body_labels as body_labels
from ._mesh_checks import check_mesh as check_mesh
from ._mesh_checks import meshes_overlap as meshes_overlap
from ._mesh_files import read_mesh as read_mesh
from .montecarlo.arrays import (
    BINS_PER_OCTAVE_BITS,
    ENERGY_BINS,
    LOWEST_ENERGY,
    TOTAL,
    Meshes,
    Outlines,
    Voxels,
)

_MARGIN = 1e-9  # of a majorant, for the rounding of a + b·E


def build_meshes(meshes: Sequence[Mesh]) -> Meshes:
    """Build the trees of closed meshes, each (vertices, faces) in world coordinates and as `check_mesh` returns it.

    Vertices are rounded by at most 2⁻⁵³ of the largest coordinate, to a grid on which differences are exact.

    Examples
    --------
    >>> corners, faces = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
    >>> build_meshes([check_mesh(corners, faces, "tetrahedron")]).node_box
    array([[0., 0., 0., 1., 1., 1.]])
    """
    roots, boxes, children, triangles = [], [np.empty((0, 6))], [np.empty((0, 2), np.int64)], [np.empty((0, 9))]
    nodes = first = 0
    for vertices, faces in meshes:
        box, child, triangle = _tree(vertices, faces)
        inner = child[:, :1] >= 0
        roots.append(nodes)
        boxes.append(box)
        children.append(child + np.where(inner, nodes, [[-first, 0]]))
        triangles.append(triangle)
        nodes, first = nodes + len(box), first + len(triangle)
    return Meshes(np.array(roots, np.int64), np.concatenate(boxes), np.concatenate(children), np.concatenate(triangles))


def _tree(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> tuple[NDArray, NDArray, NDArray]:
    """(node_box, node_child, triangle) of one mesh, numbered from 0."""
    from .montecarlo._tree_kernels import grow_tree

    grid = 2.0 ** (math.frexp(float(np.abs(vertices).max()))[1] - 52)
    corner = (np.round(vertices / grid) * grid)[faces]
    boxes = np.concatenate([corner.min(axis=1), corner.max(axis=1)], axis=1)
    order = np.arange(len(faces))
    box, child = np.empty((2 * len(faces) - 1, 6)), np.empty((2 * len(faces) - 1, 2), np.int64)
    nodes = grow_tree(boxes, order, box, child)
    corner = corner[order]
    triangle = np.concatenate([corner[:, 0], corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]], axis=1)
    return box[:nodes].copy(), child[:nodes].copy(), triangle


def build_outlines(outlines: Sequence[Sequence[ArrayLike]]) -> Outlines:
    """Put outlines in the arrays of the kernels.

    An outline is a list of loops, a loop (point, 2) in mm, with or without its first point again at the end. Which way
    a loop runs does not matter: one inside another is a hole, one inside a hole is material again, and so on.

    Raises
    ------
    ValueError
        If a loop is not (point, 2) finite numbers with three different points, or loops cross or touch themselves or one another.

    Examples
    --------
    >>> build_outlines([[[[0, 0], [0, 1], [1, 0]]]]).edge
    array([[1., 0., 0., 1.],
           [0., 1., 0., 0.],
           [0., 0., 1., 0.]])
    """
    edges = [np.empty((0, 4)), *(_outline(loops, i) for i, loops in enumerate(outlines))]
    return Outlines(np.cumsum([len(edge) for edge in edges]), np.concatenate(edges))


def _outline(loops: Sequence[ArrayLike], number: int) -> NDArray[np.float64]:
    """The edges of one outline, checked and running anticlockwise around material."""
    from .montecarlo._outline_checks import first_contact

    if len(loops) == 0:
        raise ValueError(f"outline {number} has no loops; give at least one")
    points = [_loop(loop, f"loop {i} of outline {number}") for i, loop in enumerate(loops)]
    edges = np.concatenate([np.concatenate([p, np.roll(p, -1, axis=0)], axis=1) for p in points])
    loop = np.repeat(np.arange(len(points)), [len(p) for p in points])
    i, j = first_contact(edges)
    if i >= 0:
        x, y = edges[i, :2]
        which = f"loop {loop[i]}" + ("" if loop[i] == loop[j] else f" and loop {loop[j]}")
        raise ValueError(
            f"{which} of outline {number} cross or touch beside ({x:g}, {y:g}) mm; draw lines that keep apart"
        )
    runs = [_run(p, [q for q in points if q is not p]) for p in points]
    return np.concatenate([np.concatenate([p, np.roll(p, -1, axis=0)], axis=1) for p in runs])


def _loop(loop: ArrayLike, name: str) -> NDArray[np.float64]:
    """A loop's points without repetitions."""
    points = np.asarray(loop, np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise ValueError(f"{name} must be (point, 2) finite numbers, got shape {points.shape}")
    points = points[(points != np.roll(points, 1, axis=0)).any(axis=1)] + 0.0
    if len(points) < 3:
        raise ValueError(f"{name} must have at least 3 different points, got {len(points)}")
    return points


def _run(points: NDArray[np.float64], others: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """The points in the order that keeps the material on the left."""
    x, y = points.T
    anticlockwise = float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) > 0
    hole = sum(_holds(other, points[0]) for other in others) % 2 == 1
    return points if anticlockwise != hole else points[::-1]


def _holds(loop: NDArray[np.float64], place: NDArray[np.float64]) -> bool:
    """Whether a place lies inside a loop, by the crossings of a line along x."""
    (x0, y0), (x1, y1) = (loop - place).T, (np.roll(loop, -1, axis=0) - place).T
    crossing = (y0 >= 0) != (y1 >= 0)
    right = (x0 * y1 - x1 * y0 > 0) == (y1 > y0)
    return bool((crossing & right).sum() % 2)


def build_voxels(volumes: Sequence[tuple[ArrayLike, ArrayLike]], attenuation: NDArray[np.float64]) -> Voxels:
    """Put voxel volumes in the arrays of the kernels, with the majorants of tracking through them.

    Parameters
    ----------
    volumes : for each (materials, pitch): materials (x, y, z), indices into `attenuation`; pitch (3), mm along x, y, z.
    attenuation : (material, energy bin, 10) as in `Physics`.

    Raises
    ------
    ValueError
        If a volume is not (x, y, z) of whole numbers that name materials, or a pitch not three positive lengths.

    Examples
    --------
    >>> import numpy as np
    >>> table = np.zeros((2, ENERGY_BINS, 10))
    >>> table[1, :, TOTAL] = 0.5
    >>> build_voxels([(np.ones((2, 3, 4), int), (1, 1, 2))], table).shape
    array([[2, 3, 4]])
    """
    cells = [_cells(materials, len(attenuation), i) for i, (materials, _) in enumerate(volumes)]
    pitches = [_pitch(pitch, i) for i, (_, pitch) in enumerate(volumes)]
    bound = _upper_bound(attenuation)
    ends = np.cumsum([0, *(cell.size for cell in cells)])
    return Voxels(
        ends[:-1].astype(np.int64),
        np.array([cell.shape for cell in cells], np.int64).reshape(-1, 3),
        np.array(pitches, np.float64).reshape(-1, 3),
        np.concatenate([np.empty(0, np.int16), *(cell.ravel() for cell in cells)]),
        np.array([bound[np.unique(cell)].max(axis=0) for cell in cells]).reshape(-1, ENERGY_BINS),
    )


def _cells(materials: ArrayLike, known: int, number: int) -> NDArray[np.int16]:
    cells = np.asarray(materials)
    if cells.ndim != 3 or cells.size == 0 or not np.issubdtype(cells.dtype, np.integer):
        raise ValueError(
            f"the materials of volume {number} must be (x, y, z) whole numbers, got {cells.dtype} of {cells.shape}"
        )
    low, high = int(cells.min()), int(cells.max())
    if low < 0 or high >= known:
        raise ValueError(f"the materials of volume {number} must be 0 to {known - 1}, got {low} to {high}")
    return np.ascontiguousarray(cells, np.int16)


def _pitch(pitch: ArrayLike, number: int) -> NDArray[np.float64]:
    lengths = np.asarray(pitch, np.float64)
    if lengths.shape != (3,) or not (np.isfinite(lengths).all() and (lengths > 0).all()):
        raise ValueError(f"the pitch of volume {number} must be three positive lengths in mm, got {pitch}")
    return lengths


def _upper_bound(attenuation: NDArray[np.float64]) -> NDArray[np.float64]:
    """(material, energy bin): the larger of the total attenuation at both ends of the bin, between which it is a line."""
    edge = np.arange(ENERGY_BINS + 1)
    octave, part = edge >> BINS_PER_OCTAVE_BITS, edge & ((1 << BINS_PER_OCTAVE_BITS) - 1)
    energy = LOWEST_ENERGY * 2.0**octave * (1.0 + part / (1 << BINS_PER_OCTAVE_BITS))
    a, b = attenuation[..., TOTAL], attenuation[..., TOTAL + 1]
    return np.maximum(a + b * energy[:-1], a + b * energy[1:]) * (1.0 + _MARGIN)
