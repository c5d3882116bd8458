"""Is there a picture in the counts? The codes against themselves, shifted in time.

The codes in their place explain the counts of a true scan better than the same codes some shots earlier or later; if they do
not, no reconstruction of these counts shows a target.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._captured_drift import basis_of, criteria, explaining, slow_terms, without
from ._captured_kernel import covariance, one_blas_thread, self_correlation
from .captured import Capture, check_order

Floats = NDArray[np.float64]

LEAST_LAGS = 19
"""With fewer no result could be below 5 %."""
LEVEL = 0.05

_RIDGES = np.geomspace(0.02, 200.0, 17)  # noise over the picture's share, of the variance of a shot
_ALIKE = 0.1  # self-correlation below which a shifted code is another code


@dataclass(frozen=True, kw_only=True, eq=False)
class PermutationTest:
    """How well the codes explain the counts, and how well shifted ones do.

    Attributes
    ----------
    statistic : share of the variance of the counts, beside drift, open area and background, that a smooth picture behind the codes
        predicts (1 − GCV/variance); 0 or less if nothing.
    null : (lag,) the same for codes that are shifted in a circle.
    lags : (lag,) shots that they are shifted by.
    p_value : share of all lags, that of 0 included, that do as well as the codes in their place.
    drift_order : of the polynomial that was taken from the counts.
    noise : standard deviation of the counts beside drift, open area and background, in their units.
    moves_in : shots after which a code shares nothing with itself, which are left out of the lags on both sides.
    """

    statistic: float
    null: Floats
    lags: NDArray[np.int64]
    p_value: float
    drift_order: int
    noise: float
    moves_in: int

    @property
    def least_p(self) -> float:
        """The p-value of codes that do better than all shifted ones."""
        return 1 / (1 + len(self.null))

    @property
    def significant(self) -> bool:
        """Whether the p-value is at most 5 %."""
        return self.p_value <= LEVEL

    @property
    def verdict(self) -> str:
        """A sentence for people."""
        share = f"{100 * max(self.statistic, 0):.1f} % of the variance"
        if self.significant:
            return f"the codes explain the counts (p = {self.p_value:.2g}): {share} beside the drift"
        return f"the codes explain the counts no better than shifted codes do (p = {self.p_value:.2g}); do not trust a picture"


@one_blas_thread()
def permutation_test(
    codes: ArrayLike,
    counts: ArrayLike,
    background: ArrayLike | None = None,
    *,
    lags: Sequence[int] | None = None,
    drift_order: int | None = None,
) -> PermutationTest:
    """Compare the codes in their place with the same codes, shifted in a circle of shots.

    Parameters
    ----------
    codes : (shot, y, x), 0 and 1.
    counts : (shot,) with the target.
    background : (shot,) without it; the counts may follow it by any gain, beside a drift and the open area.
    lags : shots to shift by; by default all after which a code shares nothing with itself.
    drift_order : of the polynomial in the number of the shot; by default chosen by the Bayesian information criterion.

    Returns
    -------
    PermutationTest

    Raises
    ------
    ValueError
        If codes and counts do not fit together, or fewer than 19 lags are left.

    Notes
    -----
    Drift (Legendre polynomials), open area and background are fitted and taken away. What is left, r, is compared with the smooth
    pictures of a ridge regression whose weight is chosen by generalised cross-validation, over the same 17 weights for each lag.

    Why shifts: residues of drift make r correlated from shot to shot, and so are sliding codes. Swapping single shots would destroy
    both and give too small p-values; a shift in a circle keeps both, but for the seam. If r knows nothing of the codes, and the
    statistics of codes and r do not depend on time, then every lag is as likely to give the best fit as lag 0.

    Which lags: k shots later a mask that slides shows the same picture k columns to the side, so that small lags explain the counts
    of a true scan too. They would make the null too good. Lags are left out, from both ends of the circle, until the codes
    correlate with themselves by less than 0.1 however they are moved along x or y, and a ninth more.

    The test is for structure *in* the field: a flat picture only follows the open area, which is taken away.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.xray.permutation import permutation_test
    >>> rng = np.random.default_rng(0)
    >>> strip = rng.integers(0, 2, (16, 16 + 199))
    >>> codes = np.stack([strip[:, q : q + 16] for q in range(200)])
    >>> picture = np.zeros((16, 16)); picture[4:9, 3:11] = 20.0
    >>> counts = rng.poisson(4000 + 3.0 * np.arange(200) + (codes * picture).sum(axis=(1, 2)))
    >>> test = permutation_test(codes, counts)
    >>> test.p_value == test.least_p, test.moves_in
    (True, 17)
    >>> permutation_test(codes, rng.poisson(4000 + 3.0 * np.arange(200))).significant
    False
    """
    scan = _capture(codes, counts, background)
    prepared = _Prepared(scan, drift_order)
    chosen, moves_in = _chosen_lags(scan.codes, lags)
    share = prepared.shares(prepared.coefficients(prepared.rest), float(prepared.rest @ prepared.rest))
    null = share[chosen]
    p_value = (1 + int((null >= share[0]).sum())) / (1 + len(null))
    shots = len(scan.counts)
    noise = float(np.sqrt(prepared.rest @ prepared.rest / max(shots - prepared.basis.shape[1], 1)))
    return PermutationTest(
        statistic=float(share[0]),
        null=null,
        lags=chosen,
        p_value=p_value,
        drift_order=prepared.order,
        noise=noise,
        moves_in=moves_in,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class DetectionPower:
    """How small a target the permutation test would have found in a scan.

    Attributes
    ----------
    contrasts : share of the mean counts, less the mean background, that comes from a square target.
    power : share of the simulated scans in which it was found.
    smallest : contrast that is found with a probability of 80 %, interpolated; infinite if none of them is.
    side : (y, x) cells of the square.
    """

    contrasts: Floats
    power: Floats
    smallest: float
    side: tuple[int, int]


@one_blas_thread()
def detection_power(
    codes: ArrayLike,
    counts: ArrayLike,
    background: ArrayLike | None = None,
    *,
    contrasts: Sequence[float] = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 1.0),
    side: tuple[int, int] | None = None,
    simulations: int = 48,
    drift_order: int | None = None,
    seed: int = 0,
) -> DetectionPower:
    """Add square targets to the counts of a scan, and see how often the permutation test finds them at a level of 5 %.

    The noise is that of the scan itself: the targets are seen through codes that are shifted by some other lag, with which the
    counts have nothing in common.

    Parameters
    ----------
    codes, counts, background, drift_order : as of `permutation_test`.
    contrasts : of the targets, see `DetectionPower`.
    side : (y, x) cells; by default a quarter of the field.
    simulations : scans for each contrast, with the square somewhere in the field.
    seed : of where and when.

    Raises
    ------
    ValueError
        As of `permutation_test`; or if the square is larger than the field, or there is nothing above the background.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.xray.permutation import detection_power
    >>> rng = np.random.default_rng(0)
    >>> codes = rng.integers(0, 2, (96, 8, 8))
    >>> found = detection_power(codes, rng.poisson(2000, 96), contrasts=(0.01, 0.5), simulations=20)
    >>> bool(found.power[0] < 0.5 < found.power[1])
    True
    """
    scan = _capture(codes, counts, background)
    prepared = _Prepared(scan, drift_order)
    allowed, _ = _chosen_lags(scan.codes, None)
    rows, columns = scan.codes.shape[1:]
    square = side or (max(rows // 4, 1), max(columns // 4, 1))
    if not (1 <= square[0] <= rows and 1 <= square[1] <= columns):
        raise ValueError(f"the square must fit into the field of {rows} × {columns} cells, got {square}")
    net = float(scan.counts.mean() - (0.0 if scan.background is None else scan.background.mean()))
    if net <= 0:
        raise ValueError("the counts are on average not above the background, so a contrast means nothing")
    levels = np.asarray(contrasts, np.float64)
    rng = np.random.default_rng(seed)
    found = np.zeros(len(levels))
    own = prepared.coefficients(prepared.rest)
    for _ in range(simulations):
        lag = int(rng.choice(allowed))
        added = net * _seen(np.roll(scan.codes, lag, axis=0), square, rng)
        found += prepared.finds(own, added, levels, lag, allowed)
    power = found / simulations
    return DetectionPower(contrasts=levels, power=power, smallest=_crossing(levels, power), side=square)


def _capture(codes: ArrayLike, counts: ArrayLike, background: ArrayLike | None) -> Capture:
    return Capture(
        codes=np.asarray(codes),
        counts=np.asarray(counts),
        background=None if background is None else np.asarray(background),
    )


class _Prepared:
    """A scan without its drift, and the modes in which smooth pictures can change it."""

    def __init__(self, scan: Capture, order: int | None) -> None:
        others = explaining(scan.codes, scan.background)
        shots = len(scan.counts)
        if order is not None:
            check_order(order, shots)
        self.order = int(criteria(scan.counts, others).argmin()) if order is None else int(order)
        self.basis = basis_of(np.column_stack([slow_terms(shots, self.order), others]))
        self.rest = without(scan.counts, self.basis)
        if float(self.rest @ self.rest) <= 1e-20 * float(scan.counts @ scan.counts):
            raise ValueError("drift and open area explain the counts entirely, so there is nothing left to test")
        values, modes = np.linalg.eigh(covariance(scan.codes))
        # Correlations in a circle with every mode at once, by the Fourier transform over the shots.
        self.spectrum = np.fft.rfft(modes, axis=0).conj()
        self.kept = _RIDGES / (values.clip(0)[:, None] + _RIDGES)  # (mode, ridge) share that a fit leaves
        self.freedom = (self.kept.sum(axis=0) / shots) ** 2

    def coefficients(self, values: Floats) -> Floats:
        """(lag, mode) products of values (shot,) with the modes of codes that are shifted by each lag."""
        return np.fft.irfft(self.spectrum * np.fft.rfft(values)[:, None], len(values), axis=0)

    def shares(self, coefficients: Floats, power: float) -> Floats:
        """(lag,) largest 1 − GCV/variance over the ridges."""
        left = coefficients**2 @ self.kept**2
        return 1 - (left / self.freedom).min(axis=1) / power

    def finds(self, own: Floats, added: Floats, levels: Floats, lag: int, allowed: NDArray[np.int64]) -> Floats:
        """(level,) 1 where the test finds what was added to the counts through codes shifted by `lag`."""
        more = without(added, self.basis)
        extra = self.coefficients(more)
        found = np.zeros(len(levels))
        for place, level in enumerate(levels):
            rest = self.rest + level * more
            share = self.shares(own + level * extra, float(rest @ rest))
            null = share[(lag + allowed) % len(rest)]
            found[place] = (1 + (null >= share[lag]).sum()) / (1 + len(null)) <= LEVEL
        return found


def _chosen_lags(codes: NDArray, lags: Sequence[int] | None) -> tuple[NDArray[np.int64], int]:
    """Lags of the null, and shots after which the codes share nothing."""
    shots = len(codes)
    alike = self_correlation(codes)
    # Few cells resemble each other by chance, which the least of all lags tells.
    floor = min(max(_ALIKE, 1.5 * float(alike.min())), 2.5 * _ALIKE)
    unlike = np.flatnonzero(_three_below(alike, floor))
    moves_in = shots if not unlike.size else max(1, int(np.ceil(unlike[0] * 10 / 9)))
    if lags is None:
        inner = np.arange(moves_in, shots - moves_in + 1)
        chosen = inner[alike[inner % shots] < floor] if inner.size else inner
    else:
        chosen = np.unique(np.asarray(lags, np.int64) % shots)
        chosen = chosen[chosen > 0]
    if len(chosen) < LEAST_LAGS:
        raise ValueError(
            f"a code needs {moves_in} of the {shots} shots to become another one, which leaves {len(chosen)} lags to compare with;"
            f" at least {LEAST_LAGS} are needed: take more shots"
        )
    return chosen, moves_in


def _three_below(values: Floats, floor: float) -> NDArray[np.bool_]:
    """Whether a value and the two after it are below the floor."""
    below = values < floor
    return below & np.roll(below, -1) & np.roll(below, -2)


def _seen(codes: NDArray, square: tuple[int, int], rng: np.random.Generator) -> Floats:
    """(shot,) what a square somewhere in the field adds, 1 on average."""
    top, left = (int(rng.integers(0, whole - part + 1)) for whole, part in zip(codes.shape[1:], square, strict=True))
    seen = codes[:, top : top + square[0], left : left + square[1]].sum(axis=(1, 2), dtype=np.float64)
    return seen / max(float(seen.mean()), 1e-30)


def _crossing(levels: Floats, power: Floats, wanted: float = 0.8) -> float:
    """Level at which the power first reaches what is wanted and stays there, linear between the levels."""
    order = np.argsort(levels)
    levels, power = levels[order], power[order]
    reached = np.flatnonzero(power < wanted)
    first = 0 if not reached.size else int(reached[-1]) + 1
    if first == len(levels):
        return float("inf")
    if first == 0:
        return float(levels[0])
    share = (wanted - power[first - 1]) / (power[first] - power[first - 1])
    return float(levels[first - 1] + share * (levels[first] - levels[first - 1]))
