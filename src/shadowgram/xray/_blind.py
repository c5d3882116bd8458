"""ADMM with denoisers on whitened counts, with a schedule that follows from the noise of the data.

A pixel that had all shots to itself would have the noise ν = 1/√(Σ_q w_q · var a), with w_q = 1/variance of the counts and var a
the variance of the codes' cells: what correlating the counts with the codes leaves. The denoiser's σ falls from `FIRST` ν to
`LAST` ν in the first half of the iterations and then stays; the penalty is ρ = `STRENGTH`/σ².
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from shadowgram.operators.base import LinearOperator
from shadowgram.priors.denoiser import Denoiser
from shadowgram.solvers._admm_data import DataStep, data_step
from shadowgram.solvers._parts import Weighted

Floats = NDArray[np.float64]

FIRST, LAST, STRENGTH = 4.0, 0.35, 0.5
"""On the dissertation's scans a last σ of 0.5 ν, or a strength of 0.3 or 0.75, changes the mean by 0.4 dB at most."""
_TOGETHER = 0.3  # share of the iterations, the last ones, in which all denoisers are averaged
_ORIENTATIONS = 8
_ACCURACY = 1e-3  # of conjugate gradients, relative to the residual

Callback = Callable[[int, dict[str, float]], None]


@dataclass(kw_only=True, eq=False)
class Splitting:
    """Where the iteration stands.

    Attributes
    ----------
    operator, counts : the model and what it is compared with, counts less the background.
    unit : ν, in the units of the image.
    denoisers : the first alone, and in the end the mean of all.
    iterations : of all.
    """

    operator: LinearOperator
    counts: Floats
    unit: float
    denoisers: Sequence[Denoiser]
    iterations: int
    z: Floats = field(init=False)
    u: Floats = field(init=False)
    history: dict[str, list[float]] = field(init=False)

    def __post_init__(self) -> None:
        self.z, self.u = np.zeros(self.operator.in_shape), np.zeros(self.operator.in_shape)
        self.history = {name: [] for name in ("sigma", "primal", "change", "residual", "seconds")}
        self._begun = time.perf_counter()
        self._rho = 0.0

    def run(self, deviation: Floats, start: int, stop: int, callback: Callback | None) -> None:
        """Iterations `start` to `stop`, with a standard deviation (shot,) of the counts."""
        data = data_step(Weighted(self.operator, 1 / deviation), self.counts / deviation)
        for iteration in range(start, stop):
            values = self._iterate(data, iteration)
            values["seconds"] = time.perf_counter() - self._begun
            for name, value in values.items():
                self.history[name].append(value)
            if callback is not None:
                callback(iteration + 1, dict(values))

    def _iterate(self, data: DataStep, iteration: int) -> dict[str, float]:
        sigma = self.unit * FIRST * (LAST / FIRST) ** min(iteration / max(self.iterations // 2 - 1, 1), 1.0)
        rho = STRENGTH / sigma**2
        self.u *= self._rho / rho
        self._rho = rho
        x, residual = data.solve(self.z - self.u, rho, _ACCURACY)
        before, self.z = self.z, self._denoised(x + self.u, sigma, iteration)
        self.u += x - self.z
        size = max(float(np.linalg.norm(self.z)), np.finfo(float).tiny)
        return {
            "sigma": sigma,
            "primal": float(np.linalg.norm(x - self.z)) / size,
            "change": float(np.linalg.norm(self.z - before)) / size,
            "residual": residual,
        }

    def _denoised(self, noisy: Floats, sigma: float, iteration: int) -> Floats:
        """Denoised in one of the eight orientations of the square, which change from iteration to iteration."""
        late = iteration >= round((1 - _TOGETHER) * self.iterations)
        turned = np.ascontiguousarray(_turn(noisy, iteration))
        chosen = self.denoisers if late else self.denoisers[:1]
        mean = np.mean([np.asarray(one(turned, sigma), np.float64) for one in chosen], axis=0)
        return np.maximum(np.ascontiguousarray(_turn_back(mean, iteration)), 0)


def _turn(image: Floats, k: int) -> Floats:
    turned = np.rot90(image, k % 4)
    return turned.T if k % _ORIENTATIONS >= _ORIENTATIONS // 2 else turned


def _turn_back(image: Floats, k: int) -> Floats:
    turned = image.T if k % _ORIENTATIONS >= _ORIENTATIONS // 2 else image
    return np.rot90(turned, -(k % 4))


def noise_unit(codes: np.ndarray, deviation: Floats) -> float:
    """ν, in the units of the image."""
    mean = float(codes.mean(dtype=np.float64))
    square = float(np.vdot(codes, codes)) / codes.size if codes.dtype.kind == "f" else float((codes != 0).mean())
    return float(1 / np.sqrt(np.sum(1 / deviation**2) * max(square - mean**2, 1e-3 * mean)))
