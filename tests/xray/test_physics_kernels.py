"""One collision: what is drawn against the densities that are tabulated, and these against the formulas in plain loops.

Statistical tests are seeded. Each would raise a false alarm for one choice of seeds in 16 000 (4 standard deviations, 6e-5).
"""

import itertools
import math

import numpy as np
import pytest
from scipy import stats

from shadowgram.xray import _elements
from shadowgram.xray.compton import klein_nishina, klein_nishina_total, scattered_energy
from shadowgram.xray.materials import material
from shadowgram.xray.montecarlo._jit import SOURCES, entry
from shadowgram.xray.montecarlo._physics_kernels import (
    compton,
    compton_density,
    emitted_line,
    emptied_shell,
    energy_bin,
    isotropic,
    rayleigh,
    rayleigh_density,
    turned,
)
from shadowgram.xray.montecarlo.arrays import (
    COMPTON_NORM,
    ELECTRON_MASS,
    HC,
    LOWEST_MOMENTUM,
    MOMENTUM_BINS,
    RAYLEIGH_NORM,
)
from shadowgram.xray.montecarlo.rng import begin, uniform
from shadowgram.xray.montecarlo.tables import energy_edges, momentum_edges, physics_tables

ALARM = 6e-5
NAMES = ("water", "tungsten", "iodine", "free")
WATER, TUNGSTEN, IODINE, FREE = range(4)
SQUARED_RADIUS = 2.8179403262**2 / 100  # barn
DRAWS = 1_000_000


def _entries(sources):
    @entry
    def scattered(physics, index, energy, rayleigh_, stream, out):
        """Row i: cosine and energy of a scattered photon."""
        begin(stream, 1, 0)
        for i in range(out.shape[0] if sources else 0):
            if rayleigh_:
                out[i, 0], out[i, 1] = rayleigh(physics, index, stream, energy), energy
            else:
                out[i, 0], out[i, 1] = compton(physics, index, stream, energy)

    @entry
    def densities(physics, index, energies, cosines, rayleigh_, out):
        """Row i: density per steradian, and the energy of the scattered photon."""
        for i in range(out.shape[0] if sources else 0):
            bin_ = energy_bin(energies[i])
            if rayleigh_:
                out[i, 0], out[i, 1] = rayleigh_density(physics, index, bin_, energies[i], cosines[i]), energies[i]
            else:
                out[i, 0], out[i, 1] = compton_density(physics, index, bin_, energies[i], cosines[i])

    @entry
    def directions(u, v, w, cosine, stream, out):
        """Directions turned by an angle; for a cosine above 1, isotropic ones."""
        begin(stream, 2, 0)
        for i in range(out.shape[0] if sources else 0):
            if cosine > 1.0:
                out[i, 0], out[i, 1], out[i, 2] = isotropic(stream)
            else:
                out[i, 0], out[i, 1], out[i, 2] = turned(u, v, w, cosine, stream)

    @entry
    def wander(cosines, stream, out):
        """The direction after each of many turns, one after the other."""
        begin(stream, 3, 0)
        u, v, w = 0.6, 0.0, 0.8
        for i in range(out.shape[0] if sources else 0):
            u, v, w = turned(u, v, w, cosines[i], stream)
            out[i, 0], out[i, 1], out[i, 2] = u, v, w

    @entry
    def emissions(physics, index, energy, stream, lines):
        """Row i: the lines that an absorption emits, one after the other, −1 for none."""
        begin(stream, 4, 0)
        for i in range(lines.shape[0] if sources else 0):
            shell = emptied_shell(physics, index, energy_bin(energy), uniform(stream))
            for j in range(lines.shape[1]):
                lines[i, j] = emitted_line(physics, stream, shell) if shell >= 0 else -1
                shell = physics.line_next[lines[i, j]] if lines[i, j] >= 0 else -1

    return scattered, densities, directions, wander, emissions


_scattered, _densities, _directions, _wander, _emissions = _entries(SOURCES)


@pytest.fixture(scope="module")
def physics():
    """Water, tungsten and iodine, and water whose electrons are free."""
    tables = physics_tables([material(name) for name in ("water", "tungsten", "iodine", "water")])
    edges = energy_edges()
    total = klein_nishina_total(edges)
    slope = np.diff(total) / np.diff(edges)
    tables.attenuation[FREE, :, COMPTON_NORM] = total[:-1] - slope * edges[:-1]
    tables.attenuation[FREE, :, COMPTON_NORM + 1] = slope
    tables.incoherent[FREE] = 1.0
    return tables


def stream():
    return np.zeros(2, np.uint64)


def drawn(physics, index, energy, *, coherent, count=DRAWS):
    out = np.zeros((count, 2))
    _scattered(physics, index, energy, coherent, stream(), out)
    return out.T


