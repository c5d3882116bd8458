"""How designs begin, stop, go on and repeat, how good they are, and what is refused."""

import math

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.codes._design import Weights, _board, default_c1, design, exchange, optimised


def camera(ny, nx, s, ratio=1, **changes):
    geometry = {"detector_shape": (ny, nx), "detector_pitch": 10.0 * ratio, "code_pitch": 10.0, "mask_position": s}
    return sg.SSCSI(wavelengths=(450.0, 650.0), **(geometry | changes))


def cassi(kind, *shape, **changes):
    return kind(cube_shape=shape, wavelengths=(450.0, 650.0), **changes)


PLAIN = camera(8, 16, 0.25)
FILTERED = cassi(sg.ColoredCASSI, 3, 2, 6)
BOOLEAN = sg.codes.boolean(shots=3, shape=(8, 16), seed=0)


def name(imager):
    return f"{type(imager).__name__}-{'x'.join(map(str, imager.code_shape))}-{imager.shear}"


def start_of(imager, shots=3, seed=0):
    return sg.codes.boolean(shots=shots, shape=imager.code_shape, seed=seed)


def cost_of(imager, code, weights):
    return _board(imager, code, weights, False).cost()


@pytest.mark.parametrize("sweep", range(5))
def test_the_last_sweep_is_the_first_that_changes_little(sweep):
    """The tolerance is a share of the cost of the start: a little above what one sweep changed, that sweep is the last."""
    imager = camera(24, 24, 0.25)
    whole = design(imager, shots=3, seed=0, tolerance=0, max_sweeps=6)
    changes = np.abs(np.diff(whole.costs))
    assert (np.diff(changes) < 0).all()
    for share, sweeps in [(1.02, sweep + 1), (0.98, sweep + 2)]:
        tolerance = share * changes[sweep] / whole.costs[0]
        found = design(imager, shots=3, seed=0, tolerance=tolerance)
        assert found.converged
        assert found.sweeps == len(found.moves) == len(found.costs) - 1 == sweeps
        assert found.costs == whole.costs[: sweeps + 1]


def test_costs_never_rise():
    found = design(camera(24, 24, 0.25), shots=3, seed=0)
    assert (np.diff(found.costs) <= 0).all()
    assert abs(found.costs[-1] - found.costs[-2]) <= 1e-3 * found.costs[0]
    assert found.costs[-1] < 0.9 * found.costs[0]


def test_history():
    imager, told = camera(12, 12, 0.25), []
    found = design(imager, shots=3, seed=4, max_sweeps=3, tolerance=0, callback=told.append)
    assert (found.converged, found.sweeps, found.seed, found.tile) == (False, 3, 4, None)
    assert found.weights == Weights(c1=default_c1(3, 3), repulsion=1.0, coupling=0.0)
    assert [one.costs for one in told] == [found.costs[:2], found.costs[:3], found.costs]
    assert [one.moves for one in told] == [found.moves[:1], found.moves[:2], found.moves]
    for one in told:
        assert one.costs[-1] == pytest.approx(cost_of(imager, one.code, one.weights), rel=1e-9)
    assert found.costs[0] == pytest.approx(cost_of(imager, start_of(imager, seed=4), found.weights), rel=1e-9)


def test_seeds_and_starts():
    imager = camera(12, 16, 0.25)
    one, again, other = (design(imager, shots=3, seed=seed) for seed in (0, 0, 1))
    assert np.array_equal(one.code, again.code)
    assert one.costs == again.costs
    assert not np.array_equal(one.code, other.code)
    given = design(imager, shots=3, seed=0, start=start_of(imager, seed=0))
    assert np.array_equal(given.code, one.code)
    elsewhere = design(imager, shots=3, seed=0, start=start_of(imager, seed=7).astype(float))
    assert not np.array_equal(elsewhere.code, one.code)
    assert elsewhere.costs[0] == pytest.approx(cost_of(imager, start_of(imager, seed=7), one.weights), rel=1e-9)


@pytest.mark.parametrize("imager", [camera(16, 16, 0.25), cassi(sg.ColoredCASSI, 4, 6, 8)], ids=name)
def test_optimised_is_the_best_of_its_starts_for_any_number_of_threads(imager):
    designs = [design(imager, shots=3, seed=seed) for seed in (5, 6, 7)]
    best = min(designs, key=lambda one: one.costs[-1])
    assert len({one.costs[-1] for one in designs}) == 3
    for count in (1, 2):
        with sg.threads(count):
            assert np.array_equal(optimised(imager, shots=3, seed=5, starts=3), best.code)
    assert np.array_equal(optimised(imager, shots=3, seed=5), designs[0].code)


