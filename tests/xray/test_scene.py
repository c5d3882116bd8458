"""Scenes as files and as objects: reading, writing, faults in a line, patterns, pictures."""

import math
import tomllib
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image
from pydantic import ValidationError

from shadowgram.codes import random as random_code
from shadowgram.figures import xray_scene
from shadowgram.figures._surfaces import surface
from shadowgram.figures.style import style
from shadowgram.scenes.readers.mat5 import mat5_bytes
from shadowgram.xray import scene as sc
from shadowgram.xray._parts import in_words, unit_vector
from shadowgram.xray._placed import place, volume
from shadowgram.xray._png import read_png
from shadowgram.xray._toml import to_toml
from shadowgram.xray.materials import material
from shadowgram.xray.patterns import check_pattern, random_pattern, read_pattern, read_written, written
from shadowgram.xray.spectra import Spectrum

BASE = """
title = "base"
[world]
size = [1000, 1000, 1000]
[source]
position = [0, 0, -200]
half_angle = 0.3
activity = 1e6
spectrum = { energy = 60 }
[mask]
material = "tungsten"
pitch = 2
depth = 2
rows = 4
columns = 9
view = 4
plate = [20, 10]
pattern = { transmittance = 0.5, seed = 3 }
[[solids]]
name = "block"
role = "target"
material = "water"
shape = { kind = "box", centre = [0, 0, 105], size = [10, 10, 10] }
[[detectors]]
name = "plate"
centre = [200, 0, 50]
size = [100, 100, 20]
material = "NaI"
"""


def changed(change):
    values = tomllib.loads(BASE)
    change(values)
    return to_toml(values)


def at(*path, value):
    """A change that puts a value at a place."""

    def change(values):
        for step in path[:-1]:
            values = values[step]
        values[path[-1]] = value

    return change


def without(*path):
    def change(values):
        for step in path[:-1]:
            values = values[step]
        del values[path[-1]]

    return change


def another(key, **parts):
    """A change that adds a copy of the first solid or detector with other parts."""
    return lambda values: values[key].append({**values[key][0], **parts})


def box(centre, size):
    return {"kind": "box", "centre": list(centre), "size": list(size)}


