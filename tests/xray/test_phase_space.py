"""Photons that enter detectors: the same whatever the threads, where they must be, and through files and back."""

import dataclasses
import io
import json
import struct
import zipfile

import h5py
import numpy as np
import pytest

import shadowgram as sg
from shadowgram.xray._mcpl import mcpl_chunks
from shadowgram.xray.montecarlo.arrays import ORDERS
from shadowgram.xray.phase_space import UNITS, PhaseSpace, phase_space, read_phase_space, write_phase_space
from shadowgram.xray.scene import Box, Detector, Scene, Solid, Source, World, shipped_scene

LOW, HIGH = np.array([-80.0, -80, -60]), np.array([80.0, 80, -50])


def scene(**changes):
    """A pencil of 60 keV through a hole between two detectors onto water, which scatters back onto them."""
    plates = [
        Detector(name=name, centre=(x, 0, -55), size=(70, 160, 10), material={"name": "sodium iodide", "density": 3.67})
        for name, x in (("left", -45), ("right", 45))
    ]
    values = {
        "world": World(size=(400, 400, 400), material="vacuum"),
        "source": Source(position=(0, 0, -100), spectrum={"energy": 60}, activity=1e6),
        "solids": [
            Solid(name="slab", role="target", material="water", shape=Box(centre=(0, 0, 5), size=(100, 100, 10)))
        ],
        "detectors": plates,
    }
    return Scene(**values | changes)


@pytest.fixture(scope="module")
def space():
    return phase_space(scene(), histories=60_000, seed=4)


def equal(a, b):
    assert (a.orders, a.detectors, a.histories) == (b.orders, b.detectors, b.histories)
    for name in UNITS:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        assert getattr(a, name).dtype == getattr(b, name).dtype


def test_same_rows_for_any_number_of_threads(space):
    for threads in (1, 3):
        equal(phase_space(scene(), histories=60_000, seed=4, threads=threads), space)


def test_more_histories_begin_with_the_same_photons(space):
    fewer = phase_space(scene(), histories=31_234, seed=4)
    assert 0 < len(fewer) < len(space)
    for name in UNITS:
        np.testing.assert_array_equal(getattr(fewer, name), getattr(space, name)[: len(fewer)])


def test_photons_are_on_the_detectors_and_fly_into_them(space):
    assert len(space) > 500
    for number, (low, high) in enumerate(((-80, -10), (10, 80))):
        own = space.of(space.detectors[number])
        lower, upper = LOW.copy(), HIGH.copy()
        lower[0], upper[0] = low, high
        distance = np.stack([own.position - lower, upper - own.position], axis=1)  # (photon, side, axis)
        assert distance.min() > -1e-9
        assert np.abs(distance).min(axis=(1, 2)).max() < 1e-9
        photon = np.arange(len(own))
        side, axis = np.divmod(np.abs(distance).reshape(len(own), 6).argmin(axis=1), 3)
        assert np.all(own.direction[photon, axis] * (1 - 2 * side) > 0)
    np.testing.assert_allclose(np.linalg.norm(space.direction, axis=1), 1, atol=1e-12)
    assert space.energy.max() <= 60


def test_energies_of_single_scatterings_are_those_of_their_angles():
    thin = [Solid(name="leaf", role="target", material="water", shape=Box(centre=(0, 0, 5), size=(100, 100, 0.2)))]
    found = phase_space(scene(solids=thin), histories=10_000, seed=2, variance_reduction=True)
    singles = found.order == ORDERS.index("single")
    position, direction = found.position[singles], found.direction[singles]
    # Where they crossed the middle of the leaf; a few have been in the other detector meanwhile.
    back = (position[:, 2] - 5) / direction[:, 2]
    off_axis = np.hypot(*(position - back[:, None] * direction)[:, :2].T)
    straight = off_axis <= 0.1001 * np.hypot(*direction[:, :2].T) / np.abs(direction[:, 2])
    assert straight.sum() > 1000
    assert straight.mean() > 0.99
    expected = sg.xray.scattered_energy(60.0, np.arccos(direction[straight, 2]))
    np.testing.assert_allclose(found.energy[singles][straight], expected, rtol=1e-9)


def test_weights_with_and_without_variance_reduction_agree(space):
    reduced = phase_space(scene(), histories=20_000, seed=9, variance_reduction=True)
    assert set(space.weight) == {1.0}
    assert len(reduced) > 5000
    expected, found = len(space) / space.histories, reduced.weight.sum() / reduced.histories
    error = expected / np.sqrt(len(space)) + np.sqrt((reduced.weight**2).sum()) / reduced.histories
    assert abs(found - expected) < 4 * error


