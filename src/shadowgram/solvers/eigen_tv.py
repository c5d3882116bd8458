"""EigenTV: reconstruction with the total variation of the cube's eigen-images.

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
import time
from dataclasses import dataclass

import numpy as np

from shadowgram._threads import run_chunks
from shadowgram.operators.base import LinearOperator
from shadowgram.operators.structure import shot_gram
from shadowgram.priors import _tv_kernels

from . import _eigen_tv_kernels as kernels
from ._noise_level import noise_level
from .solution import Callback, Solution, check_problem, solve

# Chosen on two real cubes, 3 and 6 shots, 20 dB to noise-free; docs/decisions/0004-eigen-tv.md has the measurements.
_LAMBDA_FACTOR, _LAMBDA_POWER = 0.45, 1.25  # λ/h of the noise of a voxel, amplitudes in units of the mean scene value
_FIRST_LAMBDA, _LEAST_LAMBDA = 0.1, 1e-4
_FITTED_NOISE = 0.87  # share of the noise that a fit leaves in the residual, whose scale is the one λ was chosen on
_RANK_POWER = 0.5  # eigen-image m is weighted by (m + 1)^0.5: the later ones hold less of the scene, and as much noise
_TV_ITERATIONS = 6
_REFRESH = 5  # iterations between estimates of V and λ
_RELAXATION = 1.6
_PACE = 0.03  # λ may fall as fast as the cube changes: by half where that is 1.5 % an iteration


@dataclass(frozen=True, kw_only=True)
class EigenTV:
    """Specification of a reconstruction by total variation in the cube's own eigenbasis.

    Problem: min over x of ½‖Hx − y‖² + λ Σ_m (m + 1)^½ TV((V x)_m), with V the eigenbasis of the spectra and of the spatial
    gradients of x itself, so that nearly all of the scene lies in the first few eigen-images.

    Parameters
    ----------
    noise : standard deviation of the noise of the snapshots, in their units, if it is known. By default it is the larger
        of what the flattest parts of the snapshots show and of the residual, and so covers errors of the model too. Known
        photon noise is worth saying (its root mean square).
    nonnegative : whether no value of the cube can be below zero, as for reflectance and radiance.
    max_iter : most iterations.
    tol : converged when the relative change of the cube in one iteration falls below this, with λ settled.

    Raises
    ------
    ValueError
        If a parameter is out of its range.

    Notes
    -----
    Iteration (alternating directions, over-relaxed): x ← z − u − Hᵀ(HHᵀ + μI)⁻¹(H(z − u) − y), which is exact, by one
    shot × shot matrix a detector element where `shot_gram` knows them and by conjugate gradients elsewhere;
    z ← Vᵀ prox_TV(V(x + u)), a few iterations from the previous duals, and z ← max(z, 0); u ← u + x − z. Every fifth
    iteration V is estimated anew, and λ = 0.45 h (c σ/√h)^1.25, with σ the noise, amplitudes in units of the mean scene
    value, and c = max((1 + 2/Q⁴)^0.8, 1 + 0.75 Q/L) for Q shots and L bands; λ falls no faster than the cube changes, and
    μ = h (0.3 λ/h)^⅓. The multiplier μu is carried over in proportion to λ.

    The history of `solve` has ``"residual"`` ‖Hx − y‖₂, ``"change"`` ‖x − previous x‖/‖x‖, ``"lambda"``, ``"mu"`` and
    ``"seconds"`` since the start, for every iteration.

    Sources: Boyd et al. (2011), sections 3.1 and 3.4.3 (the splitting, over-relaxation); Beck & Teboulle (2009),
    "Fast gradient-based algorithms for constrained total variation image denoising" (the proximal map).

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> truth = np.ones((4, 16, 16), np.float32)
    >>> truth[:, 4:12, 4:12] = np.array([0.2, 0.5, 0.7, 0.3])[:, None, None]
    >>> imager = sg.DualCASSI(cube_shape=truth.shape, wavelengths=(450, 650))
    >>> H = imager.operator(sg.codes.boolean(shots=3, shape=imager.code_shape, seed=0))
    >>> solution = sg.solve(sg.EigenTV(), H, H.forward(truth))
    >>> sg.metrics.psnr(solution.x, truth, peak=1.0) > 30
    True
    """

    noise: float | None = None
    nonnegative: bool = True
    max_iter: int = 100
    tol: float = 5e-4

    def __post_init__(self) -> None:
        if self.noise is not None and not 0 <= self.noise < math.inf:
            raise ValueError(
                f"EigenTV: noise is a standard deviation in the snapshots' units, 0 or more, got {self.noise}"
            )
        if not isinstance(self.max_iter, int | np.integer) or self.max_iter < 1:
            raise ValueError(f"EigenTV: max_iter must be a whole number of at least 1, got {self.max_iter!r}")
        if not 0 <= self.tol < 1:
            raise ValueError(f"EigenTV: tol is a relative change and must lie in [0, 1), got {self.tol}")


class _PixelSolves:
    """(HHᵀ + μI) w = r by one small inverse per detector element."""

    def __init__(self, gram: np.ndarray) -> None:
        self.gram = gram
        self.inverse = np.empty_like(gram)
        self.mu = gram.dtype.type(0)

    def prepare(self, mu: float) -> None:
        self.mu = self.gram.dtype.type(mu)
        run_chunks(kernels.invert_gram, self.gram.shape[2], 8, self.gram, self.mu, self.inverse)

    def solve(self, r: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Fill `w`; return HHᵀw."""
        run_chunks(kernels.apply_gram, r.shape[1], 8, self.inverse, r, w)
        return r - self.mu * w


