"""GAP-TV against its equations and its limit, what noise does to it; and what it has in common with ADMM-TV."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import shadowgram as sg
from shadowgram.operators import as_matrix
from shadowgram.operators.base import LinearOperator
from shadowgram.operators.structure import shot_gram


@dataclass(frozen=True, eq=False)
class Times(LinearOperator):
    """A multiple of another operator, whose Gram matrices are not known."""

    of: LinearOperator
    factor: float = 1.0

    @property
    def in_shape(self):
        return self.of.in_shape

    @property
    def out_shape(self):
        return self.of.out_shape

    def _forward(self, x, out):
        self.of._forward(x, out)
        out *= self.factor

    def _adjoint(self, y, out):
        self.of._adjoint(y, out)
        out *= self.factor


def scene(shape=(4, 24, 28), dtype=np.float64):
    """Two rectangles with smooth spectra."""
    bands, rows, columns = shape
    y, x = np.mgrid[:rows, :columns] / min(rows, columns)
    k = np.linspace(0, 1, bands)[:, None, None]
    cube = 0.3 + 0.2 * k + 0 * x
    cube = np.where((y > 0.2) & (y < 0.6) & (x > 0.1) & (x < 0.5), 0.9 - 0.6 * k, cube)
    return np.where((y > 0.5) & (x > 0.7), 0.1 + 0.7 * np.sin(3 * k), cube).astype(dtype)


def problem(imager=sg.DualCASSI, shape=(4, 24, 28), shots=2, noise=0.0, dtype=np.float64):
    if imager is sg.SSCSI:
        device = sg.SSCSI(
            detector_shape=shape[1:], detector_pitch=10.0, code_pitch=10.0, mask_position=shape[0] / shape[2],
            wavelengths=(450, 650),
        )  # fmt: skip
    else:
        device = imager(cube_shape=shape, wavelengths=(450, 650))
    H = device.operator(sg.codes.random(shots=shots, shape=device.code_shape, seed=0))
    cube = scene(H.in_shape, dtype)
    y = H.forward(cube)
    return H, cube, (y + noise * np.random.default_rng(0).standard_normal(y.shape)).astype(dtype)


def differences(x):
    """Forward differences along x and y, none across the last column and row: (..., 2, y, x)."""
    d = np.zeros((*x.shape[:-2], 2, *x.shape[-2:]))
    d[..., 0, :, :-1] = np.diff(x, axis=-1)
    d[..., 1, :-1, :] = np.diff(x, axis=-2)
    return d


def differences_adjoint(p):
    x = np.zeros((*p.shape[:-3], *p.shape[-2:]))
    x[..., :, 1:] += p[..., 0, :, :-1]
    x[..., :, :-1] -= p[..., 0, :, :-1]
    x[..., 1:, :] += p[..., 1, :-1, :]
    x[..., :-1, :] -= p[..., 1, :-1, :]
    return x


def variation(x):
    return np.sqrt((differences(x) ** 2).sum(axis=-3)).sum()


def shorten(p, weight):
    """Projection on |p| ≤ weight at every pixel."""
    return p / np.maximum(1, np.sqrt((p**2).sum(axis=-3, keepdims=True)) / weight)


def denoised(v, p, weight, steps, least=-np.inf):
    """Projected gradients on the dual of ½‖x − v‖² + weight·TV(x), x ≥ least."""
    for _ in range(steps):
        p = shorten(p + differences(np.maximum(v - differences_adjoint(p), least)) / 8, weight)
    return np.maximum(v - differences_adjoint(p), least), p


def scale_of(H, y):
    return np.sqrt((y**2).sum() / (H.forward(np.ones(H.in_shape)) ** 2).sum())


def reference(H, y, spec, iterations):
    """Alternating projection with matrices, from the equations."""
    A, shape, scale = as_matrix(H), H.in_shape, scale_of(H, y)
    gram = A @ A.T
    gram += 1e-3 * np.trace(gram) / len(gram) * np.eye(len(gram))
    z, p, b = np.zeros(shape), np.zeros((shape[0], 2, *shape[1:])), 0.0
    y = y.ravel() / scale
    for _ in range(iterations):
        b = b + (y - A @ z.ravel()) if spec.accelerate else y
        x = z + (A.T @ np.linalg.solve(gram, b - A @ z.ravel())).reshape(shape)
        z, p = denoised(x, p, spec.weight, spec.tv_iterations)
    return scale * z


@pytest.mark.parametrize("shape", [(3, 6, 8), (2, 7, 9), (4, 9, 6)])
@pytest.mark.parametrize("imager", [sg.CASSI, sg.DualCASSI, sg.SSCSI])
def test_iterates_are_those_of_the_equations(imager, shape):
    H, _, y = problem(imager, shape)
    for spec in (
        sg.GAPTV(max_iter=1, tol=0),
        sg.GAPTV(max_iter=9, tol=0, weight=0.1, tv_iterations=5),
        sg.GAPTV(max_iter=9, tol=0, weight=0.2, tv_iterations=1, accelerate=False),
    ):
        found = sg.solve(spec, H, y)
        expected = reference(H, y, spec, spec.max_iter)
        np.testing.assert_allclose(found.x, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_the_limit_is_the_least_variation_that_explains_the_snapshots():
    """Against Chambolle and Pock's primal-dual iteration with projections on Hx = y."""
    H, _, y = problem(shape=(2, 8, 9), shots=1)
    A = as_matrix(H)
    inverse = np.linalg.pinv(A)
    x = (inverse @ y.ravel()).reshape(H.in_shape)
    bar, p = x, np.zeros((2, 2, 8, 9))
    for _ in range(4000):
        p = shorten(p + 0.35 * differences(bar), 1.0)
        new = x - 0.35 * differences_adjoint(p)
        new = new - (inverse @ (A @ new.ravel() - y.ravel())).reshape(H.in_shape)
        x, bar = new, 2 * new - x
    with sg.threads(1):
        found = sg.solve(sg.GAPTV(max_iter=3000, tol=0), H, y)
    assert found.history["residual"][-1] < 1e-4 * np.linalg.norm(y)
    assert variation(found.x) == pytest.approx(variation(x), rel=1e-3)
    start = (inverse @ y.ravel()).reshape(H.in_shape)
    assert variation(start) > 1.2 * variation(x)


