"""Which codes the shots of a scan have, and the scene whose mask has them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._placed import across
from ._scan_blocks import Step, check_whole
from .patterns import Pattern as PatternArray
from .patterns import check_pattern, written

if TYPE_CHECKING:
    from .scene import Mask, Scene

_RIM = 360
"""Directions on the rim of the source's cone."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Coded:
    """A scene, and what its mask is in every shot.

    Attributes
    ----------
    scene : whose mask has the strip, or in turn the codes.
    steps : how it differs from shot to shot.
    codes : (shot, row, column) uint8 in view, 1 = hole.
    strip : (row, column) uint8 that slides; None for separate codes.
    """

    scene: Scene
    steps: tuple[Step, ...]
    codes: NDArray[np.uint8]
    strip: PatternArray | None

    def of(self, scene: Scene) -> Coded:
        """The same codes before another target, in the scene of `coded` but for its solids."""
        changed = self.scene.model_copy(update={"solids": scene.solids})
        return Coded(scene=changed, steps=self.steps, codes=self.codes, strip=self.strip)


def mask_of(scene: Scene) -> Mask:
    """The mask of a scene that has one, and detectors to count what comes through it.

    Raises
    ------
    ValueError
        If it has none.
    """
    if scene.mask is None:
        raise ValueError("a scan needs a coded mask, and this scene has none: add [mask], or use xray simulate")
    if not scene.detectors:
        raise ValueError("a scan counts photons in detectors, and this scene has none: add [[detectors]]")
    return scene.mask


def coded(scene: Scene, codes: ArrayLike | None, shots: int | None) -> Coded:
    """A scene with codes in its mask.

    Parameters
    ----------
    codes : a strip (row, column) that slides by a column a shot, or separate codes (shot, row, column); two values, the
        larger one open. By default the scene's own strip.
    shots : how many; by default as many as the scene or the codes have.

    Raises
    ------
    ValueError
        If the codes do not fit the mask or are not two-valued, or there are fewer than `shots`.
    """
    mask = mask_of(scene)
    if shots is not None:
        shots = check_whole("shots", shots, 1)
    if codes is None:
        return _sliding(scene, mask, shots or scene.shots)
    array = np.asarray(codes)
    if array.ndim == 3 and len(array) > 1:
        return _separate(scene, mask, array, shots)
    strip = _checked(array, mask)
    longer = max(0, strip.shape[1] - mask.columns) * mask.pitch
    changed = mask.model_copy(
        update={
            "columns": strip.shape[1],
            "view": mask.columns_in_view,
            "plate": (mask.plate[0] + longer, mask.plate[1]),
            "pattern": mask.pattern.model_copy(update=_pattern(strip)),
        }
    )
    most = strip.shape[1] - mask.columns_in_view + 1
    return _sliding(scene.model_copy(update={"mask": changed, "shots": most}), changed, shots or most)


def _sliding(scene: Scene, mask: Mask, shots: int) -> Coded:
    if mask.pattern.file is not None:  # the scene shall stand by itself
        mask = mask.model_copy(update={"pattern": mask.pattern.model_copy(update=_pattern(mask.cells()))})
    # With the scene's own number, a shot is the same run however many others there are.
    whole = checked(scene.model_copy(update={"mask": mask, "shots": max(shots, scene.shots)}))
    strip = mask.cells()
    view = np.lib.stride_tricks.sliding_window_view(strip, mask.columns_in_view, axis=1)[:, :shots]
    steps = tuple(Step(shot=shot) for shot in range(shots))
    return Coded(scene=whole, steps=steps, codes=np.ascontiguousarray(view.transpose(1, 0, 2)), strip=strip)


def _separate(scene: Scene, mask: Mask, array: NDArray, shots: int | None) -> Coded:
    if shots is not None and shots > len(array):
        raise ValueError(f"{shots} shots need as many codes, got {len(array)}")
    found = _checked(array, mask)[:shots]
    closed = np.zeros((mask.rows, mask.columns_in_view), np.uint8)
    pattern = mask.pattern.model_copy(update=_pattern(closed))
    still = mask.model_copy(update={"columns": mask.columns_in_view, "view": None, "pattern": pattern})
    steps = tuple(Step(code=written(code)) for code in found)
    return Coded(
        scene=checked(scene.model_copy(update={"mask": still, "shots": 1})), steps=steps, codes=found, strip=None
    )


