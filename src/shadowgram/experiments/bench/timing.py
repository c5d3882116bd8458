"""Timing functions against one another, on a machine that others may be using."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING

import threadpoolctl

from shadowgram._threads import threads

if TYPE_CHECKING:
    from collections.abc import Iterator

BURST = 0.02  # s of calls in a row: the first of them find the caches full of another function's data


@dataclass(frozen=True)
class Timing:
    """Milliseconds of repeated calls: the minimum, which others' work on the machine disturbs least, and the median."""

    ms: float
    median_ms: float

    @classmethod
    def of(cls, seconds: list[float]) -> Timing:
        """Timing of calls that took `seconds`."""
        return cls(1e3 * min(seconds), 1e3 * median(seconds))


def alternate(functions: Mapping[str, Callable[[], object]], seconds: float) -> dict[str, Timing]:
    """Time functions in turn, so that what disturbs one disturbs all.

    Parameters
    ----------
    functions : name → function. Each is called twice before, which compiles it and fills the caches.
    seconds : to spend on all of them; every function is called at least once more, whatever it takes.
    """
    taken: dict[str, list[float]] = {name: [] for name in functions}
    bursts = {}
    for name, function in functions.items():
        function()
        bursts[name] = max(1, int(BURST / max(_seconds(function), 1e-6)))
    gc.collect()
    gc.disable()
    try:
        begun = time.perf_counter()
        while not all(taken.values()) or time.perf_counter() - begun < seconds:
            for name, function in functions.items():
                taken[name] += [_seconds(function) for _ in range(bursts[name])]
    finally:
        gc.enable()
    return {name: Timing.of(values) for name, values in taken.items()}


def _seconds(function: Callable[[], object]) -> float:
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


@contextmanager
def limited_threads(count: int) -> Iterator[None]:
    """Our kernels on `count` threads, BLAS and OpenMP libraries on one."""
    with ExitStack() as stack:
        stack.enter_context(threads(count))
        stack.enter_context(threadpoolctl.threadpool_limits(1))
        yield
