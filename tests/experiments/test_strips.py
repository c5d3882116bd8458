"""Reconstruction by strips: the same operator, no seam, bounded memory, and nothing lost."""

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import shadowgram as sg
from shadowgram.cli import output
from shadowgram.cli.recovery_strips import reconstruct_in_strips
from shadowgram.experiments import _strips_plan as planning
from shadowgram.experiments import strips
from shadowgram.experiments._strips_blend import Pieces
from shadowgram.experiments._strips_plan import Strip
from shadowgram.experiments._strips_rows import Header, cut, read_header, read_rows, row_ratio
from shadowgram.experiments._strips_work import NoiseSpec, estimate_noise, piece_path
from shadowgram.experiments.source import generated
from shadowgram.experiments.strips import capture_by_rows, reconstruct_strips
from shadowgram.measurement import AWGN, Measurement, capture, read_measurement, write_measurement

W = (450.0, 650.0)
CURVE = ((450.0, 0.0), (550.0, 4.0), (650.0, 6.5))
GEOMETRY = {"detector_pitch": 20.0, "wavelengths": W}
IMAGERS = {
    "CASSI": sg.CASSI(cube_shape=(5, 30, 21), wavelengths=W),
    "CASSI exact": sg.CASSI(cube_shape=(5, 30, 21), wavelengths=W, band_shift=1.3, shear="exact"),
    "CASSI curve": sg.CASSI(cube_shape=(5, 30, 21), wavelengths=W, dispersion=CURVE),
    "CASSI uneven": sg.CASSI(cube_shape=(4, 30, 21), band_centres=(450, 470, 500, 550), band_shift=2),
    "DualCASSI": sg.DualCASSI(cube_shape=(5, 30, 21), wavelengths=W),
    "DualCASSI exact": sg.DualCASSI(cube_shape=(5, 30, 21), wavelengths=W, shear="exact"),
    "ColoredCASSI": sg.ColoredCASSI(cube_shape=(5, 30, 21), wavelengths=W),
    "ColoredCASSI exact": sg.ColoredCASSI(cube_shape=(5, 30, 21), wavelengths=W, shear="exact"),
    "Calibrated": sg.spectral.CalibratedImager(cube_shape=(3, 30, 21), band_centres=(480.0, 550.0, 620.0), pitch=9.9),
    **{
        f"SSCSI {shear}": sg.SSCSI(
            detector_shape=(30, 24), code_pitch=20.0, mask_position=0.25, shear=shear, dispersion_ratio=1.2, **GEOMETRY
        )
        for shear in ("exact", "centre", "edge")
    },
    "SSCSI own bands": sg.SSCSI(detector_shape=(30, 24), code_pitch=20.0, mask_position=0.25, bands=4, **GEOMETRY),
    "SSCSI super-resolving": sg.SSCSI(detector_shape=(30, 16), code_pitch=10.0, mask_position=0.2, **GEOMETRY),
    "SSCSI ratio, limited": sg.SSCSI(detector_shape=(30, 16), code_pitch=10.0, mask_position=0.6, **GEOMETRY),
}


def a_measurement(imager, shots=2, gray=False, noise=None):
    """Of random light, so that no row is like another."""
    random = np.random.default_rng(0)
    code = random.random((shots, *imager.code_shape), np.float32)
    code = code if gray else (code > 0.5).astype(np.uint8)
    cube = random.random(imager.resolution.cube_shape, np.float32)
    return capture(imager, code, cube, noise=noise), cube


@pytest.mark.parametrize("gray", [False, True])
@pytest.mark.parametrize("name", IMAGERS)
def test_operator_of_rows_is_the_rows_of_the_operator(name, gray, tmp_path):
    whole, cube = a_measurement(IMAGERS[name], gray=gray)
    ratio = row_ratio(whole.imager)
    back = whole.operator.adjoint(whole.snapshots)
    write_measurement(whole, tmp_path / "shots.nc")
    for ranges in ([(0, 1)], [(7, 19)], [(0, 4), (13, 14), (25, 30)]):
        strip = cut(whole, ranges)
        seen = np.concatenate([whole.snapshots[:, a:b] for a, b in ranges], axis=1)
        part = np.concatenate([cube[:, ratio * a : ratio * b] for a, b in ranges], axis=1)
        assert np.array_equal(strip.operator.forward(part), seen)
        assert np.array_equal(
            strip.operator.adjoint(seen),
            np.concatenate([back[:, ratio * a : ratio * b] for a, b in ranges], axis=1),
        )
        read = read_rows(tmp_path / "shots.nc", read_header(tmp_path / "shots.nc"), ranges)
        assert read.imager == strip.imager
        assert np.array_equal(read.code, strip.code)
        assert np.array_equal(read.snapshots, strip.snapshots)


