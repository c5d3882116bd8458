"""Settings of the benchmarks, the problem they work on, and one row of their results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram import codes
from shadowgram.spectral.sscsi import SSCSI

from .machine import Machine
from .timing import Timing
from .work import Work

if TYPE_CHECKING:
    from shadowgram.spectral._sscsi_operator import SSCSIOperator

OURS = "shadowgram"
WAVELENGTHS = (450.0, 650.0)
PITCH = 10.0  # µm; only ratios of lengths matter here


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchSpec:
    """Settings of the benchmarks.

    Parameters
    ----------
    size : pixels a side.
    bands, shots : of the datacube and its measurement; the SSCSI's mask position is bands/size, which resolves so many bands.
    cassi_bands : of the datacube of the single-shot CASSI, the size that other packages' figures are known for.
    sizes : pixels a side of the problems whose cost per voxel is compared.
    seconds : to spend on each comparison of a function with its references.

    Raises
    ------
    ValueError
        If the size does not leave room for the bands.
    """

    size: int = 256
    bands: int = 24
    shots: int = 6
    cassi_bands: int = 28
    sizes: tuple[int, ...] = (128, 256, 512, 1024)
    seconds: float = 2.0

    def __post_init__(self) -> None:
        if min(self.size, *self.sizes) <= self.bands:
            raise ValueError(
                f"the size must be more than the {self.bands} bands of the benchmark, got {min(self.size, *self.sizes)}"
            )


def sscsi_operator(spec: BenchSpec, size: int, shear: str = "exact") -> SSCSIOperator:
    """SSCSI with a Boolean code, size × size × bands."""
    imager = SSCSI(
        detector_shape=(size, size), detector_pitch=PITCH, code_pitch=PITCH, mask_position=spec.bands / size,
        wavelengths=WAVELENGTHS, shear=shear,
    )  # fmt: skip
    return imager.operator(codes.boolean(shots=spec.shots, shape=imager.code_shape, seed=0))


def random_array(shape: tuple[int, ...]) -> np.ndarray:
    """Uniform float32 in [0, 1)."""
    return np.random.default_rng(0).random(shape, dtype=np.float32)


@dataclass(frozen=True, kw_only=True)
class Row:
    """One case: our time, the reference's, and the machine's.

    Attributes
    ----------
    case : what was timed.
    ms, median_ms : ours, the minimum and the median over repeats.
    reference, reference_ms : the fastest reference of the same run and its minimum.
    ratio : reference_ms / ms.
    floor_ms, limit : least time of the case on this machine, by "bandwidth" or "arithmetic".
    share : floor_ms / ms.
    note : what else there is to say.
    """

    case: str
    ms: float
    median_ms: float
    reference: str = ""
    reference_ms: float | None = None
    floor_ms: float | None = None
    limit: str = ""
    note: str = ""

    @property
    def ratio(self) -> float | None:
        """How many times faster than the reference."""
        return None if self.reference_ms is None else self.reference_ms / self.ms

    @property
    def share(self) -> float | None:
        """Share of the machine's limit that is used."""
        return None if self.floor_ms is None else self.floor_ms / self.ms

    def record(self) -> dict[str, object]:
        """All figures by name."""
        return {**asdict(self), "ratio": self.ratio, "share": self.share}


def make_row(case: str, timings: Mapping[str, Timing], work: Work | None, machine: Machine, note: str = "") -> Row:
    """Row of a case from the timings by name: `OURS`, and the references, of which the fastest counts."""
    ours = timings[OURS]
    references = {name: timing for name, timing in timings.items() if name != OURS}
    name = min(references, key=lambda name: references[name].ms, default="")
    floor, limit = (None, "") if work is None else machine.floor_ms(work)
    return Row(
        case=case, ms=ours.ms, median_ms=ours.median_ms, reference=name,
        reference_ms=references[name].ms if name else None, floor_ms=floor, limit=limit, note=note,
    )  # fmt: skip
