"""Spectra: what they amount to, files good and hostile, tubes and their cache."""

import json
import math
import sys

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from shadowgram.cli import xray_materials
from shadowgram.xray import _tubes
from shadowgram.xray.materials import material
from shadowgram.xray.spectra import Spectrum, format_spectrum, mono, read_spectrum, shipped_tube, tube

ALUMINUM = material("aluminum")


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache, whose folder for spectra does not exist yet."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "shadowgram"


def test_one_energy():
    line = mono(60.0)
    assert line.mean_energy == 60.0
    assert line.half_value_layer(ALUMINUM) == pytest.approx(10 * ALUMINUM.half_value_layer(60.0))
    assert line.filtered(ALUMINUM, 10.0).total == pytest.approx(math.exp(-ALUMINUM.attenuation(60.0)))


@pytest.mark.parametrize("absorber", ["aluminum", "copper", "tungsten", "water"])
def test_half_value_layer_halves_the_kerma(absorber):
    spectrum = shipped_tube()

    def kerma(of):
        air = material("air")
        return sum(w * e * air.mass_energy_absorption(e) for e, w in zip(of.energy, of.weight, strict=True))

    layer = spectrum.half_value_layer(material(absorber))
    assert kerma(spectrum.filtered(material(absorber), layer)) == pytest.approx(kerma(spectrum) / 2, rel=1e-10)


def test_filters_harden():
    before = shipped_tube()
    after = before.filtered(material("Cu"), 0.3)
    assert after.total < before.total
    assert after.mean_energy > before.mean_energy + 5
    assert before.filtered(ALUMINUM, 0.0).weight == pytest.approx(before.weight)
    assert [before.filtered(ALUMINUM, 1.0).filtered(ALUMINUM, 2.0).total] == pytest.approx(
        [before.filtered(ALUMINUM, 3.0).total]
    )


def test_filters_that_cannot_be():
    for thickness in (-1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="0 or more mm"):
            mono(60.0).filtered(ALUMINUM, thickness)
    with pytest.raises(ValueError, match="1000 mm of tungsten let nothing through"):
        mono(60.0).filtered(material("tungsten"), 1000.0)


def test_a_spectrum_cannot_be_changed():
    energy = np.array([20.0, 30.0])
    spectrum = Spectrum(energy=energy, weight=np.ones(2))
    energy[0] = 25.0
    assert spectrum.energy[0] == 20.0
    with pytest.raises(ValueError, match="read-only"):
        spectrum.weight[0] = 2.0


@pytest.mark.parametrize(
    ("energy", "weight", "message"),
    [
        ([20, 30], [1], "as many weights as energies"),
        ([], [], "as many weights as energies"),
        ([30, 20], [1, 1], "must rise, but 20 keV comes after"),
        ([20, 20], [1, 1], "must rise, but 20 keV comes after a higher or the same"),
        ([0.5, 20], [1, 1], "between 1 and 800 keV, got 0.5"),
        ([20, 900], [1, 1], "between 1 and 800 keV, got 900"),
        ([20, math.nan], [1, 1], "between 1 and 800 keV, got nan"),
        ([20, 30], [1, -1], "must be 0 or more, got -1"),
        ([20, 30], [1, math.inf], "must be 0 or more, got inf"),
        ([20, 30], [0, 0], "must not all be 0"),
    ],
)
def test_what_is_no_spectrum(energy, weight, message):
    with pytest.raises(ValueError, match=message):
        Spectrum(energy=np.array(energy), weight=np.array(weight))


@pytest.mark.parametrize(
    "text",
    [
        "40,1\n60,3\n",
        "keV,photons\n40,1\n60,3\n",
        "# made by hand\nenergy (keV); weight\n40; 1\n\n60; 3  # the peak\n",
        "\ufeff40\t1\r\n60\t3\r\n",
        "0.1 0\n40 1\n60 3\n1000 0\n",
        "1 0\n0.04 1\n0.06 3\n",
        "\n3 0\n0.0005 0\n0.02 0\n0.04 1\n0.06 3\n0.08 0\n",
    ],
    ids=["plain", "names", "comments", "windows", "zeros outside", "gate lines", "gate interpolated"],
)
def test_files_that_are_read(text, tmp_path):
    path = tmp_path / "spectrum.txt"
    path.write_bytes(text.encode())
    spectrum = read_spectrum(path)
    lit = spectrum.weight > 0
    assert spectrum.energy[lit].tolist() == [40, 60]
    assert spectrum.weight[lit] / spectrum.total == pytest.approx([0.25, 0.75])


