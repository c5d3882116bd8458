"""Files for mask makers: read back, they are the code, to the nanometre."""

import re
import sys
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree as ET

import gdstk
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import minimum_filter

import shadowgram as sg
from shadowgram.codes import layout
from shadowgram.codes._rectangles import merged, rectangles
from shadowgram.codes.layout import corner_contacts, dmd_frames, write_gds, write_svg

SHAPES = [(1, 1), (1, 9), (7, 1), (5, 8), (16, 16), (13, 10)]
POLARITIES = ["open", "chrome"]
SVG = "{http://www.w3.org/2000/svg}"


def code_of(shape, shots=2, seed=0):
    return sg.codes.random(shots=shots, shape=shape, seed=seed)


def sides(polygon):
    """Left, lower, right, upper of a rectangle, nm; every corner is a whole number of nm."""
    points = np.asarray(polygon.points) * 1000
    assert np.abs(points - points.round()).max() < 1e-3
    (left, lower), (right, upper) = points.min(axis=0).round().astype(int), points.max(axis=0).round().astype(int)
    assert points.shape == (4, 2)
    assert {tuple(p) for p in points.round().astype(int)} == {
        (left, lower),
        (left, upper),
        (right, lower),
        (right, upper),
    }
    return left, lower, right, upper


def drawn(path):
    """Rectangles of each shot's cell, (n, 4) left, lower, right, upper in nm."""
    library = gdstk.read_gds(path)
    assert library.unit == pytest.approx(1e-6, rel=1e-12)
    assert library.precision == pytest.approx(1e-9, rel=1e-12)
    shots = sorted((cell for cell in library.cells if cell.name != "MASK"), key=lambda cell: int(cell.name[5:]))
    assert all((p.layer, p.datatype) == (layout.LAYER, 0) for cell in shots for p in cell.polygons)
    return [np.array([sides(p) for p in cell.polygons], dtype=np.int64).reshape(-1, 4) for cell in shots]


def rasterised(boxes, shape, side):
    """How many rectangles hold the centre of each element; y of the boxes points up."""
    counts = np.zeros(shape, dtype=int)
    for y in range(shape[0]):
        for x in range(shape[1]):
            right, up = (x + 0.5) * side, (shape[0] - y - 0.5) * side
            counts[y, x] = sum(l < right < r and b < up < t for l, b, r, t in boxes)
    return counts


def area(boxes):
    return int(((boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])).sum())


def overlap(boxes):
    """Whether any two rectangles share an area."""
    left, lower, right, upper = (boxes[:, i] for i in range(4))
    x = np.minimum(right[:, None], right) > np.maximum(left[:, None], left)
    y = np.minimum(upper[:, None], upper) > np.maximum(lower[:, None], lower)
    return bool((x & y & ~np.eye(len(boxes), dtype=bool)).any())


@pytest.mark.parametrize("polarity", POLARITIES)
@pytest.mark.parametrize("shape", SHAPES)
def test_gds_is_the_code(tmp_path, shape, polarity):
    code = code_of(shape)
    write_gds(code, tmp_path / "mask.gds", pitch=7.56, polarity=polarity)
    shots = drawn(tmp_path / "mask.gds")
    assert len(shots) == len(code)
    for boxes, shot in zip(shots, code if polarity == "open" else 1 - code, strict=True):
        assert np.array_equal(rasterised(boxes, shape, 7560), shot)
        assert area(boxes) == int(shot.sum()) * 7560**2
        assert not overlap(boxes)


@pytest.mark.parametrize("value", [0, 1])
def test_code_that_is_the_same_everywhere(tmp_path, value):
    write_gds(np.full((6, 9), value), tmp_path / "mask.gds", pitch=10)
    (boxes,) = drawn(tmp_path / "mask.gds")
    assert boxes.tolist() == ([[0, 0, 90_000, 60_000]] if value else [])


@given(shape=st.tuples(st.integers(1, 12), st.integers(1, 12)), seed=st.integers(0, 999), share=st.floats(0.05, 0.95))
def test_rectangles_are_maximal(shape, seed, share):
    """No run along x is cut, and runs of the same columns in successive rows are one."""
    pattern = np.random.default_rng(seed).random(shape) < share
    found = merged(pattern)
    counts = np.zeros(shape, dtype=int)
    for top, bottom, left, right in found:
        counts[top:bottom, left:right] += 1
        for beside in (left - 1, right):
            assert not (0 <= beside < shape[1] and pattern[top:bottom, beside].any())
    assert np.array_equal(counts, pattern)
    upper = {(bottom, left, right) for _, bottom, left, right in found}
    assert not any((top, left, right) in upper for top, _, left, right in found)


