"""Scenes in arrays: every number that the transport kernels get."""

import math

import numpy as np
import pytest

from shadowgram.xray import scene as sc
from shadowgram.xray._alias import alias_table
from shadowgram.xray._compile import compile_scene
from shadowgram.xray._placed import across, contains, place, rotation_matrix, volume
from shadowgram.xray.materials import material
from shadowgram.xray.montecarlo import arrays

ROOM = sc.World(size=(1000, 1000, 1000))
SOURCE = sc.Source(position=(0, 0, -400), half_angle=0.3, spectrum={"energy": 60}, activity=1e6)
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
    return sc.Solid(name=name, material=material, shape=shape, role=role)


def room(*solids, **parts):
    return sc.Scene(**{"world": ROOM, "source": SOURCE, "solids": solids, **parts})


@pytest.fixture
def cube(tmp_path):
    path = tmp_path / "cube.obj"
    path.write_text(CUBE)
    return path


# ---- the alias table ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1, 2, 3, 17, 118, 1000])
def test_the_alias_table_gives_the_weights(size):
    rng = np.random.default_rng(size)
    for weights in (rng.random(size), rng.random(size) ** 20, np.ones(size), np.arange(size) + 1e-300):
        alias, keep = alias_table(weights)
        found = keep / size
        np.add.at(found, alias, (1 - keep) / size)
        assert found == pytest.approx(weights / weights.sum(), abs=1e-12)
        assert ((keep >= 0) & (keep <= 1)).all()
        assert ((alias >= 0) & (alias < size)).all()


def test_the_shipped_spectrum_comes_through_its_alias_table():
    source = compile_scene(sc.shipped_scene("cxbi-blocks")).source
    share = source.keep / source.energy.size
    np.add.at(share, source.alias, (1 - source.keep) / source.energy.size)
    spectrum = sc.Energies(shipped="tube-120kV-1.5mmAl").spectrum()
    assert source.energy.tolist() == spectrum.energy.tolist()
    assert share == pytest.approx(spectrum.weight / spectrum.total, abs=1e-12)
    assert source.width == 1.0


# ---- shapes ------------------------------------------------------------------------------------------------------------------

ANGLES = (0.4, -1.1, 2.3)
SHAPES = {
    "box": sc.Box(centre=(10, -20, 30), size=(8, 12, 5)),
    "turned box": sc.Box(centre=(10, -20, 30), size=(8, 12, 5), rotation=ANGLES),
    "ellipsoid": sc.Ellipsoid(centre=(1, 2, 3), semi_axes=(4, 9, 6)),
    "turned ellipsoid": sc.Ellipsoid(centre=(1, 2, 3), semi_axes=(4, 9, 6), rotation=ANGLES),
    "cylinder": sc.Cylinder(radius=5, centre=(1, 2, 3), length=7),
    "rod": sc.Cylinder(radius=2, start=(-4, 3, 1), end=(6, -2, 9)),
    "turned rod": sc.Cylinder(radius=2, start=(-4, 3, 1), end=(6, -2, 9), rotation=ANGLES),
    "rod against z": sc.Cylinder(radius=3, start=(0, 0, 9), end=(0, 0, 1)),
    "rod along x": sc.Cylinder(radius=3, length=10, axis=(-2, 0, 0)),
    "outline": sc.Outline(centre=(5, 5, 5), points=((0, 0), (9, 0), (2, 3), (0, 9)), thickness=4),
    "turned outline": sc.Outline(
        centre=(5, 5, 5),
        points=((-6, -6), (6, -6), (6, 6), (-6, 6)),
        holes=(((-2, -2), (3, -2), (0, 4)),),
        thickness=4,
        rotation=ANGLES,
    ),
    "letters": sc.Outline(text="UD8", height=20, thickness=3, rotation=ANGLES),
}


