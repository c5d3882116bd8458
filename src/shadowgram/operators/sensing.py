"""How well a code lets a camera tell scenes apart: what is sensed, coherence, and how near the sensing matrix is to an isometry.

The sensing matrix A = HΨ takes the coefficients of a scene in a basis Ψ to the measurements; without a basis it is H, whose columns
are voxels. Its restricted isometry constant δ_S (Salazar 2022, eqs. 3.1 and 3.2; Candès 2008) says by how much A changes the energy
of a scene with S coefficients at most. To find it is NP-hard: here it is bounded from below by random supports, and what bounds
it from above (eq. 3.7), ‖AᵀA − I‖_F, is computed for groups of voxels that share detector elements.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .adapters import as_matrix
from .base import LinearOperator, Shape

MOST_COLUMNS = 8192  # of a dense sensing matrix: its Gram matrix is worked through in a few seconds
MOST_NUMBERS = 2**26  # in a dense matrix: 512 MiB
MOST_SHORT = 4096  # rows or columns, whichever are fewer, that are gone through one by one
MOST_VALUES = 2048  # singular values: about a minute
EQUAL = 1e-6  # transmittances are kept in float32
NOTHING = 1e-10  # of a column's norm: what a transform leaves of a zero
BINS = 100
PROBES = 64


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensed:
    """How often each voxel is sensed.

    Attributes
    ----------
    weight : (band, y, x) sum over all measurements of what they take of the voxel: Σ_q t̂ for an `SSCSI`.
    never, partly, once, repeatedly : shares of voxels with a weight of 0, between 0 and 1, of 1, and above 1; they add up to 1.
        Complementary codes sense every voxel once, where no light misses the mask.
    """

    weight: np.ndarray
    never: float
    partly: float
    once: float
    repeatedly: float


def sensed(H: LinearOperator) -> Sensed:
    """Find how often the voxels of a scene are sensed, Hᵀ1.

    Parameters
    ----------
    H : forward model of an imager, (band, y, x) → snapshots, with transmittances that are not negative.

    Returns
    -------
    Sensed

    Raises
    ------
    ValueError
        If H has negative sums: then it does not pass light.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.operators.sensing import sensed
    >>> imager = sg.SSCSI(detector_shape=(32, 32), detector_pitch=10.0, code_pitch=10.0, mask_position=0.125,
    ...                   wavelengths=(450, 650))
    >>> sensed(imager.operator(sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0))).once
    1.0
    >>> random = sensed(imager.operator(sg.codes.random(shots=2, shape=imager.code_shape, seed=0)))
    >>> round(random.never, 2), round(random.repeatedly, 2)
    (0.03, 0.44)
    """
    weight = H.adjoint(np.ones(H.out_shape))
    if weight.min() < -EQUAL:
        raise ValueError(
            "sensed counts light, and this operator has negative weights; use coherence or isometry for it"
        )
    never, once = weight <= EQUAL, np.abs(weight - 1) <= EQUAL
    repeatedly = weight > 1 + EQUAL
    partly = ~(never | once | repeatedly)
    return Sensed(
        weight=weight,
        never=float(never.mean()),
        partly=float(partly.mean()),
        once=float(once.mean()),
        repeatedly=float(repeatedly.mean()),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Coherence:
    """Likeness |⟨a, b⟩|/(‖a‖ ‖b‖) of the columns of a sensing matrix, over all pairs that share a measurement.

    Attributes
    ----------
    mutual : the largest, mutual coherence; 1 if two columns cannot be told apart, 0 if no columns share a measurement.
    rms : root mean square.
    pairs : number of pairs.
    histogram : (100,) number of pairs, over equal bins from 0 to 1.
    unsensed : number of columns that no measurement sees, which are left out.
    """

    mutual: float
    rms: float
    pairs: int
    histogram: np.ndarray
    unsensed: int

    def quantile(self, share: float) -> float:
        """Likeness that `share` of the pairs do not exceed, to within a bin of the histogram."""
        if not 0 <= share <= 1:
            raise ValueError(f"share must lie between 0 and 1, got {share}")
        upto = np.concatenate([[0], np.cumsum(self.histogram)])
        return float(np.interp(share * self.pairs, upto, np.arange(BINS + 1) / BINS)) if self.pairs else 0.0


def coherence(H: LinearOperator, basis: LinearOperator | None = None) -> Coherence:
    """Measure the coherence of a sensing matrix.

    Parameters
    ----------
    H : forward model, at most 8,192 voxels. Detector rows of a spectral imager share no light, so one with all columns and a few
        rows stands for a larger one.
    basis : Ψ, coefficients → scene; without it the columns are voxels, and only those share a measurement that share a detector
        element.

    Returns
    -------
    Coherence

    Raises
    ------
    ValueError
        If the matrix is too large, or the basis is of another scene.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.operators.sensing import coherence
    >>> imager = sg.SSCSI(detector_shape=(16, 16), detector_pitch=10.0, code_pitch=10.0, mask_position=0.25,
    ...                   wavelengths=(450, 650))
    >>> H = imager.operator(sg.codes.boolean(shots=4, shape=imager.code_shape, seed=0))
    >>> found = coherence(H)
    >>> found.pairs <= 16 * 16 * 6, round(found.mutual, 6)
    (True, 1.0)
    """
    A = _dense(_sensing(H, basis), "coherence")
    length = np.linalg.norm(A, axis=0)
    seen = length > NOTHING * max(float(length.max()), np.finfo(float).tiny)
    A = A[:, seen] / length[seen]
    histogram, pairs, largest, squares = np.zeros(BINS, np.int64), 0, 0.0, 0.0
    for start in range(0, A.shape[1], 512):
        shared = _likeness(A, start, min(start + 512, A.shape[1]))
        pairs += shared.size
        largest = max(largest, float(shared.max(initial=0.0)))
        squares += float(np.square(shared).sum())
        histogram += np.histogram(shared, BINS, (0, 1))[0]
    return Coherence(
        mutual=largest,
        rms=math.sqrt(squares / pairs) if pairs else 0.0,
        pairs=pairs,
        histogram=histogram,
        unsensed=int((~seen).sum()),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Isometry:
    """How far random sets of columns of a sensing matrix are from orthonormal.

    Attributes
    ----------
    sparsity : S, columns in a set.
    column_energy : mean of ‖a‖² over all columns, by which A was scaled: A/√energy is what the deviations are of.
    deviations : (trial,) ‖A_ρᵀA_ρ − I‖₂ of each set ρ.
    """

    sparsity: int
    column_energy: float
    deviations: np.ndarray

    @property
    def lower_bound(self) -> float:
        """Largest deviation found: the restricted isometry constant δ_S is at least that."""
        return float(self.deviations.max())


def isometry(
    H: LinearOperator, *, basis: LinearOperator | None, sparsity: int, trials: int = 100, seed: int = 0
) -> Isometry:
    """Estimate the restricted isometry constant of A = HΨ by random supports.

    A is scaled by one number, so that the mean energy ‖a‖² of its columns is 1: the constant depends on the scale, and a brighter
    scene is not a better code. The mean is exact for matrices of up to 4,096 rows or columns; else it is estimated with 64 random
    signs, to about 0.3 %.

    Parameters
    ----------
    H : forward model, of any size.
    basis : Ψ, coefficients → scene, such as ``operators.basis("dct-sym8", H.in_shape)``; None for voxels.
    sparsity : S, number of coefficients in a support.
    trials : number of supports, drawn without regard to which coefficients scenes have.
    seed : of the supports.

    Returns
    -------
    Isometry

    Raises
    ------
    ValueError
        If a number is out of range, the columns of a support do not fit in memory, or the basis is of another scene.

    Notes
    -----
    Source: Salazar (2022), eq. (3.2), with the maximum over all supports replaced by one over random ones. A mask takes light away
    and never adds a negative, so smooth atoms are seen much brighter than others: in a wavelet basis the constant is above 1, where
    it promises nothing about recovery and only compares codes.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.operators.sensing import isometry
    >>> imager = sg.SSCSI(detector_shape=(32, 32), detector_pitch=10.0, code_pitch=10.0, mask_position=0.125,
    ...                   wavelengths=(450, 650))
    >>> H = imager.operator(sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0))
    >>> found = isometry(H, basis=sg.operators.basis("dct-sym8", H.in_shape), sparsity=20, trials=10)
    >>> found.deviations.shape, 0 < found.lower_bound
    ((10,), True)
    """
    A = _sensing(H, basis)
    rows, columns = math.prod(A.out_shape), math.prod(A.in_shape)
    if not 1 <= sparsity <= columns:
        raise ValueError(f"sparsity must be from 1 to the {columns} columns of the sensing matrix, got {sparsity}")
    if trials < 1:
        raise ValueError(f"trials must be at least 1, got {trials}")
    if rows * sparsity > MOST_NUMBERS:
        raise ValueError(
            f"{sparsity} columns of {rows} measurements do not fit in memory: use a sparsity of at most {MOST_NUMBERS // rows}"
            " or a smaller imager"
        )
    rng = np.random.default_rng(seed)
    energy = _mean_column_energy(A, rng)
    if energy == 0:
        raise ValueError("the operator measures nothing: all its weights are 0")
    deviations = np.empty(trials)
    chosen = np.empty((sparsity, rows))
    for trial in range(trials):
        for row, column in enumerate(rng.choice(columns, sparsity, replace=False)):
            chosen[row] = _column(A, column)
        spectrum = np.linalg.eigvalsh(chosen @ chosen.T / energy)
        deviations[trial] = np.abs(spectrum - 1).max()
    return Isometry(sparsity=sparsity, column_energy=energy, deviations=deviations)


def pixel_groups(shape: Shape, *, count: int, window: tuple[int, int] = (3, 3), seed: int = 0) -> np.ndarray:
    """Draw groups of voxels that can be confused: all bands of a window of pixels, at random places.

    Parameters
    ----------
    shape : (band, y, x) of the scene, ``H.in_shape``.
    count : number of groups; places can come up more than once.
    window : (y, x) pixels.
    seed : of the places.

    Returns
    -------
    (count, band·y·x) int array of flat voxel indices, for `gram_deviation`.

    Raises
    ------
    ValueError
        If the window does not fit, or count is below 1.

    Examples
    --------
    >>> from shadowgram.operators.sensing import pixel_groups
    >>> pixel_groups((2, 8, 8), count=5, window=(1, 3)).shape
    (5, 6)
    """
    if len(shape) != 3 or not (1 <= window[0] <= shape[1] and 1 <= window[1] <= shape[2]):
        raise ValueError(
            f"a window of {window[0]} × {window[1]} pixels does not fit a scene (band, y, x) of shape {shape}"
        )
    if count < 1:
        raise ValueError(f"count must be at least 1, got {count}")
    voxels = np.arange(math.prod(shape)).reshape(shape)
    first = voxels[:, : window[0], : window[1]].ravel()
    rng = np.random.default_rng(seed)
    y, x = rng.integers(shape[1] - window[0] + 1, size=count), rng.integers(shape[2] - window[1] + 1, size=count)
    return first + (y * shape[2] + x)[:, None]


def gram_deviation(H: LinearOperator, groups: np.ndarray) -> np.ndarray:
    """Deviation ‖H_ρᵀH_ρ − I‖_F of groups ρ of voxels from what can be told apart perfectly; H is not scaled.

    Parameters
    ----------
    H : forward model, of any size.
    groups : (group, size) flat voxel indices, in C order, such as of `pixel_groups`.

    Returns
    -------
    (group,) float64 array.

    Raises
    ------
    ValueError
        If groups are not voxels of the scene, or a group holds one twice.

    Notes
    -----
    Source: Salazar (2022), eq. (3.7), which bounds δ_S from above, here over the columns of a group and without the basis, as the
    cost (3.15) of the code optimisation has it.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.operators.sensing import gram_deviation, pixel_groups
    >>> imager = sg.SSCSI(detector_shape=(32, 32), detector_pitch=10.0, code_pitch=10.0, mask_position=0.125,
    ...                   wavelengths=(450, 650))
    >>> boolean, random = (imager.operator(make(shots=4, shape=imager.code_shape, seed=0))
    ...                    for make in (sg.codes.boolean, sg.codes.random))
    >>> groups = pixel_groups(boolean.in_shape, count=20)
    >>> bool(gram_deviation(boolean, groups).mean() < gram_deviation(random, groups).mean())
    True
    """
    groups = np.asarray(groups)
    voxels = math.prod(H.in_shape)
    if groups.ndim != 2 or groups.dtype.kind not in "iu" or not groups.size:
        raise ValueError(
            f"groups must be whole numbers (group, size), got an array of shape {groups.shape} and {groups.dtype}"
        )
    if groups.min() < 0 or groups.max() >= voxels:
        raise ValueError(f"groups must hold voxels from 0 to {voxels - 1}, got {groups.min()} to {groups.max()}")
    if (np.diff(np.sort(groups, axis=1), axis=1) == 0).any():
        raise ValueError("a group holds the same voxel twice; a voxel cannot be told apart from itself")
    return np.array([_deviation(H, group) for group in groups])


def singular_values(H: LinearOperator, basis: LinearOperator | None = None) -> np.ndarray:
    """Singular values of the sensing matrix, largest first.

    Parameters
    ----------
    H : forward model, small: at most 2,048 measurements or voxels, whichever are fewer, and 2²⁶ numbers in the matrix.
    basis : Ψ, coefficients → scene. An orthonormal one changes nothing.

    Returns
    -------
    (min(measurements, coefficients),) float64 array.

    Raises
    ------
    ValueError
        If the matrix is too large, or the basis is of another scene.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> from shadowgram.operators.sensing import singular_values
    >>> imager = sg.DualCASSI(cube_shape=(4, 8, 8), wavelengths=(450, 650))
    >>> values = singular_values(imager.operator(np.ones(imager.code_shape)))
    >>> values.shape, values.max().round(6)
    ((64,), np.float64(2.0))
    """
    A = _sensing(H, basis)
    short = min(math.prod(A.in_shape), math.prod(A.out_shape))
    if short > MOST_VALUES:
        raise ValueError(
            f"the singular values of {short} measurements or voxels take too long (at most {MOST_VALUES});"
            " use an imager with fewer detector rows"
        )
    return np.linalg.svd(_dense(A, "singular_values", math.prod(A.in_shape)), compute_uv=False)


def _sensing(H: LinearOperator, basis: LinearOperator | None) -> LinearOperator:
    """A = HΨ."""
    if basis is None:
        return H
    if basis.out_shape != H.in_shape:
        raise ValueError(
            f"the basis makes scenes of shape {basis.out_shape}, and the imager sees {H.in_shape}; make it for that shape"
        )
    return H @ basis


def _dense(A: LinearOperator, name: str, most: int = MOST_COLUMNS) -> np.ndarray:
    """(rows, columns) of a small operator."""
    rows, columns = math.prod(A.out_shape), math.prod(A.in_shape)
    if columns > most or rows * columns > MOST_NUMBERS:
        raise ValueError(
            f"{name} needs the whole sensing matrix, and {rows} × {columns} is too large (at most {most} columns and"
            f" {MOST_NUMBERS} numbers); use an imager with fewer detector rows"
        )
    return as_matrix(A) if columns <= rows else as_matrix(A.H).T


def _likeness(A: np.ndarray, start: int, stop: int) -> np.ndarray:
    """Likeness of unit columns from `start` to `stop` and all later ones, of the pairs that share a measurement."""
    own, later = A[:, start:stop], A[:, start:]
    gram = np.abs(own.T @ later)
    sees_own, sees_later = (np.abs(part) > NOTHING for part in (own, later))
    shares = sees_own.T.astype(np.float32) @ sees_later.astype(np.float32) > 0
    return np.minimum(gram[np.triu(shares, 1)], 1.0)


def _column(A: LinearOperator, index: int) -> np.ndarray:
    """Column of the matrix of A, flat."""
    unit = np.zeros(A.in_shape)
    unit.flat[index] = 1
    return A.forward(unit).ravel()


def _mean_column_energy(A: LinearOperator, rng: np.random.Generator) -> float:
    """‖A‖²_F over the number of columns."""
    columns = math.prod(A.in_shape)
    wide = A if columns <= math.prod(A.out_shape) else A.H
    short = math.prod(wide.in_shape)
    if short <= MOST_SHORT:
        return sum(float(np.square(_column(wide, i)).sum()) for i in range(short)) / columns
    # E ‖Aᵀw‖² = ‖A‖²_F for random signs w (Hutchinson 1990); rows of A, disjoint shots, are nearer to orthogonal than its columns.
    signs = (rng.choice([-1.0, 1.0], size=A.out_shape) for _ in range(PROBES))
    return sum(float(np.square(A.adjoint(w)).sum()) for w in signs) / PROBES / columns


def _deviation(H: LinearOperator, group: np.ndarray) -> float:
    """‖H_ρᵀH_ρ − I‖_F of one group, on the measurements that see any of it."""
    seen, values = [], []
    for voxel in group:
        column = _column(H, voxel)
        seen.append(np.flatnonzero(column))
        values.append(column[seen[-1]])
    rows = np.unique(np.concatenate(seen))
    few = np.zeros((len(group), rows.size))
    for i, (at, value) in enumerate(zip(seen, values, strict=True)):
        few[i, np.searchsorted(rows, at)] = value
    return float(np.linalg.norm(few @ few.T - np.eye(len(group))))
