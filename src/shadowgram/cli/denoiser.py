"""`shadowgram denoiser import`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from . import output

app = typer.Typer(help="Networks that remove noise.", rich_markup_mode=None)


@app.callback()
def _group() -> None: ...


@app.command("import")
def import_(
    weights: Annotated[
        Path, typer.Argument(metavar="FILE", help="Weights of a gray FFDNet: .pth, .pt or .mat.", show_default=False)
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write: .onnx.", show_default=False)],
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Convert weights of other programs.

    The result is a file for shadowgram.priors.FFDNet(path=...).
    """
    from shadowgram.priors.weights_import import import_weights

    output.check_output(out, (".onnx",), (weights,))
    network = import_weights(weights)
    output.write_bytes(out, network.content)
    found = {
        "out": out,
        "layers": network.layers,
        "features": network.features,
        "gives": "noise" if network.residual else "image",
        "noise_map": "first" if network.map_first else "last",
        "gain_db": round(network.gain, 2),
    }
    network_line = (
        f"{out}: {network.layers} layers of {network.features} features; "
        f"the network gives the {found['gives']} and takes the noise map {found['noise_map']}"
    )
    gain_line = f"a test image with noise of 25/255 gained {network.gain:.1f} dB"
    output.report(found, [network_line, gain_line], as_json)
