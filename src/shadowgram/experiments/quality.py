"""Quality of a reconstruction: the four figures that every table and command gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shadowgram import metrics


@dataclass(frozen=True, slots=True, kw_only=True)
class Quality:
    """How far a reconstruction is from the truth.

    Attributes
    ----------
    psnr : dB, for `peak`.
    rms : mean over the pixels of the spectral RMS error, in the units of the cube.
    ssim : for `peak`.
    sam : rad, mean spectral angle.
    peak : largest value that the cube could have.
    """

    psnr: float
    rms: float
    ssim: float
    sam: float
    peak: float


def assess(estimate: np.ndarray, truth: np.ndarray, peak: float | None = None) -> Quality:
    """Compare two cubes.

    Parameters
    ----------
    estimate, truth : (band, y, x).
    peak : largest value that the cube could have; by default 1 where the truth lies in [0, 1], else the truth's largest value.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.experiments.quality import assess
    >>> truth = np.random.default_rng(0).random((3, 16, 16))
    >>> quality = assess(truth + 0.1, truth)
    >>> round(quality.psnr, 6), quality.peak
    (20.0, 1.0)
    """
    if peak is None:
        largest = float(np.max(truth))
        peak = 1.0 if largest <= 1 else largest
    return Quality(
        psnr=metrics.psnr(estimate, truth, peak=peak),
        rms=metrics.rms(estimate, truth),
        ssim=metrics.ssim(estimate, truth, peak=peak),
        sam=metrics.sam(estimate, truth),
        peak=peak,
    )
