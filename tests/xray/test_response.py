"""The linear route to a scan against direct simulations of the same masks, and the polynomial against plain loops.

Seeded. Numbers of two simulations must agree within 4 combined standard deviations, most of them of the direct one: about
1e-4 of false alarms for each of 25.
"""

import dataclasses
import math

import numpy as np
import pytest

from shadowgram.xray import scene as sc
from shadowgram.xray._compile import compile_scene
from shadowgram.xray.montecarlo import arrays
from shadowgram.xray.montecarlo._jit import SOURCES, entry
from shadowgram.xray.montecarlo._response_kernels import aim_at_cell, lengths_in_cells
from shadowgram.xray.montecarlo._walk_kernels import collect, cross, piece
from shadowgram.xray.montecarlo.arrays import ENERGY, FROM_TARGET, LEAKY, RECORD, WEIGHT, X
from shadowgram.xray.montecarlo.response import GROUPS, SETS, SIDES, Response, mask_response
from shadowgram.xray.montecarlo.rng import begin
from shadowgram.xray.montecarlo.run import run_setup
from shadowgram.xray.simulation import prepare

MASK = 1
"""The mask's index among the solids."""
ROWS = COLUMNS = 4
SEEDS = 6


def _entries(sources):
    @entry
    def through_cell(geometry, source, solid, row, column, stream, photons, lengths, sides):
        """Photons aimed at a cell, their lengths in its four cells, the side, and whether they stay in them.

        It is −1 for those outside of the cone.
        """
        for i in range(photons.shape[0] if sources else 0):
            begin(stream, 5, i)
            sides[i, 1] = -1
            if aim_at_cell(geometry, source, solid, row, column, i, photons[i], stream):
                side, inside = lengths_in_cells(geometry, solid, row, column, photons[i], lengths[i])
                sides[i, 0], sides[i, 1] = side, inside

    @entry
    def walked(geometry, desk, rays, out):
        """Add the lengths of every ray in (solid, material)."""
        for i in range(rays.shape[0] if sources else 0):
            count, end = collect(geometry, desk, rays[i], 0)
            t = 0.0
            while True:
                solid, material, stop, which = piece(geometry, desk, rays[i], count, end, t)
                out[i, solid, material] += stop - t
                if which == -1:
                    break
                if which >= 0:
                    cross(geometry, desk, rays[i], which, stop)
                t = stop

    return through_cell, walked


_through_cell, _walked = _entries(SOURCES)


def scene(pattern="1111 1111 1111 1111", *, energy=70.0, across=0.0, turn=1, shots=1, depth=4.0, extra=(), **changes):
    """A thick plate of 4 × 4 cells in vacuum, the source 100 mm before it and `across` beside its axis, water behind.

    The crystals look past the plate. With `turn` −1 all is mirrored along z.
    """
    rows = tuple(pattern.split())
    values = {
        "world": sc.World(size=(800, 800, 800), material="vacuum"),
        "source": sc.Source(
            position=(across, 0, -100 * turn),
            direction=(-across, 0, 100 * turn),
            half_angle=0.24,
            spectrum={"energies": (energy, 1.3 * energy), "weights": (2, 1)},
            activity=1,
        ),
        "mask": sc.Mask(
            material="tungsten",
            pitch=5,
            depth=depth,
            rows=len(rows),
            columns=len(rows[0]),
            view=COLUMNS,
            plate=(120, 120),
            pattern={"rows": rows},
        ),
        "solids": (
            sc.Solid(name="slab", role="target", material="water", shape=sc.Box(centre=(0, 0, 90 * turn), size=(150, 150, 20))),
            sc.Solid(name="bar", role="target", material="aluminum", shape=sc.Box(centre=(15, 10, 75 * turn), size=(20, 30, 10))),
            *extra,
        ),
        "detectors": tuple(
            sc.Detector(name=name, centre=(x, y, -20 * turn), size=(100, 100, 20), material="sodium iodide")
            for name, x, y in (("right", 180, 0), ("left", -180, 30))
        ),
        "shots": shots,
    }  # fmt: skip
    return sc.Scene(**values | changes)


