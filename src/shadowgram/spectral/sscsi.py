"""The spatial-spectral compressive spectral imager (SSCSI): a mask between the spectral plane and the detector.

======================  ==================  =====================================================================
symbol (Salazar 2022)   name                meaning, unit
======================  ==================  =====================================================================
s                       mask_position       0 = on the detector, 1 = on the spectral plane
Δc, Δd                  code_pitch,         side of a code and of a detector element, µm; Δd/Δc is a whole number
                        detector_pitch
Nd                      detector_shape      (y, x) elements; the mask has Δd/Δc times as many each way
α                       dispersion          length on the spectral plane per wavelength, µm/nm
β                       dispersion_ratio    length of the spectral plane over the wavelength range ÷ mask width
======================  ==================  =====================================================================

Band k sees the mask shifted by k columns. Models: eq. (2.19) when the stretched code pitch Δc/(1−s) is at most Δd
(super-resolving), else eq. (2.23) (detector-limited); `shear` says how a band's code is averaged (section 2.3.6).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from shadowgram.codes.patterns import check_code

from . import _geometry
from ._checks import check_choice, check_count, check_pitch, check_shape, check_wavelengths
from .resolution import DETECTOR_LIMITED, SUPER_RESOLVING, Resolution

if TYPE_CHECKING:
    from shadowgram.codes._pairs import PairTable

    from ._sscsi_operator import SSCSIOperator

SHEARS = ("exact", "centre", "edge")
MOST_PIECES = 3e7  # code columns times bands, of which the geometry makes tables
MOST_BANDS = 10_000  # far above any spectrometer: a guard against a unit mistaken, before memory runs out


@dataclass(frozen=True, kw_only=True)
class SSCSI:
    """Geometry of a spatial-spectral compressive spectral imager.

    Parameters
    ----------
    detector_shape : (y, x) elements.
    detector_pitch, code_pitch : µm. Their ratio must be a whole number, at least 1.
    mask_position : s in [0, 1).
    wavelengths : (shortest, longest) nm.
    dispersion_ratio : β; the spectral plane is centred on the mask, so with β > 1 both ends of the spectrum miss it.
    shear : ``"exact"``: the mean of the mask over the detector element and the band; ``"edge"``: over the element at the band's
        lower edge, as in eqs. (2.19) and (2.23); ``"centre"``: at the band's centre.
    bands : number of bands. By default as many as the mask position resolves, L = ⌈sβ Nd Δd/Δc⌉ (eq. 2.18), each Δλ = Δc/(sα)
        wide and shifted by exactly one code column. Another number splits the range of `wavelengths` evenly; finely resolved
        bands simulate a measurement of a continuous spectrum.

    Raises
    ------
    ValueError
        If the geometry is impossible.

    Examples
    --------
    >>> import shadowgram as sg
    >>> imager = sg.SSCSI(detector_shape=(64, 64), detector_pitch=10.0, code_pitch=10.0, mask_position=0.125,
    ...                   wavelengths=(450, 650))
    >>> imager.resolution.cube_shape, imager.resolution.band_width, imager.resolution.regime
    ((8, 64, 64), 25.0, 'detector-limited')
    >>> H = imager.operator(sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0))
    >>> H.in_shape, H.out_shape
    ((8, 64, 64), (2, 64, 64))
    """

    detector_shape: tuple[int, int]
    detector_pitch: float
    code_pitch: float
    mask_position: float
    wavelengths: tuple[float, float]
    dispersion_ratio: float = 1.0
    shear: str = "exact"
    bands: int | None = None

    def __post_init__(self) -> None:
        check_shape("detector_shape", self.detector_shape, ("y", "x"))
        check_pitch("detector_pitch", self.detector_pitch)
        check_pitch("code_pitch", self.code_pitch)
        ratio = self.detector_pitch / self.code_pitch
        if not (ratio > 0.999 and abs(ratio - round(ratio)) < 1e-6 * ratio):
            raise ValueError(
                f"detector_pitch must be a whole multiple of code_pitch, got {self.detector_pitch:g}/{self.code_pitch:g}"
                f" = {ratio:.6g}; group detector elements or choose another mask"
            )
        if not 0 <= self.mask_position < 1:
            raise ValueError(
                "mask_position must lie in [0, 1), from the detector (0) towards the spectral plane (1),"
                f" got {self.mask_position}"
            )
        check_wavelengths(self.wavelengths)
        if not (math.isfinite(self.dispersion_ratio) and self.dispersion_ratio > 0):
            raise ValueError(f"dispersion_ratio must be a positive number, got {self.dispersion_ratio}")
        check_choice("shear", self.shear, SHEARS)
        if self.bands is not None:
            check_count("bands", self.bands)
        if max(self.spectral_columns, self.bands or 0) > MOST_BANDS:
            raise ValueError(
                f"this geometry has {max(self.spectral_columns, self.bands or 0):.4g} bands, more than {MOST_BANDS};"
                " check mask_position, dispersion_ratio and bands"
            )
        if self.code_shape[1] * max(self.spectral_columns, self.bands or 1) > MOST_PIECES:
            raise ValueError(
                f"{self.code_shape[1]} code columns times {max(self.spectral_columns, self.bands or 1):.4g} bands are more than"
                f" {MOST_PIECES:.2g}: check detector_shape, mask_position and bands"
            )

    @property
    def pitch_ratio(self) -> int:
        """Code elements per detector element, each way: Δd/Δc."""
        return round(self.detector_pitch / self.code_pitch)

    @property
    def code_shape(self) -> tuple[int, int]:
        """(y, x) elements of the coded aperture."""
        ny, nx = self.detector_shape
        return ny * self.pitch_ratio, nx * self.pitch_ratio

    @property
    def dispersion(self) -> float:
        """α, µm on the spectral plane per nm (eq. 2.18)."""
        low, high = self.wavelengths
        return self.dispersion_ratio * self.code_shape[1] * self.code_pitch / (high - low)

    @property
    def shift_per_band(self) -> float:
        """Code columns by which the mask moves from one band to the next: 1 unless `bands` is given or not even one is resolved."""
        return min(1.0, self.spectral_columns) if self.bands is None else self.spectral_columns / self.bands

    @property
    def spectral_columns(self) -> float:
        """Length of the wavelength range at the mask, in code columns: sβNc."""
        return self.mask_position * self.dispersion_ratio * self.code_shape[1]

    @property
    def mask_offset(self) -> float:
        """Code column at which the detector's left end sees the shortest wavelength.

        The spectral plane is centred on the mask: its blue end stands (1 − β)/2 mask widths from the mask's left end.
        """
        return self.mask_position * self.code_shape[1] * (1 - self.dispersion_ratio) / 2

    @cached_property
    def _pieces(self) -> _geometry.Pieces:
        elements = self.detector_shape[1]
        width = self.pitch_ratio * (1 - self.mask_position)
        if width >= 1 - _geometry.ROUNDING:
            return _geometry.super_resolving_pieces(elements, width, self.mask_offset)
        return _geometry.detector_limited_pieces(elements, width, self.mask_offset)

    @cached_property
    def _table(self) -> _geometry.ColumnTable:
        return _geometry.column_table(self._pieces, self.resolution.bands, self.shift_per_band, self.shear)

    @cached_property
    def resolution(self) -> Resolution:
        """Resolution limits and the recoverable datacube, `shadowgram.spectral.resolution.Resolution`."""
        low, high = self.wavelengths
        super_resolving = self.pitch_ratio * (1 - self.mask_position) >= 1 - _geometry.ROUNDING
        columns = self.spectral_columns
        if self.bands is not None:
            bands, width = self.bands, (high - low) / self.bands
        else:
            bands = max(1, math.ceil(columns - _geometry.ROUNDING))
            # Below one column nothing is resolved: the single band is the whole range.
            width = (high - low) / max(columns, 1.0)
        table = _geometry.column_table(self._pieces, bands, self.shift_per_band, self.shear)
        missed = _geometry.light_missed(table, self.code_shape[1])
        return Resolution(
            regime=SUPER_RESOLVING if super_resolving else DETECTOR_LIMITED,
            cube_shape=(bands, self.code_shape[0], self._pieces.columns),
            band_width=width,
            spectral_extents=self._spectral_extents,
            x_pitch=self.code_pitch / (1 - self.mask_position) if super_resolving else self.detector_pitch,
            y_pitch=self.code_pitch,
            first_wavelength=float(low),
            vignetted=tuple(float(m) if m > 1e-9 else 0.0 for m in missed),
        )

    @property
    def _spectral_extents(self) -> tuple[float, float]:
        """Wavelengths, nm, for which a code column is partly and wholly on a detector element (table 2.2, either regime)."""
        per_nm = self.mask_position * self.dispersion
        if per_nm == 0:
            return math.inf, math.inf
        element = self.detector_pitch * (1 - self.mask_position)
        return min(self.code_pitch, element) / per_nm, abs(self.code_pitch - element) / per_nm

    def effective_code(self, code: np.ndarray) -> np.ndarray:
        """Transmittance that each voxel of the datacube sees, t̂, in the detector-limited regime.

        Parameters
        ----------
        code : (shot, y, x) of `code_shape`, transmittance in [0, 1].

        Returns
        -------
        (shot, band, y, x) float64 array.

        Raises
        ------
        ValueError
            If the code does not fit, or the imager is super-resolving: there a voxel can fall on two detector elements and sees
            the mask differently in each.
        """
        if self.resolution.regime != DETECTOR_LIMITED:
            raise ValueError(
                "effective_code is defined in the detector-limited regime, Δc/(1−s) > Δd; this imager is super-resolving:"
                " use operator(code)"
            )
        code = check_code(code, self.code_shape)
        reach, bands, columns = self._table.weights.shape
        padded = np.pad(code, ((0, 0), (0, 0), (1, 1)))
        effective = np.zeros((len(code), bands, code.shape[1], columns))
        for j in range(reach):
            # Columns outside the code, to either side, read the closed element added there.
            column = np.clip(self._table.first + j + 1, 0, padded.shape[2] - 1)
            effective += self._table.weights[j][:, None] * padded[:, :, column].transpose(0, 2, 1, 3)
        return effective

    def pair_table(self) -> PairTable:
        """What the voxels of a row see of the code, for `shadowgram.codes.design`.

        Raises
        ------
        ValueError
            If a voxel sees more than three code columns.
        """
        from shadowgram.codes._pairs import pair_table

        table, bands = self._table, self.resolution.bands
        weights = np.broadcast_to(table.weights, (len(table.weights), bands, len(self._pieces.start)))
        first = np.broadcast_to(table.first, weights.shape[1:])
        return pair_table(
            first.astype(np.int64),
            weights,
            self._pieces.voxel,
            self._pieces.detector,
            self.pitch_ratio,
            self.code_shape,
        )

    def operator(self, code: np.ndarray) -> SSCSIOperator:
        """Forward model of this imager with `code`: datacube (band, y, x) → snapshots (shot, y, x).

        Parameters
        ----------
        code : (shot, y, x) of `code_shape`, transmittance in [0, 1]. Binary codes (0 and 1) are much faster than gray ones.

        Raises
        ------
        ValueError
            If the code does not fit.
        """
        from ._sscsi_operator import SSCSIOperator

        return SSCSIOperator(self, check_code(code, self.code_shape))
