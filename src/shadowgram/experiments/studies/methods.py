"""What reconstructs best, and at what cost: a question of ours, on sections 2.4.3 and 3.6.

Every method reconstructs the same snapshots of the SSCSI of the source's simulations, s = 0.09375 and Boolean codes (for a single
shot a random one), without noise and with noise of 30 dB; the model that measures is the model that reconstructs, as in the source.
GPSR and TwIST get the weight that suits the scene best; the methods called blind choose for themselves, and one row shows what
EigenTV would gain by knowing.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram import codes, noise
from shadowgram.experiments.quality import assess
from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study
from shadowgram.operators.base import LinearOperator
from shadowgram.spectral.sscsi import SSCSI

from . import _common as common
from . import _methods as methods
from ._methods import METHODS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Curves, Picture

CLEAN, NOISY = "no noise", "30 dB"
NOISES = (CLEAN, NOISY)
SHOTS = (1, 2, 4, 6)
SIZE = 256
MEMORY = "memory"
SHOWN = 4
"""Shots of the pictures."""


_COLOURS = {
    "gpsr": 1, "twist": 3, "gap-tv": 5, "admm-tv": 4, "eigen-tv": 0, "eigen-tv-searched": 0, "eigen-pnp": 2,
}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """One method on one set of snapshots."""

    method: str
    shots: int
    noise: str
    size: int
    bands: int
    seed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class MemorySpec:
    """What one method takes, in a process of its own."""

    method: str
    shots: int
    size: int
    bands: int
    part: str = MEMORY


def specs(_scene: SceneSource, quick: bool) -> list[Spec | MemorySpec]:
    """All methods, both noises, one to six shots."""
    size, bands = (48, 8) if quick else (SIZE, 24)
    shown = (SHOWN,) if quick else SHOTS
    return [
        *(
            Spec(method=method, shots=shots, noise=level, size=size, bands=bands)
            for shots in shown
            for level in NOISES
            for method in METHODS
        ),
        # A process for each takes longer than all the quick reconstructions.
        *(
            MemorySpec(method=method, shots=shots, size=128 if quick else SIZE, bands=24)
            for shots in shown
            for method in (("gap-tv",) if quick else METHODS)
        ),
    ]


def measured(spec: Spec, scene: SceneSource) -> tuple[LinearOperator, np.ndarray, np.ndarray]:
    """Operator, snapshots (shot, y, x) and truth (band, y, x)."""
    truth = common.fine_cube(scene, spec.bands, (spec.size, spec.size))
    imager = SSCSI(
        detector_shape=(spec.size, spec.size), detector_pitch=common.PITCH, code_pitch=common.PITCH,
        mask_position=spec.bands / spec.size, wavelengths=scene.wavelengths, shear="edge",
    )  # fmt: skip
    # A single complementary shot would be an open mask.
    make = codes.random if spec.shots == 1 else codes.boolean
    code = make(shots=spec.shots, shape=imager.code_shape, seed=spec.seed)
    H = imager.operator(code)
    y = H.forward(truth)
    return H, (noise.awgn(y, snr_db=30, seed=spec.seed) if spec.noise == NOISY else y), truth


def run(spec: Spec | MemorySpec, scene: SceneSource) -> Result:
    """Reconstruct, assess, and measure what it cost."""
    if isinstance(spec, MemorySpec):
        return Result(values={"memory": methods.peak_memory(__name__, asdict(spec))})
    H, y, truth = measured(spec, scene)
    found = methods.best(spec.method, H, y, truth)
    quality = assess(found.solution.x, truth, peak=1.0)
    values = {
        "psnr": quality.psnr, "rms": quality.rms, "ssim": quality.ssim, "sam": quality.sam,
        "seconds": round(found.seconds, 3), "iterations": found.solution.iterations,
        "converged": bool(found.solution.converged), "solver": repr(found.spec),
    }  # fmt: skip
    if spec.shots != SHOWN:
        return Result(values=values)
    exposure = common.exposure_of(truth, scene.wavelengths)
    pictures = {"picture": common.colours(found.solution.x, scene.wavelengths, exposure)}
    if spec.method == next(iter(METHODS)):
        pictures["truth"] = common.colours(truth, scene.wavelengths, exposure)
    return Result(values=values, arrays=pictures)


def figure(records: Sequence[Record]) -> Figure:
    """Quality over shots, over time and over memory; pictures."""
    from shadowgram.figures.sheet import sheet

    return sheet(
        "What reconstructs best, and at what cost (points of a line: 1, 2, 4 and 6 shots)",
        [
            [_over(records, level, "shots", "shots", f"{level}: quality over shots") for level in NOISES],
            [_over(records, level, "seconds", "time on one thread (s)", f"{level}: quality over time") for level in NOISES],
            [_over(records, CLEAN, "memory", "memory beyond the snapshots (MB)", "no noise: quality over memory")],
            *(_pictures(records, level) for level in NOISES),
        ],
    )  # fmt: skip


def _chosen(records: Sequence[Record], method: str, level: str) -> list[Record]:
    """Reconstructions by a method, by shots."""
    own = [r for r in records if (r.spec["method"], r.spec.get("noise")) == (method, level)]
    return sorted(own, key=lambda r: r.spec["shots"])


def _memory(records: Sequence[Record], method: str) -> dict[int, float]:
    """Shots → MB."""
    own = [r for r in records if (r.spec["method"], r.spec.get("part")) == (method, MEMORY)]
    return {r.spec["shots"]: float(r.values["memory"]) for r in own}


def _over(records: Sequence[Record], level: str, what: str, xlabel: str, title: str) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    named = level == CLEAN and what in ("shots", MEMORY)
    curves = {}
    for name, method in METHODS.items():
        memory = _memory(records, name)
        own = [r for r in _chosen(records, name, level) if what != MEMORY or r.spec["shots"] in memory]
        if not own:
            continue
        places = {"shots": lambda r: r.spec["shots"], MEMORY: lambda r, m=memory: m[r.spec["shots"]]}
        x = [float(places.get(what, lambda r: r.values[what])(r)) for r in own]
        y = [float(r.values["psnr"]) for r in own]
        # As many lines as colours, and one more: broken, as it is nobody's to choose.
        dash = 1 if name == "eigen-tv-searched" else 0
        curves[method.text if named else f"_{name}"] = Curve(x=x, y=y, colour=_COLOURS[name], dash=dash)
    return Curves(title=title, xlabel=xlabel, ylabel="PSNR (dB)", curves=curves, log="" if what == "shots" else "x")


def _pictures(records: Sequence[Record], level: str) -> list[Picture]:
    from shadowgram.figures.sheet import Picture

    own = [record for method in METHODS for record in _chosen(records, method, level) if record.spec["shots"] == SHOWN]
    truth = next(r.arrays["truth"] for r in own if "truth" in r.arrays)
    shown = [Picture(title="truth", picture=truth, caption=f"{SHOWN} shots, {level}")]
    for record in own:
        if record.spec["method"] != "eigen-tv-searched":
            text = METHODS[record.spec["method"]].text.removesuffix(", blind")
            shown.append(
                Picture(title=text, picture=record.arrays["picture"], caption=f"{record.values['psnr']:.1f} dB")
            )
    return shown


def claims(records: Sequence[Record]) -> list[Claim]:
    """The tables, and what follows from them."""
    return [
        *(_table(records, level) for level in NOISES),
        _difference(
            records, "eigen-tv", "eigen-tv-searched", "how far is EigenTV, blind, from its searched parameters?"
        ),
        _difference(records, "eigen-tv", "gpsr", "what does EigenTV, blind, gain over GPSR with searched weights?"),
        _difference(records, "eigen-pnp", "eigen-tv", "what does the denoiser on the eigen-images add?"),
    ]


def _psnr(records: Sequence[Record], method: str, level: str) -> dict[int, float]:
    return {r.spec["shots"]: float(r.values["psnr"]) for r in _chosen(records, method, level)}


def _table(records: Sequence[Record], level: str) -> Claim:
    rows = []
    for name, method in METHODS.items():
        own, memory = _chosen(records, name, level), _memory(records, name)
        columns = {
            "PSNR": [f"{r.values['psnr']:.2f}" for r in own],
            "RMS": [f"{r.values['rms']:.4f}" for r in own],
            "SAM": [f"{r.values['sam']:.3f}" for r in own],
            "s": [f"{r.values['seconds']:.1f}" for r in own],
        }
        if level == CLEAN and memory:
            columns["MB"] = [f"{memory[r.spec['shots']]:.0f}" for r in own]
        rows.append(method.text + ": " + ", ".join(f"{what} {' / '.join(row)}" for what, row in columns.items()))
    shots = ", ".join(str(q) for q in sorted({r.spec["shots"] for r in records}))
    return Claim(
        page=None,
        says=f"which method is best for {shots} shots, with {level}?",
        found="PSNR in dB, RMS, SAM in rad, seconds on one thread: " + "; ".join(rows),
        agrees=None,
    )


def _difference(records: Sequence[Record], ours: str, theirs: str, says: str) -> Claim:
    found = []
    for level in NOISES:
        own, other = _psnr(records, ours, level), _psnr(records, theirs, level)
        found.append(f"{level}: " + ", ".join(f"{own[q] - other[q]:+.2f} dB for {q}" for q in own))
    return Claim(page=None, says=says, found="; ".join(found) + " shots", agrees=None)


STUDY = Study(
    name="methods",
    title="What reconstructs best, and at what cost",
    source="a question of ours, on section 2.4.3",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)


def _report_memory() -> None:
    """Print what the method of the command line takes, on the generated scene: its values do not matter."""
    from shadowgram.experiments.source import generated

    asked = MemorySpec(**json.loads(sys.argv[1]))
    problems = [
        measured(
            Spec(method=asked.method, shots=asked.shots, noise=CLEAN, size=size, bands=asked.bands), generated()
        )[:2]
        for size in (2 * asked.bands, asked.size)
    ]  # fmt: skip
    sys.stdout.write(str(methods.rise(asked.method, *problems)))


if __name__ == "__main__":
    _report_memory()
