"""Straight flights through solids against plain loops, and what comes of them: attenuation, energy, backscatter.

The reference knows nothing of entries and exits: it cuts a ray at every place where anything could change and asks at the middle of
each piece which solids are there. Statistical tests are seeded and say how often they would raise a false alarm.
"""

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest

from shadowgram.xray import scene as sc
from shadowgram.xray._compile import compile_scene
from shadowgram.xray._layout import placed_solids
from shadowgram.xray._placed import contains
from shadowgram.xray.montecarlo import arrays
from shadowgram.xray.montecarlo._jit import SOURCES, entry
from shadowgram.xray.montecarlo._physics_kernels import energy_bin
from shadowgram.xray.montecarlo._walk_kernels import (
    COLLIDED,
    ESCAPED,
    FAINT,
    collect,
    cross,
    fly,
    piece,
    pieces_ahead,
)
from shadowgram.xray.montecarlo.arrays import ENERGY, FREE, HOME, MATERIAL, RECORD, VOXELS, Rules, U, X
from shadowgram.xray.montecarlo.rng import begin
from shadowgram.xray.montecarlo.run import batch_vector, run_setup
from shadowgram.xray.simulation import prepare

GOLDEN = Path(__file__).parents[1] / "golden" / "xray_slabs.json"
ENERGY_KEV = 300.0
ANGLES = (0.4, -0.3, 0.7)
REDUCED = Rules(cutoff=1.0, reduce=True, near=30.0, least=0.005, least_air=0.1, bin_width=0.5)


def _entries(sources):
    @entry
    def walked(geometry, desk, rays, out):
        """Add the lengths of every ray in (solid, material)."""
        for i in range(rays.shape[0] if sources else 0):
            count, end = collect(geometry, desk, rays[i], 0)
            t = 0.0
            while True:
                solid, material, stop, which = piece(geometry, desk, rays[i], count, end, t)
                out[i, solid, material] += stop - t
                if which == -1:
                    break
                if which >= 0:
                    cross(geometry, desk, rays[i], which, stop)
                t = stop

    @entry
    def flown(geometry, physics, detectors, rules, desk, rays, depths, out):
        """Row i: status, distance, material, solid, depth without collision, and whether a shield was crossed."""
        begin(desk.stream, 1, 0)
        for i in range(rays.shape[0] if sources else 0):
            bin_ = energy_bin(rays[i, ENERGY])
            status, t, material, solid, free, shielded = fly(
                geometry, physics, detectors, rules, desk, rays[i], bin_, depths[i]
            )
            out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4], out[i, 5] = (
                status,
                t,
                material,
                solid,
                free,
                shielded,
            )

    @entry
    def forced(geometry, physics, desk, rays, out):
        """Row i: chance of a first collision in the target and in the air, and how far they were looked for."""
        for i in range(rays.shape[0] if sources else 0):
            _, looked = pieces_ahead(geometry, physics, desk, rays[i], energy_bin(rays[i, ENERGY]))
            out[i, 0], out[i, 1], out[i, 2] = desk.chance[0], desk.chance[1], looked

    return walked, flown, forced


_walked, _flown, _forced = _entries(SOURCES)


# ---- scenes ------------------------------------------------------------------------------------------------------------------


def torus(path, around=14, across=9):
    """A mesh with a hole in it, not convex, as an OBJ file."""
    a, b = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    u, v = 2 * np.pi * a / around, 2 * np.pi * b / across
    r = 30 + 12 * np.cos(v)
    points = np.stack([r * np.cos(u), r * np.sin(u), 12 * np.sin(v)], axis=-1).reshape(-1, 3)

    def number(i, j):
        return i % around * across + j % across + 1

    quads = [
        (number(i, j), number(i + 1, j), number(i + 1, j + 1), number(i, j + 1))
        for i in range(around)
        for j in range(across)
    ]
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    lines += [f"f {p} {q} {r}\nf {p} {r} {s}" for p, q, r, s in quads]
    path.write_text("\n".join(lines))
    return str(path)


def solid(name, shape, material="water", role="target"):
    return sc.Solid(name=name, material=None if isinstance(shape, sc.Voxels) else material, shape=shape, role=role)


def scene(*solids, **changes):
    values = {
        "world": sc.World(size=(400, 400, 400)),
        "source": sc.Source(position=(0, 0, -190), half_angle=0.3, spectrum={"energy": ENERGY_KEV}, activity=1),
        "solids": solids,
    }
    return sc.Scene(**values | changes)


def mask(**changes):
    values = {
        "material": "tungsten",
        "position": (5, -5, -80),
        "pitch": 6,
        "depth": 4,
        "rows": 8,
        "columns": 10,
        "plate": (120, 90),
        "pattern": {"transmittance": 0.5, "seed": 2},
    }
    return sc.Mask(**values | changes)


