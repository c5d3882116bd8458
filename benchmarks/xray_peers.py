"""Backscatter from a slab by other photon Monte Carlo engines; runs in their virtual environment, without shadowgram.

    python -m venv peers && peers/bin/pip install pypenred==1.15.2.0 goupil==1.3.3
    peers/bin/python benchmarks/xray_peers.py penred --material water --energy 60 --histories 2000000 --json OUT
    peers/bin/python benchmarks/xray_peers.py goupil --material water --energy 100 --histories 2000000 --no-rayleigh
    peers/bin/python benchmarks/xray_peers.py slabs --json tests/golden/xray_slabs.json

A pencil beam of one energy meets the middle of a slab of 10 × 10 × 1 cm (0 ≤ z ≤ 1 cm) in vacuum, along +z. What is counted
are the photons of every kind, from 1 keV on, that leave the slab through any face with a direction cosine w < 0.
Prints one JSON object and, with --json, writes it to a file too. `slabs` runs both engines on both materials at 30, 60 and 100 keV,
which takes ten minutes and gives the reference numbers of the tests.

penRed (PENELOPE 2018) has Rayleigh scattering with form factors, Compton scattering in the impulse approximation (binding
and Doppler broadening), the photoelectric effect and fluorescence. Electrons are absorbed where they are set free.
goupil has the same Compton model and photoelectric absorption, no fluorescence; its tables start at 1 keV, but it is meant for
0.1 to 3 MeV: of the three energies only 100 keV is within what its documentation promises. Its version 1.3.3 changes a photon's
direction in Rayleigh scattering but lets the photon go straight on (its vertices show it), so it runs with --no-rayleigh only.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import chdir
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

# Density in g/cm³; atomic number and mass fraction.
MATERIALS = {
    "water": (1.0, ((1, 0.111894), (8, 0.888106))),
    "aluminium": (2.6989, ((13, 1.0),)),
}
SYMBOLS = {1: "H", 8: "O", 13: "Al"}
ENERGIES = (30.0, 60.0, 100.0)  # keV
SIDE, DEPTH = 10.0, 1.0  # cm
CUTOFF = 1.0  # keV
# The bins of 0.5 keV start at 0.75 keV, so that the elastic line of a whole energy is in the middle of one, not on an edge.
FIRST_EDGE, BIN_WIDTH = 0.75, 0.5
COSINES = np.linspace(-1.0, 0.0, 41)
POLAR_BINS = 9000  # penRed bins the angle, in steps of 0.01° here; they are shared among the bins of the cosine
BATCH = 1_000_000  # photons that goupil has in memory
HISTORIES = 100_000_000  # for the reference numbers

SETUP = (
    "Pencil beam of one energy along +z from the point (0, 0, -1) cm onto a slab -5 <= x, y <= 5 cm, 0 <= z <= 1 cm, in vacuum. "
    "Fraction: photons per history, of every kind and from 1 keV on, that leave the slab through any face with a direction "
    "cosine w < 0. Histograms: such photons per history in each bin of energy (keV) and of w, with the standard error of each bin."
)


def energy_edges(energy: float) -> np.ndarray:
    """Give the edges of the bins of energy, keV, the last of which holds the energy of the beam."""
    bins = int((energy - FIRST_EDGE) / BIN_WIDTH) + 1
    return FIRST_EDGE + BIN_WIDTH * np.arange(bins + 1)


def histogram(edges: np.ndarray, values: np.ndarray, errors: np.ndarray) -> dict[str, list[float]]:
    """Give a histogram as JSON holds it: photons per history in each bin."""

    def short(numbers: np.ndarray, digits: int) -> list[float]:
        return [float(f"{number:.{digits}g}") for number in numbers]

    return {"edges": short(edges, 6), "values": short(values, 6), "standard_errors": short(errors, 3)}


# penRed ----------------------------------------------------------------------------------------------------------------


def quadric_slab() -> str:
    """Give the slab as a PENELOPE geometry: six planes A·x + A0 = 0 and the module between them."""
    rule = "0" * 64 + "\n"
    half = SIDE / 2
    planes = (("AX", -half), ("AX", half), ("AY", -half), ("AY", half), ("AZ", 0.0), ("AZ", DEPTH))
    text = "Slab in vacuum\n" + rule
    for number, (axis, place) in enumerate(planes, 1):
        text += f"SURFACE ({number:4d})   plane\nINDICES=( 0, 0, 0, 0, 0)\n"
        text += f"     {axis}=({1.0:+.15E},   0)\n     A0=({-place:+.15E},   0)\n{rule}"
    text += "MODULE  (   1)   slab\nMATERIAL(   1)\n"
    for number in range(1, 7):
        text += f"SURFACE ({number:4d}), SIDE POINTER=({'+1' if number % 2 else '-1'})\n"
    return text + rule + "END      " + "0" * 55 + "\n"


def emerging(edges: np.ndarray, energy_bins: int, polar_bins: int) -> dict[str, Any]:
    """Give the settings of a tally of the photons that leave the geometry backwards."""
    # The tally also maps where the photons last interacted, and insists on limits for that.
    box = {f"n{axis}": 1 for axis in "xyz"}
    limits = {f"{axis}{end}": sign * SIDE for axis in "xyz" for end, sign in (("min", -1), ("max", 1))}
    return {
        "type": "EMERGING_SPHERICAL_DISTRIB",
        "energy": {"nbins": energy_bins, "min": 1e3 * edges[0], "max": 1e3 * edges[-1]},
        "theta": {"nbins": polar_bins, "min": 90.0, "max": 180.0},
        "phi": {"nbins": 1, "min": 0.0, "max": 360.0},
        "spatial": box | limits,
        "particle": {"gamma": True},
    }


def penred_configuration(energy: float, histories: int, seed: int) -> dict[str, Any]:
    """Give what penRed is asked to do: source, tallies, geometry, material and run."""
    edges = energy_edges(energy)
    beam = {
        "nhist": float(histories),
        "kpar": "gamma",
        "direction": {"type": "CONE", "theta": 0.0, "phi": 0.0, "alpha": 0.0},
        "energy": {"type": "MONOENERGETIC", "energy": 1e3 * energy},
        "spatial": {"type": "POINT", "position": {"x": 0.0, "y": 0.0, "z": -1.0}},
    }
    slab = {
        "number": 1,
        # No electron reaches 1 GeV: all are absorbed where they are set free.
        "eabs": {"electron": 1e9, "positron": 1e9, "gamma": 1e3 * CUTOFF},
        "C1": 0.1,
        "C2": 0.1,
        "WCC": 1e3,
        "WCR": 1e3,
        "filename": "slab.mat",
    }
    return {
        "sources": {"generic": {"beam": beam}},
        "tallies": {
            "total": emerging(edges, 1, 1),
            "energy": emerging(edges, len(edges) - 1, 1),
            "polar": emerging(edges, 1, POLAR_BINS),
        },
        "geometry": {"type": "PEN_QUADRIC", "input-file": "slab.geo", "processed-geo-file": "report.geo"},
        "materials": {"slab": slab},
        "simulation": {"threads": 1, "seed1": seed, "seed2": seed + 1},
    }


def by_cosine(values: np.ndarray, errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Share the fine bins of the polar angle, 90° to 180°, among the bins of its cosine, each evenly in the cosine."""
    fine = np.cos(np.linspace(np.pi, np.pi / 2, len(values) + 1))

    def rebinned(amounts: np.ndarray) -> np.ndarray:
        return np.diff(np.interp(COSINES, fine, np.concatenate(([0.0], np.cumsum(amounts[::-1])))))

    return rebinned(values), np.sqrt(rebinned(errors**2))


