"""Special structure of operators, as functions: the Gram matrix over shots, and the norm."""

from __future__ import annotations

from functools import singledispatch

import numpy as np

from .base import LinearOperator


@singledispatch
def shot_gram(A: LinearOperator) -> np.ndarray | None:  # noqa: ARG001 - the general case knows nothing of A
    """Return H Hᵀ as one shot × shot matrix per detector element, if it has that form.

    It does when every voxel falls on a single detector element: then different detector elements do not share light.

    Returns
    -------
    (shot, shot, y, x) float64 array, or None if H Hᵀ is not of that form or not known to be.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.operators.structure import shot_gram
    >>> imager = sg.DualCASSI(cube_shape=(3, 8, 8), wavelengths=(450, 650))
    >>> gram = shot_gram(imager.operator(sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0)))
    >>> gram.shape, bool((gram.sum(axis=(0, 1)) == 3).all())
    ((2, 2, 8, 8), True)
    """
    return None


def pixel_gram(A: LinearOperator) -> np.ndarray | None:
    """H Hᵀ per detector element of an operator whose elements see one pixel of the scene each, found by applying it.

    Such an operator is g[q, y, x] = Σ_k c[q, k, y, x] f[k, y, x]; a scene that is 1 in band k and 0 elsewhere shows c of that band.

    Parameters
    ----------
    A : operator (band, y, x) → (shot, y, x).

    Returns
    -------
    (shot, shot, y, x) float64 array Σ_k c[q, k] c[r, k], or None if a random scene shows that A is not of that form.
    """
    if A.in_shape[1:] != A.out_shape[1:]:
        return None
    scene = np.random.default_rng(0).standard_normal(A.in_shape)
    one_band, seen = np.zeros(A.in_shape), np.zeros(A.out_shape)
    gram = np.zeros((A.out_shape[0], *A.out_shape))
    for k in range(A.in_shape[0]):
        one_band[k] = 1
        weights = A.forward(one_band)
        one_band[k] = 0
        seen += weights * scene[k]
        gram += weights[:, None] * weights[None]
    # Anything else would differ by about as much as the images themselves.
    wrong = np.abs(A.forward(scene) - seen).max(initial=0.0)
    return gram if wrong <= 1e-6 * np.abs(seen).max(initial=0.0) else None


def norm(A: LinearOperator) -> float:
    """Largest singular value of `A`: exact where `shot_gram` is known, else by power iteration (to about 1 %, from below).

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> from shadowgram.operators.structure import norm
    >>> imager = sg.DualCASSI(cube_shape=(4, 8, 8), wavelengths=(450, 650))
    >>> norm(imager.operator(np.ones(imager.code_shape)))
    2.0
    """
    gram = shot_gram(A)
    if gram is not None:
        return float(np.sqrt(np.linalg.eigvalsh(np.moveaxis(gram, (2, 3), (0, 1)))[..., -1].max(initial=0.0)))
    x = np.random.default_rng(0).random(A.in_shape)
    square = 0.0
    for _ in range(100):
        x /= max(float(np.linalg.norm(x)), np.finfo(float).tiny)
        x = A.adjoint(A.forward(x))
        before, square = square, float(np.linalg.norm(x))
        if square - before <= 1e-4 * square:
            break
    return square**0.5
