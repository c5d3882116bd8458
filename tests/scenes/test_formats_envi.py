"""ENVI: all types and orders, what headers leave out or say wrongly, and the pair of files."""

import warnings

import numpy as np
import pytest

from shadowgram import scenes

TYPES = {1: "u1", 2: "i2", 3: "i4", 4: "f4", 5: "f8", 12: "u2", 13: "u4", 14: "i8", 15: "u8"}
AXES = {"bsq": (0, 1, 2), "bil": (1, 0, 2), "bip": (1, 2, 0)}
VALUES = np.random.default_rng(0).integers(1, 100, (4, 5, 6))
NM = [450, 500.5, 550, 640]


def save(folder, values=VALUES, ending=".dat", *, code=4, order="bsq", swapped=0, offset=0, **said):
    """A pair of files as spectrometers write them; `said` replaces or (None) removes lines of the header."""
    stored = values.transpose(AXES[order]).astype((">" if swapped else "<") + TYPES[code])
    fields = {
        "samples": values.shape[2],
        "lines": values.shape[1],
        "bands": values.shape[0],
        "header offset": offset,
        "data type": code,
        "interleave": order,
        "byte order": swapped,
        "wavelength units": "Nanometers",
        "wavelength": "{" + ",\n ".join(map(str, NM)) + "}",
    } | {name.replace("_", " "): value for name, value in said.items()}
    text = "".join(f"{name} = {value}\n" for name, value in fields.items() if value is not None)
    (folder / "a.hdr").write_text("ENVI\n" + text)
    (folder / f"a{ending}").write_bytes(bytes(offset) + stored.tobytes())
    return folder / "a.hdr"


def quietly(path, **said):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return scenes.read(path, **said)


@pytest.mark.parametrize("order", AXES)
@pytest.mark.parametrize("code", TYPES)
@pytest.mark.parametrize("swapped", [0, 1])
def test_every_type_and_order(tmp_path, code, order, swapped):
    path = save(tmp_path, code=code, order=order, swapped=swapped, offset=7)
    cube = quietly(path)
    full = {1: 255, 12: 65535}.get(code)
    assert cube.attrs == ({"scale": full} if full else {})
    np.testing.assert_allclose(cube, VALUES / (full or 1), rtol=1e-6)
    np.testing.assert_array_equal(cube.wavelength, NM)
    assert cube.values.flags.c_contiguous
    assert cube.name == "a"


@pytest.mark.parametrize("ending", ["", ".dat", ".img", ".raw", ".bsq", ".IMG"])
def test_either_file_may_be_given(tmp_path, ending):
    path = save(tmp_path, ending=ending)
    np.testing.assert_array_equal(quietly(path), VALUES)
    np.testing.assert_array_equal(quietly(tmp_path / f"a{ending}"), VALUES)
    (tmp_path / "a.hdr").rename(tmp_path / f"a{ending}.hdr")
    np.testing.assert_array_equal(quietly(tmp_path / f"a{ending}"), VALUES)
    np.testing.assert_array_equal(quietly(tmp_path / f"a{ending}.hdr"), VALUES)


@pytest.mark.parametrize(
    ("unit", "factor", "said"),
    [
        ("Micrometers", 1000, None),
        ("um", 1000, None),
        ("µm", 1000, None),
        ("nm", 1, None),
        ("Angstroms", 0.1, None),
        (None, 1, "does not say the unit of the wavelengths: nm was taken for 450 to 640"),
        ("Unknown", 1000, "µm was taken for 0.45 to 0.64"),
        ("Wavenumber", None, "in 'Wavenumber', which is not nm or µm; they were left out"),
    ],
)
def test_units_of_wavelengths(tmp_path, unit, factor, said):
    listed = "{" + ", ".join(f"{nm / (factor or 1):.6g}" for nm in NM) + "}"
    path = save(tmp_path, wavelength=listed, wavelength_units=unit)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        cube = scenes.read(path)
    words = " ".join(str(one.message) for one in caught)
    if said is None:
        assert not words
    else:
        assert said in words
    np.testing.assert_array_equal(cube.wavelength, NM if factor else [400, 500, 600, 700])


def test_missing_wavelengths_are_guessed_in_words(tmp_path):
    path = save(tmp_path, wavelength=None)
    with pytest.warns(UserWarning, match=r"guessed wavelengths=\(400, 700\)"):
        scenes.read(path)
    assert quietly(path, wavelengths=(450, 640)).wavelength[-1] == 640


def test_scale_and_missing_values_and_bad_bands(tmp_path):
    values = VALUES * 100
    values[1, 2, 3] = values[0, 0, 0] = -9999
    said = {"reflectance_scale_factor": 10000, "data_ignore_value": -9999, "bbl": "{1, 0, 1, 0}"}
    path = save(tmp_path, values, code=2, **said)
    with pytest.warns(UserWarning, match=r"2 of 4 bands are marked as bad, and kept \(numbers 1, 3\)") as caught:
        cube = scenes.read(path)
    assert "2 of 120 values are marked as missing (data ignore value -9999); they were set to 0" in str(
        caught[0].message
    )
    assert cube.attrs == {"scale": 10000}
    assert cube.dtype == np.float32
    np.testing.assert_allclose(cube, np.where(values == -9999, 0, values / 10000), rtol=1e-6)
    lowest = save(
        tmp_path, np.where(VALUES[0, 0, 0] == VALUES, -3.4028235e38, VALUES), data_ignore_value="-3.4028235e+38"
    )
    with pytest.warns(UserWarning, match="marked as missing"):
        assert scenes.read(lowest).min() == 0


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.uint16, np.int16])
def test_there_and_back(tmp_path, dtype):
    cube = scenes.as_datacube(VALUES, np.linspace(451, 642, 4), name="scene").astype(dtype)
    scenes.write(cube, tmp_path / "a.hdr")
    back = quietly(tmp_path / "a.hdr")
    np.testing.assert_array_equal(back.wavelength, cube.wavelength)
    scale = back.attrs.get("scale", 1)
    np.testing.assert_allclose(back * scale, cube, rtol=1e-6)
    assert back.dtype == (dtype if np.dtype(dtype).kind == "f" else np.float32)
    scenes.write(cube[:2], tmp_path / "a.hdr")
    assert quietly(tmp_path / "a.dat").shape == (2, 5, 6)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.dat", "a.hdr"]


