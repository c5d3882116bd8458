"""`shadowgram xray scan` and `pencil`: what they print and write, how they go on after an interrupt, and what they refuse."""

import contextlib
import json
import os
import signal

import numpy as np
import pytest

from shadowgram.cli import main, output, running
from shadowgram.experiments import xray_scan as runs
from shadowgram.scenes.readers.native import read_dataset
from shadowgram.xray.scan import direct_scan, linear_scan, pencil_scan, with_transmittance
from shadowgram.xray.scan_file import read_pencil_map, read_scan
from shadowgram.xray.scene import read_scene

SCENE = """
title = "Small"
shots = 6
exposure = 0.01
cutoff = 10

[world]
size = [500, 500, 500]

[source]
position = [0, 0, -150]
half_angle = 0.1
activity = 1e8
spectrum = { energy = 80 }

[mask]
material = "tungsten"
pitch = 5
depth = 2
rows = 4
columns = 9
view = 4
plate = [60, 40]
pattern = { rows = ["101100101", "010110010", "110010111", "001101001"] }

[[solids]]
name = "large"
role = "target"
material = "water"
shape = { kind = "box", centre = [12, 12, 95], size = [24, 24, 30] }

[[detectors]]
name = "plate"
centre = [62, 0, 40]
size = [60, 120, 10]
material = { name = "sodium iodide", density = 3.67 }
threshold = 10
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """An empty working directory but for a scene."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(SCENE)
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


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("command", ["materials", "spectrum", "scene", "simulate", "scan", "pencil"])
def test_help_has_a_runnable_example(capsys, command):
    assert f"Example: shadowgram xray {command}" in " ".join(run(capsys, f"{command} --help").out.split())


def test_a_direct_scan(capsys, folder):
    want = direct_scan(read_scene("small.toml"), shots=3, histories=60_000, seed=2, background=True)
    command = "scan small.toml --shots 3 --histories 6e4 --seed 2 --background -o y.nc --plot y.png"
    values = json.loads(run(capsys, f"{command} --json").out)
    assert names(folder) == ["small.toml", "y.journal", "y.json", "y.nc", "y.png"]
    assert (folder / "y.png").read_bytes().startswith(b"\x89PNG")
    found = read_scan("y.nc")
    np.testing.assert_array_equal(found.counts, want.counts)
    np.testing.assert_array_equal(found.background, want.background)
    np.testing.assert_array_equal(found.codes, want.codes)
    assert values["counts"] == want.counts.tolist()
    assert values["background_error"] == want.background_error.tolist()
    assert (values["route"], values["noisy"], values["shots"]) == ("direct", True, 3)
    assert (values["photons_per_shot"], values["exposure"]) == (20_000, pytest.approx(2e-4))
    assert values["orders"] == dict(want.orders)
    assert (values["file"], values["journal"]) == ("y.nc", "y.journal")
    settings = json.loads((folder / "y.json").read_text())
    assert (settings["command"], settings["options"]["seed"]) == ("xray scan", 2)
    assert json.loads(read_dataset("y.nc").attrs["configuration"]) == settings
    lines = run(capsys, command).out.splitlines()
    assert lines[:2] == ["Small", "3 shots of 2e+04 photons (0.0002 s), direct counts"]
    assert any(line.startswith("difference") and f"{want.signal.mean():.1f}" in line for line in lines)
    assert lines[-1] == "→ y.nc"


def test_means_by_processes_in_a_named_journal(capsys, folder):
    want = direct_scan(read_scene("small.toml"), shots=2, histories=20_000, variance_reduction=True)
    run(capsys, "scan small.toml --shots 2 --histories 20000 --means --workers 2 --journal deep/kept -o y.nc")
    np.testing.assert_array_equal(read_scan("y.nc").counts, want.counts)
    assert not read_scan("y.nc").noisy
    assert names(folder / "deep" / "kept") == ["journal.sqlite"]


