"""Folders of PNG pictures, and the pictures themselves against another library."""

import warnings
import zlib

import numpy as np
import pytest
from PIL import Image

from shadowgram import scenes
from shadowgram.scenes.readers.png import png_bytes, read_grey, read_picture

VALUES = np.random.default_rng(0).random((4, 8, 9), np.float32)
NM = [450, 500.5, 550, 600 + 1 / 3]


def save(folder, names, depth=16, shape=(8, 9)):
    folder.mkdir(exist_ok=True)
    for i, name in enumerate(names):
        picture = np.full(shape, (i + 1) * (256 if depth == 16 else 1), np.uint16 if depth == 16 else np.uint8)
        (folder / name).write_bytes(png_bytes(picture))
    return folder


def quietly(path, **said):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return scenes.read(path, **said)


def order(cube):
    """Which picture each band came from."""
    return (
        np.rint(cube.values[:, 0, 0] * cube.attrs["scale"] / (256 if cube.attrs["scale"] > 255 else 1))
        .astype(int)
        .tolist()
    )


def test_there_and_back(tmp_path):
    cube = scenes.as_datacube(VALUES, NM, name="scene2")
    scenes.write(cube, tmp_path / "a")
    back = quietly(tmp_path / "a")
    np.testing.assert_array_equal(back.wavelength, NM)
    np.testing.assert_allclose(back, VALUES, atol=0.5 / 65535 + 1e-7)
    assert back.name == "scene2"
    names = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert names[:2] == ["scene2_01_450nm.png", "scene2_02_500.5nm.png"]
    seen = np.asarray(Image.open(tmp_path / "a" / names[1]))
    np.testing.assert_array_equal(seen, np.rint(VALUES[1] * np.float64(65535)))
    scenes.write(back, tmp_path / "b")
    np.testing.assert_array_equal(quietly(tmp_path / "b"), back)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_whole_numbers_are_kept(tmp_path, dtype):
    cube = scenes.as_datacube(VALUES, (400, 700)).copy(data=(VALUES * 255).astype(dtype))
    scenes.write(cube, tmp_path / "a")
    back = quietly(tmp_path / "a")
    np.testing.assert_array_equal(np.rint(back * back.attrs["scale"]), cube)
    assert back.attrs["scale"] == np.iinfo(dtype).max


@pytest.mark.parametrize(
    ("names", "found", "nm"),
    [
        (["ms_01.png", "ms_03.png", "ms_02.PNG"], [1, 3, 2], None),
        (["b10.png", "b9.png", "b8.png", *(f"b{i}.png" for i in range(8))], [*range(4, 12), 3, 2, 1], None),
        (["s_650nm.png", "s_450nm.png", "s_550.5 nm.png"], [2, 3, 1], [450, 550.5, 650]),
        (["3_450nm.png", "1_650nm.png", "2_550nm.png"], [2, 3, 1], [650, 550, 450]),
        (["cube31_650nm.png", "cube31_450nm.png"], [2, 1], [450, 650]),
    ],
)
def test_order_and_wavelengths_from_names(tmp_path, names, found, nm):
    folder = save(tmp_path / "a", names)
    for other in ("scene_RGB.bmp", "Thumbs.db", "readme.txt", ".hidden.png"):
        (folder / other).write_bytes(b"anything")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        cube = scenes.read(folder)
    assert order(cube) == found
    said = " ".join(str(one.message) for one in caught)
    if nm is None:
        assert "guessed wavelengths=(400, 700) nm" in said
    else:
        assert not said
        np.testing.assert_array_equal(cube.wavelength, nm)
    assert quietly(folder, wavelengths=(400, 700)).wavelength[0] == 400


def test_even_steps_are_wavelengths_and_said(tmp_path):
    folder = save(tmp_path / "a", ["s_420.png", "s_410.png", "s_400.png"])
    with pytest.warns(UserWarning, match="numbers in its names, 400 to 420, were taken for wavelengths in nm"):
        np.testing.assert_array_equal(scenes.read(folder).wavelength, [400, 410, 420])


def test_cave_with_grey_in_colours(tmp_path):
    """One of the CAVE scenes is stored as 8 bits in four channels."""
    folder = save(tmp_path / "watercolors_ms", [], 8)
    for i in (1, 2, 3):
        grey = np.full((8, 9), 10 * i, np.uint8)
        Image.fromarray(np.dstack([grey, grey, grey, np.full_like(grey, 255)])).save(
            folder / f"watercolors_ms_{i:02d}.png"
        )
    cube = quietly(folder, wavelengths=(400, 700))
    np.testing.assert_allclose(cube[:, 0, 0], np.array([10, 20, 30]) / 255)
    assert cube.name == "watercolors_ms"


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ([], "no PNG pictures in it"),
        (["ms_01.png", "ms_03.png"], "number 2 is missing among its pictures, which go from 1 to 3"),
        (["ms_02.png", "ms_03.png"], "begin with number 2, so that the first ones seem to be missing"),
        (["ms_1.png", "ms_01.png"], "two of its pictures have the number 1"),
        (["ms_01.png", "rgb_02.png"], "not of one series"),
        (["ms_01.png", "ms.png"], "ms.png has neither|not of one series"),
        (["1_450nm.png", "3_550nm.png"], "number 2 is missing"),
        (["a_450nm.png", "b_450nm.png"], "not of one series"),
        (["a_450nm.png", "a_450.0nm.png"], "wavelengths must increase"),
    ],
)
def test_series_that_are_none(tmp_path, names, message):
    folder = save(tmp_path / "a", names)
    with pytest.raises(ValueError, match=message) as caught:
        scenes.read(folder)
    assert str(folder) in str(caught.value)


