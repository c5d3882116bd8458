"""What can be measured of an SSCSI on its continuous model without being told the limits; and its equations as loops."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np

from shadowgram import codes
from shadowgram.operators import LinearOperator
from shadowgram.spectral.continuous import ContinuousSSCSI
from shadowgram.spectral.resolution import SUPER_RESOLVING
from shadowgram.spectral.sscsi import SSCSI

SAMPLES = 32  # fine bands a column of the code
SEEN = 1e-9  # shares and singular values above this are there
SHOTS = 24  # more than the code columns that an element can meet in one wavelength


def tiny(value: float) -> str:
    """What rounding leaves, in a sentence."""
    return f"{value:.0e}" if value else "0"


def one_wavelength(imager: SSCSI) -> SSCSI:
    """The same camera in the light of its central wavelength: without dispersion."""
    return replace(imager, dispersion_ratio=1e-12, bands=1)


def pieces(imager: SSCSI) -> np.ndarray:
    """(column, element) share of a detector element that one wavelength reaches it by through a column of the code.

    Every shot opens one column, before a white board. What the shots cannot tell apart, no others can.
    """
    one = one_wavelength(imager)
    rows, columns = one.code_shape
    each = np.eye(columns, dtype=np.uint8)[:, None].repeat(rows, axis=1)
    camera = ContinuousSSCSI(imager=one, bands=1, oversampling=one.pitch_ratio)
    shares = camera.operator(each).forward(np.ones(camera.scene_shape))[:, 0]
    return shares / shares.sum(axis=0)


def independent_columns(imager: SSCSI, seed: int) -> tuple[int, int, int]:
    """How many places along x and y many shots of one wavelength tell apart.

    Returns
    -------
    columns of the discrete model, columns of the continuous one, rows of the continuous one on an element.
    """
    one = one_wavelength(imager)
    code = codes.random(shots=SHOTS, shape=one.code_shape, seed=seed)
    fine = ContinuousSSCSI(imager=one, bands=1, oversampling=4 * one.pitch_ratio).operator(code)
    return _rank(one.operator(code), 2), _rank(fine, 2), _rank(fine, 1)


def _rank(A: LinearOperator, axis: int) -> int:
    """Rank over one axis of the scene, at the beginning of the others; over y, on the first element only."""
    columns = []
    count = A.in_shape[axis] // (A.out_shape[1] if axis == 1 else 1)
    for place in range(count):
        scene = np.zeros(A.in_shape)
        scene[(0, place, 0) if axis == 1 else (0, 0, place)] = 1
        columns.append(A.forward(scene).ravel())
    return int(np.linalg.matrix_rank(np.stack(columns, axis=1), tol=SEEN * max(np.linalg.norm(c) for c in columns)))


def responses(imager: SSCSI, code: np.ndarray) -> np.ndarray:
    """(fine band, element) what an element of the first row records of a white board, `SAMPLES` fine bands a code column."""
    bands = max(1, round(SAMPLES * imager.spectral_columns))
    A = ContinuousSSCSI(imager=imager, bands=bands, oversampling=imager.pitch_ratio).operator(code)
    found = []
    for element in range(A.out_shape[2]):
        unit = np.zeros(A.out_shape)
        unit[0, 0, element] = 1
        found.append(A.adjoint(unit).sum(axis=(1, 2)))
    return np.stack(found, axis=1)


def whole_column(imager: SSCSI, seed: int) -> tuple[float, float] | None:
    """Smallest change of wavelength, nm, after which every element sees the code as if it had moved by one column.

    Returns
    -------
    change, nm, and the largest difference that remains, relative to an open mask; None if the wavelengths do not reach so far.
    """
    code = codes.random(shots=1, shape=imager.code_shape, seed=seed)
    seen, moved = responses(imager, code), responses(imager, np.roll(code, -1, axis=2))
    bright = responses(imager, np.ones_like(code)).max()
    start = round(SAMPLES * max(0.0, -imager.mask_offset))  # where all elements look into the mask
    off = np.abs(seen[start:] - moved[start]).max(axis=1) / bright
    found = np.flatnonzero(off < SEEN)
    low, high = imager.wavelengths
    return (float(found[0] * (high - low) / len(seen)), float(off[found[0]])) if len(found) else None


def extents(imager: SSCSI) -> tuple[float, float] | None:
    """Wavelengths, nm, over which an open column comes onto a detector element, and over which its light there is full.

    Read off the response of the first element: twice the way from 25 to 75 %, and the way between the points of 50 % less that.
    None if the column does not come onto the element and leave it within the imager's wavelengths.
    """
    width = imager.pitch_ratio * (1 - imager.mask_position)
    column = math.ceil(max(imager.mask_offset + width, 0.0) - SEEN)
    if column + 1 > imager.mask_offset + imager.spectral_columns + SEEN:
        return None
    code = np.zeros((1, *imager.code_shape), np.uint8)
    code[:, :, column] = 1
    light = responses(imager, code)[:, 0]
    light = np.concatenate([[0.0], light / light.max(), [0.0]])
    low, high = imager.wavelengths
    step = (high - low) / (len(light) - 2)
    rise = 2 * (_crossing(light, 0.75) - _crossing(light, 0.25))
    between = len(light) - 1 - _crossing(light[::-1], 0.5) - _crossing(light, 0.5)
    return rise * step, max(between - rise, 0.0) * step


def _crossing(light: np.ndarray, level: float) -> float:
    """Place, in samples, at which a sequence that begins with 0 first reaches a level, linear between samples."""
    after = int(np.argmax(light >= level))
    return float(after - (light[after] - level) / (light[after] - light[after - 1]))


def matrix_by_loops(imager: SSCSI, code: np.ndarray) -> np.ndarray:
    """Sensing matrix by eqs. (2.19) and (2.23) as they are printed, a loop for every sum; rows and columns as `as_matrix` has them.

    Elements of the code outside of it are closed. Voxel columns are counted from the first that the detector sees.
    """
    s, dc, dd, ratio = imager.mask_position, imager.code_pitch, imager.detector_pitch, imager.pitch_ratio
    start = imager.mask_offset * dc  # sαλmin
    bands, ny, nx = imager.resolution.cube_shape
    rows, columns = imager.detector_shape
    padded = np.pad(code.astype(float), ((0, 0), (0, 0), (bands + columns * ratio, bands + columns * ratio)))
    t = np.roll(padded, -(bands + columns * ratio), axis=2)  # so that t[..., −1] and t[..., Nc] are closed
    H = np.zeros((len(code), rows, columns, bands, ny, nx))
    first = math.floor(start / dc + SEEN)
    for q, n, m, k in itertools.product(range(len(code)), range(rows), range(columns), range(bands)):
        left, right = (math.floor((edge * dd * (1 - s) + start) / dc + SEEN) for edge in (m, m + 1))
        for row in range(n * ratio, (n + 1) * ratio):
            if imager.resolution.regime == SUPER_RESOLVING:
                for m1 in range(left, right + 1):
                    if (weight := _weight(m, m1, left, right, s, dc, dd, start)) > SEEN:
                        H[q, n, m, k, row, m1 - first] = weight * t[q, row, m1 + k]
            else:
                m1 = left + 1
                edge = (m1 * dc - start) / (1 - s)
                p = 1.0 if (m + 1) * dd <= edge else (edge - m * dd) / dd
                H[q, n, m, k, row, m] = t[q, row, m1 + k - 1] * p + t[q, row, m1 + k] * (1 - p)
    return H.reshape(len(code) * rows * columns, -1)


def _weight(m: int, m1: int, left: int, right: int, s: float, dc: float, dd: float, start: float) -> float:
    """W of eq. (2.12): part of column m1 of the stretched code that lies on element m."""
    if m1 == left:
        return (((m1 + 1) * dc - start) / (1 - s) - m * dd) / (dc / (1 - s))
    if m1 == right:
        return ((m + 1) * dd - (m1 * dc - start) / (1 - s)) / (dc / (1 - s))
    return 1.0