def test_without_acceleration_the_limit_minimises_what_it_says():
    """Against the primal-dual iteration, by its objective."""
    H, _, y = problem(shape=(2, 8, 9), noise=0.05)
    weight = 0.1
    A, scale = as_matrix(H), scale_of(H, y)
    gram = A @ A.T
    inverse = np.linalg.inv(gram + 1e-3 * np.trace(gram) / len(gram) * np.eye(len(gram)))
    seen, hessian = y.ravel() / scale, A.T @ inverse @ A
    step = np.linalg.inv(np.eye(A.shape[1]) + 0.35 * hessian)
    x = bar = np.zeros(H.in_shape)
    p = np.zeros((2, 2, 8, 9))
    for _ in range(2000):
        p = shorten(p + 0.35 * differences(bar), weight)
        v = (x - 0.35 * differences_adjoint(p)).ravel() + 0.35 * (A.T @ inverse @ seen)
        new = (step @ v).reshape(x.shape)
        x, bar = new, 2 * new - x

    def objective(x):
        rest = A @ x.ravel() - seen
        return 0.5 * rest @ inverse @ rest + weight * variation(x)

    with sg.threads(1):
        found = sg.solve(sg.GAPTV(weight=weight, accelerate=False, max_iter=2000, tol=1e-10), H, y)
    assert objective(found.x / scale) == pytest.approx(objective(x), rel=1e-6)
    np.testing.assert_allclose(found.x / scale, x, atol=1e-3)


def test_noise_makes_it_better_and_then_worse():
    H, cube, y = problem(sg.DualCASSI, shape=(6, 48, 48), shots=4, noise=0.1, dtype=np.float32)
    seen = [sg.solve(sg.GAPTV(max_iter=k, tol=0), H, y) for k in (1, 2, 4, 8, 16, 32, 64, 128, 256)]
    quality = [sg.metrics.psnr(one.x, cube, peak=1.0) for one in seen]
    best = int(np.argmax(quality))
    assert 0 < best < 6
    assert quality[0] < quality[best] - 1
    assert quality[-1] < quality[best] - 1
    # It has fitted the noise, but for what the shots say of each other where they saw the same.
    assert seen[-1].history["residual"][-1] < 0.3 * np.linalg.norm(y - H.forward(cube))
    for spec in (sg.GAPTV(accelerate=False, max_iter=256, tol=0), sg.ADMMTV()):
        assert sg.metrics.psnr(sg.solve(spec, H, y).x, cube, peak=1.0) > quality[-1] + 1


BOTH = [sg.GAPTV, sg.ADMMTV]


