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

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram.codes.patterns import check_code

from ._disperser import Disperser
from ._dispersion import smeared_code

if TYPE_CHECKING:
    from shadowgram.codes._pairs import PairTable
    from shadowgram.operators.base import LinearOperator


@dataclass(frozen=True, kw_only=True)
class CASSI(Disperser):
    """Geometry of a single-disperser CASSI whose code has the pitch of the detector.

    Parameters
    ----------
    cube_shape : (band, y, x) of the datacube.
    wavelengths : (shortest, longest) nm, split evenly into the bands. Left out where `band_centres` is given.
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
    band_centres : (reference band,) nm, ascending; of bands that are not even, as those of a prism that all are `band_shift`
        wide on the detector. They are the wavelengths of the datacube; a band ends half-way to the next.

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

    Bands that are even on the detector and not in wavelength:

    >>> prism = sg.CASSI(cube_shape=(4, 64, 64), band_centres=(450, 470, 500, 550), band_shift=2)
    >>> prism.wavelengths, prism.resolution.wavelengths.tolist()
    ((440.0, 575.0), [450.0, 470.0, 500.0, 550.0])
    """

    @property
    def code_shape(self) -> tuple[int, int]:
        """(y, x) elements of the coded aperture."""
        return self.cube_shape[1], self.cube_shape[2]

    def effective_code(self, code: np.ndarray) -> np.ndarray:
        """Transmittance that each voxel sees, (shot, band, y, x): the same in every band."""
        code = check_code(code, self.code_shape)
        return np.repeat(code[:, None], self.cube_shape[0], axis=1).astype(np.float64)

    def pair_table(self) -> PairTable:
        """What the voxels of a row see of the code, for `shadowgram.codes.design`."""
        from ._dispersed_pairs import code_pairs

        return code_pairs(self._dispersion, self.code_shape, self.cube_shape[0])

    def operator(self, code: np.ndarray) -> LinearOperator:
        """Forward model with `code` (shot, y, x): datacube (band, y, x) → snapshots (shot, y, x + last displacement)."""
        from ._shift_operators import DispersedOperator, ShiftOperator

        code = check_code(code, self.code_shape)
        step = self._dispersion.whole_step
        if step is not None:
            return ShiftOperator(code, self.cube_shape, 0, step)
        return DispersedOperator(code[:, None], self.cube_shape, self._dispersion)


@dataclass(frozen=True, kw_only=True)
class DualCASSI(Disperser):
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

    @property
    def code_shape(self) -> tuple[int, int]:
        """(y, x) elements of the coded aperture."""
        _, ny, nx = self.cube_shape
        return ny, nx + self._dispersion.extra_columns

    def effective_code(self, code: np.ndarray) -> np.ndarray:
        """Transmittance that each voxel sees, (shot, band, y, x): the mean over its footprint."""
        code = check_code(code, self.code_shape)
        bands, _, nx = self.cube_shape
        return np.stack([smeared_code(code, self._dispersion.footprints, k, nx) for k in range(bands)], axis=1)

    def pair_table(self) -> PairTable:
        """What the voxels of a row see of the code, for `shadowgram.codes.design`.

        Raises
        ------
        ValueError
            If a voxel sees more than three code columns.
        """
        from shadowgram.codes._pairs import pair_table

        prints, columns = self._dispersion.footprints, np.arange(self.cube_shape[2])
        first = prints.first[:, None] + columns
        weights = np.broadcast_to(prints.weights.T[:, :, None], (prints.weights.shape[1], *first.shape))
        return pair_table(first, weights, columns, columns, 1, self.code_shape)

    def operator(self, code: np.ndarray) -> LinearOperator:
        """Forward model with `code` (shot, y, x): datacube (band, y, x) → snapshots (shot, y, x)."""
        from ._shift_operators import ShiftOperator, SmearedOperator

        code = check_code(code, self.code_shape)
        step = self._dispersion.whole_step
        if step is not None:
            return ShiftOperator(code, self.cube_shape, step, 0)
        return SmearedOperator(code, self.cube_shape, self._dispersion.footprints)
