"""`shadowgram codes design`, `analyse` and the kinds of `make`: what they write, that nothing is lost, and what they refuse."""

import contextlib
import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.cli import main
from shadowgram.cli.code_imager import Geometry, Kind, make_imager
from shadowgram.codes.analysis import aapsd, band_power, clusters, noise_colour
from shadowgram.measurement import imager_to_json, read_measurement
from shadowgram.operators import as_matrix, sensing
from shadowgram.scenes.readers import atomic
from shadowgram.scenes.readers.native import read_dataset
from shadowgram.spectral.bench import read_bench

SMALL = "--detector-shape 24x24 --bands 4 --shots 3"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def imager():
    """What SMALL describes."""
    return sg.SSCSI(
        detector_shape=(24, 24), detector_pitch=10.0, code_pitch=10.0, mask_position=4 / 24, wavelengths=(450.0, 650.0)
    )


def names():
    return sorted(path.name for path in Path.cwd().iterdir())


def run(capsys, command, status=0):
    """Standard output of a command, as lines; the status is checked."""
    capsys.readouterr()
    got = main(command.split())
    said = capsys.readouterr()
    assert got == status, said.err
    return said.out.splitlines()


def read_json(capsys, command):
    return json.loads("\n".join(run(capsys, command)))


def refuse(capsys, command):
    """The one line that a command says when it refuses its input; nothing may be left behind."""
    capsys.readouterr()
    before = names()
    assert main(command.split()) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("shadowgram: ")
    assert said.err.count("\n") == 1
    assert names() == before
    return said.err


def geometry(**given):
    fields = dict.fromkeys(field.name for field in dataclasses.fields(Geometry))
    return Geometry(**{**fields, **given})


@pytest.mark.parametrize("command", ["design", "analyse", "export", "make"])
def test_help_has_a_runnable_example(capsys, command):
    text = " ".join(" ".join(run(capsys, f"codes {command} --help")).split())
    assert f"Example: shadowgram codes {command}" in text


def test_design_is_that_of_the_library(folder, capsys, imager):
    said = read_json(capsys, f"codes design -o code.nc {SMALL} --c1 3 --repulsion 0.5 --coupling 0.1 --seed 4 --json")
    found = sg.codes.design(imager, shots=3, seed=4, c1=3, repulsion=0.5, coupling=0.1)
    written = read_dataset("code.nc")
    assert np.array_equal(written["code"], found.code)
    assert written["costs"].values.tolist() == list(found.costs) == said["costs"]
    assert written["moves"].values.tolist() == list(found.moves)
    assert written.attrs["imager"] == imager_to_json(imager)
    assert (said["sweeps"], said["converged"], said["shape"]) == (found.sweeps, True, [3, 24, 24])
    assert said["light"] == pytest.approx(found.code.mean(axis=(1, 2)))
    assert names() == ["code.json", "code.nc"]
    kept = json.loads((folder / "code.json").read_text())
    assert kept == json.loads(written.attrs["configuration"])
    assert kept["design"]["weights"] == {"c1": 3, "repulsion": 0.5, "coupling": 0.1}
    assert kept["options"]["tolerance"] == 1e-3


def test_parts_of_the_cost(folder, capsys, imager):
    said = read_json(capsys, f"codes design -o code.nc {SMALL} --c1 3 --coupling 0.1 --json")
    parts, code = said["parts"], read_dataset("code.nc")["code"].values
    gram = np.square(as_matrix(imager.operator(code)).T @ as_matrix(imager.operator(code)))
    own = np.sqrt(np.diag(gram))
    assert parts["pairs"] == pytest.approx(gram.sum() - np.square(own).sum())
    assert parts["diagonal"] == pytest.approx(3 * np.square(own - 1).sum())
    assert min(parts["repulsion"], parts["coupling"]) > 0
    assert sum(parts.values()) == pytest.approx(said["costs"][-1])
    text = "\n".join(run(capsys, f"codes design -o code.nc {SMALL} --c1 3 --coupling 0.1"))
    assert f"{said['costs'][0]:.6g} → {said['costs'][-1]:.6g}" in text
    assert f"repulsion {parts['repulsion']:.4g}" in text


