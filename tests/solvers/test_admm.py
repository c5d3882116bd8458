"""ADMM: its data step against dense algebra, its iteration against the equations, what it converges to, and what it says."""

from dataclasses import dataclass

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.operators import as_matrix
from shadowgram.operators.base import LinearOperator
from shadowgram.priors.tv import tv
from shadowgram.solvers import _admm_data as steps


@dataclass(frozen=True, eq=False)
class Dense(LinearOperator):
    """A matrix, acting on an image or a cube."""

    matrix: np.ndarray
    shape: tuple[int, ...]

    @property
    def in_shape(self):
        return self.shape

    @property
    def out_shape(self):
        return (len(self.matrix),)

    def _forward(self, x, out):
        out[:] = self.matrix.astype(x.dtype) @ x.ravel()

    def _adjoint(self, y, out):
        out[:] = (self.matrix.T.astype(y.dtype) @ y).reshape(self.shape)


def dense(rows, shape, seed=0):
    return Dense(np.random.default_rng(seed).random((rows, int(np.prod(shape)))), shape)


def scene(shape=(12, 15)):
    y, x = np.mgrid[: shape[0], : shape[1]]
    image = np.full(shape, 0.3)
    image[(y > 2) & (y < 9) & (x > 3) & (x < 8)] = 1.0
    image[(y > 6) & (x > 10)] = 0.6
    return image


def problem(rows=90, shape=(12, 15), noise=0.0, dtype=np.float64):
    H = dense(rows, shape)
    y = H.forward(scene(shape)) + noise * np.random.default_rng(1).standard_normal(rows)
    return H, y.astype(dtype)


def halfway(image, sigma):
    """A linear denoiser: towards the mean by a share that grows with sigma; the proximal map of a quadratic function."""
    return (image + sigma * image.mean()) / (1 + sigma)


def wall(image, sigma):
    """A proximal map without a parameter: everything between 0.2 and 0.9."""
    return np.clip(image, 0.2, 0.9)


# --- the data step ---

PROBLEMS = [(5, (7, 9)), (40, (6, 7)), (64, (8, 8)), (100, (5, 11)), (30, (3, 4, 5)), (77, (2, 3, 7))]


@pytest.mark.parametrize(("rows", "shape"), PROBLEMS)
@pytest.mark.parametrize("kind", [steps.RowStep, steps.ColumnStep, steps.GradientStep])
def test_the_data_step_is_the_dense_solution(kind, rows, shape):
    H, rng = dense(rows, shape), np.random.default_rng(2)
    y = rng.standard_normal(rows)
    step = kind(H, y)
    A = H.matrix
    for rho in (3.0, 0.05, 40.0):
        v = rng.standard_normal(shape)
        expected = np.linalg.solve(A.T @ A + rho * np.eye(A.shape[1]), A.T @ y + rho * v.ravel()).reshape(shape)
        x, residual = step.solve(v, rho, 1e-14)
        assert step.exact
        assert np.abs(x - expected).max() < 1e-10
        assert residual == pytest.approx(np.linalg.norm(A @ expected.ravel() - y), rel=1e-9)


@pytest.mark.parametrize("kind", [steps.RowStep, steps.ColumnStep, steps.GradientStep])
def test_the_data_step_in_float32(kind):
    H, rng = dense(40, (6, 9)), np.random.default_rng(2)
    y, v = rng.standard_normal(40).astype(np.float32), rng.standard_normal((6, 9)).astype(np.float32)
    A = H.matrix
    expected = np.linalg.solve(A.T @ A + np.eye(54), A.T @ y + v.ravel()).reshape(6, 9)
    x, _ = kind(H, y).solve(v, 1.0, 1e-7)
    assert x.dtype == np.float32
    assert np.abs(x - expected).max() < 2e-5


