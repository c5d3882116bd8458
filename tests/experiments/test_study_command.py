"""`shadowgram study`: list, run, show, and one clear line for what goes wrong."""

import dataclasses
import json
import sys
import types

import pytest

import shadowgram as sg
from shadowgram.cli import main, output
from shadowgram.experiments import holdings
from shadowgram.experiments.journal import FILE_NAME
from shadowgram.experiments.source import generated
from shadowgram.experiments.study import Claim


@pytest.fixture
def studies(little, tmp_path, monkeypatch):
    """Name → study, in place of the studies of the package; the working directory is empty."""
    specs = [little.Spec(number=n) for n in range(4)]
    known = {name: little.make_study(specs, name) for name in ("first", "second")}

    def load(name):
        if name not in known:
            raise ValueError(f"there is no study {name!r}; there are {', '.join(known)}")
        return known[name]

    stand_in = types.SimpleNamespace(STUDIES=tuple(known), load=load)
    monkeypatch.setitem(sys.modules, "shadowgram.experiments.studies", stand_in)
    monkeypatch.setattr("shadowgram.experiments.studies", stand_in, raising=False)
    monkeypatch.chdir(tmp_path)
    return known


def run(capsys, command, status=0):
    """Standard output and error of a command."""
    got = main(command.split())
    said = capsys.readouterr()
    assert got == status, said.err
    return said


def refused(capsys, command):
    said = run(capsys, command, 2)
    assert said.out == ""
    assert said.err.startswith("shadowgram: ")
    assert said.err.count("\n") == 1
    return said.err


def with_trouble(little, studies, **troubles):
    """Give the first study's tasks troubles, by number."""
    specs = [little.Spec(number=n, trouble=troubles.get(f"n{n}", "")) for n in range(4)]
    studies["first"] = little.make_study(specs, "first")


@pytest.mark.parametrize("command", ["study list", "study run", "study show"])
def test_help_has_a_runnable_example(capsys, command):
    assert f"Example: shadowgram {command}" in " ".join(run(capsys, f"{command} --help").out.split())


def test_run_draws_and_compares(studies, tmp_path, capsys):
    said = run(capsys, "study run first")
    assert said.out.splitlines() == [
        "first on chart: Norms of random matrices (Fig. 1, page 33)",
        "  page 33: The norm is positive",
        "    found: 4 norms",
        "    agrees: yes",
        "  page 34: It is less than 1 | never",
        "    found: it is not",
        "    agrees: no",
        "    why: too many numbers",
        "  page 35: It is beautiful",
        "    found: nothing",
        "    agrees: open",
        "agrees 1 of 3, 1 open; figure in shadowgram-studies/first.png",
    ]
    assert said.err.startswith("shadowgram: first on chart: 4 computed, 0 reused, 0 failed, of 4 tasks; ")
    folder = tmp_path / "shadowgram-studies"
    assert sorted(path.name for path in folder.iterdir()) == ["first.png", FILE_NAME]
    picture = (folder / "first.png").read_bytes()
    (folder / "first.png").unlink()
    assert "0 computed, 4 reused" in run(capsys, "study run first").err
    assert (folder / "first.png").read_bytes() == picture


def test_run_in_json(studies, capsys):
    said = json.loads(run(capsys, "study run first --quick --json").out)
    (one,) = said["studies"]
    assert (one["study"], one["scene"], one["quick"], one["computed"]) == ("first", "chart", True, 1)
    assert one["figure"] == "shadowgram-studies/first-quick.png"
    assert one["claims"][1] == {
        "page": 34, "says": "It is less than 1 | never", "found": "it is not", "agrees": False, "why": "too many numbers"
    }  # fmt: skip
    assert one["failed"] == []
    assert said["seconds"] > 0


