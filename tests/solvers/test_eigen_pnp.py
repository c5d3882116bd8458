"""EigenPnP: when its denoiser is used, what it is given, and what it promises to callers."""

import numpy as np
import pytest

import shadowgram as sg


@pytest.fixture(scope="module")
def problem():
    cube = sg.scenes.chart(size=64, bands=6, seed=1).values.astype(np.float32)
    imager = sg.DualCASSI(cube_shape=cube.shape, wavelengths=(450, 650))
    H = imager.operator(sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0))
    return cube, H, sg.noise.awgn(H.forward(cube), snr_db=25, seed=0)


def flatten(image, sigma):
    """A denoiser that leaves nothing."""
    return np.full_like(image, image.mean())


def test_a_denoiser_that_harms_is_not_used(problem):
    _, H, y = problem
    plain = sg.solve(sg.EigenTV(max_iter=40), H, y)
    solution = sg.solve(sg.EigenPnP(denoiser=flatten, max_iter=40), H, y)
    assert solution.denoised is False
    assert np.array_equal(solution.x, plain.x)


def recalling(cube):
    """A denoiser that knows the scene: it keeps what of an image lies in the span of the true eigen-images."""
    vectors = np.linalg.eigh(np.tensordot(cube, cube, ((1, 2), (1, 2))))[1]
    images = np.tensordot(vectors.T, cube / cube.mean(), 1).reshape(len(cube), -1)

    def recall(image, sigma):
        return (np.linalg.lstsq(images.T, image.ravel(), rcond=None)[0] @ images).reshape(image.shape)

    return recall


def test_a_denoiser_that_knows_the_scene_is_used(problem):
    cube, H, y = problem
    plain = sg.solve(sg.EigenTV(), H, y)
    solution = sg.solve(sg.EigenPnP(denoiser=recalling(cube), images=6), H, y)
    assert solution.denoised is True
    assert solution.iterations == plain.iterations + 12
    assert sg.metrics.psnr(solution.x, cube, peak=1.0) > sg.metrics.psnr(plain.x, cube, peak=1.0) + 1


def test_the_denoiser_gets_leading_images_and_sigmas_that_follow_the_noise(problem):
    cube, H, _ = problem
    sigmas = {}
    for snr_db in (20, 35):
        y = sg.noise.awgn(H.forward(cube), snr_db=snr_db, seed=0)
        said = []

        def note(image, sigma, said=said):
            said.append((image.shape, sigma))
            return np.zeros_like(image)

        sg.solve(sg.EigenPnP(denoiser=note, images=2, stage=3, max_iter=30), H, y)
        assert (
            len(said) == 6
        )  # two images, three iterations of the trial; and none of the solution, which it would harm
        assert all(shape == cube.shape[1:] for shape, _ in said)
        assert said[1][1] > said[0][1]
        sigmas[snr_db] = said[0][1]
    assert sigmas[20] > 1.5 * sigmas[35]


@pytest.mark.parametrize("denoiser", ["ffdnet", "bm3d"])
def test_the_denoisers_that_ship_do_no_harm(problem, denoiser):
    cube, H, y = problem
    plain = sg.metrics.psnr(sg.solve(sg.EigenTV(), H, y).x, cube, peak=1.0)
    solution = sg.solve(sg.EigenPnP(denoiser=denoiser), H, y)
    assert sg.metrics.psnr(solution.x, cube, peak=1.0) > plain - 0.1


def test_an_interrupt_in_the_stage_keeps_the_estimate(problem):
    cube, H, y = problem
    first = sg.solve(sg.EigenTV(max_iter=10), H, y)

    def stop(iteration, _):
        if iteration == 12:
            raise KeyboardInterrupt

    solution = sg.solve(sg.EigenPnP(max_iter=10, denoiser=recalling(cube), images=6), H, y, callback=stop)
    assert solution.interrupted
    assert not solution.converged
    assert solution.denoised
    assert solution.iterations == 12
    assert solution.history["residual"][:10] == first.history["residual"]


def test_threads_do_not_change_the_choice_or_the_cube(problem):
    _, H, y = problem
    found = []
    for count in (1, 3):
        with sg.threads(count):
            found.append(sg.solve(sg.EigenPnP(denoiser="tv", max_iter=8, stage=3), H, y))
    assert found[0].denoised == found[1].denoised
    assert np.array_equal(found[0].x, found[1].x)


def test_small_and_dark_cubes_are_left_to_total_variation():
    for shape, scale in (((3, 6, 20), 1.0), ((3, 16, 16), 0.0)):
        imager = sg.DualCASSI(cube_shape=shape, wavelengths=(450, 650))
        H = imager.operator(sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0))
        solution = sg.solve(sg.EigenPnP(), H, scale * H.forward(np.ones(shape)))
        assert solution.denoised is False
        assert solution.x.shape == shape


@pytest.mark.parametrize(
    ("keywords", "error", "message"),
    [
        ({"denoiser": 3}, TypeError, "denoiser is a name or a callable"),
        ({"images": 0}, ValueError, "images must be a whole number"),
        ({"stage": 1.5}, ValueError, "stage must be a whole number"),
        ({"noise": -1.0}, ValueError, "EigenPnP: noise is a standard deviation"),
        ({"max_iter": 0}, ValueError, "max_iter must be a whole number"),
    ],
)
def test_settings_are_checked(keywords, error, message):
    with pytest.raises(error, match=message):
        sg.EigenPnP(**keywords)


def test_an_unknown_denoiser_is_refused(problem):
    _, H, y = problem
    with pytest.raises(ValueError, match="no denoiser 'magic'"):
        sg.solve(sg.EigenPnP(denoiser="magic"), H, y)