def without_rayleigh(text: str) -> str:
    """Make the cross sections of Rayleigh scattering vanish in a PENELOPE material file: NE lines after NQ of the form factor."""
    head = re.search(r"Rayleigh scattering\. +NQ = +(\d+), +NE = +(\d+)\n", text)
    if head is None:
        raise SystemExit("penRed wrote a material file without the section on Rayleigh scattering.")
    rows = text[head.end() :].split("\n")
    first = int(head[1])
    for row in range(first, first + int(head[2])):
        rows[row] = f" {rows[row].split()[0]} 1.00000E-45"
    return text[: head.end()] + "\n".join(rows)


def run_penred(material: str, energy: float, histories: int, seed: int, rayleigh: bool) -> dict[str, Any]:
    """Simulate with penRed on one thread, in a directory of its own since it writes its files where it runs."""
    from pyPenred import simulation  # pyright: ignore[reportMissingImports]

    density, fractions = MATERIALS[material]
    start = time.process_time()
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        simulation.materials.create("slab", density, list(fractions), "slab.mat")
        if not rayleigh:
            Path("slab.mat").write_text(without_rayleigh(Path("slab.mat").read_text()))
        Path("slab.geo").write_text(quadric_slab())
        simulation.setConfigurationLog(str(Path(folder, "configuration.log")))
        simulation.setSimulationLog(str(Path(folder, "simulation.log")))
        simulator = simulation.create()
        simulator.configure(penred_configuration(energy, histories, seed))
        simulator.simulate(False)
        log = Path("simulation.log").read_text()
        found = simulator.getResults()
    # Of each particle there is a result; the photon is the second. The first two of its data are values and standard errors.
    total, spectrum, polar = (
        [np.ravel(numbers) for numbers in found[name][1].data()[:2]] for name in ("total", "energy", "polar")
    )
    seconds = re.search(r"Simulation user time: (\S+) s", log)
    if seconds is None:
        raise SystemExit(f"penRed did not say how long it took; its log reads:\n{log}")
    return {
        "fraction": float(total[0][0]),
        "standard_error": float(total[1][0]),
        "seconds": float(seconds[1]),
        "setup_seconds": round(time.process_time() - start - float(seconds[1]), 2),
        "energy_histogram": histogram(energy_edges(energy), *spectrum),
        "angle_histogram": histogram(COSINES, *by_cosine(*polar)),
    }


