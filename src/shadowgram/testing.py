"""Checks that any operator can be put through, for our tests and for users' own operators."""

from __future__ import annotations

import numpy as np

from .operators.base import LinearOperator


def dot_test(A: LinearOperator, dtype: type = np.float64, seed: int = 0) -> float:
    """Relative gap between ⟨A x, y⟩ and ⟨x, Aᵀ y⟩ for random x and y.

    Parameters
    ----------
    A : the operator.
    dtype : float64 (a correct adjoint gives below 1e-12) or float32 (below 1e-5).
    seed : of the random arrays.

    Returns
    -------
    float
        |⟨A x, y⟩ − ⟨x, Aᵀ y⟩| / (‖A x‖ ‖y‖), computed in float64 from the operator's own output.

    Examples
    --------
    >>> import shadowgram as sg
    >>> imager = sg.CASSI(cube_shape=(3, 8, 10), wavelengths=(450, 650))
    >>> A = imager.operator(sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0))
    >>> sg.testing.dot_test(A) < 1e-12
    True
    """
    rng = np.random.default_rng(seed)
    x = rng.standard_normal(A.in_shape).astype(dtype)
    y = rng.standard_normal(A.out_shape).astype(dtype)
    Ax, Aty = (a.astype(np.float64) for a in (A.forward(x), A.adjoint(y)))
    scale = np.linalg.norm(Ax) * np.linalg.norm(y.astype(np.float64))
    return float(abs(np.vdot(Ax, y) - np.vdot(x, Aty)) / max(scale, np.finfo(float).tiny))