def detector(name="crystal", centre=(150, 150, -150), size=(60, 40, 20), material="sodium iodide", **changes):
    return sc.Detector(name=name, centre=centre, size=size, material=material, **changes)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bodies")
    np.save(folder / "cells.npy", np.random.default_rng(3).integers(0, 3, (5, 6, 4)))
    return {"torus": torus(folder / "torus.obj"), "cells": str(folder / "cells.npy")}


def voxels(files):
    return sc.Voxels(
        file=files["cells"],
        materials=("air", "water", "aluminum"),
        pitch=(9, 8, 11),
        corner=(-90, 30, 40),
        rotation=ANGLES,
    )


def crowd(files, *, with_voxels, mask_changes):
    """Everything at once, much of it in the same place."""
    solids = [
        solid("box", sc.Box(centre=(20, 10, 0), size=(70, 50, 40), rotation=ANGLES), "aluminum", "environment"),
        solid("straight", sc.Box(centre=(40, 30, 10), size=(50, 50, 30)), "aluminum"),
        solid("egg", sc.Ellipsoid(centre=(25, 15, 0), semi_axes=(40, 20, 12), rotation=(1, 2, 0.3)), "iron", "shield"),
        solid("yolk", sc.Ellipsoid(centre=(25, 15, 0), semi_axes=(20, 14, 10)), "water"),
        solid("hole", sc.Cylinder(radius=6, start=(0, -30, -40), end=(50, 60, 40)), "air", "environment"),
        solid("rod", sc.Cylinder(radius=4, centre=(25, 15, 5), length=120, axis=(1, 0, 0)), "iron"),
        solid("ring", sc.Mesh(file=files["torus"], rotation=ANGLES, translation=(-20, 10, 20)), "aluminum"),
        solid(
            "letters", sc.Outline(centre=(-20, -20, 20), text="UD", height=60, thickness=20, rotation=ANGLES), "iron"
        ),
        solid(
            "frame",
            sc.Outline(
                centre=(-60, 40, 60),
                points=((-40, -30), (40, -35), (45, 30), (0, 10), (-42, 33)),
                holes=(((-20, -20), (20, -22), (0, 0)),),
                thickness=30,
            ),
            "aluminum",
            "shield",
        ),
        solid("chip", sc.Box(centre=(5, -5, -80), size=(90, 20, 3)), "lead", "shield"),
    ]
    if with_voxels:
        solids.append(solid("cells", voxels(files)))
        solids.append(solid("plug", sc.Box(centre=(-70, 50, 70), size=(15, 100, 15)), "iron"))
    return scene(*solids, mask=mask(**mask_changes), detectors=[detector()])


def apart(files):
    """Solids of all shapes that stand alone."""
    return scene(
        solid("box", sc.Box(centre=(-100, 0, 0), size=(60, 50, 40)), "aluminum", "shield"),
        solid("turned", sc.Box(centre=(0, 0, 0), size=(60, 50, 40), rotation=ANGLES), "iron"),
        solid("egg", sc.Ellipsoid(centre=(100, 0, 0), semi_axes=(40, 20, 30), rotation=ANGLES)),
        solid("rod", sc.Cylinder(radius=20, centre=(0, 120, 0), length=80, axis=(1, 2, 3)), "water", "shield"),
        solid("letters", sc.Outline(centre=(0, -120, 0), text="UD", height=60, thickness=20, rotation=ANGLES), "iron"),
        solid("ring", sc.Mesh(file=files["torus"], translation=(0, 0, 120)), "aluminum"),
        mask=mask(),
        detectors=[detector()],
    )


# ---- the reference -----------------------------------------------------------------------------------------------------------


