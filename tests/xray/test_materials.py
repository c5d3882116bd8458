"""Cross sections against NIST's tables, names, and what is refused."""

import json
import math

import numpy as np
import pytest
import typer
import xraylib
from scipy.io import loadmat
from typer.testing import CliRunner

from shadowgram.cli import xray_materials
from shadowgram.xray import _elements
from shadowgram.xray.materials import Material, material, material_names

# (keV, μ/ρ, μ_en/ρ), cm²/g. Hubbell and Seltzer, "Tables of X-ray mass attenuation coefficients and mass energy-absorption
# coefficients", NISTIR 5632 (NIST Standard Reference Database 126); its μ/ρ are those of XCOM with coherent scattering.
NIST = {
    "water": [(20, 0.8096, 0.5503), (60, 0.2059, 0.03190), (100, 0.1707, 0.02546)],
    "aluminum": [(20, 3.441, 3.094), (60, 0.2778, 0.1099), (100, 0.1704, 0.03794)],
    "sodium": [(1.5, 3194, 3151), (10, 15.57, 14.99), (60, 0.2268, 0.06625), (150, 0.1335, 0.02579), (300, 0.1029, 0.02771)],
    "iodine": [
        (15, 55.12, 52.08), (20, 25.43, 23.63), (30, 8.561, 7.622), (40, 22.10, 9.616), (50, 12.32, 6.573), (60, 7.579, 4.518),
        (80, 3.510, 2.331), (100, 1.942, 1.342), (150, 0.6978, 0.4742), (200, 0.3663, 0.2295), (300, 0.1771, 0.09257),
    ],
    "tungsten": [
        (15, 138.9, 117.2), (20, 65.73, 56.97), (30, 22.73, 19.91), (40, 10.67, 9.240), (50, 5.949, 5.050), (60, 3.713, 3.070),
        (80, 7.810, 2.879), (100, 4.438, 2.100), (150, 1.581, 0.9378), (200, 0.7844, 0.4913), (300, 0.3238, 0.1973),
    ],
}  # fmt: skip


@pytest.mark.parametrize("name", NIST)
def test_attenuation_is_that_of_nist(name):
    energy, total, _ = np.array(NIST[name]).T
    np.testing.assert_allclose(material(name).mass_attenuation(energy), total, rtol=2e-3)


@pytest.mark.parametrize("name", NIST)
def test_energy_absorption_is_that_of_nist(name):
    energy, _, absorbed = np.array(NIST[name]).T
    found = material(name).mass_energy_absorption(energy)
    np.testing.assert_allclose(found, absorbed, rtol=0.02)
    np.testing.assert_allclose(found[energy <= 100], absorbed[energy <= 100], rtol=0.007)


def test_energy_absorption_on_both_sides_of_the_edge_of_tungsten():
    # At the edge itself, 69.525 keV, NIST has 2.049 and 3.212; most of the jump in absorption leaves as fluorescence.
    energy = np.array([69.4, 69.52, 69.521, 69.523, 69.526, 69.53, 69.6, 69.7])
    found = material("W").mass_energy_absorption(energy)
    assert found[:3] == pytest.approx(2.049 * (69.525 / energy[:3]) ** 3, rel=0.007)
    assert found[3:] == pytest.approx(3.212, rel=0.02)


def test_skeletal_muscle_is_that_of_the_dose_study(data):
    table = loadmat(data / "cxbi" / "dose" / "mus_skel.mat")["muscle_skel"]
    muscle = material("skeletal muscle")
    # Below 5 keV the edges of its salts lie between rows that share an energy.
    energy, total, absorbed = table[(table[:, 0] >= 0.005) & (table[:, 0] <= 0.3)].T
    np.testing.assert_allclose(muscle.mass_attenuation(1000 * energy), total, rtol=5e-3)
    np.testing.assert_allclose(muscle.mass_energy_absorption(1000 * energy), absorbed, rtol=5e-3)


def test_parts_add_up_and_elements_are_additive():
    water, hydrogen, oxygen = (material(name) for name in ("water", "H", "O"))
    shares = dict(water.fractions)
    for energy in (1.0, 30.0, 512.0, 800.0):
        parts = water.photoelectric(energy) + water.compton(energy) + water.rayleigh(energy)
        assert water.mass_attenuation(energy) == pytest.approx(parts, rel=1e-14)
        for method in ("photoelectric", "compton", "rayleigh", "mass_energy_absorption"):
            mixed = shares[1] * getattr(hydrogen, method)(energy) + shares[8] * getattr(oxygen, method)(energy)
            assert getattr(water, method)(energy) == pytest.approx(mixed, rel=1e-12)
    assert water.attenuation(60.0) == pytest.approx(water.density * water.mass_attenuation(60.0))
    assert math.exp(-water.attenuation(60.0) * water.half_value_layer(60.0)) == pytest.approx(0.5)


