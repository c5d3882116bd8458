"""What a spectral imager resolves, as a value; and where the mask of an SSCSI must stand to resolve something given.

Spectral zoom (Salazar 2022, sections 2.3 and 2.6): bands are Δλ = Δc/(sα) wide, so moving the mask away from the detector narrows
them. `SSCSI.resolution` goes from s to Δλ, `position_for` from Δλ to s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .bench import Bench
    from .sscsi import SSCSI

SUPER_RESOLVING = "super-resolving"
DETECTOR_LIMITED = "detector-limited"
LOST = 0.01  # share of a band's light beside the mask from which we say that the band is vignetted
ROUNDING = 1e-9  # relative; ends of a range that were computed are still in it


@dataclass(frozen=True, kw_only=True)
class Resolution:
    """Resolution limits and the datacube that an imager can recover; `print` shows them to people.

    Attributes
    ----------
    regime : ``"super-resolving"`` (stretched code pitch Δc/(1−s) ≤ detector pitch Δd) or ``"detector-limited"``.
    cube_shape : (band, y, x) of the recoverable datacube.
    band_width : nm; bound on the spectral resolution, Δλ = Δc/(sα).
    spectral_extents : nm; the two extents of table 2.2. As the wavelength grows, a code column moves over a detector element. It is
        partly on it, on each side, for min(Δc, Δd(1−s))/(sα), and wholly on it, or all over it, for |Δc − Δd(1−s)|/(sα);
        `band_width` bounds both unless Δd(1−s) > 2Δc. Infinite where nothing moves, s = 0. Other imagers: `band_width` twice.
    x_pitch, y_pitch : µm; spatial resolution along and across the dispersion, on the detector.
    first_wavelength : nm; lower edge of band 0.
    vignetted : (band,) share of each band's light that misses the mask, 0 = none.

    Notes
    -----
    Source: Salazar (2022), tables 2.1 and 2.2, eqs. (2.17), (2.20), (2.24).

    Examples
    --------
    >>> import shadowgram as sg
    >>> imager = sg.SSCSI(detector_shape=(64, 64), detector_pitch=20.0, code_pitch=10.0, mask_position=0.25,
    ...                   wavelengths=(450, 650), dispersion_ratio=1.5)
    >>> print(imager.resolution)
    regime         super-resolving
    datacube       48 bands × 128 × 96 (y × x)
    bands          4.167 nm wide, from 450 to 650 nm; extents 4.167 and 2.083 nm
    pitch          13.33 × 10 µm (x × y, on the detector)
    throughput     98.6 %; 14 of 48 bands lose more than 1 % beside the mask, up to 7.81 %
    """

    regime: str
    cube_shape: tuple[int, int, int]
    band_width: float
    spectral_extents: tuple[float, float]
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

    @property
    def throughput(self) -> np.ndarray:
        """(band,) share of each band's light that meets the mask, 1 = all; the code then takes its part of that."""
        return 1 - np.array(self.vignetted)

    @property
    def mean_throughput(self) -> float:
        """Mean of `throughput` over the bands."""
        return float(self.throughput.mean())

    @property
    def vignetted_bands(self) -> tuple[int, ...]:
        """Bands that lose more than 1 % of their light beside the mask."""
        return tuple(k for k, share in enumerate(self.vignetted) if share > LOST)

    def __str__(self) -> str:
        bands, ny, nx = self.cube_shape
        edges, extents = self.band_edges, self.spectral_extents
        width = f"{self.band_width:.4g} nm wide, from {edges[0]:.4g} to {edges[-1]:.4g} nm"
        if extents != (self.band_width, self.band_width) and math.isfinite(extents[0]):
            width += f"; extents {extents[0]:.4g} and {extents[1]:.4g} nm"
        light = f"{100 * self.mean_throughput:.3g} %"
        if lost := len(self.vignetted_bands):
            worst = 100 * max(self.vignetted)
            light += f"; {lost} of {bands} bands lose more than {100 * LOST:g} % beside the mask, up to {worst:.3g} %"
        lines = {
            "regime": self.regime,
            "datacube": f"{bands} band{'s' * (bands > 1)} × {ny} × {nx} (y × x)",
            "bands": width,
            "pitch": f"{self.x_pitch:.4g} × {self.y_pitch:.4g} µm (x × y, on the detector)",
            "throughput": light,
        }
        return "\n".join(f"{name:<15}{text}" for name, text in lines.items())


def position_for(camera: SSCSI | Bench, *, band_width: float) -> float:
    """Mask position s at which the bands are `band_width` wide, s = Δc/(α Δλ): spectral zoom.

    Parameters
    ----------
    camera : SSCSI, whose own `mask_position` and `bands` do not matter, or a bench, which reaches some positions only.
    band_width : Δλ, nm.

    Returns
    -------
    float
        s, for ``dataclasses.replace(imager, mask_position=s)`` or ``bench.imager(s)``, whose ``resolution.band_width`` it gives.

    Raises
    ------
    ValueError
        If no position that can be reached gives such bands; the message says which can be had.
    TypeError
        If `camera` is another imager, whose bands do not depend on where a mask stands.

    Examples
    --------
    >>> import dataclasses
    >>> import shadowgram as sg
    >>> imager = sg.SSCSI(detector_shape=(64, 64), detector_pitch=10.0, code_pitch=10.0, mask_position=0,
    ...                   wavelengths=(450, 650))
    >>> s = sg.spectral.position_for(imager, band_width=10.0)
    >>> s, dataclasses.replace(imager, mask_position=s).resolution.bands
    (0.3125, 20)
    """
    if not (math.isfinite(band_width) and band_width > 0):
        raise ValueError(f"band_width must be a positive number of nm, got {band_width}")
    nearest, farthest = _reach(camera)
    low, high = camera.wavelengths
    on_plane = camera.code_pitch / camera.dispersion
    if band_width > (high - low) * (1 + ROUNDING):
        raise ValueError(f"bands of {band_width:g} nm are wider than all the wavelengths, {low:g} to {high:g} nm")
    position = on_plane / band_width
    if farthest is None:
        if position >= 1:
            raise ValueError(
                f"bands of {band_width:g} nm are too narrow: they stay wider than {on_plane:.4g} nm, their width with the mask on"
                " the spectral plane"
            )
        return position
    if position > farthest * (1 + ROUNDING):
        raise ValueError(
            f"bands of {band_width:g} nm need s = {position:.4g}, and the bench reaches {farthest:.4g}: its finest bands are"
            f" {on_plane / farthest:.4g} nm wide"
        )
    if position < nearest * (1 - ROUNDING):
        raise ValueError(
            f"bands of {band_width:g} nm need s = {position:.4g}, and the bench begins at {nearest:.4g}: its widest bands are"
            f" {on_plane / nearest:.4g} nm wide"
        )
    return min(max(position, nearest), farthest)


def _reach(camera: SSCSI | Bench) -> tuple[float, float | None]:
    """Smallest and largest s that `camera` can be set to; None for an end that is open, at s = 1."""
    from .bench import Bench
    from .sscsi import SSCSI

    if isinstance(camera, Bench):
        return camera.reachable
    if isinstance(camera, SSCSI):
        return 0.0, None
    raise TypeError(f"position_for takes an SSCSI or a Bench, whose mask can be moved, got {type(camera).__name__}")