def test_designed_code_is_taken_by_the_other_commands(folder, capsys):
    sg.scenes.write(sg.scenes.chart(size=24, bands=4, seed=0), "scene.nc")
    run(capsys, f"codes design -o code.nc {SMALL} --png code.png")
    assert (folder / "code.png").read_bytes().startswith(b"\x89PNG")
    run(capsys, "capture scene.nc -o shots.nc --code code.nc")
    assert np.array_equal(read_measurement("shots.nc").code, read_dataset("code.nc")["code"])
    assert read_json(capsys, "info code.nc --json")["shape"] == [3, 24, 24]
    run(capsys, "codes export code.nc -o mask.gds --pitch 10")
    assert (folder / "mask.gds").exists()


@pytest.mark.parametrize(
    ("options", "kind", "shape"),
    [
        ("--imager cassi --bands 4 --detector-shape 12x24", sg.CASSI, (3, 12, 24)),
        ("--imager dual --bands 4 --detector-shape 12x24 --band-shift 2", sg.DualCASSI, (3, 12, 30)),
        ("--imager cassi --bands 4 --detector-shape 12x24 --shear exact", sg.CASSI, (3, 12, 24)),
        ("--imager colored --bands 4 --detector-shape 12x24", sg.ColoredCASSI, (3, 4, 12, 24)),
        ("--detector-shape 8x12 --code-pitch 5 --mask-position 0.125", sg.SSCSI, (3, 16, 24)),
        ("--detector-shape 24x24 --bands 4 --transmittance 0.5", sg.SSCSI, (3, 24, 24)),
        ("--detector-shape 24x24 --bands 4 --dispersion-ratio 1.2 --shear edge", sg.SSCSI, (3, 24, 24)),
    ],
)
def test_every_imager(folder, capsys, options, kind, shape):
    said = read_json(capsys, f"codes design -o code.nc --shots 3 {options} --json")
    assert said["imager"] == kind.__name__
    assert read_dataset("code.nc")["code"].shape == shape
    assert said["costs"][-1] < said["costs"][0]
    said = read_json(capsys, "codes analyse code.nc --json")
    assert said["sensing"]["imager"]["type"] == kind.__name__
    assert said["shape"] == list(shape)


def test_picture_of_a_colored_code(folder, capsys):
    run(capsys, f"codes design -o code.nc {SMALL} --imager colored --png code.png")
    run(capsys, "codes analyse code.nc --png sheet.png")
    assert (folder / "code.png").read_bytes().startswith(b"\x89PNG")
    assert len((folder / "sheet.png").read_bytes()) > len((folder / "code.png").read_bytes())


def test_dispersion_curve(folder, capsys):
    Path("prism.txt").write_text("440, 0\n550, 4.5\n660, 7\n")
    options = "--imager cassi --bands 4 --detector-shape 12x24 --shots 3 --dispersion prism.txt"
    assert "say the --wavelengths" in refuse(capsys, f"codes design -o code.nc {options}")
    run(capsys, f"codes design -o code.nc {options} --wavelengths 450:650")
    described = json.loads(read_dataset("code.nc").attrs["imager"])
    assert described["dispersion"] == [[440, 0], [550, 4.5], [660, 7]]
    assert described["wavelengths"] == [450, 650]


def test_bench_and_bands():
    bench = read_bench("salazar2022")
    assert make_imager(geometry(bench="salazar2022")) == bench.imager(bench.reachable[1])
    assert make_imager(geometry(bench="salazar2022", mask_position=0.02)) == bench.imager(0.02)
    assert make_imager(geometry(bench="salazar2022", bands=6)).resolution.bands == 6
    assert make_imager(geometry(bands=24)).resolution.cube_shape == (24, 256, 256)
    assert make_imager(geometry(bands=24)).mask_position == 24 / 256


def test_imager_takes_its_size_from_the_code():
    assert make_imager(geometry(bands=4, code_pitch=5.0), (32, 40)).detector_shape == (16, 20)
    assert make_imager(geometry(kind=Kind.cassi, bands=4), (32, 40)).cube_shape == (4, 32, 40)
    assert make_imager(geometry(kind=Kind.dual, bands=4, band_shift=2.0), (32, 40)).cube_shape == (4, 32, 34)
    assert make_imager(geometry(kind=Kind.colored), (5, 32, 40)).cube_shape == (5, 32, 40)
    assert make_imager(geometry(bands=4, detector_shape="8x9"), (32, 40)).detector_shape == (8, 9)


