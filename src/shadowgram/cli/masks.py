"""`shadowgram codes`: make, design, analyse, export."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import code_analysis, code_design, mask_export, output
from .arguments import parse_size

if TYPE_CHECKING:
    import numpy as np

app = typer.Typer(help="Coded apertures.", rich_markup_mode=None)
app.command("design")(code_design.design)
app.command("analyse")(code_analysis.analyse)
app.command("export")(mask_export.export)


class Kind(StrEnum):
    """Kinds of code."""

    boolean = "boolean"
    random = "random"
    ideal = "ideal"
    four = "four"
    blue = "blue"
    green = "green"
    s_matrix = "s-matrix"
    hadamard = "hadamard"
    ura = "ura"
    mura = "mura"


CORRELATED = (Kind.ura, Kind.mura)
# What only some kinds take.
TAKEN_BY = {
    "shots": tuple(kind for kind in Kind if kind not in CORRELATED),
    "bands": (Kind.ideal, Kind.four),
    "transmittance": (Kind.random, Kind.blue, Kind.green),
    "cluster": (Kind.green,),
    "mosaic": CORRELATED,
}


@app.callback()
def _codes() -> None: ...


@app.command("make")
def make(
    context: typer.Context,
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write: .nc, .npy, or .png (one picture a shot).")],
    shape: Annotated[str, typer.Option(help="Elements y x x of the code, such as 256x256.")],
    kind: Annotated[Kind, typer.Option(help="Kind of code, see above.")] = Kind.boolean,
    shots: Annotated[int, typer.Option(help="Number of snapshots.", show_default="3; ura, mura 1")] = 3,
    bands: Annotated[int | None, typer.Option(help="ideal, four: bands of a colored code.")] = None,
    transmittance: Annotated[
        float | None,
        typer.Option(
            help="Share of open elements.", show_default="random 0.5; blue, green every element is open in one shot"
        ),
    ] = None,
    cluster: Annotated[float, typer.Option(help="green: about how many elements a cluster has.")] = 4.0,
    mosaic: Annotated[
        bool, typer.Option("--mosaic", help="ura, mura: the whole mask, which repeats the pattern to all sides.")
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed; the same seed gives the same code.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Make a coded aperture and write it to a file.

    Example: shadowgram codes make --shape 256x256 --shots 6 -o code.nc

    \b
    boolean   every element is open in one shot, at random
    random    elements are open or closed, at random
    ideal     colored, with any filters; every voxel is open in one shot
    four      colored, with four kinds of filter
    blue      halftone: open elements keep apart
    green     halftone: open elements form clusters that keep apart
    s-matrix  multiplexed: elements are open in (n + 1)/2 of n shots, n = 3, 7, 11, 15, 19, 23, 31, ...
    hadamard  multiplexed: elements are open in n/2 of n shots, n = 2, 4, 8, 12, 16, 20, 24, ...
    ura       uniformly redundant array, one pattern of p x q elements, twin primes such as 13x11
    mura      modified URA, p x p elements, p an odd prime; or one row, 1 x p, p = 5, 13, 17, 29, ...
    """  # noqa: D301 - \b keeps the lines of the table apart
    output.check_result(out, (".nc", ".npy", ".png"))
    _check_options(context, kind)
    size = parse_size("--shape", shape)
    if kind in CORRELATED:
        code = _correlated(kind, size, mosaic)
    else:
        code = make_code(kind, shots, size, bands, transmittance, seed, cluster)
    text = output.configuration(context)
    files = _write(code, out, text)
    output.write_configuration(out, text)
    values = {"files": files, "shape": list(code.shape), "open": float(code.mean())}
    shown = " × ".join(map(str, code.shape))
    lines = [f"{kind.value} code, {shown}, {100 * code.mean():.1f} % open → {', '.join(str(f) for f in files)}"]
    output.report(values, lines, as_json)


def make_code(
    kind: Kind,
    shots: int,
    shape: tuple[int, int],
    bands: int | None,
    transmittance: float | None,
    seed: int,
    cluster: float = 4.0,
) -> np.ndarray:
    """Code of a kind, (shot, y, x) or (shot, band, y, x)."""
    from shadowgram import codes

    match kind:
        case Kind.boolean:
            return codes.boolean(shots=shots, shape=shape, seed=seed)
        case Kind.random:
            share = 0.5 if transmittance is None else transmittance
            return codes.random(shots=shots, shape=shape, seed=seed, transmittance=share)
        case Kind.blue:
            return codes.blue_noise(shots=shots, shape=shape, seed=seed, transmittance=transmittance)
        case Kind.green:
            return codes.green_noise(shots=shots, shape=shape, seed=seed, cluster=cluster, transmittance=transmittance)
        case Kind.s_matrix:
            return codes.s_code(shots=shots, shape=shape, seed=seed)
        case Kind.hadamard:
            return codes.hadamard_code(shots=shots, shape=shape, seed=seed)
        case _:
            if bands is None:
                raise ValueError(f"a code of kind {kind.value} depends on the band: say --bands")
            return codes.colored(shots=shots, shape=(bands, *shape), filters=kind.value, seed=seed)


def _correlated(kind: Kind, shape: tuple[int, int], mosaic: bool) -> np.ndarray:
    """Pattern that is decoded by correlation, one shot."""
    from shadowgram import codes

    rows, columns = shape
    if kind == Kind.ura:
        pattern = codes.ura(rows, columns)
    elif rows == 1:
        pattern = codes.linear_mura(columns)
    elif rows == columns:
        pattern = codes.mura(rows)
    else:
        raise ValueError(f"a MURA is square or one row, p x p or 1 x p, got --shape {rows}x{columns}")
    return (codes.mosaic(pattern) if mosaic else pattern)[None]


def _check_options(context: typer.Context, kind: Kind) -> None:
    """Refuse an option that this kind does not take, since its user expects something of it."""
    for name, kinds in TAKEN_BY.items():
        source = context.get_parameter_source(name)
        if kind not in kinds and source is not None and source.name == "COMMANDLINE":
            takers = "the kinds " + ", ".join(kinds) if len(kinds) > 1 else f"the kind {kinds[0]}"
            raise ValueError(f"--{name} is not for {kind.value} codes, but for {takers}; leave it out")


def _write(code: np.ndarray, out: Path, text: str) -> list[Path]:
    """Write the code; a PNG holds one shot, so that several shots become out-1.png, out-2.png..."""
    suffix = out.suffix.lower()
    if suffix == ".npy":
        from shadowgram.scenes.readers.numpy_files import npy_bytes

        output.write_bytes(out, bytes(npy_bytes(code)))
        return [out]
    if suffix == ".nc":
        from shadowgram.scenes.readers.native import write_dataset

        write_dataset(code_design.code_dataset(code, text, {}), out)
        return [out]
    if code.ndim == 4:
        raise ValueError("a PNG holds a code (y, x), not a colored one: write it to .nc or .npy")
    from shadowgram.figures.style import picture_png

    files = [out] if len(code) == 1 else [out.with_stem(f"{out.stem}-{shot + 1}") for shot in range(len(code))]
    for shot, file in zip(code, files, strict=True):
        output.write_bytes(file, picture_png(shot))
    return files
