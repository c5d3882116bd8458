"""One collision: tables are looked up, angles and energies drawn, densities of angles given to the next-event estimates."""

from __future__ import annotations

import math

import numpy as np

from ._jit import kernel
from .arrays import (
    BINS_PER_OCTAVE_BITS,
    ELECTRON_MASS,
    ENERGY_BINS,
    HC,
    LOWEST_ENERGY,
    LOWEST_MOMENTUM,
    MOMENTUM_BINS,
    MOMENTUM_BINS_PER_OCTAVE_BITS,
)
from .rng import disk, uniform

HALF_RADIUS_SQUARED = 0.5 * 0.079407877
"""r_e² / 2 in barn (r_e = 2.8179403 fm)."""

_ENERGY_SHIFT = 52 - BINS_PER_OCTAVE_BITS
_ENERGY_BASE = int(np.float64(LOWEST_ENERGY).view(np.int64)) >> _ENERGY_SHIFT
_MOMENTUM_SHIFT = 52 - MOMENTUM_BINS_PER_OCTAVE_BITS
_MOMENTUM_BASE = int(np.float64(LOWEST_MOMENTUM).view(np.int64)) >> _MOMENTUM_SHIFT
_MOMENTUM_MASK = (1 << _MOMENTUM_SHIFT) - 1
_MOMENTUM_UNIT = 2.0**-_MOMENTUM_SHIFT
_LOWEST_SQUARED = LOWEST_MOMENTUM**2


@kernel
def energy_bin(energy):
    """The row of the attenuation table: exponent and first bits of the mantissa, no logarithm needed."""
    bin_ = (np.float64(energy).view(np.int64) >> _ENERGY_SHIFT) - _ENERGY_BASE
    return min(max(bin_, 0), ENERGY_BINS - 1)


@kernel
def looked_up(physics, material, bin_, energy, column):
    """The value a + b·E of a column of the attenuation table."""
    row = physics.attenuation[material, bin_]
    return row[column] + row[column + 1] * energy


@kernel
def momentum_place(x):
    """(bin, fraction inside it) of a momentum transfer; both clamped to the table."""
    bits = np.float64(x).view(np.int64)
    bin_ = (bits >> _MOMENTUM_SHIFT) - _MOMENTUM_BASE
    if bin_ < 0:
        return 0, 0.0
    if bin_ >= MOMENTUM_BINS:
        return MOMENTUM_BINS - 1, 1.0
    return bin_, (bits & _MOMENTUM_MASK) * _MOMENTUM_UNIT


@kernel
def incoherent(physics, material, x):
    """S(x) of an average electron."""
    if x < LOWEST_MOMENTUM:
        return physics.incoherent[material, 0] * (x * x / _LOWEST_SQUARED)
    bin_, fraction = momentum_place(x)
    low = physics.incoherent[material, bin_]
    return low + fraction * (physics.incoherent[material, bin_ + 1] - low)


@kernel
def edge_squared(edge):
    """x² at an edge of the momentum table."""
    octave = edge >> MOMENTUM_BINS_PER_OCTAVE_BITS
    part = edge & ((1 << MOMENTUM_BINS_PER_OCTAVE_BITS) - 1)
    x = LOWEST_MOMENTUM * (1 << octave) * (1.0 + part / (1 << MOMENTUM_BINS_PER_OCTAVE_BITS))
    return x * x


@kernel
def klein_nishina_ratio(ratio, cosine):
    """P² (P + 1/P − sin²θ) / 2 with P = E'/E: the Klein–Nishina law over r_e², never above 1."""
    return 0.5 * ratio * (ratio * ratio + 1.0 - ratio * (1.0 - cosine * cosine))


@kernel
def thomson_cosine(stream):
    """A cosine with density ∝ 1 + cos²θ: three parts of a uniform one, one part of the largest of three with either sign."""
    part, even = uniform(stream), 2.0 * uniform(stream) - 1.0
    largest = max(uniform(stream), uniform(stream), uniform(stream))
    return even if part < 0.75 else math.copysign(largest, even)


@kernel
def compton(physics, material, stream, energy):
    """Draw (cosine, scattered energy) from Klein–Nishina times the incoherent function, by rejection from Thomson's law."""
    k = energy / ELECTRON_MASS
    momentum = energy / HC
    while True:
        cosine = thomson_cosine(stream)
        ratio = 1.0 / (1.0 + k * (1.0 - cosine))
        kept = klein_nishina_ratio(ratio, cosine)
        draw = uniform(stream) * 0.5 * (1.0 + cosine * cosine)
        if draw < kept and draw < kept * incoherent(physics, material, momentum * math.sqrt(0.5 * (1.0 - cosine))):
            return cosine, energy * ratio