def test_tile_repeats_over_the_mask(folder, capsys, imager):
    run(capsys, f"codes design -o code.nc {SMALL} --tile 5x16")
    tile = sg.codes.design(imager, shots=3, seed=0, tile=(5, 16)).code
    expected = np.tile(tile, (1, 5, 2))[:, :24, :24]
    assert np.array_equal(read_dataset("code.nc")["code"], expected)


def test_best_of_several_starts(folder, capsys, imager):
    said = read_json(capsys, f"codes design -o code.nc {SMALL} --starts 2 --seed 2 --json")
    found = [sg.codes.design(imager, shots=3, seed=seed) for seed in (2, 3)]
    assert said["costs_of_starts"] == [one.costs[-1] for one in found]
    best = min(found, key=lambda one: one.costs[-1])
    assert said["seed"] == best.seed
    assert np.array_equal(read_dataset("code.nc")["code"], best.code)
    assert "best of 2" in "\n".join(run(capsys, f"codes design -o code.nc {SMALL} --starts 2 --seed 2"))


def test_exchanges(folder, capsys, imager):
    said = read_json(capsys, f"codes design -o code.nc {SMALL} --exchange --json")
    expected = sg.codes.design(imager, shots=3, seed=0)
    before = expected.costs[-1]
    for _ in range(said["exchange_sweeps"]):
        expected = sg.codes.exchange(imager, expected, max_sweeps=1)
    assert said["exchange_sweeps"] >= 1
    assert expected.converged
    assert np.array_equal(read_dataset("code.nc")["code"], expected.code)
    assert said["costs_of_starts"] == [before]
    assert said["costs"][-1] <= before


@pytest.mark.parametrize(
    ("options", "sweep"),
    [
        ("", 1),
        ("", 3),
        ("--starts 2", 2),
        ("--tile 6x12", 1),
        ("--transmittance 0.5", 2),
        ("--exchange", 3),
        ("--imager colored", 2),
    ],
)
def test_interrupted_design_goes_on_as_if_it_never_was(folder, capsys, monkeypatch, options, sweep):
    command = f"codes design -o code.nc {SMALL} --tolerance 1e-6 {options}"
    run(capsys, command)
    whole, kept = (folder / "code.nc").read_bytes(), (folder / "code.json").read_bytes()
    for file in names():
        Path(file).unlink()
    engine = sys.modules["shadowgram.codes._design"]
    design, once = engine.design, iter([True])

    def interrupted(*arguments, callback=None, **given):
        def interrupt(found):
            callback(found)
            if found.sweeps == sweep and next(once, False):
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.3)  # until the main thread has heard of it

        return design(*arguments, **given, callback=interrupt)

    monkeypatch.setattr(engine, "design", interrupted)
    assert main(command.split()) == 130
    said = capsys.readouterr()
    assert said.err == (
        "shadowgram: interrupted; the design so far is in code.design.nc, and the same command with --resume goes on\n"
    )
    assert names() == ["code.design.nc"]
    monkeypatch.undo()
    monkeypatch.chdir(folder)
    run(capsys, f"{command} --resume")
    assert names() == ["code.json", "code.nc"]
    assert (folder / "code.nc").read_bytes() == whole
    assert (folder / "code.json").read_bytes() == kept


def test_interrupt_before_the_first_sweep_leaves_nothing(folder, capsys, monkeypatch):
    def interrupted(*arguments, **given):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.3)
        raise AssertionError("the main thread has ended by now")

    monkeypatch.setattr(sys.modules["shadowgram.codes._design"], "design", interrupted)
    assert main(f"codes design -o code.nc {SMALL}".split()) == 130
    assert capsys.readouterr().err == "shadowgram: interrupted; no file is half written\n"
    assert names() == []


def test_killed_design_goes_on(folder, capsys):
    command = f"codes design -o code.nc {SMALL} --tolerance 1e-6 --starts 2"
    program = """if True:
        import os, signal
        from shadowgram.cli import code_search, main

        keep, sweeps = code_search.Search._keep, iter(range(5))

        def killed(*arguments):
            keep(*arguments)
            if next(sweeps) == 3:
                os.kill(os.getpid(), signal.SIGKILL)

        code_search.Search._keep = killed
        main()
    """
    done = subprocess.run([sys.executable, "-c", program, *command.split()], check=False)
    assert done.returncode == -signal.SIGKILL
    assert names() == ["code.design.nc"]
    run(capsys, f"{command} --resume")
    resumed = (folder / "code.nc").read_bytes()
    run(capsys, command)
    assert (folder / "code.nc").read_bytes() == resumed


