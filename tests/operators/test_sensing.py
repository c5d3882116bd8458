"""Coherence, isometry and what is sensed, against dense matrices."""

import itertools
from dataclasses import dataclass

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.operators import LinearOperator, sensing
from shadowgram.operators.sensing import coherence, gram_deviation, isometry, pixel_groups, sensed, singular_values

SCENE = (3, 4, 5)


@dataclass(frozen=True, eq=False)
class Matrix(LinearOperator):
    """A dense matrix on scenes (3, 4, 5)."""

    values: np.ndarray
    in_shape: tuple = SCENE

    @property
    def out_shape(self):
        return (len(self.values),)

    def _forward(self, x, out):
        out[:] = self.values @ x.ravel()

    def _adjoint(self, y, out):
        out[:] = (self.values.T @ y).reshape(self.in_shape)


def random_matrix(rows=20, seed=0):
    """With zeros, so that not all columns share a measurement, and a column of zeros."""
    rng = np.random.default_rng(seed)
    values = rng.standard_normal((rows, 60)) * (rng.random((rows, 60)) < 0.15)
    values[:, 7] = 0
    return Matrix(values)


def imager(shape=(6, 7), s=0.5, **more):
    more = {"detector_pitch": 10.0, "code_pitch": 10.0, "wavelengths": (450.0, 650.0)} | more
    return sg.SSCSI(detector_shape=shape, mask_position=s, **more)


def operator(kind, shots=3, **more):
    camera = imager(**more)
    return camera, getattr(sg.codes, kind)(shots=shots, shape=camera.code_shape, seed=0)


def dense(camera, code):
    """Matrix of a detector-limited imager with Δd = Δc from its effective code: element (y, x) sees its own pixel only."""
    effective = camera.effective_code(code)
    shots, bands, ny, nx = effective.shape
    matrix = np.zeros((shots, ny, nx, bands, ny, nx))
    for q, k, y, x in np.ndindex(effective.shape):
        matrix[q, y, x, k, y, x] = effective[q, k, y, x]
    return matrix.reshape(shots * ny * nx, -1)


def likeness_by_loops(A):
    """|cos| of all pairs of columns that are not zero and share a row."""
    found = []
    for i, j in itertools.combinations(range(A.shape[1]), 2):
        a, b = A[:, i], A[:, j]
        if ((a != 0) & (b != 0)).any():
            found.append(abs(a @ b) / np.sqrt((a @ a) * (b @ b)))
    return np.array(found)


CAMERAS = [operator("boolean"), operator("random", shots=2, shape=(5, 4)), operator("random", shots=1, shape=(3, 8))]


@pytest.mark.parametrize("case", range(5))
def test_coherence_by_loops(case):
    if case < 3:
        camera, code = CAMERAS[case]
        H, A = camera.operator(code), dense(*CAMERAS[case])
    else:
        H = random_matrix(rows=(20, 90)[case - 3], seed=case)
        A = H.values
    wanted, found = likeness_by_loops(A), coherence(H)
    assert found.pairs == len(wanted)
    assert found.mutual == pytest.approx(wanted.max(), abs=1e-12)
    assert found.rms == pytest.approx(np.sqrt(np.mean(wanted**2)), rel=1e-12)
    assert found.unsensed == (~A.any(axis=0)).sum()
    assert found.histogram.sum() == found.pairs
    for share in (0.1, 0.5, 0.9):
        # within a bin, and the order statistics beside it
        low, high = np.quantile(wanted, share, method="lower"), np.quantile(wanted, share, method="higher")
        assert low - 0.0101 <= found.quantile(share) <= high + 0.0101


def test_coherence_in_blocks_of_columns():
    rng = np.random.default_rng(0)
    H = Matrix(rng.standard_normal((30, 1100)), (11, 10, 10))
    columns = H.values / np.linalg.norm(H.values, axis=0)
    gram = np.abs(columns.T @ columns)[np.triu_indices(1100, 1)]
    found = coherence(H)
    assert found.pairs == gram.size
    assert found.mutual == pytest.approx(gram.max(), rel=1e-12)
    assert found.rms == pytest.approx(np.sqrt((gram**2).mean()), rel=1e-12)
    assert np.array_equal(found.histogram, np.histogram(gram, 100, (0, 1))[0])


