"""The journal: what goes in comes out, once and unchanged; what is not a whole journal is refused and left as it is."""

import dataclasses
import os
import sqlite3
import subprocess

import numpy as np
import pytest

from shadowgram.experiments.journal import FILE_NAME, Entry, open_journal, pack_arrays, read_journal, unpack_arrays
from shadowgram.experiments.source import generated

ARRAYS = {
    "curve": np.linspace(0, 1, 7, dtype=np.float32),
    "file": np.arange(6).reshape(2, 3),
    "name": np.array(["a", "β"]),
    "truth": np.array(True),
}


def entry(key="k", number=1, seed=3):
    spec = f'{{"number": {number}, "seed": {seed}}}'
    return Entry(
        key=key,
        study="little",
        revision=2,
        scene=generated(),
        spec=spec,
        result='{"psnr": 31.5, "curve": [1, 2], "best": Infinity}',
        arrays=pack_arrays(ARRAYS),
        version="0.1.0",
        commit="abc",
        host="here",
        started="2026-01-02T03:04:05.000+00:00",
        seconds=1.25,
    )


@pytest.mark.parametrize(("seed", "seconds"), [("9999999999999999999999", 1.25), ("true", 1.25), ("3", 2)])
def test_numbers_that_sqlite_would_change_come_back(seed, seconds, tmp_path):
    one = dataclasses.replace(entry(), spec=f'{{"seed": {seed}}}', seconds=seconds)
    with open_journal(tmp_path) as journal:
        assert journal.add(one)
        assert journal.records(["k"])["k"].seconds == seconds


