"""A photon's record: what it did, how it is put aside, and where it leaves its energy."""

from __future__ import annotations

from ._jit import kernel
from .arrays import (
    AIR,
    COHERENT,
    DETECTOR,
    DIRECT,
    ELSEWHERE,
    ENVIRONMENT,
    FLUORESCENT,
    LEAKY,
    MARKS,
    MULTIPLE,
    RECORD,
    SHIELD,
    SHIELDED,
    SINGLE,
    TARGET,
    WEIGHT,
    X,
    Y,
    Z,
)
from .rng import uniform

# Marks of what a photon did, in its record.
DID_COMPTON, DID_MORE, DID_RAYLEIGH, DID_FLUORESCE, MET_AIR, MET_ELSE, LEAKED, MET_SHIELD = (
    1, 2, 4, 8, 16, 32, 64, 128,
)  # fmt: skip
MET_DETECTOR = 256
"""From here on all is analog: what comes of the photon belongs to a pulse, which has one weight."""


@kernel
def order_of(marks):
    """The column of the counts to which a photon with these marks belongs."""
    if marks & MET_SHIELD:
        return SHIELDED
    if marks & LEAKED:
        return LEAKY
    if marks & MET_ELSE:
        return ELSEWHERE
    if marks & MET_AIR:
        return AIR
    if marks & DID_FLUORESCE:
        return FLUORESCENT
    if marks & DID_RAYLEIGH:
        return COHERENT
    if marks & DID_MORE:
        return MULTIPLE
    return SINGLE if marks & DID_COMPTON else DIRECT


@kernel
def mark(photon, geometry, solid, what):
    """Add to the marks that a photon collided in a solid; `what` says how, and counts in the target alone."""
    marks, role = int(photon[MARKS]), geometry.role[solid]
    if role == TARGET:
        marks |= DID_MORE if what == DID_COMPTON and marks & DID_COMPTON else what
    elif role == SHIELD:
        marks |= MET_SHIELD
    elif role == ENVIRONMENT:
        marks |= MET_AIR if solid == 0 else MET_ELSE
    elif role == DETECTOR:
        marks |= MET_DETECTOR
    photon[MARKS] = marks


@kernel
def copy_record(there, here):
    """Copy a photon's record; slices would allocate."""
    for i in range(RECORD):
        there[i] = here[i]


@kernel
def stack(records, level, which, photon):
    """Put a copy of a photon on a stack; false if it is full."""
    place = level[which]
    if place == records.shape[0]:
        return False
    copy_record(records[place], photon)
    level[which] = place + 1
    return True


@kernel
def survives(photon, stream, least):
    """Russian roulette below a weight of `least`."""
    if photon[WEIGHT] >= least:
        return True
    if uniform(stream) * least >= photon[WEIGHT]:
        return False
    photon[WEIGHT] = least
    return True


@kernel
def deposit(desk, geometry, tally, photon, solid, energy):
    """Leave energy in a solid, and in the pulse if it is a detector."""
    tally.deposited[solid] += photon[WEIGHT] * energy
    detector = geometry.detector[solid]
    if detector >= 0:
        pulse = desk.pulse[detector]
        if pulse[0] == 0.0:
            pulse[1] = photon[WEIGHT]
            pulse[2] = order_of(int(photon[MARKS]))
            pulse[3], pulse[4], pulse[5] = photon[X], photon[Y], photon[Z]
        pulse[0] += energy