@pytest.mark.parametrize("shape", [(3, 5, 8), (4, 8, 5), (1, 7, 7)])
@pytest.mark.parametrize("shots", [1, 3])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_data_step_of_detector_elements_that_share_no_light(shape, shots, dtype):
    imager = sg.DualCASSI(cube_shape=shape, wavelengths=(450, 650))
    H = imager.operator(sg.codes.random(shots=shots, shape=imager.code_shape, seed=0))
    rng = np.random.default_rng(3)
    y, v = rng.random(H.out_shape).astype(dtype), rng.random(H.in_shape).astype(dtype)
    step = steps.data_step(H, y)
    assert isinstance(step, steps.PixelStep)
    A = as_matrix(H)
    for rho in (0.3, 5.0):
        expected = np.linalg.solve(A.T @ A + rho * np.eye(A.shape[1]), A.T @ y.ravel() + rho * v.ravel())
        x, residual = step.solve(v, rho, 0.0)
        assert x.dtype == dtype
        assert np.abs(x.ravel() - expected).max() < (1e-10 if dtype is np.float64 else 1e-5)
        assert residual == pytest.approx(np.linalg.norm(A @ expected - y.ravel()), rel=1e-4)


def test_the_smaller_side_is_decomposed_and_large_problems_are_not():
    assert isinstance(steps.data_step(dense(10, (4, 5)), np.zeros(10)), steps.RowStep)
    assert isinstance(steps.data_step(dense(30, (4, 5)), np.zeros(30)), steps.ColumnStep)
    blur = Blur((50, 50))
    assert isinstance(steps.data_step(blur, np.zeros((50, 50))), steps.GradientStep)


def test_conjugate_gradients_say_when_they_fell_short():
    H, y = problem()
    H.matrix[:] *= np.geomspace(1, 1e6, len(H.matrix))[:, None]
    step = steps.GradientStep(H, y)
    step.solve(np.zeros(H.in_shape), 1e-6, 1e-13)
    assert not step.exact
    assert not sg.solve(sg.ADMM(denoiser=wall, sigma=1.0, strength=1e-6, max_iter=1), H, y).converged


@dataclass(frozen=True, eq=False)
class Blur(LinearOperator):
    """Mean of each pixel and its neighbours below and to the right, around the edges: too large to decompose at 50×50."""

    shape: tuple[int, int]

    @property
    def in_shape(self):
        return self.shape

    @property
    def out_shape(self):
        return self.shape

    def _forward(self, x, out):
        out[:] = (x + np.roll(x, -1, 0) + np.roll(x, -1, 1)) / 3

    def _adjoint(self, y, out):
        out[:] = (y + np.roll(y, 1, 0) + np.roll(y, 1, 1)) / 3


# --- the iteration ---


@pytest.mark.parametrize("nonnegative", [True, False])
@pytest.mark.parametrize("shape", [(7, 9), (2, 5, 8)])
def test_the_iteration_is_equation_4_4(shape, nonnegative):
    H, y = dense(30, shape), np.random.default_rng(4).standard_normal(30)
    spec = sg.ADMM(
        denoiser=halfway, sigma=(2.0, 0.5), strength=0.3, schedule=3, nonnegative=nonnegative, max_iter=5, tol=0
    )
    found = sg.solve(spec, H, y)
    A, z, multiplier, tried = H.matrix, np.zeros(shape), np.zeros(shape), []
    for iteration, sigma in enumerate([2.0, 1.0, 0.5, 0.5, 0.5]):
        rho = 0.3 / sigma**2
        u, before = multiplier / rho, z
        right = A.T @ y + rho * (z - u).ravel()
        x = np.linalg.solve(A.T @ A + rho * np.eye(A.shape[1]), right).reshape(shape)
        bands = (x + u).reshape(-1, *shape[-2:])
        z = np.stack([halfway(band, sigma) for band in bands]).reshape(shape)
        z = np.maximum(z, 0) if nonnegative else z
        multiplier = rho * (u + x - z)
        expected = {
            "primal": np.linalg.norm(x - z),
            "dual": rho * np.linalg.norm(z - before),
            "residual": np.linalg.norm(A @ x.ravel() - y),
            "rho": rho,
            "sigma": sigma,
        }
        for name, value in expected.items():
            assert found.history[name][iteration] == pytest.approx(value, rel=1e-9), name
        u, size = multiplier / rho, max(np.linalg.norm(x), np.linalg.norm(z))
        change = np.linalg.norm(z - before) / max(np.linalg.norm(u), size / 100)
        tried.append((max(np.linalg.norm(x - z) / size, change), z))
    assert not found.converged
    assert np.allclose(found.x, min(tried[2:], key=lambda one: one[0])[1], atol=1e-10)
    assert (found.x.min() >= 0) == nonnegative


