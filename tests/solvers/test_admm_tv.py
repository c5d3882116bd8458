"""ADMM-TV against its equations, its optimum and its promises about the weight; what it shares with GAP-TV is tested there."""

import numpy as np
import pytest
import scipy.io

import shadowgram as sg
from shadowgram.operators import as_matrix
from shadowgram.operators.structure import shot_gram


def problem(imager=sg.DualCASSI, shape=(3, 12, 14), shots=2, noise=0.0, dtype=np.float64):
    if imager is sg.SSCSI:
        device = sg.SSCSI(
            detector_shape=shape[1:], detector_pitch=10.0, code_pitch=10.0, mask_position=shape[0] / shape[2],
            wavelengths=(450, 650),
        )  # fmt: skip
    else:
        device = imager(cube_shape=shape, wavelengths=(450, 650))
    H = device.operator(sg.codes.random(shots=shots, shape=device.code_shape, seed=0))
    bands, rows, columns = H.in_shape
    y, x = np.mgrid[:rows, :columns] / min(rows, columns)
    k = np.linspace(0, 1, bands)[:, None, None]
    cube = np.where((y > 0.3) & (x > 0.2) & (x < 0.8), 0.9 - 0.6 * k, 0.05 + 0 * k).astype(dtype)
    seen = H.forward(cube)
    return H, cube, (seen + noise * np.random.default_rng(0).standard_normal(seen.shape)).astype(dtype)


def differences(x):
    """Forward differences along x and y, none across the last column and row: (band, 2, y, x)."""
    d = np.zeros((len(x), 2, *x.shape[1:]))
    d[:, 0, :, :-1] = np.diff(x, axis=2)
    d[:, 1, :-1, :] = np.diff(x, axis=1)
    return d


def differences_adjoint(p):
    x = np.zeros((len(p), *p.shape[2:]))
    x[:, :, 1:] += p[:, 0, :, :-1]
    x[:, :, :-1] -= p[:, 0, :, :-1]
    x[:, 1:, :] += p[:, 1, :-1, :]
    x[:, :-1, :] -= p[:, 1, :-1, :]
    return x


def variation(x):
    return np.sqrt((differences(x) ** 2).sum(axis=1)).sum()


def shorten(p, weight):
    """Projection on |p| ≤ weight at every pixel."""
    return p / np.maximum(1, np.sqrt((p**2).sum(axis=1, keepdims=True)) / weight)


def units(H, y):
    """Gain h, and the scale of the scene."""
    return np.einsum("qqij->", shot_gram(H)) / y.size, np.sqrt(
        (y**2).sum() / (H.forward(np.ones(H.in_shape)) ** 2).sum()
    )


def reference(H, y, spec, iterations):
    """Alternating directions with matrices, from the equations."""
    A, (gain, scale) = as_matrix(H), units(H, y)
    strength, rho = spec.weight * gain, (spec.rho or 5 * spec.weight) * gain
    least = 0 if spec.nonnegative else -np.inf
    z, u = np.zeros(H.in_shape), np.zeros(H.in_shape)
    p = np.zeros((len(z), 2, *z.shape[1:]))
    left, right = A.T @ A + rho * np.eye(A.shape[1]), A.T @ y.ravel() / scale
    for _ in range(iterations):
        x = np.linalg.solve(left, right + rho * (z - u).ravel()).reshape(z.shape)
        a = 1.6 * x + (1 - 1.6) * z + u
        for _ in range(spec.tv_iterations):
            p = shorten(p + differences(np.maximum(a - differences_adjoint(p), least)) / 8, strength / rho)
        z = np.maximum(a - differences_adjoint(p), least)
        u = a - z
    return scale * z