FAULTS = [
    (at("sauce", value=1), r"^unknown key sauce$"),
    (at("solids", 0, "shape", "sise", value=1), r"^unknown key solids\[0\] \(block\) shape\.sise$"),
    (without("world"), r"^world is missing$"),
    (without("solids", 0, "material"), r"^solids\[0\] \(block\): the key 'material' is missing$"),
    (at("world", "size", value=[1000, math.nan, 1000]), r"^world\.size\[1\] should be a finite number, got nan$"),
    (at("source", "position", value=[0, 0, math.inf]), r"^source\.position\[2\] should be a finite number"),
    (at("source", "position", value=[0, 0]), r"^source\.position\[2\] is missing$"),
    (at("source", "activity", value=0), r"^source\.activity should be greater than 0, got 0$"),
    (at("source", "activity", value=-1.5), r"^source\.activity should be greater than 0, got -1\.5$"),
    (
        at("source", "current", value=1),
        r"^source: say how strong the source is: activity in photons/s, or current in mA$",
    ),
    (without("source", "activity"), r"^source: say how strong the source is"),
    (at("source", "half_angle", value=-0.1), r"^source\.half_angle should be greater than or equal to 0, got -0\.1$"),
    (at("source", "direction", value=[0, 0, 0]), r"^source\.direction: a direction must have a length"),
    (at("source", "spectrum", value={}), r"^source\.spectrum: say the spectrum in one way: energy"),
    (at("source", "spectrum", value={"energy": 60, "shipped": "tube-120kV-1.5mmAl"}), r"say the spectrum in one way"),
    (at("source", "spectrum", value={"energy": 600}), r"photons start with 1 to 512 keV, the spectrum has 600 to 600"),
    (at("source", "spectrum", value={"energy": 1.2, "width": 1}), r"has 1\.2 to 1\.2 with bins of 1$"),
    (at("source", "spectrum", value={"energies": [50, 40], "weights": [1, 1]}), r"must rise, but 40 keV"),
    (
        at("source", "spectrum", value={"shipped": "other"}),
        r"^source\.spectrum\.shipped should be 'tube-120kV-1.5mmAl'",
    ),
    (at("source", "position", value=[0, 0, 105]), r"^the source at \(0, 0, 105\) mm lies in the solid 'block'; move"),
    (at("source", "position", value=[200, 0, 50]), r"^the source at \(200, 0, 50\) mm lies in the detector 'plate'"),
    (at("source", "position", value=[1, 0, 0]), r"^the source at \(1, 0, 0\) mm lies in the plate of the mask"),
    (at("source", "position", value=[0, 0, -600]), r"^the source at \(0, 0, -600\) mm is outside the world"),
    (
        at("solids", 0, "material", value="watr"),
        r"^solids\[0\] \(block\) material: there is no material 'watr'; .*water",
    ),
    (at("solids", 0, "material", value={"formula": "C6H6"}), r"say the density of C6H6"),
    (at("solids", 0, "material", value={"density": 1.0}), r"material: say a name, a formula or fractions$"),
    (
        at("solids", 0, "material", value={"formula": "H2O", "fractions": {"H": 1}, "density": 1}),
        r"a formula or fractions, not both",
    ),
    (at("solids", 0, "material", value={"name": "water", "density": 0}), r"material\.density should be greater than 0"),
    (at("solids", 0, "role", value="goal"), r"role should be 'environment', 'target' or 'shield', got 'goal'$"),
    (at("solids", 0, "name", value="a/b"), r"name should match pattern|name should"),
    (at("solids", 0, "name", value="plate"), r"^the name 'plate' is taken"),
    (at("solids", 0, "name", value="world"), r"^the name 'world' is taken"),
    (at("detectors", 0, "name", value="all"), r"^a detector cannot be called 'all'"),
    (
        at("solids", 0, "shape", "kind", value="bx"),
        r"^solids\[0\] \(block\) shape: kind must be one of 'box', .*got 'bx'$",
    ),
    (without("solids", 0, "shape", "kind"), r"^solids\[0\] \(block\) shape: say its kind, such as kind = 'box'$"),
    (
        at("solids", 0, "shape", "size", value=[1, -1, 1]),
        r"^solids\[0\] \(block\) shape\.size\[1\] should be greater than 0, got -1$",
    ),
    (at("solids", 0, "shape", "size", value=[1, "2", 1]), r"shape\.size\[1\] should be a valid number, got '2'$"),
    (
        at("solids", 0, "shape", value=box((0, 0, 500), (10, 10, 10))),
        r"^the solid 'block' reaches out of the world: z from 495",
    ),
    (
        at("detectors", 0, "centre", value=[480, 0, 0]),
        r"^the detector 'plate' reaches out of the world: x from 430 to 530 mm",
    ),
    (at("mask", "position", value=[492, 0, 0]), r"^the plate of the mask reaches out of the world"),
    (
        at("solids", 0, "shape", value=box((190, 0, 50), (90, 10, 10))),
        r"^the detector 'plate' and the solid 'block' overlap",
    ),
    (
        another("detectors", name="two", centre=[200, 99, 50]),
        r"^the detectors 'plate' and 'two' overlap; move them apart$",
    ),
    (at("detectors", 0, "centre", value=[50, 0, 0]), r"^the plate of the mask runs into the detector 'plate'"),
    (at("detectors", 0, "resolution", value=1.0), r"^detectors\[0\] \(plate\) resolution should be less than 1"),
    (
        at("detectors", 0, "pixels", value=[0, 1]),
        r"^detectors\[0\] \(plate\) pixels\[0\] should be greater than or equal to 1",
    ),
    (
        at("mask", "plate", value=[20, 7]),
        r"^mask: 9 × 4 cells of 2 mm take 18 × 8 mm, more than the plate's 20 × 7 mm$",
    ),
    (at("mask", "view", value=10), r"^mask: 10 columns cannot be in view of a mask that has 9$"),
    (at("mask", "pattern", value={}), r"^mask\.pattern: say the pattern in one way"),
    (at("mask", "pattern", value={"transmittance": 0.5}), r"a random pattern has a transmittance and a seed$"),
    (at("mask", "pattern", value={"rows": ["01", "1"]}), r"texts of 0 and 1 of one length"),
    (
        at("mask", "pattern", value={"rows": ["01", "10"]}),
        r"^mask: the mask has 4 rows and 9 columns, but its pattern 2 and 2$",
    ),
    (at("mask", "column_direction", value=2), r"^mask\.column_direction should be 1 or -1, got 2$"),
    (
        at("shots", value=7),
        r"^7 shots cannot be taken: with a mask of 9 columns, 4 in view, there can be 6 shots at most$",
    ),
    (
        lambda v: (v.pop("mask"), v.update(shots=2)),
        r"^2 shots cannot be taken: with no mask there can be one shot only$",
    ),
    (at("exposure", value=0), r"^exposure should be greater than 0, got 0$"),
    (at("cutoff", value=0.5), r"^cutoff should be greater than or equal to 1, got 0\.5$"),
    (
        at("solids", 0, "shape", value={"kind": "cylinder", "radius": 1}),
        r"say start and end of the cylinder, or its centre",
    ),
    (
        at("solids", 0, "shape", value={"kind": "cylinder", "radius": 1, "start": [0, 0, 90], "end": [0, 0, 90]}),
        r"the cylinder has no length",
    ),
    (
        at(
            "solids",
            0,
            "shape",
            value={"kind": "cylinder", "radius": 1, "start": [0, 0, 90], "end": [0, 0, 99], "length": 4},
        ),
        r"say start and end of the cylinder, or its centre",
    ),
    (at("solids", 0, "shape", value={"kind": "outline", "thickness": 1}), r"say the points of the outline, or a text"),
    (
        at("solids", 0, "shape", value={"kind": "outline", "thickness": 1, "text": "?", "height": 5}),
        r"^the solid 'block': there are letters for A to Z and 0 to 9 only",
    ),
    (
        at("solids", 0, "shape", value={"kind": "outline", "thickness": 1, "points": [[0, 0], [2, 2], [2, 0], [0, 2]]}),
        r"^the solid 'block': loop 0 of the outline cross or touch",
    ),
]