@pytest.mark.parametrize("kind", BOTH)
class TestBandByBand:
    def test_a_scene_of_flat_parts_is_found(self, kind):
        H, cube, y = problem(shots=3, dtype=np.float32)
        found = sg.solve(kind(), H, y)
        assert found.converged
        assert sg.metrics.psnr(found.x, cube, peak=1.0) > 30

    def test_units_of_light_and_of_the_operator_do_not_matter(self, kind):
        H, _, y = problem(noise=0.02, dtype=np.float32)
        x = sg.solve(kind(), H, y).x
        for factor in (1000, 1e-20):
            other = sg.solve(kind(), H, y * np.float32(factor)).x / np.float32(factor)
            assert np.abs(other - x).max() < 1e-4 * x.max()
        weak = sg.solve(kind(max_iter=20, tol=0), Times(H, 0.01), y * np.float32(0.01)).x
        assert np.abs(weak - sg.solve(kind(max_iter=20, tol=0), H, y).x).max() < 2e-2 * x.max()

    def test_conjugate_gradients_lead_to_the_same_cube(self, kind):
        H, _, y = problem(shots=3)
        assert shot_gram(H) is not None
        assert shot_gram(Times(H)) is None
        direct, iterative = sg.solve(kind(), H, y), sg.solve(kind(), Times(H), y)
        assert iterative.converged
        assert sg.metrics.psnr(iterative.x, direct.x, peak=1.0) > 50

    def test_dtype_follows_the_snapshots(self, kind):
        H, _, y = problem()
        single, double = (sg.solve(kind(max_iter=30, tol=0), H, y.astype(d)).x for d in (np.float32, np.float64))
        assert (single.dtype, double.dtype) == (np.float32, np.float64)
        assert np.abs(single - double).max() < 1e-3

    def test_threads_do_not_change_a_bit(self, kind):
        H, _, y = problem(shape=(5, 40, 30), noise=0.02, dtype=np.float32)
        found = []
        for count in (1, 2, 5):
            with sg.threads(count):
                found.append(sg.solve(kind(max_iter=12), H, y))
        for other in found[1:]:
            assert np.array_equal(other.x, found[0].x)
            assert other.history["residual"] == found[0].history["residual"]
            assert other.history["change"] == found[0].history["change"]

    @settings(max_examples=20, deadline=None)
    @given(
        st.tuples(st.integers(1, 5), st.integers(1, 9), st.integers(1, 9)),
        st.integers(1, 3),
        st.sampled_from([sg.CASSI, sg.DualCASSI]),
        st.sampled_from([np.float32, np.float64]),
    )
    def test_any_shape_gives_a_finite_cube(self, kind, shape, shots, imager, dtype):
        H, _, y = problem(imager, shape, shots, 0.02, dtype)
        found = sg.solve(kind(max_iter=10), H, y)
        assert found.x.shape == shape
        assert found.x.dtype == dtype
        assert np.isfinite(found.x).all()

    def test_the_history_is_true(self, kind):
        H, _, y = problem(noise=0.02)
        kept, said = y.copy(), []
        found = sg.solve(kind(), H, y, callback=lambda i, values: said.append((i, values)))
        np.testing.assert_array_equal(y, kept)
        assert {"residual", "change", "seconds"} <= set(found.history)
        assert all(len(values) == found.iterations for values in found.history.values())
        assert [i for i, _ in said] == list(range(1, found.iterations + 1))
        assert said[-1][1] == {name: values[-1] for name, values in found.history.items()}
        assert found.history["residual"][-1] == pytest.approx(np.linalg.norm(H.forward(found.x) - y), rel=1e-9)
        assert found.history["change"][-1] < kind().tol
        stopped, before = (sg.solve(kind(max_iter=k), H, y) for k in (7, 6))
        assert (stopped.converged, stopped.iterations) == (False, 7)
        assert stopped.history["residual"] == found.history["residual"][:7]
        change = np.linalg.norm(stopped.x - before.x) / np.linalg.norm(stopped.x)
        assert stopped.history["change"][-1] == pytest.approx(change, rel=1e-9)

    def test_an_interrupt_returns_the_estimate_so_far(self, kind):
        H, _, y = problem()

        def stop(iteration, _):
            if iteration == 7:
                raise KeyboardInterrupt

        found = sg.solve(kind(), H, y, callback=stop)
        assert (found.interrupted, found.converged, found.iterations) == (True, False, 7)
        assert np.array_equal(found.x, sg.solve(kind(max_iter=7), H, y).x)

    def test_nothing_seen_is_nothing_reconstructed(self, kind):
        H, _, y = problem()
        dark = sg.solve(kind(), H, np.zeros_like(y))
        assert dark.converged
        assert not dark.x.any()
        device = sg.DualCASSI(cube_shape=H.in_shape, wavelengths=(450, 650))
        closed = device.operator(np.zeros((2, *device.code_shape)))
        assert not sg.solve(kind(), closed, y).x.any()

    @pytest.mark.parametrize(
        ("keywords", "message"),
        [
            ({"weight": 0.0}, "weight must be above 0"),
            ({"weight": float("nan")}, "weight must be above 0"),
            ({"tv_iterations": 0}, "tv_iterations must be a whole number"),
            ({"max_iter": 2.5}, "max_iter must be a whole number"),
            ({"tol": 1.0}, "tol is a relative change"),
        ],
    )
    def test_settings_are_checked(self, kind, keywords, message):
        with pytest.raises(ValueError, match=f"{kind.__name__}: {message}"):
            kind(**keywords)

    def test_snapshots_are_checked(self, kind):
        H, _, y = problem()
        with pytest.raises(ValueError, match="shape"):
            sg.solve(kind(), H, y[:1])
        with pytest.raises(ValueError, match="NaN"):
            sg.solve(kind(), H, np.full_like(y, np.nan))
        with pytest.raises(ValueError, match=rf"{kind.__name__} reconstructs cubes \(band, y, x\)"):
            sg.solve(kind(), Flat(), np.ones((4, 4)))


class Flat(LinearOperator):
    """Takes and gives images."""

    in_shape = (4, 4)
    out_shape = (4, 4)

    def _forward(self, x, out):
        out[:] = x

    def _adjoint(self, y, out):
        out[:] = y
