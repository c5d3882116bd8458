"""`shadowgram info`, `convert` and `compare` with ENVI, TIFF, folders of pictures and folders of camera frames."""

import json

import numpy as np
import pytest

from shadowgram import scenes
from shadowgram.cli import main


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    values = np.random.default_rng(0).random((4, 16, 20))
    scenes.write(scenes.as_datacube(values, (450, 660), name="scene"), tmp_path / "scene.nc")
    return tmp_path


def run(capsys, command, status=0):
    got = main(command.split())
    said = capsys.readouterr()
    assert got == status, said.err
    return said.out if status == 0 else said.err


@pytest.mark.parametrize("out", ["b.hdr", "b.tif", "b.ome.tif", "b_ms"])
def test_there_and_back(folder, capsys, out):
    assert f"scene.nc → {out}" in run(capsys, f"convert scene.nc {out}")
    said = json.loads(run(capsys, f"info {out} --json"))
    assert said["kind"] == "datacube"
    assert said["shape"] == [4, 16, 20]
    assert said["wavelengths_nm"] == [450, 660]
    psnr = json.loads(run(capsys, f"compare {out} scene.nc --json"))["psnr"]
    assert psnr > 90 if out == "b_ms" else psnr is None  # infinite: the very same values
    run(capsys, f"convert {out} again.nc")
    tolerance = 1e-5 if out == "b_ms" else 0
    np.testing.assert_allclose(scenes.read("again.nc"), scenes.read("scene.nc"), atol=tolerance)


def test_inputs_are_not_replaced(folder, capsys):
    run(capsys, "convert scene.nc b.hdr")
    assert "b.dat is the input" in run(capsys, "convert b.dat b.hdr", status=2)
    run(capsys, "convert scene.nc b_ms")
    assert "b_ms is there already; a folder of PNG pictures must be new" in run(
        capsys, "convert scene.nc b_ms", status=2
    )
    assert "there is no folder nowhere" in run(capsys, "convert scene.nc nowhere/b_ms", status=2)
    assert not list(folder.glob(".*"))


def test_frames(folder, capsys):
    frames = folder / "frames"
    frames.mkdir()
    np.save(frames / "a.npy", np.full((3, 4), 300, np.uint16))
    (frames / "capture.toml").write_text('exposure = 0.5\nsaturation = 300\n[[shots]]\nframes = ["a.npy"]\n')
    said = json.loads(run(capsys, "info frames --json"))
    assert said == {
        "kind": "frames",
        "shape": [1, 3, 4],
        "exposures_s": [0.5],
        "range_per_s": [600, 600],
        "saturated": 12,
    }
    assert "frames of a camera, not a datacube" in run(capsys, "convert frames b.nc", status=2)
