"""Exact shear of the code against the models' first order: Fig. 2.13, section 2.3.6.

Within a band the code moves by one column over the detector. The source's models code the whole band as its lower edge λ1 is coded
("edge"), which it calls a first order approximation; it does not say what that costs. "Centre" codes the band as its centre is,
"exact" takes the mean over the element and the band.

First the mask as it is seen in the x–λ plane, and the coefficients that the models put in its place, in both regimes. Then what the
choice costs where it matters: a finely resolved scene (8 sub-bands a band) is measured, which no discrete model does, and
reconstructed with each shear. Beside it the inverse crime of measuring and reconstructing with the edge model, as in the source's
simulations.

What agrees: the models code a band as its lower edge. On finely resolved scenes that costs many dB, the more the fewer bands there
are, and the inverse crime hides it. Exact shear takes the time of first order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from shadowgram import codes
from shadowgram._threads import threads
from shadowgram.experiments.bench.timing import alternate
from shadowgram.experiments.source import CHART_RANGE, SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study
from shadowgram.operators import as_matrix
from shadowgram.spectral.resolution import SUPER_RESOLVING
from shadowgram.spectral.sscsi import SHEARS, SSCSI

from . import _common as common
from ._common import CONTINUOUS, SAME, SOLVERS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Curves, Heat, Picture

MAP, QUALITY, TIME = "map", "quality", "time"
SAMPLES = 24  # of the maps, an element and a band


@dataclass(frozen=True, slots=True, kw_only=True)
class MapSpec:
    """x–λ plane of a short row: the part of it that `shown` elements see."""

    mask_position: float
    pitch_ratio: int
    elements: int
    shown: int
    seed: int
    part: str = MAP


@dataclass(frozen=True, slots=True, kw_only=True)
class QualitySpec:
    """One number of resolved bands, way to measure, and shear to reconstruct with."""

    bands: int
    way: str
    shear: str
    shots: int
    size: int
    sub_bands: int
    seed: int
    part: str = QUALITY


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeSpec:
    """One size, for which all shears are timed."""

    bands: int
    shots: int
    size: int
    seconds: float
    seed: int
    part: str = TIME


Spec = MapSpec | QualitySpec | TimeSpec


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """Maps of both regimes, reconstructions over s, and one timing."""
    size, shots, sub_bands = (64, 3, 4) if quick else (256, 4, 8)
    ways = [(CONTINUOUS, shear) for shear in ("edge", "centre", "exact")] + [(SAME, "edge")]
    return [
        MapSpec(mask_position=0.25, pitch_ratio=2, elements=12, shown=6, seed=6),
        MapSpec(mask_position=0.25, pitch_ratio=1, elements=24, shown=8, seed=6),
        *(
            QualitySpec(bands=bands, way=way, shear=shear, shots=shots, size=size, sub_bands=sub_bands, seed=0)
            for bands in ((4, 8) if quick else (6, 12, 24, 48))
            for way, shear in ways
        ),
        TimeSpec(bands=8 if quick else 24, shots=shots, size=size, seconds=0.5 if quick else 10.0, seed=0),
    ]


def run(spec: Spec, scene: SceneSource) -> Result:
    """A map, a reconstruction by both solvers, or times."""
    if isinstance(spec, MapSpec):
        return _map(spec)
    return _quality(spec, scene) if isinstance(spec, QualitySpec) else _time(spec)


def _imager(size: int, bands: int, shear: str, wavelengths: tuple[float, float]) -> SSCSI:
    """Camera that resolves this many bands: s = L/N."""
    return SSCSI(
        detector_shape=(size, size), detector_pitch=common.PITCH, code_pitch=common.PITCH, mask_position=bands / size,
        wavelengths=wavelengths, shear=shear,
    )  # fmt: skip


def _map(spec: MapSpec) -> Result:
    """Transmittance over wavelength and place: of the mask, and as coefficients of each shear."""
    imager = SSCSI(
        detector_shape=(1, spec.elements), detector_pitch=common.PITCH, code_pitch=common.PITCH / spec.pitch_ratio,
        mask_position=spec.mask_position, wavelengths=CHART_RANGE,
    )  # fmt: skip
    code = codes.random(shots=1, shape=imager.code_shape, seed=spec.seed)
    x = (np.arange(spec.shown * SAMPLES) + 0.5) / SAMPLES
    k = (np.arange(imager.resolution.bands * SAMPLES) + 0.5) / SAMPLES
    element, band = np.floor(x).astype(int), np.floor(k).astype(int)
    width = imager.pitch_ratio * (1 - imager.mask_position)
    super_resolving = imager.resolution.regime == SUPER_RESOLVING
    voxel = np.floor(x * width).astype(int) if super_resolving else element
    arrays = {"mask": code[0, 0, np.floor(x * width + k[:, None]).astype(int)]}
    for shear in SHEARS:
        seen = coefficients(replace(imager, shear=shear), code)
        arrays[shear] = seen[element[None], band[:, None], voxel[None]].astype(np.float32)
    lowest = code[0, 0, np.floor(x * width + band[:, None]).astype(int)]  # the mask as λ1 of each band sees it
    values = {
        "regime": imager.resolution.regime, "bands": imager.resolution.bands, "range": list(CHART_RANGE),
        "stretched_pitch": 1 / width,
        "edge_off_lowest": float(np.abs(_cell_means(lowest, element, band, voxel) - arrays["edge"]).max()),
        "exact_off_mask": float(np.abs(_cell_means(arrays["mask"], element, band, voxel) - arrays["exact"]).max()),
    }  # fmt: skip
    return Result(values=values, arrays=arrays)


def coefficients(imager: SSCSI, code: np.ndarray) -> np.ndarray:
    """(element, band, voxel column) transmittance by which a voxel of the first row reaches an element; NaN where none of it does.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.experiments.studies.fig_2_13 import coefficients
    >>> imager = sg.SSCSI(detector_shape=(1, 4), detector_pitch=10.0, code_pitch=10.0, mask_position=0.5, wavelengths=(450, 650))
    >>> code = sg.codes.random(shots=1, shape=imager.code_shape, seed=0)
    >>> bool((coefficients(imager, code)[2, :, 2] == imager.effective_code(code)[0, :, 0, 2]).all())
    True
    """
    bands, rows, columns = imager.resolution.cube_shape
    shape = (imager.detector_shape[1], bands, rows, columns)
    light, all_light = (
        as_matrix(imager.operator(t[:1])).reshape(imager.detector_shape[0], *shape)[0, :, :, 0]
        for t in (code, np.ones_like(code))
    )
    return np.divide(light, all_light, out=np.full_like(light, np.nan), where=all_light > 0)


def _cell_means(plane: np.ndarray, element: np.ndarray, band: np.ndarray, voxel: np.ndarray) -> np.ndarray:
    """Means of a map (λ, x) over the part of a voxel on an element, and over a band, in their place."""
    cell = np.cumsum(np.diff(element * (voxel.max() + 1) + voxel, prepend=0) != 0)
    place = (band[:, None] * (cell.max() + 1) + cell).ravel()
    sums, counts = (np.bincount(place, weights) for weights in (plane.ravel().astype(float), None))
    return (sums / counts)[place].reshape(plane.shape)


def _quality(spec: QualitySpec, scene: SceneSource) -> Result:
    imager = _imager(spec.size, spec.bands, spec.shear, scene.wavelengths)
    code = codes.boolean(shots=spec.shots, shape=imager.code_shape, seed=spec.seed)
    fine = common.fine_cube(scene, spec.bands * spec.sub_bands, imager.detector_shape)
    y, truth = common.measure_fine(imager, code, fine)
    H = imager.operator(code)
    if spec.way == SAME:
        y = H.forward(truth)
    wavelengths = imager.resolution.wavelengths
    exposure = common.exposure_of(truth, wavelengths)
    exact = replace(imager, shear="exact").effective_code(code[:1])
    values: dict[str, object] = {
        "mask_position": imager.mask_position,
        "code_error": float(np.sqrt(np.mean((imager.effective_code(code[:1]) - exact) ** 2))),
        "model_error": float(np.linalg.norm(H.forward(truth) - y) / np.linalg.norm(y)),
    }
    arrays = {"truth_picture": common.colours(truth, wavelengths, exposure)}
    for solver in SOLVERS:
        estimate = common.reconstruct(solver, H, y, truth)
        values[solver] = estimate.values
        arrays[f"{solver}_picture"] = common.colours(estimate.x, wavelengths, exposure)
    return Result(values=values, arrays=arrays)


def _time(spec: TimeSpec) -> Result:
    """Milliseconds of each shear's forward and adjoint on one thread, in turn; medians."""
    rng = np.random.default_rng(spec.seed)
    work = {}
    for shear in SHEARS:
        imager = _imager(spec.size, spec.bands, shear, CHART_RANGE)
        H = imager.operator(codes.boolean(shots=spec.shots, shape=imager.code_shape, seed=spec.seed))
        x = rng.random(H.in_shape, dtype=np.float32)
        y, out, back = H.forward(x), np.empty(H.out_shape, np.float32), np.empty(H.in_shape, np.float32)
        work[f"{shear} forward"] = lambda H=H, x=x, out=out: H.forward(x, out)
        work[f"{shear} adjoint"] = lambda H=H, y=y, back=back: H.adjoint(y, back)
    with threads(1):
        taken = alternate(work, spec.seconds)
    return Result(values={"milliseconds": {name: timing.median_ms for name, timing in taken.items()}})


