"""A photon's straight flight through the solids, piece by piece, to its next collision.

`collect` finds all solids on the ray once; `piece` then gives one stretch of one material after another. No solid is
looked for again, no point on a surface is asked where it is, and the only tolerance is in `mask_piece`.
"""

from __future__ import annotations

import math

from ._jit import kernel
from ._physics_kernels import looked_up
from ._solid_kernels import (
    begins_inside,
    box_interval,
    convex_interval,
    crossing,
    inverse,
    is_convex,
    local,
    mask_piece,
    solid_box_interval,
)
from ._voxel_kernels import voxel_material
from .arrays import (
    COVERED,
    ENERGY,
    FREE,
    HOME,
    MASK,
    SEGMENTS,
    SHIELD,
    TARGET,
    TOTAL,
    VOXELS,
    U,
    V,
    W,
    X,
    Y,
    Z,
)
from .rng import exponential, uniform

ESCAPED, COLLIDED, STOPPED = 0, 1, 2
FAINT = 7.0
"""Optical depth beyond which no collision is forced."""
_NEXT_TO = 1e-6
"""mm; where a box around a detector is entered, and the detector itself, as far as rounding tells."""
OPAQUE = 60.0
"""Optical depth beyond which a flight without collision is given up."""


@kernel
def collect(geometry, desk, ray, left):
    """List the solids that a ray meets, with their next crossings; (how many, distance at which the world ends).

    `left` is a convex solid that the ray comes from and does not meet again, or 0.
    """
    x, y, z = ray[X], ray[Y], ray[Z]
    iu, iv, iw = inverse(ray[U]), inverse(ray[V]), inverse(ray[W])
    count = 0
    for solid in range(1, geometry.kind.size):
        if solid == left:
            continue
        near, far = box_interval(geometry.box[solid], x, y, z, iu, iv, iw)
        if not (near < far and far > 0.0):
            continue
        if is_convex(geometry.kind[solid]):
            near, far = convex_interval(geometry, solid, near, far, ray)
            if not (near < far and far > 0.0):
                continue
            desk.inside[count] = near < 0.0
            desk.following[count] = far if near < 0.0 else near
            desk.far[count] = far
        else:
            # A ray that begins outside of the box is outside, one that begins where it collided in this solid is inside.
            inside = near <= 0.0 and (solid == int(ray[HOME]) or begins_inside(geometry, desk, solid, ray))
            following = crossing(geometry, desk, solid, ray, 0.0, inside)
            if following == math.inf:
                continue
            desk.inside[count] = inside
            desk.following[count] = following
        desk.hit[count] = solid
        count += 1
    _, end = box_interval(geometry.box[0], x, y, z, iu, iv, iw)
    return count, end


@kernel
def piece(geometry, desk, ray, count, end, t):
    """The stretch that begins at t: (its solid, its material, where it ends, which entry of `hit` is crossed there, −1
    for the world, −2 for none).
    """
    solid, which, following = 0, -1, end
    for i in range(count):
        if desk.inside[i]:
            solid = desk.hit[i]
        if desk.following[i] < following:
            following, which = desk.following[i], i
    material = geometry.material[solid]
    if geometry.kind[solid] == MASK:
        material, wall = mask_piece(geometry, solid, ray, t)
        if wall < following:
            return solid, material, wall, -2
    return solid, material, max(following, t), which


@kernel
def cross(geometry, desk, ray, which, t):
    """Go through the surface of entry `which` of the list at distance t."""
    solid = desk.hit[which]
    inside = not desk.inside[which]
    desk.inside[which] = inside
    if is_convex(geometry.kind[solid]):
        desk.following[which] = desk.far[which] if inside else math.inf
    else:
        desk.following[which] = crossing(geometry, desk, solid, ray, t, inside)


@kernel
def voxels_collision(geometry, physics, desk, ray, solid, bin_, start, stop):
    """(Distance, material) of the next collision inside a voxel volume before `stop`, or (stop, −1): Woodcock's tracking."""
    volume = geometry.body[solid]
    x, y, z, u, v, w = local(geometry, solid, ray)
    majorant = geometry.voxels.majorant[volume, bin_]
    t = start
    while majorant > 0.0:
        t += exponential(desk.stream) / majorant
        if t >= stop:
            break
        material = voxel_material(geometry.voxels, volume, x + t * u, y + t * v, z + t * w)
        if uniform(desk.stream) * majorant < looked_up(physics, material, bin_, ray[ENERGY], TOTAL):
            return t, material
    return stop, -1


