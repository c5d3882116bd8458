"""Maps of uncertainty: against the truth on average, and what they promise to callers."""

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.operators.structure import shot_gram
from shadowgram.solvers._parts import Shots, Weighted
from shadowgram.solvers.uncertainty import uncertainty
from shadowgram.testing import dot_test

SPEC = sg.EigenTV(max_iter=25)


@pytest.fixture(scope="module")
def problem():
    cube = sg.scenes.chart(size=64, bands=8, seed=0).values.astype(np.float32)
    imager = sg.DualCASSI(cube_shape=cube.shape, wavelengths=(450, 650))
    H = imager.operator(sg.codes.boolean(shots=4, shape=imager.code_shape, seed=0))
    y = sg.noise.awgn(H.forward(cube), snr_db=30, seed=0)
    return cube, H, y, sg.solve(SPEC, H, y)


def test_the_map_is_about_as_large_as_the_error(problem):
    cube, H, y, solution = problem
    found = uncertainty(SPEC, H, y, solution, seed=0, samples=6)
    error = np.abs(solution.x - cube)
    assert found.samples == 6
    assert not found.interrupted
    assert 0.4 < np.sqrt((error**2).mean() / (found.std**2).mean()) < 2
    assert (error < 2 * found.std).mean() > 0.8
    ranks = [np.argsort(np.argsort(image.ravel())) for image in (error, found.std)]
    assert np.corrcoef(*ranks)[0, 1] > 0.25


def test_more_noise_is_less_certain(problem):
    cube, H, y, solution = problem
    noisy = sg.noise.awgn(H.forward(cube), snr_db=10, seed=0)
    maps = [
        uncertainty(SPEC, H, data, one, seed=0, samples=2).std.mean()
        for data, one in ((y, solution), (noisy, sg.solve(SPEC, H, noisy)))
    ]
    assert maps[1] > 1.5 * maps[0]


def test_the_same_seed_gives_the_same_map_for_any_threads(problem):
    _, H, y, solution = problem
    spec = sg.EigenTV(max_iter=5)
    maps = []
    for threads, seed in ((1, 0), (3, 0), (1, 1)):
        with sg.threads(threads):
            maps.append(uncertainty(spec, H, y, solution, seed=seed, samples=2).std)
    assert np.array_equal(maps[0], maps[1])
    assert not np.array_equal(maps[0], maps[2])


@pytest.mark.parametrize("at", [0, 1, 3])
def test_interrupts_keep_what_there_is(problem, at):
    _, H, y, solution = problem

    def stop(sample, _):
        if sample == at:
            raise KeyboardInterrupt

    spec = sg.EigenTV(max_iter=3)
    if at < 2:
        with pytest.raises(KeyboardInterrupt):
            uncertainty(spec, H, y, solution, seed=0, samples=5, callback=stop)
        return
    found = uncertainty(spec, H, y, solution, seed=0, samples=5, callback=stop)
    assert found.interrupted
    assert found.samples == at
    assert np.array_equal(found.std, uncertainty(spec, H, y, solution, seed=0, samples=at if at % 2 == 0 else 3).std)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"samples": 1}, "2 samples or more"),
        ({"samples": 2.0}, "2 samples or more"),
        ({"seed": -1}, "seed is a whole number"),
    ],
)
def test_settings_are_checked(problem, keywords, message):
    _, H, y, solution = problem
    with pytest.raises(ValueError, match=message):
        uncertainty(SPEC, H, y, solution, **{"seed": 0, **keywords})


def test_a_solution_of_another_operator_is_refused(problem):
    _, H, y, _ = problem
    with pytest.raises(ValueError, match="solution"):
        uncertainty(SPEC, H, y, sg.Solution(np.zeros((2, 3, 3)), True, 1), seed=0)


@pytest.mark.parametrize("shape", [(3, 5, 7), (4, 6, 6)])
@pytest.mark.parametrize("kind", ["kept", "shots"])
def test_parts_equal_their_matrices(shape, kind):
    imager = sg.CASSI(cube_shape=shape, wavelengths=(450, 650))
    H = imager.operator(np.random.default_rng(0).random((3, *imager.code_shape)))
    half = np.random.default_rng(1).random(H.out_shape) < 0.5
    part = Weighted(H, half) if kind == "kept" else Shots(H, (0, 2))
    assert dot_test(part, seed=0) < 1e-12
    x = np.random.default_rng(2).random(shape)
    seen = H.forward(x)
    expected = seen.copy()
    for index in np.ndindex(*half.shape):
        expected[index] = seen[index] if half[index] else 0
    assert np.allclose(part.forward(x), expected if kind == "kept" else seen[[0, 2]], rtol=1e-12, atol=0)
    gram = shot_gram(part)
    assert gram is not None
    w = np.random.default_rng(3).random(part.out_shape)
    assert np.allclose(np.einsum("qpij,pij->qij", gram, w), part.forward(part.adjoint(w)), rtol=1e-12, atol=1e-12)
