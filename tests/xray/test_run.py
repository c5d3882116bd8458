"""A run is a function of scene, seed and histories: threads, interrupts and checkpoints change no digit; its tallies fit."""

import dataclasses
import itertools
import math
import threading

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.xray import scene as sc
from shadowgram.xray._compile import compile_scene
from shadowgram.xray.montecarlo import arrays
from shadowgram.xray.montecarlo import run as run_module
from shadowgram.xray.montecarlo.arrays import ORDERS
from shadowgram.xray.montecarlo.run import BATCHES, LARGEST_BATCH, batch_edges, batch_vector, run_setup
from shadowgram.xray.montecarlo.tallies import COSINE_BINS, Sums, as_vector
from shadowgram.xray.simulation import prepare, simulate

HISTORIES = 10_000


def scene(**changes):
    values = {
        "world": sc.World(size=(600, 600, 600)),
        "source": sc.Source(position=(0, 0, -100), half_angle=0.3, spectrum={"energies": (40, 80), "weights": (1, 2)}, activity=1),
        "solids": [sc.Solid(name="slab", role="target", material="water", shape=sc.Box(centre=(0, 0, 50), size=(100, 100, 20)))],
        "detectors": [
            sc.Detector(
                name="big", centre=(0, 100, -40), size=(150, 20, 100), material="sodium iodide", pixels=(2, 3), resolution=0.1
            ),
            sc.Detector(name="small", centre=(100, 0, -40), size=(20, 60, 60), material="sodium iodide", efficiency=0.5),
        ],
    }  # fmt: skip
    return sc.Scene(**values | changes)


@pytest.fixture(scope="module")
def compiled():
    return compile_scene(scene())


@pytest.fixture(scope="module", params=[False, True], ids=["analog", "reduced"])
def setup(request, compiled):
    return prepare(compiled, variance_reduction=request.param)


@pytest.fixture(scope="module")
def whole(setup):
    return run_setup(setup, histories=HISTORIES, seed=3)


def equal(a, b):
    assert a.tallies.keys() == b.tallies.keys()
    assert a.histories == b.histories
    for name, one in a.tallies.items():
        np.testing.assert_array_equal(one.mean, b.tallies[name].mean, err_msg=name)
        np.testing.assert_array_equal(one.standard_error, b.tallies[name].standard_error, err_msg=name)


class Interrupt:
    """A progress bar whose user presses Ctrl-C when so many histories are done."""

    def __init__(self, at):
        self.at, self.states = at, []

    def __call__(self, state):
        self.states.append(state)
        if state.done >= self.at:
            raise KeyboardInterrupt


# ---- threads -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("threads", [1, 2, 8])
def test_same_digits_for_any_number_of_threads(setup, whole, threads):
    equal(run_setup(setup, histories=HISTORIES, seed=3, threads=threads), whole)


def test_threads_are_those_that_are_asked_for(setup, whole, monkeypatch):
    """Asked for by name, by `sg.threads`, or 2."""
    seen = set()
    plain = run_module.batch_vector

    def watched(*arguments):
        seen.add(threading.current_thread().name)
        return plain(*arguments)

    monkeypatch.setattr(run_module, "batch_vector", watched)
    with sg.threads(1):
        equal(run_setup(setup, histories=HISTORIES, seed=3), whole)
    assert len(seen) == 1
    seen.clear()
    equal(run_setup(setup, histories=HISTORIES, seed=3, threads=3), whole)
    assert 1 < len(seen) <= 3
    assert threading.current_thread().name not in seen


