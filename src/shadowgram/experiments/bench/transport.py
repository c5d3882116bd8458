"""Cases: photon transport, beside analog tracking and beside penRed on the same slab."""

from __future__ import annotations

import json
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from shadowgram import xray
from shadowgram.xray._compile import compile_scene
from shadowgram.xray.montecarlo.response import mask_response
from shadowgram.xray.montecarlo.run import Setup, batch_vector, run_setup
from shadowgram.xray.simulation import prepare

from .machine import Machine
from .spec import OURS, BenchSpec, Row, make_row
from .timing import Timing, alternate

SCRIPT = Path(__file__).parents[4] / "benchmarks" / "xray_peers.py"
SLABS = {"water": "water", "aluminium": "aluminum"}
ENERGY = 60.0  # keV
HISTORIES = 200_000  # of one call
PEER_HISTORIES = 4_000_000
ANALOG = "shadowgram, analog"
WANTED = 0.01  # relative error of the counts at the plates
MAP_WANTED = 0.005
MAP_HISTORIES = 3000  # for a cell; the time for the wanted error follows from the error that they give


def transport_cases(spec: BenchSpec, machine: Machine) -> Iterator[Row]:
    """Slabs, the whole CXBI scanner, what variance reduction gains there, and its response map.

    No floor: what limits transport are dependent look-ups, branches and random numbers, of which there is no peak worth naming.
    """
    for name, material in SLABS.items():
        yield _rate(f"slab of {name}, 60 keV", _slab(material), spec, machine)
    scene = xray.shipped_scene("cxbi-blocks")
    compiled = compile_scene(scene, 256)
    analog, reduced = (prepare(compiled, variance_reduction=on) for on in (False, True))
    yield _rate("CXBI scanner, analog", analog, spec, machine)
    yield _merit(analog, reduced, spec, machine)
    yield _map(reduced, machine)


def _slab(material: str) -> Setup:
    """The slab of ``benchmarks/xray_peers.py``."""
    text = f"""
        world = {{ size = [400, 400, 400], material = "vacuum" }}
        source = {{ position = [0, 0, -10], spectrum = {{ energy = {ENERGY} }}, activity = 1e6 }}
        [[solids]]
        name = "slab"
        role = "target"
        material = "{material}"
        shape = {{ kind = "box", centre = [0, 0, 5], size = [100, 100, 10] }}
    """
    scene = xray.parse_scene(text)
    return prepare(compile_scene(scene), variance_reduction=False)


def _rate(case: str, setup: Setup, spec: BenchSpec, machine: Machine) -> Row:
    timings = alternate({OURS: partial(batch_vector, setup, 0, 0, HISTORIES)}, spec.seconds)
    rate = HISTORIES / timings[OURS].ms / 1e3
    return make_row(f"{case}, 200 000 histories", timings, None, machine, f"{rate:.1f} million histories a second")


def _merit(analog: Setup, reduced: Setup, spec: BenchSpec, machine: Machine) -> Row:
    """Time to an error of 1 % at the plates: figures of merit are the inverse of time × error²."""
    histories = int(1e6 * max(spec.seconds, 0.3))
    taken = {}
    for name, setup in ((ANALOG, analog), (OURS, reduced)):
        batch_vector(setup, 0, 0, 1000)
        begun = time.process_time()
        run = run_setup(setup, histories=histories, seed=0, threads=1)
        seconds = time.process_time() - begun
        error = float(run.tallies["all"].relative_error)
        taken[name] = Timing.of([seconds * (error / WANTED) ** 2])
    return make_row(
        "CXBI scanner, time to 1 % at the plates", taken, None, machine, "the ratio is that of the figures of merit"
    )


def _map(reduced: Setup, machine: Machine) -> Row:
    go = partial(mask_response, reduced, solid=1, first_column=256, columns=32, margin=0, seed=0, threads=1)
    go(histories_per_cell=100)
    begun = time.process_time()
    response = go(histories_per_cell=MAP_HISTORIES)
    seconds = time.process_time() - begun
    bright = response.image > 0.5 * response.image.max()
    error = float(np.median(response.standard_error[0][bright] / response.image[bright]))
    ms = Timing.of([seconds * (error / MAP_WANTED) ** 2])
    note = f"from {MAP_HISTORIES} histories a cell, whose median error over the target is {error:.2%}"
    return make_row("CXBI response map 32×32, time to 0.5 % a pixel", {OURS: ms}, None, machine, note)


def compare(rows: Mapping[str, Row], python: str) -> Iterator[dict[str, object]]:
    """Records of penRed's time on those slabs that are among our `rows`, for as many histories.

    Raises
    ------
    ValueError
        If the script fails; with its last words.
    """
    for name in SLABS:
        case = f"slab of {name}, 60 keV, 200 000 histories"
        if case in rows:
            yield _penred(case, name, rows[case].ms, python)


def _penred(case: str, name: str, ours_ms: float, python: str) -> dict[str, object]:
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.json"
        asked = ["penred", "--material", name, "--energy", str(ENERGY), "--histories", str(PEER_HISTORIES)]
        done = subprocess.run(
            [python, str(SCRIPT), *asked, "--json", str(out)], capture_output=True, text=True, timeout=3600, check=False
        )
        if done.returncode == 2:
            skipped = " ".join(done.stderr.split()[-20:])
            return _record(case, "penRed", None, ours_ms, skipped)
        if done.returncode:
            raise ValueError(f"penRed failed: {' '.join(done.stderr.strip().splitlines()[-1:])}")
        found = json.loads(out.read_text())
    ms = 1e3 * found["seconds"] * HISTORIES / PEER_HISTORIES
    return _record(case, f"penRed {found['version']}", ms, ours_ms, "")


def _record(case: str, peer: str, ms: float | None, ours_ms: float, skipped: str) -> dict[str, object]:
    """As `peers.Peer` gives it; there is no result to compare, the tests do that."""
    ratio = None if ms is None else ms / ours_ms
    return {
        "case": case, "peer": peer, "ms": ms, "median_ms": ms, "ours_ms": ours_ms, "error": None, "skipped": skipped,
        "ratio": ratio,
    }  # fmt: skip