def test_counts_are_no_more_than_photons_that_enter(space):
    # 1 cm of sodium iodide lets few of them through, and a pulse of 60 keV is above any threshold.
    run = sg.xray.simulate(scene(), histories=60_000, seed=4)
    entered = space.weight.sum() / space.histories
    assert 0.9 * entered < run.tallies["all"].mean <= entered


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_files_give_all_of_it_back(space, tmp_path, suffix):
    write_phase_space(tmp_path / f"a{suffix}", space)
    equal(read_phase_space(tmp_path / f"a{suffix}"), space)


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_no_photons_are_a_phase_space_too(tmp_path, suffix, space):
    none = dataclasses.replace(space, **{name: getattr(space, name)[:0] for name in UNITS})
    write_phase_space(tmp_path / f"a{suffix}", none)
    equal(read_phase_space(tmp_path / f"a{suffix}"), none)


def test_units_stand_in_the_hdf5_file(space, tmp_path):
    write_phase_space(tmp_path / "a.h5", space)
    with h5py.File(tmp_path / "a.h5") as file:
        assert {name: file[name].attrs["units"] for name in file} == UNITS
        assert json.loads(file.attrs["detectors"]) == ["left", "right"]


def unpacked(data):
    """Particles of an MCPL file, after its documentation: numbers of the header, then float64 values and a flag each."""
    assert data[:8] == b"MCPL003L"
    photons, comments, blobs, flags, polarisation, single, kind, size, one_weight = struct.unpack_from(
        "<Q5IiII", data, 8
    )
    assert (blobs, flags, polarisation, single, kind, size, one_weight) == (0, 1, 0, 0, 22, 68, 0)
    at, texts = 48, []
    for _ in range(1 + comments):
        (length,) = struct.unpack_from("<I", data, at)
        texts.append(data[at + 4 : at + 4 + length].decode())
        at += 4 + length
    assert len(data) == at + 68 * photons
    rows = []
    for i in range(photons):
        x, y, z, a, b, e, time, weight, flag = struct.unpack_from("<8dI", data, at + 68 * i)
        sign = np.copysign(1, e)
        if abs(a) > 1:
            u = (sign * np.sqrt(max(0, 1 - b**2 - 1 / a**2)), b, 1 / a)
        elif abs(b) > 1:
            u = (a, sign * np.sqrt(max(0, 1 - a**2 - 1 / b**2)), 1 / b)
        else:
            u = (a, b, sign * np.sqrt(max(0, 1 - a**2 - b**2)))
        rows.append((x, y, z, *u, abs(e), time, weight, flag))
    return texts, np.array(rows)


def test_mcpl_after_its_documentation(space, tmp_path):
    write_phase_space(tmp_path / "a.mcpl", space)
    texts, rows = unpacked((tmp_path / "a.mcpl").read_bytes())
    assert texts[0] == f"shadowgram {sg.__version__}"
    assert "0 left, 1 right" in texts[2]
    assert texts[3] == "stat:sum:source_photons:                   60000"
    np.testing.assert_allclose(rows[:, :3], space.position / 10, rtol=1e-15)
    np.testing.assert_allclose(rows[:, 3:6], space.direction, atol=2e-8)  # the largest is a root of a difference
    np.testing.assert_allclose(rows[:, 6], space.energy / 1000, rtol=1e-15)
    assert not rows[:, 7].any()
    np.testing.assert_array_equal(rows[:, 8], space.weight)
    np.testing.assert_array_equal(rows[:, 9], 16.0 * space.detector + space.order)


