"""Where captures of a white scene lie on a known code: the model, and Gauss-Newton on position, stretch and blur.

A detector element m of band k sees the code over u from o[k] + m w to o[k] + (m + 1) w code columns, w = r(1−s), and rows from
r(n + dy) to r(n + 1 + dy). Detector columns and code columns are vectors over shots and rows here, (column, shot·y), with what is
smooth along y taken out: that leaves the mask and removes the lamp, and holds for a column whatever its neighbours do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from scipy.sparse import csr_array

HIGH_PASS = 17  # rows of the running mean that is taken out
FEWEST_COLUMNS = 4  # of a block that is fitted
LEAST_BLUR, MOST_BLUR = 0.02, 9.0  # variances, code elements squared: sharper or wider than any blur that can be told
FIRST_BLUR = 0.5  # wide enough to reach the pattern from where the search ends, up to a column away
ITERATIONS = 20
DAMPING = 0.8  # a step is too long where the blur of the model is not yet, or cannot be, that of the captures
SETTLED = 1e-3  # columns
SETTLED_BLUR = 0.02  # code elements


@dataclass(frozen=True, kw_only=True, eq=False)
class Placement:
    """Where the detector lies on the code.

    Attributes
    ----------
    mask_position : s.
    offsets : (band,) o, code columns; NaN where a band does not show the code.
    dy : detector rows.
    blur : (y, x) variances, code elements squared.
    """

    mask_position: float
    offsets: np.ndarray
    dy: float
    blur: tuple[float, float] = (FIRST_BLUR, FIRST_BLUR)


@dataclass(frozen=True, eq=False)
class Captures:
    """White captures and the code.

    Attributes
    ----------
    columns : (band, x, shot·y) float32, high-passed along y.
    code : (shot, y, x) float32.
    rows : of the detector.
    ratio : code elements per detector element.
    """

    columns: np.ndarray
    code: np.ndarray
    rows: int
    ratio: int


@dataclass(frozen=True, eq=False)
class Blocks:
    """What each block of detector columns, in each band, says about the placement; (block,) arrays.

    Attributes
    ----------
    band : index.
    group : index of the block among those of its band.
    centre : detector columns from the left edge.
    steps : (block, 4) by which x, dy, and the variances along y and x should grow.
    weight : 1/variance of the step in x, up to a common factor.
    energy, rest : of the high-passed captures, and what the code leaves unexplained.
    """

    band: np.ndarray
    group: np.ndarray
    centre: np.ndarray
    steps: np.ndarray
    weight: np.ndarray
    energy: np.ndarray
    rest: np.ndarray


def captures_of(white: np.ndarray, code: np.ndarray, ratio: int) -> Captures:
    """Captures (shot, band, y, x) as columns."""
    columns = np.stack([_columns(white[:, k]) for k in range(white.shape[1])])
    return Captures(columns, code.astype(np.float32), white.shape[2], ratio)


def _columns(images: np.ndarray) -> np.ndarray:
    """(x, shot·y) float32 of (shot, y, x), without what is smooth along y."""
    from scipy.ndimage import uniform_filter1d

    images = images.astype(np.float64)
    images -= uniform_filter1d(images, HIGH_PASS, axis=1, mode="nearest")
    return np.ascontiguousarray(images.reshape(-1, images.shape[2]).T, np.float32)


def overlap(x: np.ndarray, width: float, variance: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Share of a code element at distance x in a detector element `width` wide, through a Gaussian blur.

    Returns
    -------
    box(width) ∗ box(1) ∗ Gaussian at x over `width`, and its derivatives by the detector element's position and by the variance.
    """
    from scipy.special import erf

    sigma = math.sqrt(variance)
    corners = [x + c for c in ((width + 1) / 2, (width - 1) / 2, -(width - 1) / 2, -(width + 1) / 2)]
    density = [np.exp(-(z**2) / (2 * variance)) / (sigma * math.sqrt(2 * math.pi)) for z in corners]
    below = [(1 + erf(z / (sigma * math.sqrt(2)))) / 2 for z in corners]
    area = [z * p + variance * d for z, p, d in zip(corners, below, density, strict=True)]

    def differences(f: list[np.ndarray]) -> np.ndarray:
        return (f[0] - f[1] - f[2] + f[3]) / width

    # The blur grows by diffusion: the derivative by the variance is half the second derivative by x.
    return differences(area), -differences(below), differences(density) / 2


