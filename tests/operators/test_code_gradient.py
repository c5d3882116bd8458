"""Snapshots as a function of the code, against the imagers' own operators and dense matrices."""

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.operators import as_matrix
from shadowgram.spectral import code_operator
from shadowgram.spectral.code_gradient import CodedForm

NM = (450.0, 650.0)
CURVE = ((430.0, 0.0), (520.0, 3.1), (680.0, 6.4))


def sscsi(shape, ratio=1, s=0.25, **more):
    return sg.SSCSI(
        detector_shape=shape, detector_pitch=10.0 * ratio, code_pitch=10.0, mask_position=s, wavelengths=NM, **more
    )


IMAGERS = {
    "cassi": sg.CASSI(cube_shape=(3, 4, 5), wavelengths=NM, band_shift=2),
    "cassi exact": sg.CASSI(cube_shape=(4, 3, 6), wavelengths=NM, shear="exact"),
    "cassi measured": sg.CASSI(cube_shape=(3, 5, 7), wavelengths=NM, dispersion=CURVE, shear="exact"),
    "dual": sg.DualCASSI(cube_shape=(4, 2, 5), wavelengths=NM),
    "dual exact": sg.DualCASSI(cube_shape=(3, 3, 4), wavelengths=NM, band_shift=1.3, shear="exact"),
    "colored": sg.ColoredCASSI(cube_shape=(3, 4, 4), wavelengths=NM),
    "colored exact": sg.ColoredCASSI(cube_shape=(2, 3, 5), wavelengths=NM, shear="exact"),
    "sscsi": sscsi((5, 12)),
    "sscsi beside the mask": sscsi((3, 9), s=0.4, dispersion_ratio=1.5, bands=7, shear="centre"),
    "sscsi super-resolving": sscsi((3, 5), ratio=2, s=0.2),
    "sscsi binned": sscsi((3, 6), ratio=2, s=0.6),
}


def code_of(imager, shots=2, seed=0):
    return np.random.default_rng(seed).random((shots, *imager.code_shape)).astype(np.float32)


def cube_of(imager, seed=1):
    shape = imager.operator(code_of(imager)).in_shape
    return np.random.default_rng(seed).standard_normal(shape)


@pytest.mark.parametrize("name", IMAGERS)
def test_the_imager_itself(name):
    imager = IMAGERS[name]
    code, cube = code_of(imager), cube_of(imager)
    A, H = code_operator(imager, cube, shots=2), imager.operator(code)
    assert A.out_shape == H.out_shape
    np.testing.assert_allclose(A.forward(code.astype(np.float64)), H.forward(cube), atol=1e-12)
    y, back = np.random.default_rng(2).standard_normal(H.out_shape), np.empty(H.in_shape)
    CodedForm.of(imager).cube(code.astype(np.float64), y, back)
    np.testing.assert_allclose(back, H.adjoint(y), atol=1e-12)
    assert sg.testing.dot_test(A) < 1e-12
    assert sg.testing.dot_test(A, np.float32) < 1e-5


@pytest.mark.parametrize("name", IMAGERS)
def test_columns_are_codes_with_one_open_element(name):
    """The dense matrix: what the imager sees through each element of the code alone."""
    imager = IMAGERS[name]
    cube = cube_of(imager)
    matrix = as_matrix(code_operator(imager, cube, shots=1))
    for element, column in enumerate(matrix.T):
        code = np.zeros(imager.code_shape, np.uint8)
        code.flat[element] = 1
        np.testing.assert_allclose(column, imager.operator(code).forward(cube).ravel(), atol=1e-12)
    np.testing.assert_allclose(as_matrix(code_operator(imager, cube, shots=1).H), matrix.T, atol=1e-12)


def test_a_matrix_by_loops():
    """g[q, y, x + 2k] = Σ_k t[q, y, x] f[k, y, x]."""
    imager = IMAGERS["cassi"]
    cube = cube_of(imager)
    wanted = np.zeros((2, 4, 9, 2, 4, 5))
    for q, k, y, x in np.ndindex(2, *cube.shape):
        wanted[q, y, x + 2 * k, q, y, x] += cube[k, y, x]
    np.testing.assert_allclose(as_matrix(code_operator(imager, cube, shots=2)), wanted.reshape(72, 40), atol=1e-12)


def test_threads_change_nothing():
    imager = sscsi((17, 32))
    cube, code = cube_of(imager), code_of(imager).astype(float)
    A = code_operator(imager, cube, shots=2)
    y = A.forward(code)
    with sg.threads(1):
        np.testing.assert_array_equal(A.forward(code), y)
        alone = A.adjoint(y)
    with sg.threads(3):
        np.testing.assert_array_equal(A.adjoint(y), alone)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: code_operator(IMAGERS["dual"], np.ones((4, 2, 6)), 1), ValueError, r"cube of shape \(4, 2, 5\)"),
        (lambda: code_operator(IMAGERS["dual"], np.ones((4, 2, 5)), 0), ValueError, "at least 1, got 0"),
        (lambda: code_operator("dual", np.ones((4, 2, 5)), 1), TypeError, "got a str"),
    ],
)
def test_misuse(call, error, message):
    with pytest.raises(error, match=message):
        call()