def test_scalars_give_scalars_and_arrays_arrays():
    lead = material("lead")
    grid = np.array([[20, 30, 40], [50, 60, 100]])
    assert isinstance(lead.mass_attenuation(60), float)
    for method in ("mass_attenuation", "mass_energy_absorption", "half_value_layer"):
        values = getattr(lead, method)(grid)
        assert values.shape == grid.shape
        assert values[1, 1] == getattr(lead, method)(60.0)
    assert lead.form_factor(np.ones((2, 0))).shape == (2, 0)


def test_electrons():
    assert material("water").electron_density == pytest.approx(3.343e23, rel=1e-3)
    assert material("gold").electron_density == pytest.approx(79 / 196.967 * 6.02214e23 * 19.32, rel=2e-3)


def test_scattering_functions_at_both_ends():
    nai = material("NaI")
    assert nai.incoherent_function(0.0) == 0
    assert nai.incoherent_function(1e-3) == pytest.approx(nai.incoherent_function(2e-3) / 4)
    assert nai.incoherent_function([100.0, 1e12]) == pytest.approx(1, abs=2e-4)
    x = np.linspace(0, 40, 2000)
    assert np.all(np.diff(nai.incoherent_function(x)) > -1e-5)
    assert nai.form_factor(0.0) == pytest.approx(math.sqrt((11**2 + 53**2) / 2), rel=1e-3)
    assert nai.form_factor(1e12) == pytest.approx(0, abs=1e-12)
    assert material("Al").form_factor(0.1) == pytest.approx(11.225, rel=1e-4)


@pytest.mark.parametrize("z", [13, 29, 53, 74, 82, 92])
def test_edges_are_found_where_the_tables_jump(z):
    edges = _elements.photoelectric_edges(z)
    (below,), (above,) = (_elements.photoelectric((z,), edges[:, side]) for side in (0, 1))
    assert np.all(above > 1.001 * below)
    np.testing.assert_allclose(edges[:, 0], edges[:, 1], rtol=1e-14)
    # No rise is left between them, but above M edges of heavy elements, which NIST spreads over some percent.
    grid = np.geomspace(3, 800, 5000)
    rises = grid[1:][np.diff(_elements.photoelectric((z,), grid)[0]) > 0]
    assert len(rises) == np.count_nonzero(edges[:, 1] > 3)
    shells = [s for s in ("K", "L1", "L2", "L3") if xraylib.EdgeEnergy(z, getattr(xraylib, f"{s}_SHELL")) > 3]
    for shell in shells:
        energy = xraylib.EdgeEnergy(z, getattr(xraylib, f"{shell}_SHELL"))
        assert np.abs(edges[:, 1] / energy - 1).min() < 6e-4


def test_emission_of_every_element_is_less_than_what_was_absorbed():
    energy = np.geomspace(1, 800, 500)
    for z in range(1, 99):
        emitted = _elements.fluorescence(z, energy)
        shares = _elements.shell_shares(z, energy)
        assert np.all((emitted >= 0) & (emitted < energy))
        assert np.all(shares >= 0)
        assert np.all(shares.sum(axis=0) <= 1 + 1e-12)
        for shell in _elements.shells(z):
            assert sum(line.probability for line in shell.lines) == pytest.approx(1)


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("aluminium", "Al"), ("Tungsten", "W"), ("NaI", "sodium iodide"), ("WATER", "Water, Liquid"), ("teflon", "PTFE"),
        ("cortical  bone", "Bone, Cortical (ICRP)"), ("perspex", "PMMA"), ("lead glass", "Glass, Lead"),
    ],
)  # fmt: skip
def test_names_of_the_same(name, other):
    assert (material(name).density, material(name).fractions) == (material(other).density, material(other).fractions)


def test_what_the_scenes_need():
    known = {
        "caffeine": 1.23,
        "HMX": 1.91,
        "red brass": 8.44,
        "silicon": 2.33,
        "gold": 19.32,
        "air": 1.205e-3,
        "NaI": 3.667,
    }
    for name, density in known.items():
        assert material(name).density == pytest.approx(density, rel=1e-4)
    assert dict(material("red brass").fractions) == pytest.approx({29: 0.88, 50: 0.10, 30: 0.02})
    assert dict(material("caffeine").fractions)[7] == pytest.approx(4 * 14.007 / 194.19, rel=1e-3)
    assert material("NaI", density=3.67).density == 3.67
    air = material("air of 4.5", density=1.29e-3, fractions={"N": 0.755, "O": 0.232, "H": 0.013})
    assert dict(air.fractions) == pytest.approx({7: 0.755, 8: 0.232, 1: 0.013})


