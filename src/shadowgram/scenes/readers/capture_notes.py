"""The description of a folder of camera frames, `capture.toml` or `capture.json`, checked."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath

NAMES = ("capture.toml", "capture.json")
_LONGEST = 4 * 2**20  # bytes


@dataclass(frozen=True)
class Shot:
    """Names of the frames of a shot, and the exposure of each, s."""

    frames: tuple[str, ...]
    exposures: tuple[float, ...]


@dataclass(frozen=True)
class DarkFrame:
    """A frame with the shutter closed, and its exposure, s."""

    frame: str
    exposure: float


@dataclass(frozen=True)
class CaptureNotes:
    """What a description says; `saturation` in counts, None where it is not said."""

    shots: tuple[Shot, ...]
    dark: tuple[DarkFrame, ...]
    saturation: float | None


def read_notes(folder: Path) -> CaptureNotes:
    """Read the description of a folder of frames.

    Raises
    ------
    ValueError
        If there are two, or it is damaged or says something that cannot be.
    OSError
        If there is no such folder, or no description in it.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from shadowgram.scenes.readers.capture_notes import read_notes
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> _ = (folder / "capture.json").write_text('{"exposure": 0.1, "shots": [{"frames": ["a.png"]}]}')
    >>> read_notes(folder).shots
    (Shot(frames=('a.png',), exposures=(0.1,)),)
    """
    if not folder.is_dir():
        raise NotADirectoryError(
            f"{folder} is a file, not a folder" if folder.exists() else f"there is no folder {folder}"
        )
    found = [folder / name for name in NAMES if (folder / name).is_file()]
    if not found:
        raise FileNotFoundError(
            f"there is no {' or '.join(NAMES)} in {folder}; it must say the exposures and the frames of each shot"
        )
    if len(found) > 1:
        raise ValueError(f"there are both {' and '.join(NAMES)} in {folder}; keep one of them")
    try:
        return _notes(_loaded(found[0]))
    except ValueError as error:
        raise ValueError(f"cannot read {found[0]}: {error}") from error


def _loaded(path: Path) -> Mapping[str, object]:
    if path.stat().st_size > _LONGEST:
        raise ValueError("it is too long for a description of frames")
    try:
        text = path.read_text(encoding="utf-8-sig")
        said = tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
    except UnicodeDecodeError:
        raise ValueError("it is not a text in UTF-8") from None
    except RecursionError:
        raise ValueError("its brackets are nested too deep") from None
    if not isinstance(said, dict):
        raise ValueError("it must be a table of exposure, saturation, dark and shots")
    return said


def _notes(said: Mapping[str, object]) -> CaptureNotes:
    _check_keys(said, ("exposure", "saturation", "dark", "shots"), "the description")
    common = None if "exposure" not in said else _positive(said["exposure"], "exposure")
    saturation = None if "saturation" not in said else _positive(said["saturation"], "saturation")
    shots, darks = said.get("shots"), said.get("dark", [])
    if not isinstance(shots, list) or not shots:
        raise ValueError("it must have shots, each with the names of its frames: [[shots]] and frames = [...]")
    if not isinstance(darks, list):
        raise ValueError('dark must be a list of frames, such as dark = ["dark-1.png"]')
    return CaptureNotes(
        tuple(_shot(one, f"shot {number}", common) for number, one in enumerate(shots, 1)),
        tuple(_dark(one, f"dark frame {number}", common) for number, one in enumerate(darks, 1)),
        saturation,
    )


def _shot(said: object, what: str, common: float | None) -> Shot:
    if not isinstance(said, dict):
        raise ValueError(f'{what} must be a table with frames = ["…"]')
    _check_keys(said, ("frames", "exposure"), what)
    names = said.get("frames")
    if not isinstance(names, list) or not names:
        raise ValueError(f'{what} must have frames = ["…"], one name at least')
    frames = tuple(_name(name, what) for name in names)
    exposure = said.get("exposure", common)
    if isinstance(exposure, list):
        if len(exposure) != len(frames):
            raise ValueError(f"{what} has {len(frames)} frames and {len(exposure)} exposures; give one, or one a frame")
        return Shot(frames, tuple(_positive(one, f"the exposure of {what}") for one in exposure))
    return Shot(frames, (_exposure(exposure, what),) * len(frames))


def _dark(said: object, what: str, common: float | None) -> DarkFrame:
    if isinstance(said, str):
        return DarkFrame(_name(said, what), _exposure(common, what))
    if not isinstance(said, dict):
        raise ValueError(f"{what} must be the name of a file, or a table of frame and exposure")
    _check_keys(said, ("frame", "exposure"), what)
    return DarkFrame(_name(said.get("frame"), what), _exposure(said.get("exposure", common), what))


def _exposure(value: object, what: str) -> float:
    if value is None:
        raise ValueError(f"the exposure of {what} is not said; give it in seconds, there or for all frames")
    return _positive(value, f"the exposure of {what}")


def _positive(value: object, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < math.inf:
        raise ValueError(f"{what} must be a positive number, got {str(value)[:40]!r}")
    try:
        return float(value)
    except OverflowError:
        raise ValueError(f"{what} is too large") from None


def _name(value: object, what: str) -> str:
    if not isinstance(value, str) or not value or "\0" in value or len(value) > 1000:
        raise ValueError(f"a frame of {what} must be the name of a file, got {str(value)[:40]!r}")
    path = PurePath(value)
    if path.is_absolute() or ".." in path.parts:
        raise ValueError(f"the frames must be in the folder of the description; got {value[:80]!r}")
    return value


def _check_keys(said: Mapping[str, object], known: tuple[str, ...], what: str) -> None:
    for name in said:
        if name not in known:
            raise ValueError(f"{what} says {str(name)[:40]!r}, which is not known; it may say {', '.join(known)}")
