"""Snapshots over the position of the mask: Fig. 2.4, section 2.2.

The source shows a snapshot at each of three positions and says that the elements of the code look the more stretched the larger s
is, and not stretched at s = 0. It does not say which positions, code and scene; here s = 0, 0.1, 0.4 and a random code of
transmittance 0.5.

Every snapshot is made twice: with the discrete model of the source (edge shear) and from a finely resolved scene. A white board
gives the numbers: the mean run of open or closed pixels in one wavelength, and the length and contrast of the code's texture in
all of them.

What agrees: in one wavelength the elements are 1/(1−s) long, and at s = 0 they are as on the mask. What the source does not say: in
all wavelengths together the spectrum smears the code over sβNc columns, far more than the stretching.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram import codes
from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study
from shadowgram.spectral.continuous import ContinuousSSCSI
from shadowgram.spectral.sscsi import SSCSI

from . import _common as common
from . import _probes as probes
from ._common import CONTINUOUS, SAME

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Curves, Picture

LINE = 1 / 16  # of a band: width of the single wavelength
STEP = 1 / 32  # code columns, of the integrals behind the expected curves


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """One position of the mask."""

    mask_position: float
    size: int
    fine_bands: int
    seed: int


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """Positions from the detector outwards."""
    positions = (0.0, 0.1, 0.4) if quick else (0.0, 0.01, 0.025, 0.05, 0.1, 0.2, 0.3, 0.4)
    size, fine_bands = (64, 48) if quick else (256, 192)
    return [Spec(mask_position=s, size=size, fine_bands=fine_bands, seed=0) for s in positions]


def run(spec: Spec, scene: SceneSource) -> Result:
    """Snapshots of the scene and of a white board, both ways."""
    imager = SSCSI(
        detector_shape=(spec.size, spec.size), detector_pitch=common.PITCH, code_pitch=common.PITCH,
        mask_position=spec.mask_position, wavelengths=scene.wavelengths, shear="edge",
    )  # fmt: skip
    code = codes.random(shots=1, shape=imager.code_shape, seed=spec.seed)
    fine = common.fine_cube(scene, spec.fine_bands, imager.detector_shape)
    snapshot, truth = common.measure_fine(imager, code, fine)
    snapshots = {SAME: imager.operator(code).forward(truth)[0], CONTINUOUS: snapshot[0]}
    lines, whites = _white_discrete(imager, code), _white_continuous(imager, code)
    values: dict[str, object] = {
        "bands": imager.resolution.bands,
        "difference": float(np.linalg.norm(snapshots[SAME] - snapshot[0]) / np.linalg.norm(snapshot[0])),
        "code_run": mean_run(code[0]),
    }
    for way, line, white in ((SAME, *lines), (CONTINUOUS, *whites)):
        values[way] = {
            "run": mean_run(line), "texture": texture_length(white), "contrast": float(white.std() / white.mean()),
            "off_code": float(np.abs(white / white.max() - code[0]).max()),
        }  # fmt: skip
    centres = np.linspace(*scene.wavelengths, spec.fine_bands + 1)[:-1]
    arrays = {f"{way}_snapshot": s.astype(np.float32) for way, s in snapshots.items()}
    arrays |= {"line": whites[0].astype(np.float32), "code": code[0]}
    return Result(values=values, arrays=arrays | {"scene_picture": common.colours(fine[::8], centres[::8])})


def _white_discrete(imager: SSCSI, code: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Snapshots (y, x) of a white board in the middle band and in all bands, by the discrete model."""
    H = imager.operator(code)
    board = np.zeros(H.in_shape)
    board[H.in_shape[0] // 2] = 1
    return H.forward(board)[0], H.forward(np.ones(H.in_shape))[0]


def _white_continuous(imager: SSCSI, code: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Snapshots (y, x) of a white board in one wavelength, where the middle band begins, and in all, by eq. (2.2)."""
    low, high = imager.wavelengths
    resolution = imager.resolution
    begin = resolution.band_edges[resolution.bands // 2]
    line = (begin, begin + LINE * resolution.band_width)
    fine_bands = int(np.ceil((high - low) / (line[1] - line[0])))
    captures = [
        ContinuousSSCSI(imager=imager, bands=bands).white_captures(code, edges)[0, 0]
        for bands, edges in ((fine_bands, line), (8 * resolution.bands, (low, high)))
    ]
    return captures[0], captures[1]


def mean_run(picture: np.ndarray) -> float:
    """Mean length of a run along x of values above, or below, the middle between the extremes: steps for each change.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.experiments.studies.fig_2_4 import mean_run
    >>> mean_run(np.array([[0, 0, 0.1, 0.9, 0.8, 0.9, 1, 0, 0.2]]))
    4.0
    """
    clear = picture > (picture.min() + picture.max()) / 2
    changes = int(np.count_nonzero(clear[:, 1:] != clear[:, :-1]))
    return clear[:, 1:].size / max(changes, 1)


def texture_length(picture: np.ndarray) -> float:
    """Full width at half maximum of the autocorrelation along x, pixels; rows are samples of one random process."""
    deviation = picture - picture.mean(axis=0)
    width = deviation.shape[1]
    spectrum = np.fft.rfft(deviation, 2 * width, axis=1)
    sums = np.fft.irfft((np.abs(spectrum) ** 2).sum(axis=0))[:width]
    return _half_width(sums / np.arange(width, 0, -1))


def _half_width(correlation: np.ndarray) -> float:
    """Twice the lag at which a correlation, from lag 0, first falls to half, linear between lags."""
    below = correlation < correlation[0] / 2
    if not below.any():
        return 2.0 * len(correlation)
    lag = int(np.argmax(below))
    before, after = correlation[lag - 1 : lag + 1]
    return float(2 * (lag - 1 + (before - correlation[0] / 2) / (before - after)))


def expected(mask_position: float, columns: int) -> tuple[float, float]:
    """Length (pixels) and contrast of the texture of a white board in all wavelengths, from eq. (2.2) with Δc = Δd, β = 1.

    A pixel sees the code through box(1−s) ∗ box(sNc), the columns of which are independent; their phase is even over the pixels.

    Parameters
    ----------
    mask_position : s > 0.
    columns : Nc.
    """
    shape = np.ones(1)
    for width in (1.0, 1 - mask_position, mask_position * columns):
        samples = max(1, round(width / STEP))
        shape = np.convolve(shape, np.full(samples, 1 / samples))
    correlation = np.correlate(shape, shape, "full")[len(shape) - 1 :]
    pixels = np.arange(0, len(correlation), (1 - mask_position) / STEP)
    return _half_width(np.interp(pixels, np.arange(len(correlation)), correlation)), float(
        np.sqrt(correlation[0] / STEP)
    )


def figure(records: Sequence[Record]) -> Figure:
    """Snapshots, an enlarged part of each both ways, the same part of a white board, and the numbers over s."""
    from shadowgram.figures.sheet import Panel, sheet

    shown = [min(records, key=lambda r, s=s: abs(r.spec["mask_position"] - s)) for s in (0.0, 0.1, 0.4)]
    whole, parts, boards = _pictures(shown)
    run, *texture = _curves(records)
    rows: list[Sequence[Panel]] = [whole, parts, [*boards, run], texture]
    return sheet("Snapshots over the position of the mask (Fig. 2.4)", rows)


def _pictures(shown: Sequence[Record]) -> tuple[list[Picture], list[Picture], list[Picture]]:
    """Whole snapshots, the enlarged part of each both ways, and of a white board in one wavelength."""
    from shadowgram.figures.images import Zoom, toned
    from shadowgram.figures.sheet import Picture

    scene = shown[0].arrays["scene_picture"]
    part = Zoom(*_bright_part(scene, len(scene) // 8), len(scene) // 8)
    whole, parts, boards = [Picture(title="scene", picture=scene, zoom=part)], [], []
    for record in shown:
        name = f"s = {record.spec['mask_position']:g}"
        fine, discrete = (toned(record.arrays[f"{way}_snapshot"]) for way in (CONTINUOUS, SAME))
        line = record.arrays["line"]
        whole.append(Picture(title=f"snapshot, {name}", picture=fine, zoom=part))
        parts.append(Picture(title=name, picture=part.of(fine), caption="finely resolved"))
        parts.append(Picture(title="", picture=part.of(discrete), caption="discrete model"))
        boards.append(
            Picture(title=f"one wavelength, {name}", picture=part.of(line / line.max()), caption="white board")
        )
    return whole, parts, boards


def _bright_part(picture: np.ndarray, size: int) -> tuple[int, int]:
    """Corner (y, x) of the square with the most light for its unevenness, where a code shows best."""
    from scipy.ndimage import uniform_filter

    grey = picture.astype(float).mean(axis=2)
    mean = uniform_filter(grey, size)
    spread = np.sqrt(np.maximum(uniform_filter(grey**2, size) - mean**2, 0))
    score = (mean - spread)[size // 2 : -(size // 2), size // 2 : -(size // 2)]
    y, x = np.unravel_index(int(np.argmax(score)), score.shape)
    return int(y), int(x)


def _curves(records: Sequence[Record]) -> list[Curves]:
    """Run, texture and contrast of a white board over s, and what the models differ by."""
    from shadowgram.figures.sheet import Curve, Curves

    positions = np.array([r.spec["mask_position"] for r in records])
    smooth = np.geomspace(min(0.01, positions.max() / 10), positions.max(), 40)
    theory = np.array([expected(s, records[0].spec["size"]) for s in smooth])
    panels = {
        "one wavelength: mean run": ("run", "× that of the code", "1/(1 − s)", 1 / (1 - smooth), ""),
        "all wavelengths: texture": ("texture", "length (pixels)", "from eq. (2.2)", theory[:, 0], "y"),
        "all wavelengths: contrast": ("contrast", "σ/mean of a white board", "from eq. (2.2)", theory[:, 1], "y"),
    }
    names = {SAME: "discrete model", CONTINUOUS: "finely resolved"}
    drawn = [
        Curves(
            title=title, xlabel="mask position s", ylabel=ylabel, log=log,
            curves={reference: Curve(x=smooth, y=y, reference=True)}
            | {
                names[way]: Curve(x=positions, y=[_measured(r, way, key) for r in records], colour=number, dash=number)
                for number, way in enumerate((CONTINUOUS, SAME))
            },
        )
        for title, (key, ylabel, reference, y, log) in panels.items()
    ]  # fmt: skip
    difference = Curve(x=positions, y=[100 * r.values["difference"] for r in records], colour=3)
    return [
        *drawn,
        Curves(
            title="discrete model against finely resolved", xlabel="mask position s", ylabel="difference of snapshots (%)",
            curves={"_": difference}, bottom=0,
        ),
    ]  # fmt: skip


def _measured(record: Record, way: str, key: str) -> float:
    """A number of a white board; runs as multiples of the code's own."""
    return record.values[way][key] / (record.values["code_run"] if key == "run" else 1)


def claims(records: Sequence[Record]) -> list[Claim]:
    """Stretching over s, none at s = 0, the same code for all bands there; and what else makes the texture long."""
    return [_stretching(records), _none_at_the_detector(records), _texture(records), _models(records)]


def _stretching(records: Sequence[Record]) -> Claim:
    off = max(
        abs(_measured(r, way, "run") * (1 - r.spec["mask_position"]) - 1) for r in records for way in (SAME, CONTINUOUS)
    )
    runs = [_measured(r, CONTINUOUS, "run") for r in records]
    return Claim(
        page=11, says="as s increases, the stretching of the coded aperture pixels is more notorious",
        found="mean run in one wavelength, in that of the mask: "
        + ", ".join(f"{run:.3f} at s = {r.spec['mask_position']:g}" for run, r in zip(runs, records, strict=True))
        + f"; 1/(1 − s) to {100 * off:.1f} %, both ways",
        agrees=bool(np.all(np.diff(runs) > 0) and off < 0.03),
    )  # fmt: skip


def _none_at_the_detector(records: Sequence[Record]) -> Claim:
    zero = common.only(records, mask_position=0.0).values
    off = max(zero[way]["off_code"] for way in (SAME, CONTINUOUS))
    return Claim(
        page=11, says="when s = 0, no stretching is present, and all bands are coded by the same portion (p. 9)",
        found=f"a white board in all wavelengths shows the code itself; they differ by {probes.tiny(off)}, both ways",
        agrees=off < 1e-6,
    )  # fmt: skip


def _texture(records: Sequence[Record]) -> Claim:
    far = [r for r in records if r.spec["mask_position"] > 0]
    seen = {r.spec["mask_position"]: r.values[CONTINUOUS] for r in far}
    parts = [f"{v['texture']:.1f} pixels at s = {s:g}, contrast {v['contrast']:.2f}" for s, v in seen.items()]
    last, columns = max(seen), far[-1].spec["size"]
    stretched = all(v["texture"] < 2 / (1 - s) for s, v in seen.items())
    return Claim(
        page=None, says="what makes the texture of the snapshots long, the stretching or the dispersion?",
        found="texture of a white board in all wavelengths: " + "; ".join(parts),
        agrees=None,
        why="" if stretched else "the spectrum lies over sβNc columns of the mask, and smears the code over sβNc/(1 − s) pixels"
        f" ({last * columns / (1 - last):.0f} at s = {last:g}), where stretching alone gives {1 / (1 - last):.2f}",
    )  # fmt: skip


def _models(records: Sequence[Record]) -> Claim:
    off = {r.spec["mask_position"]: r.values["difference"] for r in records}
    return Claim(
        page=None, says="how far are snapshots of the discrete model from those of a finely resolved scene?",
        found="difference of the snapshots of the scene, discrete to finely resolved, over s: "
        + ", ".join(f"{s:g}: {100 * value:.1f} %" for s, value in off.items()),
        agrees=None,
    )  # fmt: skip


STUDY = Study(
    name="fig-2-4",
    title="Snapshots over the position of the mask",
    source="Fig. 2.4, page 11",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