@pytest.mark.parametrize(
    ("imager", "choices"),
    [
        (camera(16, 16, 0.25), {}),
        (camera(16, 16, 0.25), {"transmittance": 0.5}),
        (camera(32, 32, 0.125), {"tile": (16, 16)}),
        (cassi(sg.ColoredCASSI, 4, 8, 8), {}),
        # Few bands and the edge's shear: many shots cost the same, and what rounding leaves must not choose among them.
        (camera(16, 16, 0.25, shear="edge"), {"coupling": 1.0, "repulsion": 0.0, "tolerance": 0.0, "max_sweeps": 8}),
    ],
    ids=["whole", "budget", "tile", "colored", "coupling"],
)
def test_a_design_goes_on_as_if_it_had_never_stopped(imager, choices):
    choices = {"shots": 4, "seed": 1, "tolerance": 1e-4} | choices
    whole = design(imager, **choices)
    assert whole.sweeps > 3
    for sweeps in (0, 1, 3):
        part = design(imager, **(choices | {"max_sweeps": sweeps}))
        assert part.sweeps == sweeps
        assert not part.converged
        rest = design(imager, resume=part, **choices)
        assert np.array_equal(rest.code, whole.code)
        assert (rest.costs, rest.moves, rest.converged) == (whole.costs, whole.moves, whole.converged)
    assert np.array_equal(design(imager, resume=whole, **choices).code, whole.code)


@pytest.mark.parametrize(
    "changes",
    [
        {"shots": 2},
        {"seed": 1},
        {"c1": 5.0},
        {"repulsion": 2.0},
        {"coupling": 1.0},
        {"tile": (8, 12)},
    ],
    ids=str,
)
def test_a_design_goes_on_with_its_own_parameters_only(changes):
    imager, parameters = camera(8, 16, 0.25), {"shots": 3, "seed": 0, "c1": 4.0}
    found = design(imager, **parameters, max_sweeps=1)
    with pytest.raises(ValueError, match="goes on with the parameters it was made with"):
        design(imager, resume=found, **(parameters | changes))
    with pytest.raises(ValueError, match=r"must have the shape \(shot, 8, 12\)"):
        design(camera(8, 12, 0.25), resume=found, **parameters)
    with pytest.raises(ValueError, match="made for another imager"):
        design(camera(8, 16, 0.2), resume=found, **parameters)
    with pytest.raises(ValueError, match="goes on with the parameters it was made with"):
        design(imager, resume=found, transmittance=0.6, **parameters)
    with pytest.raises(ValueError, match="a start is complementary and new"):
        design(imager, resume=found, start=found.code, **parameters)
    with pytest.raises(TypeError, match="resume takes a Design"):
        design(imager, resume=3, **parameters)  # pyright: ignore[reportArgumentType]


def test_a_design_measures_better_than_a_boolean_code():
    imager = camera(32, 32, 0.25)
    cube = sg.scenes.chart(size=32, bands=8, seed=0).values
    solver = sg.GPSR(tau=1e-3, max_iter=100)
    for seed in range(3):
        found = design(imager, shots=3, seed=seed)
        assert found.costs[-1] < 0.8 * found.costs[0]
        quality = []
        for code in (sg.codes.boolean(shots=3, shape=imager.code_shape, seed=seed), found.code):
            H = imager.operator(code)
            snapshots = sg.noise.awgn(H.forward(cube), snr_db=30, seed=seed)
            quality.append(sg.metrics.psnr(sg.solve(solver, H, snapshots).x, cube, peak=1.0))
        assert quality[1] > quality[0] + 1.5  # measured: 2.9 to 3.5 dB


