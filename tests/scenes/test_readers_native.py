"""The native file: exact, readable by others, never half-written, and never wrong in silence."""

import errno
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5netcdf
import h5py
import hypothesis.extra.numpy as arrays
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from shadowgram import scenes
from shadowgram.scenes.readers import atomic
from shadowgram.scenes.readers.native import read_dataset, write_dataset


@pytest.fixture
def dataset():
    rng = np.random.default_rng(0)
    return xr.Dataset(
        {
            "snapshots": (("shot", "y", "x"), rng.random((2, 5, 6), np.float32), {"units": "1", "n": 3, "f": 0.1}),
            "code": (("shot", "y", "x"), rng.integers(0, 2, (2, 5, 6), np.uint8)),
            "open": (("y", "x"), rng.random((5, 6)) > 0.5),
            "gain": 2.5,
        },
        coords={
            "wavelength": ("band", [400.0, 500.0, 700.0], {"units": "nm"}),
            "y": np.arange(5, dtype=np.int32),
            "angle": ("shot", np.array([0.1, 0.2], np.float32)),
            "time": 7.0,
        },
        attrs={
            "imager": '{"kind": "SSCSI", "shear": "exact"}',
            "edges": np.array([1.5]),
            "half": np.float32(0.5),
            "none": "",
        },
    )


def same(a, b):
    """Identical, with the same types of values and attributes."""
    xr.testing.assert_identical(a, b)
    assert set(a.coords) == set(b.coords)
    for name in a.variables:
        assert a[name].dtype == b[name].dtype, name
        for key, value in a[name].attrs.items():
            assert type(b[name].attrs[key]) is type(value)


def test_round_trip(dataset, tmp_path):
    write_dataset(dataset, tmp_path / "a.nc")
    same(dataset, read_dataset(tmp_path / "a.nc"))
    assert [one.name for one in tmp_path.iterdir()] == ["a.nc"]


numbers = st.one_of(
    arrays.integer_dtypes(endianness="="),
    arrays.unsigned_integer_dtypes(endianness="="),
    arrays.floating_dtypes(sizes=(32, 64)),
    arrays.boolean_dtypes(),
)
texts = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20)
words = st.from_regex(r"[A-Za-z_é][A-Za-z0-9_.-]{0,8}", fullmatch=True).filter(
    lambda one: one not in ("CLASS", "NAME", "coordinates", "dtype")
)
attributes = st.dictionaries(words, texts | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False), max_size=4)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_whatever_goes_in_comes_out(data):
    sizes = data.draw(st.dictionaries(words, st.integers(1, 5), min_size=1, max_size=3))
    names = data.draw(st.lists(words.filter(lambda one: one not in sizes), max_size=4, unique=True))
    variables = {}
    for name in names:
        dims = data.draw(st.lists(st.sampled_from(sorted(sizes)), unique=True))
        values = data.draw(arrays.arrays(data.draw(numbers), [sizes[one] for one in dims]))
        variables[name] = xr.Variable(dims, values, data.draw(attributes))
    dataset = xr.Dataset(variables, attrs=data.draw(attributes))
    dataset = dataset.set_coords(data.draw(st.lists(st.sampled_from(names), unique=True)) if names else [])
    with tempfile.TemporaryDirectory() as folder:
        write_dataset(dataset, Path(folder) / "a.nc")
        same(dataset, read_dataset(Path(folder) / "a.nc"))


def test_other_software_reads_it(dataset, tmp_path):
    write_dataset(dataset, tmp_path / "a.nc")
    with xr.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as opened:
        for name in dataset.variables:
            xr.testing.assert_equal(opened[name], dataset[name])
        assert set(opened.coords) == set(dataset.coords)
        assert opened.attrs["imager"] == dataset.attrs["imager"]
    with h5netcdf.File(tmp_path / "a.nc") as opened:
        np.testing.assert_array_equal(opened["snapshots"][...], dataset.snapshots)
    with h5py.File(tmp_path / "a.nc") as opened:
        np.testing.assert_array_equal(opened["code"][...], dataset.code)
        assert all(one.fletcher32 for one in opened.values() if one.ndim and "NAME" not in one.attrs)


def test_what_other_software_wrote_is_read(dataset, tmp_path):
    dataset.to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    back = read_dataset(tmp_path / "a.nc")
    xr.testing.assert_equal(dataset, back)
    assert back.open.dtype == bool
    write_dataset(back, tmp_path / "b.nc")
    same(back, read_dataset(tmp_path / "b.nc"))


