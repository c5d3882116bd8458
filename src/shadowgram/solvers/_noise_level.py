"""The noise of coded snapshots, estimated from the snapshots themselves."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np

from shadowgram.operators.base import LinearOperator

_WINDOWS = 1500
# The share of windows that are taken to be flat. Few, because texture looks like noise; the chi-square factor undoes the choice.
_FLATTEST = 0.05


def noise_level(H: LinearOperator, y: np.ndarray) -> float:
    """Standard deviation of the noise in `y`, from the windows in which the scene is flattest.

    Where the scene has one spectrum over a small window, the snapshots there are that spectrum times what each band lets
    through, which `H` says when it is shown one band at a time. What least squares over the window leaves is noise, plus
    whatever texture the flattest windows have: about 5 % too much at 20 dB, and not quite zero without noise.

    Parameters
    ----------
    H : the imager's operator, (band, y, x) → (shot, y, x).
    y : (shot, y, x) snapshots.

    Returns
    -------
    float
        In the units of `y`; 0 where the detector is too small for a window, or dark.
    """
    bands, (shots, rows, columns) = H.in_shape[0], y.shape
    side = 3
    while side * side * shots < 2.5 * bands:
        side += 1
    if side > min(rows, columns):
        return 0.0
    top, left = np.meshgrid(np.arange(0, rows - side + 1, side), np.arange(0, columns - side + 1, side), indexing="ij")
    affordable = 2 * math.prod(H.in_shape) // (side * side * shots * bands)  # two cubes of memory
    chosen = np.linspace(0, top.size - 1, min(top.size, _WINDOWS, max(affordable, 100))).astype(int)
    dy, dx = np.mgrid[:side, :side]
    window = np.s_[:, top.ravel()[chosen, None] + dy.ravel(), left.ravel()[chosen, None] + dx.ravel()]

    def cut(snapshots: np.ndarray) -> np.ndarray:
        return snapshots[window].swapaxes(0, 1).reshape(chosen.size, -1)

    seen = np.empty((chosen.size, shots * side * side, bands), y.dtype)
    one_band = np.zeros(H.in_shape, y.dtype)
    for k in range(bands):
        one_band[k] = 1
        seen[:, :, k] = cut(H.forward(one_band))
        one_band[k] = 0
    values = cut(y)
    gram = (seen.swapaxes(1, 2) @ seen).astype(np.float64)
    light = np.trace(gram, axis1=1, axis2=2) / bands
    if light.max() == 0:
        return 0.0
    gram += (
        1e-6 * light.max() * np.eye(bands)
    )  # codes that do not tell two bands apart, and dark windows, stay solvable
    spectra = np.linalg.solve(gram, (values[:, None, :] @ seen).swapaxes(1, 2).astype(np.float64))
    rest = values - (seen @ spectra.astype(y.dtype))[:, :, 0]
    freedom = seen.shape[1] - bands
    variances = np.square(rest[light > 1e-3 * light.max()], dtype=np.float64).sum(axis=1) / freedom
    # Wilson & Hilferty (1931): the quantile of a chi-square variable over its degrees of freedom.
    spread = 2 / (9 * freedom)
    factor = (1 - spread + NormalDist().inv_cdf(_FLATTEST) * spread**0.5) ** 3
    return float(np.sqrt(np.quantile(variances, _FLATTEST) / factor))
