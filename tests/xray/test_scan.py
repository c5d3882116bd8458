"""Scans: shots are what single simulations give, both routes agree, digits do not depend on where, and files come back."""

import dataclasses
import math
import os
import signal

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.experiments.dask_run import LocalWorkers
from shadowgram.experiments.journal import open_journal
from shadowgram.experiments.run import Threads
from shadowgram.experiments.xray_scan import run_plan
from shadowgram.scenes.readers.native import read_dataset, write_dataset
from shadowgram.xray._scan_blocks import BACKGROUND_FIRST, follow
from shadowgram.xray._scan_codes import coded, lit_margin
from shadowgram.xray._scan_linear import means
from shadowgram.xray.montecarlo.arrays import ORDERS
from shadowgram.xray.montecarlo.run import batch_vector
from shadowgram.xray.scan import direct_plan, direct_scan, linear_scan, pencil_plan, pencil_scan, with_transmittance
from shadowgram.xray.scan_file import read_pencil_map, read_scan, write_pencil_map, write_scan
from shadowgram.xray.scene import Box, Detector, Mask, Scene, Solid, Source, World, parse_scene, shipped_scene
from shadowgram.xray.simulation import compiled, prepare

STRIP = ("101100101", "010110010", "110010111", "001101001")
CELLS = np.array([list(map(int, row)) for row in STRIP], np.uint8)
SHOTS = 6


def mask(**changes):
    values = {
        "material": "tungsten", "pitch": 5, "depth": 2, "rows": 4, "columns": 9, "view": 4, "plate": (60, 40),
        "pattern": {"rows": STRIP},
    }  # fmt: skip
    return Mask(**values | changes)


def block(name, centre, size):
    return Solid(name=name, role="target", material="water", shape=Box(centre=centre, size=size))


def lead(name, centre, size):
    return Solid(name=name, role="shield", material="lead", shape=Box(centre=centre, size=size))


def scene(**changes):
    """A mask of 4 × 4 cells in view, water behind most of the upper right of it and a bit left of the middle, plates beside."""
    iodide = {"name": "sodium iodide", "density": 3.67}
    values = {
        "title": "Small",
        "shots": SHOTS,
        "exposure": 0.01,
        "cutoff": 10,
        "world": World(size=(500, 500, 500)),
        "source": Source(position=(0, 0, -150), half_angle=0.1, spectrum={"energy": 80}, activity=1e8),
        "mask": mask(),
        "solids": [block("large", (12, 12, 95), (24, 24, 30)), block("bit", (-8, -4, 85), (10, 16, 10))],
        "detectors": [
            Detector(name=name, centre=(x, 0, 40), size=(60, 120, 10), material=iodide, threshold=10)
            for name, x in (("left", -62), ("right", 62))
        ],
    }
    return Scene(**values | changes)


def same(a, b):
    for field in dataclasses.fields(a):
        one, other = getattr(a, field.name), getattr(b, field.name)
        if isinstance(one, np.ndarray):
            np.testing.assert_array_equal(one, other)
        else:
            assert one == other, field.name


# The direct route


@pytest.fixture(scope="module")
def plan():
    return direct_plan(scene(), histories=2_400_000, seed=7, background=True)


@pytest.fixture(scope="module")
def direct(plan):
    return plan.run(threads=2)


def test_a_shot_is_a_simulation_with_histories_of_its_own(direct):
    assert direct.photons_per_shot == 400_000
    assert direct.exposure == pytest.approx(0.004)
    run = sg.xray.simulate(scene(), histories=400_000, seed=7)
    assert direct.counts[0] == pytest.approx(float(run.tallies["all"].mean) * 400_000, abs=1e-6)
    assert direct.standard_error[0] == pytest.approx(float(run.tallies["all"].standard_error) * 400_000, rel=1e-9)
    setup = prepare(compiled(scene(), 4), variance_reduction=False)
    assert direct.counts[4] == batch_vector(setup, 7, 4 * 400_000, 5 * 400_000)[0]
    air = prepare(compiled(scene().without_targets(), 4), variance_reduction=False)
    first = BACKGROUND_FIRST + 4 * 400_000
    assert direct.background[4] == batch_vector(air, 7, first, first + 400_000)[0]


def test_counts_are_whole_and_scatter_as_they_say(direct):
    assert direct.noisy
    assert np.all(direct.counts == direct.counts.round())
    np.testing.assert_allclose(direct.standard_error, np.sqrt(direct.counts), rtol=0.3)
    assert sum(direct.orders.values()) == pytest.approx(direct.counts.mean())
    assert list(direct.orders) == list(ORDERS)
    np.testing.assert_array_equal(direct.signal, direct.counts - direct.background)
    assert direct.signal.min() > 5 * direct.signal_error.max()