@pytest.mark.parametrize(("change", "message"), FAULTS, ids=[message[:50] for _, message in FAULTS])
def test_a_fault_is_said_in_one_line(change, message):
    with pytest.raises(ValueError, match=message) as caught:
        sc.parse_scene(changed(change))
    assert "\n" not in str(caught.value)


def test_the_base_scene_is_possible():
    scene = sc.parse_scene(BASE)
    assert scene.photons_per_shot == 1e6
    assert scene.solids[0].shape == sc.Box(centre=(0, 0, 105), size=(10, 10, 10))


def test_a_file_that_is_no_scene_is_named(tmp_path):
    path = tmp_path / "a.toml"
    with pytest.raises(FileNotFoundError, match=r"there is no file .*a\.toml"):
        sc.read_scene(path)
    with pytest.raises(IsADirectoryError, match="is a folder"):
        sc.read_scene(tmp_path)
    path.write_text("x = = 1")
    with pytest.raises(ValueError, match=r"a\.toml: it is not TOML: Invalid value"):
        sc.read_scene(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match=r"a\.toml: .*decode"):
        sc.read_scene(path)
    path.write_text(changed(without("world")))
    with pytest.raises(ValueError, match=r"a\.toml: world is missing"):
        sc.read_scene(path)


def test_three_faults_are_said_and_the_rest_counted():
    def change(values):
        values["world"]["size"] = [-1, -1, -1]
        values["source"]["activity"] = values["exposure"] = -1

    with pytest.raises(ValueError, match=r"^exposure .*; world\.size\[0\] .*; world\.size\[1\] .*; and 2 more$"):
        sc.parse_scene(changed(change))


def test_without_values_faults_have_places_too():
    with pytest.raises(ValidationError) as caught:
        sc.Solid.model_validate({"name": "a", "material": "water", "shape": {"kind": "box", "size": [1, 1, 0]}})
    assert in_words(caught.value) == "shape.box.size[2] should be greater than 0, got 0"


@pytest.mark.parametrize("name", sc.shipped_scenes())
def test_shipped_scenes_come_back_from_their_text(name):
    scene = sc.shipped_scene(name)
    assert sc.parse_scene(scene.toml()) == scene
    assert scene.title


def test_an_unknown_shipped_scene_is_refused():
    with pytest.raises(ValueError, match="no scene 'x' in the package; it has cxbi-blocks"):
        sc.shipped_scene("x")


