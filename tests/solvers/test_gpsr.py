"""GPSR against a dense solver and the conditions of optimality, its path, debiasing and the search over τ."""

from dataclasses import dataclass

import numpy as np
import pytest
import scipy.io

import shadowgram as sg
from shadowgram.operators import as_matrix, basis
from shadowgram.operators.base import LinearOperator
from shadowgram.solvers._sparse import path
from shadowgram.solvers.tau_search import search_tau


@dataclass(frozen=True, eq=False)
class Dense(LinearOperator):
    """A matrix, as an operator on cubes of a shape."""

    matrix: np.ndarray
    shape: tuple[int, ...]

    @property
    def in_shape(self):
        return self.shape

    @property
    def out_shape(self):
        return (1, 1, len(self.matrix))

    def _forward(self, x, out):
        out[:] = (self.matrix.astype(x.dtype) @ x.ravel()).reshape(out.shape)

    def _adjoint(self, y, out):
        out[:] = (self.matrix.T.astype(y.dtype) @ y.ravel()).reshape(out.shape)


def coordinate_descent(A, y, tau, sweeps=3000):
    """min ½‖y − Aθ‖² + τ‖θ‖₁, one coordinate after the other: nothing in common with gradient projection."""
    theta, residual, squares = np.zeros(A.shape[1]), y.copy(), (A**2).sum(axis=0)
    for _ in range(sweeps):
        for i in range(len(theta)):
            free = theta[i] + A[:, i] @ residual / squares[i]
            new = np.sign(free) * max(abs(free) - tau / squares[i], 0.0)
            residual -= A[:, i] * (new - theta[i])
            theta[i] = new
    return theta, 0.5 * residual @ residual + tau * np.abs(theta).sum()


def dense_problem(seed=0, rows=40, shape=(2, 4, 8)):
    rng = np.random.default_rng(seed)
    H = Dense(rng.standard_normal((rows, int(np.prod(shape)))), shape)
    theta = np.zeros(shape)
    theta.ravel()[rng.choice(theta.size, 8, replace=False)] = rng.standard_normal(8)
    psi = basis("dct-sym8", shape, levels=1)
    y = H.forward(psi.forward(theta)) + 0.05 * rng.standard_normal(H.out_shape)
    return H, psi, y


@pytest.mark.parametrize("solver", [sg.GPSR, sg.FISTA])
@pytest.mark.parametrize("tau", [0.3, 1e-2, 1e-3])
def test_agrees_with_coordinate_descent(solver, tau):
    H, psi, y = dense_problem()
    A = H.matrix @ as_matrix(psi)
    weight = tau * np.abs(A.T @ y.ravel()).max()
    expected, objective = coordinate_descent(A, y.ravel(), weight)
    found = sg.solve(solver(basis=psi, tau=tau, max_iter=20_000, tol=1e-13), H, y)
    assert found.converged
    assert found.history["tau"][-1] == pytest.approx(weight, rel=1e-12)
    assert found.history["objective"][-1] == pytest.approx(objective, rel=1e-8)
    np.testing.assert_allclose(psi.adjoint(found.x).ravel(), expected, atol=2e-4)


def imager_problem(cube_shape=(4, 24, 20), shots=2, dtype=np.float64):
    imager = sg.DualCASSI(cube_shape=cube_shape, wavelengths=(450, 650))
    H = imager.operator(sg.codes.boolean(shots=shots, shape=imager.code_shape, seed=0))
    cube = sg.scenes.chart(size=max(cube_shape[1:]), bands=cube_shape[0], seed=0).values
    cube = cube[:, : cube_shape[1], : cube_shape[2]].astype(dtype)
    return H, cube, H.forward(cube)


@pytest.mark.parametrize("cube_shape", [(4, 32, 32), (4, 21, 26)])  # the second is padded
def test_meets_the_conditions_of_optimality(cube_shape):
    """|ΨᵀHᵀ(y − HΨθ)| ≤ τ, with equality and the sign of θ on the support."""
    H, _, y = imager_problem(cube_shape)
    found = sg.solve(sg.GPSR(tau=1e-2, max_iter=5000, tol=1e-12), H, y)
    assert found.converged
    psi = basis("dct-sym8", H.in_shape)
    tau = found.history["tau"][-1]
    pull = psi.adjoint(H.adjoint(y - H.forward(found.x))) / tau
    assert np.abs(pull).max() < 1 + 1e-3
    if psi.in_shape == psi.out_shape:  # else θ cannot be read off its cube
        theta = psi.adjoint(found.x)
        support = np.abs(theta) > 1e-4 * np.abs(theta).max()
        np.testing.assert_allclose(pull[support], np.sign(theta[support]), atol=1e-3)


