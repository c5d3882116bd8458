"""The proximal map of total variation, against its definition."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import shadowgram as sg
from shadowgram.priors.tv import tv


def gradient(x):
    gy, gx = np.zeros_like(x), np.zeros_like(x)
    gy[:-1], gx[:, :-1] = np.diff(x, axis=0), np.diff(x, axis=1)
    return gx, gy


def divergence(px, py):
    """Minus the transpose of `gradient`, whose last column and row of differences are zero."""
    out = np.zeros_like(px)
    out[:, :-1] += px[:, :-1]
    out[:, 1:] -= px[:, :-1]
    out[:-1] += py[:-1]
    out[1:] -= py[:-1]
    return out


def objective(x, v, weight):
    gx, gy = gradient(x)
    return 0.5 * np.sum((x - v) ** 2) + weight * np.sqrt(gx**2 + gy**2).sum()


def chambolle_pock(v, weight, iterations):
    """An independent solution: accelerated primal-dual, algorithm 2 of Chambolle & Pock (2011), in NumPy."""
    x = bar = v.copy()
    px, py = np.zeros_like(v), np.zeros_like(v)
    tau = sigma = 8**-0.5
    for _ in range(iterations):
        gx, gy = gradient(bar)
        px, py = px + sigma * gx, py + sigma * gy
        size = np.maximum(1.0, np.sqrt(px**2 + py**2) / weight)
        px, py = px / size, py / size
        before = x
        x = (x + tau * divergence(px, py) + tau * v) / (1 + tau)
        theta = 1 / np.sqrt(1 + 2 * tau)
        tau, sigma = theta * tau, sigma / theta
        bar = x + theta * (x - before)
    return x


def noisy_step(shape=(24, 31), seed=0):
    rng = np.random.default_rng(seed)
    return np.where(np.arange(shape[1]) < 12, 0.2, 0.9) + 0.1 * rng.standard_normal(shape)


@pytest.mark.parametrize("weight", [0.02, 0.15, 1.0])
def test_equals_an_independent_primal_dual_run(weight):
    v = noisy_step()
    expected = chambolle_pock(v, weight, 5000)
    assert np.abs(tv(v, weight, tol=1e-8, max_iter=20_000) - expected).max() < 2e-4


def test_no_perturbation_lowers_the_objective():
    v, weight, rng = noisy_step(), 0.1, np.random.default_rng(1)
    x = tv(v, weight, tol=1e-7, max_iter=20_000)
    reached = objective(x, v, weight)
    for size in (1e-1, 1e-2, 1e-3):
        for _ in range(20):
            assert objective(x + size * rng.standard_normal(v.shape), v, weight) > reached
        assert objective(x + size * (v - x), v, weight) > reached
        assert objective((1 - size) * x + size * x.mean(), v, weight) > reached


@pytest.mark.parametrize("tol", [1e-2, 1e-4, 1e-6])
def test_the_gap_that_it_stops_at_bounds_the_error(tol):
    v, weight = noisy_step(), 0.2
    expected = chambolle_pock(v, weight, 5000)
    error = 0.5 * np.sum((tv(v, weight, tol=tol) - expected) ** 2)
    assert error <= 1.01 * tol * 0.5 * np.sum((v - v.mean()) ** 2)


def test_a_step_in_one_dimension_has_a_closed_form():
    # Two plateaus of n pixels move towards each other by weight / n each.
    v = np.repeat([0.0, 1.0], 8)[None]
    assert np.allclose(tv(v, 0.4, tol=1e-10), np.repeat([0.05, 0.95], 8)[None], atol=1e-5)
    assert np.allclose(tv(v, 100.0, tol=1e-10, max_iter=20_000), 0.5, atol=1e-4)


def test_is_isotropic_under_transposition_and_odd_under_sign():
    v = noisy_step()
    x = tv(v, 0.1, tol=1e-8, max_iter=20_000)
    assert np.allclose(tv(v.T.copy(), 0.1, tol=1e-8, max_iter=20_000), x.T, atol=1e-5)
    assert np.allclose(tv(-v, 0.1, tol=1e-8, max_iter=20_000), -x, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(
    arrays.arrays(np.float64, arrays.array_shapes(min_dims=2, max_dims=2, max_side=9), elements=st.floats(-5, 5)),
    st.floats(0, 3),
    st.floats(-1e3, 1e3),
)
def test_keeps_the_mean_and_follows_an_offset(v, weight, offset):
    x = tv(v, weight, tol=1e-6, max_iter=50_000)
    assert x.mean() == pytest.approx(v.mean(), abs=1e-9)
    assert x.min() >= v.min() - 0.05 * np.ptp(v) - 1e-9
    scale = np.linalg.norm(v - v.mean())
    assert np.linalg.norm(tv(v + offset, weight, tol=1e-6, max_iter=50_000) - offset - x) <= 3e-3 * scale + 1e-9


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (7, 9)])
def test_weight_zero_and_constant_images_change_nothing(shape):
    v = np.random.default_rng(0).random(shape, np.float32)
    assert np.allclose(tv(v, 0), v, rtol=0, atol=1e-6)
    assert np.array_equal(tv(np.full(shape, 3.7, np.float32), 2.0), np.full(shape, 3.7, np.float32))


def test_a_stack_is_its_images_one_by_one_for_any_number_of_threads():
    rng = np.random.default_rng(2)
    stack, weights = rng.random((5, 17, 23), np.float32), np.array([0.0, 0.05, 0.1, 0.2, 0.4])
    with sg.threads(1):
        one = tv(stack, weights)
    with sg.threads(3):
        assert np.array_equal(tv(stack, weights), one)
    for image, weight, expected in zip(stack, weights, one, strict=True):
        assert np.array_equal(tv(image, weight), expected)
    assert one.dtype == np.float32
    assert tv(stack.astype(np.float64), 0.1).dtype == np.float64
    assert tv((255 * stack).astype(np.uint8), 10).dtype == np.float32


def test_a_warm_start_is_done_at_once():
    v = noisy_step()
    dual = np.zeros((2, *v.shape))
    x = tv(v, 0.2, tol=1e-6, dual=dual)
    assert dual.any()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.allclose(tv(v, 0.2, tol=1e-6, max_iter=1, dual=dual), x, atol=1e-3)
    duals = np.zeros((1, 2, *v.shape))
    assert np.array_equal(tv(v[None], 0.2, tol=1e-6, dual=duals)[0], x)


def test_says_when_it_did_not_converge():
    with pytest.warns(RuntimeWarning, match="1 of 1 images had not converged after 3 iterations"):
        tv(noisy_step(), 0.5, max_iter=3)


@pytest.mark.parametrize(
    ("image", "keywords", "error", "message"),
    [
        (np.ones(4), {}, ValueError, r"image \(y, x\) or a stack"),
        (np.ones((0, 4)), {}, ValueError, r"got the shape \(0, 4\)"),
        (np.ones((4, 4), complex), {}, TypeError, "real numbers"),
        (np.full((4, 4), np.nan), {}, ValueError, "finite"),
        (np.ones((4, 4)), {"weight": -1}, ValueError, "0 or more, got -1"),
        (np.ones((4, 4)), {"weight": [1, 2]}, ValueError, "one for each of 1 images"),
        (np.ones((4, 4)), {"tol": 0}, ValueError, "tol"),
        (np.ones((4, 4)), {"max_iter": 0}, ValueError, "max_iter"),
        (np.ones((4, 4)), {"dual": np.zeros((2, 4, 5))}, ValueError, r"dual of shape \(2, 4, 4\)"),
        (np.ones((4, 4)), {"dual": np.zeros((2, 4, 4), np.float32)}, ValueError, "float64"),
    ],
)
def test_bad_input_gets_one_clear_sentence(image, keywords, error, message):
    with pytest.raises(error, match=message):
        tv(image, **{"weight": 0.1, **keywords})
