"""The studies of the models, sections 2.2 to 2.4.1, in their quick form on the generated scene."""

import json

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.experiments import studies
from shadowgram.experiments.source import generated
from shadowgram.experiments.studies import _common as common
from shadowgram.experiments.studies import _probes as probes
from shadowgram.experiments.studies import fig_2_4, fig_2_13, fig_2_14
from shadowgram.experiments.study import Claim, Record, spec_fields, task_key
from shadowgram.figures.style import style
from shadowgram.operators import as_matrix

# Axes of the figure (a map has a scale beside it), and what the claims find.
PANELS = {"fig-2-4": 17, "tables-2-1": 6, "fig-2-13": 19, "fig-2-14": 11}
AGREES = {
    "fig-2-4": [True, True, None, None],
    "tables-2-1": [True, False, True, False, True, True, True, True],
    "fig-2-13": [True, True, None],
    "fig-2-14": [True, None, True, True, True],
}


def recorded(spec, result):
    """A record as the journal gives it back."""
    values = json.loads(json.dumps(result.values, allow_nan=False))
    return Record(spec=spec_fields(spec), values=values, arrays=result.arrays, seconds=0.1)


@pytest.fixture(scope="module")
def all_records():
    scene = generated()
    found = {}
    for name in PANELS:
        study = studies.load(name)
        found[name] = [recorded(spec, study.run(spec, scene)) for spec in study.specs(scene, True)]
    return found


@pytest.fixture(params=list(PANELS))
def done(request, all_records):
    return studies.load(request.param), all_records[request.param]


def camera(**changes):
    geometry = {
        "detector_shape": (1, 16),
        "detector_pitch": 10.0,
        "code_pitch": 10.0,
        "mask_position": 0.3125,
        "wavelengths": (450.0, 650.0),
        "shear": "edge",
    }
    return sg.SSCSI(**(geometry | changes))


def test_specs_are_different_tasks_of_the_study_that_is_asked_for():
    scene = generated()
    for name in PANELS:
        study = studies.load(name)
        assert study.name == name
        for quick in (True, False):
            keys = [task_key(study, spec, scene) for spec in study.specs(scene, quick)]
            assert len(set(keys)) == len(keys)


def test_figure_is_drawn_from_the_records(done):
    study, records = done
    with style():
        figure = study.figure(records)
    assert len(figure.axes) == PANELS[study.name]
    assert all(axes.has_data() for axes in figure.axes)


def test_claims_state_page_numbers_and_what_was_found(done):
    study, records = done
    claims = study.claims(records)
    assert [claim.agrees for claim in claims] == AGREES[study.name]
    for claim in claims:
        assert isinstance(claim, Claim)
        assert any(character.isdigit() for character in claim.found)
        if claim.page is None:  # a question of ours
            assert claim.agrees is None
            continue
        assert 8 <= claim.page <= 29
        assert type(claim.agrees) is bool
        assert claim.agrees or claim.why


def test_arrays_can_be_stored_and_are_small(done):
    _, records = done
    assert all(a.dtype.kind in "fu" and a.dtype.itemsize <= 4 for r in records for a in r.arrays.values())
    assert sum(a.nbytes for r in records for a in r.arrays.values()) < 2_000_000


def test_a_task_gives_the_same_result_on_any_number_of_threads(done):
    study, records = done
    scene = generated()
    for spec, record in zip(study.specs(scene, True)[:2], records, strict=False):
        with sg.threads(3):
            again = recorded(spec, study.run(spec, scene))
        assert again.values == record.values
        for name, array in record.arrays.items():
            assert np.array_equal(again.arrays[name], array), name


# Fig. 2.4


def test_runs_grow_by_the_stretching_and_the_texture_by_the_dispersion(all_records):
    for record in all_records["fig-2-4"]:
        s, size = record.spec["mask_position"], record.spec["size"]
        for way in ("same", "continuous"):
            seen = record.values[way]
            assert seen["run"] / record.values["code_run"] * (1 - s) == pytest.approx(1, abs=0.03)
            if s > 0:
                length, contrast = fig_2_4.expected(s, size)
                # One code of 64 rows: its correlation is known to about 1/√64.
                assert seen["texture"] == pytest.approx(length, rel=0.15)
                assert seen["contrast"] == pytest.approx(contrast, rel=0.15)


def test_texture_is_the_width_of_what_smeared_a_random_code():
    code = np.random.default_rng(0).integers(0, 2, (400, 200)).astype(float)
    assert fig_2_4.texture_length(code) == pytest.approx(1, abs=0.02)
    smeared = np.stack([np.convolve(row, np.ones(9) / 9, mode="valid") for row in code])
    assert fig_2_4.texture_length(smeared) == pytest.approx(9, abs=0.5)
    assert fig_2_4.mean_run(code) == pytest.approx(2, abs=0.03)
    assert fig_2_4.mean_run(code.repeat(3, axis=1)) == pytest.approx(6, abs=0.1)