def test_every_name_in_the_list_is_known():
    for name in material_names():
        assert material(name).density > 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "cafeine"}, "no material 'cafeine'; the closest names are caffeine"),
        ({"name": "al"}, "closest names are Al,"),
        ({"name": "qqqqq"}, "see 'shadowgram xray materials'"),
        ({"name": ""}, "no material ''"),
        ({"name": "C8H10N4O2"}, "say the density of C8H10N4O2"),
        ({"name": "Rf2O", "density": 1.0}, "no material"),
        ({"name": "water", "density": 0}, "must be a positive number of g/cm³, got 0"),
        ({"name": "water", "density": math.nan}, "must be a positive number"),
        ({"name": "x", "fractions": {"N": 1.0}}, "say the density of x"),
        ({"name": "x", "density": 1.0, "fractions": {"Xx": 1.0}}, "chemical symbols such as N, got 'Xx'"),
        ({"name": "x", "density": 1.0, "fractions": {"N": 0.5}}, "add up to 1, they give 0.5"),
        ({"name": "x", "density": 1.0, "fractions": {"N": 1.5, "O": -0.5}}, "must be positive numbers"),
        ({"name": "x", "density": 1.0, "fractions": {}}, "add up to 1"),
    ],
)
def test_what_is_no_material(arguments, message):
    with pytest.raises(ValueError, match=message.replace("(", r"\(")):
        material(**arguments)


def test_what_is_no_composition():
    with pytest.raises(ValueError, match="different elements 1 to 98"):
        Material(name="x", density=1.0, fractions=((8, 0.5), (8, 0.5)))
    with pytest.raises(ValueError, match=r"add up to 1, they give 0\.9"):
        Material(name="x", density=1.0, fractions=((8, 0.9),))
    with pytest.raises(TypeError, match="named by a text"):
        material(13)  # type: ignore[arg-type]


@pytest.mark.parametrize("energy", [0.99, 801, 0, -60, math.nan, math.inf, [60, math.nan]])
def test_energies_without_tables(energy):
    water = material("water")
    for method in (water.mass_attenuation, water.mass_energy_absorption, water.half_value_layer):
        with pytest.raises(ValueError, match="between 1 and 800 keV"):
            method(energy)


def test_arguments_that_are_no_numbers():
    with pytest.raises(TypeError, match="energies in keV must be real numbers"):
        material("water").compton("60")
    with pytest.raises(ValueError, match="0 or more, in 1/Å; got -1"):
        material("water").form_factor(-1)
    with pytest.raises(ValueError, match="0 or more, in 1/Å; got nan"):
        material("water").incoherent_function(math.nan)


app = typer.Typer()
app.command("materials")(xray_materials.materials)
app.command("other")(lambda: None)


def run(*arguments):
    result = CliRunner().invoke(app, ["materials", *arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.stdout


def test_command_prints_a_table():
    lines = run("caffeine", "--energy", "60", "--energy", "100").splitlines()
    assert lines[0].startswith("caffeine: 1.23 g/cm³")
    assert [line.split()[0] for line in lines[-2:]] == ["60", "100"]
    assert float(lines[-2].split()[4]) == pytest.approx(material("caffeine").mass_attenuation(60.0), rel=1e-3)


def test_command_prints_json():
    said = json.loads(run("C3H6N6O6", "--density", "1.82", "--energy", "60", "--json"))
    rdx = material("C3H6N6O6", density=1.82)
    assert said["density"] == 1.82
    assert set(said["fractions"]) == {"C", "H", "N", "O"}
    (row,) = said["attenuation"]
    assert row["total"] == pytest.approx(row["photoelectric"] + row["compton"] + row["rayleigh"])
    assert row["half_value_layer"] == pytest.approx(rdx.half_value_layer(60.0))
    assert row["energy_absorption"] == pytest.approx(rdx.mass_energy_absorption(60.0))


def test_command_lists_names_and_draws(tmp_path):
    assert "Sodium Iodide" in run()
    assert "caffeine" in json.loads(run("--json"))["names"]
    run("tungsten", "--plot", str(tmp_path / "w.png"))
    assert (tmp_path / "w.png").read_bytes().startswith(b"\x89PNG")


def test_command_refuses(tmp_path):
    with pytest.raises(ValueError, match="closest names are water"):
        run("watter")
    with pytest.raises(ValueError, match="between 1 and 800"):
        run("water", "--energy", "0.1")
    with pytest.raises(ValueError, match=r"must end in \.png"):
        run("water", "--plot", str(tmp_path / "water.jpg"))