def test_directions_along_the_axes_and_the_diagonals_survive_mcpl():
    grid = np.stack(np.meshgrid(*[[-1.0, 0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    direction = np.array([d / np.linalg.norm(d) for d in grid if d.any()])
    ones = np.ones(len(direction))
    data = b"".join(
        mcpl_chunks(
            position=direction, direction=direction, energy=ones, weight=ones, flags=np.arange(len(ones), dtype=np.uint32),
            program="", comments=[], histories=1,
        )
    )  # fmt: skip
    np.testing.assert_allclose(unpacked(data)[1][:, 3:6], direction, atol=2e-8)


def test_mcpl_by_its_own_library(space, tmp_path):
    mcpl = pytest.importorskip("mcpl")
    write_phase_space(tmp_path / "a.mcpl", space)
    with mcpl.MCPLFile(str(tmp_path / "a.mcpl")) as file:
        assert (file.version, file.nparticles, file.opt_universalpdgcode) == (3, len(space), 22)
        assert file.stat_sum == {"source_photons": 60_000}
        blocks = list(file.particle_blocks)
        (block,) = blocks
        np.testing.assert_allclose(10 * block.position, space.position, rtol=1e-14)
        np.testing.assert_allclose(block.direction, space.direction, atol=2e-8)
        np.testing.assert_allclose(1000 * block.ekin, space.energy, rtol=1e-14)
        np.testing.assert_array_equal(block.weight, space.weight)


def changed(space, path, **changes):
    """A .npz file of a phase space with some of its arrays replaced."""
    arrays = {name: getattr(space, name) for name in UNITS}
    arrays |= {"orders": np.array(space.orders), "detectors": np.array(space.detectors)}
    arrays |= {"histories": np.array(space.histories)} | changes
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})
    return path


@pytest.mark.parametrize(
    ("name", "change", "why"),
    [
        ("energy", None, "it holds no 'energy'"),
        ("energy", -1.0, "energy must be positive, got -1"),
        ("energy", np.nan, "energy must be finite"),
        ("weight", 0.0, "weight must be positive, got 0"),
        ("order", 9, "order must be from 0 to 8, got 9 to 9"),
        ("detector", 2, "detector must be from 0 to 1, got 2 to 2"),
        ("direction", 1.0, "every direction must have the length 1"),
        ("position", np.inf, "position must be finite"),
        ("histories", np.array(0), "histories must be a whole number of at least 1, got 0"),
        ("histories", np.array([1, 2]), "'histories' in it must be a whole number"),
        ("histories", np.array(1.5), "'histories' in it must be a whole number"),
        ("orders", np.array([1, 2]), "'orders' in it must be a list of names"),
        ("order", np.zeros(3, np.uint8), "order must be .* numbers"),
        ("order", np.zeros(3), "'order' in it must be uint8, got float64"),
        ("position", np.zeros((5, 2)), "position must be .* numbers"),
    ],
)
def test_npz_files_that_hold_no_phase_space(space, tmp_path, name, change, why):
    if change is not None and np.ndim(change) == 0 and not isinstance(change, np.ndarray):
        change = np.full_like(getattr(space, name), change)
    with pytest.raises(ValueError, match=f"^cannot read the phase space .*: {why}"):
        read_phase_space(changed(space, tmp_path / "a.npz", **{name: change}))


def test_objects_are_not_unpickled(space, tmp_path):
    path = changed(space, tmp_path / "a.npz", energy=np.array([{"a": 1}], dtype=object))
    with pytest.raises(ValueError, match="Python objects"):
        read_phase_space(path)


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.99])
def test_truncated_files(space, tmp_path, suffix, share):
    path = tmp_path / f"a{suffix}"
    write_phase_space(path, space)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(ValueError, match="cannot read the phase space"):
        read_phase_space(path)


def test_a_bomb_is_refused(space, tmp_path):
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**10,)})
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("energy.npy", header.getvalue())
    with pytest.raises(ValueError, match=r"it declares an array of 74\.5 GiB"):
        read_phase_space(tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("attribute", "value", "why"),
    [
        ("format", "something else", "it does not say that it is a 'shadowgram phase space 1'"),
        ("detectors", "left", "its attribute 'detectors' must be a list of names in JSON"),
        ("detectors", '["left", 2]', "its attribute 'detectors' must be a list of names in JSON"),
        ("detectors", '["left"]', "detector must be from 0 to 0, got 0 to 1"),
        ("orders", 3, "its attribute 'orders' must be a list of names in JSON"),
        ("histories", 1.5, "its attribute 'histories' must be a whole number"),
        ("histories", -3, "histories must be a whole number of at least 1, got -3"),
    ],
)
def test_hdf5_files_that_hold_no_phase_space(space, tmp_path, attribute, value, why):
    write_phase_space(tmp_path / "a.h5", space)
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file.attrs[attribute] = value
    with pytest.raises(ValueError, match=f"^cannot read the phase space .*: {why}"):
        read_phase_space(tmp_path / "a.h5")


def test_files_of_other_kinds(space, tmp_path):
    with pytest.raises(ValueError, match=r"written to .npz, .h5, .mcpl files, not to a.csv"):
        write_phase_space("a.csv", space)
    (tmp_path / "a.mcpl").write_bytes(b"MCPL003L")
    with pytest.raises(ValueError, match=r"read from .npz and .h5 files, not from .*a.mcpl"):
        read_phase_space(tmp_path / "a.mcpl")
    with pytest.raises(FileNotFoundError, match="there is no file"):
        read_phase_space(tmp_path / "b.npz")


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"histories": 0}, "histories must be a whole number of at least 1, got 0"),
        ({"histories": 10, "seed": -1}, "seed must be a whole number of at least 0, got -1"),
        ({"histories": 10, "threads": 1.5}, "threads must be a whole number of at least 1, got 1.5"),
        ({"histories": 10, "shot": 1}, "the shot must be a whole number from 0 to 0, got 1"),
    ],
)
def test_numbers_that_make_no_sense(change, why):
    with pytest.raises(ValueError, match=why):
        phase_space(scene(), **change)


def test_a_scene_without_detectors_is_refused():
    with pytest.raises(ValueError, match="the scene has no detector that photons could enter"):
        phase_space(shipped_scene("slab-water"), histories=10)


def test_photons_of_one_detector(space):
    left, right = space.of("left"), space.of("right")
    assert len(left) + len(right) == len(space)
    assert left.position[:, 0].max() < 0 < right.position[:, 0].min()
    with pytest.raises(ValueError, match="there is no detector 'middle'; there are left, right"):
        space.of("middle")


def test_arrays_must_fit_together(space):
    with pytest.raises(ValueError, match="position must be"):
        PhaseSpace(**{**vars(space), "position": space.position[:-1]})
