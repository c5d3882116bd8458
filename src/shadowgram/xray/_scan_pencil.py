"""The truth of a scan: what pencil beams, one for each pixel, bring back from the target."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ._layout import detector_corners, placed_solids, world_corners
from ._placed import Placed, contains
from ._scan_blocks import Found, Plan, Step, blocks_of, check_whole, together
from ._scan_codes import checked
from .montecarlo.arrays import FROM_TARGET

if TYPE_CHECKING:
    from .scene import Scene

Floats = NDArray[np.float64]

SHAPE = (32, 32)
PITCH = 8.71
"""mm."""
DISTANCE = 250.0
"""mm."""
HALF_ANGLE = math.radians(0.4)
PHOTONS = 5000


@dataclass(frozen=True, kw_only=True, eq=False)
class PencilMap:
    """Counts of all detectors together, pixel by pixel.

    Attributes
    ----------
    counts : (y, x) rows and columns run as those of the scene's mask.
    standard_error : (y, x) by which they scatter about what an endless run would give.
    target : (y, x) the part of the counts that the target scattered or emitted; the rest is air.
    photons : source photons for each pixel.
    pitch : of the pixels, mm.
    distance : from the source to the target's front, mm.
    half_angle : of the beam, rad.
    noisy : whether the counts have the noise of a real scan; otherwise they are means.
    seed : of all that is random.
    scene : TOML of the scene that was scanned.

    Raises
    ------
    ValueError
        If shapes do not fit together, or a number cannot be.
    """

    counts: Floats
    standard_error: Floats
    target: Floats
    photons: int
    pitch: float
    distance: float
    half_angle: float
    noisy: bool
    seed: int
    scene: str

    def __post_init__(self) -> None:
        for name in ("counts", "standard_error", "target"):
            values = getattr(self, name)
            good = values.ndim == 2 and values.dtype.kind == "f" and values.shape == self.counts.shape
            if not good or not np.isfinite(values).all():
                raise ValueError(f"{name.replace('_', ' ')} of this map must be (y, x) finite numbers")
        if not (self.photons > 0 and 0 < self.pitch < math.inf and 0 < self.distance < math.inf):
            raise ValueError("photons, pitch and distance of a map must be positive")


def pencil_scan(
    scene: Scene,
    *,
    shape: tuple[int, int] = SHAPE,
    pitch: float = PITCH,
    distance: float = DISTANCE,
    half_angle: float = HALF_ANGLE,
    photons: int = PHOTONS,
    seed: int = 0,
    variance_reduction: bool = True,
    threads: int | None = None,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> PencilMap:
    """Scan a scene with parallel narrow beams of its source's spectrum; the mask is taken away.

    Parameters
    ----------
    scene : with a target and detectors, its source looking along z.
    shape : rows and columns.
    pitch : mm from beam to beam. The middle of the map is at the middle of the mask, and rows and columns are counted in the same
        directions as the mask's.
    distance : from the source to the front of the target, mm.
    half_angle : of the beam, rad.
    photons : for each pixel.
    seed : pixel p, row by row, has histories p · photons … (p + 1) · photons − 1 of this seed.
    variance_reduction : give means; otherwise counts with their noise.
    threads, progress : as of `shadowgram.xray.scan.direct_scan`.

    Raises
    ------
    OSError
        If a file of the scene cannot be read.
    ValueError
        If the scene has no target or detector, its source looks elsewhere, or a number cannot be.

    Notes
    -----
    Source: Salazar (2022), section 4.5.7, whose numbers are the defaults. The air is not subtracted.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.xray.scan import pencil_scan
    >>> pencil_scan(sg.xray.shipped_scene("cxbi-ud"), shape=(3, 4), pitch=70, photons=200).counts.shape
    (3, 4)
    """
    plan = pencil_plan(
        scene,
        shape=shape,
        pitch=pitch,
        distance=distance,
        half_angle=half_angle,
        photons=photons,
        seed=seed,
        variance_reduction=variance_reduction,
    )
    return plan.run(threads=threads, progress=progress)


def pencil_plan(
    scene: Scene,
    *,
    shape: tuple[int, int] = SHAPE,
    pitch: float = PITCH,
    distance: float = DISTANCE,
    half_angle: float = HALF_ANGLE,
    photons: int = PHOTONS,
    seed: int = 0,
    variance_reduction: bool = True,
) -> Plan[PencilMap]:
    """The parts of `pencil_scan`, to be computed anywhere; parameters and errors as there.

    Examples
    --------
    >>> from shadowgram.xray.scan import pencil_plan
    >>> from shadowgram.xray.scene import shipped_scene
    >>> plan = pencil_plan(shipped_scene("cxbi-ud"))
    >>> len(plan.blocks), plan.blocks[0].steps[0].position  # the left end of the top row
    (32, (-135.005, 135.005, 250.0))
    """
    rows, columns = (check_whole("rows and columns", count, 1) for count in shape)
    for name, value in (("pitch", pitch), ("distance", distance)):
        if not 0 < value < math.inf:
            raise ValueError(f"{name} must be a positive length in mm, got {value!r}")
    photons, seed = check_whole("photons", photons, 2), check_whole("seed", seed, 0)
    placed = placed_solids(scene, files=True)
    places = _places(scene, placed, (rows, columns), pitch, distance)
    _check_places(scene, placed, np.array(places))
    bare = _bare(scene, places, half_angle)
    blocks = blocks_of(
        bare,
        [Step(position=place) for place in places],
        histories=photons,
        first_history=0,
        seed=seed,
        variance_reduction=variance_reduction,
        together=columns,
    )

    def assemble(found: Sequence[Found]) -> PencilMap:
        whole = together(found)
        return PencilMap(
            counts=whole.counts.reshape(rows, columns),
            standard_error=whole.standard_error.reshape(rows, columns),
            target=whole.orders[:, :FROM_TARGET].sum(axis=1).reshape(rows, columns),
            photons=photons,
            pitch=pitch,
            distance=distance,
            half_angle=half_angle,
            noisy=not variance_reduction,
            seed=seed,
            scene=scene.toml(),
        )

    return Plan(blocks=blocks, assemble=assemble)


def _places(
    scene: Scene, placed: Mapping[str, Placed], shape: tuple[int, int], pitch: float, distance: float
) -> list[tuple[float, float, float]]:
    """Of the source, for every pixel, row by row."""
    forward = scene.source.direction[2]
    if abs(forward) < 1 - 1e-6:
        raise ValueError(
            "pencil beams go along z, but the source of this scene looks elsewhere; give it direction (0, 0, 1)"
        )
    along = math.copysign(1.0, forward)
    z = _front(scene, placed, along) - along * distance
    middle = scene.source.position if scene.mask is None else scene.mask.position
    step_x = pitch * (1 if scene.mask is None else scene.mask.column_direction)
    step_y = pitch * (-1 if scene.mask is None else scene.mask.row_direction)
    rows, columns = shape
    return [
        (
            round(middle[0] + (column - (columns - 1) / 2) * step_x, 9),
            round(middle[1] + (row - (rows - 1) / 2) * step_y, 9),
            round(z, 9),
        )
        for row in range(rows)
        for column in range(columns)
    ]


def _front(scene: Scene, placed: Mapping[str, Placed], along: float) -> float:
    """Where the target begins, mm."""
    targets = [placed[solid.name] for solid in scene.solids if solid.role == "target"]
    if not targets:
        raise ValueError('pencil beams look for a target, and this scene has none: give a solid role = "target"')
    return float(min(one.low[2] for one in targets) if along > 0 else max(one.high[2] for one in targets))


def _bare(scene: Scene, places: Sequence[tuple[float, float, float]], half_angle: float) -> Scene:
    """The scene without its mask, with a narrow beam."""
    if not scene.detectors:
        raise ValueError("a scan counts photons in detectors, and this scene has none: add [[detectors]]")
    source = scene.source.model_copy(update={"position": places[0], "half_angle": half_angle})
    return checked(scene.model_copy(update={"mask": None, "shots": 1, "source": source}))


def _check_places(scene: Scene, placed: Mapping[str, Placed], places: Floats) -> None:
    """Raise unless all beams begin in the world's own material."""
    low, high = world_corners(scene.world)
    if not ((low < places) & (places < high)).all():
        raise ValueError(
            "some pencil beams would begin outside the world; take a smaller pitch or distance, or a larger world"
        )
    world = scene.world.material.material()
    around = np.full(len(places), -1)
    for number, solid in enumerate(scene.solids):
        hollow = all(made.material() == world for made in solid.materials)
        around[contains(placed[solid.name], places)] = -1 if hollow else number
    names = [solid.name for solid in scene.solids]
    found = [f"the solid {names[number]!r}" for number in around if number >= 0]
    for detector in scene.detectors:
        lower, upper = detector_corners(detector)
        found += [f"the detector {detector.name!r}"] * bool(((lower < places) & (places < upper)).all(axis=1).any())
    if found:
        raise ValueError(f"some pencil beams would begin in {found[0]}; change the distance, or take a smaller pitch")