def test_capture_by_rows_is_the_capture():
    imager = IMAGERS["SSCSI super-resolving"]
    whole, cube = a_measurement(imager, noise=AWGN(snr_db=30, seed=3))
    found = capture_by_rows(imager, whole.code, lambda a, b: cube[:, a:b], step=7, noise=whole.noise)
    assert np.array_equal(found.snapshots, whole.snapshots)


def test_other_imagers_are_refused():
    with pytest.raises(TypeError, match="strips of rows are known for SSCSI"):
        cut(replace_imager(a_measurement(IMAGERS["CASSI"])[0], object()), [(0, 1)])


def replace_imager(measurement, imager):
    """A measurement with something else for an imager, behind the back of its checks."""
    other = object.__new__(Measurement)
    other.__dict__.update(measurement.__dict__, imager=imager)
    return other


@pytest.mark.parametrize(
    ("rows", "size", "halo"), [(100, 33, 8), (7, 3, 2), (64, 64, 16), (65, 64, 16), (4096, 448, 16)]
)
def test_strips_cover_every_row_once(rows, size, halo):
    found = planning.strips(rows, size, halo)
    assert [row for strip in found for row in range(strip.start, strip.stop)] == list(range(rows))
    assert all(strip.stop - strip.start <= size for strip in found)
    assert all(strip.start - strip.first == min(halo, strip.start) for strip in found)
    assert all(strip.last - strip.stop == min(halo, rows - strip.stop) for strip in found)


LARGE = {
    "detector_shape": (64, 160),
    "detector_pitch": 10.0,
    "code_pitch": 10.0,
    "mask_position": 0.075,
    "wavelengths": W,
}
LARGE_IMAGERS = {
    "CASSI": sg.CASSI(cube_shape=(12, 64, 160), wavelengths=W),
    "CASSI exact": sg.CASSI(cube_shape=(12, 64, 160), wavelengths=W, shear="exact"),
    "DualCASSI": sg.DualCASSI(cube_shape=(12, 64, 160), wavelengths=W),
    "ColoredCASSI": sg.ColoredCASSI(cube_shape=(12, 64, 160), wavelengths=W),
    "SSCSI": sg.SSCSI(**LARGE),
    "SSCSI own bands": sg.SSCSI(**LARGE, bands=10),
    "SSCSI super-resolving": sg.SSCSI(**{**LARGE, "detector_shape": (32, 80), "detector_pitch": 20.0}),
}


@pytest.mark.parametrize("shots", [1, 4])
@pytest.mark.parametrize("name", LARGE_IMAGERS)
def test_memory_is_not_more_than_said(name, shots):
    imager = LARGE_IMAGERS[name]
    taken, _ = a_measurement(imager, shots=shots)
    sg.solve(sg.EigenTV(max_iter=7), taken.operator, taken.snapshots)  # compile
    tracemalloc.start()
    sg.solve(sg.EigenTV(max_iter=7), imager.operator(taken.code), taken.snapshots)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    header = Header(imager=imager, shots=shots, scene="", double=False, code_bytes=1)
    said = planning.memory(header, taken.snapshots.shape[1])
    assert 0.6 * said < peak + taken.code.nbytes < said


def test_rows_by_memory():
    header = Header(
        imager=sg.CASSI(cube_shape=(48, 4096, 4096), wavelengths=W), shots=2, scene="", double=False, code_bytes=1
    )
    for processes in (0, 1, 2, 3):
        rows = planning.choose_rows(header, 16, 6e9, processes)
        planning.check_rows(header, rows, 16, 6e9, processes)
        assert planning.needed_limit(planning.memory(header, rows + 32), processes) <= 6e9
        with pytest.raises(ValueError, match=r"strips of \d+ rows need 6[.0-9]* GB in .*the limit is 6 GB"):
            planning.check_rows(header, rows + 20, 16, 6e9, processes)
    with pytest.raises(
        ValueError, match=r"the smallest strips, of 32 rows and a halo of 16 on each side, need 1\.1 GB"
    ):
        planning.choose_rows(header, 16, 1e9, 1)
    with pytest.raises(ValueError, match="at least 32 of their own, got 31"):
        planning.check_rows(header, 31, 16, 6e9, 0)
    small = replace(header, imager=replace(header.imager, cube_shape=(48, 256, 256)))
    assert planning.choose_rows(small, 16, 6e9, 0) == 256


