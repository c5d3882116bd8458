"""The compressive X-ray backscatter imager (CXBI): which cells of its target each shot lights, as a linear operator.

A mask T of N rows and N + Q − 1 columns slides one column a shot past a window of N × N cells. A shot counts all photons that come
back, y[q] = Σ_ij T[i, q + j] F[i, j], with F[i, j] the counts that cell (i, j) of the target gives while it is lit.

Source: Salazar (2022), eqs. (4.10) to (4.13).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from shadowgram.operators.base import LinearOperator


@dataclass(frozen=True, kw_only=True, eq=False)
class CXBI:
    """Geometry of a backscatter imager with a coded mask, in cells of the mask.

    Parameters
    ----------
    shape : (y, x) cells of the window, which are the pixels of the image.
    leakage : transmittance of closed cells, from 0 to below 1.
    penumbra : (y, x) full width in cells of the focal spot's shadow on the target, a uniform box; fractions are taken exactly.
        The window is framed, so that no light comes from cells beside it.
    sensitivity : (y, x) weights of the image, not negative, such as the mean counts of a uniform target by a Monte Carlo; None
        for 1 everywhere. The image is then in units of it.

    Raises
    ------
    ValueError
        If the geometry cannot be.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> mask = np.random.default_rng(0).random((32, 32 + 511)) < 0.1
    >>> imager = sg.CXBI(shape=(32, 32))
    >>> imager.operator(mask).out_shape, imager.operator(mask, step=4).out_shape
    ((512,), (128,))
    """

    shape: tuple[int, int]
    leakage: float = 0.0
    penumbra: tuple[float, float] = (0.0, 0.0)
    sensitivity: np.ndarray | None = None

    def __post_init__(self) -> None:
        _check_shape(self.shape)
        if not 0 <= self.leakage < 1:
            raise ValueError(f"leakage is the transmittance of closed cells, from 0 to below 1; got {self.leakage}")
        _check_penumbra(self.penumbra, self.shape)
        if self.sensitivity is not None:
            object.__setattr__(self, "sensitivity", _checked_sensitivity(self.sensitivity, self.shape))

    def operator(self, codes: ArrayLike, *, step: int = 1) -> LinearOperator:
        """Forward model, image (y, x) → counts (shot,).

        Parameters
        ----------
        codes : transmittances from 0 to 1: a sliding mask (y, x + shots − 1), whose first shot shows its first columns; or one code
            for each shot, (shot, y, x). Codes that are a sliding mask, by any number of columns a shot, are found to be one, and
            no matrix is stored.
        step : take every so manieth shot.

        Returns
        -------
        LinearOperator

        Raises
        ------
        ValueError
            If codes have another shape, values outside 0 to 1, or a shot without an open cell.

        Notes
        -----
        With leakage l a closed cell passes l and an open one 1. ``operators.as_matrix`` makes the sensing matrix (4.12).
        `shadowgram.ADMM` solves the normal equations of few rows exactly.

        Examples
        --------
        >>> import numpy as np, shadowgram as sg
        >>> mask = np.array([[1, 0, 0, 1], [0, 1, 0, 0]])
        >>> A = sg.CXBI(shape=(2, 2)).operator(mask)
        >>> A.forward(np.array([[1.0, 10.0], [100.0, 1000.0]]))
        array([1001.,  100.,   10.])
        """
        codes = _checked_codes(codes, self.shape)
        if not isinstance(step, int) or step < 1:
            raise ValueError(f"step takes every so manieth shot, a whole number of at least 1; got {step!r}")
        core = _core(codes, self.shape[1], step, self.leakage)
        blur = _box_weights(self.penumbra[0]), _box_weights(self.penumbra[1])
        if self.sensitivity is None and all(weights.size == 1 for weights in blur):
            return core
        from ._cxbi_operator import LightOperator

        return core @ LightOperator(self.shape, self.sensitivity, blur)


def sliding_step(codes: np.ndarray) -> int:
    """Columns by which each of several codes (shot, y, x) is shifted against the one before; 0 if they are no sliding mask.

    Positive where code[q + 1][:, j] = code[q][:, j + step], negative for the other direction. At least one column is shared.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.xray.cxbi import sliding_step
    >>> mask = np.random.default_rng(0).random((4, 20)) < 0.5
    >>> sliding_step(np.stack([mask[:, 2 * q : 2 * q + 8] for q in range(7)]))
    2
    """
    if len(codes) < 2:
        return 0
    columns = codes.shape[2]
    for step in range(1, columns):
        for earlier, later, sign in ((codes[:-1], codes[1:], 1), (codes[1:], codes[:-1], -1)):
            # The first pair decides nearly always, and it is cheap.
            if np.array_equal(earlier[0, :, step:], later[0, :, :-step]) and np.array_equal(
                earlier[:, :, step:], later[:, :, :-step]
            ):
                return sign * step
    return 0


def _core(codes: np.ndarray, columns: int, step: int, leakage: float) -> LinearOperator:
    """The operator of codes whose light is neither blurred nor weighted."""
    from ._cxbi_operator import ListOperator, ReversedOperator, SlidingOperator

    if codes.ndim == 2:
        _check_open_windows(codes, columns, step)
        shots = (codes.shape[1] - columns) // step + 1
        if step < columns:
            strip = codes[:, : (shots - 1) * step + columns]
            return SlidingOperator(_leaky(strip, leakage), columns, step)
        codes = np.stack([codes[:, q * step : q * step + columns] for q in range(shots)])
        return ListOperator(_leaky(codes, leakage))
    codes = codes[::step]
    _check_open_codes(codes)
    shift = sliding_step(codes)
    if shift == 0:
        return ListOperator(_leaky(codes, leakage))
    ordered = codes if shift > 0 else codes[::-1]
    sliding = SlidingOperator(_leaky(_strip(ordered, abs(shift)), leakage), columns, abs(shift))
    return sliding if shift > 0 else ReversedOperator(sliding)


def _strip(codes: np.ndarray, step: int) -> np.ndarray:
    """The mask of which sliding codes are windows."""
    rest = codes[1:, :, -step:].transpose(1, 0, 2).reshape(codes.shape[1], -1)
    return np.concatenate([codes[0], rest], axis=1)


def _leaky(codes: np.ndarray, leakage: float) -> np.ndarray:
    return np.ascontiguousarray(leakage + (1 - leakage) * codes.astype(np.float64))


def _box_weights(width: float) -> np.ndarray:
    """Weights by which neighbours light a cell, when a mask of cells is seen through a box of `width` cells.

    The share of the light of the cell k places away is (1/w) ∫ tri(k + s) ds over |s| ≤ w/2, tri(u) = max(0, 1 − |u|): a box for
    the mask's cell and one for the target's.
    """
    reach = math.ceil(width / 2) if width > 0 else 0
    if reach == 0:
        return np.ones(1)
    k = np.arange(-reach, reach + 1)
    weights = (_triangle_area(k + width / 2) - _triangle_area(k - width / 2)) / width
    return (weights + weights[::-1]) / 2


def _triangle_area(u: np.ndarray) -> np.ndarray:
    """∫ tri from −∞ to u."""
    v = np.clip(u, -1, 1)
    return 0.5 + v - np.sign(v) * v * v / 2


def _check_shape(shape: tuple[int, int]) -> None:
    whole = isinstance(shape, tuple) and len(shape) == 2 and all(isinstance(n, int) and n >= 1 for n in shape)
    if not whole:
        raise ValueError(f"shape is the cells in the window, (y, x), two whole numbers of at least 1; got {shape!r}")


def _check_penumbra(penumbra: tuple[float, float], shape: tuple[int, int]) -> None:
    pair = isinstance(penumbra, tuple) and len(penumbra) == 2
    if not (pair and all(0 <= width <= cells for width, cells in zip(penumbra, shape, strict=True))):
        raise ValueError(
            f"penumbra is the width of a shadow's edge, (y, x) in cells from 0 to the {shape} of the window; got {penumbra!r}"
        )


def _checked_sensitivity(sensitivity: ArrayLike, shape: tuple[int, int]) -> np.ndarray:
    weights = np.array(sensitivity, np.float64)
    if weights.shape != shape or not (np.isfinite(weights).all() and (weights >= 0).all() and weights.any()):
        raise ValueError(
            f"sensitivity must be {shape[0]} × {shape[1]} finite numbers that are not negative, and not all 0; got an array of"
            f" shape {weights.shape}"
        )
    weights.flags.writeable = False
    return weights


def _checked_codes(codes: ArrayLike, shape: tuple[int, int]) -> np.ndarray:
    """Codes (shot, y, x) or a mask (y, x + shots − 1), with transmittances from 0 to 1."""
    try:
        array = np.asarray(codes)
    except ValueError:
        raise ValueError("the codes of a scan must all have the same size") from None
    rows, columns = shape
    listed = array.ndim == 3 and array.shape[1:] == shape and len(array)
    sliding = array.ndim == 2 and array.shape[0] == rows and array.shape[1] >= columns
    if not (listed or sliding):
        raise ValueError(
            f"the codes of this imager are (shot, {rows}, {columns}), or one sliding mask of {rows} rows and {columns} columns or"
            f" more; got an array of shape {array.shape}"
        )
    if array.dtype.kind not in "fiub":
        raise ValueError(f"codes must hold transmittances from 0 to 1, got values of type {array.dtype}")
    low, high = array.min(), array.max()
    if not (low >= 0 and high <= 1):
        hint = "; divide 8-bit codes by 255" if 1 < high <= 255 and low >= 0 else ""
        raise ValueError(f"codes must hold transmittances from 0 to 1, got values from {low} to {high}{hint}")
    return array


def _check_open_codes(codes: np.ndarray) -> None:
    closed = np.flatnonzero(~codes.any(axis=(1, 2)))
    if closed.size:
        raise ValueError(
            f"code {closed[0]} of {len(codes)} has no open cell, so its shot measures nothing; leave it out"
        )


def _check_open_windows(mask: np.ndarray, columns: int, step: int) -> None:
    upto = np.concatenate([[0], np.cumsum(mask.any(axis=0))])
    open_columns = (upto[columns:] - upto[:-columns])[::step]
    closed = np.flatnonzero(open_columns == 0)
    if closed.size:
        raise ValueError(
            f"shot {closed[0]} of {len(open_columns)} sees no open cell of the sliding mask, so it measures nothing; use a mask"
            " with more holes or another step"
        )
