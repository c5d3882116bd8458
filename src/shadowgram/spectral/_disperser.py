"""What all kinds of CASSI share: the datacube, and how far the disperser displaces each of its bands."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import Self, cast

import numpy as np

from ._checks import check_choice, check_count, check_pitch, check_shape, check_wavelengths
from ._dispersion import SHEARS, Dispersion, check_band_shift, check_curve, check_span
from .calibration import CalibratedResolution, band_edges, checked_centres
from .resolution import DETECTOR_LIMITED, Resolution


@dataclass(frozen=True, kw_only=True)
class Disperser:
    """Datacube and dispersion of a CASSI of any kind; its subclasses say where the code is, and are what can be used.

    Parameters and errors as documented for `CASSI`.
    """

    cube_shape: tuple[int, int, int]
    wavelengths: tuple[float, float] = cast("tuple[float, float]", None)  # that of `band_centres`, once made
    pitch: float = 10.0
    band_shift: float | None = None
    shear: str = "centre"
    dispersion: tuple[tuple[float, float], ...] | None = None
    reference_bands: int | None = None
    band_centres: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        check_shape("cube_shape", self.cube_shape, ("band", "y", "x"))
        check_pitch("pitch", self.pitch)
        check_choice("shear", self.shear, SHEARS)
        if self.reference_bands is not None:
            check_count("reference_bands", self.reference_bands)
        self._take_wavelengths()
        if self.dispersion is None:
            shift = check_band_shift(1.0 if self.band_shift is None else self.band_shift)
            object.__setattr__(self, "band_shift", shift)
        elif self.band_shift is None:
            object.__setattr__(self, "dispersion", check_curve(self.dispersion, self.wavelengths))
        else:
            raise ValueError(
                "give band_shift or dispersion, not both: set band_shift to None when there is a measured curve"
            )
        check_span(self._dispersion)

    def _take_wavelengths(self) -> None:
        """Check the range, or set it to that of the bands' centres."""
        if self.band_centres is None:
            if self.wavelengths is None:
                raise ValueError("say wavelengths, (shortest, longest) in nm, or band_centres, one wavelength a band")
            check_wavelengths(self.wavelengths)
            return
        centres = checked_centres(self.band_centres, self.reference_bands or self.cube_shape[0])
        edges = band_edges(centres)
        outer = float(edges[0]), float(edges[-1])
        if self.wavelengths is not None and not np.allclose(self.wavelengths, outer, rtol=1e-9, atol=0):
            raise ValueError(
                f"bands with these centres reach from {outer[0]:g} to {outer[1]:g} nm, and wavelengths says"
                f" {tuple(self.wavelengths)}: leave wavelengths out"
            )
        object.__setattr__(self, "band_centres", centres)
        object.__setattr__(self, "wavelengths", outer)

    @cached_property
    def _dispersion(self) -> Dispersion:
        bands = self.cube_shape[0]
        return Dispersion(
            wavelengths=self.wavelengths,
            bands=bands,
            reference_bands=self.reference_bands or bands,
            law=self.dispersion or self.band_shift or 1.0,
            shear=self.shear,
            reference_centres=self.band_centres,
        )

    @property
    def displacements(self) -> np.ndarray:
        """(band,) px; displacement of each band's centre, on the detector or, of a dual disperser, on the code."""
        return self._dispersion.centres

    @property
    def resolution(self) -> Resolution:
        """The datacube and its resolution: every voxel is seen by one pixel; `band_width` is the mean of uneven bands."""
        low, high = self.wavelengths
        bands, ny, nx = self.cube_shape
        width = (high - low) / bands
        even = Resolution(
            regime=DETECTOR_LIMITED,
            cube_shape=(bands, ny, nx),
            band_width=width,
            spectral_extents=(width, width),
            x_pitch=self.pitch,
            y_pitch=self.pitch,
            first_wavelength=float(low),
            vignetted=self._dispersion.vignetted(nx),
        )
        if self.band_centres is None:
            return even
        return CalibratedResolution(**vars(even), centres=tuple(map(float, self._dispersion.band_centres)))

    def finer(self, factor: int) -> Self:
        """Return the same instrument with `factor` times finer bands and the exact shear, to simulate a finely resolved scene.

        Every wavelength keeps its displacement, and the detector (and code) its width. The cube for it holds light in the same
        unit as one for this imager, so its snapshots must be divided by `factor`: a fine band holds its share of the light.
        A colored code has the finer bands too: that of this imager, (shot, band, y, x), repeated along them, as its filters are
        known for these bands only.

        Raises
        ------
        ValueError
            If `factor` is not a positive whole number.

        Examples
        --------
        >>> import numpy as np, shadowgram as sg
        >>> imager = sg.CASSI(cube_shape=(4, 8, 8), wavelengths=(450, 650), shear="exact")
        >>> code = sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0)
        >>> cube = np.random.default_rng(0).random((4, 8, 8))
        >>> fine = imager.finer(5).operator(code).forward(np.repeat(cube, 5, axis=0)) / 5
        >>> np.allclose(fine, imager.operator(code).forward(cube))
        True
        """
        check_count("factor", factor)
        bands, *pixels = self.cube_shape
        return dataclasses.replace(
            self,
            cube_shape=(bands * factor, *pixels),
            shear="exact",
            reference_bands=self.reference_bands or bands,
        )