def density(physics, index, energies, cosines, *, coherent):
    energies, cosines = (np.ascontiguousarray(x, float) for x in np.broadcast_arrays(energies, cosines))
    out = np.zeros((len(cosines), 2))
    _densities(physics, index, energies, cosines, coherent, out)
    return out.T


# ---- the laws in plain Python ------------------------------------------------------------------------------------------------


def row(physics, index, energy, column):
    a, b = physics.attenuation[index, np.searchsorted(energy_edges(), energy, side="right") - 1, column : column + 2]
    return a + b * energy


def bound(physics, index, x):
    """S(x) of an average electron: linear between the edges, ∝ x² below them."""
    if x < LOWEST_MOMENTUM:
        return physics.incoherent[index, 0] * (x / LOWEST_MOMENTUM) ** 2
    return float(np.interp(x, momentum_edges(), physics.incoherent[index]))


def free_law(energy, cosine):
    """Klein and Nishina, barn/sr."""
    ratio = 1 / (1 + energy / ELECTRON_MASS * (1 - cosine))
    return SQUARED_RADIUS / 2 * ratio**2 * (ratio + 1 / ratio - (1 - cosine**2))


def momentum(energy, cosine):
    return energy / HC * math.sqrt((1 - cosine) / 2)


def squared_factor(physics, index, x):
    """F²(x)/F²(0): one value in each bin, and below them."""
    if x < LOWEST_MOMENTUM:
        return physics.coherent[index, 0] / LOWEST_MOMENTUM**2
    bin_ = min(int(np.searchsorted(momentum_edges(), x, side="right")) - 1, MOMENTUM_BINS - 1)
    return physics.form_factor[index, bin_]


def pieces(energy, low, high):
    """Cosines between two, and all those between them where a momentum bin begins: inside, the laws are smooth."""
    edges = 1 - 2 * (momentum_edges() * HC / energy) ** 2
    return np.unique([low, *edges[(edges > low) & (edges < high)], high])


def integral(law, energy, low, high, nodes=8):
    """2π ∫ law(cosine) d cosine, by Gauss's rule in each piece."""
    node, weight = np.polynomial.legendre.leggauss(nodes)
    ends = pieces(energy, low, high)
    half = np.diff(ends)[:, None] / 2
    at = ends[:-1, None] + half * (1 + node)
    return 2 * math.pi * float(((half * weight) * law(at.ravel()).reshape(at.shape)).sum())


def compton_law(physics, index, energy):
    return lambda cosines: np.array([free_law(energy, c) * bound(physics, index, momentum(energy, c)) for c in cosines])


def rayleigh_law(physics, index, energy):
    return lambda cosines: np.array(
        [squared_factor(physics, index, momentum(energy, c)) * (1 + c**2) / 2 for c in cosines]
    )


def agreement(cosines, edges, law, energy):
    """Chance of a histogram of cosines as far from a law as this one."""
    expected = np.array([integral(law, energy, a, b) for a, b in itertools.pairwise(edges)])
    counts = np.histogram(cosines, edges)[0]
    assert counts.sum() == len(cosines)
    expected *= len(cosines) / expected.sum()
    assert expected.min() > 20
    return stats.chisquare(counts, expected).pvalue


# ---- Compton scattering ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("energy", [20.0, 60.0, 120.0])
@pytest.mark.parametrize("index", [WATER, TUNGSTEN, FREE], ids=lambda index: NAMES[index])
def test_compton_scattering_follows_the_table(physics, index, energy):
    cosines, energies = drawn(physics, index, energy, coherent=False)
    edges = np.linspace(-1, 1, 61)
    assert agreement(cosines, edges, compton_law(physics, index, energy), energy) > ALARM
    np.testing.assert_allclose(energies, scattered_energy(energy, np.arccos(cosines)), rtol=1e-13)


@pytest.mark.parametrize("energy", [10.0, 20.0, 60.0, 120.0, 500.0])
def test_free_electrons_scatter_by_klein_and_nishina(physics, energy):
    def law(cosines):
        return klein_nishina(energy, np.arccos(cosines))

    cosines, _ = drawn(physics, FREE, energy, coherent=False)
    assert agreement(cosines, np.linspace(-1, 1, 101), law, energy) > ALARM


def random_pairs(count=2000):
    rng = np.random.default_rng(5)
    return np.exp(rng.uniform(0, np.log(511), count)), np.clip(rng.uniform(-1.02, 1.02, count), -1, 1)


