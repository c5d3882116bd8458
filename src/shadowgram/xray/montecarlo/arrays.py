"""What the transport kernels work on: plain arrays with names, made once per run and never changed by it.

Lengths are mm, energies keV, attenuation 1/mm, angles enter as cosines; `momentum` is x = E sin(θ/2) / hc in 1/Å. numba
takes a NamedTuple as it is, so the kernels read ``physics.attenuation`` as any other code would.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LOWEST_ENERGY = 1.0
"""keV at the left edge of energy bin 0."""
HIGHEST_ENERGY = 512.0
"""keV at the right edge of the last energy bin; nine octaves above the lowest."""
BINS_PER_OCTAVE_BITS = 7
"""log₂ of the energy bins per octave: a bin is the exponent and the first 7 bits of the mantissa of a float64."""
ENERGY_BINS = 9 << BINS_PER_OCTAVE_BITS
LOWEST_MOMENTUM = 2.0**-8
"""1/Å at the left edge of momentum bin 0; the scattering function is taken as ∝ x² below it."""
MOMENTUM_BINS_PER_OCTAVE_BITS = 4
MOMENTUM_BINS = 14 << MOMENTUM_BINS_PER_OCTAVE_BITS
"""Up to 64 1/Å, beyond what 512 keV can transfer."""
GUIDE = 512
"""Steps of the guide to the cumulative form factor."""
HC = 12.398419843320026
"""keV·Å (CODATA 2018, exact)."""
ELECTRON_MASS = 510.99895
"""keV (CODATA 2018)."""

# Columns of Physics.attenuation: pairs (a, b), the value inside an energy bin being a + b·E.
TOTAL, PHOTOELECTRIC, RAYLEIGH, COMPTON_NORM, RAYLEIGH_NORM = 0, 2, 4, 6, 8

BOX, ELLIPSOID, CYLINDER, OUTLINE, MESH, VOXELS, MASK = range(7)
"""Values of Geometry.kind."""
ENVIRONMENT, TARGET, SHIELD, DETECTOR = range(4)
"""Values of Geometry.role; a coded mask is a shield too."""


class Physics(NamedTuple):
    """Interaction tables of the materials of a scene.

    Attributes
    ----------
    attenuation
        (material, energy bin, 10). Pairs (a, b) of a line a + b·E that meets the table at both edges of its bin: total
        (photoelectric + Compton + Rayleigh), photoelectric and Rayleigh attenuation in 1/mm, and the two norms ∫ KN(E,
        θ) S(x) / Z̄ dΩ in barn per electron and ∫ F²(x)/F²(0) (1 + cos²θ)/2 dΩ in sr, which turn the angular laws into
        probability densities. A bin with an absorption edge inside keeps its left line up to the edge's bin border.
    incoherent
        (material, momentum edge): S(x) of one average electron, Σ nᵢ Sᵢ(x) / Σ nᵢ Zᵢ, between 0 and 1, at the edges of
        the momentum bins; linear in x between them.
    coherent
        (material, momentum edge): cumulative ∫₀^{x²} F²(t)/F²(0) dt at the edges, F² = Σ nᵢ Fᵢ², starting with the part
        below edge 0. Inside a bin it is linear in x².
    coherent_guide
        (material, `GUIDE`): where `coherent` is k / `GUIDE` of its last value, the last edge before that.
    form_factor
        (material, momentum edge): F²(x)/F²(0), so that the density agrees with `coherent`: the mean over each bin is the difference
        of `coherent` over the difference of x². One value a bin, constant inside it; the last entry repeats.
    shell_start
        (material + 1): the shells of material m that can emit a photon above the cut-off are ``shell_start[m]:shell_start[m + 1]``.
    shell_cumulative
        (shell, energy bin): cumulative share, within the material, of photoelectric absorptions that empty this shell
        or an earlier one of it.
    shell_yield
        (shell): fluorescence yield.
    line_start
        (shell + 1): the emission lines of shell s are ``line_start[s]:line_start[s + 1]``.
    line_cumulative
        (line): cumulative probability within the shell, ending at 1.
    line_energy
        (line): keV.
    line_next
        (line): the shell that the emission leaves empty and that can emit above the cut-off itself, or -1.
    """

    attenuation: Floats
    incoherent: Floats
    coherent: Floats
    coherent_guide: NDArray[np.uint8]
    form_factor: Floats
    shell_start: Integers
    shell_cumulative: Floats
    shell_yield: Floats
    line_start: Integers
    line_cumulative: Floats
    line_energy: Floats
    line_next: Integers


class Outlines(NamedTuple):
    """Extruded polygons, one after another; in its solid's own frame the polygon lies in (x, y) and is extruded along z.

    Attributes
    ----------
    start
        (outline + 1): edges of outline i are ``start[i]:start[i + 1]``.
    edge
        (edge, 4): x0, y0, x1, y1 in mm, anticlockwise around the material (clockwise around a hole), so that (y1 − y0,
        x0 − x1) points out.
    """

    start: Integers
    edge: Floats


class Meshes(NamedTuple):
    """Closed triangle meshes with one bounding-volume tree each, in world coordinates.

    Attributes
    ----------
    root
        (mesh): the index of its tree's root in `node_box`.
    node_box
        (node, 6): lower x, y, z and upper x, y, z in mm.
    node_child
        (node, 2): for an inner node its two children; for a leaf (−1 − first, count), a range of `triangle`.
    triangle
        (triangle, 9): vertex 0, edge 1 and edge 2 in mm; edge 1 × edge 2 points out of the material.
    """

    root: Integers
    node_box: Floats
    node_child: Integers
    triangle: Floats


class Voxels(NamedTuple):
    """Voxel volumes, one after another; in its solid's own frame a volume begins at (0, 0, 0).

    Attributes
    ----------
    start
        (volume): where its cells begin in `material`.
    shape
        (volume, 3): cells along x, y, z.
    pitch
        (volume, 3): mm along x, y, z.
    material
        (cell): the material's index of cell ``start + (ix · ny + iy) · nz + iz``.
    majorant
        (volume, energy bin): an upper bound, 1/mm, of the total attenuation of its materials inside the bin.
    """

    start: Integers
    shape: Integers
    pitch: Floats
    material: NDArray[np.int16]
    majorant: Floats


class Masks(NamedTuple):
    """Coded masks: plates in (x, y), their thickness along z, with a block of square cells of which some are holes.

    Attributes
    ----------
    corner
        (mask, 2): x and y, in the world, of the outer corner of cell (row 0, column 0), mm.
    step
        (mask, 2): signed pitch, mm, by which x grows with the column and y with the row.
    shape
        (mask, 2): rows, columns.
    start
        (mask): where its cells begin in `open`.
    open
        (cell): 1 where there is a hole.
    filling
        (mask): the material of the holes.
    """

    corner: Floats
    step: Floats
    shape: Integers
    start: Integers
    open: NDArray[np.uint8]
    filling: Integers


class Geometry(NamedTuple):
    """The solids of a scene; where solids overlap the later one counts.

    Attributes
    ----------
    world
        (2, 3): lower and upper corner of the box outside which nothing is followed, mm.
    kind, material, role
        (solid): one of `BOX` … `MASK`, an index into `Physics`, one of `ENVIRONMENT` … `DETECTOR`. Solid 0 is the world
        itself, a box.
    detector
        (solid): the number of the detector, or −1.
    body
        (solid): the number of its data in `outlines`, `meshes`, `voxels` or `masks`, or −1.
    box
        (solid, 6): lower x, y, z and upper x, y, z of a box around it in the world, mm.
    turned
        (solid): 1 where `frame` is not the identity.
    frame
        (solid, 12): rotation R by rows, then the origin o: a point p of the world is R (p − o) in the solid's own frame.
    size
        (solid, 3): in its own frame: half lengths of a box, half axes of an ellipsoid, (radius, unused, half length
        along z) of a cylinder, (unused, unused, half length along z) of an outline, full lengths of voxels; masks are
        boxes that are never turned.
    alone
        (solid): 1 where no later solid's box touches its box, so that inside it nothing else need be asked.
    """

    world: Floats
    kind: Integers
    material: Integers
    role: Integers
    detector: Integers
    body: Integers
    box: Floats
    turned: NDArray[np.uint8]
    frame: Floats
    size: Floats
    alone: NDArray[np.uint8]
    outlines: Outlines
    meshes: Meshes
    voxels: Voxels
    masks: Masks


class Source(NamedTuple):
    """Where photons come from.

    Attributes
    ----------
    position
        (3): centre of the focal spot, mm.
    spot
        (2): full width of the focal spot along x and y, mm (a uniform rectangle; 0 is a point).
    axis
        (3, 3): rows are two unit vectors across the cone's axis and the axis itself.
    cosine
        Cosine of the half angle: directions are uniform in solid angle within it; 1 is a pencil.
    energy
        (energy): keV, values at which photons start; with `width` the energy is uniform within ± width / 2 of it.
    width
        keV.
    alias, keep
        (energy): Walker's alias table of the spectrum.
    """

    position: Floats
    spot: Floats
    axis: Floats
    cosine: float
    energy: Floats
    width: float
    alias: Integers
    keep: Floats


class Detectors(NamedTuple):
    """The detectors, boxes whose faces lie along the axes.

    Attributes
    ----------
    solid
        (detector): its index in `Geometry`.
    assembly
        (detector, 6): lower x, y, z and upper x, y, z of a box around it and what is fixed to it. Next-event photons
        reach this box without a collision, and are followed as usual from there.
    threshold
        (detector): keV, the least energy of a pulse that is counted.
    blur
        (detector): b in keV^½; a pulse of E keV is blurred by a normal law of deviation b √E. 0 for none.
    efficiency
        (detector): probability that a pulse is read out.
    start, pixels
        (detector), (detector, 2): where its pixels begin in the image tally; rows (along y) and columns (along x).
    """

    solid: Integers
    assembly: Floats
    threshold: Floats
    blur: Floats
    efficiency: Floats
    start: Integers
    pixels: Integers


class Rules(NamedTuple):
    """How histories are followed.

    Attributes
    ----------
    cutoff
        keV below which a photon is absorbed where it is.
    reduce
        True for variance reduction (forced collisions in the target, next-event estimates to the detectors, capture by
        weight), None for analog: its type tells, so that numba compiles two kernels, and the analog one is a seventh
        faster for what is not in it.
    near
        mm; a collision closer than this to a detector's assembly makes no next-event estimate to it, whose variance
        would grow without bound.
    least
        The weight below which a photon is played Russian roulette; photons set out with a weight of 1.
    least_air
        The same for collisions forced in the air.
    bin_width
        keV per bin of the spectrum tallies.
    """

    cutoff: float
    reduce: bool | None
    near: float
    least: float
    least_air: float
    bin_width: float


class Tally(NamedTuple):
    """Sums of weights over the histories of one batch.

    Attributes
    ----------
    counts
        (detector, order): pulses above threshold by the history that led to them, see `ORDERS`.
    spectrum
        (detector, bin): pulse heights above threshold.
    image
        (pixel): pulses above threshold at the pixel of their first interaction, detectors one after another.
    deposited
        (solid): keV absorbed.
    escaped
        (cosine bin): photons that left the world, by the cosine of their direction with the source's axis, bins of [−1, 1].
    escaped_spectrum
        (2, bin): the same by energy; backwards, forwards.
    balance
        (2): keV that set out, keV that left the world.
    """

    counts: Floats
    spectrum: Floats
    image: Floats
    deposited: Floats
    escaped: Floats
    escaped_spectrum: Floats
    balance: Floats


ORDERS = ("single", "multiple", "rayleigh", "fluorescence", "air", "environment", "leak", "shield", "direct")
"""What a counted photon did before it met the detector; the last that applies of: one Compton scattering in the
target; more of them; any coherent one there; was emitted in the target by fluorescence; collided in the air; collided
in a solid that is none of target, shield and detector; crossed the
material of a shield; collided in one. "direct" is none of these."""
SINGLE, MULTIPLE, COHERENT, FLUORESCENT, AIR, ELSEWHERE, LEAKY, SHIELDED, DIRECT = range(9)
FROM_TARGET = 4
"""So many of the orders, the first ones, are the image; the others are background."""

# Fields of a photon's record. MARKS are sums of powers of two; COVERED has a bit for every detector whose next-event
# estimate was made at the last collision, so that the photon itself must not reach it; FREE is the detector to whose
# assembly a next-event photon flies without collision, or −1. FORCED is how far a first collision has been taken care
# of, MATERIAL what a photon collides with at once where it is, or −1 for one that flies.
X, Y, Z, U, V, W, ENERGY, WEIGHT, MARKS, COVERED, HOME, FREE, FORCED, MATERIAL = range(14)
RECORD = 14


class Desk(NamedTuple):
    """Scratch arrays of one thread.

    Attributes
    ----------
    stream
        (2): the random stream of the history.
    hit, following, far, inside
        (solid): the solids that the ray meets: their index, the distance of the next crossing and of the last one, and
        whether it is inside now.
    nodes
        (64): stack of the search in the trees of meshes.
    segment, segment_solid
        (256, 4), (256, 3): start, length, attenuation and probability of a first collision, of the pieces of target and
        air along a ray; solid, material and whether a shield was crossed before.
    chance
        (2): probability that the first collision is in the target, in the air.
    photon
        (RECORD): the photon that is followed.
    shower, pending
        (·, RECORD): photons that share a pulse with it, and those that do not.
    level
        (3): how many there are of both, and how many rows `phase` would have.
    entry
        (2): how far the last flight was where it first entered a detector, or −1, and which.
    phase
        (row, 10): photons that entered a detector: x, y, z, direction, keV, weight, order, detector. No rows for no record.
    pulse
        (detector, 6): keV deposited by the shower, then weight, order, x, y, z of its first interaction.
    """

    stream: NDArray[np.uint64]
    hit: Integers
    following: Floats
    far: Floats
    inside: NDArray[np.uint8]
    nodes: Integers
    segment: Floats
    segment_solid: Integers
    chance: Floats
    photon: Floats
    shower: Floats
    pending: Floats
    level: Integers
    entry: Floats
    phase: Floats
    pulse: Floats


SEGMENTS = 256
PENDING = 4096


def desk(solids: int, detectors: int, phase_rows: int = 0) -> Desk:
    """Fresh scratch arrays for one thread."""
    return Desk(
        stream=np.zeros(2, np.uint64),
        hit=np.zeros(solids, np.int64),
        following=np.zeros(solids),
        far=np.zeros(solids),
        inside=np.zeros(solids, np.uint8),
        nodes=np.zeros(64, np.int64),
        segment=np.zeros((SEGMENTS, 4)),
        segment_solid=np.zeros((SEGMENTS, 3), np.int64),
        chance=np.zeros(2),
        photon=np.zeros(RECORD),
        shower=np.zeros((64, RECORD)),
        pending=np.zeros((PENDING, RECORD)),
        level=np.zeros(3, np.int64),
        entry=np.zeros(2),
        phase=np.zeros((phase_rows, 10)),
        pulse=np.zeros((max(detectors, 1), 6)),
    )
