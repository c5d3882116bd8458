"""Curves: spectra at pixels and quality over the bands."""

from __future__ import annotations

from collections.abc import Mapping

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