def everything(folder):
    """A scene with one of each."""
    shapes = [
        sc.Box(centre=(100, 0, 100), size=(10, 20, 30), rotation=(0.1, 0.2, 0.3)),
        sc.Ellipsoid(centre=(-100, 0, 100), semi_axes=(10, 20, 30), rotation=(0.1, 0, 0)),
        sc.Cylinder(radius=1 / 3, start=(0, 0, 90), end=(10, 10, 95)),
        sc.Cylinder(radius=5, centre=(0, 50, 100), length=20, axis=(1, 1, 0), rotation=(0, 0, 0.5)),
        sc.Outline(
            centre=(0, -100, 100), points=((0, 0), (9, 0), (0, 9)), holes=(((1, 1), (3, 1), (1, 3)),), thickness=2
        ),
        sc.Outline(centre=(0, -150, 100), text="UD", height=20, thickness=2),
        sc.Mesh(file=str(folder / "a.stl"), scale=10, rotation=(0, 0.1, 0), translation=(1, 2, 3)),
    ]
    solids = [sc.Solid(name=f"solid {i}", material="Al", shape=shape) for i, shape in enumerate(shapes)]
    mixture = sc.Composition(name="x", fractions={"N": 0.7, "O": 0.3}, density=1e-3)
    voxels = sc.Voxels(file=str(folder / "v.npy"), materials=("water", mixture), pitch=(1, 1, 1), corner=(300, 0, 0))
    solids.append(sc.Solid(name='vo"xe\\ls é', role="target", shape=voxels))
    return sc.Scene(
        title="all\tof it \x7f",
        shots=3,
        exposure=1 / 3,
        cutoff=10,
        world=sc.World(size=(1000, 1000, 1000), centre=(0, 0, 1), material="vacuum"),
        source=sc.Source(
            position=(0, 0, -200),
            direction=(1, 2, 30),
            half_angle=0.1,
            focal_spot=(1, 0.5),
            spectrum={
                "tube": {"voltage": 120, "filters": [("Al", 1.5), ("Cu", 0.1)], "anode_angle": 0.3},
                "width": 0.5,
            },
            current=0.1,
        ),
        mask=sc.Mask(
            material="W",
            pitch=2,
            depth=1,
            rows=2,
            columns=5,
            view=3,
            plate=(12, 8),
            pattern=np.array([[0, 1, 0, 1, 1], [1, 1, 0, 0, 0]]),
            row_direction=1,
        ),
        solids=solids,
        detectors=[
            sc.Detector(name="d", centre=(0, 0, -400), size=(9, 9, 9), material="CsI", pixels=(3, 4), resolution=0.07)
        ],
    )


def test_any_scene_comes_back_from_its_text(tmp_path):
    scene = everything(tmp_path)
    assert sc.parse_scene(scene.toml(), "elsewhere") == scene
    assert sc.parse_scene(sc.parse_scene(scene.toml()).toml()) == scene


def test_long_patterns_stay_readable_in_the_text():
    code = random_pattern(32, 543, 0.5, seed=1)
    mask = sc.Mask(material="W", pitch=2, depth=2, rows=32, columns=543, plate=(1100, 70), pattern=code)
    scene = sc.parse_scene(BASE).model_copy(update={"mask": mask})
    assert max(map(len, scene.toml().splitlines())) < 600
    again = sc.parse_scene(
        changed(at("mask", value=tomllib.loads(scene.toml())["mask"])).replace("size = [1000", "size = [1500")
    )
    assert np.array_equal(again.mask.cells(), code)


def test_file_names_are_relative_to_the_scene(tmp_path):
    folder = tmp_path / "inner"
    folder.mkdir()
    (folder / "scene.toml").write_text(changed(at("mask", "pattern", value={"file": "../codes/a.npy"})))
    (tmp_path / "codes").mkdir()
    pattern = random_pattern(4, 9, 0.5, seed=8)
    np.save(tmp_path / "codes" / "a.npy", pattern)
    scene = sc.read_scene(folder / "scene.toml")
    assert scene.mask.pattern.file == str(tmp_path / "codes" / "a.npy")
    assert np.array_equal(scene.mask.cells(), pattern)


def test_python_takes_numpy_spectra_and_materials():
    source = sc.Source(
        position=np.array([0, 0, -1.0]),
        half_angle=np.float32(0.5),
        spectrum=Spectrum(energy=np.array([20.0, 30.0]), weight=np.array([1.0, 3.0])),
        activity=np.int64(5),
    )
    assert source.position == (0.0, 0.0, -1.0)
    assert source.spectrum.spectrum().mean_energy == 27.5
    copper = sc.Solid(name="a", material=material("Cu"), shape=sc.Box(size=np.ones(3)))
    assert copper.material.material() == material("Cu")
    assert sc.Solid(name="a", material="vacuum", shape=sc.Box(size=(1, 1, 1))).material.material().density < 1e-20