def test_codes_are_what_is_in_view(direct):
    np.testing.assert_array_equal(direct.codes, [CELLS[:, shot : shot + 4] for shot in range(SHOTS)])


def test_same_digits_for_any_number_of_threads(plan, direct):
    same(plan.run(threads=1), direct)  # which had two
    same(plan.run(threads=8), direct)


def test_blocks_do_not_depend_on_how_many_shots_there_are(plan):
    fewer = direct_plan(scene(), shots=2, histories=800_000, seed=7)
    assert fewer.blocks[0] == plan.blocks[0]
    assert [len(block.steps) for block in plan.blocks] == [2] * 6
    spans = [(b.first_history, b.first_history + b.histories * len(b.steps)) for b in plan.blocks]
    assert all(a[1] <= b[0] for a, b in zip(sorted(spans), sorted(spans)[1:], strict=False))


def test_variance_reduction_gives_the_same_means_with_smaller_errors(direct):
    found = direct_scan(scene(), histories=600_000, seed=3, variance_reduction=True, background=True)
    assert not found.noisy
    # Errors per photon, of a quarter of the histories.
    assert np.all(found.standard_error / 1e5 < 1.1 * direct.standard_error / 4e5)
    for mean, error, other, noise in (
        (found.counts, found.standard_error, direct.counts, direct.standard_error),
        (found.background, found.background_error, direct.background, direct.background_error),
    ):
        z = (mean / 1e5 - other / 4e5) / np.hypot(error / 1e5, noise / 4e5)
        assert (z**2).sum() < 22.5  # chi-square of 6: once in a thousand


def run_in(folder, plan, executor, progress=lambda state: None):
    folder.mkdir(exist_ok=True)
    with open_journal(folder) as journal, executor:
        return run_plan(plan, journal, executor=executor, progress=progress)


def test_same_digits_from_processes_and_after_an_interrupt(plan, direct, tmp_path):
    workers = run_in(tmp_path / "workers", plan, LocalWorkers(2))
    same(workers.result, direct)
    assert workers.summary.computed == len(plan.blocks)

    pressed = []

    def interrupt(state):
        if state.done == 2 and not pressed:
            pressed.append(state)
            os.kill(os.getpid(), signal.SIGINT)

    first = run_in(tmp_path / "again", plan, Threads(1), interrupt)
    assert first.result is None
    assert first.summary.interrupted
    assert 2 <= first.summary.computed < len(plan.blocks)
    second = run_in(tmp_path / "again", plan, Threads(1))
    assert second.summary.reused == first.summary.computed
    assert second.summary.computed == len(plan.blocks) - first.summary.computed
    same(second.result, direct)


def test_another_seed_or_scene_is_not_in_the_journal(tmp_path):
    for seed, title, computed in ((1, "a", 1), (1, "a", 0), (2, "a", 1), (1, "b", 1)):
        plan = direct_plan(scene(title=title), shots=2, histories=2000, seed=seed)
        assert run_in(tmp_path, plan, Threads(1)).summary.computed == computed


# Codes


def test_a_strip_of_ones_own_is_as_good_as_the_scenes():
    other = scene(mask=mask(pattern={"transmittance": 0.5, "seed": 3}))
    want = direct_scan(scene(), shots=4, histories=40_000)
    found = direct_scan(other, CELLS * 255, shots=4, histories=40_000)
    np.testing.assert_array_equal(found.counts, want.counts)
    np.testing.assert_array_equal(found.codes, want.codes)
    assert len(direct_scan(other, CELLS[None], histories=12_000).counts) == SHOTS


def test_a_longer_strip_has_a_longer_plate():
    longer = coded(scene(), np.tile(CELLS, 2), None)
    assert longer.scene.mask.plate == (60 + 9 * 5, 40)
    assert len(longer.steps) == 15


