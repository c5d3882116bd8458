"""Reading the pixels of a PNG picture with the standard library alone: the package's picture library belongs to `figures`.

Format: Portable Network Graphics (PNG) Specification, 2nd edition, W3C 2003; everything but interlaced pictures.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_SAMPLES = {
    0: 1,
    2: 3,
    3: 1,
    4: 2,
    6: 4,
}  # colour type → samples a pixel: grey, colour, palette, grey and alpha, colour and alpha
_PALETTE = 3
_MOST_PIXELS = 10**8


def read_png(path: Path) -> NDArray[np.float64]:
    """Grey picture (y, x) in [0, 1]; of a coloured one the mean of the colours. Transparency is not looked at.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is not a PNG picture, damaged, or interlaced.
    """
    data = path.read_bytes()
    if not data.startswith(_SIGNATURE):
        raise ValueError("it does not begin like a PNG picture")
    header, palette, packed, ended = b"", b"", [], False
    for kind, body in _chunks(data):
        if kind == b"IHDR":
            header = body
        elif kind == b"PLTE":
            palette = body
        elif kind == b"IDAT":
            packed.append(body)
        ended = kind == b"IEND"
    if not ended:
        raise ValueError("it is truncated")
    if len(header) != 13:
        raise ValueError("its header is damaged")
    width, height, depth, colour, *_, interlaced = struct.unpack(">IIBBBBB", header)
    if interlaced:
        raise ValueError("it is interlaced; save it without interlacing")
    if colour not in _SAMPLES or depth not in (1, 2, 4, 8, 16) or not 0 < width * height <= _MOST_PIXELS:
        raise ValueError("its header is damaged, or the picture is too large")
    samples = _samples(b"".join(packed), height, width * _SAMPLES[colour], depth, _SAMPLES[colour])
    return _grey(samples.reshape(height, width, -1), colour, depth, palette)


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = len(_SIGNATURE)
    while at < len(data):
        if at + 12 > len(data):
            raise ValueError("it is truncated")
        length, kind = struct.unpack_from(">I4s", data, at)
        body = data[at + 8 : at + 8 + length]
        check = data[at + 8 + length : at + 12 + length]
        if len(check) < 4 or zlib.crc32(kind + body) != int.from_bytes(check, "big"):
            raise ValueError("it is truncated or damaged")
        yield kind, body
        at += 12 + length


def _samples(packed: bytes, rows: int, columns: int, depth: int, per_pixel: int) -> NDArray[np.uint16]:
    """(row, sample) of the picture data."""
    stride = (columns * depth + 7) // 8
    try:
        raw = zlib.decompressobj().decompress(packed, rows * (stride + 1))
    except zlib.error as error:
        raise ValueError(f"its picture data are damaged ({error})") from error
    if len(raw) != rows * (stride + 1):
        raise ValueError("its picture data are truncated")
    lines = np.frombuffer(raw, np.uint8).reshape(rows, stride + 1)
    whole = _unfiltered(lines, max(1, per_pixel * depth // 8))
    if depth == 16:
        return whole.view(">u2").astype(np.uint16)
    if depth == 8:
        return whole.astype(np.uint16)
    bits = np.unpackbits(whole, axis=1)[:, : columns * depth].reshape(rows, columns, depth)
    return (bits @ (1 << np.arange(depth)[::-1])).astype(np.uint16)


def _unfiltered(lines: NDArray[np.uint8], step: int) -> NDArray[np.uint8]:
    """Rows with their filters undone (chapter 9 of the specification); `step` bytes lie between a byte and the one left of it."""
    rows, stride = lines.shape[0], lines.shape[1] - 1
    whole = np.zeros((rows + 1, stride + step), np.uint8)
    for i, line in enumerate(lines):
        kind, above, row = line[0], whole[i], whole[i + 1]
        row[step:] = line[1:]
        if kind == 0:
            continue
        if kind == 2:
            row[step:] += above[step:]
        elif kind in (1, 3, 4):
            for j in range(step, stride + step):
                left, up, corner = int(row[j - step]), int(above[j]), int(above[j - step])
                guess = left if kind == 1 else (left + up) // 2 if kind == 3 else _paeth(left, up, corner)
                row[j] = (int(row[j]) + guess) & 255
        else:
            raise ValueError("its picture data are damaged")
    return np.ascontiguousarray(whole[1:, step:])


def _paeth(left: int, up: int, corner: int) -> int:
    guess = left + up - corner
    return min((left, up, corner), key=lambda value: abs(guess - value))


def _grey(samples: NDArray[np.uint16], colour: int, depth: int, palette: bytes) -> NDArray[np.float64]:
    if colour == _PALETTE:
        colours = np.frombuffer(palette[: len(palette) // 3 * 3], np.uint8).reshape(-1, 3)
        index = samples[..., 0]
        if index.max() >= len(colours):
            raise ValueError("its palette is damaged")
        return colours[index].mean(axis=-1) / 255
    shown = samples[..., : 3 if colour in (2, 6) else 1]
    return shown.mean(axis=-1) / (2**depth - 1)
