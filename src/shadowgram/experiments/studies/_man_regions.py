"""Where the pistol and the man are in the image, and the contrast (4.16) of one against the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from shadowgram.xray.scene import Scene

SCENE = "cxbi-man"


@dataclass(frozen=True, kw_only=True, eq=False)
class Regions:
    """(y, x) bool: the pistol, and the rest of the man but for pixels that both share."""

    pistol: np.ndarray
    man: np.ndarray


@lru_cache(maxsize=1)
def regions() -> Regions:
    """Pixels of the pistol and of the man, from the scene's shapes along the middles of the cells."""
    from shadowgram.xray._layout import placed_solids
    from shadowgram.xray._mask_rays import through_cells
    from shadowgram.xray._placed import contains
    from shadowgram.xray.scene import shipped_scene

    scene = shipped_scene(SCENE)
    mask = scene.mask
    assert mask is not None
    start = np.array(scene.source.position)
    placed = {name: one for name, one in placed_solids(scene, files=True).items() if _role(scene, name) == "target"}
    rays = through_cells(mask, start, 9).transpose(1, 2, 3, 0)  # (ray, y, x, 3)

    def fill(names: Sequence[str], lines: np.ndarray) -> np.ndarray:
        """(y, x) share of the rays that meet one of the solids."""
        low, high = (pick(getattr(placed[n], end)[2] for n in names) for pick, end in ((min, "low"), (max, "high")))
        hit = np.zeros(lines.shape[:3], bool)
        for z in np.arange(low + 2, high, 8.0):
            points = start + lines * ((z - start[2]) / lines[..., 2:])
            for name in names:
                hit |= contains(placed[name], points.reshape(-1, 3)).reshape(hit.shape)
        return hit.mean(axis=0)

    pistol = fill(["pistol"], rays)
    body = fill([name for name in placed if name != "pistol"], rays[4:5])
    return Regions(pistol=pistol > 0.5, man=(body > 0.5) & (pistol == 0))


def _role(scene: Scene, name: str) -> str:
    return next(solid.role for solid in scene.solids if solid.name == name)


def contrasts(x: np.ndarray) -> tuple[float, float]:
    """Contrast (4.16) of the pistol against the man, and the largest of its outline elsewhere on him; 0 where nothing is there."""
    own = regions()
    if not x[own.man].mean() > 0:
        return 0.0, 0.0
    moved = [_contrast(x, place, own.man & ~place) for place in places()]
    return _contrast(x, own.pistol, own.man), max(moved)


def _contrast(x: np.ndarray, inside: np.ndarray, outside: np.ndarray) -> float:
    from shadowgram import metrics

    return metrics.contrast(x, inside, outside)


@lru_cache(maxsize=1)
def places() -> tuple[np.ndarray, ...]:
    """The pistol's outline at all places where it covers the man alone."""
    own = regions()
    rows, columns = np.nonzero(own.pistol)
    height, width = own.pistol.shape
    found = []
    for dy in range(-height, height):
        for dx in range(-width, width):
            y, x = rows + dy, columns + dx
            if y.min() < 0 or x.min() < 0 or y.max() >= height or x.max() >= width:
                continue
            moved = np.zeros(own.pistol.shape, bool)
            moved[y, x] = True
            if own.man[moved].all():
                found.append(moved)
    return tuple(found)