@pytest.mark.parametrize("ratio", [1, 2])
def test_blended_rows(tmp_path, ratio):
    cube = np.random.default_rng(0).random((2, 100 * ratio, 3), np.float32)
    found = planning.strips(100, 40, 6)
    pieces = Pieces(folder=tmp_path, strips=found, ratio=ratio, bands=2, columns=3)
    for i, strip in enumerate(found):
        part = np.ascontiguousarray(cube[:, ratio * strip.first : ratio * strip.last]) + np.float32(i)
        piece_path(tmp_path, strip).write_bytes(part.tobytes())
    whole = pieces.rows(0, 100 * ratio)
    assert np.array_equal(np.concatenate([pieces.rows(a, a + 5) for a in range(0, 100 * ratio, 5)], axis=1), whole)
    share = (whole - cube).mean(axis=(0, 2))  # 0 in the first strip, then 1, then 2
    assert np.all(np.diff(share) > -1e-6)
    first, second = found[0], found[1]
    assert share[ratio * second.first - 1] == pytest.approx(0, abs=1e-6)
    assert share[ratio * first.last] == pytest.approx(1, abs=1e-6)
    assert share[ratio * first.stop - 1 : ratio * first.stop + 1].mean() == pytest.approx(0.5, abs=1e-6)
    assert np.abs(np.diff(share)).max() < 1.7 / (12 * ratio)  # no jump: a smooth passage over twice the halo
    assert np.array_equal(whole[:, :10], cube[:, :10])


def test_a_file_of_a_strip_that_is_cut(tmp_path):
    strip = Strip(first=0, start=0, stop=4, last=4)
    piece_path(tmp_path, strip).write_bytes(bytes(40))
    with pytest.raises(ValueError, match="is cut; run again"):
        Pieces(folder=tmp_path, strips=[strip], ratio=1, bands=2, columns=3).rows(0, 4)


SOLVER = sg.EigenTV(max_iter=25)


@pytest.fixture(scope="module")
def shots(tmp_path_factory):
    """File of a noisy measurement of 96 rows."""
    path = tmp_path_factory.mktemp("strips") / "shots.nc"
    truth = sg.scenes.chart(size=(96, 64), bands=6, seed=1, wavelengths=W)
    imager = sg.CASSI(cube_shape=truth.shape, wavelengths=W)
    code = sg.codes.boolean(shots=3, shape=imager.code_shape, seed=0)
    write_measurement(capture(imager, code, truth, noise=AWGN(snr_db=30, seed=0), scene="chart"), path)
    return path


@pytest.fixture(scope="module")
def undisturbed(shots):
    """Cube of strips, as one run makes it."""
    out = shots.with_name("undisturbed.nc")
    reconstruct_strips(shots, out, SOLVER, rows=24, halo=8, configuration="{}")
    return out.read_bytes()


def test_one_strip_is_the_whole_reconstruction(shots, tmp_path):
    report = reconstruct_strips(shots, tmp_path / "cube.nc", SOLVER)
    taken = read_measurement(shots)
    cube = sg.scenes.read(tmp_path / "cube.nc")
    assert (report.strips, report.noise) == (1, None)
    assert np.array_equal(cube.values, sg.solve(SOLVER, taken.operator, taken.snapshots).x)
    assert np.allclose(cube.wavelength, taken.imager.resolution.wavelengths)
    assert cube.name == "chart"


def test_no_seam(shots, undisturbed, tmp_path):
    truth = sg.scenes.chart(size=(96, 64), bands=6, seed=1, wavelengths=W).values
    (tmp_path / "strips.nc").write_bytes(undisturbed)
    parts = sg.scenes.read(tmp_path / "strips.nc")
    taken = read_rows(shots, read_header(shots), [(0, 96)])
    whole = sg.solve(replace(SOLVER, noise=parts.noise), taken.operator, taken.snapshots).x
    assert sg.metrics.psnr(parts.values, truth, peak=1.0) > sg.metrics.psnr(whole, truth, peak=1.0) - 0.1
    steps = np.sqrt(
        np.square(np.diff(parts.values - whole, axis=1)).mean(axis=(0, 2))
    )  # of the difference, from row to row
    # A scene edge lies at row 72. Without a halo this is 4.6 times the median.
    assert np.median(steps[[23, 47, 71]]) < 1.5 * np.median(steps)
    near = np.zeros(96, bool)
    for edge in (24, 48, 72):
        near[edge - 8 : edge + 8] = True
    of_parts, of_whole = (np.sqrt(np.square(x - truth)[:, near].mean()) for x in (parts.values, whole))
    assert of_parts < 1.03 * of_whole
    assert dict(parts.attrs) == {"configuration": "{}", "strip_rows": 24, "strip_halo": 8, "noise": parts.noise}


