"""Next-event estimates: after a collision, photons are sent to the detectors with the weight of their getting there."""

from __future__ import annotations

import math

from ._jit import kernel
from ._physics_kernels import compton_density, energy_bin, rayleigh_density
from ._record_kernels import DID_COMPTON, DID_RAYLEIGH, MET_DETECTOR, copy_record
from ._walk_kernels import OPAQUE, at_home, is_homely
from .arrays import COVERED, ENERGY, FREE, HOME, MARKS, PENDING, SHIELD, TARGET, WEIGHT, U, V, W, X
from .rng import uniform


@kernel
def face_gap(box, place, axis):
    """How far a point is in front of the nearer face across an axis; negative between the two."""
    return max(box[axis] - place, place - box[3 + axis])


@kernel
def face_weight(box, photon, axis, gap):
    """About the solid angle of a face: its area seen from its middle."""
    across, along = (axis + 1) % 3, (axis + 2) % 3
    a, b = box[3 + across] - box[across], box[3 + along] - box[along]
    da = 0.5 * (box[3 + across] + box[across]) - photon[X + across]
    db = 0.5 * (box[3 + along] + box[along]) - photon[X + along]
    squared = gap * gap + da * da + db * db
    return a * b * gap / (squared * math.sqrt(squared))


@kernel
def cauchy(stream, low, high, gap):
    """A place between `low` and `high` with density gap / (span (gap² + place²)), and span, the angle between the two."""
    low, high = low / gap, high / gap
    span = math.atan2(high - low, 1.0 + low * high)
    part = math.tan(uniform(stream) * span)
    return gap * (low + part) / (1.0 - low * part), span


@kernel
def along_strip(stream, low, high, squared):
    """A place between `low` and `high` with density ∝ (squared + place²)^(−3/2), and the integral of that, times `squared`.

    So a point of a strip is uniform in solid angle, as seen from a distance √squared.
    """
    low, high = low / math.sqrt(squared + low * low), high / math.sqrt(squared + high * high)
    sine = low + uniform(stream) * (high - low)
    return sine * math.sqrt(squared / (1.0 - sine * sine)), high - low


@kernel
def aim(detectors, desk, photon, detector, near):
    """A direction to a detector as a photon sees it: (direction, its probability per steradian), or a density of 0 if
    it is too close.

    A point is drawn on the faces that look at the photon; a detector is convex, so every direction that meets it has
    one such point. Across the face a Cauchy law, then along it the law of the solid angle, put it almost evenly there.
    """
    box = detectors.assembly[detector]
    total, closest = 0.0, 0.0
    for axis in range(3):
        gap = face_gap(box, photon[X + axis], axis)
        if gap > 0.0:
            closest += gap * gap
            total += face_weight(box, photon, axis, gap)
    if closest <= near * near:
        return 0.0, 0.0, 0.0, 0.0
    draw = uniform(desk.stream) * total
    face, weight = 0, 0.0
    for axis in range(3):
        gap = face_gap(box, photon[X + axis], axis)
        if gap > 0.0:
            face, weight = axis, face_weight(box, photon, axis, gap)
            if draw < weight:
                break
            draw -= weight
    gap = face_gap(box, photon[X + face], face)
    across, along = (face + 1) % 3, (face + 2) % 3
    a, span = cauchy(desk.stream, box[across] - photon[X + across], box[3 + across] - photon[X + across], gap)
    squared = a * a + gap * gap
    b, sines = along_strip(desk.stream, box[along] - photon[X + along], box[3 + along] - photon[X + along], squared)
    c = gap if photon[X + face] < box[face] else -gap
    distance = math.sqrt(squared + b * b)
    # Densities of a and b times distance³ / gap, which turns an area of the face into a solid angle.
    density = weight / (total * span * sines)
    if face == 0:
        return c / distance, a / distance, b / distance, density
    if face == 1:
        return b / distance, c / distance, a / distance, density
    return a / distance, b / distance, c / distance, density


@kernel
def worthwhile(geometry, physics, desk, sent, least):
    """Russian roulette by the weight that a next-event photon would arrive with, as far as the solid that it sets out
    from tells.
    """
    home, left = int(sent[HOME]), OPAQUE
    if geometry.role[home] == SHIELD and geometry.alone[home] and is_homely(geometry.kind[home]):
        _, _, _, left = at_home(geometry, physics, desk, sent, energy_bin(sent[ENERGY]), OPAQUE)
    arriving = sent[WEIGHT] * math.exp(left - OPAQUE)
    if arriving >= least:
        return True
    if uniform(desk.stream) * least >= arriving:
        return False
    sent[WEIGHT] *= least / arriving
    return True


@kernel
def next_events(geometry, physics, detectors, rules, desk, photon, material, bin_, before, how):
    """Send a photon of matching weight towards every detector; `how` is the kind of emission, `before` the direction
    and energy before it.

    Returns the bits of the detectors that were served, or −1 if the stack is full.
    """
    covered, first = 0, desk.level[1]
    u, v, w, energy = before
    for detector in range(detectors.solid.size):
        du, dv, dw, density = aim(detectors, desk, photon, detector, rules.near)
        if density <= 0.0:
            continue
        covered |= 1 << detector
        cosine = min(max(u * du + v * dv + w * dw, -1.0), 1.0)
        scattered = photon[ENERGY]
        if how == DID_COMPTON:
            law, scattered = compton_density(physics, material, bin_, energy, cosine)
        elif how == DID_RAYLEIGH:
            law, scattered = rayleigh_density(physics, material, bin_, energy, cosine), energy
        else:
            law = 0.25 / math.pi
        if scattered < rules.cutoff:
            continue
        desk.level[1] += 1
        if desk.level[1] > PENDING:
            return -1
        sent = desk.pending[desk.level[1] - 1]
        copy_record(sent, photon)
        sent[U], sent[V], sent[W], sent[ENERGY] = du, dv, dw, scattered
        sent[WEIGHT] = photon[WEIGHT] * law / density
        sent[FREE] = detector
        if not worthwhile(geometry, physics, desk, sent, rules.least):
            desk.level[1] -= 1
    for i in range(first, desk.level[1]):
        desk.pending[i][COVERED] = covered
    return covered


@kernel
def serve(geometry, physics, detectors, rules, desk, photon, material, solid, bin_, before, how):
    """Next-event estimates after an emission in target, shield or air, and note on the photon which detectors they cover."""
    photon[COVERED] = 0.0
    photon[FREE] = -1.0
    if rules.reduce is None or int(photon[MARKS]) & MET_DETECTOR:
        return True
    if geometry.role[solid] in (TARGET, SHIELD) or solid == 0:
        covered = next_events(geometry, physics, detectors, rules, desk, photon, material, bin_, before, how)
        photon[COVERED] = max(covered, 0)
        return covered >= 0
    return True
