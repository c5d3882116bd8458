"""The studies of the simulations of section 2.4, in their quick form on the generated scene."""

import json

import numpy as np
import pytest

from shadowgram.experiments import studies
from shadowgram.experiments.source import generated
from shadowgram.experiments.studies import _common as common
from shadowgram.experiments.study import Record, spec_fields, task_key
from shadowgram.figures.style import style

PANELS = {"fig-2-15": 14, "fig-2-17": 13, "fig-2-19": 4, "fig-2-20": 7}


@pytest.fixture(scope="module", params=list(PANELS))
def done(request):
    study, scene = studies.load(request.param), generated()
    records = []
    for spec in study.specs(scene, True):
        result = study.run(spec, scene)
        records.append(Record(spec=spec_fields(spec), values=result.values, arrays=result.arrays, seconds=0.1))
    return study, records


def test_specs_are_different_tasks_and_the_full_ones_are_others():
    scene = generated()
    for name in PANELS:
        study = studies.load(name)
        keys = [[task_key(study, spec, scene) for spec in study.specs(scene, quick)] for quick in (True, False)]
        assert len(set(keys[0])) == len(keys[0])
        assert len(set(keys[1])) == len(keys[1])
        assert not set(keys[0]) & set(keys[1])
        assert keys[0] != [task_key(study, spec, generated(seed=1)) for spec in study.specs(scene, True)]


def test_figure_is_drawn_from_the_records(done):
    study, records = done
    with style():
        figure = study.figure(records)
    assert len(figure.axes) == PANELS[study.name]
    assert all(axes.has_data() for axes in figure.axes)


def test_claims_state_page_and_numbers(done):
    study, records = done
    for claim in study.claims(records):
        assert claim.page is None or 7 <= claim.page <= 40
        assert claim.agrees in (True, False, None)
        assert any(character.isdigit() for character in claim.found) or claim.agrees is None
        assert claim.agrees is not False or claim.why


def test_records_hold_what_json_and_npz_can(done):
    _, records = done
    for record in records:
        json.dumps(record.values, allow_nan=False)
        assert all(isinstance(a, np.ndarray) and a.dtype.kind in "fu" for a in record.arrays.values())


def test_a_task_gives_the_same_result_again(done):
    study, records = done
    scene = generated()
    spec = study.specs(scene, True)[-1]
    again = study.run(spec, scene)
    for name, array in records[-1].arrays.items():
        assert np.array_equal(again.arrays[name], array)


def test_the_stored_operator_is_the_operator():
    import shadowgram as sg

    imager = sg.SSCSI(
        detector_shape=(6, 16), detector_pitch=10.0, code_pitch=10.0, mask_position=0.1, wavelengths=(450, 650), bands=5
    )
    code = sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0)
    cube = np.random.default_rng(0).random((5, 6, 16), dtype=np.float32)
    got = common.stored_operator(imager, code).forward(cube)
    np.testing.assert_allclose(got, imager.operator(code).forward(cube), rtol=1e-5)


def test_detail_is_what_the_detector_elements_do_not_show():
    from shadowgram.experiments.studies.fig_2_17 import _detail

    rng = np.random.default_rng(0)
    truth = rng.random((2, 8, 8))
    coarse = truth.reshape(2, 4, 2, 4, 2).mean(axis=(2, 4)).repeat(2, axis=1).repeat(2, axis=2)
    assert _detail(truth, truth) == pytest.approx(1)
    assert _detail(coarse, truth) == 0
    assert abs(_detail(rng.random((2, 8, 8)), truth)) < 0.3


def test_an_unknown_study_is_refused_with_the_names_there_are():
    with pytest.raises(ValueError, match=r"there is no study 'fig-9-9'; there are fig-2-4, .*fig-2-24"):
        studies.load("fig-9-9")
