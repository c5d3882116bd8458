"""The bench against rays traced through it one by one, the dissertation's table 2.4, and files that are wrong."""

import dataclasses
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.spectral import Bench, position_for
from shadowgram.spectral.bench import read_bench

PARTS = {
    "grating_lines": 300.0,
    "relay_focal_lengths": (75.0, 75.0),
    "wavelengths": (480.0, 620.0),
    "detector_shape": (256, 256),
    "detector_pitch": 9.9,
    "code_pitch": 19.4,
    "mask_distances": (0.0, 10.0),
    "pupil_distance": 350.0,
}


def bench(**changes):
    parts = PARTS | changes
    if "measured_ratio" in changes:
        parts["pupil_distance"] = None
    return Bench(**parts)


# --- rays -------------------------------------------------------------------------------------------------------------


def through_relay(height, slope, f1, f2):
    """Ray at the grating → ray at its image, by free flights and thin lenses (paraxial matrices)."""
    for step in (("fly", f1), ("lens", f1), ("fly", f1 + f2), ("lens", f2), ("fly", f2)):
        match step:
            case "fly", length:
                height = height + length * slope
            case "lens", focal:
                slope = slope - height / focal
    return height, slope


def ray(b, wavelength, position, pupil_point=0.0):
    """Ray of a wavelength from a point of the pupil to `position` (mm) on the grating, at the grating's image."""
    middle = sum(b.wavelengths) / 2
    sine = 1e-6 * b.order * b.grating_lines
    bend = math.tan(math.asin(sine * wavelength) - math.asin(sine * middle))
    slope = (position - pupil_point) / b.pupil_distance + bend
    return through_relay(position, slope, *b.relay_focal_lengths)


BENCHES = [
    {},
    {"relay_focal_lengths": (50.0, 75.0)},
    {"relay_focal_lengths": (100.0, 60.0), "pupil_distance": 120.0, "wavelengths": (400.0, 700.0)},
    {"grating_lines": 600.0, "order": 2, "wavelengths": (500.0, 520.0), "pupil_distance": 90.0},
]


@pytest.mark.parametrize("changes", BENCHES, ids=str)
def test_rays_of_a_wavelength_meet_on_the_spectral_plane(changes):
    b = bench(**changes)
    for wavelength in (b.wavelengths[0], 0.3 * b.wavelengths[0] + 0.7 * b.wavelengths[1]):
        # The mask's side is before the image: a distance is flown backwards.
        points = [
            height - b.plane_distance * slope for height, slope in (ray(b, wavelength, x) for x in (-2.0, 0.0, 3.0))
        ]
        assert np.ptp(points) < 1e-9


@pytest.mark.parametrize("changes", BENCHES, ids=str)
def test_dispersion_is_the_mean_distance_of_wavelengths_on_the_plane(changes):
    b = bench(**changes)
    nm = np.linspace(*b.wavelengths, 257)
    x = np.array([height - b.plane_distance * slope for height, slope in (ray(b, w, 0.0) for w in nm)])
    length = abs(x[-1] - x[0])
    assert b.dispersion == pytest.approx(1000 * length / (nm[-1] - nm[0]), rel=1e-12)
    assert b.dispersion_ratio == pytest.approx(length / (256 * 0.0194), rel=1e-12)
    uneven = np.abs(x - np.interp(nm, nm[[0, -1]], x[[0, -1]])).max() * 1000 / b.dispersion
    assert b.nonlinearity == pytest.approx(uneven, rel=1e-6)
    assert 0 < b.nonlinearity < 0.03 * (nm[-1] - nm[0])


@pytest.mark.parametrize("changes", BENCHES, ids=str)
def test_the_mask_is_stretched_and_sheared_as_the_imager_says(changes):
    b = bench(**changes)
    s = b.reachable[1]
    low, high = b.wavelengths
    dc = b.distance(s)
    assert dc == pytest.approx(10.0)

    def on_mask(wavelength, position):
        height, slope = ray(b, wavelength, position)
        return height, height - dc * slope

    (x0, u0), (x1, u1) = on_mask(low, -1.0), on_mask(low, 1.0)
    assert (u1 - u0) / (x1 - x0) == pytest.approx(1 - s, rel=1e-9)  # eq. (2.2)
    shift = abs(on_mask(high, 0.5)[1] - on_mask(low, 0.5)[1])
    imager = b.imager(s)
    scale = imager.code_pitch / b.code_pitch
    assert shift * 1000 * scale == pytest.approx(s * imager.dispersion * (high - low), rel=1e-9)


