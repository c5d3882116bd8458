"""Interaction tables of the materials of a scene, as `arrays.Physics` says.

Everything that is the same for all materials or all scenes is computed once a process: integrals over the bins, and the tables of
elements. What a material needs beyond them are a few sums.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from shadowgram.xray import _elements
from shadowgram.xray._elements import RADIUS_SQUARED
from shadowgram.xray.materials import Material

from .arrays import (
    BINS_PER_OCTAVE_BITS,
    ELECTRON_MASS,
    ENERGY_BINS,
    GUIDE,
    HC,
    HIGHEST_ENERGY,
    LOWEST_ENERGY,
    LOWEST_MOMENTUM,
    MOMENTUM_BINS,
    MOMENTUM_BINS_PER_OCTAVE_BITS,
    Floats,
    Physics,
)

_COMPTON_NODES = 3  # per momentum bin; four change no norm by 1e-9
_FORM_FACTOR_NODES = 4  # per momentum bin
_SHELLS = (_elements.K, _elements.L1, _elements.L2, _elements.L3)


def physics_tables(materials: Sequence[Material], cutoff: float = 1.0) -> Physics:
    """Tables of the interactions of photons in some materials.

    Parameters
    ----------
    materials : in the order of their indices.
    cutoff : keV; shells whose most probable line lies below it are left out: what they emit is absorbed where it is emitted.

    Returns
    -------
    Physics

    Raises
    ------
    ValueError
        If there are no materials, or the cut-off is not in the range of the tables.

    Notes
    -----
    Emission is from the shells K, L1, L2 and L3, after the vacancies that photoelectric absorption makes and those that an emission
    from K leaves in L. Vacancies that Auger electrons leave, and those that move between L shells (Coster and Kronig), emit nothing
    here. A bin with an absorption edge goes on as if the edge stood at its upper border.

    Examples
    --------
    >>> from shadowgram.xray.materials import material
    >>> from shadowgram.xray.montecarlo.tables import physics_tables
    >>> physics = physics_tables([material("air"), material("tungsten")])
    >>> physics.attenuation.shape, physics.shell_yield.round(2)
    ((2, 1152, 10), array([0.12, 0.95, 0.13, 0.3 , 0.26]))
    """
    if not materials:
        raise ValueError("tables need at least one material")
    if not LOWEST_ENERGY <= cutoff < HIGHEST_ENERGY:
        raise ValueError(f"cutoff must be at least {LOWEST_ENERGY:g} and below {HIGHEST_ENERGY:g} keV, got {cutoff:g}")
    incoherent = np.array([_incoherent(m) for m in materials])
    squares = np.array([_squared_form_factor(m) for m in materials])
    coherent = np.cumsum(squares, axis=1)
    means = squares / np.diff(momentum_edges() ** 2, prepend=0.0)
    return Physics(
        attenuation=np.array([_attenuation(m, s, f) for m, s, f in zip(materials, incoherent, means, strict=True)]),
        incoherent=incoherent,
        coherent=coherent,
        coherent_guide=np.array([_guide(row) for row in coherent]),
        form_factor=np.concatenate([means[:, 1:], means[:, -1:]], axis=1),
        **_emission(materials, cutoff),
    )


def _guide(cumulative: Floats) -> NDArray[np.uint8]:
    """(GUIDE) the last edge below equal steps of a cumulative table."""
    steps = cumulative[-1] * np.arange(GUIDE) / GUIDE
    return np.clip(np.searchsorted(cumulative, steps, side="right") - 1, 0, MOMENTUM_BINS - 1).astype(np.uint8)


@cache
def energy_edges() -> Floats:
    """(energy bin + 1,) keV."""
    return _edges(LOWEST_ENERGY, BINS_PER_OCTAVE_BITS, ENERGY_BINS)


@cache
def momentum_edges() -> Floats:
    """(momentum bin + 1,) 1/Å."""
    return _edges(LOWEST_MOMENTUM, MOMENTUM_BINS_PER_OCTAVE_BITS, MOMENTUM_BINS)


def _edges(lowest: float, bits: int, bins: int) -> Floats:
    """Octaves that are split evenly, as the first bits of a mantissa do it."""
    number = np.arange(bins + 1)
    parts = 1 << bits
    return lowest * 2.0 ** (number >> bits) * (1 + (number & (parts - 1)) / parts)


def _incoherent(material: Material) -> Floats:
    """(momentum edge,) S(x) of an average electron."""
    atoms, elements = material.atoms, material.elements
    table = np.stack([_element_incoherent(z) for z in elements])
    return np.minimum(atoms @ table / (atoms @ np.array(elements)), 1.0)


@cache
def _element_incoherent(z: int) -> Floats:
    return _elements.incoherent_function((z,), momentum_edges())[0]


def _squared_form_factor(material: Material) -> Floats:
    """(momentum bin + 1,) integral of F²/F²(0) over x² below the first edge and in each bin."""
    atoms, elements = material.atoms, material.elements
    table = np.stack([_element_squared_form_factor(z) for z in elements])
    return atoms @ table / (atoms @ np.array(elements) ** 2.0)


@cache
def _element_squared_form_factor(z: int) -> Floats:
    squares = np.concatenate([[0.0], momentum_edges() ** 2])
    node, weight = np.polynomial.legendre.leggauss(_FORM_FACTOR_NODES)
    half = np.diff(squares)[:, None] / 2
    x = np.sqrt(squares[:-1, None] + half * (1 + node))
    factor = _elements.form_factor((z,), x.ravel())[0].reshape(x.shape)
    return (half * factor**2) @ weight


def _attenuation(material: Material, incoherent: Floats, means: Floats) -> Floats:
    """(energy bin, 10) of one material, as `Physics.attenuation`."""
    per_mm = material.density * material.weights / 10
    photoelectric = np.tensordot(per_mm, np.stack([_element_photoelectric(z) for z in material.elements]), 1)
    compton, rayleigh = (
        _ends(per_mm @ np.stack([table(z) for z in material.elements]))
        for table in (_element_compton, _element_rayleigh)
    )
    columns = (
        photoelectric + compton + rayleigh,
        photoelectric,
        rayleigh,
        _ends(_compton_integrals() @ incoherent),
        _ends(_rayleigh_integrals() @ means),
    )
    return np.concatenate([_lines(column) for column in columns], axis=1)


def _ends(values: Floats) -> Floats:
    """(energy bin, 2) values at both ends of the bins, of a function that is given at their edges and does not jump."""
    return np.stack([values[:-1], values[1:]], axis=1)


def _lines(ends: Floats) -> Floats:
    """(energy bin, 2) a and b of the lines a + b·E through values at both ends of the bins."""
    edges = energy_edges()
    slope = (ends[:, 1] - ends[:, 0]) / np.diff(edges)
    return np.stack([ends[:, 0] - slope * edges[:-1], slope], axis=1)


@cache
def _element_compton(z: int) -> Floats:
    return _elements.compton((z,), energy_edges())[0]


@cache
def _element_rayleigh(z: int) -> Floats:
    return _elements.rayleigh((z,), energy_edges())[0]


@cache
def _element_photoelectric(z: int) -> Floats:
    """(energy bin, 2) cm²/g at both ends of the bins; where an edge lies between, the upper value is as if it stood there."""
    ends = _ends(_elements.photoelectric((z,), energy_edges())[0])
    above = LOWEST_ENERGY  # above the edge before
    for (below, next_above), bin_ in zip(_elements.photoelectric_edges(z), _edge_bins(z), strict=True):
        if bin_ < ENERGY_BINS and above <= energy_edges()[bin_]:  # of two edges in a bin, the first counts
            # Extended by the power law that holds just below the edge.
            near = np.array([max(above, below * (1 - 2.0**-8)), below])
            low, high = _elements.photoelectric((z,), near)[0]
            ends[bin_, 1] = high * (energy_edges()[bin_ + 1] / below) ** (
                np.log(high / low) / np.log(near[1] / near[0])
            )
        above = next_above
    return ends


@cache
def _edge_bins(z: int) -> tuple[int, ...]:
    """The energy bins that hold the absorption edges of an element; one on a border belongs to the bin below it."""
    edges = _elements.photoelectric_edges(z)
    return tuple(int(bin_) for bin_ in np.searchsorted(energy_edges(), edges[:, 1], side="left") - 1)


@cache
def _compton_integrals() -> Floats:
    """(energy edge, momentum edge): weights of S at the momentum edges in ∫ KN(E, θ) S(x) dΩ, barn.

    S is linear between the edges, ∝ x² below the first, so that the integral is a sum over its values; dΩ = 8π (hc/E)² x dx.
    """
    x = momentum_edges()
    node, weight = np.polynomial.legendre.leggauss(_COMPTON_NODES)
    node, weight = (node + 1) / 2, weight / 2
    low, high = np.concatenate([[0.0], x[:-1]]), x
    result = np.zeros((ENERGY_BINS + 1, MOMENTUM_BINS + 1))
    for row, energy in zip(result, energy_edges(), strict=True):
        largest = energy / HC
        inside = low < largest
        start, stop = low[inside], np.minimum(high[inside], largest)
        at = start[:, None] + (stop - start)[:, None] * node
        cosine = 1 - 2 * (at / largest) ** 2
        ratio = 1 / (1 + energy / ELECTRON_MASS * (1 - cosine))
        law = 4 * np.pi * RADIUS_SQUARED * ratio**2 * (ratio + 1 / ratio - 1 + cosine**2) * at / largest**2
        law *= weight * (stop - start)[:, None]
        share = (at - start[:, None]) / (high[inside] - start)[:, None]
        row[0] += law[0] @ share[0] ** 2
        row[1 : len(start)] += (law[1:] * share[1:]).sum(axis=1)
        row[: len(start) - 1] += (law[1:] * (1 - share[1:])).sum(axis=1)
    return result


@cache
def _rayleigh_integrals() -> Floats:
    """(energy edge, momentum bin + 1): weights of the means of F² in ∫ F² (1 + cos²θ)/2 dΩ, sr; first below all bins."""
    largest = (energy_edges() / HC)[:, None] ** 2
    share = np.minimum(np.concatenate([[0.0], momentum_edges() ** 2]) / largest, 1.0)  # sin²(θ/2)
    return np.diff(4 * np.pi * (share - share**2 + 2 / 3 * share**3), axis=1)


def _emission(materials: Sequence[Material], cutoff: float) -> dict[str, np.ndarray]:
    """The fields of `Physics` about shells and lines."""
    shell_start, line_start = [0], [0]
    shares: list[Floats] = [np.zeros((0, ENERGY_BINS))]
    yields, cumulative, energies, following = [], [], [], []
    for material in materials:
        kept = [(z, shell) for z in sorted(material.elements, reverse=True) for shell in _emitting(z, cutoff)]
        numbers = {(z, shell.index): shell_start[-1] + i for i, (z, shell) in enumerate(kept)}
        shares.append(np.cumsum(_shell_shares(material, [(z, shell.index) for z, shell in kept]), axis=0))
        for z, shell in kept:
            yields.append(shell.fluorescence)
            cumulative += _cumulative([line.probability for line in shell.lines])
            energies += [line.energy for line in shell.lines]
            following += [numbers.get((z, line.emptied), -1) for line in shell.lines]
            line_start.append(len(energies))
        shell_start.append(len(yields))
    return {
        "shell_start": np.array(shell_start, dtype=np.int64),
        "shell_cumulative": np.minimum(np.concatenate(shares), 1.0),
        "shell_yield": np.array(yields, dtype=np.float64),
        "line_start": np.array(line_start, dtype=np.int64),
        "line_cumulative": np.array(cumulative, dtype=np.float64),
        "line_energy": np.array(energies, dtype=np.float64),
        "line_next": np.array(following, dtype=np.int64),
    }


def _emitting(z: int, cutoff: float) -> list[_elements.Shell]:
    """K and L shells whose most probable line is at or above the cut-off."""
    return [
        shell
        for shell in _elements.shells(z)
        if shell.index in _SHELLS and max(shell.lines, key=lambda line: line.probability).energy >= cutoff
    ]


def _cumulative(probabilities: list[float]) -> list[float]:
    """Sums that end at exactly 1."""
    sums = np.cumsum(probabilities)
    return [*(sums[:-1] / sums[-1]).tolist(), 1.0]


def _shell_shares(material: Material, kept: list[tuple[int, int]]) -> Floats:
    """(shell, energy bin): share of each shell in the photoelectric absorption of a material.

    Taken in the middle of the bins, and at the lower border of those where an edge lies: so goes their attenuation.
    """
    edges = energy_edges()
    energy = (edges[:-1] + edges[1:]) / 2
    with_edge = [bin_ for z in material.elements for bin_ in _edge_bins(z) if bin_ < ENERGY_BINS]
    energy[with_edge] = edges[with_edge]
    absorbed = material.weights[:, None] * _elements.photoelectric(material.elements, energy)
    part = dict(zip(material.elements, absorbed / absorbed.sum(axis=0), strict=True))
    of_shells = {z: _element_shell_shares(z) for z, _ in kept}
    return np.array([part[z] * of_shells[z][index] for z, index in kept]).reshape(len(kept), ENERGY_BINS)


@cache
def _element_shell_shares(z: int) -> Floats:
    """(4, energy bin): shares of K, L1, L2 and L3 within an element."""
    edges = energy_edges()
    energy = (edges[:-1] + edges[1:]) / 2
    with_edge = [bin_ for bin_ in _edge_bins(z) if bin_ < ENERGY_BINS]
    energy[with_edge] = edges[with_edge]
    return _elements.shell_shares(z, energy)