def test_separate_codes_are_in_a_plate_that_stands_still():
    codes = np.zeros((3, 4, 4), np.uint8)
    codes[1, :2, 2:], codes[2] = 1, 1
    found = direct_scan(scene(), codes, histories=900_000, seed=5, variance_reduction=True)
    np.testing.assert_array_equal(found.codes, codes)
    closed, part, whole = found.counts
    assert closed < 0.3 * part
    still = scene(mask=mask(columns=4, view=None, pattern={"rows": ["0011", "0011", "0000", "0000"]}), shots=1)
    setup = prepare(compiled(still), variance_reduction=True)
    assert part == pytest.approx(batch_vector(setup, 5, 300_000, 600_000)[0], rel=1e-12)
    assert whole > 1.3 * part
    np.testing.assert_array_equal(direct_scan(scene(), codes, shots=2, histories=1000).codes, codes[:2])


def test_a_pattern_file_is_taken_into_the_scene(tmp_path):
    np.save(tmp_path / "mask.npy", CELLS)
    plan = direct_plan(scene(mask=mask(pattern={"file": str(tmp_path / "mask.npy")})), histories=12_000)
    (tmp_path / "mask.npy").unlink()
    np.testing.assert_array_equal(plan.run().counts, direct_scan(scene(), histories=12_000).counts)


def test_a_file_that_changes_meanwhile_is_noticed(tmp_path):
    file = tmp_path / "spectrum.csv"
    file.write_text("60, 1\n80, 2\n")
    source = Source(position=(0, 0, -150), half_angle=0.1, spectrum={"file": str(file)}, activity=1e8)
    plan = direct_plan(scene(source=source), histories=1200)
    file.write_text("60, 1\n80, 3\n")
    with pytest.raises(ValueError, match="not those that the scan began with"):
        plan.run()


@pytest.mark.parametrize(
    ("codes", "message"),
    [
        (np.ones((4, 3)), "4 rows and 4 columns"),
        (np.ones((5, 9)), "got 5 rows and 9 columns"),
        (np.ones((2, 4, 5)), "got 4 rows and 5 columns"),
        (np.linspace(0, 1, 16).reshape(4, 4), "two values"),
        (np.ones((2, 2, 4, 4)), "rows and columns"),
        (np.zeros((0, 4, 4)), "rows and columns"),
    ],
)
def test_codes_that_do_not_fit_are_refused(codes, message):
    for route in (direct_scan, linear_scan):
        with pytest.raises(ValueError, match=message):
            route(scene(), codes, histories=40_000)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"shots": 7}, "7 shots cannot be taken"),
        ({"shots": 0}, "shots must be a whole number"),
        ({"shots": True}, "shots must be a whole number"),
        ({"codes": np.ones((2, 4, 4)), "shots": 3}, "3 shots need as many codes, got 2"),
        ({"histories": 11}, "at least 12 histories"),
        ({"histories": 1.5e6}, "histories must be a whole number"),
        ({"seed": -1}, "seed must be a whole number"),
        ({"threads": 0.5, "histories": 100}, "threads must be a whole number"),
    ],
)
def test_numbers_that_cannot_be_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        direct_scan(scene(), **given)


def test_scenes_without_mask_or_detector_are_refused():
    for route in (direct_scan, linear_scan):
        with pytest.raises(ValueError, match="has none: add \\[mask\\]"):
            route(scene(mask=None, shots=1))
        with pytest.raises(ValueError, match="has none: add \\[\\[detectors\\]\\]"):
            route(scene(detectors=[]))


def test_with_transmittance_makes_another_random_strip():
    found = with_transmittance(scene(), 0.25)
    np.testing.assert_array_equal(
        found.mask.cells(), sg.codes.random(shots=1, shape=(4, 9), seed=0, transmittance=0.25)[0]
    )
    assert with_transmittance(shipped_scene("cxbi-ud"), 0.1) == shipped_scene("cxbi-ud")
    with pytest.raises(ValueError, match="transmittance"):
        with_transmittance(scene(), 1.5)


# The linear route


@pytest.mark.parametrize(
    ("columns", "rows", "codes"),
    [
        (1, -1, None),
        (-1, 1, None),
        (1, -1, np.stack([CELLS[:, :4], 1 - CELLS[:, :4], np.ones((4, 4)), CELLS[:, 5:], CELLS[::-1, 5:]])),
    ],
)
def test_both_routes_agree(columns, rows, codes):
    turned = scene(mask=mask(column_direction=columns, row_direction=rows))
    straight = direct_scan(turned, codes, histories=800_000, seed=2, variance_reduction=True, background=True)
    linear = linear_scan(turned, codes, histories=300_000, seed=3, noise=False, background=True)
    n, m = straight.photons_per_shot, linear.photons_per_shot
    assert (m, linear.exposure) == (1e6, 0.01)
    np.testing.assert_array_equal(linear.codes, straight.codes)
    for name, error in (("counts", "standard_error"), ("background", "background_error"), ("signal", "signal_error")):
        difference = getattr(straight, name) / n - getattr(linear, name) / m
        z = difference / np.hypot(getattr(straight, error) / n, getattr(linear, error) / m)
        assert np.abs(z).max() < 4
        # The shots share what was tallied, so the mean has no smaller error than each.
        assert abs(difference.mean()) < 3 * getattr(linear, error).mean() / m
    assert np.corrcoef(straight.signal, linear.signal)[0, 1] > 0.97
    assert linear.image.shape == (4, 4)
    assert linear.image.max() * linear.codes[0].sum() > linear.signal[0] > linear.image.min()