def test_materials_are_what_they_are_said_to_be():
    assert sc.Composition(formula="C4H8N8O8", density=1.91).material().fractions == material("HMX").fractions
    assert sc.Composition(name="my explosive", formula="C4H8N8O8", density=1.91).material().name == "my explosive"
    assert sc.Composition(name="sodium iodide", density=3.5).material().density == 3.5
    air = sc.shipped_scene("cxbi-ud").world.material.material()
    assert air.elements == (7, 8, 1)
    assert air.density == 1.29e-3
    assert sc.World(size=(1, 1, 1)).material.material() == material("air")


def test_strength_of_sources():
    # Salazar (2022), 4.5.1: 6.4e8 photons/s are 5.12 nA.
    source = sc.Source(position=(0, 0, 0), spectrum={"energy": 60}, current=5.12e-6)
    assert source.photons_per_second == pytest.approx(6.4e8, rel=2e-3)
    scene = sc.shipped_scene("cxbi-blocks")
    assert scene.photons_per_shot == pytest.approx(1e7)
    assert scene.source.solid_angle == pytest.approx(0.2908, abs=5e-5)  # half angle 17.5°
    for half_angle, whole in ((math.pi, 4 * math.pi), (math.pi / 2, 2 * math.pi), (0.0, 0.0)):
        cone = sc.Source(position=(0, 0, 0), spectrum={"energy": 60}, activity=1, half_angle=half_angle)
        assert cone.solid_angle == pytest.approx(whole)


def test_directions_are_made_unit_vectors_once():
    for vector in np.random.default_rng(0).normal(size=(200, 3)):
        once = unit_vector(tuple(vector))
        assert math.hypot(*once) == pytest.approx(1, abs=1e-15)
        assert unit_vector(once) == once


