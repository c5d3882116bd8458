"""Compton and Rayleigh scattering against their formulas in plain loops, limits and integrals."""

import math

import numpy as np
import pytest
from scipy.integrate import quad

from shadowgram.xray.compton import (
    bound_compton,
    coherent,
    klein_nishina,
    klein_nishina_total,
    momentum_transfer,
    scattered_energy,
    scattering_angle,
)
from shadowgram.xray.materials import material

MC2 = 510.99895  # keV
RADIUS = 2.8179403262  # fm; r_e² / 100 is in barn


def formula(energy, theta):
    """Klein and Nishina, written for one energy and angle as in the literature."""
    scattered = energy / (1 + energy / MC2 * (1 - math.cos(theta)))
    p = scattered / energy
    return RADIUS**2 / 100 / 2 * p**2 * (p + 1 / p - math.sin(theta) ** 2)


def test_klein_nishina_is_its_formula():
    energies, angles = [1.0, 20.0, 60.0, 511.0, 2000.0], [0.0, 0.3, 1.5, 3.0, math.pi]
    found = klein_nishina(np.array(energies)[:, None], angles)
    assert found.shape == (5, 5)
    for i, energy in enumerate(energies):
        for j, theta in enumerate(angles):
            assert found[i, j] == pytest.approx(formula(energy, theta), rel=1e-10)
            assert scattered_energy(energy, theta) == pytest.approx(energy / (1 + energy / MC2 * (1 - math.cos(theta))))


def test_klein_nishina_at_its_limits():
    squared = RADIUS**2 / 100
    assert klein_nishina([1e-6, 60, 511, 5000], 0.0) == pytest.approx(squared, rel=1e-9)
    theta = np.linspace(0, np.pi, 7)
    assert klein_nishina(1e-6, theta) == pytest.approx(squared / 2 * (1 + np.cos(theta) ** 2), rel=1e-7)


@pytest.mark.parametrize("energy", [30.0, 100.0, 511.0, 3000.0, 10_000.0])
def test_total_is_the_closed_form(energy):
    a = energy / MC2
    log = math.log1p(2 * a)
    bracket = (1 + a) / a**2 * (2 * (1 + a) / (1 + 2 * a) - log / a) + log / (2 * a) - (1 + 3 * a) / (1 + 2 * a) ** 2
    assert klein_nishina_total(energy) == pytest.approx(2 * math.pi * RADIUS**2 / 100 * bracket, rel=1e-9)


def test_total_at_low_energy_is_thomson():
    assert klein_nishina_total(1e-6) == pytest.approx(8 * math.pi / 3 * RADIUS**2 / 100, rel=1e-8)
    assert klein_nishina_total(np.full((2, 3), 60.0)).shape == (2, 3)


def test_angle_is_the_inverse_of_energy():
    theta = np.linspace(0.01, np.pi, 50)
    energy = np.array([[10.0], [60.0], [662.0]])
    back = scattering_angle(energy, scattered_energy(energy, theta))
    np.testing.assert_allclose(back, np.broadcast_to(theta, (3, 50)), rtol=1e-6)
    assert scattering_angle(60.0, 60.0) == 0
    assert isinstance(scattered_energy(60.0, 1.0), float)


def test_source_says_that_about_70_percent_are_left_backwards():
    # Salazar (2022), section 4.2, for 120 keV.
    assert scattered_energy(120.0, np.pi) / 120 == pytest.approx(0.68, abs=0.005)


@pytest.mark.parametrize("name", ["water", "aluminum", "NaI", "tungsten"])
@pytest.mark.parametrize("energy", [15.0, 60.0, 200.0])
def test_bound_compton_adds_up_to_the_tables(name, energy):
    of = material(name)
    whole, _ = quad(lambda t: 2 * math.pi * math.sin(t) * bound_compton(of, energy, t), 0, math.pi, epsrel=1e-5)
    per_gram = whole * 1e-24 * of.electron_density / of.density
    assert per_gram == pytest.approx(of.compton(energy), rel=0.014)


def test_bound_electrons_scatter_less_and_not_forward():
    tungsten = material("W")
    theta = np.linspace(0, np.pi, 100)
    assert np.all(bound_compton(tungsten, 60.0, theta) <= klein_nishina(60.0, theta))
    assert bound_compton(tungsten, 60.0, 0.0) == 0
    x = momentum_transfer(60.0, 2.0)
    assert x == pytest.approx(60 / 12.39842 * math.sin(1.0))
    assert bound_compton(tungsten, 60.0, 2.0) == pytest.approx(formula(60, 2.0) * tungsten.incoherent_function(x))


@pytest.mark.parametrize(("name", "tolerance"), [("carbon", 0.005), ("aluminum", 0.005), ("tungsten", 0.05)])
def test_coherent_adds_up_to_the_tables(name, tolerance):
    # The tables have relativistic form factors, which matters for heavy elements.
    of = material(name)
    whole, _ = quad(
        lambda t: 2 * math.pi * math.sin(t) * coherent(of, 40.0, t), 0, math.pi, epsrel=1e-4, points=[0.05, 0.3]
    )
    assert whole * 1e-24 * of.atoms.sum() == pytest.approx(of.rayleigh(40.0), rel=tolerance)


def test_coherent_of_an_average_atom():
    water, hydrogen, oxygen = (material(name) for name in ("H2O", "H", "O"))
    mixed = (2 * coherent(hydrogen, 30.0, 1.0) + coherent(oxygen, 30.0, 1.0)) / 3
    assert coherent(water, 30.0, 1.0) == pytest.approx(mixed, rel=2e-3)
    assert coherent(oxygen, 30.0, 0.0) == pytest.approx(64 * RADIUS**2 / 100)


@pytest.mark.parametrize(
    ("energy", "theta", "message"),
    [
        (0.0, 1.0, "positive number of keV, got 0"),
        (-5.0, 1.0, "positive number of keV, got -5"),
        (math.nan, 1.0, "positive number of keV, got nan"),
        (math.inf, 1.0, "positive number of keV, got inf"),
        (60.0, 90.0, "between 0 and π rad, got 90"),
        (60.0, -0.1, "between 0 and π rad, got -0.1"),
        (60.0, math.nan, "between 0 and π rad, got nan"),
        ([1.0, 2.0, 3.0], [1.0, 2.0], "do not fit together"),
    ],
)
def test_what_cannot_be(energy, theta, message):
    for function in (klein_nishina, scattered_energy, momentum_transfer):
        with pytest.raises(ValueError, match=message):
            function(energy, theta)
    for law in (bound_compton, coherent):
        with pytest.raises(ValueError, match=message):
            law(material("water"), energy, theta)


def test_energies_that_no_angle_gives():
    for scattered in (60.1, 48.5):
        with pytest.raises(ValueError, match=f"not {scattered:g} of 60"):
            scattering_angle(60.0, scattered)
    with pytest.raises(TypeError, match="theta must be real numbers"):
        klein_nishina(60.0, "1")
    with pytest.raises(ValueError, match="above 10 MeV"):
        klein_nishina_total(2e4)
