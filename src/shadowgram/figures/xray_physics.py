"""The physics of X-rays in pictures: attenuation curves, spectra, and where Compton scattering goes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes
from matplotlib.ticker import FuncFormatter

from .style import new_figure

if TYPE_CHECKING:
    from shadowgram.xray.materials import Material
    from shadowgram.xray.spectra import Spectrum

_RANGE = (1.0, 300.0)  # keV
_BOTTOM = 1e-3  # cm²/g below which nothing is shown


def attenuation(of: Material) -> Figure:
    """Attenuation of a material over the photon energy: its three parts, their sum, and the energy absorption.

    Examples
    --------
    >>> from shadowgram.figures.xray_physics import attenuation
    >>> from shadowgram.xray.materials import material
    >>> len(attenuation(material("water")).axes[0].lines)
    5
    """
    energy = np.geomspace(*_RANGE, 2000)
    curves = {
        r"total $\mu/\rho$": (of.mass_attenuation(energy), "C0", "-", 2.2),
        "photoelectric": (of.photoelectric(energy), "C1", "--", 1.4),
        "Compton": (of.compton(energy), "C2", "-.", 1.4),
        "Rayleigh": (of.rayleigh(energy), "C3", ":", 1.6),
        r"energy absorption $\mu_\mathrm{en}/\rho$": (of.mass_energy_absorption(energy), "C4", "-", 1.2),
    }
    figure = new_figure(6.4, 4.2)
    axes = figure.subplots()
    for name, (values, colour, dash, width) in curves.items():
        axes.plot(energy, values, color=colour, linestyle=dash, linewidth=width, label=name)
    axes.set(
        title=f"{of.name}, {of.density:.4g} g/cm³",
        xlabel="photon energy (keV)",
        ylabel="cm²/g",
        xscale="log",
        yscale="log",
        xlim=_RANGE,
        ylim=(_BOTTOM, None),
    )
    axes.xaxis.set_major_formatter(FuncFormatter(lambda keV, _: f"{keV:g}"))
    axes.legend()
    return figure


def spectrum(of: Spectrum, title: str = "Spectrum") -> Figure:
    """Spectrum with its mean energy and its half-value layer in aluminum, and what that layer leaves of it.

    Examples
    --------
    >>> from shadowgram.figures.xray_physics import spectrum
    >>> from shadowgram.xray.spectra import shipped_tube
    >>> spectrum(shipped_tube()).axes[0].get_xlabel()
    'photon energy (keV)'
    """
    from shadowgram.xray.materials import material

    aluminum = material("aluminum")
    layer = of.half_value_layer(aluminum)
    figure = new_figure(6.4, 3.6)
    axes = figure.subplots()
    behind = of.filtered(aluminum, layer).weight
    mean = of.mean_energy
    for weight, label, colour in ((of.weight, "spectrum", "C0"), (behind, f"behind {layer:.2f} mm Al", "C1")):
        _draw_spectrum(axes, of.energy, 100 * weight / of.total, label, colour)
    ink = axes.xaxis.label.get_color()
    axes.axvline(mean, color=ink, linestyle=":", linewidth=1.0, label=f"mean energy {mean:.1f} keV")
    axes.set(
        title=f"{title}: half-value layer {layer:.2f} mm Al", xlabel="photon energy (keV)", ylabel="photons (% of all)"
    )
    axes.set_ylim(0, None)
    axes.legend()
    return figure


def _draw_spectrum(axes: Axes, energy: np.ndarray, percent: np.ndarray, label: str, colour: str) -> None:
    if len(energy) < 2:
        axes.vlines(energy, 0, percent, color=colour, linewidth=2, label=label)
        return
    axes.step(energy, percent, where="mid", color=colour, label=label)
    axes.fill_between(energy, percent, step="mid", color=colour, alpha=0.15, linewidth=0)


def klein_nishina(of: Material, energies: Sequence[float] = (20.0, 60.0, 120.0)) -> Figure:
    """Differential cross section of Compton scattering per electron, free and bound in a material, polar and over the angle.

    Parameters
    ----------
    of : the material that binds the electrons.
    energies : keV.

    Notes
    -----
    Source: Salazar (2022), fig. 4.1 right, with free electrons only.

    Examples
    --------
    >>> from shadowgram.figures.xray_physics import klein_nishina
    >>> from shadowgram.xray.materials import material
    >>> [axes.name for axes in klein_nishina(material("water")).axes]
    ['polar', 'rectilinear']
    """
    from shadowgram.xray.compton import bound_compton
    from shadowgram.xray.compton import klein_nishina as free

    figure = new_figure(9.0, 3.8)
    polar, linear = figure.add_subplot(1, 2, 1, projection="polar"), figure.add_subplot(1, 2, 2)
    theta = np.linspace(0, np.pi, 361)
    for number, energy in enumerate(energies):
        colour = f"C{number % 6}"
        for values, dash, name in (
            (free(energy, theta), "--", f"{energy:g} keV, free"),
            (bound_compton(of, energy, theta), "-", f"{energy:g} keV, in {of.name}"),
        ):
            millibarn = 1000 * values
            linear.plot(np.degrees(theta), millibarn, color=colour, linestyle=dash, label=name)
            # A figure of revolution: the lower half is the upper one turned over.
            whole = np.concatenate([theta, 2 * np.pi - theta[::-1]])
            polar.plot(whole, np.concatenate([millibarn, millibarn[::-1]]), color=colour, linestyle=dash)
    linear.set(title="Over the angle", xlabel="scattering angle θ (degrees)", ylabel="dσ/dΩ (mb/sr per electron)")
    linear.set_xlim(0, 180)
    linear.set_xticks(range(0, 181, 30))
    linear.set_ylim(0, None)
    linear.legend()
    if isinstance(polar, PolarAxes):
        polar.set_rticks([20, 40, 60, 80])
        polar.set_rlabel_position(68)
        polar.set_thetagrids(range(0, 360, 45), [f"{min(angle, 360 - angle)}°" for angle in range(0, 360, 45)])
    polar.set_title("By direction, the photon coming from the left")
    return figure
