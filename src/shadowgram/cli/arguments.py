"""What options say, as values: sizes, ranges, codes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np


def parse_size(option: str, text: str) -> tuple[int, int]:
    """Size y × x such as "256x256", as (y, x)."""
    parts = text.lower().replace("×", "x").split("x")
    if len(parts) != 2 or not all(part.strip().isdigit() and int(part) > 0 for part in parts):
        raise ValueError(f"{option} takes the size y × x, such as 256x256; got {text!r}")
    return int(parts[0]), int(parts[1])


def parse_wavelengths(text: str) -> tuple[float, float]:
    """Range such as "451:642" in nm, as (first, last)."""
    return parse_range("--wavelengths", text)


def parse_range(option: str, text: str) -> tuple[float, float]:
    """Range such as "451:642" in nm, as (first, last)."""
    try:
        first, last = (float(part) for part in text.split(":"))
    except ValueError:
        raise ValueError(f"{option} takes first:last in nm, such as 451:642; got {text!r}") from None
    return first, last


def parse_crop(text: str) -> tuple[slice, slice]:
    """Part such as "0:128,64:192", y then x, as slices."""
    try:
        (y0, y1), (x0, x1) = ((int(n) for n in part.split(":")) for part in text.split(","))
    except ValueError:
        raise ValueError(f"--crop takes y0:y1,x0:x1 in pixels, such as 0:128,64:192; got {text!r}") from None
    if not (0 <= y0 < y1 and 0 <= x0 < x1):
        raise ValueError(f"--crop must begin at 0 or more and end after it begins, got {text!r}")
    return slice(y0, y1), slice(x0, x1)


def band_range(centres: np.ndarray) -> tuple[float, float]:
    """Outer edges, nm, of bands with these centres: half a band beyond the first and the last."""
    import numpy as np

    centres = np.sort(np.asarray(centres, dtype=float))
    if len(centres) == 1:
        raise ValueError("the cube has one band, whose width is unknown: say --wavelengths first:last in nm")
    return float(1.5 * centres[0] - 0.5 * centres[1]), float(1.5 * centres[-1] - 0.5 * centres[-2])


def read_curve(path: Path) -> tuple[tuple[float, float], ...]:
    """Dispersion curve from a text file, a line a point: wavelength in nm, comma or space, displacement in px; # begins a comment.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If a line is not two numbers.
    """
    points = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        words = line.split("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            nm, px = map(float, words)
        except ValueError:
            raise ValueError(
                f"line {number} of {path} must be a wavelength in nm and a displacement in px, got {line!r}"
            ) from None
        points.append((nm, px))
    return tuple(points)


def read_code(path: Path) -> np.ndarray:
    """Code (shot, y, x) or (shot, band, y, x) from a file that `codes make` writes, a .npy array, or a PNG of one shot.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is not a code.
    """
    suffix = path.suffix.lower()
    if suffix == ".npy":
        from shadowgram.scenes.readers.numpy_files import npy_variables

        try:
            return npy_variables(path)[path.stem].load()
        except ValueError as error:
            raise ValueError(f"cannot read {path}: {error}") from error
    if suffix == ".png":
        from shadowgram.figures.style import read_grey

        return read_grey(path)[None]
    if suffix != ".nc":
        raise ValueError(f"a code is read from .nc, .npy or .png, got {path}")
    from shadowgram.scenes.readers.native import read_dataset

    dataset = read_dataset(path)
    if "code" not in dataset.data_vars:
        raise ValueError(f"{path} holds no code; make one with 'shadowgram codes make'")
    return dataset["code"].values
