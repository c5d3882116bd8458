"""The study of the author's simulated scans: its cases, what it says of them, and one of them where the data are at hand."""

import json

import numpy as np
import pytest

from shadowgram.experiments import data_folder, studies
from shadowgram.experiments.source import generated
from shadowgram.experiments.studies import cxbi_gate as gate
from shadowgram.experiments.study import Record, spec_fields, task_key
from shadowgram.figures.style import style


def records(quick=True):
    """Records as a run leaves them: blind has 20 dB and SSIM 0.8, BM3D less in each, FFDNet less in PSNR."""
    made = {"blind": (20.0, 0.8), "oracle-bm3d": (19.0, 0.7), "oracle-ffdnet": (18.0, 0.85)}
    rng = np.random.default_rng(0)
    found = []
    for spec in gate.specs(generated(), quick):
        psnr, ssim = made.get(spec.way, (19.5, 0.75))
        values = {"psnr_air": psnr, "ssim_air": ssim, "psnr_bare": psnr - 1, "ssim_bare": ssim - 0.1}
        arrays = {name: rng.random((32, 32)).astype(np.float32) for name in ("image", "truth")}
        found.append(Record(spec=spec_fields(spec), values=values, arrays=arrays, seconds=0.1))
    return found


def test_specs_are_different_tasks_and_name_every_row():
    study = studies.load("cxbi-gate")
    assert study.chapter == 4
    for quick, count in ((True, 8), (False, 3 * 18 + 5 * 12)):
        specs = study.specs(generated(), quick)
        assert len({task_key(study, spec, generated()) for spec in specs}) == len(specs) == count
    assert all(spec.rows == spec.step for spec in study.specs(generated(), False))


@pytest.mark.parametrize(("quick", "panels"), [(True, 3), (False, 42)])
def test_figure_is_drawn_from_the_records(quick, panels):
    with style():
        figure = studies.load("cxbi-gate").figure(records(quick))
    assert len([axes for axes in figure.axes if axes.has_data()]) == panels


def test_claims_count_the_cases_against_the_better_oracle_of_each_measure():
    claims = gate.claims(records(quick=False))
    assert len({claim.says for claim in claims}) == len(claims) == 6
    assert "better than the better oracle in 12 and 0 of 12 cases" in claims[0].found
    assert "blind 20.00/0.800, oracle-bm3d 19.00/0.700, oracle-ffdnet 18.00/0.850" in claims[0].found
    assert "20.0/0.80 against 19.0/0.85" in claims[0].found
    assert "blind 19.00/0.700" in claims[1].found
    assert "blind, FFDNet alone: 19.50/0.750" in claims[2].found
    assert claims[3].found == "1 %: +0.50/+0.050; 10 %: +0.50/+0.050; 50 %: +0.50/+0.050"
    for claim in claims:
        assert claim.page is None
        assert claim.agrees is None


def test_score_is_after_the_best_scale_with_the_largest_value_as_peak():
    truth = np.zeros((20, 20))
    truth[5:10, 5:15] = 50
    assert gate.score(0.2 * truth, truth) == (np.inf, pytest.approx(1.0))
    wrong = truth.copy()
    wrong[0, 0] = 10
    scale = np.vdot(wrong, truth) / np.vdot(wrong, wrong)
    error = np.mean((scale * wrong - truth) ** 2)
    assert gate.score(7 * wrong, truth)[0] == pytest.approx(10 * np.log10(50**2 / error))
    assert gate.score(np.zeros_like(truth), truth)[0] == pytest.approx(10 * np.log10(50**2 / np.mean(truth**2)))


def test_without_data_it_says_where_they_come_from(monkeypatch):
    monkeypatch.delenv(data_folder.VARIABLE, raising=False)
    gate.truths.cache_clear()
    with pytest.raises(FileNotFoundError, match="CXBI"):
        gate.run(gate.specs(generated(), True)[0], generated())


@pytest.fixture
def measured(data, monkeypatch):
    if not (data / "cxbi" / "gate").is_dir():
        pytest.skip(f"{data / 'cxbi' / 'gate'} is not there")
    monkeypatch.setenv(data_folder.VARIABLE, str(data))
    gate.truths.cache_clear()


def test_a_case_blind_and_with_an_oracle(measured, monkeypatch):
    monkeypatch.setattr(gate, "SIGMAS", (13.0, 19.0))
    monkeypatch.setattr(gate, "STRENGTHS", (1.0,))
    found = {}
    for way in ("blind", "walls", "subtracted", "oracle-ffdnet"):
        result = gate.run(gate.Spec(target="box", percent=50, step=4, way=way, rows=1), generated())
        json.dumps(result.values, allow_nan=False)
        assert {a.dtype for a in result.arrays.values()} == {np.dtype(np.float32)}
        assert result.arrays["image"].shape == result.arrays["truth"].shape == (32, 32)
        found[way] = result.values
    assert found["oracle-ffdnet"]["setting"][0] in (13.0, 19.0)
    for measure in ("psnr_air", "ssim_air"):
        assert found["blind"][measure] > found["oracle-ffdnet"][measure]
    assert found["blind"]["psnr_air"] > 25
    assert found["blind"]["psnr_air"] > found["blind"]["psnr_bare"]


def test_every_choice_of_rows_is_in_the_mean(measured):
    each = []
    for row in range(2):
        scores, _, _ = gate._blind(gate.Spec(target="box", percent=10, step=2, way="ffdnet", rows=1), row)
        each.append(scores[0, 1, 0])
    mean = gate.run(gate.Spec(target="box", percent=10, step=2, way="ffdnet", rows=2), generated()).values
    assert each[0] != each[1]
    assert mean["psnr_air"] == pytest.approx(np.mean(each))
    assert mean["spread"] == pytest.approx(np.std(each))
