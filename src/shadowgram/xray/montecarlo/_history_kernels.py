"""One history from the source to its last photon, analog or with variance reduction.

Variance reduction splits what can happen next and follows every part once, so nothing is biased:

- *forced collisions*: the first flight is split into "first collision in the target", "first collision in the air"
  (each followed with that probability as weight) and everything else (followed as usual, and given up if it collides
  first in either);
- *next-event estimates*: every direction after a collision is split into "reaches detector d without another
  collision" (sent there, with the probability as weight) and everything else (followed as usual, and given up where it
  would enter d). In the detector all is analog;
- *capture by weight* in materials without fluorescence, and *Russian roulette* for small weights.

A *shower* is what shares one pulse: photons of one weight whose energy in a detector adds up. One thing is left out of
that: with variance reduction a K and an L photon of one absorption in the target are showers of their own, so that
where both are above the cut-off and reach one detector, two pulses stand for the one of their sum.
"""

from __future__ import annotations

import math

from ._estimate_kernels import serve
from ._jit import SOURCES, entry, kernel
from ._physics_kernels import compton, emitted_line, emptied_shell, energy_bin, isotropic, looked_up, rayleigh, turned
from ._record_kernels import (
    DID_COMPTON,
    DID_FLUORESCE,
    DID_RAYLEIGH,
    LEAKED,
    MET_DETECTOR,
    copy_record,
    deposit,
    mark,
    order_of,
    stack,
    survives,
)
from ._source_kernels import emit
from ._walk_kernels import ESCAPED, STOPPED, fly, pieces_ahead, place_in_pieces
from .arrays import (
    DETECTOR,
    ENERGY,
    FORCED,
    FREE,
    HOME,
    MARKS,
    MATERIAL,
    PHOTOELECTRIC,
    RAYLEIGH,
    TARGET,
    TOTAL,
    WEIGHT,
    U,
    V,
    W,
    X,
)
from .rng import exponential, normal, start_of, uniform


@kernel
def choose(geometry, physics, rules, desk, tally, photon, material, solid, bin_):
    """What a collision is: `DID_COMPTON`, `DID_RAYLEIGH`, `DID_FLUORESCE` for an absorption, or 0 if the photon is given up.

    With variance reduction, materials without fluorescence absorb a share of the weight and scatter the rest.
    """
    energy = photon[ENERGY]
    total = looked_up(physics, material, bin_, energy, TOTAL)
    absorbed = looked_up(physics, material, bin_, energy, PHOTOELECTRIC)
    draw = uniform(desk.stream) * total
    dark = physics.shell_start[material] == physics.shell_start[material + 1]
    split = rules.reduce is not None and geometry.role[solid] != DETECTOR and not int(photon[MARKS]) & MET_DETECTOR
    if split and dark:
        share = absorbed / total
        tally.deposited[solid] += photon[WEIGHT] * share * energy
        photon[WEIGHT] *= 1.0 - share
        if not survives(photon, desk.stream, rules.least):
            return 0
        draw = absorbed + (1.0 - share) * draw
    if draw < absorbed:
        return DID_FLUORESCE
    return DID_RAYLEIGH if draw < absorbed + looked_up(physics, material, bin_, energy, RAYLEIGH) else DID_COMPTON


@kernel
def next_line(physics, rules, desk, shell, left):
    """The line that an emptied shell emits, or −1 if none that counts comes any more, and the shell that it leaves empty."""
    while shell >= 0:
        line = emitted_line(physics, desk.stream, shell)
        if line < 0:
            break
        shell = physics.line_next[line]
        if rules.cutoff < physics.line_energy[line] <= left:
            return line, shell
    return -1, -1


@kernel
def redirect(physics, desk, photon, material, how, u, v, w):
    """Give a photon that flew along (u, v, w) its direction, and after Compton scattering its energy."""
    if how == DID_FLUORESCE:
        photon[U], photon[V], photon[W] = isotropic(desk.stream)
    elif how == DID_RAYLEIGH:
        cosine = rayleigh(physics, material, desk.stream, photon[ENERGY])
        photon[U], photon[V], photon[W] = turned(u, v, w, cosine, desk.stream)
    else:
        cosine, photon[ENERGY] = compton(physics, material, desk.stream, photon[ENERGY])
        photon[U], photon[V], photon[W] = turned(u, v, w, cosine, desk.stream)


