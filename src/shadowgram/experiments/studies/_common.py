"""What the studies share: how a scene is measured, reconstructed and shown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from shadowgram import metrics
from shadowgram.experiments.quality import assess
from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Record
from shadowgram.operators import LinearOperator
from shadowgram.scenes import as_datacube, to_rgb
from shadowgram.scenes.colour import auto_exposure
from shadowgram.solvers.eigen_tv import EigenTV
from shadowgram.solvers.gpsr import GPSR
from shadowgram.solvers.solution import solve
from shadowgram.solvers.tau_search import search_tau
from shadowgram.spectral.continuous import ContinuousSSCSI
from shadowgram.spectral.sscsi import SSCSI

PITCH = 10.0  # µm, of the detectors of the simulations; only its ratio to the code's matters
SAME, CONTINUOUS = "same", "continuous"
"""How a study measures: with the model that reconstructs, as the source did, or with a finely resolved scene."""

SOLVERS = {"gpsr": "GPSR", "eigen-tv": "EigenTV"}
"""What reconstructs, as the specifications and the titles have it."""

# Relative weights that GPSR tries, as in the source "the value of τ was chosen such that an optimal PSNR is reached".
TAUS = (1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6)


@lru_cache(maxsize=2)
def fine_cube(scene: SceneSource, bands: int, size: tuple[int, int]) -> np.ndarray:
    """Values of a scene's cube, kept for the next tasks of the process; not to be changed."""
    values = scene.cube(bands, size).values
    values.flags.writeable = False
    return values