@kernel
def voxels_depth(geometry, physics, desk, ray, solid, bin_, start, stop):
    """An estimate of the optical depth between two distances inside a voxel volume; exp(−depth) is unbiased (ratio tracking)."""
    volume = geometry.body[solid]
    x, y, z, u, v, w = local(geometry, solid, ray)
    majorant = geometry.voxels.majorant[volume, bin_]
    t, passed = start, 1.0
    while majorant > 0.0 and passed > 0.0:
        t += exponential(desk.stream) / majorant
        if t >= stop:
            break
        material = voxel_material(geometry.voxels, volume, x + t * u, y + t * v, z + t * w)
        passed *= max(1.0 - looked_up(physics, material, bin_, ray[ENERGY], TOTAL) / majorant, 0.0)
    return -math.log(passed) if passed > 0.0 else math.inf


@kernel
def is_homely(kind):
    """Whether a flight may begin inside a solid of this kind without a look at the others."""
    return kind != VOXELS


@kernel
def at_home(geometry, physics, desk, ray, bin_, depth):
    """Begin a flight inside the solid of the last collision, where that stands alone: (collided, distance, material,
    depth left).
    """
    solid = int(ray[HOME])
    if is_convex(geometry.kind[solid]):
        near, far = solid_box_interval(geometry, solid, ray)
        near, far = convex_interval(geometry, solid, near, far, ray)
    else:
        far = crossing(geometry, desk, solid, ray, 0.0, True)
    t = 0.0
    while t < far:
        material, stop = geometry.material[solid], far
        if geometry.kind[solid] == MASK:
            material, wall = mask_piece(geometry, solid, ray, t)
            stop = min(wall, far)
        attenuation = looked_up(physics, material, bin_, ray[ENERGY], TOTAL)
        taken = attenuation * (stop - t)
        if depth < taken:
            return True, t + depth / attenuation, material, 0.0
        depth -= taken
        t = stop
    return False, max(far, 0.0), -1, depth


@kernel
def assembly_distance(detectors, detector, ray):
    """Where a ray enters the box around a detector and what is fixed to it; infinite if it does not."""
    iu, iv, iw = inverse(ray[U]), inverse(ray[V]), inverse(ray[W])
    near, far = box_interval(detectors.assembly[detector], ray[X], ray[Y], ray[Z], iu, iv, iw)
    return near if near < far and far > 0.0 else math.inf


@kernel
def limits(detectors, rules, ray):
    """(How far a photon flies before it comes to what its next-event estimates cover; how far it flies without collision).

    A next-event photon gives way to that of another detector, where the same ray comes to it later, or at the same
    place and its number is the lower one: so each way to fly without collision is followed once.
    """
    if rules.reduce is None:
        return math.inf, 0.0
    covered, free, end = int(ray[COVERED]), int(ray[FREE]), math.inf
    free_until = assembly_distance(detectors, free, ray) if free >= 0 else 0.0
    if covered != 0:
        for detector in range(detectors.solid.size):
            if (covered >> detector) & 1 and detector != free:
                there = assembly_distance(detectors, detector, ray)
                if there > free_until or (there == free_until and detector < free):
                    end = min(end, there)
    return end, free_until


