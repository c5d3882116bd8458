"""The demo on a small scene: what it finds is plausible, and what it leaves behind is complete and needs no network."""

import json
import re

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.cli import main
from shadowgram.experiments import demo, demo_report
from shadowgram.measurement import read_measurement

SPEC = demo.DemoSpec(size=48, bands=6, sub_bands=4)
IMAGERS = ["SSCSI", "CASSI", "Colored CASSI, ideal", "Colored CASSI, 4 filters"]


@pytest.fixture(scope="module")
def found():
    said = []
    result = demo.run(SPEC, said.append)
    assert len(said) == demo.steps(SPEC)
    return result


@pytest.fixture(scope="module")
def written(found, tmp_path_factory):
    out = tmp_path_factory.mktemp("demo")
    return out, demo_report.write(found, out, "shadowgram demo", lambda what: None)


def test_every_imager_and_solver_is_there(found):
    assert [case.name for case in found.cases] == IMAGERS
    assert [[e.solver for e in case.estimates] for case in found.cases] == [["EigenTV", "GPSR"], *[["EigenTV"]] * 3]
    assert list(found.model_errors) == ["exact", "centre", "edge"]
    assert len(found.records()) == 8


def test_reconstructions_are_better_than_grey(found):
    scene = found.scene.values
    grey = sg.metrics.psnr(np.broadcast_to(scene.mean(axis=0), scene.shape), scene, peak=1.0)
    assert all(case.estimates[0].quality.psnr > grey for case in found.cases)


def test_a_finely_resolved_scene_costs_most_with_the_crudest_model(found):
    same = found.cases[0].estimates[0].quality.psnr
    psnr = {model: estimate.quality.psnr for model, estimate in found.model_errors.items()}
    assert same + 0.5 > psnr["exact"] > psnr["edge"]


def test_figures_are_those_of_the_cubes_in_the_files(found, written):
    out, _ = written
    scene = sg.scenes.read(out / "scene.nc").values
    for case, stem in zip(
        found.cases, ["sscsi", "cassi", "colored-cassi-ideal", "colored-cassi-4-filters"], strict=True
    ):
        cube = sg.scenes.read(out / f"{stem}.nc").values
        assert sg.metrics.psnr(cube, scene, peak=1.0) == pytest.approx(case.estimates[0].quality.psnr, abs=1e-6)
        measured = read_measurement(out / f"{stem}-shots.nc")
        assert np.array_equal(measured.snapshots, case.measurement.snapshots)


def test_results_say_what_was_run(found, written):
    results = json.loads((written[0] / "results.json").read_text())
    assert results["version"] == sg.__version__
    assert results["spec"]["size"] == 48
    assert len(results["records"]) == 8
    assert results["records"][0]["psnr"] == found.cases[0].estimates[0].quality.psnr
    measured = {(r["imager"], r["solver"], r["measured_with"], r["model"]) for r in results["records"]}
    assert ("SSCSI", "EigenTV", "same model", "exact") in measured
    assert ("SSCSI", "EigenTV", "4 fine bands a band", "edge") in measured


def test_report_is_self_contained(written):
    out, files = written
    assert files[0] == out / "report.html"
    page = files[0].read_text()
    for reference in re.findall(r'(?:src|href|srcset)="([^"]*)"', page) + re.findall(r"url\(([^)]*)\)", page):
        assert reference.startswith("data:image/png;base64,")
    assert not re.search(r"https?:|<script|<link|@import|<iframe", page)


def test_report_says_what_matters(found, written):
    page = written[1][0].read_text()
    for case in found.cases:
        assert case.name in page
        for estimate in case.estimates:
            assert f"{estimate.quality.psnr:.2f}" in page
    assert all(text in page for text in ("T1", "T2", "inverse crime", "shadowgram demo", sg.__version__))
    assert "{{" not in page
    assert str(written[0]) not in page


def test_overview_is_a_picture(written):
    out, _ = written
    assert (out / "overview.png").read_bytes().startswith(b"\x89PNG")


def test_same_spec_same_numbers(found):
    imager, code = demo.imagers_and_codes(SPEC, demo.WAVELENGTHS)["SSCSI"]
    assert imager == found.cases[0].measurement.imager
    assert np.array_equal(code, found.cases[0].measurement.code)


def test_points_lie_in_the_picture_and_differ():
    for seed in range(3):
        cube = sg.scenes.chart(size=64, bands=8, seed=seed).values
        first, second = demo_report.pick_points(cube)
        assert (first.y, first.x) != (second.y, second.x)
        assert max(first.y, first.x, second.y, second.x) < 64


def test_points_of_a_dull_scene():
    points = demo_report.pick_points(np.ones((4, 32, 32), np.float32))
    assert [point.label for point in points] == ["T1", "T2"]


def test_command(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(demo, "QUICK", SPEC)
    out = tmp_path / "new" / "folder"
    assert main(["demo", "--quick", "--seed", "2", "--out", str(out), "--threads", "1", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert len(said["records"]) == 8
    assert (out / "report.html").exists()
    assert "shadowgram demo --quick --seed 2" in (out / "report.html").read_text()
