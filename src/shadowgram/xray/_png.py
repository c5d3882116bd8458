"""Pixels of a PNG picture as shares of white, for patterns; `shadowgram.scenes.readers.png` reads the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shadowgram.scenes.readers.png import read_picture


def read_png(path: Path) -> NDArray[np.float64]:
    """Grey picture (y, x) in [0, 1]; of a coloured one the mean of the colours. Transparency is not looked at.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is not a PNG picture, damaged, or interlaced.
    """
    picture = read_picture(path)
    return picture.samples.mean(axis=-1, dtype=np.float64) / picture.full