def test_run_all_in_processes(studies, tmp_path, capsys):
    said = run(capsys, "study run all --workers 1 --out here")
    assert said.out.splitlines()[-1].startswith("2 of 2 studies complete, ")
    assert said.err.count(" 4 computed") == 2
    assert sorted(path.name for path in (tmp_path / "here").iterdir()) == ["first.png", FILE_NAME, "second.png"]


def test_show_needs_the_journal_alone(studies, tmp_path, capsys):
    sg.scenes.write(sg.scenes.chart(size=16, bands=3, seed=0), tmp_path / "lego.nc")
    run(capsys, "study run first --scene lego.nc --out here")
    picture = (tmp_path / "here" / "first-lego.png").read_bytes()
    (tmp_path / "here" / "first-lego.png").unlink()
    (tmp_path / "lego.nc").unlink()
    said = json.loads(run(capsys, "study show first --scene lego --out here --json").out)
    assert (said["scene"], said["figure"]) == ("lego", "here/first-lego.png")
    assert len(said["claims"]) == 3
    assert (tmp_path / "here" / "first-lego.png").read_bytes() == picture


def test_show_says_what_is_missing(studies, little, tmp_path, capsys):
    assert "there is no journal here/journal.sqlite" in refused(capsys, "study show first --out here")
    run(capsys, "study run first --quick --out here")
    line = refused(capsys, "study show first --out here")
    assert "here/journal.sqlite has 1 of the 4 records of first on chart;" in line
    assert "run 'shadowgram study run first --out here'" in line
    assert "has no records of first on 'lego'; scenes it has: chart" in refused(
        capsys, "study show first --out here --scene lego"
    )
    with_trouble(little, studies, n1="raise")
    run(capsys, "study run first --out here", 1)
    assert "has 3 of the 4 records of first on chart (1 failed: ZeroDivisionError: division by zero)" in refused(
        capsys, "study show first --out here"
    )


def test_scenes_of_the_same_name_are_told_apart(studies, tmp_path, capsys):
    for seed in (0, 1):
        (tmp_path / f"{seed}").mkdir()
        sg.scenes.write(sg.scenes.chart(size=16, bands=3, seed=seed), tmp_path / f"{seed}" / "lego.nc")
        run(capsys, f"study run first --quick --scene {seed}/lego.nc")
    line = refused(capsys, "study show first --quick --scene lego")
    names = line.split("scenes it has: ")[1].strip().split(", ")
    assert len(set(names)) == 2
    for name in names:
        run(capsys, f"study show first --quick --scene {name}")
        assert (tmp_path / "shadowgram-studies" / f"first-{name}-quick.png").exists()
    listed = run(capsys, "study list").out
    assert all(f"{name}, quick: 1 records" in listed for name in names)


def test_claims_that_cannot_be_made_do_not_hide_the_others(studies, capsys):
    def broken(records):
        raise KeyError("psnr")

    for name in ("first", "second"):
        run(capsys, f"study run {name}")
    studies["first"] = dataclasses.replace(studies["first"], claims=broken)
    listed = run(capsys, "study list").out
    assert "KeyError" in listed
    assert "agrees 1 of 3, 1 open" in listed


def test_list(studies, little, tmp_path, capsys):
    assert run(capsys, "study list").out.splitlines() == [
        "first      Norms of random matrices (Fig. 1, page 33)",
        "second     Norms of random matrices (Fig. 1, page 33)",
    ]
    assert not (tmp_path / "shadowgram-studies").exists()
    run(capsys, "study run first")
    studies["first"] = little.make_study([little.Spec(number=n) for n in range(5)], "first", quick=4)
    lines = run(capsys, "study list").out.splitlines()
    assert lines[1] == "           chart: 4 of 5 records"
    assert lines[2] == "           chart, quick: 4 records, agrees 1 of 3, 1 open"
    assert "             page 33: The norm is positive" in run(capsys, "study list --claims").out.splitlines()
    listed = json.loads(run(capsys, "study list --json").out)["studies"]
    assert [study["name"] for study in listed] == ["first", "second"]
    whole, quick = listed[0]["holdings"]
    assert (whole["records"], whole["total"], whole["claims"]) == (4, 5, [])
    assert (quick["quick"], len(quick["claims"])) == (True, 3)


