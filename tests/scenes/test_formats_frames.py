"""Arrays out of files of all formats, and folders of camera frames."""

import json
import os
import warnings

import numpy as np
import pytest
import xarray as xr
from scipy.io import savemat

from shadowgram import scenes
from shadowgram.scenes.readers.native import write_dataset
from shadowgram.scenes.readers.png import png_bytes
from shadowgram.scenes.readers.tiff_writer import ome_tiff

MASK = np.random.default_rng(0).integers(0, 2**16, (6, 7), np.uint16)


def save_npy(path):
    np.save(path, MASK)


def save_npz(path):
    np.savez(path, mask=MASK, pitch=7.4, centres=np.arange(9.0))


def save_mat(path):
    savemat(path, {"mask": MASK, "lambda": np.arange(28.0), "note": "a text", "pitch": 7.4})


def save_nc(path):
    write_dataset(xr.Dataset({"mask": (("y", "x"), MASK), "shots": ("shot", np.arange(3.0))}), path)


def save_foreign_nc(path):
    xr.Dataset({"mask": (("y", "x"), MASK)}).to_netcdf(path, engine="h5netcdf")


def save_tif(path):
    path.write_bytes(b"".join(ome_tiff(MASK[None], None, "mask")))


def save_png(path):
    path.write_bytes(png_bytes(MASK))


@pytest.mark.parametrize("save", [save_npy, save_npz, save_mat, save_nc, save_foreign_nc, save_tif, save_png])
def test_masks_of_all_formats(tmp_path, save):
    path = tmp_path / f"mask.{save.__name__.split('_')[-1]}"
    save(path)
    for said in ({}, {"variable": "mask"}):
        found = scenes.read_array(path, **said)
        assert found.dtype == np.uint16
        np.testing.assert_array_equal(found, MASK)
    with pytest.raises(ValueError, match=r"no variable 'code' in it; it holds 'mask' \(6 × 7 uint16\)"):
        scenes.read_array(path, "code")


def test_snapshots_of_three_axes(tmp_path):
    shots = np.random.default_rng(0).normal(size=(2, 6, 7))
    np.save(tmp_path / "a.npy", shots)
    np.testing.assert_array_equal(scenes.read_array(tmp_path / "a.npy"), shots)
    scenes.write(scenes.as_datacube(shots, (400, 700)), tmp_path / "a.hdr")
    np.testing.assert_array_equal(scenes.read_array(tmp_path / "a.dat"), shots.astype(np.float32))


@pytest.mark.parametrize(
    ("arrays", "variable", "message"),
    [
        ({"a": MASK, "b": MASK}, None, "several arrays of two or three axes in it; say which with variable="),
        ({"a": MASK[0]}, None, "no array of two or three axes"),
        ({"a": MASK[0]}, "a", "'a' is not an array of two or three axes; it is 7 uint16"),
        ({"a": MASK[:0]}, "a", "'a' is not an array"),
        ({"a": MASK * 1j}, None, "no array of two or three axes.*complex numbers"),
        ({"a": np.where(MASK > 1000, np.nan, 1.0)}, None, r"'a' has \d+ values that are NaN or infinite"),
    ],
)
def test_arrays_that_are_none(tmp_path, arrays, variable, message):
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(ValueError, match=message) as caught:
        scenes.read_array(tmp_path / "a.npz", variable)
    assert str(tmp_path / "a.npz") in str(caught.value)


def test_arrays_that_are_not_there(tmp_path):
    with pytest.raises(FileNotFoundError, match="there is no file"):
        scenes.read_array(tmp_path / "a.npz")
    with pytest.raises(IsADirectoryError, match="is a folder"):
        scenes.read_array(tmp_path)


def folder_of(folder, notes, **frames):
    for name, frame in frames.items():
        np.save(folder / f"{name}.npy", np.asarray(frame))
    text = notes if isinstance(notes, str) else json.dumps(notes)
    (folder / ("capture.toml" if isinstance(notes, str) else "capture.json")).write_text(text, encoding="utf-8")
    return folder


def read_quietly(folder):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return scenes.read_frames(folder)


