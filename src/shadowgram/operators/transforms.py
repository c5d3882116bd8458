"""The sparsifying basis: a DCT along bands ⊗ a 2-D Symlet-8 wavelet transform of every band.

Both are orthonormal, so synthesis Ψ of the coefficients and analysis Ψᵀ of the cube are transposes of each other. Sizes that the
wavelet levels do not divide are padded: Ψ then crops, and ΨΨᵀ = I still holds (Salazar 2022, section 2.4, pads the scene).
How the transforms are computed, and what that gains: docs/decisions/0003-transforms.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from shadowgram._threads import run_chunks

from .base import LinearOperator, Shape

BASES = ("dct-sym8",)

# Low-pass filter of the Symlet with 8 vanishing moments (Daubechies, Ten Lectures on Wavelets, 1992, table 6.3), by ascending
# sample, from sample 2k−7 to 2k+8 for coefficient k.
_LOW_PASS = (
    0.0018899503327594609, -0.0003029205147213668, -0.01495225833704823, 0.003808752013890615,
    0.049137179673607506, -0.027219029917056003, -0.05194583810770904, 0.3644418948353314,
    0.7771857517005235, 0.4813596512583722, -0.061273359067658524, -0.1432942383508097,
    0.007607487324917605, 0.03169508781149298, -0.0005421323317911481, -0.0033824159510061256,
)  # fmt: skip


def basis(name: str, shape: Shape, levels: int | None = None) -> LinearOperator:
    """Sparsifying basis Ψ of a datacube, as an operator from coefficients to the cube.

    Parameters
    ----------
    name : ``"dct-sym8"``: orthonormal DCT-II along bands, 2-D Symlet-8 wavelets (periodised) in every band.
    shape : (band, y, x) of the cube, any sizes.
    levels : of the wavelet transform. By default as many as keep the coarsest image at 8 × 8 or more.

    Returns
    -------
    LinearOperator
        `forward` synthesises: coefficients → cube; `adjoint` analyses. The coefficients have the shape of the cube, with y and x
        rounded up to a multiple of 2^levels; the approximation is in the corner [:, :y/2^levels, :x/2^levels], and the details of
        each level beyond it, as in a picture of a wavelet transform: rows of the lower half are high-pass along y, columns of the
        right half high-pass along x.

    Raises
    ------
    ValueError
        If the name is not known, or shape or levels are impossible.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> basis = sg.operators.basis("dct-sym8", (6, 30, 33), levels=2)
    >>> basis.in_shape
    (6, 32, 36)
    >>> cube = np.random.default_rng(0).random((6, 30, 33))
    >>> bool(np.allclose(basis.forward(basis.adjoint(cube)), cube))
    True
    """
    if name not in BASES:
        raise ValueError(f"basis must be one of {', '.join(BASES)}, got {name!r}")
    if len(shape) != 3 or any(not isinstance(n, int | np.integer) or n < 1 for n in shape):
        raise ValueError(f"the basis needs a cube shape (band, y, x) of positive whole numbers, got {shape}")
    if levels is None:
        levels = default_levels(shape)
    elif not isinstance(levels, int | np.integer) or not 1 <= levels <= 16:
        raise ValueError(f"levels must be a whole number from 1 to 16, got {levels!r}")
    bands, ny, nx = (int(n) for n in shape)
    return DCTSym8((bands, ny, nx), int(levels))


def default_levels(shape: Shape) -> int:
    """Wavelet levels that leave a coarsest image of at least 8 × 8, and at least one level."""
    return max(1, (min(shape[1:]) // 8).bit_length() - 1)


@dataclass(frozen=True, eq=False)
class DCTSym8(LinearOperator):
    """DCT-II along bands ⊗ 2-D Symlet-8: coefficients (band, y, x) → cube (band, y, x). Made by `basis`."""

    shape: tuple[int, int, int]
    levels: int

    @property
    def in_shape(self) -> Shape:
        """(band, y, x) of the coefficients: the cube's, padded to whole multiples of 2^levels."""
        unit = 2**self.levels
        bands, ny, nx = self.shape
        return bands, -(-ny // unit) * unit, -(-nx // unit) * unit

    @property
    def out_shape(self) -> Shape:
        """(band, y, x) of the cube."""
        return self.shape

    def _forward(self, x: np.ndarray, out: np.ndarray) -> None:
        from . import _dct_kernels, _wavelet_kernels

        bands, ny, nx = self.in_shape
        tables = self._tables[x.dtype.name]
        lattice = tables.tangents[::-1], tables.scale
        planes = out if self.in_shape == self.shape else np.empty(self.in_shape, x.dtype)
        run_chunks(_wavelet_kernels.synthesise_planes, bands, _grain(ny * nx), x, planes, self.levels, *lattice)
        rows = _dct_kernels.ROWS
        blocks, grain = -(-self.shape[1] // rows), _grain(rows * bands * nx)
        run_chunks(_dct_kernels.synthesise_rows, blocks, grain, planes, *tables.halves_transposed, *lattice, out)

    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None:
        from . import _dct_kernels, _wavelet_kernels

        bands, ny, nx = self.in_shape
        tables = self._tables[y.dtype.name]
        lattice = tables.tangents, tables.scale
        rows = _dct_kernels.ROWS
        blocks, grain = -(-ny // rows), _grain(rows * bands * nx)
        run_chunks(_dct_kernels.analyse_rows, blocks, grain, y, *tables.halves, *lattice, out)
        run_chunks(_wavelet_kernels.analyse_planes, bands, _grain(ny * nx), out, self.levels, *lattice)

    @cached_property
    def _tables(self) -> dict[str, _Tables]:
        return {name: _Tables.of(self.shape[0], np.dtype(name)) for name in ("float32", "float64")}


def _grain(voxels: int) -> int:
    """Items of so many voxels that are worth a thread of their own (about 0.1 ms)."""
    return max(1, -(-65536 // voxels))


@dataclass(frozen=True)
class _Tables:
    """Constants of the kernels in one dtype."""

    tangents: tuple
    scale: np.floating
    halves: tuple[np.ndarray, np.ndarray]
    halves_transposed: tuple[np.ndarray, np.ndarray]

    @classmethod
    def of(cls, bands: int, dtype: np.dtype) -> _Tables:
        tangents, scale = _lattice()
        halves = _dct_halves(bands)
        return cls(
            tuple(dtype.type(t) for t in tangents),
            dtype.type(scale),
            (_padded(halves[0], dtype), _padded(halves[1], dtype)),
            (_padded(halves[0].T, dtype), _padded(halves[1].T, dtype)),
        )


def _lattice() -> tuple[list[float], float]:
    """Tangents of the 8 rotations, first to last, and the product of their cosines.

    The polyphase matrix E(z) = Σ_m E_m z⁻ᵐ of (low, high) over pairs of samples is peeled from the left:
    E = R(t) diag(1, z⁻¹) E', with R(t) = cos·[[1, t], [−t, 1]] chosen so that the second row of Rᵀ E has no constant term
    (Vaidyanathan, Multirate Systems and Filter Banks, 1993, section 6.4).
    """
    low = np.array(_LOW_PASS).reshape(8, 2)
    high = (low[::-1, ::-1] * (-1, 1)).reshape(8, 2)  # the alternating flip of the low-pass filter
    polyphase = np.stack([low, high], axis=1)[::-1]  # (delay, low or high, even or odd)
    tangents, scale = [], 1.0
    while len(polyphase) > 1:
        column = polyphase[0][:, np.abs(polyphase[0]).sum(axis=0).argmax()]
        c, s = column / np.linalg.norm(column)
        tangents.append(-s / c)
        scale *= c
        rotated = np.array([[c, s], [-s, c]]) @ polyphase
        polyphase = np.stack([rotated[:-1, 0], rotated[1:, 1]], axis=1)
    tangents.append(polyphase[0, 0, 1] / polyphase[0, 0, 0])
    sign = np.sign(scale * polyphase[0, 0, 0])
    # From the tangents, not from the taps, whose squares add up to 1 only to 1e-13.
    return tangents[::-1], float(sign * np.prod(1 / np.hypot(1, tangents)))


def _dct_halves(bands: int) -> tuple[np.ndarray, np.ndarray]:
    """Even and odd rows of the orthonormal DCT-II over the first half of the bands, with the middle band in the even part."""
    k, b = np.ogrid[:bands, :bands]
    matrix = np.sqrt(2 / bands) * np.cos(np.pi * k * (2 * b + 1) / (2 * bands))
    matrix[0] /= np.sqrt(2)
    return matrix[0::2, : bands - bands // 2], matrix[1::2, : bands // 2]


def _padded(matrix: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """Zeros below and to the right, to the multiples of 4 outputs and 3 inputs that the product kernel works on."""
    rows, columns = matrix.shape
    return np.ascontiguousarray(np.pad(matrix, ((0, -rows % 4), (0, -columns % 3))), dtype)