def test_interpolated_spectra_of_gate_count_the_distance_of_their_rows(tmp_path):
    path = tmp_path / "gate.txt"
    path.write_text("3 0\n0.02 0\n0.03 1\n0.04 1\n0.06 1\n0.08 0\n")
    assert read_spectrum(path).weight.tolist() == pytest.approx([0, 10, 15, 20, 0])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "holds no spectrum"),
        (b"energy,weight\n", "holds no spectrum"),
        (b"energy,weight\nsecond,header\n40,1\n", "line 2 of .* must be an energy and a weight, got 'second,header'"),
        (b"40,1\nsixty,1\n", "line 2 of .* must be an energy and a weight, got 'sixty,1'"),
        (b"40,1\n50\n", "line 2"),
        (b"40,1,2\n50,1,2\n60,1,2\n", "line 2"),
        (b"40,nan\n", "0 or more, got nan"),
        (b"nan,1\n", "between 1 and 800 keV, got nan"),
        (b"nan,0\n", "between 1 and 800 keV, got nan"),
        (b"40,-1\n50,1\n", "0 or more, got -1"),
        (b"50,1\n40,1\n", "must rise"),
        (b"0.04,1\n0.06,1\n", "between 1 and 800 keV, got 0.04"),
        (b"40,0\n50,0\n", "must not all be 0"),
        (b"2 0\n0.04 1\n0.06 3\n", "mode 2; only modes 1"),
        (b"\x89PNG\r\n\x1a\n\xff\xfe\x00", "is not a text file"),
        (b"\x00" * 100, "holds no spectrum"),
    ],
)
def test_hostile_files(content, message, tmp_path):
    path = tmp_path / "bad.txt"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=message) as caught:
        read_spectrum(path)
    assert "bad.txt" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_are_too_large_or_missing(tmp_path):
    with (tmp_path / "large.txt").open("wb") as file:
        file.truncate(10_000_001)
    with pytest.raises(ValueError, match="too large for a spectrum"):
        read_spectrum(tmp_path / "large.txt")
    with pytest.raises(FileNotFoundError):
        read_spectrum(tmp_path / "none.txt")


def test_what_is_written_is_read_back(tmp_path):
    path = tmp_path / "tube.csv"
    path.write_text(format_spectrum(shipped_tube(), "one\ntwo"))
    back = read_spectrum(path)
    assert back.energy.tolist() == shipped_tube().energy.tolist()
    assert back.weight == pytest.approx(shipped_tube().weight, rel=1e-6)
    assert path.read_text().startswith("# one\n# two\nenergy_keV,relative_weight\n")


def test_the_spectrum_of_the_simulations(data):
    spectrum = read_spectrum(data / "cxbi" / "spec_120.txt")
    lit = spectrum.energy[spectrum.weight > 0]
    assert (lit[0], lit[-1]) == (10, 119)
    assert spectrum.mean_energy == pytest.approx(55.62, abs=0.01)
    # It is harder than a tube behind 1.5 mm of aluminum: about as behind 3.3 mm.
    assert spectrum.half_value_layer(ALUMINUM) == pytest.approx(4.84, abs=0.01)
    harder = shipped_tube().filtered(ALUMINUM, 1.82)
    assert harder.half_value_layer(ALUMINUM) == pytest.approx(spectrum.half_value_layer(ALUMINUM), rel=0.01)


def test_shipped_tube():
    spectrum = shipped_tube()
    assert spectrum.total == pytest.approx(1, abs=1e-6)
    assert spectrum.energy.tolist() == [1.5 + i for i in range(119)]
    assert spectrum.energy[spectrum.weight.argmax()] == 59.5  # Kα1 of tungsten


def test_shipped_tube_is_what_the_command_makes(cache):
    spekpy = pytest.importorskip("spekpy")
    made = tube(120.0)
    assert made.mean_energy == pytest.approx(shipped_tube().mean_energy, rel=1e-3)
    if spekpy.__version__ == "2.5.4":
        bright = shipped_tube().weight > 1e-8
        assert made.weight[bright] / made.total == pytest.approx(shipped_tube().weight[bright], rel=1e-5)


def test_filters_agree_with_those_of_spekpy(cache):
    spekpy = pytest.importorskip("spekpy")
    other = spekpy.Spek(kvp=100, th=12, dk=1.0, mu_data_source="nist").filter("Al", 2.5).filter("Cu", 0.1)
    ours = tube(100.0, [("Al", 2.5), ("Cu", 0.1)])
    assert ours.total == pytest.approx(other.get_flu(), rel=5e-3)
    assert ours.mean_energy == pytest.approx(other.get_emean(), rel=2e-3)
    assert ours.half_value_layer(ALUMINUM) == pytest.approx(other.get_hvl1(), rel=0.01)


