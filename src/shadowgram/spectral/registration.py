"""What captures say about the camera: whether a calibration still holds, where the mask stands, what it resolves.

- `misregistration`: shift between a calibration and later captures.
- `estimate_geometry`: mask position, dispersion and alignment, from captures of a white scene and the design of the mask.
- `measured_resolution`: width of the resolvable bands, from captures of a white scene alone.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from shadowgram.codes.patterns import check_code

from . import _registration_geometry as _placement
from . import _registration_shift as _shift
from ._checks import check_count
from ._registration_resolution import MeasuredResolution, measured_resolution
from ._registration_search import search
from .calibration import band_edges, checked_centres, real_captures
from .sscsi import SSCSI

ACCEPTABLE = 0.1  # px
LIKE = 0.6  # correlation that captures of the code alone reach, and snapshots of a target do not
UNSURE = 0.5  # px
SMALLEST_IMAGE = 32  # px a side
MOST_ROWS = 8  # detector rows by which mask and detector may stand apart
CERTAIN = 5.0  # standard errors by which the mask position must exceed 0

__all__ = [
    "Geometry",
    "MeasuredResolution",
    "Misregistration",
    "estimate_geometry",
    "measured_resolution",
    "misregistration",
]


@dataclass(frozen=True, kw_only=True)
class Misregistration:
    """Shift of images of a code against a reference.

    Attributes
    ----------
    dy, dx : px; the images show the code this much further down and further right than the reference.
    correlation : of the two at this shift, 1 for images of the same code alone.
    correlation_at_zero : as they lie.
    """

    dy: float
    dx: float
    correlation: float
    correlation_at_zero: float

    @property
    def shift(self) -> float:
        """Length of the shift, px."""
        return math.hypot(self.dy, self.dx)

    @property
    def acceptable(self) -> bool:
        """Whether the shift is below 0.1 px, at which a reconstruction is 1 to 4 dB worse (see `misregistration`)."""
        return self.shift < ACCEPTABLE

    def __str__(self) -> str:
        moved = f"the code is {self.dy:+z.2f} px down and {self.dx:+z.2f} px right of where it was calibrated"
        if self.acceptable:
            return f"The calibration holds: {moved}, less than {ACCEPTABLE:g} px."
        if self.correlation < LIKE and self.shift < UNSURE:
            return (
                f"It seems that {moved}; but a correlation of {self.correlation:.2f} is that of a target's snapshots, which give"
                f" the shift to about {UNSURE:g} px: check with a white capture."
            )
        return f"The calibration no longer holds: {moved}, {ACCEPTABLE:g} px or more; calibrate again."


def misregistration(reference: ArrayLike, images: ArrayLike, *, window: int = 8) -> Misregistration:
    """By how much images of a code are shifted against a reference.

    Parameters
    ----------
    reference : (…, y, x), such as the code of a calibration (shot, band, y, x), or `code.sum(axis=1)`.
    images : of the same shape; later white captures, dark subtracted, or the snapshots of a target (shot, y, x).
    window : px; largest shift looked for, along each axis.

    Returns
    -------
    Misregistration

    Raises
    ------
    TypeError
        If the images are not real numbers.
    ValueError
        If the shapes differ, the images are smaller than 32 px or 4 windows a side, a value is not finite, or the images do not
        show the code of the reference within the window: their correlation is nowhere above chance.

    Notes
    -----
    Both are divided by their mean over 15 × 15 pixels, which takes out most of the scene and the lamp, and cross-correlated; the
    shift is the maximum of the correlation after smoothing with a Gaussian of 2 px. White captures of 64 × 64 px and more, with
    30 dB of noise, gave it to 0.02 px. Snapshots of a target show the scene as well, and its spectrum decides how the codes of
    the bands add up: there errors reached 0.4 px on 128 × 128 and 0.3 on 256 × 256. They tell that something has moved
    far, white captures by how much.

    What a shift costs, PSNR of EigenTV in dB on a generated scene of 128 × 128 (smallest and largest loss over x and y, sharp and
    blurred masks, 12, 6 and 3 bands with 4, 3 and 2 shots): at 30 dB SNR 0.3–1.6 for 0.05 px, 1.5–4.4 for 0.1, 5.5–12 for
    0.25, 10–17 for 0.5; without noise 0.1 px costs 3.6–9.9. Hence the 0.1 px of `acceptable`.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> code = sg.codes.boolean(shots=2, shape=(64, 64), seed=0)
    >>> found = sg.spectral.misregistration(code, np.roll(code, 1, axis=2))
    >>> round(found.dx, 1), found.acceptable
    (1.0, False)
    """
    check_count("window", window)
    a, b = _stack("the reference", reference), _stack("the images", images)
    if a.shape != b.shape:
        hint = "; sum the code over its bands, code.sum(axis=1)" if a.ndim == 4 and b.ndim == 3 else ""
        raise ValueError(f"reference and images must have one shape, got {a.shape} and {b.shape}{hint}")
    least = max(SMALLEST_IMAGE, 4 * window)
    if min(a.shape[-2:]) < least:
        raise ValueError(
            f"images must have {least} px a side or more for a window of {window}, got {a.shape[-2]} × {a.shape[-1]}"
        )
    a, b = _shift.local_contrast(a), _shift.local_contrast(b)
    lag = window + _shift.MARGIN
    found = _shift.locate(a, b, lag, lag)
    if found is None or max(map(abs, found)) > window:
        raise ValueError(
            f"the images do not show the code of the reference within {window} px: check that code and shots belong together,"
            " or take a larger window"
        )
    return Misregistration(
        dy=found[0],
        dx=found[1],
        correlation=_shift.similarity(a, b, *found),
        correlation_at_zero=_shift.similarity(a, b, 0.0, 0.0),
    )


def _stack(name: str, images: ArrayLike) -> np.ndarray:
    array = np.asarray(images)
    if array.ndim < 2:
        raise ValueError(f"{name} must have the axes (…, y, x), got an array of shape {array.shape}")
    return real_captures(name, array, ("…",) * (array.ndim - 2) + ("y", "x"))


@dataclass(frozen=True, kw_only=True, eq=False)
class Geometry:
    """Where the mask of an SSCSI stands and how the light is dispersed over it, by captures of a white scene.

    A detector element m of band k sees the code from o + m w to o + (m + 1) w code columns, with o = dx + shear[k] and
    w = (1 − s) Δd/Δc; element n of a column sees the code rows from (n + dy) Δd/Δc. Errors are standard errors, by the scatter
    between parts of the captures; the model itself is good to about 0.001 rows and columns.

    Attributes
    ----------
    wavelengths : (band,) nm.
    code_columns, pitch_ratio : of the code; its elements per detector element.
    mask_position, mask_position_error : s.
    dy, dy_error : detector rows.
    dx, dx_error : code columns; for the shortest wavelength.
    shear, shear_error : (band,) code columns, against the shortest wavelength. NaN for bands that do not show the code.
    dispersion, dispersion_error : code columns per nm, of a line fitted to the shear.
    nonlinearity : (band,) code columns; shear less the line.
    dispersion_ratio, dispersion_ratio_error : β, for the range of the wavelengths with half a band on each side. NaN if the mask
        position is not above 0 by 5 of its errors: on the detector nothing shows the dispersion.
    blur : (y, x) code elements; standard deviation of the blur of the mask's image by lens, faults and, along x, the width of the
        captured bands. Below about 0.15 nothing is told apart.
    correlation : (band,) of the captures and the model, 0 for bands that do not show the code.
    """

    wavelengths: np.ndarray
    code_columns: int
    pitch_ratio: int
    mask_position: float
    mask_position_error: float
    dy: float
    dy_error: float
    dx: float
    dx_error: float
    shear: np.ndarray
    shear_error: np.ndarray
    dispersion: float
    dispersion_error: float
    nonlinearity: np.ndarray
    dispersion_ratio: float
    dispersion_ratio_error: float
    blur: tuple[float, float]
    correlation: np.ndarray

    def off_centre(self, wavelengths: tuple[float, float]) -> float:
        """Code columns by which the detector looks further right than in an `SSCSI` of these wavelengths.

        Its mask is centred on the optical axis, where the middle of (shortest, longest) nm arrives.
        """
        middle = self.dispersion * (sum(wavelengths) / 2 - self.wavelengths[0])
        return self.dx + middle - self.mask_position * self.code_columns / 2

    def imager(self, template: SSCSI) -> SSCSI:
        """`template` with the mask position and the dispersion ratio found here.

        An `SSCSI` has its mask centred and aligned: what `dy` and `off_centre` say has to be put right on the bench, or in the
        code; or reconstruct with the calibration itself.

        Raises
        ------
        ValueError
            If the template has another code, or there is no dispersion ratio that it could take.
        """
        if template.code_shape[1] != self.code_columns or template.pitch_ratio != self.pitch_ratio:
            raise ValueError(
                f"the template's code has {template.code_shape[1]} columns, {template.pitch_ratio} a detector element;"
                f" the captured one has {self.code_columns}, {self.pitch_ratio} a detector element"
            )
        if math.isnan(self.dispersion_ratio):
            raise ValueError(
                f"the mask position, {self.mask_position:.2g} ± {self.mask_position_error:.1g}, is not clearly above 0, so that"
                " there is no dispersion ratio to take"
            )
        if self.dispersion_ratio <= 0:
            raise ValueError(
                "longer wavelengths see the code further left, and in an SSCSI further right: mirror captures and code along x"
            )
        low, high = template.wavelengths
        return dataclasses.replace(
            template,
            mask_position=self.mask_position,
            dispersion_ratio=self.dispersion * (high - low) / (self.mask_position * self.code_columns),
        )

    def __str__(self) -> str:
        seen = int(np.count_nonzero(self.correlation))
        edges = float(band_edges(self.wavelengths)[0]), float(band_edges(self.wavelengths)[-1])
        lines = {
            "mask position": f"{self.mask_position:.6f} ± {self.mask_position_error:.1g}",
            "alignment": f"{self.dy:+z.3f} ± {self.dy_error:.1g} detector rows,"
            f" {self.off_centre(edges):+z.3f} code columns off centre",
            "first column": f"{self.dx:+z.3f} ± {self.dx_error:.1g}, seen by the shortest wavelength",
            "dispersion": f"{self.dispersion:.5g} ± {self.dispersion_error:.2g} code columns per nm",
            "nonlinearity": f"{np.nanmax(np.abs(self.nonlinearity)):.3f} code columns at most",
            "dispersion ratio": f"{self.dispersion_ratio:.4g} ± {self.dispersion_ratio_error:.2g}",
            "blur": f"{self.blur[0]:.2f} × {self.blur[1]:.2f} code elements (y × x, standard deviation)",
            "bands": f"{seen} of {len(self.wavelengths)} show the code",
        }
        return "\n".join(f"{name:<17}{text}" for name, text in lines.items())


def estimate_geometry(
    white: ArrayLike, code: np.ndarray, *, wavelengths: Sequence[float], pitch_ratio: int = 1
) -> Geometry:
    """Mask position, alignment and dispersion of an SSCSI, from captures of a white scene and the design of the mask.

    Parameters
    ----------
    white : (shot, band, y, x) captures of a white board, one a band and shot, dark subtracted; `Calibration.code` will do.
    code : (shot, y, x) transmittance of the mask as designed, in [0, 1].
    wavelengths : (band,) nm, ascending; centres of the captured bands.
    pitch_ratio : code elements per detector element, Δd/Δc.

    Returns
    -------
    Geometry

    Raises
    ------
    TypeError
        If the captures are not real numbers.
    ValueError
        If captures and code do not fit together, or the captures do not show the code with a mask position up to 0.5 and the
        mask within 8 detector rows of its place.

    Notes
    -----
    Model: the mean of the code over the detector element, through a Gaussian blur, with a gain of its own for each block of an
    eighth of the detector's columns in each band. What is smooth over 17 rows is taken out of both first. The places of the blocks
    are found by cross-correlation over rows and shots, then by Gauss-Newton, and their scatter about one mask position and one
    offset a band gives the errors. Rows of mask and detector are taken as parallel.

    Simulated captures of 128 × 128 with 30 dB of noise and blurs of 0.5 to 1.2 code elements gave s to 4e-5 and shears to 0.007
    columns. Without blur and noise, with the mask almost on the detector, edges are sharper than the model can follow: s to 1e-4,
    shears to 0.01. A band with 2 % of the strongest one's light gave its shear to 0.02. Bands up to 5 code columns wide did no
    harm; with bands 10 columns wide, whose patterns are nearly washed out, shears were wrong by 0.3 and their errors said 0.06.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> imager = sg.SSCSI(detector_shape=(64, 64), detector_pitch=10.0, code_pitch=10.0, mask_position=0.1,
    ...                   wavelengths=(450, 650))
    >>> code = sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0)
    >>> white = imager.effective_code(code)
    >>> geometry = sg.spectral.estimate_geometry(white, code, wavelengths=imager.resolution.wavelengths)
    >>> round(geometry.mask_position, 3), geometry.shear.round(1)
    (0.1, array([0., 1., 2., 3., 4., 5., 6.]))
    """
    values = real_captures("the white captures", white, ("shot", "band", "y", "x"))
    centres = np.array(checked_centres(wavelengths, values.shape[1]))
    check_count("pitch_ratio", pitch_ratio)
    design = np.asarray(code)
    if design.ndim != 3 or len(design) != len(values) or 0 in design.shape:
        raise ValueError(
            f"code must be (shot, y, x) with the {len(values)} shots of the captures, got shape {design.shape}"
        )
    design = check_code(design, design.shape[1:])
    captures = _placement.captures_of(values, design, pitch_ratio)
    fit = _placement.refine(captures, search(captures, MOST_ROWS))
    return _geometry_of(fit, centres, design.shape[2], pitch_ratio)


def _geometry_of(fit: _placement.Fit, wavelengths: np.ndarray, code_columns: int, ratio: int) -> Geometry:
    used, offsets, covariance = fit.used, fit.placement.offsets, fit.covariance
    if len(used) < 2:
        raise ValueError(f"only the band at {wavelengths[used[0]]:g} nm shows the code: dispersion takes at least two")
    line, weights, excess = _line(wavelengths[used] - wavelengths[0], offsets[used], covariance[:-1, :-1])
    # Against the first band where it shows the code, else against the line's beginning.
    beginning = np.eye(len(used))[0] if used[0] == 0 else weights[0]
    dx = float(beginning @ offsets[used])
    shear, shear_error = np.full((2, len(wavelengths)), np.nan)
    shear[used] = offsets[used] - dx
    shear_error[used] = _errors(np.eye(len(used)) - beginning, covariance[:-1, :-1])
    # The line and s together: rows of functionals of (offsets, s).
    pair = np.zeros((2, len(covariance)))
    pair[0, :-1], pair[1, -1] = excess * weights[1], 1
    slope_and_s = pair @ covariance @ pair.T
    beta, beta_error = _dispersion_ratio(line[1], fit.placement.mask_position, slope_and_s, wavelengths, code_columns)
    return Geometry(
        wavelengths=wavelengths,
        code_columns=code_columns,
        pitch_ratio=ratio,
        mask_position=fit.placement.mask_position,
        mask_position_error=math.sqrt(slope_and_s[1, 1]),
        dy=fit.placement.dy,
        dy_error=fit.dy_error,
        dx=dx,
        dx_error=float(_errors(beginning[None], covariance[:-1, :-1])[0]),
        shear=shear,
        shear_error=shear_error,
        dispersion=float(line[1]),
        dispersion_error=math.sqrt(slope_and_s[0, 0]),
        nonlinearity=offsets - (line[0] + line[1] * (wavelengths - wavelengths[0])),
        dispersion_ratio=beta,
        dispersion_ratio_error=beta_error,
        blur=(math.sqrt(fit.placement.blur[0]), math.sqrt(fit.placement.blur[1])),
        correlation=fit.correlation,
    )


def _dispersion_ratio(
    slope: float, s: float, covariance: np.ndarray, wavelengths: np.ndarray, code_columns: int
) -> tuple[float, float]:
    """β and its standard error, by the covariance (2, 2) of slope and s; NaN where s is not clearly above 0."""
    if not s > CERTAIN * math.sqrt(covariance[1, 1]):
        return math.nan, math.nan
    edges = band_edges(wavelengths)
    columns_per_slope = float(edges[-1] - edges[0]) / (s * code_columns)
    gradient = columns_per_slope * np.array([1, -slope / s])
    return float(slope * columns_per_slope), math.sqrt(float(gradient @ covariance @ gradient))


def _errors(functionals: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    return np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", functionals, covariance, functionals), 0))


def _line(x: np.ndarray, y: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """(intercept, slope) by generalised least squares; what each y weighs in them; how much more y scatters than expected."""
    design = np.stack([np.ones_like(x), x], axis=1)
    # No offset is known better than this: without noise the covariance is that of rounding.
    precision = np.linalg.inv(covariance + 1e-8 * np.eye(len(x)))
    weights = np.linalg.solve(design.T @ precision @ design, design.T @ precision)
    line = weights @ y
    left = y - design @ line
    scatter = float(left @ precision @ left) / max(1, len(x) - 2)
    return line, weights, math.sqrt(max(1.0, scatter))
