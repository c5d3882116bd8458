"""Operators for other tools: a dense sensing matrix, and scipy's LinearOperator."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from .base import LinearOperator

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator as ScipyOperator

DENSE_LIMIT = 2**28  # elements: 2 GiB in float64


def as_matrix(A: LinearOperator) -> np.ndarray:
    """Dense sensing matrix of `A`, for tests and small problems.

    Returns
    -------
    (rows, columns) float64 array acting on C-order flattened arrays: ``as_matrix(A) @ x.ravel() == A.forward(x).ravel()``.

    Raises
    ------
    MemoryError
        If the matrix would have more than 2²⁸ elements (2 GiB).

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.operators.adapters import as_matrix
    >>> imager = sg.CASSI(cube_shape=(2, 3, 4), wavelengths=(450, 650))
    >>> as_matrix(imager.operator(sg.codes.boolean(shots=1, shape=imager.code_shape, seed=0))).shape
    (15, 24)
    """
    rows, columns = math.prod(A.out_shape), math.prod(A.in_shape)
    if rows * columns > DENSE_LIMIT:
        raise MemoryError(
            f"a dense {rows} × {columns} sensing matrix needs {rows * columns * 8 / 2**30:.1f} GiB; use as_scipy instead"
        )
    matrix = np.empty((rows, columns))
    unit = np.zeros(columns)
    for i in range(columns):
        unit[i] = 1
        matrix[:, i] = A.forward(unit.reshape(A.in_shape)).ravel()
        unit[i] = 0
    return matrix


def as_scipy(A: LinearOperator) -> ScipyOperator:
    """`A` as a `scipy.sparse.linalg.LinearOperator` on C-order flattened arrays, for lsqr, cg and friends.

    Examples
    --------
    >>> import numpy as np, scipy.sparse.linalg as sla, shadowgram as sg
    >>> from shadowgram.operators.adapters import as_scipy
    >>> imager = sg.DualCASSI(cube_shape=(2, 3, 4), wavelengths=(450, 650))
    >>> A = imager.operator(sg.codes.random(shots=4, shape=imager.code_shape, seed=0))
    >>> x = sla.lsqr(as_scipy(A), A.forward(np.ones(A.in_shape)).ravel())[0]
    >>> x.shape
    (24,)
    """
    from scipy.sparse.linalg import LinearOperator as ScipyOperator

    class Flat(ScipyOperator):
        def _matvec(self, x: np.ndarray) -> np.ndarray:
            return A.forward(x.reshape(A.in_shape)).ravel()

        def _rmatvec(self, x: np.ndarray) -> np.ndarray:
            return A.adjoint(x.reshape(A.out_shape)).ravel()

    return Flat(np.dtype(np.float64), (math.prod(A.out_shape), math.prod(A.in_shape)))
