"""Where a disperser puts each band on the detector: displacements, and the footprint of a voxel that they smear.

A voxel of band k covers one pixel and the band between its edges. Displaced by D(λ), it is seen as box(1 pixel) ∗ box(spread),
where the spread reaches from the displacement of one edge of the band to that of the other ("exact": the oblique footprint), or
is nothing at the displacement of the band's centre ("centre", first order). The shares of it that fall on each pixel are
overlaps in closed form.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from ._checks import shortened
from ._geometry import ROUNDING, share_below

SHEARS = ("centre", "exact")
MOST = 10_000  # bands, and pixels of dispersion: far above any instrument, a guard against a unit mistaken

Curve = tuple[tuple[float, float], ...]


@dataclass(frozen=True, eq=False)
class Footprints:
    """Pixels that the voxels of each band fall on: voxel x of band k has the share weights[k, j] on pixel x + first[k] + j.

    Attributes
    ----------
    first : (band,) int64.
    weights : (band, j) float64; the sum over j is 1.
    """

    first: np.ndarray
    weights: np.ndarray


@dataclass(frozen=True, eq=False)
class Dispersion:
    """Displacement of each wavelength in pixels, 0 at the centre of the first reference band.

    Attributes
    ----------
    wavelengths : (shortest, longest) nm, split evenly into `bands`, and into `reference_bands`.
    bands : number of bands of the datacube.
    reference_bands : number of bands that the displacements and the width of the detector are counted in.
    law : pixels from one reference band to the next, or a measured curve.
    shear : one of `SHEARS`.
    reference_centres : nm, of the reference bands where they are not even.
    """

    wavelengths: tuple[float, float]
    bands: int
    reference_bands: int
    law: float | Curve
    shear: str
    reference_centres: tuple[float, ...] | None = None

    def at(self, position: np.ndarray) -> np.ndarray:
        """Displacement, px, at `position`: 0 at the shortest wavelength, `reference_bands` at the longest."""
        if not isinstance(self.law, tuple):
            return self.law * (position - 0.5)
        displaced = interpolate(self.law, self.wavelength_at(np.append(0.5, position)))
        return displaced[1:] - displaced[0]

    def wavelength_at(self, position: np.ndarray) -> np.ndarray:
        """Wavelength, nm, at `position`; bands that are not even are even about their centres, and straight between them."""
        if self.reference_centres is None:
            low, high = self.wavelengths
            return low + (high - low) * position / self.reference_bands
        centres = np.array(self.reference_centres)
        k = np.clip(np.floor(position - 0.5).astype(int), 0, len(centres) - 2)
        return centres[k] + (centres[k + 1] - centres[k]) * (position - 0.5 - k)

    @property
    def band_centres(self) -> np.ndarray:
        """(band,) nm."""
        return self.wavelength_at((np.arange(self.bands) + 0.5) * (self.reference_bands / self.bands))

    @cached_property
    def edges(self) -> np.ndarray:
        """(band + 1,) px; displacements of the bands' edges."""
        return self.at(np.arange(self.bands + 1) * (self.reference_bands / self.bands))

    @cached_property
    def centres(self) -> np.ndarray:
        """(band,) px; displacements of the bands' centres."""
        return self.at((np.arange(self.bands) + 0.5) * (self.reference_bands / self.bands))

    @cached_property
    def extra_columns(self) -> int:
        """Columns that the detector (or the code) has more than the scene."""
        last = self.at(np.array([self.reference_bands - 0.5]))[0]
        return math.ceil(last - ROUNDING)

    @property
    def whole_step(self) -> int | None:
        """Pixels from one band to the next if every voxel falls on one pixel, evenly spaced from 0; else None."""
        step = round(self.centres[-1]) // max(self.bands - 1, 1)
        even = np.abs(self.centres - step * np.arange(self.bands)).max() < ROUNDING
        return step if self.shear == "centre" and even else None

    @cached_property
    def footprints(self) -> Footprints:
        """Pixels under the voxels of each band."""
        exact = self.shear == "exact"
        start = self.edges[:-1] if exact else self.centres
        spread = np.diff(self.edges) if exact else np.zeros(self.bands)
        first = np.floor(start + ROUNDING)
        reach = math.ceil((start - first + 1 + spread).max() - ROUNDING)
        cuts = (first - start)[:, None] + np.arange(reach + 1)
        # A convolution is symmetric. The band's spread varies and can be 0, which `share_below` takes as its `width`, kept off 0/0.
        below = share_below(cuts, np.maximum(spread, np.finfo(float).tiny)[:, None], 1.0)
        # What rounding leaves outside belongs to the pixels at the ends.
        below[:, 0], below[:, -1] = 0, 1
        # Rounding can leave a share of -1e-17, which no transmittance has.
        return Footprints(first.astype(np.int64), np.maximum(np.diff(below), 0))

    def vignetted(self, columns: int) -> tuple[float, ...]:
        """Share of each band's light that misses a detector (or a code) `extra_columns` wider than the scene of `columns`."""
        pixel = self.footprints.first[:, None] + np.arange(self.footprints.weights.shape[1])
        # Voxels 0 ≤ x < columns that fall on 0 ≤ x + pixel < columns + extra.
        inside = np.minimum(columns, columns + self.extra_columns - pixel) - np.maximum(0, -pixel)
        lost = 1 - (self.footprints.weights * np.clip(inside, 0, columns)).sum(axis=1) / columns
        return tuple(float(share) if share > ROUNDING else 0.0 for share in lost)


