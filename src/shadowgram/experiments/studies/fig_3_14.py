"""Spectra of designed codes: Fig. 3.14, section 3.6.5.

The axially averaged power spectral density with R = 16 sub-regions, for N = 128, 10 shots, edge shear and the three s of the
source; mean over several codes. The source does not say its c1, so there are three: our default, 3.5 (L/Q)² and none where L < Q,
which makes 0, 5 and 20 here; 1, at the lower end of the source's range; and 20 for all s. Shares of the power are given below
1/8, from there to 1/4, and above; a flat spectrum has 0.26, 0.26 and 0.48 there. Colours are named as `codes.noise_colour` does,
with R = 16 and with 4: sub-regions of 32 elements do not resolve the lack of power below 1/32 by which clusters in order are told
from others.

What agrees: along y the codes are blue for all s and c1, along x the Boolean code is white; and with the default the designed
ones are blue at s = 0.046 and move to lower frequencies as s grows, to green in the end. What the source does not say: this is c1
at least as much as s. With c1 = 1 the codes of all three s are blue along x, and with c1 = 20 all are green (R = 4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram import codes
from shadowgram.codes._design import design
from shadowgram.experiments.source import CHART_RANGE, SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study
from shadowgram.spectral.sscsi import SSCSI

from . import _common as common

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Curves

POSITIONS, SHOTS = (0.046, 0.093, 0.1875), 10
BOOLEAN, OPTIMISED = "boolean", "optimised"
DEFAULT, SMALL, LARGE = None, 1.0, 20.0
GRID = (1.0, 2.0, 5.0, 10.0, 20.0, 40.0, 70.0)
BLOCKS = (16, 4)  # sub-regions: the source's, and larger ones
LOW, MIDDLE = 0.125, 0.25  # cycles/element
ROWS, COLUMNS = "rows", "columns"


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """Codes with seeds 0, 1, ... of one kind; c1 None is the default of the designer. A Boolean code has no mask position."""

    mask_position: float | None
    shots: int
    kind: str
    c1: float | None
    size: int
    seeds: int


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """A Boolean code, designs over c1, and those of Fig. 3.13 with half the shots."""
    seeds = 1 if quick else 5
    grid = (DEFAULT, SMALL, LARGE) if quick else (DEFAULT, *GRID)
    cameras = [(s, SHOTS, c1) for s in POSITIONS for c1 in grid] + [
        (POSITIONS[0], SHOTS // 2, c1) for c1 in (DEFAULT, SMALL)
    ]
    return [
        Spec(mask_position=None, shots=SHOTS, kind=BOOLEAN, c1=None, size=128, seeds=seeds),
        *(Spec(mask_position=s, shots=shots, kind=OPTIMISED, c1=c1, size=128, seeds=seeds) for s, shots, c1 in cameras),
    ]


def run(spec: Spec, _scene: SceneSource) -> Result:
    """Mean spectra along both axes, and what is in them."""
    made = [_code(spec, seed) for seed in range(spec.seeds)]
    elements = sum(code.size for code, _ in made)
    values: dict[str, object] = {"c1": made[0][1]}
    arrays = {}
    for blocks in BLOCKS:
        spectra = np.mean([codes.aapsd(code, blocks) for code, _ in made], axis=0)
        for name, spectrum in zip((ROWS, COLUMNS), spectra, strict=True):
            values[f"{name}_{blocks}"] = {
                "colour": codes.noise_colour(spectrum, elements=elements),
                "low": codes.band_power(spectrum, 0, LOW), "middle": codes.band_power(spectrum, LOW, MIDDLE),
                "high": codes.band_power(spectrum, MIDDLE, 0.5),
            }  # fmt: skip
            arrays[f"{name}_{blocks}"] = spectrum[1 : len(spectrum) // 2 + 1].astype(np.float32)
    return Result(values=values, arrays=arrays)


def _code(spec: Spec, seed: int) -> tuple[np.ndarray, float]:
    """A code and its c1, 0 for a Boolean one."""
    if spec.mask_position is None:
        return codes.boolean(shots=spec.shots, shape=(spec.size, spec.size), seed=seed), 0.0
    imager = SSCSI(
        detector_shape=(spec.size, spec.size), detector_pitch=common.PITCH, code_pitch=common.PITCH,
        mask_position=spec.mask_position, wavelengths=CHART_RANGE, shear="edge",
    )  # fmt: skip
    found = design(imager, shots=spec.shots, seed=seed, c1=spec.c1)
    return found.code, found.weights.c1


def _of(records: Sequence[Record], s: float, c1: float | None, shots: int = SHOTS) -> Record:
    return common.only(records, mask_position=s, shots=shots, kind=OPTIMISED, c1=c1)


def _boolean(records: Sequence[Record]) -> Record:
    return common.only(records, kind=BOOLEAN)


def _weight(c1: float | None) -> str:
    return "default c1" if c1 is None else f"c1 = {c1:g}"


def figure(records: Sequence[Record]) -> Figure:
    """Spectra along both axes for three c1, and the power at low frequencies over c1."""
    from shadowgram.figures.sheet import sheet

    return sheet(
        "Axially averaged power spectral density, R = 16 (Fig. 3.14)",
        [
            [_spectra(records, ROWS, c1) for c1 in (DEFAULT, LARGE, SMALL)],
            [_spectra(records, COLUMNS, DEFAULT), _spectra(records, COLUMNS, SMALL), _low_over_c1(records)],
        ],
    )


def _spectra(records: Sequence[Record], name: str, c1: float | None) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    at = f"{name}_{BLOCKS[0]}"
    flat = _boolean(records).arrays[at]
    frequency = np.arange(1, len(flat) + 1) / (2 * len(flat))
    curves = {f"Boolean: {_boolean(records).values[at]['colour']}": Curve(x=frequency, y=flat, reference=True)}
    for place, s in enumerate(POSITIONS):
        record = _of(records, s, c1)
        weight = f", c1 = {record.values['c1']:.3g}" if c1 is None else ""
        curves[f"s = {s:g}{weight}: {record.values[at]['colour']}"] = Curve(
            x=frequency, y=record.arrays[at], colour=place
        )
    along = "rows, along x" if name == ROWS else "columns, along y"
    return Curves(
        title=f"{along}: {_weight(c1)}", xlabel="frequency (cycles/element)", ylabel="|DFT|² / energy", curves=curves, bottom=0,
        top=1.5 * max(float(np.max(curve.y)) for curve in curves.values()),  # room for the legend
    )  # fmt: skip


def _low_over_c1(records: Sequence[Record]) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    curves = {"flat": Curve(x=[GRID[0], GRID[-1]], y=[_flat_low()] * 2, reference=True)}
    for dash, name in enumerate((ROWS, COLUMNS)):
        for place, s in enumerate(POSITIONS):
            found = _over_c1(records, s, name)
            hidden = name == COLUMNS and place > 0  # one name is enough
            label = "_" * hidden + (name if name == COLUMNS and not place else f"{name}, s = {s:g}")
            curves[label] = Curve(x=list(found), y=list(found.values()), colour=place, dash=dash)
    return Curves(
        title="Power below 1/8 over c1", xlabel="c1", ylabel="share of the power", curves=curves, log="x", bottom=0
    )


def _flat_low() -> float:
    """Share of a flat spectrum at frequencies up to LOW, of those that R = 16 resolves."""
    return codes.band_power(np.ones(32), 0, LOW)


def _over_c1(records: Sequence[Record], s: float, name: str) -> dict[float, float]:
    there = common.chosen(records, mask_position=s, shots=SHOTS, kind=OPTIMISED)
    there = [r for r in there if r.values["c1"] > 0]  # the axis is logarithmic
    ordered = sorted(there, key=lambda r: r.values["c1"])
    return {r.values["c1"]: r.values[f"{name}_{BLOCKS[0]}"]["low"] for r in ordered}


def claims(records: Sequence[Record]) -> list[Claim]:
    """Boolean flat, columns blue, rows blue and then at lower frequencies; what is s, and what is c1."""
    return [
        _high_first(records),
        _lower(records),
        _columns(records),
        _flat(records),
        _green(records),
        _question(records),
    ]


def _shares(record: Record, name: str) -> str:
    """Shares of the three bands, in a sentence."""
    found = record.values[f"{name}_{BLOCKS[0]}"]
    return f"{found['low']:.2f}/{found['middle']:.2f}/{found['high']:.2f}"


def _listed(records: Sequence[Record], name: str, c1: float | None) -> str:
    return ", ".join(_shares(_of(records, s, c1), name) for s in POSITIONS)


def _colours(records: Sequence[Record], name: str, c1: float | None, blocks: int) -> list[str]:
    return [_of(records, s, c1).values[f"{name}_{blocks}"]["colour"] for s in POSITIONS]


def _high_first(records: Sequence[Record]) -> Claim:
    first = _of(records, POSITIONS[0], DEFAULT)
    half = {c1: _of(records, POSITIONS[0], c1, SHOTS // 2) for c1 in (DEFAULT, SMALL)}
    found = first.values[f"{ROWS}_{BLOCKS[0]}"]
    return Claim(
        page=62, says="over the rows, when s = 0.046, all the spectral content is at high frequencies",
        found=f"{found['colour']}; power below 1/8, to 1/4, and above: {_shares(first, ROWS)} (default, c1 ="
        f" {first.values['c1']:.3g}), Boolean {_shares(_boolean(records), ROWS)}. With 5 shots, as in Fig. 3.13,"
        f" {_shares(half[SMALL], ROWS)} (c1 = 1) and {_shares(half[DEFAULT], ROWS)} (default, c1 ="
        f" {half[DEFAULT].values['c1']:.3g}, {half[DEFAULT].values[f'{ROWS}_{BLOCKS[0]}']['colour']})",
        agrees=found["colour"] == "blue",
        why="more of it than in a flat spectrum, not all, and only with c1 below about 5",
    )  # fmt: skip


def _lower(records: Sequence[Record]) -> Claim:
    low = [
        sum(_of(records, s, DEFAULT).values[f"{ROWS}_{BLOCKS[0]}"][band] for band in ("low", "middle"))
        for s in POSITIONS
    ]
    return Claim(
        page=62, says="over the rows, as s increases, the content moves to low and middle frequencies",
        found=f"power below 1/8, to 1/4, and above, for the three s: {_listed(records, ROWS, DEFAULT)} (default),"
        f" {_listed(records, ROWS, LARGE)} (c1 = 20), {_listed(records, ROWS, SMALL)} (c1 = 1)",
        agrees=low == sorted(low),
        why="with c1 = 1 it stays at high frequencies",
    )  # fmt: skip


def _columns(records: Sequence[Record]) -> Claim:
    named = {c1: _colours(records, COLUMNS, c1, BLOCKS[0]) for c1 in (DEFAULT, LARGE, SMALL)}
    return Claim(
        page=62, says="over the columns the codes show less power at low frequencies, blue noise for all s",
        found="; ".join(f"{_weight(c1)}: {', '.join(colours)}" for c1, colours in named.items())
        + f"; power below 1/8, to 1/4, and above: {_listed(records, COLUMNS, DEFAULT)} (default), Boolean"
        f" {_shares(_boolean(records), COLUMNS)}",
        agrees=all(colour == "blue" for colours in named.values() for colour in colours),
    )  # fmt: skip


def _flat(records: Sequence[Record]) -> Claim:
    boolean = _boolean(records)
    colours = [boolean.values[f"{name}_{blocks}"]["colour"] for name in (ROWS, COLUMNS) for blocks in BLOCKS]
    return Claim(
        page=62, says="the content of a Boolean code is spread evenly over the spectrum",
        found=f"{' and '.join(dict.fromkeys(colours))}; power below 1/8, to 1/4, and above: {_shares(boolean, ROWS)} over the rows,"
        f" {_shares(boolean, COLUMNS)} over the columns",
        agrees=set(colours) == {"white"},
    )  # fmt: skip


def _green(records: Sequence[Record]) -> Claim:
    named = {blocks: _colours(records, ROWS, DEFAULT, blocks) for blocks in BLOCKS}
    return Claim(
        page=62, says="over the rows it is blue noise when s is close to zero, and green noise as s increases",
        found="; ".join(f"R = {blocks}: {', '.join(colours)}" for blocks, colours in named.items())
        + " (default c1, the three s)",
        agrees=named[4][0] == "blue" and named[4][-1] == "green",
        why="R = 16 cannot tell green from red where clusters keep further apart than its sub-regions resolve, at s = 0.1875",
    )  # fmt: skip


def _question(records: Sequence[Record]) -> Claim:
    named = "; ".join(
        f"{_weight(c1)}: "
        + ", ".join("/".join(pair) for pair in zip(*(_colours(records, ROWS, c1, n) for n in BLOCKS), strict=True))
        for c1 in (SMALL, LARGE, DEFAULT)
    )
    power = "; ".join(
        f"s = {s:g}: " + ", ".join(f"{c1:.3g}: {low:.2f}" for c1, low in _over_c1(records, s, ROWS).items())
        for s in POSITIONS
    )
    return Claim(
        page=None, says="is it s that moves the power over the rows to lower frequencies, or c1?",
        found=f"colours with R = 16/R = 4 for the three s: {named}. Share of the power below 1/8 over c1, flat"
        f" {_flat_low():.2f}: {power}",
        agrees=None,
    )  # fmt: skip


STUDY = Study(
    name="fig-3-14",
    title="Spectra of designed codes",
    source="Fig. 3.14, pages 61 to 64",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