# goupil ----------------------------------------------------------------------------------------------------------------


def goupil_engine(goupil: Any, material: str, energy: float, seed: int) -> Any:
    """Prepare forward transport in one layer that ends at the slab's faces."""
    density, fractions = MATERIALS[material]
    composition = tuple((fraction, SYMBOLS[z]) for z, fraction in fractions)
    definition = goupil.MaterialDefinition(material, mass_composition=composition)
    span = (-SIDE / 2, SIDE / 2)
    geometry = goupil.StratifiedGeometry(
        goupil.TopographyMap(span, span, z=DEPTH),
        goupil.GeometrySector(definition, density, "slab"),
        goupil.TopographyMap(span, span, z=0.0),
    )
    engine = goupil.TransportEngine(geometry)
    engine.random.seed = seed
    engine.compton_model = "Penelope"
    engine.rayleigh = False
    engine.energy_min = 1e-3 * CUTOFF
    engine.compile(energy_min=1e-3 * CUTOFF, energy_max=2e-3 * energy)
    return engine


def run_goupil(material: str, energy: float, histories: int, seed: int, rayleigh: bool) -> dict[str, Any]:
    """Simulate with goupil, whose forward transport is analogue; the beam starts on the face, where its world begins."""
    import goupil  # pyright: ignore[reportMissingImports]

    if rayleigh:
        raise SystemExit("goupil lets photons go straight on after Rayleigh scattering; run it with --no-rayleigh.")

    start = time.process_time()
    engine = goupil_engine(goupil, material, energy, seed)
    ready = time.process_time()
    seconds, edges = 0.0, energy_edges(energy)
    spectrum, cosines = np.zeros(len(edges) - 1), np.zeros(len(COSINES) - 1)
    for first in range(0, histories, BATCH):
        photons = goupil.states(min(BATCH, histories - first), energy=1e-3 * energy)
        photons["direction"][:] = 0.0, 0.0, 1.0
        begin = time.process_time()
        status = engine.transport(photons)
        seconds += time.process_time() - begin
        w = photons["direction"][:, 2]
        back = (status == goupil.TransportStatus.EXIT) & (w < 0)
        spectrum += np.histogram(1e3 * photons["energy"][back], edges)[0]
        cosines += np.histogram(w[back], COSINES)[0]
    fraction = cosines.sum() / histories

    def errors(counts: np.ndarray) -> np.ndarray:
        return np.sqrt(counts * (1 - counts / histories)) / histories  # no history gives more than one photon

    return {
        "fraction": float(fraction),
        "standard_error": float(np.sqrt(fraction * (1 - fraction) / histories)),
        "seconds": round(seconds, 3),
        "setup_seconds": round(ready - start, 2),
        "energy_histogram": histogram(edges, spectrum / histories, errors(spectrum)),
        "angle_histogram": histogram(COSINES, cosines / histories, errors(cosines)),
    }