def figure(records: Sequence[Record]) -> Figure:
    """Maps of both regimes, quality over s, and pictures."""
    from shadowgram.figures.sheet import sheet

    maps = [_maps(record) for record in common.chosen(records, part=MAP)]
    return sheet("Exact shear and first order (Fig. 2.13)", [*maps, _curves(records), _pictures(records)])


def _maps(record: Record) -> list[Heat]:
    """Mask, first order and exact coefficients over x and λ."""
    from shadowgram.figures.sheet import Heat

    bands, (low, high) = record.values["bands"], record.values["range"]
    shown = record.spec["shown"]
    edges = [np.linspace(low, high, bands + 1)[1:-1], np.arange(1, shown)]
    lines = [_grid(edges[1], low, high, vertical=True), _grid(edges[0], 0, shown, vertical=False)]
    relation = "≤" if record.values["regime"] == SUPER_RESOLVING else ">"
    titles = {"mask": f"mask, Δc/(1 − s) {relation} Δd", "edge": "first order (edge)", "exact": "exact shear"}
    return [
        Heat(
            title=title, values=record.arrays[name], extent=(0, shown, low, high), xlabel="x (detector elements)",
            ylabel="wavelength (nm)", unit="transmittance", low=0, high=1, colours="gray", lines=lines,
        )
        for name, title in titles.items()
    ]  # fmt: skip