def test_pictures_that_do_not_fit(tmp_path):
    folder = save(tmp_path / "a", ["ms_01.png", "ms_02.png"])
    save(folder, ["ms_03.png"], shape=(8, 10))
    with pytest.raises(
        ValueError, match=r"one size and depth; ms_01.png is 8 × 9 uint16 and ms_03.png is 8 × 10 uint16"
    ):
        scenes.read(folder)
    save(folder, ["ms_03.png"], depth=8)
    with pytest.raises(ValueError, match=r"ms_03.png is 8 × 9 uint8"):
        scenes.read(folder)
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (8, 9, 3), np.uint8)).save(folder / "ms_03.png")
    (folder / "ms_01.png").unlink()
    (folder / "ms_02.png").unlink()
    with pytest.raises(ValueError, match=r"ms_03.png: it is a picture in colours; a grey one is needed"):
        scenes.read(folder, wavelengths=[500])
    (folder / "ms_03.png").unlink()
    (folder / "ms_03.png").symlink_to(folder / "ms_03.png")
    with pytest.raises(OSError, match=r"ms_03.png"):
        scenes.read(folder, wavelengths=[500])
    (folder / "ms_03.png").unlink()
    save(folder, ["ms_1.png", "ms_2.png"])
    (folder / "capture.toml").write_text("")
    with pytest.raises(ValueError, match=r"frames of a camera, not a datacube; read them with scenes.read_frames"):
        scenes.read(folder)


def test_folders_are_new_and_whole(tmp_path, monkeypatch):
    cube = scenes.as_datacube(VALUES, NM)
    save(tmp_path / "a", ["mine.png"])
    for path in (tmp_path / "a", tmp_path / "a" / "mine.png"):
        with pytest.raises((OSError, ValueError), match=r"it is there already|must end with"):
            scenes.write(cube, path)
    with pytest.raises(ValueError, match=r"hold values from 0 to 1, and these go from 0 to 2"):
        scenes.write(cube * 0 + [[[2.0]], [[0]], [[0]], [[0]]], tmp_path / "b")
    with pytest.raises(ValueError, match="not int32"):
        scenes.write(cube.astype(np.int32), tmp_path / "b")
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        scenes.write(cube, tmp_path / "b" / "c")
    from shadowgram.scenes.readers import png_folder

    def full(path, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(png_folder, "_write_synced", full)
    with pytest.raises(OSError, match=r"No space left on device; nothing was changed"):
        scenes.write(cube, tmp_path / "b")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_all_filters_and_depths_against_another_library(tmp_path):
    rng = np.random.default_rng(1)
    smooth = np.add.outer(np.arange(90) ** 2, 7 * np.arange(70)).astype(np.uint16)
    for picture in (smooth, (smooth // 64).astype(np.uint8), rng.integers(0, 2**16, (40, 31)).astype(np.uint16)):
        Image.fromarray(picture).save(tmp_path / "a.png")
        found = read_grey(tmp_path / "a.png")
        assert found.dtype == picture.dtype
        np.testing.assert_array_equal(found, picture)
        (tmp_path / "b.png").write_bytes(png_bytes(picture))
        np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "b.png")), picture)
        np.testing.assert_array_equal(read_grey(tmp_path / "b.png"), picture)
    colour = np.dstack([smooth, smooth.T.repeat(2, 0)[:90, :70], smooth[::-1]]).astype(np.uint8)
    Image.fromarray(colour).save(tmp_path / "c.png", optimize=True)
    np.testing.assert_array_equal(read_picture(tmp_path / "c.png").samples, colour)


@pytest.mark.parametrize(
    ("width", "height", "depth", "message"),
    [
        (10**9, 10**9, 8, "GiB in a file of"),
        (10**9, 10**3, 1, "GiB in a file of"),
        (0, 5, 8, "no pixels"),
        (2**31, 1, 8, "no pixels"),
        (9, 8, 7, "header is damaged"),
        (9, 9, 16, "do not end where the picture does"),
        (9, 7, 16, "do not end where the picture does"),
    ],
)
def test_headers_are_not_trusted(tmp_path, width, height, depth, message):
    data = bytearray(png_bytes(np.ones((8, 9), np.uint16)))
    data[16:25] = width.to_bytes(4) + height.to_bytes(4) + bytes([depth])
    data[29:33] = zlib.crc32(data[12:29]).to_bytes(4)
    (tmp_path / "a.png").write_bytes(data)
    with pytest.raises(ValueError, match=message):
        scenes.read_array(tmp_path / "a.png")
