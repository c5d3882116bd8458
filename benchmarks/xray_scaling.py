"""Cost of a history over the triangles of a mesh and the cells of a voxel volume.

    python benchmarks/xray_scaling.py [--largest 7]

A cone of 60 keV photons meets a water sphere of 100 mm: as a mesh of 10² to 10⁶ triangles, and as voxels of 10³ to 10⁷ cells.
Prints nanoseconds for a history, analog, one thread, for each, with an ellipsoid in the same run beside it, and the memory.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from shadowgram.xray._compile import compile_scene
from shadowgram.xray._solids import Ellipsoid, Mesh, Solid, Voxels
from shadowgram.xray.montecarlo.arrays import ORDERS
from shadowgram.xray.montecarlo.run import batch_vector
from shadowgram.xray.scene import Energies, Scene, Source, World
from shadowgram.xray.simulation import prepare

HISTORIES, REPEATS, RADIUS = 100_000, 5, 50.0
BACKWARDS = 1 + len(ORDERS)
"""Place of what leaves backwards in the vector of a batch without detectors."""


def scene(shape: Ellipsoid | Mesh | Voxels) -> Scene:
    """The sphere in a cone that covers it."""
    solid = Solid(name="sphere", role="target", shape=shape, material=None if isinstance(shape, Voxels) else "water")
    return Scene(
        world=World(size=(1000, 1000, 1000), material="vacuum"),
        source=Source(position=(0, 0, -300), half_angle=0.16, spectrum=Energies(energy=60), activity=1e6),
        solids=(solid,),
    )


def cost(shape: Ellipsoid | Mesh | Voxels) -> tuple[float, float, float]:
    """(ns a history, share that leaves backwards, megabytes of the geometry)."""
    setup = prepare(compile_scene(scene(shape)), variance_reduction=False)
    batch_vector(setup, 0, 0, 1000)
    best, found = np.inf, None
    for _ in range(REPEATS):
        begun = time.perf_counter()
        found = batch_vector(setup, 0, 0, HISTORIES)
        best = min(best, time.perf_counter() - begun)
    assert found is not None
    bodies = (*setup.geometry.meshes, *setup.geometry.voxels)
    return best / HISTORIES * 1e9, float(found[BACKWARDS]) / HISTORIES, sum(a.nbytes for a in bodies) / 1e6


def mesh_file(folder: Path, level: int) -> tuple[Path, int]:
    """An icosphere in a file."""
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=level, radius=RADIUS)
    path = folder / f"sphere-{level}.stl"
    sphere.export(path)
    return path, len(sphere.faces)


def voxel_file(folder: Path, cells: int) -> Path:
    """The sphere in cells, 1 = water, 0 = vacuum."""
    side = (np.arange(cells) + 0.5) / cells * 2 - 1
    x, y, z = np.meshgrid(side, side, side, indexing="ij", sparse=True)
    path = folder / f"sphere-{cells}.npy"
    np.save(path, (x * x + y * y + z * z <= 1).astype(np.int16))
    return path


def main() -> None:
    """Print a line for each body."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--largest", type=int, default=7, help="10 to this power is the most cells; a power less triangles"
    )
    options = parser.parse_args()
    print("body                     elements  ns a history  backwards   MB")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        show("ellipsoid", 1, cost(Ellipsoid(centre=(0, 0, 0), semi_axes=(RADIUS,) * 3)))
        for level in range(1, 9):
            path, faces = mesh_file(folder, level)
            if faces <= 1.5 * 10 ** (options.largest - 1):
                show("mesh, triangles", faces, cost(Mesh(file=str(path))))
        for power in np.arange(3, options.largest + 0.5):
            cells = round(10 ** (power / 3))
            pitch = 2 * RADIUS / cells
            shape = Voxels(
                file=str(voxel_file(folder, cells)),
                materials=("vacuum", "water"),
                pitch=(pitch, pitch, pitch),
                corner=(-RADIUS, -RADIUS, -RADIUS),
            )
            show("voxels, cells", cells**3, cost(shape))


def show(body: str, elements: int, found: tuple[float, float, float]) -> None:
    """One line."""
    print(f"{body:24} {elements:8d} {found[0]:13.0f} {found[1]:10.4f} {found[2]:6.1f}", flush=True)


if __name__ == "__main__":
    main()