def primal_dual(A, y, weight, shape, iterations):
    """argmin ½‖Ax − y‖² + weight TV(x), x ≥ 0, by the primal-dual iteration of Condat and Vu."""
    x, p = np.zeros(shape), np.zeros((2, *shape))
    lipschitz = np.linalg.norm(A, 2) ** 2
    tau, dual_step = 1 / (0.5 * lipschitz + 8 * lipschitz / 16), lipschitz / 16
    for _ in range(iterations):
        divergence = np.zeros(shape)
        divergence[:-1] -= p[0, :-1]
        divergence[1:] += p[0, :-1]
        divergence[:, :-1] -= p[1, :, :-1]
        divergence[:, 1:] += p[1, :, :-1]
        slope = (A.T @ (A @ x.ravel() - y)).reshape(shape) + divergence
        before, x = x, np.maximum(x - tau * slope, 0)
        p = p + dual_step * gradient(2 * x - before)
        p /= np.maximum(1, np.hypot(*p) / weight)
    return x


def gradient(x):
    g = np.zeros((2, *x.shape))
    g[0, :-1], g[1, :, :-1] = np.diff(x, axis=0), np.diff(x, axis=1)
    return g


def objective(A, y, weight, x):
    return 0.5 * np.sum((A @ x.ravel() - y) ** 2) + weight * np.hypot(*gradient(x)).sum()


@pytest.fixture(scope="module")
def regularised():
    """A noisy problem with the minimiser of ½‖Ax − y‖² + 0.24 TV(x), x ≥ 0, found by other means."""
    rng, shape = np.random.default_rng(6), (12, 15)
    H = Dense(rng.standard_normal((90, 180)) / 5, shape)
    y = H.forward(scene(shape)) + 0.1 * rng.standard_normal(90)
    return H, y, primal_dual(H.matrix, y, 0.24, shape, 6000)


def prox(image, sigma):
    return tv(image, 0.8 * sigma, tol=1e-8, max_iter=100_000)


@pytest.mark.parametrize(
    ("denoiser", "tol", "gap", "error"),
    [(prox, 1e-5, 1e-5, 1e-3), (sg.priors.TVDenoiser(weight=0.8), 1e-3, 3e-3, 0.05)],
    ids=["float64", "shipped"],
)
@pytest.mark.parametrize("sigma", [0.1, (3.0, 0.1)])
def test_with_a_proximal_map_it_minimises_the_objective(regularised, sigma, denoiser, tol, gap, error):
    H, y, expected = regularised
    schedule = 40 if isinstance(sigma, tuple) else None
    spec = sg.ADMM(denoiser=denoiser, sigma=sigma, strength=0.03, schedule=schedule, max_iter=1000, tol=tol)
    found = sg.solve(spec, H, y)
    assert found.converged
    least = objective(H.matrix, y, 0.24, expected)
    assert least < 0.3 * objective(H.matrix, y, 0.24, np.full(H.shape, scene().mean()))
    assert objective(H.matrix, y, 0.24, found.x) == pytest.approx(least, rel=gap)
    assert np.abs(found.x - expected).max() < error


def test_decomposition_and_conjugate_gradients_give_the_same(monkeypatch):
    H, y = problem(noise=0.1)
    spec = sg.ADMM(denoiser=halfway, sigma=(2.0, 0.4), strength=0.2, max_iter=500, tol=1e-6)
    direct = sg.solve(spec, H, y)
    monkeypatch.setattr(steps, "SMALL", 10)
    iterative = sg.solve(spec, H, y)
    assert direct.converged
    assert iterative.converged
    assert abs(direct.iterations - iterative.iterations) <= 2
    assert np.abs(direct.x - iterative.x).max() < 1e-5
    assert direct.history["residual"][-1] == pytest.approx(iterative.history["residual"][-1], rel=1e-4)