def test_expected_texture_is_that_of_codes_seen_through_eq_2_2():
    s, columns = 0.3, 40
    rng = np.random.default_rng(1)
    rows = rng.integers(0, 2, (3000, columns)).astype(float)
    once = np.cumsum(np.pad(rows, ((0, 0), (1, 0))), axis=1)
    area = np.concatenate([np.zeros((3000, 1)), np.cumsum((once[:, 1:] + once[:, :-1]) / 2, axis=1)], axis=1)

    def integral(u):
        """∫∫ of every row up to u, which is quadratic between columns."""
        cell = np.minimum(np.floor(u).astype(int), columns - 1)
        part = u - cell
        return area[:, cell] + once[:, cell] * part + rows[:, cell] * part**2 / 2

    left = np.arange(columns) * (1 - s)
    right, moved = left + (1 - s), s * columns
    seen = integral(right + moved) - integral(left + moved) - integral(right) + integral(left)
    seen /= (1 - s) * moved
    length, contrast = fig_2_4.expected(s, columns)
    assert fig_2_4.texture_length(seen) == pytest.approx(length, rel=0.05)
    assert seen.std() / seen.mean() == pytest.approx(contrast, rel=0.03)


# Tables 2.1 to 2.3


@pytest.mark.parametrize(
    ("changes", "partly", "wholly"),
    [
        ({}, 11 / 16, 5 / 16),
        ({"dispersion_ratio": 1.5}, 11 / 16, 5 / 16),
        ({"code_pitch": 5.0}, 1, 6 / 16),
        ({"code_pitch": 2.5}, 1, 28 / 16),
        ({"code_pitch": 5.0, "mask_position": 0.75}, 0.5, 0.5),
    ],
)
def test_probes_find_the_spectral_limits(changes, partly, wholly):
    """Table 2.2 in code columns, for Δd (1−s)/Δc = 11/16, 22/16, 44/16 and 1/2."""
    imager = camera(**changes)
    bound = 200 / imager.spectral_columns
    assert probes.extents(imager) == pytest.approx((partly * bound, wholly * bound), rel=1e-6)
    change, rest = probes.whole_column(imager, seed=0)
    assert change == pytest.approx(bound, rel=1e-9)
    assert rest < 1e-9


def test_probes_say_where_the_spectrum_is_too_short():
    imager = camera(mask_position=0.05)  # 0.8 columns
    assert probes.extents(imager) is None
    assert probes.whole_column(imager, seed=0) is None


@pytest.mark.parametrize(("ratio", "s"), [(1, 0.3125), (1, 0.5), (2, 0.1875), (2, 0.5), (3, 0.25)])
def test_places_told_apart_are_the_parts_between_edges(ratio, s):
    imager = camera(code_pitch=10.0 / ratio, mask_position=s)
    stretched = 1 / (ratio * (1 - s))
    offset = s * 16 * ratio / 2  # the central wavelength, in code columns
    code_edges = (np.arange(-200, 200) - offset % 1) * stretched
    edges = np.unique(np.round(np.concatenate([np.arange(17), code_edges]), 9))
    parts = np.diff(edges[(edges >= 0) & (edges <= 16)])
    found = probes.pieces(imager)
    assert np.count_nonzero(found > probes.SEEN) == len(parts)
    assert found.max() == pytest.approx(parts.max(), abs=1e-8)
    _, columns, rows = probes.independent_columns(imager, seed=0)
    assert (columns, rows) == (len(parts), ratio)


@pytest.mark.parametrize("beta", [0.7, 1.0, 2.2])
@pytest.mark.parametrize(("ratio", "s"), [(1, 0.3), (2, 0.3), (2, 0.5), (3, 0.8)])
def test_printed_equations_are_the_edge_model_and_no_other(ratio, s, beta):
    imager = camera(detector_shape=(2, 5), code_pitch=10.0 / ratio, mask_position=s, dispersion_ratio=beta)
    code = sg.codes.random(shots=2, shape=imager.code_shape, seed=2)
    printed = probes.matrix_by_loops(imager, code)
    assert np.abs(printed - as_matrix(imager.operator(code))).max() < 1e-12
    exact = camera(
        detector_shape=(2, 5), code_pitch=10.0 / ratio, mask_position=s, dispersion_ratio=beta, shear="exact"
    )
    assert np.abs(printed - as_matrix(exact.operator(code))).max() > 0.1


def test_tables_hold_in_every_geometry(all_records):
    records = common.chosen(all_records["tables-2-1"], part="probe")
    assert {r.values["regime"] for r in records} == {"super-resolving", "detector-limited"}
    for r in records:
        measured = r.values["measured"]
        assert measured["widest"] == pytest.approx(r.values["x_pitch"], rel=1e-6)
        assert measured["extents"] == pytest.approx(r.values["extents"], abs=0.01 * r.values["band_width"])
        assert measured["pieces"] == measured["columns"] >= measured["columns_discrete"] == r.values["cube_shape"][2]