@pytest.fixture
def folder(tmp_path):
    """A folder with a journal of three records."""
    with open_journal(tmp_path) as journal:
        for number in range(3):
            assert journal.add(entry(f"k{number}", number))
    return tmp_path


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 512 kB."""
    if os.name != "posix" or os.geteuid() != 0:
        pytest.skip("only root can make a file system")
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=512k", "tmpfs", disk], capture_output=True).returncode:
        pytest.skip("no file system can be mounted here")
    yield disk
    subprocess.run(["umount", "-l", disk], check=True)


def test_a_record_comes_back_as_it_went_in(folder):
    with read_journal(folder) as journal:
        found = journal.records(["k1", "nothing", "k0"])
    assert list(found) == ["k1", "k0"]
    record = found["k1"]
    assert record.spec == {"number": 1, "seed": 3}
    assert record.values == {"psnr": 31.5, "curve": [1, 2], "best": float("inf")}
    assert record.seconds == 1.25
    assert record.arrays.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert record.arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(record.arrays[name], array)


def test_other_programs_can_read_where_a_record_comes_from(folder):
    row = sqlite3.connect(folder / FILE_NAME).execute(
        "SELECT study, revision, scene, scene_digest, seed, version, code_commit, host, started FROM records WHERE key = 'k0'"
    )
    started = "2026-01-02T03:04:05.000+00:00"
    assert row.fetchone() == ("little", 2, "chart", "chart-0", 3, "0.1.0", "abc", "here", started)


def test_a_record_is_never_replaced(folder):
    with open_journal(folder) as journal:
        assert not journal.add(dataclasses.replace(entry("k0"), result="{}"))
        assert journal.records(["k0"])["k0"].values["psnr"] == 31.5


def test_scenes_of_the_records(folder):
    with read_journal(folder) as journal:
        assert journal.scenes("little", 2) == [generated()]
        assert journal.scenes("little", 1) == []
        assert journal.scenes("large", 2) == []


def test_a_failure_is_forgotten_when_the_task_succeeds(folder):
    with open_journal(folder) as journal:
        journal.add_failure("k9", "little", "{}", "first", "now")
        journal.add_failure("k9", "little", "{}", "second", "now")
        assert journal.failures(["k9", "k0"]) == {"k9": "second"}
        assert journal.seconds("k9") is None
        journal.add(entry("k9"))
        assert journal.failures(["k9"]) == {}


def test_two_writers_at_once(folder):
    with open_journal(folder) as one, open_journal(folder) as two:
        assert one.add(entry("new"))
        assert not two.add(entry("new"))
        assert two.add(entry("newer"))
        assert one.seconds("newer") == 1.25


def test_a_new_file_may_be_empty(tmp_path):
    (tmp_path / FILE_NAME).touch()  # what is left of a driver that was killed as it began
    with open_journal(tmp_path) as journal:
        assert journal.add(entry())


@pytest.mark.parametrize("read", [open_journal, read_journal])
def test_a_journal_of_another_version_is_refused(folder, read):
    connection = sqlite3.connect(folder / FILE_NAME)
    connection.execute("PRAGMA user_version = 7")
    connection.close()
    before = (folder / FILE_NAME).read_bytes()
    with pytest.raises(ValueError, match="is a journal of version 7, and this shadowgram knows version 1"):
        read(folder)
    assert (folder / FILE_NAME).read_bytes() == before


def other_database():
    connection = sqlite3.connect(":memory:")
    connection.execute("CREATE TABLE records (key TEXT PRIMARY KEY)")
    return connection.serialize()


@pytest.mark.parametrize("read", [open_journal, read_journal])
@pytest.mark.parametrize("content", [b"hello", b"\x89PNG" * 1000, bytes(5000), other_database()])
def test_another_file_is_refused_and_left_alone(tmp_path, content, read):
    (tmp_path / FILE_NAME).write_bytes(content)
    with pytest.raises(ValueError, match=r"journal\.sqlite is not a journal of shadowgram"):
        read(tmp_path)
    assert (tmp_path / FILE_NAME).read_bytes() == content
    assert [path.name for path in tmp_path.iterdir()] == [FILE_NAME]


@pytest.mark.parametrize("read", [open_journal, read_journal])
@pytest.mark.parametrize("left", [0.1, 0.5, 0.9, 0.99])
def test_a_truncated_journal_is_refused_and_left_alone(folder, left, read):
    path = folder / FILE_NAME
    whole = path.read_bytes()
    path.write_bytes(whole[: int(left * len(whole))])
    before = path.read_bytes()
    with pytest.raises(ValueError, match=r"journal\.sqlite is (damaged and was left as it is|not a journal)"):
        read(folder)
    assert path.read_bytes() == before


def test_no_damaged_byte_goes_unnoticed(folder):
    path = folder / FILE_NAME
    whole = path.read_bytes()
    keys = ["k0", "k1", "k2"]
    random = np.random.default_rng(0)
    with read_journal(folder) as journal:
        true = journal.records(keys)
    refused = 0
    for place in random.choice(len(whole), 300, replace=False):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << random.integers(8)
        path.write_bytes(damaged)
        try:
            with read_journal(folder) as journal:
                found = journal.records(keys)
        except (ValueError, OSError):
            refused += 1
            continue
        for key, record in found.items():  # a flip in unused space; a lost key is computed again
            assert record.values == true[key].values
            assert record.spec == true[key].spec
            assert record.seconds == true[key].seconds
            for name, array in ARRAYS.items():
                np.testing.assert_array_equal(record.arrays[name], array)
    assert refused > 20


def test_there_is_nothing_to_read_yet(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"there is no journal .*; 'shadowgram study run' makes one"):
        read_journal(tmp_path)


def test_a_folder_that_does_not_exist(tmp_path):
    with pytest.raises(OSError, match="it cannot be opened; look at the permissions"):
        open_journal(tmp_path / "none")


def test_full_disk(small_disk):
    large = dataclasses.replace(entry("large"), arrays=bytes(600_000))
    with open_journal(small_disk) as journal:
        assert journal.add(entry("before"))
        with pytest.raises(OSError, match="the disk is full; what is in it is safe"):
            journal.add(large)
        assert journal.add(entry("after"))
    with read_journal(small_disk) as journal:
        assert list(journal.records(["before", "large", "after"])) == ["before", "after"]


@pytest.mark.parametrize("running", [False, True])
def test_a_read_only_disk_can_be_read(small_disk, running):
    with open_journal(small_disk) as journal:
        journal.add(entry("k0"))
        if running:  # no longer in the main file alone
            (small_disk / "copy").mkdir()
            for path in small_disk.glob("journal*"):
                (small_disk / "copy" / path.name).write_bytes(path.read_bytes())
    folder = small_disk / "copy" if running else small_disk
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    with read_journal(folder) as journal:
        assert list(journal.records(["k0"])) == ["k0"]
    with pytest.raises(OSError, match=r"cannot be opened|read-only"):
        open_journal(folder)


def test_arrays_are_numbers_or_text():
    assert pack_arrays({}) == b""
    assert unpack_arrays(b"") == {}
    with pytest.raises(TypeError, match="the array 'x' of a result must be a NumPy array of numbers or text"):
        pack_arrays({"x": np.array([object()])})
    with pytest.raises(TypeError, match="'x'"):
        pack_arrays({"x": [1, 2]})
