"""Meshes, outlines and voxels: rays against plain loops over all faces, rays through corners, and damaged files."""

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest

from shadowgram.xray._bodies import (
    body_labels,
    build_meshes,
    build_outlines,
    build_voxels,
    check_mesh,
    letter_outline,
    meshes_overlap,
    read_mesh,
)
from shadowgram.xray.montecarlo._mesh_kernels import STACK, mesh_crossing, mesh_inside
from shadowgram.xray.montecarlo._outline_kernels import outline_crossing, outline_inside
from shadowgram.xray.montecarlo._voxel_kernels import voxel_material
from shadowgram.xray.montecarlo.arrays import ENERGY_BINS, TOTAL

stack = np.empty(STACK, np.int64)


# Bodies


def icosphere(level, radius=1.0):
    golden = (1 + math.sqrt(5)) / 2
    points = [p for a in (-1, 1) for b in (-golden, golden) for p in ((0, a, b), (a, b, 0), (b, 0, a))]
    points = np.array(points, float)
    near = np.linalg.norm(points[:, None] - points, axis=2) < 2.1
    faces = [
        f for f in itertools.combinations(range(12), 3) if all(near[i, j] for i, j in itertools.combinations(f, 2))
    ]
    triangles = points[np.array(faces)]
    for _ in range(level):
        a, b, c = np.moveaxis(triangles, 1, 0)
        ab, bc, ca = a + b, b + c, c + a
        triangles = np.concatenate([np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
        triangles /= np.linalg.norm(triangles, axis=2, keepdims=True)
    triangles *= radius / np.linalg.norm(triangles, axis=2, keepdims=True)
    return check_mesh(np.round(triangles.reshape(-1, 3), 12), np.arange(3 * len(triangles)).reshape(-1, 3), "sphere")


def torus(large=3.0, small=1.0, n=24, m=16):
    u, v = np.meshgrid(2 * np.pi * np.arange(n) / n, 2 * np.pi * np.arange(m) / m, indexing="ij")
    ring = large + small * np.cos(v)
    points = np.stack([ring * np.cos(u), ring * np.sin(u), small * np.sin(v)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    a, b = i * m + j, (i + 1) % n * m + j
    c, d = (i + 1) % n * m + (j + 1) % m, i * m + (j + 1) % m
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return check_mesh(points, faces, "torus")


BOX_FACES = np.array([int(corner) for corner in "021123456576014154263367042246135375"]).reshape(-1, 3)


def box(low, high):
    corners = np.array([[(low, high)[i >> k & 1][k] for k in range(3)] for i in range(8)], float)
    return check_mesh(corners, BOX_FACES, "box")


def joined(bodies):
    points = np.concatenate([v for v, _ in bodies])
    shifts = np.cumsum([0, *(len(v) for v, _ in bodies)])[:-1]
    return points, np.concatenate([f + s for (_, f), s in zip(bodies, shifts, strict=True)])


def volume(mesh):
    a, b, c = np.moveaxis(mesh[0][mesh[1]], 1, 0)
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6


def rotation(rng):
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.linalg.det(q)


# Walking along rays


def stretches(inside, crossing, p, d):
    """The stretches inside, as a walker finds them that asks in turns."""
    ray = tuple(map(float, (*p, *d)))
    within, t, found = inside(*ray), 0.0, []
    for _ in range(10_000):
        following = crossing(*ray, t, within)
        assert following > t
        if within:
            assert following < math.inf
            found.append((t, following))
        if following == math.inf:
            return found
        t, within = following, not within
    pytest.fail("the walker never left")


def mesh_stretches(meshes, p, d, mesh=0):
    return stretches(
        lambda *ray: mesh_inside(meshes, mesh, stack, *ray),
        lambda *ray: mesh_crossing(meshes, mesh, stack, *ray),
        p,
        d,
    )


def outline_stretches(outlines, half_z, p, d, outline=0):
    return stretches(
        lambda *ray: outline_inside(outlines, outline, half_z, *ray),
        lambda *ray: outline_crossing(outlines, outline, half_z, *ray),
        p,
        d,
    )


def brute_stretches(mesh, p, d):
    """The stretches inside from a test of every triangle (Möller & Trumbore); for rays that meet no edge and bodies apart."""
    a, b, c = np.moveaxis(mesh[0][mesh[1]], 1, 0)
    normal = np.cross(b - a, c - a)
    down = normal @ d
    with np.errstate(divide="ignore", invalid="ignore"):
        across = np.cross(a - p, d)
        t, u, v = np.array([((a - p) * normal).sum(1), (across * (c - a)).sum(1), -(across * (b - a)).sum(1)]) / down
    hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    order = np.argsort(t[hit])
    times, leaving = t[hit][order], down[hit][order] > 0
    if len(times) and leaving[0]:
        times, leaving = np.concatenate([[0], times]), np.concatenate([[False], leaving])
    assert not leaving[0::2].any()
    assert leaving[1::2].all()
    assert len(times) % 2 == 0
    return list(zip(times[0::2], times[1::2], strict=True))


def length(found):
    return sum(b - a for a, b in found)


def convex_length(mesh, p, d):
    """Length of a ray inside a convex body, from the planes of its faces."""
    a, b, c = np.moveaxis(mesh[0][mesh[1]], 1, 0)
    normal = np.cross(b - a, c - a)
    height, down = ((a - p) * normal).sum(1), normal @ d
    if (height[down == 0] < 0).any():
        return 0.0
    entry = max(0.0, (height[down < 0] / down[down < 0]).max())
    return max(0.0, (height[down > 0] / down[down > 0]).min() - entry)


MANY = {
    "sphere": lambda rng: icosphere(3, 5.0),
    "torus": lambda rng: torus(),
    "two spheres": lambda rng: joined([icosphere(2), (icosphere(2)[0] + (1.5, 1.5, 1.0), icosphere(2)[1])]),
    "boxes": lambda rng: joined(
        [box(corner - rng.uniform(0.1, 0.45, 3), corner + rng.uniform(0.1, 0.45, 3)) for corner in np.ndindex(3, 3, 3)]
    ),
}


@pytest.mark.parametrize("kind", MANY)
def test_random_rays_agree_with_a_loop_over_all_triangles(kind):
    rng = np.random.default_rng(1)
    points, faces = MANY[kind](rng)
    points = points @ rotation(rng).T + (20, -30, 400)
    meshes = build_meshes([icosphere(0), (points, faces)])
    low, high = points.min(axis=0), points.max(axis=0)
    crossed = 0
    for _ in range(1500):
        target, p = rng.uniform(low, high), rng.uniform(low - 5, high + 5)
        d = (target - p) / np.linalg.norm(target - p)
        found, expected = mesh_stretches(meshes, p, d, 1), brute_stretches((points, faces), p, d)
        assert len(found) == len(expected)
        np.testing.assert_allclose(np.ravel(found), np.ravel(expected), atol=1e-9)
        crossed += len(found)
    assert crossed > 500


@pytest.mark.parametrize("turned", [False, True])
def test_rays_aimed_at_corners_and_edges_of_a_convex_body(turned):
    rng = np.random.default_rng(2)
    points, faces = icosphere(2, 50.0)
    if turned:
        points = points @ rotation(rng).T + (1, 2, 300)
    meshes, mesh = build_meshes([(points, faces)]), (points, faces)
    middle = points.mean(axis=0)
    edges = points[faces] * 0.5 + points[np.roll(faces, 1, axis=1)] * 0.5
    for target in np.concatenate([points, edges.reshape(-1, 3)[:300]]):
        for p in (middle, middle + rng.normal(size=3) * 10, middle + rng.normal(size=3) * 100):
            d = target - p
            for direction in (d, -d, d / np.linalg.norm(d)):
                assert length(mesh_stretches(meshes, p, direction)) == pytest.approx(
                    convex_length(mesh, p, direction), abs=1e-9, rel=1e-9
                )


def test_rays_from_one_corner_to_another_and_from_places_on_the_surface():
    rng = np.random.default_rng(3)
    points, faces = icosphere(1, 2.0)
    meshes = build_meshes([(points, faces)])
    through = 0
    for i, j in rng.integers(len(points), size=(1500, 2)):
        weights = rng.dirichlet(np.ones(3))
        for p in (points[i], weights @ points[faces[i]]):
            d = points[j] - p
            if not d.any():
                continue
            found, expected = length(mesh_stretches(meshes, p, d)), convex_length((points, faces), p, d)
            a, b, c = np.moveaxis(points[faces], 1, 0)
            within = (np.cross(b - a, c - a) * (a - p - 0.5 * expected * d)).sum(1).min() > 1e-9
            # Of a ray in a face or along an edge any part, up to the other corner, may count as inside or as outside.
            assert (expected if within else 0.0) - 1e-9 <= found <= (expected if within else 1.0) + 1e-9
            through += within
    assert through > 2000


def interval(low, high, p, d):
    """Where a ray is in a box, and whether only in its faces; exact."""
    begin, end, grazing = Fraction(0), None, False
    for k in range(3):
        if d[k] == 0:
            if not low[k] <= p[k] <= high[k]:
                return None
            grazing |= p[k] in (low[k], high[k])
            continue
        a, b = sorted((Fraction(int(low[k] - p[k]), int(d[k])), Fraction(int(high[k] - p[k]), int(d[k]))))
        begin, end = max(begin, a), b if end is None else min(end, b)
    return None if end <= begin else (begin, end, grazing)


def union_length(parts):
    total, reached = Fraction(0), Fraction(0)
    for begin, end, _ in sorted(parts):
        total += max(Fraction(0), end - max(begin, reached))
        reached = max(reached, end)
    return total


def test_lattice_rays_through_bodies_that_touch():
    """Rays in faces, along edges, through corners, from one body into the next: all lengths are known exactly.

    A stretch in a face may count or not, nothing else may differ.
    """
    rng = np.random.default_rng(4)
    cells = np.array([c for c in np.ndindex(4, 4, 4) if rng.random() < 0.4])
    points, faces = joined([box(c, c + 1) for c in cells])
    meshes = build_meshes([(points, faces)])
    grazed = 0
    for _ in range(3000):
        p, d = rng.integers(-2, 7, 3), rng.integers(-3, 4, 3)
        if not d.any():
            continue
        parts = [part for c in cells if (part := interval(c, c + 1, p, d))]
        least, most = union_length([part for part in parts if not part[2]]), union_length(parts)
        found = length(mesh_stretches(meshes, p.astype(float), d.astype(float)))
        assert float(least) - 1e-9 <= found <= float(most) + 1e-9
        grazed += least < most
    assert grazed > 100


def test_touching_bodies_are_one_stretch():
    mesh = joined([box((0, 0, 0), (1, 1, 1)), box((1, 0, 0), (2, 1, 1))])
    meshes = build_meshes([mesh])
    ((begin, end),) = mesh_stretches(meshes, (-1, 0.3, 0.4), (1, 0, 0))
    assert (begin, end) == pytest.approx((1, 3), abs=1e-15)
    # Turned, the two faces that touch come at slightly different distances, in any order.
    rng = np.random.default_rng(5)
    for _ in range(300):
        R = rotation(rng)
        meshes = build_meshes([(mesh[0] @ R.T, mesh[1])])
        p, d = R @ (-1, *rng.uniform(0.1, 0.9, 2)), R @ (1, 0, 0)
        assert length(mesh_stretches(meshes, p, d)) == pytest.approx(2.0, abs=1e-12)


def test_a_walker_that_is_not_where_it_believes_is_put_right():
    meshes = build_meshes([icosphere(2, 1.0)])
    outside, inside, d = (-3.0, 0.1, 0.2), (0.1, 0.2, 0.3), (1.0, 0.0, 0.0)
    assert mesh_crossing(meshes, 0, stack, *outside, *d, 0.5, True) == 0.5
    assert mesh_crossing(meshes, 0, stack, *outside, *d, 10.0, True) == 10.0
    assert mesh_crossing(meshes, 0, stack, *outside, *d, 10.0, False) == math.inf
    assert mesh_crossing(meshes, 0, stack, *inside, *d, 0.25, False) == 0.25
    assert mesh_inside(meshes, 0, stack, *inside, *d)
    assert not mesh_inside(meshes, 0, stack, *outside, *d)


def test_long_thin_triangles_have_no_gaps():
    """A cylinder of 2 × 4000 slivers 100 long and 0.002 wide, and fans that meet in one corner."""
    n = 4000
    angle = 2 * np.pi * np.arange(n) / n
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], 1)
    up = np.array((0, 0, 50))
    points = np.concatenate([ring - up, ring + up, [[0, 0, -50], [0, 0, 50]]])
    i, j = np.arange(n), np.roll(np.arange(n), -1)
    low, high = np.full(n, 2 * n), np.full(n, 2 * n + 1)
    faces = np.concatenate(
        [np.stack(f, 1) for f in ((i, j, j + n), (i, j + n, i + n), (low, j, i), (high, i + n, j + n))]
    )
    points, faces = check_mesh(points, faces, "cylinder")
    meshes = build_meshes([(points, faces)])
    rng = np.random.default_rng(6)
    for target in points[rng.integers(len(points), size=300)]:
        p = rng.normal(size=3) * (0.1, 0.1, 10)
        ((begin, end),) = mesh_stretches(meshes, p, target - p)
        assert begin == 0.0
        assert end == pytest.approx(1.0, abs=1e-9)


def test_chord_of_a_fine_sphere():
    meshes = build_meshes([icosphere(6, 1.0)])
    rng = np.random.default_rng(7)
    for offset in rng.uniform(0, 0.95, 50):
        a = rng.uniform(0, 2 * np.pi)
        found = length(mesh_stretches(meshes, (offset * math.cos(a), offset * math.sin(a), -5.0), (0, 0, 1.0)))
        assert found == pytest.approx(2 * math.sqrt(1 - offset**2), abs=2e-3)


def tree_depth(meshes):
    depth = {0: 1}
    for node, (left, right) in enumerate(meshes.node_child):
        if left >= 0:
            depth[int(left)] = depth[int(right)] = depth[node] + 1
        else:
            assert 1 <= right <= 4
    return max(depth.values())


@pytest.mark.parametrize("ratio", [1.0, 1.5])
def test_trees_of_nested_bodies_stay_within_the_stack(ratio):
    """Boxes in boxes, where cutting by area alone makes a tree 56 deep, and boxes that coincide, where there is nothing to cut."""
    mesh = joined([box((-(ratio**-i),) * 3, (ratio**-i,) * 3) for i in range(100)])
    meshes = build_meshes([mesh])
    assert tree_depth(meshes) <= 33 + math.log2(len(mesh[1]) / 4) <= STACK
    np.testing.assert_allclose(mesh_stretches(meshes, (-3.0, 0.1, 0.2), (1.0, 0, 0)), [(2, 4)], atol=1e-14)


# Outlines


def star_ring(rng, n=15):
    """A ring between two star-shaped loops, as loops and as a mesh of height 2."""
    angle = 2 * np.pi * (np.arange(n) + rng.uniform(-0.3, 0.3, n)) / n
    outer = (rng.uniform(1.5, 4, n) * (np.cos(angle), np.sin(angle))).T
    inner = outer * 0.4
    points = np.concatenate([np.column_stack([loop, np.full(n, z)]) for z in (-1.0, 1.0) for loop in (outer, inner)])
    i, j = np.arange(n), np.roll(np.arange(n), -1)
    quads = [
        (i, j, j + 2 * n, i + 2 * n),
        (j + n, i + n, i + 3 * n, j + 3 * n),
        (i, i + n, j + n, j),
        (i + 2 * n, j + 2 * n, j + 3 * n, i + 3 * n),
    ]
    faces = np.concatenate([np.stack(t, 1) for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    return [outer, inner], check_mesh(points, faces, "ring")


def test_outline_agrees_with_the_mesh_of_the_same_body():
    rng = np.random.default_rng(8)
    crossed = 0
    for _ in range(20):
        loops, mesh = star_ring(rng)
        outlines, meshes = build_outlines([[[(0, 0), (1, 0), (0, 1)]], loops]), build_meshes([mesh])
        for _ in range(100):
            p, target = rng.uniform(-5, 5, 3) * (1, 1, 0.4), rng.uniform(-3, 3, 3) * (1, 1, 0.3)
            for d in (target - p, (target - p) * (1, 1, 0), np.array([0, 0, 1.0]), np.array([0, 0, -2.0])):
                found, expected = outline_stretches(outlines, 1.0, p, d, 1), mesh_stretches(meshes, p, d)
                assert len(found) == len(expected)
                np.testing.assert_allclose(np.ravel(found), np.ravel(expected), atol=1e-9)
                crossed += len(found)
    assert crossed > 4000


def test_outline_through_its_corners():
    rng = np.random.default_rng(9)
    loops, mesh = star_ring(rng)
    outlines, meshes = build_outlines([loops]), build_meshes([mesh])
    for corner in np.concatenate(loops):
        for z in (-1.0, 0.3, 1.0):
            for _ in range(10):
                p = rng.uniform(-5, 5, 3)
                d = np.array([*corner, z]) - p
                # On the mesh the corner is missed by 1e-9 one way or the other.
                lengths = [length(mesh_stretches(meshes, p + rng.normal(size=3) * 1e-9, d)) for _ in range(8)]
                found = length(outline_stretches(outlines, 1.0, p, d))
                assert min(abs(found - one) for one in lengths) < 1e-6


def test_outline_on_lattice_rays():
    """A cross of five squares and a hole; rays in its sides, through its corners, in its caps."""
    plus = [(1, 0), (2, 0), (2, 1), (3, 1), (3, 2), (2, 2), (2, 3), (1, 3), (1, 2), (0, 2), (0, 1), (1, 1)]
    outlines = build_outlines([[4 * np.array(plus), [(5, 5), (7, 5), (7, 7), (5, 7)]]])
    low = [(4, 0), (0, 4), (8, 4), (4, 8), (4, 4), (4, 7), (4, 5), (7, 5)]
    high = [(8, 4), (4, 8), (12, 8), (8, 12), (8, 5), (8, 8), (5, 7), (8, 7)]
    rng = np.random.default_rng(10)
    for _ in range(3000):
        p, d = rng.integers(-2, 15, 3) * (1, 1, 0) + rng.integers(-3, 4, 3) * (0, 0, 1), rng.integers(-3, 4, 3)
        if not d.any():
            continue
        boxes = [(np.array([*a, -2]), np.array([*b, 2])) for a, b in zip(low, high, strict=True)]
        parts = [part for a, b in boxes if (part := interval(a, b, p, d))]
        least, most = union_length([part for part in parts if not part[2]]), union_length(parts)
        found = length(outline_stretches(outlines, 2.0, p.astype(float), d.astype(float)))
        assert float(least) - 1e-9 <= found <= float(most) + 1e-9


def test_loops_run_around_the_material():
    square = np.array([(0, 0), (0, 8), (8, 8), (8, 0)])
    loops = [square, square * 0.5 + 2, square * 0.25 + 3, (square + 20)[::-1]]
    edges = build_outlines([loops]).edge.reshape(4, 4, 4)
    areas = (edges[..., 0] * edges[..., 3] - edges[..., 2] * edges[..., 1]).sum(axis=1) / 2
    assert areas.tolist() == [64, -16, 4, 64]


def test_outlines_refuse_what_bounds_nothing():
    for loops, message in (
        ([], "has no loops"),
        ([[(0, 0), (1, 0), (1, 0)]], "3 different points, got 2"),
        ([[(0, 0), (1, 0), (0, math.nan)]], "finite"),
        ([[(0, 0, 0)] * 3], "shape"),
        ([[(0, 0), (1, 1), (1, 0), (0, 1)]], "cross or touch"),
        ([[(0, 0), (2, 0), (1, 0), (1, 1)]], "cross or touch"),
        ([[(0, 0), (4, 0), (4, 4), (2, 0), (0, 4)]], "cross or touch"),
        ([[(0, 0), (4, 0), (0, 4)], [(1, 1), (9, 1), (1, 2)]], "loop 0 and loop 1"),
        ([[(0, 0), (4, 0), (0, 4)], [(0, 0), (4, 0), (0, 4)]], "cross or touch"),
    ):
        with pytest.raises(ValueError, match=message):
            build_outlines([loops])
    assert len(build_outlines([[[(0, 0), (1, 0), (0, 1), (0, 0)]]]).edge) == 3


def test_letters():
    everything = "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789"
    outlines = build_outlines([letter_outline(letter, 28.0) for letter in everything])
    shapes = set()
    for i, letter in enumerate(everything):
        edges = outlines.edge[outlines.start[i] : outlines.start[i + 1]]
        assert edges[:, 1].min() == -14
        assert edges[:, 1].max() == 14
        area = (edges[:, 0] * edges[:, 3] - edges[:, 2] * edges[:, 1]).sum() / 2
        assert 100 < area < 350, letter
        shapes.add(edges.tobytes())
    assert len(shapes) == len(everything)
    word = build_outlines([letter_outline("ud 7", 10.0)])
    assert word.edge[:, 0].max() == -word.edge[:, 0].min()
    for text, height, message in (("", 1.0, "at least one"), ("A-B", 1.0, "'-'"), ("A", math.inf, "height")):
        with pytest.raises(ValueError, match=message):
            letter_outline(text, height)


def test_holes_of_letters_are_empty():
    outlines = build_outlines([letter_outline("O", 14.0)])
    assert outline_stretches(outlines, 1.0, (-20.0, 0.1, 0.0), (1.0, 0, 0)) == [(15.0, 17.0), (23.0, 25.0)]


# Voxels


def test_voxels():
    rng = np.random.default_rng(11)
    table = np.zeros((5, ENERGY_BINS, 10))
    table[..., TOTAL] = rng.uniform(5, 9, (5, ENERGY_BINS))
    table[..., TOTAL + 1] = rng.uniform(-0.01, 0.01, (5, ENERGY_BINS))
    first, second = rng.integers(0, 5, (3, 4, 5)), np.full((2, 2, 2), 3)
    voxels = build_voxels([(first, (1, 2, 0.5)), (second, (1, 1, 1))], table)
    for index in np.ndindex(first.shape):
        place = (np.array(index) + rng.uniform(0, 1, 3)) * (1, 2, 0.5)
        assert voxel_material(voxels, 0, *place) == first[index]
    assert voxel_material(voxels, 0, -1.0, 100.0, 2.5) == first[0, 3, 4]
    assert voxel_material(voxels, 1, 0.5, 0.5, 0.5) == 3
    for energy in rng.uniform(1, 511.9, 300):
        part, exponent = math.frexp(energy)
        here = (exponent - 1) * 128 + int((2 * part - 1) * 128)
        values = table[:, here, TOTAL] + table[:, here, TOTAL + 1] * energy
        assert voxels.majorant[0, here] >= values.max()
        assert voxels.majorant[0, here] <= values.max() + 0.021 * energy / 128 + 1e-6
        assert values[3] <= voxels.majorant[1, here] <= values[3] + 0.011 * energy / 128 + 1e-6


def test_voxels_refuse_what_they_cannot_hold():
    table = np.zeros((2, ENERGY_BINS, 10))
    for cells, pitch, message in (
        (np.zeros((2, 2), int), (1, 1, 1), r"\(x, y, z\)"),
        (np.zeros((2, 2, 2)), (1, 1, 1), "whole numbers"),
        (np.full((2, 2, 2), 2), (1, 1, 1), "0 to 1, got 2 to 2"),
        (np.full((2, 2, 2), -1), (1, 1, 1), "got -1"),
        (np.zeros((0, 2, 2), int), (1, 1, 1), "whole numbers"),
        (np.zeros((2, 2, 2), int), (1, 0, 1), "positive lengths"),
        (np.zeros((2, 2, 2), int), (1, math.inf, 1), "positive lengths"),
        (np.zeros((2, 2, 2), int), 1.0, "positive lengths"),
    ):
        with pytest.raises(ValueError, match=message):
            build_voxels([(cells, pitch)], table)


# What a mesh must be


def test_soup_is_merged_and_flat_faces_are_dropped():
    points, faces = box((0, 0, 0), (1, 2, 3))
    soup = np.concatenate([points[faces].reshape(-1, 3), [[0, 0, 0], [-0.0, 0, 0], [1, 2, 3], [9, 9, 9]]])
    merged = check_mesh(soup, np.arange(len(faces) * 3 + 3).reshape(-1, 3), "soup")
    assert merged[0].shape == (8, 3)
    assert merged[1].shape == (12, 3)
    assert volume(merged) == pytest.approx(6)


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_faces_are_turned_outwards(share):
    rng = np.random.default_rng(12)
    points, faces = joined([torus(), box((10, 0, 0), (11, 1, 1))])
    wrong = faces.copy()
    turn = rng.random(len(faces)) < share
    wrong[turn] = wrong[turn][:, ::-1]
    assert volume(check_mesh(points, wrong, "turned")) == pytest.approx(volume((points, faces)))


def test_one_body_inside_out_is_turned_and_a_cavity_is_not():
    large, hole, other = box((0, 0, 0), (4, 4, 4)), box((1, 1, 1), (2, 2, 2)), box((6, 0, 0), (7, 1, 1))
    reverse = lambda mesh: (mesh[0], mesh[1][:, ::-1])  # noqa: E731
    for bodies in ((large, reverse(hole), reverse(other)), (reverse(large), hole, other)):
        mesh = check_mesh(*joined(bodies), "bodies")
        assert volume(mesh) == pytest.approx(64 - 1 + 1)
    found = mesh_stretches(build_meshes([mesh]), (-1.0, 1.3, 1.4), (1.0, 0, 0))
    np.testing.assert_allclose(found, [(1, 2), (3, 5)], atol=1e-14)
    assert len(np.unique(body_labels(*mesh))) == 3


def test_bodies_may_touch_along_an_edge():
    mesh = check_mesh(*joined([box((0, 0, 0), (1, 1, 1)), box((1, 1, 0), (2, 2, 1))]), "two")
    assert volume(mesh) == pytest.approx(2)
    assert len(np.unique(body_labels(*mesh))) == 2


def test_what_bounds_no_body_is_refused():
    points, faces = box((0, 0, 0), (1, 1, 1))
    n = 5
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    at = lambda a, b: np.where(a < n, a * n + b % n, (-b) % n)  # noqa: E731  # a Klein bottle: glued with a twist
    a, b, c, d = at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)
    klein = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    somewhere = np.random.default_rng(13).normal(size=(n * n, 3))
    for vertices, corners, message in (
        (points, faces[:-1], "not closed: 3 of its 18 edges belong to one face only; fill the holes"),
        (points, np.concatenate([faces, faces[:1]]), "3 of its 18 edges belong to three or more faces"),
        (points, faces[:0], "no triangle"),
        (points, [[0, 1, 1]], "no triangle"),
        (points, [[0, 1, 2], [0, 2, 1]], "no volume"),
        (points * (1, 1, 0), faces, "no volume"),
        (somewhere, klein, "no inner side"),
        (points, faces + 1, "vertices 0 to 7, got 8"),
        (points * math.nan, faces, "finite"),
        (points, faces * 1.0, "whole numbers"),
        (points[:, :2], faces, "shape"),
    ):
        with pytest.raises(ValueError, match=message):
            check_mesh(vertices, corners, "the body")


# Overlap


def wedge(points):
    """A prism over a triangle in (x, z), 1 long in y."""
    corners = np.array([(x, y, z) for y in (0.0, 1.0) for x, z in points])
    faces = [[0, 1, 2], [3, 5, 4], [0, 3, 4], [0, 4, 1], [1, 4, 5], [1, 5, 2], [2, 5, 3], [2, 3, 0]]
    return check_mesh(corners, faces, "wedge")


CUBE = ((0, 0, 0), (1, 1, 1))
HOLLOW = joined([box((0, 0, 0), (3, 3, 3)), (box(*CUBE)[0] + 1, box(*CUBE)[1][:, ::-1])])
PAIRS = {
    "apart": (box(*CUBE), box((2, 0, 0), (3, 1, 1)), False),
    "face to face": (box(*CUBE), box((1, 0, 0), (2, 1, 1)), False),
    "face to part of a face": (box(*CUBE), box((1, 0.2, -3), (2, 0.6, 0.5)), False),
    "edge to edge": (box(*CUBE), box((1, 1, 0), (2, 2, 1)), False),
    "corner to corner": (box(*CUBE), box((1, 1, 1), (2, 2, 2)), False),
    "in a cavity": (HOLLOW, box((1, 1, 1), (2, 2, 2)), False),
    "through a ring": (torus(), box((-0.5, -0.5, -3), (0.5, 0.5, 3)), False),
    "wedge on a box": (wedge([(0.3, 1), (0.7, 1), (0.31, 1.02)]), box(*CUBE), False),
    "wedge in a wedge": (wedge([(0, 0), (1, 0), (1, 0.2)]), wedge([(0, 0), (1, 0.2), (0, 0.2)]), False),
    "the same": (box(*CUBE), box(*CUBE), True),
    "the same sphere": (icosphere(3), icosphere(3), True),
    "shifted along": (box(*CUBE), box((0.5, 0, 0), (1.5, 1, 1)), True),
    "shifted a little": (box(*CUBE), box((0.999, 0, 0), (1.5, 1, 1)), True),
    "within": (box(*CUBE), box((0.2, 0.2, 0.2), (0.8, 0.8, 0.8)), True),
    "within, sharing a wall": (box(*CUBE), box((0, 0.2, 0.2), (0.8, 0.8, 0.8)), True),
    "half of it": (box(*CUBE), box((0, 0, 0), (0.5, 1, 1)), True),
    "a rod through": (box(*CUBE), box((-1, 0.5, 0.5), (2, 0.51, 0.51)), True),
    "a cross of bars": (box((0, 0, 0), (3, 1, 1)), box((1, -1, 0), (2, 2, 1)), True),
    "a needle in a face": (box(*CUBE), wedge([(0.4, 1.5), (0.5, 0.99), (0.6, 1.5)]), True),
    "on the ring": (torus(), box((2.8, -0.1, -0.1), (3, 0.1, 0.1)), True),
    "spheres": (icosphere(3), (icosphere(3)[0] + (1.1, 1.1, 1.1), icosphere(3)[1]), True),
    "spheres apart": (icosphere(3), (icosphere(3)[0] + (1.2, 1.2, 1.2), icosphere(3)[1]), False),
}


@pytest.mark.parametrize("case", PAIRS)
def test_overlap(case):
    a, b, expected = PAIRS[case]
    assert meshes_overlap(a, b) == meshes_overlap(b, a) == expected
    rng = np.random.default_rng(14)
    for dtype in (np.float64, np.float32):
        for _ in range(5):
            R, shift = rotation(rng), rng.normal(size=3)
            moved = [(((v @ R.T) + shift).astype(dtype).astype(float), f) for v, f in (a, b)]
            assert meshes_overlap(*moved) == expected


# Files


def stl_bytes(mesh):
    triangles = np.zeros(len(mesh[1]), [("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("rest", "<u2")])
    triangles["corner"] = mesh[0][mesh[1]]
    return b"made for a test".ljust(80) + np.uint32(len(triangles)).tobytes() + triangles.tobytes()


def stl_text(mesh):
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in triangle)
        + "endloop\nendfacet\n"
        for triangle in mesh[0][mesh[1]].tolist()
    )
    return f"solid test\n{facets}endsolid test\n".encode()


def obj_text(mesh):
    lines = ["mtllib other.mtl", "o test", *(f"v {x} {y} {z}" for x, y, z in mesh[0].tolist()), "usemtl red"]
    return "\n".join([*lines, *(f"f {a} {b} {c}" for a, b, c in (mesh[1] + 1).tolist()), ""]).encode()


def ply_bytes(mesh, kind="ascii", count=None):
    head = (
        f"ply\nformat {kind} 1.0\nelement vertex {count or len(mesh[0])}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(mesh[1])}\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()
    if kind == "ascii":
        rows = [" ".join(map(str, p)) for p in mesh[0].tolist()] + [
            "3 " + " ".join(map(str, f)) for f in mesh[1].tolist()
        ]
        return head + "\n".join([*rows, ""]).encode()
    faces = np.zeros(len(mesh[1]), [("count", "u1"), ("corner", "<i4", 3)])
    faces["count"], faces["corner"] = 3, mesh[1]
    return head + mesh[0].astype("<f4").tobytes() + faces.tobytes()


GOOD = {
    "binary.stl": stl_bytes,
    "text.STL": stl_text,
    "text.obj": obj_text,
    "text.ply": ply_bytes,
    "binary.ply": lambda mesh: ply_bytes(mesh, "binary_little_endian"),
}


@pytest.mark.parametrize("name", GOOD)
def test_files_hold_what_was_written(tmp_path, name):
    mesh = torus()
    (tmp_path / name).write_bytes(GOOD[name](mesh))
    read = check_mesh(*read_mesh(tmp_path / name, scale=10), name)
    assert read[0].shape == mesh[0].shape
    assert volume(read) == pytest.approx(1000 * volume(mesh), rel=1e-5)


def test_several_solids_in_a_text_are_one_mesh(tmp_path):
    a, b = box(*CUBE), box((3, 0, 0), (4, 1, 1))
    (tmp_path / "two.stl").write_bytes(stl_text(a) + stl_text(b))
    assert volume(check_mesh(*read_mesh(tmp_path / "two.stl"), "two")) == pytest.approx(2)


def nan_box():
    points, faces = box(*CUBE)
    points[3, 1] = math.nan
    return points, faces


HOSTILE = {
    "cut.stl": (stl_bytes(box(*CUBE))[:-10], "promises 12 triangles in 684 bytes, but it has 674"),
    "long.stl": (stl_bytes(box(*CUBE)) + b"more", "promises 12"),
    "head.stl": (stl_bytes(box(*CUBE))[:50], "not an STL file"),
    "empty.stl": (b"", "it is empty"),
    "none.stl": (stl_bytes((np.zeros((0, 3)), np.zeros((0, 3), int))), "no triangles"),
    "nan.stl": (stl_bytes(nan_box()), "not finite"),
    "words.stl": (b"Once upon a time there was a box.\n" * 20, "not an STL file"),
    "cut_text.stl": (stl_text(box(*CUBE))[:-40], "ends with 'endsolid'"),
    "words_text.stl": (stl_text(box(*CUBE)).replace(b"vertex 1.0", b"vertex one"), "damaged"),
    "odd_text.stl": (stl_text(box(*CUBE)).replace(b"vertex 1.0 1.0 1.0\n", b"", 1), "damaged"),
    "nan_text.stl": (stl_text(nan_box()), "not finite"),
    "words.obj": (b"Once upon a time there was a box.\n" * 20, "no triangles|damaged"),
    "beyond.obj": (obj_text(box(*CUBE)) + b"f 1 2 99\n", "damaged|names vertex"),
    "nan.obj": (obj_text(nan_box()), "not finite|damaged"),
    "points.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no triangles"),
    "words.ply": (b"Once upon a time there was a box.\n" * 20, "damaged"),
    "endless.ply": (b"ply\nformat ascii 1.0\n", "damaged"),
    "cut.ply": (ply_bytes(box(*CUBE), "binary_little_endian")[:-10], "damaged"),
    "huge.ply": (ply_bytes(box(*CUBE), "binary_little_endian", 10**15), "damaged"),
    "beyond.ply": (ply_bytes((box(*CUBE)[0], BOX_FACES + 3)), "damaged|names vertex"),
    "nan.ply": (ply_bytes(nan_box()), "not finite"),
    "pickle.pkl": (b"\x80\x04]\x94.", "must end with .stl, .obj or .ply"),
    "pickle.stl": (b"\x80\x04]\x94." * 30, "promises|not an STL"),
    "zip.ply": (b"PK\x03\x04" * 30, "damaged"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused_in_one_sentence(tmp_path, name):
    content, message = HOSTILE[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=message) as caught:
        read_mesh(tmp_path / name)
    assert str(caught.value).startswith(f"cannot read {tmp_path / name}: ")
    assert "\n" not in str(caught.value)


def test_damaged_bytes_never_raise_anything_else(tmp_path):
    rng = np.random.default_rng(15)
    refused = 0
    for trial in range(200):
        name = list(GOOD)[trial % len(GOOD)]
        content = bytearray(GOOD[name](box(*CUBE)))
        for place in rng.integers(len(content), size=3):
            content[place] = rng.integers(256)
        (tmp_path / name).write_bytes(content[: rng.integers(1, len(content) + 1) if trial % 2 else None])
        try:
            check_mesh(*read_mesh(tmp_path / name), name)
        except ValueError:
            refused += 1
    assert refused > 100


def test_paths_and_scales(tmp_path, monkeypatch):
    with pytest.raises(FileNotFoundError, match="there is no file"):
        read_mesh(tmp_path / "none.stl")
    with pytest.raises(IsADirectoryError, match="is a folder"):
        read_mesh(tmp_path)
    for scale in (0, -1, math.nan, math.inf):
        with pytest.raises(ValueError, match="scale must be a positive number"):
            read_mesh(tmp_path / "none.stl", scale)
    (tmp_path / "box.stl").write_bytes(stl_bytes(box(*CUBE)))
    monkeypatch.setattr("shadowgram.xray._mesh_files.LARGEST_FILE", 100)
    with pytest.raises(ValueError, match="more than the"):
        read_mesh(tmp_path / "box.stl")


def test_target_of_the_source(data):
    path = data / "cxbi" / "UD1CM.stl"
    if not path.is_file():
        pytest.skip("the source's target UD1CM.stl is not among the real data")
    points, faces = check_mesh(*read_mesh(path), "UD1CM.stl")
    np.testing.assert_allclose(np.ptp(points, axis=0), (232.712, 129.126, 10.0), atol=1e-3)
    assert faces.shape == (580, 3)
    body = body_labels(points, faces)
    assert np.bincount(body).tolist() in ([260, 320], [320, 260])
    assert volume((points, faces)) == pytest.approx(106902.2, abs=0.1)
    letters = [(points, faces[body == k]) for k in (0, 1)]
    assert not meshes_overlap(*letters)
    # As thick as high wherever a ray along z meets it, and the chords add up to the volume.
    meshes = build_meshes([(points, faces)])
    n = 60
    low, high = points.min(axis=0)[:2], points.max(axis=0)[:2]
    chords = [
        length(mesh_stretches(meshes, (*(low + (high - low) * (np.array(cell) + 0.5) / n), -1.0), (0, 0, 1.0)))
        for cell in np.ndindex(n, n)
    ]
    assert set(np.round(chords, 4)) == {0.0, 10.0}
    assert np.mean(chords) * np.prod(high - low) == pytest.approx(106902.2, rel=0.02)
