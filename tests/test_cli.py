"""The command line: every command on small inputs, and one clear line with exit status 2 for whatever is wrong with them."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.cli import main
from shadowgram.measurement import read_measurement
from shadowgram.scenes.readers.native import read_dataset

COMMANDS = [
    "demo", "info", "convert", "compare", "capture", "reconstruct", "resolution", "codes make", "bench",
    "study list", "study run", "study show",
]  # fmt: skip


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty working directory with a small scene in it."""
    monkeypatch.chdir(tmp_path)
    sg.scenes.write(sg.scenes.chart(size=32, bands=4, seed=0), tmp_path / "scene.nc")
    return tmp_path


def names():
    return sorted(path.name for path in Path.cwd().iterdir())


def run(capsys, command, status=0):
    """Standard output of a command, as lines; the status is checked."""
    got = main(command.split())
    said = capsys.readouterr()
    assert got == status, said.err
    return said.out.splitlines()


def refuse(capsys, command):
    """The one line that a command says when it refuses its input; nothing may be left behind."""
    before = names()
    assert main(command.split()) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("shadowgram: ")
    assert said.err.count("\n") == 1
    assert names() == before
    return said.err


def read_json(capsys, command):
    return json.loads("\n".join(run(capsys, command)))


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_a_runnable_example(capsys, command):
    text = " ".join(" ".join(run(capsys, f"{command} --help")).split())
    assert f"Example: shadowgram {command}" in text


def test_help_lists_every_command(capsys):
    text = "\n".join(run(capsys, "--help"))
    assert all(command.split()[0] in text for command in COMMANDS)
    assert main([]) == 0
    assert capsys.readouterr().out.splitlines() == text.splitlines()


def test_version(capsys):
    assert run(capsys, "--version") == [f"shadowgram {sg.__version__}"]


