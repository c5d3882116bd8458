"""Measured spectral resolution, from captures of a white scene through a mask that need not be known (`shadowgram.spectral`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from . import _registration_shift as _shift
from .calibration import checked_centres, real_captures

LEAST_SHIFT = 0.5  # code columns, over all bands
LEAST_COLUMNS = 32  # detector columns


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredResolution:
    """Width of the bands that a camera resolves, as its captures of a white scene show it.

    Attributes
    ----------
    band_width, band_width_error : nm; Δλ, the change of wavelength that shifts the code by one column, and its standard error, by
        the scatter about a line (NaN for two bands, which always lie on one).
    wavelengths : (band,) nm.
    shifts : (band,) code columns further right that a detector element sees, against the reference band; the pattern itself
        moves to the left as this grows. NaN for bands whose pattern is not found.
    reference, neighbour : indices of the reference band and of the band whose shift is nearest to one column.
    reference_row, neighbour_row : (x,) a row of each over its mean; the neighbour's is shifted back by one column, NaN where it has
        left the detector.
    correlation : of these two rows.
    """

    band_width: float
    band_width_error: float
    wavelengths: np.ndarray
    shifts: np.ndarray
    reference: int
    neighbour: int
    reference_row: np.ndarray
    neighbour_row: np.ndarray
    correlation: float

    @property
    def left_out(self) -> np.ndarray:
        """Wavelengths, nm, of the bands whose pattern is not found: too dark, too blurred, or shifted off the detector."""
        return self.wavelengths[np.isnan(self.shifts)]

    def __str__(self) -> str:
        error = "" if math.isnan(self.band_width_error) else f" ± {self.band_width_error:.2g}"  # two bands have none
        text = f"bands of {self.band_width:.4g}{error} nm"
        if len(self.left_out):
            text += f"; left out: {', '.join(f'{w:g}' for w in self.left_out)} nm, where the pattern is not found"
        return text


def measured_resolution(
    white: ArrayLike,
    *,
    wavelengths: Sequence[float],
    reference: int = 0,
    pitch_ratio: float = 1,
    shot: int = 0,
    row: int | None = None,
) -> MeasuredResolution:
    """Spectral resolution by experiment: how far apart two wavelengths are whose patterns lie one code column apart.

    Parameters
    ----------
    white : (shot, band, y, x) captures of a white board, one a band and shot, dark subtracted. The code need not be known.
    wavelengths : (band,) nm, ascending; centres of the captured bands, any distance apart.
    reference : index of the band against which the others are shifted.
    pitch_ratio : code columns per detector element as the detector sees them, (1 − s)·Δd/Δc. The captures alone do not tell the
        stretch of the mask's image (`estimate_geometry` does, from the code); with 1 − s left out the bands come out too narrow
        by that factor.
    shot, row : which row of which capture is returned for show; the middle one if not said.

    Returns
    -------
    MeasuredResolution

    Raises
    ------
    TypeError
        If the captures are not real numbers.
    ValueError
        If captures and wavelengths do not fit together, no band shows the pattern of the reference, or all of them lie within
        half a code column of each other: the mask is too close to the detector.

    Notes
    -----
    Each band is correlated with the reference along x, summed over rows and shots, after dividing by the mean over 15 × 15 pixels;
    shifts are good to 0.01 columns on 128 × 128 pixels. Δλ is the inverse slope of a line fitted to the shifts.
    Source: Salazar (2022), section 2.5.1 and fig. 2.23. Departure: all rows and bands are used, not one randomly selected row of
    two bands.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> imager = sg.SSCSI(detector_shape=(64, 64), detector_pitch=10.0, code_pitch=10.0, mask_position=0.1,
    ...                   wavelengths=(450, 650))
    >>> white = imager.effective_code(sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0))
    >>> found = sg.spectral.measured_resolution(white, wavelengths=imager.resolution.wavelengths, pitch_ratio=1 - 0.1)
    >>> round(found.band_width), round(imager.resolution.band_width)
    (31, 31)
    """
    values = real_captures("the white captures", white, ("shot", "band", "y", "x"))
    centres = np.array(checked_centres(wavelengths, values.shape[1]))
    _check_choices(values.shape, reference, shot, row, pitch_ratio)
    shifts = _shifts(values, reference, pitch_ratio)
    slope, error = _slope(centres, shifts)
    distance = np.where(np.arange(len(centres)) == reference, np.inf, np.abs(np.abs(shifts) - 1))
    neighbour = int(np.nanargmin(distance))
    row = values.shape[2] // 2 if row is None else row
    one, other = values[shot, reference, row].astype(float), values[shot, neighbour, row].astype(float)
    back = _moved(other, -math.copysign(1 / pitch_ratio, shifts[neighbour]))
    both = np.isfinite(back)
    return MeasuredResolution(
        band_width=1 / abs(slope),
        band_width_error=error / slope**2,
        wavelengths=centres,
        shifts=shifts,
        reference=int(reference),
        neighbour=neighbour,
        reference_row=_over_mean(one),
        neighbour_row=_over_mean(back),
        correlation=_pearson(one[both], back[both]),
    )


def _check_choices(shape: tuple[int, ...], reference: int, shot: int, row: int | None, pitch_ratio: float) -> None:
    shots, bands, rows, columns = shape
    for name, index, size in (("reference", reference, bands), ("shot", shot, shots), ("row", row or 0, rows)):
        if isinstance(index, bool) or not (isinstance(index, int | np.integer) and 0 <= index < size):
            raise ValueError(f"{name} must be a whole number from 0 to {size - 1}, got {index!r}")
    if not (math.isfinite(pitch_ratio) and pitch_ratio > 0):
        raise ValueError(f"pitch_ratio is code columns per detector element, a positive number, got {pitch_ratio}")
    if columns < LEAST_COLUMNS:
        raise ValueError(f"captures must have {LEAST_COLUMNS} columns or more, got {columns}")


def _shifts(white: np.ndarray, reference: int, pitch_ratio: float) -> np.ndarray:
    """(band,) code columns; NaN where the pattern is not found."""
    columns = white.shape[3]
    most = columns - max(LEAST_COLUMNS // 2, columns // 8)  # beyond, too few columns are left in common
    contrast = [_shift.local_contrast(white[:, k]) for k in range(white.shape[1])]
    shifts = np.full(len(contrast), np.nan)
    shifts[reference] = 0.0
    for k, pattern in enumerate(contrast):
        if k != reference:
            found = _shift.locate(contrast[reference], pattern, 0, most)
            if found is not None:
                shifts[k] = -found[1] * pitch_ratio
    if np.isfinite(shifts).sum() < 2:
        raise ValueError(
            "no band shows the pattern of the reference band: take another reference, expose longer, or close the lens's aperture"
        )
    return shifts


def _slope(wavelengths: np.ndarray, shifts: np.ndarray) -> tuple[float, float]:
    """Code columns per nm, and its standard error."""
    seen = np.isfinite(shifts)
    x, y = wavelengths[seen], shifts[seen]
    x = x - x.mean()
    slope = float(x @ y / (x @ x))
    total = abs(slope) * float(np.ptp(x))
    if total < LEAST_SHIFT:
        raise ValueError(
            f"the pattern shifts by {total:.2f} code columns from {wavelengths[seen][0]:g} to {wavelengths[seen][-1]:g} nm,"
            f" less than {LEAST_SHIFT:g}: the mask is too close to the detector to measure what it resolves; move it away"
        )
    left = y - y.mean() - slope * x
    spare = len(x) - 2
    return slope, math.sqrt(left @ left / spare / (x @ x)) if spare else math.nan


def _moved(row: np.ndarray, by: float) -> np.ndarray:
    """Row whose pattern stood `by` pixels further right, moved to its place; NaN beyond the ends."""
    x = np.arange(len(row))
    return np.interp(x + by, x, row, left=np.nan, right=np.nan)


def _over_mean(row: np.ndarray) -> np.ndarray:
    mean = float(np.nanmean(row))
    return row / mean if mean else row


def _pearson(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a - a.mean(), b - b.mean()
    norm = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / norm if norm else 0.0