def test_resume_needs_the_same_parameters(folder, capsys, monkeypatch):
    _stop_at_sweep(monkeypatch, 2)
    command = f"codes design -o code.nc {SMALL} --tolerance 0"
    assert main(command.split()) == 2
    assert "No space left" in capsys.readouterr().err
    monkeypatch.undo()
    monkeypatch.chdir(folder)
    assert names() == ["code.design.nc"]
    assert "go on with it, --resume, or delete it" in refuse(capsys, command)
    for options, expected in {
        "--seed 1": "begun with --seed 0, not with --seed 1",
        "--c1 2": "begun without --c1, not with --c1 2.0",
        "--tile 6x12": "begun without --tile, not with --tile 6x12",
        "--exchange": "begun without --exchange, not with --exchange",
        "--starts 2": "begun with --starts 1",
        "--code-pitch 5": "begun for another imager",
    }.items():
        assert expected in refuse(capsys, f"{command} {options} --resume")
    assert "begun with --shots 3, not with --shots 4" in refuse(
        capsys, "codes design -o code.nc --detector-shape 24x24 --bands 4 --shots 4 --tolerance 0 --resume"
    )
    # For who will not go on, it is a code like others.
    sg.scenes.write(sg.scenes.chart(size=24, bands=4, seed=0), "scene.nc")
    run(capsys, "capture scene.nc -o shots.nc --code code.design.nc")
    run(capsys, f"{command} --resume")
    assert "code.design.nc" not in names()


def _stop_at_sweep(monkeypatch, sweep):
    """Let the disk be full when this sweep is to be kept."""
    write, count = atomic._write, iter(range(1000))

    def full(*arguments):
        if next(count) == sweep - 1:
            raise OSError(28, "No space left on device")
        write(*arguments)

    monkeypatch.setattr(atomic, "_write", full)


def test_full_disk_leaves_nothing(folder, capsys, monkeypatch):
    _stop_at_sweep(monkeypatch, 1)
    assert "No space left on device" in refuse(capsys, f"codes design -o code.nc {SMALL}")


def test_analysis_is_that_of_the_library(folder, capsys, imager):
    code = sg.codes.random(shots=3, shape=(24, 24), seed=1, transmittance=0.4)
    np.save("code.npy", code)
    said = read_json(capsys, "codes analyse code.npy --bands 4 --blocks 4 --seed 3 --json")
    assert said["transmittance"] == pytest.approx(code.mean(axis=(1, 2)))
    opened = code.sum(axis=0)
    assert said["open_shots"] == {
        "least": opened.min(), "mean": pytest.approx(opened.mean()), "most": opened.max(),
        "once": pytest.approx((opened == 1).mean()),
    }  # fmt: skip
    for name, spectrum in zip(("x", "y"), aapsd(code, 4), strict=True):
        found = said["spectrum"][name]
        assert found["power"] == pytest.approx(
            [band_power(spectrum, *limits) for limits in ((0, 0.125), (0.125, 0.25), (0.25, 0.5))]
        )
        assert sum(found["power"]) == pytest.approx(1)
        assert sum(found["flat"]) == pytest.approx(1)
        assert found["noise"] == noise_colour(spectrum, elements=code.size)
    assert said["runs"]["mean"] == clusters(code).mean_run
    assert said["runs"]["chance_per_row"] == clusters(code).chance_runs_per_row
    H = imager.operator(code)
    found = said["sensing"]
    voxels = sensing.sensed(H)
    assert found["voxels"] == {name: getattr(voxels, name) for name in ("never", "partly", "once", "repeatedly")}
    groups = sensing.pixel_groups(H.in_shape, count=found["gram_deviation"]["groups"], window=(3, 3), seed=3)
    assert found["gram_deviation"]["mean"] == pytest.approx(sensing.gram_deviation(H, groups).mean())
    few = sensing.isometry(H, basis=sg.operators.basis("dct-sym8", H.in_shape), sparsity=50, trials=20, seed=3)
    assert found["isometry"]["largest"] == pytest.approx(few.lower_bound)
    row = dataclasses.replace(imager, detector_shape=(1, 24)).operator(code[:, 11:12])
    assert found["coherence"]["rms"] == pytest.approx(sensing.coherence(row).rms)
    values = sensing.singular_values(row)
    assert found["singular_values"]["largest"] == pytest.approx(values[0])
    assert found["singular_values"]["zero"] == (values <= 1e-9 * values[0]).sum()


