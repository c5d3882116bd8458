"""`shadowgram codes export`: every format, and one clear line for what is wrong."""

import json
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import gdstk
import numpy as np
import pytest
from PIL import Image

import shadowgram as sg
from shadowgram.cli import main
from shadowgram.codes import layout


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty working directory with a code in it, as codes make writes one."""
    monkeypatch.chdir(tmp_path)
    assert main(["codes", "make", "--shape", "12x20", "--shots", "3", "-o", "code.nc"]) == 0
    np.save("gray.npy", np.full((1, 4, 4), 0.5))
    np.save("holes.npy", np.full((1, 4, 4), np.nan))
    np.save("colored.npy", np.ones((2, 3, 4, 4), np.uint8))
    return tmp_path


@pytest.fixture
def code():
    return sg.codes.boolean(shots=3, shape=(12, 20), seed=0)


def names():
    return sorted(path.name for path in Path.cwd().iterdir())


def run(capsys, command):
    """Standard output of a command, as lines."""
    capsys.readouterr()
    got = main(command.split())
    said = capsys.readouterr()
    assert got == 0, said.err
    return said.out.splitlines()


def refuse(capsys, command):
    """The one line that a command says when it refuses its input; nothing may be left behind."""
    capsys.readouterr()
    before = names()
    assert main(command.split()) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("shadowgram: ")
    assert said.err.count("\n") == 1
    assert names() == before
    return said.err


def pixels(file):
    """Pixels of a picture, and what else it says."""
    with Image.open(file) as picture:
        return np.asarray(picture), picture.info


def test_help_has_a_runnable_example(folder, capsys):
    text = " ".join(" ".join(run(capsys, "codes export --help")).split())
    example = "codes export code.nc -o mask.gds --pitch 10"
    assert f"Example: shadowgram {example}" in text
    run(capsys, example)


def test_photomask(folder, capsys, code):
    lines = run(capsys, "codes export code.nc -o mask.gds --pitch 7.56 --gap 50 --columns 2 --no-marks")
    assert lines[0] == "3 shots of 12 × 20 elements, 0.09072 × 0.1512 mm each → mask.gds"
    assert lines[1].startswith(f"{layout.corner_contacts(code)} corners where")
    mask = next(cell for cell in gdstk.read_gds("mask.gds").cells if cell.name == "MASK")
    areas = [reference.cell.area() for reference in mask.references]
    assert areas == pytest.approx([int(shot.sum()) * 7.56**2 for shot in code])
    assert len({reference.origin[1] for reference in mask.references}) == 2
    assert not mask.polygons
    settings = json.loads(Path("mask.json").read_text())
    assert settings["command"] == "codes export"
    assert settings["options"]["gap"] == 50


def test_options_reach_the_photomask(folder, capsys, code):
    assert len(run(capsys, "codes export code.nc -o mask.gds --pitch 10 --polarity chrome --bias 1 --title A")) == 1
    layout.write_gds(code, "other.gds", pitch=10, polarity="chrome", bias=1, title="A")
    assert Path("mask.gds").read_bytes() == Path("other.gds").read_bytes()


def test_drawings(folder, capsys, code):
    said = json.loads(
        "\n".join(run(capsys, "codes export code.nc -o mask.svg --pitch 10 --polarity chrome --bias 1 --json"))
    )
    assert said["files"] == ["mask-1.svg", "mask-2.svg", "mask-3.svg"]
    assert said["shape"] == [3, 12, 20]
    assert said["size_mm"] == [0.12, 0.2]
    assert said["corner_contacts"] == 0
    for shot, file in enumerate(said["files"]):
        layout.write_svg(code, "other.svg", pitch=10, shot=shot, polarity="chrome", bias=1)
        assert Path(file).read_bytes() == Path("other.svg").read_bytes()
    assert ET.parse("mask-1.svg").getroot().get("width") == "0.2mm"


def test_pictures(folder, capsys, code):
    said = json.loads("\n".join(run(capsys, "codes export code.nc -o mask.png --pitch 10 --pixels 2 --json")))
    assert said["corner_contacts"] is None
    for shot, file in zip(code, ("mask-1.png", "mask-2.png", "mask-3.png"), strict=True):
        picture, info = pixels(file)
        assert info["dpi"] == pytest.approx((5080, 5080))
        assert np.array_equal(picture, np.kron(shot, np.ones((2, 2))))


def test_one_shot_keeps_its_name(folder, capsys, code):
    run(capsys, "codes export code.nc -o mask.png --pitch 10")
    run(capsys, "codes export mask-2.png -o again.png --pitch 10")
    assert np.array_equal(pixels("again.png")[0], code[1])
    assert run(capsys, "codes export mask-2.png -o one.svg --pitch 10")[0].endswith("→ one.svg")


def test_frames(folder, capsys, code):
    lines = run(capsys, "codes export code.nc -o frame.png --dmd 40x60 --mirrors 2 --offset -8,3")
    assert lines == ["3 shots of 12 × 20 elements → frame-1.png, frame-2.png, frame-3.png"]
    expected = layout.dmd_frames(code, frame=(40, 60), mirrors=2, offset=(-8, 3))
    frames, infos = zip(*(pixels(f"frame-{shot}.png") for shot in (1, 2, 3)), strict=True)
    assert np.array_equal(np.stack(frames), expected)
    assert not any("dpi" in info for info in infos)


REFUSED = {
    "unknown ending": ("code.nc -o mask.dxf --pitch 10", "must end in .gds or .svg or .png"),
    "no pitch": ("code.nc -o mask.gds", "say --pitch"),
    "pitch of zero": ("code.nc -o mask.gds --pitch 0", "pitch must be a positive length"),
    "pitch of zero, drawing": ("code.nc -o mask.svg --pitch 0", "pitch must be a positive length"),
    "pitch of zero, picture": ("code.nc -o mask.png --pitch 0", "pitch must be a positive length"),
    "pitch between nanometres": ("code.nc -o mask.gds --pitch 1.23456", "whole number of nm"),
    "gray code": ("gray.npy -o mask.gds --pitch 10", "must be binary"),
    "gray code, frames": ("gray.npy -o mask.png --dmd 8x8", "must be binary"),
    "NaN": ("holes.npy -o mask.png --pitch 10", "transmittance must lie in"),
    "colored code": ("colored.npy -o mask.svg --pitch 10", "colored"),
    "not a code": ("code.json -o mask.svg --pitch 10", ".nc, .npy or .png"),
    "no such file": ("none.nc -o mask.svg --pitch 10", "none.nc"),
    "no such folder": ("code.nc -o none/mask.gds --pitch 10", "there is no folder"),
    "a polarity of its own": ("code.nc -o mask.gds --pitch 10 --polarity clear", "polarity"),
    "polarity of a picture": ("code.nc -o mask.png --pitch 10 --polarity chrome", "--polarity is for .gds and .svg"),
    "bias of a picture": ("code.nc -o mask.png --pitch 10 --bias 1", "--bias is for .gds and .svg"),
    "gap of a drawing": ("code.nc -o mask.svg --pitch 10 --gap 50", "--gap is for .gds"),
    "marks of a drawing": ("code.nc -o mask.svg --pitch 10 --no-marks", "--marks is for .gds"),
    "pixels of a photomask": ("code.nc -o mask.gds --pitch 10 --pixels 2", "--pixels is for .png"),
    "mirrors without a device": ("code.nc -o mask.png --pitch 10 --mirrors 2", "--mirrors is for --dmd"),
    "pitch of a device": ("code.nc -o mask.png --dmd 40x60 --pitch 10", "--pitch is for .gds and .svg and .png"),
    "a device's photomask": ("code.nc -o mask.gds --dmd 40x60", "--dmd makes .png frames"),
    "device in words": ("code.nc -o mask.png --dmd large", "--dmd takes the size"),
    "device too small": ("code.nc -o mask.png --dmd 40x60 --mirrors 4", "48 × 80 mirrors, which do not fit on 40 × 60"),
    "offset in words": ("code.nc -o mask.png --dmd 40x60 --offset left", "--offset takes mirrors y,x"),
}


@pytest.mark.parametrize(("command", "said"), REFUSED.values(), ids=REFUSED)
def test_refused(folder, capsys, command, said):
    assert said in refuse(capsys, f"codes export {command}")


def test_without_gdstk(folder, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "gdstk", None)
    assert "pip install 'shadowgram[layout]'" in refuse(capsys, "codes export code.nc -o mask.gds --pitch 10")