def test_shear_does_not_depend_on_the_pupil_and_stretch_does():
    near, far = bench(pupil_distance=100.0), bench(pupil_distance=1e7)
    s = [b.reachable[1] for b in (near, far)]
    assert s == pytest.approx([0.1, 1e-6])
    assert s[0] * near.dispersion == pytest.approx(s[1] * far.dispersion, rel=1e-12)
    assert near.imager(s[0]).resolution.band_width == pytest.approx(far.imager(s[1]).resolution.band_width, rel=1e-9)


def test_one_lens_and_a_telecentric_objective_give_equation_2_1():
    """R1 = bd/(b+d)·θ for d from the lens to the sensor: parallel light at angle θ meets f·θ beside the axis."""
    f, b, theta = 40.0, 130.0, 0.03
    d = 1 / (1 / f - 1 / b)
    points = []
    for height in (-2.0, 0.0, 5.0):
        at_lens = height + b * theta
        slope = theta - at_lens / f
        points.append(at_lens + f * slope)
    assert points == pytest.approx([b * d / (b + d) * theta] * 3)


@pytest.mark.parametrize("changes", BENCHES, ids=str)
def test_pupil_blurs_the_mask_and_the_bands(changes):
    N = 80.0
    b = bench(f_number=N, **changes)
    f1, f2 = b.relay_focal_lengths
    s = b.reachable[1]
    # A pupil of this diameter makes a cone of f-number N on the image of the grating.
    diameter = b.plane_distance / N * f1 / f2
    low = b.wavelengths[0]
    edges = [ray(b, low, 0.0, p) for p in (-diameter / 2, diameter / 2)]
    assert abs(edges[0][1] - edges[1][1]) == pytest.approx(1 / N, rel=1e-9)
    spot = abs(edges[0][1] - edges[1][1]) * b.distance(s) * 1000
    assert b.blur(s) == pytest.approx(spot, rel=1e-9)
    # Wavelengths so far apart have spots that just touch, wherever the mask stands.
    per_nm = s * b.dispersion
    assert b.pupil_band_width == pytest.approx(b.blur(s) / per_nm, rel=1e-9)
    assert b.pupil_band_width == pytest.approx(b.blur(s / 3) / (per_nm / 3), rel=1e-9)
    assert b.f_number_for(b.pupil_band_width) == pytest.approx(N, rel=1e-12)


def test_design_rule_by_hand():
    # d(sin θ)/dλ = 3e-4 per nm; cos θ = 0.986 at 550 nm, so 3.04e-4 rad/nm: N = 1/(20·3.04e-4)
    assert bench().f_number_for(20.0) == pytest.approx(164.3, abs=0.2)
    b = bench(f_number=164.3)
    assert b.pupil_band_width == pytest.approx(20, abs=0.05)
    assert b.diffraction_spot == pytest.approx(0.55 * 164.3)
    assert bench().pupil_band_width == 0
    assert bench().blur(0.01) == 0
    with pytest.raises(ValueError, match="positive number of nm"):
        b.f_number_for(0.0)


# --- the dissertation's bench -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("s", "exact", "printed", "bands"), [(0.004, 45.57, 43, 4), (0.0078, 23.37, 22, 6), (0.011, 16.57, 16, 9)]
)
def test_table_2_4(s, exact, printed, bands):
    found = read_bench("salazar2022").imager(s).resolution
    assert found.band_width == pytest.approx(exact, abs=0.01)
    assert found.band_width == pytest.approx(printed, rel=0.08)
    assert found.bands == bands == math.ceil(256 * s * 3)


def test_measured_ratio_gives_the_exit_pupil_and_the_other_way_round():
    measured = bench(measured_ratio=3.0)
    assert measured.exit_pupil == pytest.approx(350, abs=1)
    assert measured.dispersion_ratio == 3.0
    given = bench(pupil_distance=measured.exit_pupil)
    assert given.dispersion_ratio == pytest.approx(3.0, rel=1e-12)
    assert given.dispersion == pytest.approx(measured.dispersion, rel=1e-12)
    assert measured.dispersion == pytest.approx(3 * 256 * 19.4 / 140, rel=1e-12)
    other = bench(measured_ratio=3.0, relay_focal_lengths=(75.0, 150.0))
    assert bench(pupil_distance=other.exit_pupil, relay_focal_lengths=(75.0, 150.0)).dispersion_ratio == pytest.approx(
        3
    )


# --- imager -----------------------------------------------------------------------------------------------------------


