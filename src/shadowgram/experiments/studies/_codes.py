"""What the studies of designed codes share: imagers and codes, noises, solvers, and how gains are counted over seeds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from shadowgram import codes, metrics, noise
from shadowgram.operators import LinearOperator
from shadowgram.solvers.eigen_tv import EigenTV
from shadowgram.solvers.gpsr import GPSR
from shadowgram.solvers.solution import solve
from shadowgram.solvers.tau_search import search_tau
from shadowgram.spectral.sscsi import SSCSI

from . import _common as common

KINDS = {"random": "random", "boolean": "Boolean", "optimised": "optimised", "coupled": "coupled (ours)"}
"""Codes of the source in its order, and ours: the cost with coupling 1, of the exact shear."""

NOISES = {"none": "noise-free", "30 dB": "30 dB", "read": "read noise"}

READ_NOISE_SHOTS = 4
"""A Boolean code of so many shots has 30 dB in the read noise; a code with twice the light has 6 dB more."""

# τ that GPSR tries, the same for every code; the best is chosen against the truth, as in the source.
TAUS = (3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6)
CLEAN_TAUS = (1e-3, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 1e-7)  # without noise

CLEAR = 3.0  # standard errors


def imager_of(bands: int, size: int, wavelengths: tuple[float, float], shear: str = "edge") -> SSCSI:
    """SSCSI with Δc = Δd that resolves this many bands: s = bands/size.

    Examples
    --------
    >>> from shadowgram.experiments.studies._codes import imager_of
    >>> imager_of(24, 128, (450, 650)).mask_position
    0.1875
    """
    return SSCSI(
        detector_shape=(size, size), detector_pitch=common.PITCH, code_pitch=common.PITCH, mask_position=bands / size,
        wavelengths=wavelengths, shear=shear,
    )  # fmt: skip


def code_of(kind: str, imager: SSCSI, shots: int, seed: int) -> np.ndarray:
    """Code (shot, y, x) of one of `KINDS`; weights are the defaults of the design.

    Examples
    --------
    >>> from shadowgram.experiments.studies._codes import code_of, imager_of
    >>> code_of("coupled", imager_of(4, 16, (450, 650)), 2, 0).sum()
    np.uint64(256)
    """
    if kind == "random":
        return codes.random(shots=shots, shape=imager.code_shape, seed=seed)
    if kind == "boolean":
        return codes.boolean(shots=shots, shape=imager.code_shape, seed=seed)
    if kind == "optimised":
        return codes.optimised(imager, shots=shots, seed=seed)
    if kind == "coupled":
        return codes.optimised(replace(imager, shear="exact"), shots=shots, seed=seed, coupling=1.0)
    raise ValueError(f"a code is one of {', '.join(KINDS)}, got {kind!r}")


def read_noise(imager: SSCSI, truth: np.ndarray) -> float:
    """Deviation of the read noise: that of 30 dB for a Boolean code of `READ_NOISE_SHOTS` shots that sees this cube (band, y, x).

    It is the same for all codes, so that one which passes more light has the better ratio.
    """
    code = codes.boolean(shots=READ_NOISE_SHOTS, shape=imager.code_shape, seed=0)
    y = common.stored_operator(imager, code).forward(truth)
    return float(np.sqrt(np.mean(np.square(y)) / 1000))


def disturbed(y: np.ndarray, kind: str, read: float, seed: int) -> np.ndarray:
    """Snapshots with noise, float32.

    Parameters
    ----------
    y : (shot, y, x).
    kind : "none"; "30 dB" or "50 dB": relative to these snapshots, so that all codes have the same ratio; "read": `read`.
    read : deviation of the read noise.
    seed : of the noise; codes with as many shots get the same noise, but for its scale.
    """
    if kind == "none":
        return np.asarray(y, np.float32)
    if kind == "read":
        return np.asarray(y + read * np.random.default_rng(seed).normal(size=y.shape), np.float32)
    return np.asarray(noise.awgn(y, snr_db=float(kind.removesuffix(" dB")), seed=seed), np.float32)


def taus_of(kind: str) -> tuple[float, ...]:
    """τ that are tried with this kind of noise, from the largest."""
    return CLEAN_TAUS if kind == "none" else TAUS


def reconstruct(
    solver: str, H: LinearOperator, y: np.ndarray, truth: np.ndarray, kind: str
) -> tuple[np.ndarray, dict[str, float]]:
    """Estimate (band, y, x), and its PSNR (dB, peak 1), RMS and, for GPSR, the best τ.

    `kind` of noise decides which τ are tried. ``"border"`` is by how many dB the best is above the next τ inside, where it is the
    largest or smallest of them; else 0.
    """
    more: dict[str, float] = {}
    if solver == "gpsr":
        taus = taus_of(kind)
        found, table = search_tau(GPSR(max_iter=300, tol=1e-5), H, y, lambda x: metrics.psnr(x, truth, peak=1.0), taus)
        best = max(range(len(table)), key=lambda n: table[n].score)
        inside = 1 if best == 0 else best - 1
        at_border = table[best].tau in (taus[0], taus[-1])
        more = {
            "tau": table[best].tau,
            "border": round(table[best].score - table[inside].score, 4) if at_border else 0.0,
        }
    else:
        found = solve(EigenTV(), H, y)
    quality = {"psnr": metrics.psnr(found.x, truth, peak=1.0), "rms": metrics.rms(found.x, truth)}
    return found.x, {**quality, **more}


@dataclass(frozen=True, kw_only=True)
class Gain:
    """By how much one code is better than another: mean over seeds and its standard error, dB."""

    mean: float
    error: float

    @property
    def clear(self) -> bool:
        """Whether it is more than `CLEAR` standard errors."""
        return abs(self.mean) > CLEAR * self.error

    def __str__(self) -> str:
        return f"{self.mean:+.2f} ± {self.error:.2f}"


def gain(ours: Sequence[float], theirs: Sequence[float]) -> Gain:
    """Gain of `ours` over `theirs`, of the same seeds.

    Examples
    --------
    >>> from shadowgram.experiments.studies._codes import gain
    >>> str(gain([31.0, 32.0, 33.0], [30.0, 30.0, 30.0]))
    '+2.00 ± 0.58'
    """
    difference = np.subtract(ours, theirs)
    error = float(difference.std(ddof=1)) / math.sqrt(difference.size) if difference.size > 1 else math.inf
    return Gain(mean=float(difference.mean()), error=error)


def tell(name: str, gains: Mapping[str, Gain]) -> str:
    """Gains over the settings, place → gain, in a sentence.

    Examples
    --------
    >>> from shadowgram.experiments.studies._codes import Gain, tell
    >>> tell("a over b", {"Q = 2": Gain(mean=1, error=0.1), "Q = 4": Gain(mean=-0.5, error=0.4)})
    'a over b: +0.25 dB on average, above at 1 of 2 (clearly at 1), least -0.50 ± 0.40 at Q = 4, most +1.00 ± 0.10 at Q = 2'
    """
    means = [one.mean for one in gains.values()]
    above = [one for one in gains.values() if one.mean > 0]
    low, high = (choose(gains, key=lambda place: gains[place].mean) for choose in (min, max))
    return (
        f"{name}: {np.mean(means):+.2f} dB on average, above at {len(above)} of {len(gains)}"
        f" (clearly at {sum(one.clear for one in above)}), least {gains[low]} at {low}, most {gains[high]} at {high}"
    )


def holds(gains: Mapping[str, Gain]) -> bool | None:
    """Whether all are positive; None where some are not, but none clearly."""
    if all(one.mean > 0 for one in gains.values()):
        return True
    return False if any(one.mean < 0 and one.clear for one in gains.values()) else None


def exceptions(name: str, gains: Mapping[str, Gain]) -> str:
    """Where a gain is negative or not clear, in a sentence; "" where there is no such place."""
    below = [f"{place} ({one})" for place, one in gains.items() if one.mean <= 0]
    unclear = [f"{place} ({one})" for place, one in gains.items() if one.mean > 0 and not one.clear]
    parts = [f"below at {', '.join(below)}"] * bool(below) + [f"not clear at {', '.join(unclear)}"] * bool(unclear)
    return f"{name}: {'; '.join(parts)}" if parts else ""
