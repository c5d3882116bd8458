"""How much the weight c₁ of the source's cost decides, and whether the default rule finds a good one: a question of ours.

The source gives c₁ between 1 and 70 without saying when which. Here codes of the source's cost (edge shear) are designed with c₁
over several decades, for L/Q from 1 to 12, measured as in the source with the model that reconstructs, at 30 dB, and reconstructed
with GPSR, its τ searched, and EigenTV. The default is `shadowgram.codes.default_c1`. The rule for our coupled cost of the
exact shear is tried at fewer weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram import codes
from shadowgram.codes._design import default_c1
from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study

from . import _codes
from . import _common as common
from ._common import SOLVERS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Curves

FACTORS = (0.0, 0.25, 1.0, 2.5, 5.0, 10.0, 20.0, 40.0, 80.0, 160.0)  # c₁ Q/L
FEWER = (0.25, 2.5, 10.0, 40.0, 160.0)  # with coupling
DEFAULT, ENDS, GRID = "default", "end of the source's range", "grid"
STATED = (1.0, 70.0)
COSTS = {0.0: "source's cost", 1.0: "coupled, exact shear"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """One weight; `role` says why it is tried."""

    bands: int
    shots: int
    c1: float
    coupling: float
    role: str
    size: int
    seed: int


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """Weights proportional to L/Q, the default, and the ends of the source's range."""
    places = ((4, 4), (4, 2)) if quick else ((6, 6), (12, 8), (12, 6), (12, 4), (24, 6), (24, 3), (24, 2))
    return [
        Spec(
            bands=bands, shots=q, c1=c1, coupling=coupling, role=role, size=32 if quick else 128, seed=seed
        )
        for bands, q in places
        for coupling in COSTS
        for role, c1 in _weights(bands, q, coupling, quick)
        for seed in range(1 if quick else 2)
    ]  # fmt: skip


def _weights(bands: int, shots: int, coupling: float, quick: bool) -> list[tuple[str, float]]:
    """(role, c₁) to try."""
    factors = (0.0, 5.0, 40.0) if quick else FEWER if coupling else FACTORS
    tried = [(GRID, factor * bands / shots) for factor in factors]
    tried.append((DEFAULT, default_c1(bands, shots, coupling)))
    return tried if coupling else [*tried, *((ENDS, c1) for c1 in STATED)]


def run(spec: Spec, scene: SceneSource) -> Result:
    """Design, measure at 30 dB, reconstruct with both solvers."""
    imager = _codes.imager_of(spec.bands, spec.size, scene.wavelengths)
    designed_for = _codes.imager_of(
        spec.bands, spec.size, scene.wavelengths, shear="exact" if spec.coupling else "edge"
    )
    code = codes.optimised(designed_for, shots=spec.shots, seed=spec.seed, c1=spec.c1, coupling=spec.coupling)
    truth = common.fine_cube(scene, spec.bands, (spec.size, spec.size))
    H = common.stored_operator(imager, code)
    y = _codes.disturbed(H.forward(truth), "30 dB", 0.0, spec.seed)
    values = {solver: _codes.reconstruct(solver, H, y, truth, "30 dB")[1] for solver in SOLVERS}
    changes = float((np.diff(code.argmax(axis=0), axis=1) != 0).mean())
    return Result(values={**values, "run": round(1 / changes, 3)})


def _places(records: Sequence[Record]) -> list[tuple[int, int]]:
    """(bands, shots) by their ratio."""
    return sorted({(r.spec["bands"], r.spec["shots"]) for r in records}, key=lambda place: place[0] / place[1])


def _psnr(
    records: Sequence[Record], place: tuple[int, int], coupling: float, solver: str, role: str
) -> dict[float, float]:
    """c₁ → PSNR, the mean over seeds."""
    own = common.chosen(records, bands=place[0], shots=place[1], coupling=coupling, role=role)
    weights = sorted({r.spec["c1"] for r in own})
    return {c1: float(np.mean([r.values[solver]["psnr"] for r in own if r.spec["c1"] == c1])) for c1 in weights}


def _lost(records: Sequence[Record], place: tuple[int, int], coupling: float, solver: str) -> dict[str, float]:
    """What is tried → dB below the best of all weights; the default, and with the source's cost c₁ = 1 and 70."""
    several = {
        role: _psnr(records, place, coupling, solver, role) for role in (GRID, DEFAULT, ENDS) if role != ENDS or not coupling
    }  # fmt: skip
    best = max(psnr for one in several.values() for psnr in one.values())
    lost = {DEFAULT: best - next(iter(several[DEFAULT].values()))}
    return lost | {f"c₁ = {c1:g}": best - psnr for c1, psnr in several.get(ENDS, {}).items()}


