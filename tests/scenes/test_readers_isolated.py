"""MATLAB 7.3 files, the process that reads them, and random damage to files of every format."""

import io
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from shadowgram import scenes
from shadowgram.scenes.readers import hdf5_isolated

CUT_SHORT = """
import json
about = {"shape": [2, 2, 2], "dtype": "<f8", "dims": None, "attrs": {}, "matlab": "", "problem": ""}
print(json.dumps({"attrs": {}, "provenance": "", "variables": {"a": about}}), flush=True)
input()
print('{"bytes": 64}')
print("too few")
"""
FUZZ = Path(__file__).parents[2] / "benchmarks/fuzz_readers.py"


def save73(path, **variables):
    """A file as MATLAB 7.3 writes it: 512 bytes of its own, then HDF5 with the axes reversed."""
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", userblock_size=512) as file:
        for name, (values, kind) in variables.items():
            file.create_dataset(name, data=values.T).attrs["MATLAB_class"] = np.bytes_(kind)
        file.create_group("struct").attrs["MATLAB_class"] = np.bytes_("struct")
        file.create_group("sparse").attrs["MATLAB_sparse"] = np.uint64(3)
        file.create_group("#refs#")
        file["link"] = h5py.ExternalLink("/etc/passwd", "/")
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    path.write_bytes(head.ljust(512, b"\0") + buffer.getvalue()[512:])


@pytest.fixture
def image():
    return np.random.default_rng(0).integers(0, 256, (7, 8, 3), np.uint8)


def test_matlab_73(tmp_path, image):
    save73(tmp_path / "a.mat", image=(image, "uint8"), **{"lambda": (np.array([[400.0, 450, 700]]), "double")})
    with pytest.warns(UserWarning, match="axes='y,x,band'.*wavelengths from 'lambda'"):
        cube = scenes.read(tmp_path / "a.mat")
    np.testing.assert_array_equal(cube, image.transpose(2, 0, 1) / np.float32(255))
    np.testing.assert_array_equal(cube.wavelength, [400, 450, 700])


def test_matlab_73_logical(tmp_path, image):
    save73(tmp_path / "a.mat", image=(image % 2, "logical"))
    cube = scenes.read(tmp_path / "a.mat", variable="image", axes="y,x,band", wavelengths=(400, 700))
    np.testing.assert_array_equal(cube, (image % 2).transpose(2, 0, 1))


def test_what_is_no_array_is_named(tmp_path, image):
    phase = np.zeros((2, 2, 2), np.dtype([("real", "f8"), ("imag", "f8")]))
    text = np.array([[97, 98]], np.uint16)
    save73(tmp_path / "a.mat", image=(image, "uint8"), phase=(phase, "double"), text=(text, "char"))
    for name, words in (
        ("phase", "complex numbers"),
        ("text", "text"),
        ("struct", "a struct"),
        ("sparse", "a sparse array"),
        ("link", "a link to another file"),
        ("absent", "no variable 'absent' in it; it holds 'image'"),
    ):
        with pytest.raises(ValueError, match=words):
            scenes.read(tmp_path / "a.mat", variable=name)


def test_arrays_in_other_files_are_not_read(tmp_path):
    (tmp_path / "secret").write_bytes(bytes(64))
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file.create_dataset("a", (4, 4, 4), "u1", external=[(os.fspath(tmp_path / "secret"), 0, 64)])
    with pytest.raises(ValueError, match="kept in another file"):
        scenes.read(tmp_path / "a.nc", variable="a")


def test_sizes_are_not_trusted(tmp_path):
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file.create_dataset("a", (10**4, 10**4, 10**4), "f8", chunks=(100, 100, 100))
    with pytest.raises(ValueError, match="GiB in a file of"):
        scenes.read(tmp_path / "a.nc")


@pytest.mark.parametrize(
    ("child", "message"),
    [
        ("import os; os.abort()", "crashed on it"),
        (
            "import resource, signal; resource.setrlimit(resource.RLIMIT_CPU, (1, 1))\nwhile True: pass",
            "did not finish",
        ),
        ("import sys; sys.exit()", "did not finish"),
        ("print('nonsense')", "did not finish"),
        ('print(\'{"error": "bad superblock"}\')', r"cannot read it \(bad superblock\)"),
        ("print(17)", "did not finish"),
        (CUT_SHORT, "did not finish"),
    ],
)
def test_whatever_becomes_of_the_process(tmp_path, monkeypatch, image, child, message):
    save73(tmp_path / "a.mat", image=(image, "uint8"))
    (tmp_path / "_hdf5_child.py").write_text(child)
    monkeypatch.setattr(hdf5_isolated, "__file__", os.fspath(tmp_path / "hdf5_isolated.py"))
    with pytest.raises(ValueError, match=message):
        scenes.read(tmp_path / "a.mat", axes="band,y,x", wavelengths=(400, 700), variable="a")


@pytest.mark.parametrize(
    ("h5py_does", "ends", "says"),
    [
        ("while True: pass", -signal.SIGXCPU, b""),
        ("bytearray(2**31)", 0, b"needs more memory"),
        ("1 / 0", 0, b"division"),
    ],
)
def test_the_limits_of_the_process(tmp_path, h5py_does, ends, says):
    """With a h5py that misbehaves, the process itself stops at its limits."""
    (tmp_path / "h5py.py").write_text(h5py_does)
    request = {"path": "any", "modules": [os.fspath(tmp_path)], "seconds": 1, "memory": 2**30}
    child = Path(hdf5_isolated.__file__).with_name("_hdf5_child.py")
    ran = subprocess.run([sys.executable, "-I", child, json.dumps(request)], capture_output=True, check=False)
    assert ran.returncode == ends
    assert says in ran.stdout


@pytest.mark.skipif(not FUZZ.exists(), reason="the benchmarks are not part of this copy")
@pytest.mark.parametrize(
    ("name", "mutations"),
    [("native", 200), ("mat5", 200), ("mat73", 200), ("npy", 200), ("npz", 200), ("netcdf", 40)],
)
def test_random_damage(name, mutations):
    command = [sys.executable, FUZZ, "--formats", name, "--mutations", str(mutations), "--seed", "1", "--json"]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    result = json.loads(ran.stdout)[name]
    assert ran.returncode == 0, result["notes"]
    assert sum(result[one] for one in ("refused", "same", "changed")) == mutations
    assert result["refused"] > mutations / 4
