"""Operators of a backscatter imager: a mask that slides past its window, or a list of codes; (y, x) → (shot,).

A sliding mask is never made into a matrix. Small ones are correlated directly. Large ones go by real FFTs along x, in blocks of
shots (overlap-save), which costs O(N(N + Q) log N) for N × N cells and Q shots, and memory for the spectra of the strip.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from shadowgram._threads import run_chunks, thread_count
from shadowgram.operators.base import LinearOperator, Shape

from . import _cxbi_kernels as kernels

# Direct products that take as long as what FFTs cost at any size, and as one number that they transform: measured on windows from
# 16 × 16 to 128 × 128 cells with 128 to 8192 shots.
_PRODUCTS_A_CALL = 1_000_000
_PRODUCTS_A_NUMBER = 40
_PRODUCTS_A_THREAD = 200_000  # below that, to start a thread takes longer than it saves


@dataclass(frozen=True, eq=False)
class SlidingOperator(LinearOperator):
    """y[q] = Σ_ij T[i, step·q + j] F[i, j].

    Attributes
    ----------
    strip : (y, step·(shots − 1) + x) float64, C-contiguous.
    columns : x of the image.
    step : columns that the mask moves from shot to shot, fewer than `columns`.
    """

    strip: np.ndarray
    columns: int
    step: int

    @property
    def in_shape(self) -> Shape:
        """(y, x) of the image."""
        return self.strip.shape[0], self.columns

    @property
    def out_shape(self) -> Shape:
        """(shot,) of the counts."""
        return ((self.strip.shape[1] - self.columns) // self.step + 1,)

    def _forward(self, x: np.ndarray, out: np.ndarray) -> None:
        image = self._phases(x)
        if self._by_fft:
            self._fft_forward(image, out)
            return
        grain = _grain(image.size)
        run_chunks(kernels.slide_forward, out.size, grain, self._strips[x.dtype.char], image, out)

    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None:
        rows, step = self.strip.shape[0], self.step
        image = np.empty((rows * step, self._width), y.dtype)
        if self._by_fft:
            self._fft_adjoint(y, image)
        else:
            grain = _grain(y.size * self._width)
            run_chunks(kernels.slide_adjoint, len(image), grain, self._strips[y.dtype.char], y, image)
        whole = image.reshape(rows, step, self._width).transpose(0, 2, 1).reshape(rows, -1)
        out[:] = whole[:, : self.columns]

    @property
    def _width(self) -> int:
        """Columns of the image in each phase."""
        return -(-self.columns // self.step)

    def _phases(self, columns: np.ndarray) -> np.ndarray:
        """(y, …) → (y·step, … / step): every step-th column, after zeros that make the last one whole."""
        if self.step == 1:
            return columns
        rows, length = columns.shape
        padded = np.zeros((rows, -(-length // self.step) * self.step), columns.dtype)
        padded[:, :length] = columns
        phases = padded.reshape(rows, -1, self.step).transpose(0, 2, 1)
        return np.ascontiguousarray(phases).reshape(rows * self.step, -1)

    @cached_property
    def _strips(self) -> dict[str, np.ndarray]:
        """The strip in phases, for each kind of number."""
        strip = self._phases(self.strip)
        return {"d": strip, "f": strip.astype(np.float32)}

    @cached_property
    def _block(self) -> tuple[int, int]:
        """(points of an FFT, shots that one block gives): a block four images wide, or all shots in one."""
        from scipy.fft import next_fast_len

        shots, width = self.out_shape[0], self._width
        points = int(next_fast_len(min(shots + width - 1, max(4 * width, 256)), real=True) or 0)
        return points, points - width + 1

    @cached_property
    def _by_fft(self) -> bool:
        """Whether transforms take less time than the direct sums."""
        (shots,), phases = self.out_shape, self.strip.shape[0] * self.step
        points, step = self._block
        blocks = -(-shots // step)
        numbers = points * (phases + blocks) + blocks * phases * points / 8  # to multiply is an eighth of to transform
        return shots * phases * self._width > _PRODUCTS_A_CALL + _PRODUCTS_A_NUMBER * numbers

    @cached_property
    def _spectra(self) -> dict[str, np.ndarray]:
        """Filled by `_spectrum`, for the kinds of numbers that were asked for."""
        return {}

    def _spectrum(self, kind: str) -> np.ndarray:
        """(block, phase, frequency) of the strip, each block as long as an FFT."""
        if kind not in self._spectra:
            strip = self._strips[kind]
            points, step = self._block
            blocks = -(-self.out_shape[0] // step)
            spectra = np.empty((blocks, len(strip), points // 2 + 1), np.complex128 if kind == "d" else np.complex64)
            for s in range(blocks):
                spectra[s] = _spectrum_of(strip[:, s * step : s * step + points], points)
            self._spectra[kind] = spectra
        return self._spectra[kind]

    def _fft_forward(self, image: np.ndarray, out: np.ndarray) -> None:
        strip = self._spectrum(image.dtype.char)
        points, step = self._block
        spectrum = _spectrum_of(image, points)
        product = np.empty((len(strip), points // 2 + 1), strip.dtype)
        run_chunks(kernels.correlate_spectra, len(strip), 1, strip, spectrum, product)
        counts = _rows_of(product, points)[:, :step]
        out[:] = counts.reshape(-1)[: out.size]

    def _fft_adjoint(self, y: np.ndarray, image: np.ndarray) -> None:
        strip = self._spectrum(y.dtype.char)
        points, step = self._block
        blocks = np.zeros((len(strip), step), y.dtype)
        blocks.reshape(-1)[: y.size] = y
        spectrum = _spectrum_of(blocks, points)
        product = np.empty((len(image), points // 2 + 1), strip.dtype)
        run_chunks(kernels.back_spectra, len(image), 1, strip, spectrum, product)
        image[:] = _rows_of(product, points)[:, : image.shape[1]]


@dataclass(frozen=True, eq=False)
class ListOperator(LinearOperator):
    """y[q] = Σ_ij C[q, i, j] F[i, j], for codes (shot, y, x) float64 that have nothing to do with each other."""

    codes: np.ndarray

    @property
    def in_shape(self) -> Shape:
        """(y, x) of the image."""
        return self.codes.shape[1:]

    @property
    def out_shape(self) -> Shape:
        """(shot,) of the counts."""
        return self.codes.shape[:1]

    @cached_property
    def _matrix(self) -> dict[str, np.ndarray]:
        matrix = self.codes.reshape(len(self.codes), -1)
        return {"d": matrix, "f": matrix.astype(np.float32)}

    def _forward(self, x: np.ndarray, out: np.ndarray) -> None:
        run_chunks(kernels.list_forward, out.size, _grain(x.size), self._matrix[x.dtype.char], x.reshape(-1), out)

    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None:
        # out is C-contiguous, so that its reshape is a view.
        run_chunks(kernels.list_adjoint, out.size, _grain(y.size), self._matrix[y.dtype.char], y, out.reshape(-1))


@dataclass(frozen=True, eq=False)
class LightOperator(LinearOperator):
    """What blurs and weights the image before the codes: F → K(s·F).

    To blur a code inside its window and take its product with F is to take the product of the code with the blurred F.

    Attributes
    ----------
    shape : (y, x).
    sensitivity : (y, x) float64, or None for 1.
    blur : weights along y and x, of odd lengths, symmetric.
    """

    shape: tuple[int, int]
    sensitivity: np.ndarray | None
    blur: tuple[np.ndarray, np.ndarray]

    @property
    def in_shape(self) -> Shape:
        """(y, x) of the image."""
        return self.shape

    @property
    def out_shape(self) -> Shape:
        """(y, x) of the image."""
        return self.shape

    def _forward(self, x: np.ndarray, out: np.ndarray) -> None:
        self._blurred(x if self.sensitivity is None else (x * self.sensitivity).astype(x.dtype), out)

    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None:
        self._blurred(y, out)
        if self.sensitivity is not None:
            out *= self.sensitivity

    def _blurred(self, image: np.ndarray, out: np.ndarray) -> None:
        """K is its own transpose: its weights are symmetric, and outside the window there is nothing."""
        from scipy.ndimage import correlate1d

        for axis, weights in enumerate(self.blur):
            if weights.size > 1:
                image = correlate1d(image, weights, axis=axis, mode="constant")
        out[:] = image


@dataclass(frozen=True, eq=False)
class ReversedOperator(LinearOperator):
    """The shots of another operator, last one first: a mask that slides towards larger x."""

    of: LinearOperator

    @property
    def in_shape(self) -> Shape:
        """(y, x) of the image."""
        return self.of.in_shape

    @property
    def out_shape(self) -> Shape:
        """(shot,) of the counts."""
        return self.of.out_shape

    def _forward(self, x: np.ndarray, out: np.ndarray) -> None:
        out[:] = self.of.forward(x)[::-1]

    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None:
        self.of._adjoint(np.ascontiguousarray(y[::-1]), out)


def _spectrum_of(rows: np.ndarray, points: int) -> np.ndarray:
    """Real FFT of every row, after zeros."""
    from scipy.fft import rfft

    return np.asarray(rfft(rows, points, axis=1, workers=thread_count()))


def _rows_of(spectrum: np.ndarray, points: int) -> np.ndarray:
    """Inverse of `_spectrum_of`."""
    from scipy.fft import irfft

    return np.asarray(irfft(spectrum, points, axis=1, workers=thread_count()))


def _grain(products: int) -> int:
    """Items of so many products each that are worth a thread."""
    return max(1, _PRODUCTS_A_THREAD // max(products, 1))
