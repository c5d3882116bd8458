"""Drawing from a table of weights with one look."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def alias_table(weights: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Walker's alias table.

    Parameters
    ----------
    weights : (n,) not negative, not all 0.

    Returns
    -------
    alias, keep : (n,) each. Entry i, drawn with probability 1/n, is kept with probability ``keep[i]`` and exchanged for
        ``alias[i]`` otherwise.

    Notes
    -----
    Walker, ACM Trans. Math. Softw. 3, 253 (1977), set up as by Vose, IEEE Trans. Softw. Eng. 17, 972 (1991).

    Examples
    --------
    >>> from shadowgram.xray._alias import alias_table
    >>> alias_table([1, 3])
    (array([1, 1]), array([0.5, 1. ]))
    """
    share = np.asarray(weights, np.float64)
    share = share * (share.size / share.sum())
    alias, keep = np.arange(share.size), np.ones(share.size)
    small = [i for i, value in enumerate(share) if value < 1]
    large = [i for i, value in enumerate(share) if value >= 1]
    while small and large:
        little, much = small.pop(), large[-1]
        alias[little], keep[little] = much, share[little]
        share[much] -= 1 - share[little]
        if share[much] < 1:
            small.append(large.pop())
    return alias, keep  # what is left in either list differs from 1 by rounding
