"""The door for folders of raw camera frames: exposures, dark frames, saturation, and repeated frames of one shot."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .arrays import read_array
from .capture_notes import DarkFrame, Shot, read_notes

_SAME = 1e-6  # relative difference of two exposures that are one


@dataclass(frozen=True, kw_only=True, eq=False)
class Frames:
    """Captured shots, ready for reconstruction.

    Attributes
    ----------
    snapshots : (shot, y, x) float64, counts per second with the dark frames subtracted.
    saturated : (shot, y, x) bool, where no frame of the shot was below saturation; the value is then too low.
    exposures : (shot,) s, of all frames of the shot together.
    """

    snapshots: np.ndarray
    saturated: np.ndarray
    exposures: np.ndarray


def read_frames(folder: str | os.PathLike[str]) -> Frames:
    """Read a folder of raw frames (PNG, TIFF, `.npy`, …) that a `capture.toml` or `capture.json` in it describes.

    The description says, with exposures in seconds and names of files in the folder::

        exposure = 0.02                       # of every frame, unless a shot says otherwise
        saturation = 4095                     # counts; else the full scale of frames of 8 or 16 bits
        dark = ["dark-1.png", "dark-2.png"]   # with the shutter closed; or tables {frame = "dark.png", exposure = 0.1}

        [[shots]]
        frames = ["shot-1a.png", "shot-1b.png"]

        [[shots]]
        frames = ["short.png", "long.png"]
        exposure = [0.02, 0.1]                # one number, or one a frame

    From each frame the mean of the dark frames of its exposure is subtracted; where there are none of it, a straight line
    over the exposures of the others is taken. The frames of a shot are added and divided by the sum of their exposures.
    Where a frame is saturated, it and frames of the shot with the same exposure or a longer one are left out at that
    pixel; leaving out only the saturated ones of several that are alike would make the mean too low.

    Parameters
    ----------
    folder : the folder with the frames and their description.

    Returns
    -------
    Frames
        With `snapshots` (shot, y, x) in counts per second, `saturated` (shot, y, x) and `exposures` (shot,).

    Warns
    -----
    UserWarning
        If pixels are saturated, with their number; if there are no dark frames, or the saturation had to be guessed.

    Raises
    ------
    ValueError
        If the description or a frame is damaged, or they do not fit together.
    OSError
        If the folder, its description or a frame is not there.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> import shadowgram as sg
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> np.save(folder / "dark.npy", np.full((2, 3), 100, np.uint16))
    >>> np.save(folder / "shot.npy", np.full((2, 3), 300, np.uint16))
    >>> _ = (folder / "capture.toml").write_text('''
    ... exposure = 0.5
    ... saturation = 4095
    ... dark = ["dark.npy"]
    ... [[shots]]
    ... frames = ["shot.npy"]
    ... ''')
    >>> sg.scenes.read_frames(folder).snapshots
    array([[[400., 400., 400.],
            [400., 400., 400.]]])
    """
    folder = Path(folder)
    notes = read_notes(folder)
    remarks: list[str] = []
    darks = _darks(folder, notes.dark)
    if not darks:
        remarks.append("no dark frames are said, so that nothing was subtracted")
    rates, saturated = [], []
    for number, shot in enumerate(notes.shots, 1):
        rate, lost = _shot(folder, shot, darks, notes.saturation, remarks)
        if rates and rate.shape != rates[0].shape:
            raise ValueError(f"{folder}: shot {number} has {_size(rate)} pixels and the first one {_size(rates[0])}")
        if lost.any():
            remarks.append(f"shot {number}: {lost.sum()} of {lost.size} pixels ({lost.mean():.2%}) are saturated")
        rates.append(rate)
        saturated.append(lost)
    if remarks:
        warnings.warn(f"{folder.name}: {'; '.join(remarks)}", stacklevel=2)
    exposures = np.array([sum(shot.exposures) for shot in notes.shots])
    return Frames(snapshots=np.stack(rates), saturated=np.stack(saturated), exposures=exposures)


def _darks(folder: Path, said: Sequence[DarkFrame]) -> dict[float, np.ndarray]:
    """Mean dark frame of each exposure."""
    groups: dict[float, list[np.ndarray]] = {}
    for one in said:
        key = next((other for other in groups if _alike(other, one.exposure)), one.exposure)
        groups.setdefault(key, []).append(_frame(folder, one.frame))
    shapes = {frame.shape for frames in groups.values() for frame in frames}
    if len(shapes) > 1:
        raise ValueError(f"{folder}: the dark frames must be of one size; got {_sizes(shapes)} pixels")
    return {key: np.stack(frames).mean(axis=0, dtype=np.float64) for key, frames in groups.items()}


def _alike(a: float, b: float) -> bool:
    return abs(a - b) <= _SAME * max(a, b)


def _shot(
    folder: Path, shot: Shot, darks: dict[float, np.ndarray], saturation: float | None, remarks: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Counts per second (y, x) of a shot, and where all its frames were saturated."""
    frames = [_frame(folder, name) for name in shot.frames]
    shapes = {frame.shape for frame in frames} | {dark.shape for dark in darks.values()}
    if len(shapes) > 1:
        raise ValueError(f"{folder}: frames and dark frames must be of one size; got {_sizes(shapes)} pixels")
    limit = _saturation(frames, saturation, remarks)
    counts, seconds = np.zeros(frames[0].shape), np.zeros(frames[0].shape)
    reached = np.zeros(frames[0].shape, bool)  # saturation, at this exposure or a shorter one
    rate = counts
    for exposure in sorted(set(shot.exposures)):
        alike = [frame for frame, said in zip(frames, shot.exposures, strict=True) if said == exposure]
        light = np.stack(alike).sum(axis=0, dtype=np.float64) - len(alike) * _dark(darks, exposure, folder)
        if exposure == min(shot.exposures):  # the least wrong value where every frame is saturated
            rate = light / (len(alike) * exposure)
        for frame in alike:
            reached |= frame >= limit
        counts += np.where(reached, 0, light)
        seconds += np.where(reached, 0, len(alike) * exposure)
    lost = seconds == 0
    return np.divide(counts, seconds, out=rate, where=~lost), lost


