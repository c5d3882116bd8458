"""Fig. 4.1 and section 4.2: what Compton scattering does to a photon, by angle and energy.

The source draws the cross section of free electrons, dσ/dΩ over θ, for three energies that it does not name; here they are
20, 60 and 120 keV, and beside free electrons there are those of water and of gold, where the scattering function of the atoms
lowers what a small momentum transfer can do. Nothing is random.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study
from shadowgram.xray import bound_compton, klein_nishina, material, scattered_energy
from shadowgram.xray.montecarlo.arrays import ELECTRON_MASS

from . import _common as common

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Curve, Curves

SHOWN = (20.0, 60.0, 120.0)  # keV
MATERIALS = ("water", "gold")
FREE = "free"
STATED = 0.7
"""Share of the energy that the source lets a photon keep at θ = π."""
NEAR = 0.05
"""What "approximately" is taken for."""
NODES = 64  # of the integrals over a quarter of the circle
SOLID = 4  # a line through without markers


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """One energy of the incident photon, keV."""

    energy: float
    angles: int


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """The three energies that are drawn, and those between and beyond them."""
    energies = (
        SHOWN
        if quick
        else (10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 81.0, 90.0, 100.0, 120.0, 140.0, 170.0, 200.0)
    )
    return [Spec(energy=energy, angles=91 if quick else 361) for energy in energies]


def run(spec: Spec, _scene: SceneSource) -> Result:
    """Cross sections over the angle, and what follows from them."""
    theta = np.linspace(0, math.pi, spec.angles)
    arrays = {"theta": theta, "kept": scattered_energy(spec.energy, theta) / spec.energy}
    values: dict[str, object] = {
        "kept": float(arrays["kept"][-1]),
        "forward": float(klein_nishina(spec.energy, 0.0)),
        "printed": _printed_forward(spec.energy),
    }
    for name in (FREE, *MATERIALS):
        arrays[name] = _cross_section(name, spec.energy, theta)
        shares = {} if name == FREE else _shares_of(name, spec.energy)
        values[name] = {**_totals(name, spec.energy), "back": float(arrays[name][-1]), **shares}
    return Result(values=values, arrays={name: array.astype(np.float32) for name, array in arrays.items()})


def _shares_of(name: str, energy: float) -> dict[str, float]:
    """What the attenuation of a material consists of."""
    of = material(name)
    parts = {"photoelectric": of.photoelectric, "compton": of.compton, "rayleigh": of.rayleigh}
    total = float(of.mass_attenuation(energy))
    return {part: float(curve(energy)) / total for part, curve in parts.items()}


def _cross_section(name: str, energy: float, theta: np.ndarray) -> np.ndarray:
    """dσ/dΩ per electron, barn/sr."""
    return klein_nishina(energy, theta) if name == FREE else bound_compton(material(name), energy, theta)


def _printed_forward(energy: float) -> float:
    """What the bracket of (4.2) gives at θ = 0 as it is printed, in units of r_e².

    It begins with a = E/mc² where the formula has 1, and there is no sign between cos²θ and the fraction, which is 0 there.
    """
    return 0.5 * energy / ELECTRON_MASS


def _totals(name: str, energy: float) -> dict[str, float]:
    """Cross section over all directions, barn, and the share of it beyond π/2."""
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    forward, backward = (
        math.pi * float(_cross_section(name, energy, np.arccos(middle + 0.5 * nodes)) @ weights)
        for middle in (0.5, -0.5)  # of the cosines
    )
    return {"total": forward + backward, "backward": backward / (forward + backward)}


def _by_energy(records: Sequence[Record]) -> list[Record]:
    return sorted(records, key=lambda r: r.spec["energy"])


def _shown(records: Sequence[Record]) -> list[Record]:
    return [common.only(records, energy=energy) for energy in SHOWN]


def figure(records: Sequence[Record]) -> Figure:
    """Free electrons as in the source, what a photon keeps, bound electrons, and the shares over the energy."""
    from shadowgram.figures.sheet import sheet

    rows = [_free(_shown(records)), [_bound(record) for record in _shown(records)], _shares(_by_energy(records))]
    return sheet("Compton scattering by angle and energy (Fig. 4.1, right)", rows)


def _over_angle(record: Record, name: str, colour: int, *, dash: int = SOLID, scale: float = 1.0) -> Curve:
    from shadowgram.figures.sheet import Curve

    return Curve(x=np.degrees(record.arrays["theta"]), y=scale * record.arrays[name], colour=colour, dash=dash)


def _free(shown: Sequence[Record]) -> list[Curves]:
    from shadowgram.figures.sheet import Curves

    angle = "scattering angle θ (degrees)"
    named = [(f"{record.spec['energy']:g} keV", record) for record in shown]
    return [
        Curves(
            title="free electrons", xlabel=angle, ylabel="dσ/dΩ (mb/sr)", bottom=0,
            curves={name: _over_angle(record, FREE, i, scale=1000) for i, (name, record) in enumerate(named)},
        ),
        Curves(
            title="energy that the photon keeps", xlabel=angle, ylabel="E'/E (%)",
            curves={name: _over_angle(record, "kept", i, scale=100) for i, (name, record) in enumerate(named)},
            marks={90.0: "backscattered"},
        ),
    ]  # fmt: skip


def _bound(record: Record) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    free = Curve(x=np.degrees(record.arrays["theta"]), y=1000 * record.arrays[FREE], reference=True)
    curves = {FREE: free} | {
        name: _over_angle(record, name, 1 + i, dash=SOLID + i, scale=1000) for i, name in enumerate(MATERIALS)
    }
    return Curves(
        title=f"{record.spec['energy']:g} keV, per electron", xlabel="scattering angle θ (degrees)",
        ylabel="dσ/dΩ (mb/sr)", bottom=0, top=80, curves=curves,
    )  # fmt: skip


def _shares(records: Sequence[Record]) -> list[Curves]:
    from shadowgram.figures.sheet import Curve, Curves

    energy = [r.spec["energy"] for r in records]
    kept = Curve(x=energy, y=[100 * r.values["kept"] for r in records])
    stated = Curve(x=[energy[0], energy[-1]], y=[100 * STATED] * 2, reference=True)
    backward = {
        name: Curve(x=energy, y=[100 * r.values[name]["backward"] for r in records], colour=i)
        for i, name in enumerate((FREE, *MATERIALS))
    }
    parts = {
        f"{part if part == 'photoelectric' else part.capitalize()}, {name}": Curve(
            x=energy, y=[100 * r.values[name][part] for r in records], colour=number, dash=SOLID + dash
        )
        for number, part in enumerate(("photoelectric", "compton", "rayleigh"))
        for dash, name in enumerate(MATERIALS)
    }
    where = "energy of the photon (keV)"
    return [
        Curves(title="kept at θ = π", xlabel=where, ylabel="E'/E (%)", curves={"_": kept, "70 %": stated}),
        Curves(title="scattered backwards", xlabel=where, ylabel="θ > π/2 (% of scatterings)", curves=backward),
        Curves(title="what attenuates", xlabel=where, ylabel="% of μ", curves=parts, bottom=0),
    ]


def claims(records: Sequence[Record]) -> list[Claim]:
    """What section 4.2 says, and what bound electrons change."""
    ordered = _by_energy(records)
    return [
        _kept(ordered), _radius(ordered), _formula(_shown(records)), _predominant(ordered), _left_out(ordered),
        _backward(ordered), _binding(_shown(records)),
    ]  # fmt: skip


def _list(pairs: Sequence[tuple[float, str]]) -> str:
    return ", ".join(f"{text} at {energy:g} keV" for energy, text in pairs)


def _kept(records: Sequence[Record]) -> Claim:
    found = _list([(r.spec["energy"], f"{100 * r.values['kept']:.1f} %") for r in records])
    low, exact, high = (0.5 * ELECTRON_MASS * (1 / share - 1) for share in (STATED + NEAR, STATED, STATED - NEAR))
    near = [abs(r.values["kept"] - STATED) <= NEAR for r in records]
    return Claim(
        page=67, says="a photon scattered by θ = π keeps approximately 70 % of its energy",
        found=f"{found}; 70 % at {exact:.1f} keV, and 65 to 75 % from {low:.0f} to {high:.0f} keV",
        agrees=all(near),
        why="" if all(near) else "the share depends on the energy, which the source does not say; its tube of 120 kV has 52 keV"
        f" in the mean, of which {100 / (1 + 2 * 52 / ELECTRON_MASS):.0f} % are left",
    )  # fmt: skip


def _radius(records: Sequence[Record]) -> Claim:
    radius = [10 * math.sqrt(r.values["forward"]) for r in records]  # 1 barn is 100 fm²
    return Claim(
        page=67, says="r_e = 2.818 · 10⁻¹⁵ m, whose square is dσ/dΩ at θ = 0 for every energy",
        found=f"√(dσ/dΩ) at θ = 0 from {min(radius):.4f} to {max(radius):.4f} fm over {len(radius)} energies",
        agrees=max(abs(one - 2.818) for one in radius) < 5e-4,
    )  # fmt: skip


def _formula(shown: Sequence[Record]) -> Claim:
    found = _list([(r.spec["energy"], f"{r.values['printed']:.3f} r_e²") for r in shown])
    return Claim(
        page=67, says="dσ/dΩ is given by (4.2), the Klein–Nishina formula",
        found=f"as printed, at θ = 0: {found}, and not r_e²",
        agrees=False,
        why="misprints: its bracket begins with a where 1 belongs, and no sign stands before the fraction; what is drawn is"
        " the formula of Klein and Nishina, r_e²/2 P² (P + 1/P − sin²θ) with P = E'/E",
    )  # fmt: skip


def _predominant(records: Sequence[Record]) -> Claim:
    found, least = [], []
    for name in MATERIALS:
        both = [r.values[name]["photoelectric"] + r.values[name]["compton"] for r in records]
        place = int(np.argmin(both))
        least.append(both[place])
        compton = [100 * r.values[name]["compton"] for r in records]
        found.append(
            f"{name}: together at least {100 * both[place]:.0f} % of μ ({records[place].spec['energy']:g} keV),"
            f" Compton scattering alone {min(compton):.2g} to {max(compton):.0f} %"
        )
    low, high = records[0].spec["energy"], records[-1].spec["energy"]
    return Claim(
        page=67, says="Compton scattering predominates at low energies, together with the photoelectric effect",
        found=f"from {low:g} to {high:g} keV, {'; '.join(found)}",
        agrees=min(least) > 0.5,
    )  # fmt: skip


def _left_out(records: Sequence[Record]) -> Claim:
    found = []
    for name in MATERIALS:
        share = [r.values[name]["rayleigh"] for r in records]
        place = int(np.argmax(share))
        shown = _list([(r.spec["energy"], f"{100 * r.values[name]['rayleigh']:.1f} %") for r in _shown(records)])
        found.append(f"{name}: {shown}, at most {100 * share[place]:.1f} % ({records[place].spec['energy']:g} keV)")
    return Claim(
        page=None, says="μ in (4.3) is of photoelectric effect and Compton scattering (p. 67); how much of it would be Rayleigh's?",
        found="; ".join(found), agrees=None,
    )  # fmt: skip


def _backward(records: Sequence[Record]) -> Claim:
    parts = [
        f"{name}: " + _list([(r.spec["energy"], f"{100 * r.values[name]['backward']:.1f} %") for r in _shown(records)])
        for name in (FREE, *MATERIALS)
    ]
    return Claim(
        page=None, says="a photon is backscattered if θ > π/2 (p. 67); how many of the Compton scatterings are such?",
        found="; ".join(parts), agrees=None,
    )  # fmt: skip


def _binding(shown: Sequence[Record]) -> Claim:
    parts = []
    for name in MATERIALS:
        pairs = []
        for r in shown:
            back, total = (r.values[name][what] / r.values[FREE][what] for what in ("back", "total"))
            pairs.append((r.spec["energy"], f"{back:.3f} and {total:.3f}"))
        parts.append(f"{name}: {_list(pairs)}")
    return Claim(
        page=None, says="what do bound electrons change, in dσ/dΩ at θ = π and in σ?",
        found="times that of free electrons, " + "; ".join(parts), agrees=None,
    )  # fmt: skip


STUDY = Study(
    name="fig-4-1",
    title="Compton scattering by angle and energy",
    source="Fig. 4.1 and section 4.2, pages 67 and 68",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
