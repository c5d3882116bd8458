"""The generated scene: one scene at every size and band count, within its range, and with what it promises to show."""

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.scenes import _chart_parts as parts
from shadowgram.scenes import chart, colour, generated


def binned(cube, bands=1, pixels=1):
    b, y, x = cube.shape
    return cube.reshape(b // bands, bands, y // pixels, pixels, x // pixels, pixels).mean(axis=(1, 3, 5))


@pytest.mark.parametrize(
    ("size", "bands", "shape"),
    [(16, 1, (1, 16, 16)), ((17, 33), 5, (5, 17, 33)), ((41, 20), 2, (2, 41, 20)), (3, 1, (1, 3, 3))],
)
def test_any_size_and_band_count(size, bands, shape):
    scene = chart(size=size, bands=bands)
    assert scene.dims == ("band", "y", "x")
    assert scene.shape == shape
    assert scene.dtype == np.float32
    assert scene.values.min() >= 0
    assert scene.values.max() <= 1
    assert scene.wavelength.values == pytest.approx(450 + 200 / bands * (np.arange(bands) + 0.5))


@pytest.mark.parametrize("seed", range(1, 5))
def test_every_seed_stays_in_range(seed):
    values = chart(size=48, bands=40, seed=seed).values
    assert values.min() >= 0
    assert 0.8 < values.max() <= 1


def test_values_use_the_range():
    values = chart(size=96, bands=24).values
    assert 0.9 < values.max() <= 1.0
    assert values.min() < 0.005
    assert 0.05 < values.mean() < 0.4


@pytest.mark.parametrize("wavelengths", [(450.0, 650.0), (400.0, 700.0), (360.0, 780.0), (600.0, 640.0)])
def test_finer_bands_average_to_coarser_ones(wavelengths):
    coarse = chart(size=24, bands=24, wavelengths=wavelengths).values
    fine = chart(size=24, bands=192, wavelengths=wavelengths).values
    assert binned(fine, bands=8) == pytest.approx(coarse, abs=2e-6)
    # …and not because the spectra are smooth: the middle sub-band alone is far off.
    assert np.abs(fine[4::8] - coarse).max() > 5e-3
    assert fine.max() <= 1


def test_finer_pixels_average_to_coarser_ones():
    coarse = chart(size=32, bands=3).values
    fine = chart(size=128, bands=3).values
    difference = binned(fine, pixels=4) - coarse
    # Not the same samples: 1024² for the fine one and 256² for the coarse one.
    assert np.sqrt(np.mean(difference**2)) < 0.009
    # One pixel off would be much worse.
    assert np.sqrt(np.mean((binned(fine, pixels=4) - np.roll(coarse, 1, axis=2)) ** 2)) > 0.05


def test_wide_and_tall_pictures_show_the_square_in_their_middle():
    square = chart(size=40, bands=2).values
    wide = chart(size=(40, 60), bands=2).values
    tall = chart(size=(64, 40), bands=2).values
    # Beads in the wings may throw a shadow or show through at the rim, no more.
    assert np.mean(np.abs(wide[:, :, 10:50] - square)) < 0.002
    assert np.mean(np.abs(tall[:, 12:52] - square)) < 0.002


def test_seeds():
    one = chart(size=32, bands=3, seed=5).values
    assert np.array_equal(one, chart(size=32, bands=3, seed=5).values)
    assert np.mean(np.abs(one - chart(size=32, bands=3, seed=6).values)) > 0.02


def test_threads_do_not_matter(monkeypatch):
    monkeypatch.setattr(generated, "_SAMPLES_AT_ONCE", 2**14)
    with sg.threads(1):
        one = chart(size=40, bands=2).values
    with sg.threads(3):
        three = chart(size=40, bands=2).values
    assert np.array_equal(one, three)


def test_patches_are_the_measured_ones():
    edges = np.linspace(400, 700, 31)
    spectra = parts.spectra(edges)
    table, _, power = colour.observer()
    patch_nm, reflectance = colour.colorchecker()
    lamp = colour.band_means(table, power, edges) / power[(table >= 400) & (table <= 700)].max()
    expected = colour.band_means(patch_nm, reflectance, edges) * lamp
    # The mean of a product is not quite the product of the means, hence the tolerance.
    assert spectra[:24] == pytest.approx(expected, abs=2e-3)
    assert spectra[parts.LAMP] == pytest.approx(lamp)


def test_light_is_never_above_one():
    for edges in (np.linspace(360, 780, 421), np.linspace(400.3, 411.7, 50), np.array([450.0, 650.0])):
        spectra = parts.spectra(edges)
        assert spectra.min() >= 0
        assert spectra.max() <= 1 + 1e-12


def test_the_metamer_hides_from_the_eye_only():
    edges = np.linspace(450, 650, 25)
    centres = 0.5 * (edges[1:] + edges[:-1])
    spectra = parts.spectra(edges)
    pair = spectra[[parts.NEUTRAL_5, parts.METAMER]]
    rgb = sg.scenes.to_rgb(pair.T[:, None, :], 1.0, wavelengths=centres)[0].astype(int)
    assert np.abs(rgb[0] - rgb[1]).max() <= 1
    assert np.abs(pair[0] - pair[1]).max() > 0.08


def test_narrow_spectra_are_narrow():
    nm = np.arange(400.0, 701)
    spectra = parts.spectra(np.arange(399.5, 701))
    for led, (peak, width) in enumerate(parts.LEDS):
        line = spectra[parts.FIRST_LED + led]
        assert abs(nm[line.argmax()] - peak) <= 1
        assert np.count_nonzero(line > 0.5 * line.max()) == pytest.approx(width, abs=1)
    glass = spectra[parts.BEHIND_GLASS + parts.WHITE] / spectra[parts.WHITE]
    assert glass[nm == 585] < 0.1
    assert glass[nm == 610] > 0.8


def test_every_material_is_in_the_picture():
    # With one band for each nm, the number of independent spectra that can be told apart is the rank of the cube.
    scene = chart(size=64, bands=200).values.reshape(200, -1)
    strength = np.linalg.eigvalsh(scene @ scene.T)[::-1]
    assert np.count_nonzero(strength > 1e-9 * strength[0]) > 25


def test_fine_print_is_drawn():
    s, t = np.meshgrid((np.arange(600) + 0.5) / 600, 1 - (np.arange(600) + 0.5) / 600)
    ink, _, _ = parts.resolution_card(s, t)
    for colour_of_ink in (parts.BLACK, parts.RED, parts.BLUE, parts.GREEN, parts.NEUTRAL_5, parts.METAMER):
        assert 0.0005 < np.mean(ink == colour_of_ink) < 0.3
    # A spoke and a gap of the star at half its radius.
    row = ink[int((1 - 0.70) * 600), int((0.285 + 0.05) * 600) : int((0.285 + 0.22) * 600)]
    assert set(np.unique(row)) <= {parts.BLACK, parts.WHITE}
    around = np.linspace(0, 2 * np.pi, 4001)[:-1]
    star, _, _ = parts.resolution_card(0.285 + 0.15 * np.cos(around), 0.70 + 0.15 * np.sin(around))
    assert np.count_nonzero(np.diff(star)) in (63, 64)  # 32 spokes


@pytest.mark.parametrize("text", [text for text, *_ in parts._PRINT])
def test_all_printed_characters_have_a_glyph(text):
    assert set(text) <= set(parts._GLYPHS) | {" "}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"size": 0}, "size is a positive number of pixels"),
        ({"size": 32.5}, "size is a positive number of pixels"),
        ({"size": (32, 32, 32)}, "size is a positive number of pixels"),
        ({"size": (32, -1)}, "size is a positive number of pixels"),
        ({"bands": 0}, "bands is a positive whole number"),
        ({"bands": 2.0}, "bands is a positive whole number"),
        ({"seed": -1}, "seed is a whole number"),
        ({"wavelengths": (650, 450)}, "wavelengths is a rising pair within 360 to 780 nm"),
        ({"wavelengths": (0.45, 0.65)}, "wavelengths is a rising pair within 360 to 780 nm"),
        ({"wavelengths": (450, float("nan"))}, "wavelengths is a rising pair within 360 to 780 nm"),
        ({"wavelengths": 550}, r"wavelengths is a pair \(shortest, longest\)"),
    ],
)
def test_bad_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        chart(**{"size": 16, "bands": 2, **arguments})