@pytest.mark.parametrize(
    ("choices", "message"),
    [
        ({"shots": 1}, "for 2 shots or more, got 1"),
        ({"shots": 0}, "for 2 shots or more, got 0"),
        ({"shots": 2.5}, "for 2 shots or more, got 2.5"),
        ({"shots": 129}, "129 shots are more than the code has elements"),
        ({"c1": -1.0}, "c1 must be a number from 0 to 1e\\+100, got -1"),
        ({"c1": math.nan}, "c1 must be a number from 0 to 1e\\+100, got nan"),
        ({"c1": math.inf}, "c1 must be a number from 0 to 1e\\+100, got inf"),
        ({"c1": "high"}, "c1 must be a number from 0 to 1e\\+100, got 'high'"),
        ({"repulsion": -0.5}, "repulsion must be a number from 0 to 1e\\+100"),
        ({"coupling": -0.5}, "coupling must be a number from 0 to 1e\\+100"),
        ({"tolerance": -1e-3}, r"tolerance must lie in \[0, 1\)"),
        ({"tolerance": 1.0}, r"tolerance must lie in \[0, 1\)"),
        ({"tolerance": math.nan}, r"tolerance must lie in \[0, 1\)"),
        ({"seed": -1}, "seed must be a whole number"),
        ({"seed": 1.5, "transmittance": 0.5}, "seed must be a whole number"),
        ({"c1": True}, "c1 must be a number"),
        ({"c1": 1e200}, "c1 must be a number from 0 to 1e\\+100"),
        ({"tolerance": "small"}, "tolerance must lie in"),
        ({"max_sweeps": -3}, "max_sweeps must be a whole number of at least 0, got -3"),
        ({"max_sweeps": 2.5}, "max_sweeps must be a whole number"),
        ({"transmittance": "half"}, "transmittance must lie between"),
        ({"start": BOOLEAN, "transmittance": 0.5}, "a start is complementary and new"),
        ({"start": BOOLEAN[:2]}, "the start must have 3 shots, got 2"),
        ({"start": BOOLEAN[:, :4]}, r"must have the shape \(shot, 8, 16\), got \(3, 4, 16\)"),
        ({"start": np.ones_like(BOOLEAN)}, "must be complementary.* 128 of 128"),
        ({"start": np.where(BOOLEAN, 0.5, 0.25)}, "the start must be binary"),
        ({"start": 2 * BOOLEAN}, r"transmittance must lie in \[0, 1\]"),
    ],
    ids=str,
)
def test_bad_input(choices, message):
    with pytest.raises(ValueError, match=message):
        design(PLAIN, **({"shots": 3, "seed": 0} | choices))


@pytest.mark.parametrize(
    ("imager", "choices", "message"),
    [
        (camera(4, 16, 0.9, dispersion_ratio=3.0), {}, "44 bands, more than its mask has columns"),
        (camera(4, 16, 0.5, bands=2), {}, "sees 5 code columns at once, and codes are designed for at most 3"),
        (cassi(sg.DualCASSI, 3, 4, 9, band_shift=3.0, shear="exact"), {}, "sees 5 code columns at once"),
        (camera(1, 2600, 0.2), {}, "table of 2599 columns x 520 distances, too big for memory"),
        (FILTERED, {"coupling": 1.0}, "coupling is for codes of one mask"),
        (FILTERED, {"tile": (3, 2, 6)}, "colored codes are designed whole"),
        (FILTERED, {"transmittance": 0.5}, "leave the transmittance out"),
    ],
    ids=str,
)
def test_imagers_that_do_not_fit(imager, choices, message):
    with pytest.raises(ValueError, match=message):
        design(imager, shots=3, seed=0, **choices)


@pytest.mark.parametrize("starts", [0, -1, 1.5])
def test_bad_number_of_starts(starts):
    with pytest.raises(ValueError, match="starts must be a whole number of at least 1"):
        optimised(PLAIN, shots=3, seed=0, starts=starts)


@pytest.mark.parametrize("thing", [None, "SSCSI", np.zeros((3, 3))], ids=["None", "str", "array"])
def test_things_that_are_no_imagers(thing):
    with pytest.raises(TypeError, match=f"for an SSCSI, CASSI, DualCASSI or ColoredCASSI, got {type(thing).__name__}"):
        design(thing, shots=3, seed=0)


def test_designs_that_cannot_be_exchanged():
    with pytest.raises(ValueError, match="exchanges are for imagers with one mask"):
        exchange(FILTERED, design(FILTERED, shots=2, seed=0))
    with pytest.raises(ValueError, match="one open shot an element"):
        exchange(PLAIN, design(PLAIN, shots=4, seed=0, transmittance=0.5))
    with pytest.raises(ValueError, match=r"must have the shape \(shot, 8, 16\)"):
        exchange(PLAIN, design(camera(8, 12, 0.25), shots=3, seed=0))
    with pytest.raises(TypeError, match="exchanges refine a Design"):
        exchange(PLAIN, None)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="max_sweeps must be"):
        exchange(PLAIN, design(PLAIN, shots=3, seed=0), max_sweeps=-1)


def test_exchanges_go_on_like_one_call():
    found = design(camera(16, 24, 0.25), shots=3, seed=0)
    whole = exchange(camera(16, 24, 0.25), found, tolerance=0, max_sweeps=3)
    part = found
    for _ in range(3):
        part = exchange(camera(16, 24, 0.25), part, tolerance=0, max_sweeps=1)
    assert np.array_equal(part.code, whole.code)
    assert part.costs == whole.costs
