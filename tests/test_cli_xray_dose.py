"""`shadowgram xray dose`: what it prints and what it refuses."""

import json

import pytest

import shadowgram as sg
from shadowgram.cli import main

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
"""


@pytest.fixture
def scene(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(SCENE)
    return "mine.toml"


def test_the_dose_of_a_scene_of_the_package(capsys):
    assert main(["xray", "dose", "cxbi-blocks", "--shots", "512", "--transmittance", "10"]) == 0
    out = capsys.readouterr().out
    assert "512 shots, 10 % of 32 × 32 cells open" in out
    assert "skeletal muscle" in out
    assert "0.07 to 0.1 µSv an inspection" in out


def test_json_has_what_the_function_gives(scene, capsys):
    assert main(["xray", "dose", scene, "--shots", "3", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    wanted = sg.xray.scan_dose(sg.xray.read_scene(scene), shots=3)
    assert found["shots"] == 3
    assert found["scan"] == pytest.approx(wanted.scan)
    assert found["shot"] == pytest.approx(wanted.shot)
    assert found["pixel"] == pytest.approx(wanted.pixel.mean())
    assert found["transmittance"] == pytest.approx(wanted.transmittance)
    assert found["limit"] == [0.07e-6, 0.1e-6]
    assert found["simulated"] is None


def test_photons_are_followed_beside_it(scene, capsys):
    arguments = ["xray", "dose", scene, "--histories", "2e4", "--seed", "1"]
    assert main([*arguments, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    one = found["simulated"]["large"]
    assert 0 < one["standard_error"] < 0.2 * one["mean"]
    # The block is 3 cm deep and does not fill the field, so that its mean is below the dose at the skin where it is lit.
    assert 0.05 * found["scan"] < one["mean"] < found["scan"] / found["transmittance"]
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert "by 20000 photons followed" in out
    assert "large" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--transmittance", "0"], "--transmittance"),
        (["--transmittance", "101"], "--transmittance"),
        (["--transmittance", "nan"], "--transmittance"),
        (["--histories", "1"], "--histories"),
        (["--histories", "many"], "--histories"),
    ],
)
def test_bad_arguments_are_one_line(scene, arguments, message, capsys):
    assert main(["xray", "dose", scene, *arguments]) == 2
    error = capsys.readouterr().err.strip()
    assert message in error
    assert "\n" not in error


def test_a_scene_without_a_mask_is_refused(capsys):
    assert main(["xray", "dose", "slab-water"]) == 2
    assert "mask" in capsys.readouterr().err