def test_table_of_claims(studies, tmp_path, capsys):
    sg.scenes.write(sg.scenes.chart(size=16, bands=3, seed=0), tmp_path / "lego.nc")
    said = studies["first"].claims

    def by_scene(records):
        claims = said(records)
        return claims if len(records) == 4 else [dataclasses.replace(claims[0], agrees=False, why="few"), *claims[1:]]

    studies["first"] = dataclasses.replace(studies["first"], claims=by_scene)
    run(capsys, "study run first")
    run(capsys, "study run first --quick --scene lego.nc")
    run(capsys, "study list --markdown claims.md")
    lines = (tmp_path / "claims.md").read_text().splitlines()
    anchor = "[first](#first-norms-of-random-matrices)"
    table = lines.index("| study | page | the source says | chart | lego, quick |")
    assert lines[table : table + 5] == [
        "| study | page | the source says | chart | lego, quick |",
        "| --- | --- | --- | --- | --- |",
        f"| {anchor} | 33 | The norm is positive | yes | no |",
        rf"| {anchor} | 34 | It is less than 1 \| never | no | no |",
        f"| {anchor} | 35 | It is beautiful | open | open |",
    ]
    assert "## first: Norms of random matrices" in lines
    assert "![Norms of random matrices](first.png)" in lines
    assert "- chart: yes. 4 norms." in lines
    assert "- lego, quick: no. 1 norms. Why: few." in lines
    assert (tmp_path / "first.png").read_bytes().startswith(b"\x89PNG")


def test_studies_of_a_chapter(studies, tmp_path, capsys):
    studies["second"] = dataclasses.replace(studies["second"], name="second-study", source="Table 3.1, pages 56 and 57")
    studies["first"] = dataclasses.replace(studies["first"], source="Figs. 2.20 and 3.1, page 33")
    assert run(capsys, "study list --chapter 3").out == (
        "second-study Norms of random matrices (Table 3.1, pages 56 and 57)\n"
    )
    for name in studies:
        run(capsys, f"study run {name} --quick")
    run(capsys, "study list --chapter 2 --markdown claims.md")
    page = (tmp_path / "claims.md").read_text()
    assert "written by `shadowgram study list --chapter 2 --markdown claims.md`" in page
    assert "## first:" in page
    assert "second" not in page
    assert "there is no study of chapter 5; there are of 2, 3" in refused(capsys, "study list --chapter 5")


def test_studies_by_name_on_a_page_of_questions(studies, tmp_path, capsys):
    asked = [Claim(page=None, says="How many are there?", found="4 norms", agrees=None)]
    studies["second"] = dataclasses.replace(studies["second"], name="second", claims=lambda _: asked)
    run(capsys, "study run second")
    assert run(capsys, "study list second").out.startswith("second ")
    run(capsys, "study list second --markdown found.md")
    page = (tmp_path / "found.md").read_text()
    assert page.startswith("# What was found\n")
    assert "written by `shadowgram study list second --markdown found.md`" in page
    assert "| study |" not in page
    assert "**Beyond the source: How many are there?**" in page
    assert "there is no study 'third'" in refused(capsys, "study list third")


def test_chapter_of_a_study(little):
    def chapter(source):
        return dataclasses.replace(little.make_study([]), source=source).chapter

    assert [chapter(source) for source in ("Fig. 2.4, page 15", "Section 3.6.5", "pages 3 and 4")] == [2, 3, None]


