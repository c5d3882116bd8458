"""Resolution limits and models against measurements of the continuous model: Tables 2.1, 2.2 and 2.3, section 2.3.5.

The tables give formulas. Here every geometry is measured on the continuous model of eq. (2.2), without being told a limit:

- space: how finely, and in how many places, any number of shots of one wavelength tells the scene apart;
- spectrum: the change of wavelength after which every element sees the code a whole column further, and over how long an open
  column comes onto an element and stays whole on it;
- models: the operator against eqs. (2.19) and (2.23) as printed, a loop for every sum.

What agrees: all formulas. What the source does not say: with many shots more places along x can be told apart than the recoverable
datacube has columns, since an edge of the code within an element, or of an element within a code column, parts them unevenly; the
tables' limit is the widest part. And Δc/(sα) is no upper bound of Table 2.2 where Δd > 2Δc, as page 19 says itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from shadowgram import codes
from shadowgram.experiments.source import CHART_RANGE, SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study
from shadowgram.operators import as_matrix
from shadowgram.spectral.resolution import DETECTOR_LIMITED, SUPER_RESOLVING
from shadowgram.spectral.sscsi import SSCSI

from . import _common as common
from . import _probes as probes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Curve, Curves

PROBE, SIZE = "probe", "size"
SMALL = (2, 5)  # detector on which the matrices are compared


@dataclass(frozen=True, slots=True, kw_only=True)
class ProbeSpec:
    """One geometry to measure; Δd/Δc = `pitch_ratio`, a row of `elements`."""

    mask_position: float
    pitch_ratio: int
    dispersion_ratio: float
    elements: int
    seed: int
    part: str = PROBE


@dataclass(frozen=True, slots=True, kw_only=True)
class SizeSpec:
    """One geometry of the source's simulations, of which the size of the datacube is wanted."""

    mask_position: float
    pitch_ratio: int
    dispersion_ratio: float
    elements: int
    part: str = SIZE


def specs(_scene: SceneSource, quick: bool) -> list[ProbeSpec | SizeSpec]:
    """Positions and pitches in both regimes, and the sizes that the source simulates."""
    elements = 16 if quick else 32
    # Odd shares of the elements: edges of code and elements then meet at the ends only, as they do in general.
    positions = [n / elements for n in ((3, 5, 9, 13) if quick else range(3, 28, 2))]
    points = [(s, ratio, 1.0) for ratio in (1, 2, 4) for s in positions]
    points += [(0.25, 1, 3.0), (0.25, 2, 1.5)]
    sizes = [(24 / 256, 1, 1.0, 256), (0.09, 2, 1.0, 128), (0.1, 2, 1.0, 128), (0.09, 2, 3.0, 128)]
    return [
        *(
            ProbeSpec(mask_position=s, pitch_ratio=ratio, dispersion_ratio=beta, elements=elements, seed=0)
            for s, ratio, beta in points
        ),
        *(
            SizeSpec(mask_position=s, pitch_ratio=ratio, dispersion_ratio=beta, elements=n)
            for s, ratio, beta, n in sizes
        ),
    ]


def run(spec: ProbeSpec | SizeSpec, _scene: SceneSource) -> Result:
    """What the imager says, and what is measured."""
    rows = spec.elements if isinstance(spec, SizeSpec) else 1
    imager = SSCSI(
        detector_shape=(rows, spec.elements), detector_pitch=common.PITCH, code_pitch=common.PITCH / spec.pitch_ratio,
        mask_position=spec.mask_position, wavelengths=CHART_RANGE, dispersion_ratio=spec.dispersion_ratio, shear="edge",
    )  # fmt: skip
    said = imager.resolution
    values: dict[str, object] = {
        "regime": said.regime, "cube_shape": list(said.cube_shape), "band_width": said.band_width,
        "extents": list(said.spectral_extents), "x_pitch": said.x_pitch / common.PITCH,
        "y_pitch": said.y_pitch / common.PITCH, "dispersed_columns": imager.spectral_columns,
    }  # fmt: skip
    if isinstance(spec, ProbeSpec):
        values["measured"] = _measured(imager, spec.seed)
    return Result(values=values)


