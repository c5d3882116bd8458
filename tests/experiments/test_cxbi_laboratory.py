"""The study of the laboratory scan: its questions, what it says of made-up answers, and its numbers where the data are at hand."""

import json

import numpy as np
import pytest

from shadowgram.experiments import data_folder, studies
from shadowgram.experiments.source import generated
from shadowgram.experiments.studies import cxbi_laboratory as laboratory
from shadowgram.experiments.study import Record, spec_fields, task_key
from shadowgram.figures.style import style


def made_up(spec):
    """Values and arrays of one answer."""
    rng = np.random.default_rng(0)
    if spec.what == "counts":
        line = np.linspace(100, 120, 384).astype(np.float32)
        names = ("target", "empty", "difference")
        values = {
            "open": 0.51, "net": 4e7, "mean": 2.8e8, "orders": dict.fromkeys(names, 4), "noise": dict.fromkeys(names, 1e6),
            "gain": 0.0, "gain_error": 0.06, "slip_p": {"x": 0.9, "y": 0.7}, "area": [0.02, 0.06],
            "in_step": 0.009, "backwards": 0.017,
        }  # fmt: skip
        return values, dict.fromkeys((*names, *(f"drift_{name}" for name in names)), line)
    if spec.what == "picture":
        images = {name: rng.random((29, 33)).astype(np.float32) for name in laboratory.PARTS}
        contrast = dict.fromkeys(laboratory.PARTS, 0.5)
        return {"contrast": contrast, "like_drift": 0.97, "like_rest": 0.0}, images
    if spec.what == "power":
        return {"contrasts": [0.1, 0.3], "power": [0.4, 1.0], "smallest": 0.2}, {}
    p = 0.0022 if spec.name.endswith("UD") else 0.49
    values = {"p": p, "least": 0.0022, "statistic": 0.01, "order": 7, "noise": 1.0, "moves_in": 68, "lags": 249}
    return values, {"null": rng.normal(0, 0.01, 249).astype(np.float32)}


def records(quick=True):
    """Records as a run leaves them."""
    found = []
    for spec in laboratory.specs(generated(), quick):
        values, arrays = made_up(spec)
        values = json.loads(json.dumps(values))
        found.append(Record(spec=spec_fields(spec), values=values, arrays=arrays, seconds=0.1))
    return found


def test_specs_are_different_tasks_and_the_full_ones_are_others():
    scene, study = generated(), studies.load("cxbi-laboratory")
    assert study.chapter == 4
    keys = [[task_key(study, spec, scene) for spec in study.specs(scene, quick)] for quick in (True, False)]
    assert all(len(set(own)) == len(own) for own in keys)
    assert not set(keys[0]) & set(keys[1])


@pytest.mark.parametrize("quick", [True, False])
def test_figure_is_drawn_from_the_records(quick):
    with style():
        figure = studies.load("cxbi-laboratory").figure(records(quick))
    # Three panels of counts, three pictures of each method, a test, its orders and its power; no colour bars.
    shown = [axes for axes in figure.axes if axes.get_title(loc="left")]
    assert len(shown) == 3 + 3 * len(laboratory.PICTURES) + 3


def test_claims_follow_the_numbers():
    claims = {claim.says: claim for claim in laboratory.claims(records(quick=False))}
    assert len(claims) == 9
    stated = [claim for claim in claims.values() if claim.page is not None]
    assert [(claim.page, claim.agrees) for claim in stated] == [(87, True), (89, False)]
    assert "p = 0.49 of 249 lags" in stated[1].found
    assert "7 × 7 cells that gives 20 %" in stated[1].why
    assert all(claim.agrees is None for claim in claims.values() if claim.page is None)
    found = " ".join(claim.found for claim in claims.values())
    assert "UD at 50 %: p = 0.0022" in found
    assert "did not come through the open cells" in found


def test_without_data_the_reason_is_said(monkeypatch, tmp_path):
    monkeypatch.delenv(data_folder.VARIABLE, raising=False)
    with pytest.raises(FileNotFoundError, match="name the folder that has it with --data"):
        data_folder.find("cxbi/a.mat", "00", "somewhere")
    monkeypatch.setenv(data_folder.VARIABLE, str(tmp_path))
    with pytest.raises(FileNotFoundError, match=r"there is no cxbi/a\.mat in"):
        data_folder.find("cxbi/a.mat", "00", "somewhere")
    (tmp_path / "a.mat").write_bytes(b"")
    assert data_folder.find("cxbi/a.mat", "e3b0c442", "somewhere") == tmp_path / "a.mat"
    with pytest.raises(ValueError, match="is not the file of somewhere"):
        data_folder.find("cxbi/a.mat", "00", "somewhere")


@pytest.fixture(scope="module")
def answers(data):
    if not (data / "cxbi").is_dir():
        pytest.skip(f"{data / 'cxbi'} is not there")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(data_folder.VARIABLE, str(data))
        scene, found = generated(), []
        for spec in laboratory.specs(scene, True):
            result = laboratory.run(spec, scene)
            json.dumps(result.values, allow_nan=False)
            found.append(Record(spec=spec_fields(spec), values=result.values, arrays=result.arrays, seconds=0.1))
    return found


def test_the_picture_of_the_laboratory_is_that_of_its_drift(answers):
    of = {record.spec["name"]: record.values for record in answers if record.spec["what"] == "picture"}
    for name in ("tv", "ffdnet"):
        assert of[name]["like_drift"] > 0.8
        assert of[name]["contrast"]["rest"] < 0.2 * of[name]["contrast"]["difference"]
    for record in answers:
        if record.spec["what"] == "test":
            assert record.values["p"] > 0.2
    control = next(record.values for record in answers if record.spec["name"] == "50/y_UD")
    assert control["p"] == control["least"]


def test_the_net_counts_do_not_follow_the_open_area(answers):
    share, error = answers[0].values["area"]
    assert abs(share) < 0.2
    assert share + 5 * error < 0.5
    assert laboratory.claims(answers)[1].agrees is False
