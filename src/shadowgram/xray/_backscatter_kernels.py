"""Single scattering along rays through a scene, by quadrature: every way there and back is flown once for all energies.

The flights are those of the transport, `shadowgram.xray.montecarlo`, without its random numbers.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .montecarlo._jit import SOURCES, entry, kernel
from .montecarlo._physics_kernels import compton_density, energy_bin, looked_up
from .montecarlo._solid_kernels import box_interval, inverse
from .montecarlo._walk_kernels import collect, cross, piece
from .montecarlo.arrays import ELECTRON_MASS, HOME, PHOTOELECTRIC, RAYLEIGH, TARGET, TOTAL, U, V, W, X, Y, Z

DEPTHS = 6.0
"""Mean free paths, at the highest energy, beyond which a piece of the target is not looked into: e⁻¹² comes back."""
FAINT = 1e-9
"""Share of the photons of an energy that is not followed further."""
WAY = 64
"""Pieces on a way: as many as are noted."""


class Work(NamedTuple):
    """Scratch arrays of one thread.

    Attributes
    ----------
    materials, lengths : (WAY) pieces of a way.
    kinds : (piece, 2) material and solid of pieces of target.
    left : (energy) photons that scatter at a place, per mm.
    place : (3) of a scattering.
    """

    materials: NDArray[np.int64]
    lengths: NDArray[np.float64]
    kinds: NDArray[np.int64]
    left: NDArray[np.float64]
    place: NDArray[np.float64]


def fresh_work(pieces: int, energies: int) -> Work:
    """Scratch arrays for so many pieces of target on a ray, and energies."""
    return Work(
        materials=np.zeros(WAY, np.int64),
        lengths=np.zeros(WAY),
        kinds=np.zeros((pieces, 2), np.int64),
        left=np.zeros(energies),
        place=np.zeros(3),
    )


@kernel
def way_to(geometry, desk, photon, length, materials, lengths):
    """Note material and length of the pieces on a photon's way; (how many, −1 if there are too many)."""
    count, end = collect(geometry, desk, photon, 0)
    t, noted = 0.0, 0
    while True:
        _, material, stop, which = piece(geometry, desk, photon, count, end, t)
        if stop > t:
            if noted == WAY:
                return -1
            materials[noted], lengths[noted] = material, min(stop, length) - t
            noted += 1
        if stop >= length or which == -1:
            return noted
        if which >= 0:
            cross(geometry, desk, photon, which, stop)
        t = stop


@kernel
def target_on(geometry, physics, desk, photon, highest, spans, kinds):
    """Note the pieces of target along a ray, and the way before each: (how many, −1 if there are too many).

    `spans` (piece, 2): where it starts, and how far it is looked into. `kinds` (piece, 2): its material and solid.
    """
    count, end = collect(geometry, desk, photon, 0)
    t, found, depth = 0.0, 0, 0.0
    bin_ = energy_bin(highest)
    while True:
        solid, material, stop, which = piece(geometry, desk, photon, count, end, t)
        attenuation = looked_up(physics, material, bin_, highest, TOTAL)
        if geometry.role[solid] == TARGET and stop > t:
            if found == spans.shape[0]:
                return -1
            spans[found, 0], spans[found, 1] = t, min(stop - t, DEPTHS / attenuation)
            kinds[found, 0], kinds[found, 1] = material, solid
            found += 1
        depth += attenuation * (stop - t)
        if which == -1 or depth > 2.0 * DEPTHS:
            return found
        if which >= 0:
            cross(geometry, desk, photon, which, stop)
        t = stop


@kernel
def arriving(physics, materials, lengths, noted, energy):
    """Share of the photons of an energy that are not touched on a way."""
    bin_ = energy_bin(energy)
    depth = 0.0
    for i in range(noted):
        depth += looked_up(physics, materials[i], bin_, energy, TOTAL) * lengths[i]
    return math.exp(-depth)


@kernel
def compton_attenuation(physics, material, energy):
    """1/mm."""
    bin_ = energy_bin(energy)
    total = looked_up(physics, material, bin_, energy, TOTAL)
    others = looked_up(physics, material, bin_, energy, PHOTOELECTRIC) + looked_up(
        physics, material, bin_, energy, RAYLEIGH
    )
    return total - others


@kernel
def start_at(photon, position, direction, home):
    """Put a photon at a place, in a direction, inside a solid."""
    for i in range(3):
        photon[X + i], photon[U + i] = position[i], direction[i]
    photon[HOME] = home


@kernel
def absorbed_in(physics, material, length, energy):
    """Probability of a pulse on a way through a crystal: an interaction that is not Rayleigh scattering."""
    bin_ = energy_bin(energy)
    total = looked_up(physics, material, bin_, energy, TOTAL)
    return -math.expm1((looked_up(physics, material, bin_, energy, RAYLEIGH) - total) * length)