@kernel
def interact(geometry, physics, detectors, rules, desk, tally, photon, material, solid, bin_):
    """One collision: (whether the photon goes on, whether there was room for what it made).

    What leaves the atom is the scattered photon, or after an absorption its fluorescence, line by line, which goes on the
    stack of the shower. Each leaves with its next-event estimates made; the energy that is left stays where it is.
    """
    how = choose(geometry, physics, rules, desk, tally, photon, material, solid, bin_)
    if how == 0:
        return False, True
    u, v, w, energy, marks = photon[U], photon[V], photon[W], photon[ENERGY], photon[MARKS]
    shell = emptied_shell(physics, material, bin_, uniform(desk.stream)) if how == DID_FLUORESCE else -1
    left, room = energy, True
    photon[HOME] = solid
    while True:
        if how == DID_FLUORESCE:
            line, shell = next_line(physics, rules, desk, shell, left)
            if line < 0:
                break
            photon[ENERGY] = physics.line_energy[line]
        mark(photon, geometry, solid, how)
        before = (u, v, w, energy)
        room = serve(geometry, physics, detectors, rules, desk, photon, material, solid, bin_, before, how)
        redirect(physics, desk, photon, material, how, u, v, w)
        left -= photon[ENERGY]
        if how != DID_FLUORESCE:
            break
        room = room and stack(desk.shower, desk.level, 0, photon)
        photon[MARKS] = marks
        if not room:
            return False, False
    if left > 0.0:
        deposit(desk, geometry, tally, photon, solid, left)
    return how != DID_FLUORESCE, room


@kernel
def escape(source, rules, tally, photon):
    """Count a photon that leaves the world."""
    axis = source.axis
    cosine = photon[U] * axis[2, 0] + photon[V] * axis[2, 1] + photon[W] * axis[2, 2]
    bins = tally.escaped.size
    tally.escaped[min(int(0.5 * (cosine + 1.0) * bins), bins - 1)] += photon[WEIGHT]
    energy = min(int(photon[ENERGY] / rules.bin_width), tally.escaped_spectrum.shape[1] - 1)
    tally.escaped_spectrum[1 if cosine >= 0.0 else 0, energy] += photon[WEIGHT]
    tally.balance[1] += photon[WEIGHT] * photon[ENERGY]


@kernel
def note_phase(desk, photon):
    """Write down a photon where it enters a detector, or only count it where the record is full."""
    row = desk.level[2]
    desk.level[2] = row + 1
    if row < desk.phase.shape[0]:
        there = desk.phase[row]
        for i in range(3):
            there[i] = photon[X + i] + desk.entry[0] * photon[U + i]
            there[3 + i] = photon[U + i]
        there[6], there[7], there[8] = photon[ENERGY], photon[WEIGHT], order_of(int(photon[MARKS]))
        there[9] = desk.entry[1]


@kernel
def advance(geometry, physics, source, detectors, rules, desk, tally, photon, bin_):
    """Fly a photon to its next collision and leave solid and material there in `HOME` and `MATERIAL`; false if it is done with."""
    was_free = rules.reduce is not None and photon[FREE] >= 0.0
    status, t, material, solid, depth, shielded = fly(
        geometry, physics, detectors, rules, desk, photon, bin_, exponential(desk.stream)
    )
    if shielded:
        photon[MARKS] = int(photon[MARKS]) | LEAKED
    if was_free:
        photon[WEIGHT] *= math.exp(-depth)
        photon[FREE] = -1.0
        if not survives(photon, desk.stream, rules.least):
            return False
    if desk.phase.shape[0] > 0 and 0.0 <= desk.entry[0] < math.inf:
        note_phase(desk, photon)
    if status == ESCAPED:
        escape(source, rules, tally, photon)
        return False
    # What a forced flight was split into is followed on its own.
    if rules.reduce is not None:
        if status == STOPPED or ((solid == 0 or geometry.role[solid] == TARGET) and t < photon[FORCED]):
            return False
        photon[FORCED] = 0.0
    for i in range(3):
        photon[X + i] += t * photon[U + i]
    photon[HOME], photon[MATERIAL] = solid, material
    return True


@kernel
def follow(geometry, physics, source, detectors, rules, desk, tally, photon):
    """Follow one photon until it is absorbed, leaves or is given up; false if a stack was full."""
    while True:
        bin_ = energy_bin(photon[ENERGY])
        # A forced photon begins where it collides.
        if photon[MATERIAL] < 0.0 and not advance(
            geometry, physics, source, detectors, rules, desk, tally, photon, bin_
        ):
            return True
        solid, material = int(photon[HOME]), int(photon[MATERIAL])
        photon[MATERIAL] = -1.0
        alive, room = interact(geometry, physics, detectors, rules, desk, tally, photon, material, solid, bin_)
        if not room:
            return False
        if not alive:
            return True
        if photon[ENERGY] < rules.cutoff:
            deposit(desk, geometry, tally, photon, solid, photon[ENERGY])
            return True


