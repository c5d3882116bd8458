"""Classical coded apertures: arrays whose shadow is decoded by correlation, and codes that multiplex shots.

Correlation: a far source displaced by s = (y, x) elements throws the mask's shadow A(· − s) on the detector, which adds up to
D(i) = Σ_s O(s) A(i − s), indices modulo the basic pattern A. The decoding array G has Σ_i A(i − s) G(i − s') = 1 if s = s', else 0,
so that O(s) = Σ_i D(i) G(i − s): one correlation gives the scene back, and a point leaves nothing beside its peak.

Multiplexing: every element of the mask is open in the shots that a column of a Hadamard or S-matrix says.

Sources: Fenimore & Cannon, Appl. Opt. 17 (1978) 337, URA, mosaic and decoding; Gottesman & Fenimore, Appl. Opt. 28 (1989) 4344,
MURA; Harwit & Sloane, Hadamard Transform Optics, Academic Press (1979), S-matrices; Paley, J. Math. Phys. 12 (1933) 311.
"""

from __future__ import annotations

import numpy as np

from ._residues import (
    either,
    hadamard_matrix,
    is_hadamard_order,
    is_prime,
    is_prime_of,
    is_s_order,
    legendre,
    nearest,
    residue_pattern,
    s_sequence,
    whole,
)
from .patterns import _checked_size, _generator, check_code


