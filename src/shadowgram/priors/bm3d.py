"""Block matching and 3-D filtering, BM3D."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike

from shadowgram._threads import run_chunks

from ._bm3d_transforms import SIDE, biorthogonal, cosine, noise_covariances
from .denoiser import checked_image, checked_sigma

Profile = Literal["normal", "fast"]

_THRESHOLD = 2.7  # λ of the paper, in standard deviations of a coefficient
_WINDOW_SHAPE = 2.0  # β of the Kaiser window
_MARGIN = SIDE - 1  # pixels that an image has more than positions of blocks
_MIRRORED = 4  # pixels of the mirror image beyond each edge, so that many blocks cover what is at the edge
_FEW = 4096  # positions; in images that have no more, groups overlap more
_TILE = 120  # pixels from the first reference block to the last: the kernels' span of columns leaves room for no more
_NEGLIGIBLE = 1e-7  # a standard deviation of so small a share of the image's range is below float32


class _Settings(NamedTuple):
    """One stage: its transform, step between reference blocks, how far blocks are searched, how many make a group, which are alike.

    Alike are blocks whose mean squared difference is below near·σ² + far·σ·(standard deviation of the image).
    """

    transform: Callable[[], np.ndarray]
    step: int
    reach: int
    most: int
    near: float
    far: float


_PROFILES = {
    "normal": (_Settings(biorthogonal, 3, 19, 16, 2.5, 0.7), _Settings(cosine, 3, 19, 32, 0.0, 0.3)),
    "fast": (_Settings(biorthogonal, 6, 12, 16, 2.5, 0.7), _Settings(cosine, 5, 12, 16, 0.0, 0.3)),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class BM3D:
    """Denoise by block matching and 3-D filtering, called as ``BM3D()(image, sigma)``.

    Blocks of 8×8 pixels that look alike are stacked; in a 3-D transform of the stack the image is sparse and the noise is not. A
    first stage thresholds the coefficients, a second one applies the Wiener filter that the first estimate gives. It commutes with
    a change of units and of the zero: ``BM3D()(a * x + b, a * sigma)`` is ``a * BM3D()(x, sigma) + b``, up to rounding.

    Parameters
    ----------
    profile : ``"normal"``, or ``"fast"`` with fewer and smaller groups.
    spectrum : power spectral density of coloured noise, (y, x) as `numpy.fft.fft2` orders frequencies, for images of that shape;
        only its shape counts, since `sigma` is the standard deviation of all noise at a pixel. None for white noise.

    Raises
    ------
    ValueError
        If the profile is not known, or the spectrum is not 2-D, not finite, negative or zero everywhere.

    Notes
    -----
    From Dabov, Foi, Katkovnik and Egiazarian, IEEE Trans. Image Process. 16, 2080 (2007). Departures: how alike blocks must be goes
    with σ and the contrast of the image, not with the range of 8 bits, and the mean of a group is not filtered, so that it commutes
    with changes of units; blocks are matched without a filter before at any σ; the image is continued by 4 pixels of its mirror
    image; reference blocks include the last row and column, and lie two pixels apart where there are at most 64² positions. In
    coloured noise each coefficient of a group has its own variance, exactly, as Mäkinen, Azzari and Foi, IEEE Trans. Image Process.
    29, 8339 (2020), propose; the rest of what they do is left out.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> clean = np.kron(np.eye(4), np.ones((8, 8)))
    >>> noisy = clean + 0.2 * np.random.default_rng(0).standard_normal(clean.shape)
    >>> bool(np.abs(sg.priors.BM3D()(noisy, 0.2) - clean).mean() < 0.3 * np.abs(noisy - clean).mean())
    True
    """

    profile: Profile = "normal"
    spectrum: np.ndarray | None = None

    def __post_init__(self) -> None:
        if self.profile not in get_args(Profile):
            raise ValueError(f"the profile of BM3D is one of {', '.join(get_args(Profile))}, got {self.profile!r}")
        if self.spectrum is not None:
            object.__setattr__(self, "spectrum", _checked_spectrum(self.spectrum))

    def __call__(self, image: ArrayLike, sigma: float, /) -> np.ndarray:
        """Remove noise from an image.

        Parameters
        ----------
        image : (y, x), at least 8×8 pixels.
        sigma : standard deviation of the noise, in the units of the image; 0 gives the image back.

        Returns
        -------
        ndarray
            float32 of the shape of the image.

        Raises
        ------
        TypeError
            If the image or sigma is not real numbers.
        ValueError
            If they are not finite, the image is not 2-D, too small or not of the spectrum's shape, or sigma is negative.
        """
        noisy, scale = checked_image("BM3D", image), float(checked_sigma("BM3D", sigma))
        if self.spectrum is not None and self.spectrum.shape != noisy.shape:
            raise ValueError(f"BM3D: the image has the shape {noisy.shape}, but its spectrum {self.spectrum.shape}")
        low, high = float(noisy.min()), float(noisy.max())
        if scale <= _NEGLIGIBLE * (high - low):
            return noisy.copy()
        zero = 0.5 * (low + high)
        reduced = np.pad((noisy.astype(np.float64) - zero) / scale, _MIRRORED, "symmetric").astype(np.float32)
        first, second = _PROFILES[self.profile]
        pilot = _stage(reduced, None, first, self.spectrum)
        estimate = _stage(reduced, pilot, second, self.spectrum)
        inner = slice(_MIRRORED, -_MIRRORED)
        return (estimate[inner, inner].astype(np.float64) * scale + zero).astype(np.float32)


def _checked_spectrum(spectrum: ArrayLike) -> np.ndarray:
    values = np.asarray(spectrum)
    if values.ndim != 2 or values.dtype.kind not in "fiu":
        raise ValueError(f"the spectrum of BM3D is real numbers (y, x), got {values.dtype} of shape {values.shape}")
    if not (np.isfinite(values).all() and values.min() >= 0 and values.max() > 0):
        raise ValueError(
            "the spectrum of BM3D is a power spectral density: finite, nowhere negative, somewhere positive"
        )
    return values.astype(np.float64)


class _Plan(NamedTuple):
    """What the tiles of a stage share."""

    noisy: np.ndarray
    pilot: np.ndarray | None
    guide: np.ndarray
    settings: _Settings
    farthest: int
    covariances: np.ndarray | None


class _Tile(NamedTuple):
    """Positions of reference blocks, and the positions (rows, columns) that their groups reach."""

    ys: np.ndarray
    xs: np.ndarray
    rows: range
    columns: range

    @property
    def pixels(self) -> tuple[slice, slice]:
        """Pixels of the blocks at all positions."""
        return slice(self.rows.start, self.rows.stop + _MARGIN), slice(self.columns.start, self.columns.stop + _MARGIN)


def _stage(noisy: np.ndarray, pilot: np.ndarray | None, settings: _Settings, spectrum: np.ndarray | None) -> np.ndarray:
    """Estimate of one stage, from images in standard deviations of the noise."""
    positions = (noisy.shape[0] - _MARGIN, noisy.shape[1] - _MARGIN)
    if positions[0] * positions[1] <= _FEW:
        settings = settings._replace(step=min(settings.step, 2))
    plan = _plan(noisy, pilot, settings, spectrum)
    tiles = list(_tiles(positions, settings))
    results: list[tuple[np.ndarray, np.ndarray]] = [(noisy, noisy)] * len(tiles)
    run_chunks(_filter_tiles, len(tiles), 1, plan, tiles, results)
    total, weight = np.zeros_like(noisy), np.zeros_like(noisy)
    for tile, (numerator, denominator) in zip(tiles, results, strict=True):
        total[tile.pixels] += numerator
        weight[tile.pixels] += denominator
    return total / weight


def _plan(noisy: np.ndarray, pilot: np.ndarray | None, settings: _Settings, spectrum: np.ndarray | None) -> _Plan:
    from ._bm3d_kernels import OUTSIDE, SIZE, SPAN

    height, width = noisy.shape
    guide = np.full((height, width + 2 * settings.reach + SPAN), OUTSIDE)
    guide[:, settings.reach : settings.reach + width] = noisy if pilot is None else pilot
    farthest = SIZE * (settings.near + settings.far * noisy.std(dtype=np.float64))
    covariances = None if spectrum is None else noise_covariances(settings.transform(), spectrum, settings.reach)
    return _Plan(
        noisy=noisy, pilot=pilot, guide=guide, settings=settings,
        farthest=max(1, int(np.float32(farthest).view(np.int32))),  # at least 1: a block is like itself
        covariances=covariances,
    )  # fmt: skip


@cache
def _window() -> np.ndarray:
    return np.kaiser(SIDE, _WINDOW_SHAPE).astype(np.float32)


@cache
def _matrices(transform: Callable[[], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """A transform, and the window times its inverse, flat float32."""
    inverse = _window()[:, None] * np.linalg.inv(transform())
    return transform().astype(np.float32).ravel(), inverse.astype(np.float32).ravel()


@cache
def _steps(reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Displacements down and across of at most `reach`, the shortest first: where distances are equal, the nearer block counts."""
    down, across = (axis.ravel() for axis in np.mgrid[-reach : reach + 1, -reach : reach + 1])
    order = np.argsort(down**2 + across**2, kind="stable")
    return down[order], across[order]