@kernel
def compton_density(physics, material, bin_, energy, cosine):
    """(Probability per steradian of scattering by this cosine, scattered energy)."""
    ratio = 1.0 / (1.0 + energy / ELECTRON_MASS * (1.0 - cosine))
    bound = incoherent(physics, material, energy / HC * math.sqrt(max(0.5 * (1.0 - cosine), 0.0)))
    norm = looked_up(physics, material, bin_, energy, 6)
    return 2.0 * HALF_RADIUS_SQUARED * klein_nishina_ratio(ratio, cosine) * bound / norm, energy * ratio


@kernel
def coherent_integral(physics, material, squared):
    """∫₀^{x²} of the squared form factor over that at 0."""
    table = physics.coherent[material]
    if squared < _LOWEST_SQUARED:
        return table[0] * squared / _LOWEST_SQUARED
    bin_, _ = momentum_place(math.sqrt(squared))
    low = edge_squared(bin_)
    share = min((squared - low) / (edge_squared(bin_ + 1) - low), 1.0)
    return table[bin_] + share * (table[bin_ + 1] - table[bin_])


@kernel
def coherent_inverse(physics, material, value):
    """The x² below which the integral is `value`: a guide table says near which edge, a few steps from there find it."""
    table, guide = physics.coherent[material], physics.coherent_guide[material]
    if value <= table[0]:
        return value / table[0] * _LOWEST_SQUARED
    low = int(guide[min(int(value / table[MOMENTUM_BINS] * guide.size), guide.size - 1)])
    while low < MOMENTUM_BINS - 1 and table[low + 1] < value:
        low += 1
    share = (value - table[low]) / (table[low + 1] - table[low])
    start = edge_squared(low)
    return start + share * (edge_squared(low + 1) - start)


@kernel
def rayleigh(physics, material, stream, energy):
    """Draw the cosine of coherent scattering: x² from the form factor, then (1 + cos²θ)/2 by rejection."""
    largest = (energy / HC) ** 2
    total = coherent_integral(physics, material, largest)
    while True:
        squared = coherent_inverse(physics, material, uniform(stream) * total)
        cosine = 1.0 - 2.0 * min(squared / largest, 1.0)
        if uniform(stream) < 0.5 * (1.0 + cosine * cosine):
            return cosine


@kernel
def rayleigh_density(physics, material, bin_, energy, cosine):
    """Probability per steradian of coherent scattering by this cosine."""
    squared = (energy / HC) ** 2 * 0.5 * (1.0 - cosine)
    if squared < _LOWEST_SQUARED:
        factor = physics.coherent[material, 0] / _LOWEST_SQUARED
    else:
        factor = physics.form_factor[material, momentum_place(math.sqrt(squared))[0]]
    return factor * 0.5 * (1.0 + cosine * cosine) / looked_up(physics, material, bin_, energy, 8)


@kernel
def emptied_shell(physics, material, bin_, draw):
    """The shell that a photoelectric absorption empties, or −1 where no photon above the cut-off can follow."""
    for shell in range(physics.shell_start[material], physics.shell_start[material + 1]):
        if draw < physics.shell_cumulative[shell, bin_]:
            return shell
    return -1


@kernel
def emitted_line(physics, stream, shell):
    """The emission line of an emptied shell, or −1 where an Auger electron takes the energy."""
    if uniform(stream) >= physics.shell_yield[shell]:
        return -1
    draw = uniform(stream)
    last = physics.line_start[shell + 1] - 1
    for line in range(physics.line_start[shell], last):
        if draw < physics.line_cumulative[line]:
            return line
    return last


@kernel
def isotropic(stream):
    """A direction uniform on the sphere (equal-area map of the disk)."""
    a, b = disk(stream)
    squared = a * a + b * b
    scale = 2.0 * math.sqrt(1.0 - squared)
    return a * scale, b * scale, 1.0 - 2.0 * squared


@kernel
def turned(u, v, w, cosine, stream):
    """The direction (u, v, w) turned by an angle of the given cosine, about itself by a uniform angle.

    It is not normalised again: the length strays from 1 by about 1e-16 a collision.
    """
    a, b = disk(stream)
    # Twice the angle of a point of the disk is as uniform as the angle, and needs no root (von Neumann, 1951).
    across = math.sqrt(max(1.0 - cosine * cosine, 0.0)) / max(a * a + b * b, 1e-300)
    a, b = (a * a - b * b) * across, 2.0 * a * b * across
    # Across the direction without a branch near the poles but one: Duff et al., J. Comput. Graph. Techn. 6(1), 2017.
    sign = math.copysign(1.0, w)
    c = -1.0 / (sign + w)
    d = u * v * c
    return (
        a * (1.0 + sign * u * u * c) + b * d + cosine * u,
        a * sign * d + b * (sign + v * v * c) + cosine * v,
        -a * sign * u - b * v + cosine * w,
    )
