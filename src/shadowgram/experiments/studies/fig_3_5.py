"""Quality over the number of shots for random, Boolean and optimised codes: Figs. 3.5, 3.6 and 3.8 to 3.11, section 3.6.

The source reconstructs scenes of 6, 12 and 24 bands (128 × 128, s = 0.046, 0.093 and 0.1875) with GPSR and finds optimised codes
above Boolean ones, and these above random ones, in PSNR and RMS, for three scenes; noise of 30 dB begins to cost quality.

Measured as there, with the model that reconstructs (edge shear). Every setting has several codes, from different seeds, so that
differences can be told from chance. GPSR, its τ searched against the truth as in the source, and EigenTV reconstruct, without
noise, at 30 dB of every code's own signal, and with a read noise that is the same for all codes: there the random code, which
passes half of the light whatever the number of shots, has the better signal. A fourth code is ours: the cost with coupling, of
the exact shear.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study

from . import _codes
from . import _common as common
from ._codes import KINDS, NOISES, Gain
from ._common import SOLVERS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Curves, Panel

ORDER = (("optimised", "boolean"), ("boolean", "random"))
_PAGES = {"none": 54, "30 dB": 57, "read": None}


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """One code."""

    bands: int
    shots: int
    kind: str
    size: int
    seed: int


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """Three positions of the mask; eight shots of six bands are more than those can use."""
    shots = {3: (2, 4), 6: (2,)} if quick else {6: (2, 4, 8), 12: (2, 4, 8), 24: (2, 3, 4, 8)}
    return [
        Spec(bands=bands, shots=q, kind=kind, size=32 if quick else 128, seed=seed)
        for bands, several in shots.items()
        for q in several
        for kind in KINDS
        for seed in range(2 if quick else 5)
    ]


def _shown(bands: int) -> int:
    """Shots of the pictures, as in Fig. 3.6."""
    return 4 if bands == 24 else 2


def run(spec: Spec, scene: SceneSource) -> Result:
    """Design, measure, and reconstruct at every noise with both solvers."""
    imager = _codes.imager_of(spec.bands, spec.size, scene.wavelengths)
    code = _codes.code_of(spec.kind, imager, spec.shots, spec.seed)
    truth = common.fine_cube(scene, spec.bands, (spec.size, spec.size))
    H = common.stored_operator(imager, code)
    clean = H.forward(truth)
    noises = (*NOISES, "50 dB") if spec.seed == 0 else tuple(NOISES)
    read = _codes.read_noise(imager, truth)
    values: dict[str, dict[str, dict[str, float]]] = {solver: {} for solver in SOLVERS}
    arrays: dict[str, np.ndarray] = {}
    for kind in noises:
        y = _codes.disturbed(clean, kind, read, spec.seed)
        for solver in SOLVERS:
            x, values[solver][kind] = _codes.reconstruct(solver, H, y, truth, kind)
            if (solver, kind, spec.seed, spec.shots) == ("gpsr", "none", 0, _shown(spec.bands)):
                arrays = _pictures(x, truth, imager.resolution.wavelengths)
    return Result(values={**values, "point": common.vivid_points(truth, 1)[0]}, arrays=arrays)


def _pictures(x: np.ndarray, truth: np.ndarray, wavelengths: np.ndarray) -> dict[str, np.ndarray]:
    exposure = common.exposure_of(truth, wavelengths)
    row, column = common.vivid_points(truth, 1)[0]
    return {
        "wavelengths": wavelengths,
        "truth": truth[:, row, column],
        "spectrum": x[:, row, column],
        "truth_picture": common.colours(truth, wavelengths, exposure),
        "picture": common.colours(x, wavelengths, exposure),
    }


def _places(records: Sequence[Record]) -> list[tuple[int, int]]:
    """(bands, shots) in order."""
    return sorted({(r.spec["bands"], r.spec["shots"]) for r in records})


def _found(
    records: Sequence[Record], place: tuple[int, int], kind: str, solver: str, noise: str, what: str = "psnr"
) -> list[float]:
    """Values of the seeds that have this noise."""
    own = common.chosen(records, bands=place[0], shots=place[1], kind=kind)
    return [r.values[solver][noise][what] for r in own if noise in r.values[solver]]


def _position(records: Sequence[Record], bands: int) -> str:
    return f"s = {bands / records[0].spec['size']:.3g}"


def _gains(records: Sequence[Record], pair: tuple[str, str], solver: str, noise: str) -> dict[str, Gain]:
    """Place → gain in PSNR of the first kind over the second."""
    return {
        f"{_position(records, place[0])}, Q = {place[1]}": _codes.gain(
            *(_found(records, place, kind, solver, noise) for kind in pair)
        )
        for place in _places(records)
    }


def figure(records: Sequence[Record]) -> Figure:
    """PSNR over the shots by noise, position and solver; RMS; the three noises of the source; pictures and spectra."""
    from shadowgram.figures.sheet import sheet

    bands = sorted({r.spec["bands"] for r in records})
    rows: list[list[Panel | None]] = [
        [
            _quality(records, b, solver, noise, legend=n == 0 and noise == "none", axis=n in (0, len(bands)))
            for n, (solver, b) in enumerate(_columns(bands))
        ]
        for noise in NOISES
    ]
    rms: list[Panel | None] = [
        _quality(records, b, "gpsr", "none", legend=False, axis=b == bands[0], what="rms") for b in bands
    ]
    rows.append([*rms, *(_noises(records, b, first=b == bands[0]) for b in bands)])
    rows += [_shown_row(records, b, number) for number, b in enumerate(bands, 1)]
    title = "Random, Boolean and optimised codes (Figs. 3.5, 3.6, 3.8 to 3.11); bands: standard deviation over seeds"
    return sheet(title, rows)


def _columns(bands: Sequence[int]) -> list[tuple[str, int]]:
    return [(solver, b) for solver in SOLVERS for b in bands]


def _quality(
    records: Sequence[Record], bands: int, solver: str, noise: str, *, legend: bool, axis: bool, what: str = "psnr"
) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    places = [place for place in _places(records) if place[0] == bands]
    curves = {}
    for number, (kind, name) in enumerate(KINDS.items()):
        found = [_found(records, place, kind, solver, noise, what) for place in places]
        curves[name.removesuffix(" (ours)") if legend else f"_{name}"] = Curve(
            x=[q for _, q in places],
            y=[float(np.mean(f)) for f in found],
            colour=number,
            spread=[float(np.std(f)) for f in found],
        )
    title = f"{SOLVERS[solver]}, s = {bands / records[0].spec['size']:.2g}\n{NOISES[noise]}"
    label = "PSNR (dB)" if what == "psnr" else "RMS"
    return Curves(title=title, xlabel="shots", ylabel=label if axis else "", curves=curves)


def _noises(records: Sequence[Record], bands: int, *, first: bool) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    places = [place for place in _places(records) if place[0] == bands]
    curves = {
        noise if first else f"_{noise}": Curve(
            x=[q for _, q in places],
            y=[_found(records, place, "optimised", "gpsr", noise)[0] for place in places],
            colour=2, dash=dash,
        )
        for dash, noise in enumerate(("none", "50 dB", "30 dB"))
    }  # fmt: skip
    return Curves(
        title=f"GPSR, s = {bands / records[0].spec['size']:.2g}\noptimised",
        xlabel="shots",
        ylabel="PSNR (dB)" if first else "",
        curves=curves,
    )


def _shown_row(records: Sequence[Record], bands: int, number: int) -> list[Panel | None]:
    from shadowgram.figures.images import Point
    from shadowgram.figures.sheet import Curve, Curves, Picture

    shots = _shown(bands)
    shown = {kind: common.only(records, bands=bands, shots=shots, kind=kind, seed=0) for kind in KINDS}
    first = shown["random"].arrays
    point = Point(f"T{number}", *shown["random"].values["point"])
    spectra = Curves(
        title=f"{point.label}, grey: scene\nGPSR, {shots} shots", xlabel="wavelength (nm)", ylabel="radiance (relative)", bottom=0,
        curves={"_truth": Curve(x=first["wavelengths"], y=first["truth"], reference=True)}
        | {
            f"_{kind}": Curve(x=first["wavelengths"], y=record.arrays["spectrum"], colour=n)
            for n, (kind, record) in enumerate(shown.items())
        },
    )  # fmt: skip
    scene = Picture(title="scene", picture=first["truth_picture"], points=[point], caption=f"{bands} bands")
    return [spectra, scene] + [
        Picture(
            title=KINDS[kind], picture=r.arrays["picture"], caption=f"GPSR {r.values['gpsr']['none']['psnr']:.1f} dB"
        )
        for kind, r in shown.items()
    ]


def claims(records: Sequence[Record]) -> list[Claim]:
    """The order of the codes at every noise, what noise costs, and our code."""
    return [
        *(_order(records, solver, noise) for noise in NOISES for solver in SOLVERS),
        _rms(records),
        _noise_costs(records),
        _light(records),
        _more_shots_than_bands(records),
        _ours(records),
        _taus(records),
    ]


def _table(records: Sequence[Record], solver: str, noise: str) -> str:
    """Mean PSNR of the kinds at every place."""
    rows = []
    for place in _places(records):
        means = [f"{np.mean(_found(records, place, kind, solver, noise)):.1f}" for kind in KINDS]
        rows.append(f"{_position(records, place[0])}, Q = {place[1]}: {' / '.join(means)}")
    spread = np.mean(
        [np.std(_found(records, place, kind, solver, noise)) for place in _places(records) for kind in KINDS]
    )
    return f"PSNR in dB, {' / '.join(KINDS)}: {'; '.join(rows)}; deviation over seeds {spread:.2f} on average"


def _order(records: Sequence[Record], solver: str, noise: str) -> Claim:
    named = {
        f"{KINDS[ours]} over {KINDS[theirs]}": _gains(records, (ours, theirs), solver, noise) for ours, theirs in ORDER
    }
    page = _PAGES[noise]
    held = [_codes.holds(gains) for gains in named.values()]
    says = f"optimised above Boolean above random codes, {SOLVERS[solver]}, {NOISES[noise]}"
    return Claim(
        page=page,
        says=says if page else f"are {says} the same for all codes?",
        found=". ".join(_codes.tell(name, gains) for name, gains in named.items()) + ". " + _table(records, solver, noise),
        agrees=None if page is None else False if False in held else None if None in held else True,
        why=". ".join(text for name, gains in named.items() if (text := _codes.exceptions(name, gains))),
    )  # fmt: skip


def _rms(records: Sequence[Record]) -> Claim:
    """The order again, in RMS."""
    found, wrong = [], []
    places = _places(records)
    for solver, name in SOLVERS.items():
        mean = {
            kind: [np.mean(_found(records, place, kind, solver, "none", "rms")) for place in places] for kind in KINDS
        }
        for ours, theirs in ORDER:
            ratio = np.divide(mean[ours], mean[theirs])
            found.append(
                f"{name}, {KINDS[ours]} over {KINDS[theirs]}: {ratio.mean():.2f} times the RMS on average"
                f" ({ratio.min():.2f} to {ratio.max():.2f}), less at {(ratio < 1).sum()} of {len(places)}"
            )
            wrong += [
                f"{name}, {KINDS[ours]}, {_position(records, b)}, Q = {q} ({r:.2f})"
                for (b, q), r in zip(places, ratio, strict=True)
                if r >= 1
            ]
    return Claim(
        page=54, says="optimised codes have a smaller RMS than Boolean, and these than random ones",
        found="; ".join(found), agrees=not any(text.startswith("GPSR") for text in wrong),
        why=f"not at {'; '.join(wrong)}" if wrong else "",
    )  # fmt: skip


def _noise_costs(records: Sequence[Record]) -> Claim:
    cost = {
        (solver, noise): {
            place: _found(records, place, "optimised", solver, "none")[0] - _found(records, place, "optimised", solver, noise)[0]
            for place in _places(records)
        }
        for solver in SOLVERS
        for noise in ("30 dB", "50 dB")
    }  # fmt: skip
    smallest = min(place[0] for place in _places(records))
    much, little = (
        float(np.mean([lost for place, lost in cost["gpsr", noise].items() if place[0] > smallest]))
        for noise in ("30 dB", "50 dB")
    )
    return Claim(
        page=57,
        says="noise of 30 dB begins to cost quality, of 50 dB hardly does (optimised codes, the two larger s)",
        found=f"with GPSR and the two larger s, {much:.2f} and {little:.2f} dB on average; mean (least to most) over all (s, Q): "
        + "; ".join(
            f"{SOLVERS[solver]}, {noise}: {np.mean(list(lost.values())):.2f} dB"
            f" ({min(lost.values()):.2f} to {max(lost.values()):.2f})"
            for (solver, noise), lost in cost.items()
        ),
        agrees=little < 0.5 < much,
        why="hardly: less than 0.5 dB on average",
    )


def _winners(records: Sequence[Record], places: Sequence[tuple[int, int]], solver: str, noise: str) -> str:
    """Which of the source's kinds is best where."""
    won: dict[str, list[str]] = {}
    for place in places:
        means = {kind: np.mean(_found(records, place, kind, solver, noise)) for kind in KINDS if kind != "coupled"}
        best = max(means, key=lambda kind: means[kind])
        won.setdefault(KINDS[best], []).append(f"{_position(records, place[0])}, Q = {place[1]}")
    return ", ".join(f"{kind} at {len(where)} ({'; '.join(where)})" for kind, where in won.items())


