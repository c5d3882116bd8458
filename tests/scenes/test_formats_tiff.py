"""TIFF and OME-TIFF: written by others, written by us and read by others, and what is said of files that are no cubes."""

import struct
import warnings
import zlib
from itertools import product

import numpy as np
import pytest
from PIL import Image

from shadowgram import scenes
from shadowgram.scenes.readers.tiff import tiff_contents

tifffile = pytest.importorskip("tifffile")
VALUES = np.random.default_rng(0).integers(1, 200, (3, 50, 70))
NM = [451.5, 520, 640 + 1 / 3]
GREY = {"photometric": "minisblack", "metadata": None}


def quietly(path, **said):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return scenes.read(path, **said)


@pytest.mark.parametrize("suffix", [".tif", ".tiff", ".ome.tif"])
@pytest.mark.parametrize("dtype", ["f4", "f8", "u1", "u2", "i2", "i4", ">u2", "?", "f2", "i8"])
def test_there_and_back_and_what_others_see(tmp_path, suffix, dtype):
    values = VALUES.astype(dtype)
    cube = scenes.as_datacube(VALUES, NM, name="scene").copy(data=values)
    scenes.write(cube, tmp_path / f"a{suffix}")
    back = quietly(tmp_path / f"a{suffix}")
    scale = back.attrs.get("scale", 1)
    np.testing.assert_allclose(back * scale, values.astype(float), rtol=1e-6)
    np.testing.assert_array_equal(back.wavelength, NM)
    assert back.name == "scene"
    assert back.dtype == (np.float64 if dtype in ("f8", "i8") else np.float32)
    with tifffile.TiffFile(tmp_path / f"a{suffix}") as file:
        assert file.is_ome
        assert file.series[0].axes == "CYX"
        np.testing.assert_array_equal(file.asarray(), values)
        channels = tifffile.xml2dict(file.ome_metadata)["OME"]["Image"]["Pixels"]["Channel"]
        assert [channel["EmissionWavelength"] for channel in channels] == NM


def test_one_band_and_no_wavelengths(tmp_path):
    cube = scenes.as_datacube(VALUES[:1], [633], name="laser")
    scenes.write(cube, tmp_path / "a.tif")
    back = quietly(tmp_path / "a.tif")
    assert back.shape == (1, 50, 70)
    assert back.wavelength.item() == 633
    scenes.write(cube.drop_vars("wavelength"), tmp_path / "a.tif")
    with pytest.raises(ValueError, match="no array of three axes"):
        scenes.read(tmp_path / "a.tif")
    np.testing.assert_array_equal(scenes.read_array(tmp_path / "a.tif"), VALUES[0])


def test_large_files_are_bigtiff(tmp_path, monkeypatch):
    from shadowgram.scenes.readers import tiff_writer

    monkeypatch.setattr(tiff_writer, "_SMALL", 1000)
    scenes.write(scenes.as_datacube(VALUES, NM), tmp_path / "a.tif")
    np.testing.assert_array_equal(quietly(tmp_path / "a.tif"), VALUES)
    with tifffile.TiffFile(tmp_path / "a.tif") as file:
        assert file.is_bigtiff
        np.testing.assert_array_equal(file.asarray(), VALUES)


@pytest.mark.parametrize("dtype", ["u1", "u2", "f4", "i4"])
@pytest.mark.parametrize("order", "<>")
def test_pages_of_other_software(tmp_path, dtype, order):
    values, path = VALUES.astype(dtype), tmp_path / "a.tif"
    for compression, tile, big in product((None, "zlib"), (None, (16, 32)), (False, True)):
        predictor = compression is not None and values.dtype.kind != "f"
        how = {"compression": compression, "predictor": predictor, "tile": tile, "bigtiff": big, "byteorder": order}
        tifffile.imwrite(path, values, rowsperstrip=None if tile else 7, **how, **GREY)
        np.testing.assert_array_equal(tiff_contents(path).variables["a"].load(), values)
        assert quietly(path, wavelengths=NM, variable="a").shape == values.shape


@pytest.mark.parametrize("compression", ["tiff_lzw", "packbits", "tiff_adobe_deflate", None])
def test_compressions_of_another_library(tmp_path, compression):
    """Rows of noise and smooth ones, long enough for words of all lengths of LZW."""
    page = np.add.outer(np.arange(200), np.arange(150)).astype(np.uint8)
    page[60:150] = np.random.default_rng(1).integers(0, 256, (90, 150))
    Image.fromarray(page).save(tmp_path / "a.tif", compression=compression)
    np.testing.assert_array_equal(scenes.read_array(tmp_path / "a.tif"), page)
    Image.fromarray(page > 99).save(tmp_path / "a.tif", compression=compression)
    np.testing.assert_array_equal(scenes.read_array(tmp_path / "a.tif"), page > 99)


