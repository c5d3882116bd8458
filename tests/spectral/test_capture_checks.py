"""What is wrong with captured shots is said, each problem by its name."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import shadowgram as sg
from shadowgram.spectral import check_capture

BANDS, SIDE = 8, 96


def imager_of(bands=BANDS):
    return sg.CASSI(cube_shape=(bands, SIDE, SIDE), wavelengths=(450, 650), band_shift=2)


@pytest.fixture(scope="module")
def mask():
    raw = gaussian_filter(np.random.default_rng(1).random((SIDE, SIDE)), 0.7)
    return ((raw - raw.min()) / np.ptp(raw)).astype(np.float32)


@pytest.fixture(scope="module")
def shots(mask):
    fields = gaussian_filter(np.random.default_rng(2).random((3, SIDE, SIDE)), (0, 6, 6))
    fields = np.maximum((fields - fields.min()) / np.ptp(fields) - 0.45, 0)
    spectra = np.abs(np.sin(np.outer(np.arange(1, 4), np.linspace(0.3, 2, BANDS))))
    cube = np.tensordot(spectra, fields, (0, 0))
    y = imager_of().operator(mask).forward(cube) / 8
    return (y + np.random.default_rng(0).normal(0, 1e-3, y.shape)).astype(np.float32)


def only(findings):
    assert len(findings) == 1, findings
    return findings[0]


def test_nothing_is_said_of_good_shots(mask, shots):
    assert check_capture(imager_of(), mask, shots) == []
    busy = imager_of().operator(mask).forward(sg.scenes.chart(size=SIDE, bands=BANDS, seed=0).values)
    assert check_capture(imager_of(), mask, busy) == []


@pytest.mark.parametrize(("down", "right"), [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_a_mask_that_is_out_of_place(mask, shots, down, right):
    given = np.roll(mask, (-down, -right), axis=(0, 1))
    found = only(check_capture(imager_of(), given, shots))
    assert found.what == "the mask is out of place"
    assert f"{down:+.1f} px down and {right:+d} px right" in found.how_much.replace("-0.0", "+0.0")
    assert not found.fatal


@pytest.mark.parametrize(("axes", "how"), [((0,), "upside down"), ((1,), "mirrored"), ((0, 1), "turned by 180°")])
def test_a_mask_that_is_turned(mask, shots, axes, how):
    assert only(check_capture(imager_of(), np.flip(mask, axes), shots)).what == f"the mask is {how}"


def test_another_mask(mask, shots):
    other = np.random.default_rng(5).permutation(mask.ravel()).reshape(mask.shape)
    assert only(check_capture(imager_of(), other, shots)).what == "the shots do not show this mask"


def test_saturation(mask, shots):
    clipped = np.minimum(shots, np.quantile(shots, 0.97))
    assert "shot 0 is saturated" in [f.what for f in check_capture(imager_of(), mask, clipped)]
    limited = check_capture(imager_of(), mask, shots, saturation=float(np.quantile(shots, 0.9)))
    assert "10 % of its pixels" in only(limited).how_much


def test_a_missing_band(mask, shots):
    found = only(check_capture(imager_of(BANDS + 1), mask, shots))
    assert (found.what, found.fatal) == ("a band is missing", True)
    assert "right for 8 bands of 2 px, not for 9" in str(found)
    assert only(check_capture(imager_of(BANDS - 1), mask, shots)).what == "there are more bands than the model has"
    assert "does not fit" in only(check_capture(imager_of(), mask, shots[:, :, 1:])).what


@pytest.mark.parametrize(
    ("spoil_mask", "spoil_shots", "what", "says"),
    [
        (lambda m: m[:, :90], None, "a mask of another size", "it is 96 × 90, and the model takes 96 × 96"),
        (None, lambda y: y[:, :90], "a mask of another size", "90 px high and the mask 96"),
        (None, lambda y: np.concatenate([y, y]), "another number of shots than masks", "1 masks"),
        (None, lambda y: np.full_like(y, 0.5), "shot 0 shows nothing", "0.5 in every pixel"),
        (lambda m: m * 255, None, "a mask that is no transmittance", "0 to 255"),
        (lambda m: np.ones_like(m), None, "a mask without pattern", "1 everywhere"),
        (None, lambda y: np.where(y == y.max(), np.nan, y), "bad values in the shots", "1 of"),
        (None, lambda y: y.astype(complex), "the shots hold no numbers", "complex"),
    ],
)
def test_what_cannot_be_reconstructed(mask, shots, spoil_mask, spoil_shots, what, says):
    given = mask if spoil_mask is None else spoil_mask(mask)
    captured = shots if spoil_shots is None else spoil_shots(shots)
    found = only(check_capture(imager_of(), given, captured))
    assert (found.what, found.fatal) == (what, True)
    assert says in found.how_much
    assert found.what_to_do