class _ConjugateGradients:
    """(HHᵀ + μI) w = r by conjugate gradients from the previous w, for operators whose detector elements share light."""

    def __init__(self, H: LinearOperator, scratch: np.ndarray) -> None:
        self.H, self.scratch = H, scratch
        self.mu = scratch.dtype.type(0)

    def prepare(self, mu: float) -> None:
        self.mu = self.scratch.dtype.type(mu)

    def gram(self, w: np.ndarray) -> np.ndarray:
        return self.H.forward(self.H.adjoint(w, out=self.scratch))

    def solve(self, r: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Improve `w` to 0.1 % of r, or for 20 steps; return HHᵀw."""
        product = self.gram(w)
        rest = r - product - self.mu * w
        direction, energy, enough = rest.copy(), _energy(rest), 1e-6 * _energy(r)
        for _ in range(20):
            if energy <= enough:
                break
            image = self.gram(direction)
            step = r.dtype.type(energy / (_inner(direction, image) + float(self.mu) * _energy(direction)))
            w += step * direction
            product += step * image
            rest -= step * (image + self.mu * direction)
            previous, energy = energy, _energy(rest)
            direction *= r.dtype.type(energy / previous)
            direction += rest
        return product


def _inner(a: np.ndarray, b: np.ndarray) -> float:
    """Inner product in float64, summed in an order that does not depend on the number of threads, as BLAS's may."""
    return float(np.multiply(a, b, dtype=np.float64).sum())


def _energy(a: np.ndarray) -> float:
    return _inner(a, a)


class _Splitting:
    """Where the iteration stands. The snapshots are in units in which the scene's mean value is about 1.

    The data step needs r = H(2z − a) − y; with Ha − y kept beside a, that gives the residual of z without another H.
    """

    def __init__(self, spec: EigenTV, H: LinearOperator, y: np.ndarray, response: np.ndarray) -> None:
        self.spec, self.H = spec, H
        dtype = y.dtype
        self.amplitude = math.sqrt(_energy(y) / _energy(response))
        self.y = y / dtype.type(self.amplitude)
        lit = np.flatnonzero(response > 1e-3 * response.max())
        self.sample = lit[:: lit.size // 50_000 | 1]  # of the residual, for its median; odd, to meet every column
        self.noise = noise_level(H, self.y) if spec.noise is None else spec.noise / self.amplitude
        self.caution = _caution(H.in_shape[0], H.out_shape[0])
        self.correction = np.zeros(H.in_shape, dtype)
        gram = shot_gram(H)
        if gram is None:
            self.solver = _ConjugateGradients(H, self.correction)
            probe = np.random.default_rng(0).choice([-1.0, 1.0], H.out_shape).astype(dtype)
            self.gain = _energy(H.adjoint(probe, out=self.correction)) / probe.size
        else:
            self.gain = float(np.einsum("qqij->", gram)) / y.size
            self.solver = _PixelSolves(gram.astype(dtype))
            del gram  # in float64 it may be as large as three cubes
        self.change, self.settled = 0.0, False
        self.strength = _FIRST_LAMBDA
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
        return self.gain * min(max((0.3 * self.strength) ** (1 / 3), 1e-2), 1.0)

    def wanted_strength(self) -> float:
        """λ/h by the noise of a voxel: that of the snapshots over √h."""
        noise = _FITTED_NOISE * self.noise
        if self.spec.noise is None:
            # The flattest windows know nothing of errors of the model, nor of photon noise where it is bright.
            residual = self.residual.ravel()[self.sample]
            noise = max(noise, float(np.median(np.abs(residual))) / 0.6745)
        strength = _LAMBDA_FACTOR * (self.caution * noise / math.sqrt(self.gain)) ** _LAMBDA_POWER
        return max(strength, _LEAST_LAMBDA, self.strength * min(1.0, self.change / _PACE))

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

    def iterate(self) -> None:
        """One iteration, from the data step to the residual of the new z."""
        dtype, (bands, rows, _) = self.z.dtype, self.z.shape
        relaxation = dtype.type(_RELAXATION)
        seen = self.solver.solve(self.r, self.w)
        self.H.adjoint(self.w, out=self.correction)
        self.residual_of_a += relaxation * (self.residual - self.residual_of_a - seen)
        basis = self.basis.astype(dtype)
        run_chunks(kernels.to_eigen, rows, 8, basis, self.z, self.correction, relaxation, self.a, self.reflected)

        weights = (np.arange(1, bands + 1) ** _RANK_POWER * (self.strength * self.gain / self.mu)).astype(dtype)
        run_chunks(_tv_kernels.smooth, bands, 1, self.reflected, self.p, weights, _TV_ITERATIONS, self.reflected)
        least = dtype.type(0 if self.spec.nonnegative else -math.inf)
        inverse = np.ascontiguousarray(basis.T)
        run_chunks(kernels.from_eigen, rows, 8, inverse, self.reflected, self.a, least, self.z, self.sums)

        self.H.forward(self.reflected, out=self.r)
        self.r -= self.y
        self.residual = (self.r + self.residual_of_a) / 2
        change, size = self.sums.sum(axis=0)
        self.change = math.sqrt(change / size) if size > 0 else 0.0


def _caution(bands: int, shots: int) -> float:
    """By how much more than one voxel's noise λ has to count: a single shot can be explained by any noise, and where there are
    nearly as many shots as bands there is no interference between bands that would hide it.
    """
    return max((1 + 2 / shots**4) ** 0.8, 1 + 0.75 * shots / bands)


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


@solve.register
def _(spec: EigenTV, H: LinearOperator, y: np.ndarray, callback: Callback | None = None) -> Solution:
    begun = time.perf_counter()
    y = check_problem(H, y)
    if len(H.in_shape) != 3 or len(H.out_shape) != 3:
        raise ValueError(
            f"EigenTV reconstructs cubes (band, y, x) from snapshots (shot, y, x), "
            f"but the operator takes {H.in_shape} and gives {H.out_shape}"
        )
    history: dict[str, list[float]] = {name: [] for name in ("residual", "change", "lambda", "mu", "seconds")}
    response = H.forward(np.ones(H.in_shape, y.dtype))
    if not y.any() or not response.any():
        return Solution(np.zeros(H.in_shape, y.dtype), True, 0, history, seconds=time.perf_counter() - begun)
    state = _Splitting(spec, H, y, response)
    converged = interrupted = False
    try:
        for iteration in range(spec.max_iter):
            if iteration > 0 and iteration % _REFRESH == 0:
                state.refresh()
            state.iterate()
            values = {
                "residual": math.sqrt(_energy(state.residual)) * state.amplitude,
                "change": state.change,
                "lambda": state.strength * state.gain * state.amplitude,
                "mu": state.mu,
                "seconds": time.perf_counter() - begun,
            }
            for name, value in values.items():
                history[name].append(value)
            if callback is not None:
                callback(iteration + 1, values)
            converged = state.change < spec.tol and state.settled
            if converged:
                break
    except KeyboardInterrupt:
        interrupted = True
    state.z *= y.dtype.type(state.amplitude)
    iterations = len(history["seconds"])
    return Solution(state.z, converged, iterations, history, interrupted, time.perf_counter() - begun)