def test_tubes_are_computed_once(cache, monkeypatch):
    pytest.importorskip("spekpy")
    first = tube(50.0, [])
    (kept,) = cache.iterdir()
    monkeypatch.setattr(_tubes, "_compute", lambda *_: pytest.fail("it was computed again"))
    second = tube(50.0, [])
    assert second.weight.tolist() == first.weight.tolist()
    assert kept.name.startswith("tube-")


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"\xff\xfe", b"[]", b'{"key": {}}', b'{"energy": [1]}', None],
    ids=["empty", "cut", "binary", "list", "other key", "no key", "bad weights"],
)
def test_what_is_wrong_in_the_cache_is_computed_again(cache, content):
    pytest.importorskip("spekpy")
    first = tube(50.0, [])
    (kept,) = cache.iterdir()
    if content is None:
        whole = json.loads(kept.read_text())
        content = json.dumps(whole | {"weight": ["a lot"] * len(whole["weight"])}).encode()
    kept.write_bytes(content)
    assert tube(50.0, []).weight.tolist() == first.weight.tolist()
    assert json.loads(kept.read_text())["energy"] == first.energy.tolist()


def test_tubes_differ_by_every_parameter(cache):
    pytest.importorskip("spekpy")
    for arguments in ((50.0, 12.0, 1.0), (60.0, 12.0, 1.0), (50.0, 20.0, 1.0), (50.0, 12.0, 2.0)):
        _tubes.bare_tube(*arguments)
    assert len(list(cache.iterdir())) == 4


def test_a_cache_that_cannot_be_made_is_done_without(tmp_path, monkeypatch):
    pytest.importorskip("spekpy")
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert tube(50.0, []).mean_energy < 50


def test_without_spekpy(monkeypatch):
    monkeypatch.setitem(sys.modules, "spekpy", None)
    with pytest.raises(ValueError, match=r'tube spectra need the package spekpy: pip install "shadowgram\[tubes\]"'):
        tube(120.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"voltage": 5.0}, "voltage must be between 10 and 500 kV, got 5.0"),
        ({"voltage": math.nan}, "voltage must be between 10 and 500 kV, got nan"),
        ({"voltage": "120"}, "voltage must be between 10 and 500 kV, got '120'"),
        ({"voltage": 120, "anode_angle": 0}, "anode angle must be between 1 and 90 degrees, got 0"),
        ({"voltage": 120, "bin_width": 0}, "energy bins must be between 0.1 and 5 keV, got 0"),
    ],
)
def test_what_is_no_tube(arguments, message):
    with pytest.raises(ValueError, match=message):
        tube(**arguments)


app = typer.Typer()
app.command("spectrum")(xray_materials.spectrum)
app.command("other")(lambda: None)


def run(*arguments):
    result = CliRunner().invoke(app, ["spectrum", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.stdout


def test_command_reads_filters_writes_and_draws(tmp_path):
    file, out, plot = tmp_path / "in.csv", tmp_path / "out.csv", tmp_path / "out.png"
    file.write_text(format_spectrum(shipped_tube()))
    said = json.loads(run("--file", file, "--filter", "Cu:0.5", "-o", out, "--plot", plot, "--json"))
    expected = shipped_tube().filtered(material("Cu"), 0.5)
    assert said["mean_energy"] == pytest.approx(expected.mean_energy, rel=1e-5)
    assert said["half_value_layer"] == pytest.approx(expected.half_value_layer(ALUMINUM), rel=1e-5)
    assert read_spectrum(out).mean_energy == pytest.approx(expected.mean_energy, rel=1e-5)
    assert "xray spectrum --file in.csv --filter Cu:0.5" in out.read_text()
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_command_computes_a_tube(cache, tmp_path):
    pytest.importorskip("spekpy")
    lines = run("--voltage", 120, "--filter", "Al:1.5", "-o", tmp_path / "tube.csv").splitlines()
    assert lines[1].split() == ["mean", "energy", "52.08", "keV"]
    assert lines[2].split()[1:] == ["layer", "3.227", "mm", "Al"]
    assert "photons/cm² per mAs at 1 m" in lines[3]
    assert read_spectrum(tmp_path / "tube.csv").mean_energy == pytest.approx(52.08, abs=0.01)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "either the --voltage of a tube in kV or the --file"),
        (["--voltage", 120, "--file", "x.csv"], "either the --voltage"),
        (["--voltage", 120, "--filter", "Al"], "a material and its thickness in mm, such as Al:1.5; got 'Al'"),
        (["--voltage", 120, "--filter", "Al:thick"], "such as Al:1.5; got 'Al:thick'"),
        (["--voltage", 120, "--filter", "Xyzzy:1"], "no material 'Xyzzy'"),
        (["--voltage", 120, "--filter", "Al:-1"], "0 or more mm"),
        (["--file", "x.csv", "--anode-angle", 12], "no --anode-angle"),
        (["--voltage", 120, "-o", "tube.png"], r"must end in \.csv or \.txt"),
    ],
)
def test_command_refuses(options, message, cache):
    if "Xyzzy:1" in options or "Al:-1" in options:
        pytest.importorskip("spekpy")
    with pytest.raises(ValueError, match=message):
        run(*options)