def _grid(places: np.ndarray, begin: float, end: float, *, vertical: bool) -> np.ndarray:
    """Parallel lines as one polyline with gaps, (n, 2) of x and y."""
    along = np.tile([begin, end, np.nan], len(places))
    across = np.repeat(places, 3).astype(float)
    return np.stack([across, along] if vertical else [along, across], axis=1)


def _psnr(records: Sequence[Record], solver: str, way: str, shear: str) -> dict[float, float]:
    """s → PSNR."""
    of = common.chosen(common.chosen(records, part=QUALITY), way=way, shear=shear)
    return {r.values["mask_position"]: r.values[solver]["psnr"] for r in of}


def _curves(records: Sequence[Record]) -> list[Curves]:
    """PSNR over s for each solver, and how far coefficients and snapshots are off."""
    from shadowgram.figures.sheet import Curve, Curves

    drawn = [(CONTINUOUS, shear) for shear in ("edge", "centre", "exact")] + [(SAME, "edge")]
    panels = []
    for solver in SOLVERS:
        curves = {}
        for number, (way, shear) in enumerate(drawn):
            psnr = _psnr(records, solver, way, shear)
            name = shear if way == CONTINUOUS else "edge, measured with edge"
            curves[name] = Curve(x=list(psnr), y=list(psnr.values()), colour=number, dash=1 if way == SAME else 0)
        panels.append(
            Curves(
                title=f"finely resolved scene, {SOLVERS[solver]}", xlabel="mask position s", ylabel="PSNR (dB)", curves=curves
            )
        )  # fmt: skip
    off = {}
    for number, shear in enumerate(("edge", "centre", "exact")):
        of = common.chosen(common.chosen(records, part=QUALITY), way=CONTINUOUS, shear=shear)
        off[shear] = Curve(
            x=[r.values["mask_position"] for r in of], y=[100 * r.values["model_error"] for r in of], colour=number
        )
    error = Curves(
        title="model error of the snapshots", xlabel="mask position s", ylabel="‖Hf − g‖ ÷ ‖g‖ (%)", curves=off,
        log="y",
    )  # fmt: skip
    return [*panels, error]


