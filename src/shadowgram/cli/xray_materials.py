"""`shadowgram xray materials` and `shadowgram xray spectrum`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import output

if TYPE_CHECKING:
    from shadowgram.xray.materials import Material
    from shadowgram.xray.spectra import Spectrum

ENERGIES = (20.0, 30.0, 40.0, 60.0, 80.0, 100.0, 120.0)  # keV
ANODE_ANGLE = 12.0  # degrees
FAINTEST = 1e-6  # of the brightest energy, below which an energy does not count as one of the spectrum's
COLUMNS = 3  # of the list of names


def materials(
    name: Annotated[
        str | None,
        typer.Argument(metavar="MATERIAL", help="Name or formula; without it, all names.", show_default=False),
    ] = None,
    energy: Annotated[
        list[float] | None,
        typer.Option(help="Photon energy, keV; may be given several times.", show_default="20 to 120"),
    ] = None,
    density: Annotated[
        float | None, typer.Option(help="g/cm³, in place of the known one; a formula needs it.", show_default=False)
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Show the curves from 1 to 300 keV in this PNG.", show_default=False)
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Say how a material attenuates X-rays.

    Example: shadowgram xray materials caffeine --energy 60 --energy 100

    Example: shadowgram xray materials C3H6N6O6 --density 1.82 --plot rdx.png

    Elements are known by name or symbol, compounds and mixtures by NIST's name or a shorter one. The JSON has name, density
    (g/cm³), fractions (by mass), electron_density (1/cm³), and attenuation: for each energy (keV) photoelectric, compton,
    rayleigh, total and energy_absorption (cm²/g), and half_value_layer (cm). Without a material: names.
    """
    from shadowgram.xray.materials import material, material_names

    if name is None:
        names = material_names()
        output.report({"names": names}, _columns(names), as_json)
        return
    if plot is not None:
        output.check_output(plot, (".png",))
    found = material(name, density=density)
    values = _material_values(found, energy or ENERGIES)
    if plot is not None:
        _plot_material(found, plot)
    output.report(values, _material_lines(values), as_json)


def _columns(names: Sequence[str]) -> list[str]:
    """Names in columns, read downwards."""
    rows = -(-len(names) // COLUMNS)
    width = max(map(len, names)) + 2
    return ["".join(f"{name:<{width}}" for name in names[row::rows]).rstrip() for row in range(rows)]


def _material_values(found: Material, energies: Sequence[float]) -> dict[str, object]:
    from shadowgram.xray._elements import symbol

    columns = {
        "energy": energies,
        "photoelectric": found.photoelectric(energies).tolist(),
        "compton": found.compton(energies).tolist(),
        "rayleigh": found.rayleigh(energies).tolist(),
        "total": found.mass_attenuation(energies).tolist(),
        "energy_absorption": found.mass_energy_absorption(energies).tolist(),
        "half_value_layer": found.half_value_layer(energies).tolist(),
    }
    return {
        "name": found.name,
        "density": found.density,
        "fractions": {symbol(z): fraction for z, fraction in found.fractions},
        "electron_density": found.electron_density,
        "attenuation": [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)],
    }


def _material_lines(values: dict) -> list[str]:
    parts = ", ".join(f"{symbol} {100 * fraction:.4g} %" for symbol, fraction in values["fractions"].items())
    rows = [
        f"{row['energy']:>8g}{row['photoelectric']:>15.4g}{row['compton']:>11.4g}{row['rayleigh']:>11.4g}{row['total']:>11.4g}"
        f"{row['energy_absorption']:>11.4g}{row['half_value_layer']:>14.4g}"
        for row in values["attenuation"]
    ]
    return [
        f"{values['name']}: {values['density']:.4g} g/cm³, {values['electron_density']:.4g} electrons/cm³",
        f"by mass: {parts}",
        "",
        f"{'keV':>8}{'photoelectric':>15}{'Compton':>11}{'Rayleigh':>11}{'total':>11}{'μ_en/ρ':>11}{'half-value':>14}",
        f"{'':>8}{'cm²/g':>15}{'cm²/g':>11}{'cm²/g':>11}{'cm²/g':>11}{'cm²/g':>11}{'layer, cm':>14}",
        *rows,
    ]


def _plot_material(found: Material, file: Path) -> None:
    from shadowgram.figures import style, xray_physics

    with style.style():
        output.write_bytes(file, style.png(xray_physics.attenuation(found)))


