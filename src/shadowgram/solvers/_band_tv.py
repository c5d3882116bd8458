"""What GAP-TV and ADMM-TV share: their settings, the scale of the scene, and the record of the iterations."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

import numpy as np

from shadowgram.operators.base import LinearOperator

from ._data_step import energy
from .solution import Callback, Solution


def check_weight(spec: str, name: str, value: float) -> None:
    """Raise ValueError unless `value` is a weight."""
    if not 0 < value < math.inf:
        raise ValueError(f"{spec}: {name} must be above 0 and finite, got {value}")


def check_iterations(spec: str, tv_iterations: int, max_iter: int, tol: float) -> None:
    """Raise ValueError for settings that no iteration can have."""
    for name, value in (("tv_iterations", tv_iterations), ("max_iter", max_iter)):
        if not isinstance(value, int | np.integer) or value < 1:
            raise ValueError(f"{spec}: {name} must be a whole number of at least 1, got {value!r}")
    if not 0 <= tol < 1:
        raise ValueError(f"{spec}: tol is a relative change and must lie in [0, 1), got {tol}")


def check_cubes(spec: str, H: LinearOperator) -> None:
    """Raise ValueError unless `H` takes cubes and gives snapshots."""
    if len(H.in_shape) != 3 or len(H.out_shape) != 3:
        raise ValueError(
            f"{spec} reconstructs cubes (band, y, x) from snapshots (shot, y, x), "
            f"but the operator takes {H.in_shape} and gives {H.out_shape}"
        )


def scene_scale(H: LinearOperator, y: np.ndarray) -> float:
    """Value of the grey scene that would give as much light as was seen; 0 where nothing was seen or could be."""
    response = energy(H.forward(np.ones(H.in_shape, y.dtype)))
    return math.sqrt(energy(y) / response) if response > 0 else 0.0


@dataclass(eq=False)
class Log:
    """Iterations made, and their history."""

    callback: Callback | None
    begun: float = field(default_factory=time.perf_counter)
    history: dict[str, list[float]] = field(default_factory=dict)

    def add(self, values: dict[str, float]) -> None:
        """Append an iteration and tell the callback."""
        values = {**values, "seconds": time.perf_counter() - self.begun}
        for name, value in values.items():
            self.history.setdefault(name, []).append(value)
        if self.callback is not None:
            self.callback(len(self.history["seconds"]), values)

    def solution(self, x: np.ndarray, converged: bool, interrupted: bool) -> Solution:
        """What `solve` returns."""
        made = len(self.history.get("seconds", ()))
        return Solution(x, converged, made, self.history, interrupted, time.perf_counter() - self.begun)
