"""The studies of how well codes reconstruct, in their quick form on the generated scene."""

import importlib
import json
import math

import numpy as np
import pytest

from shadowgram.codes._design import default_c1
from shadowgram.experiments.source import generated
from shadowgram.experiments.studies import _codes, codes_better, codes_c1, fig_3_5
from shadowgram.experiments.studies import _common as common
from shadowgram.experiments.studies._codes import Gain
from shadowgram.experiments.study import Record, spec_fields, task_key
from shadowgram.figures.sheet import Curve, Curves, sheet
from shadowgram.figures.style import style

PANELS = {"fig-3-5": 28, "fig-3-12": 18, "codes-c1": 6, "codes-better": 9, "codes-light": 4}


def load(name):
    return importlib.import_module(f"shadowgram.experiments.studies.{name.replace('-', '_')}").STUDY


@pytest.fixture(scope="module")
def all_records():
    scene, done = generated(), {}
    for name in PANELS:
        study = load(name)
        done[name] = []
        for spec in study.specs(scene, True):
            result = study.run(spec, scene)
            done[name].append(Record(spec=spec_fields(spec), values=result.values, arrays=result.arrays, seconds=0.1))
    return done


@pytest.fixture(params=list(PANELS))
def done(request, all_records):
    return load(request.param), all_records[request.param]


@pytest.mark.parametrize("name", PANELS)
def test_specs_are_different_tasks_and_the_full_ones_are_others(name):
    scene, study = generated(), load(name)
    assert study.name == name
    keys = [[task_key(study, spec, scene) for spec in study.specs(scene, quick)] for quick in (True, False)]
    assert all(len(set(own)) == len(own) for own in keys)
    assert not set(keys[0]) & set(keys[1])


def test_figure_is_drawn_from_the_records(done):
    study, records = done
    with style():
        figure = study.figure(records)
    drawn = [axes for axes in figure.axes if axes.has_data()]
    assert len(drawn) == PANELS[study.name]


def test_claims_state_page_and_numbers(done):
    study, records = done
    claims = study.claims(records)
    assert len({claim.says for claim in claims}) == len(claims)
    for claim in claims:
        assert claim.page is None or 42 <= claim.page <= 65
        assert claim.agrees in (True, False, None)
        assert claim.page is not None or claim.agrees is None
        assert any(character.isdigit() for character in claim.found)
        assert claim.agrees is not False or claim.why
        assert "nan" not in claim.found + claim.why


def test_records_hold_what_json_and_npz_can(done):
    _, records = done
    for record in records:
        json.dumps(record.values, allow_nan=False)
        assert all(isinstance(a, np.ndarray) and a.dtype.kind in "fu" for a in record.arrays.values())


def test_a_task_gives_the_same_result_again(done):
    study, records = done
    scene = generated()
    again = study.run(study.specs(scene, True)[0], scene)
    assert again.values == records[0].values
    for name, array in records[0].arrays.items():
        assert np.array_equal(again.arrays[name], array)


def test_designed_codes_are_above_random_ones(all_records):
    for solver in ("gpsr", "eigen-tv"):
        gains = fig_3_5._gains(all_records["fig-3-5"], ("optimised", "random"), solver, "30 dB")
        assert len(gains) == 3
        assert all(one.mean > 0.5 for one in gains.values())


def test_noise_of_the_signal_and_of_the_camera():
    imager = _codes.imager_of(4, 32, (450, 650))
    truth = generated().cube(4, (32, 32)).values
    read = _codes.read_noise(imager, truth)
    ratios = {}
    for kind, shots in (("boolean", 4), ("boolean", 8), ("random", 8)):
        y = common.stored_operator(imager, _codes.code_of(kind, imager, shots, 0)).forward(truth)
        for noise in ("30 dB", "read"):
            rest = _codes.disturbed(y, noise, read, 1) - y
            ratios[kind, shots, noise] = 10 * math.log10(np.mean(np.square(y)) / np.mean(np.square(rest)))
    assert all(ratio == pytest.approx(30, abs=0.4) for (_, _, noise), ratio in ratios.items() if noise == "30 dB")
    assert ratios["boolean", 4, "read"] == pytest.approx(30, abs=0.4)
    assert ratios["boolean", 8, "read"] < 28
    assert ratios["random", 8, "read"] > 34


def test_no_noise_changes_nothing():
    y = np.random.default_rng(0).random((2, 4, 4))
    np.testing.assert_array_equal(_codes.disturbed(y, "none", 1.0, 0), y.astype(np.float32))


@pytest.mark.parametrize("kind", _codes.KINDS)
def test_codes_of_every_kind(kind):
    imager = _codes.imager_of(4, 16, (450, 650))
    code = _codes.code_of(kind, imager, 3, 0)
    assert code.shape == (3, 16, 16)
    assert (code.sum(axis=0) == 1).all() == (kind != "random")


def test_an_unknown_code_is_refused():
    with pytest.raises(ValueError, match="a code is one of random, boolean, optimised, coupled, got 'best'"):
        _codes.code_of("best", _codes.imager_of(4, 16, (450, 650)), 3, 0)


def test_gains_and_where_they_fail():
    one = _codes.gain([31.0, 32.0, 33.0, 34.0], [30.0, 30.0, 30.0, 30.0])
    assert one.mean == 2.5
    assert one.error == pytest.approx(np.std([1, 2, 3, 4], ddof=1) / 2)
    assert one.clear
    assert not _codes.gain([31.0], [30.0]).clear
    up, level, down = Gain(mean=1, error=0.1), Gain(mean=-0.1, error=0.1), Gain(mean=-1, error=0.1)
    assert [_codes.holds({"a": up, "b": other}) for other in (up, level, down)] == [True, None, False]
    assert _codes.exceptions("x", {"a": up}) == ""
    text = _codes.exceptions("x", {"a": up, "b": down, "c": Gain(mean=0.1, error=0.1)})
    assert text == "x: below at b (-1.00 ± 0.10); not clear at c (+0.10 ± 0.10)"


@pytest.mark.parametrize(("shots", "length"), [(2, 3), (5, 1), (3, 4)])
def test_runs_have_one_length_and_use_all_shots_alike(shots, length):
    code = codes_better.runs_code(shots, (40, 120), length, 0)
    assert (code.sum(axis=0) == 1).all()
    np.testing.assert_allclose(code.mean(axis=(1, 2)), 1 / shots, atol=0.02)
    change = np.diff(code.argmax(axis=0), axis=1) != 0
    for row in change:
        places = np.flatnonzero(row)
        assert not (np.diff(places) % length).any()
    assert len({tuple(row[: shots * length]) for row in change}) > 1 or length == 1


def test_weights_that_are_tried_hold_the_default_and_the_source_s_range():
    for coupling in codes_c1.COSTS:
        weights = codes_c1._weights(12, 3, coupling, False)
        assert ("default", default_c1(12, 3, coupling)) in weights
        assert [c1 for role, c1 in weights if role == codes_c1.ENDS] == ([] if coupling else [1.0, 70.0])


def test_spread_is_drawn_as_a_band_about_the_line():
    curves = {"a": Curve(x=[1, 2], y=[3.0, 5.0], spread=[0.5, 1.0]), "b": Curve(x=[1, 2], y=[1.0, 1.0])}
    with style():
        (axes,) = sheet("", [[Curves(title="", xlabel="", ylabel="", curves=curves)]]).axes
    (band,) = axes.collections
    corners = band.get_paths()[0].vertices
    for corner in ((1, 2.5), (1, 3.5), (2, 4.0), (2, 6.0)):
        assert (corners == corner).all(axis=1).any()
