"""Rays against closed triangle meshes, without gaps: every ray goes in as often as it comes out.

**Which triangles a ray crosses.** The vertices are sheared so that the ray becomes the axis, and a triangle is crossed
where the axis lies on one side of its three edges (Woop, Benthin & Wald, J. Comput. Graph. Techn. 2(1), 2013). A vertex
is rounded alike for all its triangles. The signs of the edge functions are then exact: where two products are equal,
their rounding errors decide. An axis that meets an edge or a vertex is moved aside by an infinitesimal (ε, ε²), the
same for all triangles (Edelsbrunner & Mücke, ACM Trans. Graph. 9(1), 1990). So the crossings are those of some closed
mesh and a ray that meets none of its edges: as many entering as leaving ones, always, and none for a face seen edge-on.

**What is inside.** The distances t of crossings are rounded. Where a ray grazes an edge between an entering and a
leaving face, or passes from one body into another that touches it, two crossings can have equal t or come in the wrong
order. Therefore no face decides alone. Let A(t) be the number of leaving minus entering crossings strictly beyond t;
the ray is inside at t where A(t) ≥ 1. A grazed edge adds a pair that cancels, leaving nothing or a length of rounding
size, and touching bodies are left only at the end of the last one. A is zero at the far end, so that nobody stays
inside for ever, and it does not hang on what a walker did before: one that wrongly believes itself inside is told to
leave at once.
"""

from __future__ import annotations

import math

import numpy as np

from ._jit import routine

STACK = 64
"""Length of the caller's stack; the builder makes no tree deeper than this."""

_LOW = (1 << 32) - 1
_HIGH = ~_LOW
_PADDING = 2.0**-49
_SLACK = 2.0**-36
_FLAT = 1e-100
_STEEPEST = 1e200


@routine
def _two_product(a, b):
    """(p, e) with p + e = a b exactly (Dekker, Numer. Math. 18, 1971)."""
    p = a * b
    s = 134217729.0 * a
    ah = s - (s - a)
    al = a - ah
    s = 134217729.0 * b
    bh = s - (s - b)
    bl = b - bh
    return p, ((ah * bh - p) + ah * bl + al * bh) + al * bl


@routine
def _edge(ax, ay, bx, by):
    """(value, side) of a × b; the side is exact, and that of an infinitesimally moved origin where a × b is 0."""
    p, e = _two_product(ax, by)
    q, f = _two_product(ay, bx)
    # Rounding keeps order, so unequal products are in the right order.
    if p != q:
        return (p - q) + (e - f), 1 if p > q else -1
    if e != f:
        return e - f, 1 if e > f else -1
    if ay != by:
        return 0.0, 1 if ay > by else -1
    if ax != bx:
        return 0.0, 1 if bx > ax else -1
    return 0.0, 0


@routine
def _sheared(px, py, pz, dx, dy, dz):
    """Axes (kx, ky, kz) with kz along the largest component and kept handedness, the origin in that order, the shear, 1/d."""
    largest = max(abs(dx), abs(dy), abs(dz))
    if abs(dz) == largest:
        kx, ky, kz, ox, oy, oz, u, v, w = 0, 1, 2, px, py, pz, dx, dy, dz
    elif abs(dy) == largest:
        kx, ky, kz, ox, oy, oz, u, v, w = 2, 0, 1, pz, px, py, dz, dx, dy
    else:
        kx, ky, kz, ox, oy, oz, u, v, w = 1, 2, 0, py, pz, px, dy, dz, dx
    if w < 0.0:
        kx, ky, ox, oy, u, v = ky, kx, oy, ox, v, u
    sx, sy = u / w, v / w
    # Slopes so small that their products would underflow are none.
    sx = sx if abs(sx) > _FLAT else 0.0
    sy = sy if abs(sy) > _FLAT else 0.0
    return kx, ky, kz, ox, oy, oz, sx, sy, 1.0 / w


@routine
def _crossed(triangle, i, shear):
    """(t, change) of triangle i: change is +1 where the ray enters the material, −1 where it leaves, 0 where it passes by."""
    kx, ky, kz, ox, oy, oz, sx, sy, sz = shear
    x, y, z = triangle[i, kx], triangle[i, ky], triangle[i, kz]
    # The builder puts vertices on a grid on which vertex + edge is exact, so that neighbours find the same vertex.
    az, bz, cz = z - oz, (z + triangle[i, 3 + kz]) - oz, (z + triangle[i, 6 + kz]) - oz
    ax = (x - ox) - sx * az
    bx = ((x + triangle[i, 3 + kx]) - ox) - sx * bz
    cx = ((x + triangle[i, 6 + kx]) - ox) - sx * cz
    ay = (y - oy) - sy * az
    by = ((y + triangle[i, 3 + ky]) - oy) - sy * bz
    cy = ((y + triangle[i, 6 + ky]) - oy) - sy * cz
    u = cx * by - cy * bx
    v = ax * cy - ay * cx
    w = bx * ay - by * ax
    if min(u, v, w) < 0.0 < max(u, v, w):
        return math.inf, 0
    u, side = _edge(cx, cy, bx, by)
    v, side_v = _edge(ax, ay, cx, cy)
    w, side_w = _edge(bx, by, ax, ay)
    if side != side_v or side != side_w or side == 0:
        return math.inf, 0
    area = u + v + w
    return ((u * az + v * bz + w * cz) / area * sz if area != 0.0 else az * sz), side