def test_a_copy_by_other_software_is_theirs(dataset, tmp_path):
    write_dataset(dataset, tmp_path / "a.nc")
    with xr.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as opened:
        opened.to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
    xr.testing.assert_equal(dataset, read_dataset(tmp_path / "b.nc"))


@pytest.mark.parametrize("packing", [{"scale_factor": 0.5, "add_offset": 1.0, "_FillValue": 99}, {}])
def test_packed_values_are_unpacked(tmp_path, packing):
    with h5netcdf.File(tmp_path / "a.nc", "w") as file:
        file.dimensions = {"wl": 2, "lat": 3, "lon": 4}
        stored = file.create_variable("cube", ("lat", "lon", "wl"), np.int16)
        stored[...] = np.arange(24).reshape(3, 4, 2)
        stored.attrs.update(packing)
        file.create_variable("wl", ("wl",), np.float64)[...] = [450, 550]
    with pytest.warns(UserWarning, match="wavelengths from 'wl'"):
        cube = scenes.read(tmp_path / "a.nc")
    expected = np.arange(24).reshape(3, 4, 2).transpose(2, 0, 1)
    np.testing.assert_array_equal(cube, expected * 0.5 + 1 if packing else expected)
    if packing:
        with h5netcdf.File(tmp_path / "a.nc", "a") as file:
            file["cube"][0, 0, 0] = 99
        with pytest.raises(ValueError, match="1 values that are NaN"):
            scenes.read(tmp_path / "a.nc", variable="cube", wavelengths=(450, 550))


def test_snapshots_of_other_software_are_no_cube(tmp_path):
    xr.Dataset({"a": (("shot", "y", "x"), np.zeros((2, 3, 4)))}).to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    with pytest.raises(ValueError, match=r"snapshots with axes \(shot, y, x\)"):
        scenes.read(tmp_path / "a.nc")


