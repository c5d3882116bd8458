"""Scans of the backscatter imager for the studies: what the transport says in the mean, and counts drawn from it at any dose.

The counts come from photons that are followed through the mask with its walls, the air and the target, any number of scatterings;
the images are reconstructed with `shadowgram.CXBI`, which knows nothing of all that. The truth is the source's: a scan with pencil
beams.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from ._cxbi_ways import AIR_SHARE, ORACLES, Shots, oracle_images, pedestal_of, score, subtracted

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from shadowgram.xray.scan import PencilMap, Scan
    from shadowgram.xray.scene import Scene

TARGETS = {"letters": "cxbi-ud", "blocks": "cxbi-blocks", "hand": "cxbi-hand"}
"""The source's names, and the shipped scenes."""
CELLS, PITCH = 32, 2.0  # mm
HISTORIES, QUICK_HISTORIES = 2_000_000, 300_000
"""Photons that are followed for the means."""
PHOTONS, QUICK_PHOTONS = 500, 40
"""Photons that are followed for each pixel of the truth."""
RELATIVE_SIGMAS, STRENGTHS = (0.08, 0.15, 0.28, 0.5), (0.3, 1.0)
"""The oracle's grid: σ in parts of the brightest pixel, and λ in units of the variance of the counts."""
QUICK_SIGMAS, QUICK_STRENGTHS = (0.15,), (1.0,)
KINDS = ("air", "cell")
"""What an image is compared with: the pencil beams, with the air behind 25 cm added to it, or the counts through each cell."""
MEASURES = ("psnr", "ssim")
_PENCIL_PITCH = 8.71  # mm, for the cells of 2 mm
_RIM = 14.0  # mm of the plate beyond the cells, both ends together, as in the source's scanner


def _scene(target: str, percent: float, pitch: float) -> Scene:
    """The source's scanner, with cells of another pitch where wanted, that fill the same window."""
    from shadowgram.xray.scan import with_transmittance
    from shadowgram.xray.scene import shipped_scene

    scene = shipped_scene(TARGETS[target])
    if pitch != PITCH:
        assert scene.mask is not None
        cells = round(CELLS * PITCH / pitch)
        shots = cells**2 // 2
        columns = cells + shots - 1
        mask = scene.mask.model_copy(
            update={
                "pitch": pitch, "rows": cells, "view": cells, "columns": columns,
                "plate": (columns * pitch + _RIM, scene.mask.plate[1]),
                "pattern": scene.mask.pattern.model_copy(update={"transmittance": percent / 100, "seed": 0}),
            }
        )  # fmt: skip
        # Room for the plate, which is longer, at either end of its way.
        room = 2 * (shots * pitch + mask.plate[0] / 2 + _RIM)
        world = scene.world.model_copy(update={"size": (room, *scene.world.size[1:])})
        scene = scene.model_copy(update={"mask": mask, "shots": shots, "world": world})
    return with_transmittance(scene, percent / 100)


@lru_cache(maxsize=16)
def scan_of(target: str, percent: float, histories: int, pitch: float = PITCH) -> Scan:
    """Mean counts of the source's scanner with a current of 5.12 nA, with and without the target.

    512 shots of 32 × 32 cells of 2 mm; for another pitch half as many shots as there are cells, on a plate that is long enough.
    """
    from shadowgram.xray.scan import linear_scan

    scan = linear_scan(_scene(target, percent, pitch), histories=histories, noise=False, background=True)
    for values in (scan.codes, scan.counts, scan.background, scan.image):
        assert values is not None
        values.flags.writeable = False
    return scan


@lru_cache(maxsize=8)
def truth_of(target: str, photons: int, pitch: float = PITCH) -> PencilMap:
    """Scan with pencil beams, as the source's; its pixels are as many as the mask's cells."""
    from shadowgram.xray.scan import pencil_scan
    from shadowgram.xray.scene import shipped_scene

    cells = round(CELLS * PITCH / pitch)
    beams = _PENCIL_PITCH * pitch / PITCH
    return pencil_scan(shipped_scene(TARGETS[target]), shape=(cells, cells), pitch=beams, photons=photons)