@pytest.mark.parametrize("polarity", POLARITIES)
@pytest.mark.parametrize("bias", [1, 3, 4])
@pytest.mark.parametrize("shape", [(1, 1), (6, 9), (11, 5)])
def test_bias_moves_every_edge_inwards(tmp_path, shape, bias, polarity):
    """Elements of 10 nm, compared nanometre by nanometre: a point stays open if the square around it was."""
    code = code_of(shape, seed=3)
    write_gds(code, tmp_path / "mask.gds", pitch=0.01, bias=bias / 1000, polarity=polarity)
    for boxes, shot in zip(drawn(tmp_path / "mask.gds"), code, strict=True):
        expected = minimum_filter(
            shot.repeat(10, axis=0).repeat(10, axis=1), size=2 * bias + 1, mode="constant", cval=0
        )
        got = np.zeros_like(expected)
        for left, lower, right, upper in boxes:
            got[10 * shape[0] - upper : 10 * shape[0] - lower, left:right] += 1
        assert np.array_equal(got, expected if polarity == "open" else 1 - expected)


def test_bias_parts_a_corner_contact(tmp_path):
    write_gds([[1, 0], [0, 1]], tmp_path / "mask.gds", pitch=10.0, bias=0.25)
    (boxes,) = drawn(tmp_path / "mask.gds")
    assert boxes.tolist() == [[250, 10_250, 9750, 19_750], [10_250, 250, 19_750, 9750]]


@pytest.mark.parametrize(("columns", "places"), [(None, [(0, 0), (1, 0), (2, 0)]), (2, [(0, 0), (1, 0), (0, 1)])])
def test_places_of_the_shots(tmp_path, columns, places):
    """Left to right, then down; the gap between them; all centred on the origin."""
    code = code_of((5, 8), shots=3)
    write_gds(code, tmp_path / "mask.gds", pitch=10.0, gap=70.0, columns=columns, marks=False)
    mask = next(cell for cell in gdstk.read_gds(tmp_path / "mask.gds").cells if cell.name == "MASK")
    across, down = 1 + max(x for x, _ in places), 1 + max(y for _, y in places)
    width, height = across * 150 - 70, down * 120 - 70
    expected = [(-width / 2 + 150 * x, height / 2 - 50 - 120 * y) for x, y in places]
    assert [reference.cell.name for reference in mask.references] == ["SHOT_1", "SHOT_2", "SHOT_3"]
    assert np.allclose([reference.origin for reference in mask.references], expected, rtol=0, atol=1e-6)
    assert not mask.polygons


def test_marks_lie_outside_the_shots(tmp_path):
    code = code_of((30, 40), shots=5)
    write_gds(code, tmp_path / "mask.gds", pitch=10.0, columns=3, gap=400.0)
    mask = next(cell for cell in gdstk.read_gds(tmp_path / "mask.gds").cells if cell.name == "MASK")
    shots = [(x, y, x + 400, y + 300) for x, y in (reference.origin for reference in mask.references)]
    low, high = (np.array([polygon.bounding_box()[i] for polygon in mask.polygons]) for i in (0, 1))
    for left, lower, right, upper in shots:
        outside = (high[:, 0] < left) | (high[:, 1] < lower) | (low[:, 0] > right) | (low[:, 1] > upper)
        assert outside.all()
    together = sum(polygon.area() for polygon in gdstk.boolean(mask.polygons, [], "or"))
    assert sum(polygon.area() for polygon in mask.polygons) == pytest.approx(together, rel=1e-9)
    assert all((polygon.layer, polygon.datatype) == (layout.LAYER, 0) for polygon in mask.polygons)
    crosses = [polygon for polygon in mask.polygons if len(polygon.points) == 12]
    centres = {tuple(np.mean(polygon.bounding_box(), axis=0)) for polygon in crosses}
    # Two rows of three: 2000 µm × 1000 µm, and half a gap beyond it.
    assert centres >= {(x, y) for x in (-1200.0, 1200.0) for y in (-700.0, 700.0)}
    title = gdstk.text("5 x 30 x 40, 10 um", 99.984, (0, 0))
    assert len(mask.polygons) == 4 + 5 + len(title)


