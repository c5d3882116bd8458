"""Rays against extruded polygons, in the polygon's own frame: (x, y) across, z along the extrusion.

Seen along z the ray is a line. A corner lies to the left of it or not (on it counts as left), alike for both edges that
meet there, and the line crosses the edges between a corner on the left and one that is not. So every loop is entered as
often as it is left, also by a line through a corner or along an edge. Inside at t is what has more leaving than
entering crossings strictly beyond t, as for meshes (see `_mesh_kernels`), and lies between the caps, of which the first
on the ray belongs to the solid and the last does not.
"""

from __future__ import annotations

import math

from ._jit import routine


@routine
def _caps(half_z, pz, dz):
    """(Entry, exit) of a ray between the caps; exit ≤ entry if it never is."""
    if dz == 0.0:
        return (-math.inf, math.inf) if -half_z <= pz < half_z else (math.inf, -math.inf)
    a, b = (-half_z - pz) / dz, (half_z - pz) / dz
    return (a, b) if a < b else (b, a)


@routine
def _across(dx, dy):
    """(dx, dy, 1 / |d|²) of the ray seen along z; a ray along z looks along x, and moves nowhere."""
    square = dx * dx + dy * dy
    if square < 1e-200:
        return 1.0, 0.0, 0.0
    return dx, dy, 1.0 / square


@routine
def _edges(outlines, outline, px, py, dx, dy, after):
    """(Leaving minus entering crossings beyond `after`, the nearest t of them, its net change); t = ∞ for a ray along z."""
    ux, uy, per_square = _across(dx, dy)
    beyond, nearest, change = 0, math.inf, 0
    for i in range(outlines.start[outline], outlines.start[outline + 1]):
        ax, ay = outlines.edge[i, 0] - px, outlines.edge[i, 1] - py
        bx, by = outlines.edge[i, 2] - px, outlines.edge[i, 3] - py
        a, b = ux * ay - uy * ax, ux * by - uy * bx
        if (a >= 0.0) == (b >= 0.0):
            continue
        s, e = ux * ax + uy * ay, ux * bx + uy * by
        t = s + (e - s) * (a / (a - b))
        t = t * per_square if per_square > 0.0 else (math.inf if t > 0.0 else -math.inf)
        if t <= after:
            continue
        # From right to left of the ray goes an anticlockwise edge where the ray comes out.
        step = -1 if b >= 0.0 else 1
        beyond -= step
        if t < nearest:
            nearest, change = t, step
        elif t == nearest:
            change += step
    return beyond, nearest, change


@routine
def outline_inside(outlines, outline, half_z, px, py, pz, dx, dy, dz):
    """Whether the ray p + t d is inside just after t = 0."""
    begin, end = _caps(half_z, pz, dz)
    beyond, _, _ = _edges(outlines, outline, px, py, dx, dy, 0.0)
    return begin <= 0.0 < end and beyond > 0


@routine
def outline_crossing(outlines, outline, half_z, px, py, pz, dx, dy, dz, after, leaving):
    """The smallest t ≥ after from which on the ray p + t d is outside (if `leaving`) or inside (if not); infinite if there is none.

    It is `after` itself only where the ray is there already, so that a walker that asks in turns never stands still.
    """
    begin, end = _caps(half_z, pz, dz)
    # Before the first cap as well as beyond the last one it is outside already.
    if leaving and not begin <= after < end:
        return after
    t = after if leaving else max(after, begin)
    beyond, following, change = _edges(outlines, outline, px, py, dx, dy, t)
    while t < end and (beyond > 0) == leaving:
        t = following
        beyond += change
        if t < end:
            _, following, change = _edges(outlines, outline, px, py, dx, dy, t)
    if leaving:
        return min(t, end)
    return t if t < end else math.inf