@pytest.mark.parametrize("tau", [1e-2, 1e-3])
def test_agrees_with_fista(tau):
    H, _, y = imager_problem()
    settings = {"tau": tau, "max_iter": 5000, "tol": 1e-9}
    gpsr, fista = sg.solve(sg.GPSR(**settings), H, y), sg.solve(sg.FISTA(**settings), H, y)
    assert gpsr.converged
    assert fista.converged
    assert gpsr.history["objective"][-1] == pytest.approx(fista.history["objective"][-1], rel=1e-5)


def test_float32_finds_the_same_objective():
    H, _, y = imager_problem()
    double, single = (sg.solve(sg.GPSR(tau=1e-3), H, y.astype(kind)) for kind in (np.float64, np.float32))
    assert single.history["objective"][-1] == pytest.approx(double.history["objective"][-1], rel=2e-3)


def test_objective_falls_while_tau_stays():
    H, _, y = imager_problem()
    history = sg.solve(sg.GPSR(tau=1e-4, max_iter=100, tol=0), H, y).history
    objective, tau = np.array(history["objective"]), np.array(history["tau"])
    same = np.diff(tau) == 0
    assert same.sum() > 50
    assert (np.diff(objective)[same] <= 1e-12 * objective[1:][same]).all()


def test_units_of_the_operator_do_not_matter():
    H, psi, y = dense_problem()
    tiny = Dense(1e-4 * H.matrix, H.shape)
    one, other = (sg.solve(sg.GPSR(basis=psi, tau=1e-2), A, A.matrix @ np.ones(64) + 0 * y) for A in (H, tiny))
    assert one.iterations == other.iterations
    np.testing.assert_allclose(one.x, other.x, atol=1e-6)


def test_warm_path_needs_fewer_iterations_than_a_cold_start():
    H, _, y = imager_problem((8, 64, 64), dtype=np.float32)
    settings = {"tau": 1e-5, "max_iter": 3000, "tol": 1e-5}
    warm, cold = (sg.solve(sg.GPSR(continuation=c, **settings), H, y) for c in (0.4, 1.0))
    assert warm.converged
    assert warm.history["objective"][-1] <= 1.01 * cold.history["objective"][-1]
    assert warm.iterations < cold.iterations
    taus = warm.history["tau"]
    assert sorted(taus, reverse=True) == taus
    assert len(set(taus)) > 5
    assert len(set(cold.history["tau"])) == 1


def test_last_tau_keeps_half_of_the_iterations():
    H, _, y = imager_problem()
    taus = sg.solve(sg.GPSR(tau=1e-5, max_iter=30, tol=0), H, y).history["tau"]
    assert len(taus) == 30
    assert taus.count(min(taus)) >= 15


def test_path_ends_at_tau_and_starts_below_the_largest():
    assert path(0.5, 1.0, 0.4) == [0.5]
    assert path(1e-3, 1.0, 1.0) == [1e-3]
    found = path(1e-3, 1.0, 0.5)
    assert found[-1] == 1e-3
    assert 0.5 <= found[0] <= 1
    np.testing.assert_allclose(np.divide(found[1:], found[:-1]), 0.5)
    assert path(1e-3, 2e-3, 0.4) == [1e-3]


def test_debiasing_is_least_squares_on_the_support():
    H, psi, y = dense_problem()
    A = H.matrix @ as_matrix(psi)
    plain = sg.solve(sg.GPSR(basis=psi, tau=0.05, max_iter=2000, tol=1e-10), H, y)
    debiased = sg.solve(sg.GPSR(basis=psi, tau=0.05, max_iter=2000, tol=1e-10, debias=True), H, y)
    support = np.flatnonzero(np.abs(psi.adjoint(plain.x)) > 1e-10)
    assert 0 < len(support) < 40
    best = np.linalg.lstsq(A[:, support], y.ravel())[0]
    theta = psi.adjoint(debiased.x).ravel()
    np.testing.assert_allclose(np.delete(theta, support), 0, atol=1e-10)
    least = np.linalg.norm(A[:, support] @ best - y.ravel())
    assert debiased.converged
    # Conjugate gradients stop at 1 % of the gradient.
    assert debiased.history["residual"][-1] == pytest.approx(least, rel=1e-2)
    assert plain.history["residual"][-1] > 1.05 * least
    assert debiased.history["tau"][-1] == 0
    assert debiased.iterations > plain.iterations


