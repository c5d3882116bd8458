"""Variance reduction changes no mean: the same scenes analog and reduced, tally by tally; and the errors reported are true.

Seeded. Single numbers must agree within 4 combined standard deviations (about 1e-4 of false alarms with errors from 128
batches), spectra, images and orders by a chi-square test at 6e-5. That makes about 250 comparisons: for one of 50 choices
of seeds one would fail.
"""

import math

import numpy as np
import pytest
from scipy import stats

from shadowgram.xray import scene as sc
from shadowgram.xray._compile import compile_scene
from shadowgram.xray.montecarlo.arrays import ORDERS
from shadowgram.xray.montecarlo.run import batch_phase_space, run_setup
from shadowgram.xray.simulation import prepare

ALARM = 6e-5
ANALOG, REDUCED = 2_500_000, 400_000
CUBE = """v 0 0 0
v 1 0 0
v 0 1 0
v 1 1 0
v 0 0 1
v 1 0 1
v 0 1 1
v 1 1 1
f 1 3 4 2
f 5 6 8 7
f 1 2 6 5
f 3 7 8 4
f 1 5 7 3
f 2 4 8 6
"""


def solid(name, shape, material="water", role="target"):
    return sc.Solid(name=name, material=None if isinstance(shape, sc.Voxels) else material, shape=shape, role=role)


def box(name, centre, size, material="water", role="target", **shape):
    return solid(name, sc.Box(centre=centre, size=size, **shape), material, role)


def crystal(name, centre, size, material="sodium iodide", **changes):
    return sc.Detector(name=name, centre=centre, size=size, material=material, **changes)


def source(energy=60, **changes):
    spectrum = energy if isinstance(energy, dict) else {"energy": energy}
    values = {"position": (0, 0, -100), "half_angle": 0.3, "spectrum": spectrum, "activity": 1}
    return sc.Source(**values | changes)


ABOVE, BESIDE = crystal("above", (0, 100, -40), (150, 20, 100)), crystal("beside", (110, 0, -30), (20, 100, 60))
SLAB = box("slab", (0, 0, 50), (100, 100, 20))


def scene(*solids, **changes):
    values = {
        "world": sc.World(size=(800, 800, 800)),
        "source": source(),
        "solids": solids,
        "detectors": (ABOVE, BESIDE),
    }
    return sc.Scene(**values | changes)


def boxes(folder):
    tilted = box("tilted", (30, 0, 40), (40, 50, 30), "aluminum", rotation=(0.3, 0.2, 0.5))
    return scene(box("box", (-25, 0, 30), (40, 60, 20)), tilted)


def overlapping(folder):
    return scene(
        box("slab", (0, 0, 40), (100, 100, 30)),
        solid("egg", sc.Ellipsoid(centre=(10, 5, 40), semi_axes=(30, 20, 12)), "iron"),
        solid("hole", sc.Cylinder(radius=8, start=(10, 5, 20), end=(10, 5, 60)), "air", "environment"),
        solid("lid", sc.Ellipsoid(centre=(-10, -5, 30), semi_axes=(20, 20, 8)), "lead", "shield"),
    )


def mesh(folder):
    (folder / "cube.obj").write_text(CUBE)
    cube = sc.Mesh(file=str(folder / "cube.obj"), scale=50, rotation=(0.4, 0.3, 0.2), translation=(-25, -25, 30))
    return scene(solid("cube", cube), box("core", (0, 0, 55), (10, 10, 10), "aluminum"))


def voxels(folder):
    """Voxels with a box painted into them, behind a box."""
    np.save(folder / "cells.npy", np.random.default_rng(3).integers(0, 3, (8, 8, 4)))
    cells = sc.Voxels(
        file=str(folder / "cells.npy"),
        materials=("air", "water", "tin"),
        pitch=(8, 8, 8),
        corner=(-30, -30, 30),
        rotation=(0.2, -0.1, 0.3),
    )
    return scene(
        solid("cells", cells), box("core", (0, 0, 40), (20, 20, 10), "aluminum"), box("front", (0, 0, 0), (20, 100, 5))
    )


def outline(folder):
    return scene(solid("UD", sc.Outline(centre=(0, 0, 40), text="UD", height=60, thickness=10), "aluminum"))


def ellipsoid_in_air(folder):
    return scene(solid("egg", sc.Ellipsoid(centre=(0, 0, 60), semi_axes=(50, 40, 30))))


def fog(folder):
    """Air that scatters as much as the target does."""
    thick = sc.Composition(name="fog", density=0.05, fractions={"N": 0.755, "O": 0.232, "H": 0.013})
    return scene(
        box("block", (0, 0, 60), (60, 60, 20), "aluminum"), world=sc.World(size=(500, 500, 500), material=thick)
    )


def nothing(folder):
    return scene(source=source(half_angle=0.5))


def shields(folder):
    return scene(
        box("roof", (0, 40, -30), (150, 3, 100), "lead", "shield"),
        box("shutter", (0, 0, 0), (40, 40, 0.3), "tungsten", "shield"),
        box("foil", (0, 60, -40), (150, 1, 100), "tin", "shield"),
        SLAB,
    )


