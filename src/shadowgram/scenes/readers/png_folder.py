"""Folders with a grey PNG picture a band, numbered or with the wavelength in the name, as the CAVE scenes are kept.

`ms_01.png`, `ms_02.png`, … have numbers that follow each other from 0 or 1; `scene_450nm.png`, … have wavelengths.
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from .capture_notes import NAMES as CAPTURE_NAMES
from .contents import Contents, Variable
from .png import png_bytes, png_variables, read_grey

_NANOMETRES = re.compile(r"(?<![\d.])(\d{1,6}(?:\.\d{1,20})?)\s?nm(?![a-z])", re.IGNORECASE)
_NUMBER = re.compile(r"\d{1,9}(?!.*\d)")
_VISIBLE = (200, 20_000)  # nm; numbers in here with even steps are wavelengths, not counts of bands
_MOST_BANDS = 100_000


@dataclass(frozen=True)
class _Band:
    """A picture: its number and wavelength by its name, and the rest of the name."""

    path: Path
    rest: str
    number: int | None
    nm: float | None


def folder_contents(folder: Path, *, wavelengths_said: bool) -> Contents:
    """The cube that the PNG pictures of a folder are the bands of, and their wavelengths where their names say them.

    Raises
    ------
    ValueError
        If there are none, they do not belong together, a number is missing, or one is coloured or damaged.
    """
    bands = _bands(folder)
    notes: list[str] = []
    centres = _order(bands, notes, wavelengths_said)
    pictures = [_listed(band.path) for band in bands]
    for band, picture in zip(bands, pictures, strict=True):
        if (picture.shape, picture.dtype) != (pictures[0].shape, pictures[0].dtype):
            raise ValueError(
                f"the pictures must be of one size and depth; {bands[0].path.name} is {pictures[0].describe()} "
                f"and {band.path.name} is {picture.describe()}"
            )
    shape, dtype = (len(bands), *pictures[0].shape), pictures[0].dtype
    assert dtype is not None
    name = bands[0].rest if re.fullmatch(r"[A-Za-z]\w*", bands[0].rest, re.ASCII) else folder.name
    cube = Variable(shape, dtype, partial(_load, bands, shape, dtype), ("band", "y", "x"))
    variables = {name: cube}
    if centres is not None:
        variables["wavelength"] = Variable(centres.shape, centres.dtype, lambda: centres, attrs={"units": "nm"})
    return Contents(variables, notes)


def _bands(folder: Path) -> list[_Band]:
    if any((folder / name).is_file() for name in CAPTURE_NAMES):
        raise ValueError("it holds frames of a camera, not a datacube; read them with scenes.read_frames")
    with os.scandir(folder) as entries:
        names = sorted(
            one.name for one in entries if one.name.lower().endswith(".png") and not one.name.startswith(".")
        )
    if not names:
        raise ValueError("there are no PNG pictures in it; a folder must hold a grey one for each band")
    if len(names) > _MOST_BANDS:
        raise ValueError(f"there are {len(names)} pictures in it, more than a datacube has bands")
    return [_parsed(folder / name) for name in names]


def _parsed(path: Path) -> _Band:
    stem = path.name[:-4]
    found = _NANOMETRES.findall(stem)
    rest = _NANOMETRES.sub("", stem) if len(found) == 1 else stem
    number = _NUMBER.search(rest)
    if number is not None:
        rest = rest[: number.start()] + rest[number.end() :]
    return _Band(
        path,
        rest.strip(" _-."),
        int(number[0]) if number is not None else None,
        float(found[0]) if len(found) == 1 else None,
    )


def _order(bands: list[_Band], notes: list[str], wavelengths_said: bool) -> np.ndarray | None:
    """Sort the bands by number, or else by wavelength; the wavelengths if the names say them."""
    for band in bands:
        if band.rest != bands[0].rest or (band.nm is None) != (bands[0].nm is None):
            raise ValueError(
                f"the names {bands[0].path.name} and {band.path.name} are not of one series; keep only the bands in it"
            )
        if band.number is None and (band.nm is None or bands[0].number is not None):
            raise ValueError(
                "the pictures of a folder must be numbered or have wavelengths such as 450nm in their names; "
                f"{band.path.name} has neither"
            )
    numbers = [band.number for band in bands if band.number is not None]
    if numbers and len(numbers) < len(bands):
        raise ValueError("some of its pictures have numbers and some have not; they are not of one series")
    bands.sort(key=lambda band: (band.number if band.number is not None else 0, band.nm or 0.0))
    if bands[0].nm is not None:
        if numbers and len(set(numbers)) > 1:
            _check_numbers(bands, anywhere=True)
        else:  # a number that all names share tells nothing
            bands.sort(key=lambda band: band.nm or 0.0)
        return np.array([band.nm for band in bands], np.float64)
    steps = {b - a for a, b in pairwise(sorted(numbers))}
    low, high = min(numbers), max(numbers)
    if len(bands) > 2 and len(steps) == 1 and max(steps) > 1 and low >= _VISIBLE[0] and high <= _VISIBLE[1]:
        notes.append(f"the numbers in its names, {low} to {high}, were taken for wavelengths in nm")
        return np.array(sorted(numbers), np.float64)
    _check_numbers(bands, anywhere=wavelengths_said)
    return None


def _check_numbers(bands: Sequence[_Band], *, anywhere: bool) -> None:
    """Refuse bands whose numbers do not follow each other, from 0 or 1 unless they may begin anywhere."""
    numbers = [band.number if band.number is not None else 0 for band in bands]
    for before, after in pairwise(numbers):
        if after == before:
            raise ValueError(f"two of its pictures have the number {after}")
        if after > before + 1:
            raise ValueError(
                f"number {before + 1} is missing among its pictures, which go from {numbers[0]} to {numbers[-1]}"
            )
    if not anywhere and numbers[0] > 1:
        raise ValueError(
            f"its pictures begin with number {numbers[0]}, so that the first ones seem to be missing; "
            "say wavelengths= if they are not"
        )


def _listed(path: Path) -> Variable:
    try:
        return next(iter(png_variables(path).values()))
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error


def _load(bands: Sequence[_Band], shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    values = np.empty(shape, dtype)
    for band, into in zip(bands, values, strict=True):
        try:
            into[...] = read_grey(band.path)
        except ValueError as error:
            raise ValueError(f"{band.path.name}: {error}") from error
    return values


def write_folder(
    values: np.ndarray, wavelengths: Sequence[float] | np.ndarray | None, name: str, path: str | os.PathLike[str]
) -> None:
    """Write a cube (band, y, x) as a new folder of PNG pictures, all or nothing.

    Whole numbers of 8 and 16 bits are kept; floats must lie in [0, 1], and become shares of 65535.

    Raises
    ------
    ValueError
        If the values are of other types, or beyond [0, 1].
    OSError
        If there is anything but an empty folder at `path`, or it cannot be written.
    """
    target = Path(path).absolute()
    pixels = _pixels(values)
    if not target.parent.is_dir():
        raise FileNotFoundError(f"there is no folder {target.parent}")
    if target.is_symlink() or (target.exists() and (not target.is_dir() or any(target.iterdir()))):
        raise FileExistsError(f"cannot write {path}: it is there already; give the name of a new folder")
    temporary = target.with_name(f".{target.name[:100]}.{secrets.token_hex(6)}.part")
    digits = max(2, len(str(len(values))))
    try:
        try:
            temporary.mkdir()
            for i, picture in enumerate(pixels):
                said = (
                    "" if wavelengths is None else f"_{np.format_float_positional(float(wavelengths[i]), trim='-')}nm"
                )
                _write_synced(temporary / f"{name}_{i + 1:0{digits}d}{said}.png", png_bytes(picture))
            temporary.replace(target)
        except BaseException:
            with suppress(OSError):
                shutil.rmtree(temporary)
            raise
    except OSError as error:
        raise type(error)(f"cannot write {path}: {error.strerror or error}; nothing was changed") from error


def _pixels(values: np.ndarray) -> np.ndarray:
    if values.dtype in (np.uint8, np.uint16):
        return values
    if values.dtype.kind != "f":
        raise ValueError(f"PNG pictures hold shares of white or numbers of 8 or 16 bits, not {values.dtype}")
    low, high = float(values.min()), float(values.max())
    if low < 0 or high > 1:
        raise ValueError(
            f"PNG pictures hold values from 0 to 1, and these go from {low:g} to {high:g}; scale them first"
        )
    return np.rint(values * np.float64(65535)).astype(np.uint16)


def _write_synced(path: Path, data: bytes) -> None:
    with path.open("xb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
