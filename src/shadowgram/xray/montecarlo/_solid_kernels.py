"""Where a ray enters and leaves one solid; convex shapes here, the others in their own modules."""

from __future__ import annotations

import math

import numpy as np

from ._jit import kernel
from ._mesh_kernels import mesh_crossing, mesh_inside
from ._outline_kernels import outline_crossing, outline_inside
from .arrays import BOX, CYLINDER, ELLIPSOID, MASK, MESH, OUTLINE, VOXELS, U, V, W, X, Y, Z


@kernel
def slab(low, high, p, d):
    """(Entry, exit) of a ray between two parallel planes."""
    if d == 0.0:
        return (-math.inf, math.inf) if low <= p <= high else (math.inf, -math.inf)
    a, b = (low - p) / d, (high - p) / d
    return (a, b) if a < b else (b, a)


@kernel
def inverse(d):
    """1/d, with a huge number for the infinity of d = 0: a ray in a plane counts as inside it and no 0 · ∞ comes up."""
    return 1.0 / d if abs(d) > 1e-290 else math.copysign(1e290, d)


@kernel
def box_interval(box, x, y, z, iu, iv, iw):
    """(Entry, exit) of a ray and a box with faces along the axes, from the inverse direction; exit < entry if they miss.

    `box` is lower x, y, z and upper x, y, z.
    """
    a, b = (box[0] - x) * iu, (box[3] - x) * iu
    near, far = (a, b) if a < b else (b, a)
    a, b = (box[1] - y) * iv, (box[4] - y) * iv
    low, high = (a, b) if a < b else (b, a)
    near, far = (low if low > near else near), (high if high < far else far)
    a, b = (box[2] - z) * iw, (box[5] - z) * iw
    low, high = (a, b) if a < b else (b, a)
    return (low if low > near else near), (high if high < far else far)


@kernel
def solid_box_interval(geometry, solid, ray):
    """(Entry, exit) of a ray and the box around one solid."""
    iu, iv, iw = inverse(ray[U]), inverse(ray[V]), inverse(ray[W])
    return box_interval(geometry.box[solid], ray[X], ray[Y], ray[Z], iu, iv, iw)


@kernel
def quadratic(a, half_b, c):
    """Both roots of a t² + 2 half_b t + c = 0 in order, without cancellation; (∞, −∞) if there is none."""
    root = half_b * half_b - a * c
    if root <= 0.0 or a == 0.0:
        return math.inf, -math.inf
    q = -(half_b + math.copysign(math.sqrt(root), half_b))
    first, second = q / a, (c / q if q != 0.0 else 0.0)
    return (first, second) if first < second else (second, first)


@kernel
def ellipsoid_interval(size, x, y, z, u, v, w):
    """(Entry, exit) of a ray and an ellipsoid about the origin."""
    x, y, z, u, v, w = x / size[0], y / size[1], z / size[2], u / size[0], v / size[1], w / size[2]
    return quadratic(u * u + v * v + w * w, x * u + y * v + z * w, x * x + y * y + z * z - 1.0)


@kernel
def cylinder_interval(size, x, y, z, u, v, w):
    """(Entry, exit) of a ray and a cylinder about the z axis."""
    near, far = slab(-size[2], size[2], z, w)
    across = u * u + v * v
    outside = x * x + y * y - size[0] * size[0]
    if across < 1e-30:
        return (near, far) if outside <= 0.0 else (math.inf, -math.inf)
    a, b = quadratic(across, x * u + y * v, outside)
    return max(near, a), min(far, b)


