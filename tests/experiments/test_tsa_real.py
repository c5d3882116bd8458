"""The study of the real captures: its questions, what it says of made-up answers, and its numbers where the data are at hand."""

import json

import numpy as np
import pytest

from shadowgram.experiments import data_folder, studies
from shadowgram.experiments.source import generated
from shadowgram.experiments.studies import tsa_real as study
from shadowgram.experiments.study import Record, spec_fields
from shadowgram.figures.style import style


def made_up(spec):
    rng = np.random.default_rng(0)
    values = {
        "findings": [], "dy": 0.4, "dy_error": 0.05, "dx": 0.01, "dx_error": 0.09, "dispersion": 1.001, "dispersion_error": 0.003,
        "blur": [0.2, 0.1], "blur_errors": [0.08, 0.08], "dark": 0.0104, "dark_error": 2e-4,
        "held_out": {"given": 0.0057, "dark level": 0.0052, "corrected": 0.0045},
        "fitted": dict.fromkeys(study.WAYS, 0.003), "points": [[2, 3], [5, 6], [7, 9]], "noise": 0.0012, "rest_dark": 0.0013,
        "rest_bright": 0.004, "light_bright": 0.16, "correlation_x": [0.1] * 11, "correlation_y": [-0.3] * 11,
    }  # fmt: skip
    arrays = {f"rgb {way}": rng.integers(0, 255, (12, 16, 3)).astype(np.uint8) for way in study.WAYS}
    arrays |= {f"spectra {way}": rng.random((3, 28)) for way in study.WAYS}
    return values, arrays | {"capture": rng.random((12, 20)), "rest": rng.normal(0, 1e-3, (12, 20))}


@pytest.fixture(scope="module")
def records():
    found = []
    for spec in study.specs(generated(), quick=False):
        values, arrays = made_up(spec)
        found.append(Record(spec=spec_fields(spec), values=json.loads(json.dumps(values)), arrays=arrays, seconds=0.1))
    return found


def test_all_scenes_whole_or_a_part_of_one():
    assert studies.load("tsa-real").name == "tsa-real"
    whole = study.specs(generated(), quick=False)
    assert {spec.rows for spec in whole} == {(0, 660)}
    assert {spec.scene for spec in whole} == set(study.SCENES)
    assert len(study.specs(generated(), quick=True)) == 1


def test_figure_is_drawn_from_the_records(records):
    with style():
        figure = study.figure(records)
    shown = [axes for axes in figure.axes if axes.get_title(loc="left")]
    assert len(shown) == 6 * len(study.SCENES)


def test_claims_follow_the_numbers(records):
    seen, fits, dark, white = study.claims(records)
    assert seen.found.startswith("no; scene 1: +0.40 ± 0.05 px down")
    assert "0.00570 given, 0.00520 dark level, 0.00450 corrected, 21 % less" in fits.found
    assert "0.0104 ± 0.0002" in dark.found
    assert "in the dark half 0.00130" in white.found
    assert "neighbour is 0.30" in white.found
    assert all(claim.page is None and claim.agrees is None for claim in (seen, fits, dark, white))


def test_noise_alone_is_white():
    rng = np.random.default_rng(0)
    rest = rng.normal(0, 0.01, (1, 60, 80))
    found = study._residual(rest, 0.1 + rest)
    assert abs(found["noise"] - 0.01) < 0.006
    assert max(map(abs, found["correlation_x"])) < 0.06


def test_a_part_of_a_scene(data):
    if not (data / "tsa_real").is_dir():
        pytest.skip(f"{data / 'tsa_real'} is not there")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(data_folder.VARIABLE, str(data))
        (spec,) = study.specs(generated(), quick=True)
        values = study.run(spec, generated()).values
    json.dumps(values, allow_nan=False)
    assert [text.split(":")[0] for text in values["findings"]] == ["the mask is out of place"]
    assert 0.2 < values["dy"] < 0.7
    assert abs(values["dark"] - 0.0105) < 0.002
    errors = values["held_out"]
    assert errors["corrected"] < 0.95 * errors["dark level"] < 0.95 * errors["given"]
