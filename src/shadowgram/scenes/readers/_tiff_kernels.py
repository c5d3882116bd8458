"""LZW and PackBits, as TIFF has them; both stop at the end of either array and return how many bytes they wrote, 0 of damage."""

from __future__ import annotations

import numpy as np
from numba import njit

_CLEAR, _END, _FIRST, _MOST = 256, 257, 258, 4096


@njit(cache=True, nogil=True)
def decode_packbits(data: np.ndarray, out: np.ndarray) -> int:
    """Runs of bytes (TIFF 6.0, section 9)."""
    at, done = 0, 0
    while at < data.size and done < out.size:
        kind = int(data[at])
        at += 1
        if kind < 128:
            count = min(kind + 1, data.size - at, out.size - done)
            for k in range(count):
                out[done + k] = data[at + k]
            at += count
            done += count
        elif kind > 128 and at < data.size:
            count = min(257 - kind, out.size - done)
            for k in range(count):
                out[done + k] = data[at]
            at += 1
            done += count
    return done


@njit(cache=True, nogil=True)
def decode_lzw(data: np.ndarray, out: np.ndarray) -> int:
    """Lempel, Ziv and Welch's code with words of 9 to 12 bits, the highest bit first (TIFF 6.0, section 13).

    A word stands for a stretch of what was already written: the stretch of the word before it and the byte after that.
    """
    starts, lengths = np.zeros(_MOST, np.int64), np.zeros(_MOST, np.int64)
    width, words, before = 9, _FIRST, -1
    before_start, before_length = 0, 0
    bit, done = 0, 0
    while done < out.size and bit + width <= 8 * data.size:
        word = 0
        for k in range(bit, bit + width):
            word = 2 * word + ((int(data[k >> 3]) >> (7 - (k & 7))) & 1)
        bit += width
        if word == _END:
            break
        if word == _CLEAR:
            width, words, before = 9, _FIRST, -1
            continue
        if word >= _FIRST and (before < 0 or word > words or word >= _MOST):
            return 0
        if before >= 0 and words < _MOST:
            starts[words], lengths[words] = before_start, before_length + 1
            words += 1
        if word >= words:
            return 0
        start = done
        if word < 256:
            out[done] = word
            done += 1
        else:
            count = min(lengths[word], out.size - done)
            for k in range(count):
                out[done + k] = out[starts[word] + k]
            done += count
        before, before_start, before_length = word, start, done - start
        if words >= (1 << width) - 1 and width < 12:
            width += 1
    return done