@kernel
def fly(geometry, physics, detectors, rules, desk, ray, bin_, depth):
    """Follow a photon to its next collision.

    Returns (ESCAPED, COLLIDED or STOPPED where its next-event estimates take over; distance; material; solid; optical
    depth passed without collision by a next-event photon; whether a shield was crossed).
    """
    t, free_depth, shielded = 0.0, 0.0, False
    desk.entry[0] = -1.0
    last, free_until = limits(detectors, rules, ray)
    home, left = int(ray[HOME]), 0
    if free_until == 0.0 and home > 0 and geometry.alone[home] and is_homely(geometry.kind[home]):
        collided, t, material, depth = at_home(geometry, physics, desk, ray, bin_, depth)
        if collided and t < last:
            return COLLIDED, t, material, home, 0.0, False
        shielded = geometry.role[home] == SHIELD
        # A body that is not convex may be met again.
        left = home if is_convex(geometry.kind[home]) else 0
    count, end = collect(geometry, desk, ray, left)
    while True:
        solid, material, stop, which = piece(geometry, desk, ray, count, end, t)
        stop = min(stop, last)
        if desk.entry[0] < 0.0 and geometry.detector[solid] >= 0 and stop > t and solid != home:
            # What a next-event photon flies through without collision another one enters.
            desk.entry[0], desk.entry[1] = (t if t > free_until - _NEXT_TO else math.inf), geometry.detector[solid]
        free_stop = min(stop, free_until)
        if geometry.kind[solid] == VOXELS:
            if free_stop > t:
                free_depth += voxels_depth(geometry, physics, desk, ray, solid, bin_, t, free_stop)
                t = free_stop
            t, material = voxels_collision(geometry, physics, desk, ray, solid, bin_, t, stop)
            if material >= 0:
                return COLLIDED, t, material, solid, free_depth, shielded
        else:
            attenuation = looked_up(physics, material, bin_, ray[ENERGY], TOTAL)
            if geometry.role[solid] == SHIELD and material == geometry.material[solid] and stop > t:
                shielded = True
            if free_stop > t:
                free_depth += attenuation * (free_stop - t)
                t = free_stop
            taken = attenuation * (stop - t)
            if depth < taken:
                return COLLIDED, t + depth / attenuation, material, solid, free_depth, shielded
            depth -= taken
        if stop >= last:
            return STOPPED, stop, material, solid, free_depth, shielded
        if free_depth > OPAQUE or which == -1:
            return ESCAPED, stop, material, solid, free_depth, shielded
        if which >= 0:
            cross(geometry, desk, ray, which, stop)
        t = stop


@kernel
def pieces_ahead(geometry, physics, desk, ray, bin_):
    """Note the pieces of target and of air along a ray: (how many, how far they were looked for).

    `segment` holds start, length, attenuation and the probability that the first collision is there; `segment_solid`
    whose it is and whether a shield comes before it; `chance` the sums of the probabilities over the target and over
    the air. The search ends where little is left, and at voxel volumes, whose depth is not known at once.
    """
    count, end = collect(geometry, desk, ray, 0)
    t, depth, pieces, shielded = 0.0, 0.0, 0, 0
    desk.chance[0], desk.chance[1] = 0.0, 0.0
    while True:
        solid, material, stop, which = piece(geometry, desk, ray, count, end, t)
        if geometry.kind[solid] == VOXELS or pieces == SEGMENTS or depth > FAINT:
            return pieces, t
        attenuation = looked_up(physics, material, bin_, ray[ENERGY], TOTAL)
        taken = attenuation * (stop - t)
        if taken > 0.0 and (solid == 0 or geometry.role[solid] == TARGET):
            chance = math.exp(-depth) * -math.expm1(-taken)
            desk.chance[1 if solid == 0 else 0] += chance
            row, noted = desk.segment[pieces], desk.segment_solid[pieces]
            row[0], row[1], row[2], row[3] = t, stop - t, attenuation, chance
            noted[0], noted[1], noted[2] = solid, material, shielded
            pieces += 1
        if geometry.role[solid] == SHIELD and material == geometry.material[solid] and stop > t:
            shielded = 1
        depth += taken
        if which == -1:
            return pieces, stop
        if which >= 0:
            cross(geometry, desk, ray, which, stop)
        t = stop


@kernel
def place_in_pieces(desk, pieces, air):
    """Draw a collision from the pieces of target, or of air, that `pieces_ahead` noted: (distance, index of the piece)."""
    draw = uniform(desk.stream) * desk.chance[1 if air else 0]
    chosen = -1
    for i in range(pieces):
        if (desk.segment_solid[i, 0] == 0) == air:
            chosen = i
            draw -= desk.segment[i, 3]
            if draw < 0.0:
                break
    row = desk.segment[chosen]
    share = -math.expm1(-row[1] * row[2])
    return row[0] + min(-math.log1p(-uniform(desk.stream) * share) / row[2], row[1]), chosen
