"""What a ray costs in a mesh: nanoseconds per query for icospheres of 10² to 10⁶ triangles, build times, memory.

    python benchmarks/xray_bodies.py

One thread. Rays come from everywhere and aim at the body at random, so that from about 10⁵ triangles on most of the tree that a ray
needs is not in the caches. "per level" is the time over log₂ of the triangles: constant where the cost grows logarithmically.
"again" repeats a few rays, whose part of the tree stays in the caches. Each time is the least of several.
"""

from __future__ import annotations

import math
import time

import numpy as np
from numba import njit
from numpy.typing import NDArray

from shadowgram.xray._bodies import build_meshes, build_outlines, check_mesh, letter_outline
from shadowgram.xray.montecarlo._mesh_kernels import STACK, mesh_crossing, mesh_inside
from shadowgram.xray.montecarlo._outline_kernels import outline_crossing

RAYS, FEW, REPEATS = 100_000, 200, 5


@njit(nogil=True)
def enter(meshes, stack, rays, start, out):
    """Ask every ray where it enters mesh 0."""
    for i in range(len(rays)):
        x, y, z, u, v, w = rays[i, 0], rays[i, 1], rays[i, 2], rays[i, 3], rays[i, 4], rays[i, 5]
        out[i] = mesh_crossing(meshes, 0, stack, x, y, z, u, v, w, start[i], False)


@njit(nogil=True)
def leave(meshes, stack, rays, start, out):
    """Ask every ray where it leaves mesh 0."""
    for i in range(len(rays)):
        x, y, z, u, v, w = rays[i, 0], rays[i, 1], rays[i, 2], rays[i, 3], rays[i, 4], rays[i, 5]
        out[i] = mesh_crossing(meshes, 0, stack, x, y, z, u, v, w, start[i], True)


@njit(nogil=True)
def inside(meshes, stack, rays, start, out):
    """Ask every ray whether it begins in mesh 0."""
    for i in range(len(rays)):
        x, y, z, u, v, w = rays[i, 0], rays[i, 1], rays[i, 2], rays[i, 3], rays[i, 4], rays[i, 5]
        out[i] = start[i] + mesh_inside(meshes, 0, stack, x, y, z, u, v, w)


@njit(nogil=True)
def enter_outline(outlines, stack, rays, start, out):
    """Ask every ray where it enters outline 0."""
    for i in range(len(rays)):
        x, y, z, u, v, w = rays[i, 0], rays[i, 1], rays[i, 2], rays[i, 3], rays[i, 4], rays[i, 5]
        out[i] = outline_crossing(outlines, 0, 5.0, x, y, z, u, v, w, start[i], False) + stack[0]


def aimed(rng: np.random.Generator, count: int, radius: float) -> NDArray[np.float64]:
    """Rays (ray, 6) from a large sphere to places within a smaller one."""
    place, target = rng.normal(size=(2, count, 3))
    place *= 6 * radius / np.linalg.norm(place, axis=1, keepdims=True)
    target *= radius * np.cbrt(rng.random((count, 1))) / np.linalg.norm(target, axis=1, keepdims=True)
    d = target - place
    return np.concatenate([place, d / np.linalg.norm(d, axis=1, keepdims=True)], axis=1)


def ns(kernel, body, rays, start) -> tuple[float, NDArray[np.float64]]:
    """(Least time per ray in ns, answers)."""
    stack, out, best = np.zeros(STACK, np.int64), np.empty(len(rays)), math.inf
    for _ in range(REPEATS):
        began = time.perf_counter()
        kernel(body, stack, rays, start, out)
        best = min(best, time.perf_counter() - began)
    return best / len(rays) * 1e9, out


def seconds(call, *args) -> tuple[float, object]:
    """(Time of one call, its result)."""
    began = time.perf_counter()
    result = call(*args)
    return time.perf_counter() - began, result


def main() -> None:
    """Print one line for each mesh, then one for an outline."""
    import trimesh

    rays = aimed(np.random.default_rng(0), RAYS, 50.0)
    few = np.tile(rays[:FEW], (RAYS // FEW, 1))
    zero = np.zeros(RAYS)
    corners, faces = check_mesh(*_icosphere(trimesh, 0), "sphere")
    warm = build_meshes([(corners, faces)])
    for kernel in (enter, leave, inside):
        ns(kernel, warm, rays, zero)
    print("triangles  enter  per level  again  per level  leave  inside | check  build | bytes per triangle")
    for level in range(1, 9):
        raw = _icosphere(trimesh, level)
        check, mesh = seconds(check_mesh, *raw, "sphere")
        build, meshes = seconds(build_meshes, [mesh])
        enter_ns, entry = ns(enter, meshes, rays, zero)
        again_ns, _ = ns(enter, meshes, few, zero)
        hit = np.isfinite(entry)
        leave_ns, _ = ns(leave, meshes, rays[hit], entry[hit])
        inside_ns, _ = ns(inside, meshes, rays, zero)
        count, size = len(meshes.triangle), sum(array.nbytes for array in meshes)
        print(
            f"{count:9d} {enter_ns:6.0f} {enter_ns / math.log2(count):10.1f} {again_ns:6.0f} {again_ns / math.log2(count):10.1f}"
            f" {leave_ns:6.0f} {inside_ns:7.0f} | {check:4.2f}s {build:5.2f}s | {size / count:6.0f}",
            flush=True,
        )
    outlines = build_outlines([letter_outline("UD", 100.0)])
    ns(enter_outline, outlines, rays[:10], zero)
    print(f"outline of {len(outlines.edge)} edges: enter {ns(enter_outline, outlines, rays, zero)[0]:.0f} ns")


def _icosphere(trimesh, level: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    sphere = trimesh.creation.icosphere(subdivisions=level, radius=50.0)
    return np.array(sphere.vertices, np.float64), np.array(sphere.faces, np.int64)


if __name__ == "__main__":
    main()