def covers(folder):
    """Silicon that touches a crystal, aluminium that does not, a floor that its assembly reaches down to, and a target in there."""
    return scene(
        SLAB,
        box("cover", (0, 87.5, -40), (200, 5, 140), "silicon", "environment"),
        box("window", (0, 60, -40), (200, 3, 140), "aluminum", "environment"),
        box("pillar", (150, 85, -40), (20, 60, 300), "aluminum", "environment"),
        box("foot", (130, 100, 60), (15, 20, 20)),
        cutoff=8,
        detectors=(ABOVE, crystal("beside", (129, 0, -30), (20, 100, 60))),
    )


def shared_cover(folder):
    """Two crystals behind one cover, whose assemblies begin at the same place, and a third one behind them."""
    return scene(
        SLAB,
        box("cover", (0, 80, -40), (300, 4, 200), "silicon", "environment"),
        detectors=(
            crystal("left", (-60, 92, -40), (80, 20, 80)),
            crystal("right", (60, 92.5, -40), (80, 20, 80)),
            crystal("behind", (0, 140, -60), (200, 20, 80)),
        ),
    )


def one_behind_another(folder):
    """What flies through the aluminium on to the other crystal is sent there once, not twice."""
    return scene(
        box("slab", (0, 0, 30), (80, 80, 20)),
        detectors=(
            crystal("thin", (100, 0, -40), (20, 60, 60), "aluminum"),
            crystal("thick", (140, 0, -60), (20, 60, 60)),
        ),
    )


def dark_plate_behind_a_crystal(folder):
    """What comes back from the plate adds to the pulse that it had left: with a weight, it would not."""
    return scene(
        box("plate", (0, 0, 11.1), (100, 100, 20), "aluminum", "environment"),
        world=sc.World(size=(800, 800, 800), material="vacuum"),
        source=source(30, half_angle=0.05),
        cutoff=8,
        detectors=(crystal("thin", (0, 0, 0), (100, 100, 2), "silicon", threshold=0.5),),
    )


def gold_k(folder):
    return scene(
        box("leaf", (0, 0, 50), (100, 100, 2), "gold"),
        box("slab", (0, 0, 70), (100, 100, 20)),
        source=source(100),
        cutoff=15,
    )


def gold_l(folder):
    return scene(
        box("leaf", (0, 0, 50), (100, 100, 2), "gold"),
        source=source(30),
        detectors=(crystal("above", (0, 100, -40), (150, 20, 100), threshold=3),),
    )


def pixels_blur_and_efficiency(folder):
    camera = crystal("camera", (0, 0, -150), (300, 300, 20), pixels=(5, 7), resolution=0.1, efficiency=0.7)
    return scene(SLAB, detectors=(camera,), source=source({"energies": (30, 60, 90), "weights": (1, 2, 3), "width": 4}))


def transmission(folder):
    """Crystals in the beam, behind everything."""
    return scene(
        SLAB,
        box("wall", (0, 0, 80), (100, 100, 10), "water", "environment"),
        box("strip", (30, 0, 100), (50, 100, 1), "lead", "shield"),
        detectors=(crystal("front", (0, 0, 150), (80, 80, 20)), crystal("back", (0, 0, 180), (200, 200, 20))),
    )


def mask(folder):
    coded = sc.Mask(
        material="tungsten",
        pitch=5,
        depth=2,
        rows=8,
        columns=8,
        plate=(60, 60),
        pattern={"transmittance": 0.5, "seed": 1},
    )
    return scene(box("slab", (0, 0, 80), (100, 100, 20)), mask=coded)


def near(folder):
    """A target within 30 mm of a crystal, where no photons are sent."""
    return scene(box("close", (0, 70, -40), (100, 30, 100)), SLAB, source=source(half_angle=1.5))


def high_cutoff(folder):
    return scene(SLAB, cutoff=50)


SCENES = {
    boxes: 8,
    overlapping: 8,
    mesh: 10,
    voxels: 2,
    outline: 8,
    ellipsoid_in_air: 10,
    fog: 8,
    nothing: 10,
    shields: 10,
    covers: 3,
    shared_cover: 8,
    one_behind_another: 20,
    dark_plate_behind_a_crystal: 0.3,
    gold_k: 5,
    gold_l: 10,
    pixels_blur_and_efficiency: 8,
    transmission: 0.5,
    mask: 8,
    near: 0.5,
    high_cutoff: 20,
}
"""With the least that a history is worth when reduced, in analog ones; 1 and less where most counts are direct."""


@pytest.fixture(scope="module", params=list(SCENES), ids=lambda made: made.__name__)
def both(request, tmp_path_factory):
    """(what made the scene, analog run, reduced run)."""
    compiled = compile_scene(request.param(tmp_path_factory.mktemp("bodies")))
    analog = run_setup(prepare(compiled, variance_reduction=False), histories=ANALOG, seed=1)
    reduced = run_setup(prepare(compiled, variance_reduction=True), histories=REDUCED, seed=2)
    assert analog.tallies.keys() == reduced.tallies.keys()
    return request.param, analog.tallies, reduced.tallies


