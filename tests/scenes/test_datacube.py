"""What is a datacube and what is refused as one."""

import numpy as np
import pytest
import xarray as xr

from shadowgram.scenes.datacube import as_datacube, check_cube


def test_axes_wavelengths_and_numbers_are_kept():
    values = np.random.default_rng(0).random((3, 4, 5))
    cube = as_datacube(values, [450, 500, 620], name="scene")
    assert cube.dims == ("band", "y", "x")
    assert cube.dtype == np.float32
    assert cube.name == "scene"
    assert cube.wavelength.attrs == {"units": "nm"}
    np.testing.assert_array_equal(cube.wavelength, [450.0, 500.0, 620.0])
    np.testing.assert_array_equal(cube, values.astype(np.float32))


def test_whole_numbers_are_not_scaled():
    cube = as_datacube(np.full((2, 3, 3), 255, np.uint8), (400, 500))
    assert cube.dtype == np.float32
    assert cube.max() == 255


def test_float32_is_not_copied():
    values = np.zeros((2, 3, 3), np.float32)
    assert np.shares_memory(as_datacube(values, (400, 500)).values, values)


@pytest.mark.parametrize(
    ("bands", "pair", "centres"),
    [
        (24, (451, 642), np.linspace(451, 642, 24)),
        (2, (400, 500), [400, 500]),
        (1, (400, 500), [450]),
        (3, (6, 2), [6, 4, 2]),
    ],
)
def test_a_pair_is_the_first_and_the_last_centre(bands, pair, centres):
    np.testing.assert_allclose(as_datacube(np.zeros((bands, 2, 2)), pair).wavelength, centres, rtol=1e-15)


@pytest.mark.parametrize(
    ("values", "wavelengths", "message"),
    [
        (np.zeros((3, 3)), (400, 700), r"three axes.*\(3, 3\)"),
        (np.zeros((3, 0, 3)), (400, 700), "empty"),
        (np.zeros((3, 2, 3), complex), (400, 700), "real numbers"),
        (np.full((3, 2, 3), "a"), (400, 700), "real numbers"),
        (np.zeros((3, 2, 3)), [400, 500, 600, 700], "3 bands: give 3 wavelengths"),
        (np.zeros((3, 2, 3)), [[400, 500, 600]], r"shape \(1, 3\)"),
        (np.zeros((3, 2, 3)), "visible", "must be numbers in nm"),
        (np.zeros((3, 2, 3)), [400, np.nan, 600], "finite and positive"),
        (np.zeros((3, 2, 3)), [0, 1, 2], "finite and positive"),
        (np.zeros((3, 2, 3)), [400, 500, 500], "out of order"),
        (np.zeros((3, 2, 3)), (500, 500), "out of order"),
        (np.full((3, 2, 3), 1e300), (400, 700), "18 values that are NaN or infinite"),
    ],
)
def test_what_is_no_datacube_is_refused(values, wavelengths, message):
    with pytest.raises(ValueError, match=message):
        as_datacube(values, wavelengths)


def test_the_first_bad_value_is_named():
    cube = as_datacube(np.zeros((3, 4, 5)), (400, 700))
    cube[1, 2, 3] = np.nan
    cube[2, 0, 0] = np.inf
    with pytest.raises(ValueError, match="2 values that are NaN or infinite, the first at band 1, y 2, x 3"):
        check_cube(cube)


def test_wrong_axes_and_kinds_are_refused():
    with pytest.raises(ValueError, match=r"axes \(band, y, x\), got \(y, x, band\)"):
        check_cube(xr.DataArray(np.zeros((2, 2, 2)), dims=("y", "x", "band")))
    with pytest.raises(TypeError, match="as_datacube"):
        check_cube(np.zeros((2, 2, 2)))  # pyright: ignore[reportArgumentType]
    check_cube(xr.DataArray(np.zeros((2, 2, 2), int), dims=("band", "y", "x")))