def test_a_header_never_gets_other_data(tmp_path):
    cube = scenes.as_datacube(VALUES, NM)
    scenes.write(cube, tmp_path / "a.hdr")
    (tmp_path / "a.img").write_bytes(b"other")
    with pytest.raises(ValueError, match=r"a\.img would be taken for its data"):
        scenes.write(cube, tmp_path / "a.hdr")
    np.testing.assert_array_equal(quietly(tmp_path / "a.hdr"), VALUES)  # the one of the right size
    (tmp_path / "a.img").write_bytes((tmp_path / "a.dat").read_bytes())
    with pytest.raises(ValueError, match="several files that may be its data and 2 of the right size"):
        scenes.read(tmp_path / "a.hdr")
    (tmp_path / "b.dat").mkdir()
    before = sorted(tmp_path.iterdir())
    with pytest.raises(OSError, match="nothing was changed"):
        scenes.write(cube, tmp_path / "b.hdr")
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ({"samples": 10**12}, r"declares 80000000000000 bytes \(4 × 5 × 1000000000000 float32\) but a.dat has 480"),
        ({"samples": -6}, "must have 'samples', a whole number from 1 on, got '-6'"),
        ({"samples": 0}, "a whole number from 1 on, got '0'"),
        ({"samples": "six"}, "got 'six'"),
        ({"samples": "6.0"}, "got '6.0'"),
        ({"lines": None}, "must have 'lines'"),
        ({"lines": 4}, "384 bytes .* but a.dat has 480"),
        ({"bands": "9" * 400}, "must have 'bands'"),
        ({"header_offset": -1}, "must have 'header offset'"),
        ({"data_type": 6}, "complex numbers"),
        ({"data_type": 7}, "must have a data type of 1, 2, 3"),
        ({"byte_order": 2}, "byte order = 0 or 1"),
        ({"interleave": "bqs"}, "interleave = bsq, bil or bip, got 'bqs'"),
        ({"file_compression": 1}, "compressed"),
        ({"wavelength": "{450, 500, 550}"}, "has 4 bands but 3 numbers in 'wavelength'"),
        ({"wavelength": "{450, 500, x, 640}"}, "'wavelength' in its header must be numbers"),
        ({"wavelength": "{450, 500, nan, 640}"}, "must be positive numbers"),
        ({"wavelength": "{450, 550, 500, 640}"}, "wavelengths must increase"),
        ({"bbl": "{1, 0}"}, "2 numbers in 'bbl'"),
        ({"reflectance_scale_factor": 0}, "must be positive and finite, got 0"),
        ({"reflectance_scale_factor": "1e99"}, "must be positive and finite"),
        ({"data_ignore_value": "none"}, "must be a number, got 'none'"),
        ({"major_frame_offsets": "{0, 8}"}, "major frame offsets, which are not read"),
        ({"description": "{never ends"}, "'description' of its header does not end"),
    ],
)
def test_headers_are_not_trusted(tmp_path, said, message):
    path = save(tmp_path, **said)
    with pytest.raises(ValueError, match=message) as caught:
        scenes.read(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (b"ENVI", "must have 'samples'"),
        (b"ENVIRONMENT\n", "does not begin with a line ENVI"),
        (b"ENVI\nbands = 4\nBands = 4\n", "says 'bands' twice"),
        (b"ENVI\nno equals sign\n", "is not 'name = value'"),
        (b"ENVI\nsamples = 6\0\n", "not a text"),
    ],
)
def test_headers_that_are_none(tmp_path, header, message):
    path = save(tmp_path)
    path.write_bytes(header)
    with pytest.raises(ValueError, match=message):
        scenes.read(path)


def test_data_files_that_are_not_there(tmp_path):
    path = save(tmp_path)
    (tmp_path / "a.dat").unlink()
    with pytest.raises(FileNotFoundError, match=r"there is no data file for .*a\.hdr"):
        scenes.read(path)
    (tmp_path / "a.dat").symlink_to(tmp_path / "a.dat")
    with pytest.raises(FileNotFoundError, match="no data file"):
        scenes.read(path)
    with pytest.raises(FileNotFoundError, match="there is no file"):
        scenes.read(tmp_path / "a.dat")
    path.unlink()
    (tmp_path / "a.dat").unlink()
    (tmp_path / "a.dat").write_bytes(bytes(480))
    with pytest.raises(ValueError, match="known format"):
        scenes.read(tmp_path / "a.dat")


def test_byte_order_that_is_not_said(tmp_path):
    with pytest.warns(UserWarning, match="does not say the byte order"):
        np.testing.assert_array_equal(scenes.read(save(tmp_path, byte_order=None)), VALUES)
