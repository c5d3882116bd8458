"""What the channels of an ordinary colour picture read of each band."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .colour import _rgb_weights


def rgb_response(wavelengths: ArrayLike, *, illuminant: str = "D65") -> np.ndarray:
    """Weights of bands in the red, green and blue of a picture, for `shadowgram.operators.SpectralResponse`.

    Parameters
    ----------
    wavelengths : (band,) nm, rising or falling. Centres of the bands.
    illuminant : what a white surface looks like in the cube: "D65" for radiance under daylight, "equal-energy" for reflectances.

    Returns
    -------
    (3, band) float64
        Linear sRGB, without the transfer curve; some weights are negative, as of every camera whose colours were corrected.
        A white surface whose brightest band is 1 reads 1 in each channel.

    Raises
    ------
    ValueError
        If the wavelengths are not in order, or all invisible.

    Notes
    -----
    The weights are those of `to_rgb`, from the CIE 1931 2° colour-matching functions. A camera's own curves are better where they
    are known: its picture must not have been white-balanced, corrected or given a transfer curve by other means.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> weights = sg.scenes.rgb_response(np.linspace(450, 650, 12))
    >>> weights.shape, weights.argmax(axis=1)
    ((3, 12), array([9, 5, 0]))
    """
    nm = np.asarray(wavelengths, np.float64)
    steps = np.diff(nm)
    if nm.ndim != 1 or not nm.size or not np.isfinite(nm).all() or not ((steps > 0).all() or (steps < 0).all()):
        raise ValueError(f"rgb_response takes the wavelengths of the bands in nm, rising or falling, got {wavelengths}")
    falling = nm[0] > nm[-1]
    weights = _rgb_weights(nm[::-1] if falling else nm, illuminant)
    return weights[:, ::-1].copy() if falling else weights