def simple(path, data, *, bits, form=1, compression=1, predictor=1, photometric=1, size=(5, 6), order="<", extra=()):
    """A page of one strip, by hand."""
    tags = {256: size[1], 257: size[0], 258: bits, 259: compression, 262: photometric, 273: 8, 277: 1, 278: size[0]}
    tags |= {279: len(data), 317: predictor, 339: form} | dict(extra)
    entries = b"".join(struct.pack(order + "HHII", tag, 4, 1, tags[tag]) for tag in sorted(tags))
    head = {"<": b"II", ">": b"MM"}[order] + struct.pack(order + "HI", 42, 8 + len(data))
    path.write_bytes(head + data + struct.pack(order + "H", len(tags)) + entries + bytes(4))


@pytest.mark.parametrize("bits", [1, 2, 4, 10, 12])
def test_packed_bits(tmp_path, bits):
    values = np.random.default_rng(bits).integers(0, 2**bits, (5, 6))
    rows = ["".join(f"{value:0{bits}b}" for value in row) for row in values]
    packed = b"".join(int(row.ljust(-(-len(row) // 8) * 8, "0"), 2).to_bytes(-(-len(row) // 8)) for row in rows)
    simple(tmp_path / "a.tif", packed, bits=bits)
    np.testing.assert_array_equal(scenes.read_array(tmp_path / "a.tif"), values)
    simple(tmp_path / "a.tif", packed, bits=bits, photometric=0)
    np.testing.assert_array_equal(scenes.read_array(tmp_path / "a.tif"), 2**bits - 1 - values)


@pytest.mark.parametrize("order", "<>")
def test_predictor_of_floats(tmp_path, order):
    """Adobe's third technical note: the bytes of a row sorted by their weight, then their differences."""
    values = np.random.default_rng(2).normal(size=(5, 6)).astype(">f4")
    coded = b""
    for row in values:
        planes = np.frombuffer(row.tobytes(), np.uint8).reshape(6, 4).T.ravel()
        coded += np.diff(planes, prepend=np.uint8(0)).tobytes()
    simple(tmp_path / "a.tif", zlib.compress(coded), bits=32, form=3, compression=8, predictor=3, order=order)
    np.testing.assert_array_equal(scenes.read_array(tmp_path / "a.tif"), values)


def test_samples_of_one_page(tmp_path):
    values = np.random.default_rng(3).integers(1, 60000, (5, 20, 30), np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", values.transpose(1, 2, 0), planarconfig="contig", **GREY)
    tifffile.imwrite(tmp_path / "b.tif", values, planarconfig="separate", **GREY)
    for name in ("a", "b"):
        cube = quietly(tmp_path / f"{name}.tif", wavelengths=(400, 700))
        np.testing.assert_array_equal(cube, values / np.float32(65535))


def test_wavelengths_where_others_write_them(tmp_path):
    path = tmp_path / "a.tif"
    values = VALUES.astype(np.float32)
    tifffile.imwrite(path, values, photometric="minisblack", metadata={"wavelength": [450, 500, 550]})
    assert quietly(path).wavelength.values.tolist() == [450, 500, 550]
    for channel in (
        {"Name": ["450 nm", "a 500nm", "550 nm"]},
        {"EmissionWavelength": [0.45, 0.5, 0.55], "EmissionWavelengthUnit": ["µm"] * 3},
    ):
        tifffile.imwrite(path, values, ome=True, photometric="minisblack", metadata={"axes": "CYX", "Channel": channel})
        np.testing.assert_allclose(quietly(path).wavelength, [450, 500, 550])
    tifffile.imwrite(path, values, imagej=True)
    with pytest.warns(UserWarning, match=r"guessed wavelengths=\(400, 700\)"):
        np.testing.assert_array_equal(scenes.read(path), values)


def test_thumbnails_are_left_out(tmp_path):
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        for page in VALUES.astype(np.float32):
            file.write(page, **GREY)
        file.write(VALUES[0, :9, :9].astype(np.float32), subfiletype=1, **GREY)
    assert quietly(tmp_path / "a.tif", wavelengths=NM).shape == VALUES.shape


def test_files_that_are_no_cubes(tmp_path):
    path = tmp_path / "a.tif"
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(path)
    with pytest.raises(ValueError, match="a picture in red, green and blue; say wavelengths="):
        scenes.read(path)
    assert quietly(path, wavelengths=(620, 460)).shape == (3, 8, 8)
    Image.fromarray(np.zeros((8, 8), bool)).save(path, compression="group4")
    with pytest.raises(ValueError, match="compressed with a fax code, which is not read; save it without compression"):
        scenes.read(path, variable="a")
    Image.fromarray(np.zeros((8, 8), np.uint8)).convert("P").save(path)
    with pytest.raises(ValueError, match="in colours of the kind a palette"):
        scenes.read(path, variable="a")
    tifffile.imwrite(path, np.zeros((2, 3, 8, 8), np.float32), ome=True, metadata={"axes": "ZCYX"})
    with pytest.raises(ValueError, match="more than three axes"):
        scenes.read(path)
    tifffile.imwrite(path, np.zeros((3, 8, 8), np.complex64), **GREY)
    with pytest.raises(ValueError, match="complex numbers"):
        scenes.read(path)
    with tifffile.TiffWriter(path) as file:
        for side in (8, 8, 9, 9):
            file.write(np.full((side, side), side, np.float32), **GREY)
    with pytest.raises(ValueError, match=r"several arrays of three axes in it.*'image1' \(2 × 8 × 8 float32\)"):
        scenes.read(path)
    assert scenes.read_array(path, "image2").shape == (2, 9, 9)


def test_planes_that_are_missing_are_not_made_up(tmp_path):
    scenes.write(scenes.as_datacube(VALUES, NM), tmp_path / "a.tif")
    whole = (tmp_path / "a.tif").read_bytes()
    (tmp_path / "a.tif").write_bytes(whole.replace(b'SizeC="3"', b'SizeC="4"'))
    with pytest.raises(ValueError, match="has 4 channels and 3 wavelengths"):
        scenes.read(tmp_path / "a.tif")
    (tmp_path / "a.tif").write_bytes(whole.replace(b'SizeZ="1"', b'SizeZ="2"'))
    with pytest.raises(ValueError, match="says 6 planes, and there are 3 pages"):
        scenes.read(tmp_path / "a.tif")
    (tmp_path / "a.tif").write_bytes(whole.replace(b'SizeT="1"', b'SizeT="x"'))
    with pytest.raises(ValueError, match="gives 'x' as a number of planes"):
        scenes.read(tmp_path / "a.tif")
    (tmp_path / "a.tif").write_bytes(whole.replace(b'IFD="0"', b'IFD="1"'))
    with pytest.raises(ValueError, match="in another order"):
        scenes.read(tmp_path / "a.tif")
    (tmp_path / "a.tif").write_bytes(whole.replace(b"<Image ", b"<Imag& "))
    with pytest.raises(ValueError, match="is not XML"):
        scenes.read(tmp_path / "a.tif")


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ({"size": (10**9, 10**9)}, "GiB in a file of"),
        ({"size": (0, 6)}, "the size of a page.*damaged"),
        ({"size": (5, 7)}, "the data of a page are missing or reach beyond"),
        ({"size": (5, 2)}, "the data of a page are missing or reach beyond"),
        ({"bits": 7, "form": 3}, "samples of 7 bits of a kind that is not read"),
        ({"extra": {273: 10**6}.items()}, "reach beyond its end"),
        ({"extra": {273: 0}.items()}, "are missing"),
        ({"extra": {273: 40}.items()}, "lie over each other or over its directories"),
        ({"extra": {279: 0}.items()}, "are missing"),
        ({"extra": {278: 2}.items()}, "has 1 pieces of data where there should be 3"),
        ({"extra": {322: 16, 323: 0}.items()}, "the size of a page"),
        ({"compression": 8}, "cannot be decompressed"),
        ({"compression": 5}, "do not have the length"),
        ({"compression": 7}, "compressed with JPEG"),
    ],
)
def test_directories_are_not_trusted(tmp_path, said, message):
    simple(tmp_path / "a.tif", bytes(range(100, 130)), **({"bits": 8} | said))
    with pytest.raises(ValueError, match=message):
        scenes.read_array(tmp_path / "a.tif", "a")


def test_directories_that_go_in_circles_or_off_the_end(tmp_path):
    simple(tmp_path / "a.tif", bytes(30), bits=8)
    whole = (tmp_path / "a.tif").read_bytes()
    for following, message in ((38, "go round in a circle"), (len(whole), "beyond its end"), (40, "damaged")):
        (tmp_path / "a.tif").write_bytes(whole[:-4] + struct.pack("<I", following))
        with pytest.raises(ValueError, match=message):
            scenes.read_array(tmp_path / "a.tif")
    for length in (4, 7, 9, 60, len(whole) - 1):
        (tmp_path / "a.tif").write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"truncated|damaged"):
            scenes.read_array(tmp_path / "a.tif")


def test_many_large_lists_do_not_take_for_ever(tmp_path):
    """A thousand directories that each ask for the same list of a hundred thousand places."""
    count, blob = 100_000, bytes(800_000)
    tags = {256: (4, 1, 1), 257: (4, 1, count), 273: (4, count, 16), 278: (4, 1, 1), 279: (4, count, 16)}
    body = b"II*\0" + struct.pack("<I", 16 + len(blob)) + bytes(8) + blob
    for i in range(1000):
        following = len(body) + 2 + 12 * len(tags) + 4 if i < 999 else 0
        entries = b"".join(struct.pack("<HHII", tag, *value) for tag, value in tags.items())
        body += struct.pack("<H", len(tags)) + entries + struct.pack("<I", following)
    (tmp_path / "a.tif").write_bytes(body)
    with pytest.raises(ValueError, match="damaged"):
        scenes.read(tmp_path / "a.tif")