def ura(p: int, q: int) -> np.ndarray:
    """Uniformly redundant array of twin primes: all displacements but none overlap in equally many open elements.

    Parameters
    ----------
    p, q : sizes along y and x, elements; twin primes, p − q = 2 or −2.

    Returns
    -------
    (y, x) = (p, q) uint8 array of 0 and 1, the basic pattern, with (pq + 1)/2 open elements.

    Raises
    ------
    ValueError
        If `p` and `q` are not twin primes.

    Notes
    -----
    Fenimore & Cannon (1978): with r = s + 2, A(i, j) = 0 if i = 0; 1 if j = 0 ≠ i; 1 if i and j are both quadratic
    residues, of r and s, or both not; else 0. The periodic autocorrelation is (pq + 1)/2 at the origin and (pq + 1)/4 elsewhere.

    Examples
    --------
    >>> from shadowgram.codes.classical import ura
    >>> ura(5, 3)
    array([[0, 0, 0],
           [1, 1, 0],
           [1, 0, 1],
           [1, 0, 1],
           [1, 1, 0]], dtype=uint8)
    """
    p, q = whole(p, "p"), whole(q, "q")
    if abs(p - q) != 2 or not (is_prime(p) and is_prime(q)):
        middles = nearest((p + q) // 2, lambda m: is_prime(m - 1) and is_prime(m + 1))
        pairs = " or ".join(f"({m + 1}, {m - 1})" for m in middles)
        raise ValueError(f"a URA needs twin primes, p − q = 2 or −2, got ({p}, {q}); use {pairs}")
    return residue_pattern(p, q) if p > q else residue_pattern(q, p).T.copy()


def mura(p: int) -> np.ndarray:
    """Modified uniformly redundant array, square.

    Parameters
    ----------
    p : size along y and x, elements; an odd prime.

    Returns
    -------
    (y, x) = (p, p) uint8 array of 0 and 1, the basic pattern, with (p² − 1)/2 open elements.

    Raises
    ------
    ValueError
        If `p` is not an odd prime.

    Notes
    -----
    Gottesman & Fenimore (1989): the rule of `ura` with r = s = p. The autocorrelation is not flat, but the decoding array, which
    differs from that of a URA in one element, makes up for it.

    Examples
    --------
    >>> from shadowgram.codes.classical import mura
    >>> mura(5)
    array([[0, 0, 0, 0, 0],
           [1, 1, 0, 0, 1],
           [1, 0, 1, 1, 0],
           [1, 0, 1, 1, 0],
           [1, 1, 0, 0, 1]], dtype=uint8)
    """
    p = whole(p, "p")
    if p == 2 or not is_prime(p):
        near = either(nearest(max(p, 3), is_prime))
        raise ValueError(f"a square MURA needs an odd prime, got p={p}; use {near}")
    return residue_pattern(p, p)


def linear_mura(length: int) -> np.ndarray:
    """Modified uniformly redundant array of one row: the quadratic residues are open.

    Parameters
    ----------
    length : along x, elements; a prime 4m + 1.

    Returns
    -------
    (y, x) = (1, length) uint8 array of 0 and 1, the basic pattern, with (length − 1)/2 open elements.

    Raises
    ------
    ValueError
        If `length` is not a prime 4m + 1.

    Notes
    -----
    Gottesman & Fenimore (1989).

    Examples
    --------
    >>> from shadowgram.codes.classical import linear_mura
    >>> linear_mura(13)
    array([[0, 1, 0, 1, 1, 0, 0, 0, 0, 1, 1, 0, 1]], dtype=uint8)
    """
    length = whole(length, "length")
    if not is_prime_of(length, 1):
        near = either(nearest(length, lambda n: is_prime_of(n, 1)))
        raise ValueError(f"a linear MURA needs a prime 4m + 1, got {length}; use {near}")
    return (legendre(length)[None] > 0).astype(np.uint8)


def mosaic(pattern: np.ndarray) -> np.ndarray:
    """The mask that stands before a detector of the basic pattern's size: the pattern repeated to all sides.

    Parameters
    ----------
    pattern : (y, x) = (p, q), basic pattern.

    Returns
    -------
    (y, x) = (2p − 1, 2q − 1) array of the pattern's type; pattern[0, 0] is in the middle. A source displaced by s = (0 … p − 1,
    0 … q − 1) throws the part ``[p − 1 − s[0] : 2p − 1 − s[0], q − 1 − s[1] : 2q − 1 − s[1]]`` on the detector, which is the
    pattern rolled by s. A source on the axis has s = ((p − 1)/2, (q − 1)/2) where these are whole numbers.

    Raises
    ------
    ValueError
        If `pattern` does not have two axes.

    Examples
    --------
    >>> from shadowgram.codes.classical import mosaic, mura
    >>> mosaic(mura(3))
    array([[1, 0, 1, 1, 0],
           [0, 1, 1, 0, 1],
           [0, 0, 0, 0, 0],
           [1, 0, 1, 1, 0],
           [0, 1, 1, 0, 1]], dtype=uint8)
    """
    pattern = _checked_pattern(pattern)
    rows, columns = (np.arange(1, 2 * n) % n for n in pattern.shape)
    return pattern[np.ix_(rows, columns)]


def decoding(pattern: np.ndarray) -> np.ndarray:
    """Decoding array G of a basic pattern A: Σ_i A(i − s) G(i − s') is 1 for s = s' and 0 for all other displacements.

    Parameters
    ----------
    pattern : (y, x), basic pattern: a URA, a MURA, rolled or transposed as you like, or any other whose spectrum has no zero.

    Returns
    -------
    (y, x) float64 array. Of a URA or MURA with K open elements it is the array of the literature divided by K: 1/K behind open
    elements, −1/K behind closed ones, except 1/K at the origin of a MURA.

    Raises
    ------
    ValueError
        If no such array exists, or a value of the pattern is outside [0, 1].

    Notes
    -----
    G is the inverse filter, unique if there is one. Noise of variance v on every detector element becomes Σ G²·v on every element
    of the image: about 4v/(pq) with a URA or MURA, and much more if another pattern's spectrum is small somewhere.

    Examples
    --------
    >>> from shadowgram.codes.classical import decoding, mura
    >>> (decoding(mura(3)) * mura(3).sum()).astype(int)
    array([[ 1, -1, -1],
           [ 1,  1, -1],
           [ 1, -1,  1]])
    """
    pattern = _checked_pattern(pattern)
    spectrum = np.fft.fft2(pattern)
    opened = float(pattern.sum())
    if np.abs(spectrum).min() <= 1e-9 * opened:
        raise ValueError(
            "the spectrum of this pattern has a zero, so no correlation can undo its shadow; use a pattern of ura or mura"
        )
    decoder = np.fft.ifft2(1 / spectrum.conj()).real
    signs = np.sign(decoder)
    return signs / opened if np.allclose(decoder * opened, signs, rtol=0, atol=1e-9) else decoder


def correlate(snapshot: np.ndarray, decoding_array: np.ndarray) -> np.ndarray:
    """Scene behind a snapshot: O(s) = Σ_i D(i) G(i − s), periodic, by fast Fourier transform.

    Parameters
    ----------
    snapshot : (..., y, x), of the basic pattern's size: the sum of the shadows of a mosaic.
    decoding_array : (y, x), from `decoding`.

    Returns
    -------
    (..., y, x) float64 array; element (y, x) is the source that displaces the shadow by so many elements.

    Raises
    ------
    ValueError
        If the sizes differ.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.codes.classical import correlate, decoding, mosaic, ura
    >>> scene = np.zeros((7, 5))
    >>> scene[2, 3], scene[6, 0] = 4, 1
    >>> mask = mosaic(ura(7, 5))
    >>> snapshot = sum(scene[s] * mask[6 - s[0] : 13 - s[0], 4 - s[1] : 9 - s[1]] for s in np.ndindex(7, 5))
    >>> np.allclose(correlate(snapshot, decoding(ura(7, 5))), scene, atol=1e-12)
    True
    """
    snapshot, decoding_array = np.asarray(snapshot, float), np.asarray(decoding_array, float)
    if decoding_array.ndim != 2 or snapshot.shape[-2:] != decoding_array.shape:
        raise ValueError(
            f"the snapshot must be as large as the decoding array along y and x, got {snapshot.shape} and"
            f" {decoding_array.shape}"
        )
    y, x = decoding_array.shape
    return np.fft.irfft2(np.fft.rfft2(snapshot) * np.fft.rfft2(decoding_array).conj(), s=(y, x))


def hadamard(order: int) -> np.ndarray:
    """Hadamard matrix H of 1 and −1, H Hᵀ = n·I, whose first row and column are 1.

    Parameters
    ----------
    order : n. 1, 2, p + 1 for a prime p = 4m + 3, 2(p + 1) for a prime p = 4m + 1, and any of these doubled as often as you like.

    Returns
    -------
    (n, n) int8 array.

    Raises
    ------
    ValueError
        If `order` is none of these.

    Notes
    -----
    Sylvester's doubling and both constructions of Paley (1933). Of the multiples of 4 up to 100, 52, 92 and 100 are left out.

    Examples
    --------
    >>> from shadowgram.codes.classical import hadamard
    >>> hadamard(4)
    array([[ 1,  1,  1,  1],
           [ 1, -1,  1, -1],
           [ 1,  1, -1, -1],
           [ 1, -1, -1,  1]], dtype=int8)
    """
    order = whole(order, "order")
    if not is_hadamard_order(order):
        near = either(nearest(order, is_hadamard_order))
        raise ValueError(f"no Hadamard matrix of order {order} can be made here; use {near}")
    H = hadamard_matrix(order)
    H = H * H[0]
    return H * H[:, :1]


def s_matrix(order: int) -> np.ndarray:
    """Cyclic S-matrix of 0 and 1: S Sᵀ = (n + 1)/4·(I + J), J being all ones; S⁻¹ = 2/(n + 1)·(2 Sᵀ − J).

    Parameters
    ----------
    order : n, a prime 4m + 3, a product of twin primes, or 2^k − 1.

    Returns
    -------
    (n, n) uint8 array, S[i, j] = s[(i + j) mod n]; every row and column has (n + 1)/2 ones.

    Raises
    ------
    ValueError
        If `order` is none of these.

    Notes
    -----
    Harwit & Sloane (1979). s holds the quadratic residues and 0, or a URA read along its diagonal, or a sequence of
    maximal length.

    Examples
    --------
    >>> from shadowgram.codes.classical import s_matrix
    >>> s_matrix(3)
    array([[1, 1, 0],
           [1, 0, 1],
           [0, 1, 1]], dtype=uint8)
    """
    order = whole(order, "order")
    if not is_s_order(order):
        near = either(nearest(order, is_s_order))
        raise ValueError(f"no cyclic S-matrix of order {order} can be made here; use {near}")
    i = np.arange(order)
    return s_sequence(order)[(i[:, None] + i) % order]


def s_code(*, shots: int, shape: tuple[int, int], seed: int) -> np.ndarray:
    """Multiplexed code: every element is open in (n + 1)/2 of n shots, those that a column of the S-matrix says.

    Parameters
    ----------
    shots : number of snapshots n, an order of `s_matrix`.
    shape : (y, x) of the coded aperture, elements.
    seed : of the places: columns are dealt out at random, each equally often.

    Returns
    -------
    (shot, y, x) uint8 array of 0 and 1.

    Raises
    ------
    ValueError
        If there is no S-matrix of this order, or `shape` or `seed` is out of range.

    Notes
    -----
    The gain over n shots that pass one of n unknowns each: where the detector's noise does not depend on the light, the
    signal-to-noise ratio grows by (n + 1)/(2√n), about √n/2. Photon noise takes this back, as every shot passes half of the light:
    unknown j gets the variance 2·Σ x/(n + 1) in place of x_j, so a uniform scene loses √(2n/(n + 1)), about √2, and only what is
    brighter than twice the mean gains (Harwit & Sloane 1979). This is for n unknowns seen through n different columns.

    Examples
    --------
    >>> from shadowgram.codes.classical import s_code
    >>> code = s_code(shots=7, shape=(8, 8), seed=0)
    >>> code.shape, bool((code.sum(axis=0) == 4).all())
    ((7, 8, 8), True)
    """
    return _dealt_columns(s_matrix(shots), shape, seed)


def hadamard_code(*, shots: int, shape: tuple[int, int], seed: int) -> np.ndarray:
    """Multiplexed code of the columns of (H + 1)/2: every element is open in half of the shots, and 1/n of them in all.

    Parameters
    ----------
    shots : number of snapshots n, an order of `hadamard`.
    shape : (y, x) of the coded aperture, elements.
    seed : of the places: columns are dealt out at random, each equally often.

    Returns
    -------
    (shot, y, x) uint8 array of 0 and 1. The first shot opens every element.

    Raises
    ------
    ValueError
        If there is no Hadamard matrix of this order, or `shape` or `seed` is out of range.

    Notes
    -----
    Twice a shot minus the first one is what elements of transmittance 1 and −1 would give. The gain over n shots that pass one of n
    unknowns each is √n/2 in signal-to-noise ratio where the noise does not depend on the light, and a loss of about √2 under photon
    noise, as of `s_code`; but the unknown behind the column that is always open gains nothing, so `s_code` is the better choice.

    Examples
    --------
    >>> from shadowgram.codes.classical import hadamard_code
    >>> hadamard_code(shots=4, shape=(8, 8), seed=0).sum(axis=(1, 2)).tolist()
    [64, 32, 32, 32]
    """
    return _dealt_columns((hadamard(shots) > 0).astype(np.uint8), shape, seed)


def _dealt_columns(matrix: np.ndarray, shape: tuple[int, int], seed: int) -> np.ndarray:
    shots, y, x = _checked_size(len(matrix), shape, axes=2)
    column = _generator(seed).permutation(np.arange(y * x) % shots)
    return np.ascontiguousarray(matrix[:, column].reshape(shots, y, x))


def _checked_pattern(pattern: np.ndarray) -> np.ndarray:
    pattern = np.asarray(pattern)
    if pattern.ndim != 2 or not pattern.size:
        raise ValueError(f"the basic pattern must have the shape (y, x), got {pattern.shape}")
    check_code(pattern, pattern.shape)
    return pattern
