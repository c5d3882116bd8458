"""Random, complementary (Boolean) and colored coded apertures.

Every pattern is uint8, 1 = open, 0 = closed, made by `numpy.random.default_rng(seed)`: the same seed gives the same code.
"""

from __future__ import annotations

import math

import numpy as np


def random(*, shots: int, shape: tuple[int, int], seed: int, transmittance: float = 0.5) -> np.ndarray:
    """Independent open and closed elements.

    Parameters
    ----------
    shots : number of snapshots Q.
    shape : (y, x) of the coded aperture, elements; an imager says it as `imager.code_shape`.
    seed : of the pattern.
    transmittance : share of open elements, in (0, 1].

    Returns
    -------
    (shot, y, x) uint8 array of 0 and 1.

    Raises
    ------
    ValueError
        If `shots`, `shape` or `transmittance` is out of range.

    Examples
    --------
    >>> import shadowgram as sg
    >>> sg.codes.random(shots=2, shape=(64, 64), seed=0).mean(axis=(1, 2)).round(1)
    array([0.5, 0.5])
    """
    size, rng = _checked_size(shots, shape, axes=2), _generator(seed)
    if not 0 < transmittance <= 1:
        raise ValueError(f"transmittance must lie in (0, 1], got {transmittance}")
    return (rng.random(size) < transmittance).astype(np.uint8)


def boolean(*, shots: int, shape: tuple[int, int], seed: int) -> np.ndarray:
    """Complementary code: every element is open in exactly one shot, so Σ_q t = 1 and each shot passes 1/Q.

    Parameters
    ----------
    shots : number of snapshots Q.
    shape : (y, x) of the coded aperture, elements.
    seed : of the pattern.

    Returns
    -------
    (shot, y, x) uint8 array of 0 and 1. The shots' numbers of open elements differ by one at most.

    Raises
    ------
    ValueError
        If `shots` or `shape` is out of range.

    Notes
    -----
    Source: Salazar (2022), eq. (2.29), "Boolean" structure.

    Examples
    --------
    >>> import shadowgram as sg
    >>> code = sg.codes.boolean(shots=3, shape=(8, 8), seed=0)
    >>> code.shape, bool((code.sum(axis=0) == 1).all())
    ((3, 8, 8), True)
    """
    return _one_open_shot(shots, _checked_size(shots, shape, axes=2)[1:], _generator(seed))


def colored(*, shots: int, shape: tuple[int, int, int], seed: int, filters: str = "ideal") -> np.ndarray:
    """Colored code: the transmittance of an element depends on the band.

    Parameters
    ----------
    shots : number of snapshots Q.
    shape : (band, y, x) of the coded aperture.
    seed : of the pattern.
    filters : ``"ideal"``: any filter can be made, and every voxel is open in exactly one shot (Σ_q t = 1, eq. 2.30);
        ``"four"``: each element of each shot is a low-pass, high-pass, band-pass or band-stop filter, and every voxel is open in
        at least one shot (Σ_q t ≥ 1, eq. 2.31). The low-pass filter opens the lower half of the bands and the band-pass filter
        the middle half; the other two are their complements. Two shots of every element, drawn at random, hold such a pair.

    Returns
    -------
    (shot, band, y, x) uint8 array of 0 and 1.

    Raises
    ------
    ValueError
        If a parameter is out of range, or four filters are asked to cover the spectrum in one shot.

    Notes
    -----
    Source: Salazar (2022), eqs. (2.30) and (2.31). Which cut-offs the four filters had is not said there.

    Examples
    --------
    >>> import shadowgram as sg
    >>> sg.codes.colored(shots=3, shape=(6, 8, 8), seed=0, filters="four").sum(axis=0).min() >= 1
    np.True_
    """
    size = _checked_size(shots, shape, axes=3)[1:]
    rng = _generator(seed)
    if filters == "ideal":
        return _one_open_shot(shots, size, rng)
    if filters != "four":
        raise ValueError(f'filters must be "ideal" or "four", got {filters!r}')
    if shots < 2:
        raise ValueError("four filters cannot pass every band in one shot; use at least 2 shots or filters='ideal'")
    bands, *pixels = size
    choice = rng.integers(4, size=(shots, *pixels))
    order = rng.permuted(np.broadcast_to(np.arange(shots)[:, None, None], choice.shape), axis=0)
    # Filters 2i and 2i + 1 are complements, so giving them to two shots of an element opens every band there.
    np.put_along_axis(choice, order[1:2], np.take_along_axis(choice, order[:1], axis=0) ^ 1, axis=0)
    return _four_filters(bands)[choice].transpose(0, 3, 1, 2).copy()


def check_code(code: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return `code` as an array with a leading shot axis, or say what is wrong with it.

    Parameters
    ----------
    code : (shot, ...), or one shot of `shape`; transmittance in [0, 1].
    shape : of one shot, as `imager.code_shape` says.

    Returns
    -------
    (shot, ...) array: uint8 if every element is open or closed, else float32.

    Raises
    ------
    ValueError
        If the shape or a value does not fit.

    Examples
    --------
    >>> from shadowgram.codes import check_code
    >>> check_code([[0, 1], [1, 0]], (2, 2)).shape
    (1, 2, 2)
    """
    code = np.asarray(code)
    if code.shape == shape:
        code = code[None]
    if code.ndim != len(shape) + 1 or code.shape[1:] != shape or not len(code):
        raise ValueError(f"the code must have the shape (shot, {', '.join(map(str, shape))}), got {code.shape}")
    if code.dtype.kind not in "fiub":
        raise ValueError(f"the code must hold transmittances in [0, 1], got values of type {code.dtype}")
    low, high = code.min(), code.max()
    if not (low >= 0 and high <= 1):
        hint = "; divide an 8-bit code by 255" if 1 < high <= 255 and low >= 0 else ""
        raise ValueError(f"transmittance must lie in [0, 1], got values from {low} to {high}{hint}")
    binary = code.dtype.kind in "iub" or bool(((code == 0) | (code == 1)).all())
    return np.ascontiguousarray(code, np.uint8 if binary else np.float32)


def _checked_size(shots: int, shape: tuple[int, ...], axes: int) -> tuple[int, ...]:
    if shots < 1:
        raise ValueError(f"a code needs at least one shot, got shots={shots}")
    if len(shape) != axes or min(shape) < 1:
        names = ("band", "y", "x")[-axes:]
        raise ValueError(f"the code's shape must be ({', '.join(names)}) with positive sizes, got {tuple(shape)}")
    return (int(shots), *(int(n) for n in shape))


def _generator(seed: int) -> np.random.Generator:
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise ValueError(f"seed must be a whole number of at least 0, got {seed!r}")
    return np.random.default_rng(seed)


def _one_open_shot(shots: int, size: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    open_in = rng.permutation(np.arange(math.prod(size)) % shots).reshape(size)
    return (open_in == np.arange(shots).reshape(-1, *[1] * len(size))).astype(np.uint8)


def _four_filters(bands: int) -> np.ndarray:
    """(filter, band): low-pass, high-pass, band-pass, band-stop."""
    place = (np.arange(bands) + 0.5) / bands
    low, middle = place < 0.5, np.abs(place - 0.5) < 0.25
    return np.stack([low, ~low, middle, ~middle]).astype(np.uint8)