@pytest.mark.parametrize("shape", [(3, 6, 8), (2, 7, 9), (4, 9, 6)])
@pytest.mark.parametrize("imager", [sg.CASSI, sg.DualCASSI, sg.SSCSI])
def test_iterates_are_those_of_the_equations(imager, shape):
    H, _, y = problem(imager, shape, noise=0.1)
    for spec in (
        sg.ADMMTV(weight=0.02, max_iter=1, tol=0),
        sg.ADMMTV(weight=0.05, max_iter=9, tol=0),
        sg.ADMMTV(weight=0.01, rho=0.3, nonnegative=False, tv_iterations=4, max_iter=9, tol=0),
    ):
        found = sg.solve(spec, H, y)
        expected = reference(H, y, spec, spec.max_iter)
        np.testing.assert_allclose(found.x, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("nonnegative", [True, False])
@pytest.mark.parametrize(("weight", "rho", "tv_iterations"), [(0.02, None, 2), (0.1, 0.2, 1), (0.1, 1.0, 5)])
def test_the_optimum_is_that_of_a_primal_dual_method(weight, rho, tv_iterations, nonnegative):
    """Chambolle and Pock's iteration with x ≥ 0 in the primal, data and variation in the dual."""
    H, _, y = problem(shape=(2, 8, 9), noise=0.2)
    A, (gain, scale) = as_matrix(H), units(H, y)
    strength, step = weight * gain, 0.99 / np.sqrt(np.linalg.norm(A, 2) ** 2 + 8)
    x = bar = np.zeros(H.in_shape)
    p, q = np.zeros((2, 2, 8, 9)), np.zeros(len(A))
    for _ in range(3000):
        p = shorten(p + step * differences(bar), strength * scale)
        q = (q + step * (A @ bar.ravel() - y.ravel())) / (1 + step)
        new = x - step * (differences_adjoint(p) + (A.T @ q).reshape(x.shape))
        new = np.maximum(new, 0) if nonnegative else new
        x, bar = new, 2 * new - x

    def objective(x):
        return 0.5 * np.sum((A @ x.ravel() - y.ravel()) ** 2) + strength * scale * variation(x)

    spec = sg.ADMMTV(
        weight=weight, rho=rho, tv_iterations=tv_iterations, nonnegative=nonnegative, max_iter=2000, tol=1e-9
    )
    with sg.threads(1):
        found = sg.solve(spec, H, y)
    assert found.converged
    assert found.history["objective"][-1] == pytest.approx(objective(found.x), rel=1e-9)
    assert found.history["lambda"][-1] == pytest.approx(strength * scale, rel=1e-9)
    assert objective(found.x) == pytest.approx(objective(x), rel=1e-5)
    assert (found.x.min() == 0) == nonnegative  # the constraint is active


def test_blind_weight_follows_the_noise():
    weights = []
    for noise in (0.0, 0.05, 0.2):
        H, _, y = problem(shape=(4, 48, 48), shots=3, noise=noise, dtype=np.float32)
        gain, scale = units(H, y)
        weights.append(sg.solve(sg.ADMMTV(max_iter=1), H, y).history["lambda"][-1] / (gain * scale))
    assert weights[0] == pytest.approx(5e-3, rel=1e-3)
    assert weights[2] / weights[1] == pytest.approx(4**1.25, rel=0.2)


def test_blind_weight_serves_a_real_cube(data):
    path = data / "uis_lego" / "lego.mat"
    if not path.is_file():
        pytest.skip(f"{path} not found")
    cube = np.moveaxis(scipy.io.loadmat(path)["hyperimg"], 2, 0)[:, 64:192, 64:192].astype(np.float32) / 255
    imager = sg.SSCSI(
        detector_shape=(128, 128), detector_pitch=10.0, code_pitch=10.0, mask_position=0.1875, wavelengths=(451, 642),
        shear="edge",
    )  # fmt: skip
    H = imager.operator(sg.codes.boolean(shots=4, shape=imager.code_shape, seed=0))
    y = sg.noise.awgn(H.forward(np.ascontiguousarray(cube)), snr_db=30, seed=0).astype(np.float32)
    blind, less, more = (
        sg.metrics.psnr(sg.solve(sg.ADMMTV(weight=w), H, y).x, cube, peak=1.0) for w in (None, 0.005, 0.5)
    )
    assert blind > max(less, more) + 0.5
    assert blind > 30


def test_values_below_zero_are_for_those_who_ask():
    H, cube, y = problem(shape=(4, 24, 24), shots=3)
    shifted = y - H.forward(np.full(H.in_shape, 0.4))
    assert sg.solve(sg.ADMMTV(), H, shifted).x.min() == 0
    signed = sg.solve(sg.ADMMTV(nonnegative=False), H, shifted).x
    assert sg.metrics.psnr(signed, cube - 0.4, peak=1.0) > 30


def test_the_penalty_is_checked():
    with pytest.raises(ValueError, match="ADMMTV: rho must be above 0"):
        sg.ADMMTV(rho=0.0)
