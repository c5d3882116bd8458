"""What is wrong with a model, found from a capture: simulated with known errors."""

import dataclasses

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, shift

import shadowgram as sg
from shadowgram.operators.structure import shot_gram
from shadowgram.solvers._parts import Weighted
from shadowgram.spectral import _mismatch_fit as windowed
from shadowgram.spectral._mismatch_refine import Capture, Model, _slopes, moved_code, parameters
from shadowgram.spectral._mismatch_windows import windows_of
from shadowgram.testing import dot_test

BANDS, SIDE = 6, 80


def gray_mask(shots=1, shape=(SIDE, SIDE)):
    """A mask as a camera sees it: blurred elements."""
    raw = np.random.default_rng(1).random((shots, *shape))
    smooth = gaussian_filter(raw, (0, 0.7, 0.7))
    return ((smooth - smooth.min()) / np.ptp(smooth)).astype(np.float32)


def scene(bands=BANDS, side=SIDE):
    cube = sg.scenes.chart(size=side, bands=bands, seed=0).values.copy()
    cube[:, :12] = cube[:, -12:] = 0
    cube[:, :, :12] = 0
    return cube


def imager_of(bands=BANDS, side=SIDE, shift_px=2):
    return sg.CASSI(cube_shape=(bands, side, side), wavelengths=(450, 650), band_shift=shift_px)


def simulated(dy, dx, scale, offset=0.0, gains=(1.0,), noise=1e-3):
    """Shots of a mask that is elsewhere, with a wrong dispersion."""
    imager = imager_of()
    mask = gray_mask(len(gains))
    right = dx + scale * imager.displacements
    true = np.stack([[shift(m, (dy, x), order=3, mode="nearest") for x in right] for m in mask]).clip(0, 1)
    colored = sg.ColoredCASSI(cube_shape=imager.cube_shape, wavelengths=imager.wavelengths, band_shift=2)
    y = colored.operator(true.astype(np.float32)).forward(scene()) * np.array(gains)[:, None, None] + offset
    y += np.random.default_rng(0).normal(0, noise, y.shape) * y.max()
    return imager, mask, y.astype(np.float32)


def test_finds_shift_dispersion_gains_and_dark_level():
    gains = np.array([1.05, 0.95])
    imager, mask, y = simulated(0.3, -0.4, 0.06, offset=0.2, gains=gains)
    found = sg.spectral.estimate_mismatch(imager, mask, y)
    assert abs(found.dy - 0.3) < 3 * found.dy_error < 0.3
    assert abs(found.dx + 0.4) < 3 * found.dx_error < 0.6
    assert abs(found.dispersion - 1.06) < 3 * found.dispersion_error
    assert (np.abs(found.gains - gains / np.sqrt(gains.prod())) < 2 * found.gain_errors).all()
    assert found.gain_errors.max() < 0.03
    assert np.abs(found.offsets - 0.2).max() < 0.03
    assert found.held_out[1] < 0.8 * found.held_out[0]
    assert isinstance(found.imager, sg.ColoredCASSI)
    assert found.operator.out_shape == found.snapshots.shape
    assert "mask" in str(found)


@pytest.fixture(scope="module")
def right():
    return sg.spectral.estimate_mismatch(*simulated(0.0, 0.0, 0.0))


def test_a_model_that_is_right_is_left_alone(right):
    found = right
    assert abs(found.dy) < 3 * found.dy_error
    assert abs(found.dispersion - 1) < 3 * found.dispersion_error
    assert found.imager == imager_of()
    assert not found.displaced.any()


def test_the_mask_of_a_calibrated_camera():
    code = gray_mask(12, (48, 48)).reshape(3, 4, 48, 48)
    imager = sg.spectral.CalibratedImager(cube_shape=(4, 48, 48), band_centres=(475, 525, 575, 625), pitch=10.0)
    moved = shift(code, (0, 0, 0.5, -0.5), order=3, mode="nearest").clip(0, 1)
    found = sg.spectral.estimate_mismatch(imager, code, imager.operator(moved).forward(scene(4, 48)))
    assert abs(found.dy - 0.5) < 3 * found.dy_error < 0.3
    assert abs(found.dx + 0.5) < 3 * found.dx_error < 0.4
    assert (found.dispersion, found.dispersion_error) == (1, 0)
    assert found.code.shape == code.shape
    assert np.abs(found.code - moved)[:, :, 3:-3, 3:-3].max() < 0.5 * np.abs(code - moved)[:, :, 3:-3, 3:-3].max()


