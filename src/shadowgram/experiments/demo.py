"""The demo: one generated scene, four imagers, the same number of snapshots, reconstructed and compared.

Two kinds of figure come out. In `Demo.cases` the model that simulated the snapshots also reconstructs them (the "inverse crime"),
for all imagers alike. In `Demo.model_errors` the SSCSI measures finely resolved bands, as a real scene has them, and its
three models reconstruct: what they lose against the first is the price of the model.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram import codes, scenes
from shadowgram.measurement import AWGN, Imager, Measurement, capture
from shadowgram.solvers.eigen_tv import EigenTV
from shadowgram.solvers.gpsr import GPSR
from shadowgram.solvers.solution import solve
from shadowgram.spectral.cassi import CASSI
from shadowgram.spectral.colored import ColoredCASSI
from shadowgram.spectral.sscsi import SHEARS, SSCSI

from .quality import Quality, assess

if TYPE_CHECKING:
    import xarray as xr

PITCH = 10.0  # µm; only ratios of lengths matter here
WAVELENGTHS = (450.0, 650.0)  # nm
FIRST = "SSCSI"


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoSpec:
    """Settings of the demo.

    Parameters
    ----------
    size : pixels a side.
    bands : of the datacube.
    shots : snapshots of each imager.
    snr_db : of the snapshots, dB.
    sub_bands : fine bands in each band, for the measurement with a model error.
    seed : of scene, codes and noise.
    """

    size: int = 256
    bands: int = 24
    shots: int = 3
    snr_db: float = 40.0
    sub_bands: int = 8
    seed: int = 0


QUICK = DemoSpec(size=128, bands=12)


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """A reconstruction and how it went."""

    solver: str
    x: np.ndarray
    quality: Quality
    seconds: float
    iterations: int
    converged: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """One imager: its measurement, and a reconstruction by each solver."""

    name: str
    measurement: Measurement
    estimates: tuple[Estimate, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class Demo:
    """What the demo found.

    Attributes
    ----------
    scene : (band, y, x) truth.
    cases : one an imager; the first is the SSCSI. The first estimate of each is by the default solver.
    model_errors : model ("exact", "centre", "edge") → reconstruction of the finely resolved measurement.
    seconds : of everything.
    """

    spec: DemoSpec
    scene: xr.DataArray
    cases: tuple[Case, ...]
    model_errors: dict[str, Estimate]
    seconds: float

    def records(self) -> list[dict[str, object]]:
        """All figures, one row a reconstruction."""
        rows = [(case.name, "same", estimate) for case in self.cases for estimate in case.estimates]
        rows += [(self.cases[0].name, shear, estimate) for shear, estimate in self.model_errors.items()]
        return [
            {
                "imager": name,
                "solver": estimate.solver,
                "measured_with": "same model" if model == "same" else f"{self.spec.sub_bands} fine bands a band",
                "model": "exact" if model == "same" and name == self.cases[0].name else model,
                **dataclasses.asdict(estimate.quality),
                "seconds": estimate.seconds,
                "iterations": estimate.iterations,
                "converged": estimate.converged,
            }
            for name, model, estimate in rows
        ]


def imagers_and_codes(spec: DemoSpec, wavelengths: tuple[float, float]) -> dict[str, tuple[Imager, np.ndarray]]:
    """The four imagers, each with a code whose shots are complementary (the four filters: Σ_q t ≥ 1)."""
    shape, pixels = (spec.bands, spec.size, spec.size), (spec.size, spec.size)
    sscsi = SSCSI(
        detector_shape=pixels, detector_pitch=PITCH, code_pitch=PITCH, mask_position=spec.bands / spec.size,
        wavelengths=wavelengths,
    )  # fmt: skip
    cassi = CASSI(cube_shape=shape, wavelengths=wavelengths, pitch=PITCH)
    colored = ColoredCASSI(cube_shape=shape, wavelengths=wavelengths, pitch=PITCH)
    boolean = codes.boolean(shots=spec.shots, shape=pixels, seed=spec.seed)
    return {
        FIRST: (sscsi, boolean),
        "CASSI": (cassi, boolean),
        "Colored CASSI, ideal": (colored, codes.colored(shots=spec.shots, shape=shape, seed=spec.seed)),
        "Colored CASSI, 4 filters": (
            colored,
            codes.colored(shots=spec.shots, shape=shape, seed=spec.seed, filters="four"),
        ),
    }


def solvers(imager: str) -> dict[str, EigenTV | GPSR]:
    """Solvers for an imager: the default, and for the first imager that of the literature beside it."""
    default: dict[str, EigenTV | GPSR] = {"EigenTV": EigenTV()}
    return default | {"GPSR": GPSR(basis="dct-sym8", tau=1e-4)} if imager == FIRST else default


def steps(spec: DemoSpec) -> int:
    """How often `run` calls its `step`."""
    names = imagers_and_codes(spec, WAVELENGTHS)
    return 3 + sum(len(solvers(name)) for name in names) + len(SHEARS)


def run(spec: DemoSpec, step: Callable[[str], None]) -> Demo:
    """Run the demo.

    Parameters
    ----------
    spec : settings.
    step : called with a few words before each part; `steps` says how often.
    """
    begun = time.perf_counter()
    step("compiling")
    _warm_up()
    step("scene")
    scene = scenes.chart(size=spec.size, bands=spec.bands, seed=spec.seed, wavelengths=WAVELENGTHS)
    noise = AWGN(snr_db=spec.snr_db, seed=spec.seed)
    cases = []
    for name, (imager, code) in imagers_and_codes(spec, WAVELENGTHS).items():
        measurement = capture(imager, code, scene, noise=noise, scene="chart")
        estimates = []
        for label, solver in solvers(name).items():
            step(f"{name}, {label}")
            estimates.append(_reconstruct(label, solver, measurement, scene.values))
        cases.append(Case(name=name, measurement=measurement, estimates=tuple(estimates)))
    step("finely resolved scene")
    first = cases[0].measurement
    fine = scenes.chart(size=spec.size, bands=spec.bands * spec.sub_bands, seed=spec.seed, wavelengths=WAVELENGTHS)
    honest = capture(first.imager, first.code, fine, noise=noise, fine=True, scene="chart")
    label, solver = next(iter(solvers(FIRST).items()))
    model_errors = {}
    for shear in SHEARS:
        step(f"model error, {shear}")
        imager = dataclasses.replace(first.imager, shear=shear)
        measurement = dataclasses.replace(honest, imager=imager)
        model_errors[shear] = _reconstruct(label, solver, measurement, scene.values)
    return Demo(
        spec=spec, scene=scene, cases=tuple(cases), model_errors=model_errors, seconds=time.perf_counter() - begun
    )


def _reconstruct(label: str, solver: EigenTV | GPSR, measurement: Measurement, truth: np.ndarray) -> Estimate:
    begun = time.perf_counter()
    solution = solve(solver, measurement.operator, measurement.snapshots)
    seconds = time.perf_counter() - begun
    return Estimate(
        solver=label,
        x=solution.x,
        quality=assess(solution.x, truth),
        seconds=seconds,
        iterations=solution.iterations,
        converged=bool(solution.converged),
    )


def _warm_up() -> None:
    """Have every kernel compiled or loaded, so that the times in the table are those of the work."""
    spec = DemoSpec(size=32, bands=4)
    scene = np.random.default_rng(0).random((spec.bands, spec.size, spec.size), dtype=np.float32)
    for name, (imager, code) in imagers_and_codes(spec, WAVELENGTHS).items():
        measurement = capture(imager, code, scene)
        for solver in solvers(name).values():
            solve(dataclasses.replace(solver, max_iter=6), measurement.operator, measurement.snapshots)
