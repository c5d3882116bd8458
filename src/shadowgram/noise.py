"""What a detector adds to the light: white noise at a stated SNR, or shot and read noise, saturation and quantisation.

Noise is drawn from `numpy.random.default_rng(seed)`, so that a measurement can be repeated; there is no unseeded noise.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike


def awgn(y: ArrayLike, *, snr_db: float, seed: int) -> np.ndarray:
    """Add white Gaussian noise at a signal-to-noise ratio.

    Parameters
    ----------
    y : real array of any shape, in general (shot, y, x). Noise-free snapshots.
    snr_db : 10 log₁₀(mean(y²) / σ²), in dB, the mean being over all values of all snapshots; ``inf`` for no noise.
    seed : whole number ≥ 0. Same seed, same noise.

    Returns
    -------
    array of the shape of `y`
        float64 stays float64, anything else becomes float32. Values may be negative.

    Raises
    ------
    ValueError
        If `y` holds NaN or infinity, is zero everywhere (no ratio is possible), or `snr_db` is NaN.

    Notes
    -----
    The signal is the mean square, with the mean of `y` left in, as in MATLAB's ``awgn(..., "measured")`` and in the
    compressive imaging literature; a ratio of variances would be a few dB lower for the same noise.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram import noise
    >>> y = np.full((2, 100, 100), 3.0)
    >>> noisy = noise.awgn(y, snr_db=20, seed=0)
    >>> round(float((noisy - y).std()), 2)
    0.3
    """
    y = _real(y, "awgn")
    if math.isnan(snr_db) or snr_db == -math.inf:
        raise ValueError(f"snr_db is a ratio in dB, such as 30, or inf for no noise; got {snr_db!r}")
    power = float(np.mean(np.square(y, dtype=np.float64)))
    if power == 0:
        raise ValueError("awgn cannot reach a signal-to-noise ratio: the snapshots are zero everywhere")
    sigma = math.sqrt(power) * 10 ** (-snr_db / 20)
    return (y + sigma * _generator(seed).standard_normal(y.shape)).astype(y.dtype)


def sensor(
    y: ArrayLike,
    *,
    seed: int,
    full_well: float = 10_000.0,
    read_noise: float = 5.0,
    bits: int = 12,
    saturation: float | None = None,
) -> np.ndarray:
    """Record light with a sensor: shot noise, read noise, saturation and quantisation.

    Parameters
    ----------
    y : real array ≥ 0 of any shape, in general (shot, y, x). Light on the detector, in any unit.
    seed : whole number ≥ 0. Same seed, same noise.
    full_well : electrons at which a pixel saturates.
    read_noise : standard deviation of the read-out, in electrons.
    bits : of the converter, 1 to 32; its largest code is the full well.
    saturation : the exposure: the light, in the units of `y`, that just fills the well. By default the largest value in
        `y`. A smaller value exposes longer: less noise, but everything above it is cut; `saturated` says how much.

    Returns
    -------
    array of the shape of `y`, in its units
        float64 stays float64, anything else becomes float32. Nothing lies above `saturation`.

    Raises
    ------
    ValueError
        If `y` is negative or not finite somewhere, or a parameter makes no sense.

    Notes
    -----
    electrons = Poisson(full_well · y / saturation) + Normal(0, read_noise), rounded to whole converter steps of
    full_well / (2^bits − 1) electrons and cut at the full well. The converter's black level is subtracted and taken to
    be high enough not to cut the read noise, so that dark pixels are zero on average and may be slightly negative.
    Dark current and fixed-pattern noise are not modelled. Source: EMVA standard 1288, the linear sensor model.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram import noise
    >>> y = np.full((1, 200, 200), 0.5)
    >>> shot = noise.sensor(y, seed=0, full_well=20_000, read_noise=0, saturation=1.0)
    >>> round(float(shot.std()), 4)  # √10000 of 10000 electrons
    0.005
    """
    y = _real(y, "sensor")
    if y.size and y.min() < 0:
        raise ValueError(
            f"sensor takes light, which is not negative, got values down to {y.min():.6g}; clip them at 0 first"
        )
    if not (math.isfinite(full_well) and 1 <= full_well <= 1e12):
        raise ValueError(f"full_well is a number of electrons from 1 to 1e12, got {full_well!r}")
    if not (math.isfinite(read_noise) and read_noise >= 0):
        raise ValueError(f"read_noise is a standard deviation in electrons, zero or more, got {read_noise!r}")
    if not isinstance(bits, int | np.integer) or not 1 <= bits <= 32:
        raise ValueError(f"bits is a whole number from 1 to 32, got {bits!r}")
    if saturation is None:
        saturation = float(y.max(initial=0))
    if not (math.isfinite(saturation) and saturation > 0):
        raise ValueError(
            f"saturation is the light that fills the well, a positive number in the units of y, got {saturation!r}; "
            "by default it is the largest value of y, so say it if y is zero everywhere"
        )
    rng = _generator(seed)
    # Far above the full well every draw is cut anyway; the limit keeps the Poisson mean in its legal range.
    mean = np.minimum(y * (full_well / saturation), 100 * full_well)
    electrons = rng.poisson(mean) + read_noise * rng.standard_normal(y.shape)
    codes = 2 ** int(bits) - 1
    code = np.minimum(np.rint(electrons * (codes / full_well)), codes)
    return (code / codes * saturation).astype(y.dtype)


def saturated(y: ArrayLike, *, saturation: float) -> float:
    """Share of the pixels, in [0, 1], that are at the saturation of the sensor.

    Parameters
    ----------
    y : array of any shape. Recorded snapshots, in the units in which they were given to `sensor`.
    saturation : as given to `sensor`, or a camera's largest value.

    Raises
    ------
    ValueError
        If `y` is empty or not finite somewhere.

    Examples
    --------
    >>> from shadowgram import noise
    >>> shot = noise.sensor([0.1, 0.2, 5.0, 9.0], seed=0, saturation=1.0)
    >>> noise.saturated(shot, saturation=1.0)
    0.5
    """
    y = _real(y, "saturated")
    if y.size == 0:
        raise ValueError("saturated takes at least one pixel, got an empty array")
    return float(np.mean(y >= y.dtype.type(saturation)))


def _real(y: ArrayLike, name: str) -> np.ndarray:
    y = np.asarray(y)
    if y.dtype.kind not in "fiub":
        raise TypeError(f"{name} takes real numbers, got an array of {y.dtype}")
    if not np.isfinite(y).all():
        raise ValueError(f"{name} needs finite numbers, but the snapshots hold NaN or infinity")
    return y.astype(np.float64 if y.dtype == np.float64 else np.float32)


def _generator(seed: int) -> np.random.Generator:
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise ValueError(f"seed is a whole number of at least 0, got {seed!r}")
    return np.random.default_rng(seed)
