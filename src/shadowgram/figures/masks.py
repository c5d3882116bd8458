"""Codes as pictures for printers and projectors: one bit a pixel, and for printers the size of a pixel."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

_METRES_AN_INCH = 0.0254
_MOST = 2**31 - 1  # pixels a metre that a PNG can say


def mask_png(shot: np.ndarray, *, pitch: float, pixels: int = 1) -> bytes:
    """PNG file of one shot of a binary code, open elements white, with its true size.

    Parameters
    ----------
    shot : (y, x) bool, True = open.
    pitch : side of an element, µm.
    pixels : along a side of an element.

    Returns
    -------
    bytes
        The file. It keeps whole numbers of pixels a metre: if 10⁶ `pixels`/`pitch` is none, it is off by half a pixel in a
        metre at most.

    Raises
    ------
    ValueError
        If `pitch` or `pixels` is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.figures.masks import mask_png
    >>> mask_png(np.eye(8, dtype=bool), pitch=20.0)[1:4]
    b'PNG'
    """
    if not (isinstance(pixels, int | np.integer) and pixels >= 1):
        raise ValueError(f"pixels must be a whole number of at least 1, got {pixels!r}")
    if not (pitch > 0 and 1 <= 1e6 * pixels / pitch <= _MOST):
        raise ValueError(
            f"pitch must be a positive length in µm, from {1e6 * pixels / _MOST:.2g} to {1e6 * pixels:g} that a PNG "
            f"with {pixels} pixels an element can say, got {pitch}"
        )
    resolution = round(1e6 * pixels / pitch) * _METRES_AN_INCH
    picture = np.asarray(shot, dtype=bool).repeat(pixels, axis=0).repeat(pixels, axis=1)
    return _png(picture, (resolution, resolution))


def frame_png(frame: np.ndarray) -> bytes:
    """PNG file of one frame of a micromirror device, a pixel a mirror, mirrors that are on white.

    Parameters
    ----------
    frame : (y, x) bool, True = on, as of `shadowgram.codes.layout.dmd_frames`.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.figures.masks import frame_png
    >>> frame_png(np.ones((1080, 1920), dtype=bool))[1:4]
    b'PNG'
    """
    return _png(np.asarray(frame, dtype=bool), None)


def _png(picture: np.ndarray, dpi: tuple[float, float] | None) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, format="png", **({} if dpi is None else {"dpi": dpi}))
    return buffer.getvalue()