def test_the_image_lies_where_the_target_is():
    upright = linear_scan(scene(), shots=1, histories=20_000).image
    assert upright[:2, 2:].min() > 20 * upright[2:, 2:].max()  # up and right: the first rows, the last columns
    turned = linear_scan(scene(mask=mask(column_direction=-1, row_direction=1)), shots=1, histories=20_000).image
    np.testing.assert_allclose(turned[2:, :2], upright[1::-1, :1:-1], rtol=0.1)


def test_noise_is_poisson_and_repeatable():
    clean = linear_scan(scene(), histories=20_000, noise=False, seed=1, background=True)
    noisy = linear_scan(scene(), histories=20_000, seed=1, background=True)
    assert (clean.noisy, noisy.noisy) == (False, True)
    same(noisy, linear_scan(scene(), histories=20_000, seed=1, background=True, threads=1))
    for mean, drawn in ((clean.counts, noisy.counts), (clean.background, noisy.background)):
        assert np.all(drawn == drawn.round())
        assert 0 < ((drawn - mean) ** 2 / mean).sum() < 22.5  # chi-square of 6: once in a thousand
    np.testing.assert_allclose(noisy.standard_error**2, clean.standard_error**2 + clean.counts)


def test_errors_of_the_means_are_what_seeds_scatter_by():
    whole = coded(scene(), None, None)
    found = [means(whole, 8000, seed, None, lambda done, total: None) for seed in range(16)]
    scatter = np.sqrt(np.mean(np.std([one.counts for one in found], axis=0, ddof=1) ** 2))
    said = np.sqrt(np.mean([one.standard_error**2 for one in found]))
    assert 0.5 < scatter / said < 1.3  # besides, single shots differ from the fit in the same way for all seeds


def test_margin_is_what_the_cone_lights_or_the_plate_has():
    shipped = shipped_scene("cxbi-blocks")
    assert lit_margin(shipped) == math.ceil((151 * math.tan(shipped.source.half_angle) - 32) / 2)
    assert lit_margin(scene()) == 2  # 15.2 mm of light, 10 of view
    brighter = scene().source.model_copy(update={"half_angle": 0.2})
    assert lit_margin(scene(source=brighter)) == 4  # 30.6 mm of light, but no plate beyond 30
    assert lit_margin(scene(source=brighter, mask=mask(plate=(46, 40)))) == 2
    wide = scene(source=scene().source.model_copy(update={"half_angle": 2.0}))
    assert lit_margin(wide) == 4
    narrow = scene(source=scene().source.model_copy(update={"half_angle": 0.01}))
    assert lit_margin(narrow) == 0


def test_too_few_histories_for_a_response_are_refused():
    with pytest.raises(ValueError, match="needs at least 161 histories, got 100"):
        linear_scan(scene(), histories=100)
    assert len(linear_scan(scene(), histories=161).counts) == SHOTS


# Pencil beams


def test_pencil_beams_find_the_target_where_the_mask_has_it():
    corner = [block("corner", (30, 30, 100), (20, 20, 10))]
    for columns, rows, place in ((1, -1, (0, 3)), (-1, -1, (0, 0)), (1, 1, (2, 3)), (-1, 1, (2, 0))):
        turned = scene(mask=mask(column_direction=columns, row_direction=rows), solids=corner)
        found = pencil_scan(turned, shape=(3, 4), pitch=20, distance=60, photons=200)
        assert np.unravel_index(found.target.argmax(), (3, 4)) == place
        assert np.count_nonzero(found.target) == 1
    plain = pencil_scan(scene(mask=None, shots=1, solids=corner), shape=(3, 4), pitch=20, distance=60, photons=200)
    assert plain.target.argmax() == 3


