"""Single- and dual-disperser CASSI.

- `CASSI`: the coded scene is dispersed over the detector, g(x, y) = ∫ t(x − D(λ), y) f(x − D(λ), y, λ) dλ, so the detector is
  wider than the scene by the displacement D of the last band.
- `DualCASSI`: the dispersion is undone before the detector, g(x, y) = ∫ t(x + D(λ), y) f(x, y, λ) dλ; the mask is the wider one.

To first order a band is displaced as its centre is; with d whole pixels a band, that is g[y, x + dk] = Σ_k t[y, x] f[k, y, x].
In truth a band is smeared over the displacements between its edges, and a voxel falls obliquely on three pixels or more: the
higher-order model, ``shear="exact"``.

Sources: Wagadarikar et al., Appl. Opt. 47 (2008) B44; Gehm et al., Opt. Express 15 (2007) 14013; Arguello et al., Appl. Opt. 52
(2013) D12 (higher order).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from shadowgram.codes.patterns import check_code

from ._checks import check_choice, check_count, check_pitch, check_shape, check_wavelengths
from ._dispersion import SHEARS, Dispersion, check_band_shift, check_curve, check_span, smeared_code
from .resolution import DETECTOR_LIMITED, Resolution

if TYPE_CHECKING:
    from shadowgram.operators.base import LinearOperator

    from .colored import ColoredCASSI


@dataclass(frozen=True, kw_only=True)
class CASSI:
    """Geometry of a single-disperser CASSI whose code has the pitch of the detector.

    Parameters
    ----------
    cube_shape : (band, y, x) of the datacube.
    wavelengths : (shortest, longest) nm, split evenly into the bands.
    pitch : µm, of detector and code.
    band_shift : pixels of dispersion from the centre of one band to that of the next, any positive number; 1 if neither it nor
        `dispersion` is given.
    shear : ``"centre"``: a band is displaced as its centre is (first order; a displacement that is not whole splits a voxel over
        two pixels); ``"exact"``: a band is smeared over the displacements between its edges, so that a voxel falls on a trapezoid
        of pixels, with weights 1/8, 3/4 and 1/8 for a shift of 1.
    dispersion : measured curve instead of `band_shift`, at least two pairs (wavelength nm, displacement px), both increasing.
        Between the points it is a monotone cubic; beyond its ends it goes on straight, for at most half its range. Only
        differences count: the centre of band 0 is displaced by 0.
    reference_bands : number of bands that `band_shift` and the detector's width are counted in, and the first of which is
        displaced by 0; those of `cube_shape` if not given. `finer` sets it: finer bands on the same instrument.

    Raises
    ------
    ValueError
        If the geometry is impossible.

    Notes
    -----
    The detector is as wide as the scene plus the displacement of the last band's centre, rounded up, for both shears. Light that
    falls beside it is lost, which `resolution.vignetted` says.

    Examples
    --------
    >>> import shadowgram as sg
    >>> imager = sg.CASSI(cube_shape=(24, 64, 64), wavelengths=(450, 650))
    >>> imager.operator(sg.codes.boolean(shots=3, shape=imager.code_shape, seed=0)).out_shape
    (3, 64, 87)

    A prism disperses less in the red:

    >>> prism = sg.CASSI(cube_shape=(4, 64, 64), wavelengths=(450, 650), shear="exact",
    ...                  dispersion=((450, 0.0), (500, 11.0), (550, 18.0), (600, 23.0), (650, 26.5)))
    >>> prism.displacements.round(1)
    array([ 0. ,  8.8, 14.7, 18.9])
    """

    cube_shape: tuple[int, int, int]
    wavelengths: tuple[float, float]
    pitch: float = 10.0
    band_shift: float | None = None
    shear: str = "centre"
    dispersion: tuple[tuple[float, float], ...] | None = None
    reference_bands: int | None = None

    def __post_init__(self) -> None:
        check_geometry(self)

    @cached_property
    def _dispersion(self) -> Dispersion:
        return dispersion_of(self)

    @property
    def displacements(self) -> np.ndarray:
        """(band,) px; displacement of each band's centre on the detector."""
        return self._dispersion.centres

    @property
    def code_shape(self) -> tuple[int, int]:
        """(y, x) elements of the coded aperture."""
        return self.cube_shape[1], self.cube_shape[2]

    @property
    def resolution(self) -> Resolution:
        """The datacube and its resolution."""
        vignetted = self._dispersion.vignetted(self.cube_shape[2])
        return even_resolution(self.cube_shape, self.wavelengths, self.pitch, vignetted)

    def effective_code(self, code: np.ndarray) -> np.ndarray:
        """Transmittance that each voxel sees, (shot, band, y, x): the same in every band."""
        code = check_code(code, self.code_shape)
        return np.repeat(code[:, None], self.cube_shape[0], axis=1).astype(np.float64)

    def operator(self, code: np.ndarray) -> LinearOperator:
        """Forward model with `code` (shot, y, x): datacube (band, y, x) → snapshots (shot, y, x + last displacement)."""
        from ._shift_operators import DispersedOperator, ShiftOperator

        code = check_code(code, self.code_shape)
        step = self._dispersion.whole_step
        if step is not None:
            return ShiftOperator(code, self.cube_shape, 0, step)
        return DispersedOperator(code[:, None], self.cube_shape, self._dispersion)

    def finer(self, factor: int) -> CASSI:
        """Return the same instrument with `factor` times finer bands and the exact shear, to simulate a finely resolved scene.

        Every wavelength keeps its displacement, and the detector (and code) its width. The cube for it holds light in the same
        unit as one for this imager, so its snapshots must be divided by `factor`: a fine band holds its share of the light.

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
        return dataclasses.replace(self, **finer_fields(self, factor))


@dataclass(frozen=True, kw_only=True)
class DualCASSI:
    """Geometry of a dual-disperser CASSI; parameters as for `CASSI`.

    The code is as wide as the scene plus the displacement of the last band's centre, rounded up; beside it, it is closed. A voxel
    sees the mean of the code over its footprint.

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
    band_shift: float | None = None
    shear: str = "centre"
    dispersion: tuple[tuple[float, float], ...] | None = None
    reference_bands: int | None = None

    def __post_init__(self) -> None:
        check_geometry(self)

    @cached_property
    def _dispersion(self) -> Dispersion:
        return dispersion_of(self)

    @property
    def displacements(self) -> np.ndarray:
        """(band,) px; displacement of each band's centre on the code."""
        return self._dispersion.centres

    @property
    def code_shape(self) -> tuple[int, int]:
        """(y, x) elements of the coded aperture."""
        _, ny, nx = self.cube_shape
        return ny, nx + self._dispersion.extra_columns

    @property
    def resolution(self) -> Resolution:
        """The datacube and its resolution."""
        vignetted = self._dispersion.vignetted(self.cube_shape[2])
        return even_resolution(self.cube_shape, self.wavelengths, self.pitch, vignetted)

    def effective_code(self, code: np.ndarray) -> np.ndarray:
        """Transmittance that each voxel sees, (shot, band, y, x): the mean over its footprint."""
        code = check_code(code, self.code_shape)
        bands, _, nx = self.cube_shape
        return np.stack([smeared_code(code, self._dispersion.footprints, k, nx) for k in range(bands)], axis=1)

    def operator(self, code: np.ndarray) -> LinearOperator:
        """Forward model with `code` (shot, y, x): datacube (band, y, x) → snapshots (shot, y, x)."""
        from ._shift_operators import ShiftOperator, SmearedOperator

        code = check_code(code, self.code_shape)
        step = self._dispersion.whole_step
        if step is not None:
            return ShiftOperator(code, self.cube_shape, step, 0)
        return SmearedOperator(code, self.cube_shape, self._dispersion.footprints)

    def finer(self, factor: int) -> DualCASSI:
        """Return the same instrument with finer bands and the exact shear, as `CASSI.finer` does."""
        return dataclasses.replace(self, **finer_fields(self, factor))


