"""`shadowgram study`: list, run, show."""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from . import output, running

if TYPE_CHECKING:
    from shadowgram.experiments.holdings import Holding
    from shadowgram.experiments.journal import Journal
    from shadowgram.experiments.run import Executor, Summary
    from shadowgram.experiments.source import SceneSource
    from shadowgram.experiments.study import Claim, Study

FAILED = 1
FOLDER = Path("shadowgram-studies")

app = typer.Typer(
    help="Figures and tables of the source, computed again: long experiments that may be interrupted at any time.",
    rich_markup_mode=None,
    no_args_is_help=True,
)

Name = Annotated[str, typer.Argument(help="Study, such as fig-2-15; 'study list' names them all.", show_default=False)]
Out = Annotated[Path, typer.Option(help="Folder of the journal and the figures.")]
Quick = Annotated[bool, typer.Option("--quick", help="A small version of the study.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


@app.command("list")
def list_studies(
    names: Annotated[
        list[str] | None, typer.Argument(help="Studies, such as fig-2-15; by default all of them.", show_default=False)
    ] = None,
    out: Out = FOLDER,
    claims: Annotated[
        bool, typer.Option("--claims", help="Print every claim of the source, and what was found.")
    ] = False,
    markdown: Annotated[
        Path | None, typer.Option(help="File for a page of all claims, .md; the figures go beside it.")
    ] = None,
    chapter: Annotated[
        int | None, typer.Option(help="Chapter of the source; by default all of them.", show_default=False)
    ] = None,
    as_json: Json = False,
) -> None:
    """List the studies, what the journal has of them, and whether it agrees with the source.

    Example: shadowgram study list --claims
    """
    if markdown is not None:
        output.check_output(markdown, (".md",))
    found = _held(_chosen(names or [], chapter), out)
    width = max(11, *(len(study.name) + 1 for study, _ in found))
    lines = []
    for study, held in found:
        lines += [f"{study.name:<{width}}{study.title} ({study.source})"]
        for holding in held:
            lines.append(f"{'':<11}{_state(holding)}")
            lines += [f"{'':<13}{line}" for line in _claim_lines(holding.claims)] if claims else []
    if markdown is not None:
        _write_page(markdown, found, out, "".join(f" {name}" for name in names or []), chapter)
    values = [
        {"name": study.name, "title": study.title, "source": study.source, "revision": study.revision}
        | {"holdings": [_holding_values(holding) for holding in held]}
        for study, held in found
    ]
    output.report({"studies": values}, lines, as_json)


def _chosen(names: Sequence[str], chapter: int | None) -> list[Study]:
    """The studies of these names, or of a chapter, or all of them."""
    from shadowgram.experiments import studies

    known = [studies.load(name) for name in names or studies.STUDIES]
    if chapter is None:
        return known
    chosen = [study for study in known if study.chapter == chapter]
    if not chosen:
        there = sorted({study.chapter for study in known if study.chapter is not None})
        raise ValueError(f"there is no study of chapter {chapter}; there are of {', '.join(map(str, there))}")
    return chosen


def _write_page(
    markdown: Path, found: Sequence[tuple[Study, Sequence[Holding]]], out: Path, named: str, chapter: int | None
) -> None:
    from shadowgram.experiments import holdings
    from shadowgram.experiments.journal import read_journal

    chosen = named if chapter is None else f"{named} --chapter {chapter}"
    text, figures = holdings.page(found, f"shadowgram study list{chosen} --markdown {markdown.name}")
    if figures:
        with read_journal(out) as journal:
            for name, (study, held) in figures.items():
                records = holdings.gather(study, held.scene, held.quick, journal)
                output.write_bytes(markdown.parent / name, holdings.figure_png(study, records, dpi=100))
    output.write_bytes(markdown, text.encode())


@app.command("run")
def run(
    name: Annotated[str, typer.Argument(help="Study, such as fig-2-15, or 'all'.", show_default=False)],
    quick: Quick = False,
    scene: Annotated[
        Path | None, typer.Option(help="Datacube to use in place of the generated scene.", show_default=False)
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Compute in this many processes; by default in threads of one.")
    ] = None,
    cluster: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Compute on the workers of this Dask scheduler.")
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder of measured data, for the studies that need them; without it 'all' leaves them out.",
            show_default=False,
        ),
    ] = None,
    out: Out = FOLDER,
    as_json: Json = False,
) -> None:
    """Compute what the journal does not have yet, draw the figure and compare with the source. Interrupt and run again at will.

    Example: shadowgram study run fig-2-15 --quick
    """
    from shadowgram.experiments import studies
    from shadowgram.experiments.journal import open_journal

    begun = time.monotonic()
    if data is not None:
        _use_data(data)
    chosen = [studies.load(one) for one in (studies.STUDIES if name == "all" else [name])]
    source = _source(scene)
    left_out: list[Study] = []
    executor = running.executor(workers, cluster)
    out.mkdir(parents=True, exist_ok=True)
    output.check_folder(out)
    done: list[_Done] = []
    with open_journal(out) as journal, executor:
        if name == "all":
            left_out = _left_out(chosen, source, quick, journal)
            chosen = [study for study in chosen if study not in left_out]
        for place, study in enumerate(chosen, 1):
            what = study.name if len(chosen) == 1 else f"{study.name} ({place} of {len(chosen)})"
            done.append(_run(study, source, quick, journal, executor, what))
            if not as_json and done[-1].figure is not None:
                typer.echo("\n".join(_found_lines(study, source, done[-1].figure, done[-1].claims)))
            if done[-1].summary.interrupted:
                break
    seconds = time.monotonic() - begun
    if as_json:
        without = [{"study": study.name, "why": _why_left_out(study)} for study in left_out]
        typer.echo(output.to_json({"studies": [one.values() for one in done], "left_out": without, "seconds": seconds}))
    elif name == "all":
        whole = sum(one.figure is not None for one in done)
        without = f", {len(left_out)} left out for want of data" if left_out else ""
        typer.echo(
            f"{whole} of {len(chosen)} studies complete{without}, {output.duration(seconds)}; figures are in {out}"
        )
    _end(done, journal.path)