def inside_by_definition(shape, points):
    """Whether points lie in a shape, from its description alone."""
    if isinstance(shape, sc.Cylinder):
        start, end = shape.start, shape.end
        if start is None:
            half = np.array(shape.axis or (0, 0, 1)) * shape.length / 2
            centre = np.array(shape.centre or (0, 0, 0))
            start, end = centre - half, centre + half
        start, end = np.array(start, float), np.array(end, float)
        middle = (start + end) / 2
        start, end = (middle + rotation_matrix(shape.rotation) @ (p - middle) for p in (start, end))
        along = (points - start) @ (end - start) / ((end - start) @ (end - start))
        nearest = start + along[:, None] * (end - start)
        return (along > 0) & (along < 1) & (np.linalg.norm(points - nearest, axis=1) < shape.radius)
    x, y, z = ((points - np.array(shape.centre)) @ rotation_matrix(shape.rotation)).T
    if isinstance(shape, sc.Box):
        a, b, c = shape.size
        return (abs(x) < a / 2) & (abs(y) < b / 2) & (abs(z) < c / 2)
    if isinstance(shape, sc.Ellipsoid):
        a, b, c = shape.semi_axes
        return (x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2 < 1
    from matplotlib.path import Path

    from shadowgram.xray._bodies import letter_outline

    loops = letter_outline(shape.text, shape.height) if shape.text else [shape.points, *shape.holes]
    odd = sum(Path(np.array(loop)).contains_points(np.c_[x, y]) for loop in loops) % 2 == 1
    return odd & (abs(z) < shape.thickness / 2)


@pytest.mark.parametrize("name", SHAPES)
def test_shapes_stand_where_they_are_said_to(name):
    shape, rng = SHAPES[name], np.random.default_rng(0)
    placed = place(shape)
    points = placed.low - 1 + rng.random((20_000, 3)) * (placed.high - placed.low + 2)
    expected = inside_by_definition(shape, points)
    assert 500 < expected.sum() < 19_500
    assert np.array_equal(contains(placed, points), expected)
    inside = points[expected]
    assert (inside > placed.low).all()
    assert (inside < placed.high).all()
    # The box is the smallest: the extreme points come close to its sides.
    gap = np.maximum(inside.min(axis=0) - placed.low, placed.high - inside.max(axis=0))
    assert (gap < 0.25 * (placed.high - placed.low)).all()
    # As many points are inside as the volume says, within four standard deviations.
    share = volume(placed) / np.prod(placed.high - placed.low + 2)
    assert expected.mean() == pytest.approx(share, abs=4 * math.sqrt(share * (1 - share) / 20_000))


@pytest.mark.parametrize("name", SHAPES)
def test_frames_follow_the_contract(name):
    geometry = compile_scene(room(solid("it", SHAPES[name]))).geometry
    rotation, origin = geometry.frame[1, :9].reshape(3, 3), geometry.frame[1, 9:]
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1)
    assert geometry.turned[1] == (not np.array_equal(rotation, np.eye(3)))
    placed = place(SHAPES[name])
    # The kernels ask R (p − o) against the size; the corners of the box are the same solid's.
    assert geometry.size[1] == pytest.approx(placed.size)
    exact = geometry.kind[1] == arrays.BOX and not geometry.turned[1]
    slack = 0 if exact else 2e-6
    assert geometry.box[1, :3] == pytest.approx(placed.low, abs=slack)
    assert geometry.box[1, 3:] == pytest.approx(placed.high, abs=slack)
    assert (geometry.box[1, :3] <= placed.low).all()
    rng = np.random.default_rng(1)
    points = placed.low + rng.random((2000, 3)) * (placed.high - placed.low)
    own = (points - origin) @ rotation.T
    kind, size = geometry.kind[1], geometry.size[1]
    if kind == arrays.BOX:
        inside = (np.abs(own) < size).all(axis=1)
    elif kind == arrays.ELLIPSOID:
        inside = ((own / size) ** 2).sum(axis=1) < 1
    elif kind == arrays.CYLINDER:
        inside = (np.hypot(own[:, 0], own[:, 1]) < size[0]) & (np.abs(own[:, 2]) < size[2])
    else:
        edges = geometry.outlines.edge
        x0, y0, x1, y1 = edges.T[:, :, None]
        crossing = ((y0 > own[:, 1]) != (y1 > own[:, 1])) & (
            own[:, 0] < x0 + (own[:, 1] - y0) * (x1 - x0) / np.where(y1 == y0, 1, y1 - y0)
        )
        inside = (crossing.sum(axis=0) % 2 == 1) & (np.abs(own[:, 2]) < size[2])
    assert np.array_equal(inside, inside_by_definition(SHAPES[name], points))