@routine
def _slopes(px, py, pz, dx, dy, dz, pad):
    """For each axis: the column of the box face met first and of the other one, where p stands to each of them padded, and 1/d.

    1/d stays finite along an axis that the ray does not move on.
    """
    ix = 1.0 / dx if abs(dx) > 1.0 / _STEEPEST else _STEEPEST
    iy = 1.0 / dy if abs(dy) > 1.0 / _STEEPEST else _STEEPEST
    iz = 1.0 / dz if abs(dz) > 1.0 / _STEEPEST else _STEEPEST
    x0, x1, p0, p1 = (0, 3, px + pad, px - pad) if ix > 0.0 else (3, 0, px - pad, px + pad)
    y0, y1, q0, q1 = (1, 4, py + pad, py - pad) if iy > 0.0 else (4, 1, py - pad, py + pad)
    z0, z1, r0, r1 = (2, 5, pz + pad, pz - pad) if iz > 0.0 else (5, 2, pz - pad, pz + pad)
    return x0, x1, y0, y1, z0, z1, p0, p1, q0, q1, r0, r1, ix, iy, iz


@routine
def _reach(box, node, px, py, pz):
    """The largest coordinate difference between p and the box."""
    x = max(abs(box[node, 0] - px), abs(box[node, 3] - px))
    y = max(abs(box[node, 1] - py), abs(box[node, 4] - py))
    z = max(abs(box[node, 2] - pz), abs(box[node, 5] - pz))
    return max(x, y, z)


@routine
def _near(box, node, line, first, last):
    """Where the ray enters the padded box, at least 0; infinite where it misses it between `first` and `last`."""
    x0, x1, y0, y1, z0, z1, p0, p1, q0, q1, r0, r1, ix, iy, iz = line
    near = max((box[node, x0] - p0) * ix, (box[node, y0] - q0) * iy, (box[node, z0] - r0) * iz, 0.0)
    far = min((box[node, x1] - p1) * ix, (box[node, y1] - q1) * iy, (box[node, z1] - r1) * iz)
    return near if near <= far and far >= first and near <= last else math.inf


@routine
def net_crossing(meshes, mesh, stack, px, py, pz, dx, dy, dz, after, every):
    """The nearest t > after and its net change (two faces may share it); with `every`, the net change of all t > after instead.

    The stack holds nodes and where the ray enters them in one number: the upper half of a positive float64 keeps its
    order and only rounds down. Boxes are padded by the rounding of sheared vertices, and pruned with a slack for that of t.
    """
    # One way out, nothing that raises and an inlined triangle test: so numba counts no references here, which threads share.
    shear = _sheared(px, py, pz, dx, dy, dz)
    node = meshes.root[mesh]
    reach = _reach(meshes.node_box, node, px, py, pz)
    line = _slopes(px, py, pz, dx, dy, dz, _PADDING * reach)
    slack = _SLACK * reach * abs(shear[8])
    best, change, top, first = math.inf, 0, 0, after - slack
    last = np.float64(best).view(np.int64)
    stack[0] = node
    top = 1
    while top > 0:
        top -= 1
        node = stack[top] & _LOW
        if (stack[top] & _HIGH) > last:
            continue
        while meshes.node_child[node, 0] >= 0:
            left, right = meshes.node_child[node, 0], meshes.node_child[node, 1]
            t = _near(meshes.node_box, left, line, first, best + slack)
            s = _near(meshes.node_box, right, line, first, best + slack)
            if s < t:
                left, right, t, s = right, left, s, t
            if s < math.inf:
                stack[top] = (np.float64(s).view(np.int64) & _HIGH) | right
                top += 1
            node = left
            if t == math.inf:
                break
        else:
            begin = -1 - meshes.node_child[node, 0]
            for i in range(begin, begin + meshes.node_child[node, 1]):
                t, side = _crossed(meshes.triangle, i, shear)
                if side != 0 and t > after:
                    if every or t == best:
                        change += side
                    elif t < best:
                        best, change = t, side
            last = np.float64(best + slack).view(np.int64)
    return best, change


@routine
def mesh_inside(meshes, mesh, stack, px, py, pz, dx, dy, dz):
    """Whether the ray p + t d is inside just after t = 0."""
    _, change = net_crossing(meshes, mesh, stack, px, py, pz, dx, dy, dz, 0.0, True)
    return change < 0


@routine
def mesh_crossing(meshes, mesh, stack, px, py, pz, dx, dy, dz, after, leaving):
    """The smallest t ≥ after from which on the ray p + t d is outside (if `leaving`) or inside (if not); infinite if there is none.

    A walker that is where it believes to be gets t > after. One that is not, because rounding put it down on the other
    side of a surface, gets `after` itself, never twice in a row. A leaving walker never gets infinity.
    `after` is at least 0; `stack` is an int64 array of length `STACK`.
    """
    depth, t = 1 if leaving else 0, after
    while (depth > 0) == leaving and t < math.inf:
        t, change = net_crossing(meshes, mesh, stack, px, py, pz, dx, dy, dz, t, False)
        depth += change
    # All changes up to the far end sum to −A(after): then it is known where the ray was at `after`.
    return after if t == math.inf and (leaving or depth < 0) else t