@pytest.mark.parametrize("index", range(4), ids=lambda index: NAMES[index])
def test_the_compton_density_is_the_formula(physics, index):
    energies, cosines = random_pairs()
    found, scattered = density(physics, index, energies, cosines, coherent=False)
    expected = [
        free_law(e, c) * bound(physics, index, momentum(e, c)) / row(physics, index, e, COMPTON_NORM)
        for e, c in zip(energies, cosines, strict=True)
    ]
    np.testing.assert_allclose(found, expected, rtol=2e-8)  # the radius of the electron is rounded
    np.testing.assert_allclose(scattered, energies / (1 + energies / ELECTRON_MASS * (1 - cosines)), rtol=1e-14)


@pytest.mark.parametrize("coherent", [False, True], ids=["Compton", "Rayleigh"])
@pytest.mark.parametrize("index", range(3), ids=lambda index: NAMES[index])
def test_densities_are_one_over_the_sphere(physics, index, coherent):
    for energy in (1.001, 3.3, 20.0, 59.9, 60.0, 121.7, 400.0):

        def law(cosines, energy=energy):
            return density(physics, index, energy, cosines, coherent=coherent)[0]

        # The norm, which goes at most with E⁻², is a line between the borders of an energy bin: off by 6/8 of 1/128 squared.
        assert integral(law, energy, -1, 1) == pytest.approx(1, abs=5e-5)


# ---- Rayleigh scattering -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("energy", [20.0, 60.0, 120.0])
@pytest.mark.parametrize("index", [WATER, TUNGSTEN], ids=lambda index: NAMES[index])
def test_rayleigh_scattering_follows_the_table(physics, index, energy):
    cosines, energies = drawn(physics, index, energy, coherent=True)
    law = rayleigh_law(physics, index, energy)
    # Fine bins where the photons go: from −1 to 0 evenly, then ever finer to 1.
    edges = np.concatenate([np.linspace(-1, 0, 9), 1 - np.geomspace(1, 2e-5, 80)[1:], [1.0]])
    enough = [integral(law, energy, a, b) for a, b in itertools.pairwise(edges)]
    whole = sum(enough)
    kept = [edges[0]]
    gathered = 0.0
    for share, edge in zip(enough, edges[1:], strict=True):
        gathered += share / whole * DRAWS
        if gathered > 100:
            kept.append(edge)
            gathered = 0.0
    kept[-1] = 1.0
    assert len(kept) > 30
    assert agreement(cosines, np.array(kept), law, energy) > ALARM
    assert (energies == energy).all()


@pytest.mark.parametrize("index", range(3), ids=lambda index: NAMES[index])
def test_the_rayleigh_density_is_the_formula(physics, index):
    energies, cosines = random_pairs()
    found, _ = density(physics, index, energies, cosines, coherent=True)
    expected = [
        squared_factor(physics, index, momentum(e, c)) * (1 + c**2) / 2 / row(physics, index, e, RAYLEIGH_NORM)
        for e, c in zip(energies, cosines, strict=True)
    ]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("coherent", [False, True], ids=["Compton", "Rayleigh"])
@pytest.mark.parametrize("energy", [1.0, 1.5, 511.9])
def test_scattering_at_the_ends_of_the_tables(physics, energy, coherent):
    for index in range(3):
        cosines, energies = drawn(physics, index, energy, coherent=coherent, count=20_000)
        assert ((cosines >= -1) & (cosines <= 1)).all()
        assert ((energies > 0) & (energies <= energy)).all()
        mean, spread = cosines.mean(), cosines.std() / math.sqrt(len(cosines))
        law = (rayleigh_law if coherent else compton_law)(physics, index, energy)
        expected = integral(lambda c, law=law: c * law(c), energy, -1, 1) / integral(law, energy, -1, 1)
        assert mean == pytest.approx(expected, abs=4 * spread)


# ---- directions --------------------------------------------------------------------------------------------------------------

POLES = [
    (0.0, 0.0, 1.0),
    (0.0, 0.0, -1.0),
    (0.0, 0.0, -0.0),  # replaced below by a direction across the axis
    (1e-9, 0.0, 1.0),
    (0.0, -1e-9, -1.0),
    (1e-200, 1e-200, -1.0),
    (1e-5, 2e-5, -1.0),
    (1.0, 0.0, 0.0),
    (0.0, 1.0, -0.0),
    (1.0, 1e-17, -1e-17),
    (0.6, -0.48, 0.64),
    (-0.6, 0.48, -0.64),
]


def unit(vector):
    vector = np.array(vector if any(vector) else (1.0, 1.0, -0.0))
    return vector / np.linalg.norm(vector)


def even(values, bins=36):
    return stats.chisquare(np.bincount((values * bins).astype(int), minlength=bins)).pvalue