def overlap_matrices(middle: np.ndarray, width: float, variance: float, elements: int) -> list[csr_array]:
    """`overlap` of detector elements at `middle` (rows) with code elements 0, 1, … (columns); beside the code all is closed."""
    from scipy.sparse import csr_array

    reach = (width + 1) / 2 + 4 * math.sqrt(variance)
    first = np.ceil(middle - reach - 0.5).astype(np.int32)
    place = first[:, None] + np.arange(math.floor(2 * reach) + 1, dtype=np.int32)
    outside = (place < 0) | (place >= elements)
    column = np.clip(place, 0, elements - 1).ravel()
    starts = np.arange(len(middle) + 1) * place.shape[1]
    return [
        csr_array((np.where(outside, 0, w).astype(np.float32).ravel(), column, starts), shape=(len(middle), elements))
        for w in overlap(place + 0.5 - middle[:, None], width, variance)
    ]


def code_columns(captures: Captures, dy: float, variance: float) -> list[np.ndarray]:
    """Code columns as detector rows see them, (code column, shot·y), and their derivatives by dy and by the variance."""
    middle = captures.ratio * (np.arange(captures.rows) + 0.5 + dy)
    matrices = overlap_matrices(middle, captures.ratio, variance, captures.code.shape[1])
    seen, moved, blurred = (_columns(np.stack([m @ shot for shot in captures.code])) for m in matrices)
    return [seen, captures.ratio * moved, blurred]


# Fit: Gauss-Newton, block by block of detector columns, each with a gain of its own.


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """A placement, how well it is known, and how well the code explains each band.

    Attributes
    ----------
    placement : the best one.
    covariance : of the offsets of the bands `used` and of the mask position (last), code columns and 1.
    dy_error : detector rows.
    used : indices of bands.
    correlation : (band,) of captures and model; 0 for bands not used.
    """

    placement: Placement
    covariance: np.ndarray
    dy_error: float
    used: np.ndarray
    correlation: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class _Step:
    """One step of the iteration: what the blocks say at a placement, what they agree on, and where it leads."""

    blocks: Blocks
    used: np.ndarray
    agreed: np.ndarray
    covariance: np.ndarray
    change: np.ndarray
    settled: bool
    placement: Placement


def refine(captures: Captures, start: Placement) -> Fit:
    """Improve a placement until it settles."""
    last = _improve(captures, start)
    for _ in range(ITERATIONS):
        if last.settled:
            break
        last = _improve(captures, last.placement)
    blocks = last.blocks
    explained = np.zeros(len(captures.columns))
    for k in last.used:
        mine = blocks.band == k
        explained[k] = math.sqrt(max(0.0, 1 - blocks.rest[mine].sum() / blocks.energy[mine].sum()))
    return Fit(
        placement=last.placement,
        covariance=last.covariance + np.diag(last.agreed**2),  # as far as it still moves, it is not known
        dy_error=_mean_error(blocks.steps[:, 1] - last.change[1], blocks),
        used=last.used,
        correlation=explained,
    )


def _mean_error(deviations: np.ndarray, blocks: Blocks) -> float:
    """Standard error of the weighted mean; all bands see nearly the same columns of the code, so that they err together."""
    sums = np.bincount(blocks.group, blocks.weight * deviations)
    groups = len(np.unique(blocks.group))
    return math.sqrt(float(sums @ sums) * groups / max(1, groups - 1)) / float(blocks.weight.sum())


def _improve(captures: Captures, placement: Placement) -> _Step:
    blocks = measure_blocks(captures, placement)
    used, agreed, covariance = _agreement(blocks, captures.ratio)
    change = np.average(blocks.steps, axis=0, weights=blocks.weight)
    after = _moved(placement, used, DAMPING * agreed, DAMPING * change)
    columns = captures.ratio * captures.columns.shape[1]
    length = max(np.abs(agreed[:-1]).max(), abs(agreed[-1]) * columns, abs(change[1]) * captures.ratio)
    blur_settled = np.allclose(np.sqrt(after.blur), np.sqrt(placement.blur), atol=SETTLED_BLUR, rtol=0)
    return _Step(
        blocks=blocks,
        used=used,
        agreed=agreed,
        covariance=covariance,
        change=change,
        settled=bool(length < SETTLED and blur_settled),
        placement=after,
    )


def _moved(placement: Placement, used: np.ndarray, step: np.ndarray, change: np.ndarray) -> Placement:
    offsets = np.full_like(placement.offsets, np.nan)
    offsets[used] = placement.offsets[used] + step[:-1]
    blur = [
        min(max(old + new, old / 3, LEAST_BLUR), 3 * old, MOST_BLUR)
        for old, new in zip(placement.blur, change[2:], strict=True)
    ]
    return replace(
        placement,
        mask_position=placement.mask_position + float(step[-1]),
        offsets=offsets,
        dy=placement.dy + float(np.clip(change[1], -1, 1)),
        blur=(blur[0], blur[1]),
    )