def test_angles_turn_about_x_then_y_then_z():
    quarter = math.pi / 2
    assert rotation_matrix((quarter, 0, 0)) @ [0, 1, 0] == pytest.approx([0, 0, 1])
    assert rotation_matrix((0, quarter, 0)) @ [0, 0, 1] == pytest.approx([1, 0, 0])
    assert rotation_matrix((0, 0, quarter)) @ [1, 0, 0] == pytest.approx([0, 1, 0])
    a, b, c = ANGLES
    one_by_one = rotation_matrix((0, 0, c)) @ rotation_matrix((0, b, 0)) @ rotation_matrix((a, 0, 0))
    assert rotation_matrix(ANGLES) == pytest.approx(one_by_one)


def test_outlines_run_anticlockwise_around_material():
    geometry = compile_scene(room(solid("it", SHAPES["turned outline"]))).geometry
    assert geometry.body[1] == 0
    edges = geometry.outlines.edge[geometry.outlines.start[0] : geometry.outlines.start[1]]
    for x0, y0, x1, y1 in edges:
        middle, out = np.array([x0 + x1, y0 + y1]) / 2, np.array([y1 - y0, x0 - x1])
        step = 1e-3 * out / np.linalg.norm(out)
        own = np.array([[*(middle + step), 0.0], [*(middle - step), 0.0]])
        placed = place(SHAPES["turned outline"])
        world = own @ placed.turn + placed.origin
        assert contains(placed, world).tolist() == [False, True]


def test_meshes_are_scaled_turned_and_moved(cube):
    shape = sc.Mesh(file=cube, scale=10, rotation=ANGLES, translation=(1, 2, 3))
    placed = place(shape)
    assert volume(placed) == pytest.approx(1000)
    rng = np.random.default_rng(3)
    points = placed.low - 1 + rng.random((500, 3)) * (placed.high - placed.low + 2)
    own = (points - [1, 2, 3]) @ rotation_matrix(ANGLES)
    assert np.array_equal(contains(placed, points), ((own > 0) & (own < 10)).all(axis=1))
    geometry = compile_scene(room(solid("it", shape), solid("b", sc.Mesh(file=cube, translation=(100, 0, 0))))).geometry
    assert geometry.kind.tolist() == [arrays.BOX, arrays.MESH, arrays.MESH]
    assert geometry.body.tolist() == [-1, 0, 1]
    assert geometry.meshes.root.size == 2
    assert geometry.turned.tolist() == [0, 0, 0]


