"""The studies of chapter 4, in their quick form."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.experiments import studies
from shadowgram.experiments.source import generated
from shadowgram.experiments.studies import _common as common
from shadowgram.experiments.studies import fig_4_1, slab_backscatter
from shadowgram.experiments.study import Record, spec_fields, task_key
from shadowgram.figures.style import style

PANELS = {"fig-4-1": 8, "slab-backscatter": 6}
GOLDEN = Path(__file__).parent.parent / "golden" / "xray_slabs.json"


@pytest.fixture(scope="module")
def all_records():
    scene, done = generated(), {}
    for name in PANELS:
        study = studies.load(name)
        done[name] = []
        for spec in study.specs(scene, True):
            result = study.run(spec, scene)
            done[name].append(Record(spec=spec_fields(spec), values=result.values, arrays=result.arrays, seconds=0.1))
    return done


@pytest.fixture(params=list(PANELS))
def done(request, all_records):
    return studies.load(request.param), all_records[request.param]


@pytest.mark.parametrize("name", PANELS)
def test_specs_are_different_tasks_and_the_full_ones_are_others(name):
    scene, study = generated(), studies.load(name)
    assert (study.name, study.chapter) == (name, 4)
    keys = [[task_key(study, spec, scene) for spec in study.specs(scene, quick)] for quick in (True, False)]
    assert all(len(set(own)) == len(own) for own in keys)
    assert not set(keys[0]) & set(keys[1])


def test_figure_is_drawn_from_the_records(done):
    study, records = done
    with style():
        figure = study.figure(records)
    assert len([axes for axes in figure.axes if axes.has_data()]) == PANELS[study.name]


def test_claims_state_page_and_numbers(done):
    study, records = done
    claims = study.claims(records)
    assert len({claim.says for claim in claims}) == len(claims)
    for claim in claims:
        assert claim.page is None or claim.page in (67, 68)
        assert claim.page is not None or claim.agrees is None
        assert any(character.isdigit() for character in claim.found)
        assert claim.agrees is not False or claim.why
        assert "nan" not in claim.found + claim.why


def test_records_hold_what_json_and_npz_can(done):
    _, records = done
    for record in records:
        json.dumps(record.values, allow_nan=False)
        assert all(isinstance(a, np.ndarray) and a.dtype == np.float32 for a in record.arrays.values())


def test_a_task_gives_the_same_result_again(done):
    study, records = done
    scene = generated()
    again = study.run(study.specs(scene, True)[0], scene)
    assert again.values == records[0].values
    for name, array in records[0].arrays.items():
        assert np.array_equal(again.arrays[name], array)


def test_what_a_photon_keeps_and_when_it_is_seventy_percent(all_records):
    kept, *_ = fig_4_1.claims(all_records["fig-4-1"])
    assert kept.agrees is False
    for energy in (20, 60, 120):
        assert f"{100 / (1 + 2 * energy / 510.999):.1f} % at {energy} keV" in kept.found
    assert "70 % at 109.5 keV, and 65 to 75 % from 85 to 138 keV" in kept.found


def test_shares_of_free_electrons_are_those_of_a_plain_sum(all_records):
    theta = (np.arange(20_000) + 0.5) * math.pi / 20_000
    for energy in fig_4_1.SHOWN:
        values = common.only(all_records["fig-4-1"], energy=energy).values
        for name in ("free", "water", "gold"):
            section = (
                sg.xray.klein_nishina(energy, theta)
                if name == "free"
                else sg.xray.bound_compton(sg.xray.material(name), energy, theta)
            )
            parts = 2 * math.pi * section * np.sin(theta) * math.pi / 20_000
            assert values[name]["total"] == pytest.approx(parts.sum(), rel=2e-4)
            assert values[name]["backward"] == pytest.approx(parts[10_000:].sum() / parts.sum(), abs=1e-4)
        assert values["free"]["total"] == pytest.approx(float(sg.xray.klein_nishina_total(energy)), rel=1e-9)


def test_binding_is_told_for_each_energy(all_records):
    binding = fig_4_1.claims(all_records["fig-4-1"])[-1]
    for energy in fig_4_1.SHOWN:
        values = common.only(all_records["fig-4-1"], energy=energy).values
        for name in fig_4_1.MATERIALS:
            back, total = (values[name][what] / values["free"][what] for what in ("back", "total"))
            assert f"{back:.3f} and {total:.3f} at {energy:g} keV" in binding.found
            assert total < back <= 1


def test_reference_numbers_are_those_of_the_benchmark():
    packaged = Path(sg.xray.__file__).parent / "data" / "slabs-penred.json"
    assert json.loads(packaged.read_text()) == json.loads(GOLDEN.read_text())


def test_slabs_scatter_back_what_the_other_program_says(all_records):
    # The tables differ by 1.3 and 1.9 % in effect at 30 keV, and by less above; the rest is chance.
    for record in all_records["slab-backscatter"]:
        apart, error = slab_backscatter._difference(record)
        assert error < 0.02
        assert abs(apart) < 0.02 + 4 * error
        for what, near in (("energy", 0.005 * record.spec["energy"]), ("cosine", 0.02)):
            means = [slab_backscatter.mean_of(record, what, prefix) for prefix in ("", "reference_")]
            assert means[0] == pytest.approx(means[1], abs=near)


def test_histograms_add_up_to_the_fractions(all_records):
    for record in all_records["slab-backscatter"]:
        for prefix, name in (("", "fraction"), ("reference_", "reference")):
            for what in ("energy", "cosine"):
                assert record.arrays[f"{prefix}{what}"].sum() == pytest.approx(record.values[name], rel=1e-4)
        assert record.arrays["cosine_edges"] == pytest.approx(record.arrays["reference_cosine_edges"])


def test_claims_say_within_or_beyond(all_records):
    records = all_records["slab-backscatter"]
    changed = [
        Record(
            spec=r.spec,
            values={**r.values, "fraction": (1 + shift) * r.values["reference"]},
            arrays=r.arrays,
            seconds=0,
        )
        for r, shift in zip(records, (0.004, 0.006, -0.004, 0.014, -0.016, 0.0), strict=True)
    ]
    water, aluminum, *_ = slab_backscatter.claims(changed)
    assert [text.count("(within)") for text in (water.found, aluminum.found)] == [2, 2]
    assert "60 keV" in water.found.split("(beyond)")[0].split(";")[-1]
    assert water.why
    assert not slab_backscatter.claims([*changed[:1] * 3, *changed[3:]])[0].why