def test_windows_of_a_flat_scene_say_the_dark_level_exactly():
    imager, mask = imager_of(bands=4), gray_mask()
    H = imager.operator(mask)
    y = H.forward(np.full(H.in_shape, 0.5)) + 0.25
    windows = windows_of(H, y, 500)
    offsets, _ = windowed.fit_offsets(windows, (0.0, 0.0), np.zeros(1), 1e-8)
    assert abs(offsets[0] - 0.25) < 0.01


def test_moved_patterns_are_those_of_a_moved_mask():
    imager, mask = imager_of(bands=4, side=48), gray_mask(shape=(48, 48))
    H = imager.operator(mask)
    windows = windows_of(H, np.ones(H.out_shape), 500)
    inner = (windows.rows.min(axis=1) > 8) & (windows.rows.max(axis=1) < 40)
    inner &= (windows.columns.min(axis=1) > 16) & (windows.columns.max(axis=1) < 40)
    one_band = np.zeros(H.in_shape)
    one_band[2] = 1
    wanted = shift(H.forward(one_band)[0], (1.3, -0.6), order=3, mode="mirror")[windows.rows, windows.columns]
    got, down = windows.patterns_and_slopes(1.3, -0.6)
    assert inner.sum() > 5
    np.testing.assert_allclose(got[inner][:, :, 2], wanted[inner], atol=1e-5)
    difference = (windows.patterns(1.31, -0.6) - windows.patterns(1.29, -0.6)) / 0.02
    np.testing.assert_allclose(down[inner], difference[inner], atol=5e-3)


@pytest.mark.parametrize("shape", [(3, 9, 8), (2, 8, 11)])
def test_held_out_operator_is_the_whole_one_without_some_pixels(shape):
    imager = sg.CASSI(cube_shape=shape, wavelengths=(450, 650))
    code = sg.codes.random(shots=2, shape=imager.code_shape, seed=0)
    H = imager.operator(code)
    kept = (np.random.default_rng(0).random(H.out_shape) > 0.3).astype(np.float32)
    A = Weighted(H, kept)
    assert dot_test(A) < 1e-12
    assert dot_test(A, np.float32) < 1e-5
    dense = np.zeros((np.prod(A.out_shape), np.prod(shape)))
    for q in range(2):
        for k in range(shape[0]):
            for i in range(shape[1]):
                for j in range(shape[2]):
                    row = np.ravel_multi_index((q, i, j + k), A.out_shape)
                    dense[row, np.ravel_multi_index((k, i, j), shape)] = kept[q, i, j + k] * code[q, i, j]
    x = np.random.default_rng(1).random(shape)
    np.testing.assert_allclose(A.forward(x).ravel(), dense @ x.ravel(), atol=1e-12)
    gram = shot_gram(A)
    whole = dense @ dense.T
    pixels = np.prod(A.out_shape[1:])
    for q in range(2):
        for r in range(2):
            diagonal = np.diag(whole[q * pixels : (q + 1) * pixels, r * pixels : (r + 1) * pixels])
            np.testing.assert_allclose(gram[q, r].ravel(), diagonal, atol=1e-12)


def test_slopes_are_the_derivatives_of_the_snapshots():
    imager, mask = imager_of(bands=3, side=24), gray_mask(2, (24, 24))
    y = np.zeros((2, 24, 28), np.float32)
    capture = Capture(code=mask, snapshots=y, rows=slice(4, 20), dispersion=imager._dispersion, bands=3)
    cube = np.random.default_rng(0).random((3, 16, 24)).astype(np.float32)
    model = Model(place=(0.2, -0.1, 0.01), blur=(0.2, 0.2), log_gains=np.array([0.1, -0.1]))

    def seen(m):
        return capture.operator(capture.codes(m)).forward(cube)

    code = capture.codes(model)
    names = parameters(capture)
    assert names == ["dy", "dx", "scale", "blur_y", "blur_x", "gain_1"]
    slopes = dict(zip(names, _slopes(capture, model, cube, seen(model), code, names), strict=True))
    for name, trial, h in (
        ("dy", dataclasses.replace(model, place=(0.22, -0.1, 0.01)), 0.02),
        ("dx", dataclasses.replace(model, place=(0.2, -0.08, 0.01)), 0.02),
        ("scale", dataclasses.replace(model, place=(0.2, -0.1, 0.015)), 0.005),
        ("blur_y", dataclasses.replace(model, blur=(0.22, 0.2)), 0.02),
        ("gain_1", dataclasses.replace(model, log_gains=np.array([0.09, -0.09])), 0.01),
    ):
        difference = (seen(trial) - seen(model)) / h
        error = np.linalg.norm(slopes[name] - difference) / np.linalg.norm(difference)
        assert error < 0.15, name