def test_complementary_code_in_words(folder, capsys):
    run(capsys, "codes make --shape 48x48 --shots 4 -o code.nc")
    said = "\n".join(run(capsys, "codes analyse code.nc"))
    assert "25 % of the elements are open in a shot" in said
    assert "every one is open in one shot" in said
    assert said.count("white") == 3
    assert "imager" not in said
    said = "\n".join(run(capsys, "codes analyse code.nc --bands 4"))
    assert "0 % never, 0 % partly, 100 % once, 0 % repeatedly" in said
    assert "imager        SSCSI" in said


def test_gray_and_single_codes(folder, capsys):
    np.save("gray.npy", np.random.default_rng(0).random((32, 32)))
    said = read_json(capsys, "codes analyse gray.npy --json")
    assert said["runs"] is None
    assert said["shape"] == [1, 32, 32]
    assert "runs" not in "\n".join(run(capsys, "codes analyse gray.npy --png gray.png"))
    assert (folder / "gray.png").exists()


def test_rows_that_are_too_large_are_said(folder, capsys, monkeypatch):
    run(capsys, "codes make --shape 24x24 -o code.nc")
    monkeypatch.setattr(sensing, "MOST_COLUMNS", 95)
    monkeypatch.setattr(sensing, "MOST_VALUES", 71)
    said = run(capsys, "codes analyse code.nc --bands 4")
    assert said[-1] == "not computed  coherence and singular values: a detector row is too large"
    sensed = read_json(capsys, "codes analyse code.nc --bands 4 --json")["sensing"]
    assert sensed["coherence"] is sensed["singular_values"] is None


def test_sensing_sheet_shows_what_it_is_given():
    from shadowgram.figures.codes import sensing_sheet
    from shadowgram.figures.style import style

    code = sg.codes.boolean(shots=2, shape=(32, 32), seed=0)
    with style():
        figure = sensing_sheet(code, title="code", likeness=[1, 3, 0, 0], singular_values=[2.0, 1.0, 0.5])
    panels = {axes.get_title(loc="left"): axes for axes in figure.axes}
    np.testing.assert_allclose(panels["Singular values"].lines[0].get_xydata(), [[1, 2], [2, 1], [3, 0.5]])
    likeness = next(axes for title, axes in panels.items() if title.startswith("Likeness"))
    np.testing.assert_allclose(likeness.lines[0].get_xydata()[:2], [[0.125, 0.25], [0.375, 0.75]])


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ("--kind blue --shots 4", lambda: sg.codes.blue_noise(shots=4, shape=(16, 20), seed=0)),
        (
            "--kind blue --shots 2 --transmittance 0.3 --seed 1",
            lambda: sg.codes.blue_noise(shots=2, shape=(16, 20), seed=1, transmittance=0.3),
        ),
        ("--kind green --cluster 6", lambda: sg.codes.green_noise(shots=3, shape=(16, 20), seed=0, cluster=6)),
        ("--kind s-matrix --shots 7", lambda: sg.codes.s_code(shots=7, shape=(16, 20), seed=0)),
        ("--kind hadamard --shots 4", lambda: sg.codes.hadamard_code(shots=4, shape=(16, 20), seed=0)),
        ("--kind random", lambda: sg.codes.random(shots=3, shape=(16, 20), seed=0)),
    ],
)
def test_kinds(folder, capsys, options, expected):
    run(capsys, f"codes make --shape 16x20 -o code.nc {options}")
    assert np.array_equal(read_dataset("code.nc")["code"], expected())


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ("--kind ura --shape 13x11", lambda: sg.codes.ura(13, 11)),
        ("--kind ura --shape 5x7 --mosaic", lambda: sg.codes.mosaic(sg.codes.ura(5, 7))),
        ("--kind mura --shape 11x11", lambda: sg.codes.mura(11)),
        ("--kind mura --shape 1x13", lambda: sg.codes.linear_mura(13)),
    ],
)
def test_patterns_for_correlation_have_one_shot(folder, capsys, options, expected):
    said = read_json(capsys, f"codes make -o code.nc {options} --json")
    assert said["shape"] == [1, *expected().shape]
    assert np.array_equal(read_dataset("code.nc")["code"], expected()[None])