def _saturation(frames: Sequence[np.ndarray], said: float | None, remarks: list[str]) -> float:
    """Counts from which on a pixel is saturated."""
    if said is not None:
        return said
    guess = float(np.iinfo(frames[0].dtype).max) if frames[0].dtype in (np.uint8, np.uint16) else np.inf
    what = f"the full scale of the frames, {guess:g}, was taken" if guess < np.inf else "it was not looked for"
    remark = f"the saturation is not said: {what}"
    if remark not in remarks:
        remarks.append(remark)
    return guess


def _dark(darks: dict[float, np.ndarray], exposure: float, folder: Path) -> np.ndarray | float:
    """Dark frame of an exposure."""
    if not darks:
        return 0.0
    for other, dark in darks.items():
        if _alike(other, exposure):
            return dark
    if len(darks) < 2:
        raise ValueError(
            f"{folder}: there is no dark frame of {exposure:g} s; give one, or some of two other exposures to interpolate"
        )
    # A straight line through the dark frames: offset and dark current of each pixel.
    times = np.array(list(darks))
    away = times - times.mean()
    weights = 1 / len(times) + (exposure - times.mean()) * away / (away @ away)
    return np.tensordot(weights, np.stack(list(darks.values())), axes=1)


def _frame(folder: Path, name: str) -> np.ndarray:
    frame = read_array(folder / name)
    if frame.ndim != 2:
        raise ValueError(f"{folder / name} must be one grey frame (y, x); it is an array of shape {frame.shape}")
    return frame


def _size(frame: np.ndarray) -> str:
    return " × ".join(map(str, frame.shape))


def _sizes(shapes: set[tuple[int, ...]]) -> str:
    return " and ".join(" × ".join(map(str, shape)) for shape in sorted(shapes))