def _light(records: Sequence[Record]) -> Claim:
    random = {
        solver: _codes.tell("random over optimised", _gains(records, ("random", "optimised"), solver, "read"))
        for solver in SOLVERS
    }
    return Claim(
        page=None,
        says="which code is best where the noise is the camera's own, so that light counts? (30 dB for a Boolean code with Q ="
        f" {_codes.READ_NOISE_SHOTS})",
        found=". ".join(
            f"{name}: {_winners(records, _places(records), solver, 'read')}; {random[solver]}"
            for solver, name in SOLVERS.items()
        ),
        agrees=None,
    )  # fmt: skip


def _more_shots_than_bands(records: Sequence[Record]) -> Claim:
    places = [place for place in _places(records) if place[1] > place[0]]
    gains = {
        f"{name}, {text}": _codes.gain(*(_found(records, place, kind, solver, noise) for kind in ORDER[0]))
        for place in places
        for solver, name in SOLVERS.items()
        for noise, text in NOISES.items()
    }
    return Claim(
        page=None,
        says="what is best with more shots than bands (c₁ = 0)?",
        found=". ".join(
            f"{name}, {text}: {_winners(records, places, solver, noise)}"
            for solver, name in SOLVERS.items()
            for noise, text in NOISES.items()
        )
        + ". Optimised over Boolean, dB: "
        + ", ".join(f"{name}: {one}" for name, one in gains.items()),
        agrees=None,
    )