DESIGN = "codes design -o code.nc --detector-shape 16x16"
BAD = {
    "one shot": (f"{DESIGN} --bands 4 --shots 1", "2 shots or more"),
    "no shots": (f"{DESIGN} --bands 4 --shots 0", "2 shots or more"),
    "shots not said": (f"{DESIGN} --bands 4", "--shots"),
    "more shots than elements": (f"{DESIGN} --bands 4 --shots 300", "more than the code has elements"),
    "unknown imager": (f"{DESIGN} --bands 4 --shots 3 --imager hubble", "--imager"),
    "c1 below zero": (f"{DESIGN} --bands 4 --shots 3 --c1 -1", "c1 must be a number from 0 to 1e+100"),
    "repulsion that is none": (f"{DESIGN} --bands 4 --shots 3 --repulsion nan", "repulsion must be a number"),
    "tolerance of 1": (f"{DESIGN} --bands 4 --shots 3 --tolerance 1", "tolerance must lie in [0, 1)"),
    "mask too narrow": (f"{DESIGN} --bands 20 --shots 3", "cannot be resolved with 16 code columns"),
    "mask of a CASSI too narrow": (f"{DESIGN} --bands 20 --shots 3 --imager cassi", "more than its mask has columns"),
    "no bands": (f"{DESIGN} --shots 3", "--mask-position, or what it must resolve, --bands"),
    "bands twice": (f"{DESIGN} --shots 3 --bands 4 --mask-position 0.25", "give one of them"),
    "CASSI without bands": (f"{DESIGN} --shots 3 --imager dual", "how many --bands"),
    "s = 1": (f"{DESIGN} --shots 3 --mask-position 1", "mask_position must lie in [0, 1)"),
    "size in words": ("codes design -o code.nc --shots 3 --bands 4 --detector-shape big", "--detector-shape takes"),
    "CASSI option": (f"{DESIGN} --shots 3 --bands 4 --band-shift 2", "--band-shift belong to the CASSIs"),
    "SSCSI option": (
        f"{DESIGN} --shots 3 --bands 4 --imager cassi --code-pitch 5",
        "--code-pitch belong to the imager",
    ),
    "shear of another": (f"{DESIGN} --shots 3 --bands 4 --imager cassi --shear edge", "shear must be one of"),
    "bench and geometry": (f"{DESIGN} --shots 3 --bench salazar2022", "a bench has its own geometry"),
    "bench that is none": ("codes design -o code.nc --shots 3 --bench nowhere.toml", "nowhere.toml"),
    "bench out of reach": ("codes design -o c.nc --shots 3 --bench salazar2022 --mask-position 0.9", "beyond what"),
    "tile in words": (f"{DESIGN} --shots 3 --bands 4 --tile small", "--tile takes"),
    "tile beyond the mask": (f"{DESIGN} --shots 3 --bands 4 --tile 8x32", "at most those of the mask"),
    "tile too narrow": (f"{DESIGN} --shots 3 --bands 4 --tile 8x3", "columns wide"),
    "tile of a colored code": (f"{DESIGN} --shots 3 --bands 4 --imager colored --tile 8x8", "leave the tile out"),
    "too little light": (f"{DESIGN} --shots 3 --bands 4 --transmittance 0.1", "must lie between 1/3"),
    "light of a colored code": (
        f"{DESIGN} --shots 3 --bands 4 --imager colored --transmittance 0.5",
        "leave the transmittance out",
    ),
    "coupling and light": (f"{DESIGN} --shots 3 --bands 4 --transmittance 0.5 --coupling 1", "coupling is for codes"),
    "exchange and light": (f"{DESIGN} --shots 3 --bands 4 --transmittance 0.5 --exchange", "--exchange is for codes"),
    "exchange of colors": (f"{DESIGN} --shots 3 --bands 4 --imager colored --exchange", "--exchange is for codes"),
    "no starts": (f"{DESIGN} --shots 3 --bands 4 --starts 0", "--starts"),
    "design in an array file": ("codes design -o code.npy --shots 3 --bands 4", "must end in .nc"),
    "design in no folder": ("codes design -o no/code.nc --shots 3 --bands 4", "there is no folder no"),
    "design over settings": ("codes design -o mine.nc --shots 3 --bands 4", "mine.json"),
    "picture of another kind": (f"{DESIGN} --shots 3 --bands 4 --png code.pdf", "must end in .png"),
    "resume without a design": (f"{DESIGN} --shots 3 --bands 4 --resume", "no unfinished design code.design.nc"),
    "resume of another file": ("codes design -o other.nc --shots 3 --bands 4 --resume", "is not an unfinished design"),
    "other file in the way": ("codes design -o other.nc --shots 3 --bands 4", "is another file"),
    "damaged design": ("codes design -o cut.nc --shots 3 --bands 4 --resume", "cut.design.nc"),
    "no code": ("codes analyse missing.nc", "missing.nc"),
    "cube for a code": ("codes analyse scene.nc", "holds no code"),
    "code in an unknown format": ("codes analyse mine.json", "a code is read from"),
    "code of one axis": ("codes analyse line.npy", "must hold a code (shot, y, x)"),
    "code with NaN": ("codes analyse nan.npy", "transmittance must lie in [0, 1]"),
    "code of one value": ("codes analyse open.npy", "the same everywhere"),
    "blocks that are no square": ("codes analyse small.nc --blocks 5", "blocks must be a square number"),
    "blocks too small": ("codes analyse small.nc --blocks 64", "use fewer blocks"),
    "code that does not fit": ("codes analyse small.nc --bands 4 --detector-shape 16x16", "got (3, 12, 12)"),
    "code of another pitch": ("codes analyse small.nc --bands 4 --code-pitch 2", "got (3, 12, 12)"),
    "colored code for one mask": ("codes analyse colored.nc --bands 4", "got (2, 4, 12, 12)"),
    "code for a colored imager": ("codes analyse small.nc --imager colored --bands 4", "got (3, 12, 12)"),
    "imager without bands": ("codes analyse small.nc --imager sscsi", "say where the mask stands"),
    "too many bands": ("codes analyse small.nc --bands 13", "cannot be resolved"),
    "analysis over the code": ("codes analyse shot.png --png shot.png", "is the input"),
    "cluster of a boolean code": ("codes make --shape 8x8 -o c.nc --cluster 3", "--cluster is not for boolean codes"),
    "mosaic of a random code": ("codes make --shape 8x8 -o c.nc --kind random --mosaic", "--mosaic is not for"),
    "light of a boolean code": ("codes make --shape 8x8 -o c.nc --transmittance 0.3", "--transmittance is not for"),
    "shots of a URA": ("codes make --shape 5x3 -o c.nc --kind ura --shots 2", "--shots is not for ura codes"),
    "URA of another size": ("codes make --shape 8x8 -o c.nc --kind ura", "twin primes"),
    "MURA that is not square": ("codes make --shape 5x7 -o c.nc --kind mura", "p x p or 1 x p"),
    "no S-matrix": ("codes make --shape 8x8 -o c.nc --kind s-matrix --shots 4", "use 3 or 7"),
    "no Hadamard matrix": ("codes make --shape 8x8 -o c.nc --kind hadamard", "use 2 or 4"),
    "clusters of one": ("codes make --shape 8x8 -o c.nc --kind green --cluster 1", "use blue_noise"),
}