def setup_of(described, shot=0):
    return prepare(compile_scene(described, shot), variance_reduction=True)


def direct(setup, histories=300_000, seed=9):
    """Counts of photons that met the target and did not collide in the plate, and the standard error."""
    run = run_setup(setup, histories=histories, seed=seed)
    orders = run.tallies["all/orders"]
    met = [*range(FROM_TARGET), LEAKY]
    # Orders are counted apart, so their errors hardly depend on each other.
    return float(orders.mean[met].sum()), math.sqrt((orders.standard_error[met] ** 2).sum())


def responses(setup, per_cell=1500, margin=2, columns=COLUMNS, first=0):
    """The same response by several seeds, whose spread is its error."""
    return [
        mask_response(
            setup,
            solid=MASK,
            first_column=first,
            columns=columns,
            margin=margin,
            histories_per_cell=per_cell,
            seed=seed,
        )
        for seed in range(SEEDS)
    ]


def mean_and_error(values):
    values = np.array(values)
    return values.mean(axis=0), values.std(axis=0, ddof=1) / math.sqrt(len(values))


def sigma(many, one):
    """How far apart, in combined standard deviations; with 6 seeds an error of their mean is itself 30 % uncertain."""
    mean, error = many
    return (mean - one[0]) / math.hypot(float(error), one[1])


def codes(count, seed):
    return np.random.default_rng(seed).integers(0, 2, (count, ROWS, COLUMNS)).astype(float)


def rows_of(code):
    return " ".join("".join(str(int(x)) for x in row) for row in code)


# ---- the polynomial in plain loops -------------------------------------------------------------------------------------------


def evaluated(response, code):
    """Counts (group) of one code (row, column) with the margin's columns, cells beyond it closed."""
    groups, _, _, rows, slots = response.terms.shape
    total = np.zeros(groups)

    def cell(i, j):
        return code[i, j] if 0 <= i < rows and 0 <= j < code.shape[1] else 0.0

    for side in range(SIDES):
        across = 1 if side in (1, 3) else -1
        along = 1 if side in (2, 3) else -1
        for subset in range(SETS):
            for i in range(rows):
                for j in range(slots):
                    product = 1.0
                    if subset & 1:
                        product *= cell(i, j)
                    if subset & 2:
                        product *= cell(i, j + across)
                    if subset & 4:
                        product *= cell(i + along, j)
                    if subset & 8:
                        product *= cell(i + along, j + across)
                    for group in range(groups):
                        total[group] += response.terms[group, side, subset, i, j] * product
    return total


@pytest.fixture(scope="module")
def made_up():
    rng = np.random.default_rng(1)
    rows, columns, margin = 3, 5, 2
    shape = (GROUPS, SIDES, SETS, rows, columns + 2 * margin)
    terms = rng.normal(size=shape) * (rng.random(shape) < 0.7)
    terms[:, 2, 7] = 0
    together = terms.sum(axis=(1, 2))
    return Response(
        terms=terms, open=together, standard_error=np.abs(together), columns=columns, margin=margin, histories=1
    )


def test_shots_of_codes_are_the_polynomial(made_up):
    shots = np.random.default_rng(2).integers(0, 2, (6, 3, 5))
    found = made_up.shots(shots)
    assert found.shape == (GROUPS, 6)
    for i, code in enumerate(shots):
        padded = np.pad(code.astype(float), ((0, 0), (2, 2)))
        np.testing.assert_allclose(found[:, i], evaluated(made_up, padded), rtol=1e-12, atol=1e-12)


