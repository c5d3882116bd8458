"""What a denoiser is: a callable ``(image, sigma) → image``, for plug-and-play reconstruction and for anyone else."""

from __future__ import annotations

import importlib
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

LEAST_SIDE = 8  # pixels

_SHIPPED = {"bm3d": ("bm3d", "BM3D"), "ffdnet": ("ffdnet", "FFDNet"), "tv": ("tv_denoiser", "TVDenoiser")}


class Denoiser(Protocol):
    """Remove white Gaussian noise of standard deviation `sigma` from an image (y, x), both in the units of the image.

    Deterministic, without state; the result is float32, of the shape of the image, and finite.
    """

    def __call__(self, image: np.ndarray, sigma: float, /) -> np.ndarray:
        """Denoise one image."""
        ...


def get(name: str) -> Denoiser:
    """Give a denoiser that ships with the package, with its default settings.

    Parameters
    ----------
    name : ``"bm3d"``, ``"ffdnet"`` or ``"tv"``; for other settings see `BM3D`, `FFDNet` and `TVDenoiser`.

    Returns
    -------
    callable
        ``(image, sigma) → image``: image (y, x) of at least 8×8 pixels, `sigma` in its units; the result is float32.

    Raises
    ------
    ValueError
        If there is no denoiser of that name.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> clean = np.kron(np.eye(4), np.ones((8, 8)))
    >>> noisy = clean + 0.2 * np.random.default_rng(0).standard_normal(clean.shape)
    >>> bool(np.abs(sg.priors.get("tv")(noisy, 0.2) - clean).mean() < 0.5 * np.abs(noisy - clean).mean())
    True
    """
    if name not in _SHIPPED:
        raise ValueError(f"there is no denoiser {name!r}: the names are {', '.join(map(repr, _SHIPPED))}")
    module, kind = _SHIPPED[name]
    return getattr(importlib.import_module(f".{module}", __package__), kind)()


def checked_image(name: str, image: ArrayLike) -> np.ndarray:
    """Give an image as a contiguous float32 array, once it is known to be one.

    Raises
    ------
    TypeError
        If it is not real numbers.
    ValueError
        If it is not (y, x) of at least 8×8 pixels, or holds values that are not finite.
    """
    values = np.asarray(image)
    if values.dtype.kind not in "fiub":
        raise TypeError(f"{name} takes real numbers, got an array of {values.dtype}")
    if values.ndim != 2 or min(values.shape) < LEAST_SIDE:
        raise ValueError(
            f"{name} takes an image (y, x) of at least {LEAST_SIDE}×{LEAST_SIDE} pixels, got {values.shape}"
        )
    if not np.isfinite(values).all():
        raise ValueError(f"{name} takes finite values, got NaN or infinite ones; replace them first")
    with np.errstate(over="ignore"):
        single = np.ascontiguousarray(values, np.float32)
    if not np.isfinite(single).all():
        raise ValueError(f"{name} works in float32, got values up to {np.abs(values).max():.3g}; scale the image first")
    return single


def checked_sigma(name: str, sigma: ArrayLike, shape: tuple[int, int] | None = None) -> np.ndarray:
    """Give a standard deviation as float32: one number, (), or with `shape` (y, x) also a map of that shape.

    Raises
    ------
    TypeError
        If it is not real numbers.
    ValueError
        If it is negative, not finite, or neither a number nor of that shape.
    """
    values = np.asarray(sigma)
    if values.dtype.kind not in "fiu":
        raise TypeError(f"{name}: sigma is a standard deviation in the image's units, got {sigma!r}")
    if values.shape not in ((), shape):
        wanted = "one number" if shape is None else f"one number or a map of the image's shape {shape}"
        raise ValueError(f"{name}: sigma is {wanted}, got an array of shape {values.shape}")
    if not (np.isfinite(values).all() and (values >= 0).all()):
        raise ValueError(f"{name}: sigma is a standard deviation of 0 or more, got {values.min():.4g}")
    return values.astype(np.float32)