def test_a_problem_that_is_too_large_for_dense_algebra():
    rng = np.random.default_rng(0)
    image = np.kron(scene((10, 10)), np.ones((5, 5)))
    H = Blur((50, 50))
    y = H.forward(image) + 0.05 * rng.standard_normal(image.shape)
    found = sg.solve(sg.ADMM(denoiser="tv", sigma=(0.5, 0.05), strength=0.0025), H, y)
    assert found.converged
    assert sg.metrics.psnr(found.x, image, peak=1.0) > sg.metrics.psnr(y, image, peak=1.0) + 6


@pytest.mark.parametrize("name", ["bm3d", "ffdnet", "tv"])
def test_every_shipped_denoiser_improves_on_least_squares(name):
    H, y = problem(rows=180, shape=(16, 17), noise=0.2)
    truth = scene((16, 17))
    A = H.matrix
    ridge = A.T @ np.linalg.solve(A @ A.T + 0.04 * np.eye(len(A)), y)
    found = sg.solve(sg.ADMM(denoiser=name, sigma=(0.5, 0.1), strength=0.02), H, y)
    assert sg.metrics.psnr(found.x, truth, peak=1.0) > sg.metrics.psnr(ridge.reshape(truth.shape), truth, peak=1.0) + 3


def test_bands_of_a_cube_are_denoised_one_by_one():
    H, y = dense(50, (3, 8, 9)), np.random.default_rng(5).random(50)
    seen = []

    def watch(image, sigma):
        assert image.flags.c_contiguous
        seen.append(image.copy())
        image[:] = -1  # a denoiser that works in place must not disturb the iteration
        return wall(seen[-1], sigma)

    found = sg.solve(sg.ADMM(denoiser=watch, sigma=1.0, strength=1.0, max_iter=4), H, y)
    plain = sg.solve(sg.ADMM(denoiser=wall, sigma=1.0, strength=1.0, max_iter=4), H, y)
    assert [image.shape for image in seen] == [(8, 9)] * 12
    assert np.array_equal(found.x, plain.x)


def test_sigma_falls_in_equal_ratios_and_then_stays():
    H, y = problem()
    keywords = {"denoiser": halfway, "strength": 0.5, "tol": 0}
    history = sg.solve(sg.ADMM(sigma=(8.0, 1.0), max_iter=8, **keywords), H, y).history
    assert np.allclose(history["sigma"], [8, 4, 2, 1, 1, 1, 1, 1])
    assert np.allclose(history["rho"], 0.5 / np.square(history["sigma"]))
    history = sg.solve(sg.ADMM(sigma=(1.0, 4.0), schedule=3, max_iter=5, **keywords), H, y).history
    assert np.allclose(history["sigma"], [1, 2, 4, 4, 4])
    assert sg.solve(sg.ADMM(sigma=2, max_iter=3, **keywords), H, y).history["sigma"] == [2, 2, 2]
    assert sg.solve(sg.ADMM(sigma=(2, 1), max_iter=1, **keywords), H, y).history["sigma"] == [1]


def test_it_is_not_converged_before_sigma_has_settled():
    H, y = problem()
    spec = {"denoiser": wall, "strength": 1.0, "tol": 1e-2}
    early = sg.solve(sg.ADMM(sigma=1.0, max_iter=300, **spec), H, y)
    assert early.converged
    assert early.iterations < 150
    late = sg.solve(sg.ADMM(sigma=(1.001, 1.0), schedule=200, max_iter=300, **spec), H, y)
    assert late.converged
    assert late.iterations >= 200


