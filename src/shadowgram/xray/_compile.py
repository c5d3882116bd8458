"""A scene as the transport kernels want it: arrays."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ._alias import alias_table
from ._bodies import build_meshes, build_outlines, build_voxels
from ._layout import check_placed, detector_corners, placed_solids, plate_corners, world_corners
from ._parts import Composition
from ._placed import Placed, across, volume
from ._solids import Solid
from .materials import Material
from .montecarlo import arrays
from .montecarlo.tables import physics_tables

if TYPE_CHECKING:
    from .scene import Detector, Mask, Scene
    from .scene import Source as SceneSource

Floats = NDArray[np.float64]

ROLES = {"environment": arrays.ENVIRONMENT, "target": arrays.TARGET, "shield": arrays.SHIELD}
_REFERENCE = 662.0
"""keV of the line of Cs-137, at which resolutions are said."""
_FWHM = 2 * math.sqrt(2 * math.log(2))
"""Full width at half maximum of a normal law of deviation 1."""
_WORLD = 0
_MASK = 1


@dataclass(frozen=True, kw_only=True, eq=False)
class Compiled:
    """A scene in arrays, at one shot.

    Attributes
    ----------
    scene, shot : what it was made from.
    geometry, physics, source, detectors : for the kernels. Solids are the world, the mask if there is one, the solids and
        the detectors.
    materials : in the order of their indices, the world's first.
    solid_names, detector_names : "world", "mask", and what the scene calls the others.
    masses : (solid) g; NaN for the world and for solids that something later cuts into.
    """

    scene: Scene
    shot: int
    geometry: arrays.Geometry
    physics: arrays.Physics
    source: arrays.Source
    detectors: arrays.Detectors
    materials: tuple[Material, ...]
    solid_names: tuple[str, ...]
    detector_names: tuple[str, ...]
    masses: Floats

    def at_shot(self, shot: int) -> Compiled:
        """The same with the mask moved to another shot, at little cost.

        Raises
        ------
        ValueError
            If there is no such shot.
        """
        _check_shot(self.scene, shot)
        mask = self.scene.mask
        if mask is None or shot == self.shot:
            return self
        box = self.geometry.box.copy()
        box[_MASK] = np.concatenate(plate_corners(mask, shot))
        frame = self.geometry.frame.copy()
        frame[_MASK, 9:] = mask.plate_centre(shot)
        moved = self.geometry.masks._replace(corner=_mask_corner(mask, shot))
        geometry = self.geometry._replace(box=box, frame=frame, alone=_alone(box), masks=moved)
        masses = self.masses.copy()
        masses[_MASK] = _mask_mass(mask) if _uncut(box, _MASK) else math.nan
        return dataclasses.replace(self, shot=shot, geometry=geometry, masses=masses)


def compile_scene(scene: Scene, shot: int = 0) -> Compiled:
    """Put a scene in arrays.

    Parameters
    ----------
    shot : 0 to ``scene.shots`` − 1; where the mask is.

    Raises
    ------
    OSError
        If a file of the scene cannot be read.
    ValueError
        If there is no such shot, or what the files hold cannot be: an open mesh, meshes that overlap, solids that reach out of
        the world.

    Examples
    --------
    >>> from shadowgram.xray._compile import compile_scene
    >>> from shadowgram.xray.scene import shipped_scene
    >>> compiled = compile_scene(shipped_scene("slab-water"))
    >>> compiled.solid_names, compiled.masses[1:].round(9)
    (('world', 'slab'), array([100.]))
    """
    _check_shot(scene, shot)
    placed = placed_solids(scene, files=True)
    check_placed(scene, placed)
    materials = _Materials()
    world = materials.index(scene.world.material)
    rows = [
        _Row(kind=arrays.BOX, material=world, role=arrays.ENVIRONMENT, box=np.concatenate(world_corners(scene.world)))
    ]
    if scene.mask is not None:
        rows.append(_mask_row(scene.mask, shot, materials))
    bodies = _Bodies()
    rows += [_solid_row(solid, placed[solid.name], materials, bodies) for solid in scene.solids]
    rows += [_detector_row(detector, i, materials) for i, detector in enumerate(scene.detectors)]
    # No line lies above 0.9 of the highest energy, so that none is kept.
    physics = physics_tables(materials.known, scene.cutoff if scene.fluorescence else 0.9 * arrays.HIGHEST_ENERGY)
    geometry = _geometry(scene, shot, rows, bodies, physics)
    return Compiled(
        scene=scene,
        shot=shot,
        geometry=geometry,
        physics=physics,
        source=_source(scene.source),
        detectors=_detectors(scene, rows),
        materials=tuple(materials.known),
        solid_names=_solid_names(scene),
        detector_names=tuple(detector.name for detector in scene.detectors),
        masses=_masses(scene, geometry, placed, materials.known),
    )


def _check_shot(scene: Scene, shot: int) -> None:
    if isinstance(shot, bool) or not isinstance(shot, int | np.integer) or not 0 <= shot < scene.shots:
        raise ValueError(f"the shot must be a whole number from 0 to {scene.shots - 1}, got {shot!r}")


def _solid_names(scene: Scene) -> tuple[str, ...]:
    mask = ("mask",) if scene.mask is not None else ()
    return ("world", *mask, *(solid.name for solid in scene.solids), *(one.name for one in scene.detectors))


class _Materials:
    """Materials in the order in which they are first used; those with the same elements and density are one."""

    def __init__(self) -> None:
        self.known: list[Material] = []

    def index(self, composition: Composition) -> int:
        """The index of a material, which is noted if it is new."""
        wanted = composition.material()
        for i, material in enumerate(self.known):
            if (material.density, material.fractions) == (wanted.density, wanted.fractions):
                return i
        self.known.append(wanted)
        return len(self.known) - 1


class _Bodies:
    """Bodies that have arrays of their own, in the order of their numbers."""

    def __init__(self) -> None:
        self.outlines: list[Placed] = []
        self.meshes: list[Placed] = []
        self.voxels: list[tuple[NDArray[np.int16], Floats]] = []


@dataclass(frozen=True, kw_only=True, eq=False)
class _Row:
    """A row of `Geometry`."""

    kind: int
    material: int
    role: int
    box: Floats
    detector: int = -1
    body: int = -1
    placed: Placed | None = None

    @property
    def frame(self) -> Floats:
        """(12,) rotation by rows and origin."""
        if self.placed is None:
            return np.concatenate([np.eye(3).ravel(), (self.box[:3] + self.box[3:]) / 2])
        return np.concatenate([self.placed.turn.ravel(), self.placed.origin])

    @property
    def size(self) -> Floats:
        """(3,) size in its own frame."""
        return (self.box[3:] - self.box[:3]) / 2 if self.placed is None else self.placed.size


def _mask_row(mask: Mask, shot: int, materials: _Materials) -> _Row:
    box = np.concatenate(plate_corners(mask, shot))
    return _Row(kind=arrays.MASK, material=materials.index(mask.material), role=arrays.SHIELD, box=box, body=0)


def _solid_row(solid: Solid, placed: Placed, materials: _Materials, bodies: _Bodies) -> _Row:
    index, body = [materials.index(one) for one in solid.materials], -1
    several = {arrays.OUTLINE: bodies.outlines, arrays.MESH: bodies.meshes}.get(placed.kind)
    if placed.kind == arrays.VOXELS:
        body = len(bodies.voxels)
        bodies.voxels.append((np.array(index, np.int16)[placed.cells], placed.pitch))
    elif several is not None:
        body = len(several)
        several.append(placed)
    role = ROLES[solid.role]
    return _Row(kind=placed.kind, material=index[0], role=role, box=placed.box, body=body, placed=placed)


def _detector_row(detector: Detector, number: int, materials: _Materials) -> _Row:
    return _Row(
        kind=arrays.BOX,
        material=materials.index(detector.material),
        role=arrays.DETECTOR,
        box=np.concatenate(detector_corners(detector)),
        detector=number,
    )


def _geometry(scene: Scene, shot: int, rows: list[_Row], bodies: _Bodies, physics: arrays.Physics) -> arrays.Geometry:
    box = np.array([row.box for row in rows])
    return arrays.Geometry(
        world=np.stack(world_corners(scene.world)),
        kind=np.array([row.kind for row in rows], np.int64),
        material=np.array([row.material for row in rows], np.int64),
        role=np.array([row.role for row in rows], np.int64),
        detector=np.array([row.detector for row in rows], np.int64),
        body=np.array([row.body for row in rows], np.int64),
        box=box,
        turned=np.array([row.placed is not None and row.placed.turned for row in rows], np.uint8),
        frame=np.array([row.frame for row in rows]),
        size=np.array([row.size for row in rows]),
        alone=_alone(box),
        outlines=build_outlines([one.loops for one in bodies.outlines]),
        meshes=build_meshes([(one.vertices, one.faces) for one in bodies.meshes]),
        voxels=build_voxels(bodies.voxels, physics.attenuation),
        masks=_masks(scene.mask, shot),
    )


def _alone(box: Floats) -> NDArray[np.uint8]:
    """1 where no later box touches."""
    return np.array([not _meeting(box, i, 0.0).any() and i != _WORLD for i in range(len(box))], np.uint8)


def _uncut(box: Floats, i: int) -> bool:
    return not _meeting(box, i, -1e-5).any()


def _meeting(box: Floats, i: int, margin: float) -> NDArray[np.bool_]:
    """Which later boxes come within `margin` mm of box i."""
    later = box[i + 1 :]
    return np.all((later[:, :3] <= box[i, 3:] + margin) & (later[:, 3:] >= box[i, :3] - margin), axis=1)


def _masks(mask: Mask | None, shot: int) -> arrays.Masks:
    if mask is None:
        none = np.zeros(0, np.int64)
        pairs = np.zeros((0, 2))
        return arrays.Masks(
            corner=pairs, step=pairs, shape=pairs.astype(np.int64), start=none, open=np.zeros(0, np.uint8), filling=none
        )
    return arrays.Masks(
        corner=_mask_corner(mask, shot),
        step=mask.pitch * np.array([[mask.column_direction, mask.row_direction]], np.float64),
        shape=np.array([[mask.rows, mask.columns]], np.int64),
        start=np.zeros(1, np.int64),
        open=mask.cells().ravel(),
        filling=np.array([_WORLD], np.int64),
    )


def _mask_corner(mask: Mask, shot: int) -> Floats:
    """(1, 2) x and y of the outer corner of cell (0, 0)."""
    x, y, _ = mask.plate_centre(shot)
    half = mask.pitch / 2
    return np.array([[x - mask.column_direction * half * mask.columns, y - mask.row_direction * half * mask.rows]])


def _mask_mass(mask: Mask) -> float:
    """Of the plate without its holes, g."""
    area = mask.plate[0] * mask.plate[1] - int(mask.cells().sum()) * mask.pitch**2
    return area * mask.depth * mask.material.material().density / 1000


def _masses(scene: Scene, geometry: arrays.Geometry, placed: Mapping[str, Placed], materials: list[Material]) -> Floats:
    masses = np.full(len(geometry.kind), math.nan)
    density = np.array([material.density for material in materials])
    for i, name in enumerate(_solid_names(scene)):
        if i == _WORLD or not _uncut(geometry.box, i):
            continue
        if scene.mask is not None and i == _MASK:
            masses[i] = _mask_mass(scene.mask)
        elif geometry.kind[i] == arrays.VOXELS:
            body = geometry.body[i]
            start = geometry.voxels.start[body]
            cells = geometry.voxels.material[start : start + np.prod(geometry.voxels.shape[body])]
            masses[i] = density[cells].sum() * np.prod(geometry.voxels.pitch[body]) / 1000
        else:
            mm3 = volume(placed[name]) if name in placed else 8 * np.prod(geometry.size[i])
            masses[i] = mm3 * density[geometry.material[i]] / 1000
    return masses


def _source(source: SceneSource) -> arrays.Source:
    spectrum = source.spectrum.spectrum()
    alias, keep = alias_table(spectrum.weight)
    axis = np.array(source.direction)
    return arrays.Source(
        position=np.array(source.position),
        spot=np.array(source.focal_spot),
        axis=np.stack([*across(axis), axis]),
        cosine=math.cos(source.half_angle),
        energy=spectrum.energy.copy(),
        width=source.spectrum.spread,
        alias=alias,
        keep=keep,
    )


def _detectors(scene: Scene, rows: list[_Row]) -> arrays.Detectors:
    detectors = scene.detectors
    solid = np.arange(len(rows) - len(detectors), len(rows))
    pixels = np.array([one.pixels for one in detectors], np.int64).reshape(-1, 2)
    return arrays.Detectors(
        solid=solid,
        assembly=_assemblies(rows, solid),
        threshold=np.array([one.threshold for one in detectors]),
        blur=np.array([one.resolution * math.sqrt(_REFERENCE) / _FWHM for one in detectors]),
        efficiency=np.array([one.efficiency for one in detectors]),
        start=np.cumsum(pixels.prod(axis=1)) - pixels.prod(axis=1),
        pixels=pixels,
    )


def _assemblies(rows: list[_Row], detectors: NDArray[np.int64], touch: float = 1.0) -> Floats:
    """(detector, 6) boxes around each detector and what is fixed to it: solids of the environment within `touch` mm."""
    found = np.array([rows[i].box for i in detectors]).reshape(-1, 6)
    for assembly in found:
        core = assembly.copy()
        for row in rows[_WORLD + 1 :]:
            close = np.all(row.box[:3] <= core[3:] + touch) and np.all(row.box[3:] >= core[:3] - touch)
            if row.role == arrays.ENVIRONMENT and close:
                assembly[:3] = np.minimum(assembly[:3], row.box[:3])
                assembly[3:] = np.maximum(assembly[3:], row.box[3:])
    return found