def test_coherence_and_singular_values_in_a_basis():
    camera, code = operator("boolean", shape=(16, 24), s=0.25)
    H = camera.operator(code)
    basis = sg.operators.basis("dct-sym8", H.in_shape)
    atoms = np.stack([basis.forward(e.reshape(basis.in_shape)).ravel() for e in np.eye(np.prod(basis.in_shape))], 1)
    A = dense(camera, code) @ atoms
    columns = A / np.linalg.norm(A, axis=0)
    gram = np.abs(columns.T @ columns)
    found = coherence(H, basis)
    assert found.mutual == pytest.approx(gram[np.triu_indices(len(gram), 1)].max(), abs=1e-10)
    np.testing.assert_allclose(singular_values(H, basis), np.linalg.svd(A, compute_uv=False), atol=1e-10)
    np.testing.assert_allclose(singular_values(H, basis), singular_values(H), atol=1e-10)  # Ψ is orthonormal


def test_singular_values_of_pixels():
    """Those of the imager are those of its pixels, as they share no detector element."""
    camera, code = CAMERAS[0]
    effective = camera.effective_code(code)
    wanted = [np.linalg.svd(effective[:, :, y, x], compute_uv=False) for y, x in np.ndindex(effective.shape[2:])]
    np.testing.assert_allclose(singular_values(camera.operator(code)), np.sort(np.ravel(wanted))[::-1], atol=1e-12)


def test_closed_forms():
    identity = Matrix(np.eye(60))
    found = coherence(identity)
    assert (found.mutual, found.rms, found.pairs, found.unsensed, found.quantile(0.5)) == (0, 0, 0, 0, 0)
    assert isometry(identity, basis=None, sparsity=20, trials=3).lower_bound == pytest.approx(0, abs=1e-12)
    assert isometry(Matrix(5 * np.eye(60)), basis=None, sparsity=20).lower_bound == pytest.approx(0, abs=1e-12)
    assert gram_deviation(identity, pixel_groups(SCENE, count=3)).max() == 0
    np.testing.assert_allclose(gram_deviation(Matrix(2 * np.eye(60)), np.arange(60)[None]), 3 * np.sqrt(60))
    twice = np.eye(60)
    twice[:, 1] = twice[:, 0]
    found = coherence(Matrix(twice))
    assert (found.mutual, found.pairs) == (1, 1)
    # the two columns have the eigenvalues 0 and 2; all 60 are drawn
    assert isometry(Matrix(twice), basis=None, sparsity=60, trials=1).lower_bound == pytest.approx(1, abs=1e-12)
    assert gram_deviation(Matrix(twice), np.array([[0, 1]]))[0] == pytest.approx(np.sqrt(2))


@pytest.mark.parametrize("with_basis", [False, True])
def test_isometry_is_that_of_the_supports_drawn(with_basis):
    camera, code = operator("random", shape=(16, 17), s=0.2)
    H, A = camera.operator(code), dense(camera, code)
    basis = sg.operators.basis("dct-sym8", H.in_shape) if with_basis else None
    if basis:
        A = A @ np.stack([basis.forward(e.reshape(basis.in_shape)).ravel() for e in np.eye(np.prod(basis.in_shape))], 1)
    found = isometry(H, basis=basis, sparsity=9, trials=5, seed=3)
    energy = (A**2).sum() / A.shape[1]
    assert found.column_energy == pytest.approx(energy, rel=1e-10)
    rng = np.random.default_rng(3)
    for deviation in found.deviations:
        drawn = A[:, rng.choice(A.shape[1], 9, replace=False)] / np.sqrt(energy)
        values = np.linalg.svd(drawn, compute_uv=False) ** 2
        assert deviation == pytest.approx(max(values[0] - 1, 1 - values[-1]), rel=1e-9)
    assert found.lower_bound == found.deviations.max()
    assert found.sparsity == 9


def test_mean_energy_by_random_signs(monkeypatch):
    """Within 5 of the 0.3 % that the docstring promises for imagers beyond the limit; here that is lowered."""
    camera, code = operator("random", shape=(64, 64), s=0.1)
    H = camera.operator(code)
    exact = (camera.effective_code(code) ** 2).sum() / np.prod(H.in_shape)
    monkeypatch.setattr(sensing, "MOST_SHORT", 100)
    assert isometry(H, basis=None, sparsity=2, trials=1).column_energy == pytest.approx(exact, rel=0.015)


def test_isometry_of_a_large_imager():
    camera, code = operator("boolean", shape=(64, 64), s=0.1875, shots=4)
    H = camera.operator(code)
    basis = sg.operators.basis("dct-sym8", H.in_shape)
    found = isometry(H, basis=basis, sparsity=30, trials=3, seed=1)
    assert np.array_equal(found.deviations, isometry(H, basis=basis, sparsity=30, trials=3, seed=1).deviations)
    assert found.lower_bound > 0