def test_title(tmp_path):
    counts = []
    for title in (None, "", "Camera 7"):
        write_gds(code_of((5, 8), shots=1), tmp_path / "mask.gds", pitch=10.0, title=title)
        counts.append(len(gdstk.read_gds(tmp_path / "mask.gds").top_level()[0].polygons))
    assert counts[1] == 4 + 1
    assert counts[2] == counts[1] + len(gdstk.text("Camera 7", 1, (0, 0)))
    assert counts[0] == counts[1] + len(gdstk.text("1 x 5 x 8, 10 um", 1, (0, 0)))


def test_the_same_code_gives_the_same_bytes(tmp_path):
    code = code_of((9, 9))
    for name in ("a.gds", "b.gds"):
        write_gds(code, tmp_path / name, pitch=10.0)
    data = (tmp_path / "a.gds").read_bytes()
    assert data == (tmp_path / "b.gds").read_bytes()
    # The times of the library do not come from the clock: 1 January 2000 twice, with years from 1900.
    assert np.frombuffer(data, ">i2", count=12, offset=10).tolist() == [100, 1, 1, 0, 0, 0] * 2
    assert all(
        np.frombuffer(data, ">i2", count=12, offset=found.end()).tolist() == [100, 1, 1, 0, 0, 0] * 2
        for found in re.finditer(rb"\x00\x1c\x05\x02", data)
    )


def test_a_large_code_is_a_small_file(tmp_path):
    """64 bytes a rectangle and no more, and fewer rectangles than open elements."""
    code = sg.codes.boolean(shots=2, shape=(128, 128), seed=0)
    write_gds(code, tmp_path / "mask.gds", pitch=10.0, marks=False)
    count = sum(len(merged(shot.astype(bool))) for shot in code)
    assert count < 0.5 * code.sum()
    assert (tmp_path / "mask.gds").stat().st_size < 64 * count + 1000


@pytest.mark.parametrize("polarity", POLARITIES)
@pytest.mark.parametrize("shape", SHAPES)
def test_svg_is_the_code(tmp_path, shape, polarity):
    code = code_of(shape, seed=1)
    write_svg(code, tmp_path / "mask.svg", pitch=7.56, shot=1, polarity=polarity)
    root = ET.parse(tmp_path / "mask.svg").getroot()
    height, width = (n * 7.56 for n in shape)
    assert [float(n) for n in root.get("viewBox").split()] == pytest.approx([0, 0, width, height], abs=1e-9)
    assert root.get("width").removesuffix("mm") == f"{width / 1000:.6f}".rstrip("0")
    assert float(root.get("height").removesuffix("mm")) == pytest.approx(height / 1000, abs=1e-9)
    (path,) = root.findall(f"{SVG}path")
    boxes = svg_boxes(path)
    flipped = np.stack([boxes[:, 0], height - boxes[:, 3], boxes[:, 2], height - boxes[:, 1]], axis=1)
    shot = code[1] if polarity == "open" else 1 - code[1]
    assert np.array_equal(rasterised(flipped, shape, 7.56), shot)
    sizes = np.round(boxes * 1000).astype(np.int64)
    assert area(sizes) == int(shot.sum()) * 7560**2
    assert path.get("fill") == {"open": "#fff", "chrome": "#000"}[polarity]
    grounds = [(float(r.get("width")), float(r.get("height"))) for r in root.findall(f"{SVG}rect")]
    assert grounds == ([pytest.approx((width, height))] if polarity == "open" else [])


def svg_boxes(path):
    """(n, 4) left, top, right, bottom in µm; the path may hold nothing but rectangles."""
    number = r"(-?\d+(?:\.\d+)?)"
    shape = re.compile(rf"M{number} {number}h{number}v{number}h{number}z")
    assert shape.sub("", path.get("d")) == ""
    rows = np.array([[float(n) for n in found] for found in shape.findall(path.get("d"))]).reshape(-1, 5)
    assert np.array_equal(rows[:, 4], -rows[:, 2])
    return np.stack([rows[:, 0], rows[:, 1], rows[:, 0] + rows[:, 2], rows[:, 1] + rows[:, 3]], axis=1)