# Both ------------------------------------------------------------------------------------------------------------------

ENGINES: dict[str, tuple[str, Callable[[str, float, int, int, bool], dict[str, Any]]]] = {
    "penred": ("pyPenred", run_penred),
    "goupil": ("goupil", run_goupil),
}


def version_of(engine: str) -> str:
    """Give the version of an engine's package, or end the program with one sentence."""
    package = ENGINES[engine][0]
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        print(
            f"{package} is not installed for this Python; install it with `pip install {package.lower()}`.",
            file=sys.stderr,
        )
        raise SystemExit(2) from None


def case(engine: str, material: str, energy: float, histories: int, seed: int, rayleigh: bool) -> dict[str, Any]:
    """Run one engine on one slab."""
    head = {
        "engine": engine,
        "version": version_of(engine),
        "material": material,
        "density": MATERIALS[material][0],
        "mass_fractions": {SYMBOLS[z]: fraction for z, fraction in MATERIALS[material][1]},
        "energy_kev": energy,
        "histories": histories,
        "seed": seed,
        "rayleigh": rayleigh,
    }
    found = ENGINES[engine][1](material, energy, histories, seed, rayleigh)
    return head | found | {"histories_per_second": round(histories / found["seconds"])}


def slabs(seed: int) -> dict[str, Any]:
    """Run penRed on every slab, then both engines without Rayleigh scattering, of which the fractions are kept."""
    for engine in ENGINES:
        version_of(engine)  # before the first of the long runs
    wanted = [(material, energy) for material in MATERIALS for energy in ENERGIES]
    cases = [case("penred", *slab, HISTORIES, seed, True) for slab in wanted]
    plain = [case(engine, *slab, HISTORIES // 4, seed, False) for slab in wanted for engine in ENGINES]
    return {
        "command": "python benchmarks/xray_peers.py slabs --json tests/golden/xray_slabs.json",
        "engine": "penRed (PENELOPE 2018), through pyPenred",
        "version": version_of("penred"),
        "setup": SETUP,
        "physics": "Rayleigh with form factors; Compton in the impulse approximation (binding, Doppler); photoelectric effect; "
        "fluorescence; photons below 1 keV and all electrons are absorbed where they are.",
        "cases": cases,
        "without_rayleigh": [
            {key: value for key, value in run.items() if not key.endswith("histogram")} for run in plain
        ],
    }


def lines(value: dict[str, Any]) -> str:
    """Give JSON with one line for each entry, and one for each case of a list."""

    def entry(item: Any) -> str:
        if isinstance(item, list):
            return "[\n  " + ",\n  ".join(json.dumps(one) for one in item) + "\n ]"
        return json.dumps(item)

    return "{\n " + ",\n ".join(f"{json.dumps(key)}: {entry(item)}" for key, item in value.items()) + "\n}"


def main() -> None:
    """Read the command line, run, and print."""
    parser = argparse.ArgumentParser(description="Backscatter from a slab by other Monte Carlo engines.")
    parser.add_argument("engine", choices=[*ENGINES, "slabs"])
    parser.add_argument("--material", choices=list(MATERIALS), default="water")
    parser.add_argument("--energy", type=float, default=60.0, help="keV, above 1 (default: 60)")
    parser.add_argument("--histories", type=int, default=2_000_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rayleigh", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--json", type=Path, metavar="OUT", help="a file for the result")
    options = parser.parse_args()
    if options.energy <= CUTOFF:
        parser.error(f"--energy is in keV and must be above {CUTOFF:g}, not {options.energy:g}")
    if options.histories < 1 or options.seed < 1:
        parser.error("--histories and --seed must be at least 1")
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    if options.engine == "slabs":
        result = slabs(options.seed)
    else:
        result = case(
            options.engine, options.material, options.energy, options.histories, options.seed, options.rayleigh
        )
    text = lines(result)
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    main()