def _agreement(blocks: Blocks, ratio: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Steps of the offsets and of s that explain those of the blocks, and their covariance by the scatter of the blocks."""
    used, row = np.unique(blocks.band, return_inverse=True)
    matrix = np.zeros((len(row), len(used) + 1))
    matrix[np.arange(len(row)), row] = 1
    matrix[:, -1] = -ratio * blocks.centre
    normal = (matrix * blocks.weight[:, None]).T @ matrix
    inverse = np.linalg.pinv(normal, hermitian=True)
    step = inverse @ (matrix.T @ (blocks.weight * blocks.steps[:, 0]))
    left = blocks.steps[:, 0] - matrix @ step
    spare = max(1, len(row) - len(step))
    return used, step, inverse * float((blocks.weight * left**2).sum() / spare)


def measure_blocks(captures: Captures, placement: Placement) -> Blocks:
    """Fit each block of columns of each band by itself, to first order."""
    patterns = code_columns(captures, placement.dy, placement.blur[0])
    elements = captures.columns.shape[1]
    groups = np.array_split(np.arange(elements), max(4, min(8, elements // 8)))
    width = captures.ratio * (1 - placement.mask_position)
    fits = []
    for k in np.flatnonzero(np.isfinite(placement.offsets)):
        left = placement.offsets[k] + width * np.arange(elements)
        inside = (left >= -0.5) & (left + width <= captures.code.shape[2] + 0.5)
        gram, product, energy = _inner_products(
            captures.columns[k], patterns, left + width / 2, width, placement.blur[1]
        )
        for number, group in enumerate(groups):
            lit = group[inside[group]]
            if len(lit) >= FEWEST_COLUMNS:
                fit = _fit_block(gram[lit].sum(axis=0), product[lit].sum(axis=0), float(energy[lit].sum()))
                fits += [(k, number, lit.mean() + 0.5, *fit)] if fit is not None else []
    if not fits:
        raise ValueError("the captures do not show this code: no part of any band agrees with it")
    table = np.array(fits, dtype=np.float64)
    band, number = table[:, :2].astype(np.int64).T
    return Blocks(band, number, table[:, 2], table[:, 3:7], table[:, 7], table[:, 8], table[:, 9])


def _inner_products(
    columns: np.ndarray, patterns: list[np.ndarray], middle: np.ndarray, width: float, variance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Per detector column: Gram matrix of the model and its four derivatives, their products with the capture, its energy."""
    seen, moved, blurred = patterns
    value, by_x, by_variance = overlap_matrices(middle, width, variance, len(seen))
    model = np.stack([value @ seen, by_x @ seen, value @ moved, value @ blurred, by_variance @ seen], axis=1)
    # Many small products: einsum's own loop, as BLAS would start its threads for each.
    gram = np.einsum("map,mbp->mab", model, model)
    return gram, np.einsum("map,mp->ma", model, columns), np.square(columns).sum(axis=1)


def _fit_block(gram: np.ndarray, product: np.ndarray, energy: float) -> tuple[float, ...] | None:
    """(steps in x, dy, variance along y and x; weight, energy, rest), or None for a block that does not show the code."""
    gram, product = gram.astype(np.float64), product.astype(np.float64)
    if not (gram[0, 0] > 0 and product[0] > 0):
        return None
    # Place and blur apart, which hardly know of each other: together they could swap a wrong place for a negative blur.
    place, inverse = _least_squares(gram, product, [0, 1, 2])
    blur, _ = _least_squares(gram, product, [0, 3, 4])
    rest = max(energy - float(product[:3] @ place), 0.0)
    if not (min(place[0], blur[0]) > 0 and rest < 0.98 * energy):
        return None
    steps = np.concatenate([np.clip(place[1:] / place[0], -1, 1), blur[1:] / blur[0]])
    weight = place[0] ** 2 / (inverse[1, 1] * (rest + 1e-3 * energy))
    return *(float(v) for v in steps), float(weight), energy, rest


def _least_squares(gram: np.ndarray, product: np.ndarray, terms: list[int]) -> tuple[np.ndarray, np.ndarray]:
    gram = gram[np.ix_(terms, terms)]
    # A ridge in units of each keeps a direction that does not show from running away.
    inverse = np.linalg.inv(gram + np.diag(1e-6 * np.diag(gram) + np.finfo(float).tiny))
    return inverse @ product[terms], inverse