# Fig. 2.13


def test_exact_shear_recovers_what_first_order_loses(all_records):
    records = common.chosen(all_records["fig-2-13"], part="quality")
    for bands in {r.spec["bands"] for r in records}:
        of = {(r.spec["way"], r.spec["shear"]): r.values for r in records if r.spec["bands"] == bands}
        fine = [of["continuous", shear] for shear in ("edge", "centre", "exact")]
        for solver in ("gpsr", "eigen-tv"):
            edge, centre, exact = (values[solver]["psnr"] for values in fine)
            assert edge + 3 < centre < exact
            assert of["same", "edge"][solver]["psnr"] > edge + 3
        assert fine[0]["model_error"] > 2 * fine[1]["model_error"] > 2 * fine[2]["model_error"]
        assert of["same", "edge"]["model_error"] == 0


def test_maps_are_the_mask_and_its_means(all_records):
    for record in common.chosen(all_records["fig-2-13"], part="map"):
        assert set(np.unique(record.arrays["mask"])) == {0, 1}
        assert record.arrays["mask"].shape == record.arrays["edge"].shape == record.arrays["exact"].shape
        assert record.values["edge_off_lowest"] < 1e-6
        assert record.values["exact_off_mask"] < 1e-6
        assert np.abs(record.arrays["exact"].mean() - record.arrays["mask"].mean()) < 1e-6
        assert np.abs(record.arrays["exact"] - record.arrays["edge"]).max() > 0.4


def test_times_are_there_for_every_shear(all_records):
    times = common.only(all_records["fig-2-13"], part="time").values["milliseconds"]
    assert set(times) == {f"{shear} {way}" for shear in ("edge", "centre", "exact") for way in ("forward", "adjoint")}
    assert all(value > 0 for value in times.values())


def test_coefficients_are_shares_of_the_light():
    imager = camera(detector_shape=(1, 7), code_pitch=5.0, mask_position=0.3, shear="exact")
    code = sg.codes.random(shots=1, shape=imager.code_shape, seed=0)
    found = fig_2_13.coefficients(imager, code)
    assert found.shape == (7, imager.resolution.bands, imager.resolution.cube_shape[2])
    assert np.nanmin(found) >= 0
    assert np.nanmax(found) <= 1 + 1e-12
    np.testing.assert_allclose(found + fig_2_13.coefficients(imager, 1 - code), np.where(np.isnan(found), np.nan, 1))


# Fig. 2.14


def test_matrices_have_the_sizes_and_structure_of_the_figure(all_records):
    matrices = common.chosen(all_records["fig-2-14"], part="matrix")
    assert [r.arrays["edge"].shape for r in matrices] == [(64, 224), (64, 64), (128, 128)]
    finer, limited, two = (r.arrays["edge"] for r in matrices)
    assert np.array_equal(limited, np.diag(np.diag(limited)))
    assert np.count_nonzero(finer, axis=0).max() == 2
    for shot in (0, 64):
        for band in (0, 64):
            block = two[shot : shot + 64, band : band + 64]
            assert np.array_equal(block, np.diag(np.diag(block)))
    # Complementary shots: together every voxel is seen once.
    np.testing.assert_allclose(np.diag(two[:64, :64]) + np.diag(two[64:, :64]), 1, rtol=1e-6)


def test_the_second_band_is_the_first_one_column_further(all_records):
    two = common.only(all_records["fig-2-14"], part="matrix", shots=2, bands=2)
    assert two.values["off_shifted"] < 1e-12
    blocks = two.arrays["edge"][:64].reshape(64, 2, 64)
    first, second = (np.diag(blocks[:, k]).reshape(8, 8) for k in (0, 1))
    code = two.arrays["code"][0].astype(float)
    place = np.arange(8) * 0.82
    for k, seen in enumerate((first, second)):
        edge = np.floor(place + k).astype(int)
        part = np.clip((edge + 1 - place - k) / 0.82, 0, 1)
        padded = np.pad(code, ((0, 0), (0, 2)))
        np.testing.assert_allclose(seen, padded[:, edge] * part + padded[:, edge + 1] * (1 - part), atol=1e-6)
    assert np.abs(first - second).max() > 0.5


@pytest.mark.parametrize(("ratio", "tolerance"), [(1, 1e-12), (2, 5e-3)])
def test_matrix_of_a_finely_resolved_scene_is_that_of_exact_shear(ratio, tolerance):
    """Where the edges of voxels are edges of fine pixels it is so exactly; else a fine pixel holds a mean of two voxels."""
    imager = camera(detector_shape=(3, 4), code_pitch=10.0 / ratio, mask_position=0.25, shear="exact")
    code = sg.codes.random(shots=2, shape=imager.code_shape, seed=0)
    bands = imager.resolution.bands
    found = fig_2_14.fine_matrix(imager, code, 8 * bands, bands)
    assert np.abs(found - as_matrix(imager.operator(code))).max() < tolerance