def test_moved_code_goes_down_and_right():
    code = np.zeros((1, 16, 16))
    code[0, 8, 8] = 1
    moved = moved_code(code, 2.0, np.array([0.0, 3.0]), (0.0, 0.0))
    assert moved.shape == (1, 2, 16, 16)
    assert np.argwhere(moved[0, 1] > 0.99).tolist() == [[10, 11]]
    assert moved_code(code, 0.0, np.zeros(2), (0.5, 0.0))[0, 0, 7, 8] > 0.1


def test_some_rows_of_a_moved_code_are_those_of_the_whole():
    code = np.random.default_rng(0).random((2, 80, 20))
    right = np.array([0.3, -0.5])
    whole = moved_code(code, 1.4, right, (0.3, 0.1))
    for rows in (slice(30, 50), slice(0, 20), slice(70, 80)):
        np.testing.assert_allclose(moved_code(code, 1.4, right, (0.3, 0.1), rows), whole[:, :, rows], atol=1e-5)


def test_aligned_moves_bands_onto_each_other(right):
    cube = np.zeros((BANDS, 4, 16))
    cube[:, :, 8] = 1
    moved = dataclasses.replace(right, displaced=np.full(BANDS, 2.0)).aligned(cube)
    assert np.argmax(moved[0, 0]) == 6
    assert dataclasses.replace(right, displaced=np.zeros(BANDS)).aligned(cube) is cube


def test_what_cannot_be_estimated_is_refused():
    imager, mask = imager_of(), gray_mask()
    y = np.ones((1, SIDE, SIDE + 10))
    with pytest.raises(ValueError, match="shot 0 is 1 in every pixel"):
        sg.spectral.estimate_mismatch(imager, mask, y)
    with pytest.raises(ValueError, match="snapshots of shape"):
        sg.spectral.estimate_mismatch(imager, mask, y[:, :, 1:])
    with pytest.raises(TypeError, match="CASSI"):
        sg.spectral.estimate_mismatch(sg.DualCASSI(cube_shape=(4, 8, 8), wavelengths=(450, 650)), mask, y)
    small = imager_of(side=8)
    with pytest.raises(ValueError, match="too small"):
        sg.spectral.estimate_mismatch(small, mask[:, :8, :8], np.random.default_rng(0).random((1, 8, 18)))


def test_bands_with_centres_of_their_own():
    imager = sg.CASSI(cube_shape=(4, 8, 8), band_centres=(450, 470, 500, 550), band_shift=2)
    assert imager.wavelengths == (440.0, 575.0)
    assert imager.resolution.wavelengths.tolist() == [450, 470, 500, 550]
    assert imager.displacements.tolist() == [0, 2, 4, 6]
    fine = imager.finer(2).resolution
    np.testing.assert_allclose(fine.wavelengths, [445, 455, 465, 477.5, 492.5, 512.5, 537.5, 562.5])
    assert dataclasses.replace(imager, cube_shape=(4, 16, 8)).band_centres == imager.band_centres
    with pytest.raises(ValueError, match="a band is missing"):
        sg.CASSI(cube_shape=(4, 8, 8), band_centres=(450, 470, 500))
    with pytest.raises(ValueError, match="leave wavelengths out"):
        sg.CASSI(cube_shape=(4, 8, 8), band_centres=(450, 470, 500, 550), wavelengths=(450, 650))
    with pytest.raises(ValueError, match="say wavelengths"):
        sg.CASSI(cube_shape=(4, 8, 8))


def test_a_curve_is_read_at_the_centres_of_uneven_bands():
    curve = ((440.0, 0.0), (600.0, 16.0))
    imager = sg.CASSI(cube_shape=(4, 8, 8), band_centres=(450, 470, 500, 550), dispersion=curve)
    np.testing.assert_allclose(imager.displacements, [0, 2, 5, 10])


def test_uneven_bands_in_files(tmp_path):
    from shadowgram.measurement import Measurement, band_means, imager_from_json, read_measurement, write_measurement

    imager = sg.CASSI(cube_shape=(4, 8, 8), band_centres=(450, 470, 500, 550), band_shift=2)
    code = gray_mask(shape=(8, 8))
    write_measurement(Measurement(imager=imager, code=code, snapshots=np.ones((1, 8, 14))), tmp_path / "shots.nc")
    back = read_measurement(tmp_path / "shots.nc")
    assert back.imager == imager
    np.testing.assert_array_equal(back.code, code)
    old = '{"type": "CASSI", "cube_shape": [3, 8, 10], "wavelengths": [450, 650], "band_shift": 1}'
    assert imager_from_json(old).band_centres is None
    means = band_means(np.arange(8.0).reshape(8, 1, 1), imager)
    assert means.ravel().tolist() == [0.5, 2.5, 4.5, 6.5]
    with pytest.raises(ValueError, match="a multiple of"):
        band_means(np.ones((6, 1, 1)), imager)