@pytest.fixture(scope="module")
def bad_inputs(tmp_path_factory):
    """A folder of good and bad files, which no command of the table changes."""
    folder = tmp_path_factory.mktemp("bad")
    with contextlib.chdir(folder):
        assert main(["codes", "make", "--shape", "12x12", "-o", "small.nc"]) == 0
        colored = "--shape 12x12 --kind four --bands 4 --shots 2 -o colored.nc"
        assert main(["codes", "make", *colored.split()]) == 0
        assert main(["codes", "make", "--shape", "12x12", "--shots", "1", "-o", "shot.png"]) == 0
    shutil.copy(folder / "small.nc", folder / "other.design.nc")
    (folder / "cut.design.nc").write_bytes((folder / "small.nc").read_bytes()[:-100])
    sg.scenes.write(sg.scenes.chart(size=16, bands=4, seed=0), folder / "scene.nc")
    np.save(folder / "line.npy", np.ones(8))
    np.save(folder / "nan.npy", np.full((1, 8, 8), np.nan))
    np.save(folder / "open.npy", np.ones((1, 16, 16)))
    (folder / "mine.json").write_text('{"important": true}')
    return folder


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_in_one_line(bad_inputs, monkeypatch, capsys, case):
    monkeypatch.chdir(bad_inputs)
    command, expected = BAD[case]
    assert expected in refuse(capsys, command)
