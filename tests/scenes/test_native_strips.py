"""Native files written and read in parts."""

import os
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
import xarray as xr

from shadowgram import scenes
from shadowgram.scenes.readers import native
from shadowgram.scenes.readers.native import read_dataset, write_dataset
from shadowgram.scenes.readers.native_parts import read_part, write_rows


def a_cube(rows=700, columns=513):
    """Of more than one chunk along y."""
    values = np.random.default_rng(0).random((3, rows, columns), np.float32)
    return scenes.as_datacube(values, (450, 650), "scene").assign_attrs(configuration="as it was")


def shape_of(cube):
    """The cube with no values of its own."""
    return cube.copy(data=np.broadcast_to(np.float32(0), cube.shape)).to_dataset(name=cube.name)


def test_written_by_rows_reads_like_the_whole_and_is_always_the_same(tmp_path):
    cube = a_cube()
    asked = []

    def rows(start, stop):
        asked.append((start, stop))
        return cube.values[:, start:stop]

    write_rows(shape_of(cube), tmp_path / "rows.nc", "scene", rows)
    assert len(asked) > 1
    assert asked[0][0] == 0
    assert asked[-1][1] == 700
    assert all(before[1] == after[0] for before, after in pairwise(asked))
    assert scenes.read(tmp_path / "rows.nc").identical(cube)
    assert 0.99 * cube.nbytes < (tmp_path / "rows.nc").stat().st_size < native.stored_bytes(cube.to_dataset())
    assert [p.name for p in sorted(tmp_path.iterdir())] == ["rows.nc"]
    # Nothing in a file depends on the time or the way it was made, so that a resumed work ends in the same bytes.
    write_rows(shape_of(cube), tmp_path / "again.nc", "scene", rows, temporary=tmp_path / "part")
    assert (tmp_path / "again.nc").read_bytes() == (tmp_path / "rows.nc").read_bytes()


def test_large_datasets_are_made_on_the_disk(tmp_path, monkeypatch):
    cube = a_cube()
    monkeypatch.setattr(native, "IN_MEMORY", 1000)
    monkeypatch.setattr(native, "_image", None)
    write_dataset(cube.to_dataset(), tmp_path / "cube.nc")
    assert scenes.read(tmp_path / "cube.nc").identical(cube)


def test_another_axis_and_whole_numbers(tmp_path):
    code = np.random.default_rng(1).integers(0, 2, (2, 1500, 900)).astype(np.uint8)
    like = xr.Dataset(
        {
            "code": (("shot", "code_y", "code_x"), np.broadcast_to(np.uint8(0), code.shape)),
            "snapshots": (("shot", "y", "x"), np.ones((2, 4, 5))),
        }
    )
    write_rows(like, tmp_path / "shots.nc", "code", lambda a, b: code[:, a:b], axis="code_y")
    found = read_dataset(tmp_path / "shots.nc")
    assert np.array_equal(found["code"].values, code)
    assert found["code"].dtype == np.uint8
    assert np.array_equal(found["snapshots"].values, np.ones((2, 4, 5)))


@pytest.mark.parametrize("where", [(0, 1), (63, 65), (500, 700)])
def test_part_equals_the_rows_of_the_whole(tmp_path, where):
    cube = a_cube()
    scenes.write(cube, tmp_path / "cube.nc")
    part = read_part(tmp_path / "cube.nc", {"y": slice(*where)})
    assert part.identical(read_dataset(tmp_path / "cube.nc").isel(y=slice(*where)))


def test_part_of_a_damaged_or_foreign_file_is_refused(tmp_path):
    path = tmp_path / "cube.nc"
    scenes.write(a_cube(64, 64), path)
    with pytest.raises(ValueError, match="axis 'y' has the length 64; there is no part from 60 to 65"):
        read_part(path, {"y": slice(60, 65)})
    whole = path.read_bytes()
    path.write_bytes(whole[:-64])
    with pytest.raises(ValueError, match="has no checksum"):
        read_part(path, {"y": slice(0, 4)})
    damaged = bytearray(whole)
    damaged[-100_000 % len(whole) if len(whole) > 100_000 else len(whole) // 2] ^= 1
    path.write_bytes(damaged)
    with pytest.raises(ValueError, match="damaged"):
        read_part(path, {"y": slice(0, 4)})


def test_what_goes_wrong_in_the_middle_leaves_the_old_file(tmp_path):
    cube, path = a_cube(), tmp_path / "cube.nc"
    scenes.write(cube, path)
    old = path.read_bytes()

    def broken(start, stop):
        if start > 0:
            raise RuntimeError("no more rows")
        return cube.values[:, start:stop]

    with pytest.raises(RuntimeError, match="no more rows"):
        write_rows(shape_of(cube), path, "scene", broken)
    with pytest.raises(ValueError, match=r"rows 0 to \d+ must have the shape"):
        write_rows(shape_of(cube), path, "scene", lambda a, b: cube.values[:, a : b - 1])
    with pytest.raises(OSError, match="there is no folder"):
        write_rows(shape_of(cube), tmp_path / "nowhere" / "cube.nc", "scene", lambda a, b: cube.values[:, a:b])
    assert path.read_bytes() == old
    assert len(list(tmp_path.iterdir())) == 1


FULL = """
import resource, signal, sys, numpy as np, xarray as xr
from shadowgram.scenes.readers.native_parts import write_rows
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (3_000_000, 3_000_000))
like = xr.Dataset({"a": (("y", "x"), np.broadcast_to(np.float32(0), (4000, 1000)))})
try:
    write_rows(like, sys.argv[1], "a", lambda a, b: np.ones((b - a, 1000), np.float32))
except OSError as error:
    print(error)
"""


@pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="space on the disk cannot be reserved")
def test_a_full_disk_is_one_sentence_and_nothing_is_left(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path / "a.nc")], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("cannot write")
    assert "nothing was changed" in done.stdout
    assert done.stderr == ""
    assert not list(tmp_path.iterdir())
