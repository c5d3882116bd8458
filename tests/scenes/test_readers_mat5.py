"""MATLAB 5 files against SciPy's reader and against files written by hand."""

import struct
import zlib

import numpy as np
import pytest
import scipy.sparse
from scipy.io import loadmat, savemat

from shadowgram import scenes
from shadowgram.scenes.readers.mat5 import mat5_variables

STORED = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 9, "i8": 12, "u8": 13}


def element(order, kind, content):
    return struct.pack(order + "II", kind, len(content)) + content + b"\0" * (-len(content) % 8)


def matrix(order, values, kind, stored, name=b"cube", flags=0):
    """An array of MATLAB class `kind`, stored as the NumPy type `stored`."""
    parts = [
        element(order, 6, struct.pack(order + "II", kind | flags, 0)),
        element(order, 5, struct.pack(f"{order}{values.ndim}i", *values.shape)),
        element(order, 1, name),
        element(order, STORED[stored], values.astype(order + stored).tobytes(order="F")),
    ]
    return element(order, 14, b"".join(parts))


def header(order):
    return b"MATLAB 5.0 MAT-file".ljust(124) + (b"\x00\x01IM" if order == "<" else b"\x01\x00MI")


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("dtype", ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"])
def test_numbers_that_scipy_writes(tmp_path, dtype, compressed):
    values = np.random.default_rng(0).integers(0, 100, (3, 4, 5)).astype(dtype)
    savemat(tmp_path / "a.mat", {"one": values, "two": values[0] * 2, "three": 3.5}, do_compression=compressed)
    variables = mat5_variables(tmp_path / "a.mat")
    assert list(variables) == ["one", "two", "three"]
    assert variables["one"].dtype == dtype
    loaded = variables["one"].load()
    np.testing.assert_array_equal(loaded, values)
    assert loaded.dtype == dtype
    np.testing.assert_array_equal(variables["two"].load(), values[0] * 2)
    np.testing.assert_array_equal(variables["three"].load(), [[3.5]])


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize(
    ("kind", "stored", "dtype"),
    [
        (6, "f8", "f8"),
        (6, "u1", "u1"),
        (6, "u2", "u2"),
        (6, "i2", "f8"),
        (6, "i4", "f8"),
        (7, "u1", "f4"),
        (12, "u1", "i4"),
    ],
)
def test_numbers_that_matlab_writes(tmp_path, order, compressed, kind, stored, dtype):
    values = np.arange(24).reshape(2, 3, 4)
    body = matrix(order, values, kind, stored)
    if compressed:
        squeezed = zlib.compress(body)
        body = struct.pack(order + "II", 15, len(squeezed)) + squeezed
    (tmp_path / "a.mat").write_bytes(header(order) + body)
    loaded = mat5_variables(tmp_path / "a.mat")["cube"].load()
    assert loaded.dtype == dtype
    np.testing.assert_array_equal(loaded, values)
    np.testing.assert_array_equal(loadmat(tmp_path / "a.mat")["cube"], values)


@pytest.mark.parametrize(("kind", "flags"), [(6, 0), (9, 0x200)])
def test_zeros_and_ones_are_no_image_of_8_bits(tmp_path, kind, flags):
    values = np.arange(24).reshape(2, 3, 4) % 2
    (tmp_path / "a.mat").write_bytes(header("<") + matrix("<", values, kind, "u1", flags=flags))
    cube = scenes.read(tmp_path / "a.mat", variable="cube", axes="band,y,x", wavelengths=(400, 700))
    np.testing.assert_array_equal(cube, values)


def test_what_is_no_array_is_named(tmp_path):
    savemat(
        tmp_path / "a.mat",
        {
            "sparse": scipy.sparse.eye_array(3).tocsc(),
            "cell": np.array([1, "a"], object),
            "struct": {"field": 1},
            "complex": np.zeros((2, 2, 2), complex),
            "text": "abc",
            "rows": np.array(["ab", "cd"]),
        },
    )
    variables = mat5_variables(tmp_path / "a.mat")
    assert variables["text"].load() == "abc"
    for name, words in (
        ("sparse", "sparse array; save full"),
        ("cell", "cell array"),
        ("struct", "struct; save its fields"),
        ("complex", "complex numbers"),
        ("rows", "text"),
    ):
        with pytest.raises(ValueError, match=words):
            scenes.read(tmp_path / "a.mat", variable=name)
    with pytest.raises(ValueError, match=r"no array of three axes in it; it holds 'sparse' \(a sparse array"):
        scenes.read(tmp_path / "a.mat")


def test_sizes_are_not_trusted(tmp_path):
    cases = {
        "declares an array of .* GiB": matrix("<", np.zeros((2, 2, 2)), 6, "f8").replace(
            struct.pack("<3i", 2, 2, 2), struct.pack("<3i", 2**20, 2**20, 2)
        ),
        "do not have the size": matrix("<", np.zeros((2, 2, 2)), 6, "f8").replace(
            struct.pack("<3i", 2, 2, 2), struct.pack("<3i", 2, 2, 3)
        ),
        "name or the size": matrix("<", np.zeros((2, 2, 2)), 6, "f8").replace(
            struct.pack("<3i", 2, 2, 2), struct.pack("<3i", 2, -2, 2)
        ),
        "longer than the file": matrix("<", np.zeros((2, 2, 2)), 6, "f8")[:-8],
        "middle of a variable": matrix("<", np.zeros((2, 2, 2)), 6, "f8") + b"\0\0\0",
        "do.* not fit": matrix("<", np.zeros((2, 2, 2)), 9, "f8"),
    }
    for message, body in cases.items():
        (tmp_path / "a.mat").write_bytes(header("<") + body)
        with pytest.raises(ValueError, match=message):
            scenes.read(tmp_path / "a.mat", axes="band,y,x", variable="cube", wavelengths=(400, 700))


def test_a_bomb_is_not_inflated(tmp_path):
    body = matrix("<", np.zeros((2, 2, 2)), 6, "f8")
    huge = struct.pack("<II", 14, 2**31) + body[8:] + b"\0" * 400_000
    for content, message in ((huge, "GiB"), (body + b"\0" * 10_000_000, "wrong length")):
        squeezed = zlib.compress(content)
        (tmp_path / "a.mat").write_bytes(header("<") + struct.pack("<II", 15, len(squeezed)) + squeezed)
        with pytest.raises(ValueError, match=message):
            scenes.read(tmp_path / "a.mat", axes="band,y,x", variable="cube", wavelengths=(400, 700))


def test_the_checksum_of_compressed_values_counts(tmp_path):
    squeezed = bytearray(zlib.compress(matrix("<", np.zeros((2, 2, 2)), 6, "f8")))
    squeezed[-1] ^= 1
    (tmp_path / "a.mat").write_bytes(header("<") + struct.pack("<II", 15, len(squeezed)) + bytes(squeezed))
    with pytest.raises(ValueError, match="incorrect data check"):
        scenes.read(tmp_path / "a.mat", axes="band,y,x", variable="cube", wavelengths=(400, 700))
