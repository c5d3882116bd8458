"""The studies of the design and its codes, sections 3.3, 3.6.1 and 3.6.5, in their quick form."""

import json
import math

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.codes._board import Board
from shadowgram.experiments import studies
from shadowgram.experiments.source import generated
from shadowgram.experiments.studies import _common as common
from shadowgram.experiments.studies import fig_3_1, fig_3_7, fig_3_13, fig_3_14, table_3_1
from shadowgram.experiments.studies._plain import PlainBoard
from shadowgram.experiments.study import Claim, Record, spec_fields, task_key
from shadowgram.figures.style import style
from shadowgram.operators import as_matrix

# Axes of the figure (a map has a scale beside it), and what the claims find.
PANELS = {"fig-3-1": 6, "fig-3-7": 6, "table-3-1": 3, "fig-3-13": 13, "fig-3-14": 6}
AGREES = {
    "fig-3-1": [True, True, True, None],
    "fig-3-7": [True, True, True, True, None],
    "fig-3-13": [True, True, True, False, None],
    "fig-3-14": [True, True, True, True, True, None],
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


def camera(ny, nx, s):
    return sg.SSCSI(
        detector_shape=(ny, nx), detector_pitch=10.0, code_pitch=10.0, mask_position=s, wavelengths=(450.0, 650.0),
        shear="edge",
    )  # fmt: skip


def test_specs_are_different_tasks_of_the_study_that_is_asked_for():
    scene = generated()
    for name in PANELS:
        study = studies.load(name)
        assert study.name == name
        assert study.chapter == 3
        for quick in (True, False):
            keys = [task_key(study, spec, scene) for spec in study.specs(scene, quick)]
            assert len(set(keys)) == len(keys)


def test_figure_is_drawn_from_the_records(done):
    study, records = done
    with style():
        figure = study.figure(records)
        figure.canvas.draw()
    assert len(figure.axes) == PANELS[study.name]
    assert all(axes.has_data() for axes in figure.axes)


def test_claims_state_page_numbers_and_what_was_found(done):
    study, records = done
    claims = study.claims(records)
    for claim in claims:
        assert isinstance(claim, Claim)
        assert any(character.isdigit() for character in claim.found)
        if claim.page is None:  # a question of ours
            assert claim.agrees is None
            continue
        assert 44 <= claim.page <= 64
        assert type(claim.agrees) is bool
        assert claim.agrees or claim.why or study.name == "table-3-1"
    if study.name in AGREES:  # the other one is about time
        assert [claim.agrees for claim in claims] == AGREES[study.name]


def test_arrays_can_be_stored_and_are_small(done):
    _, records = done
    assert all(a.dtype.kind in "fu" and a.dtype.itemsize <= 4 for r in records for a in r.arrays.values())
    assert sum(a.nbytes for r in records for a in r.arrays.values()) < 2_000_000


@pytest.mark.parametrize("name", list(AGREES))
def test_a_task_gives_the_same_result_on_any_number_of_threads(name, all_records):
    study, scene = studies.load(name), generated()
    spec, record = study.specs(scene, True)[1], all_records[name][1]
    with sg.threads(3):
        again = recorded(spec, study.run(spec, scene))
    assert again.values == record.values
    for array_name, array in record.arrays.items():
        assert np.array_equal(again.arrays[array_name], array), array_name


# Algorithm 1 as printed


def cost_by_loops(imager, code, c1, repulsion):
    """Eq. (3.17) from the matrix H, with the repulsion over ordered pairs of open elements of a shot."""
    matrix = as_matrix(imager.operator(code))
    gram = matrix.T @ matrix
    diagonal = np.diag(gram)
    total = (gram**2).sum() - (diagonal**2).sum() + c1 * ((diagonal - 1) ** 2).sum()
    reach = imager.resolution.bands - 1
    for shot in code:
        opened = np.argwhere(shot)
        for y, x in opened:
            for yy, xx in opened:
                if 0 < max(abs(y - yy), abs(x - xx)) <= reach:
                    total += repulsion / math.hypot(y - yy, x - xx)
    return total


@pytest.mark.parametrize(("ny", "nx", "s", "shots"), [(5, 9, 0.3, 3), (6, 8, 0.25, 2), (4, 11, 0.46, 4)])
def test_plain_cost_is_that_of_the_matrix(ny, nx, s, shots):
    imager = camera(ny, nx, s)
    code = sg.codes.boolean(shots=shots, shape=(ny, nx), seed=nx)
    board = PlainBoard(code, mask_position=s, bands=imager.resolution.bands, c1=3.5, repulsion=0.7)
    assert np.array_equal(board.code, code)
    assert board.cost() == pytest.approx(cost_by_loops(imager, code, 3.5, 0.7), rel=1e-12)


def test_plain_opens_an_element_where_the_whole_cost_is_least():
    s, shots, (ny, nx) = 0.3, 3, (5, 9)
    imager = camera(ny, nx, s)
    code = sg.codes.boolean(shots=shots, shape=(ny, nx), seed=1)
    moved = 0
    for place in range(ny * nx):
        board = PlainBoard(code, mask_position=s, bands=imager.resolution.bands, c1=3.5, repulsion=0.7)
        board.sweep(np.array([place]), np.zeros(1, np.uint64))
        costs = []
        for shot in range(shots):
            tried = code.copy()
            tried[:, place // nx, place % nx] = np.arange(shots) == shot
            costs.append(cost_by_loops(imager, tried, 3.5, 0.7))
        assert board.cost() == pytest.approx(min(costs), rel=1e-12)
        moved += not np.array_equal(board.code, code)
    assert moved > 5


@pytest.mark.parametrize(
    ("ny", "nx", "s", "shots", "c1", "repulsion"),
    [(17, 17, 0.3, 3, 5.0, 1.0), (20, 32, 0.1875, 4, 20.0, 0.0), (9, 24, 0.093, 2, 0.0, 0.5), (31, 16, 0.5, 5, 70.0, 1.0)],
)  # fmt: skip
def test_plain_and_incremental_sweeps_are_the_same(ny, nx, s, shots, c1, repulsion):
    imager = camera(ny, nx, s)
    start = sg.codes.boolean(shots=shots, shape=(ny, nx), seed=3)
    plain = PlainBoard(start, mask_position=s, bands=imager.resolution.bands, c1=c1, repulsion=repulsion)
    ours = Board(imager.pair_table(), start, c1=c1, repulsion=repulsion, coupling=0.0, wrap=False)
    total = ours.cost()
    for number in range(3):
        rng = np.random.default_rng(number)
        order, state = rng.permutation(ny * nx), rng.integers(1 << 63, size=1, dtype=np.uint64)
        plain.sweep(order, state.copy())
        total += ours.sweep(order, state.copy())[0]
        assert np.array_equal(plain.code, ours.code)
        assert plain.cost() == pytest.approx(total, rel=1e-10)
    assert not np.array_equal(plain.code, start)


def test_affected_voxels_are_those_that_see_the_element():
    imager = camera(1, 12, 0.4)
    bands = imager.resolution.bands
    board = PlainBoard(
        sg.codes.boolean(shots=2, shape=(1, 12), seed=0), mask_position=0.4, bands=bands, c1=0.0, repulsion=0.0
    )
    first = np.floor(np.arange(12) * 0.6 + 1e-9).astype(int)
    seen = np.zeros(20, int)
    for m in range(12):
        for k in range(bands):
            seen[first[m] + k] += 1
            seen[first[m] + k + 1] += 1
    assert np.array_equal(board.affected(), seen[:12])


# Fig. 3.1


def test_matrix_is_in_the_order_of_the_source(all_records):
    record = all_records["fig-3-1"][0]
    n = record.spec["elements"]
    imager = camera(n, n, record.spec["mask_position"])
    code = sg.codes.boolean(shots=2, shape=(n, n), seed=record.spec["seed"])
    seen = imager.effective_code(code)
    expected = np.zeros((2 * n * n, 2 * n * n))
    for q in range(2):
        for k in range(2):
            for m in range(n):
                for y in range(n):
                    expected[q * n * n + m * n + y, k * n * n + m * n + y] = seen[q, k, y, m]
    np.testing.assert_allclose(record.arrays["matrix"], expected, atol=1e-7)
    assert [r.values["apart"] > 0 for r in all_records["fig-3-1"]] == [False, False, True]


def test_indices_of_the_source():
    places = [fig_3_1._place(i, 3) for i in range(1, 19)]
    assert places[:4] == [(0, 0, 0), (0, 1, 0), (0, 2, 0), (1, 0, 0)]
    assert places[9:] == [(m, n, 1) for m, n, _ in places[:9]]


# Fig. 3.7


def test_costs_begin_at_one_and_end_with_the_last_sweep(all_records):
    for record in all_records["fig-3-7"]:
        costs = record.arrays["costs"]
        assert (costs[:, 0] == 1).all()
        assert len(costs) == record.spec["executions"] == len(record.values["sweeps"])
        for line, sweeps, last in zip(costs, record.values["sweeps"], record.values["last"], strict=True):
            assert line[sweeps] == pytest.approx(last, rel=1e-6)
            change = -np.diff(line[: sweeps + 1])
            assert (change[:-1] > 1e-3 * (1 - 1e-3)).all()
            assert change[-1] <= 1e-3 * (1 + 1e-3)


def test_executions_are_different_and_c1_changes_them(all_records):
    records = all_records["fig-3-7"]
    for record in common.chosen(records, part=fig_3_7.MANY):
        assert len(set(record.values["last"])) == record.spec["executions"]
    small, large = (
        common.only(records, part=fig_3_7.FEW, mask_position=0.1875, c1=c1).values["sweeps"][0] for c1 in (1.0, 140.0)
    )
    assert small + 2 < large


# Table 3.1


def test_both_ways_find_the_same_code_at_every_size(all_records):
    assert len(all_records["table-3-1"]) == 7
    for record in all_records["table-3-1"]:
        assert record.values["same_code"]
        assert record.values["cost_error"] < 1e-10
        assert record.values["affected"] == pytest.approx(2 * record.spec["bands"])
        assert record.values["plain"] > record.values["cost"] > 0
        assert record.values["plain"] > record.values["tables"] > 0


def test_slopes_of_the_formula(all_records):
    stated = table_3_1._stated(all_records["table-3-1"])
    assert stated["N"] == pytest.approx(2)
    assert stated["L"] == pytest.approx(2)
    assert stated["Q"] == pytest.approx(np.polyfit(np.log([2, 4, 8]), np.log([3, 5, 9]), 1)[0])


# Figs. 3.13 and 3.14


def test_pairs_and_runs_of_boolean_codes_are_those_of_chance(all_records):
    for case in fig_3_13.CASES:
        record = fig_3_13._of(all_records["fig-3-13"], case, fig_3_13.BOOLEAN)
        # Pairs of a code: about size · p² of them, of which √ is the spread; two distances in 30 may be that far off.
        pairs = record.spec["shots"] * 128**2 / record.spec["shots"] ** 2
        assert np.abs(record.arrays["pairs"] - 1).max() < 4 / math.sqrt(pairs)
        assert record.values["clustering"] == pytest.approx(1, abs=0.03)
        np.testing.assert_allclose(record.arrays["runs"], record.arrays["chance"], atol=0.02)


def test_designed_codes_keep_apart_and_cluster_with_c1(all_records):
    for case in fig_3_13.CASES:
        large, small = (
            fig_3_13._of(all_records["fig-3-13"], case, fig_3_13.OPTIMISED, c1).values for c1 in (fig_3_13.SHOWN, fig_3_13.SMALL)
        )  # fmt: skip
        assert large["apart"] < 0.5
        assert small["near"] < 0.2 < 1.5 < large["near"]
        assert small["clustering"] < 0.95 < 1.3 < large["clustering"]


def test_gray_elements_are_counted_in_the_matrix():
    imager = camera(8, 16, 0.25)
    code = sg.codes.boolean(shots=2, shape=(8, 16), seed=0)
    matrix = as_matrix(imager.operator(code))
    gray = np.count_nonzero((matrix > 1e-9) & (matrix < 1 - 1e-9))
    found = fig_3_13._statistics(imager, code)
    assert found["gray"] == gray > 0
    assert found["gray_share"] == pytest.approx(gray / np.count_nonzero(matrix > 1e-9))


def test_pair_correlation_is_the_mean_over_all_pairs():
    code = sg.codes.random(shots=2, shape=(3, 9), seed=0, transmittance=0.4)
    found = fig_3_13.pair_correlation(code, 5)
    for d in range(1, 6):
        both = [code[q, y, x] * code[q, y, x + d] for q in range(2) for y in range(3) for x in range(9 - d)]
        assert found[d - 1] == pytest.approx(np.mean(both) / code.mean() ** 2)


def test_spectra_leave_the_constant_out_and_shares_add_up(all_records):
    for record in all_records["fig-3-14"]:
        for name in ("rows", "columns"):
            for blocks in fig_3_14.BLOCKS:
                shares = record.values[f"{name}_{blocks}"]
                assert shares["low"] + shares["middle"] + shares["high"] == pytest.approx(1)
                spectrum = record.arrays[f"{name}_{blocks}"]
                assert spectrum.shape == (64 // round(blocks**0.5),)
                assert spectrum.max() < 4  # the constant is tens of times as large


def test_colours_of_designed_codes(all_records):
    records = all_records["fig-3-14"]
    for c1 in (fig_3_14.DEFAULT, fig_3_14.SMALL, fig_3_14.LARGE):
        assert fig_3_14._colours(records, "columns", c1, 16) == ["blue"] * 3
    assert fig_3_14._colours(records, "rows", fig_3_14.SMALL, 16) == ["blue"] * 3
    assert fig_3_14._colours(records, "rows", fig_3_14.LARGE, 4) == ["green"] * 3
