"""`shadowgram codes export`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import output
from .arguments import parse_size, read_code

if TYPE_CHECKING:
    import numpy as np

# What only some kinds of output take; "dmd" is a .png for a micromirror device.
TAKEN_BY = {
    "pitch": (".gds", ".svg", ".png"),
    "polarity": (".gds", ".svg"),
    "bias": (".gds", ".svg"),
    "gap": (".gds",),
    "columns": (".gds",),
    "marks": (".gds",),
    "title": (".gds",),
    "pixels": (".png",),
    "dmd": ("dmd",),
    "mirrors": ("dmd",),
    "offset": ("dmd",),
}


class Polarity(StrEnum):
    """What the polygons are."""

    open = "open"
    chrome = "chrome"


def export(
    context: typer.Context,
    code: Annotated[Path, typer.Argument(help="Binary code to make: .nc, .npy or .png.", show_default=False)],
    out: Annotated[
        Path, typer.Option("-o", "--out", help="File to write: .gds (all shots), .svg or .png (one a shot).")
    ],
    pitch: Annotated[float | None, typer.Option(help="Side of an element, µm; a whole number of nm.")] = None,
    polarity: Annotated[
        Polarity, typer.Option(help="What is drawn: open areas or chrome (.gds, .svg).")
    ] = Polarity.open,
    bias: Annotated[float, typer.Option(help="µm by which edges of open areas move inwards (.gds, .svg).")] = 0.0,
    gap: Annotated[float, typer.Option(help="µm between shots (.gds).")] = 1000.0,
    columns: Annotated[int | None, typer.Option(help="Shots in a row (.gds); all, if not given.")] = None,
    marks: Annotated[bool, typer.Option(help="Draw crosses, numbers of the shots and the title (.gds).")] = True,
    title: Annotated[str | None, typer.Option(help="Text below the shots (.gds); the size, if not given.")] = None,
    pixels: Annotated[int, typer.Option(help="Pixels along the side of an element (.png).")] = 1,
    dmd: Annotated[str | None, typer.Option(help="Make .png frames for a device of y x x mirrors: 1080x1920.")] = None,
    mirrors: Annotated[int, typer.Option(help="Mirrors along the side of an element (--dmd).")] = 1,
    offset: Annotated[str, typer.Option(help="Mirrors y,x from the centre, down and right (--dmd).")] = "0,0",
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Write a binary code as a photomask (.gds), a drawing (.svg), a picture (.png) or frames for a micromirror device.

    Example: shadowgram codes export code.nc -o mask.gds --pitch 10
    """
    output.check_result(out, (".gds", ".svg", ".png"), [code])
    kind = _check_options(context, out, dmd, pitch)
    from shadowgram.codes import layout

    shots = layout.check_binary(read_code(code))
    files = [out] if kind == ".gds" or len(shots) == 1 else _numbered(out, len(shots))
    if dmd is not None:
        size = parse_size("--dmd", dmd)
        _write_frames(files, layout.dmd_frames(shots, frame=size, mirrors=mirrors, offset=_parse_offset(offset)))
    elif pitch is not None and kind == ".gds":
        options = {
            "polarity": polarity.value,
            "bias": bias,
            "gap": gap,
            "columns": columns,
            "marks": marks,
            "title": title,
        }
        layout.write_gds(shots, out, pitch=pitch, **options)
    elif pitch is not None and kind == ".svg":
        for shot, file in enumerate(files):
            layout.write_svg(shots, file, pitch=pitch, shot=shot, polarity=polarity.value, bias=bias)
    elif pitch is not None:
        _write_pictures(files, shots, pitch, pixels)
    output.write_configuration(out, output.configuration(context))
    contacts = 0 if bias else layout.corner_contacts(shots)
    _report(shots, files, pitch, contacts if kind in (".gds", ".svg") else None, as_json)


def _check_options(context: typer.Context, out: Path, dmd: str | None, pitch: float | None) -> str:
    """Kind of output; an option that it does not take is refused, since its user expects something of it."""
    kind = out.suffix.lower() if dmd is None else "dmd"
    if kind == "dmd" and out.suffix.lower() != ".png":
        raise ValueError(f"--dmd makes .png frames, got {out}")
    for name, kinds in TAKEN_BY.items():
        source = context.get_parameter_source(name)
        if kind not in kinds and source is not None and source.name == "COMMANDLINE":
            takers = " and ".join("--dmd" if taker == "dmd" else taker for taker in kinds)
            raise ValueError(f"--{name} is for {takers}; leave it out")
    if kind != "dmd" and pitch is None:
        raise ValueError("say --pitch, the side of an element in µm")
    return kind


def _numbered(out: Path, count: int) -> list[Path]:
    return [out.with_stem(f"{out.stem}-{shot + 1}") for shot in range(count)]


def _parse_offset(text: str) -> tuple[int, int]:
    try:
        down, right = (int(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"--offset takes mirrors y,x, such as 20,-40; got {text!r}") from None
    return down, right


def _write_frames(files: list[Path], frames: np.ndarray) -> None:
    from shadowgram.figures.masks import frame_png

    for file, frame in zip(files, frames, strict=True):
        output.write_bytes(file, frame_png(frame))


def _write_pictures(files: list[Path], shots: np.ndarray, pitch: float, pixels: int) -> None:
    from shadowgram.figures.masks import mask_png

    for file, shot in zip(files, shots, strict=True):
        output.write_bytes(file, mask_png(shot, pitch=pitch, pixels=pixels))


def _report(shots: np.ndarray, files: list[Path], pitch: float | None, contacts: int | None, as_json: bool) -> None:
    rows, columns = shots.shape[1:]
    size = None if pitch is None else [rows * pitch / 1000, columns * pitch / 1000]
    values = {
        "files": files,
        "shape": list(shots.shape),
        "open": float(shots.mean()),
        "size_mm": size,
        "corner_contacts": contacts,
    }
    count = "1 shot" if len(shots) == 1 else f"{len(shots)} shots"
    lengths = "" if size is None else f", {size[0]:g} × {size[1]:g} mm each"
    lines = [f"{count} of {rows} × {columns} elements{lengths} → {', '.join(map(str, files))}"]
    if contacts:
        lines.append(
            f"{contacts} corners where open elements only touch: the process may join or part them; --bias parts them"
        )
    output.report(values, lines, as_json)
