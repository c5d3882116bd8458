"""`shadowgram bench`."""

from __future__ import annotations

import dataclasses
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from . import output


class Group(StrEnum):
    """Groups of cases."""

    operators = "operators"
    basis = "basis"
    iteration = "iteration"
    reconstruction = "reconstruction"
    codes = "codes"
    transport = "transport"
    denoisers = "denoisers"
    scaling = "scaling"
    threads = "threads"
    memory = "memory"


def bench(
    name: Annotated[
        Group | None, typer.Argument(help="What to time; by default everything.", show_default=False)
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the results as JSON.")] = False,
    out: Annotated[Path | None, typer.Option(help="File to keep the results in: .json, or .md for the table.")] = None,
    peers: Annotated[
        str | None, typer.Option(metavar="PYTHON", help="Python of an environment with the packages to compare with.")
    ] = None,
    size: Annotated[int, typer.Option(help="Pixels a side of the datacube.")] = 256,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer repeats, and no large problems.")] = False,
) -> None:
    """Time everything on one thread, against references and against what the machine can do.

    Example: shadowgram bench operators
    """
    from shadowgram.experiments.bench import peers as others
    from shadowgram.experiments.bench.run import GROUPS, run
    from shadowgram.experiments.bench.spec import BenchSpec
    from shadowgram.experiments.bench.table import lines

    if out is not None:
        output.check_output(out, (".json", ".md"))
    if peers is not None:
        others.check(peers)
    spec = BenchSpec(size=size)
    if quick:
        spec = dataclasses.replace(spec, seconds=0.3, sizes=(128, 256))
    groups = GROUPS if name is None else (name.value,)
    with output.progress("bench", len(groups) + 1 + (peers is not None)) as advance:
        steps = iter(range(len(groups) + 3))
        results = run(spec, groups, peers, lambda text: advance(next(steps), text))
    values, text = dataclasses.asdict(results), lines(results)
    if out is not None:
        content = output.to_json(values) if out.suffix.lower() == ".json" else "\n".join(text)
        output.write_bytes(out, f"{content}\n".encode())
    output.report(values, text, as_json)