def spectrum(
    voltage: Annotated[float | None, typer.Option(help="Of a tungsten tube, kV.", show_default=False)] = None,
    file: Annotated[
        Path | None,
        typer.Option(help="Instead of a tube: two columns, keV and weight, or a spectrum of GATE.", show_default=False),
    ] = None,
    filters: Annotated[
        list[str] | None,
        typer.Option(
            "--filter", metavar="NAME:MM", help="Material and mm, such as Al:1.5; several times.", show_default=False
        ),
    ] = None,
    anode_angle: Annotated[
        float | None, typer.Option(help="Of the tube, degrees.", show_default=str(ANODE_ANGLE))
    ] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Write the spectrum: .csv or .txt.", show_default=False)
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Show the spectrum in this PNG.", show_default=False)] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Compute the spectrum of an X-ray tube, or read one, and say how hard it is.

    Example: shadowgram xray spectrum --voltage 120 --filter Al:1.5 -o tube.csv

    Example: shadowgram xray spectrum --file tube.csv --filter Cu:0.5 --plot harder.png

    A tube needs the extra package spekpy. The JSON has mean_energy (keV), half_value_layer (mm of aluminum, of air kerma), energy
    (keV), weight, and total: for a tube photons/cm² per mAs at 1 m, else the sum of the weights.
    """
    _check_files(file, out, plot)
    found = _made(voltage, file, [_parse_filter(text) for text in filters or ()], anode_angle)
    if out is not None:
        from shadowgram.xray.spectra import format_spectrum

        comment = _origin(voltage, file, filters or (), anode_angle)
        output.write_bytes(out, format_spectrum(found, comment).encode())
    if plot is not None:
        _plot_spectrum(found, plot)
    values = _spectrum_values(found)
    output.report(values, _spectrum_lines(values, voltage is not None), as_json)


def _check_files(file: Path | None, out: Path | None, plot: Path | None) -> None:
    if out is not None:
        output.check_output(out, (".csv", ".txt"), inputs=[file])
    if plot is not None:
        output.check_output(plot, (".png",), inputs=[file])


def _made(
    voltage: float | None, file: Path | None, filters: Sequence[tuple[str, float]], anode_angle: float | None
) -> Spectrum:
    from shadowgram.xray import spectra
    from shadowgram.xray.materials import material

    if (voltage is None) == (file is None):
        raise ValueError("say either the --voltage of a tube in kV or the --file of a spectrum")
    if file is None and voltage is not None:
        return spectra.tube(voltage, filters, anode_angle=ANODE_ANGLE if anode_angle is None else anode_angle)
    if anode_angle is not None:
        raise ValueError(
            "a spectrum from a file has no --anode-angle: leave it out, or say --voltage instead of --file"
        )
    found = spectra.read_spectrum(file or Path())
    for name, thickness in filters:
        found = found.filtered(material(name), thickness)
    return found


def _parse_filter(text: str) -> tuple[str, float]:
    try:
        name, thickness = text.rsplit(":", 1)
        return name.strip(), float(thickness)
    except ValueError:
        raise ValueError(f"--filter takes a material and its thickness in mm, such as Al:1.5; got {text!r}") from None


def _origin(voltage: float | None, file: Path | None, filters: Sequence[str], anode_angle: float | None) -> str:
    """How a spectrum was made, for the file that holds it."""
    from shadowgram import __version__

    angle = "" if anode_angle is None else f" --anode-angle {anode_angle:g}"
    given = f"--voltage {voltage:g}{angle}" if voltage is not None else f"--file {'' if file is None else file.name}"
    filtered = "".join(f" --filter {text}" for text in filters)
    lines = [f"shadowgram {__version__}: shadowgram xray spectrum {given}{filtered}"]
    if voltage is not None:
        from spekpy import __version__ as version

        degrees = ANODE_ANGLE if anode_angle is None else anode_angle
        lines.append(f"Tungsten anode at {degrees:g} degrees, from SpekPy {version}; filters by xraylib.")
    return "\n".join([*lines, "Energies are the centres of bins; weights are photons, not energy, and add up to 1."])


def _spectrum_values(found: Spectrum) -> dict[str, object]:
    from shadowgram.xray.materials import material

    return {
        "mean_energy": found.mean_energy,
        "half_value_layer": found.half_value_layer(material("aluminum")),
        "total": found.total,
        "energy": found.energy.tolist(),
        "weight": found.weight.tolist(),
    }


def _spectrum_lines(values: dict, tube: bool) -> list[str]:
    faintest = FAINTEST * max(values["weight"])
    lit = [energy for energy, weight in zip(values["energy"], values["weight"], strict=True) if weight > faintest]
    output_line = [f"output            {values['total']:.4g} photons/cm² per mAs at 1 m"] if tube else []
    return [
        f"energies          {lit[0]:g} to {lit[-1]:g} keV",
        f"mean energy       {values['mean_energy']:.2f} keV",
        f"half-value layer  {values['half_value_layer']:.3f} mm Al",
        *output_line,
    ]


def _plot_spectrum(found: Spectrum, file: Path) -> None:
    from shadowgram.figures import style, xray_physics

    with style.style():
        output.write_bytes(file, style.png(xray_physics.spectrum(found)))