def figure(records: Sequence[Record]) -> Figure:
    """PSNR below the best over c₁, by setting, cost and solver; the runs of the codes; what the default loses."""
    from shadowgram.figures.sheet import sheet

    rows = [
        [_over_weights(records, coupling, solver, named=coupling == 0 and solver == "gpsr") for solver in SOLVERS]
        for coupling in COSTS
    ]
    rows.append([_losses(records, solver, named=solver == "gpsr") for solver in SOLVERS])
    return sheet("Weight c₁ of the cost of a code, 30 dB; below: what the default and fixed weights lose", rows)


def _over_weights(records: Sequence[Record], coupling: float, solver: str, *, named: bool) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    curves = {}
    for number, place in enumerate(_places(records)):
        grid = _psnr(records, place, coupling, solver, GRID) | _psnr(records, place, coupling, solver, DEFAULT)
        best = max(grid.values())
        weights = [c1 for c1 in sorted(grid) if c1 > 0]
        name = f"L/Q = {place[0] / place[1]:.3g} (L = {place[0]})"
        curves[name if named else f"_{name}"] = Curve(
            x=[c1 * place[1] / place[0] for c1 in weights], y=[grid[c1] - best for c1 in weights], colour=number,
            dash=number // 6,
        )  # fmt: skip
    return Curves(
        title=f"{COSTS[coupling]}, {SOLVERS[solver]}", xlabel="c₁ Q/L", ylabel="PSNR below the best (dB)", curves=curves,
        log="x", bottom=-6, top=0.3,
    )  # fmt: skip


def _losses(records: Sequence[Record], solver: str, *, named: bool) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    places = _places(records)
    ratios = [bands / shots for bands, shots in places]
    lost = {coupling: [_lost(records, place, coupling, solver) for place in places] for coupling in COSTS}
    curves = {
        name: Curve(x=ratios, y=[one[name] for one in lost[0.0]], colour=number) for number, name in enumerate(lost[0.0][0])
    }  # fmt: skip
    curves["default, coupled"] = Curve(x=ratios, y=[one[DEFAULT] for one in lost[1.0]], colour=0, dash=1)
    return Curves(
        title=f"lost, {SOLVERS[solver]}", xlabel="bands per shot L/Q", ylabel="below the best (dB)", bottom=0,
        curves=curves if named else {f"_{name}": curve for name, curve in curves.items()},
    )  # fmt: skip


def claims(records: Sequence[Record]) -> list[Claim]:
    """What the default and fixed weights lose, and where the best weight lies."""
    return [*(_rule(records, coupling) for coupling in COSTS), *(_best(records, coupling) for coupling in COSTS)]


def _rule(records: Sequence[Record], coupling: float) -> Claim:
    found = []
    for solver, name in SOLVERS.items():
        lost = {place: _lost(records, place, coupling, solver) for place in _places(records)}
        for tried in next(iter(lost.values())):
            by_place = {f"{place[0] / place[1]:.3g}": one[tried] for place, one in lost.items()}
            worst = max(by_place, key=lambda ratio: by_place[ratio])
            found.append(
                f"{name}, {tried}: {by_place[worst]:.2f} dB at most, {np.mean(list(by_place.values())):.2f} on average; by L/Q "
                + ", ".join(f"{ratio}: {value:.2f}" for ratio, value in by_place.items())
            )
    ends = "" if coupling else ", and fixed ones at the ends of the source's range 1 to 70"
    return Claim(
        page=None,
        says=f"how much does the default c₁ lose against the best of all tried{ends}? ({COSTS[coupling]}, 30 dB)",
        found=". ".join(found),
        agrees=None,
    )


def _best(records: Sequence[Record], coupling: float) -> Claim:
    found = []
    for solver, name in SOLVERS.items():
        parts = []
        for place in _places(records):
            grid = _psnr(records, place, coupling, solver, GRID)
            best = max(grid, key=lambda c1: grid[c1])
            near = [c1 for c1, psnr in grid.items() if psnr > grid[best] - 0.3]
            parts.append(
                f"{place[0] / place[1]:.3g}: {best:.3g} ({min(near):.3g} to {max(near):.3g}; default"
                f" {default_c1(*place, coupling):.3g}; worst {min(grid.values()) - grid[best]:+.1f} dB)"
            )
        found.append(f"{name}: " + ", ".join(parts))
    return Claim(
        page=None,
        says=f"which c₁ is best? ({COSTS[coupling]}, 30 dB)",
        found="best of the grid by L/Q (those within 0.3 dB; the worst): " + ". ".join(found),
        agrees=None,
    )


STUDY = Study(
    name="codes-c1",
    title="Weight of the diagonal in the cost of a code",
    source="a question of ours, on section 3.3.5",
    revision=2,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