@app.command("show")
def show(
    name: Name,
    scene: Annotated[
        str | None, typer.Option(metavar="NAME", help="Scene of the journal; by default the generated one.")
    ] = None,
    quick: Quick = False,
    out: Out = FOLDER,
    as_json: Json = False,
) -> None:
    """Draw the figure again and compare with the source, from the journal alone.

    Example: shadowgram study show fig-2-15 --quick
    """
    from shadowgram.experiments import holdings, studies
    from shadowgram.experiments.journal import read_journal

    study = studies.load(name)
    with read_journal(out) as journal:
        source = holdings.find_scene(study, scene, journal)
        records = holdings.gather(study, source, quick, journal)
    figure, claims = _draw(study, source, quick, records, out)
    values = {"study": study.name, "scene": source.name, "quick": quick, "figure": figure, "claims": _plain(claims)}
    output.report(values, _found_lines(study, source, figure, claims), as_json)


@dataclasses.dataclass(kw_only=True)
class _Done:
    """One study of a run."""

    study: Study
    scene: SceneSource
    quick: bool
    summary: Summary
    figure: Path | None = None
    claims: Sequence[Claim] = ()
    problem: str = ""

    def values(self) -> dict[str, object]:
        counts = dataclasses.asdict(self.summary)
        counts["failed"] = [{"task": label, "error": error} for label, error in self.summary.failed]
        return {
            "study": self.study.name,
            "scene": self.scene.name,
            "quick": self.quick,
            **counts,
            "figure": self.figure,
            "claims": _plain(self.claims),
            "problem": self.problem or None,
        }


def _run(study: Study, scene: SceneSource, quick: bool, journal: Journal, executor: Executor, what: str) -> _Done:
    from shadowgram.experiments import holdings
    from shadowgram.experiments.run import run as run_study
    from shadowgram.experiments.tasks import make_tasks, one_line

    total = len({task.key for task in make_tasks(study, scene, quick)})
    with output.progress(what, total) as update:
        summary = run_study(
            study, scene, quick, journal, executor=executor,
            progress=lambda state: update(state.done, state.label, state.seconds_left),
        )  # fmt: skip
    done = _Done(study=study, scene=scene, quick=quick, summary=summary)
    typer.echo(_summary_line(done), err=True)
    if summary.failed:
        label, error = summary.failed[0]
        done.problem = f"{len(summary.failed)} of {total} tasks failed, the first, {label or 'the only one'}: {error}"
    elif not summary.interrupted:
        try:
            records = holdings.gather(study, scene, quick, journal)
            scene = holdings.find_scene(study, scene.digest, journal)
            done.figure, done.claims = _draw(study, scene, quick, records, journal.path.parent)
        except Exception as error:  # noqa: BLE001 - the next study of a long night must not suffer
            done.problem = f"no figure: {one_line(error)}"
    if done.problem:
        output.complain(f"{study.name}: {done.problem}")
    return done


def _draw(study: Study, scene: SceneSource, quick: bool, records: Sequence[Any], out: Path) -> tuple[Path, list[Claim]]:
    from shadowgram.experiments import holdings

    figure = out / holdings.figure_name(study, scene, quick)
    output.write_bytes(figure, holdings.figure_png(study, records))
    return figure, list(study.claims(records))