def test_a_linear_scan(capsys, folder):
    want = linear_scan(read_scene("small.toml"), histories=20_000, seed=4)
    values = json.loads(
        run(capsys, "scan small.toml --route linear --histories 2e4 --seed 4 -o y.nc --json --plot y.png").out
    )
    assert values["counts"] == want.counts.tolist() == read_scan("y.nc").counts.tolist()
    assert main(["info", "y.nc", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["kind"], told["route"], told["shape"]) == ("xray-scan", "linear", list(want.counts.shape))
    assert (values["background"], values["orders"], values["journal"]) == (None, None, None)
    assert names(folder) == ["small.toml", "y.json", "y.nc", "y.png"]
    run(capsys, "scan small.toml --route linear --histories 2e4 --seed 4 --means -o z.nc")
    np.testing.assert_allclose(read_scan("z.nc").counts, want.counts, atol=6 * want.standard_error.max())
    assert not np.array_equal(read_scan("z.nc").counts, want.counts)


def test_other_codes(capsys, folder):
    scene = read_scene("small.toml")
    run(capsys, "scan small.toml --transmittance 25 --shots 2 --histories 2000 -o y.nc")
    mask = with_transmittance(scene, 0.25).mask
    np.testing.assert_array_equal(read_scan("y.nc").codes, [mask.code(0), mask.code(1)])
    strip = np.array([[1, 0, 0, 1, 1, 0], [0, 1, 1, 0, 0, 0], [1, 1, 0, 0, 1, 1], [0, 0, 1, 1, 0, 1]], np.uint8)
    np.save(folder / "strip.npy", strip)
    np.savetxt(folder / "strip.csv", strip, fmt="%d", delimiter=",")
    for file in ("strip.npy", "strip.csv"):
        run(capsys, f"scan small.toml --code {file} --histories 3000 -o y.nc")
        np.testing.assert_array_equal(read_scan("y.nc").codes, [strip[:, i : i + 4] for i in range(3)])
    assert main(["codes", "make", "--shots", "2", "--shape", "4x4", "--seed", "1", "-o", "codes.nc"]) == 0
    run(capsys, "scan small.toml --code codes.nc --histories 2000 -o y.nc")
    np.testing.assert_array_equal(read_scan("y.nc").codes, read_dataset("codes.nc")["code"].values)
    np.save(folder / "codes.npy", read_scan("y.nc").codes)
    run(capsys, "scan small.toml --code codes.npy --shots 1 --histories 2000 -o y.nc")
    assert read_scan("y.nc").codes.shape == (1, 4, 4)


@pytest.fixture
def pressed(monkeypatch):
    """Press Ctrl-C once when two parts are done."""
    times = []

    @contextlib.contextmanager
    def progress(what, total=None):
        def update(step, note, left=None):
            if step == 2 and not times:
                times.append(step)
                os.kill(os.getpid(), signal.SIGINT)

        yield update

    monkeypatch.setattr(output, "progress", progress)
    return times


def test_an_interrupt_leaves_a_journal_to_go_on_from(capsys, folder, pressed, monkeypatch):
    monkeypatch.setenv("SHADOWGRAM_THREADS", "1")
    command = "scan small.toml --histories 6e6 -o y.nc"
    said = run(capsys, command, 130)
    assert pressed == [2]
    assert said.out == ""
    assert names(folder) == ["small.toml", "y.journal"]
    done = int(said.err.split("interrupted: ")[1].split()[0])
    assert 2 <= done < 6
    assert said.err.endswith(f"{done} of 6 parts are in y.journal/journal.sqlite, and the same command goes on\n")
    again = []
    follow = runs.follow
    monkeypatch.setattr(runs, "follow", lambda block: again.append(block.first) or follow(block))
    run(capsys, command)
    assert len(again) == 6 - done
    np.testing.assert_array_equal(
        read_scan("y.nc").counts, direct_scan(read_scene("small.toml"), histories=6_000_000).counts
    )


def test_parts_that_fail(capsys, folder, monkeypatch):
    def fail(block):
        raise RuntimeError("no room")

    monkeypatch.setattr(runs, "follow", fail)
    said = run(capsys, "scan small.toml --histories 600 -o y.nc", 1)
    assert said.err.startswith("shadowgram: 1 parts failed, the first with RuntimeError: no room")
    assert not (folder / "y.nc").exists()


def test_pencil_beams(capsys, folder):
    given = {"shape": (2, 3), "pitch": 8, "distance": 60, "photons": 300, "seed": 5}
    want = pencil_scan(read_scene("small.toml"), **given)
    command = "pencil small.toml --shape 2x3 --pitch 8 --distance 60 --photons 300 --seed 5 -o truth.nc"
    values = json.loads(run(capsys, f"{command} --plot truth.png --json").out)
    assert names(folder) == ["small.toml", "truth.journal", "truth.json", "truth.nc", "truth.png"]
    np.testing.assert_array_equal(read_pencil_map("truth.nc").counts, want.counts)
    assert values["target"] == want.target.tolist()
    assert (values["shape"], values["photons"], values["noisy"]) == ([2, 3], 300, False)
    lines = run(capsys, f"{command} --analog --half-angle 1 --workers 1").out.splitlines()
    assert lines[0] == "2 × 3 pixels (y × x) of 8 mm, 300 photons each"
    found = read_pencil_map("truth.nc")
    assert found.noisy
    assert found.half_angle == pytest.approx(np.pi / 180)
    assert lines[1].split()[2] == f"{found.counts.mean():.1f},"


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("scan none.toml -o y.nc", "there is no file none.toml"),
        ("scan blocks -o y.nc", "there is no scene 'blocks'"),
        ("scan slab-water -o y.nc", "needs a coded mask, and this scene has none"),
        ("scan small.toml -o y.txt", "must end in .nc"),
        ("scan small.toml -o nowhere/y.nc", "there is no folder nowhere"),
        ("scan small.toml -o y.nc --plot y.jpg", "must end in .png"),
        ("scan small.toml -o y.nc --shots 7", "7 shots cannot be taken: with a mask of 9 columns, 4 in view"),
        ("scan small.toml -o y.nc --shots none", "should be a valid integer"),
        ("scan small.toml -o y.nc --histories many", "--histories takes a whole number of at least 2"),
        ("scan small.toml -o y.nc --histories 1e400", "--histories takes a whole number of at least 2"),
        ("scan small.toml -o y.nc --histories 3", "6 shots need at least 12 histories"),
        ("scan small.toml -o y.nc --transmittance 0", "above 0 and at most 100; got 0"),
        ("scan small.toml -o y.nc --transmittance nan", "above 0 and at most 100; got nan"),
        ("scan small.toml -o y.nc --transmittance 5 --code a.npy", "give one of them"),
        ("scan small.toml -o y.nc --code a.npy", "there is no file a.npy"),
        ("scan small.toml -o y.nc --code broken.npy", "cannot read the code broken.npy"),
        ("scan small.toml -o y.nc --code small.toml", "cannot read the pattern small.toml"),
        ("scan small.toml -o y.nc --code wide.csv", "codes of this mask have 4 rows and 4 columns"),
        ("scan small.toml -o y.nc --workers 2 --cluster tcp://localhost:1", "not both"),
        ("scan small.toml -o y.nc --workers 9999", "--workers takes a whole number from 1"),
        ("scan small.toml -o y.nc --journal small.toml", "File exists: small.toml"),
        ("scan small.toml -o y.nc --route linear --workers 2", "belong to --route direct"),
        ("scan small.toml -o y.nc --route linear --histories 50", "needs at least 161 histories, got 50"),
        ("scan small.toml -o y.nc --route wide", "is not one of"),
        ("pencil slab-water -o y.nc", "add [[detectors]]"),
        ("pencil small.toml -o y.nc --shape 3", "--shape takes the size y × x"),
        ("pencil small.toml -o y.nc --pitch 0", "pitch must be a positive length"),
        ("pencil small.toml -o y.nc --shape 1x40 --distance 40", "begin in the detector"),
        ("pencil small.toml -o y.nc --photons 1", "--photons"),
    ],
)
def test_what_cannot_be_is_said_in_a_line(capsys, folder, command, message):
    (folder / "broken.npy").write_bytes(b"\x93NUMPY\x01\x00v\x00{}")
    (folder / "wide.csv").write_text("1,0,1\n0,1,1\n")
    before = names(folder)
    assert message in refused(capsys, command)
    assert names(folder) == before


def test_a_broken_scene_is_said_before_a_journal_is_made(capsys, folder):
    (folder / "mesh.toml").write_text(
        SCENE.replace('kind = "box", centre = [12, 12, 95], size = [24, 24, 30]', 'kind = "mesh", file = "none.stl"')
    )
    assert "none.stl" in refused(capsys, "scan mesh.toml -o y.nc --histories 600")
    assert "none.stl" in refused(capsys, "pencil mesh.toml -o y.nc --photons 10")
    assert "y.journal" not in names(folder)


def test_compilation_is_told_of(capsys, monkeypatch):
    import time
    import types

    from shadowgram.xray.montecarlo import _history_kernels

    monkeypatch.setattr(running, "COMPILED_BY", 0.01)
    for signatures, times in (([], 1), ([1], 0)):
        monkeypatch.setattr(_history_kernels, "batch", types.SimpleNamespace(signatures=signatures))
        with running.telling_of_compilation("batch"):
            time.sleep(0.1)
        assert capsys.readouterr().err.count("compiling the transport") == times
