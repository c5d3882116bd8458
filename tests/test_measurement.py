"""Measurements: what goes in comes back from the file, simulation is honest, and wrong contents are refused in one line."""

import dataclasses
import json

import numpy as np
import pytest
import xarray as xr

import shadowgram as sg
from shadowgram.measurement import (
    AWGN,
    Measurement,
    band_means,
    capture,
    imager_from_json,
    imager_to_json,
    read_measurement,
    write_measurement,
)
from shadowgram.scenes.readers.native import read_dataset, write_dataset

CUBE = {"cube_shape": (4, 16, 20), "wavelengths": (450.0, 650.0)}


def sscsi(**changes):
    settings = {
        "detector_shape": (16, 32), "detector_pitch": 10.0, "code_pitch": 10.0, "mask_position": 0.125,
        "wavelengths": (450.0, 650.0),
    }  # fmt: skip
    return sg.SSCSI(**settings | changes)


IMAGERS = [
    sscsi(),
    sscsi(code_pitch=5.0, shear="edge", dispersion_ratio=1.1),
    sg.CASSI(**CUBE),
    sg.DualCASSI(**CUBE, band_shift=2),
    sg.ColoredCASSI(**CUBE),
]


def code_for(imager, shots=2):
    make = sg.codes.colored if len(imager.code_shape) == 3 else sg.codes.boolean
    return make(shots=shots, shape=imager.code_shape, seed=0)


def cube_for(imager, seed=0):
    return np.random.default_rng(seed).random(imager.resolution.cube_shape).astype(np.float32)


@pytest.mark.parametrize("imager", IMAGERS, ids=lambda imager: type(imager).__name__)
@pytest.mark.parametrize("noise", [None, AWGN(snr_db=30.0, seed=3)], ids=["clean", "noisy"])
def test_file_gives_back_what_was_written(imager, noise, tmp_path):
    written = capture(imager, code_for(imager), cube_for(imager), noise=noise, scene="a Tüte µm")
    write_measurement(written, tmp_path / "shots.nc", configuration='{"a": 1}')
    read = read_measurement(tmp_path / "shots.nc")
    assert (read.imager, read.noise, read.scene) == (imager, noise, "a Tüte µm")
    assert read.code.dtype == written.code.dtype
    assert np.array_equal(read.code, written.code)
    assert np.array_equal(read.snapshots, written.snapshots)
    assert read_dataset(tmp_path / "shots.nc").attrs["configuration"] == '{"a": 1}'


@pytest.mark.parametrize("imager", IMAGERS, ids=lambda imager: type(imager).__name__)
def test_capture_is_the_operator_and_the_noise(imager):
    code, cube = code_for(imager), cube_for(imager)
    clean = imager.operator(code).forward(cube)
    assert np.array_equal(capture(imager, code, cube).snapshots, clean)
    noisy = capture(imager, code, cube, noise=AWGN(snr_db=20.0, seed=1)).snapshots
    assert np.array_equal(noisy, sg.noise.awgn(clean, snr_db=20.0, seed=1))


@pytest.mark.parametrize(
    "imager",
    [sscsi(), *(kind(**CUBE, shear="exact") for kind in (sg.CASSI, sg.DualCASSI, sg.ColoredCASSI))],
    ids=lambda imager: type(imager).__name__,
)
def test_fine_bands_of_a_flat_spectrum_measure_like_coarse_ones(imager):
    # Where the spectrum is constant within each band, the exact model makes no error, whatever the scene.
    code, coarse = code_for(imager), cube_for(imager)
    fine = capture(imager, code, np.repeat(coarse, 5, axis=0), fine=True).snapshots
    assert np.allclose(fine, capture(imager, code, coarse).snapshots, rtol=2e-5, atol=2e-5)


def test_fine_measurement_does_not_depend_on_the_model_of_the_reconstruction():
    fine = np.random.default_rng(0).random((12, 16, 32))
    exact, edge = (capture(sscsi(shear=shear), code_for(sscsi()), fine, fine=True) for shear in ("exact", "edge"))
    assert np.array_equal(exact.snapshots, edge.snapshots)


