"""Whether codes and counts run apart in the course of a scan, as the counts themselves tell."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._captured_drift import basis_of, criteria, explaining, slow_terms
from ._captured_kernel import covariance, one_blas_thread

Floats = NDArray[np.float64]

_RIDGES = np.geomspace(0.02, 200.0, 17)


@dataclass(frozen=True, kw_only=True, eq=False)
class Slip:
    """By how much the codes run apart from what the target saw.

    Attributes
    ----------
    cells : from the first shot to the last; that of the largest likelihood, from a parabola through its neighbours.
    standard_error : from the curvature there; infinite at an end of what was tried, or where the counts do not tell.
    gain : log-likelihood over that of no slip.
    p_value : chance of such a gain if there is no slip, by the likelihood ratio with one degree of freedom.
    tried, likelihoods : (slip,) cells, and the log-likelihoods relative to no slip.
    """

    cells: float
    standard_error: float
    gain: float
    p_value: float
    tried: Floats
    likelihoods: Floats


@one_blas_thread()
def slip(
    codes: ArrayLike,
    counts: ArrayLike,
    background: ArrayLike | None = None,
    *,
    axis: Literal["x", "y"] = "x",
    tried: Sequence[float] | None = None,
    drift_order: int | None = None,
) -> Slip:
    """Find an offset of the codes that grows evenly from shot to shot, such as that of a stage with a wrong step.

    Parameters
    ----------
    codes : (shot, y, x).
    counts, background : (shot,).
    axis : along which the codes slip.
    tried : cells from the first shot to the last, in rising order and with 0 among them; by default from −2 to 2 in steps of 1/4.
        With s the codes of the last shot are read s/2 cells further along, and those of the first s/2 cells before; at the edge
        the last cell is repeated.
    drift_order : as of `shadowgram.xray.permutation.permutation_test`.

    Returns
    -------
    Slip

    Raises
    ------
    ValueError
        If codes and counts do not fit together, or `tried` are not rising numbers with 0.

    Notes
    -----
    An offset that is the same in all shots moves the picture along, and the counts cannot tell it from a target that stands
    elsewhere: it has to be registered with something whose place is known. Therefore it is not looked for.

    The likelihood is that of counts from any smooth picture, with the noise, the picture's share and the drift fitted. Between
    cells the codes are read with weights whose variance is that of a half-way offset, whatever the offset, since otherwise the one
    with the most blur would fit a smooth picture best.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.xray.captured import slip
    >>> rng = np.random.default_rng(0)
    >>> strip = rng.integers(0, 2, (16, 16 + 256))
    >>> codes = np.stack([strip[:, q : q + 16] for q in range(256)])
    >>> late = np.stack([strip[:, q + (q >= 128) :][:, :16] for q in range(256)])
    >>> picture = np.zeros((16, 16)); picture[4:10, 3:9] = 100.0
    >>> found = slip(codes, rng.poisson(500 + (late * picture).sum(axis=(1, 2))))
    >>> bool(1 < found.cells < 2), found.p_value < 0.001
    (True, True)
    """
    from .captured import Capture

    scan = Capture(
        codes=np.asarray(codes),
        counts=np.asarray(counts),
        background=None if background is None else np.asarray(background),
    )
    values = _checked_tried(tried)
    if axis not in ("x", "y"):
        raise ValueError(f"axis is 'x' or 'y', got {axis!r}")
    others = explaining(scan.codes, scan.background)
    order = int(criteria(scan.counts, others).argmin()) if drift_order is None else drift_order
    free = _complement(np.column_stack([slow_terms(len(others), order), others]))
    rest = free.T @ scan.counts
    ordered = scan.codes if axis == "x" else scan.codes.transpose(0, 2, 1)
    over_shots = np.linspace(-0.5, 0.5, len(ordered))
    likelihoods = np.array([_likelihood(covariance(_moved(ordered, by * over_shots)), free, rest) for by in values])
    return _slip(values, likelihoods - likelihoods[np.flatnonzero(values == 0)[0]])


def _checked_tried(tried: Sequence[float] | None) -> Floats:
    values = np.arange(-8, 9) / 4 if tried is None else np.asarray(tried, np.float64)
    if values.ndim != 1 or len(values) < 3 or not (np.diff(values) > 0).all() or 0 not in values:
        raise ValueError(
            f"slips to try must be at least three rising numbers of cells with 0 among them, got {tried!r}"
        )
    return values


def _complement(terms: Floats) -> Floats:
    """Orthonormal columns of all that the terms do not span."""
    basis = basis_of(terms)
    whole, _ = np.linalg.qr(np.column_stack([basis, np.eye(len(basis))]))
    return whole[:, basis.shape[1] : len(basis)]


def _moved(codes: NDArray, by: Floats) -> Floats:
    """Codes (shot, row, cell) as they are ``by`` (shot,) cells further along the last axis, all with the same blur.

    Of the weights of three cells the sum is 1, the mean the offset f from the nearest cell, and the variance 1/4.
    """
    nearest = np.floor(by + 0.5)
    f = (by - nearest)[:, None, None]
    at = np.arange(codes.shape[2]) + nearest[:, None].astype(np.int64)
    parts = [np.take_along_axis(codes, np.clip(at + k, 0, codes.shape[2] - 1)[:, None, :], axis=2) for k in (-1, 0, 1)]
    weights = ((0.25 + f * f - f) / 2, 0.75 - f * f, (0.25 + f * f + f) / 2)
    return weights[0] * parts[0] + weights[1] * parts[1] + weights[2] * parts[2]


def _likelihood(matrix: Floats, free: Floats, values: Floats) -> float:
    """Largest log-likelihood over the noise and the share of the picture."""
    powers, modes = np.linalg.eigh(free.T @ matrix @ free)
    squares = (modes.T @ values) ** 2
    scales = powers.clip(0)[:, None] + _RIDGES
    count = len(values)
    noise = np.maximum((squares[:, None] / scales).sum(axis=0) / count, 1e-300)
    return float((-0.5 * (count * np.log(noise) + np.log(scales).sum(axis=0))).max())


def _slip(tried: Floats, likelihoods: Floats) -> Slip:
    from scipy.special import erfc

    best = int(likelihoods.argmax())
    cells, error, gain = float(tried[best]), math.inf, float(likelihoods[best])
    if 0 < best < len(tried) - 1:
        # The parabola through three points, which need not be evenly spaced.
        curve, slope, level = np.polyfit(tried[best - 1 : best + 2] - cells, likelihoods[best - 1 : best + 2], 2)
        if curve < 0:
            cells, gain = cells - float(slope / (2 * curve)), float(level - slope**2 / (4 * curve))
            error = float(1 / math.sqrt(-2 * curve))
    gain = max(gain, 0.0)
    return Slip(
        cells=cells,
        standard_error=error,
        gain=gain,
        p_value=float(erfc(math.sqrt(gain))),  # of χ² = 2 gain with one degree of freedom
        tried=tried,
        likelihoods=likelihoods,
    )
