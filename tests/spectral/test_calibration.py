"""Calibration from captures of a white board: what it corrects, what it refuses, and what a reconstruction loses by it."""

import dataclasses

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.measurement import (
    Measurement,
    band_means,
    check_cube,
    imager_from_json,
    imager_to_json,
    read_measurement,
    write_measurement,
)
from shadowgram.operators import as_matrix
from shadowgram.spectral import CalibratedImager, calibrate

SHOTS, BANDS, NY, NX = 2, 3, 10, 12
CENTRES = (480.0, 550.0, 620.0)
BLACK = 100.0


def captures(seed=0, counts=3000.0):
    """White captures above the black level, (shot, band, y, x)."""
    return BLACK + counts * np.random.default_rng(seed).random((SHOTS, BANDS, NY, NX))


def made(white=None, **changes):
    keywords = {"wavelengths": CENTRES, "pitch": 9.9, "dark": np.full((NY, NX), BLACK)} | changes
    return calibrate(captures() if white is None else white, **keywords)


def test_code_and_scale_give_back_the_counts():
    white = captures()
    camera = made(white)
    assert camera.code.dtype == np.float32
    assert camera.code.max() == 1
    assert camera.code.min() >= 0
    np.testing.assert_allclose(camera.scale * camera.code, white - BLACK, rtol=1e-6, atol=1e-3)
    assert camera.imager == CalibratedImager(cube_shape=(BANDS, NY, NX), band_centres=CENTRES, pitch=9.9)


def test_dark_frames_are_averaged_and_noise_below_zero_is_cut():
    white = captures()
    white[0, 1, 3, 4] = BLACK - 20
    dark = BLACK + np.array([-6.0, 1.0, 5.0])[:, None, None] * np.ones((NY, NX))
    camera = made(white, dark=dark)
    assert camera.dark.shape == (NY, NX)
    np.testing.assert_allclose(camera.dark, BLACK)
    assert camera.code[0, 1, 3, 4] == 0


def test_the_response_of_pixels_is_taken_out_and_dead_ones_are_left_out():
    rng = np.random.default_rng(1)
    response = 1 + 0.1 * rng.standard_normal((NY, NX))
    response[2, 3] = 0.001
    flat = BLACK + 2000 * response
    ideal = captures() - BLACK
    camera = made(BLACK + ideal * response, flat=flat)
    alive = response > 0.5
    shape = response / response.mean()
    np.testing.assert_allclose(
        (camera.scale * camera.code)[..., alive], (ideal * response / shape)[..., alive], rtol=1e-4
    )
    assert not camera.code[..., 2, 3].any()
    snapshots = camera.snapshots(BLACK + ideal.sum(axis=1) * response)
    assert not snapshots[:, 2, 3].any()
    np.testing.assert_allclose(snapshots, camera.operator.forward(np.ones((BANDS, NY, NX), np.float32)), rtol=1e-3)


def test_snapshots_are_in_the_units_of_the_operator_for_any_exposure():
    white = captures()
    camera = made(white)
    target = np.random.default_rng(2).random((BANDS, NY, NX)).astype(np.float32)
    light = ((white - BLACK) * target).sum(axis=1)
    wanted = camera.operator.forward(target)
    np.testing.assert_allclose(camera.snapshots(BLACK + light), wanted, rtol=1e-4)
    longer = camera.snapshots(130 + 2.5 * light, exposure=2.5, dark=np.full((2, NY, NX), 130))
    np.testing.assert_allclose(longer, wanted, rtol=1e-4)


def test_the_operator_is_the_dense_matrix_of_the_white_captures():
    white = captures()
    camera = made(white)
    H = np.zeros((SHOTS, NY, NX, BANDS, NY, NX))
    for q in range(SHOTS):
        for k in range(BANDS):
            for y in range(NY):
                for x in range(NX):
                    H[q, y, x, k, y, x] = camera.code[q, k, y, x]
    np.testing.assert_allclose(as_matrix(camera.operator), H.reshape(SHOTS * NY * NX, -1), atol=1e-12)
    assert sg.testing.dot_test(camera.operator) < 1e-12
    assert sg.testing.dot_test(camera.operator, np.float32) < 1e-5


def test_uneven_bands_keep_their_wavelengths():
    imager = CalibratedImager(cube_shape=(4, 2, 2), band_centres=(450.0, 460.0, 480.0, 520.0), pitch=5.0)
    np.testing.assert_allclose(imager.resolution.band_edges, [445, 455, 470, 500, 540])
    np.testing.assert_allclose(imager.resolution.wavelengths, [450, 460, 480, 520])
    assert imager.wavelengths == (445.0, 540.0)
    assert imager.resolution.band_width == pytest.approx(70 / 3)
    assert "from 445 to 540 nm" in str(imager.resolution)
    fine = np.repeat(np.arange(19.0), 5)[:, None, None] * np.ones((1, 2, 2))  # steps of 5 nm from 445 to 540
    np.testing.assert_allclose(band_means(fine, imager)[:, 0, 0], [0.5, 3.0, 7.5, 14.5])


