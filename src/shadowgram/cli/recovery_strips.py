"""`shadowgram reconstruct --strips`: what it does beyond the options of `shadowgram reconstruct`."""

from __future__ import annotations

import dataclasses
import json
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from . import output

if TYPE_CHECKING:
    from shadowgram.experiments.run import Progress
    from shadowgram.experiments.strips import StripsReport

    from .recovery_solvers import Spec

AUTO = "auto"


def parse_strips(text: str) -> int | None:
    """Rows of a strip; None for "auto", as many as the memory allows.

    Examples
    --------
    >>> from shadowgram.cli.recovery_strips import parse_strips
    >>> parse_strips("auto"), parse_strips("256")
    (None, 256)
    """
    if text == AUTO:
        return None
    if not text.isdecimal() or int(text) < 1:
        raise ValueError(f"--strips takes a number of detector rows such as 256, or auto; got {text!r}")
    return int(text)


def reconstruct_in_strips(
    context: typer.Context,
    shots: Path,
    out: Path,
    spec: Spec,
    *,
    strips: str,
    memory: float,
    workers: int | None,
    cluster: str | None,
    threads: int | None,
    as_json: bool,
) -> None:
    """Reconstruct a measurement by strips, write the cube and its settings, and print how it went.

    Parameters
    ----------
    context : of the command; its options go into the cube's settings.
    shots, out : measurement and cube.
    spec : the solver, which must be EigenTV.
    strips : rows of a strip, or "auto".
    memory : GB, of this process and its workers.
    workers : processes of this machine; None for one strip after the other in this process.
    cluster : address of a Dask scheduler, instead.
    threads : of this process; None for all.
    as_json : print the result as JSON.

    Raises
    ------
    output.Interrupted
        After Ctrl-C; the same command goes on.
    """
    from shadowgram import threads as use_threads
    from shadowgram.experiments.strips import reconstruct_strips

    if workers is not None and cluster is not None:
        raise ValueError("give --workers for processes of this machine, or --cluster for a scheduler, not both")
    if not 0 < memory < float("inf"):
        raise ValueError(f"--memory is a number of GB above 0, got {memory:g}")
    output.check_result(out, (".nc",), inputs=[shots])
    rows = parse_strips(strips)
    text = output.configuration(context, solver={"type": type(spec).__name__, **dataclasses.asdict(spec)})
    with (
        output.progress("reconstructing strips") as update,
        nullcontext() if threads is None else use_threads(threads),
    ):
        report = reconstruct_strips(
            shots,
            out,
            spec,
            rows=rows,
            memory_limit=1e9 * memory,
            workers=cluster if cluster is not None else workers or 0,
            configuration=text,
            progress=lambda state: update(state.done, _note(state)),
        )
    if report.interrupted:
        raise output.Interrupted(
            f"interrupted: {report.computed + report.reused} of {report.strips} strips are in {report.folder};"
            " the same command goes on"
        )
    output.write_configuration(out, json.dumps(json.loads(text) | {"strips": _values(report)}, indent=2))
    output.report(_values(report), _lines(report), as_json)


def _note(state: Progress) -> str:
    left = "" if state.seconds_left is None else f", {output.duration(state.seconds_left)} left"
    return f"{state.done} of {state.total}{left}" + (f", {state.label}" if state.label else "")


def _values(report: StripsReport) -> dict[str, object]:
    """Report as JSON holds it."""
    values = {"file": report.path.as_posix(), **dataclasses.asdict(report)}
    return {name: value for name, value in values.items() if name not in ("path", "folder", "interrupted")}


def _lines(report: StripsReport) -> list[str]:
    size = f"{report.strips} strips of {report.rows} rows, {report.halo} more on each side"
    reused = f", {report.reused} of them by an earlier run" if report.reused else ""
    noise = "" if report.noise is None else f", noise {report.noise:.3g}"
    return [
        f"{'in one piece' if report.strips == 1 else size}{reused}{noise}",
        (
            f"{report.converged} of {report.strips} converged, {output.duration(report.seconds)},"
            f" {report.peak_memory / 1e9:.2f} GB at most; written to {report.path}"
        ),
    ]
