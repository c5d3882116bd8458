"""Which code is best for EigenTV where a continuous scene is measured: a question of ours.

The source designs codes for its edge model and reconstructs what that model measured. A camera measures a continuous scene: here
one with eight fine bands a band, each where the optics put it, without noise and at 30 dB, reconstructed by EigenTV with the exact
shear. The codes are Boolean; designed with the source's cost for either shear; with our coupling; halftones, blue and green noise;
and "runs": rows of runs of equal elements as long as bands and shots ask for, without any design.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram import codes
from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study
from shadowgram.spectral.sscsi import SSCSI

from . import _codes
from . import _common as common
from ._codes import Gain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS = {
    "boolean": "Boolean",
    "edge": "source's cost, edge shear",
    "exact": "source's cost, exact shear",
    "coupled": "coupled, exact shear",
    "blue": "blue noise",
    "green": "green noise",
    "runs": "runs, no design",
}
NOISES = {"none": "noise-free", "30 dB": "30 dB"}
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
    """L/Q from 1 to 8, some of them with two numbers of bands."""
    places = (
        ((3, 3), (4, 2))
        if quick
        else ((6, 6), (6, 4), (12, 8), (6, 3), (12, 6), (6, 2), (12, 3), (24, 6), (24, 3))
    )  # fmt: skip
    return [
        Spec(bands=bands, shots=q, kind=kind, size=32 if quick else 128, seed=seed)
        for bands, q in places
        for kind in KINDS
        for seed in range(2 if quick else 5)
    ]


def run_length(bands: int, shots: int) -> int:
    """Length of the runs: (L/Q)^0.85, rounded, which was found by trying lengths from 1 to 5.

    Examples
    --------
    >>> from shadowgram.experiments.studies.codes_better import run_length
    >>> run_length(6, 6), run_length(24, 6), run_length(24, 3)
    (1, 3, 6)
    """
    return max(1, round((bands / shots) ** 0.85))


def runs_code(shots: int, shape: tuple[int, int], length: int, seed: int) -> np.ndarray:
    """Complementary code (shot, y, x) whose rows are runs of `length` elements; every Q runs hold all shots in random order.

    Examples
    --------
    >>> from shadowgram.experiments.studies.codes_better import runs_code
    >>> runs_code(2, (1, 8), 2, seed=1).tolist()
    [[[0, 1, 1, 0, 0, 0, 0, 1]], [[1, 0, 0, 1, 1, 1, 1, 0]]]
    """
    rng = np.random.default_rng(seed)
    ny, nx = shape
    periods = -(-nx // (length * shots)) + 1
    order = rng.permuted(np.tile(np.arange(shots), (ny * periods, 1)), axis=1).reshape(ny, -1)
    whole = np.repeat(order, length, axis=1)
    start = rng.integers(length * shots, size=ny)[:, None] + np.arange(nx)
    opened = np.take_along_axis(whole, start, axis=1)
    return (opened == np.arange(shots)[:, None, None]).astype(np.uint8)


def _code(spec: Spec, imager: SSCSI) -> np.ndarray:
    """Code of a specification for the imager with exact shear."""
    shots, shape, seed = spec.shots, imager.code_shape, spec.seed
    length = run_length(spec.bands, shots)
    if spec.kind == "exact":
        return codes.optimised(imager, shots=shots, seed=seed)
    if spec.kind == "edge":
        edge = _codes.imager_of(spec.bands, spec.size, imager.wavelengths)
        return codes.optimised(edge, shots=shots, seed=seed)
    if spec.kind == "blue":
        return codes.blue_noise(shots=shots, shape=shape, seed=seed)
    if spec.kind == "green":  # clusters as wide as the runs are long
        return codes.green_noise(shots=shots, shape=shape, seed=seed, cluster=max(2, length**2))
    if spec.kind == "runs":
        return runs_code(shots, shape, length, seed)
    return _codes.code_of(spec.kind, imager, shots, seed)


def run(spec: Spec, scene: SceneSource) -> Result:
    """Measure a finely resolved scene and reconstruct with EigenTV, without noise and with."""
    imager = _codes.imager_of(spec.bands, spec.size, scene.wavelengths, shear="exact")
    code = _code(spec, imager)
    fine = common.fine_cube(scene, spec.bands * SUB_BANDS, (spec.size, spec.size))
    clean, truth = common.measure_fine(imager, code, fine)
    H = common.stored_operator(imager, code)
    values = {
        noise: _codes.reconstruct("eigen-tv", H, _codes.disturbed(clean, noise, 0.0, spec.seed), truth, noise)[1]
        for noise in NOISES
    }
    label = code.argmax(axis=0)
    changes = float((np.diff(label, axis=1) != 0).mean())
    values = {**values, "run": round(1 / changes, 3)}
    return Result(values=values, arrays={"code": label[:24, :48].astype(np.uint8)} if spec.seed == 0 else {})


def _places(records: Sequence[Record]) -> list[tuple[int, int]]:
    """(bands, shots) by their ratio."""
    return sorted(
        {(r.spec["bands"], r.spec["shots"]) for r in records}, key=lambda place: (place[0] / place[1], place[0])
    )


def _name(place: tuple[int, int]) -> str:
    return f"L = {place[0]}, Q = {place[1]}"


def _found(records: Sequence[Record], place: tuple[int, int], kind: str, noise: str) -> list[float]:
    own = common.chosen(records, bands=place[0], shots=place[1], kind=kind)
    return [r.values[noise]["psnr"] for r in own]


def _gains(records: Sequence[Record], ours: str, theirs: str, noise: str) -> dict[tuple[int, int], Gain]:
    """Place → gain in PSNR."""
    return {
        place: _codes.gain(_found(records, place, ours, noise), _found(records, place, theirs, noise))
        for place in _places(records)
    }


def figure(records: Sequence[Record]) -> Figure:
    """Gain over the Boolean code by L/Q, and parts of the codes."""
    from shadowgram.figures.sheet import Curve, Curves, Picture, sheet

    gains = []
    for noise, text in NOISES.items():
        curves = {}
        for number, (kind, name) in enumerate(KINDS.items()):
            found = _by_ratio(_gains(records, kind, "boolean", noise))
            named = number % 2 == (noise != "none")  # half of the names in either panel, where there is room
            curves[name if named else f"_{name}"] = Curve(
                x=list(found), y=[one.mean for one in found.values()], colour=number, dash=number // 6,
                spread=[one.error for one in found.values()],
            )  # fmt: skip
        low = min(y for curve in curves.values() for y in curve.y)
        high = max(y for curve in curves.values() for y in curve.y)
        gains.append(
            Curves(
                title=f"EigenTV, {text}", xlabel="bands per shot L/Q", ylabel="gain over Boolean (dB)", curves=curves,
                bottom=low - 0.6 * (high - low),
            )
        )  # fmt: skip
    place = max(_places(records), key=lambda one: (min(one[0] / one[1], 4), one[0]))
    shown = {kind: common.only(records, bands=place[0], shots=place[1], kind=kind, seed=0) for kind in KINDS}
    pictures = [
        Picture(
            title=KINDS[kind].replace(", ", ",\n"), picture=r.arrays["code"] / max(1, place[1] - 1),
            caption=f"runs of {r.values['run']:.1f}",
        )
        for kind, r in shown.items()
    ]  # fmt: skip
    title = (
        "Codes for a finely resolved scene (bands: standard error over seeds); below: which shot opens an element,"
        f" {_name(place)}"
    )
    return sheet(title, [gains, pictures[:4], [*pictures[4:], None]])


def _by_ratio(gains: dict[tuple[int, int], Gain]) -> dict[float, Gain]:
    """L/Q → gain, the mean where two settings have that ratio."""
    ratios = sorted({bands / shots for bands, shots in gains})
    together = {ratio: [one for (bands, shots), one in gains.items() if bands / shots == ratio] for ratio in ratios}
    return {
        ratio: Gain(
            mean=float(np.mean([one.mean for one in several])),
            error=math.hypot(*(one.error for one in several)) / len(several),
        )
        for ratio, several in together.items()
    }


def claims(records: Sequence[Record]) -> list[Claim]:
    """What the coupling, the exact shear, and codes without a design are worth."""
    return [
        *(_coupling(records, noise) for noise in NOISES),
        _question(records, "exact", "edge", "what does the exact shear in the source's cost give?"),
        _question(records, "coupled", "exact", "what does the coupling give, the exact shear being the same?"),
        _question(records, "runs", "edge", "how near do runs, without any design, come to the source's optimised codes?"),
        _question(records, "blue", "boolean", "is blue noise better than a Boolean code?"),
        _question(records, "green", "boolean", "is green noise better than a Boolean code?"),
        _table(records),
    ]  # fmt: skip


def _coupling(records: Sequence[Record], noise: str) -> Claim:
    gains = _gains(records, "coupled", "edge", noise)
    return Claim(
        page=None,
        says=f"does the coupled cost of the exact shear improve on the source's optimised codes? (EigenTV, {NOISES[noise]})",
        found="gain in dB ± standard error over seeds, by L/Q: "
        + "; ".join(f"{ratio:.3g}: {one}" for ratio, one in _by_ratio(gains).items())
        + ". "
        + _codes.tell("by setting", {_name(place): one for place, one in gains.items()}),
        agrees=None,
    )


def _question(records: Sequence[Record], ours: str, theirs: str, says: str) -> Claim:
    found = []
    for noise, text in NOISES.items():
        gains = _gains(records, ours, theirs, noise)
        by_ratio = "; ".join(f"{ratio:.3g}: {one}" for ratio, one in _by_ratio(gains).items())
        told = _codes.tell(text, {_name(place): one for place, one in gains.items()})
        found.append(f"{told}. By L/Q: {by_ratio}")
    return Claim(page=None, says=says, found=". ".join(found), agrees=None)


def _table(records: Sequence[Record]) -> Claim:
    rows, best = [], []
    for noise, text in NOISES.items():
        for place in _places(records):
            means = {kind: float(np.mean(_found(records, place, kind, noise))) for kind in KINDS}
            rows.append(f"{text}, {_name(place)}: {' / '.join(f'{mean:.1f}' for mean in means.values())}")
            best.append(max(means, key=lambda kind: means[kind]))
    wins = {KINDS[kind]: best.count(kind) for kind in KINDS if kind in best}
    return Claim(
        page=None,
        says="which code is best for EigenTV?",
        found="best at "
        + ", ".join(f"{count}: {name}" for name, count in wins.items())
        + f", of {len(best)} settings. PSNR in dB, {' / '.join(KINDS)}: "
        + "; ".join(rows),
        agrees=None,
    )


STUDY = Study(
    name="codes-better",
    title="Codes for a continuous scene",
    source="a question of ours, on section 3.3.5",
    revision=2,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
