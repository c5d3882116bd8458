"""The best weight τ of a sparse reconstruction by comparison with the truth, for any solver that can go on from a larger τ."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import singledispatch
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from shadowgram.operators.base import LinearOperator

from ._sparse import Record, SparseProblem
from .solution import Callback, Solution, TauTrial, check_problem

if TYPE_CHECKING:
    from .gpsr import GPSR
    from .twist import TwIST

# Best values on real cubes were 1e-5 to 3e-5 without noise; noise asks for more.
SEARCHED = tuple(float(f"{tau:.1e}") for tau in np.geomspace(1e-2, 1e-6, 13))


class Path(Protocol):
    """Where a solver stands on its way to smaller τ."""

    problem: SparseProblem
    theta: np.ndarray

    def follow(self, spec: Any, above: float, record: Record) -> bool:
        """Go on from the relative weight `above` to that of `spec`; whether the criterion was met there."""
        ...


@singledispatch
def begin(spec: object, H: LinearOperator, y: np.ndarray) -> Path:  # noqa: ARG001
    """Start a solver at θ = 0, before any τ; `y` has been checked."""
    raise TypeError(f"search_tau takes a solver such as GPSR() or TwIST(), got {type(spec).__name__}")


def search_tau(
    spec: GPSR | TwIST,
    H: LinearOperator,
    y: np.ndarray,
    score: Callable[[np.ndarray], float],
    taus: Iterable[float] = SEARCHED,
    callback: Callback | None = None,
) -> tuple[Solution, tuple[TauTrial, ...]]:
    """Reconstruct for a descending series of τ, each starting from the one before, and keep what scores best.

    A tool for studies: a `score` such as the PSNR compares with the truth, which a camera does not have. "τ chosen for the best
    PSNR" in the literature means this; the solution says so in its `tau_search`. The search costs two to three single runs.

    Parameters
    ----------
    spec : ``GPSR(...)`` or ``TwIST(...)``; its `tau` is not used, and `max_iter` holds for each τ. The result is not debiased.
    H, y, callback : as in `solve`.
    score : called with every estimate x (band, y, x), which it must not keep; larger is better.
    taus : relative weights to try, in any order; larger ones are tried first. The search ends early once two in a row score
        worse than the best.

    Returns
    -------
    (Solution, table)
        The best one, with the history of the whole search, and its `tau_search` table.

    Raises
    ------
    TypeError
        If `spec` is another solver, or as in `solve`.
    ValueError
        If there is nothing to try, `spec` asks for debiasing, or as in `solve`.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.solvers.tau_search import search_tau
    >>> cube = sg.scenes.chart(size=32, bands=4, seed=0).values
    >>> imager = sg.DualCASSI(cube_shape=cube.shape, wavelengths=(450, 650))
    >>> H = imager.operator(sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0))
    >>> best, table = search_tau(sg.GPSR(), H, H.forward(cube), lambda x: sg.metrics.psnr(x, cube, peak=1.0))
    >>> max(trial.score for trial in table) == sg.metrics.psnr(best.x, cube, peak=1.0)
    True
    """
    y = check_problem(H, y)
    record = Record(callback)
    state = begin(spec, H, y)
    tried = sorted((replace(spec, tau=tau) for tau in taus), key=lambda one: -one.tau)
    if not tried:
        raise ValueError("search_tau needs at least one tau to try")
    table: list[TauTrial] = []
    best, kept, interrupted, above = -1, None, False, 1.0
    try:
        for one in tried:
            begun = record.iterations
            converged = state.follow(one, above, record)
            x = state.problem.cube(state.theta)
            table.append(TauTrial(one.tau, float(score(x)), record.iterations - begun, converged))
            if kept is None or table[-1].score > table[best].score:
                best, kept = len(table) - 1, x.copy()
            elif len(table) - 1 - best == 2:
                break
            above = one.tau
    except KeyboardInterrupt:
        interrupted = True
    if kept is None:  # interrupted before the first score
        return record.solution(state.problem.cube(state.theta), False, interrupted), ()
    found = record.solution(kept, table[best].converged, interrupted)
    return replace(found, tau_search=tuple(table)), tuple(table)
