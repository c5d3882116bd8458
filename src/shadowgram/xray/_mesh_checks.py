"""Whether a triangle mesh bounds a body, and whether two bodies overlap."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Vertices = NDArray[np.float64]
Faces = NDArray[np.int64]
Mesh = tuple[Vertices, Faces]

TOUCHING = 2.0**-22
"""Bodies that reach into one another by less than this, times the largest coordinate, touch: four roundings of a float32 file."""


class _Edges(NamedTuple):
    """Sides of faces, sorted so that those of one edge stand together.

    Attributes
    ----------
    face
        (side): the face it belongs to.
    way
        (side): +1 where it runs from the lower to the higher vertex, else −1.
    first
        (edge): where its sides begin.
    sides
        (edge): how many sides it has.
    """

    face: NDArray[np.int64]
    way: NDArray[np.int64]
    first: NDArray[np.int64]
    sides: NDArray[np.int64]


def check_mesh(vertices: ArrayLike, faces: ArrayLike, name: str) -> Mesh:
    """Make of a triangle mesh the clean boundary of a body, or say what is wrong with it.

    Equal vertices are merged and faces without three different ones removed. Faces are turned so that neighbours
    agree, and bodies so that the material is inside; what lies in another body and is turned the other way is a cavity and stays.

    Parameters
    ----------
    vertices : (vertex, 3), finite, mm.
    faces : (face, 3), indices of vertices.
    name : of the mesh, for messages.

    Returns
    -------
    vertices, faces : the same of the clean mesh; the normal by the right-hand rule points out of the material.

    Raises
    ------
    ValueError
        If an array is not one of these, the surface is open, has no inner side, or encloses nothing.

    Examples
    --------
    >>> corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    >>> check_mesh(corners, [[0, 1, 2], [0, 1, 3], [1, 2, 3], [2, 0, 3]], "tetrahedron")[1].tolist()
    [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
    """
    points, corners = _arrays(vertices, faces, name)
    points, corners = _merged(points, corners)
    if len(corners) == 0:
        raise ValueError(f"{name} holds no triangle with three different corners")
    edges = _edges(corners, len(points))
    _check_closed(edges, name)
    body = _labels(*_neighbours(edges)[:2], len(corners))
    if _ways(edges).any():
        corners = _turned(corners, _disagreeing(edges, body, len(corners), name))
    corners = _outward(points, corners, body, name)
    _check_paired(_edges(corners, len(points)), name)
    return points, corners


def body_labels(vertices: ArrayLike, faces: ArrayLike) -> NDArray[np.int64]:
    """The number of the body that each face belongs to, (face,); faces that share an edge belong together.

    Examples
    --------
    >>> import numpy as np
    >>> corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    >>> faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    >>> body_labels(np.concatenate([corners, corners + 5]), np.concatenate([faces, faces + 4])).tolist()
    [0, 0, 0, 0, 1, 1, 1, 1]
    """
    points, corners = _arrays(vertices, faces, "the mesh")
    return _labels(*_neighbours(_edges(corners, len(points)))[:2], len(corners))


def meshes_overlap(a: Mesh, b: Mesh) -> bool:
    """Whether two bodies, each as `check_mesh` returns it, share a volume; touching at faces, edges or corners is not sharing.

    Examples
    --------
    >>> import numpy as np
    >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    >>> faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    >>> meshes_overlap((corners, faces), (corners + 0.1, faces)), meshes_overlap((corners, faces), (corners + [0, 0, 1], faces))
    (True, False)
    """
    from ._bodies import build_meshes
    from .montecarlo._overlap_kernels import reaches_into

    boxes = [(v[f].min(axis=(0, 1)), v[f].max(axis=(0, 1))) for v, f in (a, b)]
    (low_a, high_a), (low_b, high_b) = boxes
    depth = TOUCHING * max(float(np.abs(corner).max()) for box in boxes for corner in box)
    if ((high_a - low_b <= depth) | (high_b - low_a <= depth)).any():
        return False
    first, second = build_meshes([a]), build_meshes([b])
    return bool(reaches_into(first.triangle, second, depth) or reaches_into(second.triangle, first, depth))


def _arrays(vertices: ArrayLike, faces: ArrayLike, name: str) -> Mesh:
    points, corners = np.asarray(vertices, np.float64), np.asarray(faces)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(f"the vertices of {name} must be (vertex, 3) finite numbers, got shape {points.shape}")
    if corners.ndim != 2 or corners.shape[1] != 3 or not np.issubdtype(corners.dtype, np.integer):
        raise ValueError(f"the faces of {name} must be (face, 3) whole numbers, got {corners.dtype} of {corners.shape}")
    if len(corners) and not 0 <= corners.min() <= corners.max() < len(points):
        raise ValueError(f"the faces of {name} must name vertices 0 to {len(points) - 1}, got {corners.max()}")
    return points, corners.astype(np.int64)


def _merged(points: Vertices, corners: Faces) -> Mesh:
    """Equal vertices made one, unused ones and faces that name one twice left out."""
    points = points + 0.0  # −0 equals 0
    order = np.lexsort(points.T)
    new = np.ones(len(points), bool)
    new[1:] = (np.diff(points[order], axis=0) != 0).any(axis=1)
    number = np.empty(len(points), np.int64)
    number[order] = np.cumsum(new) - 1
    corners = number[corners]
    kept = (corners != np.roll(corners, 1, axis=1)).all(axis=1)
    corners = corners[kept]
    used, corners = np.unique(corners, return_inverse=True)
    return points[order][new][used], corners.reshape(-1, 3)


def _edges(corners: Faces, vertices: int) -> _Edges:
    start, stop = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    key = np.minimum(start, stop) * vertices + np.maximum(start, stop)
    order = np.argsort(key, kind="stable")
    _, first, count = np.unique(key[order], return_index=True, return_counts=True)
    return _Edges(order // 3, np.where(start < stop, 1, -1)[order], first, count)


def _ways(edges: _Edges) -> NDArray[np.int64]:
    """For each edge, sides that run up minus sides that run down: 0 where its faces agree."""
    return np.add.reduceat(edges.way, edges.first)


def _check_closed(edges: _Edges, name: str) -> None:
    open_ = int((edges.sides == 1).sum())
    if open_:
        raise ValueError(
            f"{name} is not closed: {open_} of its {len(edges.sides)} edges belong to one face only; "
            "fill the holes and join the seams (for example with MeshLab or Blender) and export it again"
        )


def _check_paired(edges: _Edges, name: str) -> None:
    """Raise unless the faces at every edge come in pairs that agree; bodies may touch at an edge."""
    unpaired = int((_ways(edges) != 0).sum())
    if unpaired:
        raise ValueError(
            f"{name} does not bound a body: {unpaired} of its {len(edges.sides)} edges belong to three or more faces "
            "that do not pair up; remove inner or doubled faces and export it again"
        )


def _neighbours(edges: _Edges) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """(Face, face, whether they agree) at every edge that has just two."""
    side = edges.first[edges.sides == 2]
    return edges.face[side], edges.face[side + 1], edges.way[side] != edges.way[side + 1]


def _labels(a: NDArray[np.int64], b: NDArray[np.int64], nodes: int) -> NDArray[np.int64]:
    """The number of the connected part that each node belongs to."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(a), bool), (a, b)), shape=(nodes, nodes))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _disagreeing(edges: _Edges, body: NDArray[np.int64], faces: int, name: str) -> NDArray[np.bool_]:
    """Which faces to turn so that neighbours agree, the fewer ones of each body.

    Every face is two nodes, as it is and turned. Neighbours that agree join like with like, others like with unlike; a
    surface with two sides then falls into two parts, each other's reverse.
    """
    a, b, agree = _neighbours(edges)
    other = faces * ~agree
    label = _labels(np.concatenate([a, a + faces]), np.concatenate([b + other, b + faces - other]), 2 * faces)
    if (label[:faces] == label[faces:]).any():
        raise ValueError(f"{name} does not bound a body: it has no inner side, as a Möbius strip has none")
    turn = label[:faces] > label[faces:]
    mostly = np.bincount(body, turn) * 2 > np.bincount(body)
    return turn ^ mostly[body]


def _turned(corners: Faces, turn: NDArray[np.bool_]) -> Faces:
    corners = corners.copy()
    corners[turn] = corners[turn][:, [0, 2, 1]]
    return corners


def _volumes(points: Vertices, corners: Faces, body: NDArray[np.int64]) -> NDArray[np.float64]:
    a, b, c = np.moveaxis(points[corners] - points.mean(axis=0), 1, 0)
    return np.bincount(body, np.einsum("ij,ij->i", a, np.cross(b, c))) / 6


def _outward(points: Vertices, corners: Faces, body: NDArray[np.int64], name: str) -> Faces:
    """Faces turned so that the whole has a positive volume, and bodies so that only cavities have a negative one."""
    volumes = _volumes(points, corners, body)
    size = float(np.prod(np.ptp(points, axis=0)))
    if not abs(volumes).max() > 1e-12 * size:
        raise ValueError(f"{name} encloses no volume; all its points lie in a plane or its faces cancel")
    if volumes.sum() < 0:
        corners, volumes = _turned(corners, np.ones(len(corners), bool)), -volumes
    inside_out = np.zeros(len(volumes), bool)
    for k in np.flatnonzero(volumes < 0):
        inside_out[k] = not _is_within_another(points, corners, body, volumes, int(k))
    return _turned(corners, inside_out[body])


def _is_within_another(
    points: Vertices, corners: Faces, body: NDArray[np.int64], volumes: NDArray[np.float64], k: int
) -> bool:
    """Whether a vertex of body k lies inside another body."""
    from ._bodies import build_meshes
    from .montecarlo._mesh_kernels import STACK, mesh_inside

    place = points[corners[body == k][0, 0]]
    x, y, z = place
    stack = np.empty(STACK, np.int64)
    for j in np.flatnonzero(volumes > 0):
        other = corners[body == j]
        low, high = points[other].min(axis=(0, 1)), points[other].max(axis=(0, 1))
        near = ((low <= place) & (place <= high)).all()
        if near and mesh_inside(build_meshes([(points, other)]), 0, stack, x, y, z, 0.36, 0.48, 0.8):
            return True
    return False