def _ours(records: Sequence[Record]) -> Claim:
    return Claim(
        page=None,
        says="does the coupling of neighbouring columns, with the exact shear in the cost, improve on the source's cost where the"
        " edge model measures?",
        found=". ".join(
            _codes.tell(f"{name}, {text}", _gains(records, ("coupled", "optimised"), solver, noise))
            for solver, name in SOLVERS.items()
            for noise, text in NOISES.items()
        ),
        agrees=None,
    )  # fmt: skip


def _taus(records: Sequence[Record]) -> Claim:
    found = []
    for noise, text in NOISES.items():
        taus = [r.values["gpsr"][noise]["tau"] for r in records]
        ends = (_codes.taus_of(noise)[0], _codes.taus_of(noise)[-1])
        at_end = [r for r in records if r.values["gpsr"][noise]["tau"] in ends]
        parts = [f"{text}: {min(taus):.0e} to {max(taus):.0e}, {len(at_end)} of {len(taus)} at an end of the grid"]
        for name, few in (("Q < L", True), ("Q ≥ L", False)):
            more = [r.values["gpsr"][noise]["border"] for r in at_end if (r.spec["shots"] < r.spec["bands"]) == few]
            parts += [f"{max(more):.2f} dB above the next inside at most where {name}"] if more else []
        found.append(", ".join(parts))
    return Claim(
        page=None,
        says="which τ are the best for GPSR, and does the grid hold them? (without noise the best may be the limit τ → 0)",
        found="; ".join(found),
        agrees=None,
    )


STUDY = Study(
    name="fig-3-5",
    title="Random, Boolean and optimised codes",
    source="Figs. 3.5, 3.6 and 3.8 to 3.11, pages 54 to 60",
    revision=2,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
