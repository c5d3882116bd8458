"""Residues of primes, and the arrays and matrices that are made of them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np


def residue_pattern(r: int, s: int) -> np.ndarray:
    """(r, s) uint8 array: the common rule of URA and MURA, open where both indices are residues or neither is."""
    pattern = legendre(r)[:, None] * legendre(s) > 0
    pattern[:, 0] = True
    pattern[0] = False
    return pattern.astype(np.uint8)


def legendre(p: int) -> np.ndarray:
    """(p,) int8 array: 1 for quadratic residues of the odd prime p, −1 for the others, 0 for 0."""
    symbol = np.full(p, -1, np.int8)
    symbol[np.arange(1, p, dtype=np.int64) ** 2 % p] = 1
    symbol[0] = 0
    return symbol


def hadamard_matrix(n: int) -> np.ndarray:
    """Hadamard matrix of a possible order, signs as they come: Sylvester's for powers of two, else Paley's, doubled if need be."""
    if n == 1:
        return np.ones((1, 1), np.int8)
    pair = np.array([[1, 1], [1, -1]], np.int8)
    power_of_two = n & (n - 1) == 0
    if not power_of_two and is_prime_of(n - 1, 3):
        return _conference(n - 1) + np.eye(n, dtype=np.int8)
    if not power_of_two and is_prime_of(n // 2 - 1, 1):
        turned = np.array([[1, -1], [-1, -1]], np.int8)
        return np.kron(_conference(n // 2 - 1), pair) + np.kron(np.eye(n // 2, dtype=np.int8), turned)
    return np.kron(pair, hadamard_matrix(n // 2))


def is_hadamard_order(n: int) -> bool:
    if n in (1, 2):
        return True
    return n > 2 and n % 4 == 0 and (is_prime_of(n - 1, 3) or is_prime_of(n // 2 - 1, 1) or is_hadamard_order(n // 2))


def _conference(p: int) -> np.ndarray:
    """(p + 1, p + 1) matrix C of 1, −1 and a zero diagonal, C Cᵀ = p·I; symmetric if p = 4m + 1, else Cᵀ = −C."""
    i = np.arange(p)
    matrix = np.ones((p + 1, p + 1), np.int8)
    matrix[0, 0] = 0
    matrix[1:, 0] = 1 if p % 4 == 1 else -1
    matrix[1:, 1:] = legendre(p)[(i[:, None] - i) % p]
    return matrix


def s_sequence(n: int) -> np.ndarray:
    """(n,) uint8 array: first row of the cyclic S-matrix of a possible order."""
    if is_prime_of(n, 3):
        return (legendre(n) >= 0).astype(np.uint8)
    p = _twin_factor(n)
    if p:
        i = np.arange(n)
        return residue_pattern(p + 2, p)[i % (p + 2), i % p]
    return _maximal_sequence(n.bit_length())


def is_s_order(n: int) -> bool:
    return is_prime_of(n, 3) or bool(_twin_factor(n)) or (n > 0 and n & (n + 1) == 0)


def _twin_factor(n: int) -> int:
    """The smaller of the twin primes whose product is n, or 0."""
    p = math.isqrt(n + 1) - 1 if n > 0 else 0
    return p if p * (p + 2) == n and is_prime(p) and is_prime(p + 2) else 0


def _maximal_sequence(bits: int) -> np.ndarray:
    """(2^bits − 1,) uint8 array: output of the first shift register, by taps, that runs through all states but zero."""
    sequences = (_register_output(taps, bits) for taps in range(1, 2**bits, 2))
    return np.array(next(s for s in sequences if len(s) == 2**bits - 1), np.uint8)


def _register_output(taps: int, bits: int) -> list[int]:
    """One period of the register whose next bit is the parity of its bits under odd `taps`."""
    state, sequence = 1, []
    while not sequence or state != 1:
        sequence.append(state & 1)
        state = state >> 1 | ((state & taps).bit_count() & 1) << (bits - 1)
    return sequence


def whole(number: int, name: str) -> int:
    if not isinstance(number, int | np.integer):
        raise ValueError(f"{name} must be a whole number, got {number!r}")
    return int(number)


def is_prime(n: int) -> bool:
    return n > 1 and all(n % d for d in range(2, math.isqrt(n) + 1))


def is_prime_of(n: int, remainder: int) -> bool:
    """Whether n is a prime 4m + remainder."""
    return n % 4 == remainder and is_prime(n)


def nearest(n: int, fits: Callable[[int], bool]) -> list[int]:
    """The closest numbers that fit, n itself, or one below, if there is one, and one above."""
    n = max(n, 1)
    below = next((m for m in range(n, 0, -1) if fits(m)), None)
    above = next(m for m in itertools.count(n) if fits(m))
    return sorted({m for m in (below, above) if m is not None})


def either(numbers: list[int]) -> str:
    return " or ".join(map(str, numbers))
