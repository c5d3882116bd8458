"""True-colour rendering through the CIE 1931 2° functions, and the colour tables that scenes are made of.

All bands are integrated; no three bands are picked. The tables in `tables/` come with their licence,
`tables/LICENSE-colour`.
"""

from __future__ import annotations

from functools import cache
from importlib import resources

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from .datacube import as_datacube, check_cube

# XYZ → linear sRGB, IEC 61966-2-1.
_XYZ_TO_SRGB = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]],
)
# sRGB luminance of linear R, G, B.
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
# Luminance of the white patch of a ColorChecker: a white card under automatic exposure looks white, highlights whiter.
_PAPER_WHITE = 0.9


def to_rgb(
    cube: xr.DataArray | ArrayLike,
    exposure: float | None = None,
    *,
    wavelengths: ArrayLike | None = None,
    illuminant: str = "D65",
) -> np.ndarray:
    """Render a cube in true colour.

    Parameters
    ----------
    cube : (band, y, x), an array or a DataArray with coordinate `wavelength` in nm. Radiance in any unit; negative
        values are shown as black.
    exposure : factor on the radiance; with 1, a white surface whose brightest band reads 1 is shown as white. By
        default `auto_exposure` of this cube; give one figure to all cubes that are to be compared.
    wavelengths : (band,) nm, rising or falling. Centres of the bands; needed if `cube` does not carry them.
    illuminant : what a white surface looks like in the cube. "D65" for radiance under daylight, such as `chart` gives;
        "equal-energy" for reflectances, or radiance divided by that of a white card. Either way grey is shown as grey.

    Returns
    -------
    (y, x, 3) uint8
        sRGB.

    Raises
    ------
    ValueError
        If the wavelengths are missing, do not fit or are all invisible, or if a value is not finite.

    Notes
    -----
    XYZ = Σ_k (L_k / w_k) ∫_k D65(λ) x̄ȳz̄(λ) dλ, where w is the spectrum of a white surface in the cube, and the
    integral is over the interval of band k, which ends half way to its neighbours. The first and the last band stand
    for all of the visible range beyond them, as CIE 015 advises for spectra that end early, so that grey stays grey
    whatever range the bands cover; a cube of one band is shown in grey. Colours that sRGB cannot show are moved towards
    grey of the same luminance until it can. Source: CIE 015:2018; IEC 61966-2-1 (sRGB).

    Examples
    --------
    >>> import shadowgram as sg
    >>> sg.scenes.to_rgb(sg.scenes.chart(size=32, bands=8, seed=0)).shape
    (32, 32, 3)
    """
    values, nm = _labelled(cube, wavelengths)
    linear = _linear_rgb(values, nm, illuminant)
    linear *= _auto_exposure(linear) if exposure is None else _checked_exposure(exposure)
    return np.moveaxis(np.rint(255 * _encode(_into_gamut(linear))).astype(np.uint8), 0, -1)


def auto_exposure(
    cube: xr.DataArray | ArrayLike, *, wavelengths: ArrayLike | None = None, illuminant: str = "D65"
) -> float:
    """Exposure that `to_rgb` takes by default: it shows the 99th percentile of the luminance as bright as white paper.

    Parameters and errors are those of `to_rgb`.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.scenes import colour
    >>> truth = sg.scenes.chart(size=32, bands=8, seed=0)
    >>> exposure = colour.auto_exposure(truth)
    >>> dimmed = sg.scenes.to_rgb(0.5 * truth, exposure)
    """
    return _auto_exposure(_linear_rgb(*_labelled(cube, wavelengths), illuminant))


def wavelength_rgb(nm: ArrayLike) -> np.ndarray:
    """Colour of monochromatic light, for lines and fills in plots of spectra.

    Parameters
    ----------
    nm : any shape, nm.

    Returns
    -------
    (..., 3) float in [0, 1]
        sRGB, as bright as it shows; darker towards the ends of the visible range, and dark outside of it.

    Examples
    --------
    >>> from shadowgram.scenes import colour
    >>> red, green, blue = colour.wavelength_rgb(630)
    >>> bool(red > green and red > blue)
    True
    """
    nm = np.asarray(nm, dtype=np.float64)
    table, functions, _ = observer()
    # Beyond these ends the chromaticity no longer changes, and its quotient is unsafe.
    inside = np.clip(nm, 400, 690)
    linear = np.tensordot(_XYZ_TO_SRGB, np.stack([np.interp(inside, table, f) for f in functions]), 1)
    linear = np.maximum(linear, 0)
    linear /= linear.max(axis=0)
    dim = np.clip(1 - np.abs(nm - inside) / 60, 0.1, 1)
    return np.moveaxis(_encode(linear * dim), 0, -1)


@cache
def observer() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """CIE 1931 2° colour-matching functions and D65.

    Returns
    -------
    wavelengths : (n,) nm, 360 to 780 in steps of 1.
    functions : (3, n). x̄, ȳ, z̄.
    power : (n,). Relative spectral power of D65, 100 at 560 nm.
    """
    columns = _read_table("cie1931_2deg_d65.csv")
    return columns[0], columns[1:4], columns[4]


@cache
def colorchecker() -> tuple[np.ndarray, np.ndarray]:
    """Measured reflectances of the ColorChecker.

    Returns
    -------
    wavelengths : (n,) nm, 380 to 730 in steps of 10.
    reflectances : (24, n). The patches row by row, from dark skin to black.
    """
    columns = _read_table("colorchecker24.csv")
    return columns[0], columns[1:]


