"""The two doors: every format there and back, what is guessed, and what is said when it cannot be."""

import os
import warnings
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy.io import savemat

from shadowgram import scenes
from shadowgram.scenes.readers.native import write_dataset

DATA = Path(os.environ.get("SHADOWGRAM_DATA", Path(__file__).parents[2] / "../shared/data"))
real_data = pytest.mark.skipif(not DATA.is_dir(), reason="the folder of real data is absent; see SHADOWGRAM_DATA")


@pytest.fixture
def cube():
    values = np.random.default_rng(0).random((5, 6, 7), np.float32)
    cube = scenes.as_datacube(values, [451.5, 500, 520, 600, 642], name="scene")
    return cube.assign_attrs(note="é", scale=255)


def quietly(path, **said):
    """Read without any warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return scenes.read(path, **said)


def test_native_keeps_everything(cube, tmp_path):
    cube = cube.assign_coords(y=np.arange(6) * 0.5, exposure=3.5, gain=("band", np.arange(5, dtype=np.int16)))
    for dtype in (np.float32, np.float64, np.uint8, ">u2", bool):
        scenes.write(cube.astype(dtype, keep_attrs=True), tmp_path / "a.nc")
        back = quietly(tmp_path / "a.nc")
        xr.testing.assert_identical(back, cube.astype(dtype, keep_attrs=True))
        assert back.dtype == dtype
        assert back.gain.dtype == np.int16


def test_native_names_what_has_no_name(cube, tmp_path):
    scenes.write(cube.rename(None), tmp_path / "a.nc")
    assert quietly(tmp_path / "a.nc").name == "datacube"


@pytest.mark.parametrize("suffix", [".npz", ".mat", ".NPZ"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_named_arrays_keep_values_axes_and_wavelengths(cube, tmp_path, suffix, dtype):
    path = tmp_path / f"a{suffix}"
    scenes.write(cube.astype(dtype), path)
    back = quietly(path)
    assert back.dtype == dtype
    assert back.name == "scene"
    np.testing.assert_array_equal(back, cube.astype(dtype))
    np.testing.assert_array_equal(back.wavelength, cube.wavelength)


@pytest.mark.parametrize("suffix", [".npz", ".mat"])
def test_a_cube_with_equal_sides_needs_no_guess(tmp_path, suffix):
    cube = scenes.as_datacube(np.random.default_rng(0).random((4, 4, 4)), (400, 700))
    scenes.write(cube, tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(quietly(tmp_path / f"a{suffix}"), cube)


def test_npy_keeps_values(cube, tmp_path):
    scenes.write(cube, tmp_path / "a.npy")
    back = quietly(tmp_path / "a.npy", variable="a", axes="band,y,x", wavelengths=cube.wavelength.values)
    np.testing.assert_array_equal(back, cube)
    np.testing.assert_array_equal(back.wavelength, cube.wavelength)


@pytest.mark.parametrize("order", ["C", "F"])
def test_npy_of_either_order(tmp_path, order):
    values = np.asarray(np.random.default_rng(0).random((8, 9, 3)), order=order, dtype=">f4")
    np.save(tmp_path / "a.npy", values)
    back = quietly(tmp_path / "a.npy", variable="a", axes=("y", "x", "band"), wavelengths=(400, 700))
    assert back.dtype == np.float32
    assert back.values.flags.c_contiguous
    np.testing.assert_array_equal(back, values.transpose(2, 0, 1))


def test_mat_is_as_matlab_shows_it(cube, tmp_path):
    from scipy.io import loadmat

    scenes.write(cube, tmp_path / "a.mat")
    held = loadmat(tmp_path / "a.mat")
    np.testing.assert_array_equal(held["scene"], cube.values.transpose(1, 2, 0))
    np.testing.assert_array_equal(held["wavelength"], [cube.wavelength])


@pytest.mark.parametrize(
    ("dtype", "expected", "scale"),
    [(np.uint8, 1.0, 255), (np.uint16, 255 / 65535, 65535), (np.int32, 255.0, None), (np.float16, 255.0, None)],
)
def test_images_of_8_and_16_bits_are_scaled(tmp_path, dtype, expected, scale):
    np.savez(tmp_path / "a.npz", cube=np.full((2, 3, 4), 255, dtype))
    cube = quietly(tmp_path / "a.npz", variable="cube", axes="band,y,x", wavelengths=(400, 500))
    assert cube.dtype == np.float32
    assert cube.attrs.get("scale") == scale
    np.testing.assert_array_equal(cube, np.full((2, 3, 4), expected, np.float32))


def test_guesses_are_said_in_the_words_of_the_arguments(tmp_path):
    savemat(tmp_path / "a.mat", {"hyperimg": np.zeros((7, 8, 3)) + 0.5, "mask": np.zeros((7, 8))})
    with pytest.warns(UserWarning, match=r"^a.mat: guessed") as caught:
        cube = scenes.read(tmp_path / "a.mat")
    said = str(caught[0].message)
    assert "variable='hyperimg'" in said
    assert "axes='y,x,band'" in said
    assert "wavelengths=(400, 700)" in said
    assert caught[0].filename == __file__
    assert cube.shape == (3, 7, 8)
    np.testing.assert_array_equal(cube.wavelength, [400, 550, 700])
    quietly(tmp_path / "a.mat", variable="hyperimg", axes="y,x,band", wavelengths=(400, 700))


@pytest.mark.parametrize("name", ["wavelength_nm", "lambda", "bands", "Wavelengths", "wl", "centers"])
def test_wavelengths_are_found_by_name(tmp_path, name):
    centres = np.array([[410, 450, 640]], np.uint16)
    np.savez(tmp_path / "a.npz", cube=np.zeros((7, 8, 3)), **{name: centres})
    with pytest.warns(UserWarning, match=f"wavelengths from '{name}' in nm"):
        cube = scenes.read(tmp_path / "a.npz")
    np.testing.assert_array_equal(cube.wavelength, centres[0])


def test_micrometres_are_understood(tmp_path):
    np.savez(tmp_path / "a.npz", cube=np.zeros((7, 8, 3)), wavelength=[0.45, 0.5, 2.0])
    with pytest.warns(UserWarning, match="in µm"):
        np.testing.assert_allclose(scenes.read(tmp_path / "a.npz").wavelength, [450, 500, 2000])


@pytest.mark.parametrize("numbers", [[1, 2, 3], [500, 400, 450], [400, 500]])
def test_band_numbers_are_not_wavelengths(tmp_path, numbers):
    np.savez(tmp_path / "a.npz", cube=np.zeros((7, 8, 3)), bands=numbers)
    with pytest.warns(UserWarning, match=r"wavelengths=\(400, 700\)"):
        scenes.read(tmp_path / "a.npz")


def test_the_number_of_wavelengths_tells_the_bands(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((6, 5, 7)))
    with pytest.warns(UserWarning, match="axes='y,x,band'"):
        cube = scenes.read(tmp_path / "a.npy", wavelengths=[400, 450, 500, 550, 600, 650, 700])
    assert cube.shape == (7, 6, 5)


@pytest.mark.parametrize(
    ("said", "message"),
    [
        (
            {"variable": "scene"},
            r"no variable 'scene' in it; it holds 'cube' \(5 × 6 × 7 float64\)",
        ),
        ({"variable": "flat"}, "'flat'.*has 2 axes; a datacube has three"),
        ({"variable": "words"}, "'words' is text"),
        ({"variable": "none"}, "'none' is empty"),
        ({"variable": "phase"}, "'phase' is complex numbers"),
        ({"variable": "objects"}, "'objects' is Python objects"),
        ({}, "several arrays of three axes in it; say which with variable=.*'flat'"),
        ({"variable": "cube", "axes": "x,y"}, "axes must name band, y and x"),
        ({"variable": "cube", "axes": "band,y,x", "wavelengths": [400, 500, 600]}, "5 bands: give 5 wavelengths"),
        ({"variable": "bad", "axes": "band,y,x"}, "1 values that are NaN or infinite, the first at band 1, y 0, x 0"),
        ({"variable": "square"}, "cannot be told which axis of 4 × 4 × 9 is the band.*axes="),
    ],
)
def test_clear_errors(tmp_path, said, message):
    bad = np.zeros((2, 3, 4))
    bad[1, 0, 0] = np.inf
    np.savez(
        tmp_path / "a.npz",
        cube=np.zeros((5, 6, 7)),
        flat=np.zeros((6, 7)),
        words=np.array("text"),
        none=np.zeros((0, 3, 3)),
        phase=np.zeros((5, 6, 7), complex),
        objects=np.array([[[None]]]),
        bad=bad,
        square=np.zeros((4, 4, 9)),
    )
    with pytest.raises(ValueError, match=message) as caught:
        scenes.read(tmp_path / "a.npz", **said)
    assert str(tmp_path / "a.npz") in str(caught.value)


def test_files_that_are_not_there_or_not_files(tmp_path):
    with pytest.raises(FileNotFoundError, match="there is no file"):
        scenes.read(tmp_path / "absent.mat")
    with pytest.raises(ValueError, match="no PNG pictures in it"):
        scenes.read(tmp_path)
    os.mkfifo(tmp_path / "pipe.mat")
    with pytest.raises(OSError, match="is not a file"):
        scenes.read(tmp_path / "pipe.mat")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "it is empty"),
        (b"GIF89a" + b"\0" * 600, r"known format \(native or NetCDF-4 \(.nc\), MATLAB 5 to 7.3"),
        (b"CDF\x01" + b"\0" * 600, "classic NetCDF"),
        (b"PK\x05\x06" + b"\0" * 18, "it holds no variables"),
        (b"PK\x03\x04", "truncated or damaged"),
        (b"\x93NUMPY", "truncated or damaged"),
    ],
)
def test_files_of_no_use(tmp_path, content, message):
    (tmp_path / "a.dat").write_bytes(content)
    with pytest.raises(ValueError, match=message):
        scenes.read(tmp_path / "a.dat")


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000, 1000000, 100), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 2, 3), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (True, 2, 3), }",
        "{'descr': '<f8', 'fortran_order': 0, 'shape': (1, 2, 3), }",
        "{'descr': '<f8', 'shape': (1, 2, 3), }",
        "[" * 5000,
        "__import__('os').abort()",
    ],
)
def test_npy_headers_are_not_trusted(tmp_path, header):
    text = header.encode()
    (tmp_path / "a.npy").write_bytes(b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + b"\0" * 48)
    with pytest.raises(ValueError, match="damaged"):
        scenes.read(tmp_path / "a.npy")


def test_npy_length_must_fit(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((2, 3, 4)))
    whole = (tmp_path / "a.npy").read_bytes()
    for content in (whole[:-1], whole + b"\0"):
        (tmp_path / "a.npy").write_bytes(content)
        with pytest.raises(ValueError, match="truncated or damaged"):
            scenes.read(tmp_path / "a.npy")


def test_native_says_what_it_holds_instead(cube, tmp_path):
    write_dataset(xr.Dataset({"snapshots": (("shot", "y", "x"), np.zeros((2, 3, 4)))}), tmp_path / "a.nc")
    with pytest.raises(ValueError, match=r"no datacube in it; it holds 'snapshots' \(2 × 3 × 4 float64\)"):
        scenes.read(tmp_path / "a.nc")
    with pytest.raises(ValueError, match=r"axes \(band, y, x\), got \(shot, y, x\)"):
        scenes.read(tmp_path / "a.nc", variable="snapshots")
    two = xr.Dataset({"truth": cube, "estimate": cube * 2})
    write_dataset(two, tmp_path / "a.nc")
    with pytest.raises(ValueError, match="several datacubes in it; say which with variable="):
        scenes.read(tmp_path / "a.nc")
    xr.testing.assert_identical(scenes.read(tmp_path / "a.nc", variable="estimate"), two.estimate)


def test_native_axes_and_wavelengths_can_be_said_otherwise(cube, tmp_path):
    scenes.write(cube, tmp_path / "a.nc")
    other = scenes.read(tmp_path / "a.nc", wavelengths=(400, 800))
    np.testing.assert_array_equal(other.wavelength, [400, 500, 600, 700, 800])
    np.testing.assert_array_equal(other, cube)
    turned = scenes.read(tmp_path / "a.nc", axes="band,x,y", wavelengths=(400, 800))
    np.testing.assert_array_equal(turned, cube.values.transpose(0, 2, 1))


@pytest.mark.parametrize("suffix", [".txt", ".h5"])
def test_unknown_suffixes_are_refused(cube, tmp_path, suffix):
    with pytest.raises(ValueError, match=r"must end with .nc, .mat, .npz, .npy, .hdr or .tif"):
        scenes.write(cube, tmp_path / f"a{suffix}")
    assert not list(tmp_path.iterdir())


def test_only_datacubes_are_written(cube, tmp_path):
    cube[0, 0, 0] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        scenes.write(cube, tmp_path / "a.nc")
    with pytest.raises(TypeError, match=r"xarray\.DataArray"):
        scenes.write(cube.values, tmp_path / "a.nc")
    assert not list(tmp_path.iterdir())


@real_data
def test_lego():
    with pytest.warns(UserWarning, match="guessed variable='hyperimg'") as caught:
        cube = scenes.read(DATA / "uis_lego/lego.mat", wavelengths=(451, 642))
    assert "wavelength" not in str(caught[0].message)
    assert cube.shape == (24, 256, 256)
    assert (float(cube.min()), float(cube.max())) == (0.0, 1.0)
    assert cube.wavelength.values[[0, -1]].tolist() == [451, 642]


@real_data
def test_cave():
    cube = quietly(
        DATA / "cave_toy/cave_toy_left_512x256x31_u16.npz",
        variable="cube",
        axes="y,x,band",
        wavelengths=np.arange(400, 701, 10),
    )
    with pytest.warns(UserWarning, match="wavelengths from 'wavelength_nm'"):
        xr.testing.assert_identical(scenes.read(DATA / "cave_toy/cave_toy_left_512x256x31_u16.npz"), cube)
    assert cube.shape == (31, 512, 256)
    assert cube.attrs == {"scale": 65535}


@real_data
def test_c_cassi():
    with pytest.warns(UserWarning, match="guessed"):
        cube = scenes.read(DATA / "uis_ccassi/OSO_FULL.mat")
    assert cube.shape == (11, 128, 128)
    np.testing.assert_allclose(cube.max(), 13197 / 65535, rtol=1e-6)