def test_band_means_of_bands_that_do_not_divide():
    # 3 fine bands onto 2: the middle one is shared.
    imager = sg.CASSI(cube_shape=(2, 1, 1), wavelengths=(400, 700))
    values = np.array([1.0, 2.0, 6.0], np.float32).reshape(3, 1, 1)
    got = band_means(values, imager)
    assert got.dtype == np.float32
    assert np.allclose(got.ravel(), [(1 + 0.5 * 2) / 1.5, (0.5 * 2 + 6) / 1.5])


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, bool, np.float64])
def test_cubes_of_whole_numbers_measure_and_average_like_others(dtype):
    whole = np.arange(8 * 16 * 20).reshape(8, 16, 20) % 2
    imager = sg.CASSI(**CUBE)
    means = band_means(whole.astype(dtype), imager)
    assert means.dtype == (np.float64 if dtype is np.float64 else np.float32)
    np.testing.assert_allclose(means, whole.reshape(4, 2, 16, 20).mean(axis=1), rtol=1e-6)
    fine = capture(imager, code_for(imager), whole.astype(dtype), fine=True).snapshots
    np.testing.assert_allclose(
        fine, capture(imager, code_for(imager), whole.astype(np.float64), fine=True).snapshots, rtol=1e-5, atol=1e-6
    )


def spoiled(value):
    cube = cube_for(sscsi())
    cube[1, 2, 3] = value
    return cube


@pytest.mark.parametrize(
    ("cube", "fine", "message"),
    [
        (spoiled(np.nan), False, "1 of 2048 values are NaN or infinite"),
        (spoiled(np.inf), False, "1 of 2048 values are NaN or infinite"),
        (np.zeros((5, 16, 32)), False, "the imager resolves 4 bands, the cube has 5"),
        (np.zeros((4, 16, 31)), False, "the imager sees 16 × 32 pixels"),
        (np.zeros((16, 32)), False, "datacube"),
        (np.zeros((8, 16, 31)), True, "n × n pixels a detector element of 16 × 32"),
        (np.zeros((8, 24, 48)), True, "n × n pixels a detector element of 16 × 32"),
        (np.full((8, 16, 32), np.nan), True, "4096 of 4096 values are NaN or infinite"),
        (np.zeros((4, 16, 32), complex), False, "real numbers"),
        (
            sg.scenes.as_datacube(np.zeros((4, 16, 32)), (900, 1100)),
            False,
            "give the imager the wavelengths of the cube",
        ),
    ],
)
def test_wrong_cube_is_refused(cube, fine, message):
    with pytest.raises((ValueError, TypeError), match=message):
        capture(sscsi(), code_for(sscsi()), cube, fine=fine)


@pytest.mark.parametrize(
    ("bands", "pupil", "message"), [(7, 0.0, "a multiple of the imager's 4 bands, the cube has 7"), (8, 5.0, "pupil")]
)
def test_what_a_cassi_cannot_measure_finely(bands, pupil, message):
    imager = sg.CASSI(**CUBE)
    with pytest.raises(ValueError, match=message):
        capture(imager, code_for(imager), np.zeros((bands, 16, 20)), fine=True, pupil=pupil)


def test_a_finite_aperture_needs_a_finely_resolved_scene_and_blurs_its_code():
    imager = sscsi()
    fine = np.ones((8, 32, 64))
    sharp, soft = (capture(imager, code_for(imager), fine, fine=True, pupil=p).snapshots for p in (0.0, 400.0))
    assert np.abs(np.diff(soft, axis=1)).mean() < 0.7 * np.abs(np.diff(sharp, axis=1)).mean()
    with pytest.raises(ValueError, match="measure with fine=True"):
        capture(imager, code_for(imager), cube_for(imager), pupil=5.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"snapshots": np.zeros((3, 16, 32))}, "check the number of shots"),
        ({"snapshots": np.full((2, 16, 32), np.nan)}, "NaN or infinite"),
        ({"snapshots": np.zeros((2, 16, 32), complex)}, "real numbers"),
        ({"code": np.ones((2, 16, 31))}, "the code must have the shape"),
        ({"code": np.full((2, 16, 32), 255)}, "divide an 8-bit code by 255"),
    ],
)
def test_measurement_checks_that_its_parts_fit(changes, message):
    parts = {"imager": sscsi(), "code": code_for(sscsi()), "snapshots": np.zeros((2, 16, 32))}
    with pytest.raises((ValueError, TypeError), match=message):
        Measurement(**parts | changes)


def test_snapshots_of_a_camera_become_floats():
    counts = np.full((2, 16, 32), 4095, np.uint16)
    taken = Measurement(imager=sscsi(), code=code_for(sscsi()), snapshots=counts).snapshots
    assert taken.dtype == np.float32
    assert taken.max() == 4095


