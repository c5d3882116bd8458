"""The CASSI family against dense matrices written with plain loops from the equations."""

import itertools
import math

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.operators import as_matrix, norm, shot_gram

IMAGERS = [
    (kind, shape, shift)
    for kind in (sg.CASSI, sg.DualCASSI, sg.ColoredCASSI)
    for shape in ((3, 4, 6), (4, 5, 7), (1, 3, 2), (7, 3, 3))
    for shift in (1, 2)
]


def make(kind, shape, shift):
    return kind(cube_shape=shape, wavelengths=(450.0, 650.0), band_shift=shift)


def make_code(imager, seed=0, shots=3):
    if isinstance(imager, sg.ColoredCASSI):
        return sg.codes.colored(shots=shots, shape=imager.code_shape, seed=seed)
    return sg.codes.boolean(shots=shots, shape=imager.code_shape, seed=seed)


def sensing_matrix(imager, code):
    bands, ny, nx = imager.cube_shape
    d = imager.band_shift
    wide = 0 if isinstance(imager, sg.DualCASSI) else d
    H = np.zeros((len(code), ny, nx + wide * (bands - 1), bands, ny, nx))
    for q, k, y, x in itertools.product(range(len(code)), range(bands), range(ny), range(nx)):
        if isinstance(imager, sg.ColoredCASSI):
            H[q, y, x + d * k, k, y, x] = code[q, k, y, x]
        elif isinstance(imager, sg.DualCASSI):
            H[q, y, x, k, y, x] = code[q, y, x + d * k]
        else:
            H[q, y, x + d * k, k, y, x] = code[q, y, x]
    return H.reshape(math.prod(H.shape[:3]), -1)


@pytest.mark.parametrize(("kind", "shape", "shift"), IMAGERS)
@pytest.mark.parametrize("gray", [False, True])
def test_operator_equals_the_dense_matrix(kind, shape, shift, gray):
    imager = make(kind, shape, shift)
    code = make_code(imager)
    if gray:
        code = np.random.default_rng(0).random(code.shape, dtype=np.float32)
    H = imager.operator(code)
    wanted = sensing_matrix(imager, code)
    assert np.array_equal(as_matrix(H), wanted)
    assert np.array_equal(as_matrix(H.H), wanted.T)
    assert sg.testing.dot_test(H) < 1e-12
    assert sg.testing.dot_test(H, np.float32) < 1e-5


@pytest.mark.parametrize(("kind", "shape", "shift"), IMAGERS)
def test_gram_and_norm(kind, shape, shift):
    imager = make(kind, shape, shift)
    H = imager.operator(np.random.default_rng(0).random((2, *imager.code_shape)))
    M = as_matrix(H)
    wanted = (M @ M.T).reshape(*H.out_shape, *H.out_shape)
    pixels = np.indices(H.out_shape[1:])
    full = np.zeros_like(wanted)
    for a, b in itertools.product(range(2), repeat=2):
        full[a, pixels[0], pixels[1], b, pixels[0], pixels[1]] = shot_gram(H)[a, b]
    assert np.abs(full - wanted).max() < 1e-12
    assert norm(H) == pytest.approx(np.linalg.norm(M, 2), rel=1e-10)


@pytest.mark.parametrize(("kind", "shape", "shift"), IMAGERS)
def test_effective_code_is_the_light_of_each_voxel(kind, shape, shift):
    imager = make(kind, shape, shift)
    code = make_code(imager)
    light = as_matrix(imager.operator(code)).reshape(3, -1, math.prod(shape)).sum(axis=1)
    np.testing.assert_allclose(imager.effective_code(code), light.reshape(3, *shape))
    np.testing.assert_allclose(imager.effective_code(code).sum(axis=0), 1)


def test_resolution():
    imager = sg.CASSI(cube_shape=(4, 5, 6), wavelengths=(400.0, 600.0), pitch=8.0)
    assert imager.resolution.cube_shape == (4, 5, 6)
    assert imager.resolution.band_width == 50
    np.testing.assert_allclose(imager.resolution.wavelengths, [425, 475, 525, 575])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cube_shape": (4, 5)}, "cube_shape must be"),
        ({"cube_shape": (4, 5, 0)}, "cube_shape must be"),
        ({"band_shift": 0}, "band_shift"),
        ({"pitch": -1.0}, "pitch"),
        ({"wavelengths": (600.0, 400.0)}, "wavelengths"),
    ],
)
@pytest.mark.parametrize("kind", [sg.CASSI, sg.DualCASSI, sg.ColoredCASSI])
def test_impossible_geometries(kind, changes, message):
    with pytest.raises(ValueError, match=message):
        kind(**({"cube_shape": (4, 5, 6), "wavelengths": (450.0, 650.0)} | changes))


@pytest.mark.parametrize(("kind", "shape", "shift"), IMAGERS[:3])
def test_results_do_not_depend_on_threads(kind, shape, shift):
    imager = make(kind, (shape[0], 40, shape[2]), shift)
    H = imager.operator(make_code(imager))
    cube = np.random.default_rng(0).random(H.in_shape, dtype=np.float32)
    with sg.threads(1):
        snapshots = H.forward(cube)
    with sg.threads(3):
        assert np.array_equal(H.forward(cube), snapshots)
