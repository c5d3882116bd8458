"""Which code suits a camera that is short of light: a question of ours.

The source's noise has the same ratio to the signal for every code. The read noise of a camera is the same for every code, and
one that passes more light has the better ratio. Here a finely resolved scene is measured with the exact shear and read noise
of two levels: such that a Boolean code of four shots has 30 dB, and 20 dB. Codes: those of the source; designed with light
budgets of 3/8 and 1/2 (`shadowgram.codes.design(transmittance=…)`, the source's cost); and Hadamard codes, half open, without
design.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram import codes
from shadowgram.codes._design import design
from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study

from . import _codes
from . import _common as common
from ._codes import Gain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS = {
    "random": "random",
    "boolean": "Boolean",
    "optimised": "optimised",
    "hadamard": "Hadamard, 1/2 open",
    "light-3/8": "designed, 3/8 open",
    "light-1/2": "designed, 1/2 open",
}
BUDGETS = {"light-3/8": 3 / 8, "light-1/2": 1 / 2}
LEVELS = {"30 dB": 1.0, "20 dB": 10**0.5}
"""Read noise, by the ratio that a Boolean code of four shots has in it → its deviation over that of 30 dB."""

SUB_BANDS = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """One code."""

    bands: int
    shots: int
    kind: str
    size: int
    seed: int


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """More and fewer bands than shots."""
    places = ((4, 4),) if quick else ((6, 4), (6, 8), (12, 4), (12, 8), (24, 4), (24, 8))
    return [
        Spec(bands=bands, shots=q, kind=kind, size=32 if quick else 128, seed=seed)
        for bands, q in places
        for kind in KINDS
        for seed in range(2 if quick else 3)
    ]


def run(spec: Spec, scene: SceneSource) -> Result:
    """Measure a finely resolved scene in read noise and reconstruct with both solvers."""
    edge = _codes.imager_of(spec.bands, spec.size, scene.wavelengths)
    imager = _codes.imager_of(spec.bands, spec.size, scene.wavelengths, shear="exact")
    if spec.kind in BUDGETS:
        code = design(edge, shots=spec.shots, seed=spec.seed, transmittance=BUDGETS[spec.kind]).code
    elif spec.kind == "hadamard":
        code = codes.hadamard_code(shots=spec.shots, shape=imager.code_shape, seed=spec.seed)
    else:
        code = _codes.code_of(spec.kind, edge, spec.shots, spec.seed)
    fine = common.fine_cube(scene, spec.bands * SUB_BANDS, (spec.size, spec.size))
    clean, truth = common.measure_fine(imager, code, fine)
    H, read = common.stored_operator(imager, code), _codes.read_noise(imager, truth)
    values: dict[str, dict[str, dict[str, float]]] = {solver: {} for solver in common.SOLVERS}
    for level, factor in LEVELS.items():
        y = _codes.disturbed(clean, "read", factor * read, spec.seed)
        for solver in common.SOLVERS:
            values[solver][level] = _codes.reconstruct(solver, H, y, truth, "read")[1]
    return Result(values={**values, "transmittance": float(code.mean())})


def _places(records: Sequence[Record]) -> list[tuple[int, int]]:
    """(bands, shots), by shots."""
    return sorted({(r.spec["bands"], r.spec["shots"]) for r in records}, key=lambda place: (place[1], place[0]))


def _name(place: tuple[int, int]) -> str:
    return f"L = {place[0]}, Q = {place[1]}"


def _found(records: Sequence[Record], place: tuple[int, int], kind: str, solver: str, level: str) -> list[float]:
    own = common.chosen(records, bands=place[0], shots=place[1], kind=kind)
    return [r.values[solver][level]["psnr"] for r in own]


def _gains(records: Sequence[Record], ours: str, theirs: str, solver: str, level: str) -> dict[str, Gain]:
    return {
        _name(place): _codes.gain(
            _found(records, place, ours, solver, level), _found(records, place, theirs, solver, level)
        )
        for place in _places(records)
    }


def figure(records: Sequence[Record]) -> Figure:
    """Gain over the Boolean code by setting."""
    from shadowgram.figures.sheet import Curve, Curves, sheet

    places = _places(records)
    marks = {float(n): f"{bands}|{q}" for n, (bands, q) in enumerate(places)}
    rows = []
    for level in LEVELS:
        row = []
        for solver, text in common.SOLVERS.items():
            curves, named = {}, not rows and not row
            for number, (kind, name) in enumerate(KINDS.items()):
                gains = list(_gains(records, kind, "boolean", solver, level).values())
                curves[name if named else f"_{name}"] = Curve(
                    x=list(range(len(places))), y=[one.mean for one in gains], colour=number,
                    spread=[one.error for one in gains],
                )  # fmt: skip
            low, high = (choose(y for curve in curves.values() for y in curve.y) for choose in (min, max))
            row.append(
                Curves(
                    title=f"{text}, read noise of {level} for a Boolean code of 4 shots",
                    xlabel="setting, bands | shots",
                    ylabel="gain over Boolean (dB)", curves=curves, marks=marks, bottom=low - 0.1 * (high - low),
                    top=high + (1.2 if named else 0.2) * (high - low),
                )
            )  # fmt: skip
        rows.append(row)
    return sheet("Codes for a camera that is short of light (bands: standard error over seeds)", rows)


def claims(records: Sequence[Record]) -> list[Claim]:
    """Which code is best in each noise, and what the budgets give."""
    return [
        *(_best(records, solver, level) for level in LEVELS for solver in common.SOLVERS),
        _question(records, "light-3/8", "optimised", "what does a light budget of 3/8 give over the complementary design?"),
        _question(records, "light-1/2", "random", "is a design of half open elements better than random half open ones?"),
        _question(records, "hadamard", "random", "is a Hadamard code better than a random one?"),
    ]  # fmt: skip


def _best(records: Sequence[Record], solver: str, level: str) -> Claim:
    rows = []
    for place in _places(records):
        means = {kind: float(np.mean(_found(records, place, kind, solver, level))) for kind in KINDS}
        best = max(means, key=lambda kind: means[kind])
        rows.append(f"{_name(place)}: {KINDS[best]}, {' / '.join(f'{mean:.1f}' for mean in means.values())}")
    return Claim(
        page=None,
        says=f"which code is best in read noise of {level} for a Boolean code of 4 shots? ({common.SOLVERS[solver]})",
        found=f"best, and PSNR in dB of {' / '.join(KINDS.values())}: " + "; ".join(rows),
        agrees=None,
    )


def _question(records: Sequence[Record], ours: str, theirs: str, says: str) -> Claim:
    found = [
        _codes.tell(f"{text}, {level}", _gains(records, ours, theirs, solver, level))
        for level in LEVELS
        for solver, text in common.SOLVERS.items()
    ]
    return Claim(page=None, says=says, found=". ".join(found), agrees=None)


STUDY = Study(
    name="codes-light",
    title="Codes for a camera that is short of light",
    source="a question of ours, on section 3.6.2",
    revision=2,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