def test_bad_input(studies, tmp_path, capsys):
    assert "there is no study 'third'; there are first, second" in refused(capsys, "study run third")
    assert "there is no study 'all'" in refused(capsys, "study show all")
    assert "not both" in refused(capsys, "study run first --workers 2 --cluster tcp://127.0.0.1:1")
    assert "--workers" in refused(capsys, "study run first --workers 0")
    assert "none.nc" in refused(capsys, "study run first --scene none.nc")
    assert "must end in .md" in refused(capsys, "study list --markdown claims.txt")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / FILE_NAME).write_text("a diary")
    for command in ("study run first --out .", "study show first --out .", "study list --out ."):
        assert "journal.sqlite is not a journal of shadowgram; choose another folder" in refused(capsys, command)
    assert (tmp_path / FILE_NAME).read_text() == "a diary"


def test_failures_end_with_status_1_and_one_line(studies, little, tmp_path, capsys):
    with_trouble(little, studies, n1="raise", n2="raise")
    said = run(capsys, "study run all", 1)
    problem = (
        "shadowgram: first: 2 of 4 tasks failed, the first, number=1 trouble=raise: ZeroDivisionError: division by zero"
    )
    assert sum(line.startswith(problem) for line in said.err.splitlines()) == 1
    assert said.out.splitlines()[-1].startswith("1 of 2 studies complete")
    assert not (tmp_path / "shadowgram-studies" / "first.png").exists()
    assert (tmp_path / "shadowgram-studies" / "second.png").exists()
    one = json.loads(run(capsys, "study run first --json", 1).out)["studies"][0]
    assert len(one["failed"]) == 2
    assert one["problem"].startswith("2 of 4 tasks failed")


def test_a_figure_that_cannot_be_drawn_does_not_stop_the_other_studies(studies, capsys):
    studies["first"] = dataclasses.replace(studies["first"], figure=lambda records: records["psnr"])
    said = run(capsys, "study run all", 1)
    assert "shadowgram: first: no figure: TypeError: list indices must be" in said.err
    assert "second.png" in said.out


def test_interrupt(studies, little, capsys, monkeypatch):
    monkeypatch.setenv("SHADOWGRAM_THREADS", "1")
    with_trouble(little, studies, n1="interrupt", n2="slow")
    said = run(capsys, "study run all", 130)
    assert said.err.splitlines()[-1] == (
        "shadowgram: interrupted: 2 of 4 results of first are in shadowgram-studies/journal.sqlite;"
        " of the running tasks 1 were finished and 0 dropped; the same command goes on"
    )
    assert "second" not in said.out
    assert "2 computed, 2 reused" in run(capsys, "study run first").err


def test_progress_without_a_terminal(studies, little, capsys, monkeypatch):
    monkeypatch.setattr(output, "LINE_EVERY", 0.0)
    with_trouble(little, studies, n1="wait", n2="wait")
    lines = run(capsys, "study run all").err.splitlines()
    assert any("first (1 of 2): 2 of 4, " in line and " so far, " in line and " left" in line for line in lines)
    assert any(line.startswith("shadowgram: second (2 of 2): 4 of 4, ") for line in lines)
    monkeypatch.setattr(output, "LINE_EVERY", 30.0)
    assert len(run(capsys, "study run all").err.splitlines()) == 2


def test_the_bar_shows_the_time_left(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setattr(output.threading, "Timer", AtOnce)
    with output.progress("work", 8) as update:
        update(2, "a note", 90.0)
    text = capsys.readouterr().err
    assert "2/8" in text
    assert "a note" in text
    assert "2 min left" in text
    with output.progress("work", 8) as update:
        update(2, "a note")
    assert " s left" in capsys.readouterr().err


class AtOnce:
    """A timer that does not wait."""

    def __init__(self, seconds, function):
        self.start = function

    def cancel(self):
        pass

    def join(self):
        pass


def test_file_names():
    study = types.SimpleNamespace(name="fig-1")
    lego = dataclasses.replace(generated(), name="lego", path="/somewhere/lego.nc")
    assert holdings.figure_name(study, lego, False) == "fig-1-lego.png"
    assert holdings.figure_name(study, lego, True) == "fig-1-lego-quick.png"