def test_spectra_by_each_way(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text("30, 1\n40, 0\n50, 1\n")
    assert sc.Energies(file=path).spectrum().energy.tolist() == [30, 50]  # nothing starts at 40 keV
    tube = sc.Energies(shipped="tube-120kV-1.5mmAl")
    assert (tube.spread, sc.Energies(energy=60.0).spread, sc.Energies(energy=60.0, width=2.0).spread) == (1, 0, 2)
    assert tube.spectrum().energy.max() < 120
    with pytest.raises(FileNotFoundError):
        sc.Energies(file=tmp_path / "none.csv").spectrum()


def test_the_mask_slides_a_column_a_shot():
    mask = sc.shipped_scene("cxbi-blocks").mask
    cells = mask.cells()
    assert cells.shape == (32, 543)
    assert mask.most_shots == 512
    for shot in (0, 1, 300, 511):
        assert np.array_equal(mask.code(shot), cells[:, shot : shot + 32])
        # Columns shot to shot + 31 lie about the axis.
        left = mask.plate_centre(shot)[0] - 543 / 2 * 2 + 2 * shot
        assert left == pytest.approx(-32)
    turned = mask.model_copy(update={"column_direction": -1})
    assert turned.plate_centre(0)[0] == -mask.plate_centre(0)[0]


def test_without_targets_nothing_else_is_gone():
    scene = sc.shipped_scene("cxbi-hand")
    air = scene.without_targets()
    assert {solid.role for solid in air.solids} == {"shield", "environment"}
    assert len(air.solids) == sum(solid.role != "target" for solid in scene.solids)
    assert air.detectors == scene.detectors
    assert sc.parse_scene(air.toml()) == air


def test_a_source_may_stand_in_a_hollow():
    housing = sc.Solid(
        name="housing", role="shield", material="lead", shape=sc.Box(centre=(0, 0, -200), size=(50, 50, 50))
    )
    hollow = sc.Solid(name="hollow", material="air", shape=sc.Box(centre=(0, 0, -190), size=(20, 20, 40)))
    scene = sc.parse_scene(BASE)
    parts = {name: getattr(scene, name) for name in ("world", "source", "mask", "detectors")}
    assert len(sc.Scene(**parts, solids=[housing, hollow]).solids) == 2
    with pytest.raises(ValidationError, match=r"lies in the solid 'housing'.*a later solid of the world's air"):
        sc.Scene(**parts, solids=[hollow, housing])


def test_letters_of_the_shipped_scene_are_where_the_author_had_them(data):
    file = data / "cxbi" / "UD1CM.stl"
    if not file.exists():
        pytest.skip("the author's mesh is not there")
    mesh = place(sc.Mesh(file=file, translation=(-110, -63, 500)))
    letters = [place(solid.shape) for solid in sc.shipped_scene("cxbi-ud").solids if solid.name in "UD"]
    assert np.min([one.low for one in letters], axis=0) == pytest.approx(mesh.low, abs=0.05)
    assert np.max([one.high for one in letters], axis=0) == pytest.approx(mesh.high, abs=0.05)
    assert sum(map(volume, letters)) == pytest.approx(volume(mesh), rel=2e-3)


def test_the_author_s_truth_agrees_with_the_place_of_the_letters(data):
    from scipy.io import loadmat

    from shadowgram.xray._placed import contains

    file = data / "cxbi" / "gate" / "ground_truth_UD_square.mat"
    if not file.exists():
        pytest.skip("the author's ground truth is not there")
    truth = loadmat(file)
    place_of = (np.arange(32) - 15.5) * 8.71
    x, y = np.meshgrid(place_of, -place_of)  # row 0 at the top
    beam = np.stack([r * np.array([math.cos(a), math.sin(a)]) for r in (0.6, 1.2, 1.6) for a in np.arange(0, 6.2, 0.7)])
    points = np.stack([x, y], axis=-1).reshape(-1, 1, 2) + beam
    points = np.concatenate([points, np.full((*points.shape[:2], 1), 505.0)], axis=-1).reshape(-1, 3)
    for name, key, weights in (("cxbi-ud", "UD", None), ("cxbi-blocks", "square", {"caffeine": 1.0, "HMX": 1.3})):
        image = np.zeros(32 * 32)
        for solid in sc.shipped_scene(name).solids:
            if solid.role == "target":
                share = contains(place(solid.shape), points).reshape(32 * 32, -1).mean(axis=1)
                image += share * (1.0 if weights is None else weights[solid.material.name])
        assert np.corrcoef(image, truth[key].ravel())[0, 1] > 0.96


# ---- patterns ----------------------------------------------------------------------------------------------------------------

CODE = random_pattern(5, 7, 0.4, seed=2)


def test_random_patterns_are_those_of_codes():
    assert np.array_equal(CODE, random_code(shots=1, shape=(5, 7), seed=2, transmittance=0.4)[0])
    assert np.array_equal(read_written(written(CODE)), CODE)


def save_npy(path):
    np.save(path, CODE)


def save_npz(path):
    np.savez(path, code=CODE[None].astype(bool), seed=np.array(3))


def save_mat(path):
    path.write_bytes(mat5_bytes({"code": CODE.astype(float), "pitch": np.array([[2.0]])}))


def save_mat73(path):
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        file["code"] = CODE.T
        file["code"].attrs["MATLAB_class"] = np.bytes_("uint8")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


def save_csv(path):
    path.write_text("# rows\n" + "\n".join(", ".join(map(str, row)) for row in CODE) + "\n\n")


def save_png(path):
    Image.fromarray(CODE * np.uint8(255)).save(path)


def save_nc(path):
    import xarray as xr

    from shadowgram.scenes.readers.native import write_dataset

    write_dataset(xr.Dataset({"code": (("shot", "y", "x"), CODE[None])}), path)


@pytest.mark.parametrize(
    ("suffix", "save"),
    [
        (".npy", save_npy),
        (".npz", save_npz),
        (".mat", save_mat),
        (".mat", save_mat73),
        (".csv", save_csv),
        (".png", save_png),
        (".nc", save_nc),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_patterns_come_back_from_files(tmp_path, suffix, save):
    path = tmp_path / f"code{suffix}"
    save(path)
    assert np.array_equal(read_pattern(path), CODE)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv", b"0 1\n1\n", r"cannot read the pattern .*a\.csv: line 2 has 1 columns, and the first one 2"),
        ("a.csv", b"0 x\n", "line 1 must be numbers, got '0 x'"),
        ("a.csv", b"0 1\n2 0\n", "a pattern has two values, 0 for closed and one for holes, got 3 from 0 to 2"),
        ("a.csv", b"-1 0\n", "a pattern has two values"),
        ("a.csv", b"nan 0\n", "a pattern has two values"),
        ("a.csv", b"", "a pattern has rows and columns of numbers"),
        ("a.csv", b"\xff\x00", "not a text file"),
        ("a.npy", b"\x93NUMPY", "truncated or damaged"),
        ("a.png", b"GIF", "does not begin like a PNG picture"),
        ("a.doc", b"0", r"arrays are read from \.npy, \.npz, \.mat and \.nc files, not from \.doc"),
    ],
)
def test_files_that_hold_no_pattern_are_refused(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=message):
        read_pattern(tmp_path / name)


def test_several_or_no_arrays_are_refused(tmp_path):
    np.savez(tmp_path / "two.npz", a=CODE, b=CODE)
    with pytest.raises(ValueError, match="several arrays of 2 axes"):
        read_pattern(tmp_path / "two.npz")
    np.save(tmp_path / "line.npy", CODE[0])
    with pytest.raises(ValueError, match="no array of 2 or 3 axes"):
        read_pattern(tmp_path / "line.npy")
    np.save(tmp_path / "objects.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(ValueError, match="no array"):
        read_pattern(tmp_path / "objects.npy")
    with pytest.raises(ValueError, match="rows and columns"):
        check_pattern(np.zeros((2, 5, 7)))


def test_png_pictures_of_all_kinds(tmp_path):
    rng = np.random.default_rng(1)
    grey = rng.integers(256, size=(37, 41), dtype=np.uint8)
    smooth = np.add.outer(np.arange(60), np.arange(90)).astype(np.uint8)  # makes the encoder use its filters
    colour = np.stack([smooth, smooth.T[:60, :60].repeat(2, axis=1)[:, :90], smooth[::-1]], axis=-1)
    pictures = {
        "grey": (Image.fromarray(grey), grey / 255),
        "smooth": (Image.fromarray(smooth), smooth / 255),
        "bit": (Image.fromarray(grey > 99), (grey > 99) * 1.0),
        "colour": (Image.fromarray(colour), colour.mean(axis=-1) / 255),
        "alpha": (Image.fromarray(np.dstack([colour, smooth])), colour.mean(axis=-1) / 255),
        "grey and alpha": (Image.fromarray(np.dstack([smooth, smooth])), smooth / 255),
        "deep": (Image.fromarray(smooth.astype(np.uint16) * 257), smooth / 255),
    }
    palette = Image.fromarray(grey // 64).convert("P")
    palette.putpalette([0, 0, 0, 30, 60, 90, 255, 255, 255, 3, 3, 3])
    pictures["palette"] = (palette, np.array([0, 60, 255, 3])[grey // 64] / 255)
    for name, (picture, expected) in pictures.items():
        path = tmp_path / f"{name}.png"
        picture.save(path)
        assert read_png(path) == pytest.approx(expected, abs=1e-12), name


def test_every_png_filter_is_undone(tmp_path):
    """A picture filtered by hand, line by line, as chapter 9 of the specification says."""
    import struct
    import zlib

    rng = np.random.default_rng(4)
    pixels = rng.integers(256, size=(10, 6, 3), dtype=np.uint8)
    raw, above = b"", np.zeros(18, int)
    for i, row in enumerate(pixels.reshape(10, 18).astype(int)):
        left, corner = np.r_[0, 0, 0, row[:-3]], np.r_[0, 0, 0, above[:-3]]
        guess = left + above - corner
        paeth = np.choose(
            np.argmin([abs(guess - left), abs(guess - above), abs(guess - corner)], axis=0), [left, above, corner]
        )
        filtered = row - [np.zeros(18, int), left, above, (left + above) // 2, paeth][i % 5]
        raw += bytes([i % 5]) + bytes((filtered % 256).tolist())
        above = row
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", 6, 10, 8, 2, 0, 0, 0)), (b"IDAT", zlib.compress(raw)), (b"IEND", b"")]
    data = b"\x89PNG\r\n\x1a\n"
    for kind, body in chunks:
        data += struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
    path = tmp_path / "filters.png"
    path.write_bytes(data)
    assert read_png(path) == pytest.approx(pixels.mean(axis=-1) / 255)
    assert np.asarray(Image.open(path)).tolist() == pixels.tolist()


def test_damaged_png_pictures_are_refused(tmp_path):
    path = tmp_path / "a.png"
    Image.fromarray(CODE * np.uint8(255)).save(path)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(300):
        damaged = bytearray(whole)
        damaged[rng.integers(8, len(whole))] ^= 1 << rng.integers(8)
        path.write_bytes(bytes(damaged[: rng.integers(len(whole) // 2, len(whole) + 1)]))
        try:
            read_pattern(path)
        except ValueError:
            continue
        pytest.fail("a damaged picture was read")


# ---- pictures ----------------------------------------------------------------------------------------------------------------


def closed_volume(polygons):
    """Volume inside a closed surface of flat polygons, whichever way each of them runs, seen from the middle of a convex body."""
    middle = np.concatenate(polygons).mean(axis=0)
    total = 0.0
    for polygon in polygons:
        a = polygon[0] - middle
        for b, c in pairwise(polygon[1:]):
            total += abs(np.dot(a, np.cross(b - middle, c - middle))) / 6
    return total


@pytest.mark.parametrize(
    ("shape", "error"),
    [
        (sc.Box(centre=(1, 2, 3), size=(4, 5, 6), rotation=(0.3, 0.2, 0.1)), 1e-9),
        (sc.Ellipsoid(semi_axes=(4, 5, 6), rotation=(0.3, 0.2, 0.1)), 0.03),
        (sc.Cylinder(radius=3, start=(0, 1, 2), end=(5, 4, 3)), 0.01),
        (sc.Outline(points=((0, 0), (4, 0), (5, 2), (0, 3)), thickness=2, rotation=(0, 1, 0)), 1e-9),
    ],
)
def test_drawn_surfaces_enclose_the_solids(shape, error):
    placed = place(shape)
    polygons = surface(placed)
    assert closed_volume(polygons) == pytest.approx(volume(placed), rel=error)
    points = np.concatenate(polygons)
    assert points.min(axis=0) == pytest.approx(placed.low, abs=0.1)
    assert points.max(axis=0) == pytest.approx(placed.high, abs=0.1)


def test_faces_with_holes_are_drawn_whole():
    square, hole = ((0, 0), (10, 0), (10, 10), (0, 10)), ((3, 3), (7, 3), (7, 7), (3, 7))
    polygons = surface(place(sc.Outline(points=square, holes=(hole,), thickness=2)))
    top = [p for p in polygons if (p[:, 2] == 1).all()]
    area = sum(abs(np.cross(p[2] - p[0], p[3] - p[1])[2]) / 2 for p in top)
    assert area == pytest.approx(84)


def test_voxels_are_drawn_by_the_sides_that_show(tmp_path):
    cells = np.zeros((4, 5, 6), np.uint8)
    cells[1:3, 1:3, 2:5] = 1
    np.save(tmp_path / "v.npy", cells)
    placed = place(sc.Voxels(file=tmp_path / "v.npy", materials=("air", "water"), pitch=(1, 2, 3), corner=(7, 7, 7)))
    polygons = surface(placed, np.array([False, True]))
    assert len(polygons) == 2 * (2 * 2 + 2 * 3 + 2 * 3)
    points = np.concatenate(polygons)
    assert points.min(axis=0).tolist() == [8, 9, 13]
    assert points.max(axis=0).tolist() == [10, 13, 22]


def test_pictures_are_written(tmp_path):
    path = tmp_path / "ud.png"
    xray_scene.draw(sc.shipped_scene("cxbi-ud"), path, shot=511)
    picture = np.asarray(Image.open(path).convert("RGB"))
    assert picture.shape == (960, 1760, 3)
    assert 0.01 < (picture != 255).any(axis=-1).mean() < 0.9


def test_pictures_of_small_scenes_and_of_one_with_everything(tmp_path):
    np.save(tmp_path / "v.npy", np.ones((4, 4, 4), int))
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    sides = ["1 3 4 2", "5 6 8 7", "1 2 6 5", "3 7 8 4", "1 5 7 3", "2 4 8 6"]
    text = "".join("v {} {} {}\n".format(*corner) for corner in corners) + "".join(f"f {side}\n" for side in sides)
    (tmp_path / "a.obj").write_text(text)
    scene = everything(tmp_path)
    mesh = sc.Solid(
        name="mesh", material="Al", shape=sc.Mesh(file=tmp_path / "a.obj", scale=10, translation=(0, 200, 50))
    )
    solids = (*(solid for solid in scene.solids if solid.shape.kind != "mesh"), mesh)
    with style():
        for one in (
            scene.model_copy(update={"solids": solids}),
            sc.shipped_scene("slab-water"),
            sc.shipped_scene("slab-water").without_targets(),
        ):
            assert xray_scene.picture(one).axes[0].get_xlabel() == "z (mm)"