def test_where_pencil_beams_begin():
    plan = pencil_plan(scene(), shape=(2, 3), pitch=4, distance=50, half_angle=0.01, photons=10)
    assert [step.position for block in plan.blocks for step in block.steps] == [
        (x, y, 30.0) for y in (2.0, -2.0) for x in (-4.0, 0.0, 4.0)
    ]
    assert [(block.first, block.first_history) for block in plan.blocks] == [(0, 0), (3, 30)]
    bare = parse_scene(plan.blocks[0].scene)
    assert (bare.mask, bare.source.half_angle, bare.solids) == (None, 0.01, scene().solids)
    back = scene(source=Source(position=(0, 0, 200), direction=(0, 0, -1), spectrum={"energy": 80}, activity=1))
    assert pencil_plan(back, shape=(1, 1), distance=30).blocks[0].steps[0].position == (0.0, 0.0, 140.0)


def test_pencil_beams_in_both_ways_and_on_all_executors(tmp_path):
    analog = pencil_plan(scene(), shape=(3, 3), pitch=8, distance=60, photons=4000, variance_reduction=False)
    noisy = analog.run()
    mean = pencil_scan(scene(), shape=(3, 3), pitch=8, distance=60, photons=4000, seed=9)
    assert (noisy.noisy, mean.noisy) == (True, False)
    assert np.all(noisy.counts == noisy.counts.round())
    z = (noisy.counts - mean.counts) / np.sqrt(mean.counts + mean.standard_error**2)
    assert (z**2).sum() < 27.9  # chi-square of 9: once in a thousand
    assert np.all(mean.target <= mean.counts)
    same(run_in(tmp_path / "threads", analog, Threads(2)).result, noisy)
    same(analog.run(threads=1), noisy)


@pytest.mark.parametrize(
    ("changes", "given", "message"),
    [
        ({"solids": []}, {}, "this scene has none: give a solid role"),
        ({"detectors": []}, {}, "add \\[\\[detectors\\]\\]"),
        ({}, {"shape": (0, 4)}, "rows and columns must be a whole number"),
        ({}, {"pitch": -1.0}, "pitch must be a positive length"),
        ({}, {"distance": math.nan}, "distance must be a positive length"),
        ({}, {"photons": 1}, "photons must be a whole number of at least 2"),
        ({}, {"half_angle": 4.0}, "half_angle"),
        ({}, {"shape": (1, 39), "distance": 40.0}, "begin in the detector 'left'"),
        ({}, {"shape": (1, 3), "distance": 40.0, "pitch": 62.0}, "begin in the detector 'left'"),
        ({}, {"distance": 900.0}, "outside the world"),
        (
            {"solids": [block("t", (0, 0, 80), (9, 9, 9)), lead("shield", (3, 0, 60), (3, 3, 3))]},
            {"shape": (1, 5), "pitch": 3.0, "distance": 15.5},
            "begin in the solid 'shield'",
        ),
        (
            {"source": Source(position=(0, 0, -150), direction=(1, 0, 1), spectrum={"energy": 80}, activity=1)},
            {},
            "along z",
        ),
    ],
)
def test_pencil_beams_that_cannot_be_are_refused(changes, given, message):
    with pytest.raises(ValueError, match=message):
        pencil_plan(scene(**changes), **given)


# Files


def scans():
    codes = coded(scene(), None, None).codes
    values = {"photons_per_shot": 5.0, "exposure": 0.25, "seed": 3, "scene": scene().toml(), "codes": codes}
    numbers = np.arange(SHOTS) / 7
    orders = dict(zip(ORDERS, np.arange(9.0).tolist(), strict=True))
    from shadowgram.xray.scan import Scan

    yield Scan(**values, counts=numbers, standard_error=numbers, route="direct", noisy=True, orders=orders)
    yield Scan(
        **values, counts=numbers, standard_error=numbers, background=-numbers, background_error=numbers, route="linear",
        noisy=False, image=np.ones((4, 4)),
    )  # fmt: skip


def test_scans_come_back_from_files(tmp_path, direct):
    for scan in (*scans(), direct):
        write_scan(scan, tmp_path / "y.nc", configuration="{}")
        same(read_scan(tmp_path / "y.nc"), scan)
        assert read_dataset(tmp_path / "y.nc").attrs["configuration"] == "{}"
    with pytest.raises(ValueError, match=r"ends in \.nc"):
        write_scan(direct, tmp_path / "y.txt")


