"""What the machine is and what it can do: memory bandwidth and float32 arithmetic on one thread, measured."""

from __future__ import annotations

import platform
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import _machine_kernels as kernels
from .timing import alternate
from .work import Work

STREAM_FLOATS = 1 << 24  # 64 MB an array: beyond the last-level cache
# Multiply-adds on whole vectors of float32: x86 names the width by the register, ARM by the arrangement.
PACKED = re.compile(r"vfmadd\d+ps\s[^\n]*%[yz]mm|fmla\s+v\d+\.4s|fmla\s+z\d+\.s")


@dataclass(frozen=True, kw_only=True)
class Machine:
    """Limits of one thread.

    Attributes
    ----------
    cpu : the model, as the system names it.
    bandwidth : GB/s, the better of copy (8 bytes an element) and triad (12); a written line that is first read is not counted.
    peak : float32 GFLOP/s of fused multiply-adds.
    packed : the kernel behind `peak` was compiled to multiply-adds on whole vectors; if not, `peak` is too low.
    """

    cpu: str
    bandwidth: float
    peak: float
    packed: bool

    def floor_ms(self, work: Work) -> tuple[float, str]:
        """Least time that `work` takes, ms, and what limits it."""
        memory, arithmetic = work.bytes / self.bandwidth / 1e6, work.flops / self.peak / 1e6
        return max((memory, "bandwidth"), (arithmetic, "arithmetic"))


def measure(seconds: float, floats: int = STREAM_FLOATS) -> Machine:
    """Measure the machine, on arrays of `floats` elements, for about `seconds`."""
    a, b, c = (np.full(floats, value, np.float32) for value in (1, 2, 3))
    streams = alternate({"copy": lambda: kernels.copy(a, b), "triad": lambda: kernels.triad(a, b, c)}, seconds / 2)
    x = np.linspace(0, 0.5, 1024, dtype=np.float32)
    out, repetitions = np.empty_like(x), 20
    busy = alternate({"fma": lambda: kernels.multiply_add(repetitions, x, out)}, seconds / 2)
    assembly = next(iter(kernels.multiply_add.inspect_asm().values()))
    return Machine(
        cpu=cpu_model(),
        bandwidth=max(8 / streams["copy"].ms, 12 / streams["triad"].ms) * floats / 1e6,
        peak=kernels.FLOPS * repetitions * x.size / busy["fma"].ms / 1e6,
        packed=len(PACKED.findall(assembly)) >= kernels.CHAINS * kernels.STEPS,
    )


def cpu_model() -> str:
    """Model of the processor, as /proc/cpuinfo says it."""
    try:
        found = re.search(r"^model name\s*:\s*(.+)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    except OSError:
        found = None
    return found[1] if found else platform.processor() or platform.machine()
