"""Single- and dual-disperser CASSI.

- `CASSI`: the coded scene is dispersed over the detector, g[y, x + dk] = Σ_k t[y, x] f[k, y, x] with d pixels a band, so the
  detector is d(L − 1) pixels wider than the scene.
- `DualCASSI`: the dispersion is undone before the detector, g[y, x] = Σ_k t[y, x + dk] f[k, y, x]; the mask is the wider one.

Sources: Wagadarikar et al., Appl. Opt. 47 (2008) B44; Gehm et al., Opt. Express 15 (2007) 14013.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram.codes.patterns import check_code

from ._checks import check_count, check_pitch, check_shape, check_wavelengths
from .resolution import DETECTOR_LIMITED, Resolution

if TYPE_CHECKING:
    from ._shift_operators import ShiftOperator


@dataclass(frozen=True, kw_only=True)
class CASSI:
    """Geometry of a single-disperser CASSI whose code has the pitch of the detector.

    Parameters
    ----------
    cube_shape : (band, y, x) of the datacube.
    wavelengths : (shortest, longest) nm, split evenly into the bands.
    pitch : µm, of detector and code.
    band_shift : detector pixels of dispersion a band.

    Raises
    ------
    ValueError
        If the geometry is impossible.

    Examples
    --------
    >>> import shadowgram as sg
    >>> imager = sg.CASSI(cube_shape=(24, 64, 64), wavelengths=(450, 650))
    >>> imager.operator(sg.codes.boolean(shots=3, shape=imager.code_shape, seed=0)).out_shape
    (3, 64, 87)
    """

    cube_shape: tuple[int, int, int]
    wavelengths: tuple[float, float]
    pitch: float = 10.0
    band_shift: int = 1

    def __post_init__(self) -> None:
        check_geometry(self.cube_shape, self.wavelengths, self.pitch, self.band_shift)

    @property
    def code_shape(self) -> tuple[int, int]:
        """(y, x) elements of the coded aperture."""
        return self.cube_shape[1], self.cube_shape[2]

    @property
    def resolution(self) -> Resolution:
        """The datacube and its resolution."""
        return even_resolution(self.cube_shape, self.wavelengths, self.pitch)

    def effective_code(self, code: np.ndarray) -> np.ndarray:
        """Transmittance that each voxel sees, (shot, band, y, x): the same in every band."""
        code = check_code(code, self.code_shape)
        return np.repeat(code[:, None], self.cube_shape[0], axis=1).astype(np.float64)

    def operator(self, code: np.ndarray) -> ShiftOperator:
        """Forward model with `code` (shot, y, x): datacube (band, y, x) → snapshots (shot, y, x + band_shift·(bands − 1))."""
        from ._shift_operators import ShiftOperator

        return ShiftOperator(check_code(code, self.code_shape), self.cube_shape, 0, self.band_shift)


@dataclass(frozen=True, kw_only=True)
class DualCASSI:
    """Geometry of a dual-disperser CASSI; parameters as for `CASSI`.

    Examples
    --------
    >>> import shadowgram as sg
    >>> imager = sg.DualCASSI(cube_shape=(24, 64, 64), wavelengths=(450, 650))
    >>> imager.code_shape
    (64, 87)
    """

    cube_shape: tuple[int, int, int]
    wavelengths: tuple[float, float]
    pitch: float = 10.0
    band_shift: int = 1

    def __post_init__(self) -> None:
        check_geometry(self.cube_shape, self.wavelengths, self.pitch, self.band_shift)

    @property
    def code_shape(self) -> tuple[int, int]:
        """(y, x) elements of the coded aperture."""
        bands, ny, nx = self.cube_shape
        return ny, nx + self.band_shift * (bands - 1)

    @property
    def resolution(self) -> Resolution:
        """The datacube and its resolution."""
        return even_resolution(self.cube_shape, self.wavelengths, self.pitch)

    def effective_code(self, code: np.ndarray) -> np.ndarray:
        """Transmittance that each voxel sees, (shot, band, y, x)."""
        code = check_code(code, self.code_shape)
        bands, _, nx = self.cube_shape
        shifts = range(0, bands * self.band_shift, self.band_shift)
        return np.stack([code[:, :, d : d + nx] for d in shifts], axis=1).astype(np.float64)

    def operator(self, code: np.ndarray) -> ShiftOperator:
        """Forward model with `code` (shot, y, x): datacube (band, y, x) → snapshots (shot, y, x)."""
        from ._shift_operators import ShiftOperator

        return ShiftOperator(check_code(code, self.code_shape), self.cube_shape, self.band_shift, 0)


def check_geometry(
    cube_shape: tuple[int, int, int], wavelengths: tuple[float, float], pitch: float, band_shift: int
) -> None:
    """Raise unless these describe a CASSI of any kind."""
    check_shape("cube_shape", cube_shape, ("band", "y", "x"))
    check_wavelengths(wavelengths)
    check_pitch("pitch", pitch)
    check_count("band_shift", band_shift)


def even_resolution(cube_shape: tuple[int, int, int], wavelengths: tuple[float, float], pitch: float) -> Resolution:
    """Resolution of an imager that sees every voxel of a cube of equal bands on one pixel."""
    low, high = wavelengths
    return Resolution(
        regime=DETECTOR_LIMITED,
        cube_shape=(cube_shape[0], cube_shape[1], cube_shape[2]),
        band_width=(high - low) / cube_shape[0],
        x_pitch=pitch,
        y_pitch=pitch,
        first_wavelength=float(low),
        vignetted=(0.0,) * cube_shape[0],
    )
