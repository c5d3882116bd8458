"""How much of a pencil beam comes back from a slab, against another program: the ground under section 4.5.

The source simulates with GATE, and gives no number that a single slab could be checked with. Here pencils of 30, 60 and 100 keV
meet slabs of water and aluminum of 10 × 10 × 1 cm in vacuum. Fractions, energies and directions of what comes back are compared
with penRed (PENELOPE 2018), whose numbers come with the package. Its Compton scattering is of the impulse approximation, which
broadens energies; ours has the scattering function and no broadening. And the tables differ, most at 30 keV: ours (xraylib) have
2.6 and 1.4 % more photoelectric absorption in water and aluminum, and 1.4 and 1.1 % less Compton scattering.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np

from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study

from . import _common as common

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Curve, Curves
    from shadowgram.xray import Scene

MATERIALS = {"water": "water", "aluminium": "aluminum"}
"""As the reference calls them, and as the package does."""
ENERGIES = (30.0, 60.0, 100.0)  # keV
WANTED = {"water": 0.005, "aluminium": 0.015}
"""Relative difference that the two programs are hoped to have at most."""
WHY = (
    "the tables differ: at 30 keV ours have 2.6 % (water) and 1.4 % (aluminum) more photoelectric absorption, and 1.4 % and"
    " 1.1 % less Compton scattering than penRed's"
)
NOTHING = 1e-9  # per photon and keV, in place of 0 on logarithmic axes
SOLID = 4  # a line through without markers


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """One slab and energy, keV."""

    material: str
    energy: float
    histories: int
    seed: int


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """Both materials at all energies."""
    return [
        Spec(material=name, energy=energy, histories=200_000 if quick else 100_000_000, seed=1)
        for name in MATERIALS
        for energy in ENERGIES
    ]


def slab(name: str, energy: float, density: float) -> Scene:
    """The scene: a pencil along z onto the middle of a slab whose front is at z = 0, in vacuum."""
    from shadowgram.xray.scene import Box, Composition, Scene, Solid, Source, World

    shape = Box(centre=(0, 0, 5), size=(100, 100, 10))
    return Scene(
        world=World(size=(1000, 1000, 1000), material="vacuum"),  # type: ignore[arg-type]  # a name will do
        source=Source(position=(0, 0, -10), spectrum={"energy": energy}, activity=1e6),  # type: ignore[arg-type]
        solids=(Solid(name="slab", role="target", material=Composition(name=name, density=density), shape=shape),),
    )


@functools.cache
def _reference() -> Mapping[tuple[str, float], Mapping[str, Any]]:
    """(material, energy) → what penRed found."""
    file = resources.files("shadowgram.xray") / "data" / "slabs-penred.json"
    cases = json.loads(file.read_text(encoding="utf-8"))["cases"]
    return {(case["material"], case["energy_kev"]): case for case in cases}


def run(spec: Spec, _scene: SceneSource) -> Result:
    """Follow the photons, and put the reference beside them."""
    from shadowgram.xray import simulate

    theirs = _reference()[spec.material, spec.energy]
    scene = slab(MATERIALS[spec.material], spec.energy, theirs["density"])
    tallies = simulate(scene, histories=spec.histories, seed=spec.seed).tallies
    fraction, spectrum = tallies["escaped/backward"], tallies["escaped/backward/spectrum"]
    cosine = tallies["escaped/cosine"]
    back = cosine.mean.size // 2
    energy_edges, cosine_edges = spectrum.edges[0], cosine.edges[0]
    assert energy_edges is not None
    assert cosine_edges is not None
    ours = {
        "energy": spectrum.mean, "energy_error": spectrum.standard_error, "energy_edges": energy_edges,
        "cosine": cosine.mean[:back], "cosine_error": cosine.standard_error[:back], "cosine_edges": cosine_edges[: back + 1],
    }  # fmt: skip
    reference = {
        f"reference_{ours}{ending}": np.array(theirs[f"{name}_histogram"][what])
        for ours, name in (("energy", "energy"), ("cosine", "angle"))
        for ending, what in (("", "values"), ("_edges", "edges"), ("_error", "standard_errors"))
    }
    values = {
        "fraction": float(fraction.mean), "error": float(fraction.standard_error),
        "reference": theirs["fraction"], "reference_error": theirs["standard_error"],
    }  # fmt: skip
    return Result(values=values, arrays={name: a.astype(np.float32) for name, a in (ours | reference).items()})


def _difference(record: Record) -> tuple[float, float]:
    """Relative difference of the fractions, and its standard error."""
    v = record.values
    relative = np.hypot(v["error"] / v["fraction"], v["reference_error"] / v["reference"])
    return v["fraction"] / v["reference"] - 1, float(relative)


def mean_of(record: Record, what: str, prefix: str = "") -> float:
    """Mean energy, keV, or cosine of what comes back, from the histogram."""
    counts, edges = (record.arrays[f"{prefix}{what}{ending}"].astype(float) for ending in ("", "_edges"))
    return float(counts @ (edges[1:] + edges[:-1]) / 2 / counts.sum())


def figure(records: Sequence[Record]) -> Figure:
    """Differences of the fractions, and for each material spectra and directions of both programs."""
    from shadowgram.figures.sheet import sheet

    rows = [_fractions(records)]
    rows += [_histograms(common.chosen(records, material=name)) for name in MATERIALS]
    return sheet("What comes back from a slab of 1 cm; broad and pale: penRed", rows)


def _fractions(records: Sequence[Record]) -> list[Curves]:
    from shadowgram.figures.sheet import Curve, Curves

    fractions: dict[str, Curve] = {}
    differences: dict[str, Curve] = {}
    for number, name in enumerate(MATERIALS):
        own = common.chosen(records, material=name)
        energy = [r.spec["energy"] for r in own]
        reference = [100 * r.values["reference"] for r in own]
        fractions[f"_{name}, penRed"] = Curve(x=energy, y=reference, reference=True)
        fractions[MATERIALS[name]] = Curve(x=energy, y=[100 * r.values["fraction"] for r in own], colour=number)
        apart, errors = zip(*(_difference(r) for r in own), strict=True)
        differences[MATERIALS[name]] = Curve(
            x=energy, y=[100 * one for one in apart], spread=[100 * one for one in errors], colour=number
        )
    return [
        Curves(title="backscattered", xlabel="energy (keV)", ylabel="% of the photons", curves=fractions, bottom=0),
        Curves(
            title="difference from penRed (band: standard error)", xlabel="energy (keV)", ylabel="%", curves=differences
        ),
    ]


def _histograms(own: Sequence[Record]) -> list[Curves]:
    from shadowgram.figures.sheet import Curves

    name = MATERIALS[own[0].spec["material"]]
    curves: dict[str, dict[str, Curve]] = {"energy": {}, "cosine": {}}
    for number, record in enumerate(own):
        label = f"{record.spec['energy']:g} keV"
        for what, drawn in curves.items():
            drawn[f"_{label}, penRed"] = _steps(record, f"reference_{what}", number, reference=True)
            drawn[label] = _steps(record, what, number)
    return [
        Curves(
            title=f"{name}: energy of what comes back", xlabel="keV", ylabel="per photon and keV", log="y",
            curves=curves["energy"], bottom=1e-6,
        ),
        Curves(
            title=f"{name}: direction of what comes back", xlabel="cosine of the angle with the beam",
            ylabel="per photon and unit of cosine", curves=curves["cosine"], bottom=0,
        ),
    ]  # fmt: skip


def _steps(record: Record, what: str, colour: int, *, reference: bool = False) -> Curve:
    """A histogram as a density over the middles of its bins; empty ones are far down, so that single ones stand out."""
    from shadowgram.figures.sheet import Curve

    edges = record.arrays[f"{what}_edges"].astype(float)
    density = np.maximum(record.arrays[what] / np.diff(edges), NOTHING)
    return Curve(x=(edges[1:] + edges[:-1]) / 2, y=density, colour=colour, dash=SOLID, reference=reference)


def claims(records: Sequence[Record]) -> list[Claim]:
    """How far the programs are apart, in fractions, energies and directions."""
    return [
        *(_within(common.chosen(records, material=name), WANTED[name]) for name in MATERIALS),
        _means(records, "energy", "keV"),
        _means(records, "cosine", ""),
    ]


def _within(own: Sequence[Record], wanted: float) -> Claim:
    parts, beyond = [], False
    for record in own:
        apart, error = _difference(record)
        v = record.values
        beyond |= abs(apart) > wanted
        parts.append(
            f"{record.spec['energy']:g} keV: {v['fraction']:.5f} and {v['reference']:.5f},"
            f" {100 * apart:+.2f} ± {100 * error:.2f} % ({'beyond' if abs(apart) > wanted else 'within'})"
        )
    name = MATERIALS[own[0].spec["material"]]
    return Claim(
        page=None, says=f"does {name} send back what it does in penRed, within {100 * wanted:g} %?",
        found="; ".join(parts), agrees=None, why=WHY if beyond else "",
    )  # fmt: skip


def _means(records: Sequence[Record], what: str, unit: str) -> Claim:
    parts = [
        f"{MATERIALS[r.spec['material']]}, {r.spec['energy']:g} keV: {mean_of(r, what):.3f} and"
        f" {mean_of(r, what, 'reference_'):.3f} {unit}".rstrip()
        for r in records
    ]
    return Claim(
        page=None, says=f"mean {what} of what comes back, here and in penRed?", found="; ".join(parts), agrees=None
    )  # fmt: skip


STUDY = Study(
    name="slab-backscatter",
    title="Backscatter of slabs against another program",
    source="a question of ours, on section 4.5",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
