"""Several operators on one scene, against dense matrices."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.operators import LinearOperator, SpectralResponse, as_matrix, shot_gram, stack

NM = (450.0, 650.0)


def camera(kind, shape, shots, gray=False):
    """Operator of an imager of cubes of this shape."""
    if kind == "sscsi":
        imager = sg.SSCSI(
            detector_shape=shape[1:],
            detector_pitch=10.0,
            code_pitch=10.0,
            mask_position=shape[0] / shape[2],
            wavelengths=NM,
        )
    elif kind == "super-resolving":
        half = (shape[1] // 2, shape[2] // 2)
        imager = sg.SSCSI(detector_shape=half, detector_pitch=20.0, code_pitch=10.0, mask_position=0.1, wavelengths=NM)
    elif kind == "smeared":
        imager = sg.DualCASSI(cube_shape=shape, wavelengths=NM, shear="exact")
    else:
        imager = {"cassi": sg.CASSI, "dual": sg.DualCASSI}[kind](cube_shape=shape, wavelengths=NM)
    code = np.random.default_rng(1).random((shots, *imager.code_shape))
    return imager.operator(code if gray else code > 0.5)


def framed(image, rows, columns):
    """Image in the middle of zeros."""
    whole = np.zeros((len(image), rows, columns))
    top, left = (rows - image.shape[1]) // 2, (columns - image.shape[2]) // 2
    for q, y, x in np.ndindex(image.shape):
        whole[q, top + y, left + x] = image[q, y, x]
    return whole


def dense(parts, noise):
    """Columns are the images of single voxels, framed and scaled by hand."""
    rows, columns = (max(part.out_shape[axis] for part in parts) for axis in (1, 2))
    shape = parts[0].in_shape
    matrices = [as_matrix(part) for part in parts]
    voxels = []
    for voxel in range(int(np.prod(shape))):
        images = [
            framed(m[:, voxel].reshape(p.out_shape) / s, rows, columns)
            for m, p, s in zip(matrices, parts, noise, strict=True)
        ]
        voxels.append(np.concatenate(images).ravel())
    return np.stack(voxels, axis=1)


@pytest.mark.parametrize(
    ("kind", "shape"),
    [("cassi", (4, 5, 6)), ("dual", (3, 4, 5)), ("sscsi", (2, 3, 8)), ("sscsi", (3, 6, 7)), ("super-resolving", None)],
)
def test_a_stack_is_the_matrices_on_top_of_each_other(kind, shape):
    H = camera(kind, shape or (2, 6, 8), shots=2, gray=kind == "dual")
    rgb = SpectralResponse(np.random.default_rng(0).standard_normal((3, H.in_shape[0])), H.in_shape)
    both = stack(H, rgb, noise=(0.5, 3.0))
    wanted = dense((H, rgb), (0.5, 3.0))
    np.testing.assert_allclose(as_matrix(both), wanted, atol=1e-12)
    np.testing.assert_allclose(as_matrix(both.H), wanted.T, atol=1e-12)
    assert sg.testing.dot_test(both) < 1e-12
    assert sg.testing.dot_test(both, np.float32) < 1e-5


def by_matrix(A):
    """(shot, shot, y, x) blocks of H Hᵀ, and the largest element outside of them."""
    matrix = as_matrix(A)
    shots, rows, columns = A.out_shape
    whole = (matrix @ matrix.T).reshape(shots, rows * columns, shots, rows * columns)
    blocks = np.einsum("apbp->abp", whole).copy()
    pixel = np.arange(rows * columns)
    whole[:, pixel, :, pixel] = 0
    return blocks.reshape(shots, shots, rows, columns), np.abs(whole).max()


@pytest.mark.parametrize("kind", ["dual", "sscsi", "smeared"])
def test_gram_with_its_cross_terms(kind):
    H = camera(kind, (3, 4, 7), shots=2, gray=True)
    both = stack(H, SpectralResponse.pan(H.in_shape), noise=(0.5, 0.1))
    wanted, beside = by_matrix(both)
    assert beside == 0
    assert np.abs(wanted[0, 2]).max() > 1
    np.testing.assert_allclose(shot_gram(both), wanted, atol=1e-12)


def test_gram_of_pictures_and_of_two_imagers():
    pan = SpectralResponse.pan((3, 4, 5))
    np.testing.assert_allclose(shot_gram(stack(pan, pan)), np.full((2, 2, 4, 5), 1 / 3), atol=1e-15)
    two = stack(camera("dual", (3, 4, 5), 1), camera("smeared", (3, 4, 5), 2))
    wanted, beside = by_matrix(two)
    assert beside == 0
    np.testing.assert_allclose(shot_gram(two), wanted, atol=1e-12)
    nested = stack(two, pan)
    np.testing.assert_allclose(shot_gram(nested), by_matrix(nested)[0], atol=1e-12)


@dataclass(frozen=True, eq=False)
class Mirrored(LinearOperator):
    """The sum of all bands, mirrored: one matrix an element, but not of the same pixel."""

    in_shape: tuple = (3, 4, 5)
    out_shape: tuple = (1, 4, 5)

    def _forward(self, x, out):
        out[0] = x.sum(axis=0)[:, ::-1]

    def _adjoint(self, y, out):
        out[:] = y[:, :, ::-1]


@shot_gram.register
def _(A: Mirrored):
    return np.full((1, 1, 4, 5), 3.0)


@pytest.mark.parametrize("kind", ["cassi", "super-resolving", "mirrored"])
def test_no_gram_where_pixels_share_light(kind):
    H = Mirrored() if kind == "mirrored" else camera(kind, (3, 8, 10), shots=2)
    both = stack(H, SpectralResponse.pan(H.in_shape))
    assert shot_gram(both) is None
    if kind != "super-resolving":  # whose picture is finer than its shots
        assert by_matrix(both)[1] > 0.1


def test_parts_come_back():
    H = camera("cassi", (4, 6, 9), shots=2)
    parts = [np.random.default_rng(0).random((2, 6, 12)).astype(np.float32), np.ones((1, 6, 9), np.float32)]
    both = stack(H, SpectralResponse.pan(H.in_shape), noise=(0.25, 0.5))
    y = both.join(parts)
    assert y.dtype == np.float32
    assert both.join([parts[0], np.ones((1, 6, 9))]).dtype == np.float64
    for part, given in zip(both.split(y), parts, strict=True):
        np.testing.assert_array_equal(part, given)
    cube = np.random.default_rng(1).random(H.in_shape)
    images = both.split(both.forward(cube))
    np.testing.assert_allclose(images[0], H.forward(cube), atol=1e-14)
    np.testing.assert_allclose(images[1][0], cube.mean(axis=0), atol=1e-14)


def scene(bands=6, size=32):
    """Squares of different spectra on a ramp."""
    y, x = np.mgrid[:size, :size] / size
    k = np.arange(bands)[:, None, None] / bands
    cube = 0.3 + 0.2 * x * k + 0 * y
    cube[:, 6:18, 8:20] += 0.4 * np.sin(3 * k) ** 2
    cube[:, 14:28, 16:30] += 0.3 * (1 - k)
    return cube.astype(np.float32)


def noisy(A, cube, sigma, seed):
    return (A.forward(cube) + np.random.default_rng(seed).normal(0, sigma, A.out_shape)).astype(np.float32)


@pytest.mark.parametrize("kind", ["sscsi", "cassi"])
def test_a_picture_helps_the_reconstruction(kind):
    """Through the pixels' own matrices for an SSCSI, and by conjugate gradients for a CASSI."""
    truth = scene()
    H = camera(kind, truth.shape, shots=1)
    pan = SpectralResponse.pan(truth.shape)
    y, picture = noisy(H, truth, 0.02, 0), noisy(pan, truth, 0.005, 1)
    both = stack(H, pan, noise=(0.02, 0.005))
    alone = sg.solve(sg.EigenTV(noise=0.02), H, y).x
    helped = sg.solve(sg.EigenTV(noise=1), both, both.join([y, picture])).x
    assert sg.metrics.psnr(helped, truth, peak=1.0) > sg.metrics.psnr(alone, truth, peak=1.0) + 1.5