def test_svg_with_bias(tmp_path):
    write_svg([[1, 0], [0, 1]], tmp_path / "mask.svg", pitch=10.0, bias=0.25)
    boxes = svg_boxes(ET.parse(tmp_path / "mask.svg").getroot().find(f"{SVG}path"))
    assert boxes.tolist() == [[0.25, 0.25, 9.75, 9.75], [10.25, 10.25, 19.75, 19.75]]


@given(nm=st.integers(-(10**12), 10**12), places=st.sampled_from([3, 6]))
def test_decimals_are_exact(nm, places):
    text = layout._decimal(nm, places)
    assert re.fullmatch(r"-?\d+(\.\d*[1-9])?", text)
    whole, _, rest = text.lstrip("-").partition(".")
    assert (-1 if text[0] == "-" else 1) * int(whole + rest.ljust(places, "0")) == nm


@pytest.mark.parametrize(
    ("shape", "mirrors", "first"),
    [((4, 6), 1, (3, 7)), ((3, 5), 2, (2, 5)), ((5, 9), 1, (2, 5)), ((10, 20), 1, (0, 0))],
)
def test_dmd_frames_are_centred(shape, mirrors, first):
    code = code_of(shape)
    frames = dmd_frames(code, frame=(10, 20), mirrors=mirrors)
    expected = np.zeros((len(code), 10, 20), dtype=bool)
    for q, y, x in np.ndindex(code.shape):
        for i in range(mirrors):
            for j in range(mirrors):
                expected[q, first[0] + mirrors * y + i, first[1] + mirrors * x + j] = code[q, y, x]
    assert frames.dtype == bool
    assert np.array_equal(frames, expected)


def test_dmd_offset():
    code = np.ones((2, 3))
    frames = dmd_frames(code, frame=(8, 9), offset=(-3, 3))
    assert np.argwhere(frames[0]).min(axis=0).tolist() == [0, 6]
    assert frames.sum() == 6
    assert dmd_frames(code).shape == (1, 1080, 1920)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"frame": (8, 8)}, "5 × 9 mirrors, which do not fit on 8 × 8"),
        ({"frame": (9, 17), "mirrors": 2}, "10 × 18 mirrors"),
        ({"frame": (7, 9), "offset": (2, 0)}, "moved by 2 down and 0 right"),
        ({"frame": (7, 9), "offset": (0, -1)}, "moved by 0 down and -1 right"),
        ({"mirrors": 0}, "mirrors must be a whole number"),
        ({"mirrors": 1.5}, "mirrors must be a whole number"),
        ({"frame": (1080,)}, "frame must be two whole numbers"),
        ({"frame": (-8, 20)}, "do not fit"),
        ({"offset": (0.5, 0)}, "offset must be two whole numbers"),
    ],
)
def test_dmd_refuses(options, said):
    with pytest.raises(ValueError, match=said):
        dmd_frames(np.ones((5, 9)), **options)


def test_corner_contacts():
    code = code_of((12, 17), shots=3, seed=5)
    expected = sum(
        code[q, y : y + 2, x : x + 2].tolist() in ([[1, 0], [0, 1]], [[0, 1], [1, 0]])
        for q in range(3)
        for y in range(11)
        for x in range(16)
    )
    assert expected > 0
    assert corner_contacts(code) == expected
    assert corner_contacts(np.indices((5, 6)).sum(axis=0) % 2) == 4 * 5


WRONG_CODES = {
    "NaN": (np.array([[1.0, np.nan]]), "transmittance must lie in"),
    "gray": (np.array([[1.0, 0.25]]), "binary, every element 0 .* got a transmittance of 0.25"),
    "8 bits": (np.array([[0, 255]], np.uint8), "divide an 8-bit code by 255"),
    "colored": (np.ones((2, 4, 3, 3)), r"got \(2, 4, 3, 3\); a colored code"),
    "a row": (np.ones(5), r"got \(5,\)"),
    "nothing": (np.ones((1, 0, 4)), r"got \(1, 0, 4\)"),
    "words": (np.array([["a", "b"]]), "type <U1"),
}


@pytest.mark.parametrize("write", [write_gds, write_svg])
@pytest.mark.parametrize("wrong", WRONG_CODES.values(), ids=WRONG_CODES)
def test_wrong_codes_are_refused(tmp_path, wrong, write):
    with pytest.raises(ValueError, match=wrong[1]):
        write(wrong[0], tmp_path / "mask", pitch=10.0)
    assert not list(tmp_path.iterdir())


