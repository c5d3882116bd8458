"""Calibration of a spectral camera from captures of a white board, one a band and shot, through the mask.

What each voxel sees need not be computed from a geometry, it can be photographed: with a white board as the scene and light of one
band at a time, the capture of shot q and band k is the diagonal block (q, k) of the sensing matrix, with the lens's blur, the
mask's faults, the lamp and the camera's response in it. Source: Salazar (2022), section 2.5.2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from shadowgram.codes.patterns import check_code

from ._checks import check_nanometres, check_pitch, check_shape
from .resolution import DETECTOR_LIMITED, Resolution

if TYPE_CHECKING:
    from ._shift_operators import ColoredOperator

MOST_SATURATED = 1e-3  # share of a capture's pixels
PILED = 5  # times as many pixels at the largest value as at the one below: noise spreads, saturation piles up
LEAST_LIGHT = 5.0  # standard errors of a capture's mean above dark
LEAST_SHARE = 1e-3  # of the brightest capture's mean; the black level drifts by as much
DEAD = 0.05  # response, relative to the mean


@dataclass(frozen=True, kw_only=True)
class CalibratedResolution(Resolution):
    """Resolution of a camera whose bands are known by their centres, as from a calibration; they need not be even.

    Attributes
    ----------
    centres : (band,) nm. `band_width` is their mean spacing, and a band ends half-way to the next.
    """

    centres: tuple[float, ...]

    @property
    def band_edges(self) -> np.ndarray:
        """(bands + 1,) nm; band k lies between edges k and k + 1."""
        return band_edges(self.centres)

    @property
    def wavelengths(self) -> np.ndarray:
        """(band,) nm; centres of the bands."""
        return np.array(self.centres)


@dataclass(frozen=True, kw_only=True)
class CalibratedImager:
    """A camera known by captures of a white board: g[y, x] = Σ_k t[k, y, x] f[k, y, x], with t measured.

    Parameters
    ----------
    cube_shape : (band, y, x) of the datacube.
    band_centres : (band,) nm, ascending, at least two.
    pitch : µm; side of a detector element.

    Raises
    ------
    ValueError
        If a parameter is impossible.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> imager = sg.spectral.CalibratedImager(cube_shape=(3, 8, 10), band_centres=(480.0, 550.0, 620.0), pitch=9.9)
    >>> imager.wavelengths, imager.resolution.band_width
    ((445.0, 655.0), 70.0)
    >>> imager.operator(np.full((2, 3, 8, 10), 0.5)).out_shape
    (2, 8, 10)
    """

    cube_shape: tuple[int, int, int]
    band_centres: tuple[float, ...]
    pitch: float

    def __post_init__(self) -> None:
        check_shape("cube_shape", self.cube_shape, ("band", "y", "x"))
        check_pitch("pitch", self.pitch)
        object.__setattr__(self, "band_centres", checked_centres(self.band_centres, self.cube_shape[0]))

    @property
    def code_shape(self) -> tuple[int, int, int]:
        """(band, y, x) of the measured code."""
        return self.cube_shape

    @property
    def wavelengths(self) -> tuple[float, float]:
        """(shortest, longest) nm; the outer edges of the first and the last band."""
        edges = band_edges(self.band_centres)
        return float(edges[0]), float(edges[-1])

    @property
    def resolution(self) -> CalibratedResolution:
        """The datacube and its resolution; what the mask resolves of the bands is for `measured_resolution` to say."""
        bands = self.cube_shape[0]
        spacing = (self.band_centres[-1] - self.band_centres[0]) / (bands - 1)
        return CalibratedResolution(
            regime=DETECTOR_LIMITED,
            cube_shape=self.cube_shape,
            band_width=spacing,
            spectral_extents=(spacing, spacing),
            x_pitch=self.pitch,
            y_pitch=self.pitch,
            first_wavelength=self.wavelengths[0],
            vignetted=(0.0,) * bands,
            centres=tuple(self.band_centres),
        )

    def effective_code(self, code: np.ndarray) -> np.ndarray:
        """Transmittance that each voxel sees, (shot, band, y, x): the code itself."""
        return check_code(code, self.code_shape).astype(np.float64)

    def operator(self, code: np.ndarray) -> ColoredOperator:
        """Forward model with `code` (shot, band, y, x): datacube (band, y, x) → snapshots (shot, y, x)."""
        from ._shift_operators import ColoredOperator

        return ColoredOperator(check_code(code, self.code_shape), 0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """What `calibrate` finds: the camera, its code, and how raw captures of a target become snapshots for its operator.

    Attributes
    ----------
    imager : the camera.
    code : (shot, band, y, x) float32 in [0, 1]; the white captures, corrected, over `scale`. Noise below zero is cut off.
    scale : counts; the brightest corrected white pixel.
    dark : (y, x) float32 counts with the shutter closed.
    response : (y, x) float32 of each pixel relative to the mean one; infinite for dead pixels, which are then left out: zero
        in the code and in every snapshot.
    saturation : raw value of a saturated pixel; None for the full scale of integers.
    """

    imager: CalibratedImager
    code: np.ndarray
    scale: float
    dark: np.ndarray
    response: np.ndarray
    saturation: float | None

    @cached_property
    def operator(self) -> ColoredOperator:
        """Forward model: reflectance (band, y, x), relative to the white board → snapshots (shot, y, x)."""
        return self.imager.operator(self.code)

    def __str__(self) -> str:
        shots, bands, ny, nx = self.code.shape
        light = self.code.mean(axis=(0, 2, 3))
        weakest = int(light.argmin())
        dead = int(np.count_nonzero(np.isinf(self.response)))
        return (
            f"{shots} shots × {bands} bands × {ny} × {nx} (y × x), brightest pixel {self.scale:.5g} counts, {dead} dead pixels,"
            f" weakest band {self.imager.band_centres[weakest]:g} nm with {100 * light[weakest] / light.max():.3g} % of the"
            " strongest one's light"
        )

    def snapshots(self, raw: ArrayLike, *, exposure: float = 1.0, dark: ArrayLike | None = None) -> np.ndarray:
        """Snapshots of a target, as `operator` gives them for its reflectance relative to the white board.

        Parameters
        ----------
        raw : (shot, y, x) captures of the target under the light of the white captures, all bands at once.
        exposure : exposure time of these captures over that of the white ones.
        dark : (y, x) or (frame, y, x) captures with the shutter closed and this exposure; that of the calibration if not given.

        Returns
        -------
        (shot, y, x) float32 array. Values may be negative, by noise.

        Raises
        ------
        TypeError
            If the captures are not real numbers.
        ValueError
            If their shape does not fit, a value is not finite, or more than 0.1 % of a capture's pixels are saturated.
        """
        values = real_captures("the captures", raw, ("shot", "y", "x"))
        shots, _, ny, nx = self.code.shape
        if values.shape != (shots, ny, nx):
            raise ValueError(f"the captures must be (shot, y, x) = {(shots, ny, nx)}, got {values.shape}")
        if not (math.isfinite(exposure) and exposure > 0):
            raise ValueError(f"exposure is a ratio of times, a positive number, got {exposure}")
        _check_saturation(values[:, None], self.saturation, "the capture")
        black = self.dark if dark is None else _mean_frame("dark", dark, (ny, nx))
        return ((values.astype(np.float32) - black) / self.response / np.float32(self.scale * exposure)).astype(
            np.float32
        )


def calibrate(
    white: ArrayLike,
    *,
    wavelengths: Sequence[float],
    pitch: float,
    dark: ArrayLike | None = None,
    flat: ArrayLike | None = None,
    saturation: float | None = None,
) -> Calibration:
    """Assemble the sensing matrix from captures of a white board.

    Parameters
    ----------
    white : (shot, band, y, x) raw captures of a white board through the mask, all with one exposure; band by band, with a
        tunable source or filters in the light.
    wavelengths : (band,) nm, ascending; centres of the bands.
    pitch : µm; side of a detector element.
    dark : (y, x) or (frame, y, x) captures with the shutter closed and the same exposure, whose mean is subtracted.
    flat : (y, x) or (frame, y, x) captures of uniform light without the mask. Captures are divided by (flat − dark) over its
        mean, which takes out what differs from pixel to pixel; pixels below 5 % of the mean are left out as dead.
    saturation : raw value of a saturated pixel. By default the full scale of the type for integers and none for floats; a
        camera of 12 bits in a type of 16 saturates at 4095, and integers of which many end at one value ask for this. ``inf``
        for no check.

    Returns
    -------
    Calibration

    Raises
    ------
    TypeError
        If captures are not real numbers.
    ValueError
        If captures do not fit together, hold NaN or infinity, are saturated in more than 0.1 % of their pixels, or are dark:
        a mean above dark that is not above 5 of its standard errors and 0.1 % of the brightest capture's.

    Notes
    -----
    A voxel that sees the white board gives the counts of the white capture, so that the reconstruction is the reflectance
    relative to the board, band by band, with the spectra of lamp and camera taken out. Noise of the white captures is an error of
    the model: it pays to average many frames of each. Source: Salazar (2022), section 2.5.2.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> true = sg.DualCASSI(cube_shape=(3, 16, 16), wavelengths=(450, 650))
    >>> code = sg.codes.boolean(shots=2, shape=true.code_shape, seed=0)
    >>> white = 100 + 3000 * true.effective_code(code)
    >>> camera = sg.spectral.calibrate(white, wavelengths=true.resolution.wavelengths, pitch=10.0, dark=np.full((16, 16), 100))
    >>> camera.code.shape, camera.scale
    ((2, 3, 16, 16), 3000.0)
    >>> target = np.full((3, 16, 16), 0.25, np.float32)
    >>> raw = 100 + 3000 * true.operator(code).forward(target)
    >>> np.allclose(camera.snapshots(raw), camera.operator.forward(target), rtol=1e-4)
    True
    """
    values = real_captures("the white captures", white, ("shot", "band", "y", "x"))
    centres = checked_centres(wavelengths, values.shape[1])
    check_pitch("pitch", pitch)
    _check_saturation(values, saturation, "the white capture")
    _check_repeated(values, centres)
    shape = values.shape[2:]
    black = np.zeros(shape, np.float32) if dark is None else _mean_frame("dark", dark, shape)
    light = values.astype(np.float32) - black
    _check_light(light, centres)
    response = np.ones(shape, np.float32) if flat is None else _response(_mean_frame("flat", flat, shape), black)
    light /= response
    scale = float(light.max())
    np.clip(light / np.float32(scale), 0, 1, out=light)
    imager = CalibratedImager(cube_shape=(values.shape[1], *shape), band_centres=centres, pitch=float(pitch))
    return Calibration(imager=imager, code=light, scale=scale, dark=black, response=response, saturation=saturation)


def band_edges(centres: Sequence[float] | np.ndarray) -> np.ndarray:
    """(band + 1,) edges half-way between the centres; the outer bands are even about theirs."""
    c = np.asarray(centres, dtype=np.float64)
    between = (c[1:] + c[:-1]) / 2
    return np.concatenate([[2 * c[0] - between[0]], between, [2 * c[-1] - between[-1]]])


def check_centres(centres: Sequence[float], bands: int) -> None:
    """Raise unless these are the centres of `bands` bands."""
    if len(centres) != bands:
        raise ValueError(
            f"there are {bands} bands and {len(centres)} wavelengths: a band is missing, or was captured twice"
        )
    if bands < 2:
        raise ValueError("a calibration needs at least two bands; one capture says nothing about wavelengths")
    rising = all(a < b for a, b in pairwise(centres))
    if not (all(math.isfinite(c) for c in centres) and centres[0] > 0 and rising):
        raise ValueError(f"wavelengths must be the bands' centres in nm, ascending, got {tuple(centres)}")
    check_nanometres(centres)


def checked_centres(wavelengths: Sequence[float], bands: int) -> tuple[float, ...]:
    """Centres of the bands as numbers."""
    values = np.asarray(wavelengths)
    if values.ndim != 1 or values.dtype.kind not in "fiu":
        raise ValueError(f"wavelengths must be a list of numbers in nm, one a band, got {wavelengths!r}")
    centres = tuple(float(w) for w in values)
    check_centres(centres, bands)
    return centres


def real_captures(name: str, values: ArrayLike, axes: tuple[str, ...]) -> np.ndarray:
    """Array of finite real numbers with these axes, none of them empty."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiub":
        raise TypeError(f"{name} must be real numbers, got an array of {array.dtype}")
    if array.ndim != len(axes) or 0 in array.shape:
        raise ValueError(f"{name} must have the axes ({', '.join(axes)}), got an array of shape {array.shape}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(f"{name} must be finite, but the value at ({', '.join(axes)}) = {where} is {array[where]}")
    return array


def _mean_frame(name: str, frames: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(frames)
    array = real_captures(name, array, ("y", "x") if array.ndim == 2 else ("frame", "y", "x"))
    if array.shape[-2:] != shape:
        raise ValueError(f"{name} must have the captures' (y, x) = {shape}, got {array.shape[-2:]}")
    return array.reshape(-1, *shape).mean(axis=0, dtype=np.float64).astype(np.float32)


def _check_saturation(captures: np.ndarray, saturation: float | None, what: str) -> None:
    """Raise if a capture (shot, band, y, x) has too many pixels at `saturation`."""
    if saturation is None:
        if captures.dtype.kind == "f":
            return
        saturation = _plateau(captures, what)
    if not saturation > 0:
        raise ValueError(
            f"saturation is the raw value of a saturated pixel, above 0, or inf for no check; got {saturation:g}"
        )
    share = (captures >= saturation).mean(axis=(2, 3))
    if (share > MOST_SATURATED).any():
        shot, band = np.argwhere(share > MOST_SATURATED)[0]
        raise ValueError(
            f"{what} of {_place(shot, band if share.shape[1] > 1 else None)} is saturated in {100 * share[shot, band]:.3g} % of"
            f" its pixels (at {saturation:g} or more): shorten the exposure"
        )


def _plateau(captures: np.ndarray, what: str) -> float:
    """Full scale of a type of whole numbers; but raise if pixels pile up at a smaller largest value, which may be the camera's."""
    if captures.dtype.kind == "b":
        return 1.0
    largest = captures.max()
    at, below = (np.count_nonzero(captures == value, axis=(2, 3)) for value in (largest, largest - 1))
    full, pixels = float(np.iinfo(captures.dtype).max), captures[0, 0].size
    if largest < full and (piled := (at > MOST_SATURATED * pixels) & (at > PILED * (below + 1))).any():
        raise ValueError(
            f"{100 * at[piled].max() / pixels:.3g} % of the pixels of {what} have the same largest value, {largest}: if the camera"
            " saturates there, shorten the exposure; else say saturation, or inf for no check"
        )
    return full


def _check_repeated(white: np.ndarray, centres: tuple[float, ...]) -> None:
    """Raise if two neighbouring bands are the same capture, pixel by pixel; noise makes that impossible in raw data."""
    for k in range(1, white.shape[1]):
        if white.dtype.kind in "iu" and np.array_equal(white[:, k], white[:, k - 1]):
            raise ValueError(
                f"the white captures at {centres[k - 1]:g} and {centres[k]:g} nm are the same in every pixel:"
                " one was stored twice"
            )


def _check_light(light: np.ndarray, centres: tuple[float, ...]) -> None:
    """Raise if a white capture (shot, band, y, x), dark subtracted, shows no light."""
    mean = light.mean(axis=(2, 3), dtype=np.float64)
    error = light.std(axis=(2, 3), dtype=np.float64) / math.sqrt(light[0, 0].size)
    if not mean.max() > LEAST_LIGHT * error.flat[mean.argmax()]:
        raise ValueError(
            "no white capture is brighter than dark: check the light, and that white and dark are not swapped"
        )
    unlit = mean <= np.maximum(LEAST_LIGHT * error, LEAST_SHARE * mean.max())
    if unlit.any():
        shot, band = np.argwhere(unlit)[0]
        raise ValueError(
            f"the white capture of {_place(shot, band)}, {centres[band]:g} nm, is dark: its mean is {mean[shot, band]:.3g} ±"
            f" {error[shot, band]:.2g} above dark; capture it again, or leave the band out"
        )


def _response(flat: np.ndarray, black: np.ndarray) -> np.ndarray:
    """Relative to its mean; infinite for dead pixels."""
    light = flat - black
    mean = float(light.mean(dtype=np.float64))
    if not mean > 0:
        raise ValueError(
            f"flat must be brighter than dark, but its mean is {mean:.4g} above it: check that the two are not swapped"
        )
    response = light / np.float32(mean)
    dead = response < DEAD
    if dead.mean() > 0.1:
        raise ValueError(
            f"flat is dark in {100 * dead.mean():.0f} % of its pixels: capture uniform light, without the mask"
        )
    response[dead] = np.inf
    return response


def _place(shot: int, band: int | None) -> str:
    return f"shot {shot}" if band is None else f"shot {shot}, band {band} (from 0)"
