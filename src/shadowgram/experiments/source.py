"""Where the scenes of the studies come from: the generated one, or a datacube of the user's, at any resolution."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import xarray as xr

from shadowgram import scenes
from shadowgram.spectral._geometry import interval_means

CHART_RANGE = (450.0, 650.0)


@dataclass(frozen=True, kw_only=True)
class SceneSource:
    """A scene that gives cubes of any size.

    Attributes
    ----------
    name : for titles and tables.
    digest : tells scenes apart; two files with the same values have the same one.
    wavelengths : (shortest, longest) nm, the range that its bands cover.
    bands, size : bands and (y, x) pixels that it was recorded with; the generated scene has none of its own, and says (0, (0, 0)).
    path : file of a recorded scene; None for the generated one.
    seed : of the generated scene.
    """

    name: str
    digest: str
    wavelengths: tuple[float, float]
    bands: int = 0
    size: tuple[int, int] = (0, 0)
    path: str | None = None
    seed: int = 0

    def cube(self, bands: int, size: tuple[int, int], wavelengths: tuple[float, float] | None = None) -> xr.DataArray:
        """Cube of this scene.

        Parameters
        ----------
        bands : number of bands, evenly over `wavelengths`.
        size : (y, x) pixels over the whole field, a square part of the scene if they are equal.
        wavelengths : (shortest, longest) nm; by default all of the scene's.

        Returns
        -------
        xarray.DataArray
            (band, y, x) float32 in [0, 1]. A recorded scene with other bands or pixels than were asked for is interpolated
            linearly between their centres and averaged over what each new band and pixel covers.
        """
        low, high = wavelengths or self.wavelengths
        if self.path is None:
            return scenes.chart(size=size, bands=bands, seed=self.seed, wavelengths=(low, high))
        cube = _recorded(self.path)
        values = _resampled(cube.values, 0, *self._band_places(cube, low, high), bands)
        ny, nx = _cropped(values.shape[1:], size)
        y, x = (values.shape[1] - ny) // 2, (values.shape[2] - nx) // 2
        values = values[:, y : y + ny, x : x + nx]
        for axis, count in ((1, size[0]), (2, size[1])):
            values = _resampled(values, axis, 0.0, float(values.shape[axis]), count)
        edges = np.linspace(low, high, bands + 1)
        return scenes.as_datacube(values.astype(np.float32), (edges[1:] + edges[:-1]) / 2, self.name)

    def _band_places(self, cube: xr.DataArray, low: float, high: float) -> tuple[float, float]:
        """The range in units of recorded bands, whose edges are whole numbers."""
        first, last = self.wavelengths
        step = (last - first) / cube.sizes["band"]
        return (low - first) / step, (high - first) / step


def generated(seed: int = 0) -> SceneSource:
    """The generated scene.

    Examples
    --------
    >>> from shadowgram.experiments.source import generated
    >>> generated().cube(4, (16, 24)).shape
    (4, 16, 24)
    """
    return SceneSource(name="chart", digest=f"chart-{seed}", wavelengths=CHART_RANGE, seed=seed)


def recorded(path: str | Path) -> SceneSource:
    """A datacube in a file that states its wavelengths, evenly spaced; convert others with ``shadowgram convert``.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is no datacube, its bands are not evenly spaced, or it has values below 0.
    """
    cube = _recorded(str(path))
    if "wavelength" not in cube.coords or cube.sizes["band"] < 2:
        raise ValueError(f"{path} does not say the wavelengths of its bands; give them to 'shadowgram convert'")
    centres = cube.wavelength.values
    steps = np.diff(centres)
    if np.ptp(steps) > 0.02 * steps.mean():
        raise ValueError(
            f"the bands of {path} are {steps.min():.4g} to {steps.max():.4g} nm apart; studies take evenly spaced bands"
        )
    step = (centres[-1] - centres[0]) / (len(centres) - 1)
    digest = hashlib.sha256(cube.values.tobytes() + centres.tobytes()).hexdigest()[:16]
    return SceneSource(
        name=Path(path).stem,
        digest=digest,
        wavelengths=(float(centres[0] - step / 2), float(centres[-1] + step / 2)),
        bands=cube.sizes["band"],
        size=(cube.sizes["y"], cube.sizes["x"]),
        path=str(path),
    )


@lru_cache(maxsize=2)
def _recorded(path: str) -> xr.DataArray:
    """Cube of a file with rising wavelengths, in [0, 1]. Read once a process, and not to be changed."""
    cube = scenes.read(path)
    if cube.sizes["band"] > 1 and "wavelength" in cube.coords and cube.wavelength[0] > cube.wavelength[-1]:
        cube = cube[::-1]
    values = np.ascontiguousarray(cube.values, np.float32)
    if values.min() < 0:
        raise ValueError(f"{path} has values down to {values.min():.4g}; a scene is light, which is not negative")
    values = values / max(float(values.max()), 1.0)
    values.flags.writeable = False
    return cube.copy(data=values)


def _cropped(shape: tuple[int, ...], size: tuple[int, int]) -> tuple[int, int]:
    """Largest (y, x) part of `shape` with the proportions of `size`."""
    ny, nx = shape
    return min(ny, round(nx * size[0] / size[1])), min(nx, round(ny * size[1] / size[0]))


def _resampled(values: np.ndarray, axis: int, low: float, high: float, count: int) -> np.ndarray:
    """Means over `count` even intervals of [low, high], of values that stand in the middle of the cells 0…1, 1…2 and so on."""
    old = values.shape[axis]
    if count == old and low == 0 and high == old:
        return values
    width = (high - low) / count
    if width >= 1:  # coarser: mean over what it covers
        return interval_means(values, axis, low + width * np.arange(count + 1))
    # finer: linear between the centres
    places = np.clip(low + width * (np.arange(count) + 0.5) - 0.5, 0, old - 1)
    weights = np.clip(1 - np.abs(places[:, None] - np.arange(old)), 0, None).astype(np.float32)
    return np.moveaxis(np.tensordot(weights, values, axes=(1, axis)), 0, axis)
