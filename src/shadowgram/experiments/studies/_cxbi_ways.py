"""How the studies reconstruct backscatter scans, blind and as the source did with an oracle, and how they judge an image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from shadowgram.figures.sheet import Picture

ORACLES = ("oracle-bm3d", "oracle-ffdnet")
AIR_SHARE = 0.85
"""Of the air's light through a cell, what lies beyond z = 25 cm, where pencil beams start: by the package's Monte Carlo."""
ORACLE_ITERATIONS = 40
_SUBTRACTED_ITERATIONS = 100  # as `shadowgram.xray.reconstruct` has by default


@dataclass(frozen=True, kw_only=True, eq=False)
class Shots:
    """What is reconstructed.

    Attributes
    ----------
    codes : (shot, y, x), 1 = open.
    counts, air : (shot,) with and without target.
    """

    codes: np.ndarray
    counts: np.ndarray
    air: np.ndarray


def pedestal_of(shots: Shots) -> float:
    """Counts that the air gives through an open cell."""
    from shadowgram.xray._background import fit_background

    area = shots.codes.sum(axis=(1, 2)).astype(float)
    return max(fit_background(shots.air.astype(float), area).pedestal, 0.0)


def subtracted(shots: Shots) -> np.ndarray:
    """As `shadowgram.xray.reconstruct`, but the air is subtracted shot by shot, and its noise is in the counts."""
    import shadowgram as sg
    from shadowgram.priors import get
    from shadowgram.xray._blind import Splitting, noise_unit

    deviation = np.full(shots.counts.size, np.sqrt(shots.counts.mean() + shots.air.mean()))
    state = Splitting(
        operator=sg.CXBI(shape=shots.codes.shape[1:]).operator(shots.codes), counts=shots.counts - shots.air,
        unit=noise_unit(shots.codes, deviation), denoisers=[get("ffdnet"), get("bm3d")], iterations=_SUBTRACTED_ITERATIONS,
    )  # fmt: skip
    state.run(deviation, 0, _SUBTRACTED_ITERATIONS, None)
    return state.z


def oracle_images(shots: Shots, way: str, grid: Sequence[tuple[float, float]]) -> list[np.ndarray]:
    """Images of the published method, for each setting of an oracle to choose from.

    Parameters
    ----------
    way : of `ORACLES`.
    grid : σ of the denoiser in counts, and λ in units of the variance of the counts.
    """
    import shadowgram as sg

    imager = sg.CXBI(shape=shots.codes.shape[1:]).operator(shots.codes)
    variance = float(shots.counts.mean() + shots.air.mean())
    return [
        sg.solve(
            sg.ADMM(
                denoiser=way.removeprefix("oracle-"), sigma=sigma, strength=strength * variance,
                max_iter=ORACLE_ITERATIONS, tol=0,
            ),
            imager, shots.counts - shots.air,
        ).x.astype(float)
        for sigma, strength in grid
    ]  # fmt: skip


def score(x: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """PSNR and SSIM after the scale that brings x closest to the truth; peak and range are the largest value of the truth.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.experiments.studies._cxbi_ways import score
    >>> truth = np.zeros((16, 16)); truth[4:8] = 100
    >>> psnr, ssim = score(3 * truth + np.eye(16), truth)
    >>> psnr > 45, 0.99 < ssim < 1
    (True, True)
    """
    from shadowgram import metrics

    scaled = x * (np.vdot(x, truth) / max(np.vdot(x, x), 1e-30))
    peak = float(truth.max())
    return metrics.psnr(scaled, truth, peak=peak), metrics.ssim(scaled, truth, peak=peak)


def picture(title: str, values: np.ndarray, caption: str) -> Picture:
    """Image in grey from 0 to nearly its brightest pixel."""
    from shadowgram.figures.sheet import Picture

    shown = np.clip(values / max(float(np.quantile(values, 0.995)), 1e-9), 0, 1)
    return Picture(title=title, picture=shown.astype(float), caption=caption)
