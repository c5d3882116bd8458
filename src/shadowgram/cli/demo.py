"""`shadowgram demo`."""

from __future__ import annotations

import dataclasses
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import typer

from . import output


def demo(
    out: Annotated[Path, typer.Option(help="Folder to write; made if it does not exist.")] = Path("shadowgram-demo"),
    quick: Annotated[bool, typer.Option("--quick", help="A quarter of the pixels and half of the bands.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of scene, codes and noise.")] = 0,
    threads: Annotated[int | None, typer.Option(help="Threads; by default all processors.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Reconstruct a generated scene with four imagers, and write an HTML report.

    Example: shadowgram demo --quick --out shadowgram-demo
    """
    from shadowgram import threads as use_threads
    from shadowgram.experiments import demo as experiment
    from shadowgram.experiments import demo_report

    out.mkdir(parents=True, exist_ok=True)
    output.check_folder(out)
    spec = dataclasses.replace(experiment.QUICK if quick else experiment.DemoSpec(), seed=seed)
    command = f"shadowgram demo{' --quick' if quick else ''}{f' --seed {seed}' if seed else ''}"
    done = 0
    with (
        output.progress("demo", experiment.steps(spec) + 2) as update,
        nullcontext() if threads is None else use_threads(threads),
    ):

        def step(what: str) -> None:
            nonlocal done
            update(done, what)
            done += 1

        result = experiment.run(spec, step)
        files = demo_report.write(result, out, command, step)
    lines = [
        f"{row['imager']:<26}{row['solver']:<9}{row['model']:<8}{row['measured_with']:<24}"
        f"{row['psnr']:6.2f} dB  {row['seconds']:6.2f} s"
        for row in result.records()
    ]
    lines += [f"{len(files)} files in {out}, {result.seconds:.1f} s; open {files[0]}"]
    output.report({"files": files, "records": result.records(), "seconds": result.seconds}, lines, as_json)
