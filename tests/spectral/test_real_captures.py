"""What is said of real captures, and of the same with another mask, where the data are at hand."""

import numpy as np
import pytest

import shadowgram as sg

ROWS = slice(340, 452)


@pytest.fixture(scope="module")
def captured(data):
    folder = data / "tsa_real"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    mask = sg.scenes.read_array(folder / "mask.mat")[ROWS]
    shot = sg.scenes.read_array(folder / "scene3.mat")[ROWS][None]
    return sg.CASSI(cube_shape=(28, len(mask), 660), wavelengths=(450, 650), band_shift=2), mask, shot


def test_a_gray_mask_as_measured_is_a_code(captured):
    imager, mask, shot = captured
    H = imager.operator(mask)
    assert H.out_shape == shot.shape
    one = np.zeros(H.in_shape, np.float32)
    one[3, 5, 7] = 1
    assert H.forward(one)[0, 5, 7 + 6] == mask[5, 7]


def test_what_is_said_of_real_captures(captured):
    imager, mask, shot = captured
    (further,) = sg.spectral.check_capture(imager, np.roll(mask, -1, axis=0), shot)
    assert 1.2 < float(further.how_much.split("it ")[1].split(" px down")[0]) < 1.7
    wrong = sg.spectral.check_capture(
        sg.CASSI(cube_shape=(29, *mask.shape), wavelengths=(450, 650), band_shift=2), mask, shot
    )
    assert [finding.what for finding in wrong] == ["a band is missing"]