def test_shots_of_a_strip_are_the_polynomial(made_up):
    strip = np.random.default_rng(3).integers(0, 2, (3, 11)).astype(float)
    found = made_up.shots(strip)
    assert found.shape == (GROUPS, 7)
    padded = np.pad(strip, ((0, 0), (3, 3)))
    for shot in range(7):
        # Beside the view the strip goes on: one column more than the margin can be a neighbour.
        window = padded[:, shot : shot + 5 + 2 * 3]
        grown = dataclasses.replace(made_up, terms=np.pad(made_up.terms, ((0, 0), (0, 0), (0, 0), (0, 0), (1, 1))))
        np.testing.assert_allclose(found[:, shot], evaluated(grown, window), rtol=1e-12, atol=1e-12)


def test_the_image_is_the_view_of_the_target(made_up):
    np.testing.assert_array_equal(made_up.image, made_up.open[0, :, 2:7])


@pytest.mark.parametrize(
    ("shape", "match"),
    [
        ((2, 3, 4), r"codes must be \(shot, 3, 5\) or a strip \(3, at least 5\), got \(2, 3, 4\)"),
        ((2, 3, 6), "got"),
        ((4, 5), "got"),
        ((3, 4), "got"),
        ((5,), "got"),
    ],
)
def test_codes_of_another_shape_are_refused(made_up, shape, match):
    with pytest.raises(ValueError, match=match):
        made_up.shots(np.zeros(shape))


@pytest.mark.parametrize("value", [0.5, 2, -1, math.nan])
def test_codes_that_are_gray_are_refused(made_up, value):
    code = np.zeros((1, 3, 5))
    code[0, 1, 2] = value
    with pytest.raises(ValueError, match=r"a mask cell is 0 \(closed\) or 1 \(open\)"):
        made_up.shots(code)


# ---- one photon through the plate --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("turn", [1, -1])
@pytest.mark.parametrize(("columns", "rows"), [(1, -1), (-1, 1)])
@pytest.mark.parametrize("across", [0.0, -30.0])
def test_lengths_in_cells_are_those_of_a_walk_through_the_plate(turn, columns, rows, across):
    """With any code, the plate's material on the way is that of the closed ones among the four cells."""
    code = codes(1, 4)[0]
    described = scene(rows_of(code), turn=turn, across=across, depth=4.0)
    turned = described.mask.model_copy(update={"column_direction": columns, "row_direction": rows})
    compiled = compile_scene(described.model_copy(update={"mask": turned}))
    around = np.pad(code, 1)
    crossed = np.zeros(4)
    for row in range(ROWS):
        for column in range(COLUMNS):
            photons, lengths, sides = np.zeros((200, RECORD)), np.zeros((200, 4)), np.zeros((200, 2), np.int64)
            _through_cell(
                compiled.geometry, compiled.source, MASK, row, column, np.zeros(2, np.uint64), photons, lengths, sides
            )
            assert (sides[:, 1] == 1).all()
            out = np.zeros((200, len(compiled.solid_names), len(compiled.materials)))
            _walked(compiled.geometry, arrays.desk(len(compiled.solid_names), 2), photons, out)
            np.testing.assert_allclose(lengths.sum(axis=1), out[:, MASK].sum(axis=1), rtol=1e-12)
            step = np.where(sides[:, 0] & 1, 1, -1), np.where(sides[:, 0] & 2, 1, -1)
            of = np.stack(
                [
                    np.full(200, around[row + 1, column + 1]),
                    around[row + 1, column + 1 + step[0]],
                    around[row + 1 + step[1], column + 1],
                    around[row + 1 + step[1], column + 1 + step[0]],
                ],
                axis=1,
            )
            np.testing.assert_allclose((lengths * (1 - of)).sum(axis=1), out[:, MASK, 1], atol=1e-6)
            crossed += (lengths > 1e-3).sum(axis=0)
    assert (crossed > 20).all(), "all four cells are met"


