"""What a case cannot do without: the bytes that go to and from memory once, and the float32 operations.

L bands, Q shots, N² pixels, V = L·N² voxels; a multiply-add is two operations; the arithmetic is that of the cheapest way to
compute the same that we know of, not of the textbook's.

=================  ==========================================================  ==============================================
case               bytes                                                       operations
=================  ==========================================================  ==============================================
SSCSI              cube 4V, snapshots 4QN², one mask bit a shot (L+2)N²·⌈Q/8⌉  2QV masked adds, 2JV blending of J columns
SSCSI, gray        cube 4V, snapshots 4QN², code 4QN²                          2QJV: J columns are weighed for every shot
CASSI, colored     cube 4V, snapshots 4QN(N+L−1), code QN² or QV               2QV, of higher order (2Q + 2J)V for J pixels
basis, one way     cube 8V (read and write)                                    wavelet 16·2·4/3 V, DCT (L+1)V
GAP-TV iteration   operator both ways, and 28V: estimate and two duals, read   those, 21V a step of the denoising, 12V around it,
                   and written once, correction read; inverses of HHᵀ 4Q²N²    2Q²N² for the products with the inverses
GPSR iteration     operator and basis both ways, and 24V: coefficients,        those, and 20V for the two positive parts, their
                   direction and gradient, read and written once               step, the line search and the gradient
=================  ==========================================================  ==============================================

The 16 wavelet operations a voxel and axis are 8 rotations of a pair of samples (the lattice of an orthonormal filter of 16 taps;
applied directly it takes 32), two axes, and 1 + 1/4 + 1/16 + … = 4/3 for the levels. The DCT is a product with the even and the
odd half of its matrix, L/2 multiply-adds a voxel.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Work:
    """Bytes to and from memory, and float32 operations."""

    bytes: float
    flops: float

    def __add__(self, other: Work) -> Work:
        return Work(self.bytes + other.bytes, self.flops + other.flops)


def sscsi(bands: int, size: int, shots: int, columns: int) -> Work:
    """Forward or adjoint of an SSCSI with a binary code, whose voxels see `columns` code columns each."""
    pixels, voxels = size**2, bands * size**2
    masks = (bands + columns - 1) * pixels * -(-shots // 8)
    return Work(4 * voxels + 4 * shots * pixels + masks, 2 * shots * voxels + 2 * columns * voxels)


def sscsi_gray(bands: int, size: int, shots: int, columns: int) -> Work:
    """Forward or adjoint of an SSCSI with a gray code, whose voxels see `columns` code columns each."""
    voxels = bands * size**2
    return Work(4 * voxels + 8 * shots * size**2, 2 * shots * columns * voxels)


def cassi(bands: int, size: int, shots: int, pixels: int = 0) -> Work:
    """Forward or adjoint of a CASSI, whose voxels each fall on `pixels` in a model of higher order."""
    snapshots = shots * size * (size + bands - 1)
    return Work(4 * bands * size**2 + 4 * snapshots + shots * size**2, 2 * (shots + pixels) * bands * size**2)


def colored(bands: int, size: int, shots: int) -> Work:
    """Forward or adjoint of a colored CASSI."""
    voxels = bands * size**2
    return Work(4 * voxels + 4 * shots * size * (size + bands - 1) + shots * voxels, 2 * shots * voxels)


def basis(bands: int, size: int) -> Work:
    """Analysis or synthesis in DCT ⊗ Symlet-8."""
    voxels = bands * size**2
    return Work(8 * voxels, (16 * 2 * 4 / 3 + bands + 1) * voxels)


def gpsr_iteration(bands: int, size: int, shots: int) -> Work:
    """One iteration of GPSR with an SSCSI."""
    one_way = sscsi(bands, size, shots, columns=3) + basis(bands, size)
    voxels = bands * size**2
    return one_way + one_way + Work(24 * voxels, 20 * voxels)


def gap_tv_iteration(bands: int, size: int, shots: int, tv_iterations: int) -> Work:
    """One iteration of GAP-TV with an SSCSI."""
    one_way = sscsi(bands, size, shots, columns=3)
    pixels, voxels = size**2, bands * size**2
    own = Work(28 * voxels + 4 * shots**2 * pixels, (21 * tv_iterations + 12) * voxels + 2 * shots**2 * pixels)
    return one_way + one_way + own
