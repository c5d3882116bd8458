"""What the commands write: lines, JSON, files that are whole or absent, and a progress bar."""

from __future__ import annotations

import json
import math
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePath
from typing import TextIO

import typer

BAD_INPUT = 2


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


@contextmanager
def progress(what: str, total: int | None = None) -> Iterator[Callable[[int, str], None]]:
    """Progress bar on stderr, on terminals only, and only after a second of work.

    Gives a function (step, note) to be called now and then; without `total` a moving bar is shown.
    """
    if not sys.stderr.isatty():
        yield lambda step, note: None  # noqa: ARG005 - the signature of update
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[note]}"), TimeElapsedColumn())
    bar = Progress(*columns, console=Console(stderr=True), transient=True)
    task = bar.add_task(what, total=total, note="")
    # A timer, since the first news of a long work may be late.
    timer = threading.Timer(1.0, bar.start)
    timer.daemon = True
    timer.start()
    try:
        yield lambda step, note: bar.update(task, completed=step, note=note)
    finally:
        timer.cancel()
        timer.join()
        bar.stop()
