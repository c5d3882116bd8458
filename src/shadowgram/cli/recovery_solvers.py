"""Solvers of `shadowgram reconstruct`: which one, with what settings, and how long it will take."""

from __future__ import annotations

import dataclasses
import time
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from shadowgram.operators.base import LinearOperator
    from shadowgram.priors.denoiser import Denoiser
    from shadowgram.solvers.admm_tv import ADMMTV
    from shadowgram.solvers.eigen_pnp import EigenPnP
    from shadowgram.solvers.eigen_tv import EigenTV
    from shadowgram.solvers.fista import FISTA
    from shadowgram.solvers.gap_tv import GAPTV
    from shadowgram.solvers.gpsr import GPSR
    from shadowgram.solvers.twist import TwIST

    Spec = EigenTV | EigenPnP | GPSR | FISTA | TwIST | GAPTV | ADMMTV

# What a search usually takes of the iterations that it may: 30 to 60 of 150 from two shots on.
_USUAL_ITERATIONS = 60
_TIMED = 6  # iterations; the first one is left out, since it may wait for a compiler


class Solver(StrEnum):
    """Reconstruction algorithms."""

    eigen_tv = "eigen-tv"
    gpsr = "gpsr"
    fista = "fista"
    twist = "twist"
    gap_tv = "gap-tv"
    admm_tv = "admm-tv"


class Effort(StrEnum):
    """How much time eigen-tv may take."""

    fast = "fast"
    best = "best"


_SPARSE = (Solver.gpsr, Solver.fista, Solver.twist)
_WEIGHTED = (Solver.gap_tv, Solver.admm_tv)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Wishes:
    """Options about the solver, as they were given; None for those that were not."""

    solver: Solver
    quality: Effort | None
    tau: float | None
    weight: float | None
    noise: float | None
    max_iter: int | None
    tol: float | None


def choose(wishes: Wishes) -> Spec:
    """Solver with the options that were given, its own defaults for the others.

    Raises
    ------
    ValueError
        If an option belongs to another solver, or a value is out of its range.
    """
    import shadowgram as sg

    solver = wishes.solver
    if wishes.tau is not None and solver not in _SPARSE:
        raise ValueError(f"--tau belongs to gpsr, fista and twist; {solver} has no such weight")
    if wishes.weight is not None and solver not in _WEIGHTED:
        raise ValueError(f"--weight belongs to gap-tv and admm-tv; {solver} has no such weight")
    for name in ("quality", "noise"):
        if getattr(wishes, name) is not None and solver != Solver.eigen_tv:
            raise ValueError(f"--{name} belongs to eigen-tv; {solver} does not use it")
    kinds = {
        Solver.eigen_tv: sg.EigenPnP if wishes.quality == Effort.best else sg.EigenTV,
        Solver.gpsr: sg.GPSR,
        Solver.fista: sg.FISTA,
        Solver.twist: sg.TwIST,
        Solver.gap_tv: sg.GAPTV,
        Solver.admm_tv: sg.ADMMTV,
    }
    names = ("tau", "weight", "noise", "max_iter", "tol")
    given = {name: getattr(wishes, name) for name in names if getattr(wishes, name) is not None}
    if wishes.quality == Effort.best and wishes.tol is None:
        given["tol"] = 2e-4
    if wishes.quality == Effort.best and wishes.max_iter is None:
        given["max_iter"] = 300  # one shot of a real camera goes on improving for as long
    return kinds[solver](**given)


def most_iterations(spec: Spec) -> int:
    """Iterations that the history can have."""
    from shadowgram.solvers.eigen_pnp import EigenPnP

    return spec.max_iter + (spec.stage if isinstance(spec, EigenPnP) else 0)


def estimate_seconds(spec: Spec, H: LinearOperator, y: np.ndarray, samples: int) -> float:
    """Seconds that a reconstruction and `samples` more of them will take, from a few iterations on these very data."""
    from shadowgram.solvers.eigen_pnp import EigenPnP

    usual = min(spec.max_iter, _USUAL_ITERATIONS)
    if not isinstance(spec, EigenPnP):
        return (1 + samples) * usual * _seconds_of_iteration(dataclasses.replace(spec, max_iter=_TIMED), H, y)
    from shadowgram.solvers.eigen_tv import EigenTV

    # Everything is done twice: the first time to find out whether the denoiser helps.
    iterations = 2 * (usual + spec.stage) * _seconds_of_iteration(EigenTV(max_iter=_TIMED, noise=spec.noise), H, y)
    stage = 2 * spec.stage * spec.images * _seconds_of_denoiser(spec.denoiser, H.in_shape[1:])
    return (1 + samples) * (iterations + stage)


def _seconds_of_iteration(spec: Spec, H: LinearOperator, y: np.ndarray) -> float:
    from shadowgram.solvers.solution import solve

    marks: list[float] = []
    solve(spec, H, y, callback=lambda _, values: marks.append(values["seconds"]))
    return (marks[-1] - marks[0]) / (len(marks) - 1) if len(marks) > 1 else 0.0


def _seconds_of_denoiser(denoiser: str | Denoiser, shape: tuple[int, ...]) -> float:
    """Seconds for one image; the first call, which loads the network, is not counted."""
    import numpy as np

    from shadowgram.priors import get
    from shadowgram.priors.denoiser import LEAST_SIDE

    if min(shape) < LEAST_SIDE:
        return 0.0
    denoise = get(denoiser) if isinstance(denoiser, str) else denoiser
    image = np.random.default_rng(0).random(shape).astype(np.float32)
    denoise(image, 0.1)
    begun = time.perf_counter()
    denoise(image, 0.1)
    return time.perf_counter() - begun
