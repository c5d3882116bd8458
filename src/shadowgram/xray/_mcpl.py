"""Lists of photons in MCPL, the format in which programs of particle transport hand particles to each other.

Version 3 of the format, little endian, float64; units are cm, MeV and ms. Source: T. Kittelmann et al., "Monte Carlo Particle
Lists: MCPL", Computer Physics Communications 218 (2017) 17, doi:10.1016/j.cpc.2017.04.012, and mctools.github.io/mcpl.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

PHOTON = 22
"""Number of the photon in the scheme of the Particle Data Group."""
_PARTICLE = np.dtype(
    [
        ("position", "<f8", 3),
        ("packed", "<f8", 2),
        ("energy", "<f8"),
        ("time", "<f8"),
        ("weight", "<f8"),
        ("flags", "<u4"),
    ]
)
_HEADER = np.dtype(
    [
        ("signature", "S8"),
        ("particles", "<u8"),
        *((name, "<u4") for name in ("comments", "blobs", "has_flags", "has_polarisation", "single_precision")),
        ("one_kind", "<i4"),
        ("particle_bytes", "<u4"),
        ("one_weight", "<u4"),
    ]
)


def mcpl_chunks(
    *,
    position: Floats,
    direction: Floats,
    energy: Floats,
    weight: Floats,
    flags: NDArray[np.uint32],
    program: str,
    comments: Sequence[str],
    histories: int,
) -> Iterator[bytes]:
    """Give the pieces of an MCPL file of photons.

    Parameters
    ----------
    position, direction : (photon, 3) mm, and of length 1.
    energy, weight : (photon) keV, any.
    flags : (photon) a number for each; `comments` should say what it means.
    program, comments : texts of the header.
    histories : source photons; programs that merge files add them up, and divide by them.
    """
    texts = [*comments, f"stat:sum:source_photons:{float(histories):24.15g}"]
    header = np.zeros((), _HEADER)
    header["signature"] = b"MCPL003L"
    header["particles"], header["comments"] = len(energy), len(texts)
    header["has_flags"], header["one_kind"], header["particle_bytes"] = 1, PHOTON, _PARTICLE.itemsize
    yield header.tobytes()
    for text in (program, *texts):
        encoded = text.encode()
        yield len(encoded).to_bytes(4, "little") + encoded
    particles = np.zeros(len(energy), _PARTICLE)
    packed, sign = _packed(direction)
    particles["position"], particles["packed"] = position / 10, packed
    particles["energy"] = np.copysign(energy / 1000, sign)
    particles["weight"], particles["flags"] = weight, flags
    yield particles.tobytes()


def _packed(direction: Floats) -> tuple[Floats, Floats]:
    """(photon, 2) two numbers and (photon) a sign from which a direction is found again.

    The two smaller components and the sign of the largest would do; so that it is known which one is left out, w is stored
    as 1/w, which is above 1, in place of the one that is larger than it.
    """
    largest = np.abs(direction).argmax(axis=1)
    with np.errstate(divide="ignore"):
        inverse = 1 / direction[:, 2]
    first = np.where(largest == 0, inverse, direction[:, 0])
    second = np.where(largest == 1, inverse, direction[:, 1])
    return np.stack([first, second], axis=1), direction[np.arange(len(direction)), largest]
