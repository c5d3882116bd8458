"""`shadowgram xray simulate` and `shadowgram xray scene`: what they print and write, and one line for what is wrong."""

import importlib
import json
import types

import numpy as np
import pytest
import typer

import shadowgram as sg
from shadowgram.cli import main, xray_results, xray_simulate
from shadowgram.scenes.readers.native import read_dataset
from shadowgram.xray.montecarlo.arrays import ORDERS
from shadowgram.xray.phase_space import read_phase_space
from shadowgram.xray.scene import shipped_scene, shipped_scenes

SCENE = """
title = "Two plates"
exposure = 0.5

[world]
size = [400, 400, 400]
material = "vacuum"

[source]
position = [0, 0, -100]
activity = 4e6
spectrum = { energy = 60 }

[[solids]]
name = "slab"
role = "target"
material = "water"
shape = { kind = "box", centre = [0, 0, 5], size = [100, 100, 10] }

[[detectors]]
name = "plate left"
centre = [-45, 0, -55]
size = [70, 160, 10]
material = { name = "sodium iodide", density = 3.67 }
pixels = [4, 3]

[[detectors]]
name = "plate_left"
centre = [45, 0, -55]
size = [70, 160, 10]
material = { name = "sodium iodide", density = 3.67 }
resolution = 0.07
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    app = typer.Typer(rich_markup_mode=None, add_completion=False, pretty_exceptions_enable=False)
    xray = typer.Typer(rich_markup_mode=None)
    xray.command("simulate")(xray_simulate.simulate)
    xray.command("scene")(xray_simulate.scene)
    app.add_typer(xray, name="xray")
    monkeypatch.setattr(importlib.import_module("shadowgram.cli.main"), "app", app)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "two.toml").write_text(SCENE)
    return tmp_path


def run(capsys, command, status=0):
    got = main(["xray", *command.split()])
    said = capsys.readouterr()
    assert got == status, said.err
    return said


def refused(capsys, command):
    said = run(capsys, command, 2)
    assert said.out == ""
    assert said.err.startswith("shadowgram: ")
    assert said.err.count("\n") == 1
    return said.err


@pytest.mark.parametrize("command", ["simulate", "scene"])
def test_help_has_a_runnable_example(capsys, command):
    assert f"Example: shadowgram xray {command}" in " ".join(run(capsys, f"{command} --help").out.split())


def test_table_has_counts_by_order_and_what_they_are_per_shot(capsys):
    lines = run(capsys, "simulate two.toml --histories 2e4 --seed 3").out.splitlines()
    found = sg.xray.simulate(sg.xray.read_scene("two.toml"), histories=20_000, seed=3)
    assert lines[0] == "Two plates"
    assert lines[1].startswith("20000 photons followed in ")
    assert " ".join(lines[3].split()) == "per source photon per shot of 2e+06 photons"
    for name in ("all", "plate left", "plate_left"):
        one = found.tallies[name]
        each, shot = (xray_results.with_error(f * float(one.mean), f * float(one.standard_error)) for f in (1, 2e6))
        assert " ".join(f"{name} {each} {shot}".split()) in [" ".join(line.split()) for line in lines]
    words = [line.split()[0] for line in lines if line.startswith("    ")]
    present = [order for order, count in zip(ORDERS, found.tallies["all/orders"].mean, strict=True) if count > 0]
    assert [word for word in words if word in ORDERS][: len(present)] == present
    assert "single" in present
    assert {"fluorescence", "air", "leak"}.isdisjoint(words)
    backwards = found.tallies["escaped/backward"]
    assert any(
        xray_results.with_error(float(backwards.mean), float(backwards.standard_error)) in line for line in lines
    )
    dose = found.tallies["dose/slab"]
    assert any(
        line.startswith("  slab") and xray_results.with_error(float(dose.mean), float(dose.standard_error)) in line
        for line in lines
    )


def test_a_scene_without_detectors_shows_what_escapes(capsys):
    lines = run(capsys, "simulate slab-water --histories 2000").out.splitlines()
    assert "photons that leave the world" in lines
    assert not any("counts" in line for line in lines)


def test_json_is_what_the_run_gives(capsys):
    said = run(capsys, "simulate two.toml --histories 20000 --seed 3 --variance-reduction --json").out
    values = json.loads(said)
    found = sg.xray.simulate(sg.xray.read_scene("two.toml"), histories=20_000, seed=3, variance_reduction=True)
    assert (values["title"], values["histories"], values["finished"]) == ("Two plates", 20_000, True)
    assert values["photons_per_shot"] == 2e6
    assert values["tallies"].keys() == found.tallies.keys()
    for name, estimate in found.tallies.items():
        one = values["tallies"][name]
        np.testing.assert_array_equal(one["mean"], estimate.mean)
        np.testing.assert_array_equal(one["standard_error"], estimate.standard_error)
        assert one["unit"] == estimate.unit
        assert tuple(one.get("axes", ())) == estimate.axes
    orders = values["tallies"]["plate left/orders"]
    assert (orders["order"], orders["edges"]) == (list(ORDERS), [None])
    assert len(values["tallies"]["all"]) == 3


def test_json_file_has_the_settings_too(capsys, folder):
    run(capsys, "simulate two.toml --histories 2000 -o a.json --stop-at 0.9 --shot 0")
    values = json.loads((folder / "a.json").read_text())
    assert (values["program"], values["command"]) == ("shadowgram", "xray simulate")
    assert values["options"]["stop_at"] == 0.9
    assert values["tallies"]["all"]["mean"] > 0


def test_netcdf_file_has_every_tally_with_its_bins(capsys, folder):
    values = json.loads(run(capsys, "simulate two.toml --histories 20000 -o a.nc --json").out)
    data = read_dataset(folder / "a.nc")
    by_name = {variable.attrs["long_name"]: name for name, variable in data.data_vars.items()}
    for name, one in values["tallies"].items():
        np.testing.assert_array_equal(data[by_name[name]], one["mean"])
        np.testing.assert_array_equal(data[by_name[f"standard error of {name}"]], one["standard_error"])
        assert data[by_name[name]].attrs["units"] == one["unit"]
    assert len(by_name) == 2 * len(values["tallies"])
    spectrum = data[by_name["plate left/spectrum"]]
    assert spectrum.energy.attrs["units"] == "keV"
    np.testing.assert_allclose(spectrum.energy[:2], [0.25, 0.75])
    assert data[by_name["plate left/image"]].shape == (4, 3)
    assert json.loads(data.attrs["settings"])["options"]["histories"] == "20000"
    assert json.loads((folder / "a.json").read_text())["command"] == "xray simulate"


def test_phase_space_and_picture(capsys, folder):
    said = run(capsys, "simulate two.toml --histories 20000 --phase-space p.npz --plot p.png")
    space = read_phase_space(folder / "p.npz")
    assert said.err.endswith(f"shadowgram: p.npz has {len(space)} photons\n")
    assert (space.histories, space.detectors) == (20_000, ("plate left", "plate_left"))
    assert (folder / "p.png").read_bytes().startswith(b"\x89PNG")


def test_stop_at_an_error(capsys):
    values = json.loads(run(capsys, "simulate two.toml --histories 1e6 --stop-at 0.1 --variance-reduction --json").out)
    one = values["tallies"]["all"]
    assert values["histories"] < 1e6
    assert 0 < one["standard_error"] / one["mean"] <= 0.1


class Interrupting:
    """In place of what watches a run: Ctrl-C after some batches."""

    def __init__(self, update, stop_at):
        self.batches = 0

    def __call__(self, state):
        self.batches += 1
        if self.batches == 40:
            raise KeyboardInterrupt


def test_an_interrupt_keeps_what_was_found_and_a_checkpoint_goes_on(capsys, folder, monkeypatch):
    command = "simulate two.toml --histories 20000 --checkpoint c.npz -o a.json --phase-space p.h5"
    with monkeypatch.context() as patch:
        patch.setattr(xray_simulate, "_Watch", Interrupting)
        said = run(capsys, command, 130)
    assert said.err == (
        "shadowgram: interrupted: this is what 6250 of 20000 photons gave; c.npz keeps it, and the same command goes on;"
        " p.h5 was not written\n"
    )
    assert "6250 photons followed" in said.out
    part = json.loads((folder / "a.json").read_text())
    assert (part["histories"], part["finished"]) == (6250, False)
    assert not (folder / "p.h5").exists()
    run(capsys, command)
    whole = json.loads((folder / "a.json").read_text())
    (folder / "c.npz").unlink()
    run(capsys, command)
    again = json.loads((folder / "a.json").read_text())
    assert whole["tallies"] == again["tallies"]
    assert read_phase_space(folder / "p.h5").histories == 20_000


def test_time_left_does_not_count_the_compilation(monkeypatch):
    said = []
    clock = iter([100.0, 102.0, 104.0])
    monkeypatch.setattr(xray_simulate.time, "monotonic", lambda: next(clock))
    watch = xray_simulate._Watch(lambda *news: said.append(news), 0.01)
    for done, error in ((100, np.inf), (200, 0.04), (300, 0.02)):
        watch(types.SimpleNamespace(done=done, total=2000, relative_error=error))
    # 4 s for 200; at 0.02 it takes four times the 300 that are done.
    assert said == [(100, "", None), (200, "± 4 %", pytest.approx(36)), (300, "± 2 %", pytest.approx(18))]


@pytest.mark.parametrize("name", shipped_scenes())
def test_every_shipped_scene_is_described(capsys, name):
    lines = run(capsys, f"scene {name}").out.splitlines()
    described = shipped_scene(name)
    assert lines[0] == described.title
    for part in (*described.solids, *described.detectors):
        assert any(line.startswith(part.name) for line in lines)


def test_scene_says_what_things_are_and_how_heavy(capsys):
    lines = [" ".join(line.split()) for line in run(capsys, "scene two.toml").out.splitlines()]
    assert "world 400 × 400 × 400 mm of vacuum" in lines
    assert "source at (0, 0, -100) mm towards (0, 0, 1), a pencil" in lines
    assert "4e+06 photons/s, 2e+06 in one shot of 0.5 s" in lines
    assert "slab target box water, 1 g/cm³ 100 × 100 × 10 mm (0, 0, 5) 100 g" in lines
    assert (
        "plate left sodium iodide, 3.67 g/cm³ 70 × 160 × 10 mm (-45, 0, -55) 10 keV exact 4 × 3" in lines
    )  # 3.67 is less than the crystal has
    assert any("7 % at 662 keV" in line for line in lines)


def test_scene_as_json(capsys):
    values = json.loads(run(capsys, "scene cxbi-blocks --json").out)
    assert values["photons_per_shot"] == pytest.approx(1e7)
    assert values["solid_angle"] == pytest.approx(0.2908, abs=1e-4)
    by_name = {solid["name"]: solid for solid in values["solids"]}
    assert by_name["world"]["mass"] is None
    assert by_name["caffeine 1"]["mass"] == pytest.approx(7 * 7 * 1.23)
    assert by_name["caffeine 1"]["lower"] == pytest.approx([35, 35, 500])
    assert (by_name["mask"]["role"], by_name["plate +x"]["role"]) == ("mask", "detector")
    assert values["scene"]["mask"]["columns"] == 543


def test_scene_as_toml_is_a_scene_to_begin_with(capsys, folder):
    (folder / "mine.toml").write_text(run(capsys, "scene cxbi-ud --toml").out, encoding="utf-8")
    assert sg.xray.read_scene("mine.toml") == shipped_scene("cxbi-ud")


def test_scene_is_drawn(capsys, folder):
    run(capsys, "scene two.toml --plot two.png")
    assert (folder / "two.png").read_bytes().startswith(b"\x89PNG")


def test_shipped_scenes_are_listed(capsys):
    lines = run(capsys, "scene --list").out.splitlines()
    assert [line.split()[0] for line in lines] == list(shipped_scenes())
    values = json.loads(run(capsys, "scene --list --json").out)
    assert values["scenes"][-1] == {"name": "slab-water", "title": "60 keV pencil on 1 cm of water"}


@pytest.mark.parametrize(
    ("command", "why"),
    [
        (
            "simulate cxbi-block --histories 10",
            "there is no scene 'cxbi-block': give a TOML file, or one of cxbi-blocks,",
        ),
        ("simulate three.toml --histories 10", "there is no file three.toml"),
        ("simulate two.toml", "Missing option '--histories'"),
        (
            "simulate two.toml --histories many",
            "--histories takes a whole number of at least 2, such as 1000000 or 1e6;",
        ),
        ("simulate two.toml --histories 1e3.5", "got '1e3.5'"),
        ("simulate two.toml --histories 2.5", "got '2.5'"),
        ("simulate two.toml --histories inf", "got 'inf'"),
        ("simulate two.toml --histories nan", "got 'nan'"),
        ("simulate two.toml --histories 1", "got '1'"),
        ("simulate two.toml --histories 10 --shot 1", "the shot must be a whole number from 0 to 0, got 1"),
        (
            "simulate two.toml --histories 10 --stop-at 2",
            "stop_at is a relative standard error between 0 and 1, got 2.0",
        ),
        ("simulate two.toml --histories 10 -o a.csv", "a.csv must end in .json or .nc"),
        ("simulate two.toml --histories 10 -o no/a.nc", "there is no folder no"),
        ("simulate two.toml --histories 10 --plot a.pdf", "a.pdf must end in .png"),
        ("simulate two.toml --histories 10 --phase-space a.csv", "a.csv must end in .npz or .h5 or .mcpl"),
        (
            "simulate two.toml --histories 10 --checkpoint a.npz --phase-space a.npz",
            "a.npz cannot be both --checkpoint",
        ),
        ("simulate two.toml --histories 10 --checkpoint two.toml", "two.toml must end in .npz"),
        (
            "simulate slab-water --histories 10 --phase-space a.npz",
            "the scene has no detector that photons could enter",
        ),
        ("simulate words.toml --histories 10", "words.toml: it is not TOML"),
        ("scene", "say which scene, a TOML file or one of those that --list names"),
        ("scene nothing", "there is no scene 'nothing'"),
        ("scene two.toml --toml --json", "--toml and --json are two ways of printing: give one of them"),
        ("scene two.toml --plot two.jpg", "two.jpg must end in .png"),
        ("scene two.toml --shot 3", "the shot must be a whole number from 0 to 0, got 3"),
    ],
)
def test_one_line_for_what_is_wrong(capsys, folder, command, why):
    (folder / "words.toml").write_text("a scene with two plates")
    assert why in refused(capsys, command)


def test_a_checkpoint_of_another_run_is_refused(capsys):
    run(capsys, "simulate two.toml --histories 2000 --checkpoint c.npz")
    assert "belongs to another scene, seed or number of histories" in refused(
        capsys, "simulate two.toml --histories 2000 --seed 1 --checkpoint c.npz"
    )