def test_imager_has_the_pitches_on_the_detector():
    imager = bench().imager(0.01)
    assert (imager.detector_pitch, imager.code_pitch) == (9.9, 9.9)
    assert imager.shear == "exact"
    # 19.4 µm · 0.256 = 4.966 µm, twice in 9.9 µm within 1 %, then exactly
    finer = bench(magnification=0.256, code_pitch=19.4)
    imager = finer.imager(0.01, shear="edge")
    assert imager.code_pitch == 9.9 / 2
    assert imager.shear == "edge"
    assert imager.code_shape == (512, 512)
    assert finer.mask_width == pytest.approx(512 * 0.0194)
    assert imager.dispersion_ratio == pytest.approx(bench().dispersion_ratio / 2)  # the mask is twice as wide


@pytest.mark.parametrize("s", [-0.001, 0.0004, 0.03, 0.9, math.nan])
def test_positions_beyond_the_reach(s):
    b = bench(mask_distances=(1.0, 10.0))
    with pytest.raises(ValueError, match=r"beyond what the bench reaches, s from 0\.002857 to 0\.02857 \(1 to 10 mm"):
        b.imager(s)


def test_both_ends_of_the_reach_can_be_had():
    b = bench(mask_distances=(1.0, 10.0))
    assert [b.imager(s).mask_position for s in b.reachable] == list(b.reachable)
    finest, widest = (b.imager(s).resolution.band_width for s in b.reachable[::-1])
    assert [position_for(b, band_width=w) for w in (widest, finest)] == pytest.approx(b.reachable)
    for w in (widest, finest):
        b.imager(position_for(b, band_width=w))


@pytest.mark.parametrize("changes", BENCHES, ids=str)
def test_spectral_zoom_round_trip(changes):
    b = bench(mask_distances=(1.0, 10.0), **changes)
    low, high = b.wavelengths
    finest = b.imager(b.reachable[1]).resolution.band_width
    widest = b.imager(b.reachable[0]).resolution.band_width
    for width in np.linspace(finest, widest, 7):
        s = position_for(b, band_width=float(width))
        assert b.imager(s).resolution.band_width == pytest.approx(width, rel=1e-9)
    assert widest <= high - low


def test_band_widths_that_the_bench_does_not_reach():
    b = bench(mask_distances=(1.0, 10.0))
    with pytest.raises(ValueError, match=r"its finest bands are 6\.377 nm wide"):
        position_for(b, band_width=5.0)
    with pytest.raises(ValueError, match=r"its widest bands are 63\.77 nm wide"):
        position_for(b, band_width=100.0)
    with pytest.raises(ValueError, match="wider than all the wavelengths, 480 to 620 nm"):
        position_for(b, band_width=150.0)


