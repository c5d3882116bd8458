"""What a coded aperture is like: its power spectrum, the colour of its noise, and its clusters.

The spectrum is Bartlett's (Salazar 2022, section 3.5): the code is cut into R sub-regions of side N/√R, and the mean over them of
|DFT|²/energy is taken, where the energy of a sub-region is the sum of its squared elements. By Parseval's theorem the mean of this
spectrum over all frequencies, the constant (DC) term included, is 1. The DC term is Σt of a sub-region, for a binary code, and
towers over the rest; what a pattern is like stands in the other frequencies, and those are all that is judged here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .patterns import check_code

LEAST_SHARE = 0.01  # of the power that must be elsewhere than in a flat spectrum, before a pattern has a colour
SPREAD = 4.0  # times 1/√elements: what chance moves in a flat spectrum
FOLD = 1e-9  # cycles/element; frequencies nearer than this are one


def frequencies(count: int) -> np.ndarray:
    """Frequencies of a spectrum with `count` values, cycles per code element, in the order of `numpy.fft.fft`.

    Examples
    --------
    >>> from shadowgram.codes.analysis import frequencies
    >>> frequencies(4)
    array([ 0.  ,  0.25, -0.5 , -0.25])
    """
    return np.fft.fftfreq(count)


def bartlett(code: np.ndarray, blocks: int = 16) -> np.ndarray:
    """Power spectral density of a code, averaged over sub-regions and shots.

    Parameters
    ----------
    code : (shot, y, x) or (y, x), transmittance in [0, 1].
    blocks : R, number of sub-regions, √R along each axis; a square number. More give less resolution and less chance.

    Returns
    -------
    (y/√R, x/√R) float64 array, frequencies as in `frequencies`: the constant (DC) term is at [0, 0]. Where √R does not divide a
    side, the last rows or columns of the code are left out. Sub-regions without an open element are skipped.

    Raises
    ------
    ValueError
        If the code is not one, is closed everywhere, or cannot be cut into so many sub-regions.

    Notes
    -----
    Source: Salazar (2022), eq. (3.19).

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.codes.analysis import bartlett
    >>> density = bartlett(sg.codes.boolean(shots=3, shape=(64, 96), seed=0))
    >>> density.shape, density.mean().round(6)
    ((16, 24), np.float64(1.0))
    """
    code = _checked(code)
    root, ny, nx = _division(code.shape[1:], blocks)
    density, regions = np.zeros((ny, nx)), 0
    for shot in code:  # one at a time: the transform of a whole stack could be large
        whole = shot[: root * ny, : root * nx].astype(np.float64)
        parts = whole.reshape(root, ny, root, nx).swapaxes(1, 2).reshape(-1, ny, nx)
        energy = np.square(parts).sum(axis=(1, 2))
        lit = energy > 0
        density += (np.abs(np.fft.fft2(parts[lit])) ** 2 / energy[lit, None, None]).sum(axis=0)
        regions += int(lit.sum())
    if not regions:
        raise ValueError("the code is closed everywhere, so it has no spectrum; check the file or the transmittance")
    return density / regions


def aapsd(code: np.ndarray, blocks: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """Axially averaged power spectral density: Bartlett's spectrum, averaged over its rows and over its columns.

    Parameters
    ----------
    code : (shot, y, x) or (y, x), transmittance in [0, 1]; of several shots the mean is taken.
    blocks : R, number of sub-regions; a square number.

    Returns
    -------
    rows : (x/√R,) spectrum along x, the mean over the rows of `bartlett`.
    columns : (y/√R,) spectrum along y, the mean over its columns.
        Both in the order of `numpy.fft.fft`; `frequencies` says which frequencies these are. Value 0 of each holds the constant
        (DC) term, which is much larger than the rest. A pattern without order is flat, at 1 − transmittance, elsewhere.

    Raises
    ------
    ValueError
        As `bartlett`.

    Notes
    -----
    Source: Salazar (2022), eqs. (3.20) and (3.21). Averaged over both axes, a two-dimensional pattern loses contrast: a ring of
    power at frequency f reaches down to 0 in either. `bartlett` shows it whole.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.codes.analysis import aapsd
    >>> rows, columns = aapsd(sg.codes.boolean(shots=4, shape=(64, 128), seed=0))
    >>> rows.shape, columns.shape, rows[1:].mean().round(1)
    ((32,), (16,), np.float64(0.8))
    """
    density = bartlett(code, blocks)
    return density.mean(axis=0), density.mean(axis=1)


def band_power(spectrum: np.ndarray, low: float, high: float) -> float:
    """Share of a code's power, the constant term apart, at frequencies low < |f| ≤ high.

    Parameters
    ----------
    spectrum : one of `aapsd`, or of `bartlett`, where |f| = √(fx² + fy²). Negative frequencies count like positive ones.
    low, high : cycles per element. A spectrum along one axis ends at 0.5, one along two at √½.

    Returns
    -------
    float
        From 0 to 1. A flat spectrum along one axis has about 2 (high − low).

    Raises
    ------
    ValueError
        If low and high are not in order, or the spectrum has no power but the constant.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> from shadowgram.codes.analysis import aapsd, band_power
    >>> stripes = np.tile([0, 1], (32, 16))
    >>> rows, columns = aapsd(stripes, blocks=4)
    >>> band_power(rows, 0.4, 0.5), band_power(rows, 0, 0.4)
    (1.0, 0.0)
    """
    if not 0 <= low < high:
        raise ValueError(f"low and high must be frequencies with 0 ≤ low < high, got {low} and {high}")
    frequency, power, _ = _folded(spectrum)
    inside = (frequency > low + FOLD) & (frequency <= high + FOLD)
    return float(power[inside].sum() / power.sum())


def noise_colour(spectrum: np.ndarray, *, elements: int | None = None) -> str:
    """Name the colour of a code's noise by where its power lies.

    Parameters
    ----------
    spectrum : one of `aapsd`, or of `bartlett`, which is then taken over |f| = √(fx² + fy²).
    elements : number of code elements that the spectrum was made of, ``code.size``; it says what chance does. By default as many
        as one square shot has in 16 sub-regions: right for the default of `aapsd`, cautious for more shots.

    Returns
    -------
    str
        ``"white"``: flat, up to chance. ``"blue"``: power lacks at low frequencies: open elements keep apart. ``"green"``: it lacks
        at low and at high ones: open elements form clusters that keep apart. ``"red"``: it lacks at high ones only: clusters
        without order.

    Raises
    ------
    ValueError
        If the spectrum is not one, or has no power but the constant.

    Notes
    -----
    Let C(f) be the share of power at frequencies up to f (`band_power`) and F(f) that of a flat spectrum. −min(C − F) is the
    power that lacks below some frequency, and max(C − F) that which lacks above one. For a flat spectrum of n elements C − F is a
    Brownian bridge that seldom exceeds 2.8/√n (once in 1,000); lacks count when above 4/√n, as complementary shots repeat each
    other in part, and above 1 % of the power. Power that lacks at high frequencies makes a pattern blue still if it is less than a
    quarter of what lacks at low ones. It makes it green if, of the frequencies below the one where C − F is largest, the low ones
    lack more than chance and 2 % of the power there. Frequencies are resolved to one over the side of a sub-region, and those of
    the constant are not judged: clusters that keep further apart than that side are red, and green with fewer `blocks`.
    The names are from Ulichney (1988) and from Lau, Arce and Gallagher (1998); Salazar (2022), section 3.6.5, speaks of green
    where the power is at low to middle frequencies, which is red or green here.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.codes.analysis import aapsd, noise_colour
    >>> code = sg.codes.boolean(shots=4, shape=(128, 128), seed=0)
    >>> [noise_colour(spectrum, elements=code.size) for spectrum in aapsd(code)]
    ['white', 'white']
    """
    _, power, values = _folded(spectrum)
    count = 16 * np.size(spectrum) ** (2 // np.ndim(spectrum)) if elements is None else elements
    if count < 1:
        raise ValueError(f"elements must be the number of elements of the code, such as code.size, got {elements}")
    chance = SPREAD / math.sqrt(count)
    surplus = _surplus(power, values)
    low, high = -surplus.min(), surplus.max()
    least = max(LEAST_SHARE, chance)
    if max(low, high) <= least:
        return "white"
    if high <= max(least, low / 4):
        return "blue"
    below = surplus.argmax() + 1
    part = values[:below].sum() / values.sum()
    rise = -_surplus(power[:below], values[:below]).min()
    return "green" if rise > max(2 * LEAST_SHARE, chance / math.sqrt(part)) else "red"


@dataclass(frozen=True, kw_only=True, eq=False)
class Clusters:
    """Runs of open elements along the rows of a code, beside those of rows whose elements are open by chance.

    Attributes
    ----------
    transmittance : p, share of open elements.
    mean_run : mean length of a run, elements; 0 if nothing is open.
    runs_per_row : mean number of runs in a row of a shot.
    histogram : (x,) number of runs of 1, 2, ... x elements, in all rows and shots.
    chance_mean_run, chance_runs_per_row, chance_histogram : what independent elements that are open with probability p would give
        on average. Long rows have runs of 1/(1−p) elements.
    """

    transmittance: float
    mean_run: float
    runs_per_row: float
    histogram: np.ndarray
    chance_mean_run: float
    chance_runs_per_row: float
    chance_histogram: np.ndarray

    @property
    def clustering(self) -> float:
        """Mean run over that of chance: above 1 open elements cluster, below 1 they keep apart."""
        return self.mean_run / self.chance_mean_run if self.chance_mean_run else 1.0


def clusters(code: np.ndarray) -> Clusters:
    """Measure the runs of open elements along the rows (x) of a code.

    Parameters
    ----------
    code : (shot, y, x) or (y, x) of open (1) and closed (0) elements. For runs along y give ``code.swapaxes(-1, -2)``.

    Returns
    -------
    Clusters

    Raises
    ------
    ValueError
        If the code is not one, or has gray elements.

    Notes
    -----
    Salazar (2022), section 3.3.4: a voxel that sees two code columns needs both open in the same shot, so optimised codes cluster
    along x.

    Examples
    --------
    >>> from shadowgram.codes.analysis import clusters
    >>> found = clusters([[1, 1, 0, 1, 0, 0], [0, 1, 1, 1, 0, 1]])
    >>> found.mean_run, found.runs_per_row, found.histogram
    (1.75, 2.0, array([2, 1, 1, 0, 0, 0]))
    """
    code = _checked(code)
    if code.dtype != np.uint8:
        raise ValueError("clusters takes a code of open (1) and closed (0) elements, got gray ones; round it first")
    shots, rows, columns = code.shape
    lengths = _run_lengths(code.reshape(shots * rows, columns))
    histogram = np.bincount(lengths, minlength=columns + 1)[1:]
    share = int(code.sum(dtype=np.int64)) / code.size
    chance = shots * rows * _chance_runs(share, columns)
    return Clusters(
        transmittance=share,
        mean_run=float(lengths.mean()) if lengths.size else 0.0,
        runs_per_row=lengths.size / (shots * rows),
        histogram=histogram,
        chance_mean_run=share * code.size / float(chance.sum()) if share else 0.0,
        chance_runs_per_row=float(chance.sum()) / (shots * rows),
        chance_histogram=chance,
    )


def _checked(code: np.ndarray) -> np.ndarray:
    code = np.asarray(code)
    if code.ndim not in (2, 3) or not code.size:
        raise ValueError(
            f"the code must be (shot, y, x) or (y, x), got the shape {code.shape}; of a colored code give one band at a time"
        )
    return check_code(code, code.shape[-2:])


def _division(shape: tuple[int, ...], blocks: int) -> tuple[int, int, int]:
    """√R, and the sides y and x of a sub-region."""
    root = math.isqrt(blocks) if isinstance(blocks, int | np.integer) and blocks > 0 else 0
    if not root or root * root != blocks:
        raise ValueError(f"blocks must be a square number of sub-regions, such as 4, 9 or 16, got {blocks!r}")
    ny, nx = (n // root for n in shape)
    if min(ny, nx) < 2:
        raise ValueError(
            f"a code of {shape[0]} × {shape[1]} elements cannot be cut into {root} × {root} sub-regions of at least 2 × 2;"
            " use fewer blocks or a larger code"
        )
    return root, ny, nx


def _folded(spectrum: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distinct |f| > 0, ascending, the power at each, and how many values of the spectrum have it."""
    spectrum = np.asarray(spectrum, np.float64)
    if spectrum.ndim not in (1, 2) or max(spectrum.shape, default=0) < 2 or not (spectrum >= 0).all():
        raise ValueError(
            "the spectrum must be one of aapsd or bartlett, one or two axes of numbers that are not negative,"
            f" got an array of shape {spectrum.shape}"
        )
    axes = np.meshgrid(*(frequencies(n) for n in spectrum.shape), indexing="ij")
    frequency = np.sqrt(sum(np.square(f) for f in axes)).ravel()[1:]
    distinct, place, values = np.unique(np.round(frequency / FOLD), return_inverse=True, return_counts=True)
    power = np.bincount(place, spectrum.ravel()[1:])
    if power.sum() <= 1e-12 * spectrum.sum():
        raise ValueError("the spectrum has no power but the constant: the code is the same everywhere")
    return distinct * FOLD, power, values


def _surplus(power: np.ndarray, values: np.ndarray) -> np.ndarray:
    """C − F: share of power up to each frequency, less the share that a flat spectrum has there."""
    return np.cumsum(power) / power.sum() - np.cumsum(values) / values.sum()


def _run_lengths(rows: np.ndarray) -> np.ndarray:
    """Lengths of all runs of ones in the rows."""
    edges = np.diff(np.pad(rows.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    return np.nonzero(edges == -1)[1] - np.nonzero(edges == 1)[1]


def _chance_runs(share: float, columns: int) -> np.ndarray:
    """Expected number of runs of 1 ... n elements in a row of n that are open with probability `share`.

    A run of l < n elements ends with one closed neighbour in two places, at the row's ends, and with two in n − l − 1 others.
    """
    length = np.arange(1, columns + 1)
    closed = 1 - share
    runs = share**length * (2 * closed + (columns - length - 1) * closed**2)
    runs[-1] = share**columns
    return runs