def test_voxels_carry_their_materials(tmp_path):
    cells = np.random.default_rng(5).integers(3, size=(3, 4, 5))
    np.save(tmp_path / "v.npy", cells)
    shape = sc.Voxels(
        file=tmp_path / "v.npy",
        materials=("bone", "air", "water"),
        pitch=(1, 2, 3),
        corner=(10, 0, 0),
        rotation=(0, 0, 1),
    )
    scene = room(solid("slab", SHAPES["box"], "water"), sc.Solid(name="phantom", role="target", shape=shape))
    compiled = compile_scene(scene)
    geometry = compiled.geometry
    assert [one.name for one in compiled.materials] == ["air", "water", "bone"]
    index = np.array([2, 0, 1])
    assert geometry.voxels.material.reshape(3, 4, 5).tolist() == index[cells].tolist()
    assert geometry.size[2].tolist() == [3, 8, 15]
    assert geometry.frame[2, 9:].tolist() == [10, 0, 0]
    assert geometry.turned[2] == 1
    # What lies in cell (2, 1, 0) is a corner and a turn away.
    point = np.array([10, 0, 0]) + rotation_matrix((0, 0, 1)) @ [2.5, 3, 1.5]
    own = geometry.frame[2, :9].reshape(3, 3) @ (point - geometry.frame[2, 9:])
    assert (own // shape.pitch).tolist() == [2, 1, 0]
    densities = np.array([material(name).density for name in ("bone", "air", "water")])
    assert compiled.masses[2] == pytest.approx(densities[cells].sum() * 6 / 1000)
    # Bin 500 begins at 2³ (1 + 116/128) keV.
    attenuation = compiled.physics.attenuation[:, 500, 0] + compiled.physics.attenuation[:, 500, 1] * 15.25
    assert geometry.voxels.majorant[0, 500] >= attenuation.max()


# ---- the scene as a whole ----------------------------------------------------------------------------------------------------


def test_solids_come_in_order_with_roles_and_materials():
    scene = sc.shipped_scene("cxbi-blocks")
    compiled = compile_scene(scene)
    geometry = compiled.geometry
    assert compiled.solid_names[:3] == ("world", "mask", "frame above")
    assert compiled.solid_names[-2:] == compiled.detector_names == ("plate +x", "plate -x")
    assert geometry.kind.tolist() == [arrays.BOX, arrays.MASK] + [arrays.BOX] * 12
    roles = (
        [arrays.ENVIRONMENT]
        + [arrays.SHIELD] * 5
        + [arrays.TARGET] * 4
        + [arrays.ENVIRONMENT] * 2
        + [arrays.DETECTOR] * 2
    )
    assert geometry.role.tolist() == roles
    assert [compiled.materials[i].name for i in geometry.material] == [
        "air", *["tungsten"] * 5, "caffeine", "caffeine", "HMX", "HMX", "silicon", "silicon", *["sodium iodide"] * 2
    ]  # fmt: skip
    assert geometry.material[0] == 0
    assert len(compiled.materials) == 6
    assert geometry.detector.tolist() == [-1] * 12 + [0, 1]
    assert geometry.world.tolist() == [[-1250] * 3, [1250] * 3]
    assert geometry.box[0].tolist() == [-1250] * 3 + [1250] * 3
    assert geometry.box[6].tolist() == [35, 35, 500, 105, 105, 510]  # caffeine at (+, +)
    assert compiled.physics.attenuation.shape[0] == 6


def test_equal_materials_are_one():
    scene = room(
        solid("a", sc.Box(size=(1, 1, 1)), "aluminum"),
        solid("b", sc.Box(centre=(9, 0, 0), size=(1, 1, 1)), "Al"),
        solid("c", sc.Box(centre=(19, 0, 0), size=(1, 1, 1)), {"name": "Al", "density": 2.0}),
        solid("d", sc.Box(centre=(29, 0, 0), size=(1, 1, 1)), "air"),
    )
    assert compile_scene(scene).geometry.material.tolist() == [0, 1, 1, 2, 0]


def test_alone_is_what_no_later_box_touches():
    boxes = [(0, 10), (20, 10), (25, 4), (40, 10), (45.0, 10), (50 + 1e-3, 1), (-30, 6)]
    scene = room(*(solid(f"s{i}", sc.Box(centre=(x, 0, 0), size=(size, 5, 5))) for i, (x, size) in enumerate(boxes)))
    geometry = compile_scene(scene).geometry
    for i in range(1, len(boxes) + 1):
        meets = [
            all(
                geometry.box[i][k] <= geometry.box[j][3 + k] and geometry.box[j][k] <= geometry.box[i][3 + k]
                for k in range(3)
            )
            for j in range(i + 1, len(boxes) + 1)
        ]
        assert geometry.alone[i] == (not any(meets)), i
    assert geometry.alone.tolist() == [0, 1, 0, 1, 0, 0, 1, 1]


def test_masses_are_those_of_whole_solids():
    ball = sc.Ellipsoid(centre=(0, 0, 100), semi_axes=(10, 10, 10))
    block = sc.Box(centre=(15, 0, 100), size=(20, 10, 10))
    detector = sc.Detector(name="d", centre=(0, 0, 200), size=(10, 10, 10), material="NaI")
    compiled = compile_scene(room(solid("ball", ball, "lead"), solid("block", block), detectors=[detector]))
    assert np.isnan(compiled.masses[:2]).all()  # the world, and the ball into which the block cuts
    assert compiled.masses[2] == pytest.approx(2.0)
    assert compiled.masses[3] == pytest.approx(material("NaI").density)
    alone = compile_scene(room(solid("ball", ball, "lead"))).masses[1]
    assert alone == pytest.approx(4 / 3 * math.pi * material("lead").density)


# ---- mask --------------------------------------------------------------------------------------------------------------------


def masked(**changes):
    pattern = np.random.default_rng(2).integers(2, size=(3, 8))
    parts = {
        "material": "tungsten",
        "position": (3, -4, 5),
        "pitch": 2.5,
        "depth": 2,
        "rows": 3,
        "columns": 8,
        "view": 3,
        "plate": (30, 11),
        "pattern": pattern,
    }
    return room(mask=sc.Mask(**{**parts, **changes}), shots=6)


@pytest.mark.parametrize("across_", [1, -1])
@pytest.mark.parametrize("down", [1, -1])
@pytest.mark.parametrize("shot", [0, 2, 5])
def test_holes_are_where_the_pattern_has_them(across_, down, shot):
    scene = masked(column_direction=across_, row_direction=down)
    geometry = compile_scene(scene, shot).geometry
    masks = geometry.masks
    open_ = masks.open.reshape(masks.shape[0])
    code = scene.mask.code(shot)
    for i in range(3):
        for j in range(3):
            # Cell (i, j) of the field, whose middle is at (3, −4).
            x, y = 3 + across_ * 2.5 * (j - 1), -4 + down * 2.5 * (i - 1)
            column = math.floor((x - masks.corner[0, 0]) / masks.step[0, 0])
            row = math.floor((y - masks.corner[0, 1]) / masks.step[0, 1])
            assert (row, column) == (i, j + shot)
            assert open_[row, column] == code[i, j]
    # The strip is in the middle of the plate.
    middle = masks.corner[0] + masks.step[0] * masks.shape[0][::-1] / 2
    assert (geometry.box[1, :2] + geometry.box[1, 3:5]) / 2 == pytest.approx(middle)
    assert geometry.box[1, 3:] - geometry.box[1, :3] == pytest.approx([30, 11, 2])
    assert geometry.box[1, [2, 5]].tolist() == [4, 6]
    assert masks.filling.tolist() == [0]
    assert (geometry.kind[1], geometry.role[1], geometry.body[1]) == (arrays.MASK, arrays.SHIELD, 0)


def test_moving_to_a_shot_is_compiling_at_it():
    scene = sc.shipped_scene("cxbi-ud")
    moved, whole = compile_scene(scene).at_shot(300), compile_scene(scene, 300)
    for a, b in zip(_leaves(moved.geometry), _leaves(whole.geometry), strict=True):
        assert np.array_equal(a, b)
    assert np.array_equal(moved.masses, whole.masses, equal_nan=True)
    assert moved.shot == 300
    back = moved.at_shot(0)
    assert np.array_equal(back.geometry.box, compile_scene(scene).geometry.box)


def _leaves(value):
    if isinstance(value, tuple):
        for one in value:
            yield from _leaves(one)
    else:
        yield value


@pytest.mark.parametrize("shot", [-1, 6, 1.0, True])
def test_there_is_no_other_shot(shot):
    with pytest.raises(ValueError, match="the shot must be a whole number from 0 to 5, got"):
        compile_scene(masked(), shot)
    with pytest.raises(ValueError, match="the shot must be"):
        compile_scene(masked()).at_shot(shot)


def test_the_mass_of_a_mask_is_without_its_holes():
    scene = masked()
    holes = int(scene.mask.cells().sum())
    expected = (30 * 11 - holes * 6.25) * 2 * material("tungsten").density / 1000
    assert compile_scene(scene).masses[1] == pytest.approx(expected)


# ---- source and detectors ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -3), (1, 0, 0), (-1, 1e-3, 0), (0, 2, 0), (1, 2, 3)])
def test_the_frame_of_the_source(direction):
    source = sc.Source(
        position=(1, 2, 3), direction=direction, focal_spot=(4, 5), half_angle=0.4, spectrum={"energy": 60}, activity=1
    )
    arrays_ = compile_scene(room(source=source)).source
    assert arrays_.axis @ arrays_.axis.T == pytest.approx(np.eye(3), abs=1e-14)
    assert np.linalg.det(arrays_.axis) == pytest.approx(1)
    assert arrays_.axis[2] == pytest.approx(np.array(direction) / np.linalg.norm(direction))
    assert arrays_.cosine == math.cos(0.4)
    assert (arrays_.position.tolist(), arrays_.spot.tolist()) == ([1, 2, 3], [4, 5])


def test_along_z_the_spot_lies_along_x_and_y():
    assert np.stack(across(np.array([0.0, 0.0, 1.0]))).tolist() == [[1, 0, 0], [0, 1, 0]]
    assert compile_scene(sc.shipped_scene("slab-water")).source.cosine == 1.0


def test_detectors_in_arrays():
    detectors = [
        sc.Detector(name="a", centre=(0, 0, 100), size=(1, 2, 3), material="NaI", resolution=0.07, pixels=(3, 4)),
        sc.Detector(name="b", centre=(0, 0, 200), size=(1, 2, 3), material="CsI", threshold=20, efficiency=0.5),
        sc.Detector(name="c", centre=(0, 0, 300), size=(1, 2, 3), material="CsI", pixels=(2, 1)),
    ]
    found = compile_scene(room(solid("s", sc.Box(size=(1, 1, 1))), detectors=detectors)).detectors
    assert found.solid.tolist() == [2, 3, 4]
    assert found.threshold.tolist() == [10, 20, 10]
    assert found.efficiency.tolist() == [1, 0.5, 1]
    assert found.start.tolist() == [0, 12, 13]
    assert found.pixels.tolist() == [[3, 4], [1, 1], [2, 1]]
    # A pulse of 662 keV has a standard deviation of b √662, and a full width at half maximum of 7 %.
    assert found.blur[0] * math.sqrt(662) * 2.3548200 == pytest.approx(0.07 * 662, rel=1e-6)
    assert found.blur[1] == 0


def test_fluorescence_can_be_left_out():
    block = solid("s", sc.Box(size=(1, 1, 1)), "tungsten")
    assert compile_scene(room(block)).physics.shell_yield.size > 0
    silent = room(block, fluorescence=False)
    assert compile_scene(silent).physics.shell_yield.size == 0
    assert sc.parse_scene(silent.toml()) == silent


def test_a_scene_with_next_to_nothing():
    compiled = compile_scene(room())
    assert compiled.geometry.kind.tolist() == [arrays.BOX]
    assert compiled.detectors.solid.size == 0
    assert compiled.geometry.masks.shape.shape == (0, 2)
    assert compiled.geometry.alone.tolist() == [0]


# ---- what files can get wrong ------------------------------------------------------------------------------------------------


def test_open_meshes_are_refused(tmp_path):
    path = tmp_path / "open.obj"
    path.write_text(CUBE.replace("f 2 4 8 6\n", ""))
    with pytest.raises(ValueError, match=r"^the solid 'it': the mesh open\.obj is not closed: 4 of its 1\d edges"):
        compile_scene(room(solid("it", sc.Mesh(file=path))))


def test_meshes_must_not_overlap(cube):
    first = solid("first", sc.Mesh(file=cube, scale=10))
    with pytest.raises(ValueError, match=r"^the meshes 'first' and 'second' overlap"):
        compile_scene(room(first, solid("second", sc.Mesh(file=cube, scale=10, translation=(9, 9, 9)))))
    beside = solid("second", sc.Mesh(file=cube, scale=10, translation=(10, 0, 0)))
    assert compile_scene(room(first, beside)).geometry.kind.size == 3


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ({"translation": (495, 0, 0)}, "^the solid 'it' reaches out of the world: x from 495 to 505 mm"),
        ({"translation": (-5, -5, -405)}, r"^the source at \(0, 0, -400\) mm lies in the solid 'it'"),
        ({"translation": (-5, 0, 100)}, "^the detector 'd' and the solid 'it' overlap"),
    ],
)
def test_meshes_must_keep_out_of_the_way(cube, shape, message):
    detector = sc.Detector(name="d", centre=(0, 0, 100), size=(9, 9, 9), material="NaI")
    with pytest.raises(ValueError, match=message):
        compile_scene(room(solid("it", sc.Mesh(file=cube, scale=10, **shape)), detectors=[detector]))


