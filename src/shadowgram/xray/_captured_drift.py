"""Slow changes of a scan's counts: Legendre polynomials of the shot, fitted jointly with what else the counts may follow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

MOST_ORDER = 12
_SHOTS_PER_TERM = 16  # fewer shots for each term, and the drift would follow the picture


def slow_terms(shots: int, order: int) -> Floats:
    """(shot, order + 1) Legendre polynomials over the scan."""
    return np.asarray(np.polynomial.legendre.legvander(np.linspace(-1, 1, shots), order), np.float64)


def explaining(codes: NDArray, background: Floats | None) -> Floats:
    """(shot, term) what counts may follow without any picture: the open area of the code, and a run without target."""
    area = codes.reshape(len(codes), -1).mean(axis=1, dtype=np.float64)
    columns = [area] if background is None else [area, background]
    return np.column_stack(columns)


def basis_of(terms: Floats) -> Floats:
    """Orthonormal columns that span those of `terms`, of which some may depend on others or be 0."""
    lengths = np.linalg.norm(terms, axis=0)
    terms = terms[:, lengths > 0] / lengths[lengths > 0]
    left, values, _ = np.linalg.svd(terms, full_matrices=False)
    return left[:, values > 1e-10 * values[0]]


def without(values: Floats, basis: Floats) -> Floats:
    """What is left of (shot, ...) values when the best fit of the basis is taken away."""
    return values - basis @ (basis.T @ values)


def most_order(shots: int) -> int:
    """Highest order that is tried."""
    return max(0, min(MOST_ORDER, shots // _SHOTS_PER_TERM - 1))


def criteria(counts: Floats, others: Floats) -> Floats:
    """Bayesian information criterion n ln(RSS/n) + k ln n of every order from 0, relative to the smallest."""
    shots = len(counts)
    found = []
    for order in range(most_order(shots) + 1):
        basis = basis_of(np.column_stack([slow_terms(shots, order), others]))
        rest = without(counts, basis)
        # Counts that are all explained have no noise to compare with; rounding stands for it.
        squares = max(float(rest @ rest), 1e-24 * float(counts @ counts), 1e-300)
        found.append(shots * np.log(squares / shots) + basis.shape[1] * np.log(shots))
    return np.array(found) - min(found)