def _measured(imager: SSCSI, seed: int) -> dict[str, object]:
    """Numbers of the probes; lengths in detector elements, wavelengths in nm, None where the spectrum is too short."""
    parts = probes.pieces(imager)
    discrete, columns, rows = probes.independent_columns(imager, seed)
    change, extents = probes.whole_column(imager, seed), probes.extents(imager)
    small = replace(imager, detector_shape=SMALL)
    code = codes.random(shots=2, shape=small.code_shape, seed=seed)
    difference = np.abs(as_matrix(small.operator(code)) - probes.matrix_by_loops(small, code)).max()
    return {
        "widest": float(parts.max()), "pieces": int(np.count_nonzero(parts > probes.SEEN)),
        "columns_discrete": discrete, "columns": columns, "rows_per_element": rows,
        "whole_column": change and change[0], "whole_column_off": change and change[1], "extents": extents and list(extents),
        "matrix_difference": float(difference),
    }  # fmt: skip


def figure(records: Sequence[Record]) -> Figure:
    """Formulas as broad lines, measurements as marked ones."""
    from shadowgram.figures.sheet import sheet

    return sheet(
        "Resolution limits and what is measured of them (Tables 2.1, 2.2)",
        [_spatial_panels(records), [_spectral_panel(records, ratio) for ratio in _ratios(records)]],
    )


def _plain(records: Sequence[Record]) -> list[Record]:
    """Measured geometries with β = 1, of which curves over s are made."""
    return common.chosen(common.chosen(records, part=PROBE), dispersion_ratio=1.0)


def _ratios(records: Sequence[Record]) -> list[int]:
    return sorted({r.spec["pitch_ratio"] for r in _plain(records)})


def _spatial_panels(records: Sequence[Record]) -> list[Curves]:
    """Widest part, distinguishable columns and bands over s, a colour a ratio of the pitches."""
    from shadowgram.figures.sheet import Curves

    elements, ratios = _plain(records)[0].spec["elements"], _ratios(records)
    return [
        Curves(
            title="resolution along x", xlabel="mask position s", ylabel="widest indistinct part ÷ Δd", bottom=0,
            curves=_against(
                records, lambda r: r.values["x_pitch"], {"": lambda r: r.values["measured"]["widest"]}
            ),
        ),
        Curves(
            title=f"places told apart along x, {elements} elements", xlabel="mask position s", ylabel="columns", bottom=0,
            top=1.5 * elements * ratios[-1],
            curves=_against(
                records, lambda r: r.values["cube_shape"][2],
                {
                    "": lambda r: r.values["measured"]["columns_discrete"],
                    ", continuous": lambda r: r.values["measured"]["columns"],
                },
            ),
        ),
        Curves(
            title="bands", xlabel="mask position s", ylabel="bands", bottom=0,
            curves=_against(
                records, lambda r: r.values["cube_shape"][0], {"": _range_in_columns}
            ),
        ),
    ]  # fmt: skip


def _range_in_columns(record: Record) -> float:
    """Length of the spectrum in measured changes by a whole column."""
    return (CHART_RANGE[1] - CHART_RANGE[0]) / record.values["measured"]["whole_column"]


def _against(
    records: Sequence[Record], formula: Callable[[Record], float], found: dict[str, Callable[[Record], float]]
) -> dict[str, Curve]:
    """A formula and what was found, over s, for every ratio of the pitches."""
    from shadowgram.figures.sheet import Curve

    curves: dict[str, Curve] = {}
    for number, ratio in enumerate(_ratios(records)):
        of = common.chosen(_plain(records), pitch_ratio=ratio)
        positions = [r.spec["mask_position"] for r in of]
        curves["formula" if number == 0 else f"_formula {ratio}"] = Curve(
            x=positions, y=[formula(r) for r in of], reference=True
        )
        for dash, (name, value) in enumerate(found.items()):
            label = f"Δd/Δc = {ratio}{name}"
            curves[label if not name or number == 0 else f"_{label}"] = Curve(
                x=positions, y=[value(r) for r in of], colour=number, dash=2 * dash
            )
    return curves


def _spectral_panel(records: Sequence[Record], ratio: int) -> Curves:
    """Extents of Table 2.2 and the whole-column change over s, in units of the bound Δc/(sα)."""
    from shadowgram.figures.sheet import Curve, Curves

    of = common.chosen(_plain(records), pitch_ratio=ratio)
    positions = [r.spec["mask_position"] for r in of]
    formulas = [(1.0, *(extent / r.values["band_width"] for extent in r.values["extents"])) for r in of]
    hidden = "_" if ratio < _ratios(records)[-1] else ""  # one legend does for all
    curves, names = {}, ("a whole column further", "column partly on an element", "column wholly on it")
    for number, values in enumerate(zip(*formulas, strict=True)):
        curves[f"_formula {number}" if number or hidden else "formulas"] = Curve(x=positions, y=values, reference=True)
    for number, name in enumerate(names):
        pairs = [(r.spec["mask_position"], _spectral(r)[number], r.values["band_width"]) for r in of]
        seen = {s: value / width for s, value, width in pairs if value is not None}
        curves[hidden + name] = Curve(x=list(seen), y=list(seen.values()), colour=number)
    border = 1 - 1 / ratio
    return Curves(
        title=f"spectral extents, Δd/Δc = {ratio}", xlabel="mask position s", ylabel="wavelength ÷ Δc/(sα)",
        curves=curves, marks={border: ""} if border > 0 else {}, bottom=0,
    )  # fmt: skip