@pytest.mark.parametrize("name", ["CASSI", "CASSI exact", "SSCSI"])
def test_the_noise_of_the_sample(name, tmp_path):
    imager = LARGE_IMAGERS[name]
    taken, _ = a_measurement(imager, noise=AWGN(snr_db=20, seed=1))
    write_measurement(taken, tmp_path / "shots.nc")
    solver = sg.EigenTV(max_iter=40)
    spec = NoiseSpec(ranges=((0, 64),), solver=solver, version="")
    noise = estimate_noise(spec, generated(), source=tmp_path / "shots.nc", count=1).values["noise"]
    by_itself = sg.solve(solver, taken.operator, taken.snapshots).history["lambda"][-1]
    told = sg.solve(replace(solver, noise=noise), taken.operator, taken.snapshots).history["lambda"][-1]
    assert told == pytest.approx(by_itself, rel=0.02)


KILLED = """
import os, signal, sys
import shadowgram as sg
from shadowgram.experiments.strips import reconstruct_strips
def progress(state):
    if state.done >= 2:
        os.kill(os.getpid(), signal.SIGKILL)
if __name__ == "__main__":
    spec = sg.EigenTV(max_iter=25)
    reconstruct_strips(sys.argv[1], sys.argv[2], spec, rows=24, halo=8, configuration="{}", progress=progress)
"""


@pytest.fixture(scope="module")
def killed(shots):
    """Folder that a killed process left, beside a cube that was never written."""
    out = shots.with_name("killed.nc")
    done = subprocess.run([sys.executable, "-c", KILLED, str(shots), str(out)], check=False)
    assert done.returncode == -signal.SIGKILL
    assert not out.exists()
    return out.with_name("killed.nc.strips")


def left(killed, out):
    """A copy of what the killed process left, for another cube."""
    return Path(shutil.copytree(killed, out.with_name(out.name + ".strips")))


def test_a_killed_run_goes_on_to_the_same_bytes(shots, killed, undisturbed, tmp_path):
    out = tmp_path / "cube.nc"
    folder = left(killed, out)
    report = reconstruct_strips(shots, out, SOLVER, halo=8, configuration="{}")  # the rows are those of the killed run
    assert (report.strips, report.reused, report.computed) == (4, 2, 2)
    assert out.read_bytes() == undisturbed
    assert not folder.exists()


def test_a_damaged_strip_is_computed_again(shots, killed, undisturbed, tmp_path):
    out = tmp_path / "cube.nc"
    one, two = sorted(left(killed, out).glob("*.f32"))
    one.unlink()
    damaged = bytearray(two.read_bytes())
    damaged[1000] ^= 1
    two.write_bytes(damaged)
    assert reconstruct_strips(shots, out, SOLVER, halo=8, configuration="{}").computed == 4
    assert out.read_bytes() == undisturbed


def test_worker_processes_make_the_same_bytes(shots, killed, undisturbed, tmp_path):
    out = tmp_path / "cube.nc"
    left(killed, out)
    report = reconstruct_strips(shots, out, SOLVER, halo=8, workers=2, configuration="{}")
    assert (report.computed, report.reused) == (2, 2)
    assert out.read_bytes() == undisturbed


def test_an_interrupt_keeps_what_is_finished(shots, undisturbed, tmp_path):
    sent = []

    def interrupt(state):
        if state.done == 1 and not sent:
            sent.append(os.kill(os.getpid(), signal.SIGINT))

    out = tmp_path / "cube.nc"
    report = reconstruct_strips(shots, out, SOLVER, rows=24, halo=8, configuration="{}", progress=interrupt)
    assert report.interrupted
    assert not out.exists()
    assert reconstruct_strips(shots, out, SOLVER, halo=8, configuration="{}").reused >= 1
    assert out.read_bytes() == undisturbed


