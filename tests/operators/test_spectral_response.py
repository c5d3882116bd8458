"""Pictures of ordinary cameras, against plain loops."""

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.operators import SpectralResponse, as_matrix, norm
from shadowgram.scenes import rgb_response


def dense(weights, cube_shape):
    """g[c, y, x] = Σ_k w[c, k] f[k, y, x]."""
    channels, (bands, ny, nx) = len(weights), cube_shape
    matrix = np.zeros((channels, ny, nx, bands, ny, nx))
    for c, k, y, x in np.ndindex(channels, *cube_shape):
        matrix[c, y, x, k, y, x] = weights[c, k]
    return matrix.reshape(channels * ny * nx, -1)


@pytest.mark.parametrize(("channels", "shape"), [(1, (5, 4, 6)), (3, (4, 7, 3)), (4, (3, 1, 17)), (2, (1, 5, 1))])
def test_a_picture_is_a_weighted_sum_of_the_bands(channels, shape):
    weights = np.random.default_rng(0).standard_normal((channels, shape[0]))
    P = SpectralResponse(weights, shape)
    assert P.out_shape == (channels, *shape[1:])
    np.testing.assert_allclose(as_matrix(P), dense(weights, shape), atol=1e-12)
    np.testing.assert_allclose(as_matrix(P.H), dense(weights, shape).T, atol=1e-12)
    assert sg.testing.dot_test(P) < 1e-12
    assert sg.testing.dot_test(P, np.float32) < 1e-5
    assert norm(P) == pytest.approx(np.linalg.norm(weights, 2), rel=1e-2)


def test_panchromatic():
    cube = np.random.default_rng(0).random((5, 20, 18))
    np.testing.assert_allclose(SpectralResponse.pan(cube.shape).forward(cube)[0], cube.mean(axis=0), atol=1e-14)
    with sg.threads(1):
        alone = SpectralResponse.pan((5, 40, 18)).forward(np.tile(cube, (1, 2, 1)))
    np.testing.assert_array_equal(alone, SpectralResponse.pan((5, 40, 18)).forward(np.tile(cube, (1, 2, 1))))


def test_colours_of_a_white_card_and_of_light_of_one_colour():
    nm = np.arange(405.0, 700, 10)
    weights = rgb_response(nm, illuminant="equal-energy")
    white = SpectralResponse(weights, (nm.size, 2, 2)).forward(np.ones((nm.size, 2, 2)))
    np.testing.assert_allclose(white, 1, atol=1e-12)
    for colour, peak in enumerate((605, 545, 445)):
        assert abs(nm[weights[colour].argmax()] - peak) <= 10
    np.testing.assert_allclose(rgb_response(nm[::-1], illuminant="equal-energy"), weights[:, ::-1])
    # Under daylight a white card has the spectrum of D65; its brightest band, here 1, is what the scale follows.
    daylight = np.interp(nm, *sg.scenes.colour.observer()[::2])
    np.testing.assert_allclose(rgb_response(nm) @ daylight / daylight.max(), 1, rtol=0.02)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: SpectralResponse(np.ones((1, 3)), (4, 5, 5)), r"with 4 bands as the cube has, got \(1, 3\)"),
        (lambda: SpectralResponse(np.ones((1, 1, 4)), (4, 5, 5)), "channel, band"),
        (lambda: SpectralResponse(np.array([1, np.nan]), (2, 5, 5)), "finite"),
        (lambda: SpectralResponse(np.ones(2), (2, 5)), r"\(band, y, x\)"),
        (lambda: rgb_response([500, 450, 600]), "rising or falling"),
        (lambda: rgb_response([500.0, np.inf]), "rising or falling"),
        (lambda: rgb_response([1500.0, 1600.0]), "are the wavelengths in nm"),
    ],
)
def test_misuse(call, message):
    with pytest.raises(ValueError, match=message):
        call()