class Reference:
    """A scene that is asked what is where."""

    def __init__(self, described):
        self.scene, self.compiled = described, compile_scene(described)
        self.names = self.compiled.solid_names
        self.placed = placed_solids(described, files=True)
        self.made_of = {one.name: one for one in (*described.solids, *described.detectors)}
        self.per_mm = {
            energy: np.array([float(one.attenuation(energy)) / 10 for one in self.compiled.materials])
            for energy in (60.0, ENERGY_KEV)
        }

    def index(self, composition):
        wanted = composition.material()
        return next(
            i
            for i, one in enumerate(self.compiled.materials)
            if (one.density, one.fractions) == (wanted.density, wanted.fractions)
        )

    def box(self, name):
        if name == "world":
            centre, size = self.scene.world.centre, self.scene.world.size
        elif name == "mask":
            centre, size = self.scene.mask.plate_centre(0), (*self.scene.mask.plate, self.scene.mask.depth)
        else:
            centre, size = self.made_of[name].centre, self.made_of[name].size
        return np.array(centre) - np.array(size) / 2, np.array(centre) + np.array(size) / 2

    def cells(self, points):
        """(column, row) of places in the mask, as fractions."""
        coded = self.scene.mask
        x, y, _ = coded.plate_centre(0)
        column = (points[:, 0] - x) * coded.column_direction / coded.pitch + coded.columns / 2
        row = (points[:, 1] - y) * coded.row_direction / coded.pitch + coded.rows / 2
        return column, row

    def inside(self, name, points):
        if name in self.placed:
            return contains(self.placed[name], points)
        low, high = self.box(name)
        return ((points > low) & (points < high)).all(axis=1)

    def material(self, name, points):
        """(point) index of the material that a solid has there."""
        if name == "world":
            return np.full(len(points), self.index(self.scene.world.material))
        if name == "mask":
            coded = self.scene.mask
            column, row = (np.floor(x).astype(int) for x in self.cells(points))
            on = (column >= 0) & (column < coded.columns) & (row >= 0) & (row < coded.rows)
            is_open = np.zeros(len(points), bool)
            is_open[on] = coded.cells()[row[on], column[on]] == 1
            return np.where(is_open, self.index(self.scene.world.material), self.index(coded.material))
        one = self.made_of[name]
        if name in self.placed and self.placed[name].kind == VOXELS:
            placed = self.placed[name]
            own = (points - placed.origin) @ placed.turn.T / placed.pitch
            which = np.clip(own.astype(int), 0, np.array(placed.cells.shape) - 1)
            return np.array([self.index(m) for m in one.shape.materials])[placed.cells[tuple(which.T)]]
        return np.full(len(points), self.index(one.material))

    def at(self, points):
        """(solid, material) at places: the later solid counts."""
        solids = np.zeros(len(points), int)
        materials = self.material("world", points)
        for i, name in enumerate(self.names):
            here = self.inside(name, points)
            if i and here.any():
                solids[here] = i
                materials[here] = self.material(name, points[here])
        return solids, materials

    def places(self, p, d):
        """Distances at which anything could change."""
        found = []
        for name in self.names:
            if name not in self.placed:
                for corner in self.box(name):
                    found += [(corner[k] - p[k]) / d[k] for k in range(3) if d[k] != 0]
                if name == "mask":
                    column, row = self.cells(np.stack([p, p + d]))
                    for place, count in ((column, self.scene.mask.columns), (row, self.scene.mask.rows)):
                        step = place[1] - place[0]
                        found += [(k - place[0]) / step for k in range(count + 1) if step != 0]
            else:
                found += own_places(self.placed[name], p, d)
        low, high = self.box("world")
        end = min(((high if d[k] > 0 else low)[k] - p[k]) / d[k] for k in range(3) if d[k] != 0)
        return np.unique([0.0, *(t for t in found if 0 < t < end), end])

    def pieces(self, ray):
        """(start, stop, solid, material) along a ray."""
        p, d = ray[X : X + 3], ray[U : U + 3]
        ends = self.places(p, d)
        middle = (ends[:-1] + ends[1:]) / 2
        return ends[:-1], ends[1:], *self.at(p + middle[:, None] * d)


def own_places(placed, p, d):
    """Distances at which a ray meets the planes and curved surfaces that a shape is made of."""
    o, w = placed.turn @ (p - placed.origin), placed.turn @ d
    planes = []  # (normal, offset)
    curved = []
    size = placed.size
    if placed.kind == arrays.BOX:
        planes = [(axis, s * size @ axis) for axis in np.eye(3) for s in (-1, 1)]
    elif placed.kind == arrays.ELLIPSOID:
        curved = [(w / size, o / size, 1.0)]
    elif placed.kind == arrays.CYLINDER:
        curved = [(w[:2], o[:2], size[0] ** 2)]
        planes = [(np.eye(3)[2], s * size[2]) for s in (-1, 1)]
    elif placed.kind == arrays.OUTLINE:
        planes = [(np.eye(3)[2], s * size[2]) for s in (-1, 1)]
        for loop in placed.loops:
            for a, b in zip(loop, np.roll(loop, -1, axis=0), strict=True):
                normal = np.array([b[1] - a[1], a[0] - b[0], 0.0])
                planes.append((normal, normal[:2] @ a))
    elif placed.kind == VOXELS:
        planes = [
            (axis, k * placed.pitch @ axis)
            for i, axis in enumerate(np.eye(3))
            for k in range(placed.cells.shape[i] + 1)
        ]
    else:
        a, b, c = np.moveaxis((placed.vertices - placed.origin)[placed.faces], 1, 0)
        planes = [(n, n @ v) for n, v in zip(np.cross(b - a, c - a), a, strict=True)]
    found = [(offset - n @ o) / (n @ w) for n, offset in planes if n @ w != 0]
    for direction, start, c in curved:
        roots = np.roots([direction @ direction, 2 * direction @ start, start @ start - c])
        found += [float(root.real) for root in roots if abs(root.imag) < 1e-12]
    return found


