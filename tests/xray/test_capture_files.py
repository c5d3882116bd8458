"""Codes and counts from files: MATLAB cells of both kinds, NumPy, native scans; and files that are damaged."""

import io
import time

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from shadowgram.xray.capture_files import read_capture
from shadowgram.xray.scan import Scan
from shadowgram.xray.scan_file import write_scan
from shadowgram.xray.scene import shipped_scene

SHOTS = 12
RNG = np.random.default_rng(0)
CODES = (RNG.random((SHOTS, 5, 7)) < 0.5).astype(np.uint8)
CODES[:, 0, 0] = 1
COUNTS = RNG.integers(100, 200, SHOTS)
AIR = RNG.integers(10, 20, SHOTS)


def cells(codes):
    """A MATLAB cell array 1 × shots with a code in each cell."""
    array = np.empty((1, len(codes)), object)
    for number, code in enumerate(codes):
        array[0, number] = code
    return array


def save_hdf5_cells(path, name, codes):
    """As MATLAB writes cells in version 7.3: references to arrays whose axes are in reverse."""
    with h5py.File(path, "w", userblock_size=512) as file:
        kept = file.create_group("#refs#")
        references = []
        for number, code in enumerate(codes):
            item = kept.create_dataset(f"c{number}", data=code.T)
            item.attrs["MATLAB_class"] = np.bytes_(b"uint8")
            references.append(item.ref)
        shown = file.create_dataset(name, (len(codes), 1), h5py.ref_dtype)
        shown[:, 0] = references
        shown.attrs["MATLAB_class"] = np.bytes_(b"cell")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


@pytest.fixture
def folder(tmp_path):
    savemat(tmp_path / "codes.mat", {"code_shift": cells(CODES)}, do_compression=True)
    savemat(tmp_path / "plain.mat", {"codes_bin": cells(CODES)})
    savemat(tmp_path / "cube.mat", {"C": CODES.transpose(1, 2, 0)})
    savemat(tmp_path / "y.mat", {"y_target": COUNTS[None], "shots": float(SHOTS)})
    savemat(tmp_path / "air.mat", {"air": AIR[:, None].astype(np.int32)})
    save_hdf5_cells(tmp_path / "new.mat", "codes", CODES)
    np.savez(tmp_path / "all.npz", codes=CODES, y=COUNTS, air=AIR)
    np.savez(tmp_path / "rows.npz", codes=CODES.reshape(SHOTS, 35), counts=COUNTS)
    np.save(tmp_path / "codes.npy", CODES)
    np.save(tmp_path / "counts.npy", COUNTS)
    return tmp_path


@pytest.mark.parametrize("codes", ["codes.mat", "plain.mat", "cube.mat", "new.mat", "codes.npy"])
@pytest.mark.parametrize(("counts", "air"), [("y.mat", "air.mat"), ("counts.npy", None)])
def test_codes_and_counts_of_every_kind(folder, codes, counts, air):
    found = read_capture(folder / codes, folder / counts, air and folder / air)
    np.testing.assert_array_equal(found.codes, CODES)
    np.testing.assert_array_equal(found.counts, COUNTS)
    assert (found.background is None) == (air is None)
    if air:
        np.testing.assert_array_equal(found.background, AIR)


def test_one_file_with_everything(folder):
    found = read_capture(folder / "all.npz")
    np.testing.assert_array_equal(found.codes, CODES)
    np.testing.assert_array_equal(found.background, AIR)
    # With counts of another file its own run without target belongs to another scan.
    assert read_capture(folder / "all.npz", folder / "counts.npy").background is None
    rows = read_capture(folder / "rows.npz", shape=(5, 7))
    np.testing.assert_array_equal(rows.codes, CODES)
    assert rows.background is None


def test_a_native_scan(folder):
    error = np.sqrt(COUNTS).astype(float)
    scan = Scan(
        counts=COUNTS.astype(float), standard_error=error, background=AIR.astype(float), background_error=error,
        codes=CODES, photons_per_shot=1e7, exposure=0.1, route="direct", noisy=True, seed=0,
        scene=shipped_scene("cxbi-blocks").toml(),
    )  # fmt: skip
    write_scan(scan, folder / "y.nc")
    found = read_capture(folder / "y.nc")
    np.testing.assert_array_equal(found.codes, CODES)
    np.testing.assert_array_equal(found.background, AIR)
    np.testing.assert_array_equal(read_capture(folder / "y.nc", background=folder / "counts.npy").background, COUNTS)


def test_images_of_codes_and_of_a_detector(folder):
    images = 100 + 900 * np.kron(CODES, np.ones((3, 3))).astype(np.uint16)
    np.savez(folder / "images.npz", codes=images)
    detector = RNG.integers(0, 4000, (SHOTS, 6, 9)).astype(np.uint16)
    np.savez(folder / "detector.npz", y=detector)
    found = read_capture(folder / "images.npz", folder / "detector.npz", block=3)
    np.testing.assert_array_equal(found.codes, CODES)
    np.testing.assert_array_equal(found.counts, detector.sum(axis=(1, 2), dtype=float))


def test_usual_names_go_first(folder):
    np.savez(folder / "two.npz", y=COUNTS, index=np.arange(SHOTS))
    assert read_capture(folder / "codes.npy", folder / "two.npz").counts[0] == COUNTS[0]
    np.savez(folder / "three.npz", a=COUNTS, b=np.arange(SHOTS))
    assert "call the right one 'counts'" in refused(folder / "codes.npy", folder / "three.npz")