def smeared_code(code: np.ndarray, footprints: Footprints, band: int, columns: int) -> np.ndarray:
    """Mean transmittance that the voxels of a band see in a code (shot, y, x): (shot, y, `columns`); outside, it is closed."""
    first, weights = int(footprints.first[band]), footprints.weights[band]
    seen = np.zeros((*code.shape[:-1], columns + len(weights) - 1))
    left, right = max(first, 0), min(first + seen.shape[-1], code.shape[-1])
    if left < right:
        seen[..., left - first : right - first] = code[..., left:right]
    return sum((w * seen[..., j : j + columns] for j, w in enumerate(weights)), np.zeros(()))


def interpolate(curve: Curve, nm: np.ndarray) -> np.ndarray:
    """Displacement at wavelengths `nm`: a monotone cubic between the points, straight lines beyond the ends.

    At an end the slope is at least a third of that between the last two points: the usual formula can make it 0, and the line
    beyond would put all wavelengths on one pixel.

    Notes
    -----
    Source: Fritsch and Butland, SIAM J. Sci. Stat. Comput. 5 (1984) 300, for the slopes inside.
    """
    from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

    wavelength, displaced = np.array(curve).T
    slopes = PchipInterpolator(wavelength, displaced).derivative()(wavelength)
    secants = np.diff(displaced) / np.diff(wavelength)
    slopes[[0, -1]] = first, last = np.maximum(slopes[[0, -1]], secants[[0, -1]] / 3)
    cubic = CubicHermiteSpline(wavelength, displaced, slopes)
    below, above = np.minimum(nm - wavelength[0], 0), np.maximum(nm - wavelength[-1], 0)
    return cubic(nm - below - above) + first * below + last * above


def check_band_shift(band_shift: object) -> float:
    """Return the shift as a number of Python's own, or raise unless it is positive."""
    if (
        isinstance(band_shift, bool)
        or not isinstance(band_shift, int | float | np.integer | np.floating)
        or not 0 < band_shift <= MOST
    ):
        raise ValueError(
            f"band_shift must be a positive number of pixels a band, at most {MOST}, got {shortened(band_shift)}"
        )
    return int(band_shift) if isinstance(band_shift, int | np.integer) else float(band_shift)


def check_curve(curve: object, wavelengths: tuple[float, float]) -> Curve:
    """Return a dispersion curve as pairs of floats, or say what is wrong with it for an imager of these wavelengths."""
    points = _pairs(curve)
    for (nm, px), (next_nm, next_px) in pairwise(points):
        if next_nm - nm < ROUNDING:
            raise ValueError(
                f"the wavelengths of dispersion must ascend, got {next_nm:g} nm after {nm:g} nm: sort the pairs"
            )
        if next_px - px < ROUNDING:
            mirrored = points[-1][1] < points[0][1]
            raise ValueError(
                f"the displacements of dispersion must increase with wavelength, got {next_px:g} px at {next_nm:g} nm after"
                f" {px:g} px at {nm:g} nm: "
                + (
                    "mirror the images and change the signs"
                    if mirrored
                    else "measure these points again or leave one out"
                )
            )
    _check_pixels(points[-1][1] - points[0][1])
    low, high = points[0][0], points[-1][0]
    margin = (high - low) / 2
    if wavelengths[0] < low - margin or wavelengths[1] > high + margin:
        raise ValueError(
            f"dispersion from {low:g} to {high:g} nm can be extended to {low - margin:g} to {high + margin:g} nm, which does not"
            f" hold the imager's {wavelengths[0]:g} to {wavelengths[1]:g} nm: measure it over a wider range"
        )
    return points


def _pairs(curve: object) -> Curve:
    wanted = "dispersion must be at least two pairs (wavelength nm, displacement px) of finite numbers"
    if not isinstance(curve, Sequence | np.ndarray) or len(curve) < 2:
        raise ValueError(f"{wanted}, got {shortened(curve)}")
    try:
        points = tuple((float(nm), float(px)) for nm, px in curve)
    except (TypeError, ValueError):
        raise ValueError(f"{wanted}, got {shortened(curve)}") from None
    for point in points:
        if not all(map(math.isfinite, point)):
            raise ValueError(f"{wanted}, got {point}")
    return points


def check_span(dispersion: Dispersion) -> None:
    """Raise if there are absurdly many bands, or they are spread absurdly wide."""
    if dispersion.bands > MOST:
        raise ValueError(f"cube_shape has {dispersion.bands} bands, more than {MOST}")
    shortest, longest = dispersion.at(np.array([0.0, dispersion.reference_bands]))
    _check_pixels(longest - shortest)


def _check_pixels(span: float) -> None:
    if span > MOST:
        raise ValueError(
            f"this dispersion spreads the spectrum over {span:.4g} pixels, more than {MOST}:"
            " check band_shift or dispersion, which are in pixels"
        )
