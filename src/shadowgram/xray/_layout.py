"""Whether the parts of a scene can stand where they are said to."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ._bodies import meshes_overlap
from ._placed import Placed, contains, place
from ._solids import Mesh, Voxels
from .montecarlo import arrays

if TYPE_CHECKING:
    from .scene import Detector, Mask, Scene, World

Floats = NDArray[np.float64]
Corners = tuple[Floats, Floats]

_TOUCHING = 1e-9  # mm; neighbours may share a face
_SAMPLES = 12  # along each side of a shared box


def check_layout(scene: Scene) -> None:
    """Check what can be checked without reading files.

    Raises
    ------
    ValueError
        If something lies outside the world, the source or a detector is in something, or an outline crosses itself.
    """
    check_placed(scene, placed_solids(scene, files=False))


def placed_solids(scene: Scene, *, files: bool) -> dict[str, Placed]:
    """The solids of a scene by name; those from files too if `files` is set."""
    found = {}
    for solid in scene.solids:
        if files or not isinstance(solid.shape, Mesh | Voxels):
            try:
                found[solid.name] = place(solid.shape)
            except ValueError as error:
                raise ValueError(f"the solid {solid.name!r}: {error}") from None
    return found


def check_placed(scene: Scene, placed: Mapping[str, Placed]) -> None:
    """Check where things are, as far as the solids are known."""
    for name, one in placed.items():
        _check_in_world(scene.world, f"the solid {name!r}", (one.low, one.high))
    for detector in scene.detectors:
        _check_in_world(scene.world, f"the detector {detector.name!r}", detector_corners(detector))
    if scene.mask is not None:
        for shot in {0, scene.shots - 1}:
            where = "the plate of the mask" + (f" in shot {shot}" if scene.shots > 1 else "")
            _check_in_world(scene.world, where, plate_corners(scene.mask, shot))
    _check_detectors(scene, placed)
    _check_source(scene, placed)
    _check_meshes(placed)


def world_corners(world: World) -> Corners:
    """Lower and upper corner, mm."""
    centre, half = np.array(world.centre), np.array(world.size) / 2
    return centre - half, centre + half


def detector_corners(detector: Detector) -> Corners:
    """Lower and upper corner, mm."""
    centre, half = np.array(detector.centre), np.array(detector.size) / 2
    return centre - half, centre + half


def plate_corners(mask: Mask, shot: int) -> Corners:
    """Lower and upper corner of a mask's plate in a shot, mm."""
    centre, half = np.array(mask.plate_centre(shot)), np.array([*mask.plate, mask.depth]) / 2
    return centre - half, centre + half


def _swept_plate(mask: Mask, shots: int) -> Corners:
    """Corners of the box that the plate sweeps over all shots."""
    (first_low, first_high), (last_low, last_high) = plate_corners(mask, 0), plate_corners(mask, shots - 1)
    return np.minimum(first_low, last_low), np.maximum(first_high, last_high)


def _check_in_world(world: World, what: str, corners: Corners) -> None:
    low, high = world_corners(world)
    for axis, name in enumerate("xyz"):
        if corners[0][axis] < low[axis] - _TOUCHING or corners[1][axis] > high[axis] + _TOUCHING:
            raise ValueError(
                f"{what} reaches out of the world: {name} from {corners[0][axis]:g} to {corners[1][axis]:g} mm, where the world"
                f" has {low[axis]:g} to {high[axis]:g}; move it or enlarge the world"
            )


def _shared(a: Corners, b: Corners) -> Corners | None:
    """The box that two boxes share, if they do more than touch."""
    low, high = np.maximum(a[0], b[0]), np.minimum(a[1], b[1])
    return (low, high) if (high - low > _TOUCHING).all() else None


def _check_detectors(scene: Scene, placed: Mapping[str, Placed]) -> None:
    for one, other in combinations(scene.detectors, 2):
        if _shared(detector_corners(one), detector_corners(other)):
            raise ValueError(f"the detectors {one.name!r} and {other.name!r} overlap; move them apart")
    for detector in scene.detectors:
        mine = detector_corners(detector)
        if scene.mask is not None and _shared(mine, _swept_plate(scene.mask, scene.shots)):
            raise ValueError(f"the plate of the mask runs into the detector {detector.name!r}; move one of them")
        for name, solid in placed.items():
            shared = _shared(mine, (solid.low, solid.high))
            if shared is not None and contains(solid, _grid(shared)).any():
                raise ValueError(f"the detector {detector.name!r} and the solid {name!r} overlap; move them apart")


def _grid(corners: Corners) -> Floats:
    """(point, 3) points spread over a box."""
    low, high = corners
    steps = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    return low + np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3) * (high - low)


def _check_source(scene: Scene, placed: Mapping[str, Placed]) -> None:
    """Raise unless the source is in the world's own material, be it in a hollow painted into another solid."""
    point = np.array(scene.source.position)
    low, high = world_corners(scene.world)
    if not ((low < point) & (point < high)).all():
        raise ValueError(f"the source at {_shown(point)} mm is outside the world; move it or enlarge the world")
    boxes = [(f"the detector {one.name!r}", detector_corners(one)) for one in scene.detectors]
    if scene.mask is not None:
        boxes.append(("the plate of the mask", _swept_plate(scene.mask, scene.shots)))
    for what, (lower, upper) in boxes:
        if ((lower < point) & (point < upper)).all():
            raise ValueError(f"the source at {_shown(point)} mm lies in {what}; move one of them")
    world = scene.world.material.material()
    around = None
    for solid in scene.solids:
        if solid.name in placed and contains(placed[solid.name], point[None])[0]:
            around = None if all(one.material() == world for one in solid.materials) else solid.name
    if around is not None:
        raise ValueError(
            f"the source at {_shown(point)} mm lies in the solid {around!r}; move one of them, or make a hollow: a later solid of"
            f" the world's {world.name}"
        )


def _check_meshes(placed: Mapping[str, Placed]) -> None:
    meshes = [(name, one) for name, one in placed.items() if one.kind == arrays.MESH]
    for (first, a), (second, b) in combinations(meshes, 2):
        if _shared((a.low, a.high), (b.low, b.high)) and meshes_overlap((a.vertices, a.faces), (b.vertices, b.faces)):
            raise ValueError(
                f"the meshes {first!r} and {second!r} overlap; move them apart, or make one body of them in a modeller"
            )


def _shown(point: Floats) -> str:
    return "(" + ", ".join(f"{x:g}" for x in point) + ")"
