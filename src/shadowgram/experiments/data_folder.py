"""Measured data that some studies need and the package cannot ship: found in a folder that the user names."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

VARIABLE = "SHADOWGRAM_DATA"
"""Of the environment, which processes that compute inherit: the folder of the data."""


def find(relative: str, sha256: str, origin: str) -> Path:
    """The file of this content.

    Parameters
    ----------
    relative : path such as "cxbi/experiment/codes_bin.mat"; the folder may also begin further down.
    sha256 : first digits of the file's digest.
    origin : where the data come from, for the error.

    Raises
    ------
    FileNotFoundError
        If no folder was named, or there is no such file in it.
    ValueError
        If the file is another one.

    Examples
    --------
    >>> from shadowgram.experiments.data_folder import find
    >>> find("none/y.mat", "00", "github.com/nobody")
    Traceback (most recent call last):
    ...
    FileNotFoundError: ...
    """
    named = os.environ.get(VARIABLE)
    if not named:
        raise FileNotFoundError(
            f"this needs {relative} ({origin}); name the folder that has it with --data or {VARIABLE}"
        )
    parts = Path(relative).parts
    for start in range(len(parts)):
        path = Path(named).joinpath(*parts[start:])
        if path.is_file():
            if not hashlib.sha256(path.read_bytes()).hexdigest().startswith(sha256):
                raise ValueError(f"{path} is not the file of {origin} that this study is about")
            return path
    raise FileNotFoundError(f"there is no {relative} in {named}; it comes from {origin}")
