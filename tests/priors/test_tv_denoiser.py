"""The total variation denoiser: what it minimises, how it chooses its weight, and its extremes."""

import warnings

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.priors import TVDenoiser, tv_denoiser
from shadowgram.priors.tv import tv


def flat_scene(side=48):
    y, x = np.mgrid[:side, :side] / side
    return 60 + 150.0 * ((y - 0.4) ** 2 + (x - 0.45) ** 2 < 0.08) - 40 * (x + y > 1.4)


def textured_scene(side=48):
    y, x = np.mgrid[:side, :side]
    return (
        128 + 60 * np.sin(1.9 * x + 0.3 * y) * np.cos(1.3 * y) + 20 * np.random.default_rng(3).standard_normal(x.shape)
    )


def noisy(scene, sigma):
    return scene + sigma * np.random.default_rng(0).standard_normal(scene.shape)


@pytest.mark.parametrize("weight", [0.3, 0.85, 2.0])
def test_a_fixed_weight_is_the_proximal_map(weight):
    image = noisy(flat_scene(), 20)
    expected = tv(image, weight * 20, tol=1e-9, max_iter=100_000)
    found = TVDenoiser(weight=weight)(image, 20)
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.01 * 20


def loss(denoiser, scene, sigma, seeds=8):
    """By how many dB it is behind the best of all fixed weights, in the mean over noise."""
    losses = []
    for seed in range(seeds):
        image = scene + sigma * np.random.default_rng(seed).standard_normal(scene.shape)
        errors = [np.mean((TVDenoiser(weight=k)(image, sigma) - scene) ** 2) for k in np.geomspace(0.1, 2, 25)]
        losses.append(10 * np.log10(np.mean((denoiser(image, sigma) - scene) ** 2) / min(errors)))
    return np.mean(losses)


@pytest.mark.parametrize("scene", [flat_scene(), textured_scene()], ids=["flat", "textured"])
@pytest.mark.parametrize("sigma", [5, 20, 50])
def test_the_chosen_weight_is_nearly_the_best(scene, sigma):
    # On so few pixels the estimated risk is itself uncertain; a fixed weight loses up to 8 dB.
    assert loss(TVDenoiser(), scene, sigma) < 0.2


def test_no_fixed_weight_serves_both_scenes():
    for weight in (0.3, 0.5, 0.75, 1.0):
        assert max(loss(TVDenoiser(weight=weight), scene, 5) for scene in (flat_scene(), textured_scene())) > 1


def test_the_divergence_is_that_of_the_map():
    """For tv, the divergence is the number of flat areas, here counted where the solution has few."""
    image = noisy(np.repeat([[0.0], [100.0]], 8, axis=0) + np.zeros((16, 16)), 1.0)
    scaled = image - image.mean()
    flat = tv(scaled, 30.0, tol=1e-8, max_iter=100_000)
    areas = len(np.unique(np.round(flat, 2)))
    probe = np.random.default_rng(0).choice([-1.0, 1.0], image.shape)
    moved = tv(scaled + 0.1 * probe, 30.0, tol=1e-8, max_iter=100_000)
    means = [np.sum(probe[flat > 0]) ** 2, np.sum(probe[flat < 0]) ** 2]
    assert areas == 2
    assert np.sum(probe * (moved - flat)) / 0.1 == pytest.approx(sum(means) / 128, abs=0.05)


def test_a_parabola_finds_the_place_between_the_weights():
    places = np.log([0.5, 1.0, 2.5])
    assert tv_denoiser._least(places, (places - np.log(1.2)) ** 2) == pytest.approx(1.2)
    assert tv_denoiser._least(places, -places) == pytest.approx(2.5)
    assert tv_denoiser._least(places[:2], places[:2]) == pytest.approx(0.5)


def test_noise_that_is_texture_is_left_and_flat_noise_is_taken():
    sigma = 5.0
    rough, flat = (TVDenoiser()(noisy(scene, sigma), sigma) for scene in (textured_scene(), flat_scene()))
    assert np.std(rough - noisy(textured_scene(), sigma)) < 0.5 * sigma
    assert np.std(flat - noisy(flat_scene(), sigma)) > 0.8 * sigma


@pytest.mark.parametrize("weight", [None, 0.85])
def test_no_sigma_makes_it_warn_or_fail(weight):
    image = noisy(flat_scene(40)[:, :23], 3)
    spread = []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for sigma in 10.0 ** np.arange(-38, 39, 2):
            found = TVDenoiser(weight=weight)(image, sigma)
            assert np.isfinite(found).all()
            spread.append(np.ptp(found))
    assert np.array_equal(TVDenoiser(weight=weight)(image, 1e-38), image.astype(np.float32))
    assert spread[-1] == 0
    assert np.abs(found - image.mean()).max() < 1e-4
    assert (np.diff(spread) < 1e-2 * spread[0]).all()


def test_a_large_weight_gives_the_mean_already_where_the_iteration_does():
    image = noisy(flat_scene(16), 3)
    contrast = np.abs(image - image.mean()).max()
    enough = 0.501 * np.hypot(16, 16) * contrast
    assert np.ptp(tv(image, enough, tol=1e-8, max_iter=100_000)) < 0.05
    assert np.ptp(TVDenoiser(weight=1)(image, enough)) == 0
    assert np.ptp(TVDenoiser(weight=1)(image, enough / 100)) > 1


def test_weight_zero_gives_the_image():
    image = noisy(flat_scene(), 20)
    assert np.array_equal(TVDenoiser(weight=0)(image, 20), image.astype(np.float32))


def test_one_line_for_a_map_of_sigma_and_for_a_weight_below_zero():
    with pytest.raises(ValueError, match=r"TVDenoiser: sigma is one number, got an array of shape \(16, 16\)"):
        sg.priors.get("tv")(np.ones((16, 16)), np.full((16, 16), 0.1))
    for weight in (-1, np.inf, np.nan):
        with pytest.raises(ValueError, match="weight is in units of sigma and must be 0 or more"):
            TVDenoiser(weight=weight)
