"""What captures tell, against captures simulated here: exact means over boxes of a finely drawn, blurred mask."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

import shadowgram as sg
from shadowgram.spectral import _registration_geometry as placement
from shadowgram.spectral import calibrate, estimate_geometry, measured_resolution, misregistration

FINE = 10  # samples per code element
BESIDE = 12  # closed code elements drawn on each side


def drawn(values, blur):
    """Function edges → means between them, along the last axis, of a blurred piecewise constant function."""
    sides = [(0, 0)] * (values.ndim - 1) + [(BESIDE, BESIDE)]
    fine = np.repeat(np.pad(values, sides), FINE, axis=-1)
    if blur:
        fine = gaussian_filter1d(fine, blur * FINE, axis=-1, mode="constant")
    below = np.concatenate([np.zeros((*fine.shape[:-1], 1)), np.cumsum(fine, axis=-1)], axis=-1) / FINE

    def means(edges):
        place = np.clip((edges + BESIDE) * FINE, 0, below.shape[-1] - 1)
        left = np.minimum(place.astype(int), below.shape[-1] - 2)
        share = place - left
        return np.diff(below[..., left] * (1 - share) + below[..., left + 1] * share, axis=-1) / (edges[1] - edges[0])

    return means


def white_captures(code, offsets, position, *, ratio=1, dy=0.0, blur=0.0, band=0.0):
    """(shot, band, y, x): elements of band k see the code from offsets[k] + m·ratio(1 − s), rows from ratio(n + dy)."""
    ny, nx = code.shape[1] // ratio, code.shape[2] // ratio
    rows = drawn(code.astype(float).swapaxes(1, 2), blur)(ratio * (np.arange(ny + 1) + dy)).swapaxes(1, 2)
    mask, columns = drawn(rows, blur), ratio * (1 - position) * np.arange(nx + 1)
    within = band * (np.arange(8) - 3.5) / 8 if band else [0.0]
    return np.stack([np.mean([mask(o + d + columns) for d in within], axis=0) for o in offsets], axis=1)


def camera(position, bands, size, *, beta=1.0, ratio=1, dx=0.0):
    """(offsets of the bands, their width in columns, wavelengths) of an SSCSI, as `SSCSI` defines them, shifted by dx."""
    columns = position * beta * size * ratio
    offsets = position * size * ratio * (1 - beta) / 2 + columns * (np.arange(bands) + 0.5) / bands + dx
    edges = np.linspace(450, 650, bands + 1)
    return offsets, columns / bands, (edges[1:] + edges[:-1]) / 2


def boolean(size, seed=0, shots=2):
    return sg.codes.boolean(shots=shots, shape=(size, size), seed=seed)


def test_the_simulator_agrees_with_the_imager():
    imager = sg.SSCSI(
        detector_shape=(32, 32),
        detector_pitch=10.0,
        code_pitch=10.0,
        mask_position=0.15,
        wavelengths=(450, 650),
        dispersion_ratio=1.3,
        bands=5,
    )
    code = boolean(32)
    offsets, width, _ = camera(0.15, 5, 32, beta=1.3)
    wanted = imager.effective_code(code)
    np.testing.assert_allclose(white_captures(code, offsets, 0.15, band=width), wanted, atol=0.02)


# Shift against a calibration


@pytest.mark.parametrize("blur", [0.0, 0.4, 1.0])
@pytest.mark.parametrize(("dy", "dx"), [(0.0, 0.0), (0.3, -0.5), (-2.6, 1.45), (6.9, -7.2)])
def test_a_shift_of_white_captures_is_found_to_a_fiftieth_of_a_pixel(dy, dx, blur):
    code, offsets = boolean(96), np.array([0.2, 1.1])
    before = white_captures(code, offsets, 0.05, blur=blur)
    after = white_captures(code, offsets - 0.95 * dx, 0.05, blur=blur, dy=-dy)
    before, after = (sg.noise.awgn(w, snr_db=30, seed=seed) for seed, w in enumerate((before, after)))
    found = misregistration(before, 700 * after)
    assert abs(found.dy - dy) < 0.02
    assert abs(found.dx - dx) < 0.02
    assert found.correlation > 0.9
    assert found.shift == pytest.approx(np.hypot(found.dy, found.dx))
    assert found.acceptable == (dy == dx == 0)
    assert ("no longer holds" in str(found)) == (not found.acceptable)
    if max(abs(dy), abs(dx)) > 1:
        assert found.correlation_at_zero < 0.2
    else:
        assert found.correlation_at_zero < found.correlation + 1e-4


def test_the_snapshots_of_a_target_show_that_the_mask_has_moved():
    size, bands = 128, 4
    code = boolean(size)
    offsets, width, wavelengths = camera(bands / size, bands, size)
    white = white_captures(code, offsets, bands / size, band=width)
    camera_before = calibrate(white, wavelengths=wavelengths, pitch=10.0)
    target = sg.scenes.chart(size=size, bands=bands, seed=0).values
    for dy, dx in ((0, 0), (1, 0), (0, -1)):
        moved = white_captures(code, offsets - (1 - bands / size) * dx, bands / size, band=width, dy=-dy)
        snapshots = camera_before.snapshots((moved * target).sum(axis=1))
        found = misregistration(camera_before.code.sum(axis=1), snapshots)
        assert abs(found.dy - dy) < 0.15
        assert abs(found.dx - dx) < 0.15
        assert (found.shift > 0.8) == (dy != 0 or dx != 0)


def test_other_codes_have_no_shift():
    for seed in range(20):
        with pytest.raises(ValueError, match="do not show the code of the reference within 8 px"):
            misregistration(boolean(48, seed), boolean(48, seed + 100))


def test_a_shift_beyond_the_window_is_said():
    code = boolean(64)
    with pytest.raises(ValueError, match="within 4 px"):
        misregistration(code, np.roll(code, 6, axis=1), window=4)
    assert misregistration(code, np.roll(code, 6, axis=1), window=8).dy == pytest.approx(6, abs=0.02)


@pytest.mark.parametrize(
    ("reference", "images", "window", "message"),
    [
        (np.ones((2, 3, 64, 64)), np.ones((2, 64, 64)), 8, r"one shape.*sum the code over its bands"),
        (np.ones((64, 64)), np.ones((64, 60)), 8, "one shape"),
        (np.ones((64, 31)), np.ones((64, 31)), 4, "32 px a side or more for a window of 4, got 64 × 31"),
        (np.ones((64, 64)), np.ones((64, 64)), 0, "window"),
        (np.ones((64, 64)), np.full((64, 64), np.nan), 8, "the images must be finite"),
        (np.ones((64, 64)), np.ones((64, 64), complex), 8, "real numbers"),
        (np.ones(64), np.ones(64), 8, "axes"),
        (np.ones((64, 64)), np.ones((64, 64)), 8, "do not show the code"),
        (np.zeros((64, 64)), np.zeros((64, 64)), 8, "do not show the code"),
    ],
)
def test_images_that_cannot_be_compared_are_refused(reference, images, window, message):
    with pytest.raises((ValueError, TypeError), match=message):
        misregistration(reference, images, window=window)


# Geometry

GEOMETRIES = [
    # position, bands, size, keywords of camera, keywords of white_captures, tolerance of s, of shear
    (0.0, 3, 128, {}, {"blur": 0.5}, 1e-4, 0.01),
    (0.004, 4, 256, {"beta": 3.0}, {"blur": 0.4, "dy": 0.3}, 1e-4, 0.02),
    (0.0078, 4, 128, {"dx": 0.45}, {"blur": 0.8, "dy": 1.37}, 1e-4, 0.01),
    (0.09375, 8, 128, {}, {}, 5e-5, 0.01),
    (0.09375, 8, 128, {"dx": -3.2}, {"blur": 1.2, "dy": -5.5}, 1e-4, 0.02),
    (0.3, 16, 128, {}, {"blur": 0.6}, 1e-4, 0.01),
    (0.2, 8, 128, {"beta": 1.6}, {"blur": 0.5}, 1e-4, 0.02),
    (0.1, 6, 64, {"ratio": 2}, {"blur": 0.7, "dy": 0.4}, 1e-4, 0.02),
    (0.25, 6, 48, {"ratio": 3, "dx": 2.0}, {"blur": 0.7}, 2e-4, 0.02),
]


@pytest.mark.parametrize("some", [slice(0, 4), slice(4, 8), slice(None)])
def test_where_the_detector_looks_does_not_depend_on_the_bands_captured(some):
    imager = sg.SSCSI(
        detector_shape=(96, 96), detector_pitch=10.0, code_pitch=10.0, mask_position=8 / 96, wavelengths=(450, 650)
    )
    code = boolean(96)
    white = imager.effective_code(code)[:, some]
    found = estimate_geometry(white, code, wavelengths=imager.resolution.wavelengths[some])
    assert abs(found.off_centre(imager.wavelengths)) < 0.05


@pytest.mark.parametrize(("position", "bands", "size", "where", "how", "s_tolerance", "shear_tolerance"), GEOMETRIES)
def test_geometry_is_found(position, bands, size, where, how, s_tolerance, shear_tolerance):
    ratio, beta = where.get("ratio", 1), where.get("beta", 1.0)
    code = boolean(size * ratio)
    offsets, width, wavelengths = camera(position, bands, size, **where)
    white = white_captures(code, offsets, position, ratio=ratio, band=min(width, 1.0), **how)
    white = sg.noise.awgn(white, snr_db=30, seed=0)
    found = estimate_geometry(white, code, wavelengths=wavelengths, pitch_ratio=ratio)
    assert abs(found.mask_position - position) < s_tolerance
    np.testing.assert_allclose(found.shear, offsets - offsets[0], atol=shear_tolerance)
    assert abs(found.dx - offsets[0]) < shear_tolerance
    assert abs(found.dy - how.get("dy", 0)) < 0.01
    assert abs(found.off_centre((wavelengths[0], wavelengths[-1])) - where.get("dx", 0)) < shear_tolerance
    assert found.dispersion == pytest.approx(position * beta * size * ratio / 200, abs=4 * shear_tolerance / 200)
    assert np.abs(found.nonlinearity).max() < shear_tolerance
    assert (found.correlation > 0.85).all()
    if position == 0:
        assert np.isnan(found.dispersion_ratio)
    else:
        assert abs(found.dispersion_ratio - beta) < max(0.001 * beta, 4 * found.dispersion_ratio_error)
        assert found.dispersion_ratio_error < 0.01 * beta
    if "blur" in how and not width:
        np.testing.assert_allclose(found.blur, how["blur"], atol=0.03)


def test_errors_are_what_they_say():
    """Of 18 captures, the deviations over their errors scatter by 1 ± 0.17; limits of 0.55 and 1.6 fail by chance once in 1e3."""
    deviations = []
    for seed in range(18):
        position = (0.03, 0.1, 0.2)[seed % 3]
        offsets, width, wavelengths = camera(position, 4, 64, dx=seed / 18)
        code = boolean(64, seed)
        white = white_captures(code, offsets, position, band=width, blur=0.6, dy=0.3)
        found = estimate_geometry(sg.noise.awgn(white, snr_db=25, seed=seed), code, wavelengths=wavelengths)
        deviations.append(
            [
                (found.mask_position - position) / found.mask_position_error,
                (found.dx - offsets[0]) / found.dx_error,
                (found.shear[3] - 3 * width) / found.shear_error[3],
                (found.dispersion - 4 * width / 200) / found.dispersion_error,
                (found.dispersion_ratio - 1) / found.dispersion_ratio_error,
            ]
        )
    scatter = np.sqrt(np.mean(np.square(deviations), axis=0))
    assert (scatter > 0.55).all()
    assert (scatter < 1.6).all()


def test_a_curved_dispersion_shows():
    offsets, _, wavelengths = camera(0.1, 8, 96)
    curve = 0.2 * np.linspace(-1, 1, 8) ** 2
    found = estimate_geometry(
        white_captures(boolean(96), offsets + curve, 0.1, blur=0.5), boolean(96), wavelengths=wavelengths
    )
    np.testing.assert_allclose(found.nonlinearity - found.nonlinearity.mean(), curve - curve.mean(), atol=0.02)
    assert np.abs(found.nonlinearity).max() > 0.08


def test_vignetted_and_dark_bands_do_not_disturb_the_others():
    size = 96
    code = boolean(size)
    offsets, _, wavelengths = camera(0.2, 9, size, beta=3.0)  # the outer bands see no more than two thirds of the mask
    white = white_captures(code, offsets, 0.2, blur=0.5)
    white *= np.array([0.05, 1, 1, 0.3, 0, 1, 1, 1, 0.05])[:, None, None]
    y, x = np.mgrid[:size, :size] / size
    white *= np.exp(-((y - 0.3) ** 2) - (x - 0.7) ** 2)
    found = estimate_geometry(sg.noise.awgn(white, snr_db=35, seed=0), code, wavelengths=wavelengths)
    assert np.isnan(found.shear[4])
    assert found.correlation[4] == 0
    lit = np.arange(9) != 4
    np.testing.assert_allclose(found.shear[lit], (offsets - offsets[0])[lit], atol=0.03)
    assert abs(found.mask_position - 0.2) < 2e-4
    assert found.dispersion_ratio == pytest.approx(3, abs=0.01)
    assert "8 of 9 show the code" in str(found)


def test_geometry_makes_the_imager_that_predicts_the_captures():
    template = sg.SSCSI(
        detector_shape=(64, 64),
        detector_pitch=10.0,
        code_pitch=10.0,
        mask_position=0.5,
        wavelengths=(450, 650),
        bands=7,
    )
    true = sg.SSCSI(
        detector_shape=(64, 64),
        detector_pitch=10.0,
        code_pitch=10.0,
        mask_position=0.11,
        wavelengths=(450, 650),
        dispersion_ratio=1.2,
        bands=7,
    )
    code = boolean(64)
    white = true.effective_code(code)
    found = estimate_geometry(white, code, wavelengths=true.resolution.wavelengths)
    predicted = found.imager(template).effective_code(code)
    assert np.sqrt(np.mean((predicted - white) ** 2)) < 0.01
    assert found.imager(template).dispersion_ratio == pytest.approx(1.2, abs=2e-3)
    with pytest.raises(ValueError, match="the template's code has 32 columns"):
        found.imager(
            sg.SSCSI(detector_shape=(32, 32), detector_pitch=1, code_pitch=1, mask_position=0.1, wavelengths=(450, 650))
        )
    mirrored = estimate_geometry(white[:, ::-1], code, wavelengths=true.resolution.wavelengths)
    assert mirrored.dispersion_ratio == pytest.approx(-1.2, abs=2e-3)
    with pytest.raises(ValueError, match="mirror captures and code"):
        mirrored.imager(template)
    on_detector = estimate_geometry(white[:, [3, 3]], code, wavelengths=(500, 600))
    assert on_detector.dispersion == pytest.approx(0, abs=1e-6)
    still = estimate_geometry(white_captures(code, [0.2, 0.2], 0.0, blur=0.5), code, wavelengths=(500, 600))
    with pytest.raises(ValueError, match="not clearly above 0"):
        still.imager(template)


def test_captures_of_another_code_are_told():
    offsets, _, wavelengths = camera(0.1, 3, 64)
    white = white_captures(boolean(64), offsets, 0.1, blur=0.5)
    for other in (boolean(64, 1), boolean(64)[:, :, ::-1], boolean(64)[::-1][:, ::-1], np.ones((2, 64, 64))):
        with pytest.raises(ValueError, match="the captures do not show this code"):
            estimate_geometry(white, other, wavelengths=wavelengths)
    scene = sg.scenes.chart(size=64, bands=3, seed=0).values
    for nothing in (np.stack([scene, scene[::-1]]), np.ones((2, 3, 64, 64)), np.zeros((2, 3, 64, 64))):
        with pytest.raises(ValueError, match="the captures do not show this code"):
            estimate_geometry(nothing, boolean(64), wavelengths=wavelengths)


def test_one_band_that_shows_the_code_is_not_enough():
    white = white_captures(boolean(64), [0.0, 0.0], 0.1, blur=0.5)
    white[:, 1] = np.random.default_rng(0).random(white[:, 1].shape)
    with pytest.raises(ValueError, match="only the band at 500 nm shows the code"):
        estimate_geometry(white, boolean(64), wavelengths=(500, 600))


@pytest.mark.parametrize(
    ("white", "code", "keywords", "message"),
    [
        (np.ones((2, 3, 32)), boolean(32), {}, "axes"),
        (np.ones((2, 3, 32, 32)), boolean(32)[:1], {}, "with the 2 shots of the captures"),
        (np.ones((2, 3, 32, 32)), 255 * boolean(32), {}, "divide an 8-bit code by 255"),
        (np.ones((2, 2, 32, 32)), boolean(32), {}, "2 bands and 3 wavelengths"),
        (np.ones((2, 3, 32, 32)), boolean(32), {"pitch_ratio": 1.5}, "pitch_ratio"),
        (np.full((2, 3, 32, 32), np.inf), boolean(32), {}, "finite"),
        (np.ones((2, 3, 32, 32), complex), boolean(32), {}, "real numbers"),
    ],
)
def test_captures_that_do_not_fit_are_refused(white, code, keywords, message):
    with pytest.raises((ValueError, TypeError), match=message):
        estimate_geometry(white, code, wavelengths=(450, 550, 650), **keywords)


@pytest.mark.parametrize("width", [0.7, 1.0, 2.3])
@pytest.mark.parametrize("variance", [0.05, 0.6])
def test_the_overlap_and_its_derivatives_are_those_of_integration(width, variance):
    """Against sums over a fine grid: the share of code element [−½, ½] in the blurred element around −x, over its width."""
    step = 1 / 400
    grid = np.arange(-12, 12, step) + step / 2
    code = (np.abs(grid) < 0.5).astype(float)
    blurred = gaussian_filter1d(code, np.sqrt(variance) / step, mode="constant", truncate=8)
    x = np.array([-1.9, -0.63, 0.0, 0.21, 1.37])
    wanted = np.array([blurred[np.abs(grid + at) < width / 2].sum() * step / width for at in x])
    value, by_place, by_variance = placement.overlap(x, width, variance)
    np.testing.assert_allclose(value, wanted, atol=3e-3)
    d = 1e-5
    np.testing.assert_allclose(
        by_place,
        (placement.overlap(x - d, width, variance)[0] - placement.overlap(x + d, width, variance)[0]) / (2 * d),
        atol=1e-6,
    )
    np.testing.assert_allclose(
        by_variance,
        (placement.overlap(x, width, variance + d)[0] - placement.overlap(x, width, variance - d)[0]) / (2 * d),
        atol=1e-6,
    )


# Resolution


@pytest.mark.parametrize(
    ("position", "bands", "beta"),
    [(0.0078, 6, 3.0), (0.011, 4, 3.0), (0.02, 24, 1.0), (0.1, 60, 1.0), (0.1, 4, 1.0), (0.25, 8, 1.0)],
    ids=["dissertation", "dissertation, coarse", "1.8 columns in all", "finer than a band", "3 columns a band", "far"],
)
@pytest.mark.parametrize("last", [False, True])
def test_resolution_is_that_of_the_geometry(position, bands, beta, last):
    size = 128
    offsets, width, wavelengths = camera(position, bands, size, beta=beta)
    white = white_captures(boolean(size), offsets, position, blur=0.4, band=min(width, 1.0))
    reference = bands - 1 if last else 0
    found = measured_resolution(
        sg.noise.awgn(white, snr_db=30, seed=0), wavelengths=wavelengths, reference=reference, pitch_ratio=1 - position
    )
    true = 200 / (position * beta * size)
    assert found.band_width == pytest.approx(true, rel=0.005)
    assert found.band_width_error < 0.005 * true
    np.testing.assert_allclose(found.shifts, offsets - offsets[reference], atol=0.02)
    assert not found.left_out.size
    nearest = np.abs(np.abs(offsets - offsets[reference]) - 1)
    nearest[reference] = np.inf
    assert nearest[found.neighbour] < nearest.min() + 0.02
    assert found.reference_row.shape == found.neighbour_row.shape == (size,)
    if nearest.min() < 0.1:
        assert found.correlation > 0.95
    if nearest.min() > 1.5:
        assert found.correlation < 0.5


def test_the_pitch_ratio_counts_code_columns():
    offsets, _, wavelengths = camera(0.05, 6, 64, ratio=2)
    white = white_captures(boolean(128), offsets, 0.05, ratio=2, blur=0.5)
    found = measured_resolution(white, wavelengths=wavelengths, pitch_ratio=2 * 0.95, row=10, shot=1)
    assert found.band_width == pytest.approx(200 / (0.05 * 128), rel=0.005)
    row = white[1, 0, 10]
    np.testing.assert_allclose(found.reference_row, row / row.mean())


def test_bands_without_a_pattern_are_left_out_and_said():
    offsets, _, wavelengths = camera(0.1, 6, 64)
    white = white_captures(boolean(64), offsets, 0.1, blur=0.5)
    white[:, [1, 4]] = 0.5 + 0.01 * np.random.default_rng(0).standard_normal((2, 2, 64, 64))
    found = measured_resolution(white, wavelengths=wavelengths, pitch_ratio=0.9)
    np.testing.assert_allclose(found.left_out, wavelengths[[1, 4]])
    assert found.band_width == pytest.approx(200 / 6.4, rel=0.01)
    assert "left out: 500, 600 nm" in str(found)
    white[:, [2, 3, 5]] = white[:, [1]] + 0.01 * np.random.default_rng(1).standard_normal((2, 3, 64, 64))
    with pytest.raises(ValueError, match="no band shows the pattern of the reference band"):
        measured_resolution(white, wavelengths=wavelengths)


def test_two_bands_give_a_width_without_an_error():
    white = white_captures(boolean(64), [0.0, 2.0], 0.0, blur=0.5)
    found = measured_resolution(white, wavelengths=(500, 520))
    assert found.band_width == pytest.approx(10, rel=0.01)
    assert np.isnan(found.band_width_error)


def test_a_mask_too_close_to_the_detector_is_said():
    offsets, _, wavelengths = camera(0.003, 5, 96)
    white = white_captures(boolean(96), offsets, 0.003, blur=0.5)
    with pytest.raises(
        ValueError, match=r"shifts by 0\.23 code columns from 470 to 630 nm, less than 0\.5: the mask is too close"
    ):
        measured_resolution(white, wavelengths=wavelengths)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"reference": 3}, "reference must be a whole number from 0 to 2, got 3"),
        ({"shot": -1}, "shot"),
        ({"row": 32}, "row"),
        ({"pitch_ratio": 0}, "pitch_ratio"),
        ({"wavelengths": (450, 550)}, "3 bands and 2 wavelengths"),
    ],
)
def test_choices_that_do_not_exist_are_refused(keywords, message):
    white = np.random.default_rng(0).random((2, 3, 32, 32))
    with pytest.raises(ValueError, match=message):
        measured_resolution(white, **({"wavelengths": (450, 550, 650)} | keywords))


def test_too_few_columns_are_said():
    with pytest.raises(ValueError, match="32 columns or more, got 16"):
        measured_resolution(np.ones((1, 2, 64, 16)), wavelengths=(450, 550))
