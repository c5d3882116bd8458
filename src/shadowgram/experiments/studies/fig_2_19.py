"""Spectral zoom: how well a signature of narrow peaks comes out, over the position of the mask: Fig. 2.19, section 2.4.3.2.

The source puts a synthetic spectral signature with strong peaks at random places of the datacube and reconstructs for several s at
a compression ratio of 0.2 (so that Q grows with the number of bands L = ⌈sN⌉). The correlation |r| between the true and the
reconstructed signature rises with s.

Here the signature is a sum of seven Gaussian peaks, 2.5 to 6 % of the range wide (FWHM), in twelve patches of 8 × 8 pixels; r is
taken on the fine bands, of the mean over a patch's inner pixels, and averaged over the patches. "Same model" measures the means
of the fine scene over the bands, so that r can only show the resolution of the bands; the finely resolved scene has no bands of its
own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram import codes
from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study
from shadowgram.spectral.sscsi import SSCSI

from . import _common as common
from ._common import CONTINUOUS, SAME, SOLVERS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COMPRESSION = 0.2
# Of the range: place and width (FWHM) of each peak, and its height.
PEAKS = (
    (0.08, 0.04, 0.6), (0.21, 0.03, 1.0), (0.36, 0.06, 0.5), (0.49, 0.025, 0.9),
    (0.62, 0.04, 0.7), (0.75, 0.03, 1.0), (0.91, 0.05, 0.6),
)  # fmt: skip
PATCH = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """One mask position and way to measure."""

    bands: int
    way: str
    size: int
    fine_bands: int
    patches: int
    seed: int


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """Numbers of bands of which a fifth is a whole number of shots."""
    size, patches, fine = (64, 4, 80) if quick else (256, 12, 400)
    return [
        Spec(bands=bands, way=way, size=size, fine_bands=fine, patches=patches, seed=0)
        for way in (SAME, CONTINUOUS)
        for bands in ((5, 10, 20) if quick else (5, 10, 20, 40, 60, 80))
    ]


def signature(bands: int) -> np.ndarray:
    """(band,) signature with strong peaks, in [0, 1].

    Examples
    --------
    >>> from shadowgram.experiments.studies.fig_2_19 import signature
    >>> from scipy.signal import find_peaks
    >>> len(find_peaks(signature(400))[0])
    7
    """
    place = (np.arange(bands) + 0.5) / bands
    total = np.full(bands, 0.05)
    for centre, width, height in PEAKS:
        total += height * np.exp(-4 * np.log(2) * ((place - centre) / width) ** 2)
    return np.minimum(total, 1.0)


def _corners(spec: Spec) -> list[tuple[int, int]]:
    """Upper left pixels of patches that do not touch."""
    rng = np.random.default_rng(spec.seed)
    cells = spec.size // (2 * PATCH) - 1
    chosen = rng.choice(cells**2, spec.patches, replace=False)
    return [(int(PATCH + 2 * PATCH * (c // cells)), int(PATCH + 2 * PATCH * (c % cells))) for c in chosen]


def _scene_with_signature(spec: Spec, scene: SceneSource) -> np.ndarray:
    cube = common.fine_cube(scene, spec.fine_bands, (spec.size, spec.size)).copy()
    for y, x in _corners(spec):
        cube[:, y : y + PATCH, x : x + PATCH] = signature(spec.fine_bands)[:, None, None]
    return cube


def run(spec: Spec, scene: SceneSource) -> Result:
    """Measure and reconstruct with both solvers."""
    imager = SSCSI(
        detector_shape=(spec.size, spec.size), detector_pitch=common.PITCH, code_pitch=common.PITCH,
        mask_position=spec.bands / spec.size, wavelengths=scene.wavelengths, shear="edge" if spec.way == SAME else "exact",
    )  # fmt: skip
    shots = max(1, round(COMPRESSION * spec.bands))
    code = codes.boolean(shots=shots, shape=imager.code_shape, seed=spec.seed)
    fine = _scene_with_signature(spec, scene)
    H = imager.operator(code)
    y, truth = common.measure_fine(imager, code, fine)
    if spec.way == SAME:
        y = H.forward(truth)
    low, high = scene.wavelengths
    fine_wavelengths = low + (high - low) * (np.arange(spec.fine_bands) + 0.5) / spec.fine_bands
    wavelengths = imager.resolution.wavelengths
    true = signature(spec.fine_bands)
    means = [_patch_means(truth, spec)]
    values: dict[str, object] = {
        "shots": shots, "mask_position": imager.mask_position, "band_width": imager.resolution.band_width,
        "perfect": float(np.mean([_correlation(s, wavelengths, true, fine_wavelengths) for s in means[0]])),
    }  # fmt: skip
    arrays = {"wavelengths": wavelengths, "fine_wavelengths": fine_wavelengths, "signature": true}
    for solver in SOLVERS:
        estimate = common.reconstruct(solver, H, y, truth)
        found = _patch_means(estimate.x, spec)
        rs = [_correlation(s, wavelengths, true, fine_wavelengths) for s in found]
        values[solver] = estimate.values | {"r": float(np.mean(rs)), "r_spread": float(np.std(rs))}
        arrays[f"{solver}_spectrum"] = found[int(np.argsort(rs)[len(rs) // 2])]
    return Result(values=values, arrays=arrays)


def _patch_means(cube: np.ndarray, spec: Spec) -> list[np.ndarray]:
    """Mean spectra of the patches, but for a margin of two pixels."""
    return [cube[:, y + 2 : y + PATCH - 2, x + 2 : x + PATCH - 2].mean(axis=(1, 2)) for y, x in _corners(spec)]


def _correlation(spectrum: np.ndarray, at: np.ndarray, true: np.ndarray, fine: np.ndarray) -> float:
    """|r| between a spectrum, interpolated to the fine bands, and the true signature."""
    values = np.interp(fine, at, spectrum)
    return float(abs(np.corrcoef(values, true)[0, 1])) if np.ptp(values) > 0 else 0.0


def figure(records: Sequence[Record]) -> Figure:
    """|r| over s, and the signatures found."""
    from shadowgram.figures.sheet import Curve, Curves, sheet

    same, fine = (common.chosen(records, way=way) for way in (SAME, CONTINUOUS))
    positions = [r.values["mask_position"] for r in same]
    curves = {
        f"{name}, {'same model' if way is same else 'fine scene'}": Curve(
            x=positions, y=[r.values[solver]["r"] for r in way], colour=number, dash=int(way is fine)
        )
        for number, (solver, name) in enumerate(SOLVERS.items())
        for way in (same, fine)
    }
    curves |= {"perfect bands": Curve(x=positions, y=[r.values["perfect"] for r in same], reference=True)}
    overview = Curves(
        title="Likeness of the signature", xlabel="mask position s", ylabel="correlation |r|", curves=curves, width=1.2
    )
    truth = Curve(x=same[0].arrays["fine_wavelengths"], y=same[0].arrays["signature"], reference=True)
    shown = [fine[0], fine[len(fine) // 2], fine[-1]]
    panels = [
        Curves(
            title=f"s = {r.values['mask_position']:.3g}: {r.spec['bands']} bands, Q = {r.values['shots']}",
            xlabel="wavelength (nm)", ylabel="radiance (relative)", bottom=0,
            curves={"truth": truth}
            | {
                f"{name}, |r| = {r.values[solver]['r']:.2f}": Curve(
                    x=r.arrays["wavelengths"], y=r.arrays[f"{solver}_spectrum"], colour=number
                )
                for number, (solver, name) in enumerate(SOLVERS.items())
            },
        )
        for r in shown
    ]  # fmt: skip
    return sheet(
        "Spectral zoom at a compression ratio of 0.2 (Fig. 2.19); finely resolved scene",
        [[overview, panels[0]], panels[1:]],
    )


def claims(records: Sequence[Record]) -> list[Claim]:
    """|r| rises with s."""
    found, rising = [], {}
    for way in (SAME, CONTINUOUS):
        for solver, name in SOLVERS.items():
            series = {r.values["mask_position"]: r.values[solver]["r"] for r in common.chosen(records, way=way)}
            rs = list(series.values())
            # A fall of a hundredth is not a trend.
            rising[way, solver] = bool(rs[-1] > rs[0] + 0.05 and min(np.diff(rs)) > -0.02)
            found.append(f"{name}, {way}: " + ", ".join(f"{s:.3g}: {r:.2f}" for s, r in series.items()))
    perfect = {r.values["mask_position"]: r.values["perfect"] for r in common.chosen(records, way=SAME)}
    found.append("bands without any error: " + ", ".join(f"{s:.3g}: {r:.2f}" for s, r in perfect.items()))
    failed = [f"{SOLVERS[solver]}, {way}" for (way, solver), up in rising.items() if not up]
    return [
        Claim(
            page=32,
            says="peaks of the signature become clearer as s grows: |r| rises with s (CR = 0.2)",
            found="|r| over s: " + "; ".join(found),
            agrees=rising[SAME, "gpsr"],
            why="" if not failed else f"not steadily: {', '.join(failed)}",
        )
    ]


STUDY = Study(
    name="fig-2-19",
    title="Spectral zoom of a signature with peaks",
    source="Fig. 2.19, page 32",
    revision=2,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
