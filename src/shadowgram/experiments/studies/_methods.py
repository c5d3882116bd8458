"""The methods that reconstruct datacubes, as the studies compare them: what each tries, how it does, and what it costs.

Literature gives comparison methods the weight that suits the scene best, which nobody has who does not know the truth. So do
these studies, for all but the methods that choose for themselves: "blind".
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from shadowgram import metrics
from shadowgram.experiments.bench.memory import peak_resident, resident
from shadowgram.operators.base import LinearOperator
from shadowgram.solvers.admm_tv import ADMMTV
from shadowgram.solvers.eigen_pnp import EigenPnP
from shadowgram.solvers.eigen_tv import EigenTV
from shadowgram.solvers.gap_tv import GAPTV
from shadowgram.solvers.gpsr import GPSR
from shadowgram.solvers.solution import Solution, solve
from shadowgram.solvers.twist import TwIST

Solver = GPSR | TwIST | GAPTV | ADMMTV | EigenTV | EigenPnP


@dataclass(frozen=True, kw_only=True)
class Method:
    """A method of the comparison.

    Attributes
    ----------
    text : as titles and tables call it.
    trials : snapshots → solvers of which the best is taken, by its PSNR against the truth; one, where nothing is chosen.
    blind : whether it needs no truth.
    """

    text: str
    trials: Callable[[np.ndarray], Sequence[Solver]]
    blind: bool = False


_TAUS = (1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6)
_NOISES = (3e-4, 1e-3, 3e-3, 1e-2, 2e-2, 4e-2)
"""Noise over the root mean square of the snapshots; EigenTV's weights follow from it."""


def _level(y: np.ndarray) -> float:
    return math.sqrt(float(np.mean(np.square(y, dtype=np.float64))))


METHODS = {
    "gpsr": Method(text="GPSR", trials=lambda _: [GPSR(tau=tau, max_iter=300) for tau in _TAUS]),
    "twist": Method(text="TwIST", trials=lambda _: [TwIST(tau=tau, max_iter=300) for tau in _TAUS]),
    "gap-tv": Method(text="GAP-TV", trials=lambda _: [GAPTV()]),
    "admm-tv": Method(text="ADMM-TV", trials=lambda _: [ADMMTV()]),
    "eigen-tv": Method(text="EigenTV, blind", trials=lambda _: [EigenTV()], blind=True),
    "eigen-tv-searched": Method(
        text="EigenTV, searched", trials=lambda y: [EigenTV(), *(EigenTV(noise=part * _level(y)) for part in _NOISES)]
    ),
    "eigen-pnp": Method(text="EigenTV + FFDNet, blind", trials=lambda _: [EigenPnP()], blind=True),
}


FALLING = ("gpsr", "twist")
"""Methods whose trials are weights that fall."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """What a method made of the snapshots.

    Attributes
    ----------
    solution : of the best trial.
    seconds : of the processor, on one thread, for that trial alone.
    spec : the solver of that trial.
    """

    solution: Solution
    seconds: float
    spec: Solver


def best(name: str, H: LinearOperator, y: np.ndarray, truth: np.ndarray) -> Found:
    """Reconstruct `y` by the method of this name; of several trials the one nearest to the truth.

    A search over falling weights ends after two that were worse than the best.
    """
    tried: list[tuple[float, Found]] = []
    for spec in METHODS[name].trials(y):
        begun = time.thread_time()
        solution = solve(spec, H, y)
        found = Found(solution=solution, seconds=time.thread_time() - begun, spec=spec)
        tried.append((metrics.psnr(solution.x, truth, peak=1.0), found))
        scores = [score for score, _ in tried]
        if len(scores) - scores.index(max(scores)) > 2 and name in FALLING:
            break
    return max(tried, key=lambda pair: pair[0])[1]


def peak_memory(module: str, arguments: object) -> float:
    """MB by which resident memory rises in a process of its own, ``python -m module JSON``, which prints it.

    Raises
    ------
    ValueError
        If the process fails; with its last words.
    """
    command = [sys.executable, "-m", module, json.dumps(arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ValueError(f"the measurement of memory failed: {done.stderr.strip().splitlines()[-1:]}")
    return float(done.stdout)


Problem = tuple[LinearOperator, np.ndarray]


def rise(name: str, small: Problem, problem: Problem) -> float:
    """MB by which resident memory rises at its peak in a few iterations of a method.

    The small problem comes first, for libraries and kernels to be loaded: they are not memory of the reconstruction, and what a
    problem of the same size has freed would be taken again unseen.
    """
    from shadowgram._threads import threads

    with threads(1):
        for H, y in (small, problem):
            spec = replace(METHODS[name].trials(y)[0], max_iter=6)
            before = resident()
            solve(spec, H, y)
    return max(0, peak_resident() - before) / 1e6