# --- what it says ---


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_history_is_true(dtype):
    H, y = problem(rows=220, noise=0.3, dtype=dtype)
    said = []
    spec = sg.ADMM(denoiser=wall, sigma=(2.0, 0.5), strength=0.5, max_iter=400)
    found = sg.solve(spec, H, y, callback=lambda i, values: said.append((i, values)))
    assert found.converged
    assert found.x.dtype == dtype
    assert found.x.shape == H.in_shape
    assert set(found.history) == {"primal", "dual", "residual", "rho", "sigma", "seconds"}
    assert all(len(values) == found.iterations for values in found.history.values())
    assert [i for i, _ in said] == list(range(1, found.iterations + 1))
    assert said[-1][1] == {name: values[-1] for name, values in found.history.items()}
    assert found.history["primal"][-1] < 1e-3 * np.linalg.norm(found.x) * 1.01
    assert found.history["residual"][-1] == pytest.approx(np.linalg.norm(H.forward(found.x) - y), rel=0.05)
    starved = sg.solve(sg.ADMM(denoiser=wall, sigma=0.5, strength=0.5, max_iter=3), H, y)
    assert not starved.converged
    assert starved.iterations == 3


def test_an_interrupt_returns_the_estimate_so_far():
    H, y = problem()

    def stop(iteration, _):
        if iteration == 7:
            raise KeyboardInterrupt

    spec = sg.ADMM(denoiser=halfway, sigma=1.0, strength=0.2, tol=0)
    found = sg.solve(spec, H, y, callback=stop)
    assert found.interrupted
    assert not found.converged
    assert found.iterations == 7
    same = sg.solve(sg.ADMM(denoiser=halfway, sigma=1.0, strength=0.2, tol=0, max_iter=7), H, y)
    assert np.array_equal(found.x, same.x)
    assert not same.interrupted


def test_an_interrupt_inside_the_denoiser_keeps_the_last_whole_iteration():
    H, y = problem()
    calls = []

    def stop(image, sigma):
        calls.append(sigma)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return halfway(image, sigma)

    found = sg.solve(sg.ADMM(denoiser=stop, sigma=1.0, strength=0.2, tol=0), H, y)
    same = sg.solve(sg.ADMM(denoiser=halfway, sigma=1.0, strength=0.2, tol=0, max_iter=3), H, y)
    assert found.interrupted
    assert found.iterations == 3
    assert np.array_equal(found.x, same.x)


def test_a_denoiser_that_cycles_is_not_converged():
    H, y = problem()
    turn = []

    def cycle(image, sigma):
        turn.append(1)
        return image + (0.1 if len(turn) % 2 else -0.1)

    found = sg.solve(sg.ADMM(denoiser=cycle, sigma=1.0, strength=1.0, max_iter=60), H, y)
    assert not found.converged
    assert found.iterations == 60
    assert np.isfinite(found.x).all()


@pytest.mark.parametrize("gain", [-3.0, -1e30])
def test_a_denoiser_that_diverges_gives_the_best_it_came_to(gain):
    H, y = problem(dtype=np.float32)
    calls = []

    def burst(image, sigma):
        calls.append(1)
        return wall(image, sigma) if len(calls) < 60 else gain * image

    spec = {"denoiser": burst, "sigma": 1.0, "strength": 1.0, "nonnegative": False, "tol": 1e-7}
    found = sg.solve(sg.ADMM(max_iter=400, **spec), H, y)
    assert not found.converged
    assert len(found.history["primal"]) == found.iterations
    calls.clear()
    before = sg.solve(sg.ADMM(max_iter=59, **spec), H, y)
    assert np.array_equal(found.x, before.x)
    if gain < -1e3:
        assert found.iterations < 100  # ended when the numbers left float32


def test_nothing_seen_and_nothing_to_see():
    H, y = problem()
    dark = sg.solve(sg.ADMM(denoiser="tv", sigma=1.0, strength=1.0), H, np.zeros_like(y))
    assert dark.converged
    assert not dark.x.any()
    blind = Dense(np.zeros((4, 100)), (10, 10))
    assert not sg.solve(sg.ADMM(denoiser="tv", sigma=1.0, strength=1.0), blind, np.ones(4)).x.any()