def test_search_keeps_the_best_and_says_what_it_tried():
    H, cube, y = imager_problem((6, 32, 32))
    y = sg.noise.awgn(y, snr_db=25, seed=0)
    seen = []

    def score(x):
        seen.append(sg.metrics.psnr(x, cube, peak=1.0))
        return seen[-1]

    best, table = search_tau(sg.GPSR(), H, y, score, taus=(1e-4, 0.1, 1e-2, 3e-2, 1e-3, 1e-5, 3e-3))
    assert best.tau_search == table
    tried = [trial.tau for trial in table]
    assert tried == sorted(tried, reverse=True)
    assert [trial.score for trial in table] == seen
    assert sg.metrics.psnr(best.x, cube, peak=1.0) == max(seen)
    assert max(seen) > seen[0] + 1
    assert max(seen) > seen[-1] + 0.5
    assert len(table) == seen.index(max(seen)) + 3 < 7  # ended after two that were worse
    assert best.iterations == sum(trial.iterations for trial in table)


def test_search_costs_little_more_than_one_run():
    H, cube, y = imager_problem((6, 32, 32))
    best, table = search_tau(sg.GPSR(), H, y, lambda x: sg.metrics.psnr(x, cube, peak=1.0))
    alone = sg.solve(sg.GPSR(tau=table[-1].tau, max_iter=1000), H, y)
    assert best.iterations < 4 * alone.iterations


def test_interrupted_search_gives_the_best_so_far():
    H, cube, y = imager_problem()
    scores = []

    def score(x):
        scores.append(sg.metrics.psnr(x, cube, peak=1.0))
        if len(scores) == 3:
            raise KeyboardInterrupt
        return scores[-1]

    best, table = search_tau(sg.GPSR(), H, y, score, taus=(1e-1, 1e-2, 1e-3))
    assert best.interrupted
    assert len(table) == 2
    assert sg.metrics.psnr(best.x, cube, peak=1.0) == max(scores[:2])

    def interrupt(iteration, values):
        raise KeyboardInterrupt

    none, table = search_tau(sg.GPSR(), H, y, score, callback=interrupt)
    assert none.interrupted
    assert table == ()
    assert none.x.shape == H.in_shape


def test_search_refuses_what_it_cannot_do():
    H, _, y = imager_problem()
    with pytest.raises(ValueError, match="at least one tau"):
        search_tau(sg.GPSR(), H, y, np.sum, taus=())
    with pytest.raises(ValueError, match="set debias=False"):
        search_tau(sg.GPSR(debias=True), H, y, np.sum)
    with pytest.raises(ValueError, match="tau is relative"):
        search_tau(sg.GPSR(), H, y, np.sum, taus=(1e-3, 2.0))


def test_continuation_is_checked():
    for continuation in (0, 1.5, -0.4):
        with pytest.raises(ValueError, match=r"continuation must lie in \(0, 1\]"):
            sg.GPSR(continuation=continuation)


def test_reconstructs_a_real_cube(data):
    """Lego scene, 3 boolean shots, measured with the same model: 30.0 dB here, and 30.4 at the best τ."""
    path_of_cube = data / "uis_lego" / "lego.mat"
    if not path_of_cube.is_file():
        pytest.skip(f"{path_of_cube} not found")
    cube = np.moveaxis(scipy.io.loadmat(path_of_cube)["hyperimg"], 2, 0).astype(np.float32) / 255
    imager = sg.SSCSI(
        detector_shape=(256, 256), detector_pitch=10.0, code_pitch=10.0, mask_position=0.09375, wavelengths=(451, 642),
        shear="edge",
    )  # fmt: skip
    H = imager.operator(sg.codes.boolean(shots=3, shape=imager.code_shape, seed=0))
    found = sg.solve(sg.GPSR(tau=1e-4), H, H.forward(cube))
    assert found.converged
    assert sg.metrics.psnr(found.x, cube, peak=1.0) > 29.5