def azimuth(directions, axis):
    """Of directions about an axis, as a share of a turn."""
    first = np.cross(axis, (0.0, 1.0, 0.0) if abs(axis[1]) < 0.5 else (1.0, 0.0, 0.0))
    first /= np.linalg.norm(first)
    return np.arctan2(directions @ np.cross(axis, first), directions @ first) / (2 * math.pi) % 1.0


@pytest.mark.parametrize("start", POLES, ids=str)
@pytest.mark.parametrize("cosine", [1.0, 0.9999999, 0.5, 0.0, -0.7, -1.0])
def test_a_turn_has_its_angle_and_any_azimuth(start, cosine):
    start = unit(start)
    out = np.zeros((100_000, 3))
    _directions(*start, cosine, stream(), out)
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), 1, rtol=1e-15)
    np.testing.assert_allclose(out @ start, cosine, atol=5e-16)
    if abs(cosine) < 1:
        assert even(azimuth(out, start)) > ALARM


def test_ten_thousand_turns_leave_the_length():
    cosines = np.random.default_rng(6).uniform(-1, 1, 10_000)
    out = np.zeros((len(cosines), 3))
    _wander(cosines, stream(), out)
    assert np.abs(np.linalg.norm(out, axis=1) - 1).max() < 1e-12
    before = np.concatenate([[[0.6, 0.0, 0.8]], out[:-1]])
    np.testing.assert_allclose((before * out).sum(axis=1), cosines, atol=1e-12)


def test_isotropic_directions():
    out = np.zeros((DRAWS, 3))
    _directions(0.0, 0.0, 1.0, 2.0, stream(), out)
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), 1, rtol=1e-15)
    for axis in (*np.eye(3), unit((1.0, 2.0, -3.0))):
        assert even((1 + out @ axis) / 2, 200) > ALARM
        assert even(azimuth(out, axis), 200) > ALARM


# ---- fluorescence ------------------------------------------------------------------------------------------------------------


def emission_tree(z, energy):
    """{(energies of the lines of one absorption): probability}, from the tables of elements, shells K, L1, L2, L3."""
    shells = {shell.index: shell for shell in _elements.shells(z) if shell.index < 4}
    shares = _elements.shell_shares(z, np.array([energy]))[:, 0]

    def after(index):
        """What the filling of a shell emits."""
        if index not in shells:
            return {(): 1.0}
        shell = shells[index]
        found = {(): 1 - shell.fluorescence}
        for line in shell.lines:
            for rest, chance in after(line.emptied).items():
                key = (round(line.energy, 9), *rest)
                found[key] = found.get(key, 0.0) + shell.fluorescence * line.probability * chance
        return found

    tree = {(): 1 - shares.sum()}
    for index, share in enumerate(shares):
        for key, chance in after(index).items():
            tree[key] = tree.get(key, 0.0) + share * chance
    return tree


@pytest.mark.parametrize(
    ("index", "z", "energy"),
    [(TUNGSTEN, 74, e) for e in (100.0, 40.0, 11.0)] + [(IODINE, 53, e) for e in (60.0, 34.0, 20.0)],
)
def test_atoms_emit_their_lines(physics, index, z, energy):
    bin_ = np.searchsorted(energy_edges(), energy, side="right") - 1
    tree = emission_tree(z, energy_edges()[bin_ : bin_ + 2].mean())
    assert sum(tree.values()) == pytest.approx(1, abs=1e-9)
    lines = np.zeros((DRAWS, 5), np.int64)
    _emissions(physics, index, energy, stream(), lines)
    assert (lines[:, 4] == -1).all()
    base = len(physics.line_energy) + 1
    numbers, counts = np.unique((lines + 1) @ base ** np.arange(5), return_counts=True)
    found = {}
    for number, count in zip(numbers, counts, strict=True):
        emitted = [int(number) // base**j % base - 1 for j in range(5)]
        key = tuple(round(physics.line_energy[line], 9) for line in emitted if line >= 0)
        found[key] = found.get(key, 0) + int(count)
    assert set(found) <= set(tree)
    assert max(sum(key) for key in found) < energy
    # What is rarer than 20 in all goes together.
    often = {key: DRAWS * chance for key, chance in tree.items() if DRAWS * chance > 20}
    rest = DRAWS - sum(often.values())
    observed = [found.get(key, 0) for key in often]
    expected = list(often.values())
    if rest > 20:
        observed.append(DRAWS - sum(observed))
        expected.append(rest)
    else:
        expected = [e * sum(observed) / sum(expected) for e in expected]
    assert stats.chisquare(observed, expected).pvalue > ALARM


def test_light_atoms_emit_nothing(physics):
    lines = np.zeros((1000, 3), np.int64)
    _emissions(physics, WATER, 20.0, stream(), lines)
    assert (lines == -1).all()