def band_means(nm: np.ndarray, values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Exact means over intervals of functions that are linear between samples.

    Because they are exact, the mean of the means over two halves is the mean over the whole.

    Parameters
    ----------
    nm : (n,) rising. Where the functions are sampled; they keep their end values outside.
    values : (..., n). The samples.
    edges : (bands + 1,) rising, in the units of `nm`.

    Returns
    -------
    (..., bands)
    """
    # The integral up to an edge is quadratic between samples: with the edges among the samples, the trapezoid rule is
    # exact.
    grid = np.union1d(nm, edges)
    low = np.clip(np.searchsorted(nm, grid, side="right") - 1, 0, nm.size - 2)
    t = np.clip((grid - nm[low]) / (nm[low + 1] - nm[low]), 0, 1)
    dense = values[..., low] * (1 - t) + values[..., low + 1] * t
    areas = np.cumsum(0.5 * (dense[..., 1:] + dense[..., :-1]) * np.diff(grid), axis=-1)
    at = np.searchsorted(grid, edges)
    integral = np.concatenate([np.zeros_like(areas[..., :1]), areas], axis=-1)[..., at]
    return np.diff(integral, axis=-1) / np.diff(edges)


def _read_table(name: str) -> np.ndarray:
    with resources.files("shadowgram.scenes").joinpath("tables", name).open(encoding="utf-8") as file:
        columns = np.loadtxt(file, delimiter=",", skiprows=1).T.copy()
    columns.flags.writeable = False  # it is handed out more than once
    return columns


def _labelled(cube: xr.DataArray | ArrayLike, wavelengths: ArrayLike | None) -> tuple[np.ndarray, np.ndarray]:
    """Values (band, y, x) and centres (band,) of a cube, with rising wavelengths."""
    if wavelengths is not None:
        cube = as_datacube(np.asarray(cube), np.asarray(wavelengths))
    elif not isinstance(cube, xr.DataArray) or "wavelength" not in cube.coords:
        raise ValueError("true colour needs the wavelengths of the bands: give wavelengths= in nm")
    check_cube(cube)
    values, nm = cube.values, np.asarray(cube.coords["wavelength"].values, dtype=np.float64)
    return (values, nm) if nm[0] <= nm[-1] else (values[::-1], nm[::-1])


def _linear_rgb(values: np.ndarray, nm: np.ndarray, illuminant: str) -> np.ndarray:
    """Linear sRGB, (3, y, x) float32, before exposure."""
    weights = _rgb_weights(nm, illuminant).astype(np.float32)
    pixels = values.reshape(nm.size, -1).astype(np.float32, copy=False)
    return (weights @ pixels).reshape(3, *values.shape[1:])


def _rgb_weights(nm: np.ndarray, illuminant: str) -> np.ndarray:
    """What one unit of radiance in each band adds to linear R, G and B, (3, band)."""
    if illuminant not in ("D65", "equal-energy"):
        raise ValueError(f'illuminant is "D65" or "equal-energy", got {illuminant!r}')
    table, functions, power = observer()
    edges = _band_edges(nm)
    if edges[0] >= table[-1] or edges[-1] <= table[0]:
        raise ValueError(
            f"true colour needs light within {table[0]:g} to {table[-1]:g} nm, but the bands lie at {nm[0]:g} to "
            f"{nm[-1]:g} nm; are the wavelengths in nm?"
        )
    white = band_means(table, power, edges) if illuminant == "D65" else np.ones(nm.size)
    # The first and the last band stand for all that lies beyond them.
    edges = np.concatenate([[min(edges[0], table[0] - 1)], edges[1:-1], [max(edges[-1], table[-1] + 1)]])
    # The products end in zero, so that the part of a band beyond the visible range adds nothing.
    ends = np.concatenate([[table[0] - 1], table, [table[-1] + 1]])
    xyz = band_means(ends, np.pad(functions * power, ((0, 0), (1, 1))), edges) * np.diff(edges)
    rgb = _XYZ_TO_SRGB @ xyz
    # The matrix is rounded; divided by what it makes of white, grey is exactly grey.
    return rgb / rgb.sum(axis=1, keepdims=True) * (white.max() / white)


def _band_edges(nm: np.ndarray) -> np.ndarray:
    """Half way between neighbouring centres, and as far beyond the outer ones."""
    if nm.size == 1:
        return np.array([nm[0] - 5, nm[0] + 5])
    return np.concatenate([[1.5 * nm[0] - 0.5 * nm[1]], 0.5 * (nm[1:] + nm[:-1]), [1.5 * nm[-1] - 0.5 * nm[-2]]])


def _auto_exposure(linear: np.ndarray) -> float:
    bright = float(np.percentile(np.tensordot(_LUMINANCE, linear, 1), 99))
    return _PAPER_WHITE / bright if bright > 0 else 1.0


def _checked_exposure(exposure: float) -> float:
    if not (np.isfinite(exposure) and exposure > 0):
        raise ValueError(f"exposure is a positive factor on the radiance, got {exposure!r}")
    return float(exposure)


def _into_gamut(linear: np.ndarray) -> np.ndarray:
    """Colours within [0, 1], moved towards grey of the same luminance where they were outside."""
    grey = np.clip(np.tensordot(_LUMINANCE.astype(linear.dtype), linear, 1), 0, 1)
    low, high = linear.min(axis=0), linear.max(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        keep = np.minimum(np.where(low < 0, grey / (grey - low), 1), np.where(high > 1, (1 - grey) / (high - grey), 1))
    return np.clip(grey + keep * (linear - grey), 0, 1)


def _encode(linear: np.ndarray) -> np.ndarray:
    """The sRGB transfer curve."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)
