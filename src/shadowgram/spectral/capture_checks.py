"""What is wrong with captured shots, before they are reconstructed: each finding says what, how much, and what to do."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from . import _mismatch_fit as windowed
from ._mismatch_windows import Windows, side_for, windows_of
from .calibration import MOST_SATURATED, CalibratedImager
from .mismatch import MovableImager, best_place, lightest_rows

MOST_WINDOWS = 3000
UNSEEN = 2.0  # standard errors, below which the shots do not show the mask at all
FAR_OFF = 0.25  # px down, from which it is worth saying
FAR = 0.37  # of the mask's height; where it shows another pattern

TURNED = {"upside down": (-2,), "mirrored": (-1,), "turned by 180°": (-2, -1)}


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Something that is wrong with captured shots.

    Attributes
    ----------
    what : the problem, in a few words.
    how_much : in numbers.
    what_to_do : to mend it.
    fatal : whether nothing can be reconstructed before it is mended.
    """

    what: str
    how_much: str
    what_to_do: str
    fatal: bool = False

    def __str__(self) -> str:
        return f"{self.what}: {self.how_much}; {self.what_to_do}"


def check_capture(
    imager: MovableImager, code: ArrayLike, snapshots: ArrayLike, *, saturation: float | None = None
) -> list[Finding]:
    r"""What speaks against reconstructing some snapshots with a model.

    Parameters
    ----------
    imager : `CASSI`, `ColoredCASSI` or `CalibratedImager`.
    code : (shot, \\*imager.code_shape), or one shot; the mask.
    snapshots : (shot, y, x), as the camera gives them.
    saturation : value of a saturated pixel; by default the largest value, if more than 0.1 % of a shot's pixels have it.

    Returns
    -------
    list of Finding
        Fatal ones alone where there are any: values that are not numbers, sizes that do not fit, nothing captured. Else saturation,
        and what the pattern of the mask in the capture says: a mask that is out of place, turned, or another one. Empty if all
        seems well.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> imager = sg.CASSI(cube_shape=(4, 32, 32), wavelengths=(450, 650), band_shift=2)
    >>> code = sg.codes.random(shots=1, shape=imager.code_shape, seed=0)
    >>> print(sg.spectral.check_capture(imager, code, np.ones((1, 32, 36)))[0].what)
    a band is missing
    """
    mask, values = np.asarray(code), np.asarray(snapshots)
    if mask.ndim == len(imager.code_shape):
        mask = mask[None]
    fatal = [*_bad_values("the mask", mask), *_bad_values("the shots", values)] or [
        *_wrong_sizes(imager, mask, values),
        *_not_a_mask(mask),
    ]
    fatal = fatal or _empty(values)
    if fatal:
        return fatal
    return [*_saturated(values, saturation), *_misplaced(imager, mask, values.astype(np.float32))]


def _bad_values(name: str, values: np.ndarray) -> list[Finding]:
    if values.dtype.kind not in "fiub":
        return [
            Finding(
                what=f"{name} hold no numbers",
                how_much=f"values of type {values.dtype}",
                what_to_do="read another variable",
                fatal=True,
            )
        ]
    bad = 0 if values.dtype.kind != "f" else int(np.count_nonzero(~np.isfinite(values)))
    if not bad:
        return []
    return [
        Finding(
            what=f"bad values in {name}",
            how_much=f"{bad} of {values.size} are NaN or infinite",
            what_to_do="fill these pixels from their neighbours, or crop them",
            fatal=True,
        )
    ]


def _wrong_sizes(imager: MovableImager, mask: np.ndarray, values: np.ndarray) -> list[Finding]:
    if mask.shape[1:] != imager.code_shape:
        wanted, got = (" × ".join(map(str, shape)) for shape in (imager.code_shape, mask.shape[1:]))
        return [
            Finding(what="a mask of another size", how_much=f"it is {got}, and the model takes {wanted}",
                    what_to_do="crop or resample the mask to the pixels of the shots", fatal=True)
        ]  # fmt: skip
    if values.ndim != 3 or len(values) != len(mask):
        return [
            Finding(what="another number of shots than masks",
                    how_much=f"shots of shape {values.shape} and {len(mask)} masks, where (shot, y, x) is expected",
                    what_to_do="give one mask for each shot", fatal=True)
        ]  # fmt: skip
    rows, columns = imager.code_shape[-2:]
    if values.shape[1] != rows:
        return [
            Finding(what="a mask of another size", how_much=f"the shots are {values.shape[1]} px high and the mask {rows}",
                    what_to_do="crop both to the same rows", fatal=True)
        ]  # fmt: skip
    return _wrong_width(imager, columns, values.shape[2])