@kernel
def read_out(geometry, detectors, rules, desk, tally):
    """Turn the energy of a shower into pulses, blur, threshold and count them."""
    for detector in range(detectors.solid.size):
        pulse = desk.pulse[detector]
        energy = pulse[0]
        if energy <= 0.0:
            continue
        pulse[0] = 0.0
        if detectors.blur[detector] > 0.0:
            energy += detectors.blur[detector] * math.sqrt(energy) * normal(desk.stream)
        if energy < detectors.threshold[detector]:
            continue
        if detectors.efficiency[detector] < 1.0 and uniform(desk.stream) >= detectors.efficiency[detector]:
            continue
        weight = pulse[1]
        tally.counts[detector, int(pulse[2])] += weight
        tally.spectrum[detector, min(int(energy / rules.bin_width), tally.spectrum.shape[1] - 1)] += weight
        box = geometry.box[detectors.solid[detector]]
        rows, columns = detectors.pixels[detector, 0], detectors.pixels[detector, 1]
        row = min(max(int((pulse[4] - box[1]) / (box[4] - box[1]) * rows), 0), rows - 1)
        column = min(max(int((pulse[3] - box[0]) / (box[3] - box[0]) * columns), 0), columns - 1)
        tally.image[detectors.start[detector] + row * columns + column] += weight


@kernel
def force(geometry, physics, rules, desk, photon):
    """Split off "first collision in the target" and "in the air" from a photon's first flight; false if a stack was full.

    Both are put on the stack of pending photons where they collide. What is left on the desk is the photon itself, with
    `FORCED` telling how far such a first collision has been taken care of.
    """
    pieces, looked = pieces_ahead(geometry, physics, desk, photon, energy_bin(photon[ENERGY]))
    weight, room = photon[WEIGHT], True
    for air in range(2):
        photon[WEIGHT] = weight * desk.chance[air]
        if photon[WEIGHT] > 0.0 and survives(photon, desk.stream, rules.least_air if air == 1 else rules.least):
            t, chosen = place_in_pieces(desk, pieces, air == 1)
            room = room and stack(desk.pending, desk.level, 1, photon)
            put = desk.pending[desk.level[1] - 1]
            for i in range(3):
                put[X + i] += t * photon[U + i]
            put[HOME], put[MATERIAL] = desk.segment_solid[chosen, 0], desk.segment_solid[chosen, 1]
            put[MARKS] = LEAKED if desk.segment_solid[chosen, 2] == 1 else 0.0
    photon[WEIGHT], photon[FORCED] = weight, looked
    return room


@kernel
def history(geometry, physics, source, detectors, rules, desk, tally):
    """Follow the source photon on the desk and everything that comes of it; false if a stack was full.

    Photons of the shower come before pending ones, and the pulse is read out between two showers.
    """
    photon, level = desk.photon, desk.level
    tally.balance[0] += photon[WEIGHT] * photon[ENERGY]
    level[0], level[1] = 0, 0
    room = rules.reduce is None or force(geometry, physics, rules, desk, photon)
    while room:
        room = follow(geometry, physics, source, detectors, rules, desk, tally, photon)
        if level[0] > 0:
            level[0] -= 1
            copy_record(photon, desk.shower[level[0]])
            continue
        read_out(geometry, detectors, rules, desk, tally)
        if level[1] == 0:
            break
        level[1] -= 1
        copy_record(photon, desk.pending[level[1]])
    return room


def _batch(sources):
    @entry
    def batch(geometry, physics, source, detectors, rules, desk, tally, seed, first, last):
        """Histories `first` to `last` − 1; the number of the one whose photons found no room, or −1."""
        # Found one history ahead, since nothing can begin before the first number is there.
        start, step = start_of(seed, first)
        for number in range(first, last if sources else first):
            desk.stream[0], desk.stream[1] = start, step
            start, step = start_of(seed, number + 1)
            emit(desk.photon, source, desk.stream)
            if not history(geometry, physics, source, detectors, rules, desk, tally):
                return number
        return -1

    return batch


batch = _batch(SOURCES)