def check_geometry(imager: CASSI | DualCASSI | ColoredCASSI) -> None:
    """Raise unless the parameters describe a CASSI of any kind; set the default of the dispersion, as plain numbers."""
    check_shape("cube_shape", imager.cube_shape, ("band", "y", "x"))
    check_wavelengths(imager.wavelengths)
    check_pitch("pitch", imager.pitch)
    check_choice("shear", imager.shear, SHEARS)
    if imager.reference_bands is not None:
        check_count("reference_bands", imager.reference_bands)
    if imager.dispersion is None:
        object.__setattr__(
            imager, "band_shift", check_band_shift(1.0 if imager.band_shift is None else imager.band_shift)
        )
    elif imager.band_shift is None:
        object.__setattr__(imager, "dispersion", check_curve(imager.dispersion, imager.wavelengths))
    else:
        raise ValueError(
            "give band_shift or dispersion, not both: set band_shift to None when there is a measured curve"
        )
    check_span(dispersion_of(imager))


def dispersion_of(imager: CASSI | DualCASSI | ColoredCASSI) -> Dispersion:
    """Displacements that the parameters describe."""
    bands = imager.cube_shape[0]
    return Dispersion(
        wavelengths=imager.wavelengths,
        bands=bands,
        reference_bands=imager.reference_bands or bands,
        law=imager.dispersion or imager.band_shift or 1.0,
        shear=imager.shear,
    )


def finer_fields(imager: CASSI | DualCASSI | ColoredCASSI, factor: int) -> dict[str, object]:
    """Parameters that differ in an imager with `factor` times finer bands on the same instrument."""
    check_count("factor", factor)
    bands, *pixels = imager.cube_shape
    return {
        "cube_shape": (bands * factor, *pixels),
        "shear": "exact",
        "reference_bands": imager.reference_bands or bands,
    }


def even_resolution(
    cube_shape: tuple[int, int, int],
    wavelengths: tuple[float, float],
    pitch: float,
    vignetted: tuple[float, ...] | None = None,
) -> Resolution:
    """Resolution of an imager that sees a cube of equal bands, pixel by pixel; `vignetted` is nothing if not given."""
    band_width = (wavelengths[1] - wavelengths[0]) / cube_shape[0]
    return Resolution(
        regime=DETECTOR_LIMITED,
        cube_shape=(cube_shape[0], cube_shape[1], cube_shape[2]),
        band_width=band_width,
        spectral_extents=(band_width, band_width),
        x_pitch=pitch,
        y_pitch=pitch,
        first_wavelength=float(wavelengths[0]),
        vignetted=(0.0,) * cube_shape[0] if vignetted is None else vignetted,
    )