@pytest.mark.parametrize("imager", IMAGERS, ids=lambda imager: type(imager).__name__)
def test_imager_survives_json(imager):
    assert imager_from_json(imager_to_json(imager)) == imager


GOOD = json.loads(imager_to_json(sg.CASSI(**CUBE)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not a JSON object"),
        ("[" * 100_000, "not a JSON object"),
        ("[]", "not a JSON object"),
        ("{}", "must be one of SSCSI, CASSI, DualCASSI, ColoredCASSI"),
        (json.dumps(GOOD | {"type": "os.system"}), "must be one of SSCSI"),
        (json.dumps(GOOD | {"type": ["CASSI"]}), "must be one of SSCSI"),
        (json.dumps(GOOD | {"surprise": 1}), "CASSI has no parameter 'surprise'"),
        (json.dumps(GOOD | {"pitch": "10"}), "CASSI: pitch: Input should be a valid number"),
        (json.dumps(GOOD | {"pitch": -10.0}), "pitch must be a positive length"),
        (json.dumps(GOOD | {"cube_shape": [4, 16]}), "CASSI: cube_shape"),
        (json.dumps(GOOD | {"cube_shape": [4, 16, 0]}), "positive whole numbers"),
        (json.dumps(GOOD | {"cube_shape": [4, 16, 2.5]}), "CASSI: cube_shape"),
        (json.dumps(GOOD | {"wavelengths": [650, 450]}), "ascending"),
        (json.dumps(GOOD | {"wavelengths": [450, float("nan")]}), "wavelengths"),
        (json.dumps({"type": "CASSI"}), "CASSI: cube_shape"),
        (imager_to_json(sscsi()).replace('"bands": null', '"bands": 100000000'), "more than 10000;"),
        (
            imager_to_json(sscsi()).replace('"dispersion_ratio": 1.0', '"dispersion_ratio": 1e9'),
            "more than 10000;",
        ),
    ],
)
def test_hostile_description_of_an_imager(text, message):
    with pytest.raises(ValueError, match=message) as caught:
        imager_from_json(text)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


def with_attributes(dataset, **changes):
    return dataset.assign_attrs(**changes)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: with_attributes(d, kind="cube"), "is not a measurement"),
        (lambda d: d.drop_vars("code"), "is not a measurement"),
        (lambda d: with_attributes(d, imager=7), "its imager is not text"),
        (lambda d: with_attributes(d, imager="{}"), "the imager must be one of"),
        (lambda d: with_attributes(d, noise='{"snr_db": 1}'), "AWGN: seed"),
        (lambda d: with_attributes(d, noise='{"snr_db": 1, "seed": 1, "x": 2}'), "no parameter 'x'"),
        (lambda d: with_attributes(d, noise="7"), "the noise is not a JSON object"),
        (lambda d: with_attributes(d, noise="nonsense"), "the noise is not a JSON object"),
        (lambda d: d.isel(shot=slice(0, 1)).assign(code=d["code"].rename(shot="other")), "check the number of shots"),
        (lambda d: d.assign(snapshots=d["snapshots"] * np.inf), "NaN or infinite"),
        (lambda d: d.assign(code=d["code"] + 7), "transmittance must lie in"),
    ],
)
def test_file_with_wrong_contents(change, message, tmp_path):
    path = tmp_path / "shots.nc"
    write_measurement(capture(sscsi(), code_for(sscsi()), 1 + cube_for(sscsi())), path)
    write_dataset(change(read_dataset(path)), path)
    with pytest.raises(ValueError, match=message) as caught:
        read_measurement(path)
    assert "\n" not in str(caught.value)


def test_cube_file_is_not_a_measurement(tmp_path):
    path = tmp_path / "cube.nc"
    write_dataset(xr.Dataset({"snapshots": (("y", "x"), np.ones((3, 4)))}), path)
    with pytest.raises(ValueError, match=r"cube\.nc is not a measurement"):
        read_measurement(path)


def test_measurement_reconstructs_with_another_model():
    measurement = capture(sscsi(), code_for(sscsi()), cube_for(sscsi()))
    other = dataclasses.replace(measurement, imager=sscsi(shear="edge"))
    assert not np.allclose(other.operator.forward(cube_for(sscsi())), measurement.snapshots, rtol=1e-2)
