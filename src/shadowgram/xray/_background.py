"""The counts of a run without target as a smooth model: one noisy realisation is not subtracted from another.

The model is Σ_k c_k T_k(t) + g (a_q − mean a), Chebyshev polynomials of the shot's place t in the scan and the open area a_q of its
code. It has far fewer terms than shots, so that it adds hardly any noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

MOST_ORDER = 8
_SHOTS_PER_TERM = 16  # fewer, and the polynomial would follow the noise
_ROUNDS = 3
_LEAST = 1e-3  # of the mean: no fitted count is below


@dataclass(frozen=True, kw_only=True, eq=False)
class Background:
    """A fitted run without target.

    Attributes
    ----------
    values : (shot,) counts.
    pedestal : counts that every open cell adds.
    dispersion : variance of the counts in units of what the model says; 1 for pure Poisson noise in whole counts.
    terms : (shot, term) what was fitted.
    """

    values: Floats
    pedestal: float
    dispersion: float
    terms: Floats


def fit_background(counts: Floats, area: Floats) -> Background:
    """Fit a run without target, with the order of lowest Bayesian information criterion.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.xray._background import fit_background
    >>> rng = np.random.default_rng(0)
    >>> area = rng.integers(80, 120, 400)
    >>> found = fit_background(rng.poisson(1000 + 5.0 * area).astype(float), area.astype(float))
    >>> found.terms.shape[1], round(found.pedestal)
    (2, 5)
    """
    shots = counts.size
    if not counts.any():
        return Background(values=np.zeros(shots), pedestal=0.0, dispersion=1.0, terms=_terms(area, 0))
    best, least = None, np.inf
    for order in range(max(1, min(MOST_ORDER, shots // _SHOTS_PER_TERM - 1) + 1)):
        terms = _terms(area, order)
        weights, values = fit_poisson(counts, terms)
        squares = float(np.sum((counts - values) ** 2 / values))
        criterion = shots * np.log(max(squares, 1e-30)) + terms.shape[1] * np.log(shots)
        if criterion < least:
            least = criterion
            spare = max(shots - terms.shape[1], 1)
            pedestal = float(weights[-1]) if terms.shape[1] > order + 1 else 0.0
            best = Background(values=values, pedestal=pedestal, dispersion=squares / spare, terms=terms)
    assert best is not None
    return best


def fit_poisson(counts: Floats, terms: Floats) -> tuple[Floats, Floats]:
    """Weights of the terms, and fitted counts: maximum likelihood by Fisher scoring with the identity link.

    One step is a weighted least-squares fit of the counts themselves, with the weights 1/mean of the step before.
    """
    floor = _LEAST * float(counts.mean())
    values = np.full(counts.size, counts.mean())
    found = np.zeros(terms.shape[1])
    for _ in range(_ROUNDS):
        scale = 1 / np.sqrt(values)
        found = np.asarray(np.linalg.lstsq(terms * scale[:, None], counts * scale, rcond=None)[0], np.float64)
        values = np.asarray(np.maximum(terms @ found, floor), np.float64)
    return found, values


def _terms(area: Floats, order: int) -> Floats:
    """(shot, term); the last one is the open area, if it changes."""
    smooth = np.asarray(np.polynomial.chebyshev.chebvander(np.linspace(-1, 1, area.size), order), np.float64)
    apart = area - area.mean()
    return smooth if np.abs(apart).max() <= 1e-9 * np.abs(area).max() else np.column_stack([smooth, apart])