def test_dark_frames_exposures_and_repeated_frames(tmp_path):
    rng = np.random.default_rng(1)
    rate, offset, current = rng.uniform(1000, 9000, (2, 4, 5)), rng.uniform(50, 90, (4, 5)), rng.uniform(1, 9, (4, 5))

    def frame(k, seconds, noise=0.0):
        return rate[k] * seconds + offset + current * seconds + noise

    bump = rng.normal(size=(4, 5))
    frames = {"a1": frame(0, 0.5, bump), "a2": frame(0, 0.5, -bump), "b1": frame(1, 0.5), "b2": frame(1, 2.0)}
    darks = {"d1": offset + current * 0.5 + 1, "d2": offset + current * 0.5 - 1, "d3": offset + current * 2}
    notes = """
    exposure = 0.5
    saturation = 60000
    dark = ["d1.npy", "d2.npy", {frame = "d3.npy", exposure = 2}]
    [[shots]]
    frames = ["a1.npy", "a2.npy"]
    [[shots]]
    frames = ["b1.npy", "b2.npy"]
    exposure = [0.5, 2.0]
    """
    found = read_quietly(folder_of(tmp_path, notes, **frames, **darks))
    np.testing.assert_allclose(found.snapshots, rate, rtol=1e-12)
    np.testing.assert_array_equal(found.exposures, [1.0, 2.5])
    assert not found.saturated.any()
    assert found.snapshots.shape == found.saturated.shape == (2, 4, 5)
    longer = {"saturation": 60000, "dark": [{"frame": "d1.npy", "exposure": 0.5}, {"frame": "d3.npy", "exposure": 2}]}
    longer |= {"shots": [{"frames": ["c.npy"], "exposure": 3}]}
    (tmp_path / "capture.toml").unlink()
    np.save(tmp_path / "d1.npy", offset + current * 0.5)
    found = read_quietly(folder_of(tmp_path, longer, c=frame(0, 3)))
    np.testing.assert_allclose(found.snapshots[0], rate[0], rtol=1e-12)


def test_saturation(tmp_path):
    """Of three frames at three pixels: never, only in the longest, in one of two that are alike, everywhere."""
    short = [[100, 200, 4095, 4095]], [[100, 200, 3000, 4095]]
    notes = {
        "saturation": 4095,
        "dark": [{"frame": "d.npy", "exposure": e} for e in (1, 10)],
        "shots": [{"frames": ["a.npy", "b.npy", "c.npy"], "exposure": [1, 1, 10]}],
    }
    folder_of(tmp_path, notes, a=short[0], b=short[1], c=[[1000, 4095, 4095, 4095]], d=[[0, 0, 0, 95]])
    with pytest.warns(UserWarning, match=r"shot 1: 2 of 4 pixels \(50.00%\) are saturated"):
        found = scenes.read_frames(tmp_path)
    np.testing.assert_allclose(found.snapshots, [[[100, 200, 7095 / 2, 4000]]])
    assert found.saturated.tolist() == [[[False, False, True, True]]]


def test_what_is_not_said_is_said(tmp_path):
    (tmp_path / "a.png").write_bytes(png_bytes(np.array([[1, 255]], np.uint8)))
    folder_of(tmp_path, 'exposure = 2\n[[shots]]\nframes = ["a.png"]')
    with pytest.warns(UserWarning, match="no dark frames are said, so that nothing was subtracted") as caught:
        found = scenes.read_frames(tmp_path)
    said = str(caught[0].message)
    assert "the saturation is not said: the full scale of the frames, 255, was taken" in said
    assert "1 of 2 pixels" in said
    assert caught[0].filename == __file__
    np.testing.assert_array_equal(found.snapshots, [[[0.5, 127.5]]])
    folder_of(tmp_path, 'exposure = 2\n[[shots]]\nframes = ["b.npy"]', b=[[1.0, 2.0]])
    with pytest.warns(UserWarning, match="the saturation is not said: it was not looked for"):
        scenes.read_frames(tmp_path)


SHOT = '[[shots]]\nframes = ["a.npy"]\n'


