"""Photons set out."""

from __future__ import annotations

import math

from ._jit import kernel
from .arrays import COVERED, ENERGY, FORCED, FREE, HOME, MARKS, MATERIAL, WEIGHT, U, V, W, X, Y, Z
from .rng import disk, uniform


@kernel
def source_energy(source, place, stream):
    """The photon energy of the spectrum at a place in [0, 1): one look into Walker's table."""
    energy = source.energy[0]
    if source.energy.size > 1:
        place *= source.energy.size
        index = int(place)
        if place - index >= source.keep[index]:
            index = source.alias[index]
        energy = source.energy[index]
    if source.width > 0.0:
        energy += (uniform(stream) - 0.5) * source.width
    return energy


@kernel
def blank(photon):
    """Make a record that of a photon that has met nothing yet."""
    photon[WEIGHT] = 1.0
    photon[MARKS] = 0.0
    photon[COVERED] = 0.0
    photon[HOME] = 0.0
    photon[FREE] = -1.0
    photon[FORCED] = 0.0
    photon[MATERIAL] = -1.0


@kernel
def set_direction(photon, axis, a, b, c):
    """Direction (a, b, c) in the frame of the source."""
    photon[U] = a * axis[0, 0] + b * axis[1, 0] + c * axis[2, 0]
    photon[V] = a * axis[0, 1] + b * axis[1, 1] + c * axis[2, 1]
    photon[W] = a * axis[0, 2] + b * axis[1, 2] + c * axis[2, 2]


@kernel
def start_in_spot(photon, source, stream):
    """A place in the focal spot, uniform over its rectangle."""
    photon[X], photon[Y], photon[Z] = source.position[0], source.position[1], source.position[2]
    if source.spot[0] > 0.0 or source.spot[1] > 0.0:
        a = (uniform(stream) - 0.5) * source.spot[0]
        b = (uniform(stream) - 0.5) * source.spot[1]
        for i in range(3):
            photon[X + i] += a * source.axis[0, i] + b * source.axis[1, i]


@kernel
def emit(photon, source, stream):
    """One photon of the source: direction uniform in solid angle within the cone (Lambert's equal-area map of a disk)."""
    blank(photon)
    start_in_spot(photon, source, stream)
    if source.cosine < 1.0:
        a, b = disk(stream)
        radius = math.sqrt(2.0 * (1.0 - source.cosine))
        a, b = a * radius, b * radius
        squared = a * a + b * b
        scale = math.sqrt(1.0 - 0.25 * squared)
        set_direction(photon, source.axis, a * scale, b * scale, 1.0 - 0.5 * squared)
    else:
        photon[U], photon[V], photon[W] = source.axis[2, 0], source.axis[2, 1], source.axis[2, 2]
    photon[ENERGY] = source_energy(source, uniform(stream) if source.energy.size > 1 else 0.0, stream)
