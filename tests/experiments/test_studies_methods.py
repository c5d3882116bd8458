"""The comparisons of methods, in their quick form on the generated scene, and the field's comparison on a folder of scenes."""

import json

import numpy as np
import pytest
from scipy.io import savemat

from shadowgram.experiments.data_folder import VARIABLE
from shadowgram.experiments.source import generated
from shadowgram.experiments.studies import _methods, kaist, methods
from shadowgram.experiments.study import Record, spec_fields, task_key
from shadowgram.figures.style import style
from shadowgram.scenes import chart

PANELS = {"methods": 2 + 2 + 1 + 2 * 7, "kaist": 5}


@pytest.fixture(scope="module")
def records():
    scene, done = generated(), {}
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(VARIABLE, raising=False)
        for study in (methods.STUDY, kaist.STUDY):
            done[study.name] = [
                Record(spec=spec_fields(spec), values=result.values, arrays=result.arrays, seconds=0.1)
                for spec in study.specs(scene, True)
                for result in [study.run(spec, scene)]
            ]
    return done


@pytest.mark.parametrize("study", [methods.STUDY, kaist.STUDY], ids=lambda study: study.name)
def test_figure_and_claims_come_from_the_records(study, records):
    own = records[study.name]
    with style():
        drawn = [axes for axes in study.figure(own).axes if axes.has_data()]
    assert len(drawn) == PANELS[study.name]
    claims = study.claims(own)
    assert len({claim.says for claim in claims}) == len(claims) > 3
    assert all("nan" not in claim.found for claim in claims)
    for record in own:
        json.dumps(record.values, allow_nan=False)


@pytest.mark.parametrize("study", [methods.STUDY, kaist.STUDY], ids=lambda study: study.name)
def test_quick_and_full_tasks_are_all_different(study, monkeypatch):
    monkeypatch.delenv(VARIABLE, raising=False)
    scene = generated()
    keys = [task_key(study, spec, scene) for quick in (True, False) for spec in study.specs(scene, quick)]
    assert len(set(keys)) == len(keys)


def test_every_method_finds_something_and_eigen_tv_more_than_gpsr(records):
    found = {(r.spec["method"], r.spec["noise"]): r.values for r in records["methods"] if "noise" in r.spec}
    assert {name for name, _ in found} == set(_methods.METHODS)
    assert all(values["psnr"] > 15 and values["seconds"] > 0 for values in found.values())
    assert found["eigen-tv", "30 dB"]["psnr"] > found["gpsr", "30 dB"]["psnr"]
    # A search starts with the parameters that EigenTV chooses for itself.
    assert found["eigen-tv-searched", "30 dB"]["psnr"] >= found["eigen-tv", "30 dB"]["psnr"]


def test_memory_counts_at_least_the_cube(records):
    [measured] = [r for r in records["methods"] if r.spec.get("part") == methods.MEMORY]
    cube = 24 * 128 * 128 * 4 / 1e6
    assert cube < measured.values["memory"] < 40 * cube


def test_published_psnr_is_the_mean_over_the_bands_after_rounding():
    truth = np.zeros((2, 4, 4))
    x = truth.copy()
    x[0] += 10 / 256
    x[1] += 20.3 / 256  # is 20
    assert kaist.published_psnr(x, truth) == pytest.approx(np.mean([20 * np.log10(255 / 10), 20 * np.log10(255 / 20)]))


def test_a_folder_of_scenes_and_a_mask_is_what_is_compared(tmp_path, monkeypatch):
    folder = tmp_path / "kaist"
    folder.mkdir()
    cube = np.asarray(chart(size=256, bands=28, seed=0).values)
    savemat(folder / "scene01.mat", {"img": cube.transpose(1, 2, 0)})
    mask = (np.random.default_rng(0).random((256, 256)) < 0.5).astype(np.float64)
    savemat(folder / "mask.mat", {"mask": mask})
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    specs = kaist.specs(generated(), False)
    assert {spec.scene for spec in specs} == {"scene01.mat"}
    assert all(spec.digest and spec.mask for spec in specs)
    values, centres = kaist.read_scene(folder / "scene01.mat")
    np.testing.assert_array_equal(values, cube)
    np.testing.assert_array_equal(centres, kaist.WAVELENGTHS)
    np.testing.assert_array_equal(kaist._mask(specs[0]), mask[None])


def test_a_scene_of_another_size_is_refused(tmp_path):
    savemat(tmp_path / "a.mat", {"img": np.ones((64, 60, 28))})
    with pytest.raises(ValueError, match=r"\(28, 64, 60\), and the comparison is of \(28, 256, 256\); crop it"):
        kaist.read_scene(tmp_path / "a.mat")
    savemat(tmp_path / "b.mat", {"img": np.full((256, 256, 28), 1.5)})
    with pytest.raises(ValueError, match=r"1.5, and the comparison's lie in \[0, 1\]"):
        kaist.read_scene(tmp_path / "b.mat")
