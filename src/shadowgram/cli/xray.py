"""`shadowgram xray`: materials, spectra, scenes, simulations, scans and reconstructions."""

from __future__ import annotations

import typer

from . import xray_dose, xray_materials, xray_reconstruct, xray_scan, xray_simulate

app = typer.Typer(help="X-ray backscatter scanners.", rich_markup_mode=None, no_args_is_help=True)
app.command("materials")(xray_materials.materials)
app.command("spectrum")(xray_materials.spectrum)
app.command("scene")(xray_simulate.scene)
app.command("simulate")(xray_simulate.simulate)
app.command("scan")(xray_scan.scan)
app.command("pencil")(xray_scan.pencil)
app.command("dose")(xray_dose.dose)
app.command("reconstruct")(xray_reconstruct.reconstruct)