def apart(analog, reduced):
    """In combined standard deviations."""
    error = np.hypot(analog.standard_error, reduced.standard_error)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(error > 0, (reduced.mean - analog.mean) / error, 0.0)


def test_totals_agree(both):
    _, analog, reduced = both
    checked = [name for name, one in analog.items() if one.mean.ndim == 0]
    assert {"all", "energy/started", "escaped/backward"} < set(checked)
    for name in checked:
        assert abs(apart(analog[name], reduced[name])) < 4, name


def test_orders_spectra_and_images_agree(both):
    _, analog, reduced = both
    checked = [name for name, one in analog.items() if one.mean.ndim]
    assert any(name.endswith("/spectrum") for name in checked)
    for name in checked:
        # Enough in both for a normal law of their errors.
        often = (analog[name].mean * ANALOG > 100) & (reduced[name].relative_error < 0.3)
        if often.any():
            squares = (apart(analog[name], reduced[name])[often] ** 2).sum()
            assert stats.chi2.sf(squares, often.sum()) > ALARM, name
        # And what one never finds, the other finds seldom.
        never = analog[name].mean == 0
        assert reduced[name].mean[never].sum() * ANALOG < 20 + 0.2 * never.sum(), name


def test_errors_are_smaller(both):
    made, analog, reduced = both
    worth = analog["all"].standard_error ** 2 * ANALOG / (reduced["all"].standard_error ** 2 * REDUCED)
    print(f"a history is worth {worth:.1f} analog ones")
    assert worth > SCENES[made]


def test_orders_say_what_photons_did(both):
    made, analog, reduced = both
    for tallies in (analog, reduced):
        found = {order: float(x) for order, x in zip(ORDERS, tallies["all/orders"].mean, strict=True)}
        assert sum(found.values()) == pytest.approx(float(tallies["all"].mean), rel=1e-9)
        seen = {order for order, x in found.items() if x > 0}
        if made is nothing:
            assert seen == {"air"}
        elif made is dark_plate_behind_a_crystal:
            assert seen == {"environment", "direct"}
        elif made in (boxes, outline, ellipsoid_in_air, one_behind_another):
            assert (
                {"single", "multiple", "rayleigh", "air"}
                <= seen
                <= {"single", "multiple", "rayleigh", "air", "fluorescence"}
            )
        elif made in (gold_k, gold_l):
            assert found["fluorescence"] > 0.3 * sum(found.values())
        elif made is shields:
            assert {"shield", "leak", "single"} <= seen
        elif made is transmission:
            assert found["direct"] > 0.1 * sum(found.values())


@pytest.mark.parametrize("made", [one_behind_another, shared_cover, transmission])
def test_as_many_photons_enter_the_detectors(made, tmp_path):
    """By the records of those that do, in 20 batches."""
    compiled = compile_scene(made(tmp_path))
    number = len(compiled.detector_names)
    found = []
    for reduce, size in ((False, 50_000), (True, 10_000)):
        setup = prepare(compiled, variance_reduction=reduce)
        sums = []
        for i in range(20):
            photons = batch_phase_space(setup, 5, i * size, (i + 1) * size)
            sums.append(np.bincount(photons[:, 9].astype(int), photons[:, 7], minlength=number) / size)
            np.testing.assert_allclose((photons[:, 3:6] ** 2).sum(axis=1), 1, rtol=1e-12)
        found.append((np.mean(sums, axis=0), np.std(sums, axis=0, ddof=1) / math.sqrt(20)))
    (analog, error), (reduced, other) = found
    assert (np.abs(analog - reduced) < 4 * np.hypot(error, other)).all()


# ---- the errors that are reported --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("reduce", [False, True], ids=["analog", "reduced"])
def test_standard_errors_are_those_of_the_means(reduce):
    """60 seeds: the spread of the means against the errors that each run reports. Twice 3e-5 of false alarms for each tally."""
    setup = prepare(compile_scene(pixels_blur_and_efficiency(None)), variance_reduction=reduce)
    seeds, names = 60, ("all", "camera", "deposited/slab", "escaped/backward", "energy/escaped")
    found = {name: [] for name in (*names, "orders", "image")}
    for seed in range(seeds):
        tallies = run_setup(setup, histories=4_000 if reduce else 40_000, seed=seed).tallies
        for name in names:
            found[name].append((tallies[name].mean, tallies[name].standard_error))
        found["orders"].append((tallies["all/orders"].mean[0], tallies["all/orders"].standard_error[0]))
        found["image"].append((tallies["camera/image"].mean[2, 3], tallies["camera/image"].standard_error[2, 3]))
    for name, pairs in found.items():
        mean, error = np.array(pairs).T
        weight = 1 / np.mean(error**2)
        squares = ((mean - mean.mean()) ** 2).sum() * weight
        chance = stats.chi2.cdf(squares, seeds - 1)
        print(f"{name}: spread over error {math.sqrt(squares / (seeds - 1)):.3f}")
        assert 3e-5 < chance < 1 - 3e-5, name
