"""`shadowgram import`: shots and a mask from files become a measurement."""

import json

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import shadowgram as sg
from shadowgram.cli import main
from shadowgram.measurement import read_measurement

CENTRES = (450.0, 465.0, 490.0, 530.0)


@pytest.fixture
def files(tmp_path):
    """A capture, its mask and its wavelengths, as a camera's owner has them."""
    raw = gaussian_filter(np.random.default_rng(1).random((48, 48)), 0.7)
    mask = ((raw - raw.min()) / np.ptp(raw)).astype(np.float32)
    imager = sg.CASSI(cube_shape=(4, 48, 48), band_centres=CENTRES, band_shift=2)
    scene = np.zeros((4, 48, 48), np.float32)
    scene[:, 10:40, 10:40] = np.array([0.2, 0.5, 0.7, 0.3])[:, None, None]
    np.save(tmp_path / "mask.npy", mask)
    np.save(tmp_path / "shot.npy", imager.operator(mask).forward(scene)[0] + 0.1)
    (tmp_path / "nm.txt").write_text("450, 465  # blue\n490\n530\n", encoding="utf-8")
    return tmp_path


def run(folder, *more, shots="shot.npy", wavelengths="nm.txt"):
    known = folder / wavelengths
    nm = str(known) if known.is_file() else wavelengths
    out = folder / "shots.nc"
    given = [
        "import",
        str(folder / shots),
        "--mask",
        str(folder / "mask.npy"),
        "--band-shift",
        "2",
        "--wavelengths",
        nm,
    ]
    return main([*given, "-o", str(out), *more]), out


def test_measurement_of_captured_shots(files, capsys):
    status, out = run(files)
    assert status == 0
    found = read_measurement(out)
    assert found.imager.resolution.wavelengths.tolist() == list(CENTRES)
    np.testing.assert_array_equal(found.snapshots[0], np.load(files / "shot.npy").astype(np.float32))
    np.testing.assert_array_equal(found.code[0], np.load(files / "mask.npy"))
    assert "4 bands" in capsys.readouterr().out
    assert main(["reconstruct", str(out), "-o", str(files / "cube.nc"), "--max-iter", "3"]) == 0
    assert sg.scenes.read(files / "cube.nc").wavelength.values.tolist() == list(CENTRES)


def test_corrected(files, capsys):
    status, out = run(files, "--correct", "--json")
    assert status == 0
    said = json.loads(capsys.readouterr().out)
    assert abs(said["mismatch"]["offsets"][0] - 0.1) < 0.01
    assert read_measurement(out).snapshots.min() < 0.02


def test_wavelengths_as_list_and_range(files):
    assert run(files, wavelengths="450,465,490,530")[0] == 0
    status, out = run(files, "--bands", "4", wavelengths="450:540")
    assert status == 0
    assert read_measurement(out).imager.resolution.wavelengths.tolist() == [450, 480, 510, 540]


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"wavelengths": "450,465,490,500,530"}, "a band is missing"),
        ({"wavelengths": "450:540"}, "say the number of bands"),
        ({"wavelengths": "blue,red"}, "must be numbers in nm"),
        ({"wavelengths": "450"}, "one band"),
    ],
)
def test_what_is_refused(files, capsys, more, says):
    assert run(files, **more)[0] == 2
    assert says in capsys.readouterr().err


def test_other_problems_are_named(files, capsys):
    assert run(files, "--camera", "sscsi")[0] == 2
    assert "not sscsi" in capsys.readouterr().err
    assert run(files, "--bands", "5")[0] == 2
    assert "--bands is 5" in capsys.readouterr().err
    mask, shot = np.load(files / "mask.npy"), np.load(files / "shot.npy")
    np.save(files / "mask.npy", mask[:40])
    assert run(files)[0] == 2
    assert "a mask of another size" in capsys.readouterr().err
    np.save(files / "mask.npy", mask)
    np.save(files / "shot.npy", np.full_like(shot, 0.5))
    assert run(files)[0] == 2
    assert "shows nothing" in capsys.readouterr().err
    np.save(files / "shot.npy", np.minimum(shot, np.quantile(shot, 0.95)))
    assert run(files)[0] == 0
    assert "warning: shot 0 is saturated" in capsys.readouterr().err
    np.save(files / "small.npy", shot[:40])
    out = files / "shots.nc"
    two = ["import", str(files / "shot.npy"), str(files / "small.npy"), "--mask", str(files / "mask.npy")]
    assert main([*two, "--wavelengths", "450,465,490,530", "-o", str(out)]) == 2
    assert "the shots must have one size" in capsys.readouterr().err


def test_a_folder_of_a_camera(files):
    shot = np.load(files / "shot.npy")
    folder = files / "camera"
    folder.mkdir()
    np.save(folder / "a.npy", (shot * 1000).astype(np.uint16))
    np.save(folder / "dark.npy", np.full(shot.shape, 100, np.uint16))
    (folder / "capture.toml").write_text(
        'exposure = 0.5\nsaturation = 65535\ndark = ["dark.npy"]\n[[shots]]\nframes = ["a.npy"]\n', encoding="utf-8"
    )
    status, out = run(files, shots="camera")
    assert status == 0
    np.testing.assert_allclose(read_measurement(out).snapshots[0], 2000 * (shot - 0.1), atol=3)
