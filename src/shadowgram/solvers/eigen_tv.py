"""EigenTV: reconstruction with the total variation of the cube's eigen-images; the symbols are those of `_eigen_splitting`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from shadowgram.operators.base import LinearOperator

from ._eigen_run import EigenRun
from .solution import Callback, Solution, solve


@dataclass(frozen=True, kw_only=True)
class EigenTV:
    """Specification of a reconstruction by total variation in the cube's own eigenbasis.

    Problem: min over x of ½‖Hx − y‖² + λ Σ_m (m + 1)^p TV((V x)_m), with V the eigenbasis of the spectra and of the spatial
    gradients of x itself, so that nearly all of the scene lies in the first few eigen-images, and p = 0.5 − 0.9/Q² for Q shots.
    Where bands fall beside one another on a detector wider than the scene, and Q is below a quarter of the bands, p = 1.

    Parameters
    ----------
    noise : standard deviation of the noise of the snapshots, in their units, if it is known. By default it is that of the
        residual, in which errors of the model and photon noise count, and at least a share of what the flattest parts of the
        snapshots show. Of photon noise it is the root mean square.
    nonnegative : whether no value of the cube can be below zero, as for reflectance and radiance.
    max_iter : most iterations.
    tol : converged when the relative change of the cube in one iteration falls below this, with λ settled.

    Raises
    ------
    ValueError
        If a parameter is out of its range.

    Notes
    -----
    Iteration (alternating directions, over-relaxed): x ← z − u − Hᵀ(HHᵀ + μI)⁻¹(H(z − u) − y), which is exact, by one
    shot × shot matrix a detector element where `shot_gram` knows them and by conjugate gradients elsewhere;
    z ← Vᵀ prox_TV(V(x + u)), a few iterations from the previous duals, and z ← max(z, 0); u ← u + x − z. Every fifth
    iteration V is estimated anew, and λ = 0.45 h (c σ/√h)^1.25, with σ the noise, amplitudes in units of the mean scene
    value, and c = max((1 + 2/Q⁴)^0.8, 1 + 0.75 Q/L) for Q shots and L bands, or 0.45 (1 + 0.75 Q/L) where p = 1; λ falls no
    faster than the cube changes, and μ = h (k λ/h)^⅓ with k = 0.3 − 0.2/Q². The multiplier μu is carried over in proportion
    to λ.

    The history of `solve` has ``"residual"`` ‖Hx − y‖₂, ``"change"`` ‖x − previous x‖/‖x‖, ``"lambda"``, ``"mu"`` and
    ``"seconds"`` since the start, for every iteration.

    Sources: Boyd et al. (2011), sections 3.1 and 3.4.3 (the splitting, over-relaxation); Beck & Teboulle (2009),
    "Fast gradient-based algorithms for constrained total variation image denoising" (the proximal map).

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> truth = np.ones((4, 16, 16), np.float32)
    >>> truth[:, 4:12, 4:12] = np.array([0.2, 0.5, 0.7, 0.3])[:, None, None]
    >>> imager = sg.DualCASSI(cube_shape=truth.shape, wavelengths=(450, 650))
    >>> H = imager.operator(sg.codes.boolean(shots=3, shape=imager.code_shape, seed=0))
    >>> solution = sg.solve(sg.EigenTV(), H, H.forward(truth))
    >>> sg.metrics.psnr(solution.x, truth, peak=1.0) > 30
    True
    """

    noise: float | None = None
    nonnegative: bool = True
    max_iter: int = 150
    tol: float = 5e-4

    def __post_init__(self) -> None:
        check_settings("EigenTV", self.noise, self.max_iter, self.tol)


def check_settings(name: str, noise: float | None, max_iter: int, tol: float) -> None:
    """Raise a ValueError unless the settings that `EigenTV` and `EigenPnP` share make sense."""
    if noise is not None and not 0 <= noise < math.inf:
        raise ValueError(f"{name}: noise is a standard deviation in the snapshots' units, 0 or more, got {noise}")
    if not isinstance(max_iter, int | np.integer) or max_iter < 1:
        raise ValueError(f"{name}: max_iter must be a whole number of at least 1, got {max_iter!r}")
    if not 0 <= tol < 1:
        raise ValueError(f"{name}: tol is a relative change and must lie in [0, 1), got {tol}")


@solve.register
def _(spec: EigenTV, H: LinearOperator, y: np.ndarray, callback: Callback | None = None) -> Solution:
    run = EigenRun("EigenTV", H, y, spec.noise, spec.nonnegative, callback)
    converged = interrupted = False
    try:
        converged = run.minimise(spec.max_iter, spec.tol)
    except KeyboardInterrupt:
        interrupted = True
    return run.solution(converged, interrupted)