def test_two_runs_at_once_do_not_meet(setup, whole):
    found = [None, None]

    def go(i):
        found[i] = run_setup(setup, histories=HISTORIES, seed=3, threads=2)

    workers = [threading.Thread(target=go, args=(i,)) for i in range(2)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    for run in found:
        equal(run, whole)


def test_another_seed_gives_other_numbers(setup, whole):
    other = run_setup(setup, histories=HISTORIES, seed=4)
    assert other.tallies["all"].mean != whole.tallies["all"].mean
    error = math.hypot(float(other.tallies["all"].standard_error), float(whole.tallies["all"].standard_error))
    assert float(other.tallies["all"].mean) == pytest.approx(float(whole.tallies["all"].mean), abs=4 * error)


# ---- batches -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("histories", [2, 3, 127, 128, 129, 1000, 10_000_019, BATCHES * LARGEST_BATCH + 1])
def test_batches_cover_all_histories_evenly(histories):
    edges = batch_edges(histories)
    sizes = np.diff(edges)
    assert (edges[0], edges[-1]) == (0, histories)
    assert len(sizes) >= min(BATCHES, histories)
    assert 1 <= sizes.min() <= sizes.max() <= LARGEST_BATCH
    assert sizes.max() - sizes.min() <= 1


def test_a_batch_is_the_sum_of_its_histories(setup):
    one_by_one = sum(batch_vector(setup, 3, i, i + 1) for i in range(500, 700))
    np.testing.assert_allclose(batch_vector(setup, 3, 500, 700), one_by_one, rtol=1e-12)
    assert (batch_vector(setup, 3, 700, 700) == 0).all()


def test_means_and_errors_are_those_of_the_batches(setup, whole):
    edges = batch_edges(HISTORIES)
    vectors = np.array([batch_vector(setup, 3, a, b) for a, b in itertools.pairwise(edges)])
    total = vectors[:, 0]
    assert whole.tallies["all"].mean == pytest.approx(total.sum() / HISTORIES, rel=1e-12)
    expected = total.std(ddof=1) * math.sqrt(len(total)) / HISTORIES
    assert whole.tallies["all"].standard_error == pytest.approx(expected, rel=1e-9)


# ---- tallies -----------------------------------------------------------------------------------------------------------------


def test_tallies_fit_together(whole):
    mean = {name: one.mean for name, one in whole.tallies.items()}
    close = {"rel": 1e-10}
    assert mean["all"] > 0
    assert mean["all"] == pytest.approx(mean["big"] + mean["small"], **close)
    assert mean["all"] == pytest.approx(mean["all/orders"].sum(), **close)
    np.testing.assert_allclose(mean["all/orders"], mean["big/orders"] + mean["small/orders"], rtol=1e-10)
    for name in ("big", "small"):
        for part in ("orders", "spectrum", "image"):
            assert mean[name] == pytest.approx(mean[f"{name}/{part}"].sum(), **close)
    for side in ("backward", "forward"):
        assert mean[f"escaped/{side}"] == pytest.approx(mean[f"escaped/{side}/spectrum"].sum(), **close)
    assert mean["escaped/cosine"][: COSINE_BINS // 2].sum() == pytest.approx(float(mean["escaped/backward"]), **close)
    assert mean["escaped/cosine"][COSINE_BINS // 2 :].sum() == pytest.approx(float(mean["escaped/forward"]), **close)
    assert 40 < mean["energy/started"] < 80
    # 1 keV in 1 g of water, of which there are 200.
    assert mean["dose/slab"] == pytest.approx(mean["deposited/slab"] * 1.602176634e-16 / 0.2, rel=1e-9)
    assert "dose/world" not in mean


def test_tallies_have_axes_edges_and_units(whole):
    tallies = whole.tallies
    assert tallies["all/orders"].mean.shape == (len(ORDERS),)
    assert tallies["big/image"].mean.shape == (2, 3)
    assert tallies["big/image"].axes == ("y", "x")
    assert tallies["small/image"].mean.shape == (1, 1)
    edges = tallies["big/spectrum"].edges[0]
    assert len(edges) == tallies["big/spectrum"].mean.size + 1
    assert (edges[0], edges[1]) == (0.0, 0.5)
    assert (tallies["big/spectrum"].mean[edges[1:] <= 10] == 0).all(), "nothing is counted below the threshold"
    for name, one in tallies.items():
        assert one.mean.shape == one.standard_error.shape
        assert len(one.axes) == len(one.edges) == one.mean.ndim
        assert one.unit.endswith("per source photon"), name
        assert (one.standard_error >= 0).all()


def test_an_estimate_scales():
    run = simulate(sc.shipped_scene("slab-water"), histories=1000, seed=1)
    one = run.tallies["escaped/backward"]
    many = one.scaled(1e6, "photons per shot")
    assert (many.mean, many.standard_error, many.unit) == (1e6 * one.mean, 1e6 * one.standard_error, "photons per shot")
    assert many.relative_error == pytest.approx(one.relative_error)
    assert run.tallies["all"].mean == 0
    assert run.tallies["all"].relative_error == math.inf


# ---- what a detector reads out -----------------------------------------------------------------------------------------------


def read_out(x=0.0, y=0.0, energy=100.0, histories=100_000, **changes):
    """Tallies of a pencil along z that a detector of 60 × 40 mm absorbs, every photon of it and all of its energy."""
    values = {"name": "one", "centre": (10, 20, 50), "size": (60, 40, 50), "material": "lead"}
    described = scene(
        source=sc.Source(position=(10 + x, 20 + y, -100), spectrum={"energy": energy}, activity=1),
        world=sc.World(size=(600, 600, 600), material="vacuum"),
        solids=(),
        detectors=(sc.Detector(**values | changes),),
        fluorescence=False,
    )
    setup = prepare(compile_scene(described), variance_reduction=False)
    table = setup.physics.attenuation.copy()
    table[..., arrays.PHOTOELECTRIC : arrays.PHOTOELECTRIC + 2] = table[..., arrays.TOTAL : arrays.TOTAL + 2]
    black = dataclasses.replace(setup, physics=setup.physics._replace(attenuation=table))
    return run_setup(black, histories=histories, seed=1).tallies


@pytest.mark.parametrize(
    ("x", "y", "row", "column"), [(-29, -19, 0, 0), (29, -19, 0, 2), (-29, 19, 4, 0), (29, 19, 4, 2), (1, -11, 1, 1)]
)
def test_pulses_lie_in_the_pixel_of_their_place(x, y, row, column):
    """Rows along y, columns along x."""
    image = read_out(x, y, histories=100, pixels=(5, 3))["one/image"].mean
    assert image.shape == (5, 3)
    assert image[row, column] == pytest.approx(1)
    assert image.sum() == pytest.approx(1)


def test_all_of_the_energy_is_in_the_pulse():
    tallies = read_out(histories=1000)
    assert tallies["one"].mean == 1
    assert tallies["one/spectrum"].mean[200] == 1
    assert tallies["all/orders"].mean[ORDERS.index("direct")] == 1
    assert tallies["deposited/one"].mean == pytest.approx(100, rel=1e-12)


@pytest.mark.parametrize(("threshold", "counted"), [(0, 1), (99.9, 1), (100, 1), (100.1, 0)])
def test_pulses_below_the_threshold_are_not_counted(threshold, counted):
    assert read_out(histories=200, threshold=threshold)["one"].mean == counted


def test_the_efficiency_is_the_share_that_is_counted():
    """4 standard deviations: 6e-5."""
    assert read_out(efficiency=0.3)["one"].mean == pytest.approx(0.3, abs=4 * math.sqrt(0.21 / 100_000))


def test_pulses_are_blurred_by_the_resolution():
    """FWHM 10 % at 662 keV is 25.7 % at 100 keV, since it goes with 1/√E; mean and width within 4 standard deviations."""
    spectrum = read_out(resolution=0.1)["one/spectrum"]
    middle = (spectrum.edges[0][1:] + spectrum.edges[0][:-1]) / 2
    share = spectrum.mean
    sigma = 0.1 * 662 / 2.3548 * math.sqrt(100 / 662)
    below = share[middle < 100].sum()
    assert below == pytest.approx(0.5, abs=4 * math.sqrt(0.25 / 100_000))
    # What is below the mean by more than 1.2 deviations, an edge of a bin nearby being taken.
    edge = round((100 - 1.2 * sigma) / 0.5) * 0.5
    tail = 0.5 * math.erfc((100 - edge) / sigma / math.sqrt(2))
    assert share[middle < edge].sum() == pytest.approx(tail, abs=4 * math.sqrt(tail / 100_000))


# ---- interrupts and checkpoints ----------------------------------------------------------------------------------------------


def test_an_interrupt_keeps_what_was_found(setup):
    stop = Interrupt(3000)
    run = run_setup(setup, histories=HISTORIES, seed=3, progress=stop)
    assert not run.finished
    assert run.histories == stop.states[-1].done
    assert 3000 <= run.histories < 3200
    assert run.tallies["escaped/forward"].mean > 0.5
    assert [state.done for state in stop.states] == batch_edges(HISTORIES)[1 : len(stop.states) + 1]
    assert all(state.total == HISTORIES for state in stop.states)


def test_an_interrupt_before_the_first_batch_is_one(setup, monkeypatch, tmp_path):
    def pressed(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(run_module, "batch_vector", pressed)
    with pytest.raises(KeyboardInterrupt):
        run_setup(setup, histories=HISTORIES, seed=3, checkpoint=tmp_path / "c")
    assert not (tmp_path / "c").exists()


def test_a_resumed_run_has_the_same_digits(setup, whole, tmp_path):
    path = tmp_path / "run.checkpoint"
    for session, at in enumerate((100, 2000, 2001, 7000)):
        stop = Interrupt(at)
        run = run_setup(setup, histories=HISTORIES, seed=3, checkpoint=path, progress=stop, threads=1 + session % 2)
        assert not run.finished
    later = Interrupt(math.inf)
    run = run_setup(setup, histories=HISTORIES, seed=3, checkpoint=path, progress=later)
    assert run.finished
    assert later.states[0].done > 7000, "what was done is not done again"
    equal(run, whole)
    again = Interrupt(0)
    done = run_setup(setup, histories=HISTORIES, seed=3, checkpoint=path, progress=again)
    assert not again.states, "a finished run is not done again"
    equal(done, whole)
    assert done.seconds >= run.seconds


def test_an_interrupt_between_two_statements_tears_no_sum():
    """Sums are exchanged as one, so that total and squares are always of the same batches."""

    class Torn(np.ndarray):
        def __add__(self, other):
            raise KeyboardInterrupt

    sums = Sums.of_size(2)
    sums.add(np.array([1.0, 2.0]), 10)
    sums.squares = sums.squares.view(Torn)
    with pytest.raises(KeyboardInterrupt):
        sums.add(np.array([1.0, 2.0]), 10)
    assert (sums.total.tolist(), sums.batches, sums.histories) == ([1.0, 2.0], 1, 10)


def test_checkpoints_are_written_on_the_way(setup, monkeypatch, tmp_path):
    monkeypatch.setattr(run_module, "SAVE_EVERY", 0.0)
    path = tmp_path / "run.checkpoint"
    sizes = []

    def look(state):
        sizes.append(path.stat().st_size if path.exists() else 0)

    run_setup(setup, histories=300, seed=3, checkpoint=path, progress=look)
    assert all(sizes)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.fixture
def checkpoint(setup, tmp_path):
    path = tmp_path / "run.checkpoint"
    run_setup(setup, histories=HISTORIES, seed=3, checkpoint=path, progress=Interrupt(1000))
    return path


def refused(setup, path, match, **changes):
    before = path.read_bytes()
    with pytest.raises(ValueError, match=match):
        run_setup(setup, **{"histories": HISTORIES, "seed": 3, "checkpoint": path} | changes)
    assert path.read_bytes() == before


def test_foreign_checkpoints_are_refused(setup, checkpoint):
    belongs = "belongs to another scene, seed or number of histories; remove it or name another file"
    refused(setup, checkpoint, belongs, seed=4)
    refused(setup, checkpoint, belongs, histories=HISTORIES + 1)
    for changes in (
        {"rules": setup.rules._replace(cutoff=2.0)},
        {"rules": setup.rules._replace(reduce=None if setup.rules.reduce else True)},
        {"bins": setup.bins + 1},
        {"source": setup.source._replace(position=np.array([0.0, 0.0, -99.0]))},
        {"geometry": setup.geometry._replace(box=setup.geometry.box + 1e-9)},
    ):
        refused(dataclasses.replace(setup, **changes), checkpoint, belongs)


def test_damaged_checkpoints_are_refused(setup, checkpoint):
    no_checkpoint = "is no checkpoint of a simulation, or is damaged; remove it or name another file"
    good = checkpoint.read_bytes()
    rng = np.random.default_rng(5)
    for size in (0, 1, 31, 32, 100, len(good) // 2, len(good) - 1):
        checkpoint.write_bytes(good[:size])
        refused(setup, checkpoint, no_checkpoint)
    for _ in range(50):
        wrong = bytearray(good)
        wrong[rng.integers(len(good))] ^= 1 << rng.integers(8)
        checkpoint.write_bytes(wrong)
        refused(setup, checkpoint, no_checkpoint)
    for garbage in (rng.bytes(5000), b"PK\x03\x04" + rng.bytes(300), b"\x93NUMPY" + rng.bytes(300), b"0" * 64):
        checkpoint.write_bytes(garbage)
        refused(setup, checkpoint, no_checkpoint)
    np.save(checkpoint.with_suffix(".npy"), np.zeros(3))
    refused(setup, checkpoint.with_suffix(".npy"), no_checkpoint)
    checkpoint.write_bytes(good + b"\0")
    refused(setup, checkpoint, no_checkpoint)
    checkpoint.write_bytes(good)
    assert run_setup(setup, histories=HISTORIES, seed=3, checkpoint=checkpoint).finished


def test_a_checkpoint_that_cannot_be_one(setup, tmp_path):
    with pytest.raises(ValueError, match=r"cannot be read: .*; remove it or name another file"):
        run_setup(setup, histories=HISTORIES, seed=3, checkpoint=tmp_path)
    with pytest.raises(OSError, match="there is no folder"):
        run_setup(setup, histories=200, seed=3, checkpoint=tmp_path / "nowhere" / "c")


# ---- stopping ----------------------------------------------------------------------------------------------------------------


def test_stop_at_stops(setup, tmp_path):
    whole = run_setup(setup, histories=200_000, seed=3)
    wanted = 1.2 * float(whole.tallies["all"].relative_error)
    path = tmp_path / "c"
    run = run_setup(setup, histories=200_000, seed=3, stop_at=wanted, checkpoint=path, threads=1)
    assert run.finished
    assert 60_000 < run.histories < 200_000
    assert run.tallies["all"].relative_error <= wanted
    # It does not matter when it was interrupted, nor how many threads were ahead; and nothing comes on top.
    for threads in (1, 2):
        again = Interrupt(0)
        equal(
            run_setup(
                setup, histories=200_000, seed=3, stop_at=wanted, checkpoint=path, progress=again, threads=threads
            ),
            run,
        )
        assert not again.states
    equal(run_setup(setup, histories=200_000, seed=3, stop_at=wanted, threads=2), run)
    # The same checkpoint goes on to the end for those who want it all.
    equal(run_setup(setup, histories=200_000, seed=3, checkpoint=path), whole)


def test_stop_at_needs_half_of_the_batches(setup):
    run = run_setup(setup, histories=HISTORIES, seed=3, stop_at=0.999)
    assert run.histories == batch_edges(HISTORIES)[BATCHES // 2]


def test_stop_at_never_stops_where_nothing_is_counted(compiled):
    empty = prepare(compile_scene(scene(detectors=())), variance_reduction=False)
    run = run_setup(empty, histories=1000, seed=1, stop_at=0.5)
    assert run.histories == 1000
    assert run.tallies["all"].mean == 0


# ---- bad arguments -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"histories": 1}, "histories must be a whole number of at least 2, got 1"),
        ({"histories": 1e6}, "histories must be a whole number of at least 2, got 1000000.0"),
        ({"histories": True}, "histories must be a whole number"),
        ({"histories": "many"}, "histories must be a whole number"),
        ({"seed": -1}, "seed must be a whole number of at least 0, got -1"),
        ({"seed": 0.5}, "seed must be a whole number"),
        ({"seed": 2**63}, r"seed must be below 2\*\*63"),
        ({"threads": 0}, "threads must be a whole number of at least 1, got 0"),
        ({"threads": 1.5}, "threads must be a whole number"),
        ({"stop_at": 0}, "stop_at is a relative standard error between 0 and 1, got 0"),
        ({"stop_at": 1.0}, "stop_at is a relative standard error between 0 and 1, got 1.0"),
        ({"stop_at": math.nan}, "stop_at is a relative standard error between 0 and 1, got nan"),
    ],
)
def test_bad_arguments_are_refused(setup, changes, match):
    with pytest.raises(ValueError, match=match):
        run_setup(setup, **{"histories": 100, "seed": 1} | changes)


@pytest.mark.parametrize(
    ("shot", "match"), [(-1, "the shot must be a whole number from 0 to 0, got -1"), (1, "got 1"), (0.5, "got 0.5")]
)
def test_shots_that_are_not_taken(shot, match):
    with pytest.raises(ValueError, match=match):
        simulate(scene(), histories=100, shot=shot)


def test_energies_must_lie_above_the_cutoff():
    with pytest.raises(ValueError, match="must lie between the cut-off, 90 keV, and 512 keV, got 80 keV"):
        simulate(scene(cutoff=90), histories=100)


def test_numbers_of_numpy_are_as_good(setup, whole):
    equal(run_setup(setup, histories=np.int32(HISTORIES), seed=np.uint8(3), threads=np.int64(2)), whole)


def test_a_large_seed_is_as_good(setup):
    run = run_setup(setup, histories=1000, seed=2**63 - 1)
    assert run.tallies["escaped/forward"].mean > 0.5


def test_simulate_takes_scenes_compiled_or_not(compiled):
    a = simulate(scene(), histories=1000, seed=2, variance_reduction=True)
    b = simulate(compiled, histories=1000, seed=2, variance_reduction=True)
    equal(a, b)


def test_setups_are_told_apart(setup):
    assert setup.digest() == dataclasses.replace(setup).digest()
    assert setup.digest() != dataclasses.replace(setup, bins=setup.bins + 1).digest()
    assert as_vector(setup.empty_tally()).sum() == 0