def test_a_mesh_whose_box_alone_meets_a_detector_may_stay(tmp_path):
    path = tmp_path / "wedge.obj"  # half of a cube, cut along a diagonal
    path.write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 0 1 1\nf 1 3 2\nf 4 5 6\nf 1 2 5 4\nf 2 3 6 5\nf 3 1 4 6\n"
    )
    detector = sc.Detector(name="d", centre=(8, 8, 5), size=(3, 3, 3), material="NaI")
    wedge = solid("wedge", sc.Mesh(file=path, scale=10))
    assert compile_scene(room(wedge, detectors=[detector])).detector_names == ("d",)


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        (np.full((2, 2, 2), 2), "hold numbers from 2 to 2, but there are materials for 0 to 1"),
        (np.full((2, 2, 2), -1), "hold numbers from -1 to -1"),
        (np.ones((2, 2, 2)), "must be whole numbers, got float64"),
        (np.ones((2, 2), int), "there is no array of 3 axes in it"),
    ],
)
def test_voxels_that_make_no_sense_are_refused(tmp_path, cells, message):
    np.save(tmp_path / "v.npy", cells)
    shape = sc.Voxels(file=tmp_path / "v.npy", materials=("air", "water"), pitch=(1, 1, 1))
    with pytest.raises(ValueError, match=f"^the solid 'it': .*v.npy.*{message}"):
        compile_scene(room(sc.Solid(name="it", shape=shape)))


def test_missing_files_are_named(tmp_path):
    for shape in (
        sc.Mesh(file=tmp_path / "none.stl"),
        sc.Voxels(file=tmp_path / "none.npy", materials=("air",), pitch=(1, 1, 1)),
    ):
        made_of = None if isinstance(shape, sc.Voxels) else "water"
        with pytest.raises(FileNotFoundError, match=r"there is no file .*none\."):
            compile_scene(room(sc.Solid(name="it", material=made_of, shape=shape)))
    scene = masked(pattern={"file": tmp_path / "none.npy"})
    with pytest.raises(FileNotFoundError, match=r"there is no file .*none\.npy"):
        compile_scene(scene)
    np.save(tmp_path / "none.npy", np.ones((4, 4)))
    with pytest.raises(ValueError, match="the mask has 3 rows and 8 columns, but its pattern 4 and 4"):
        compile_scene(scene)