def rays(count, seed, size=200.0):
    """Records of photons all over the world, in all directions, some of them along the axes."""
    rng = np.random.default_rng(seed)
    out = np.zeros((count, RECORD))
    out[:, X : X + 3] = rng.uniform(-size, size, (count, 3))
    direction = rng.normal(size=(count, 3))
    for i in range(0, count, 10):
        direction[i] = np.eye(3)[i // 10 % 3] * (1 if i % 20 else -1)
    # Half of them towards the middle, where the solids are.
    aimed = rng.uniform(-40, 40, (count, 3)) - out[:, X : X + 3]
    direction[1::2] = aimed[1::2]
    out[:, U : U + 3] = direction / np.linalg.norm(direction, axis=1)[:, None]
    out[:, ENERGY] = ENERGY_KEV
    out[:, FREE], out[:, MATERIAL] = -1, -1
    return out


def desk_of(reference):
    return arrays.desk(len(reference.names), 1)


def far_away():
    """A detector out of this world: what is sent there flies through all of it without collision."""
    wall = np.array([[-1e7, -1e7, 1e6, 1e7, 1e7, 2e6]])
    one = np.ones(1)
    return arrays.Detectors(
        solid=np.zeros(1, np.int64),
        assembly=wall,
        threshold=one,
        blur=one,
        efficiency=one,
        start=np.zeros(1, np.int64),
        pixels=np.ones((1, 2), np.int64),
    )


@pytest.fixture(scope="module")
def crowded(files):
    return Reference(crowd(files, with_voxels=False, mask_changes={}))


@pytest.fixture(scope="module")
def mirrored(files):
    changes = {"column_direction": -1, "row_direction": 1}
    return Reference(crowd(files, with_voxels=False, mask_changes=changes))


@pytest.fixture(scope="module")
def with_cells(files):
    return Reference(crowd(files, with_voxels=True, mask_changes={}))


@pytest.fixture(scope="module")
def lonely(files):
    return Reference(apart(files))


# ---- lengths -----------------------------------------------------------------------------------------------------------------


def check_lengths(reference, lines, *, by_material):
    geometry = reference.compiled.geometry
    found = np.zeros((len(lines), len(reference.names), len(reference.compiled.materials)))
    _walked(geometry, desk_of(reference), lines, found)
    expected = np.zeros_like(found)
    for i, line in enumerate(lines):
        start, stop, solids, materials = reference.pieces(line)
        np.add.at(expected[i], (solids, materials), stop - start)
    if not by_material:
        found, expected = found.sum(axis=2), expected.sum(axis=2)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    return expected


@pytest.mark.parametrize("which", ["crowded", "mirrored"])
def test_lengths_in_a_crowd_are_those_of_plain_loops(which, request):
    met = check_lengths(request.getfixturevalue(which), rays(300, 1), by_material=True).sum(axis=(0, 2))
    assert (met > 10).all(), "every solid is met"


def test_lengths_with_voxels_are_those_of_plain_loops(with_cells):
    met = check_lengths(with_cells, rays(300, 2), by_material=False).sum(axis=0)
    assert (met > 10).all()


def test_lengths_in_solids_that_stand_alone(lonely):
    assert lonely.compiled.geometry.alone[1:].all()
    check_lengths(lonely, rays(300, 3), by_material=True)


def test_rays_along_the_axes_and_through_corners():
    """Lengths known by hand: a cube of 20 mm, its corners, its edges and its faces' middles."""
    reference = Reference(scene(solid("cube", sc.Box(size=(20, 20, 20)), "iron")))
    root = math.sqrt(0.5)
    cases = [
        ((-50, 0, 0), (1, 0, 0), 20.0),
        ((0, 50, 9.999), (0, -1, 0), 20.0),
        ((0, 0, 0), (0, 0, -1), 10.0),
        ((-50, -50, 0), (root, root, 0), 20 / root),
        ((-50, -50, -50), (3**-0.5, 3**-0.5, 3**-0.5), 20 * math.sqrt(3)),
        ((-50, -45, 0), (root, root, 0), 15 / root),
        ((-50, 10.001, 0), (1, 0, 0), 0.0),
        ((50, 0, 0), (1, 0, 0), 0.0),
    ]
    lines = np.zeros((len(cases), RECORD))
    for line, (p, d, _) in zip(lines, cases, strict=True):
        line[X : X + 3], line[U : U + 3] = p, d
    found = np.zeros((len(cases), 2, 2))
    _walked(reference.compiled.geometry, desk_of(reference), lines, found)
    np.testing.assert_allclose(found[:, 1, 1], [length for *_, length in cases], atol=1e-12)


# ---- the mask ----------------------------------------------------------------------------------------------------------------

ROWS = ("10110", "01001", "11010")


@pytest.mark.parametrize("shot", [0, 1])
@pytest.mark.parametrize("columns", [1, -1])
@pytest.mark.parametrize("rows", [1, -1])
def test_holes_of_a_mask_are_where_they_are_said_to_be(shot, columns, rows):
    """Straight rays through the middle of every cell: 0 or 3 mm of tungsten."""
    coded = sc.Mask(
        material="tungsten", pitch=2, depth=3, rows=3, columns=5, view=4, plate=(30, 20), pattern={"rows": ROWS},
        column_direction=columns, row_direction=rows,
    )  # fmt: skip
    compiled = compile_scene(scene(mask=coded, shots=2), shot)
    lines = np.zeros((15, RECORD))
    lines[:, U + 2] = 1
    for i in range(3):
        for j in range(5):
            # In shot q the columns q to q + 3 are centred on the axis.
            lines[5 * i + j, X : X + 3] = columns * 2 * (j - shot - 1.5), rows * 2 * (i - 1), -50
    found = np.zeros((15, 2, 2))
    _walked(compiled.geometry, arrays.desk(2, 0), lines, found)
    closed = np.array([[cell == "0" for cell in row] for row in ROWS])
    np.testing.assert_allclose(found[:, 1, 1].reshape(3, 5), 3.0 * closed, atol=1e-9)
    np.testing.assert_allclose(found.sum(axis=(1, 2)), 250, rtol=1e-12)


def test_slanted_rays_through_one_two_and_three_cells():
    coded = sc.Mask(material="tungsten", pitch=2, depth=3, rows=3, columns=5, plate=(30, 20), pattern={"rows": ROWS})
    compiled = compile_scene(scene(mask=coded))
    # Row 1 at y = 0 holds 0 1 0 0 1 for x = −5, −3, −1, 1, 3, 5; the plate has z from −1.5 to 1.5.
    cases = [
        # (x on entry, Δx over the plate, share of the path in tungsten)
        (-2.9, 1.8, 0.0),  # in the hole from −3 to −1
        (-2.0, 2.0, 0.5),  # from the hole into the closed cell beside it, at half the way
        (-0.5, 3.0, 1.0),  # three closed: −1 to 1, 1 to 3
        (-3.5, 5.0, 3.0 / 5.0),  # closed (0.5), the hole (2), closed (2), closed (0.5)
        (2.0, 4.0, 2.0 / 4.0),  # closed (1), the hole (2), then the frame (1)
        (-0.5, -2.0, 0.25),  # backwards: closed (0.5), the hole (1.5)
        (-1.0005, 3.0, 2.9995 / 3.0),  # the hole for half a micrometre, then two closed
        (-0.9995, -3.0, 1.0 / 3.0),  # backwards: closed for half a micrometre, the hole (2), closed (0.9995)
        (7.0, -9.0, 6.0 / 9.0),  # backwards: the frame (2), the hole (2), closed (4), the hole from −1 (1)
    ]
    lines = np.zeros((len(cases), RECORD))
    for line, (x, across, _) in zip(lines, cases, strict=True):
        direction = np.array([across, 0.0, 3.0]) / math.hypot(across, 3.0)
        line[U : U + 3] = direction
        line[X : X + 3] = np.array([x, 0.3, -1.5]) - 20 * direction
    found = np.zeros((len(cases), 2, 2))
    _walked(compiled.geometry, arrays.desk(2, 0), lines, found)
    expected = [share * math.hypot(across, 3.0) for _, across, share in cases]
    np.testing.assert_allclose(found[:, 1, 1], expected, atol=1e-6)
    np.testing.assert_allclose(found[:, 1].sum(axis=1), [math.hypot(across, 3.0) for _, across, _ in cases], atol=1e-9)


# ---- flights -----------------------------------------------------------------------------------------------------------------


def reference_depth(reference, line, energy=ENERGY_KEV):
    """(start, stop, solid, material, optical depth) of the pieces along a ray."""
    start, stop, solids, materials = reference.pieces(line)
    return start, stop, solids, materials, reference.per_mm[energy][materials] * (stop - start)


@pytest.mark.parametrize("which", ["crowded", "lonely"])
def test_depths_without_collision_are_those_of_plain_loops(which, request):
    reference = request.getfixturevalue(which)
    lines = rays(300, 4)
    lines = lines[lines[:, U + 2] > 0.05]  # towards the wall far away
    lines[:, FREE] = 0
    found = np.zeros((len(lines), 6))
    arguments = (reference.compiled.geometry, reference.compiled.physics, far_away(), REDUCED, desk_of(reference))
    _flown(*arguments, lines, np.full(len(lines), 1e9), found)
    roles, own = reference.compiled.geometry.role, reference.compiled.geometry.material
    for line, (status, t, _, _, depth, shielded) in zip(lines, found, strict=True):
        start, stop, solids, materials, taken = reference_depth(reference, line)
        assert status == ESCAPED
        assert t == pytest.approx(stop[-1], rel=1e-12)
        assert depth == pytest.approx(taken.sum(), rel=1e-6, abs=1e-9)
        crossed = (roles[solids] == arrays.SHIELD) & (materials == own[solids]) & (stop - start > 1e-6)
        assert shielded == crossed.any()


def along(reference, line, depth):
    """(distance, solid, material) at an optical depth, or None beyond the last one."""
    start, _, solids, materials, taken = reference_depth(reference, line)
    before = np.concatenate([[0.0], np.cumsum(taken)])
    if depth >= before[-1]:
        return None
    i = int(np.searchsorted(before, depth, side="right")) - 1
    return start[i] + (depth - before[i]) / reference.per_mm[ENERGY_KEV][materials[i]], solids[i], materials[i]


@pytest.mark.parametrize("which", ["crowded", "lonely"])
def test_collisions_are_where_the_depth_is_used_up(which, request):
    reference = request.getfixturevalue(which)
    lines = rays(300, 5)
    depths = np.random.default_rng(6).exponential(1.5, len(lines))
    found = np.zeros((len(lines), 6))
    arguments = (reference.compiled.geometry, reference.compiled.physics, far_away(), REDUCED, desk_of(reference))
    _flown(*arguments, lines, depths, found)
    collided = 0
    for line, depth, (status, t, material, body, free, _) in zip(lines, depths, found, strict=True):
        expected = along(reference, line, depth)
        assert free == 0
        if expected is None:
            assert status == ESCAPED
        else:
            collided += 1
            assert status == COLLIDED
            assert t == pytest.approx(expected[0], abs=1e-5)
            assert (body, material) == expected[1:]
    assert collided > 40


def test_a_flight_that_begins_at_home_is_the_same(lonely):
    """Inside a solid that stands alone others are not asked; what comes out must not depend on it."""
    geometry = lonely.compiled.geometry
    lines = rays(6000, 7, size=150)
    solids, _ = lonely.at(lines[:, X : X + 3])
    kept = solids > 0
    lines, solids = lines[kept], solids[kept]
    assert set(solids) >= set(range(1, 8))
    arguments = (geometry, lonely.compiled.physics, far_away(), REDUCED, desk_of(lonely))
    for scale in (0.1, 1.0, 5.0):
        depths = np.random.default_rng(8).exponential(scale, len(lines))
        plain, at_home = np.zeros((len(lines), 6)), np.zeros((len(lines), 6))
        lines[:, HOME] = 0
        _flown(*arguments, lines, depths, plain)
        lines[:, HOME] = solids
        _flown(*arguments, lines, depths, at_home)
        np.testing.assert_allclose(at_home[:, 1], plain[:, 1], rtol=1e-9, atol=1e-6)
        np.testing.assert_array_equal(at_home[:, [0, 2, 3, 4]], plain[:, [0, 2, 3, 4]])
        # What collided at home has met the shield there and needs no mark of having crossed it.
        left = at_home[:, 3] != solids
        np.testing.assert_array_equal(at_home[left, 5], plain[left, 5])


def test_chances_of_a_first_collision(crowded):
    lines = rays(300, 9)
    found = np.zeros((len(lines), 3))
    _forced(crowded.compiled.geometry, crowded.compiled.physics, desk_of(crowded), lines, found)
    roles = crowded.compiled.geometry.role
    for line, (target, air, looked) in zip(lines, found, strict=True):
        _, stop, solids, _, taken = reference_depth(crowded, line)
        before = np.cumsum(taken) - taken
        chance = np.exp(-before) * -np.expm1(-taken)
        near = stop <= looked + 1e-6
        assert target == pytest.approx(chance[near & (roles[solids] == arrays.TARGET)].sum(), abs=1e-6)
        assert air == pytest.approx(chance[near & (solids == 0)].sum(), abs=1e-6)
        assert looked == pytest.approx(stop[-1]) or taken[near].sum() > FAINT


@pytest.mark.parametrize("free", [True, False], ids=["ratio tracking", "Woodcock's tracking"])
def test_flights_through_voxels_let_as_many_through(with_cells, free):
    """4 standard deviations: 6e-5 for each of 20 rays."""
    cells = with_cells.placed["cells"]
    lines = rays(60, 10)
    lines[:, X : X + 3] *= [1, 1, 0.2]
    aimed = (
        (cells.low + cells.high) / 2 + np.random.default_rng(12).normal(scale=10, size=(60, 3)) - lines[:, X : X + 3]
    )
    lines[:, U : U + 3] = aimed / np.linalg.norm(aimed, axis=1)[:, None]
    chosen = []
    for line in lines[lines[:, U + 2] > 0.05]:
        *_, solids, _, taken = reference_depth(with_cells, line)
        if taken[solids == with_cells.names.index("cells")].sum() > 0.1 and taken.sum() < 3:
            chosen.append((line, taken.sum()))
    chosen = chosen[:20]
    assert len(chosen) == 20
    repeats = 20_000
    many = np.repeat(np.array([line for line, _ in chosen]), repeats, axis=0)
    many[:, FREE] = 0 if free else -1
    depths = np.full(len(many), 1e9) if free else np.random.default_rng(11).exponential(1, len(many))
    found = np.zeros((len(many), 6))
    arguments = (with_cells.compiled.geometry, with_cells.compiled.physics, far_away(), REDUCED, desk_of(with_cells))
    _flown(*arguments, many, depths, found)
    passed = (np.exp(-found[:, 4]) if free else (found[:, 0] == ESCAPED).astype(float)).reshape(20, repeats)
    expected = np.exp([-depth for _, depth in chosen])
    error = passed.std(axis=1, ddof=1) / math.sqrt(repeats)
    assert (np.abs(passed.mean(axis=1) - expected) < 4 * error).all()


# ---- Beer and Lambert --------------------------------------------------------------------------------------------------------


def only_absorbing(setup):
    """The same with every collision an absorption: what gets through has not collided."""
    physics = setup.physics
    table = physics.attenuation.copy()
    table[..., arrays.PHOTOELECTRIC : arrays.PHOTOELECTRIC + 2] = table[..., arrays.TOTAL : arrays.TOTAL + 2]
    table[..., arrays.RAYLEIGH : arrays.RAYLEIGH + 2] = 0
    dark = physics._replace(attenuation=table, shell_start=np.zeros_like(physics.shell_start))
    return dataclasses.replace(setup, physics=dark)


def pencil(direction=(0.0, 0.0, 1.0), position=(0.0, 0.0, -100.0)):
    return sc.Source(position=position, direction=direction, spectrum={"energy": 60}, activity=1)


def check_transmission(described, depth, histories, seed):
    """Within 3 standard deviations: a false alarm for one of 370 seeds."""
    run = run_setup(
        only_absorbing(prepare(compile_scene(described), variance_reduction=False)), histories=histories, seed=seed
    )
    passed = run.tallies["escaped/forward"]
    expected = math.exp(-depth)
    sigma = math.sqrt(expected * (1 - expected) / histories)
    assert float(passed.mean) == pytest.approx(expected, abs=3 * sigma)
    assert float(passed.standard_error) == pytest.approx(sigma, rel=0.3)
    assert run.tallies["escaped/backward"].mean == 0
    assert run.tallies["escaped/cosine"].mean[-1] == passed.mean
    assert run.tallies["escaped/forward/spectrum"].mean[120] == passed.mean
    return sigma / expected


@pytest.mark.parametrize(("name", "thickness"), [("water", 14.0), ("aluminum", 3.8), ("tungsten", 0.04)])
def test_slabs_attenuate_by_beer_and_lambert(name, thickness):
    slab = solid("slab", sc.Box(centre=(0, 0, thickness / 2), size=(100, 100, thickness)), name)
    described = scene(slab, world=sc.World(size=(400, 400, 400), material="vacuum"), source=pencil())
    depth = slab.material.material().attenuation(60) / 10 * thickness
    assert check_transmission(described, depth, 40_000_000, seed=1) < 1e-4


def test_slanted_rays_are_attenuated_by_an_ellipsoid_and_a_mesh_box(tmp_path):
    corners = [(x, y, z) for z in (-10, 10) for y in (-15, 15) for x in (-20, 20)]
    faces = ["1 3 4", "1 4 2", "5 6 8", "5 8 7", "1 2 6", "1 6 5", "3 7 8", "3 8 4", "1 5 7", "1 7 3", "2 4 8", "2 8 6"]
    path = tmp_path / "box.obj"
    path.write_text("\n".join([f"v {x} {y} {z}" for x, y, z in corners] + [f"f {face}" for face in faces]))
    egg = solid("egg", sc.Ellipsoid(centre=(5, 0, 30), semi_axes=(30, 20, 10), rotation=ANGLES))
    box = solid("box", sc.Mesh(file=str(path), rotation=ANGLES, translation=(0, 5, -30)), "aluminum", "environment")
    direction = (0.1, 0.12, 1.0)
    described = scene(
        egg,
        box,
        world=sc.World(size=(400, 400, 400), material="vacuum"),
        source=pencil(direction, position=(-3.0, -5.0, -80.0)),
    )
    line = np.zeros(RECORD)
    line[X : X + 3] = described.source.position
    line[U : U + 3] = np.array(direction) / np.linalg.norm(direction)
    reference = Reference(described)
    start, stop, _, materials, taken = reference_depth(reference, line, 60.0)
    assert (np.bincount(materials, stop - start, minlength=3)[1:] > 10).all()
    check_transmission(described, float(taken.sum()), 8_000_000, seed=2)


def test_voxels_attenuate_by_beer_and_lambert(files):
    described = scene(solid("cells", voxels(files)), source=pencil((0.05, 0.02, 1.0), (-80, 60, -100)))
    line = np.zeros(RECORD)
    line[X : X + 3] = described.source.position
    line[U : U + 3] = np.array(described.source.direction)
    depth = float(reference_depth(Reference(described), line, 60.0)[-1].sum())
    assert depth > 0.3
    check_transmission(described, depth, 10_000_000, seed=3)


# ---- energy ------------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def kitchen(files):
    """Fluorescence, nested solids, a mask, voxels and detectors at once; energies from 20 to 120 keV."""
    return compile_scene(
        scene(
            solid("gold", sc.Box(centre=(0, 0, 0), size=(100, 100, 0.05)), "gold"),
            solid("egg", sc.Ellipsoid(centre=(10, 0, 30), semi_axes=(40, 30, 20), rotation=ANGLES)),
            solid("pit", sc.Ellipsoid(centre=(10, 0, 30), semi_axes=(10, 10, 10)), "lead", "shield"),
            solid("ring", sc.Mesh(file=files["torus"], translation=(0, 0, 70)), "tin", "environment"),
            solid("cells", voxels(files)),
            source=sc.Source(
                position=(0, 0, -190),
                half_angle=0.3,
                spectrum={"energies": (30, 70, 110), "weights": (1, 1, 1), "width": 20},
                activity=1,
            ),
            mask=mask(),
            detectors=[
                detector(centre=(0, 80, -60), size=(100, 20, 60)),
                detector("back", (0, 0, 150), (300, 300, 20)),
            ],
            cutoff=5,
        )
    )


def test_energy_is_conserved_in_every_history(kitchen):
    setup = prepare(kitchen, variance_reduction=False)
    size = len(setup.solid_names)
    empty = setup.empty_tally()
    deposits = -(empty.balance.size + empty.escaped_spectrum.size + empty.escaped.size + size)
    emitted = set()
    for number in range(3000):
        vector = batch_vector(setup, 5, number, number + 1)
        deposited = vector[deposits : deposits + size]
        started, escaped = vector[-2:]
        assert (deposited >= 0).all()
        assert 20 <= started <= 120
        assert started == pytest.approx(deposited.sum() + escaped, rel=1e-12)
        emitted |= set(np.flatnonzero(deposited))
    assert emitted == set(range(size)), "every solid takes part"


def test_energy_is_conserved_on_the_whole(kitchen):
    run = run_setup(prepare(kitchen, variance_reduction=False), histories=200_000, seed=6)
    deposited = sum(float(run.tallies[f"deposited/{name}"].mean) for name in kitchen.solid_names)
    assert deposited + float(run.tallies["energy/escaped"].mean) == pytest.approx(
        float(run.tallies["energy/started"].mean), rel=1e-12
    )
    # Three equal bins about 70 keV, each spread over 20 keV: 4 standard deviations.
    assert float(run.tallies["energy/started"].mean) == pytest.approx(70, abs=4 * 33.2 / math.sqrt(200_000))


# ---- backscatter -------------------------------------------------------------------------------------------------------------


def golden_cases():
    if not GOLDEN.exists():
        return [pytest.param(None, marks=pytest.mark.skip(reason="tests/golden/xray_slabs.json is not there"))]
    cases = json.loads(GOLDEN.read_text(encoding="utf-8"))["cases"]
    # At 30 keV the cross sections differ by more than these tests allow, see test_slab_tables.py.
    cases = [case for case in cases if case["energy_kev"] > 30]
    return [pytest.param(case, id=f"{case['material']} {case['energy_kev']:g} keV") for case in cases]


@pytest.mark.parametrize("case", golden_cases())
def test_slabs_scatter_back_as_much_as_penred_says(case):
    """penRed follows the physics of PENELOPE 2018 with tables of its own: 0.5 % for water, 1.5 % for aluminium."""
    compound = {"name": case["material"], "density": case["density"], "fractions": case["mass_fractions"]}
    described = scene(
        solid("slab", sc.Box(centre=(0, 0, 5), size=(100, 100, 10)), compound),
        world=sc.World(size=(400, 400, 400), material="vacuum"),
        source=sc.Source(position=(0, 0, -10), spectrum={"energy": case["energy_kev"]}, activity=1),
    )
    run = run_setup(prepare(compile_scene(described), variance_reduction=False), histories=6_000_000, seed=7)
    found, mine = run.tallies["escaped/backward"], run.tallies["escaped/cosine"]
    allowed = 0.005 if case["material"] == "water" else 0.015
    # Beyond it 3 standard deviations: a false alarm for one of 370 seeds, were the physics off by all that is allowed.
    error = math.hypot(float(found.standard_error), case["standard_error"])
    expected = case["fraction"]
    assert float(found.mean) == pytest.approx(expected, abs=allowed * expected + 3 * error)
    # By direction, in 40 bins, each with 4 standard deviations.
    angles = case["angle_histogram"]
    np.testing.assert_allclose(mine.edges[0][:41], angles["edges"], atol=1e-12)
    expected = np.array(angles["values"])
    error = np.hypot(mine.standard_error[:40], angles["standard_errors"])
    assert (np.abs(mine.mean[:40] - expected) < allowed * expected + 4 * error).all()