def test_threads_do_not_change_a_bit():
    cube = np.random.default_rng(0).random((4, 21, 18)).astype(np.float32)
    imager = sg.DualCASSI(cube_shape=cube.shape, wavelengths=(450, 650))
    H = imager.operator(sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0))
    y = H.forward(cube)
    found = []
    for count in (1, 3):
        with sg.threads(count):
            found.append(sg.solve(sg.ADMM(denoiser="tv", sigma=0.2, strength=0.01, max_iter=6), H, y))
    assert np.array_equal(found[0].x, found[1].x)
    assert found[0].history["primal"] == found[1].history["primal"]


@pytest.mark.parametrize(
    ("result", "message"),
    [
        (lambda image: np.full_like(image, np.nan), "the denoiser broken gave values that are not finite"),
        (lambda image: image[1:], r"real numbers of shape \(12, 15\), got an array of shape \(11, 15\)"),
        (lambda image: image[None], r"got an array of shape \(1, 12, 15\)"),
        (lambda image: image.astype(complex), "got an array of type complex128"),
        (lambda image: None, r"got an array of shape \(\)"),
    ],
)
def test_a_broken_denoiser_is_named(result, message):
    H, y = problem()

    def broken(image, sigma):
        return result(image)

    with pytest.raises(ValueError, match=message) as caught:
        sg.solve(sg.ADMM(denoiser=broken, sigma=1.0, strength=1.0), H, y)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("keywords", "error", "message"),
    [
        ({"denoiser": 3}, TypeError, "denoiser is a name or a callable .* got 3"),
        ({"sigma": 0}, ValueError, "sigma is a standard deviation above 0 .* got 0"),
        ({"sigma": (1.0, -1.0)}, ValueError, r"got \(1.0, -1.0\)"),
        ({"sigma": (1.0, 2.0, 3.0)}, ValueError, r"pair of them \(first, last\)"),
        ({"sigma": np.nan}, ValueError, "got nan"),
        ({"sigma": "1"}, ValueError, "got '1'"),
        ({"strength": 0.0}, ValueError, "strength is λ in the units of y² and must be above 0, got 0.0"),
        ({"strength": np.inf}, ValueError, "strength"),
        ({"max_iter": 0}, ValueError, "max_iter must be a whole number of at least 1, got 0"),
        ({"max_iter": 2.5}, ValueError, "got 2.5"),
        ({"schedule": 5}, ValueError, "there is one sigma only"),
        ({"sigma": (2.0, 1.0), "schedule": 0}, ValueError, "from 1 to max_iter = 100, got 0"),
        ({"sigma": (2.0, 1.0), "schedule": 101}, ValueError, "got 101"),
        ({"tol": 1}, ValueError, r"lie in \[0, 1\), got 1"),
    ],
)
def test_bad_settings_get_one_clear_sentence(keywords, error, message):
    with pytest.raises(error, match=message):
        sg.ADMM(**{"sigma": 1.0, "strength": 1.0, **keywords})


def test_bad_problems_get_one_clear_sentence():
    H, y = problem()
    spec = sg.ADMM(denoiser="tv", sigma=1.0, strength=1.0)
    with pytest.raises(ValueError, match=r"snapshots must have the shape \(90,\)"):
        sg.solve(spec, H, y[1:])
    with pytest.raises(ValueError, match="1 NaN"):
        sg.solve(spec, H, np.append(y[1:], np.nan))
    with pytest.raises(ValueError, match=r"images \(y, x\) or cubes \(band, y, x\), but the operator takes \(20,\)"):
        sg.solve(spec, dense(4, (20,)), np.zeros(4))
    with pytest.raises(ValueError, match="there is no denoiser 'nlm'"):
        sg.solve(sg.ADMM(denoiser="nlm", sigma=1.0, strength=1.0), H, y)
    with pytest.raises(ValueError, match="at least 8×8 pixels"):
        sg.solve(spec, dense(4, (5, 9)), np.zeros(4))
