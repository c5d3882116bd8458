"""How far to trust a reconstruction, voxel by voxel."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from shadowgram.operators.base import LinearOperator

from ._parts import Weighted
from .solution import Solution, check_problem, solve


@dataclass(frozen=True, kw_only=True, eq=False)
class Uncertainty:
    """Spread of reconstructions of the same scene.

    Attributes
    ----------
    std : (band, y, x) standard deviations, in the units of the cube.
    samples : reconstructions that it was made from.
    interrupted : whether Ctrl-C ended it before all the samples that were asked for.
    """

    std: np.ndarray
    samples: int
    interrupted: bool = False


def uncertainty(
    spec: object,
    H: LinearOperator,
    y: np.ndarray,
    solution: Solution,
    *,
    seed: int,
    samples: int = 8,
    callback: Callable[[int, int], None] | None = None,
) -> Uncertainty:
    """Estimate the standard deviation of every voxel of a reconstruction, from reconstructions of halves of the measurement.

    Parameters
    ----------
    spec : the solver that gave `solution`.
    H, y : forward model and snapshots (shot, y, x), as they were given to `solve`.
    solution : its result.
    seed : whole number, 0 or more. Same seed, same map, for any number of threads.
    samples : reconstructions to make, 2 or more; each costs about as much as the solution.
    callback : called as ``callback(samples so far, iterations of the next one)`` after every iteration.

    Returns
    -------
    Uncertainty
        After Ctrl-C, from the samples so far, if there are two; else `KeyboardInterrupt` goes on to the caller.

    Raises
    ------
    ValueError
        If the samples are fewer than 2, the seed is negative, or `solution` is not of `H`.

    Notes
    -----
    Each sample is reconstructed from a random half of the detector's elements, and the next one from the other half. With half the
    data an average has twice the variance, and differs from the average of all data by just the variance of the latter: the map
    is √ of the mean square of the samples less the solution, averaged over 3 × 3 pixels. It covers noise, photons' as well, and
    how well the codes tell the bands apart.

    What it does not cover is what all samples have in common: details that the prior smooths away whatever the data, a wrong
    model, and light that no shot has seen. On real cubes through an `SSCSI`, 2 and 4 shots, with and without noise, the map's mean
    square was 0.4 to 3 times that of the true error, and the error within twice the map in 56 % (a scene with fine texture, whose
    bias is most of the error) to 96 % of the voxels; its rank correlation with the error was 0.2 to 0.65.

    Source: Efron (1982), "The Jackknife, the Bootstrap and Other Resampling Plans", chapter 8 (half-sampling).

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.solvers.uncertainty import uncertainty
    >>> cube = sg.scenes.chart(size=32, bands=4, seed=0).values
    >>> imager = sg.DualCASSI(cube_shape=cube.shape, wavelengths=(450, 650))
    >>> H = imager.operator(sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0))
    >>> y = H.forward(cube)
    >>> solution = sg.solve(sg.EigenTV(max_iter=20), H, y)
    >>> found = uncertainty(sg.EigenTV(max_iter=20), H, y, solution, seed=0, samples=2)
    >>> found.std.shape, bool((found.std >= 0).all())
    ((4, 32, 32), True)
    """
    y = check_problem(H, y)
    if not isinstance(samples, int | np.integer) or samples < 2:
        raise ValueError(f"uncertainty needs 2 samples or more, got {samples!r}")
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise ValueError(f"uncertainty: seed is a whole number of 0 or more, got {seed!r}")
    if solution.x.shape != H.in_shape or len(H.in_shape) != 3:
        raise ValueError(
            f"uncertainty needs the solution (band, y, x) of this operator, which takes {H.in_shape}, got {solution.x.shape}"
        )
    squares = np.zeros(H.in_shape, np.float64)
    done = 0
    try:
        for estimate in _estimates(spec, H, y, samples, seed, callback):
            squares += np.square(estimate - solution.x, dtype=np.float64)
            done += 1
    except KeyboardInterrupt:
        if done < 2:
            raise
    std = np.sqrt(_smoothed(squares / done)).astype(y.dtype)
    return Uncertainty(std=std, samples=done, interrupted=done < samples)


def _estimates(
    spec: object, H: LinearOperator, y: np.ndarray, samples: int, seed: int, callback: Callable[[int, int], None] | None
) -> Iterator[np.ndarray]:
    """Reconstructions from halves of the detector; two by two, they share no element."""
    rng = np.random.default_rng(seed)
    half = np.zeros(y.shape, bool)
    for sample in range(samples):
        half = rng.random(y.shape) < 0.5 if sample % 2 == 0 else ~half

        def told(iteration: int, _: dict[str, float], sample: int = sample) -> None:
            if callback is not None:
                callback(sample, iteration)

        found = solve(spec, Weighted(H, half), np.where(half, y, 0).astype(y.dtype), told)
        if found.interrupted:
            raise KeyboardInterrupt
        yield found.x


def _smoothed(variance: np.ndarray) -> np.ndarray:
    """Mean over 3 × 3 pixels, or fewer at the edges: one of few samples is noisy itself."""
    for axis in (1, 2):
        aligned = np.moveaxis(variance, axis, -1)
        total, count = aligned.copy(), np.ones(aligned.shape[-1])
        total[..., :-1] += aligned[..., 1:]
        total[..., 1:] += aligned[..., :-1]
        count[1:] += 1
        count[:-1] += 1
        variance = np.moveaxis(total / count, -1, axis)
    return variance