def _spectral(record: Record) -> tuple[float | None, float | None, float | None]:
    """Measured whole-column change, partly and wholly, nm."""
    measured = record.values["measured"]
    partly, wholly = measured["extents"] or (None, None)
    return measured["whole_column"], partly, wholly


def claims(records: Sequence[Record]) -> list[Claim]:
    """Each formula against its measurement."""
    measured = common.chosen(records, part=PROBE)
    return [
        _spatial(measured), _told_apart(measured), _extents(measured), _bound(measured), _adjacent(measured), _bands(measured),
        _sizes(common.chosen(records, part=SIZE)), _models(measured),
    ]  # fmt: skip


def _spatial(measured: Sequence[Record]) -> Claim:
    off = max(abs(r.values["measured"]["widest"] / r.values["x_pitch"] - 1) for r in measured)
    rows = all(r.values["measured"]["rows_per_element"] == r.spec["pitch_ratio"] for r in measured)
    return Claim(
        page=24, says="Table 2.1: the spatial resolution is Δc/(1−s) × Δc, or Δd × Δc where Δc/(1−s) > Δd",
        found=f"the widest part within which no shots tell anything apart is that wide along x in {len(measured)} geometries,"
        f" {_within(off)}; along y an element has {'Δd/Δc' if rows else 'another number of'} rows",
        agrees=off < 1e-6 and rows,
    )  # fmt: skip


def _told_apart(measured: Sequence[Record]) -> Claim:
    discrete = all(r.values["measured"]["columns_discrete"] == r.values["cube_shape"][2] for r in _centred(measured))
    more = {r: r.values["measured"]["columns"] / r.values["cube_shape"][2] for r in _centred(measured)}
    worst = max(more, key=lambda r: more[r])
    minimum = max(more.values()) <= 1
    return Claim(
        page=13, says="the minimum attainable spatial resolution is Δc/(1−s) along x (p. 17: Δd where Δc/(1−s) > Δd)",
        found=f"{probes.SHOTS} shots of one wavelength: the discrete model tells {'all' if discrete else 'not all'} columns of its"
        f" datacube apart; the continuous one up to {more[worst]:.2f} times as many ({worst.values['measured']['columns']} for"
        f" {worst.values['cube_shape'][2]} at s = {worst.spec['mask_position']:g}, Δd/Δc = {worst.spec['pitch_ratio']})",
        agrees=minimum and discrete,
        why="" if minimum else "the limit is that of the widest parts; where edges of code and elements cut each other, narrower"
        " parts can be told apart too, but unevenly",
    )  # fmt: skip


def _centred(measured: Sequence[Record]) -> list[Record]:
    """Geometries whose datacube begins with a whole column, as that of their central wavelength does."""
    return common.chosen(measured, dispersion_ratio=1.0)


def _extents(measured: Sequence[Record]) -> Claim:
    off = [
        np.abs(np.subtract(r.values["measured"]["extents"], r.values["extents"])).max() / r.values["band_width"]
        for r in measured if r.values["measured"]["extents"]
    ]  # fmt: skip
    return Claim(
        page=24, says="Table 2.2: Δc/(sα) and (Δd(1−s) − Δc)/(sα), or Δd(1−s)/(sα) and (Δc − Δd(1−s))/(sα)",
        found=f"an open column comes onto an element, and stays whole on it, for these wavelengths in {len(off)} geometries,"
        f" {_within(max(off))} of Δc/(sα) ({probes.SAMPLES} fine bands each)",
        agrees=bool(max(off) < 2 / probes.SAMPLES),
    )  # fmt: skip