def test_help_loads_nothing_heavy():
    code = (
        "import sys; from shadowgram.cli import main; main(['--help']);"
        "heavy = {'numba', 'scipy', 'xarray', 'matplotlib', 'h5py', 'pandas', 'rich', 'numpy'} & set(sys.modules);"
        "print(sorted(heavy), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == "[]\n"


@pytest.mark.parametrize("imager", ["sscsi", "cassi", "dual", "colored", "colored4"])
def test_capture_and_reconstruct(folder, capsys, imager):
    said = read_json(capsys, f"capture scene.nc -o shots.nc --imager {imager} --shots 2 --snr 40 --seed 1 --json")
    assert said["snapshots"][0] == 2
    assert said["datacube"] == [4, 32, 32]
    measured = read_measurement(folder / "shots.nc")
    assert measured.noise.snr_db == 40
    assert measured.scene == "chart"
    said = read_json(capsys, "reconstruct shots.nc -o cube.nc --truth scene.nc --max-iter 20 --json")
    assert said["quality"]["psnr"] > 15
    cube, scene = sg.scenes.read("cube.nc"), sg.scenes.read("scene.nc")
    assert cube.shape == scene.shape
    assert np.allclose(cube.wavelength, scene.wavelength)
    assert said["quality"]["psnr"] == pytest.approx(sg.metrics.psnr(cube.values, scene.values, peak=1.0))


@pytest.mark.parametrize("solver", ["gpsr --tau 1e-3", "fista --tau 1e-3", "eigen-tv"])
def test_solvers(folder, capsys, solver):
    run(capsys, "capture scene.nc -o shots.nc")
    said = read_json(capsys, f"reconstruct shots.nc -o cube.nc --max-iter 5 --threads 1 --solver {solver} --json")
    assert 0 < said["iterations"] <= 5
    settings = json.loads((folder / "cube.json").read_text())
    assert settings["options"]["solver"] == solver.split()[0]
    assert settings["solver"]["max_iter"] == 5


def test_interrupted_reconstruction_keeps_the_best_so_far(folder, capsys, monkeypatch):
    from shadowgram.solvers import solution

    assert all((sg.EigenTV, sg.GPSR, sg.FISTA))  # they register with `solve`, which must still be the true one
    solve = solution.solve

    def interrupted(spec, H, y, callback=None):
        def interrupt(iteration, values):
            callback(iteration, values)
            if iteration >= 2:
                os.kill(os.getpid(), signal.SIGINT)

        return solve(spec, H, y, callback=interrupt)

    monkeypatch.setattr(solution, "solve", interrupted)
    run(capsys, "capture scene.nc -o shots.nc")
    assert main(["reconstruct", "shots.nc", "-o", "cube.nc"]) == 130
    said = capsys.readouterr()
    assert "the best so far is in cube.nc" in said.err
    assert sg.scenes.read("cube.nc").shape == (4, 32, 32)
    assert json.loads((folder / "cube.json").read_text())["interrupted"] is True


def test_interrupt_elsewhere_leaves_nothing(folder, capsys, monkeypatch):
    def interrupt(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(sg.noise, "awgn", interrupt)
    assert main(["capture", "scene.nc", "-o", "shots.nc", "--snr", "30"]) == 130
    assert capsys.readouterr().err == "shadowgram: interrupted; no file is half written\n"
    assert names() == ["scene.nc"]


def test_settings_are_kept_in_the_file_and_beside_it(folder, capsys):
    run(capsys, "capture scene.nc -o shots.nc --shots 2 --seed 5")
    beside = json.loads((folder / "shots.json").read_text())
    inside = json.loads(read_dataset(folder / "shots.nc").attrs["configuration"])
    assert beside == inside
    assert beside["command"] == "capture"
    assert beside["version"] == sg.__version__
    assert beside["options"]["shots"] == 2
    assert beside["options"]["seed"] == 5
    assert beside["options"]["detector_pitch"] == 10.0  # a default
    assert beside["imager"]["mask_position"] == 4 / 32  # what came of one


def test_same_command_same_bytes(folder, capsys):
    for out in ("a.nc", "b.nc"):
        run(capsys, f"capture scene.nc -o {out} --snr 30")
    a, b = (read_measurement(out).snapshots for out in ("a.nc", "b.nc"))
    assert np.array_equal(a, b)


def test_bands_to_keep(folder, capsys):
    run(capsys, "convert scene.nc some.nc --bands 500:600")
    kept = sg.scenes.read("some.nc").wavelength.values
    assert kept.tolist() == [525.0, 575.0]
    assert "keeps none of the bands at 475 to 625 nm" in refuse(capsys, "convert scene.nc none.nc --bands 700:800")
    assert "--bands takes first:last" in refuse(capsys, "convert scene.nc none.nc --bands 700")


def test_fine_scene_of_a_cassi(folder, capsys):
    sg.scenes.write(sg.scenes.chart(size=32, bands=16, seed=0), "fine.nc")
    said = read_json(capsys, "capture fine.nc -o shots.nc --imager cassi --bands 4 --fine --json")
    assert said["datacube"] == [4, 32, 32]
    assert "multiple" in refuse(capsys, "capture fine.nc -o other.nc --imager cassi --bands 5 --fine")
    assert "--bands belongs to the CASSIs" in refuse(capsys, "capture fine.nc -o other.nc --bands 4 --fine")


def test_cassi_options(folder, capsys):
    Path("prism.txt").write_text("# nm, px\n440, 0\n550, 4.5\n660, 7\n")
    run(capsys, "capture scene.nc -o shots.nc --imager cassi --shear exact --dispersion prism.txt")
    imager = read_json(capsys, "info shots.nc --json")["imager"]
    assert (imager["shear"], imager["dispersion"][1]) == ("exact", [550.0, 4.5])
    assert "440: 0, 550: 4.5, 660: 7" in "".join(run(capsys, "info shots.nc"))
    run(capsys, "capture scene.nc -o shots.nc --imager dual --band-shift 1.5")
    assert read_json(capsys, "info shots.nc --json")["imager"]["band_shift"] == 1.5
    Path("bad.txt").write_text("440 0\n550\n")
    assert "line 2 of bad.txt" in refuse(capsys, "capture scene.nc -o o.nc --imager cassi --dispersion bad.txt")
    assert "shear must be one of 'centre', 'exact'" in refuse(
        capsys, "capture scene.nc -o o.nc --imager cassi --shear edge"
    )
    assert "belong to the CASSIs" in refuse(capsys, "capture scene.nc -o o.nc --band-shift 2")


def test_fine_scene(folder, capsys):
    sg.scenes.write(sg.scenes.chart(size=32, bands=16, seed=0), "fine.nc")
    assert "the cube has 16" in refuse(capsys, "capture fine.nc -o shots.nc --mask-position 0.125")
    run(capsys, "capture fine.nc -o shots.nc --mask-position 0.125 --fine")
    said = read_json(capsys, "reconstruct shots.nc -o cube.nc --truth fine.nc --max-iter 20 --json")
    assert said["quality"]["psnr"] > 15


def test_super_resolving_camera(folder, capsys):
    sg.scenes.write(sg.scenes.chart(size=(32, 28), bands=4, seed=0), "scene.nc")
    geometry = "--detector-shape 16x16 --code-pitch 5 --mask-position 0.125"
    said = read_json(capsys, f"capture scene.nc -o shots.nc {geometry} --json")
    assert said["snapshots"] == [3, 16, 16]
    assert said["datacube"] == [4, 32, 28]


@pytest.mark.parametrize("file", ["code.nc", "code.npy"])
def test_code_from_a_file(folder, capsys, file):
    run(capsys, f"codes make --shape 32x32 --kind random --shots 5 --seed 7 -o {file}")
    run(capsys, f"capture scene.nc -o shots.nc --code {file}")
    expected = sg.codes.random(shots=5, shape=(32, 32), seed=7)
    assert np.array_equal(read_measurement("shots.nc").code, expected)


def test_code_as_pictures(folder, capsys):
    said = read_json(capsys, "codes make --shape 32x32 --shots 2 -o code.png --json")
    assert said["files"] == ["code-1.png", "code-2.png"]
    run(capsys, "capture scene.nc -o shots.nc --code code-2.png")
    expected = sg.codes.boolean(shots=2, shape=(32, 32), seed=0)[1:]
    assert np.array_equal(read_measurement("shots.nc").code, expected)


def test_colored_code_file(folder, capsys):
    run(capsys, "codes make --shape 32x32 --kind four --bands 4 --shots 2 -o code.nc")
    run(capsys, "capture scene.nc -o shots.nc --imager colored --code code.nc")
    assert read_measurement("shots.nc").code.shape == (2, 4, 32, 32)


def test_info(folder, capsys):
    said = read_json(capsys, "info scene.nc --json")
    assert said["kind"] == "datacube"
    assert said["shape"] == [4, 32, 32]
    assert said["wavelengths_nm"] == [475, 625]
    run(capsys, "capture scene.nc -o shots.nc --snr 30")
    said = read_json(capsys, "info shots.nc --json")
    assert said["kind"] == "measurement"
    assert said["imager"]["type"] == "SSCSI"
    assert said["noise"] == {"snr_db": 30, "seed": 0}
    run(capsys, "codes make --shape 8x9 -o code.nc")
    assert read_json(capsys, "info code.nc --json")["shape"] == [3, 8, 9]
    assert run(capsys, "info scene.nc")[2].split() == ["shape", "4", "×", "32", "×", "32"]


@pytest.mark.parametrize("ending", ["mat", "npz", "npy"])
def test_convert_and_back(folder, capsys, ending):
    run(capsys, f"convert scene.nc other.{ending}")
    # A .npy says neither axes nor wavelengths.
    options = "--axes band,y,x --wavelengths 475:625" if ending == "npy" else ""
    said = read_json(capsys, f"convert other.{ending} back.nc {options} --json")
    assert said["shape"] == [4, 32, 32]
    back, scene = sg.scenes.read("back.nc"), sg.scenes.read("scene.nc")
    assert np.array_equal(back.values, scene.values)
    assert np.allclose(back.wavelength, scene.wavelength)


def test_convert_crops(folder, capsys):
    run(capsys, "convert scene.nc part.nc --crop 2:12,5:32")
    assert np.array_equal(sg.scenes.read("part.nc").values, sg.scenes.read("scene.nc").values[:, 2:12, 5:32])


def test_falling_wavelengths_are_turned_round(folder, capsys):
    scene = sg.scenes.read("scene.nc")
    sg.scenes.write(scene[::-1], "falling.nc")
    run(capsys, "capture falling.nc -o a.nc")
    run(capsys, "capture scene.nc -o b.nc")
    assert np.array_equal(read_measurement("a.nc").snapshots, read_measurement("b.nc").snapshots)


def test_compare(folder, capsys):
    scene = sg.scenes.read("scene.nc")
    sg.scenes.write(scene + np.float32(0.1), "off.nc")
    said = read_json(capsys, "compare off.nc scene.nc --json --png both.png")
    assert said["psnr"] == pytest.approx(20, abs=1e-3)
    assert said["peak"] == 1
    assert (folder / "both.png").read_bytes().startswith(b"\x89PNG")
    assert read_json(capsys, "compare off.nc scene.nc --peak 10 --json")["psnr"] == pytest.approx(40, abs=1e-3)
    assert run(capsys, "compare off.nc scene.nc")[0].split() == ["PSNR", "20.00", "dB", "(peak", "1)"]


def test_compare_takes_the_largest_value_as_the_peak_beyond_one(folder, capsys):
    sg.scenes.write(sg.scenes.read("scene.nc") * 1000, "big.nc")
    said = read_json(capsys, "compare big.nc big.nc --json")
    assert said["peak"] > 1
    assert said["psnr"] is None  # infinite


def test_resolution(folder, capsys):
    said = read_json(capsys, "resolution --mask-position 0.09375 --wavelengths 451:642 --json --png s.png")
    assert said["cube_shape"] == [24, 256, 256]
    assert said["bands"] == 24
    assert (folder / "s.png").read_bytes().startswith(b"\x89PNG")
    said = read_json(
        capsys,
        "resolution --mask-position 0.09375 --wavelengths 451:642 --detector-shape 128x128 --code-pitch 5 --json",
    )
    assert said["cube_shape"] == [24, 256, 232]


def test_picture_of_a_capture(folder, capsys):
    run(capsys, "capture scene.nc -o shots.nc --imager colored --png shots.png")
    assert (folder / "shots.png").read_bytes().startswith(b"\x89PNG")


def test_warnings_are_one_line_each(folder, capsys):
    np.save("raw.npy", np.random.default_rng(0).random((32, 32, 4)))
    assert main(["capture", "raw.npy", "-o", "shots.nc"]) == 0
    said = capsys.readouterr().err
    assert said.startswith("shadowgram: warning: raw.npy: guessed")
    assert said.count("\n") == 1


BAD = {
    "no file": ("info missing.nc", "missing.nc"),
    "no scene": ("capture missing.nc -o shots.nc", "missing.nc"),
    "a folder": ("info .", "folder"),
    "unknown command": ("reconstrukt shots.nc", "No such command"),
    "unknown option": ("info scene.nc --colour", "No such option"),
    "option without a value": ("capture scene.nc -o", "-o"),
    "no output": ("capture scene.nc", "'-o'"),
    "not a number": ("capture scene.nc -o shots.nc --shots three", "--shots"),
    "unknown imager": ("capture scene.nc -o shots.nc --imager hubble", "--imager"),
    "unknown solver": ("reconstruct shots.nc -o cube.nc --solver magic", "--solver"),
    "no shots": ("capture scene.nc -o shots.nc --shots 0", "at least one shot"),
    "NaN in the cube": ("capture nan.nc -o shots.nc", "NaN"),
    "band counts that do not match": (
        "capture scene.nc -o shots.nc --mask-position 0.25",
        "resolves 8 bands, the cube has 4",
    ),
    "truth of other bands": ("reconstruct shots.nc -o cube.nc --truth three.nc", "resolves 4 bands, the cube has 3"),
    "pixel counts that do not match": (
        "capture scene.nc -o s.nc --detector-shape 32x16 --mask-position 0.25",
        "pixels",
    ),
    "too many bands": ("capture deep.nc -o shots.nc", "cannot be resolved"),
    "code of wrong shape": ("capture scene.nc -o shots.nc --code small.npy", "(shot, 32, 32), got (2, 8, 8)"),
    "code beyond 1": ("capture scene.nc -o shots.nc --code eight-bit.npy", "divide an 8-bit code by 255"),
    "code with NaN": ("capture scene.nc -o shots.nc --code nan.npy", "transmittance must lie in [0, 1]"),
    "code of Python objects": ("capture scene.nc -o shots.nc --code objects.npy", "objects.npy"),
    "code that is a picture of nothing": ("capture scene.nc -o shots.nc --code broken.png", "broken.png"),
    "code that is a cube": ("capture scene.nc -o shots.nc --code scene.nc", "holds no code"),
    "code of an unknown kind": ("capture scene.nc -o shots.nc --code best", "--code"),
    "code without a file": ("capture scene.nc -o shots.nc --code missing.npy", "missing.npy"),
    "random colored code": ("capture scene.nc -o shots.nc --imager colored --code random", "colored"),
    "s = 1": ("capture scene.nc -o shots.nc --mask-position 1", "mask_position must lie in [0, 1)"),
    "s < 0": ("resolution --mask-position -0.1 --wavelengths 450:650", "mask_position must lie in [0, 1)"),
    "pitches that do not divide": (
        "capture scene.nc -o s.nc --code-pitch 4 --detector-shape 32x32 --mask-position 0.1",
        "whole multiple",
    ),
    "finer code without a geometry": ("capture scene.nc -o shots.nc --code-pitch 5", "--detector-shape"),
    "SSCSI option for a CASSI": ("capture scene.nc -o shots.nc --imager cassi --mask-position 0.1", "--mask-position"),
    "truncated scene": ("capture cut.nc -o shots.nc", "cut.nc"),
    "mutated scene": ("info mutated.nc", "damaged"),
    "text for a cube": ("info text.npy", "text.npy"),
    "cube for a measurement": ("reconstruct scene.nc -o cube.nc", "is not a measurement"),
    "measurement for a cube": ("compare shots.nc scene.nc", "shots.nc"),
    "output folder that does not exist": ("capture scene.nc -o nowhere/shots.nc", "there is no folder nowhere"),
    "output folder that is a file": ("capture scene.nc -o text.npy/shots.nc", "there is no folder"),
    "output that is a folder": ("convert scene.nc sub.nc", "sub.nc is a folder"),
    "demo in a file": ("demo --quick --out text.npy", "text.npy"),
    "unknown format": ("convert scene.nc scene.xyz", ".nc or .mat"),
    "output over the input": ("convert scene.nc scene.nc", "is the input"),
    "output over the input by another name": ("convert scene.nc sub.nc/../scene.nc", "is the input"),
    "output over the truth": ("reconstruct shots.nc -o scene.nc --truth scene.nc", "is the input"),
    "settings over another file": ("convert scene.nc mine.npz", "mine.json"),
    "cubes of two shapes": ("compare scene.nc three.nc", "one shape"),
    "peak of zero": ("compare scene.nc scene.nc --peak 0", "peak"),
    "crop beyond the cube": ("convert scene.nc part.nc --crop 0:33,0:32", "reaches beyond"),
    "crop in words": ("convert scene.nc part.nc --crop top", "--crop takes"),
    "wavelengths in words": ("resolution --mask-position 0.1 --wavelengths blue:red", "--wavelengths takes"),
    "falling wavelengths": ("resolution --mask-position 0.1 --wavelengths 650:450", "ascending"),
    "size in words": ("codes make --shape large -o code.nc", "--shape takes"),
    "colored code without bands": ("codes make --shape 8x8 --kind four -o code.nc", "say --bands"),
    "colored code as a picture": ("codes make --shape 8x8 --kind four --bands 4 -o code.png", "PNG"),
    "code in an unknown format": ("codes make --shape 8x8 -o code.txt", ".nc or .npy or .png"),
    "transmittance beyond 1": ("codes make --shape 8x8 --kind random --transmittance 2 -o code.nc", "transmittance"),
    "threads": ("reconstruct shots.nc -o cube.nc --threads 0", "threads"),
    "tau for eigen-tv": ("reconstruct shots.nc -o cube.nc --tau 1e-3", "--tau belongs to"),
    "tau below zero": ("reconstruct shots.nc -o cube.nc --solver gpsr --tau -1", "tau"),
    "SNR that is none": ("capture scene.nc -o shots.nc --snr nan", "snr_db"),
    "negative seed": ("capture scene.nc -o other.nc --seed -1", "seed"),
}


@pytest.fixture(scope="module")
def bad_inputs(tmp_path_factory):
    """A folder of good and bad files, which no command of the table changes."""
    folder = tmp_path_factory.mktemp("bad")
    scene = sg.scenes.chart(size=32, bands=4, seed=0)
    sg.scenes.write(scene, folder / "scene.nc")
    sg.scenes.write(scene[:3], folder / "three.nc")
    sg.scenes.write(sg.scenes.chart(size=16, bands=20, seed=0), folder / "deep.nc")
    holed = scene.copy(deep=True)
    holed[1, 2, 3] = np.nan
    sg.scenes.readers.native.write_dataset(holed.to_dataset(name="chart"), folder / "nan.nc")
    whole = (folder / "scene.nc").read_bytes()
    (folder / "cut.nc").write_bytes(whole[: len(whole) // 2])
    (folder / "mutated.nc").write_bytes(whole[:9000] + bytes([whole[9000] ^ 1]) + whole[9001:])
    np.save(folder / "small.npy", np.ones((2, 8, 8)))
    np.save(folder / "eight-bit.npy", np.full((2, 32, 32), 255, np.uint8))
    np.save(folder / "nan.npy", np.full((2, 32, 32), np.nan))
    np.save(folder / "objects.npy", np.array([{}], object), allow_pickle=True)
    (folder / "broken.png").write_bytes(b"\x89PNG\r\n\x1a\n broken")
    (folder / "text.npy").write_text("not an array")
    (folder / "sub.nc").mkdir()
    (folder / "mine.json").write_text('{"important": true}')
    with contextlib.chdir(folder):
        assert main(["capture", "scene.nc", "-o", "shots.nc"]) == 0
    return folder


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_in_one_line(bad_inputs, monkeypatch, capsys, case):
    monkeypatch.chdir(bad_inputs)
    command, expected = BAD[case]
    assert expected in refuse(capsys, command)


def test_read_only_folder(folder, capsys):
    locked = folder / "locked"
    locked.mkdir(mode=0o555)
    if os.access(locked, os.W_OK):  # root may write everywhere but here
        locked = Path("/proc")
    if not locked.is_dir():
        pytest.skip("this user may write everywhere")
    assert f"cannot write in the folder {locked}" in refuse(capsys, f"capture scene.nc -o {locked}/shots.nc")
    assert f"cannot write in the folder {locked}" in refuse(capsys, f"demo --quick --out {locked}")


def test_full_disk_is_one_line(folder, capsys, monkeypatch):
    from shadowgram.scenes.readers import atomic

    def full(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(atomic, "_write", full)
    assert "No space left on device" in refuse(capsys, "capture scene.nc -o shots.nc")


def test_too_little_memory_is_one_line(folder, capsys, monkeypatch):
    def full(*arguments, **options):
        raise MemoryError("Unable to allocate 7 TiB")

    monkeypatch.setattr(sg.noise, "awgn", full)
    assert "not enough memory: Unable to allocate 7 TiB" in refuse(capsys, "capture scene.nc -o shots.nc --snr 30")


def test_bugs_are_not_hidden(folder, monkeypatch):
    def bug(*arguments, **options):
        raise AssertionError("impossible")

    monkeypatch.setattr(sg.noise, "awgn", bug)
    with pytest.raises(AssertionError, match="impossible"):
        main(["capture", "scene.nc", "-o", "shots.nc", "--snr", "30"])


def test_reader_that_goes_away_is_no_error(folder):
    command = f"{sys.executable} -c 'from shadowgram.cli import main; main()' info scene.nc --json | true"
    done = subprocess.run(["bash", "-o", "pipefail", "-c", command], capture_output=True, text=True, check=False)
    assert done.stderr == ""
