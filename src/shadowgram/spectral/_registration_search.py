"""Where captures of a white scene may lie on a known code, to about a column: where the fit of `_registration_geometry` begins.

The correlation of every detector column m with every code column u, over rows and shots, has a ridge along u = o + (m + ½) w.
"""

from __future__ import annotations

import math

import numpy as np

from ._registration_geometry import LEAST_BLUR, Captures, Placement, code_columns

SEARCHED = 0.5  # largest mask position that is tried
TRIED = 3  # bands, from the strongest, in which the code is looked for first
SIGNIFICANT = 7.0  # standard deviations above chance; among 1e6 places chance gives 5


def search(captures: Captures, most_rows: int) -> Placement:
    """Placement to about a column, or a ValueError if the captures do not show the code."""
    energies = np.square(captures.columns).sum(axis=(1, 2))
    # The strongest band may be strong by something else.
    for k in np.argsort(-energies)[:TRIED]:
        dy = _row_shift(captures.columns[k], captures, most_rows)
        if dy is not None:
            break
    else:
        raise ValueError(
            "the captures do not show this code: their best agreement with it is not above chance;"
            f" check that code and shots belong together, are not mirrored, and lie within {most_rows} rows of each other"
        )
    seen, _, _ = code_columns(captures, dy, LEAST_BLUR)
    place = _from_middle(captures.columns.shape[1])
    tables = _correlations(captures.columns, seen)
    _, position, _ = _best_line(tables[k], place, captures.ratio)
    offsets = [_offset(table, place, captures.ratio * (1 - position)) for table in tables]
    return Placement(mask_position=position, offsets=np.array(offsets), dy=float(dy))


def _row_shift(columns: np.ndarray, captures: Captures, most_rows: int) -> int | None:
    """Detector rows by which the code fits best, None if nowhere better than by chance."""
    place = _from_middle(len(columns))
    # In few columns a wrong stretch does no harm, so that all rows can be tried with few of them.
    central = np.abs(place) < max(len(place) / 8, 32)
    rows = range(-most_rows, most_rows + 1)
    shifted = np.stack([code_columns(captures, dy, LEAST_BLUR)[0] for dy in rows])
    tables = _correlations(shifted, columns[central]).swapaxes(1, 2)
    scores, _, mean_squares = zip(*(_best_line(t, place[central], captures.ratio) for t in tables), strict=True)
    best = int(np.argmax(scores))
    return rows[best] if scores[best] > SIGNIFICANT * math.sqrt(np.mean(mean_squares)) else None


def _from_middle(elements: int) -> np.ndarray:
    """Places of the detector's columns."""
    return np.arange(elements) + 0.5 - elements / 2


def _correlations(columns: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(…, column, other column) for (…, column, shot·y) and (other column, shot·y), by one large product."""
    flat = _unit(columns).reshape(-1, columns.shape[-1]) @ _unit(others).T
    return flat.reshape(*columns.shape[:-1], len(others))


def _unit(columns: np.ndarray) -> np.ndarray:
    norms = np.linalg.norm(columns, axis=-1, keepdims=True)
    # Columns beside the mask hold nothing but rounding.
    return columns / np.maximum(norms, np.maximum(1e-3 * norms.max(axis=-2, keepdims=True), np.finfo(np.float32).tiny))


def _best_line(correlations: np.ndarray, place: np.ndarray, ratio: int) -> tuple[float, float, float]:
    """(score, mask position, mean square of all scores), for detector columns at `place` from the detector's middle."""
    step = 1.5 / (ratio * len(place))  # three quarters of a column at the ends
    correlations = _smooth(correlations)
    middles = np.arange(correlations.shape[1])
    best, total, positions = (-math.inf, 0.0), 0.0, np.arange(0, SEARCHED, step)
    for position in positions:
        scores = _line_scores(correlations, place, middles, ratio * (1 - position))
        best = max(best, (float(scores.max()), float(position)))
        total += float(np.mean(scores**2))
    return *best, total / len(positions)


def _offset(correlations: np.ndarray, place: np.ndarray, width: float) -> float:
    """o of a band, NaN where nothing stands out of chance."""
    if not correlations.any():
        return math.nan
    correlations = _smooth(correlations)
    half = math.ceil(len(place) / 2 * width)
    middles = np.arange(-half, correlations.shape[1] + half)
    scores = _line_scores(correlations, place, middles, width)
    best = int(scores.argmax())
    # Of a normal distribution, the median of |score| is 0.6745 of the standard deviation; the peak does not move it.
    if not scores[best] > SIGNIFICANT * np.median(np.abs(scores[scores != 0])) / 0.6745:
        return math.nan
    return float(middles[best] + 0.5 - len(place) / 2 * width)


def _smooth(correlations: np.ndarray) -> np.ndarray:
    """Over 3 code columns, so that a line may pass beside its columns."""
    smooth = correlations.copy()
    smooth[:, 1:] += correlations[:, :-1] / 2
    smooth[:, :-1] += correlations[:, 1:] / 2
    return smooth


def _line_scores(correlations: np.ndarray, place: np.ndarray, middles: np.ndarray, width: float) -> np.ndarray:
    """Sum of the correlations along the line through each code column of `middles` at the detector's middle."""
    rows, columns = correlations.shape
    column = middles + np.round(place * width).astype(np.int64)[:, None]
    inside = (column >= 0) & (column < columns)
    return np.where(inside, correlations[np.arange(rows)[:, None], np.clip(column, 0, columns - 1)], 0).sum(axis=0)
