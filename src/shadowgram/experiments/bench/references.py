"""What a careful user computes with NumPy, PyWavelets and scipy.fft: float32, one thread, buffers made once.

Operators hold their code as float32 over (shot, band, y, x), so that nothing is converted while the clock runs.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np


class EinsumCode:
    """g[q] = Σ_k t[q, k] f[k] and its adjoint, by einsum."""

    def __init__(self, code: np.ndarray) -> None:
        self.code = code

    def forward(self, x: np.ndarray) -> np.ndarray:
        """(band, y, x) → (shot, y, x)."""
        return np.einsum("qkyx,kyx->qyx", self.code, x)

    def adjoint(self, y: np.ndarray) -> np.ndarray:
        """(shot, y, x) → (band, y, x)."""
        return np.einsum("qkyx,qyx->kyx", self.code, y)


class BandLoops:
    """g[q, :, k·shift:] += t[q, k] f[k] and its adjoint, band by band: what stays in cache is a few planes.

    Parameters
    ----------
    code : (shot, band or 1, y, x) float32.
    bands : number of bands.
    shift : pixels from one band to the next on the detector.
    """

    def __init__(self, code: np.ndarray, bands: int, shift: int) -> None:
        self.code = np.broadcast_to(code, (len(code), bands, *code.shape[2:]))
        self.shift = shift
        self.plane = np.empty(code.shape[2:], code.dtype)
        shots, _, ny, nx = self.code.shape
        self.snapshots = np.empty((shots, ny, nx + shift * (bands - 1)), code.dtype)
        self.cube = np.empty((bands, ny, nx), code.dtype)

    def forward(self, x: np.ndarray) -> np.ndarray:
        """(band, y, x) → (shot, y, x)."""
        self.snapshots[:] = 0
        for k, plane in enumerate(x):
            start = k * self.shift
            for q, snapshot in enumerate(self.snapshots):
                np.multiply(self.code[q, k], plane, out=self.plane)
                snapshot[:, start : start + plane.shape[1]] += self.plane
        return self.snapshots

    def adjoint(self, y: np.ndarray) -> np.ndarray:
        """(shot, y, x) → (band, y, x)."""
        for k, plane in enumerate(self.cube):
            start = k * self.shift
            np.multiply(self.code[0, k], y[0, :, start : start + plane.shape[1]], out=plane)
            for q in range(1, len(y)):
                np.multiply(self.code[q, k], y[q, :, start : start + plane.shape[1]], out=self.plane)
                plane += self.plane
        return self.cube


class TapLoops:
    """CASSI of higher order, one pixel a band: every coded band falls on three pixels, the middle one shifted by k.

    Parameters
    ----------
    code : (y, x) float32.
    shape : (band, y, x) of the cube.
    taps : shares of the pixel before, at and after the shift; what falls beside the detector is lost.
    """

    def __init__(self, code: np.ndarray, shape: tuple[int, int, int], taps: tuple[float, float, float]) -> None:
        self.code, self.taps = code, [code.dtype.type(tap) for tap in taps]
        bands, ny, nx = shape
        self.wide = np.empty((ny, nx + bands + 1), code.dtype)  # the detector with a column on either side
        self.coded, self.plane = np.empty((2, ny, nx), code.dtype)
        self.cube = np.empty(shape, code.dtype)

    def forward(self, x: np.ndarray) -> np.ndarray:
        """(band, y, x) → (1, y, x)."""
        self.wide[:] = 0
        for k, plane in enumerate(x):
            np.multiply(self.code, plane, out=self.coded)
            for j, tap in enumerate(self.taps):
                np.multiply(self.coded, tap, out=self.plane)
                self.wide[:, k + j : k + j + plane.shape[1]] += self.plane
        return self.wide[None, :, 1:-1]

    def adjoint(self, y: np.ndarray) -> np.ndarray:
        """(1, y, x) → (band, y, x)."""
        self.wide[:, [0, -1]] = 0
        self.wide[:, 1:-1] = y[0]
        for k, plane in enumerate(self.cube):
            plane[:] = 0
            for j, tap in enumerate(self.taps):
                np.multiply(self.wide[:, k + j : k + j + plane.shape[1]], tap, out=self.plane)
                plane += self.plane
            plane *= self.code
        return self.cube


class WaveletDCT:
    """DCT along bands and Symlet-8 of every band by scipy.fft and PyWavelets, one worker.

    Raises
    ------
    ImportError
        If PyWavelets is not installed.
    """

    def __init__(self, shape: tuple[int, int, int], levels: int) -> None:
        import pywt
        import scipy.fft

        self._pywt: Any = pywt
        self._fft: Any = scipy.fft
        self.levels = levels
        self.slices = pywt.coeffs_to_array(self._decompose(np.zeros(shape, np.float32)), axes=(1, 2))[1]

    def analysis(self, x: np.ndarray) -> np.ndarray:
        """Cube → coefficients, one array."""
        along = self._fft.dct(x, axis=0, norm="ortho")
        return self._pywt.coeffs_to_array(self._decompose(along), axes=(1, 2))[0]

    def synthesis(self, z: np.ndarray) -> np.ndarray:
        """Coefficients → cube."""
        coefficients = self._pywt.array_to_coeffs(z, self.slices, output_format="wavedec2")
        planes = self._pywt.waverec2(coefficients, "sym8", "periodization", axes=(1, 2))
        return self._fft.idct(planes, axis=0, norm="ortho", overwrite_x=True)

    def _decompose(self, x: np.ndarray) -> list[Any]:
        with warnings.catch_warnings():
            # PyWavelets warns of levels whose images are smaller than the filter; periodised, they are as orthonormal as the rest.
            warnings.filterwarnings("ignore", message="Level value", category=UserWarning)
            return self._pywt.wavedec2(x, "sym8", "periodization", self.levels, axes=(1, 2))


@dataclass(eq=False)
class GPSRSteps:
    """The iteration of GPSR with Barzilai-Borwein steps and an exact line search.

    Source: Figueiredo, Nowak and Wright, IEEE J. Sel. Top. Signal Process. 1 (2007) 586, section III.B.
    z = u − v with u, v ≥ 0; every `step` costs one forward, one adjoint, one synthesis and one analysis.
    """

    operator: EinsumCode | BandLoops
    basis: WaveletDCT
    snapshots: np.ndarray
    tau: float

    def __post_init__(self) -> None:
        self.gradient = -self.basis.analysis(self.operator.adjoint(self.snapshots))
        shape = self.gradient.shape
        self.u, self.v = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        self.du, self.dv, self.smaller = (np.empty(shape, np.float32) for _ in range(3))
        self.alpha = 1.0

    def step(self) -> None:
        """One iteration."""
        u, v, du, dv, gradient = self.u, self.v, self.du, self.dv, self.gradient
        for part, change, towards in ((u, du, self.tau), (v, dv, -self.tau)):
            np.add(gradient, np.float32(towards), out=change)
            change *= np.float32(-self.alpha if part is u else self.alpha)
            change += part
            np.maximum(change, 0, out=change)
            change -= part
        dz = du - dv
        seen = self.operator.forward(self.basis.synthesis(dz))
        curvature = float(np.vdot(seen, seen))
        slope = float(np.vdot(gradient, dz)) + self.tau * float(du.sum() + dv.sum())
        share = np.float32(min(1.0, -slope / max(curvature, 1e-30)))
        change = self.basis.analysis(self.operator.adjoint(seen))
        du *= share
        dv *= share
        change *= share
        u += du
        v += dv
        gradient += change
        np.minimum(u, v, out=self.smaller)
        u -= self.smaller
        v -= self.smaller
        square = float(np.vdot(du, du) + np.vdot(dv, dv))
        self.alpha = min(max(square / max(float(share) ** 2 * curvature, 1e-30), 1e-30), 1e30)
