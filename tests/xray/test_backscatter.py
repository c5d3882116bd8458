"""Single scattering against plain sums from the equations, closed forms, and photons that are followed."""

import math

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.xray.compton import bound_compton, scattered_energy
from shadowgram.xray.montecarlo.arrays import ORDERS
from shadowgram.xray.scan import with_transmittance
from shadowgram.xray.scene import Box, Detector, Ellipsoid, Mask, Scene, Solid, Source, Voxels, World

ENERGY = 70.0
BARN = 1e-24  # cm²


def slab(thickness=12.0, *, spectrum=None, centre=(4.0, 0.0), **mask):
    """A slab of water on one side of the axis, and a plate beside the mask."""
    return Scene(
        world=World(size=(900, 900, 900)),
        source=Source(position=(0, 0, -100), half_angle=0.2, spectrum=spectrum or {"energy": ENERGY}, activity=1e6),
        mask=Mask(
            material="tungsten",
            pitch=4,
            depth=1,
            rows=3,
            columns=4,
            plate=(60, 60),
            pattern={"rows": ["0000"] * 3},
            **mask,
        ),
        solids=[
            Solid(
                name="slab",
                role="target",
                material="water",
                shape=Box(centre=(*centre, 200 + thickness / 2), size=(60, 100, thickness)),
            )
        ],
        detectors=[
            Detector(
                name="plate",
                centre=(-90, 20, 60),
                size=(80, 120, 20),
                material={"name": "sodium iodide", "density": 3.67},
                threshold=10,
            )
        ],
    )


def air_and_water(scene, a, b):
    """mm of air and of water from a to b, (…, 2)."""
    box = scene.solids[0].shape
    low, high = (np.array(box.centre) + sign * np.array(box.size) / 2 for sign in (-1, 1))
    way = b - a
    with np.errstate(divide="ignore"):
        one, other = (low - a) / way, (high - a) / way
    near = np.maximum(np.minimum(one, other).max(axis=-1), 0)
    far = np.minimum(np.maximum(one, other).min(axis=-1), 1)
    length = np.linalg.norm(way, axis=-1)
    inside = np.maximum(far - near, 0) * length
    return np.stack([length - inside, inside], axis=-1)


def left_of(scene, energy, a, b):
    """Share of photons that are not touched from a to b."""
    media = scene.world.material.material(), sg.xray.material("water")
    attenuation = np.stack([one.attenuation(energy) / 10 for one in media], axis=-1)
    return np.exp(-(attenuation * air_and_water(scene, a, b)).sum(axis=-1))


def places_on(scene, axis, steps=24):
    """(place, 3) midpoints of the upper face of the plate across an axis, and the area of each."""
    plate = scene.detectors[0]
    centre, size = np.array(plate.centre), np.array(plate.size)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    share = (np.arange(steps) + 0.5) / steps - 0.5
    places = np.tile(centre, (steps * steps, 1))
    places[:, axis] += size[axis] / 2
    places[:, a] += np.repeat(share, steps) * size[a]
    places[:, b] += np.tile(share, steps) * size[b]
    return places, size[a] * size[b] / steps**2


def through_crystal(scene, places, back):
    """mm from places on the plate's faces to where lines leave it."""
    plate = scene.detectors[0]
    walls = np.array(plate.centre) + np.where(back > 0, 0.5, -0.5) * np.array(plate.size)
    return ((walls - places) / back).min(axis=1)