def _tiles(positions: tuple[int, int], settings: _Settings) -> Iterator[_Tile]:
    """Share reference blocks, of which the last row and column has some, among tiles, whatever the number of threads."""
    rows, columns = (_parts(count, settings.step) for count in positions)
    for ys in rows:
        for xs in columns:
            reached = (
                range(max(0, int(at[0]) - settings.reach), min(count, int(at[-1]) + settings.reach + 1))
                for at, count in zip((ys, xs), positions, strict=True)
            )
            yield _Tile(ys, xs, *reached)


def _parts(count: int, step: int) -> list[np.ndarray]:
    places = np.unique(np.append(np.arange(0, count, step), count - 1))
    most = _TILE // step + 1
    edges = np.linspace(0, places.size, -(-places.size // most) + 1).astype(int)
    return [places[a:b] for a, b in pairwise(edges)]


def _filter_tiles(
    start: int, stop: int, plan: _Plan, tiles: list[_Tile], results: list[tuple[np.ndarray, np.ndarray]]
) -> None:
    for i in range(start, stop):
        results[i] = _filter_tile(plan, tiles[i])


def _filter_tile(plan: _Plan, tile: _Tile) -> tuple[np.ndarray, np.ndarray]:
    """Weighted sum of the filtered blocks of a tile, and the sum of the weights, at its pixels."""
    from . import _bm3d_kernels as kernels

    count, most = len(tile.rows) * len(tile.columns), plan.settings.most
    noisy = _coefficients(plan, tile, plan.noisy)
    pilot = np.empty(0, np.float32) if plan.pilot is None else _coefficients(plan, tile, plan.pilot)
    places, counts = _groups(plan, tile)
    if plan.covariances is None:
        variances = np.ones(most * kernels.SIZE, np.float32)
    else:
        variances = np.empty(places.size * kernels.SIZE, np.float32)
        square = np.empty(most * most * kernels.SIZE, np.float32)
        kernels.group_variances(places, counts, len(tile.columns), plan.covariances, square, variances)
    sums, weights = np.zeros(count * kernels.SIZE, np.float32), np.zeros(count, np.float32)
    group = np.empty(most * kernels.SIZE, np.float32)
    other = np.empty(group.size if pilot.size else 0, np.float32)
    kernels.filter_groups(places, counts, noisy, pilot, variances, np.float32(_THRESHOLD), group, other, sums, weights)
    return _image(plan, tile, sums), _spread(weights.reshape(len(tile.rows), -1), _window())


def _sizes(tile: _Tile) -> tuple[np.uint64, ...]:
    """Sizes that the transforms take: 1, items of a pixel in rows of coefficients, positions down and across, rows, columns."""
    height, width = len(tile.rows), len(tile.columns)
    return tuple(np.uint64(n) for n in (1, SIDE, height, width, height + _MARGIN, width + _MARGIN))


def _coefficients(plan: _Plan, tile: _Tile, image: np.ndarray) -> np.ndarray:
    """Coefficients of the blocks at all positions of a tile, flat (p, c)."""
    from . import _bm3d_kernels as kernels

    one, items, height, width, rows, columns = _sizes(tile)
    matrix, _ = _matrices(plan.settings.transform)
    planes = np.empty(items * width * items, np.float32)
    along_x = np.empty(rows * width * items, np.float32)
    kernels.analyse(matrix, image[tile.pixels].ravel(), columns, one, rows, width, one, planes, along_x)
    out = np.empty(height * width * items * items, np.float32)
    kernels.analyse(matrix, along_x, width * items, width * items, height, width, items, planes, out)
    return out


def _image(plan: _Plan, tile: _Tile, sums: np.ndarray) -> np.ndarray:
    """Sum of the windowed blocks of the coefficients `sums` (p, c)."""
    from . import _bm3d_kernels as kernels

    one, items, height, width, rows, columns = _sizes(tile)
    _, inverse = _matrices(plan.settings.transform)
    planes = np.empty(items * width * items, np.float32)
    along_x = np.zeros(rows * width * items, np.float32)
    kernels.synthesise(inverse, sums, width * items, width * items, height, width, items, planes, along_x)
    out = np.zeros(rows * columns, np.float32)
    kernels.synthesise(inverse, along_x, columns, one, rows, width, one, planes, out)
    return out.reshape(rows, columns)


def _spread(weights: np.ndarray, window: np.ndarray) -> np.ndarray:
    """Sum of windows that begin at each position, times its weight."""
    height, width = weights.shape
    rows = np.zeros((height + _MARGIN, width), np.float32)
    for i in range(SIDE):
        rows[i : i + height] += window[i] * weights
    out = np.zeros((height + _MARGIN, width + _MARGIN), np.float32)
    for i in range(SIDE):
        out[:, i : i + width] += window[i] * rows
    return out


def _groups(plan: _Plan, tile: _Tile) -> tuple[np.ndarray, np.ndarray]:
    """Positions (group, k), flat, of the blocks most like each reference block, and how many of them make its group."""
    from . import _bm3d_kernels as kernels

    ys, xs, settings = tile.ys, tile.xs, plan.settings
    down, across = _steps(settings.reach)
    keys = np.empty((ys.size, xs.size, settings.most), np.int64)
    span = -(-int(xs[-1] - xs[0] + SIDE) // 32) * 32  # a whole number of vectors
    found = np.empty(span, np.float32)
    kernels.match(
        plan.guide.ravel(), plan.guide.shape[1], ys, xs[0] + settings.reach, xs - xs[0], down, across, plan.noisy.shape[0] - SIDE,
        plan.farthest, settings.most, span, np.zeros(span + SIDE, np.float32), found, found.view(np.int32),
        np.empty(xs.size, np.int64), keys.ravel(),
    )  # fmt: skip
    there = keys != kernels.NONE
    steps = np.where(there, keys & 0xFFFFFFFF, 0)
    here = (ys[:, None] - tile.rows.start) * len(tile.columns) + xs - tile.columns.start
    places = here[..., None] + (down * len(tile.columns) + across)[steps]
    counts = 2 ** np.log2(there.sum(2)).astype(np.int64)
    return places.ravel(), counts.ravel()
