"""`shadowgram codes make`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import output
from .arguments import parse_size

if TYPE_CHECKING:
    import numpy as np

app = typer.Typer(help="Coded apertures.", rich_markup_mode=None)


class Kind(StrEnum):
    """Kinds of code."""

    boolean = "boolean"
    random = "random"
    ideal = "ideal"
    four = "four"


@app.callback()
def _codes() -> None: ...


@app.command("make")
def make(
    context: typer.Context,
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write: .nc, .npy, or .png (one picture a shot).")],
    shape: Annotated[str, typer.Option(help="Elements y x x of the code, such as 256x256.")],
    kind: Annotated[
        Kind, typer.Option(help="boolean (complementary), random; ideal, four: colored, any filter or four kinds.")
    ] = Kind.boolean,
    shots: Annotated[int, typer.Option(help="Number of snapshots.")] = 3,
    bands: Annotated[int | None, typer.Option(help="Bands of a colored code.")] = None,
    transmittance: Annotated[float, typer.Option(help="Share of open elements of a random code.")] = 0.5,
    seed: Annotated[int, typer.Option(min=0, help="Seed; the same seed gives the same code.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Make a coded aperture and write it to a file.

    Example: shadowgram codes make --shape 256x256 --shots 6 -o code.nc
    """
    output.check_result(out, (".nc", ".npy", ".png"))
    code = make_code(kind, shots, parse_size("--shape", shape), bands, transmittance, seed)
    text = output.configuration(context)
    files = _write(code, out, text)
    output.write_configuration(out, text)
    values = {"files": files, "shape": list(code.shape), "open": float(code.mean())}
    shown = " × ".join(map(str, code.shape))
    lines = [f"{kind.value} code, {shown}, {100 * code.mean():.1f} % open → {', '.join(str(f) for f in files)}"]
    output.report(values, lines, as_json)


def make_code(
    kind: Kind, shots: int, shape: tuple[int, int], bands: int | None, transmittance: float, seed: int
) -> np.ndarray:
    """Code of a kind, (shot, y, x) or (shot, band, y, x)."""
    from shadowgram import codes

    if kind == Kind.boolean:
        return codes.boolean(shots=shots, shape=shape, seed=seed)
    if kind == Kind.random:
        return codes.random(shots=shots, shape=shape, seed=seed, transmittance=transmittance)
    if bands is None:
        raise ValueError(f"a code of kind {kind.value} depends on the band: say --bands")
    return codes.colored(shots=shots, shape=(bands, *shape), filters=kind.value, seed=seed)


def _write(code: np.ndarray, out: Path, text: str) -> list[Path]:
    """Write the code; a PNG holds one shot, so that several shots become out-1.png, out-2.png..."""
    suffix = out.suffix.lower()
    if suffix == ".npy":
        from shadowgram.scenes.readers.numpy_files import npy_bytes

        output.write_bytes(out, bytes(npy_bytes(code)))
        return [out]
    if suffix == ".nc":
        import xarray as xr

        from shadowgram import __version__
        from shadowgram.scenes.readers.native import write_dataset

        axes = ("shot", "y", "x") if code.ndim == 3 else ("shot", "band", "y", "x")
        attributes = {"kind": "code", "configuration": text, "shadowgram_version": __version__}
        write_dataset(xr.Dataset({"code": (axes, code)}, attrs=attributes), out)
        return [out]
    if code.ndim == 4:
        raise ValueError("a PNG holds a code (y, x), not a colored one: write it to .nc or .npy")
    from shadowgram.figures.style import picture_png

    files = [out] if len(code) == 1 else [out.with_stem(f"{out.stem}-{shot + 1}") for shot in range(len(code))]
    for shot, file in zip(code, files, strict=True):
        output.write_bytes(file, picture_png(shot))
    return files
