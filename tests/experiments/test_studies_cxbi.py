"""The studies of our own backscatter scans, on made-up scans of few cells, and the two that are made with the transport."""

import dataclasses
import json
import sys
import types

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.cli import main
from shadowgram.experiments import data_folder, studies
from shadowgram.experiments.source import generated
from shadowgram.experiments.studies import _cxbi_scans as scans
from shadowgram.experiments.studies import _cxbi_ways as ways
from shadowgram.experiments.studies import cxbi_poisson, fig_4_4, fig_4_9
from shadowgram.experiments.study import Record, spec_fields, task_key
from shadowgram.figures.style import style
from shadowgram.xray.scan import PencilMap, Scan

PANELS = {"fig-4-4": 9, "fig-4-5": 6, "fig-4-8": 10, "fig-4-9": 10, "cxbi-poisson": 8}
PAGES = range(73, 82)
FULL = {"fig-4-4": 13, "fig-4-5": 9, "fig-4-8": 10, "fig-4-9": 3, "cxbi-poisson": 6}


def cells_of(pitch):
    return 16 if pitch == scans.PITCH else 24


def letter(cells):
    """A block, in counts a cell."""
    y, x = np.indices((cells, cells)) / cells
    return np.where((y > 0.3) & (y < 0.7) & (x > 0.2) & (x < 0.6), 80.0, 0.5)


def made_scan(_target, percent, _histories, pitch=scans.PITCH):
    """Shots of a mask before air that gives 2 counts through a cell."""
    cells = cells_of(pitch)
    shots = cells**2 // 2
    mask = (np.random.default_rng(3).random((cells, cells + shots - 1)) < percent / 100).astype(np.uint8)
    codes = np.stack([mask[:, q : q + cells] for q in range(shots)])
    image = letter(cells)
    air = 2000 + 2.0 * codes.sum(axis=(1, 2))
    counts = air + sg.CXBI(shape=(cells, cells)).operator(mask).forward(image)
    return Scan(
        counts=counts, standard_error=np.sqrt(counts), background=air, background_error=np.sqrt(air), codes=codes,
        photons_per_shot=1e7, exposure=0.015, route="linear", noisy=False, seed=0, scene="", image=image,
    )  # fmt: skip


def made_truth(_target, photons, pitch=scans.PITCH):
    image = letter(cells_of(pitch))
    return PencilMap(
        counts=image + 2.0 * ways.AIR_SHARE, standard_error=np.zeros_like(image), target=image + 0.01 * np.eye(len(image)),
        photons=photons, pitch=8.7, distance=250.0, half_angle=0.007, noisy=False, seed=0, scene="",
    )  # fmt: skip


@pytest.fixture(scope="module")
def all_records():
    done = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scans, "scan_of", made_scan)
        patch.setattr(scans, "truth_of", made_truth)
        for name in PANELS:
            study = studies.load(name)
            specs = study.specs(generated(), True)
            results = [study.run(spec, generated()) for spec in specs]
            done[name] = [
                Record(spec=spec_fields(spec), values=result.values, arrays=result.arrays, seconds=0.1)
                for spec, result in zip(specs, results, strict=True)
            ]
    return done


@pytest.fixture(params=list(PANELS))
def done(request, all_records):
    return studies.load(request.param), all_records[request.param]


@pytest.mark.parametrize("name", PANELS)
def test_specs_are_different_tasks_and_the_full_ones_are_others(name):
    scene, study = generated(), studies.load(name)
    assert (study.name, study.chapter, study.data) == (name, 4, "")
    keys = [[task_key(study, spec, scene) for spec in study.specs(scene, quick)] for quick in (True, False)]
    assert all(len(set(own)) == len(own) for own in keys)
    assert len(keys[1]) == FULL[name]
    # The picture of the matrix is the same in both forms.
    assert len(set(keys[0]) & set(keys[1])) == (name == "fig-4-4")


def test_figure_is_drawn_from_the_records(done):
    study, records = done
    with style():
        figure = study.figure(records)
    axes = [one for one in figure.axes if one.has_data() and one.get_label() != "<colorbar>"]
    assert len(axes) == PANELS[study.name]


def test_claims_state_page_and_numbers(done):
    study, records = done
    claims = study.claims(records)
    assert len({claim.says for claim in claims}) == len(claims)
    assert any(claim.page is not None for claim in claims)
    for claim in claims:
        assert claim.page is None or claim.page in PAGES
        assert claim.page is not None or claim.agrees is None
        assert any(character.isdigit() for character in claim.found)
        assert claim.agrees is not False or claim.why
        assert "nan" not in claim.found + claim.why


def test_records_hold_what_json_and_npz_can(done):
    _, records = done
    for record in records:
        json.dumps(record.values, allow_nan=False)
        assert all(isinstance(a, np.ndarray) and a.dtype == np.float32 for a in record.arrays.values())


def test_the_matrix_is_that_of_the_equations(all_records):
    claims = fig_4_4.claims(all_records["fig-4-4"])
    assert [claim.agrees for claim in claims] == [True, True, True, True, None]
    wrong = [
        dataclasses.replace(r, values=r.values | {"difference": 1.0, "moved": 0.9, "adjacent_seen": 0.1})
        if r.spec["kind"] == "shown" or r.spec["choice"] == "consecutive" else r
        for r in all_records["fig-4-4"]
    ]  # fmt: skip
    assert [claim.agrees for claim in fig_4_4.claims(wrong)] == [True, False, False, False, None]


