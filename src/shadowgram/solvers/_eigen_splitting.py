"""Splitting of data from a prior on the cube's eigen-images, which `EigenTV` and `EigenPnP` share.

| symbol | meaning |
|---|---|
| H, y | the imager's operator, cube (band, y, x) → snapshots (shot, y, x), and the snapshots |
| V | orthonormal eigenbasis of the spectra of the current estimate; row m of V z is eigen-image m |
| λ, μ | weight of the prior, and of the penalty that splits data from prior |
| h | mean diagonal element of H Hᵀ: what a detector element gathers |
| x, z, u | estimate that follows the data, estimate that follows the prior, scaled multiplier |
| a | x + u, over-relaxed; the prior's input |
| p | dual images of the total variation, kept from one iteration to the next |
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from shadowgram._threads import run_chunks
from shadowgram.operators.base import LinearOperator
from shadowgram.priors import _tv_kernels

from . import _eigen_tv_kernels as kernels
from ._data_step import data_step, energy
from ._noise_level import noise_level

# Chosen on two real cubes, 3 and 6 shots, 20 dB to noise-free; docs/decisions/0004-eigen-tv.md has the measurements.
_LAMBDA_FACTOR, _LAMBDA_POWER = 0.45, 1.25  # λ/h of the noise of a voxel, amplitudes in units of the mean scene value
_FIRST_LAMBDA, _LEAST_LAMBDA = 0.1, 1e-4
_FITTED_NOISE = 0.87  # share of the noise that a fit leaves in the residual, whose scale is the one λ was chosen on
_BRIGHTNESSES = 8  # groups of detector elements whose noise may differ
# Eigen-image m is weighted by (m + 1)^p, p = 0.5 − 0.9/Q²: with several shots the later ones hold less of the scene than of noise;
# with one shot they are all that tells the bands apart.
_RANK_POWER, _RANK_POWER_OF_ONE_SHOT = 0.5, 0.9
# A detector wider than the scene sees its bands side by side, and with few shots a band that moves along x costs the data little.
# Only the first eigen-images, which all bands share, hold the edges together; and with the others held down, less λ is enough.
_RANK_POWER_ACROSS, _CAUTION_ACROSS, _FEW_SHOTS = 1.0, 0.45, 0.25
TV_ITERATIONS = 6
REFRESH = 5  # iterations between estimates of V and λ
_RELAXATION = 1.6
_PULL = 0.3  # of μ towards the prior
_PACE = 0.03  # λ may fall as fast as the cube changes: by half where that is 1.5 % an iteration


class Splitting:
    """Where the iteration stands. The snapshots are in units in which the scene's mean value is about 1.

    The data step needs r = H(2z − a) − y; with Ha − y kept beside a, that gives the residual of z without another H.
    """

    def __init__(
        self, H: LinearOperator, y: np.ndarray, response: np.ndarray, noise: float | None, nonnegative: bool
    ) -> None:
        self.H, self.known_noise = H, noise is not None
        self.least = y.dtype.type(0 if nonnegative else -math.inf)
        dtype = y.dtype
        self.amplitude = math.sqrt(energy(y) / energy(response))
        self.y = y / dtype.type(self.amplitude)
        lit = np.flatnonzero(response > 1e-3 * response.max())
        sample = lit[:: lit.size // 50_000 | 1]  # of the residual, for its medians; odd, to meet every column
        self.sample = np.array_split(sample[np.argsort(self.y.ravel()[sample], kind="stable")], _BRIGHTNESSES)
        self.noise = noise_level(H, self.y) if noise is None else noise / self.amplitude
        bands, shots = H.in_shape[0], H.out_shape[0]
        self.caution = _caution(H)
        # How much of the flattest windows' noise is beyond doubt: they hold texture too, but where the shots are nearly as many as
        # the bands, or one, the residual can be explained away, and they are all there is.
        self.trust = min(1.0, 0.5 + shots / bands + shots**-4)
        self.ranks = np.arange(1, bands + 1) ** _rank_power(H)
        self.pull = _PULL * (1 - 2 / 3 / shots**2)
        self.correction = np.zeros(H.in_shape, dtype)
        self.solver = data_step(H, self.correction)
        self.gain = self.solver.gain
        self.change, self.settled = 0.0, False
        self.strength = max(_FIRST_LAMBDA, shots**-3)
        self.mu = self.penalty()
        self.solver.prepare(self.mu)
        self.w = np.zeros_like(self.y)
        self.solver.solve(self.y, self.w)
        self.z = H.adjoint(self.w)
        self.a = self.z.copy()
        self.reflected = self.z.copy()
        self.p = np.zeros((H.in_shape[0], 2, *H.in_shape[1:]), dtype)
        self.basis = _eigenbasis(self.z)
        self.r = H.forward(self.z) - self.y
        self.residual, self.residual_of_a = self.r.copy(), self.r.copy()
        self.sums = np.zeros((H.in_shape[1], 2))

    def penalty(self) -> float:
        """μ: the cube root keeps both halves of the iteration about equally fast over four decades of λ."""
        return self.gain * min(max((self.pull * self.strength) ** (1 / 3), 1e-2), 1.0)

    def wanted_strength(self) -> float:
        """λ/h by the noise of a voxel: that of the snapshots over √h."""
        noise = _FITTED_NOISE * self.noise
        if not self.known_noise:
            noise = max(self.trust * noise, self.residual_noise())
        strength = _LAMBDA_FACTOR * (self.caution * noise / math.sqrt(self.gain)) ** _LAMBDA_POWER
        return max(strength, _LEAST_LAMBDA, self.strength * min(1.0, self.change / _PACE))

    def residual_noise(self) -> float:
        """Of the residual, which the flattest windows know nothing of: errors of the model, and photons where it is bright."""
        residual = self.residual.ravel()
        medians = [float(np.median(np.abs(residual[part]))) for part in self.sample if part.size]
        return math.sqrt(np.mean(np.square(medians))) / 0.6745

    def refresh(self) -> None:
        """Estimate λ and the eigenbasis anew, and carry the multipliers over."""
        dtype, rows = self.z.dtype, self.z.shape[1]
        strength, mu, basis = self.strength, self.mu, self.basis
        wanted = self.wanted_strength()
        self.settled = abs(math.log(wanted / strength)) < 0.1
        factor = 1.0
        if abs(math.log(wanted / strength)) > 0.02:
            self.strength = wanted
            self.mu = self.penalty()
            self.solver.prepare(self.mu)
            factor = self.strength / strength * mu / self.mu
            run_chunks(kernels.rescale, rows, 8, dtype.type(factor), self.z, self.a, self.reflected)
            self.residual_of_a = self.residual + dtype.type(factor) * (self.residual_of_a - self.residual)
            self.r = 2 * self.residual - self.residual_of_a
        self.basis = _eigenbasis(self.z)
        rotation = np.ascontiguousarray(factor * self.basis @ basis.T, dtype)
        run_chunks(kernels.rotate_duals, rows, 8, rotation, self.p)

    def iterate(self, prior: Callable[[np.ndarray], None]) -> None:
        """One iteration, from the data step to the residual of the new z; `prior` changes the eigen-images of a in place."""
        dtype, rows = self.z.dtype, self.z.shape[1]
        relaxation = dtype.type(_RELAXATION)
        seen = self.solver.solve(self.r, self.w)
        self.H.adjoint(self.w, out=self.correction)
        self.residual_of_a += relaxation * (self.residual - self.residual_of_a - seen)
        basis = self.basis.astype(dtype)
        run_chunks(kernels.to_eigen, rows, 8, basis, self.z, self.correction, relaxation, self.a, self.reflected)
        prior(self.reflected)
        inverse = np.ascontiguousarray(basis.T)
        run_chunks(kernels.from_eigen, rows, 8, inverse, self.reflected, self.a, self.least, self.z, self.sums)

        self.H.forward(self.reflected, out=self.r)
        self.r -= self.y
        self.residual = (self.r + self.residual_of_a) / 2
        change, size = self.sums.sum(axis=0)
        self.change = math.sqrt(change / size) if size > 0 else 0.0

    def weights(self) -> np.ndarray:
        """Weight of the total variation of each eigen-image against half its squared distance from a."""
        return (self.ranks * (self.strength * self.gain / self.mu)).astype(self.z.dtype)

    def total_variation(self, images: np.ndarray) -> None:
        """The proximal map of the total variation, a few iterations from the previous duals, in place."""
        run_chunks(_tv_kernels.smooth, len(images), 1, images, self.p, self.weights(), TV_ITERATIONS, images)


def _bands_may_part(H: LinearOperator) -> bool:
    """Whether bands fall beside one another, as in a CASSI with one disperser, and the shots are few against them."""
    return H.out_shape[2] > H.in_shape[2] and H.out_shape[0] < _FEW_SHOTS * H.in_shape[0]


def _rank_power(H: LinearOperator) -> float:
    """The power of m + 1 by which eigen-image m is weighted."""
    if _bands_may_part(H):
        return _RANK_POWER_ACROSS
    return _RANK_POWER - _RANK_POWER_OF_ONE_SHOT / H.out_shape[0] ** 2


def _caution(H: LinearOperator) -> float:
    """By how much more than one voxel's noise λ has to count: a single shot can be explained by any noise, and where there are
    nearly as many shots as bands there is no interference between bands that would hide it.
    """
    shots = H.out_shape[0]
    crowded = 1 + 0.75 * shots / H.in_shape[0]
    return _CAUTION_ACROSS * crowded if _bands_may_part(H) else max((1 + 2 / shots**4) ** 0.8, crowded)


def _eigenbasis(z: np.ndarray) -> np.ndarray:
    """Orthonormal rows that diagonalise the second moments of spectra and of their spatial gradients, in equal shares.

    The total variation is that of gradients; spectra alone would spread the details of a smooth scene over many eigen-images.
    """
    bands, rows = z.shape[:2]
    sums = np.zeros((rows, 2, bands, bands))
    run_chunks(kernels.moments, rows, 8, z, sums)
    values, gradients = sums.sum(axis=0)
    tiny = np.finfo(float).tiny
    moment = values / max(np.trace(values), tiny) + gradients / max(np.trace(gradients), tiny)
    vectors = np.linalg.eigh(moment)[1][:, ::-1].T
    largest = np.abs(vectors).argmax(axis=1)
    return vectors * np.sign(vectors[np.arange(bands), largest])[:, None]
