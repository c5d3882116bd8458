"""What a spectral imager resolves, as a value."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SUPER_RESOLVING = "super-resolving"
DETECTOR_LIMITED = "detector-limited"


@dataclass(frozen=True, kw_only=True)
class Resolution:
    """Resolution limits and the datacube that an imager can recover.

    Attributes
    ----------
    regime : ``"super-resolving"`` (stretched code pitch Δc/(1−s) ≤ detector pitch Δd) or ``"detector-limited"``.
    cube_shape : (band, y, x) of the recoverable datacube.
    band_width : nm; bound on the spectral resolution, Δλ = Δc/(sα).
    x_pitch, y_pitch : µm; spatial resolution along and across the dispersion, on the detector.
    first_wavelength : nm; lower edge of band 0.
    vignetted : (band,) share of each band's light that misses the mask, 0 = none.

    Notes
    -----
    Source: Salazar (2022), tables 2.1 and 2.2, eqs. (2.17), (2.20), (2.24).
    """

    regime: str
    cube_shape: tuple[int, int, int]
    band_width: float
    x_pitch: float
    y_pitch: float
    first_wavelength: float
    vignetted: tuple[float, ...]

    @property
    def bands(self) -> int:
        """Number of bands."""
        return self.cube_shape[0]

    @property
    def band_edges(self) -> np.ndarray:
        """(bands + 1,) nm; band k lies between edges k and k + 1."""
        return self.first_wavelength + self.band_width * np.arange(self.bands + 1)

    @property
    def wavelengths(self) -> np.ndarray:
        """(band,) nm; centres of the bands."""
        return self.band_edges[:-1] + self.band_width / 2
