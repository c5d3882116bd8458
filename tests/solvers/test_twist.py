"""TwIST against its equations, against FISTA, its safeguard, and the search over τ."""

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.operators import as_matrix, basis
from shadowgram.solvers.tau_search import search_tau


def problem(imager=sg.DualCASSI, shape=(4, 16, 20), shots=2, noise=0.0):
    if imager is sg.SSCSI:
        device = sg.SSCSI(
            detector_shape=shape[1:], detector_pitch=10.0, code_pitch=10.0, mask_position=shape[0] / shape[2],
            wavelengths=(450, 650),
        )  # fmt: skip
    else:
        device = imager(cube_shape=shape, wavelengths=(450, 650))
    H = device.operator(sg.codes.boolean(shots=shots, shape=device.code_shape, seed=0))
    bands, rows, columns = H.in_shape
    cube = sg.scenes.chart(size=max(rows, columns), bands=bands, seed=0).values[:, :rows, :columns].astype(float)
    y = H.forward(np.ascontiguousarray(cube))
    return H, cube, y + noise * np.random.default_rng(0).standard_normal(y.shape)


def reference(A, y, tau, conditioning, iterations):
    """Two-step iteration with the safeguard, from the equations; also how often the safeguard was needed."""

    def objective(theta):
        return 0.5 * np.sum((A @ theta - y) ** 2) + tau * np.abs(theta).sum()

    step = 1 / (1.02 * np.linalg.norm(A, 2) ** 2)
    rho = (1 - conditioning**0.5) / (1 + conditioning**0.5)
    alpha = rho**2 + 1
    beta = 2 * alpha / (conditioning + 1)
    before, theta, refused = None, np.zeros(A.shape[1]), 0
    for _ in range(iterations):
        v = theta + step * A.T @ (y - A @ theta)
        gamma = np.sign(v) * np.maximum(np.abs(v) - step * tau, 0)
        new = gamma if before is None else (1 - alpha) * before + (alpha - beta) * theta + beta * gamma
        if objective(new) > objective(theta):
            new, refused = gamma, refused + 1
        before, theta = theta, new
    return theta, refused


@pytest.mark.parametrize("shape", [(3, 8, 8), (2, 9, 13), (5, 12, 6)])
@pytest.mark.parametrize("imager", [sg.CASSI, sg.DualCASSI, sg.SSCSI])
def test_iterates_are_those_of_the_equations(imager, shape):
    H, _, y = problem(imager, shape)
    psi = basis("dct-sym8", H.in_shape)
    A = as_matrix(H) @ as_matrix(psi)
    tau = 1e-3 * np.abs(A.T @ y.ravel()).max()
    refusals = []
    for iterations, conditioning in ((1, 1e-4), (12, 1e-4), (40, 1e-2)):
        theta, refused = reference(A, y.ravel(), tau, conditioning, iterations)
        found = sg.solve(sg.TwIST(tau=1e-3, conditioning=conditioning, max_iter=iterations, tol=0), H, y)
        np.testing.assert_allclose(found.x.ravel(), as_matrix(psi) @ theta, rtol=0, atol=1e-10 * np.abs(found.x).max())
        refusals.append(refused)
    assert max(refusals) > 0  # the safeguard was tried


@pytest.mark.parametrize(("tau", "noise"), [(1e-2, 0.0), (1e-3, 0.0), (1e-2, 0.05)])
def test_agrees_with_fista_and_gpsr(tau, noise):
    H, _, y = problem(noise=noise)
    settings = {"tau": tau, "max_iter": 5000, "tol": 1e-9}
    found = [sg.solve(solver(**settings), H, y) for solver in (sg.TwIST, sg.FISTA, sg.GPSR)]
    assert all(one.converged for one in found)
    twist, fista, gpsr = (one.history["objective"][-1] for one in found)
    assert twist == pytest.approx(fista, rel=1e-5)
    assert twist == pytest.approx(gpsr, rel=1e-5)


def test_objective_never_rises():
    H, _, y = problem(noise=0.02)
    for conditioning in (1e-6, 1e-2):
        found = sg.solve(sg.TwIST(tau=1e-4, conditioning=conditioning, max_iter=150, tol=0), H, y)
        objective = np.array(found.history["objective"])
        assert len(objective) == 150
        assert (np.diff(objective) <= 0).all()


def test_two_steps_are_faster_than_one():
    H, _, y = problem()
    settings = {"tau": 1e-3, "max_iter": 60, "tol": 0}
    two, one = (sg.solve(sg.TwIST(conditioning=c, **settings), H, y).history["objective"][-1] for c in (1e-4, 0.999999))
    least = sg.solve(sg.TwIST(tau=1e-3, max_iter=3000, tol=1e-9), H, y).history["objective"][-1]
    assert two - least < 0.3 * (one - least)


def test_units_do_not_matter():
    H, _, y = problem()
    x = sg.solve(sg.TwIST(max_iter=40), H, y).x
    for factor in (1000.0, 1e-15):
        other = sg.solve(sg.TwIST(max_iter=40), H, factor * y).x / factor
        np.testing.assert_allclose(other, x, rtol=0, atol=1e-9 * x.max())


def test_search_goes_on_from_each_tau():
    H, cube, y = problem(shape=(6, 32, 32), noise=0.02)
    taus = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5)

    def score(x):
        return sg.metrics.psnr(x, cube, peak=1.0)

    best, table = search_tau(sg.TwIST(), H, y, score, taus)
    assert sg.metrics.psnr(best.x, cube, peak=1.0) == max(trial.score for trial in table)
    assert best.tau_search == table
    assert table[0].score < max(trial.score for trial in table) > table[-1].score
    gpsr, _ = search_tau(sg.GPSR(), H, y, score, taus)
    assert score(best.x) == pytest.approx(score(gpsr.x), abs=0.3)


def test_search_refuses_other_solvers():
    H, _, y = problem()
    with pytest.raises(TypeError, match=r"search_tau takes a solver such as GPSR\(\) or TwIST\(\), got EigenTV"):
        search_tau(sg.EigenTV(), H, y, np.sum)


@pytest.mark.parametrize("conditioning", [0.0, 1.0, -1e-4, float("nan")])
def test_conditioning_is_checked(conditioning):
    with pytest.raises(ValueError, match="conditioning is the least eigenvalue"):
        sg.TwIST(conditioning=conditioning)