def test_maps_come_back_from_files(tmp_path):
    found = pencil_scan(scene(), shape=(2, 3), pitch=8, distance=60, photons=100)
    write_pencil_map(found, tmp_path / "truth.nc")
    same(read_pencil_map(tmp_path / "truth.nc"), found)
    with pytest.raises(ValueError, match="is not a scan; make one with 'shadowgram xray scan'"):
        read_scan(tmp_path / "truth.nc")
    write_scan(next(scans()), tmp_path / "y.nc")
    with pytest.raises(ValueError, match="is not a scan with pencil beams; make one with 'shadowgram xray pencil'"):
        read_pencil_map(tmp_path / "y.nc")


def test_damaged_files_are_refused(tmp_path):
    write_scan(next(scans()), tmp_path / "y.nc")
    whole = (tmp_path / "y.nc").read_bytes()
    bad = tmp_path / "bad.nc"
    for size in (0, 7, 100, len(whole) // 2, len(whole) - 64, len(whole) - 1):
        bad.write_bytes(whole[:size])
        with pytest.raises(ValueError, match=str(bad)):
            read_scan(bad)
    for place in range(50, len(whole), len(whole) // 40):
        bad.write_bytes(whole[:place] + bytes([whole[place] ^ 16]) + whole[place + 1 :])
        with pytest.raises(ValueError, match=str(bad)):
            read_scan(bad)
    with pytest.raises(FileNotFoundError):
        read_scan(tmp_path / "none.nc")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda ds: ds.assign(counts=("shot", np.full(SHOTS, np.nan))), "counts of this scan must be 6 finite numbers"),
        (lambda ds: ds.assign(counts=("shot", np.arange(SHOTS))), "counts of this scan must be 6 finite numbers"),
        (lambda ds: ds.assign(counts=("other", np.ones(5))), "must be 6 finite numbers"),
        (lambda ds: ds.assign(codes=ds.codes + np.uint8(1)), "codes of a scan are 0 and 1"),
        (lambda ds: ds.assign(codes=ds.codes[0].drop_vars([])), "codes of a scan are 0 and 1"),
        (lambda ds: ds.assign(background=ds.counts), "a background has a standard error"),
        (lambda ds: ds.assign(image=("other", np.ones(3))), "image of this scan must be 4 × 4"),
        (lambda ds: ds.assign(orders=("other", np.ones(3))), "its orders have no number for each name"),
        (lambda ds: ds.assign_attrs(order_names=3), "its order names is not a text"),
        (lambda ds: ds.assign_attrs(route="sideways"), "route of a scan is direct or linear"),
        (lambda ds: ds.assign_attrs(exposure="long"), "its exposure is not a number"),
        (lambda ds: ds.assign_attrs(photons_per_shot=-1.0), "must be positive"),
        (lambda ds: ds.assign_attrs(scene="title = 3"), "title should"),
        (lambda ds: ds.assign_attrs(scene="[[["), "it is not TOML"),
        (lambda ds: ds.drop_vars("codes"), "is not a scan"),
        (lambda ds: ds.assign_attrs(kind="measurement"), "is not a scan"),
    ],
)
def test_whole_files_with_wrong_contents_are_refused(tmp_path, spoil, message):
    path = tmp_path / "y.nc"
    write_scan(next(scans()), path)
    write_dataset(spoil(read_dataset(path)), path)
    with pytest.raises(ValueError, match=message) as caught:
        read_scan(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda ds: ds.assign(target=("y", np.ones(2))), "target of this map must be"),
        (lambda ds: ds.assign(counts=ds.counts * np.inf), "counts of this map must be"),
        (lambda ds: ds.assign_attrs(pitch=0.0), "must be positive"),
        (lambda ds: ds.assign_attrs(photons=math.inf), "its photons is not a number"),
    ],
)
def test_maps_with_wrong_contents_are_refused(tmp_path, spoil, message):
    path = tmp_path / "truth.nc"
    write_pencil_map(pencil_scan(scene(), shape=(2, 3), pitch=8, distance=60, photons=100), path)
    write_dataset(spoil(read_dataset(path)), path)
    with pytest.raises(ValueError, match=message):
        read_pencil_map(path)


def test_signal_needs_a_background():
    with pytest.raises(ValueError, match="has no background"):
        _ = next(scans()).signal


def test_a_block_is_a_function_of_its_description():
    (only,) = direct_plan(scene(), shots=3, histories=6000, seed=4).blocks
    a, b = follow(only), follow(dataclasses.replace(only))
    np.testing.assert_array_equal(a.orders, b.orders)
    assert a.counts.sum() > 0
    assert not np.array_equal(a.counts, follow(dataclasses.replace(only, seed=5)).counts)
