"""Scenes of the studies at any resolution."""

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.experiments.source import generated, recorded


@pytest.fixture
def file(tmp_path):
    values = np.random.default_rng(0).random((6, 12, 16)).astype(np.float32)
    sg.scenes.write(sg.scenes.as_datacube(values, (455, 505)), tmp_path / "box.nc")
    return tmp_path / "box.nc", values


def test_a_recorded_scene_comes_back_as_it_is(file):
    path, values = file
    scene = recorded(path)
    assert (scene.name, scene.bands, scene.size, scene.wavelengths) == ("box", 6, (12, 16), (450.0, 510.0))
    cube = scene.cube(6, (12, 16))
    assert np.array_equal(cube.values, values)
    np.testing.assert_allclose(cube.wavelength.values, np.arange(455, 506, 10))


def test_coarser_bands_and_pixels_are_means(file):
    path, values = file
    cube = recorded(path).cube(3, (6, 8)).values
    np.testing.assert_allclose(cube, values.reshape(3, 2, 6, 2, 8, 2).mean(axis=(1, 3, 5)), rtol=1e-5)


def test_finer_bands_lie_between_the_recorded_ones(file):
    path, values = file
    fine = recorded(path).cube(6 * 4, (12, 16)).values
    # Centres of fine bands lie 1/8, 3/8, 5/8 and 7/8 of the way through a recorded band.
    between = 5 / 8 * values[2] + 3 / 8 * values[1]
    np.testing.assert_allclose(fine[8], between, rtol=1e-5)
    np.testing.assert_allclose(fine[0], values[0], rtol=1e-6)


def test_a_part_of_the_range_and_a_square_part_of_the_field(file):
    path, values = file
    cube = recorded(path).cube(2, (12, 12), (470, 490))
    np.testing.assert_allclose(cube.values, values[2:4, :, 2:14], rtol=1e-6)
    np.testing.assert_allclose(cube.wavelength.values, [475, 485])


def test_the_generated_scene_is_told_apart_by_its_seed():
    assert generated(0).digest != generated(1).digest
    assert generated().cube(3, (8, 10)).shape == (3, 8, 10)


def test_values_tell_recorded_scenes_apart_not_their_names(file, tmp_path):
    path, values = file
    sg.scenes.write(sg.scenes.as_datacube(values, (455, 505)), tmp_path / "other.nc")
    assert recorded(path).digest == recorded(tmp_path / "other.nc").digest
    sg.scenes.write(sg.scenes.as_datacube(values * 0.5, (455, 505)), tmp_path / "third.nc")
    assert recorded(path).digest != recorded(tmp_path / "third.nc").digest


@pytest.mark.parametrize(
    ("values", "wavelengths", "message"),
    [
        (np.zeros((3, 4, 4)), (450, 460, 500), "evenly spaced"),
        (np.full((3, 4, 4), -1.0), (450, 500), "not negative"),
        (np.zeros((1, 4, 4)), (450, 500), "does not say the wavelengths"),
    ],
)
def test_scenes_that_a_study_cannot_take(values, wavelengths, message, tmp_path):
    sg.scenes.write(sg.scenes.as_datacube(values, wavelengths), tmp_path / "bad.nc")
    with pytest.raises(ValueError, match=message):
        recorded(tmp_path / "bad.nc")