def _bound(measured: Sequence[Record]) -> Claim:
    beyond = [
        r for r in measured
        if r.values["measured"]["extents"] and max(r.values["measured"]["extents"]) > 1.05 * r.values["band_width"]
    ]  # fmt: skip
    expected = [
        r for r in beyond if r.spec["pitch_ratio"] > 2 and r.spec["mask_position"] < 1 - 2 / r.spec["pitch_ratio"]
    ]
    found = "in no geometry is a measured extent larger"
    if beyond:
        worst = max(beyond, key=lambda r: max(r.values["measured"]["extents"]) / r.values["band_width"])
        found = (
            f"a measured extent is larger in {len(beyond)} of {len(measured)} geometries, by up to"
            f" {max(worst.values['measured']['extents']) / worst.values['band_width']:.2f} times (s ="
            f" {worst.spec['mask_position']:g}, Δd/Δc = {worst.spec['pitch_ratio']})"
        )
    only = len(expected) == len(beyond)
    return Claim(
        page=24, says="Δλ = Δc/(sα) is an upper bound that encompasses all the cases of Table 2.2",
        found=found, agrees=not beyond,
        why="" if not beyond else f"{'only' if only else 'not only'} where Δd/Δc = C > 2 and s < 1 − 2/C, as page 19 says: a column"
        " then stays on an element for longer than it takes to come onto it; Δc/(sα) is still what tells two wavelengths apart",
    )  # fmt: skip


def _adjacent(measured: Sequence[Record]) -> Claim:
    seen = [r for r in measured if r.values["measured"]["whole_column"]]
    off = max(abs(r.values["measured"]["whole_column"] / r.values["band_width"] - 1) for r in seen)
    rest = max(r.values["measured"]["whole_column_off"] for r in seen)
    return Claim(
        page=21, says="bands Δc/(sα) apart are coded by the same code shifted by one column",
        found=f"the smallest change of wavelength that shows every element the code a column further is Δc/(sα) {_within(off)} in"
        f" {len(seen)} geometries; what it shows then differs from the shifted code by {probes.tiny(rest)}",
        agrees=off < 1 / probes.SAMPLES and rest < 1e-6,
    )  # fmt: skip


def _bands(measured: Sequence[Record]) -> Claim:
    seen = [r for r in measured if r.values["measured"]["whole_column"]]
    right = [int(np.ceil(_range_in_columns(r) - 1e-6)) == r.values["cube_shape"][0] for r in seen]
    return Claim(
        page=21, says="L = ⌈sα(λmax − λmin)/Δc⌉ bands can be resolved (eqs. 2.17, 2.18)",
        found=f"the wavelengths hold that many measured changes by a whole column in {sum(right)} of {len(right)} geometries",
        agrees=all(right),
    )  # fmt: skip


def _sizes(sizes: Sequence[Record]) -> Claim:
    listed = ", ".join(
        f"{'×'.join(map(str, reversed(r.values['cube_shape'])))} for Nd = {r.spec['elements']}, Δd/Δc = {r.spec['pitch_ratio']},"
        f" s = {r.spec['mask_position']:g}, β = {r.spec['dispersion_ratio']:g}"
        for r in sizes
    )
    wanted = {(1, 24 / 256): [24, 256, 256], (2, 0.09): [24, 256, 233]}
    plain = {(r.spec["pitch_ratio"], r.spec["mask_position"]): r.values["cube_shape"] for r in _centred(sizes)}
    return Claim(
        page=29, says="with s ≈ 0.1 datacubes of 256×256×24 and, super-resolved, 233×256×24 are recovered (eqs. 2.24, 2.20)",
        found=f"x × y × bands: {listed}",
        agrees=all(plain[key] == shape for key, shape in wanted.items()),
        why="s ≈ 0.1 must be 0.0899 to 0.0937: at 0.1 there are 26 bands. With the spectral plane's end inside a column (β = 3) the"
        " detector sees one column more than eq. (2.20) counts",
    )  # fmt: skip


def _models(measured: Sequence[Record]) -> Claim:
    off: dict[str, float] = {}
    for record in measured:
        regime = record.values["regime"]
        off[regime] = max(off.get(regime, 0.0), record.values["measured"]["matrix_difference"])
    return Claim(
        page=24, says="Table 2.3: the measurements follow eq. (2.19), or eq. (2.23) where Δc/(1−s) > Δd",
        found=f"the operator and loops over the printed equations differ by {probes.tiny(off[SUPER_RESOLVING])} (2.19) and"
        f" {probes.tiny(off[DETECTOR_LIMITED])} (2.23) at most, in {len(measured)} geometries",
        agrees=max(off.values()) < 1e-12,
    )  # fmt: skip


def _within(share: float) -> str:
    """How near two numbers are, in a sentence."""
    return "exactly" if share < 1e-6 else f"to {100 * share:.2g} %"


STUDY = Study(
    name="tables-2-1",
    title="Resolution limits and models against measurements",
    source="Tables 2.1, 2.2 and 2.3, page 24",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
