"""Curves: spectra at pixels, quality over the bands, resolution over the mask position."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .style import MARKERS, new_figure


def spectra(
    wavelengths: np.ndarray,
    truth: Mapping[str, np.ndarray],
    estimates: Mapping[str, Mapping[str, np.ndarray]],
    quality: Mapping[str, np.ndarray],
) -> Figure:
    """Spectra at labelled pixels against the truth, and the PSNR of every band.

    Parameters
    ----------
    wavelengths : (band,) nm.
    truth : label of the pixel → (band,) spectrum.
    estimates : imager → label of the pixel → (band,) spectrum.
    quality : imager → (band,) PSNR, dB.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.figures.lines import spectra
    >>> line = np.linspace(0, 1, 5)
    >>> figure = spectra(np.linspace(450, 650, 5), {"T1": line}, {"CASSI": {"T1": line}}, {"CASSI": 30 + line})
    >>> len(figure.axes)
    2
    """
    figure = new_figure(3.4 * (len(truth) + 1), 3.0)
    *pixels, bands = figure.subplots(1, len(truth) + 1)
    for axes, (label, spectrum) in zip(pixels, truth.items(), strict=True):
        draw_spectra(axes, wavelengths, spectrum, {name: of[label] for name, of in estimates.items()})
        axes.set_title(f"Spectrum at {label}")
    for number, (name, values) in enumerate(quality.items()):
        bands.plot(wavelengths, values, marker=MARKERS[number], label=name)
    bands.set(title="Quality of each band", xlabel="wavelength (nm)", ylabel="PSNR (dB)")
    figure.legend(*pixels[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(estimates) + 1)
    return figure


def draw_spectra(
    axes: Axes, wavelengths: np.ndarray, truth: np.ndarray, estimates: Mapping[str, np.ndarray], unit: str = "radiance"
) -> None:
    """Draw estimated spectra over the true one."""
    ink = axes.xaxis.label.get_color()
    axes.plot(wavelengths, truth, color=ink, linewidth=5, alpha=0.28, solid_capstyle="round", label="truth")
    for number, (name, values) in enumerate(estimates.items()):
        axes.plot(wavelengths, values, marker=MARKERS[number], label=name)
    axes.set(xlabel="wavelength (nm)", ylabel=f"{unit} (relative)")
    axes.set_ylim(min(0.0, axes.get_ylim()[0]), None)


def resolution(
    mask_positions: np.ndarray, bands: np.ndarray, x_pitch: np.ndarray, *, chosen: Sequence[float] = ()
) -> Figure:
    """Bands and spatial resolution that an SSCSI reaches, over the position of its mask.

    Parameters
    ----------
    mask_positions : (n,) s, from 0 = on the detector to 1 = on the spectral plane.
    bands : (n,) number of bands.
    x_pitch : (n,) µm, spatial resolution along the dispersion.
    chosen : positions to mark.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.figures.lines import resolution
    >>> s = np.linspace(0, 0.9, 10)
    >>> len(resolution(s, 1 + 64 * s, np.full(10, 10.0), chosen=[0.125]).axes)
    2
    """
    figure = new_figure(7.0, 3.0)
    left, right = figure.subplots(1, 2)
    left.step(mask_positions, bands, where="mid")
    left.set(title="Spectral resolution", xlabel="mask position s", ylabel="bands")
    right.plot(mask_positions, x_pitch, color="C1")
    right.set(title="Spatial resolution along x", xlabel="mask position s", ylabel="pitch on the detector (µm)")
    right.set_ylim(0, None)
    for axes in (left, right):
        for s in chosen:
            axes.axvline(s, color=axes.xaxis.label.get_color(), linestyle=":", linewidth=1.0)
            axes.annotate(
                f"s = {s:g}", (s, 1), (3, -10), xycoords=("data", "axes fraction"), textcoords="offset points"
            )
    return figure