@kernel
def face_node(geometry, detectors, detector, node, photon, place):
    """Turn a photon at a place to a node on a detector's face: (distance, solid angle, way through the crystal), or a distance of 0
    where it sees the face from behind.

    `node`: x, y, z, axis of the face, its side (1 or −1), area in mm².
    """
    du, dv, dw = node[0] - place[0], node[1] - place[1], node[2] - place[2]
    axis = int(node[3])
    across = -node[4] * (du if axis == 0 else (dv if axis == 1 else dw))
    if across <= 0.0:
        return 0.0, 0.0, 0.0
    distance = math.sqrt(du * du + dv * dv + dw * dw)
    photon[X], photon[Y], photon[Z] = place[0], place[1], place[2]
    photon[U], photon[V], photon[W] = du / distance, dv / distance, dw / distance
    iu, iv, iw = inverse(photon[U]), inverse(photon[V]), inverse(photon[W])
    near, far = box_interval(geometry.box[detectors.solid[detector]], place[0], place[1], place[2], iu, iv, iw)
    return distance, node[5] * across / distance**3, max(far - near, 0.0)


@kernel
def let_through(geometry, physics, desk, photon, energies, weights, length, material, work):
    """Fill `work.left`, what of each energy scatters at the end of a way, per mm; false for too many pieces."""
    noted = way_to(geometry, desk, photon, length, work.materials, work.lengths)
    for e in range(energies.size):
        there = arriving(physics, work.materials, work.lengths, noted, energies[e])
        work.left[e] = 0.0
        if there > FAINT:
            work.left[e] = weights[e] * there * compton_attenuation(physics, material, energies[e])
    return noted >= 0


@kernel
def scattered_to(geometry, physics, desk, energies, ray, material, crystal, lowest, angle, distance, through, work):
    """Counts of what `let_through` left, scattered into a solid angle and flown to a crystal; −1 for too many pieces."""
    photon = desk.photon
    noted = way_to(geometry, desk, photon, distance, work.materials, work.lengths)
    if noted < 0:
        return -1.0
    cosine = photon[U] * ray[0] + photon[V] * ray[1] + photon[W] * ray[2]
    score = 0.0
    for e in range(energies.size):
        energy = energies[e]
        if work.left[e] == 0.0 or energy < lowest * (1.0 + energy / ELECTRON_MASS * (1.0 - cosine)):
            continue
        law, scattered = compton_density(physics, material, energy_bin(energy), energy, cosine)
        back = arriving(physics, work.materials, work.lengths, noted, scattered)
        score += work.left[e] * law * back * absorbed_in(physics, crystal, through, scattered)
    return score * angle


@kernel
def scattered_from(geometry, physics, detectors, desk, energies, ray, material, solid, lowest, nodes, work):
    """Counts in all detectors of what `let_through` left, scattered at `work.place`; −1 for too many pieces."""
    total = 0.0
    for detector in range(detectors.solid.size):
        crystal = geometry.material[detectors.solid[detector]]
        for n in range(nodes.shape[1]):
            node = nodes[detector, n]
            distance, angle, through = face_node(geometry, detectors, detector, node, desk.photon, work.place)
            if angle > 0.0:
                desk.photon[HOME] = solid
                score = scattered_to(
                    geometry,
                    physics,
                    desk,
                    energies,
                    ray,
                    material,
                    crystal,
                    lowest[detector],
                    angle,
                    distance,
                    through,
                    work,
                )
                if score < 0.0:
                    return -1.0
                total += score * detectors.efficiency[detector]
    return total


def _single_scatter_rays(sources):
    @entry
    def single_scatter_rays(
        start,
        stop,
        geometry,
        physics,
        detectors,
        desk,
        position,
        rays,
        energies,
        weights,
        lowest,
        depths,
        nodes,
        work,
        spans,
        found,
    ):
        """Counts of single scattering, per photon of a ray and mm of its way, at nodes of its pieces of target.

        `rays` (ray, 3) directions; `energies`, `weights` (energy) of the source, which add up to 1; `depths` (node) where to look
        in a piece, as shares of how far it is looked into; `nodes` (detector, node, 6) as of `face_node`; `lowest` (detector) keV
        that are counted. Filled: `spans` (ray, piece, 2) as of `target_on`, `found` (ray, piece, node). Returns a ray that meets
        too many pieces, or −1.
        """
        photon, highest = desk.photon, energies[energies.size - 1]
        for number in range(start, stop if sources else start):
            ray = rays[number]
            start_at(photon, position, ray, 0.0)
            pieces = target_on(geometry, physics, desk, photon, highest, spans[number], work.kinds)
            for k in range(pieces):
                material, solid = work.kinds[k, 0], work.kinds[k, 1]
                for depth in range(depths.size):
                    length = spans[number, k, 0] + depths[depth] * spans[number, k, 1]
                    start_at(photon, position, ray, 0.0)
                    if not let_through(geometry, physics, desk, photon, energies, weights, length, material, work):
                        return number
                    for i in range(3):
                        work.place[i] = position[i] + length * ray[i]
                    score = scattered_from(
                        geometry, physics, detectors, desk, energies, ray, material, solid, lowest, nodes, work
                    )
                    if score < 0.0:
                        return number
                    found[number, k, depth] = score
            if pieces < 0:
                return number
        return -1

    return single_scatter_rays


single_scatter_rays = _single_scatter_rays(SOURCES)
