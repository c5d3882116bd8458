"""`shadowgram resolution`: geometry or a bench, a position or a band width; one line for whatever is wrong with them."""

import json
from pathlib import Path

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.cli import main
from shadowgram.figures.resolution import over_position
from shadowgram.spectral.bench import read_bench

GEOMETRY = "--wavelengths 450:650 --detector-shape 64x64"
BENCH = """
grating_lines = 300.0
relay_focal_lengths = [75.0, 75.0]
wavelengths = [480.0, 620.0]
detector_shape = [64, 64]
detector_pitch = 9.9
code_pitch = 19.4
measured_ratio = 3.0
mask_distances = [1.0, 10.0]
f_number = 100.0
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(BENCH)
    (tmp_path / "typo.toml").write_text(BENCH.replace("code_pitch", "codepitch"))
    (tmp_path / "text.toml").write_text(BENCH.replace("300.0", "'many'"))
    (tmp_path / "words.toml").write_text("a bench with 300 lines")
    return tmp_path


def run(capsys, options):
    assert main(["resolution", *options.split()]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    return said.out


def read_json(capsys, options):
    return json.loads(run(capsys, f"{options} --json"))


def test_position_to_band_width_and_back(capsys):
    said = read_json(capsys, f"--mask-position 0.125 {GEOMETRY}")
    assert (said["band_width"], said["bands"], said["mask_position"]) == (25.0, 8, 0.125)
    assert said["spectral_extents"] == pytest.approx([21.875, 3.125])
    back = read_json(capsys, f"--band-width 25 {GEOMETRY}")
    assert back == said
    assert "distance" not in said
    imager = sg.SSCSI(**said["imager"])
    assert imager.resolution.band_edges == pytest.approx(said["band_edges"])
    assert imager.resolution.wavelengths == pytest.approx(said["wavelengths"])
    assert imager.resolution.throughput == pytest.approx(said["throughput"])


def test_what_is_infinite_is_null(capsys):
    assert read_json(capsys, f"--mask-position 0 {GEOMETRY}")["spectral_extents"] == [None, None]
    assert read_json(capsys, "--bench salazar2022")["bench"]["f_number"] is None


def test_every_key_is_in_the_help(capsys):
    assert main(["resolution", "--help"]) == 0
    text = capsys.readouterr().out
    said = read_json(capsys, "--bench mine.toml")
    derived = set(said["bench"]) - set(read_bench("mine.toml").__dataclass_fields__)
    names = {name for name in set(said) | derived if name not in text}
    assert names == {"first_wavelength"}  # the first of band_edges


def test_a_bench_and_a_band_width_give_the_place_of_the_mask(capsys):
    said = read_json(capsys, "--bench salazar2022 --band-width 22")
    bench = read_bench("salazar2022")
    assert said["band_width"] == pytest.approx(22)
    assert said["mask_position"] == pytest.approx(140 / (256 * 3 * 22))
    assert said["distance"] == pytest.approx(bench.plane_distance * said["mask_position"])
    assert said["bench"]["dispersion_ratio"] == 3
    assert said["bench"]["dispersion"] == pytest.approx(106.42, abs=0.01)
    assert said["bench"]["reachable"] == pytest.approx(bench.reachable)
    assert said["reach"][0]["distance"] == 0
    assert said["reach"][-1]["distance"] == pytest.approx(10)
    assert said["reach"][-1]["bands"] == 22


def test_without_a_position_a_bench_stands_as_far_as_it_reaches(capsys):
    said = read_json(capsys, "--bench mine.toml")
    assert said["mask_position"] == pytest.approx(read_bench("mine.toml").reachable[1])
    assert said["bench"]["blur"] == pytest.approx(100)  # 10 mm / 100


def test_people_read_it_in_lines(capsys):
    lines = run(capsys, f"--band-width 25 {GEOMETRY}").splitlines()
    assert lines[0].split() == ["mask", "s", "=", "0.125"]
    assert [line.split()[0] for line in lines[1:]] == ["regime", "datacube", "bands", "pitch", "throughput", "code"]
    text = run(capsys, "--bench mine.toml --mask-position 0.05")
    assert "mm from the image plane" in text
    assert "f/100 keeps apart 32.87 nm wherever the mask stands" in text
    rows = text.split("throughput\n")[-1].splitlines()
    assert len(rows) == 9
    assert [float(row.split()[1]) for row in rows] == pytest.approx(np.linspace(1, 10, 9), abs=1e-3)
    assert "taken for a pinhole" in run(capsys, "--bench salazar2022")


@pytest.mark.parametrize("options", [f"--mask-position 0.125 {GEOMETRY}", "--bench mine.toml --band-width 40"])
def test_picture(folder, capsys, options):
    run(capsys, f"{options} --png s.png")
    assert (folder / "s.png").read_bytes().startswith(b"\x89PNG")


def test_the_figure_has_curves_the_position_and_the_limits_of_the_bench():
    bench = read_bench("mine.toml")
    s = 0.06
    figure = over_position(bench.imager(s), 0.2, bench=bench)
    width, bands, pitch, light = figure.axes[:4]
    assert width.get_yscale() == "log"
    for axes in (width, bands, pitch, light):
        assert any(list(line.get_xdata()) == [s] for line in axes.lines)
        shaded = axes.patches[0].get_extents().transformed(axes.transData.inverted())
        assert (shaded.x0, shaded.x1) == pytest.approx(bench.reachable)
    pupil = next(line for line in width.lines if "pupil f/100" in str(line.get_label()))
    assert pupil.get_ydata()[0] == pytest.approx(bench.pupil_band_width)
    found = bench.imager(s).resolution
    x, y = width.lines[0].get_data()
    assert np.interp(s, x, y) == pytest.approx(found.band_width, rel=1e-3)
    x, y = bands.lines[0].get_data()
    assert y[np.searchsorted(x, s)] == found.bands
    assert light.lines[0].get_ydata()[-1] > light.lines[1].get_ydata()[-1]


def test_the_figure_of_a_camera_says_both_regimes():
    imager = sg.SSCSI(
        detector_shape=(32, 32), detector_pitch=20, code_pitch=10, mask_position=0.3, wavelengths=(450, 650)
    )
    pitch = over_position(imager, 0.95).axes[2]
    assert {"super-resolving", "detector-limited"} <= {text.get_text() for text in pitch.texts}
    x, y = pitch.lines[0].get_data()
    assert np.interp(0.25, x, y) == pytest.approx(10 / 0.75, rel=1e-2)
    assert y[-1] == 20


BAD = {
    "nothing": ("", "--wavelengths"),
    "no wavelengths": ("--mask-position 0.1", "--wavelengths"),
    "neither position nor width": (GEOMETRY, "--mask-position, or what it must resolve, --band-width"),
    "position and width": (f"--mask-position 0.1 --band-width 20 {GEOMETRY}", "give one of them"),
    "position and width on a bench": ("--bench mine.toml --mask-position 0.1 --band-width 20", "give one of them"),
    "bench and geometry": (
        f"--bench mine.toml {GEOMETRY}",
        "leave out --wavelengths, --detector-shape, or --bench",
    ),
    "bench and pitch": ("--bench mine.toml --detector-pitch 10", "leave out --detector-pitch"),
    "bench and code": ("--bench mine.toml --code-pitch 10", "leave out --code-pitch"),
    "bench and ratio": ("--bench mine.toml --dispersion-ratio 1", "leave out --dispersion-ratio"),
    "beyond the reach": ("--bench salazar2022 --mask-position 0.1", "beyond what the bench reaches"),
    "before the reach": ("--bench mine.toml --mask-position 0", "beyond what the bench reaches"),
    "too narrow for the bench": ("--bench salazar2022 --band-width 2", "its finest bands are 6.377 nm wide"),
    "too wide for the bench": ("--bench salazar2022 --band-width 141", "wider than all the wavelengths"),
    "too wide for the mount": ("--bench mine.toml --band-width 100", "its widest bands are 63.77 nm wide"),
    "too narrow": (f"--band-width 3 {GEOMETRY}", "they stay wider than 3.125 nm"),
    "too wide": (f"--band-width 300 {GEOMETRY}", "wider than all the wavelengths, 450 to 650 nm"),
    "no width": (f"--band-width 0 {GEOMETRY}", "positive number of nm"),
    "width in words": (f"--band-width wide {GEOMETRY}", "--band-width"),
    "s = 1": (f"--mask-position 1 {GEOMETRY}", "mask_position must lie in [0, 1)"),
    "s = nan": ("--bench mine.toml --mask-position nan", "beyond what the bench reaches"),
    "unknown key": ("--bench typo.toml", "unknown key 'codepitch'"),
    "missing key": ("--bench typo.toml", "the key 'code_pitch' is missing"),
    "text for a number": ("--bench text.toml", "grating_lines should be a valid number, got 'many'"),
    "not TOML": ("--bench words.toml", "words.toml is not TOML"),
    "no such bench": ("--bench hubble", "benches that come with shadowgram are salazar2022"),
    "a folder": ("--bench .", "."),
    "picture of another kind": ("--bench mine.toml --png s.jpg", "must end in .png"),
    "picture in no folder": ("--bench mine.toml --png nowhere/s.png", "there is no folder nowhere"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line(capsys, case):
    options, says = BAD[case]
    before = sorted(Path.cwd().iterdir())
    assert main(["resolution", *options.split()]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("shadowgram: ")
    assert said.err.count("\n") == 1
    assert says in said.err
    assert sorted(Path.cwd().iterdir()) == before