def test_weights_of_aimed_photons_are_shares_of_the_cone():
    """Over the cells of a mask that holds the whole cone they add up to 1; within 4 standard deviations."""
    described = scene()
    wide = described.mask.model_copy(
        update={"rows": 20, "columns": 20, "view": 20, "pattern": sc.Pattern(rows=("1" * 20,) * 20)}
    )
    compiled = compile_scene(described.model_copy(update={"mask": wide}))
    total = variance = 0.0
    for row in range(20):
        for column in range(20):
            photons, lengths, sides = np.zeros((100, RECORD)), np.zeros((100, 4)), np.zeros((100, 2), np.int64)
            _through_cell(
                compiled.geometry, compiled.source, MASK, row, column, np.zeros(2, np.uint64), photons, lengths, sides
            )
            weight = np.where(sides[:, 1] >= 0, photons[:, WEIGHT], 0.0)
            total += weight.mean()
            variance += weight.var(ddof=1) / 100
            assert (photons[:, X + 2] == -100).all()
            energies = photons[sides[:, 1] >= 0, ENERGY]
            if len(energies) == 100:
                # Spread evenly over the spectrum: 2 of 3 have 70 keV, and of 100 not one more or less than can be.
                assert abs((energies == 70).sum() - 200 / 3) < 3
    assert total == pytest.approx(1, abs=4 * math.sqrt(variance))
    assert math.sqrt(variance) < 5e-3


# ---- against direct simulations ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=[0.0, -30.0], ids=["straight", "oblique"])
def many(request):
    return request.param, responses(setup_of(scene(across=request.param)))


def check(described, patterns, found, seed):
    """Shots of codes against direct simulations, each with a seed of its own."""
    mean, error = mean_and_error([one.shots(np.array(patterns))[0] for one in found])
    for i, code in enumerate(patterns):
        expected = direct(setup_of(described(rows_of(code))), seed=seed + i)
        assert expected[1] < 0.015 * expected[0]
        assert abs(sigma((mean[i], error[i]), expected)) < 4


def test_random_codes_give_what_direct_simulations_give(many):
    across, found = many
    patterns = [*codes(5, 6), np.eye(ROWS), np.ones((ROWS, COLUMNS))]
    check(lambda pattern: scene(pattern, across=across), patterns, found, 10)


def test_a_closed_mask_gives_nothing(many):
    """70 and 91 keV: e⁻¹⁸ at most."""
    across, found = many
    assert found[0].shots(np.zeros((1, ROWS, COLUMNS)))[0, 0] < 1e-4 * found[0].image.sum()
    assert direct(setup_of(scene(" ".join(["0000"] * 4), across=across)))[0] == 0


def test_a_sliding_strip_gives_what_direct_simulations_give():
    strip = np.random.default_rng(7).integers(0, 2, (ROWS, 7)).astype(float)
    described = scene(rows_of(strip), shots=4, across=-15.0)
    mean, error = mean_and_error([one.shots(strip)[0] for one in responses(setup_of(described), margin=3)])
    for shot in range(4):
        expected = direct(setup_of(described, shot), seed=20 + shot)
        assert abs(sigma((mean[shot], error[shot]), expected)) < 4


def test_hard_light_leaks_through_closed_cells():
    """At 250 and 325 keV much goes through the plate and its corners. All that the cone lights is within rows and margin."""
    patterns = [np.random.default_rng(8).integers(0, 2, (10, COLUMNS)).astype(float), np.zeros((10, COLUMNS))]

    def described(pattern):
        return scene(pattern, energy=250.0)

    found = responses(setup_of(described(rows_of(patterns[0]))), margin=3)
    check(described, patterns, found, 30)
    coded, closed = found[0].shots(np.array(patterns))[0]
    assert closed > 0.1 * coded


def test_the_open_map_is_what_single_cells_give():
    """A narrow cone through the middle of a cell of an open mask."""
    described = scene()
    for row, column in ((1, 1), (2, 1)):
        x, y = 5 * (column - 1.5), -5 * (row - 1.5)
        narrow = sc.Source(
            position=(x, y, -100), half_angle=0.02, spectrum={"energies": (70.0, 91.0), "weights": (2, 1)}, activity=1
        )
        setup = setup_of(described.model_copy(update={"source": narrow}))
        found = responses(setup, per_cell=10_000)
        maps = np.array([one.open[0] for one in found])
        elsewhere = np.ones(maps.shape[1:], bool)
        elsewhere[row, column + 2] = False
        assert (maps[:, elsewhere] == 0).all()
        np.testing.assert_array_equal(found[0].image, maps[0][:, 2:6])
        assert abs(sigma(mean_and_error(maps[:, row, column + 2]), direct(setup))) < 4