def test_even_bands_have_the_edges_of_other_imagers():
    imager = CalibratedImager(cube_shape=(3, 2, 2), band_centres=CENTRES, pitch=5.0)
    other = sg.CASSI(cube_shape=(3, 2, 2), wavelengths=(445, 655)).resolution
    np.testing.assert_allclose(imager.resolution.band_edges, other.band_edges)
    assert imager.resolution.band_width == other.band_width


def test_it_goes_through_a_measurement_file(tmp_path):
    camera = made()
    cube = sg.scenes.chart(size=(NY, NX), bands=BANDS, seed=0, wavelengths=camera.imager.wavelengths)
    check_cube(cube, camera.imager)
    measurement = Measurement(
        imager=camera.imager, code=camera.code, snapshots=camera.operator.forward(cube.values), scene="bench"
    )
    write_measurement(measurement, tmp_path / "shots.nc")
    again = read_measurement(tmp_path / "shots.nc")
    assert again.imager == camera.imager
    assert np.array_equal(again.code, camera.code)
    np.testing.assert_allclose(again.operator.forward(cube.values), measurement.snapshots)
    assert imager_from_json(imager_to_json(camera.imager)) == camera.imager


def white_with(**changes):
    white = captures()
    for (q, k), value in changes["at"].items():
        white[q, k] = value
    return white


@pytest.mark.parametrize(
    ("white", "changes", "message"),
    [
        (np.zeros((SHOTS, BANDS, NY, NX), complex), {}, "real numbers, got an array of complex128"),
        (np.zeros((SHOTS, BANDS, NY, NX), str), {}, "real numbers"),
        (np.zeros((BANDS, NY, NX)), {}, r"axes \(shot, band, y, x\), got an array of shape \(3, 10, 12\)"),
        (np.zeros((SHOTS, 0, NY, NX)), {}, "axes"),
        (captures()[:, :2], {}, "2 bands and 3 wavelengths: a band is missing"),
        (captures()[:, :1], {"wavelengths": [500.0]}, "at least two bands"),
        (None, {"wavelengths": (480.0, 620.0, 550.0)}, "ascending"),
        (None, {"wavelengths": (480.0, 550.0, np.nan)}, "ascending"),
        (None, {"wavelengths": "480"}, "list of numbers"),
        (None, {"pitch": 0.0}, "pitch"),
        (white_with(at={(1, 2): np.nan}), {}, r"\(shot, band, y, x\) = \(1, 2, 0, 0\) is nan"),
        (white_with(at={(1, 2): BLACK}), {}, r"shot 1, band 2 \(from 0\), 620 nm, is dark"),
        (white_with(at={(0, 1): 4095.0}), {"saturation": 4095}, "shot 0, band 1 .* saturated in 100 %"),
        (np.full((SHOTS, BANDS, NY, NX), 255, np.uint8), {}, "saturated"),
        (None, {"dark": np.full((NY, NX), 5000.0)}, "no white capture is brighter than dark"),
        (None, {"dark": np.zeros((NX, NY))}, r"dark must have the captures' \(y, x\) = \(10, 12\), got \(12, 10\)"),
        (None, {"dark": np.full((NY, NX), np.inf)}, "dark must be finite"),
        (None, {"flat": np.full((NY, NX), BLACK)}, "flat must be brighter than dark"),
        (None, {"flat": BLACK + 100 * (np.arange(NX) % 2) * np.ones((NY, 1))}, "flat is dark in 50 %"),
        (None, {"flat": np.ones(NX)}, "flat must have the axes"),
    ],
)
def test_what_is_wrong_is_said(white, changes, message):
    with pytest.raises((ValueError, TypeError), match=message):
        made(white, **changes)


def test_a_dark_frame_is_found_in_noise_and_a_dim_one_is_not_taken_for_it():
    rng = np.random.default_rng(3)
    white = captures() + 5 * rng.standard_normal((SHOTS, BANDS, NY, NX))
    dim = white.copy()
    dim[1, 0] = BLACK + 0.01 * (dim[1, 0] - BLACK) + 5 * rng.standard_normal((NY, NX))
    made(dim)
    dim[1, 0] = BLACK + 5 * rng.standard_normal((NY, NX))
    with pytest.raises(ValueError, match="shot 1, band 0"):
        made(dim)


def test_saturation_counts_pixels():
    white = np.random.default_rng(0).integers(100, 4000, (1, 2, 100, 100)).astype(np.uint16)
    white[0, 1].flat[:10] = 4095
    calibrate(white, wavelengths=(500, 600), pitch=5.0, saturation=4095)
    white[0, 1].flat[:11] = 4095
    with pytest.raises(ValueError, match=r"shot 0, band 1 .* saturated in 0\.11 %"):
        calibrate(white, wavelengths=(500, 600), pitch=5.0, saturation=4095)
    with pytest.raises(
        ValueError, match=r"0\.11 % of the pixels of the white capture have the same largest value, 4095"
    ):
        calibrate(white, wavelengths=(500, 600), pitch=5.0)  # full scale is 65535
    white[0, 1].flat[:11] = 3999  # as many as noise may leave there
    calibrate(white, wavelengths=(500, 600), pitch=5.0)
    white[0, 1].flat[:11] = 4095
    calibrate(white, wavelengths=(500, 600), pitch=5.0, saturation=np.inf)