def plain_sum(scene, row, column, energy=ENERGY, depths=40):
    """Counts per source photon through the middle of a cell, by midpoints over depth and the two faces of the plate in sight."""
    water, crystal = sg.xray.material("water"), scene.detectors[0].material.material()
    start = np.array(scene.source.position)
    cell = np.array([(column - 1.5) * 4, (1 - row) * 4, -0.5]) - start
    share = 16 * cell[2] / np.linalg.norm(cell) ** 3 / scene.source.solid_angle
    way = cell / np.linalg.norm(cell)
    thickness = scene.solids[0].shape.size[2] / way[2]
    total = 0.0
    for k in range(depths):
        place = start + ((200 - start[2]) / way[2] + (k + 0.5) / depths * thickness) * way
        for axis in (0, 2):
            places, area = places_on(scene, axis)
            back = places - place
            distance = np.linalg.norm(back, axis=1)
            back = back / distance[:, None]
            theta = np.arccos(back @ way)
            scattered = scattered_energy(energy, theta)
            law = bound_compton(water, energy, theta) * BARN * water.electron_density / 10
            pulses = (crystal.mass_attenuation(scattered) - crystal.rayleigh(scattered)) * crystal.density / 10
            seen = -np.expm1(-pulses * through_crystal(scene, places, back))
            angle = -back[:, axis] * area / distance**2
            ways = left_of(scene, np.array(energy), start, place) * left_of(scene, scattered, place, places)
            total += (ways * law * angle * seen * (scattered > 10)).sum() * thickness / depths
    return share * total


def test_one_energy_is_the_plain_sum():
    scene = slab()
    found = sg.xray.single_scatter(scene, rays=1).image
    for row, column in ((0, 2), (2, 1)):
        assert found[row, column] == pytest.approx(plain_sum(scene, row, column), rel=0.005)
    assert found.shape == (3, 4)


def test_a_spectrum_is_the_sum_of_its_energies():
    one, other = (sg.xray.single_scatter(slab(spectrum={"energy": energy}), rays=1) for energy in (45.0, 90.0))
    both = sg.xray.single_scatter(slab(spectrum={"energies": [45.0, 90.0], "weights": [3.0, 1.0]}), rays=1)
    assert np.allclose(both.image, 0.75 * one.image + 0.25 * other.image, rtol=1e-3)
    assert (one.depth95 < other.depth95)[both.image > 0].all()


@pytest.mark.parametrize("thickness", [2.0, 30.0, 150.0])
def test_the_depth_of_saturation_is_that_of_an_exponential(thickness):
    scene = slab(thickness, centre=(0.0, 0.0))
    far = scene.detectors[0].model_copy(update={"centre": (0, 150, -440), "size": (4, 4, 4)})
    found = sg.xray.single_scatter(scene.model_copy(update={"detectors": (far,)}), rays=1)
    water = sg.xray.material("water")
    start, cell = np.array(scene.source.position), np.array([-2.0, 0.0, 99.5])
    way = cell / np.linalg.norm(cell)
    # From a middle depth: the direction to the plate hardly changes, but it is farther away from deeper places.
    place = start + (300 + min(thickness / 2, 25)) / way[2] * way
    back = np.array([0, 150, -438]) - place
    distance = np.linalg.norm(back)
    back /= distance
    scattered = float(scattered_energy(ENERGY, math.acos(float(way @ back))))
    kappa = (water.attenuation(ENERGY) + water.attenuation(scattered) * way[2] / -back[2]) / 10 + 2 / distance
    whole = -math.expm1(-kappa * thickness / way[2])
    wanted = -math.log1p(-0.95 * whole) / kappa
    assert found.depth95[1, 1] == pytest.approx(wanted, rel=0.02)


@pytest.mark.parametrize("name", ["cxbi-blocks", "cxbi-hand"])
@pytest.mark.parametrize(("threshold", "excess"), [(0.1, 0.01), (10.0, 0.05)])
def test_photons_that_are_followed_agree(name, threshold, excess):
    """All cells open. Above 10 keV pulses are missing from which lines of iodine escaped."""
    scene = sg.xray.shipped_scene(name)
    plates = tuple(one.model_copy(update={"threshold": threshold}) for one in scene.detectors)
    scene = scene.model_copy(update={"detectors": plates})
    run = sg.xray.simulate(with_transmittance(scene, 1.0), histories=120_000, seed=5, variance_reduction=True, shot=256)
    orders = run.tallies["all/orders"]
    single = ORDERS.index("single")
    followed, error = orders.mean[single], orders.standard_error[single]
    computed = sg.xray.single_scatter(scene).image.sum()
    assert error < 0.02 * followed
    assert -3 * error - 0.01 * followed < computed - followed < 3 * error + excess * followed


