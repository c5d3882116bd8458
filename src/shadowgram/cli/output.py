"""What the commands write: lines, JSON, files that are whole or absent, and a progress bar."""

from __future__ import annotations

import json
import math
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePath
from typing import Protocol, TextIO

import typer

BAD_INPUT = 2
LINE_EVERY = 30.0  # s between two lines of progress


class Interrupted(Exception):  # noqa: N818 - not an error
    """The user interrupted the work, and what was reached is safe; the message says where."""


def complain(message: str) -> int:
    """One line on stderr; the exit status of bad input."""
    typer.echo(f"shadowgram: {_one_line(message)}", err=True)
    return BAD_INPUT


def print_warning(
    message: Warning | str,
    category: type[Warning],  # noqa: ARG001 - the signature of warnings.showwarning
    filename: str,  # noqa: ARG001
    lineno: int,  # noqa: ARG001
    file: TextIO | None = None,  # noqa: ARG001
    line: str | None = None,  # noqa: ARG001
) -> None:
    """One line on stderr, as `warnings.showwarning`."""
    typer.echo(f"shadowgram: warning: {_one_line(str(message))}", err=True)


def _one_line(text: str) -> str:
    return " ".join(text.split())


def report(values: Mapping[str, object], lines: Sequence[str], as_json: bool) -> None:
    """Print a result on stdout, for machines or for people."""
    if as_json:
        typer.echo(to_json(values))
    else:
        typer.echo("\n".join(lines))


def to_json(values: object) -> str:
    """JSON text that any parser reads: infinite and undefined numbers become null, paths have forward slashes."""
    return json.dumps(_plain(values), indent=2, allow_nan=False, ensure_ascii=False)


def _plain(value: object) -> object:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, PurePath):
        return value.as_posix()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def check_output(out: Path, suffixes: Sequence[str], inputs: Sequence[Path | None] = ()) -> None:
    """Refuse a path that cannot be written, or that would replace an input, before any work is done.

    Raises
    ------
    ValueError
        If the ending is unknown, or `out` is one of `inputs`.
    OSError
        If the folder does not exist or cannot be written.
    """
    if out.suffix.lower() not in suffixes:
        raise ValueError(f"{out} must end in {' or '.join(suffixes)}")
    for given in inputs:
        if given is not None and given.exists() and out.exists() and given.samefile(out):
            raise ValueError(f"{out} is the input; write to another file")
    if out.is_dir():
        raise ValueError(f"{out} is a folder; give a file in it")
    check_folder(out.parent)


def check_result(out: Path, suffixes: Sequence[str], inputs: Sequence[Path | None] = ()) -> None:
    """Refuse a path as `check_output`, and if a JSON file of the user's stands where the settings of the result would go."""
    check_output(out, suffixes, inputs)
    settings = out.with_suffix(".json")
    if settings.exists():
        try:
            ours = json.loads(settings.read_text(encoding="utf-8")).get("program") == "shadowgram"
        except (ValueError, AttributeError):
            ours = False
        if not ours:
            raise ValueError(
                f"{settings}, where the settings of the result would go, is another file; choose another name"
            )


def check_folder(folder: Path) -> None:
    """Raise an OSError unless files can be made in `folder`."""
    if not folder.is_dir():
        raise NotADirectoryError(f"there is no folder {folder}; make it first, or write elsewhere")
    try:
        # Permissions alone do not tell: the file system may be read-only or full.
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise PermissionError(f"cannot write in the folder {folder}: {error.strerror}") from error


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file whole or not at all."""
    from shadowgram.scenes.readers.atomic import replace_file

    replace_file(path, [data])


def configuration(context: typer.Context, **resolved: object) -> str:
    """All settings of a command as JSON: the options with their defaults, what came of them, and the version."""
    from shadowgram import __version__

    command = context.command_path.removeprefix("shadowgram").strip()
    return to_json(
        {"program": "shadowgram", "version": __version__, "command": command, "options": context.params, **resolved}
    )


def write_configuration(out: Path, text: str) -> None:
    """Keep the settings beside a result: cube.nc → cube.json."""
    write_bytes(out.with_suffix(".json"), (text + "\n").encode())


class Update(Protocol):
    """Called now and then during a long work: how far it is, what it does, and seconds left if the caller knows better."""

    def __call__(self, step: int, note: str, left: float | None = None) -> None: ...  # noqa: D102


@contextmanager
def progress(what: str, total: int | None = None) -> Iterator[Update]:
    """Progress of a long work on stderr: on a terminal a bar, after a second; elsewhere a line every 30 seconds.

    Gives a function (step, note, left) to be called now and then. Without `total` a moving bar is shown, and no time left.
    """
    if not sys.stderr.isatty():
        yield from _progress_lines(what, total)
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = [TextColumn("{task.description}"), BarColumn()]
    columns += [] if total is None else [TextColumn("{task.completed:.0f}/{task.total:.0f}")]
    columns += [TextColumn("{task.fields[note]}"), TimeElapsedColumn()]
    columns += [] if total is None else [TextColumn("{task.fields[left]}")]
    bar = Progress(*columns, console=Console(stderr=True), transient=True)
    task = bar.add_task(what, total=total, note="", left="")
    begun = time.monotonic()
    # A timer, since the first news of a long work may be late.
    timer = threading.Timer(1.0, bar.start)
    timer.daemon = True
    timer.start()

    def update(step: int, note: str, left: float | None = None) -> None:
        bar.update(task, completed=step, note=note, left=_time_left(step, total, begun, left))

    try:
        yield update
    finally:
        timer.cancel()
        timer.join()
        bar.stop()


def _progress_lines(what: str, total: int | None) -> Iterator[Update]:
    """Plain lines where there is no terminal; none for a work that is short."""
    begun = said = time.monotonic()
    state = what

    def update(step: int, note: str, left: float | None = None) -> None:
        nonlocal said, state
        of = "" if total is None else f" of {total}"
        state = f"{what}: {step}{of}"
        if time.monotonic() - said >= LINE_EVERY:
            said = time.monotonic()
            parts = [state, f"{duration(said - begun)} so far", _time_left(step, total, begun, left), note]
            typer.echo(f"shadowgram: {', '.join(part for part in parts if part)}", err=True)

    yield update
    if said > begun:
        typer.echo(f"shadowgram: {state}, {duration(time.monotonic() - begun)}", err=True)


def _time_left(step: int, total: int | None, begun: float, left: float | None) -> str:
    """Words for the time left: as the caller says, or as if the rest took as long as what is done."""
    if left is None and total is not None and 0 < step < total:
        left = (time.monotonic() - begun) * (total - step) / step
    return "" if left is None else f"{duration(left)} left"


def duration(seconds: float) -> str:
    """Length of time for people.

    Examples
    --------
    >>> from shadowgram.cli.output import duration
    >>> [duration(seconds) for seconds in (0.84, 59.7, 61, 3600, 7300)]
    ['0.8 s', '1 min', '1 min', '1 h', '2 h 2 min']
    """
    if seconds < 59.5:
        return f"{seconds:.0f} s" if seconds >= 9.95 else f"{seconds:.1f} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    parts = [f"{hours} h"] * (hours > 0) + [f"{minutes} min"] * (minutes > 0)
    return " ".join(parts)
