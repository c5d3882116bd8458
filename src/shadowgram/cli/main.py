"""Entry point of the command line: the list of commands, and how a run ends."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Sequence
from typing import Annotated

import typer

from . import benchmark, cameras, captured_shots, demo, denoiser, files, masks, recovery, resolution, study, xray
from .output import Interrupted, complain, print_warning

OK, INTERRUPTED = 0, 130

app = typer.Typer(
    name="shadowgram",
    help="Coded-aperture imaging: design codes, simulate spectral imagers, reconstruct what they saw.",
    rich_markup_mode=None,  # plain help, and half the start-up time
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("demo")(demo.demo)
app.command("info")(files.info)
app.command("convert")(files.convert)
app.command("compare")(files.compare)
app.command("capture")(cameras.capture)
app.command("import")(captured_shots.import_shots)
app.command("reconstruct")(recovery.reconstruct)
app.command("resolution")(resolution.resolution)
app.add_typer(masks.app, name="codes")
app.add_typer(study.app, name="study")
app.add_typer(xray.app, name="xray")
app.add_typer(denoiser.app, name="denoiser")
app.command("bench")(benchmark.bench)


def _show_version(asked: bool) -> None:
    if asked:
        from shadowgram import __version__

        typer.echo(f"shadowgram {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None: ...


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    arguments : as after ``shadowgram`` in a shell; by default those of this process.

    Returns
    -------
    int
        0; 2 after bad input, with one line on stderr; 130 after an interrupt. Anything unforeseen is raised.

    Examples
    --------
    >>> from shadowgram.cli import main
    >>> main(["--version"])  # doctest: +ELLIPSIS
    shadowgram ...
    0
    """
    given = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    with warnings.catch_warnings():
        warnings.simplefilter("default", UserWarning)
        warnings.showwarning = print_warning
        try:
            status = app(given, prog_name="shadowgram", standalone_mode=False)
        except BrokenPipeError:
            # The reader of our output has gone, as in "shadowgram info FILE | head -1"; there is nobody left to tell.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return OK
        except MemoryError as error:
            return complain(f"not enough memory: {error}")
        except OSError as error:
            return complain(f"{error.strerror}: {error.filename}" if error.strerror and error.filename else str(error))
        except (ValueError, TypeError) as error:
            return complain(str(error))
        except Interrupted as error:
            complain(str(error))
            return INTERRUPTED
        except (KeyboardInterrupt, typer.Abort):
            status = INTERRUPTED
        except Exception as error:  # noqa: BLE001 - what is not about the command line is raised again
            return complain(_usage(error))
    if status == INTERRUPTED:  # Typer gives this status to Ctrl-C as well
        complain("interrupted; no file is half written")
    return status if isinstance(status, int) else OK


def _usage(error: Exception) -> str:
    """What the argument parser has to say about the command line; anything else is a bug and is raised again."""
    if not hasattr(error, "format_message"):
        raise error
    context = getattr(error, "ctx", None)
    command = context.command_path if context else "shadowgram"
    return f"{error.format_message().rstrip('.')}; see '{command} --help'"  # type: ignore[attr-defined]