def _end(done: Sequence[_Done], journal: Path) -> None:
    """End as the last study did: interrupted, with a status that says that something failed, or well."""
    last = done[-1].summary if done else None
    if last is not None and last.interrupted:
        raise output.Interrupted(
            f"interrupted: {last.computed + last.reused} of {last.total} results of {done[-1].study.name} are in {journal};"
            f" of the running tasks {last.finished} were finished and {last.dropped} dropped; the same command goes on"
        )
    if any(one.problem for one in done):
        raise typer.Exit(FAILED)


def _use_data(folder: Path) -> None:
    """Let the tasks find measured data, here and in processes that are started from here."""
    from shadowgram.experiments.data_folder import VARIABLE

    if not folder.is_dir():
        raise NotADirectoryError(f"there is no folder {folder}; give the one that has the measured data")
    os.environ[VARIABLE] = str(folder.resolve())


def _left_out(chosen: Sequence[Study], scene: SceneSource, quick: bool, journal: Journal) -> list[Study]:
    """Studies of a long night that cannot be computed here, with a line that says why."""
    without = [study for study in chosen if _lacks_data(study, scene, quick, journal)]
    for study in without:
        output.complain(f"{study.name} is left out: {_why_left_out(study)}")
    return without


def _lacks_data(study: Study, scene: SceneSource, quick: bool, journal: Journal) -> bool:
    """Whether a study needs measured data, no folder of them was named, and the journal does not have all records."""
    from shadowgram.experiments.data_folder import VARIABLE
    from shadowgram.experiments.tasks import make_tasks

    if not study.data or os.environ.get(VARIABLE):
        return False
    keys = {task.key for task in make_tasks(study, scene, quick)}
    return len(journal.records(keys)) < len(keys)


def _why_left_out(study: Study) -> str:
    from shadowgram.experiments.data_folder import VARIABLE

    return f"it needs measured data ({study.data}); name their folder with --data or {VARIABLE}"


def _source(scene: Path | None) -> SceneSource:
    from shadowgram.experiments.source import generated, recorded

    # The whole path: workers have another working directory, and the journal is read in others.
    return generated() if scene is None else recorded(scene.resolve())


def _held(studies: Sequence[Study], out: Path) -> list[tuple[Study, list[Holding]]]:
    from shadowgram.experiments import holdings
    from shadowgram.experiments.journal import FILE_NAME, read_journal

    if not (out / FILE_NAME).exists():
        return [(study, []) for study in studies]
    with read_journal(out) as journal:
        return [(study, holdings.holdings(study, journal)) for study in studies]


def _state(holding: Holding) -> str:
    from shadowgram.experiments.holdings import agreement

    if holding.complete:
        return f"{holding.label}: {holding.records} records, {agreement(holding.claims)}"
    if holding.problem:
        return f"{holding.label}: {holding.records} records, {holding.problem}"
    return f"{holding.label}: {holding.records} of {holding.total} records"


def _holding_values(holding: Holding) -> dict[str, object]:
    return {
        "scene": holding.scene.name,
        "digest": holding.scene.digest,
        "quick": holding.quick,
        "records": holding.records,
        "total": holding.total,
        "claims": _plain(holding.claims),
    }


def _plain(claims: Sequence[Claim]) -> list[dict[str, object]]:
    return [dataclasses.asdict(claim) for claim in claims]


def _found_lines(study: Study, scene: SceneSource, figure: Path, claims: Sequence[Claim]) -> list[str]:
    from shadowgram.experiments.holdings import agreement

    return [
        f"{study.name} on {scene.name}: {study.title} ({study.source})",
        *(f"  {line}" for line in _claim_lines(claims)),
        f"{agreement(claims)}; figure in {figure}",
    ]


def _claim_lines(claims: Sequence[Claim]) -> list[str]:
    from shadowgram.experiments.holdings import place, verdict

    lines = []
    for claim in claims:
        lines += [f"{place(claim.page)}: {claim.says}".replace("Page", "page"), f"  found: {claim.found}"]
        lines += [f"  agrees: {verdict(claim)}"] if claim.page is not None else []
        lines += [f"  why: {claim.why}"] if claim.why else []
    return lines


def _summary_line(done: _Done) -> str:
    summary = done.summary
    return (
        f"shadowgram: {done.study.name} on {done.scene.name}: {summary.computed} computed, {summary.reused} reused,"
        f" {len(summary.failed)} failed, of {summary.total} tasks; {output.duration(summary.seconds)}"
    )