@pytest.mark.parametrize("case", range(4))
def test_gram_deviation_by_loops(case):
    if case < 3:
        H, A = CAMERAS[case][0].operator(CAMERAS[case][1]), dense(*CAMERAS[case])
    else:
        H = random_matrix()
        A = H.values
    groups = pixel_groups(H.in_shape, count=6, window=(2, 3), seed=case)
    for group, found in zip(groups, gram_deviation(H, groups), strict=True):
        total = 0.0
        for i, j in itertools.product(group, repeat=2):
            total += (A[:, i] @ A[:, j] - (i == j)) ** 2
        assert found == pytest.approx(np.sqrt(total), rel=1e-12)


def test_groups_are_windows_of_pixels_with_all_bands():
    groups = pixel_groups((4, 9, 7), count=200, window=(3, 2), seed=0)
    assert groups.shape == (200, 24)
    places = set()
    for group in groups:
        band, y, x = np.unravel_index(group, (4, 9, 7))
        assert sorted(zip(band, y - y.min(), x - x.min(), strict=True)) == list(np.ndindex(4, 3, 2))
        places.add((y.min(), x.min()))
    assert places == set(
        np.ndindex(7, 6)
    )  # 42 places; that one is missed by 200 draws has a chance of 1/3, so the seed is fixed


def test_sensed_is_the_sum_of_the_effective_code():
    for camera, code in CAMERAS:
        found = sensed(camera.operator(code))
        wanted = camera.effective_code(code).sum(axis=0)
        np.testing.assert_allclose(found.weight, wanted, atol=1e-12)
        assert found.never == (wanted < 1e-9).mean()
        assert found.once == (np.abs(wanted - 1) < 1e-9).mean()
        assert found.repeatedly == (wanted > 1 + 1e-9).mean()
        assert found.never + found.partly + found.once + found.repeatedly == pytest.approx(1)


@pytest.mark.parametrize("more", [{}, {"detector_pitch": 20.0}])
def test_complementary_codes_sense_all_once(more):
    """In both regimes; columns beside the mask are dark, and only there light is missed."""
    camera = imager(shape=(8, 32), s=0.25, **more)
    found = sensed(camera.operator(sg.codes.boolean(shots=3, shape=camera.code_shape, seed=0)))
    assert found.once == 1
    wide = imager(shape=(8, 32), s=0.25, dispersion_ratio=2.0, **more)
    found = sensed(wide.operator(sg.codes.boolean(shots=3, shape=wide.code_shape, seed=0)))
    assert found.weight.max() == pytest.approx(1)
    missed = 1 - found.weight.mean(axis=(1, 2))
    np.testing.assert_allclose(missed, wide.resolution.vignetted, atol=1e-9)
    assert found.never > 0.01


def big():
    camera = imager(shape=(64, 64), s=0.1)
    return camera.operator(np.ones(camera.code_shape))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: sensed(Matrix(-np.eye(60))), "negative weights"),
        (lambda: coherence(big()), "coherence needs the whole sensing matrix, and 4096 × 28672 is too large"),
        (lambda: singular_values(big()), "4096 measurements or voxels take too long"),
        (
            lambda: coherence(random_matrix(), sg.operators.basis("dct-sym8", (3, 4, 6))),
            r"makes scenes of shape \(3, 4, 6\), and the imager sees \(3, 4, 5\)",
        ),
        (lambda: coherence(random_matrix()).quantile(1.5), "between 0 and 1"),
        (lambda: isometry(random_matrix(), basis=None, sparsity=61), "from 1 to the 60 columns"),
        (lambda: isometry(random_matrix(), basis=None, sparsity=3, trials=0), "trials must be at least 1"),
        (lambda: isometry(big(), basis=None, sparsity=20_000), "sparsity of at most 16384"),
        (lambda: isometry(Matrix(np.zeros((5, 60))), basis=None, sparsity=3), "measures nothing"),
        (lambda: pixel_groups(SCENE, count=1, window=(5, 1)), "5 × 1 pixels does not fit"),
        (lambda: pixel_groups(SCENE, count=0), "count must be at least 1"),
        (lambda: gram_deviation(random_matrix(), np.arange(5)), r"whole numbers \(group, size\)"),
        (lambda: gram_deviation(random_matrix(), np.ones((1, 2))), "whole numbers"),
        (lambda: gram_deviation(random_matrix(), np.array([[0, 60]])), "voxels from 0 to 59, got 0 to 60"),
        (lambda: gram_deviation(random_matrix(), np.array([[3, 1, 3]])), "the same voxel twice"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(ValueError, match=message):
        call()