def _pictures(records: Sequence[Record]) -> list[Picture]:
    """Reconstructions at the source's number of bands, or the nearest."""
    from shadowgram.figures.sheet import Picture

    quality = common.chosen(records, part=QUALITY)
    bands = min((r.spec["bands"] for r in quality), key=lambda bands: abs(bands - 24))
    of = common.chosen(quality, bands=bands, way=CONTINUOUS)
    times = common.only(records, part=TIME).values["milliseconds"]
    pictures = [Picture(title=f"scene, {bands} bands", picture=of[0].arrays["truth_picture"], caption="truth")]
    return pictures + [
        Picture(
            title=f"{r.spec['shear']}, {r.spec['shots']} shots", picture=r.arrays["eigen-tv_picture"],
            caption=f"EigenTV {r.values['eigen-tv']['psnr']:.1f} dB; H {times[r.spec['shear'] + ' forward']:.2g},"
            f" Hᵀ {times[r.spec['shear'] + ' adjoint']:.2g} ms",
        )
        for r in of
    ]  # fmt: skip


def claims(records: Sequence[Record]) -> list[Claim]:
    """What the models do within a band, what that costs, and what hides it."""
    return [_lower_edge(records), _first_order(records), _hidden(records)]


def _lower_edge(records: Sequence[Record]) -> Claim:
    maps = common.chosen(records, part=MAP)
    off = max(r.values["edge_off_lowest"] for r in maps)
    exact = max(r.values["exact_off_mask"] for r in maps)
    return Claim(
        page=26, says="in the models the band [λ1, λ2] is coded by the pattern that codes the scene at λ1",
        found=f"coefficients of the edge model are the means of the mask at λ1 over the elements, to {off:.0e}, and those of exact"
        f" shear the means over element and band, to {exact:.0e} ({SAMPLES} samples each), in both regimes",
        agrees=max(off, exact) < 1 / SAMPLES,
    )  # fmt: skip


def _first_order(records: Sequence[Record]) -> Claim:
    parts = []
    for solver in SOLVERS:
        edge, centre, exact = (_psnr(records, solver, CONTINUOUS, shear) for shear in ("edge", "centre", "exact"))
        rows = (f"s = {s:.3g}: {edge[s]:.1f} / {centre[s]:.1f} / {exact[s]:.1f}" for s in edge)
        parts.append(f"{SOLVERS[solver]} " + ", ".join(rows))
    quality = common.chosen(common.chosen(records, part=QUALITY), way=CONTINUOUS)
    errors = {shear: np.mean([r.values["code_error"] for r in quality if r.spec["shear"] == shear]) for shear in SHEARS}
    times = common.only(records, part=TIME).values["milliseconds"]
    clock = ", ".join(
        f"{s} {times[s + ' forward']:.3g} + {times[s + ' adjoint']:.3g}" for s in ("edge", "centre", "exact")
    )
    error = {r.spec["bands"]: r.values["model_error"] for r in quality if r.spec["shear"] == "edge"}
    falls = {bands: error[bands] / error[2 * bands] for bands in error if 2 * bands in error}
    return Claim(
        page=25, says="the discretization model must be considered a first order approximation",
        found="PSNR (dB) of a finely resolved scene with edge / centre / exact shear: " + "; ".join(parts)
        + f". Coefficients are off by {errors['edge']:.2f} (edge) and {errors['centre']:.2f} (centre) r.m.s. Medians of ms of"
        f" forward + adjoint on this machine: {clock}. Each doubling of the bands divides the edge model's error of the snapshots"
        f" by {', '.join(f'{fall:.2f}' for fall in falls.values())}: first order is 2",
        agrees=all(1.6 < fall < 2.5 for fall in falls.values()),
    )  # fmt: skip


def _hidden(records: Sequence[Record]) -> Claim:
    gaps = []
    for solver in SOLVERS:
        same, fine = (_psnr(records, solver, way, "edge") for way in (SAME, CONTINUOUS))
        gaps += [(same[s] - fine[s], solver, s) for s in same]
    worst, least = max(gaps), min(gaps)
    return Claim(
        page=None, says="how much does a simulation hide that measures and reconstructs with the same model, as section 2.4?",
        found="of the PSNR that the edge model reaches on its own measurements it loses"
        f" {least[0]:.1f} ({SOLVERS[least[1]]}, s = {least[2]:.3g}) to {worst[0]:.1f} dB ({SOLVERS[worst[1]]}, s = {worst[2]:.3g})"
        " on a finely resolved scene",
        agrees=None,
    )  # fmt: skip


STUDY = Study(
    name="fig-2-13",
    title="Exact shear and the models' first order",
    source="Fig. 2.13, pages 25 and 26",
    revision=2,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