WRONG_OPTIONS = [
    (write_gds, {"pitch": 0}, "pitch must be a positive length"),
    (write_gds, {"pitch": -10.0}, "pitch must be a positive length"),
    (write_gds, {"pitch": np.nan}, "pitch must be a positive length"),
    (write_svg, {"pitch": np.inf}, "pitch must be a positive length"),
    (write_svg, {"pitch": 1e308}, "pitch must be a positive length"),
    (write_gds, {"pitch": 10.0005}, r"pitch must be a whole number of nm, got 10.0005 µm; 10 is the nearest"),
    (write_svg, {"pitch": 1e-5}, r"pitch must be a whole number of nm, got 1e-05 µm; 0.001 is the nearest"),
    (write_gds, {"bias": 5.0}, "bias must be less than half of the pitch, 5 µm"),
    (write_svg, {"bias": -1.0}, "bias must be a positive length"),
    (write_gds, {"bias": 0.0001}, "bias must be a whole number of nm"),
    (write_gds, {"gap": 39.0}, "marks need a gap of at least 40 µm"),
    (write_gds, {"gap": np.nan}, "marks need a gap"),
    (write_gds, {"gap": 0.0, "marks": False}, "gap must be a positive length"),
    (write_gds, {"columns": 0}, "columns must be a whole number"),
    (write_gds, {"polarity": "clear"}, 'polarity must be "open" or "chrome"'),
    (write_svg, {"polarity": "clear"}, 'polarity must be "open" or "chrome"'),
    (write_gds, {"title": "10 µm"}, "printable ASCII"),
    (write_gds, {"title": "two\nlines"}, "printable ASCII"),
    (write_svg, {"shot": 2}, "shot must be a number from 0 to 1"),
    (write_svg, {"shot": -1}, "shot must be a number from 0 to 1"),
    (write_gds, {"pitch": 400_000.0}, r"ends at 2.147 m from its centre, the mask at 2\.[48]"),
    (write_gds, {"gap": 2e6, "marks": False, "pitch": 300_000.0}, "ends at 2.147 m"),
]


@pytest.mark.parametrize(("write", "options", "said"), WRONG_OPTIONS)
def test_wrong_options_are_refused(tmp_path, write, options, said):
    with pytest.raises(ValueError, match=said):
        write(code_of((3, 6)), tmp_path / "mask", **{"pitch": 10.0} | options)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("write", [write_gds, write_svg])
def test_a_file_that_cannot_be_written_leaves_nothing_behind(tmp_path, write):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("old")
    for path in ("none/mask", "folder", "file/mask"):
        with pytest.raises(OSError, match="cannot write"):
            write(code_of((3, 4)), tmp_path / path, pitch=10.0)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "folder"]
    assert (tmp_path / "file").read_text() == "old"


def test_a_full_disk_is_noticed(tmp_path, monkeypatch):
    """gdstk does not complain when the disk is full: the end of its file is missing then."""

    class Cut(gdstk.Library):
        def write_gds(self, outfile, timestamp):
            super().write_gds(outfile, timestamp=timestamp)
            Path(outfile).write_bytes(Path(outfile).read_bytes()[:-100])

    monkeypatch.setattr(layout, "_gdstk", lambda: SimpleNamespace(**vars(gdstk) | {"Library": Cut}))
    with pytest.raises(OSError, match="no room for temporary files"):
        write_gds(code_of((3, 4)), tmp_path / "mask.gds", pitch=10.0)
    assert not list(tmp_path.iterdir())


def test_without_gdstk(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "gdstk", None)
    with pytest.raises(ValueError, match=r"pip install 'shadowgram\[layout\]'"):
        write_gds(code_of((3, 4)), tmp_path / "mask.gds", pitch=10.0)
    assert not list(tmp_path.iterdir())


def test_rectangles_of_a_shot_in_nanometres():
    opened = np.array([[True, True, False], [True, True, False]])
    assert rectangles(opened, 10, 0, closed=False).tolist() == [[0, 20, 0, 20]]
    assert rectangles(opened, 10, 0, closed=True).tolist() == [[0, 20, 20, 30]]
    assert rectangles(opened, 10, 2, closed=False).tolist() == [[2, 18, 2, 18]]