def _wrong_width(imager: MovableImager, columns: int, width: int) -> list[Finding]:
    displacements = np.zeros(1) if isinstance(imager, CalibratedImager) else imager.displacements
    extra = int(np.ceil(displacements[-1] - 1e-9))
    if width == columns + extra:
        return []
    bands = len(displacements)
    shift = displacements[-1] / max(bands - 1, 1)
    whole = 1 + (width - columns) / shift if shift else 0.0
    beside = f"the shots are {width} px wide, {width - columns} wider than the mask"
    if shift and whole >= 1 and abs(whole - round(whole)) < 0.05:
        missing = "a band is missing" if whole < bands else "there are more bands than the model has"
        return [
            Finding(
                what=missing,
                how_much=f"{beside}, which is right for {round(whole)} bands of {shift:g} px, not for {bands}",
                what_to_do="check the number of bands, the shift, and that neither shots nor mask are cropped",
                fatal=True,
            )
        ]
    return [
        Finding(
            what="the detector's width does not fit the bands",
            how_much=f"{beside}, and {bands} bands reach {extra} px further than it",
            what_to_do="check the band shift, and crop shots and mask to what belongs together",
            fatal=True,
        )
    ]


def _not_a_mask(mask: np.ndarray) -> list[Finding]:
    low, high = float(mask.min()), float(mask.max())
    if low < 0 or high > 1:
        return [
            Finding(what="a mask that is no transmittance", how_much=f"its values are {low:g} to {high:g}, not within 0 to 1",
                    what_to_do="divide it by a capture without mask, or by its largest value", fatal=True)
        ]  # fmt: skip
    if low == high:
        return [
            Finding(what="a mask without pattern", how_much=f"it is {low:g} everywhere",
                    what_to_do="give the captured or designed mask", fatal=True)
        ]  # fmt: skip
    return []


def _empty(values: np.ndarray) -> list[Finding]:
    return [
        Finding(what=f"shot {shot} shows nothing", how_much=f"it is {image.flat[0]:g} in every pixel",
                what_to_do="capture it again", fatal=True)
        for shot, image in enumerate(values) if image.min() == image.max()
    ]  # fmt: skip


def _saturated(values: np.ndarray, saturation: float | None) -> list[Finding]:
    found = []
    for shot, image in enumerate(values):
        limit = image.max() if saturation is None else saturation
        share = float((image >= limit).mean())
        if share > MOST_SATURATED:
            found.append(
                Finding(
                    what=f"shot {shot} is saturated",
                    how_much=f"{100 * share:.3g} % of its pixels are at {float(limit):g} or more",
                    what_to_do="shorten the exposure; the spectra of these places will be wrong",
                )
            )
    return found


def _misplaced(imager: MovableImager, mask: np.ndarray, values: np.ndarray) -> list[Finding]:
    """What the pattern in the capture says of the mask."""
    bands, shots = imager.cube_shape[0], len(values)
    if min(values.shape[1:]) < 4 * side_for(bands, shots):
        return []
    rows = lightest_rows(values, np.zeros(shots))
    part = dataclasses.replace(imager, cube_shape=(bands, rows.stop - rows.start, imager.cube_shape[2]))

    def seen_with(code: np.ndarray) -> Windows:
        return windows_of(part.operator(code[..., rows, :]), values[:, rows], MOST_WINDOWS)

    windows = seen_with(mask)
    offsets = np.zeros(shots)
    offsets, _ = windowed.fit_offsets(
        windowed.spread_out(windows, windowed.MOST_ALL), (0.0, 0.0), offsets, windowed.noise_floor(windows, offsets)
    )
    lit = windowed.lit(windows, offsets, windowed.MOST_LIT)
    floor = windowed.noise_floor(lit, offsets)
    whole = best_place(lit, offsets)
    down, error = windowed.fit_down(lit, whole, offsets, floor)

    def best_score(code: np.ndarray) -> np.ndarray:
        """As good as it gets within the search, for any code."""
        few = windowed.spread_out(windowed.lit(seen_with(code), offsets, windowed.MOST_LIT), windowed.MOST_SEARCHED)
        return min(windowed.search(few, offsets, floor).values(), key=lambda one: float(one.mean()))

    few, best = windowed.spread_out(lit, windowed.MOST_SEARCHED), best_score(mask)
    for how, axes in TURNED.items():
        if windowed.worse_by(best, best_score(np.flip(mask, axes)), few.tile) > windowed.CLEAR:
            return [
                Finding(
                    what=f"the mask is {how}",
                    how_much="so it fits the pattern in the shots, and as given it does not",
                    what_to_do="turn the mask's picture, or the shots",
                )
            ]
    elsewhere = best_score(np.roll(mask, round(FAR * mask.shape[-2]), axis=-2))
    if windowed.worse_by(elsewhere, best, few.tile) < UNSEEN:
        return [
            Finding(
                what="the shots do not show this mask",
                how_much="a part of it from elsewhere fits as well",
                what_to_do="check that mask and shots belong together, and which way the bands are displaced",
            )
        ]
    moved_down = abs(down) > max(FAR_OFF, windowed.CLEAR * error)
    if not moved_down and not whole[1]:
        return []
    return [
        Finding(
            what="the mask is out of place",
            how_much=f"the shots show it {down:+.1f} px down and {whole[1]:+.0f} px right of where it is given",
            what_to_do="move it, capture it again, or have the model corrected (--correct, estimate_mismatch)",
        )
    ]
