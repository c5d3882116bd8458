"""Halftone codes: patterns whose open elements are spread evenly (blue noise) or gather in evenly spread clusters (green noise).

A pattern P of share g has the energy Σ_a Σ_b P(a) w(a − b) P(b) = Σ_f ŵ(f) |P̂(f)|², on a torus, so that patterns tile. The weight
w says which frequencies cost: a Gaussian of deviation σ charges the low ones and leaves the power to those near √g cycles per
element, the principal frequency; a difference of Gaussians charges the low ones and rewards those near √(g/M), where clusters of M
elements repeat. A complementary code gives each element to one shot, and its energy is the sum over the shots. It is lowered by
exchanging elements of two shots that lie close to each other until no exchange helps.

Sources: Ulichney, Proc. SPIE 1913 (1993) 332, void-and-cluster; Lau, Arce & Gallagher, Proc. IEEE 86 (1998) 2424, green noise;
Correa, Arguello & Arce, J. Opt. Soc. Am. A 33 (2016) 2312, blue-noise codes for spectral imaging in several shots.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .patterns import _checked_size, _generator

_UNIT = 2**20  # weights are whole multiples of 1/_UNIT; a Gaussian is below half of that at 5.4 deviations
_SWEEPS = 100  # 20 are needed at 256 × 256
_BAND = 8  # rows
_SIGMA = 1.5  # elements; Ulichney's choice
_SPACINGS = 0.5  # σ in mean spacings 1/√g where elements are so sparse that this is more than _SIGMA
_GREEN_WIDTHS = 2.0  # ratio of the two deviations; with the next number it keeps clusters near the asked size
_GREEN_REPULSION = 10.0  # integral of the wide Gaussian over that of the narrow one


def blue_noise(*, shots: int, shape: tuple[int, int], seed: int, transmittance: float | None = None) -> np.ndarray:
    """Code in which every shot is blue noise: open elements as far from each other as their number allows.

    Parameters
    ----------
    shots : number of snapshots Q.
    shape : (y, x) of the coded aperture, elements.
    seed : of the pattern.
    transmittance : share of open elements, in (0, 1], of shots that are made one by one; by default the code is complementary:
        every element is open in exactly one shot, which for one shot means that all are open.

    Returns
    -------
    (shot, y, x) uint8 array of 0 and 1, which can be tiled without seams. The shots' numbers of open elements differ by one at
    most.

    Raises
    ------
    ValueError
        If a parameter is out of range.

    Notes
    -----
    Ulichney's void-and-cluster with many classes: the shots take the largest of their voids in turn until every element is given
    away, then elements are exchanged. σ = 1.5 elements, or half the mean spacing where that is more. At 256 × 256 and 6 shots the
    power below half of the principal frequency is 4 % of a random code's.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.codes.halftone import blue_noise
    >>> code = blue_noise(shots=4, shape=(32, 32), seed=0)
    >>> bool((code.sum(axis=0) == 1).all()), code.sum(axis=(1, 2)).tolist()
    (True, [256, 256, 256, 256])
    >>> power = np.abs(np.fft.fft2(code)) ** 2 / (32 * 32 * 0.25 * 0.75)  # white noise: 1
    >>> bool(power[:, 1:4, 0:4].mean() < 0.1)
    True
    """
    size, rng = _checked_size(shots, shape, axes=2), _generator(seed)
    if transmittance is None:
        return _opened(_spread_evenly(shots, size[1:], rng), shots)
    opened = _open_elements(transmittance, size[1:])
    return np.stack([_blue_pattern(opened, size[1:], rng) for _ in range(shots)]).astype(np.uint8)


def green_noise(
    *, shots: int, shape: tuple[int, int], seed: int, cluster: float, transmittance: float | None = None
) -> np.ndarray:
    """Code in which every shot is green noise: clusters of open elements, spread evenly.

    Parameters
    ----------
    shots : number of snapshots Q.
    shape : (y, x) of the coded aperture, elements.
    seed : of the pattern.
    cluster : about how many elements M a cluster shall have, at least 2.
    transmittance : share of open elements, in (0, 1], of shots that are made one by one; by default the code is complementary, as
        of `blue_noise`.

    Returns
    -------
    (shot, y, x) uint8 array of 0 and 1, which can be tiled without seams.

    Raises
    ------
    ValueError
        If a parameter is out of range.

    Notes
    -----
    The power peaks at √(g/M) cycles per element, g being the share of open elements or, if these are fewer, of closed ones. Up to
    g = 1/4 the clusters are dots and their mean size is within 20 % of M; above 1/3 they join into bands, √(M/g) apart.
    Clusters are easier to make than single elements and diffract less. The time grows with M: at 256 × 256 and 6 shots 1.3 s for 9
    elements, 10 s for 64.

    Examples
    --------
    >>> from shadowgram.codes.halftone import green_noise
    >>> code = green_noise(shots=4, shape=(32, 32), seed=0, cluster=6)
    >>> bool((code.sum(axis=0) == 1).all())
    True
    >>> bool((code & code.take(range(1, 33), axis=2, mode="wrap")).mean() > 0.1)  # neighbours in x; 0.06 if random
    True
    """
    size, rng = _checked_size(shots, shape, axes=2), _generator(seed)
    n = math.prod(size[1:])
    opened = -(-n // shots) if transmittance is None else _open_elements(transmittance, size[1:])
    if not 2 <= cluster <= opened:
        raise ValueError(
            f"cluster must lie between 2 and the {opened} elements that a shot opens, got {cluster}; for single elements"
            " use blue_noise"
        )
    if transmittance is None:
        return _opened(_cluster_evenly(_shares(size), cluster, size[1:], rng), shots)
    counts = np.array([n - opened, opened])
    return np.stack([_cluster_evenly(counts, cluster, size[1:], rng) for _ in range(shots)]).astype(np.uint8)


def void_and_cluster(shape: tuple[int, int], seed: int) -> np.ndarray:
    """Rank of every element in a sequence of blue-noise patterns, each of which contains the one before (a dither array).

    Parameters
    ----------
    shape : (y, x) of the array, elements.
    seed : of the array.

    Returns
    -------
    (y, x) int64 array that holds every rank 0 … y·x − 1 once. ``rank < n`` opens n elements and is blue noise for every n.

    Raises
    ------
    ValueError
        If `shape` or `seed` is out of range.

    Notes
    -----
    From a pattern with a tenth of the elements open, phase I takes away the tightest cluster until nothing is left; phases II and
    III fill the largest void. On a torus these two are one rule, because the energy of the closed elements is a constant minus that
    of the open ones. σ = 1.5 elements, as in the source; where less than a tenth is open, or closed, σ is half the mean spacing,
    since elements that are too far apart to feel each other would be ranked at random.

    Examples
    --------
    >>> from shadowgram.codes.halftone import void_and_cluster
    >>> rank = void_and_cluster((16, 16), seed=0)
    >>> bool((np.sort(rank, axis=None) == np.arange(256)).all()), int((rank < 64).sum())
    (True, 64)
    """
    size, rng = _checked_size(1, shape, axes=2)[1:], _generator(seed)
    n = math.prod(size)
    few = -(-n // 10)
    start = _blue_pattern(few, size, rng)
    filled = _fill_voids(start, max(n - 2 * few, 0), _gaussian(_SIGMA, size), rng)
    full = start.copy()
    full.flat[filled] = 1
    rank = np.empty(n, np.int64)
    rank[_thin_out(start, rng)[::-1]] = np.arange(few)
    rank[filled] = np.arange(few, few + filled.size)
    rank[_thin_out(1 - full, rng)] = np.arange(few + filled.size, n)
    return rank.reshape(size)


@dataclass(frozen=True, kw_only=True)
class _Stencil:
    """Weights w around an element, folded on the torus; weights[0, 0] lies `corner` = (y, x) away from it."""

    weights: np.ndarray
    corner: tuple[int, int]

    def middle(self, reach: int) -> _Stencil:
        """The part within `reach` elements."""
        first = [max(-c - reach, 0) for c in self.corner]
        last = [-c + reach + 1 for c in self.corner]
        return _Stencil(
            weights=np.ascontiguousarray(self.weights[first[0] : last[0], first[1] : last[1]]),
            corner=(self.corner[0] + first[0], self.corner[1] + first[1]),
        )


def _stencil(profile: Callable[[np.ndarray], np.ndarray], reach: int, shape: tuple[int, ...]) -> _Stencil:
    """The function `profile` of the squared distance, up to `reach` elements along y and x."""
    offsets = np.arange(-reach, reach + 1)
    weights = np.rint(_UNIT * profile(offsets[:, None] ** 2 + offsets**2)).astype(np.int64)
    high, wide = (min(n, offsets.size) for n in shape)
    corner = (-(high // 2), -(wide // 2))
    folded = np.zeros((high, wide), np.int64)
    np.add.at(folded, ((offsets[:, None] - corner[0]) % high, (offsets - corner[1]) % wide), weights)
    return _Stencil(weights=folded, corner=corner)


def _gaussian(sigma: float, shape: tuple[int, ...]) -> _Stencil:
    return _stencil(lambda r2: np.exp(-r2 / (2 * sigma**2)), math.ceil(5.4 * sigma), shape)


def _blue_sigma(share: float, shape: tuple[int, ...]) -> float:
    """Deviation for the share g of open or closed elements, whichever are fewer."""
    # With a sixth of the torus even two elements feel each other.
    return max(_SIGMA, min(_SPACINGS / math.sqrt(share), max(shape) / 6))


def _band_pass(frequency: float, shape: tuple[int, ...]) -> _Stencil:
    """w whose transform a·exp(−2π²σ₂²f²) − exp(−2π²σ₁²f²) is positive at f = 0 and has its minimum at `frequency`.

    Setting the derivative to zero gives σ₁² = ln(a·κ²)/(2π²·f²·(κ² − 1)) with κ = σ₂/σ₁.
    """
    a, kappa2 = _GREEN_REPULSION, _GREEN_WIDTHS**2
    narrow2 = math.log(a * kappa2) / (2 * (math.pi * frequency) ** 2 * (kappa2 - 1))
    wide2 = kappa2 * narrow2

    def profile(r2: np.ndarray) -> np.ndarray:
        return a / kappa2 * np.exp(-r2 / (2 * wide2)) - np.exp(-r2 / (2 * narrow2))

    return _stencil(profile, math.ceil(4 * math.sqrt(wide2)), shape)


def _shares(size: tuple[int, ...]) -> np.ndarray:
    """Elements of each shot of a complementary code."""
    shots, *shape = size
    return np.bincount(np.arange(math.prod(shape)) % shots, minlength=shots)


def _open_elements(transmittance: float, shape: tuple[int, ...]) -> int:
    if not 0 < transmittance <= 1:
        raise ValueError(f"transmittance must lie in (0, 1], got {transmittance}")
    n = math.prod(shape)
    opened = round(transmittance * n)
    if not opened:
        raise ValueError(f"transmittance {transmittance} opens none of {n} elements; use at least {1 / n:.2g}")
    return opened


def _opened(labels: np.ndarray, shots: int) -> np.ndarray:
    return (labels == np.arange(shots)[:, None, None]).astype(np.uint8)


def _spread_evenly(shots: int, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """Shot of every element, by filling the voids of the shots in turn and exchanging."""
    from . import _halftone_kernels as kernels

    n = math.prod(shape)
    stencil = _gaussian(_blue_sigma(1 / shots, shape), shape)
    labels = np.zeros(shape, np.int64)
    # As in `_choose`, a rank drawn at random in each key keeps them from being equal.
    keys = rng.permutation(n)
    trees = np.empty((shots, 2 * n), np.int64)
    for tree in trees:
        kernels.grow(tree, keys)
    kernels.fill(np.arange(n) % shots, labels, trees, n * stencil.weights, stencil.corner)
    _exchange(labels, shots, stencil, _neighbourhood(1 / shots), rng)
    return labels


def _blue_pattern(opened: int, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """(y, x) int64 pattern of 0 and 1 with so many open elements, by filling voids and exchanging."""
    n = math.prod(shape)
    few = min(opened, n - opened)
    pattern = np.zeros(shape, np.int64)
    if few:
        stencil = _gaussian(_blue_sigma(few / n, shape), shape)
        pattern.flat[_fill_voids(pattern, few, stencil, rng)] = 1
        _exchange(pattern, 2, stencil, _neighbourhood(few / n), rng)
    return pattern if few == opened else 1 - pattern


def _cluster_evenly(counts: np.ndarray, cluster: float, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """Class of every element, counts[q] elements of class q, by exchanges from a random start.

    Filling voids first is no help: one cluster after another would grow as a crystal does, in long bands.
    """
    labels = rng.permutation(np.repeat(np.arange(counts.size), counts)).reshape(shape)
    share = counts[-1] / labels.size
    if 0 < share < 1:
        frequency = math.sqrt(min(share, 1 - share) / cluster)
        _exchange(labels, counts.size, _band_pass(frequency, shape), math.ceil(0.7 / frequency), rng)
    return labels


def _neighbourhood(share: float) -> int:
    """How far away a partner of an exchange may be: one and a half mean spacings."""
    return max(3, math.ceil(1.5 / math.sqrt(share)))


def _exchange(labels: np.ndarray, classes: int, stencil: _Stencil, reach: int, rng: np.random.Generator) -> None:
    """Exchange elements of different classes, up to `reach` apart, until that lowers the energy no more."""
    from . import _halftone_kernels as kernels

    counts = np.bincount(labels.ravel(), minlength=classes)
    most = int(counts.argmax())
    fields = np.stack([_energy(labels == q, stencil) if q != most else np.zeros_like(labels) for q in range(classes)])
    # The energies of all classes add up to a constant.
    fields[most] = stencil.weights.sum() - fields.sum(axis=0)
    near = stencil.middle(reach)
    # Every exchange with a class that holds half of the elements is seen from the others.
    skip = most if 2 * counts[most] >= labels.size else -1
    for _ in range(_SWEEPS):
        order = rng.permutation(labels.size)
        # One band of rows after the other, so that the fields stay in cache: 5 times faster at 1024 × 1024.
        order = order[np.argsort(order // (_BAND * labels.shape[1]), kind="stable")]
        if not kernels.sweep(order, skip, labels, fields, near.weights, near.corner, stencil.weights, stencil.corner):
            return


def _energy(pattern: np.ndarray, stencil: _Stencil) -> np.ndarray:
    """(y, x) weights of all open elements, summed at every place; int64, in 1/_UNIT."""
    from . import _halftone_kernels as kernels

    field = np.zeros(pattern.shape, np.int64)
    kernels.add_open(pattern, field, stencil.weights, stencil.corner)
    return field


def _fill_voids(pattern: np.ndarray, count: int, stencil: _Stencil, rng: np.random.Generator) -> np.ndarray:
    """Closed places to open one after the other, each in the largest void."""
    return _choose(pattern == 0, _energy(pattern == 1, stencil), count, stencil, rng)


def _thin_out(pattern: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """All open places in the order in which to close them, each in the tightest cluster."""
    pattern = pattern.copy()
    left, places = int(pattern.sum()), [np.empty(0, np.int64)]
    while left:
        # The spacing grows as elements go, and the Gaussian with it.
        stencil = _gaussian(_blue_sigma(left / pattern.size, pattern.shape), pattern.shape)
        places.append(_choose(pattern == 1, -_energy(pattern == 1, stencil), -(-left // 2), stencil, rng))
        pattern.flat[places[-1]] = 0
        left //= 2
    return np.concatenate(places)


def _choose(
    free: np.ndarray, energy: np.ndarray, count: int, stencil: _Stencil, rng: np.random.Generator
) -> np.ndarray:
    """`count` free places one after the other, each with the smallest energy; each raises the energy around it."""
    from . import _halftone_kernels as kernels

    n = free.size
    # Energies are whole numbers: n times the energy plus a rank drawn at random is a key without ties.
    keys = np.where(free, n * energy + rng.permutation(n).reshape(free.shape), kernels.TAKEN)
    tree, places = np.empty(2 * n, np.int64), np.empty(count, np.int64)
    kernels.grow(tree, keys.ravel())
    kernels.take(places, tree, free.shape[1], n * stencil.weights, stencil.corner)
    return places
