"""The scanner against the GATE simulations of the dissertation's author, where his data are at hand."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "gate_agreement.py"


@pytest.fixture(scope="module")
def gate():
    if not SCRIPT.is_file():
        pytest.skip("needs a checkout with benchmarks/gate_agreement.py")
    spec = importlib.util.spec_from_file_location("gate_agreement", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclasses look there
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def cxbi(data):
    folder = data / "cxbi"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    return folder


# The tolerances are those that the scanner must meet, percent by percent; they leave 3 to 5 standard errors of his counts.
@pytest.mark.parametrize(("percent", "ratio", "correlation"), [(1, 0.08, 0.90), (10, 0.05, 0.96), (50, 0.05, 0.97)])
def test_shots_of_the_four_blocks(gate, cxbi, percent, ratio, correlation):
    scene = gate.gate_scene(cxbi, "box", percent, fluorescence=False)
    ours = gate.response(scene, gate.QUICK).shots(gate.strip(cxbi, percent))[0] * scene.photons_per_shot
    his = gate.load(cxbi, f"{percent}/y_box.mat", "y").ravel() - gate.load(cxbi, f"{percent}/y_air.mat", "air").ravel()
    assert abs(ours.mean() / his.mean() - 1) < ratio
    assert gate.correlation(ours, his) > correlation


@pytest.mark.parametrize(("percent", "below_ceiling"), [(1, 0.02), (10, 0.02), (50, 0.02)])
def test_shots_of_the_letters(gate, cxbi, percent, below_ceiling):
    scene = gate.with_letters(gate.gate_scene(cxbi, "UD", percent, fluorescence=False), cxbi, gate.LETTERS[percent])
    ours = gate.response(scene, gate.QUICK).shots(gate.strip(cxbi, percent))[0] * scene.photons_per_shot
    his, air = (
        gate.load(cxbi, f"{percent}/y_UD.mat", "y").ravel(),
        gate.load(cxbi, f"{percent}/y_air.mat", "air").ravel(),
    )
    assert abs(ours.mean() / (his - air).mean() - 1) < 0.05
    assert gate.correlation(ours, his - air) > gate.ceiling(ours, his.mean() + air.mean()) - below_ceiling


@pytest.mark.parametrize(("target", "key"), [("box", "square"), ("UD", "UD")])
def test_pencil_beam_truth(gate, cxbi, target, key):
    scene = gate.gate_scene(cxbi, target, 10, fluorescence=False)
    if target == "UD":
        scene = gate.with_letters(scene, cxbi, gate.LETTERS[None])
    ours = gate.truth(scene, gate.Effort(per_cell=1, per_pixel=400, direct=1))
    assert gate.correlation(ours, gate.load(cxbi, "ground_truth_UD_square.mat", key)) > 0.98
    assert np.unravel_index(ours.argmax(), ours.shape) != (0, 0)