def test_photons_through_a_part_of_the_cells_agree():
    """The map, and not only its sum: light on one block of four, and the mean over it."""
    scene = sg.xray.shipped_scene("cxbi-blocks")
    found = sg.xray.single_scatter(scene).image
    caffeine, hmx = found[2:14, 18:30].sum(), found[2:14, 2:14].sum()
    counts = []
    for columns in (slice(18, 30), slice(2, 14)):
        cells = np.zeros((32, 32), np.uint8)
        cells[2:14, columns] = 1
        pattern = scene.mask.pattern.model_copy(
            update={"rows": tuple("".join(map(str, row)) for row in cells), "transmittance": None, "seed": None}
        )
        mask = scene.mask.model_copy(update={"pattern": pattern, "columns": 32, "view": None})
        run = sg.xray.simulate(
            scene.model_copy(update={"mask": mask, "shots": 1}), histories=200_000, seed=6, variance_reduction=True
        )
        counts.append(run.tallies["all/orders"].mean[ORDERS.index("single")])
    assert caffeine / hmx == pytest.approx(counts[0] / counts[1], rel=0.05)
    assert caffeine == pytest.approx(counts[0], rel=0.09)
    assert abs(found[2:14, 14:18].sum()) < 0.2 * caffeine


def test_threads_change_nothing():
    scene = sg.xray.shipped_scene("cxbi-ud")
    found = []
    for count in (1, 2, 3):
        with sg.threads(count):
            found.append(sg.xray.single_scatter(scene, rays=1))
    for other in found[1:]:
        assert np.array_equal(found[0].image, other.image)
        assert np.array_equal(found[0].depth95, other.depth95, equal_nan=True)


def test_rows_and_columns_are_the_mask_s():
    plain = sg.xray.single_scatter(slab(), rays=3).image
    assert (plain[:, 0] > plain[:, -1]).all()  # the plate is at smaller x
    turned = sg.xray.single_scatter(slab(column_direction=-1, row_direction=1), rays=1).image
    assert np.allclose(turned[::-1, ::-1], sg.xray.single_scatter(slab(), rays=1).image, rtol=1e-12)


def test_cells_beside_the_target_give_nothing():
    scene = slab()
    ball = Solid(name="ball", role="target", material="water", shape=Ellipsoid(centre=(6, 6, 220), semi_axes=(5, 5, 5)))
    found = sg.xray.single_scatter(scene.model_copy(update={"solids": (ball,)}), rays=8)
    assert found.image[2, 0] == 0
    assert np.isnan(found.depth95[2, 0])
    assert (found.image > 0).sum() < 12
    assert np.nanmax(found.depth95) < 10


def test_efficiency_scales_and_a_high_threshold_leaves_nothing():
    scene = slab()
    whole = sg.xray.single_scatter(scene, rays=1).image
    for update, share in (({"efficiency": 0.25}, 0.25), ({"threshold": 69.0}, 0.0)):
        plate = scene.detectors[0].model_copy(update=update)
        assert np.allclose(
            sg.xray.single_scatter(scene.model_copy(update={"detectors": (plate,)}), rays=1).image, share * whole
        )


def test_scenes_that_cannot_be_computed_are_refused(tmp_path):
    scene = slab()
    np.save(tmp_path / "cells.npy", np.zeros((2, 2, 2), int))
    cells = Voxels(file=str(tmp_path / "cells.npy"), materials=("water",), pitch=(5, 5, 5), corner=(0, 0, 200))
    voxels = Solid(name="cells", role="target", shape=cells)
    for changed, message in (
        ({"mask": None}, "mask"),
        ({"solids": ()}, 'role = "target"'),
        ({"solids": (voxels,)}, "voxels"),
        ({"detectors": ()}, "detector"),
    ):
        with pytest.raises(ValueError, match=message):
            sg.xray.single_scatter(scene.model_copy(update=changed))
    with pytest.raises(ValueError, match="rays"):
        sg.xray.single_scatter(scene, rays=0)
