"""`solve`, what it refuses, and what every solver gives back."""

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.solvers.solution import check_problem


def small_problem(dtype=np.float32):
    imager = sg.DualCASSI(cube_shape=(3, 16, 16), wavelengths=(450, 650))
    H = imager.operator(sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0))
    return H, H.forward(np.random.default_rng(0).random(H.in_shape).astype(dtype))


SOLVERS = [sg.GPSR(max_iter=8), sg.FISTA(max_iter=8), sg.TwIST(max_iter=8)]


@pytest.mark.parametrize("solver", SOLVERS, ids=lambda s: type(s).__name__)
class TestEverySparseSolver:
    def test_dtype_follows_the_snapshots(self, solver):
        H, y = small_problem()
        assert sg.solve(solver, H, y).x.dtype == np.float32
        assert sg.solve(solver, H, y.astype(np.float64)).x.dtype == np.float64
        assert sg.solve(solver, H, np.round(100 * y).astype(np.int64)).x.dtype == np.float32

    def test_history_has_one_value_an_iteration(self, solver):
        H, y = small_problem()
        told = []
        found = sg.solve(solver, H, y, callback=lambda iteration, values: told.append((iteration, values)))
        assert found.iterations == len(told) > 0
        assert [iteration for iteration, _ in told] == list(range(1, found.iterations + 1))
        for name in ("objective", "residual", "tau", "nonzeros", "seconds"):
            assert found.history[name] == [values[name] for _, values in told]
        assert 0 < found.history["seconds"][-1] <= found.seconds

    def test_history_tells_the_truth_about_the_result(self, solver):
        H, y = small_problem(np.float64)
        found = sg.solve(solver, H, y)
        psi = sg.operators.basis("dct-sym8", H.in_shape)
        residual = np.linalg.norm(H.forward(found.x) - y)
        assert found.history["residual"][-1] == pytest.approx(residual, rel=1e-10)
        # Ψ is square here, so the coefficients can be read off the cube.
        coefficients = psi.adjoint(found.x)
        objective = 0.5 * residual**2 + found.history["tau"][-1] * np.abs(coefficients).sum()
        assert found.history["objective"][-1] == pytest.approx(objective, rel=1e-10)
        assert found.history["nonzeros"][-1] == np.count_nonzero(np.abs(coefficients) > 1e-12)

    def test_starved_is_not_converged(self, solver):
        found = sg.solve(type(solver)(max_iter=2), *small_problem())
        assert not found.converged
        assert found.iterations == 2

    def test_interrupt_gives_the_best_so_far(self, solver):
        H, y = small_problem()

        def interrupt(iteration, values):
            if iteration == 4:
                raise KeyboardInterrupt

        found = sg.solve(solver, H, y, callback=interrupt)
        assert (found.interrupted, found.converged, found.iterations) == (True, False, 4)
        full = sg.solve(type(solver)(max_iter=100, tol=1e-7), H, y)
        assert not full.interrupted
        residuals = [np.linalg.norm(H.forward(x) - y) for x in (np.zeros(H.in_shape, np.float32), found.x, full.x)]
        assert residuals[0] > residuals[1] > residuals[2]
        assert residuals[1] == pytest.approx(found.history["residual"][-1], rel=1e-4)

    def test_nothing_seen_is_a_dark_cube(self, solver):
        H, y = small_problem()
        found = sg.solve(solver, H, np.zeros_like(y))
        assert found.converged
        assert found.x.shape == H.in_shape
        assert not found.x.any()

    def test_threads_do_not_change_a_bit(self, solver):
        imager = sg.DualCASSI(cube_shape=(8, 96, 96), wavelengths=(450, 650))
        H = imager.operator(sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0))
        y = H.forward(np.random.default_rng(0).random(H.in_shape).astype(np.float32))
        found = []
        for count in (1, 3):
            with sg.threads(count):
                found.append(sg.solve(solver, H, y))
        np.testing.assert_array_equal(found[0].x, found[1].x)
        assert found[0].history["objective"] == found[1].history["objective"]

    def test_snapshots_are_left_alone(self, solver):
        H, y = small_problem()
        kept = y.copy()
        sg.solve(solver, H, y)
        np.testing.assert_array_equal(y, kept)

    def test_settings_are_checked(self, solver):
        kind = type(solver)
        for tau in (0, 1, -1e-3, float("nan")):
            with pytest.raises(ValueError, match="tau is relative to the largest"):
                kind(tau=tau)
        with pytest.raises(ValueError, match="max_iter must be a whole number of at least 1, got 0"):
            kind(max_iter=0)
        with pytest.raises(ValueError, match=r"tol must lie in \[0, 1\)"):
            kind(tol=-1e-5)
        with pytest.raises(ValueError, match="basis must be one of dct-sym8"):
            kind(basis="dct-haar")
        with pytest.raises(TypeError, match="a name or a LinearOperator, got int"):
            kind(basis=3)
        psi = sg.operators.basis("dct-sym8", (4, 16, 16))
        with pytest.raises(ValueError, match="levels belongs to a basis given by name"):
            kind(basis=psi, levels=2)
        with pytest.raises(ValueError, match=r"gives cubes of shape \(4, 16, 16\), the operator takes \(3, 16, 16\)"):
            sg.solve(kind(basis=psi), *small_problem())

    def test_basis_may_be_an_operator(self, solver):
        H, y = small_problem()
        kind = type(solver)
        psi = sg.operators.basis("dct-sym8", H.in_shape, levels=1)
        by_name = sg.solve(kind(levels=1, max_iter=5), H, y)
        np.testing.assert_array_equal(sg.solve(kind(basis=psi, max_iter=5), H, y).x, by_name.x)


def test_not_a_solver():
    H, y = small_problem()
    with pytest.raises(TypeError, match=r"solve takes a solver such as GPSR\(\), FISTA\(\) or EigenTV\(\), got str"):
        sg.solve("gpsr", H, y)
    with pytest.raises(TypeError, match=r"got the class GPSR: write GPSR\(\)"):
        sg.solve(sg.GPSR, H, y)


def test_snapshots_are_checked():
    H, y = small_problem()
    with pytest.raises(TypeError, match=r"H must be a LinearOperator.*got ndarray"):
        check_problem(np.eye(3), y)
    with pytest.raises(ValueError, match=r"shape \(2, 16, 16\) that H gives, got \(16, 16\)"):
        sg.solve(sg.GPSR(), H, y[0])
    with pytest.raises(TypeError, match="real numbers, got an array of complex"):
        sg.solve(sg.GPSR(), H, y * 1j)
    y[0, 0, :3] = np.nan
    with pytest.raises(ValueError, match="snapshots contain 3 NaN values"):
        sg.solve(sg.GPSR(), H, y)
    y[1, 0, :2] = np.inf
    with pytest.raises(ValueError, match="3 NaN and 2 infinite values"):
        sg.solve(sg.FISTA(), H, y)