@kernel
def local(geometry, solid, ray):
    """A ray in the frame of a solid."""
    f = geometry.frame[solid]
    x, y, z = ray[X] - f[9], ray[Y] - f[10], ray[Z] - f[11]
    u, v, w = ray[U], ray[V], ray[W]
    if geometry.turned[solid] == 0:
        return x, y, z, u, v, w
    return (
        f[0] * x + f[1] * y + f[2] * z,
        f[3] * x + f[4] * y + f[5] * z,
        f[6] * x + f[7] * y + f[8] * z,
        f[0] * u + f[1] * v + f[2] * w,
        f[3] * u + f[4] * v + f[5] * w,
        f[6] * u + f[7] * v + f[8] * w,
    )


@kernel
def convex_interval(geometry, solid, near, far, ray):
    """(Entry, exit) of a ray and a convex solid, given those of the box around it."""
    kind = geometry.kind[solid]
    if kind == MASK or (geometry.turned[solid] == 0 and (kind in (BOX, VOXELS))):
        return near, far
    x, y, z, u, v, w = local(geometry, solid, ray)
    size = geometry.size[solid]
    if kind == ELLIPSOID:
        return ellipsoid_interval(size, x, y, z, u, v, w)
    if kind == CYLINDER:
        return cylinder_interval(size, x, y, z, u, v, w)
    low = 0.0 if kind == VOXELS else -1.0
    near, far = slab(low * size[0], size[0], x, u)
    a, b = slab(low * size[1], size[1], y, v)
    near, far = max(near, a), min(far, b)
    a, b = slab(low * size[2], size[2], z, w)
    return max(near, a), min(far, b)


@kernel
def is_convex(kind):
    """Whether a ray meets solids of this kind in one piece."""
    return kind not in (OUTLINE, MESH)


@kernel
def begins_inside(geometry, desk, solid, ray):
    """Whether a ray begins inside a solid that is not convex."""
    body = geometry.body[solid]
    if geometry.kind[solid] == MESH:
        return mesh_inside(geometry.meshes, body, desk.nodes, ray[X], ray[Y], ray[Z], ray[U], ray[V], ray[W])
    x, y, z, u, v, w = local(geometry, solid, ray)
    return outline_inside(geometry.outlines, body, geometry.size[solid, 2], x, y, z, u, v, w)


@kernel
def crossing(geometry, desk, solid, ray, after, leaving):
    """The next entry into, or exit from, a solid that is not convex."""
    body = geometry.body[solid]
    if geometry.kind[solid] == MESH:
        return mesh_crossing(
            geometry.meshes, body, desk.nodes, ray[X], ray[Y], ray[Z], ray[U], ray[V], ray[W], after, leaving
        )
    x, y, z, u, v, w = local(geometry, solid, ray)
    return outline_crossing(geometry.outlines, body, geometry.size[solid, 2], x, y, z, u, v, w, after, leaving)


@kernel
def mask_piece(geometry, solid, ray, t):
    """(Material, distance of the next cell wall) in a mask at distance t along a ray."""
    masks, mask = geometry.masks, geometry.body[solid]
    # A step of 0.1 nm past the wall just crossed, so that the ray is in the next cell whatever the rounding.
    t += 1e-7
    column = (ray[X] + t * ray[U] - masks.corner[mask, 0]) / masks.step[mask, 0]
    row = (ray[Y] + t * ray[V] - masks.corner[mask, 1]) / masks.step[mask, 1]
    j, i = math.floor(column), math.floor(row)
    across, down = ray[U] / masks.step[mask, 0], ray[V] / masks.step[mask, 1]
    wall = math.inf
    if across > 0.0:
        wall = t + (j + 1.0 - column) / across
    elif across < 0.0:
        wall = t + (j - column) / across
    if down > 0.0:
        wall = min(wall, t + (i + 1.0 - row) / down)
    elif down < 0.0:
        wall = min(wall, t + (i - row) / down)
    rows, columns = masks.shape[mask, 0], masks.shape[mask, 1]
    if 0 <= i < rows and 0 <= j < columns and masks.open[masks.start[mask] + np.int64(i) * columns + np.int64(j)]:
        return masks.filling[mask], wall
    return geometry.material[solid], wall