def _checked(array: NDArray, mask: Mask) -> NDArray[np.uint8]:
    """Codes of the mask's size, 0 and 1."""
    flat = check_pattern(array.reshape(-1, array.shape[-1]) if array.ndim == 3 and array.size else array)
    found = flat.reshape(array.shape) if array.ndim == 3 and len(array) > 1 else flat
    *_, rows, columns = map(int, found.shape)
    view = mask.columns_in_view
    fits = columns == view if found.ndim == 3 else columns >= view
    if rows != mask.rows or not fits:
        raise ValueError(
            f"codes of this mask have {mask.rows} rows and {view} columns, or a strip of them as many columns and more; got"
            f" {rows} rows and {columns} columns"
        )
    return found


def _pattern(cells: PatternArray) -> dict[str, object]:
    return {"rows": written(cells), "file": None, "transmittance": None, "seed": None}


def with_transmittance(scene: Scene, transmittance: float, seed: int | None = None) -> Scene:
    """The same scene with another random strip in its mask.

    Parameters
    ----------
    transmittance : probability of a hole, above 0 and at most 1.
    seed : of the strip; by default that of the scene's random strip, or 0 if it has another.

    Raises
    ------
    ValueError
        If the scene has no mask, or the transmittance cannot be.

    Examples
    --------
    >>> from shadowgram.xray.scan import with_transmittance
    >>> from shadowgram.xray.scene import shipped_scene
    >>> scene = with_transmittance(shipped_scene("cxbi-blocks"), 0.5)
    >>> scene.mask.cells().mean().round(2)
    np.float64(0.5)
    """
    mask = mask_of(scene)
    chosen = (mask.pattern.seed or 0) if seed is None else seed
    update = {"rows": None, "file": None, "transmittance": float(transmittance), "seed": chosen}
    changed = mask.model_copy(update={"pattern": mask.pattern.model_copy(update=update)})
    return checked(scene.model_copy(update={"mask": changed}))


def checked(scene: Scene) -> Scene:
    """A scene that was put together from parts, after all checks of one that is read."""
    from .scene import parse_scene

    return parse_scene(scene.toml())


def lit_margin(scene: Scene) -> int:
    """Columns beyond the view, on either side, that the source lights or that the plate has; the fewer of the two."""
    mask = mask_of(scene)
    room = math.floor((mask.plate[0] / mask.pitch - mask.columns_in_view) / 2 + 1e-9)
    beyond = (_lit(scene, mask) - mask.columns_in_view * mask.pitch / 2) / mask.pitch
    return room if beyond >= room else max(0, math.ceil(beyond - 1e-9))


def _lit(scene: Scene, mask: Mask) -> float:
    """Largest |x − x of the mask| that the source lights at either face of the plate, mm."""
    source = scene.source
    axis = np.array(source.direction)
    turn = np.stack([*across(axis), axis])
    azimuth = np.linspace(0, 2 * math.pi, _RIM, endpoint=False)
    sine, cosine = math.sin(source.half_angle), math.cos(source.half_angle)
    rim = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.full(_RIM, cosine)], axis=1) @ turn
    start = np.array(source.position)
    spot = 0.5 * float(np.hypot(*source.focal_spot))
    lit = 0.0
    for face in (mask.position[2] - mask.depth / 2, mask.position[2] + mask.depth / 2):
        with np.errstate(divide="ignore", invalid="ignore"):
            length = (face - start[2]) / rim[:, 2]
        if not (length > 0).all():
            return math.inf  # the cone is so wide that some of its rim misses the mask's plane
        lit = max(lit, float(np.abs(start[0] + length * rim[:, 0] - mask.position[0]).max()) + spot)
    return lit
