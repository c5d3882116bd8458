"""Transport tables against the materials they are made of, read as the contract says, in plain loops."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad

from shadowgram.xray import _elements
from shadowgram.xray.materials import material
from shadowgram.xray.montecarlo.arrays import (
    COMPTON_NORM,
    ELECTRON_MASS,
    ENERGY_BINS,
    GUIDE,
    HC,
    LOWEST_MOMENTUM,
    MOMENTUM_BINS,
    PHOTOELECTRIC,
    RAYLEIGH,
    RAYLEIGH_NORM,
    TOTAL,
)
from shadowgram.xray.montecarlo.tables import energy_edges, momentum_edges, physics_tables

NAMES = ("water", "aluminum", "NaI", "tungsten", "air", "lead")
SQUARED_RADIUS = 2.8179403262**2 / 100  # barn


@pytest.fixture(scope="module")
def physics():
    return physics_tables([material(name) for name in NAMES])


def energy_bin(energy):
    """Exponent and first 7 bits of the mantissa."""
    mantissa, exponent = math.frexp(energy)
    return (exponent - 1) * 128 + int((2 * mantissa - 1) * 128)


def value(physics, index, energy, column):
    row = physics.attenuation[index, energy_bin(energy)]
    return row[column] + row[column + 1] * energy


def momentum_bin(x):
    mantissa, exponent = math.frexp(x / LOWEST_MOMENTUM)
    return (exponent - 1) * 16 + int((2 * mantissa - 1) * 16)


def scattering(physics, index, x):
    """S of an average electron, linear between the edges and ∝ x² below them."""
    if x < LOWEST_MOMENTUM:
        return physics.incoherent[index, 0] * (x / LOWEST_MOMENTUM) ** 2
    edges, bin_ = momentum_edges(), momentum_bin(x)
    share = (x - edges[bin_]) / (edges[bin_ + 1] - edges[bin_])
    return (1 - share) * physics.incoherent[index, bin_] + share * physics.incoherent[index, bin_ + 1]


def squared_form_factor(physics, index, x):
    if x < LOWEST_MOMENTUM:
        return physics.coherent[index, 0] / LOWEST_MOMENTUM**2
    return physics.form_factor[index, momentum_bin(x)]


def edge_bins(of):
    return {energy_bin(edge) for z in of.elements for edge in _elements.photoelectric_edges(z)[:, 1] if edge < 512}


def test_edges_are_those_of_the_bits():
    edges = energy_edges()
    assert (edges[0], edges[128], edges[-1]) == (1, 2, 512)
    for bin_ in range(0, ENERGY_BINS, 37):
        assert energy_bin(edges[bin_]) == bin_
        assert energy_bin(np.nextafter(edges[bin_ + 1], 0)) == bin_
    x = momentum_edges()
    assert (x[0], x[-1]) == (LOWEST_MOMENTUM, 64)
    assert [momentum_bin(x[bin_]) for bin_ in range(MOMENTUM_BINS)] == list(range(MOMENTUM_BINS))


def test_shapes_and_types(physics):
    assert physics.attenuation.shape == (len(NAMES), ENERGY_BINS, 10)
    for table in (physics.incoherent, physics.coherent, physics.form_factor):
        assert table.shape == (len(NAMES), MOMENTUM_BINS + 1)
    shells = physics.shell_start[-1]
    assert physics.shell_cumulative.shape == (shells, ENERGY_BINS)
    assert physics.shell_yield.shape == (shells,)
    assert physics.line_start.shape == (shells + 1,)
    for table in physics:
        assert table.flags.c_contiguous
        assert table.dtype in (np.float64, np.int64, np.uint8)
        assert np.isfinite(table).all()


@pytest.mark.parametrize("index", range(len(NAMES)))
def test_the_guide_points_at_the_last_edge_before_a_step(physics, index):
    cumulative = physics.coherent[index]
    for step, edge in enumerate(physics.coherent_guide[index]):
        value = cumulative[-1] * step / GUIDE
        assert edge == 0 or cumulative[edge] <= value
        assert edge == MOMENTUM_BINS - 1 or value < cumulative[edge + 1]


@pytest.mark.parametrize("index", range(len(NAMES)))
def test_lines_meet_the_table_at_both_edges(physics, index):
    of = material(NAMES[index])
    columns = {TOTAL: of.mass_attenuation, PHOTOELECTRIC: of.photoelectric, RAYLEIGH: of.rayleigh}
    edges = energy_edges()
    with_edge = edge_bins(of)
    for column, method in columns.items():
        expected = of.density / 10 * method(edges)
        row = physics.attenuation[index]
        at_left = row[:, column] + row[:, column + 1] * edges[:-1]
        at_right = row[:, column] + row[:, column + 1] * edges[1:]
        np.testing.assert_allclose(at_left, expected[:-1], rtol=1e-12)
        smooth = [bin_ for bin_ in range(ENERGY_BINS) if bin_ not in with_edge or column == RAYLEIGH]
        np.testing.assert_allclose(at_right[smooth], expected[1:][smooth], rtol=1e-12)
        assert np.all(at_right > 0)


@pytest.mark.parametrize("index", range(len(NAMES)))
def test_lines_are_near_the_table_inside_the_bins(physics, index):
    of = material(NAMES[index])
    with_edge = edge_bins(of)
    # NIST's tables rise steeply between the M edges of heavy elements, and bend there.
    lowest = {"tungsten": 2.1, "lead": 2.7}.get(NAMES[index], 1.0)
    energies = np.exp(np.random.default_rng(0).uniform(np.log(lowest), np.log(512), 3000))
    energies = np.array([energy for energy in energies if energy_bin(energy) not in with_edge])
    found = [value(physics, index, energy, TOTAL) for energy in energies]
    np.testing.assert_allclose(found, of.attenuation(energies) / 10, rtol=1.05e-4)


@pytest.mark.parametrize(
    ("name", "edge"), [("NaI", 33.1694), ("tungsten", 69.525), ("lead", 88.0045), ("tungsten", 10.2068)]
)
def test_bins_with_an_edge_go_on_from_the_left(physics, name, edge):
    index = NAMES.index(name)
    bin_ = energy_bin(edge)
    left, right = energy_edges()[bin_ : bin_ + 2]
    below = material(name).photoelectric(edge * (1 - 1e-3)) * (1 - 1e-3) ** 3
    for energy in (left, edge, np.nextafter(right, 0)):
        found = value(physics, index, energy, PHOTOELECTRIC) * 10 / material(name).density
        assert found == pytest.approx(below * (edge / energy) ** 3, rel=0.01)
        parts = value(physics, index, energy, RAYLEIGH) + found * material(name).density / 10
        assert value(physics, index, energy, TOTAL) > parts
    assert value(physics, index, right, PHOTOELECTRIC) > 2 * value(physics, index, left, PHOTOELECTRIC)


@pytest.mark.parametrize("index", [0, 2, 3])
@pytest.mark.parametrize("energy", [1.0, 3.5, 20.0, 59.5, 130.25, 512.0 * (1 - 1e-9)])
def test_norms_are_integrals_of_the_tables(physics, index, energy):
    largest = energy / HC
    # Pieces between the edges, where the integrands are smooth.
    borders = [0.0, *momentum_edges()[momentum_edges() < largest], largest]

    def compton(x):
        cosine = 1 - 2 * (x / largest) ** 2
        p = 1 / (1 + energy / ELECTRON_MASS * (1 - cosine))
        law = SQUARED_RADIUS / 2 * p**2 * (p + 1 / p - 1 + cosine**2) * scattering(physics, index, x)
        return law * 8 * math.pi * x / largest**2

    def rayleigh(x):
        cosine = 1 - 2 * (x / largest) ** 2
        return squared_form_factor(physics, index, x) * (1 + cosine**2) / 2 * 8 * math.pi * x / largest**2

    for law, column in ((compton, COMPTON_NORM), (rayleigh, RAYLEIGH_NORM)):
        pieces = [quad(law, low, np.nextafter(high, 0), epsrel=1e-9)[0] for low, high in itertools.pairwise(borders)]
        # Inside a bin, what falls as 1/E² is up to 5e-5 below the line; at an edge the line is exact.
        tolerance = 1e-8 if energy_edges()[energy_bin(energy)] == energy else 5e-5
        assert value(physics, index, energy, column) == pytest.approx(sum(pieces), rel=tolerance)


@pytest.mark.parametrize(
    ("name", "tolerance"), [("water", 3e-3), ("aluminum", 7e-3), ("NaI", 9e-3), ("tungsten", 1.3e-2)]
)
def test_compton_norm_gives_the_compton_attenuation(physics, name, tolerance):
    of = material(name)
    for energy in np.arange(10.0, 201.0, 5.0):
        per_mm = of.electron_density * 1e-24 * value(physics, NAMES.index(name), energy, COMPTON_NORM) / 10
        assert per_mm == pytest.approx(of.density * of.compton(energy) / 10, rel=tolerance)


@pytest.mark.parametrize(
    ("name", "tolerance"), [("water", 6e-3), ("aluminum", 5e-3), ("NaI", 5e-2), ("tungsten", 8e-2)]
)
def test_rayleigh_norm_gives_the_rayleigh_attenuation(physics, name, tolerance):
    of = material(name)
    squares = of.density * of.atoms @ np.array(of.elements) ** 2.0
    for energy in np.arange(10.0, 201.0, 10.0):
        per_mm = SQUARED_RADIUS * squares * 1e-24 * value(physics, NAMES.index(name), energy, RAYLEIGH_NORM) / 10
        assert per_mm == pytest.approx(of.density * of.rayleigh(energy) / 10, rel=tolerance)


@pytest.mark.parametrize("index", range(len(NAMES)))
def test_scattering_functions_are_those_of_the_material(physics, index):
    of = material(NAMES[index])
    x = momentum_edges()
    np.testing.assert_allclose(physics.incoherent[index], np.minimum(of.incoherent_function(x), 1), rtol=1e-12)
    inside = np.exp(np.random.default_rng(1).uniform(np.log(1e-3), np.log(41), 300))
    found = [scattering(physics, index, at) for at in inside]
    np.testing.assert_allclose(found, of.incoherent_function(inside), rtol=0.02, atol=2e-5)
    assert physics.incoherent.max() <= 1


@pytest.mark.parametrize("index", range(len(NAMES)))
def test_form_factors_are_the_means_that_the_cumulative_has(physics, index):
    of = material(NAMES[index])
    at_zero = of.form_factor(0.0) ** 2
    cumulative, edges = physics.coherent[index], momentum_edges()
    assert np.all(np.diff(cumulative) >= 0)
    for bin_ in range(0, MOMENTUM_BINS, 9):
        width = edges[bin_ + 1] ** 2 - edges[bin_] ** 2
        mean = (cumulative[bin_ + 1] - cumulative[bin_]) / width
        assert physics.form_factor[index, bin_] == pytest.approx(mean, rel=1e-9, abs=1e-14 / width)
        direct, _ = quad(
            lambda t: of.form_factor(math.sqrt(t)) ** 2, edges[bin_] ** 2, edges[bin_ + 1] ** 2, epsrel=1e-8
        )
        assert physics.form_factor[index, bin_] == pytest.approx(direct / width / at_zero, rel=1e-3)
    assert physics.form_factor[index, -1] == physics.form_factor[index, -2]
    assert cumulative[0] == pytest.approx(LOWEST_MOMENTUM**2, rel=2e-3)


def test_shells(physics):
    for index in range(len(NAMES)):
        shells = range(physics.shell_start[index], physics.shell_start[index + 1])
        before = np.zeros(ENERGY_BINS)
        for shell in shells:
            assert np.all(physics.shell_cumulative[shell] >= before)
            before = physics.shell_cumulative[shell]
            lines = physics.line_cumulative[physics.line_start[shell] : physics.line_start[shell + 1]]
            assert np.all(np.diff(lines, prepend=0) > 0)
            assert lines[-1] == 1
            assert 0 < physics.shell_yield[shell] < 1
            for line in range(physics.line_start[shell], physics.line_start[shell + 1]):
                following = physics.line_next[line]
                assert following == -1 or shell < following < physics.shell_start[index + 1]
        assert np.all(before <= 1)


def test_k_shell_takes_the_share_by_which_absorption_jumps(physics):
    for name, edge in (("NaI", 33.1694), ("tungsten", 69.525), ("lead", 88.0045)):
        index = NAMES.index(name)
        k = physics.shell_start[index]
        below, above = material(name).photoelectric([edge * (1 - 1e-3), edge * (1 + 1e-3)])
        bin_ = energy_bin(edge)
        assert physics.shell_cumulative[k, bin_] == 0
        assert physics.shell_cumulative[k, bin_ + 1] == pytest.approx(1 - below / above, abs=0.015)


def test_tungsten_emits_its_lines(physics):
    start = physics.shell_start[NAMES.index("tungsten")]
    assert physics.shell_start[NAMES.index("tungsten") + 1] - start == 4
    lines = slice(physics.line_start[start], physics.line_start[start + 1])
    probability = np.diff(physics.line_cumulative[lines], prepend=0)
    strongest = probability.argmax()
    # X-ray data booklet (LBNL 2009): Kα1 59.318 keV; about half of the K emission.
    assert physics.line_energy[lines][strongest] == pytest.approx(59.318, abs=2e-3)
    assert probability[strongest] == pytest.approx(0.50, abs=0.01)
    assert physics.shell_yield[start] == pytest.approx(0.954, abs=0.005)
    assert physics.line_next[lines][strongest] == start + 3  # L3


def test_emission_is_nearly_that_of_the_whole_cascade(physics):
    def carried(shell):
        first, last = physics.line_start[shell], physics.line_start[shell + 1]
        probability = np.diff(physics.line_cumulative[first:last], prepend=0)
        energy = 0.0
        for line in range(first, last):
            following = physics.line_next[line]
            after = carried(following) if following >= 0 else 0.0
            energy += probability[line - first] * (physics.line_energy[line] + after)
        return physics.shell_yield[shell] * energy

    for name, z, tolerance in (("tungsten", 74, 0.03), ("lead", 82, 0.03), ("aluminum", 13, 0.02)):
        index = NAMES.index(name)
        for energy in (100.0, 300.0):
            previous = mean = 0.0
            for shell in range(physics.shell_start[index], physics.shell_start[index + 1]):
                now = physics.shell_cumulative[shell, energy_bin(energy)]
                mean += (now - previous) * carried(shell)
                previous = now
            assert mean == pytest.approx(_elements.fluorescence(z, np.array([energy]))[0], rel=tolerance)


def test_cutoff_leaves_out_shells():
    tungsten = [material("tungsten")]
    only_k = physics_tables(tungsten, cutoff=10.0)
    assert only_k.shell_yield.tolist() == [physics_tables(tungsten).shell_yield[0]]
    assert set(only_k.line_next) == {-1}
    none = physics_tables([material("water")])
    assert none.shell_start.tolist() == [0, 0]
    assert none.shell_cumulative.shape == (0, ENERGY_BINS)
    assert none.line_start.tolist() == [0]
    assert none.line_energy.size == 0


def test_tables_do_not_depend_on_their_company(physics):
    alone = physics_tables([material("NaI")])
    index = NAMES.index("NaI")
    assert np.array_equal(alone.attenuation[0], physics.attenuation[index])
    assert np.array_equal(alone.coherent[0], physics.coherent[index])
    first = physics.shell_start[index]
    following = physics.line_next[physics.line_start[first] : physics.line_start[physics.shell_start[index + 1]]]
    assert alone.line_next.tolist() == [n - first if n >= 0 else -1 for n in following]


def test_what_makes_no_tables():
    with pytest.raises(ValueError, match="at least one material"):
        physics_tables([])
    for cutoff in (0.5, 512.0, math.nan):
        with pytest.raises(ValueError, match="cutoff must be at least 1 and below 512"):
            physics_tables([material("water")], cutoff=cutoff)