def test_the_open_map_has_true_errors(many):
    _, found = many
    maps = np.array([one.image for one in found])
    reported = np.array([one.standard_error[0, :, 2 : 2 + COLUMNS] for one in found])
    assert maps.shape == (SEEDS, ROWS, COLUMNS)
    ratio = (maps.var(axis=0, ddof=1) / (reported**2).mean(axis=0)).mean()
    # 16 cells with 5 degrees of freedom each, 4 standard deviations; spreading the energies evenly makes true errors smaller.
    assert 0.3 < ratio < 1 + 4 * math.sqrt(2 / 80)


def test_all_cells_open_are_an_open_mask(many):
    """Shots of ones have the frame closed beside them; the sum of the open map has it open."""
    _, found = many
    for one in found:
        ones = one.shots(np.ones((1, ROWS, COLUMNS)))[0, 0]
        assert ones < one.open[0].sum()


def test_light_along_minus_z_gives_the_mirrored_map():
    """The same scanner mirrored along z: the same counts, from other random numbers only in the rounding."""
    towards = mask_response(
        setup_of(scene()), solid=MASK, first_column=0, columns=COLUMNS, margin=2, histories_per_cell=4000, seed=1
    )
    away = mask_response(
        setup_of(scene(turn=-1)), solid=MASK, first_column=0, columns=COLUMNS, margin=2, histories_per_cell=4000, seed=2
    )
    error = np.hypot(towards.standard_error[0], away.standard_error[0])
    apart = (towards.open[0] - away.open[0])[:, 2:6] / error[:, 2:6]
    assert (away.image > 0).all()
    assert (np.abs(apart) < 4).all()


# ---- around it ---------------------------------------------------------------------------------------------------------------


def one_response(described, **changes):
    arguments = {
        "solid": MASK,
        "first_column": 0,
        "columns": COLUMNS,
        "margin": 2,
        "histories_per_cell": 300,
        "seed": 1,
    }
    return mask_response(setup_of(described), **arguments | changes)


def test_responses_are_the_same_for_any_number_of_threads_and_any_pattern():
    calls = []
    one = one_response(scene(), threads=1, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(i + 1, len(calls)) for i in range(len(calls))]
    for other in (one_response(scene(), threads=2), one_response(scene("1000 0000 0001 1010"), threads=3)):
        np.testing.assert_array_equal(one.terms, other.terms)
        np.testing.assert_array_equal(one.standard_error, other.standard_error)
    assert one.terms.shape == (GROUPS, SIDES, SETS, ROWS, COLUMNS + 4)
    assert one.histories == 300 // 4 * (16 * 4 + 16)
    assert not np.array_equal(one.terms, one_response(scene(), seed=2).terms)


def test_a_plate_too_thick_is_refused():
    with pytest.raises(
        ValueError, match="crosses more than one cell wall across or along the mask: the plate is too thick"
    ):
        one_response(scene(depth=40.0))
    with pytest.raises(ValueError, match="or the light too oblique; run the scan directly"):
        one_response(scene(depth=8.0, across=-60.0))


def test_a_view_beyond_the_plate_is_refused():
    assert one_response(scene(), margin=10).margin == 10
    with pytest.raises(
        ValueError, match="x from -65 to 65 mm, reaches beyond the plate, -60 to 60 mm; make the margin smaller"
    ):
        one_response(scene(), margin=11)


def test_a_pencil_is_refused():
    pencil = sc.Source(position=(1, 1, -100), spectrum={"energy": 60}, activity=1)
    with pytest.raises(ValueError, match="this one is a pencil"):
        one_response(scene(source=pencil))