def drawn(scan: Scan, taken: slice, dose: float, seed: int) -> Shots:
    """Counts with the noise of photons.

    Parameters
    ----------
    scan : means.
    taken : which shots.
    dose : photons in units of the scan's own.
    seed : of the noise.
    """
    assert scan.background is not None
    rng = np.random.default_rng(seed)
    counts, air = (rng.poisson(dose * values[taken].clip(min=0)) for values in (scan.counts, scan.background))
    return Shots(codes=scan.codes[taken], counts=counts.astype(float), air=air.astype(float))


def grid_of(scan: Scan, dose: float, quick: bool) -> list[tuple[float, float]]:
    """The oracle's settings, σ in counts and λ."""
    assert scan.image is not None
    peak = dose * float(scan.image.max())
    sigmas, strengths = (QUICK_SIGMAS, QUICK_STRENGTHS) if quick else (RELATIVE_SIGMAS, STRENGTHS)
    return [(sigma * peak, strength) for sigma in sigmas for strength in strengths]


def tried(shots: Shots, way: str, grid: Sequence[tuple[float, float]]) -> tuple[list[np.ndarray], float]:
    """Images by one way, one for each setting of an oracle and else one, and the counts of the air through a cell.

    Parameters
    ----------
    way : of `ORACLES`, or "blind", "ffdnet", "bm3d" and "least-squares" (`shadowgram.xray.reconstruct`), or "subtracted".
    grid : as `grid_of` gives it.
    """
    from shadowgram.xray import reconstruct

    if way in ORACLES:
        return oracle_images(shots, way, grid), pedestal_of(shots)
    if way == "subtracted":
        return [subtracted(shots)], pedestal_of(shots)
    denoiser = way if way in ("ffdnet", "bm3d") else ("ffdnet", "bm3d")
    likelihood = "least-squares" if way == "least-squares" else "poisson"
    found = reconstruct(shots.codes, shots.counts, shots.air, denoiser=denoiser, likelihood=likelihood)
    return [found.x], found.pedestal


def scores(image: np.ndarray, pedestal: float, truth: PencilMap, scan: Scan) -> np.ndarray:
    """(kind, measure) of an image."""
    assert scan.image is not None
    return np.array([score(image + AIR_SHARE * pedestal, truth.counts), score(image, scan.image.clip(min=0))])


def best(found: Sequence[Sequence[np.ndarray]]) -> tuple[dict[str, float], int]:
    """Of scores, draw → setting → (kind, measure): the means over draws at the best setting for each, and the best for PSNR.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.experiments.studies._cxbi_scans import best
    >>> two_draws = [[np.full((2, 2), 20.0), np.full((2, 2), 21.0)], [np.full((2, 2), 24.0), np.full((2, 2), 22.0)]]
    >>> best(two_draws)[0]["psnr_air"], best(two_draws)[1]
    (22.0, 0)
    """
    means = np.mean(np.array(found), axis=0)
    values = {
        f"{measure}_{kind}": round(float(means[:, i, j].max()), 5)
        for i, kind in enumerate(KINDS)
        for j, measure in enumerate(MEASURES)
    }
    return values, int(means[:, 0, 0].argmax())


def judged(
    draws: Sequence[Shots],
    way: str,
    grid: Sequence[tuple[float, float]],
    judge: Callable[[np.ndarray, float], np.ndarray],
) -> tuple[dict[str, float], np.ndarray]:
    """Scores of a way over several draws of the counts, and the image of the first."""
    every = [tried(shots, way, grid) for shots in draws]
    values, setting = best([[judge(image, pedestal) for image in images] for images, pedestal in every])
    if way in ORACLES:
        values["sigma"], values["strength"] = map(float, grid[setting])
    return values, every[0][0][setting]
