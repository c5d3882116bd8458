"""FISTA: its steps, its restart, and where it stops. Agreement with GPSR and with a dense solver is tested in test_gpsr.py."""

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.operators import norm
from shadowgram.solvers import _sparse_kernels as kernels


def problem(dtype=np.float64):
    imager = sg.DualCASSI(cube_shape=(4, 32, 32), wavelengths=(450, 650))
    H = imager.operator(sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0))
    return H, H.forward(sg.scenes.chart(size=32, bands=4, seed=0).values.astype(dtype))


def test_first_iteration_is_a_soft_threshold_of_the_back_projection():
    H, y = problem()
    found = sg.solve(sg.FISTA(tau=0.05, max_iter=1), H, y)
    psi = sg.operators.basis("dct-sym8", H.in_shape)
    back = psi.adjoint(H.adjoint(y))
    weight, step = 0.05 * np.abs(back).max(), 1 / (1.02 * norm(H) ** 2)
    expected = np.sign(back) * np.maximum(step * np.abs(back) - step * weight, 0)
    np.testing.assert_allclose(psi.adjoint(found.x), expected, atol=1e-12)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_soft_threshold_is_the_proximal_map(dtype):
    """It minimises ½(t − v)² + w|t|, checked against a fine grid of t."""
    v = np.linspace(-2, 2, 401).astype(dtype)
    zero, out, sums = np.zeros_like(v), np.zeros_like(v), np.zeros((1, 2))
    kernels.fista_step(0, 1, zero, out, -v, dtype(0), dtype(1), dtype(0.5), sums)
    grid = np.linspace(-2, 2, 4001)
    cost = 0.5 * (grid[:, None] - v) ** 2 + 0.5 * np.abs(grid)[:, None]
    np.testing.assert_allclose(out, grid[cost.argmin(axis=0)], atol=1.1e-3)
    np.testing.assert_allclose(sums[0], [np.abs(out).sum(), np.count_nonzero(out)], rtol=1e-6)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_objective_never_rises(dtype):
    H, y = problem(dtype)
    objective = sg.solve(sg.FISTA(tau=1e-3, max_iter=300, tol=0), H, y).history["objective"]
    assert len(objective) > 100
    assert (np.diff(objective) <= 0).all()


def test_restarts_where_momentum_overshoots():
    """A refused step repeats the objective in the history; at this τ there is at least one before convergence."""
    H, y = problem()
    found = sg.solve(sg.FISTA(tau=1e-2, max_iter=1000, tol=1e-9), H, y)
    assert found.converged
    assert (np.diff(found.history["objective"]) == 0).sum() >= 1


def test_converges_faster_than_plain_steps():
    """Without momentum (ISTA) the same number of iterations ends much further above the minimum."""
    H, y = problem()
    found = sg.solve(sg.FISTA(tau=1e-4, max_iter=60, tol=0), H, y)
    psi = sg.operators.basis("dct-sym8", H.in_shape)
    theta, weight, step = np.zeros(psi.in_shape), found.history["tau"][-1], 1 / (1.02 * norm(H) ** 2)
    for _ in range(60):
        theta = theta - step * psi.adjoint(H.adjoint(H.forward(psi.forward(theta)) - y))
        theta = np.sign(theta) * np.maximum(np.abs(theta) - step * weight, 0)
    residual = H.forward(psi.forward(theta)) - y
    plain = 0.5 * np.vdot(residual, residual) + weight * np.abs(theta).sum()
    least = sg.solve(sg.FISTA(tau=1e-4, max_iter=3000, tol=1e-10), H, y).history["objective"][-1]
    assert 0 < found.history["objective"][-1] - least < 0.4 * (plain - least)
