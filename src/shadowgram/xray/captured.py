"""From what a laboratory captures to codes and counts: block means of code images, thresholds, sums, drift, gain, slip.

`shadowgram.xray.capture_files` reads the files, `shadowgram.xray.permutation` tells whether there is a picture in the counts, and
`shadowgram.xray.reconstruct` makes it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._captured_drift import basis_of, criteria, explaining, slow_terms, without
from ._captured_registration import Slip as Slip
from ._captured_registration import slip as slip

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Capture:
    """Codes and counts of a scan that was measured.

    Attributes
    ----------
    codes : (shot, y, x) uint8, 1 = open.
    counts : (shot,) with the target, not negative.
    background : (shot,) without the target, in the same units; None if it was not taken.

    Raises
    ------
    ValueError
        If lengths do not fit together, a count is negative or not finite, or a code has no open cell.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.xray.captured import Capture
    >>> Capture(codes=np.ones((3, 4, 4), np.uint8), counts=np.array([5.0, 4.0, 6.0])).every(2).counts
    array([5., 6.])
    """

    codes: NDArray[np.uint8]
    counts: Floats
    background: Floats | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "codes", checked_codes(self.codes))
        shots = len(self.codes)
        object.__setattr__(self, "counts", checked_counts("counts", self.counts, shots))
        if self.background is not None:
            object.__setattr__(self, "background", checked_counts("background", self.background, shots))

    def every(self, step: int) -> Capture:
        """Every so manieth shot, from the first.

        Raises
        ------
        ValueError
            If `step` is not a whole number from 1 to the number of shots.
        """
        if not isinstance(step, int) or not 1 <= step <= len(self.codes):
            raise ValueError(f"every takes a whole number of shots, from 1 to {len(self.codes)}; got {step!r}")
        background = None if self.background is None else self.background[::step]
        return Capture(codes=self.codes[::step], counts=self.counts[::step], background=background)


def checked_codes(codes: ArrayLike) -> NDArray[np.uint8]:
    """Codes (shot, y, x) as 0 and 1.

    Raises
    ------
    ValueError
        If they have other axes or values, or a code has no open cell.
    """
    array = np.asarray(codes)
    if array.ndim != 3 or not array.size or array.dtype.kind not in "biuf":
        raise ValueError(f"codes are numbers (shot, y, x), got {array.dtype} of shape {array.shape}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise ValueError("codes must be 0 and 1, got values that are not finite")
    low, high = array.min(), array.max()
    opened = array == high
    if low < 0 or not (opened | (array == 0)).all():
        raise ValueError(
            f"codes must be 0 where closed and one value where open, got values from {low:g} to {high:g}; images of codes become"
            " such by block means and a threshold (block, --block)"
        )
    closed = np.flatnonzero(~array.any(axis=(1, 2)))
    if closed.size:
        raise ValueError(f"code {closed[0]} of {len(array)} has no open cell; leave its shot out of codes and counts")
    return opened.astype(np.uint8)


def checked_counts(name: str, values: ArrayLike, shots: int) -> Floats:
    """Counts (shot,) as float64.

    Raises
    ------
    ValueError
        If there is not one for each shot, or one is negative or not finite.
    """
    array = np.asarray(values)
    if array.dtype.kind not in "biuf" or array.ndim != 1:
        raise ValueError(f"{name} must be a number for each shot, got {array.dtype} of shape {array.shape}")
    if len(array) != shots:
        raise ValueError(f"there are {shots} codes and {len(array)} values of {name}; give one for each code")
    array = array.astype(np.float64)
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, got {array[~np.isfinite(array)][0]} in shot {_first(array)}")
    if (array < 0).any():
        raise ValueError(
            f"{name} cannot be negative, got {array.min():g} in shot {int(array.argmin())}; give the counts as they were measured,"
            " and the run without target as background"
        )
    return array


def _first(array: Floats) -> int:
    return int(np.flatnonzero(~np.isfinite(array))[0])


def block_means(images: ArrayLike, block: float | tuple[float, float]) -> Floats:
    """Mean over each block of detector pixels, such as those behind one cell of a mask.

    Parameters
    ----------
    images : (..., y, x).
    block : size in pixels, of a square or (y, x); not less than 1. Where it is no whole number, pixels on an edge count by the part
        of them that is inside. What is left over at the far edges is not used.

    Returns
    -------
    (..., y, x) float64

    Raises
    ------
    ValueError
        If a size is less than a pixel or more than the image.

    Examples
    --------
    >>> from shadowgram.xray.captured import block_means
    >>> block_means([[1, 3, 5, 7, 9]], (1, 2.5))
    array([[2.6, 7.4]])
    """
    array = np.asarray(images)
    if array.ndim < 2 or not array.size or array.dtype.kind not in "biuf":
        raise ValueError(f"images are numbers (..., y, x), got {array.dtype} of shape {array.shape}")
    sizes = block if isinstance(block, tuple) else (block, block)
    for size, pixels in zip(sizes, array.shape[-2:], strict=True):
        if not 1 <= size <= pixels:
            raise ValueError(f"a block has from 1 to {pixels} pixels a side in these images, got {size:g}")
    rows, columns = (_weights(pixels, size) for size, pixels in zip(sizes, array.shape[-2:], strict=True))
    return np.matmul(np.matmul(rows, array.astype(np.float64)), columns.T)


def _weights(pixels: int, size: float) -> Floats:
    """(block, pixel) share of each pixel in the mean of a block."""
    count = int(np.floor(pixels / size + 1e-9))
    start = size * np.arange(count)[:, None]
    pixel = np.arange(pixels)
    covered = np.minimum(start + size, pixel + 1) - np.maximum(start, pixel)
    return covered.clip(0, None) / size


def binary_codes(means: ArrayLike) -> NDArray[np.uint8]:
    """Codes from block means: a cell is open where it is brighter than the mean of all blocks of its shot.

    A flat illumination and codes that are about half open are taken for granted, as in the source (Salazar, 2022, section 4.9).

    Parameters
    ----------
    means : (shot, y, x).

    Returns
    -------
    (shot, y, x) uint8

    Raises
    ------
    ValueError
        If there is a shot without contrast.

    Examples
    --------
    >>> from shadowgram.xray.captured import binary_codes
    >>> binary_codes([[[9, 1], [2, 8]]]).tolist()
    [[[1, 0], [0, 1]]]
    """
    array = np.asarray(means, np.float64)
    if array.ndim != 3 or not array.size or not np.isfinite(array).all():
        raise ValueError(f"block means are finite numbers (shot, y, x), got shape {array.shape}")
    codes = array > array.mean(axis=(1, 2), keepdims=True)
    flat = np.flatnonzero(~codes.any(axis=(1, 2)))
    if flat.size:
        raise ValueError(f"the image of code {flat[0]} is the same everywhere, so no cell can be told to be open")
    return codes.astype(np.uint8)


def summed(images: ArrayLike, *, dark: ArrayLike | None = None, divisor: float = 1e3) -> Floats:
    """One number a shot from images of a detector with pixels, as if it were a single one.

    Parameters
    ----------
    images : (shot, y, x).
    dark : (y, x) what the detector reads without X-rays, to be taken from every image; None to take nothing.
    divisor : of the sums; 1000 in the source.

    Returns
    -------
    (shot,) float64

    Raises
    ------
    ValueError
        If shapes do not fit together or `divisor` is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.xray.captured import summed
    >>> summed(np.full((2, 10, 10), 30), dark=np.full((10, 10), 10))
    array([2., 2.])
    """
    array = np.asarray(images)
    if array.ndim != 3 or not array.size or array.dtype.kind not in "biuf":
        raise ValueError(f"images of the detector are numbers (shot, y, x), got {array.dtype} of shape {array.shape}")
    if not 0 < divisor < np.inf:
        raise ValueError(f"divisor must be positive, got {divisor!r}")
    total = array.sum(axis=(1, 2), dtype=np.float64)
    if dark is not None:
        level = np.asarray(dark, np.float64)
        if level.shape != array.shape[1:]:
            raise ValueError(f"the dark image must have the shape {array.shape[1:]} of the others, got {level.shape}")
        total -= level.sum()
    return total / divisor


def from_images(
    code_images: ArrayLike,
    images: ArrayLike,
    background_images: ArrayLike | None = None,
    *,
    block: float | tuple[float, float] = 7,
    dark: ArrayLike | None = None,
    divisor: float = 1e3,
) -> Capture:
    """A scan from the images of its codes and those of the detector: section 4.9 of the source.

    Parameters
    ----------
    code_images : (shot, y, x), by a detector in the place of the target.
    images, background_images : (shot, y, x) with and without the target, of any size.
    block : detector pixels a cell of the code, see `block_means`.
    dark, divisor : see `summed`.

    Raises
    ------
    ValueError
        As of the steps; or if there are not as many images as codes.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.xray.captured import from_images
    >>> codes = np.array([[[1, 0], [0, 1]], [[0, 1], [1, 0]]])
    >>> scan = from_images(200 * np.kron(codes, np.ones((7, 7))) + 30, np.full((2, 5, 5), 400.0))
    >>> scan.codes.tolist() == codes.tolist(), scan.counts
    (True, array([10., 10.]))
    """
    background = None if background_images is None else summed(background_images, dark=dark, divisor=divisor)
    return Capture(
        codes=binary_codes(block_means(code_images, block)),
        counts=summed(images, dark=dark, divisor=divisor),
        background=background,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Drift:
    """A slow change of counts over a scan.

    Attributes
    ----------
    values : (shot,) the change, 0 on average.
    order : of the polynomial.
    criteria : (order,) Bayesian information criterion of each order that was tried, relative to the smallest; None if the order
        was given.
    residual : standard deviation of what neither the drift nor open area and background explain.
    """

    values: Floats
    order: int
    criteria: Floats | None
    residual: float


def drift(
    codes: ArrayLike, counts: ArrayLike, background: ArrayLike | None = None, *, order: int | None = None
) -> Drift:
    """Fit a drift that is smooth in time, jointly with the open area of the codes and the run without target.

    Parameters
    ----------
    codes : (shot, y, x).
    counts, background : (shot,).
    order : of the Legendre polynomial in the number of the shot; by default from 0 to 12 where the Bayesian information criterion
        is least.

    Raises
    ------
    ValueError
        If codes and counts do not fit together, or `order` is not from 0 to half the number of shots.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.xray.captured import drift
    >>> rng = np.random.default_rng(0)
    >>> codes = rng.integers(0, 2, (64, 8, 8))
    >>> drift(codes, rng.poisson(1000 + 10.0 * np.arange(64))).order
    1
    """
    scan = _scan(codes, counts, background)
    others = explaining(scan.codes, scan.background)
    tried = None
    if order is None:
        tried = criteria(scan.counts, others)
        order = int(tried.argmin())
    check_order(order, len(scan.counts))
    slow = slow_terms(len(scan.counts), order)[:, 1:]
    terms = np.column_stack([np.ones(len(slow)), slow, others - others.mean(axis=0)])
    fitted = np.linalg.lstsq(terms, scan.counts, rcond=None)[0]
    values = slow @ fitted[1 : 1 + order]
    rest = without(scan.counts, basis_of(terms))
    left = max(len(slow) - terms.shape[1], 1)
    return Drift(
        values=values - values.mean(), order=order, criteria=tried, residual=float(np.sqrt(rest @ rest / left))
    )


def check_order(order: object, shots: int) -> None:
    """Raise a ValueError unless `order` is one of a drift."""
    if not isinstance(order, int | np.integer) or not 0 <= order <= shots // 2:
        raise ValueError(f"the order of a drift is a whole number from 0 to half the {shots} shots, got {order!r}")


@dataclass(frozen=True, kw_only=True)
class Gain:
    """By how much a run without target has to be multiplied to fit one with it.

    Attributes
    ----------
    value, standard_error : of the factor.
    """

    value: float
    standard_error: float


def background_gain(codes: ArrayLike, counts: ArrayLike, background: ArrayLike, *, order: int | None = None) -> Gain:
    """Fit the gain from what both runs do from shot to shot, with a drift and the open area of the codes beside it.

    A gain of 1 is the case of equal exposures and no dead time. A gain near 0 says that the runs share nothing but their drift, so
    that their difference, shot by shot, has more noise than the counts alone. Noise of the background pulls the value to 0.

    Parameters
    ----------
    codes, counts, background, order : see `drift`; the order is chosen without the background.

    Raises
    ------
    ValueError
        As of `drift`; or if nothing is left of the background beside its drift.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.xray.captured import background_gain
    >>> rng = np.random.default_rng(0)
    >>> codes = rng.integers(0, 2, (128, 8, 8))
    >>> air = rng.normal(1000, 50, 128)
    >>> gain = background_gain(codes, 0.9 * air + rng.normal(300, 5, 128), air)
    >>> abs(gain.value - 0.9) < 3 * gain.standard_error
    True
    """
    scan = _scan(codes, counts, background)
    assert scan.background is not None
    chosen = drift(codes, counts, order=order).order
    shots = len(scan.counts)
    basis = basis_of(np.column_stack([slow_terms(shots, chosen), explaining(scan.codes, None)]))
    y, b = without(scan.counts, basis), without(scan.background, basis)
    power = float(b @ b)
    if power <= 1e-20 * float(scan.background @ scan.background):
        raise ValueError(
            "the background does not change from shot to shot beside its drift, so its gain cannot be fitted"
        )
    value = float(b @ y) / power
    rest = y - value * b
    error = np.sqrt(float(rest @ rest) / max(shots - basis.shape[1] - 1, 1) / power)
    return Gain(value=value, standard_error=float(error))


def _scan(codes: ArrayLike, counts: ArrayLike, background: ArrayLike | None) -> Capture:
    return Capture(
        codes=np.asarray(codes),
        counts=np.asarray(counts),
        background=None if background is None else np.asarray(background),
    )