@pytest.mark.parametrize(
    ("dataset", "message"),
    [
        (xr.Dataset({"a": ("x", ["text"])}), "'a' holds <U4"),
        (xr.Dataset({"a": ("x", [1j])}), "'a' holds complex128"),
        (xr.Dataset({"a": ("x", np.zeros(2, np.float16))}), "'a' holds float16"),
        (xr.Dataset({"a": ("x", np.zeros(0))}), "axis 'x' has length 0"),
        (xr.Dataset({"a/b": ("x", [1.0])}), "without spaces and slashes, got 'a/b'"),
        (xr.Dataset({"a b": ("x", [1.0])}), "without spaces and slashes, got 'a b'"),
        (xr.Dataset({3: ("x", [1.0])}), "got 3"),
        (xr.Dataset(attrs={"a": None}), "attribute 'a' of the dataset is None"),
        (xr.Dataset(attrs={"a": True}), "attribute 'a' of the dataset is True"),
        (xr.Dataset(attrs={"a": {"b": 1}}), "attribute 'a' of the dataset"),
        (xr.Dataset(attrs={"a": ["b"]}), "write others as text"),
        (xr.Dataset(attrs={"a": "b\0"}), "write others as text"),
        (xr.Dataset({"v": ("x", [1.0], {"NAME": "b"})}), "attribute 'NAME' of 'v' cannot be kept"),
        (xr.Dataset(attrs={"coordinates": "b"}), "attribute 'coordinates' of the dataset cannot be kept"),
        (xr.Dataset({"v": ("x", [1], {"dtype": "bool"})}), "says bool but it holds int64"),
    ],
)
def test_what_cannot_be_kept_is_refused(dataset, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        write_dataset(dataset, tmp_path / "a.nc")
    assert not list(tmp_path.iterdir())


def test_every_byte_counts(tmp_path):
    """One bit flipped in every byte, one after the other, of the header, the attributes, the checksum and some values."""
    scenes.write(scenes.as_datacube(np.ones((2, 3, 4)), (400, 700)).assign_attrs(note="a" * 50), tmp_path / "a.nc")
    whole = (tmp_path / "a.nc").read_bytes()
    # Without its first bytes or those that announce the checksum it is not told from a foreign file, which another
    # process reads; the random damage of benchmarks/fuzz_readers.py covers these.
    for at in range(8, len(whole) - 64, 7):
        (tmp_path / "b.nc").write_bytes(whole[:at] + bytes([whole[at] ^ 4]) + whole[at + 1 :])
        with pytest.raises(ValueError, match="do not match the checksum"):
            scenes.read(tmp_path / "b.nc")


@pytest.mark.parametrize(
    "damage", [lambda b: b[:-64], lambda b: b[:-65], lambda b: b + b"\0", lambda b: b[:-64] + b"\0" * 64]
)
def test_a_lost_checksum_is_noticed(tmp_path, damage):
    scenes.write(scenes.as_datacube(np.ones((2, 3, 4)), (400, 700)), tmp_path / "a.nc")
    (tmp_path / "a.nc").write_bytes(damage((tmp_path / "a.nc").read_bytes()))
    for read in (scenes.read, read_dataset):
        with pytest.raises(ValueError, match=r"cannot read .*a.nc: .*damaged"):
            read(tmp_path / "a.nc")


def test_a_changed_file_is_noticed(tmp_path):
    scenes.write(scenes.as_datacube(np.ones((2, 3, 4)), (400, 700)), tmp_path / "a.nc")
    with h5py.File(tmp_path / "a.nc", "r+") as file:
        file["datacube"][0, 0, 0] = 2
    with pytest.raises(ValueError, match="other software changed it"):
        scenes.read(tmp_path / "a.nc")


WRITER = """
import sys, itertools
import numpy as np
from shadowgram import scenes
cubes = [scenes.as_datacube(np.full((8, 64, 64), value), (400, 700)) for value in (1.0, 2.0)]
for count in itertools.count():
    scenes.write(cubes[count % 2], sys.argv[1])
    if count == 3:
        print("ready", flush=True)
"""


@pytest.mark.parametrize("suffix", [".nc", ".npz"])
def test_killed_while_writing(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    for wait in (0.0, 0.011, 0.027, 0.05):
        with subprocess.Popen([sys.executable, "-c", WRITER, path], stdout=subprocess.PIPE) as writer:
            assert writer.stdout is not None
            assert writer.stdout.readline() == b"ready\n"
            time.sleep(wait)
            writer.send_signal(signal.SIGKILL)
        cube = scenes.read(path, variable="datacube")
        assert cube.shape == (8, 64, 64)
        assert float(cube.min()) == float(cube.max()) in (1.0, 2.0)


@pytest.mark.parametrize("suffix", [".nc", ".npz", ".npy", ".mat"])
def test_a_full_disk(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    cube = scenes.as_datacube(np.ones((8, 64, 64)), (400, 700))
    scenes.write(cube, path)
    before = path.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, limits[1]))
    try:
        with pytest.raises(OSError, match=rf"cannot write .*a{suffix}: File too large; nothing was changed"):
            scenes.write(cube * 2, path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_no_space_left(tmp_path, monkeypatch):
    def full(descriptor):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(atomic.os, "fsync", full)
    with pytest.raises(OSError, match=r"cannot write .*a.nc: No space left on device; nothing was changed"):
        scenes.write(scenes.as_datacube(np.ones((2, 2, 2)), (400, 700)), tmp_path / "a.nc")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(os.geteuid() == 0, reason="permissions do not bind root")
def test_a_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "locked").mkdir(mode=0o500)
    with pytest.raises(PermissionError, match=r"cannot write .*locked/a.nc: Permission denied; nothing was changed"):
        scenes.write(scenes.as_datacube(np.ones((2, 2, 2)), (400, 700)), tmp_path / "locked/a.nc")


def test_targets_that_are_no_files(tmp_path):
    cube = scenes.as_datacube(np.ones((2, 2, 2)), (400, 700))
    with pytest.raises(FileNotFoundError, match=r"cannot write .*: there is no folder"):
        scenes.write(cube, tmp_path / "absent/a.nc")
    (tmp_path / "a.nc").mkdir()
    with pytest.raises(OSError, match="it is a folder or a device"):
        scenes.write(cube, tmp_path / "a.nc")


def test_links_and_permissions_stay(tmp_path):
    cube = scenes.as_datacube(np.ones((2, 2, 2)), (400, 700))
    scenes.write(cube, tmp_path / "a.nc")
    (tmp_path / "a.nc").chmod(0o640)
    (tmp_path / "link.nc").symlink_to("a.nc")
    scenes.write(cube * 2, tmp_path / "link.nc")
    assert (tmp_path / "link.nc").is_symlink()
    assert (tmp_path / "a.nc").stat().st_mode & 0o777 == 0o640
    assert scenes.read(tmp_path / "a.nc").max() == 2