@pytest.mark.parametrize(
    ("notes", "message"),
    [
        ("", "must have shots"),
        ("shots = []", "must have shots"),
        ("shots = [3]", "shot 1 must be a table"),
        ("[[shots]]\nframes = []", "shot 1 must have frames"),
        (SHOT, "the exposure of shot 1 is not said"),
        ("exposure = 0\n" + SHOT, "exposure must be a positive number, got '0'"),
        ("exposure = nan\n" + SHOT, "exposure must be a positive number, got 'nan'"),
        ("exposure = true\n" + SHOT, "exposure must be a positive number"),
        ('exposure = "2 s"\n' + SHOT, "got '2 s'"),
        ("exposure = " + "9" * 400 + "\n" + SHOT, "exposure is too large"),
        ("exposure = 1\nsaturation = -1\n" + SHOT, "saturation must be a positive number"),
        ("exposure = 1\ngain = 2\n" + SHOT, "says 'gain', which is not known; it may say exposure, saturation"),
        ("exposure = 1\n" + SHOT + "exposures = 2", "shot 1 says 'exposures'"),
        ("exposure = 1\n" + SHOT + "exposure = [1, 2]", "shot 1 has 1 frames and 2 exposures"),
        ("exposure = 1\ndark = 3\n" + SHOT, "dark must be a list"),
        ("exposure = 1\ndark = [3]\n" + SHOT, "dark frame 1 must be the name of a file"),
        ('exposure = 1\n[[shots]]\nframes = ["/etc/passwd"]', "must be in the folder"),
        ('exposure = 1\n[[shots]]\nframes = ["../a.npy"]', "must be in the folder"),
        ("exposure = [" * 3000, "nested too deep|Unclosed|cannot read"),
        ("exposure =", "cannot read"),
        ('exposure = 1\ndark = ["small.npy"]\n' + SHOT, "must be of one size; got 2 × 3 and 4 × 5 pixels"),
        ('exposure = 1\ndark = ["a.npy", "small.npy"]\n' + SHOT, "dark frames must be of one size"),
        ('exposure = 1\n[[shots]]\nframes = ["a.npy"]\n[[shots]]\nframes = ["small.npy"]', "shot 2 has 2 × 3 pixels"),
        ('exposure = 1\n[[shots]]\nframes = ["cube.npy"]', r"must be one grey frame \(y, x\).*\(2, 3, 4\)"),
        ('exposure = 1\n[[shots]]\nframes = ["damaged.npy"]', r"cannot read .*damaged\.npy: .*damaged"),
        ('exposure = 1\ndark = [{frame = "a.npy", exposure = 2}]\n' + SHOT, "no dark frame of 1 s"),
    ],
)
def test_descriptions_are_not_trusted(tmp_path, notes, message):
    folder_of(tmp_path, notes, a=np.zeros((4, 5)), small=np.zeros((2, 3)), cube=np.zeros((2, 3, 4)))
    (tmp_path / "damaged.npy").write_bytes(b"\x93NUMPY")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(ValueError, match=message) as caught:
            scenes.read_frames(tmp_path)
    assert os.fspath(tmp_path) in str(caught.value)


def test_descriptions_and_frames_that_are_not_there(tmp_path):
    with pytest.raises(
        FileNotFoundError, match=r"there is no capture.toml or capture.json in .*must say the exposures"
    ):
        scenes.read_frames(tmp_path)
    with pytest.raises(NotADirectoryError, match="there is no folder"):
        scenes.read_frames(tmp_path / "absent")
    folder_of(tmp_path, "exposure = 1\n" + SHOT)
    with pytest.raises(NotADirectoryError, match="is a file, not a folder"):
        scenes.read_frames(tmp_path / "capture.toml")
    with pytest.raises(FileNotFoundError, match=r"a\.npy"):
        scenes.read_frames(tmp_path)
    (tmp_path / "a.npy").symlink_to(tmp_path / "a.npy")
    with pytest.raises(FileNotFoundError, match=r"a\.npy"):
        scenes.read_frames(tmp_path)
    (tmp_path / "capture.json").write_text("[" * 100_000)
    with pytest.raises(ValueError, match=r"there are both capture.toml and capture.json"):
        scenes.read_frames(tmp_path)
    (tmp_path / "capture.toml").unlink()
    with pytest.raises(ValueError, match=r"capture\.json: "):
        scenes.read_frames(tmp_path)