def test_bands_of_a_coarse_camera_are_no_plateau():
    white = np.random.default_rng(0).integers(5, 60, (1, 2, 100, 100)).astype(np.uint8)
    calibrate(white, wavelengths=(500, 600), pitch=5.0)


def test_a_band_that_was_stored_twice_is_found():
    white = np.random.default_rng(0).integers(100, 4000, (2, 3, 20, 20)).astype(np.uint16)
    white[:, 2] = white[:, 1]
    with pytest.raises(ValueError, match="at 600 and 700 nm are the same in every pixel"):
        calibrate(white, wavelengths=(500, 600, 700), pitch=5.0, saturation=4095)


@pytest.mark.parametrize(("saturation", "message"), [(np.nan, "above 0"), (-5.0, "above 0")])
def test_impossible_saturation(saturation, message):
    with pytest.raises(ValueError, match=message):
        calibrate(np.ones((1, 2, 8, 8)), wavelengths=(500, 600), pitch=5.0, saturation=saturation)


def test_wavelengths_in_micrometres_are_asked_about():
    with pytest.raises(ValueError, match=r"0\.5 to 0\.6: are these µm"):
        calibrate(np.ones((1, 2, 8, 8)), wavelengths=(0.5, 0.6), pitch=5.0)


@pytest.mark.parametrize(
    ("raw", "keywords", "message"),
    [
        (np.zeros((SHOTS + 1, NY, NX)), {}, r"\(2, 10, 12\), got \(3, 10, 12\)"),
        (np.full((SHOTS, NY, NX), np.nan), {}, "finite"),
        (np.zeros((SHOTS, NY, NX), complex), {}, "real numbers"),
        (np.zeros((SHOTS, NY, NX)), {"exposure": 0.0}, "exposure"),
        (np.full((SHOTS, NY, NX), 65535, np.uint16), {}, "the capture of shot 0 is saturated"),
        (np.zeros((SHOTS, NY, NX)), {"dark": np.zeros((NY, NY))}, "dark must have"),
    ],
)
def test_snapshots_that_do_not_fit_are_refused(raw, keywords, message):
    with pytest.raises((ValueError, TypeError), match=message):
        made().snapshots(raw, **keywords)


def test_an_imager_is_checked():
    good = CalibratedImager(cube_shape=(3, 4, 5), band_centres=CENTRES, pitch=5.0)
    for changes in (
        {"cube_shape": (3, 4)},
        {"band_centres": CENTRES[:2]},
        {"pitch": -1.0},
        {"band_centres": (1, 3, 2)},
    ):
        with pytest.raises(ValueError, match=r"cube_shape|bands|pitch|ascending"):
            dataclasses.replace(good, **changes)


def test_reconstruction_through_a_calibration_is_near_that_of_the_ideal_model():
    """The whole way: lamp, response of the pixels, black level and noise are in the captures, and not in the result."""
    size, bands, shots = 64, 6, 3
    imager = sg.SSCSI(
        detector_shape=(size, size),
        detector_pitch=10.0,
        code_pitch=10.0,
        mask_position=bands / size,
        wavelengths=(450, 650),
    )
    code = sg.codes.boolean(shots=shots, shape=imager.code_shape, seed=0)
    reflectance = sg.scenes.chart(size=size, bands=bands, seed=0).values
    rng = np.random.default_rng(5)
    lamp = np.linspace(0.5, 1.0, bands)[:, None, None] * np.hanning(3 * size)[size : 2 * size]
    response = 1 + 0.05 * rng.standard_normal((size, size))
    black = 64 + 4 * rng.random((size, size))

    def counts(light):
        return np.rint(black + 3000 * response * light + 3 * rng.standard_normal(light.shape))

    ideal = imager.operator(code)
    white = np.mean([counts(imager.effective_code(code) * lamp) for _ in range(8)], axis=0)
    camera = calibrate(
        white,
        wavelengths=imager.resolution.wavelengths,
        pitch=10.0,
        dark=np.stack([counts(np.zeros((size, size))) for _ in range(32)]),
        flat=np.stack([counts(np.full((size, size), 0.8)) for _ in range(32)]),
    )
    raw = counts(ideal.forward(reflectance * lamp))
    found = sg.solve(sg.EigenTV(), camera.operator, camera.snapshots(raw)).x
    clean = sg.solve(sg.EigenTV(), ideal, sg.noise.awgn(ideal.forward(reflectance), snr_db=50, seed=0)).x
    quality, best = (sg.metrics.psnr(x, reflectance, peak=1.0) for x in (found, clean))
    assert quality > best - 1
    uncorrected = sg.solve(sg.EigenTV(), ideal, ((raw - 64) / 3000).astype(np.float32)).x
    assert quality > sg.metrics.psnr(uncorrected, reflectance, peak=1.0) + 5
