"""The continuous-scene simulator against plain loops over eq. (2.2), the discrete model, and closed forms."""

import itertools
import math

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.operators import as_matrix
from shadowgram.spectral import ContinuousSSCSI


def camera(**changes):
    geometry = {
        "detector_shape": (3, 5),
        "detector_pitch": 10.0,
        "code_pitch": 10.0,
        "mask_position": 0.4,
        "wavelengths": (450.0, 650.0),
    }
    return sg.SSCSI(**(geometry | changes))


def mean_transmittance(row, u0, u1, step):
    """Mean over u in [u0, u1] and over shifts [0, step] of a code row: exact, from the breaks of a piecewise quadratic."""

    def twice_integrated(z):
        """∫∫ of the row up to z, closed outside of it."""
        total = 0.0
        for j, t in enumerate(row):
            inside = min(max(z - j, 0.0), 1.0)
            total += t * (inside**2 / 2 + max(z - j - 1, 0.0))
        return total

    F = twice_integrated
    return (F(u1 + step) - F(u0 + step) - F(u1) + F(u0)) / ((u1 - u0) * step)


def sensing_matrix(scene, code):
    """Eq. (2.2) by loops: detector element ← scene pixel and fine band."""
    imager, over = scene.imager, scene.oversampling
    s, r = imager.mask_position, imager.pitch_ratio
    rows, columns = imager.detector_shape
    code_columns = columns * r
    step = s * imager.dispersion_ratio * code_columns / scene.bands
    offset = s * code_columns * (1 - imager.dispersion_ratio) / 2
    width = r * (1 - s) / over
    bands_each = scene.bands * imager.resolution.band_width / 200.0
    voxels = r if r * (1 - s) < 1 else r * r * (1 - s)
    H = np.zeros((len(code), rows, columns, *scene.scene_shape))
    for q, k, y, x in itertools.product(range(len(code)), *map(range, scene.scene_shape)):
        u = offset + x * width + k * step
        seen = mean_transmittance(code[q, y * r // over], u, u + width, step)
        H[q, y // over, x // over, k, y, x] = seen * voxels / bands_each / over**2
    return H.reshape(len(code) * rows * columns, -1)


@pytest.mark.parametrize(
    ("changes", "bands", "over"),
    [
        ({}, 4, 1),
        ({}, 5, 2),
        ({"detector_shape": (2, 6), "mask_position": 0.2, "dispersion_ratio": 2.2}, 7, 3),
        ({"detector_shape": (2, 4), "detector_pitch": 20.0, "mask_position": 0.25}, 6, 2),
        ({"detector_shape": (3, 3), "detector_pitch": 20.0, "mask_position": 0.7}, 5, 4),
    ],
)
def test_operator_equals_the_dense_matrix(changes, bands, over):
    imager = camera(**changes)
    scene = ContinuousSSCSI(imager=imager, bands=bands, oversampling=over)
    code = sg.codes.boolean(shots=2, shape=imager.code_shape, seed=1)
    A = scene.operator(code)
    assert np.abs(as_matrix(A) - sensing_matrix(scene, code)).max() < 1e-12
    assert sg.testing.dot_test(A) < 1e-12
    assert sg.testing.dot_test(A, np.float32) < 1e-5


@pytest.mark.parametrize("pupil", [20.0, 90.0])
def test_operator_with_a_finite_aperture(pupil):
    imager = camera(mask_position=0.3)
    scene = ContinuousSSCSI(imager=imager, bands=6, oversampling=2, pupil=pupil, response=(0, 1, 2, 3, 2, 1))
    A = scene.operator(sg.codes.random(shots=2, shape=imager.code_shape, seed=1))
    assert sg.testing.dot_test(A) < 1e-12
    assert sg.testing.dot_test(A, np.float32) < 1e-5


def test_a_scene_of_whole_voxels_is_what_the_discrete_model_measures():
    imager = camera(detector_shape=(4, 20), mask_position=0.25)
    code = sg.codes.boolean(shots=3, shape=imager.code_shape, seed=0)
    cube = np.random.default_rng(0).random(imager.resolution.cube_shape)
    scene = ContinuousSSCSI(imager=imager, bands=5 * 8, oversampling=3)
    fine = cube.repeat(8, axis=0).repeat(3, axis=1).repeat(3, axis=2)
    np.testing.assert_allclose(scene.operator(code).forward(fine), imager.operator(code).forward(cube), rtol=1e-12)
    np.testing.assert_allclose(scene.truth(fine), cube, rtol=1e-12)


@pytest.mark.parametrize("changes", [{"mask_position": 0.2}, {"detector_pitch": 20.0, "mask_position": 0.2}])
def test_an_open_mask_passes_the_light_of_the_truth(changes):
    """Snapshots of both models agree for an open mask, in both regimes: the units are the same."""
    imager = camera(detector_shape=(4, 10), **changes)
    assert imager.spectral_columns == imager.resolution.bands
    rng = np.random.default_rng(0)
    scene = ContinuousSSCSI(imager=imager, bands=4 * imager.resolution.bands, oversampling=4)
    fine = np.broadcast_to(rng.random(scene.bands)[:, None, None], scene.scene_shape)
    opened = np.ones(imager.code_shape)
    want = imager.operator(opened).forward(scene.truth(fine))
    got = scene.operator(opened).forward(fine)
    np.testing.assert_allclose(got[:, :, :-1], want[:, :, :-1], rtol=1e-10)


def test_truth_in_the_super_resolving_regime_averages_stretched_columns():
    imager = camera(detector_shape=(2, 8), detector_pitch=20.0, mask_position=0.25)
    scene = ContinuousSSCSI(imager=imager, bands=imager.resolution.bands * 2, oversampling=12)
    ramp = np.broadcast_to((np.arange(96) + 0.5) / 12, scene.scene_shape)  # the place in detector elements
    columns = imager.resolution.cube_shape[2]
    assert columns == 12
    np.testing.assert_allclose(scene.truth(ramp)[0, 0], (np.arange(columns) + 0.5) / 1.5, rtol=1e-12)


def test_white_captures_of_all_bands_sum_to_the_snapshot_of_a_white_scene():
    imager = camera(detector_shape=(4, 16), mask_position=0.25)
    code = sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0)
    scene = ContinuousSSCSI(imager=imager, bands=50, oversampling=2, pupil=30.0, response=tuple(np.linspace(1, 2, 50)))
    captures = scene.white_captures(code, np.linspace(450, 650, 5))  # edges within fine bands: they are shared
    assert captures.shape == (2, 4, 4, 16)
    whole = scene.operator(code).forward(np.ones(scene.scene_shape))
    np.testing.assert_allclose(captures.sum(axis=1), whole, rtol=1e-12)
    assert captures[:, 3].mean() > 1.5 * captures[:, 0].mean()


def test_white_captures_are_the_effective_code():
    imager = camera(detector_shape=(4, 16), mask_position=0.25)
    code = sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0)
    scene = ContinuousSSCSI(imager=imager, bands=4 * 8)
    captures = scene.white_captures(code, imager.resolution.band_edges)
    np.testing.assert_allclose(captures, imager.effective_code(code), atol=1e-12)


def test_blur_is_a_disc_of_the_pupil_times_s():
    """A single open element becomes a spot whose variance grows by that of a disc, (b/4)², which along x is stretched."""
    s, pupils = 0.2, (200.0, 400.0)
    imager = camera(detector_shape=(41, 41), mask_position=s, dispersion_ratio=1e-9)
    code = np.zeros(imager.code_shape)
    code[20, 20] = 1
    scenes = [ContinuousSSCSI(imager=imager, bands=1, oversampling=4, pupil=pupil) for pupil in (0.0, *pupils)]
    assert scenes[1].blur == pytest.approx(4.0)
    sharp, *soft = (scene.operator(code).forward(np.ones(scene.scene_shape))[0] for scene in scenes)
    place = np.arange(41)
    for axis, stretch in ((0, 1.0), (1, 1 / (1 - s))):
        variances = []
        for spot in soft:
            assert spot.sum() == pytest.approx(sharp.sum(), rel=0.01)
            profile = spot.sum(axis=1 - axis) / spot.sum()
            variances.append((profile * place**2).sum() - (profile * place).sum() ** 2)
        gained = math.sqrt((variances[1] - variances[0]) / (8.0**2 - 4.0**2))
        assert gained == pytest.approx(stretch / 4, rel=0.02)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"bands": 0}, "bands must be a whole number"),
        ({"oversampling": 3}, "multiple of the 2 code elements"),
        ({"pupil": -1.0}, "pupil is a diameter"),
        ({"pupil": math.nan}, "pupil is a diameter"),
        ({"response": (1.0, 2.0)}, "8 finite sensitivities"),
        ({"response": (math.nan,) * 8}, "8 finite sensitivities"),
    ],
)
def test_impossible_cameras(changes, message):
    imager = camera(detector_pitch=20.0)
    with pytest.raises(ValueError, match=message):
        ContinuousSSCSI(**({"imager": imager, "bands": 8, "oversampling": 2} | changes))


@pytest.mark.parametrize(
    ("edges", "message"),
    [
        ((450.0,), "at least two ascending"),
        ((650.0, 450.0), "at least two ascending"),
        ((440.0, 500.0), "within the imager's 450 to 650 nm"),
        ((450.0, 451.0), "use more fine bands"),
    ],
)
def test_impossible_bands_of_a_calibration(edges, message):
    imager = camera()
    with pytest.raises(ValueError, match=message):
        ContinuousSSCSI(imager=imager, bands=20).white_captures(np.ones(imager.code_shape), edges)


def test_truth_says_which_scene_it_takes():
    with pytest.raises(ValueError, match="the scene must have the shape"):
        ContinuousSSCSI(imager=camera(), bands=20).truth(np.zeros((20, 4, 4)))


def test_results_do_not_depend_on_threads():
    imager = camera(detector_shape=(33, 17))
    scene = ContinuousSSCSI(imager=imager, bands=20, oversampling=2, pupil=40.0)
    A = scene.operator(sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0))
    cube = np.random.default_rng(0).random(A.in_shape, dtype=np.float32)
    with sg.threads(1):
        alone = A.forward(cube)
    with sg.threads(3):
        assert np.array_equal(A.forward(cube), alone)
