"""One-bit pictures of codes: the pixels, and how large they are."""

import io
import struct

import numpy as np
import pytest
from PIL import Image

import shadowgram as sg
from shadowgram.figures.masks import frame_png, mask_png
from shadowgram.figures.style import read_grey

SHOT = sg.codes.random(shots=1, shape=(5, 13), seed=0)[0]


def opened(data):
    picture = Image.open(io.BytesIO(data))
    picture.load()
    return picture


@pytest.mark.parametrize("pixels", [1, 3])
def test_mask_is_the_code(pixels):
    picture = opened(mask_png(SHOT, pitch=7.56, pixels=pixels))
    assert picture.mode == "1"
    assert np.array_equal(np.asarray(picture), np.kron(SHOT, np.ones((pixels, pixels))))


@pytest.mark.parametrize(
    ("pitch", "pixels", "metre"), [(10.0, 1, 100_000), (10.0, 4, 400_000), (2000.0, 1, 500), (7.56, 1, 132_275)]
)
def test_mask_says_its_size(pitch, pixels, metre):
    data = mask_png(SHOT, pitch=pitch, pixels=pixels)
    start = data.index(b"pHYs") + 4
    assert struct.unpack(">IIB", data[start : start + 9]) == (metre, metre, 1)
    assert opened(data).info["dpi"] == pytest.approx((0.0254 * metre, 0.0254 * metre))


def test_mask_can_be_read_as_a_code(tmp_path):
    (tmp_path / "mask.png").write_bytes(mask_png(SHOT, pitch=10.0))
    assert np.array_equal(read_grey(tmp_path / "mask.png"), SHOT)


def test_frame_has_no_size():
    data = frame_png(SHOT)
    assert b"pHYs" not in data
    assert np.array_equal(np.asarray(opened(data)), SHOT)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"pitch": 0.0}, "pitch must be a positive length"),
        ({"pitch": -1.0}, "pitch must be a positive length"),
        ({"pitch": np.nan}, "pitch must be a positive length"),
        ({"pitch": 1e-5}, "pitch must be a positive length"),
        ({"pitch": 2e6}, "pitch must be a positive length in µm, from 0.00047 to 1e\\+06"),
        ({"pitch": 10.0, "pixels": 0}, "pixels must be a whole number"),
    ],
)
def test_wrong_options_are_refused(options, said):
    with pytest.raises(ValueError, match=said):
        mask_png(SHOT, **options)
