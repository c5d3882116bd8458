"""One stream of random numbers per history, a function of (seed, history, how many were drawn) and of nothing else.

A stream is a SplitMix64 sequence (Steele, Lea, Flood, OOPSLA 2014): draw k of history h is the mix of start(seed, h) +
k · step(seed, h). Start and odd step both come from the same mixing function, so two histories that happen to start
close together still part at once. Results therefore do not depend on threads, workers, batches or order, and history 12
345 678 can be repeated alone.
"""

from __future__ import annotations

import math

import numpy as np

from ._jit import kernel

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_STEP_1 = np.uint64(0xFF51AFD7ED558CCD)
_STEP_2 = np.uint64(0xC4CEB9FE1A85EC53)
_S27, _S30, _S31, _S33, _S11 = np.uint64(27), np.uint64(30), np.uint64(31), np.uint64(33), np.uint64(11)
_ONE = np.uint64(1)
_UNIT = 2.0**-53


@kernel
def mix(z):
    """A bijection of the 64-bit integers in which every input bit changes about half of the output bits."""
    z = (z ^ (z >> _S30)) * _MIX_1
    z = (z ^ (z >> _S27)) * _MIX_2
    return z ^ (z >> _S31)


@kernel
def start_of(seed, history):
    """(Start, step) of a history's stream."""
    key = mix(np.uint64(seed) + _GOLDEN)
    start = mix(key + np.uint64(history) * _GOLDEN)
    step = start ^ key
    step = (step ^ (step >> _S33)) * _STEP_1
    step = (step ^ (step >> _S33)) * _STEP_2
    return start, (step ^ (step >> _S33)) | _ONE


@kernel
def begin(stream, seed, history):
    """Put `stream`, two uint64, at the first number of a history."""
    stream[0], stream[1] = start_of(seed, history)


@kernel
def uniform(stream):
    """The next number, uniform on [0, 1) in steps of 2⁻⁵³."""
    stream[0] += stream[1]
    return (mix(stream[0]) >> _S11) * _UNIT


@kernel
def exponential(stream):
    """The next number of an exponential law of mean 1."""
    return -math.log(1.0 - uniform(stream))


@kernel
def normal(stream):
    """The next number of a normal law of mean 0 and deviation 1 (Marsaglia's polar method, one of its two)."""
    while True:
        a = 2.0 * uniform(stream) - 1.0
        b = 2.0 * uniform(stream) - 1.0
        s = a * a + b * b
        if 0.0 < s < 1.0:
            return a * math.sqrt(-2.0 * math.log(s) / s)


@kernel
def disk(stream):
    """A point uniform in the unit disk."""
    while True:
        a = 2.0 * uniform(stream) - 1.0
        b = 2.0 * uniform(stream) - 1.0
        if a * a + b * b < 1.0:
            return a, b
