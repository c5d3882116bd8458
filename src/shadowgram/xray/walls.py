"""What a mask of thick holes lets through, seen from a point: closed neighbours shade the light that is askew."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def through_walls(codes: ArrayLike, slope: float) -> NDArray[np.float64]:
    """Transmittances of the cells of a thick mask.

    A ray through cell i at distance |i − c| from the axis moves by slope · |i − c| cells between the faces of the mask, away from
    the axis. That share of the cell's light leaves through the neighbour farther out, and passes if this is open too.

    Parameters
    ----------
    codes : (shot, y, x) transmittances from 0 to 1; the source is before the middle of the window. What is beside it is closed.
    slope : depth of the holes over the distance from the source.

    Returns
    -------
    (shot, y, x) float64

    Raises
    ------
    ValueError
        If codes are not (shot, y, x), or light at the edge moves by more than a cell.

    Examples
    --------
    >>> from shadowgram.xray.walls import through_walls
    >>> through_walls([[[1, 0, 1, 1, 1]]], 0.1)[0, 0].round(2).tolist()
    [0.8, 0.0, 1.0, 1.0, 0.8]
    """
    array = np.asarray(codes, np.float64)
    if array.ndim != 3 or not array.size:
        raise ValueError(f"codes of a thick mask are (shot, y, x), got an array of shape {array.shape}")
    middle = [(n - 1) / 2 for n in array.shape[1:]]
    if not 0 <= slope * max(middle) <= 1:
        raise ValueError(
            f"slope must be from 0 to {1 / max(*middle, 1e-9):.3g}, so that light moves by a cell at most; got {slope}"
        )
    y, x = (np.arange(n) - m for n, m in zip(array.shape[1:], middle, strict=True))
    share_y, share_x = slope * np.abs(y)[:, None], slope * np.abs(x)
    padded = np.pad(array, ((0, 0), (1, 1), (1, 1)))
    rows, columns = np.arange(y.size)[:, None] + 1, np.arange(x.size)[None, :] + 1
    out_y, out_x = rows + np.sign(y).astype(int)[:, None], columns + np.sign(x).astype(int)
    # On the axis the neighbour farther out is the cell itself, of which nothing is taken.
    straight = (1 - share_y) * (1 - share_x)
    askew_y, askew_x, both = share_y * (1 - share_x), (1 - share_y) * share_x, share_y * share_x
    over_y, over_x = padded[:, out_y, columns], padded[:, rows, out_x]
    share = straight + askew_y * over_y + askew_x * over_x + both * over_y * over_x * padded[:, out_y, out_x]
    return array * np.minimum(share, 1)  # rounding