def test_work_on_something_else_is_not_touched(shots, killed, tmp_path):
    out = tmp_path / "cube.nc"
    folder = left(killed, out)
    for other, name in (
        ({"spec": sg.EigenTV(max_iter=24), "halo": 8}, "solver"),
        ({"spec": SOLVER, "halo": 4}, "halo"),
        ({"spec": SOLVER, "halo": 8, "rows": 30}, "rows"),
    ):
        with pytest.raises(ValueError, match=f"the beginning of a reconstruction with another {name}"):
            reconstruct_strips(shots, out, **other)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(OSError, match="another process is reconstructing into"):
            reconstruct_strips(shots, out, SOLVER, halo=8)
    assert len(list(folder.glob("*.f32"))) == 2


def test_what_is_asked_wrongly_leaves_nothing(shots, tmp_path, monkeypatch):
    out = tmp_path / "cube.nc"
    for wrong, error, message in (
        ({"spec": sg.GPSR(tau=1e-3)}, TypeError, "strips take EigenTV"),
        ({"halo": -1}, ValueError, "halo is a number of rows"),
        ({"memory_limit": 0}, ValueError, "memory_limit is a number of bytes"),
        ({"rows": 20}, ValueError, "at least 32 of their own, got 20"),
        ({"rows": 0}, ValueError, "rows is the number of rows of a strip"),
        ({"memory_limit": 3.51e8}, ValueError, "the smallest strips"),
        ({"workers": -2}, ValueError, "workers"),
    ):
        with pytest.raises(error, match=message):
            reconstruct_strips(shots, out, **wrong)
    with pytest.raises(ValueError, match=r"ends in \.nc"):
        reconstruct_strips(shots, tmp_path / "cube.mat")
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        reconstruct_strips(shots, tmp_path / "nowhere" / "cube.nc")
    sg.scenes.write(sg.scenes.chart(size=16, bands=3, seed=0), tmp_path / "scene.nc")
    with pytest.raises(ValueError, match="is not a measurement"):
        reconstruct_strips(tmp_path / "scene.nc", out)
    assert [path.name for path in tmp_path.iterdir()] == ["scene.nc"]
    monkeypatch.setattr(strips.shutil, "disk_usage", lambda _path: shutil._ntuple_diskusage(1, 1, 1))
    with pytest.raises(OSError, match="make room, or write to another disk"):
        reconstruct_strips(shots, out, sg.EigenTV(max_iter=1, noise=0.01), rows=32)


def a_command(**options):
    """The command line, as far as strips need it."""
    app = typer.Typer()

    @app.command()
    def reconstruct(context: typer.Context, shots: Path, out: Path) -> None:
        given = {"strips": "24", "memory": 6.0, "workers": None, "cluster": None, "threads": 1, "as_json": True}
        reconstruct_in_strips(context, shots, out, sg.EigenTV(max_iter=3), **(given | options))

    return app


def test_command(shots, tmp_path):
    done = CliRunner().invoke(a_command(strips="32"), [str(shots), str(tmp_path / "cube.nc")], catch_exceptions=False)
    printed = json.loads(done.stdout)
    settings = json.loads((tmp_path / "cube.json").read_text())
    assert (printed["strips"], printed["rows"], printed["computed"]) == (3, 32, 3)
    assert settings["strips"] == printed
    assert settings["solver"]["max_iter"] == 3
    kept = json.loads(sg.scenes.read(tmp_path / "cube.nc").configuration)
    assert kept == {name: value for name, value in settings.items() if name != "strips"}
    auto = CliRunner().invoke(a_command(strips="auto", as_json=False), [str(shots), str(tmp_path / "auto.nc")])
    assert auto.stdout.startswith("in one piece\n0 of 1 converged")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"strips": "many"}, "--strips takes a number of detector rows"),
        ({"memory": 0.0}, "--memory is a number of GB"),
        ({"workers": 1, "cluster": "tcp://127.0.0.1:1"}, "not both"),
    ],
)
def test_command_says_what_is_wrong(shots, tmp_path, options, message):
    with pytest.raises(ValueError, match=message):
        CliRunner().invoke(a_command(**options), [str(shots), str(tmp_path / "cube.nc")], catch_exceptions=False)


def test_interrupted_command(shots, tmp_path, monkeypatch):
    def interrupted(*given, **options):
        report = reconstruct_strips(*given, **options)
        return replace(report, interrupted=True)

    monkeypatch.setattr(strips, "reconstruct_strips", interrupted)
    with pytest.raises(output.Interrupted, match=r"3 of 3 strips are in .*the same command goes on"):
        CliRunner().invoke(a_command(strips="32"), [str(shots), str(tmp_path / "cube.nc")], catch_exceptions=False)
