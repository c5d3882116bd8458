"""What every solver gives back, and the function that starts them all.

A solver is a frozen dataclass of its parameters (`GPSR`, `FISTA`, `EigenTV`, `ADMM`); its module registers how it is solved.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import singledispatch

import numpy as np

from shadowgram.operators.base import LinearOperator

from .whiteness import Whiteness

Callback = Callable[[int, dict[str, float]], None]


@dataclass(frozen=True)
class TauTrial:
    """One regularisation weight that a search tried: relative τ, what it scored, and how its run ended."""

    tau: float
    score: float
    iterations: int
    converged: bool


@dataclass(frozen=True, eq=False)
class Solution:
    """A reconstruction and how it came about.

    Parameters
    ----------
    x : the estimate, of the operator's `in_shape`, e.g. (band, y, x).
    converged : whether the solver's own criterion was met; False where it ran out of iterations or was interrupted.
    iterations : how many were made, over all phases.
    history : one value an iteration under each name, e.g. ``"objective"``, ``"residual"`` (‖Hx − y‖₂), ``"seconds"``.
    interrupted : whether Ctrl-C ended it; `x` is then the best estimate so far.
    seconds : wall time.
    tau_search : what was tried, if the regularisation weight was chosen by comparing with the truth; empty otherwise.
    whiteness : how white the residual Hx − y is, from `EigenTV` and `EigenPnP`; a correlation far from 0 says that the model is
        wrong, or that the prior smoothed details away. None from the other solvers (see `residual_whiteness`).
    denoised : whether `EigenPnP` used its denoiser; None from the other solvers.
    """

    x: np.ndarray
    converged: bool
    iterations: int
    history: dict[str, list[float]] = field(default_factory=dict)
    interrupted: bool = False
    seconds: float = 0.0
    tau_search: tuple[TauTrial, ...] = ()
    whiteness: Whiteness | None = None
    denoised: bool | None = None


@singledispatch
def solve(spec: object, H: LinearOperator, y: np.ndarray, callback: Callback | None = None) -> Solution:  # noqa: ARG001
    """Reconstruct what `H` saw as `y`, by the solver that `spec` describes.

    Parameters
    ----------
    spec : ``EigenTV(...)``, ``EigenPnP(...)``, ``GPSR(...)``, ``FISTA(...)``, ``TwIST(...)``, ``GAPTV(...)``, ``ADMMTV(...)`` or
        ``ADMM(...)``.
    H : the forward model, e.g. ``imager.operator(code)``.
    y : snapshots of `H.out_shape`, e.g. (shot, y, x). float32 and integers are solved in float32, float64 in float64.
    callback : called as ``callback(iteration, values)`` after every iteration, with the newest values of the history.

    Returns
    -------
    Solution
        After Ctrl-C (`KeyboardInterrupt`), the best estimate so far, marked as interrupted.

    Raises
    ------
    TypeError
        If `spec` is not a solver, `H` not an operator, or `y` not real numbers.
    ValueError
        If `y` does not fit `H`, or holds values that are not finite.

    Examples
    --------
    >>> import shadowgram as sg
    >>> cube = sg.scenes.chart(size=32, bands=4, seed=0).values
    >>> imager = sg.DualCASSI(cube_shape=cube.shape, wavelengths=(450, 650))
    >>> H = imager.operator(sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0))
    >>> found = sg.solve(sg.GPSR(tau=1e-3, max_iter=50), H, H.forward(cube))
    >>> found.x.shape, len(found.history["objective"]) == found.iterations
    ((4, 32, 32), True)
    """
    raise TypeError(f"solve takes a solver such as GPSR(), FISTA() or EigenTV(), got {_name(spec)}")


def _name(thing: object) -> str:
    return f"the class {thing.__name__}: write {thing.__name__}()" if isinstance(thing, type) else type(thing).__name__


def check_problem(H: LinearOperator, y: np.ndarray) -> np.ndarray:
    """Snapshots as a contiguous float32 or float64 array, once they are known to fit `H`."""
    if not isinstance(H, LinearOperator):
        raise TypeError(f"H must be a LinearOperator, such as imager.operator(code), got {type(H).__name__}")
    y = np.asarray(y)
    if y.dtype.kind not in "fiub":
        raise TypeError(f"snapshots must be real numbers, got an array of {y.dtype}")
    if y.shape != H.out_shape:
        raise ValueError(f"snapshots must have the shape {H.out_shape} that H gives, got {y.shape}")
    wrong = {"NaN": np.count_nonzero(np.isnan(y)), "infinite": np.count_nonzero(np.isinf(y))}
    if any(wrong.values()):
        said = " and ".join(f"{count} {what}" for what, count in wrong.items() if count)
        raise ValueError(f"snapshots contain {said} values; replace or mask dead pixels first")
    double = y.dtype.kind == "f" and y.dtype.itemsize > 4
    return np.ascontiguousarray(y, np.float64 if double else np.float32)