def stored_operator(imager: SSCSI, code: np.ndarray) -> LinearOperator:
    """SSCSI with Δc = Δd through its stored effective code, the mask on the detector included.

    Several times faster than `imager.operator` where bands do not move by whole columns, for Q times the memory of the cube.
    """
    from shadowgram.spectral._shift_operators import ColoredOperator

    if imager.mask_position == 0:  # the border of the regimes, where all bands see the code itself
        return ColoredOperator(np.repeat(code[:, None], imager.resolution.bands, axis=1).astype(np.float32), 0)
    return ColoredOperator(imager.effective_code(code).astype(np.float32), 0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """Reconstruction by one solver.

    Attributes
    ----------
    x : (band, y, x).
    values : psnr (dB, peak 1), rms, ssim, sam (rad), detail (`spectral_detail`), seconds, iterations, converged; tau for GPSR.
    """

    x: np.ndarray
    values: dict[str, float | int | bool]


def reconstruct(
    solver: str, H: LinearOperator, y: np.ndarray, truth: np.ndarray, noise: float | None = None
) -> Estimate:
    """Reconstruct and assess, peak 1.

    Parameters
    ----------
    solver : "gpsr": the source's, its τ searched for the best PSNR against the truth (an oracle, as in the source); "eigen-tv":
        ours, as it comes.
    H, y, truth : operator, snapshots, (band, y, x).
    noise : of the snapshots, for EigenTV, where it is known.
    """
    y = np.asarray(y, np.float32)
    if solver == "gpsr":
        solution, table = search_tau(
            GPSR(max_iter=300, tol=1e-5), H, y, lambda x: metrics.psnr(x, truth, peak=1.0), TAUS
        )
        tau = max(table, key=lambda trial: trial.score).tau
        more: dict[str, float | int | bool] = {"tau": tau}
    elif solver == "eigen-tv":
        solution, more = solve(EigenTV(noise=noise), H, y), {}
    else:
        raise ValueError(f"a study reconstructs with 'gpsr' or 'eigen-tv', got {solver!r}")
    quality = assess(solution.x, truth, peak=1.0)
    values = {"psnr": quality.psnr, "rms": quality.rms, "ssim": quality.ssim, "sam": quality.sam, **more}
    values |= {
        "detail": spectral_detail(solution.x, truth),
        "seconds": round(solution.seconds, 3), "iterations": solution.iterations, "converged": bool(solution.converged)
    }  # fmt: skip
    return Estimate(x=solution.x, values=values)


def spectral_detail(estimate: np.ndarray, truth: np.ndarray) -> float:
    """Share of the spectra's second differences that an estimate has, ⟨Δ²x, Δ²f⟩/⟨Δ²f, Δ²f⟩ over all pixels; 1 is all of them.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.experiments.studies._common import spectral_detail
    >>> truth = np.random.default_rng(0).random((5, 4, 4))
    >>> spectral_detail(0.5 * truth + 3, truth)
    0.5
    """
    if len(truth) < 3:
        return 0.0
    a, b = np.diff(estimate, 2, axis=0), np.diff(truth, 2, axis=0)
    return round(float(np.vdot(a, b) / np.vdot(b, b)), 6)


def measure_fine(
    imager: SSCSI, code: np.ndarray, scene: np.ndarray, pupil: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Snapshots (shot, y, x) of a finely resolved scene (band, y, x), and its truth (band, y, x) on the imager's voxels."""
    over = scene.shape[1] // imager.detector_shape[0]
    camera = ContinuousSSCSI(imager=imager, bands=len(scene), oversampling=over, pupil=pupil)
    return camera.operator(code).forward(scene), camera.truth(scene)


def colours(values: np.ndarray, wavelengths: Sequence[float] | np.ndarray, exposure: float | None = None) -> np.ndarray:
    """True colours of a cube, (y, x, 3) uint8; by default exposed for itself."""
    cube = as_datacube(np.clip(values, 0, None), wavelengths)
    return to_rgb(cube, auto_exposure(cube) if exposure is None else exposure)


def exposure_of(values: np.ndarray, wavelengths: Sequence[float] | np.ndarray) -> float:
    """Exposure that shows a cube well, to be used for its reconstructions too."""
    return auto_exposure(as_datacube(values, wavelengths))


def vivid_points(cube: np.ndarray, count: int, margin: int = 6) -> list[tuple[int, int]]:
    """Pixels (y, x) whose surroundings are even, bright and coloured, far from each other: where spectra are worth showing.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.experiments.studies._common import vivid_points
    >>> cube = np.full((3, 32, 32), 0.1); cube[0, 8:16, 8:16] = 1
    >>> [(y, x)] = vivid_points(cube, 1)
    >>> 8 <= y < 16 and 8 <= x < 16
    True
    """
    from scipy.ndimage import uniform_filter

    side = max(3, cube.shape[1] // 64)
    mean = np.stack([uniform_filter(band.astype(np.float32), side) for band in cube])
    square = np.stack([uniform_filter(np.square(band, dtype=np.float32), side) for band in cube])
    uneven = np.sqrt(np.maximum(square - mean**2, 0)).mean(axis=0)
    score = mean.std(axis=0) - 2 * uneven
    edge = min(margin, cube.shape[1] // 4)
    score[:edge] = score[-edge:] = score[:, :edge] = score[:, -edge:] = -np.inf
    rows, columns = np.indices(score.shape)
    points = []
    for _ in range(count):
        y, x = np.unravel_index(int(np.argmax(score)), score.shape)
        points.append((int(y), int(x)))
        score[np.hypot(rows - y, columns - x) < cube.shape[1] / 5] = -np.inf
    return points


def chosen(records: Sequence[Record], **wanted: object) -> list[Record]:
    """Records whose specification has these values, in order."""
    return [r for r in records if all(r.spec[name] == value for name, value in wanted.items())]


def only(records: Sequence[Record], **wanted: object) -> Record:
    """The one record whose specification has these values."""
    found = chosen(records, **wanted)
    if len(found) != 1:
        raise LookupError(f"{len(found)} records with {wanted}")
    return found[0]


def series(pairs: Mapping[int, float]) -> str:
    """Numbers over a parameter, in a sentence: "3: 30.1, 6: 33.2"."""
    return ", ".join(f"{key}: {value:.1f}" for key, value in pairs.items())
