"""An SSCSI before a continuous scene: what a detector records, by no discrete model's assumptions.

`ContinuousSSCSI` evaluates eq. (2.2) on a scene that is finer than anything the imager resolves, in wavelength and in space:
every fine band stands at its own place on the mask, every scene pixel sees its own part of it. The lens can have a finite
aperture, whose image on the spectral plane, `pupil` µm wide, blurs the mask over s·pupil (section 2.5.3); the detector can have a
spectral response. A measurement made so has a model error whichever discrete model reconstructs it, as in a real camera.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from shadowgram.codes.patterns import check_code

from . import _geometry
from ._checks import check_count
from .resolution import SUPER_RESOLVING
from .sscsi import SSCSI

if TYPE_CHECKING:
    from ._sscsi_operator import PieceOperator

_BLUR_SAMPLES = (
    12  # across the disc of confusion, of which the sampled disc's area and width are then right to about 1 %
)
_MOST_SAMPLES = 16  # per code element, where the disc is smaller than that


@dataclass(frozen=True, eq=False)
class _Mask:
    """Transmittance (shot, y, x) on the rows of the scene, samples a code element along x, and closed samples before the code."""

    seen: np.ndarray
    samples: int
    margin: int


@dataclass(frozen=True, kw_only=True)
class ContinuousSSCSI:
    """A finely resolved scene in front of an SSCSI.

    Parameters
    ----------
    imager : the camera. Its `shear` does not matter; its bands give the unit of the snapshots, light per band, and the shape of
        `truth`.
    bands : fine bands, evenly over `imager.wavelengths`; several to each band of the imager.
    oversampling : scene pixels a detector element, each way; a multiple of `imager.pitch_ratio`.
    pupil : µm; diameter of the image of the lens aperture on the spectral plane. 0 is the infinitesimal aperture of eq. (2.2).
        `Bench.pupil` says it for an f-number, in the scale of `Bench.imager`.
    response : (band,) relative sensitivity of camera and optics in the fine bands; None for 1.

    Raises
    ------
    ValueError
        If a parameter is out of range.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> imager = sg.SSCSI(detector_shape=(16, 16), detector_pitch=10.0, code_pitch=10.0, mask_position=0.25,
    ...                   wavelengths=(450, 650))
    >>> camera = sg.spectral.ContinuousSSCSI(imager=imager, bands=32, oversampling=2)
    >>> camera.scene_shape
    (32, 32, 32)
    >>> A = camera.operator(sg.codes.boolean(shots=3, shape=imager.code_shape, seed=0))
    >>> A.out_shape
    (3, 16, 16)
    >>> camera.truth(np.ones(camera.scene_shape)).shape == imager.resolution.cube_shape
    True

    Notes
    -----
    Snapshots are in the units of `imager.operator(code)`: a scene that is constant over every voxel gives what the discrete model
    with exact shear gives.
    Source: Salazar (2022), eq. (2.2) and sections 2.3.6, 2.5.3. As there, the mask is stretched along x only.
    """

    imager: SSCSI
    bands: int
    oversampling: int = 1
    pupil: float = 0.0
    response: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        check_count("bands", self.bands)
        check_count("oversampling", self.oversampling)
        if self.oversampling % self.imager.pitch_ratio:
            raise ValueError(
                f"oversampling must be a multiple of the {self.imager.pitch_ratio} code elements a detector element,"
                f" got {self.oversampling}"
            )
        if not (math.isfinite(self.pupil) and self.pupil >= 0):
            raise ValueError(f"pupil is a diameter in µm, 0 or more, got {self.pupil}")
        if self.response is not None:
            response = np.asarray(self.response, dtype=float)
            if response.shape != (self.bands,) or not np.isfinite(response).all() or response.min() < 0:
                raise ValueError(
                    f"response must give {self.bands} finite sensitivities, none negative, one a fine band,"
                    f" got an array of shape {response.shape}"
                )

    @property
    def scene_shape(self) -> tuple[int, int, int]:
        """(band, y, x) of the scenes that it takes."""
        ny, nx = self.imager.detector_shape
        return self.bands, ny * self.oversampling, nx * self.oversampling

    @property
    def blur(self) -> float:
        """Diameter of the disc over which the mask is blurred, in code elements."""
        return self.imager.mask_position * self.pupil / self.imager.code_pitch

    def operator(self, code: np.ndarray) -> PieceOperator:
        """Forward model with `code` (shot, y, x): scene (band, y, x) of `scene_shape` → snapshots (shot, y, x)."""
        return self._operator(self._mask(check_code(code, self.imager.code_shape)), slice(None))

    def truth(self, scene: np.ndarray) -> np.ndarray:
        """Mean of a scene over every voxel of the imager's datacube: what a perfect reconstruction would be.

        Parameters
        ----------
        scene : (band, y, x) of `scene_shape`.

        Returns
        -------
        (band, y, x) float array of `imager.resolution.cube_shape`; float64 if the scene is, else float32. The last band may reach
        beyond the longest wavelength, where there is no light: its mean is that of the whole band.
        """
        scene = np.asarray(scene)
        if scene.shape != self.scene_shape:
            raise ValueError(f"the scene must have the shape {self.scene_shape} (band, y, x), got {scene.shape}")
        bands, rows, columns = scene.shape
        edges = self.imager.resolution.band_edges
        low, high = self.imager.wavelengths
        cube = _geometry.interval_means(scene, 0, (edges - low) * (bands / (high - low)), whole=True)
        cube = _geometry.interval_means(cube, 1, np.linspace(0, rows, self.imager.code_shape[0] + 1))
        return _geometry.interval_means(cube, 2, self._voxel_edges * (columns / self.imager.detector_shape[1]))

    def white_captures(self, code: np.ndarray, band_edges: Sequence[float] | np.ndarray) -> np.ndarray:
        """Snapshots of a white board, lit by one band at a time: what a calibration takes (section 2.5.2).

        Parameters
        ----------
        code : (shot, y, x) of the imager's `code_shape`.
        band_edges : (band + 1,) nm, ascending, within the imager's wavelengths; in each band the light is uniform.

        Returns
        -------
        (shot, band, y, x) float64, such that the snapshots of a scene constant over every band are the sum over the bands.

        Raises
        ------
        ValueError
            If the edges are not ascending, lie outside the imager's wavelengths, or a band is narrower than a fine band.
        """
        low, high = self.imager.wavelengths
        edges = np.asarray(band_edges, dtype=float)
        step = (high - low) / self.bands
        if edges.ndim != 1 or len(edges) < 2 or not np.isfinite(edges).all() or (np.diff(edges) <= 0).any():
            raise ValueError("band_edges must be at least two ascending wavelengths in nm")
        if edges[0] < low - 1e-6 * step or edges[-1] > high + 1e-6 * step:
            raise ValueError(
                f"band_edges must lie within the imager's {low:g} to {high:g} nm, got {edges[0]:g} to {edges[-1]:g} nm"
            )
        if np.diff(edges).min() < step * (1 - 1e-6):
            raise ValueError(
                f"the narrowest band is {np.diff(edges).min():.4g} nm, finer than this scene's {step:.4g} nm: use more fine bands"
            )
        code = check_code(code, self.imager.code_shape)
        places = np.clip((edges - low) / step, 0, self.bands)
        mask = self._mask(code)
        captures = []
        for first, last in pairwise(places):
            lit = slice(math.floor(first + 1e-6), math.ceil(last - 1e-6))
            k = np.arange(lit.start, lit.stop)
            share = np.clip(np.minimum(k + 1, last) - np.maximum(k, first), 0, 1)
            board = np.broadcast_to(share[:, None, None], (len(k), *self.scene_shape[1:]))
            captures.append(self._operator(mask, lit).forward(board))
        return np.stack(captures, axis=1)

    def _operator(self, mask: _Mask, lit: slice) -> PieceOperator:
        """Forward model of a part of the fine bands."""
        from ._sscsi_operator import PieceOperator

        pieces, table = self._geometry(mask.samples, mask.margin, lit)
        shape = (table.first.shape[0], *self.scene_shape[1:])
        return PieceOperator(mask.seen, pieces, table, shape, self.imager.detector_shape)

    def _geometry(self, samples: int, margin: int, lit: slice) -> tuple[_geometry.Pieces, _geometry.ColumnTable]:
        """Scene pixels and their columns on a mask with `samples` samples a code element and `margin` closed ones before it."""
        imager, over = self.imager, self.oversampling
        width = imager.pitch_ratio * (1 - imager.mask_position) / over
        plain = _geometry.detector_limited_pieces(
            imager.detector_shape[1] * over, width * samples, imager.mask_offset * samples + margin
        )
        pieces = replace(plain, share=plain.share * self._light, detector=plain.detector // over)
        table = _geometry.column_table(pieces, self.bands, imager.spectral_columns * samples / self.bands, "exact")
        weights = table.weights[:, lit]
        if self.response is not None:
            weights = weights * np.asarray(self.response)[lit, None]
        return pieces, replace(table, first=table.first[lit], weights=weights)

    @property
    def _light(self) -> float:
        """Light of a scene voxel of unit radiance, in the units of the discrete model, where each voxel counts whole."""
        imager = self.imager
        voxels = imager.pitch_ratio
        if imager.resolution.regime == SUPER_RESOLVING:
            voxels *= imager.pitch_ratio * (1 - imager.mask_position)
        low, high = imager.wavelengths
        return voxels * (high - low) / imager.resolution.band_width / self.bands / self.oversampling**2

    def _mask(self, code: np.ndarray) -> _Mask:
        """The mask as the lens shows it."""
        rows = self.oversampling // self.imager.pitch_ratio
        if self.blur == 0:
            return _Mask(np.repeat(code, rows, axis=1), 1, 0)
        samples = rows * math.ceil(min(_BLUR_SAMPLES / self.blur, _MOST_SAMPLES) / rows)
        disc = _disc(self.blur * samples)
        # Shot by shot: a shot is many times larger while it is blurred.
        seen = np.stack([_blurred(shot, disc, samples, samples // rows) for shot in code])
        return _Mask(seen, samples, len(disc) // 2)

    @cached_property
    def _voxel_edges(self) -> np.ndarray:
        """Edges of the voxel columns, in detector elements."""
        imager = self.imager
        columns = imager.resolution.cube_shape[2]
        if imager.resolution.regime != SUPER_RESOLVING:
            return np.arange(columns + 1.0)
        first = math.floor(imager.mask_offset + _geometry.ROUNDING)
        stretched = imager.pitch_ratio * (1 - imager.mask_position)
        edges = (first + np.arange(columns + 1) - imager.mask_offset) / stretched
        return np.clip(edges, 0, imager.detector_shape[1])


def _blurred(shot: np.ndarray, disc: np.ndarray, samples: int, merged: int) -> np.ndarray:
    """A shot (y, x) with `samples` samples an element each way, convolved; it gains half a disc at either end along x.

    Along y it keeps its length, and `merged` rows become one.
    """
    from scipy.signal import fftconvolve

    margin = len(disc) // 2
    fine = np.pad(shot.repeat(samples, axis=0).repeat(samples, axis=1).astype(np.float64), margin)
    seen = fftconvolve(fine, disc, mode="same")[margin:-margin]
    return np.clip(seen.reshape(-1, merged, seen.shape[1]).mean(axis=1), 0, 1).astype(np.float32)


def _disc(diameter: float) -> np.ndarray:
    """Disc of unit sum on a square grid with an odd number of samples a side, with soft edges of one sample."""
    half = math.ceil(diameter / 2)
    place = np.arange(-half, half + 1)
    radius = np.hypot(place[:, None], place)
    disc = np.clip(diameter / 2 + 0.5 - radius, 0, 1)
    return disc / disc.sum()