def test_the_page_runs():
    names = {}
    page = (Path(__file__).parents[2] / "docs" / "side-information.md").read_text(encoding="utf-8")
    for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL):
        exec(compile(block, "side-information.md", "exec"), names)
    alone, helped = (sg.metrics.psnr(names[name].x, names["truth"].values, peak=1.0) for name in ("alone", "helped"))
    assert helped > alone + 5


@dataclass(frozen=True, eq=False)
class Hidden(LinearOperator):
    """An operator of which nothing more is known."""

    of: LinearOperator

    @property
    def in_shape(self):
        return self.of.in_shape

    @property
    def out_shape(self):
        return self.of.out_shape

    def _forward(self, x, out):
        self.of._forward(x, out)

    def _adjoint(self, y, out):
        self.of._adjoint(y, out)


def test_both_ways_of_solving_agree():
    truth = scene()
    both = stack(camera("sscsi", truth.shape, shots=2), SpectralResponse.pan(truth.shape), noise=(0.02, 0.005))
    y = noisy(both, truth, 1.0, 0)
    spec = sg.EigenTV(noise=1, max_iter=20, tol=0)
    np.testing.assert_allclose(sg.solve(spec, Hidden(both), y).x, sg.solve(spec, both, y).x, atol=0.01)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda H: stack(H, SpectralResponse.pan((3, 8, 9))), "same scene"),
        (lambda H: stack(H, noise=(1.0, 2.0)), "each of 1 parts, got 2"),
        (lambda H: stack(H, H, noise=(1.0, 0.0)), "must be positive"),
        (lambda H: stack(H).join([]), "1 parts, got 0"),
        (lambda H: stack(H).join([np.ones((1, 8, 9))]), r"images of shape \(1, 8, 8\)"),
        (lambda H: stack(H).split(np.ones((1, 8, 9))), r"shape \(1, 8, 8\)"),
    ],
)
def test_misuse(call, message):
    with pytest.raises(ValueError, match=message):
        call(camera("dual", (3, 8, 8), 1))


def test_misuse_of_flat_measurements():
    @dataclass(frozen=True, eq=False)
    class Counts(LinearOperator):
        in_shape: tuple = (2, 3, 4)
        out_shape: tuple = (5,)

        def _forward(self, x, out):
            out[:] = x.sum()

        def _adjoint(self, y, out):
            out[:] = y.sum()

    with pytest.raises(ValueError, match=r"images \(shot, y, x\), got one that gives \(5,\)"):
        stack(SpectralResponse.pan((2, 3, 4)), Counts())
