"""The SSCSI against dense matrices written with plain loops from the equations, the author's own matrices, and closed forms."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import shadowgram as sg
from shadowgram.operators import as_matrix, shot_gram


def camera(**changes):
    geometry = {
        "detector_shape": (4, 7),
        "detector_pitch": 10.0,
        "code_pitch": 10.0,
        "mask_position": 0.4,
        "wavelengths": (450.0, 650.0),
    }
    return sg.SSCSI(**(geometry | changes))


# Odd, even and non-square detectors; both regimes, and their border Δc = Δd(1−s); the mask on the detector; β ≠ 1; bands given.
GEOMETRIES = [
    {},
    {"detector_shape": (3, 8), "mask_position": 0.1875},
    {"detector_shape": (5, 6), "mask_position": 0.0},
    {"detector_shape": (5, 6), "mask_position": 0.0, "bands": 3},
    {"detector_shape": (3, 6), "mask_position": 0.1},
    {"detector_shape": (3, 5), "detector_pitch": 20.0, "mask_position": 0.3},
    {"detector_shape": (2, 6), "detector_pitch": 20.0, "mask_position": 0.5},
    {"detector_shape": (3, 5), "detector_pitch": 20.0, "mask_position": 0.7},
    {"detector_shape": (2, 5), "detector_pitch": 30.0, "mask_position": 0.45},
    {"mask_position": 0.3, "dispersion_ratio": 2.5},
    {"mask_position": 0.3, "dispersion_ratio": 0.6},
    {"detector_shape": (3, 4), "detector_pitch": 20.0, "mask_position": 0.25, "dispersion_ratio": 1.7},
    {"detector_shape": (3, 9), "mask_position": 0.4, "bands": 11},
    {"detector_shape": (3, 9), "mask_position": 0.4, "bands": 2},
    {"detector_shape": (2, 4), "detector_pitch": 20.0, "mask_position": 0.25, "bands": 5},
]


def seen_transmittance(row, u0, u1, start, spread):
    """Mean over [u0, u1] and over shifts [start, start + spread] of a code row, column by column, exactly.

    The length of the shifts that put u into column j is piecewise linear in u, so the trapezoid rule between its breaks is exact.
    """
    total = 0.0
    for j, t in enumerate(row):
        if spread == 0:
            total += t * max(0.0, min(u1, j + 1 - start) - max(u0, j - start))
            continue
        breaks = sorted({u0, u1, *(b for b in (j - start, j + 1 - start, j - start - spread, j + 1 - start - spread))})
        breaks = [b for b in breaks if u0 <= b <= u1]

        def length(u, j=j):
            return max(0.0, min(start + spread, j + 1 - u) - max(start, j - u))

        total += t * sum((b - a) * (length(a) + length(b)) / 2 for a, b in itertools.pairwise(breaks)) / spread
    return total / (u1 - u0)


def sensing_matrix(imager, code):
    """H by plain loops: THEORY of eqs. (2.2), (2.19), (2.23), with a band's code at its edge, its centre or averaged over it."""
    s, ratio = imager.mask_position, round(imager.detector_pitch / imager.code_pitch)
    rows, columns = imager.detector_shape
    code_columns = columns * ratio
    bands, ny, nx = imager.resolution.cube_shape
    spectrum = s * imager.dispersion_ratio * code_columns
    step = min(1.0, spectrum) if imager.bands is None else spectrum / bands
    spread = step if imager.shear == "exact" else 0.0
    shift = {"edge": 0.0, "centre": step / 2, "exact": 0.0}[imager.shear]
    offset = s * code_columns * (1 - imager.dispersion_ratio) / 2
    width = ratio * (1 - s)
    super_resolving = width >= 1
    first_cell = math.floor(offset + 1e-9)
    H = np.zeros((len(code), rows, columns, bands, ny, nx))
    for q, m, k, y in itertools.product(range(len(code)), range(columns), range(bands), range(ny)):
        u0, u1 = offset + m * width, offset + (m + 1) * width
        for v in range(nx):
            if super_resolving:
                a, b = max(u0, first_cell + v), min(u1, first_cell + v + 1)
                part = b - a
            else:
                a, b, part = u0, u1, float(v == m)
            if part > 1e-9:
                seen = seen_transmittance(code[q, y], a, b, k * step + shift, spread)
                H[q, y // ratio, m, k, y, v] = part * seen
    return H.reshape(len(code) * rows * columns, -1)


@pytest.mark.parametrize("shear", ["exact", "centre", "edge"])
@pytest.mark.parametrize("geometry", GEOMETRIES, ids=str)
@pytest.mark.parametrize("kind", ["boolean", "gray"])
def test_operator_equals_the_dense_matrix(geometry, shear, kind):
    imager = camera(shear=shear, **geometry)
    rng = np.random.default_rng(1)
    code = sg.codes.boolean(shots=3, shape=imager.code_shape, seed=1)
    if kind == "gray":
        code = rng.random(code.shape)
    H = imager.operator(code)
    wanted = sensing_matrix(imager, code if kind == "boolean" else code.astype(np.float32).astype(float))
    assert np.abs(as_matrix(H) - wanted).max() < 1e-12
    assert np.abs(as_matrix(H.H) - wanted.T).max() < 1e-12
    assert sg.testing.dot_test(H) < 1e-12
    assert sg.testing.dot_test(H, np.float32) < 1e-5


@pytest.mark.parametrize("shots", [1, 2, 4, 7, 8, 9, 17])
def test_any_number_of_shots(shots):
    imager = camera(detector_shape=(3, 11), mask_position=0.3)
    code = sg.codes.random(shots=shots, shape=imager.code_shape, seed=2)
    assert np.abs(as_matrix(imager.operator(code)) - sensing_matrix(imager, code)).max() < 1e-12


@pytest.mark.parametrize(("columns", "ratio"), [(130, 1), (257, 1), (70, 2)])
def test_more_columns_than_a_tile(columns, ratio):
    imager = camera(detector_shape=(1, columns), detector_pitch=10.0 * ratio, mask_position=0.015)
    code = sg.codes.boolean(shots=2, shape=imager.code_shape, seed=2)
    assert np.abs(as_matrix(imager.operator(code)) - sensing_matrix(imager, code)).max() < 1e-12


@pytest.mark.parametrize(("s", "bands"), [(0.046875, 6), (0.1875, 24)])
def test_golden_matrices_of_the_author(data, s, bands):
    """Edgar-Noita/SSCSI-Coded-aperture-optimization, printed to 4 decimals: half a unit of the last one is 5e-5."""
    import scipy.io

    stored = scipy.io.loadmat(data / "sscsi_vi" / f"Vi_t_128_s{s}.mat")
    V = next(v for k, v in stored.items() if not k.startswith("_")).tocsc()
    imager = camera(detector_shape=(128, 128), mask_position=s, shear="edge")
    code = sg.codes.random(shots=1, shape=(128, 128), seed=0)
    wanted = (V.T @ code[0].ravel(order="F").astype(float)).reshape(bands, 128, 128).transpose(0, 2, 1)
    assert imager.effective_code(code).shape == (1, bands, 128, 128)
    assert np.abs(imager.effective_code(code)[0] - wanted).max() <= 5.0001e-5


@pytest.mark.parametrize("shear", ["exact", "centre", "edge"])
def test_effective_code_is_the_diagonal_of_the_operator(shear):
    imager = camera(detector_shape=(3, 9), detector_pitch=20.0, mask_position=0.6, shear=shear)
    code = sg.codes.random(shots=2, shape=imager.code_shape, seed=0)
    seen = imager.effective_code(code)
    cube = np.random.default_rng(0).random(imager.resolution.cube_shape)
    snapshots = (seen * cube).sum(axis=1).reshape(2, 3, 2, 9).sum(axis=2)
    np.testing.assert_allclose(imager.operator(code).forward(cube), snapshots, rtol=1e-12)


def test_effective_code_needs_the_detector_limited_regime():
    imager = camera(detector_pitch=20.0, mask_position=0.1)
    with pytest.raises(ValueError, match="super-resolving"):
        imager.effective_code(np.ones(imager.code_shape))


@pytest.mark.parametrize("geometry", GEOMETRIES, ids=str)
def test_shot_gram_is_the_gram_matrix_per_detector_element(geometry):
    imager = camera(**geometry)
    H = imager.operator(sg.codes.random(shots=3, shape=imager.code_shape, seed=0))
    gram = shot_gram(H)
    if imager.resolution.regime == "super-resolving":
        assert gram is None
        return
    M = as_matrix(H)
    wanted = (M @ M.T).reshape(*H.out_shape, *H.out_shape)
    pixels = np.indices(H.out_shape[1:])
    full = np.zeros_like(wanted)
    for a, b in itertools.product(range(3), repeat=2):
        full[a, pixels[0], pixels[1], b, pixels[0], pixels[1]] = gram[a, b]
    assert np.abs(full - wanted).max() < 1e-12


def test_mask_on_the_detector_codes_all_bands_alike():
    imager = camera(detector_shape=(4, 6), mask_position=0.0, bands=5)
    code = sg.codes.random(shots=2, shape=imager.code_shape, seed=0)
    seen = imager.effective_code(code) if imager.resolution.regime == "detector-limited" else None
    assert seen is None  # Δc = Δd at s = 0 is the border case, and counts as super-resolving
    cube = np.random.default_rng(0).random((5, 4, 6))
    np.testing.assert_allclose(imager.operator(code).forward(cube), code * cube.sum(axis=0), rtol=1e-12)


@settings(deadline=None, max_examples=25)
@given(
    s=st.floats(0, 0.95),
    columns=st.integers(1, 12),
    ratio=st.integers(1, 3),
    shots=st.integers(1, 5),
    shear=st.sampled_from(["exact", "centre", "edge"]),
    seed=st.integers(0, 99),
)
def test_complementary_shots_sum_to_the_open_code(s, columns, ratio, shots, shear, seed):
    imager = camera(detector_shape=(2, columns), detector_pitch=10.0 * ratio, mask_position=s, shear=shear)
    cube = np.random.default_rng(seed).random(imager.resolution.cube_shape)
    snapshots = imager.operator(sg.codes.boolean(shots=shots, shape=imager.code_shape, seed=seed)).forward(cube)
    opened = imager.operator(np.ones(imager.code_shape)).forward(cube)
    assert (snapshots >= 0).all()
    np.testing.assert_allclose(snapshots.sum(axis=0), opened[0], rtol=1e-10, atol=1e-12)


def test_open_code_keeps_the_light_of_bands_that_are_not_vignetted():
    imager = camera(detector_shape=(4, 16), mask_position=0.25)
    assert imager.resolution.vignetted == (0.0,) * 4
    cube = np.random.default_rng(0).random(imager.resolution.cube_shape)
    np.testing.assert_allclose(
        imager.operator(np.ones(imager.code_shape)).forward(cube)[0], cube.sum(axis=0), rtol=1e-12
    )


def test_a_long_spectral_plane_vignettes_both_ends():
    imager = camera(detector_shape=(2, 64), mask_position=0.25, dispersion_ratio=3.0)
    missed = np.array(imager.resolution.vignetted)
    assert missed[0] > 0.2
    assert missed[-1] > 0.2
    assert missed[len(missed) // 2] == 0
    H = imager.operator(np.ones(imager.code_shape))
    through = np.array(
        [H.forward(np.eye(len(missed))[k, :, None, None] * np.ones(H.in_shape)).mean() for k in range(len(missed))]
    )
    np.testing.assert_allclose(1 - through, missed, atol=1e-12)


def test_the_cube_of_the_dissertation():
    """Nd = 128, Δc = Δd/2, s ≈ 0.1: 233 × 256 × 24 (section 2.4.3.1); ⌈256(1−s)⌉ = 233 and ⌈256s⌉ = 24 at s = 0.0918."""
    imager = camera(detector_shape=(128, 128), detector_pitch=20.0, mask_position=0.0918)
    assert imager.resolution.cube_shape == (24, 256, 233)
    assert imager.resolution.regime == "super-resolving"
    assert imager.resolution.x_pitch == pytest.approx(10 / (1 - 0.0918))
    assert imager.resolution.y_pitch == 10


def test_resolution_of_the_detector_limited_regime():
    imager = camera(detector_shape=(256, 256), mask_position=0.09375)
    resolution = imager.resolution
    assert resolution.cube_shape == (24, 256, 256)
    assert resolution.band_width == pytest.approx(200 / 24)
    assert resolution.band_width == pytest.approx(imager.code_pitch / (imager.mask_position * imager.dispersion))
    assert resolution.x_pitch == resolution.y_pitch == 10
    np.testing.assert_allclose(resolution.band_edges[[0, -1]], [450, 650])
    np.testing.assert_allclose(np.diff(resolution.wavelengths), 200 / 24)


def test_finely_resolved_bands_measure_what_the_exact_shear_averages():
    coarse = camera(detector_shape=(3, 16), mask_position=0.25)
    fine = camera(detector_shape=(3, 16), mask_position=0.25, bands=4 * 32, shear="centre")
    code = sg.codes.boolean(shots=2, shape=coarse.code_shape, seed=0)
    cube = np.random.default_rng(0).random(coarse.resolution.cube_shape)
    measured = fine.operator(code).forward(np.repeat(cube, 32, axis=0) / 32)
    # the midpoint rule over 32 sub-bands is exact up to cells that a sub-band only partly crosses
    assert np.abs(measured - coarse.operator(code).forward(cube)).max() < 0.02
    edge = camera(detector_shape=(3, 16), mask_position=0.25, shear="edge").operator(code).forward(cube)
    assert np.abs(measured - edge).max() > 0.2


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mask_position": 1.0}, r"mask_position must lie in \[0, 1\)"),
        ({"mask_position": -0.1}, "mask_position"),
        ({"mask_position": math.nan}, "mask_position"),
        ({"detector_pitch": 15.0}, "whole multiple of code_pitch"),
        ({"detector_pitch": 5.0}, "whole multiple"),
        ({"code_pitch": 0.0}, "code_pitch must be a positive length"),
        ({"detector_pitch": math.inf}, "detector_pitch must be a positive length"),
        ({"detector_shape": (0, 4)}, "detector_shape must be"),
        ({"detector_shape": (4.0, 4)}, "detector_shape must be"),
        ({"detector_shape": (4,)}, "detector_shape must be"),
        ({"wavelengths": (650.0, 450.0)}, "wavelengths must be"),
        ({"wavelengths": (450.0, math.nan)}, "wavelengths must be"),
        ({"dispersion_ratio": 0.0}, "dispersion_ratio"),
        ({"shear": "center"}, "shear must be one of 'exact', 'centre', 'edge', got 'center'"),
        ({"bands": 0}, "bands must be a whole number"),
        ({"wavelengths": (0.45, 0.65)}, "are these µm"),
        ({"detector_shape": (8, 100_000), "mask_position": 0.05}, "code columns times 5000 bands are more than"),
        ({"bands": 10**9}, "more than 10000"),
        ({"dispersion_ratio": 1e9}, "more than 10000"),
    ],
)
def test_impossible_geometries(changes, message):
    with pytest.raises(ValueError, match=message):
        camera(**changes)


def test_results_do_not_depend_on_threads():
    imager = camera(detector_shape=(67, 33), mask_position=0.2)
    H = imager.operator(sg.codes.boolean(shots=3, shape=imager.code_shape, seed=0))
    cube = np.random.default_rng(0).random(H.in_shape, dtype=np.float32)
    with sg.threads(1):
        snapshots = H.forward(cube)
        back = H.adjoint(snapshots)
    for count in (2, 5):
        with sg.threads(count):
            assert np.array_equal(H.forward(cube), snapshots)
            assert np.array_equal(H.adjoint(snapshots), back)
