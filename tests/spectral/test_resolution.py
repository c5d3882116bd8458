"""What imagers resolve: tables 2.1 and 2.2 and eqs. (2.17) to (2.24) by hand, and by looking through the operator."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import shadowgram as sg
from shadowgram.operators import as_matrix
from shadowgram.spectral import Resolution, position_for


def camera(**changes):
    geometry = {
        "detector_shape": (4, 32),
        "detector_pitch": 10.0,
        "code_pitch": 10.0,
        "mask_position": 0.25,
        "wavelengths": (450.0, 650.0),
    }
    return sg.SSCSI(**(geometry | changes))


# By hand. α = β Nd Δd/200 nm; sα in µm/nm stands beside each.
BY_HAND = [
    # sα = 0.25·320/200 = 0.4: Δλ = 10/0.4; partly 7.5/0.4, wholly (10 − 7.5)/0.4
    ({}, "detector-limited", (8, 4, 32), 25.0, (18.75, 6.25), 10.0, 10.0),
    # sα = 0.25·2·320/200 = 0.8, twice the spectral plane, half the band
    ({"dispersion_ratio": 2.0}, "detector-limited", (16, 4, 32), 12.5, (9.375, 3.125), 10.0, 10.0),
    # Δd = 20, Nd = 32: sα = 0.25·640/200 = 0.8; Δc/(1−s) = 13.33 ≤ 20; 64·0.75 = 48 columns; (15 − 10)/0.8
    ({"detector_pitch": 20.0}, "super-resolving", (16, 8, 48), 12.5, (12.5, 6.25), 40 / 3, 10.0),
    # Δd = 40: sα = 1.6; 128·0.75 = 96 columns; (30 − 10)/1.6 is more than the bound 6.25, as Δd(1−s) > 2Δc
    ({"detector_pitch": 40.0}, "super-resolving", (32, 16, 96), 6.25, (6.25, 12.5), 40 / 3, 10.0),
    # Δd = 20, s = 0.5: the border, 20·0.5 = 10 = Δc; sα = 1.6
    (
        {"detector_pitch": 20.0, "mask_position": 0.5},
        "super-resolving",
        (32, 8, 32),
        6.25,
        (6.25, 0.0),
        20.0,
        10.0,
    ),
    # Δd = 20, s = 0.75: 5 < 10; sα = 2.4; partly 5/2.4, wholly (10 − 5)/2.4
    (
        {"detector_pitch": 20.0, "mask_position": 0.75},
        "detector-limited",
        (48, 8, 32),
        10 / 2.4,
        (5 / 2.4, 5 / 2.4),
        20.0,
        10.0,
    ),
]


@pytest.mark.parametrize(("changes", "regime", "cube", "width", "extents", "x_pitch", "y_pitch"), BY_HAND, ids=str)
def test_tables_by_hand(changes, regime, cube, width, extents, x_pitch, y_pitch):
    found = camera(**changes).resolution
    assert found.regime == regime
    assert found.cube_shape == cube
    assert found.bands == cube[0]
    assert found.band_width == pytest.approx(width, rel=1e-12)
    assert found.spectral_extents == pytest.approx(extents, rel=1e-12, abs=1e-12)
    assert (found.x_pitch, found.y_pitch) == pytest.approx((x_pitch, y_pitch), rel=1e-12)
    assert found.band_edges[[0, -1]] == pytest.approx([450, 650])
    assert found.wavelengths[0] == pytest.approx(450 + width / 2)


@pytest.mark.parametrize(
    ("columns", "s", "beta", "bands"), [(256, 0.004, 3.0, 4), (256, 0.0078, 3.0, 6), (233, 0.1, 1.0, 24)]
)
def test_number_of_bands_is_rounded_up(columns, s, beta, bands):
    found = camera(detector_shape=(2, columns), mask_position=s, dispersion_ratio=beta).resolution
    assert found.bands == math.ceil(s * columns * beta) == bands  # eq. (2.18)
    assert found.band_width == pytest.approx(200 / (s * columns * beta))  # the last band reaches beyond the range
    assert found.band_edges[-2] < 650 <= found.band_edges[-1]


def seen_over_wavelength(imager, column, element, bands):
    """(bands,) transmittance of a detector element at `bands` wavelengths, when only this column of the code is open."""
    fine = dataclasses.replace(imager, bands=bands, shear="centre")
    code = np.zeros((1, *fine.code_shape))
    code[:, :, column] = 1
    H = fine.operator(code)
    snapshot = np.zeros(H.out_shape)
    snapshot[0, 0, element] = 1
    # All voxels that the element sees, per code row.
    return H.adjoint(snapshot).sum(axis=(1, 2)) / fine.pitch_ratio


@pytest.mark.parametrize("changes", [case[0] for case in BY_HAND], ids=str)
def test_spectral_extents_are_what_an_element_sees_of_a_code_column(changes):
    imager = camera(**changes)
    bands, element = 4000, imager.detector_shape[1] // 2
    width = imager.pitch_ratio * (1 - imager.mask_position)
    column = int(imager.mask_offset + element * width + imager.spectral_columns / 2)  # seen in the middle of the range
    seen = seen_over_wavelength(imager, column, element, bands)
    most, nm = seen.max(), 200 / bands
    partly = np.count_nonzero((seen > 1e-9) & (seen < most - 1e-9)) * nm / 2  # it comes on, and leaves
    wholly = np.count_nonzero(seen >= most - 1e-9) * nm
    assert seen[0] == seen[-1] == 0
    assert (partly, wholly) == pytest.approx(imager.resolution.spectral_extents, abs=2.01 * nm)


def test_a_point_meets_the_next_code_column_one_band_width_further():
    imager = camera(mask_position=0.95)  # elements see 1/20 of a column: nearly points
    bands, element = 6000, 16
    starts = [
        np.flatnonzero(seen_over_wavelength(imager, column, element, bands) > 1e-9)[0] * 200 / bands
        for column in range(10, 14)
    ]
    assert np.diff(starts) == pytest.approx(imager.resolution.band_width, abs=1.01 * 200 / bands)


@pytest.mark.parametrize("shear", ["exact", "centre", "edge"])
@pytest.mark.parametrize("changes", [{}, {"detector_pitch": 20.0}, {"dispersion_ratio": 2.0}], ids=str)
def test_the_next_band_sees_the_code_shifted_by_one_column(changes, shear):
    imager = camera(detector_shape=(2, 12), mask_position=0.25, shear=shear, **changes)
    bands, ny, nx = imager.resolution.cube_shape
    code = np.random.default_rng(0).random((1, *imager.code_shape)).astype(np.float32)
    shifted = np.zeros_like(code)
    shifted[:, :, :-1] = code[:, :, 1:]
    # Elements at the left end look past column 0, which the shifted code has lost.
    H, G = (as_matrix(imager.operator(c)).reshape(2, 12, bands, ny * nx)[:, 4:] for c in (code, shifted))
    assert np.abs(H[:, :, 1:] - G[:, :, :-1]).max() < 1e-12
    assert np.abs(H[:, :, 1:] - H[:, :, :-1]).max() > 0.1


def test_nothing_moves_with_the_mask_on_the_detector():
    found = camera(mask_position=0.0).resolution
    assert found.spectral_extents == (math.inf, math.inf)
    assert (found.bands, found.band_width) == (1, 200.0)


@pytest.mark.parametrize("kind", [sg.CASSI, sg.DualCASSI, sg.ColoredCASSI])
def test_extents_of_other_imagers_are_their_bands(kind):
    found = kind(cube_shape=(8, 6, 7), wavelengths=(450, 650)).resolution
    assert found.spectral_extents == (25.0, 25.0)
    assert found.mean_throughput == 1
    assert found.vignetted_bands == ()


def test_throughput_is_what_an_open_code_lets_through():
    imager = camera(mask_position=0.5, dispersion_ratio=2.0)
    found = imager.resolution
    H = imager.operator(np.ones((1, *imager.code_shape)))
    passed = H.adjoint(np.ones(H.out_shape)).mean(axis=(1, 2))
    assert found.throughput == pytest.approx(passed, abs=1e-12)
    assert found.mean_throughput == pytest.approx(passed.mean())
    assert found.vignetted_bands == tuple(np.flatnonzero(passed < 0.99))
    assert 0 < len(found.vignetted_bands) < found.bands


def test_vignetted_bands_lose_more_than_one_per_cent():
    found = dataclasses.replace(camera().resolution, vignetted=(0.0, 0.01, 0.011, 1.0))
    assert found.vignetted_bands == (2, 3)
    assert found.throughput == pytest.approx([1, 0.99, 0.989, 0])


def test_people_read_a_line_for_each_thing():
    lines = str(camera(dispersion_ratio=2.0, mask_position=0.5).resolution).splitlines()
    assert [line.split()[0] for line in lines] == ["regime", "datacube", "bands", "pitch", "throughput"]
    assert "32 bands × 4 × 32" in lines[1]
    assert "6.25 nm wide, from 450 to 650 nm; extents 3.125 and 3.125 nm" in lines[2]
    assert "beside the mask" in lines[4]
    assert "extents" not in str(sg.CASSI(cube_shape=(8, 6, 7), wavelengths=(450, 650)).resolution)
    assert "inf" not in str(camera(mask_position=0.0).resolution)
    assert isinstance(camera().resolution, Resolution)


@settings(deadline=None, max_examples=60)
@given(
    share=st.floats(0.011, 1.0),
    columns=st.integers(10, 200),
    ratio=st.integers(1, 3),
    beta=st.floats(0.5, 4.0),
)
def test_position_for_gives_the_bands_that_were_asked_for(share, columns, ratio, beta):
    imager = camera(detector_shape=(2, columns), detector_pitch=10.0 * ratio, mask_position=0.1, dispersion_ratio=beta)
    finest = imager.code_pitch / imager.dispersion
    width = finest * 1.001 + share * (200 - finest * 1.001)
    s = position_for(imager, band_width=width)
    assert 0 < s < 1
    assert dataclasses.replace(imager, mask_position=s).resolution.band_width == pytest.approx(width, rel=1e-9)


def test_position_for_by_hand_and_whatever_the_camera_is_set_to():
    for s, bands in ((0.0, None), (0.9, 7)):
        imager = camera(mask_position=s, bands=bands)
        assert position_for(imager, band_width=25.0) == pytest.approx(0.25, rel=1e-12)
    assert position_for(imager, band_width=200.0) == pytest.approx(1 / 32)


@pytest.mark.parametrize(
    ("width", "says"),
    [
        (200.1, "wider than all the wavelengths, 450 to 650 nm"),
        (6.25, "they stay wider than 6.25 nm"),
        (1.0, "they stay wider than 6.25 nm"),
        (0.0, "positive number of nm"),
        (-3.0, "positive number of nm"),
        (math.nan, "positive number of nm"),
        (math.inf, "positive number of nm"),
    ],
)
def test_band_widths_that_cannot_be_had(width, says):
    with pytest.raises(ValueError, match=says):
        position_for(camera(), band_width=width)


def test_position_for_wants_a_mask_that_moves():
    with pytest.raises(TypeError, match="whose mask can be moved, got CASSI"):
        position_for(sg.CASSI(cube_shape=(8, 6, 7), wavelengths=(450, 650)), band_width=10.0)