def test_an_image_near_the_truth_is_found_in_the_truths_units(all_records):
    (record,) = all_records["fig-4-5"]
    nothing = ways.score(np.zeros((16, 16)), letter(16))[0]
    for kind in scans.KINDS:
        assert record.values[f"blind_4_psnr_{kind}"] > nothing + 4
    assert record.values["views"] > 80


def test_counts_are_in_proportion_to_the_dose():
    scan = made_scan("", 10, 0)
    taken = slice(1, None, 4)
    shots = scans.drawn(scan, taken, 0.25, 0)
    assert np.array_equal(shots.codes, scan.codes[1::4])
    for drawn, mean in ((shots.counts, scan.counts[1::4]), (shots.air, scan.background[1::4])):
        assert np.array_equal(drawn, np.round(drawn))
        assert abs((drawn - mean / 4).sum()) < 4 * np.sqrt(mean.sum() / 4)
    again = scans.drawn(scan, taken, 0.25, 0)
    assert np.array_equal(again.counts, shots.counts)
    assert not np.array_equal(scans.drawn(scan, taken, 0.25, 1).counts, shots.counts)


def test_details_are_those_within_two_by_two_pixels():
    fine = np.kron(np.eye(6), np.ones((2, 2))) * 10
    fine[0, 0] = 14
    found = fig_4_9._detail(fine, fine)
    assert (found["detail"], found["likeness"]) == (pytest.approx(1), pytest.approx(1))
    flat = fig_4_9._detail(np.full((6, 6), 3.0), fine)
    assert flat["detail"] == pytest.approx(0, abs=1e-9)
    assert fig_4_9._contrast(2 * fine, fine)["share"] == pytest.approx(1)


def test_the_page_80_verdict_is_by_what_noise_costs(all_records):
    (record,) = all_records["cxbi-poisson"]
    verdicts = []
    for clean in (record.values["subtracted_1_psnr"] + 0.1, record.values["subtracted_1_psnr"] + 3):
        changed = dataclasses.replace(record, values=record.values | {"clean_psnr": clean})
        verdicts.append(cxbi_poisson.claims([changed])[0].agrees)
    assert verdicts == [True, False]


def test_the_transport_gives_scan_and_truth_of_the_same_image():
    scan = scans.scan_of("letters", 10, 60_000)
    truth = scans.truth_of("letters", 10)
    assert scan.counts.shape == (512,)
    assert scan.counts.mean() > 1.2 * scan.background.mean()
    # Not mirrored: the letters U and D are not the same from the other side.
    both = [np.corrcoef(scan.image.ravel(), truth.target[:, ::turn].ravel())[0, 1] for turn in (1, -1)]
    assert both[0] > 0.7
    assert both[0] > both[1] + 0.2


def test_a_finer_mask_fills_the_same_window():
    fine = scans._scene("letters", 10, fig_4_9.FINE)
    coarse = scans._scene("letters", 10, fig_4_9.COARSE)
    assert fine.mask.columns_in_view * fine.mask.pitch == coarse.mask.columns_in_view * coarse.mask.pitch == 64
    assert (fine.mask.rows, fine.shots, fine.mask.most_shots) == (64, 2048, 2048)
    assert fine.mask.depth == coarse.mask.depth


@pytest.fixture
def measured(little, tmp_path, monkeypatch):
    """A study that needs no data and one that does, in place of the studies of the package."""
    known = {
        "plain": little.make_study([little.Spec(number=0)], "plain"),
        "lab": dataclasses.replace(little.make_study([little.Spec(number=1)], "lab"), data="a bench far away"),
    }
    stand_in = types.SimpleNamespace(STUDIES=tuple(known), load=known.__getitem__)
    monkeypatch.setitem(sys.modules, "shadowgram.experiments.studies", stand_in)
    monkeypatch.setattr("shadowgram.experiments.studies", stand_in, raising=False)
    # Set first, so that what --data puts there is gone afterwards.
    monkeypatch.setenv(data_folder.VARIABLE, str(tmp_path))
    monkeypatch.delenv(data_folder.VARIABLE)
    monkeypatch.chdir(tmp_path)


def run(capsys, command):
    """Standard output and error of a command that ends well."""
    assert main(command.split()) == 0
    return capsys.readouterr()


def test_all_leaves_out_what_has_no_data_and_says_why(measured, capsys):
    said = run(capsys, "study run all")
    why = "it needs measured data (a bench far away); name their folder with --data or SHADOWGRAM_DATA"
    assert f"shadowgram: lab is left out: {why}" in said.err.splitlines()
    assert said.out.splitlines()[-1].startswith("1 of 1 studies complete, 1 left out for want of data, ")
    found = json.loads(run(capsys, "study run all --json").out)
    assert [one["study"] for one in found["studies"]] == ["plain"]
    assert found["left_out"] == [{"study": "lab", "why": why}]


def test_with_a_folder_or_its_records_it_is_not_left_out(measured, tmp_path, capsys):
    said = run(capsys, f"study run all --data {tmp_path}")
    assert said.out.splitlines()[-1].startswith("2 of 2 studies complete, ")
    assert "left out" not in said.out + said.err
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(data_folder.VARIABLE)
        said = run(capsys, "study run all")
    assert said.out.splitlines()[-1].startswith("2 of 2 studies complete, ")
    assert "1 reused" in said.err


def test_the_studies_of_the_authors_data_say_that_they_need_them():
    for name in ("cxbi-gate", "cxbi-laboratory"):
        assert studies.load(name).data == "github.com/Edgar-Noita/CXBI"
