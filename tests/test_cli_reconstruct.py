"""`shadowgram reconstruct`: solvers, effort, whiteness, uncertainty and a picture beside the shots."""

import json

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.cli import main


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A scene, its shots, and pictures of it."""
    folder = tmp_path_factory.mktemp("made")
    cube = sg.scenes.chart(size=32, bands=6, seed=0)
    sg.scenes.write(cube, folder / "scene.nc")
    command = f"capture {folder}/scene.nc -o {folder}/shots.nc --imager dual --shots 1 --code random --snr 40 --seed 1"
    assert main(command.split()) == 0
    pan = 1000 * cube.values.mean(axis=0)
    np.save(folder / "pan.npy", pan)
    np.save(
        folder / "rgb.npy", np.moveaxis(np.tensordot(sg.scenes.rgb_response(cube.wavelength), cube.values, 1), 0, 2)
    )
    np.save(folder / "small.npy", pan[:30])
    np.save(folder / "dark.npy", 0 * pan)
    return folder


@pytest.fixture
def folder(made, tmp_path, monkeypatch):
    """An empty working directory with copies of what was made."""
    monkeypatch.chdir(tmp_path)
    for path in made.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


def run(capsys, options, status=0):
    got = main(f"reconstruct shots.nc -o cube.nc {options}".split())
    said = capsys.readouterr()
    assert got == status, said.err
    return said


def read_json(capsys, options):
    return json.loads(run(capsys, f"{options} --json").out)


@pytest.mark.parametrize(
    "solver", ["twist --tau 1e-3", "gap-tv --weight 0.2", "admm-tv --weight 0.1", "eigen-tv --noise 0.01"]
)
def test_solvers_take_their_options(folder, capsys, solver):
    said = read_json(capsys, f"--solver {solver} --max-iter 5")
    assert 0 < said["iterations"] <= 5
    name, option, value = solver.split()
    settings = json.loads((folder / "cube.json").read_text())["solver"]
    assert settings["type"].lower() == name.replace("-", "")
    assert settings[option[2:]] == float(value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--tau 0.1", "--tau belongs to gpsr, fista and twist"),
        ("--solver gap-tv --tau 0.1", "--tau belongs to gpsr, fista and twist"),
        ("--weight 0.1", "--weight belongs to gap-tv and admm-tv"),
        ("--solver gpsr --noise 0.1", "--noise belongs to eigen-tv"),
        ("--solver fista --quality best", "--quality belongs to eigen-tv"),
        ("--noise -1", "noise is a standard deviation"),
        ("--uncertainty cube.nc", "write to two files"),
        ("--uncertainty map.png", "must end in .nc"),
        ("--uncertainty shots.nc", "is the input"),
        ("--side small.npy", "must be a picture of 1 channel"),
        ("--side pan.npy --side-response rgb", "must be a picture of 3 channels"),
        ("--side dark.npy", "not all 0"),
        ("--side none.npy", "none.npy"),
    ],
)
def test_what_makes_no_sense_is_refused(folder, capsys, options, message):
    assert message in run(capsys, options, status=2).err
    assert not (folder / "cube.nc").exists()


def test_the_best_quality_says_how_long_it_takes(folder, capsys):
    said = run(capsys, "--quality best --max-iter 15 --truth scene.nc")
    assert "this will take about" in said.err
    assert "the denoiser" in said.out
    assert json.loads((folder / "cube.json").read_text())["solver"]["type"] == "EigenPnP"
    assert run(capsys, "--quality fast --max-iter 15").err == ""
    assert json.loads((folder / "cube.json").read_text())["solver"]["type"] == "EigenTV"


def test_a_wrong_model_shows_in_the_residual(folder, capsys):
    right = read_json(capsys, "")["whiteness"]
    assert "correlation of neighbours" in run(capsys, "--max-iter 3").out
    assert abs(right["correlation"]) <= 1
    assert len(right["scores"]) == len(right["lags"])
    assert read_json(capsys, "--solver gpsr --max-iter 3")["whiteness"] is None


def test_the_uncertainty_is_written(folder, capsys):
    said = read_json(capsys, "--uncertainty map.nc --max-iter 10")
    assert said["uncertainty"] == "map.nc"
    deviations, cube = sg.scenes.read("map.nc"), sg.scenes.read("cube.nc")
    assert deviations.shape == cube.shape
    assert np.allclose(deviations.wavelength, cube.wavelength)
    assert (deviations.values >= 0).all()
    assert deviations.values.mean() > 0


def test_an_interrupted_uncertainty_leaves_the_cube(folder, capsys, monkeypatch):
    from shadowgram.solvers import uncertainty

    def interrupt(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(uncertainty, "uncertainty", interrupt)
    assert "the cube is in cube.nc" in run(capsys, "--uncertainty map.nc --max-iter 5", status=130).err
    assert sg.scenes.read("cube.nc").shape == (6, 32, 32)
    assert not (folder / "map.nc").exists()


@pytest.mark.parametrize("response", ["pan", "rgb"])
def test_a_picture_beside_one_shot_helps(folder, capsys, response):
    alone = read_json(capsys, "--truth scene.nc")["quality"]["psnr"]
    both = read_json(capsys, f"--truth scene.nc --side {response}.npy --side-response {response}")["quality"]["psnr"]
    assert both > alone + 1


def test_strips_write_the_cube_and_say_how_many_there_were(folder, capsys):
    sg.scenes.write(sg.scenes.chart(size=(64, 16), bands=3, seed=0), folder / "tall.nc")
    command = f"capture {folder}/tall.nc -o {folder}/shots.nc --imager dual --shots 1 --code random --snr 40 --seed 1"
    assert main(command.split()) == 0
    capsys.readouterr()
    said = read_json(capsys, "--strips 32 --max-iter 5")
    assert (said["strips"], said["rows"]) == (2, 32)
    assert sg.scenes.read("cube.nc").shape == (3, 64, 16)
    assert json.loads((folder / "cube.json").read_text())["strips"]["strips"] == 2


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ("--strips 16 --truth scene.nc", "--truth needs the whole cube in memory"),
        ("--strips 16 --side pan.npy", "--side needs the whole cube in memory"),
        ("--strips 16 --solver gpsr", "strips take EigenTV, whose weights can be the same in all, not GPSR"),
        ("--strips half", "--strips takes a number of detector rows such as 256, or auto; got 'half'"),
        ("--workers 2", "add --strips auto"),
    ],
)
def test_strips_refuse_what_needs_the_whole_cube(folder, capsys, options, problem):
    assert problem in run(capsys, options, status=2).err
    assert not (folder / "cube.nc").exists()
