"""The operator protocol, composition, adapters and structure."""

from dataclasses import dataclass

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.operators import Adjoint, Compose, LinearOperator, as_matrix, as_scipy, norm, shot_gram


@dataclass(frozen=True, eq=False)
class Matrix(LinearOperator):
    """A dense matrix on arrays (2, 3) → (5,)."""

    values: np.ndarray

    @property
    def in_shape(self):
        return (2, 3)

    @property
    def out_shape(self):
        return (5,)

    def _forward(self, x, out):
        out[:] = self.values @ x.ravel()

    def _adjoint(self, y, out):
        out[:] = (self.values.T @ y).reshape(2, 3)


@pytest.fixture
def A():
    return Matrix(np.random.default_rng(0).standard_normal((5, 6)))


def test_adjoint_and_composition(A):
    assert sg.testing.dot_test(A) < 1e-14
    normal = A.H @ A
    assert isinstance(normal, Compose)
    assert isinstance(A.H, Adjoint)
    assert A.H.H is A
    assert sg.testing.dot_test(normal) < 1e-14
    np.testing.assert_allclose(as_matrix(normal), A.values.T @ A.values, atol=1e-14)
    np.testing.assert_allclose(as_matrix(normal.H), A.values.T @ A.values, atol=1e-14)


def test_the_dot_test_finds_a_wrong_adjoint(A):
    @dataclass(frozen=True, eq=False)
    class Wrong(Matrix):
        def _adjoint(self, y, out):
            out[:] = (self.values.T @ y).reshape(2, 3) * 1.001

    assert sg.testing.dot_test(Wrong(A.values)) > 1e-5


def test_norm_by_power_iteration(A):
    assert shot_gram(A) is None
    assert norm(A) == pytest.approx(np.linalg.norm(A.values, 2), rel=1e-2)


def test_scipy_adapter(A):
    S = as_scipy(A)
    x, y = np.arange(6.0), np.arange(5.0)
    np.testing.assert_allclose(S @ x, A.values @ x)
    np.testing.assert_allclose(S.H @ y, A.values.T @ y)


def test_dtype_follows_the_input(A):
    for given, wanted in (("f4", "f4"), ("f8", "f8"), ("u1", "f4"), ("i8", "f4"), (">f8", "f8")):
        assert A.forward(np.ones((2, 3), given)).dtype == wanted
    imager = sg.DualCASSI(cube_shape=(2, 3, 4), wavelengths=(450.0, 650.0))
    H = imager.operator(np.ones(imager.code_shape))
    assert H.forward(np.asfortranarray(np.ones((2, 3, 4), np.float32))).dtype == np.float32


def test_out_is_filled_and_returned(A):
    out = np.full(5, np.nan)
    assert A.forward(np.ones((2, 3)), out) is out
    np.testing.assert_allclose(out, A.values.sum(axis=1))


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (
            lambda A: A.forward(np.ones((3, 2))),
            ValueError,
            r"Matrix.forward takes an array of shape \(2, 3\), got \(3, 2\)",
        ),
        (lambda A: A.adjoint(np.ones(6)), ValueError, r"Matrix.adjoint takes an array of shape \(5,\)"),
        (lambda A: A.forward(np.ones((2, 3), complex)), TypeError, "real numbers"),
        (lambda A: A.forward(np.ones((2, 3)), np.empty(5, np.float32)), ValueError, "out array of shape"),
        (lambda A: A @ A, ValueError, "cannot compose Matrix @ Matrix"),
        (lambda A: A @ 3, TypeError, "unsupported"),
    ],
)
def test_misuse(A, call, error, message):
    with pytest.raises(error, match=message):
        call(A)


def test_a_matrix_too_large_for_memory_is_refused():
    imager = sg.CASSI(cube_shape=(24, 256, 256), wavelengths=(450.0, 650.0))
    with pytest.raises(MemoryError, match="GiB"):
        as_matrix(imager.operator(np.ones(imager.code_shape)))


def test_threads():
    with pytest.raises(ValueError, match="at least 1"), sg.threads(0):
        pass
