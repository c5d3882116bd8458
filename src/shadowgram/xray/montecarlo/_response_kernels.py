"""What one cell of the mask gives at the detectors: the linear route to a scan.

A photon of a small focal spot that crosses a plate of holes meets the cell where it enters and at most its neighbour
across, its neighbour along and the one diagonal to it. With T the transmittance of those cells (0 or 1) and e = exp(−μ
· length) what a closed one lets through, it passes with the probability Π (e + (1 − e) T), a polynomial with one term
for each set of cells. The kernel follows the photon behind the mask and adds what it gives at the detectors, times each
coefficient, to the term of its set, so that any code can be put in afterwards.
"""

from __future__ import annotations

import math

from ._history_kernels import history
from ._jit import SOURCES, entry, kernel
from ._physics_kernels import energy_bin, looked_up
from ._solid_kernels import solid_box_interval
from ._source_kernels import blank, source_energy, start_in_spot
from .arrays import ENERGY, FROM_TARGET, TOTAL, WEIGHT, U, V, W, X, Y, Z
from .rng import begin, uniform

SETS = 16
"""Bits of a set of cells: 1 the cell of entry, 2 its neighbour across (x), 4 its neighbour along (y), 8 the diagonal one."""
SIDES = 4
"""On which side the neighbours are: bit 1 for the next column, bit 2 for the next row, else the one before."""
GOLDEN = 0.6180339887498949
GROUPS = 2
"""Counts of photons that met the target (0), and of those that met air or anything else (1)."""


@kernel
def aim_at_cell(geometry, source, solid, row, column, turn, photon, stream):
    """Send a photon through a uniform point of a cell's entry face; its weight is the share of the source's photons that go there.

    The energies of the photons of one cell, numbered by `turn`, are spread evenly over the spectrum (Weyl's sequence of
    the golden ratio, shifted from cell to cell), which takes their share of the variance away.
    """
    masks, mask = geometry.masks, geometry.body[solid]
    blank(photon)
    start_in_spot(photon, source, stream)
    step_x, step_y = masks.step[mask, 0], masks.step[mask, 1]
    x = masks.corner[mask, 0] + (column + uniform(stream)) * step_x - photon[X]
    y = masks.corner[mask, 1] + (row + uniform(stream)) * step_y - photon[Y]
    z = geometry.box[solid, 2 if photon[Z] < geometry.box[solid, 2] else 5] - photon[Z]
    distance = math.sqrt(x * x + y * y + z * z)
    photon[U], photon[V], photon[W] = x / distance, y / distance, z / distance
    axis = source.axis[2]
    if photon[U] * axis[0] + photon[V] * axis[1] + photon[W] * axis[2] < source.cosine:
        return False
    photon[WEIGHT] = abs(step_x * step_y * photon[W]) / (distance * distance * 2.0 * math.pi * (1.0 - source.cosine))
    place = turn * GOLDEN + row * 0.7548776662466927 + column * 0.5698402909980532
    photon[ENERGY] = source_energy(source, place - math.floor(place), stream)
    return True


@kernel
def lengths_in_cells(geometry, solid, row, column, photon, lengths):
    """Lengths of a photon's path through the plate in the four cells of a term; (side, whether it stays within them)."""
    masks, mask = geometry.masks, geometry.body[solid]
    near, far = solid_box_interval(geometry, solid, photon)
    a = (photon[X] + near * photon[U] - masks.corner[mask, 0]) / masks.step[mask, 0] - column
    b = (photon[Y] + near * photon[V] - masks.corner[mask, 1]) / masks.step[mask, 1] - row
    du, dv = photon[U] / masks.step[mask, 0], photon[V] / masks.step[mask, 1]
    across = near + ((1.0 - a) / du if du > 0.0 else (-a / du if du < 0.0 else math.inf))
    along = near + ((1.0 - b) / dv if dv > 0.0 else (-b / dv if dv < 0.0 else math.inf))
    first, second = min(across, along), max(across, along)
    first, second = min(max(first, near), far), min(max(second, near), far)
    lengths[0] = first - near
    lengths[1] = second - first if across < along else 0.0
    lengths[2] = second - first if along <= across else 0.0
    lengths[3] = far - second
    inside = abs(du) * (far - near) < 1.0 and abs(dv) * (far - near) < 1.0
    return (1 if du > 0.0 else 0) + (2 if dv > 0.0 else 0), inside


@kernel
def coefficients(lengths, attenuation, terms):
    """Coefficients of Π (e + (1 − e) T) over the cells that are crossed, by set of cells."""
    for subset in range(SETS):
        value = 1.0
        for cell in range(4):
            held = lengths[cell] * attenuation
            if (subset >> cell) & 1:
                value *= -math.expm1(-held)
            else:
                value *= math.exp(-held)
        terms[subset] = value


@kernel
def behind_mask(geometry, physics, solid, photon):
    """Put a photon 1 nm behind the plate, its weight less what the air before the plate takes."""
    near, far = solid_box_interval(geometry, solid, photon)
    air = looked_up(physics, geometry.material[0], energy_bin(photon[ENERGY]), photon[ENERGY], TOTAL)
    photon[WEIGHT] *= math.exp(-air * near)
    for i in range(3):
        photon[X + i] += (far + 1e-6) * photon[U + i]


def _response_batch(sources):
    @entry
    def response_batch(
        geometry, physics, source, detectors, rules, desk, tally, solid, cells, seed, first, last, response, work
    ):
        """Histories `first` to `last` − 1, which go through `cells` in turn.

        `response` (group, side, set, row, column) is added to, with columns counted from the first that `cells` may
        name; `work` is 20 long. Returns the number of a history whose photons found no room or that crossed too many
        cells, or −1.
        """
        lengths, terms = work[:4], work[4:]
        photon = desk.photon
        for number in range(first, last if sources else first):
            place = number % cells.shape[0]
            row, column, slot = cells[place, 0], cells[place, 1], cells[place, 2]
            turn = number // cells.shape[0] * cells[place, 4] + cells[place, 3]
            begin(desk.stream, seed, number)
            if not aim_at_cell(geometry, source, solid, row, column, turn, photon, desk.stream):
                continue
            side, inside = lengths_in_cells(geometry, solid, row, column, photon, lengths)
            if not inside:
                return number
            bin_ = energy_bin(photon[ENERGY])
            opaque = looked_up(physics, geometry.material[solid], bin_, photon[ENERGY], TOTAL)
            coefficients(lengths, opaque, terms)
            behind_mask(geometry, physics, solid, photon)
            weight = photon[WEIGHT]
            photon[WEIGHT] = 1.0
            for detector in range(tally.counts.shape[0]):
                for order in range(tally.counts.shape[1]):
                    tally.counts[detector, order] = 0.0
            if not history(geometry, physics, source, detectors, rules, desk, tally):
                return number
            for group in range(GROUPS):
                score = 0.0
                for detector in range(tally.counts.shape[0]):
                    for order in range(FROM_TARGET * group, FROM_TARGET if group == 0 else tally.counts.shape[1]):
                        score += tally.counts[detector, order]
                if score != 0.0:
                    for subset in range(SETS):
                        response[group, side, subset, row, slot] += weight * score * terms[subset]
        return -1

    return response_batch


response_batch = _response_batch(SOURCES)