def refused(*files, **given):
    with pytest.raises((ValueError, OSError), match=r"^[^\n]+$") as raised:
        read_capture(*files, **given)
    return str(raised.value)


def test_what_cannot_be_is_said_in_a_line(folder):
    whole = (folder / "codes.mat").read_bytes()
    (folder / "short.mat").write_bytes(whole[: len(whole) // 2])
    (folder / "empty.mat").write_bytes(b"")
    np.savez(folder / "objects.npz", codes=np.array([CODES, None], object))
    np.savez(folder / "dark.npz", codes=CODES * (np.arange(SHOTS) != 3)[:, None, None], y=COUNTS)
    np.savez(folder / "below.npz", codes=CODES, y=COUNTS - 150)
    np.savez(folder / "long.npz", y=np.r_[COUNTS, COUNTS])
    savemat(folder / "names.mat", {"label": "codes", "number": 3.0})
    savemat(folder / "ragged.mat", {"codes": cells([CODES[0], CODES[1][:4]])})
    savemat(folder / "texts.mat", {"codes": cells(["a", "b"])})
    y = folder / "counts.npy"
    assert "short.mat: " in refused(folder / "short.mat", y)
    assert "truncated" in refused(folder / "short.mat", y)
    assert "header is truncated" in refused(folder / "empty.mat", y)
    assert "holds no codes (shot, y, x)" in refused(folder / "objects.npz", y)
    assert "Python objects" in refused(folder / "objects.npz", y)
    assert "code 3 of 12 has no open cell" in refused(folder / "dark.npz")
    assert "counts cannot be negative" in refused(folder / "below.npz")
    assert "there are 12 codes in" in refused(folder / "codes.mat", folder / "long.npz")
    assert "12 codes and 24 values of background" in refused(folder / "codes.mat", y, folder / "long.npz")
    assert "holds no codes (shot, y, x); it holds 'label' (text)" in refused(folder / "names.mat", y)
    assert "arrays of one shape" in refused(folder / "ragged.mat", y)
    assert "must be arrays of real numbers" in refused(folder / "texts.mat", y)
    assert "holds no counts" in refused(folder / "codes.mat")
    assert "holds no counts" in refused(folder / "codes.mat", folder / "codes.mat")
    assert "there is no file" in refused(folder / "none.mat", y)
    assert "must be a .mat, .npz, .npy or .nc file" in refused(folder, y) or "is a folder" in refused(folder, y)
    assert "not 4 × 9; give their shape" in refused(folder / "rows.npz", shape=(4, 9))
    assert "from 1 to 5 pixels a side" in refused(folder / "all.npz", block=9)
    np.savez(folder / "grey.npz", codes=CODES * 7 + np.arange(7, dtype=np.uint8), y=COUNTS)
    assert "--block" in refused(folder / "grey.npz")


def mutated(whole, rng):
    """A file with bytes changed, cut out, doubled, or its end missing."""
    data = bytearray(whole)
    kind = rng.integers(4)
    if kind == 0:
        return bytes(data[: rng.integers(len(data))])
    at = int(rng.integers(len(data)))
    if kind == 1:
        for _ in range(int(rng.integers(1, 12))):
            data[int(rng.integers(len(data)))] = int(rng.integers(256))
    elif kind == 2:
        del data[at : at + int(rng.integers(1, 40))]
    else:
        data[at:at] = data[at : at + int(rng.integers(1, 40))]
    return bytes(data)


@pytest.mark.parametrize(
    ("name", "times"), [("codes.mat", 100), ("plain.mat", 80), ("all.npz", 80), ("new.mat", 14), ("codes.npy", 40)]
)
def test_damaged_files_are_refused_or_read_but_never_crash(folder, name, times):
    rng = np.random.default_rng(7)
    whole = (folder / name).read_bytes()
    path = folder / f"bad{(folder / name).suffix}"
    counts = None if name == "all.npz" else folder / "counts.npy"
    outcomes = {"read": 0, "refused": 0}
    for _ in range(times):
        path.write_bytes(mutated(whole, rng))
        begun = time.monotonic()
        try:
            found = read_capture(path, counts)
        except (ValueError, OSError) as error:
            outcomes["refused"] += "\n" not in str(error)
        else:
            assert len(found.codes) == len(found.counts)
            outcomes["read"] += 1
        assert time.monotonic() - begun < 20
    assert outcomes["read"] + outcomes["refused"] == times
    assert outcomes["refused"] > times / 4


def test_nothing_is_unpickled(folder):
    class Trap:
        def __reduce__(self):
            return (pytest.fail, ("unpickled",))

    buffer = io.BytesIO()
    np.save(buffer, np.array([Trap()], object), allow_pickle=True)
    (folder / "trap.npy").write_bytes(buffer.getvalue())
    assert "holds no codes" in refused(folder / "trap.npy", folder / "counts.npy")


def test_the_files_of_the_source(data):
    folder = data / "cxbi"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    experiment, gate = folder / "experiment", folder / "gate" / "10"
    found = read_capture(experiment / "codes_bin.mat", experiment / "y_target.mat", experiment / "y_empty.mat")
    assert found.codes.shape == (384, 29, 33)
    assert found.codes.mean() == pytest.approx(0.506, abs=0.001)
    assert (found.counts[0], found.background[0]) == (279_817_691, 235_103_272)
    scan = read_capture(gate / "code_it1.mat", gate / "y_UD.mat", gate / "y_air.mat")
    np.testing.assert_array_equal(scan.codes[0][:, 1:], scan.codes[1][:, :-1])