WRONG = {
    "both pupils": ({"measured_ratio": 3.0, "pupil_distance": 3.0}, "either pupil_distance or measured_ratio"),
    "no pupil": ({"pupil_distance": None}, "either pupil_distance or measured_ratio"),
    "telecentric": ({"pupil_distance": math.inf}, "telecentric objective s is 0"),
    "pupil behind": ({"pupil_distance": -3.0}, "pupil_distance must be a positive length"),
    "ratio": ({"pupil_distance": None, "measured_ratio": 0.0}, "measured_ratio must be a positive number"),
    "no order": ({"order": 0}, "order must be a whole number"),
    "too many lines": (
        {"grating_lines": 2000.0},
        "sends no light of 620 nm into order 1; it takes at most 1613 lines/mm",
    ),
    "lines": ({"grating_lines": -3.0}, "grating_lines must be a positive number"),
    "relay": ({"relay_focal_lengths": (75.0, 0.0)}, "relay_focal_lengths must be two positive lengths"),
    "wavelengths": ({"wavelengths": (620.0, 480.0)}, "ascending"),
    "shape": ({"detector_shape": (0, 3)}, "detector_shape must be"),
    "pitch": ({"detector_pitch": math.nan}, "detector_pitch must be a positive length"),
    "code": ({"code_pitch": 0.0}, "code_pitch must be a positive length"),
    "f-number": ({"f_number": math.nan}, "f_number must be a positive number"),
    "magnification": ({"magnification": 0.0}, "magnification must be a positive number"),
    "magnification 3/2": (
        {"magnification": 0.34},
        "whole number of mask elements, got .* = 1.501; set magnification to 0.2552",
    ),
    "mask too coarse": ({"magnification": 0.53}, "whole number of mask elements, got .* set magnification to 0.5103"),
    "distances": ({"mask_distances": (5.0, 5.0)}, "mask_distances must be"),
    "negative distance": ({"mask_distances": (-1.0, 5.0)}, "mask_distances must be"),
    "mask in the lens": ({"mask_distances": (0.0, 80.0)}, "the second relay lens is 75 mm from"),
    "mask beyond the plane": (
        {"pupil_distance": 20.0, "mask_distances": (0.0, 30.0)},
        "the spectral plane is 20 mm from",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_parts_that_do_not_make_a_bench(case):
    changes, says = WRONG[case]
    with pytest.raises(ValueError, match=says):
        Bench(**(PARTS | changes))


# --- files ------------------------------------------------------------------------------------------------------------

TOML = """
grating_lines = 600
relay_focal_lengths = [50, 75.0]
wavelengths = [450.0, 650.0]
detector_shape = [64, 128]
detector_pitch = 10.0
code_pitch = 10.0
magnification = 1.0
mask_distances = [2.0, 30.0]
pupil_distance = 200.0
f_number = 120.0
"""


def test_file_gives_the_bench(tmp_path):
    (tmp_path / "mine.toml").write_text(TOML)
    b = read_bench(tmp_path / "mine.toml")
    assert b == Bench(
        grating_lines=600, relay_focal_lengths=(50, 75), wavelengths=(450, 650), detector_shape=(64, 128), detector_pitch=10,
        code_pitch=10, magnification=1, mask_distances=(2, 30), pupil_distance=200, f_number=120,
    )  # fmt: skip
    assert b.plane_distance == pytest.approx(450)
    assert hash(b) == hash(dataclasses.replace(b))


def test_a_file_comes_before_a_bench_of_that_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert read_bench("salazar2022").grating_lines == 300
    (tmp_path / "salazar2022").write_text(TOML)
    assert read_bench("salazar2022").grating_lines == 600


FILES = {
    "unknown key": (TOML + "gratings = 3\n", "unknown key 'gratings'"),
    "a table": (TOML + "[lens]\nf = 3\n", "unknown key 'lens'"),
    "missing key": (TOML.replace("code_pitch = 10.0", ""), "the key 'code_pitch' is missing"),
    "two faults": (TOML.replace("code_pitch", "codepitch"), "'code_pitch' is missing; unknown key 'codepitch'"),
    "text for a number": (TOML.replace("600", "'many'"), "grating_lines should be a valid number, got 'many'"),
    "true for a number": (TOML.replace("600", "true"), "grating_lines should be a valid number, got True"),
    "half an element": (
        TOML.replace("64, 128", "64.5, 128"),
        r"detector_shape\.0 should be a valid integer, got 64\.5",
    ),
    "one length": (TOML.replace("[50, 75.0]", "50.0"), "relay_focal_lengths should be a valid tuple, got 50.0"),
    "a bad value": (TOML.replace("code_pitch = 10.0", "code_pitch = -1.0"), "code_pitch must be a positive length"),
    "not TOML": ("grating 300", "is not TOML"),
    "not text": ("\xff\xfe", "is not TOML"),
}


@pytest.mark.parametrize("case", FILES)
def test_files_that_are_wrong(tmp_path, case):
    text, says = FILES[case]
    path = tmp_path / "mine.toml"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(ValueError, match=says) as caught:
        read_bench(path)
    assert "mine.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_such_bench():
    with pytest.raises(FileNotFoundError, match=r"no bench file nowhere\.toml.* are salazar2022"):
        read_bench("nowhere.toml")


def test_the_packaged_bench_is_a_file_of_the_package():
    folder = Path(sg.__file__).parent / "spectral" / "benches"
    assert [path.name for path in sorted(folder.iterdir())] == ["salazar2022.toml"]


def test_bench_alone_does_not_load_pydantic():
    code = "import sys; from shadowgram.spectral import Bench; print('pydantic' in sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "False"


@pytest.mark.parametrize("f_number", [8.0, 160.0])
def test_pupil_is_what_the_simulator_blurs_by(f_number):
    bench = dataclasses.replace(sg.spectral.read_bench("salazar2022"), f_number=f_number)
    s = 0.0078
    imager = bench.imager(s)
    camera = sg.spectral.ContinuousSSCSI(imager=imager, bands=4, pupil=bench.pupil)
    assert camera.blur * bench.code_pitch == pytest.approx(bench.blur(s), rel=1e-12)
    assert bench.pupil / imager.dispersion == pytest.approx(bench.pupil_band_width, rel=1e-6)
