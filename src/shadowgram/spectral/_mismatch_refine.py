"""Refinement of a model on held-out pixels: reconstruct from the others, and see which change of the model predicts these better.

The reconstruction takes up part of what is wrong with the model, so that a step goes only part of the way; the steps are
extrapolated. Source of the extrapolation: Anderson, J. ACM 12 (1965) 547.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from shadowgram.operators.base import LinearOperator
from shadowgram.solvers._parts import Weighted
from shadowgram.solvers.eigen_tv import EigenTV
from shadowgram.solvers.solution import solve

from ._dispersion import Dispersion
from ._mismatch_windows import TILES
from ._shift_operators import ColoredOperator, DispersedOperator

HELD_OUT = 0.2  # share of the pixels
ITERATIONS = 30
MOST_ROUNDS = 8
PART = 5.0  # how many steps it takes to go all the way, at most: 3 to 6 on simulated captures
DIFFERENCE, WIDENING = 0.05, 0.1  # px, px²; for derivatives
STEP = 0.4  # px or px², at most, in a round
SETTLED = 0.01  # px of any band, px², or of a gain
FARTHEST = 3.0  # px
MARGIN = 12  # rows of the code beside those that are wanted: the shift, the blur, and what a spline needs


@dataclass(frozen=True, kw_only=True, eq=False)
class Model:
    """What can be wrong: place of the mask, dispersion, blur, gains.

    Attributes
    ----------
    place : dy, dx px, and relative error ε of the dispersion.
    blur : variance along y and x, px².
    log_gains : (shot,), of mean 0.
    """

    place: tuple[float, float, float]
    blur: tuple[float, float]
    log_gains: np.ndarray

    def right(self, displacements: np.ndarray) -> np.ndarray:
        """(band,) px; how far right each band sees the mask."""
        return self.place[1] + self.place[2] * displacements


@dataclass(frozen=True, kw_only=True, eq=False)
class Capture:
    """What the model is compared with.

    Attributes
    ----------
    code : (shot, y, x), or (shot, band, y, x).
    snapshots : (shot, rows, x) float32, without the dark level.
    rows : of the code that are compared.
    dispersion : of the disperser; None if the bands are not displaced.
    bands : number of bands.
    """

    code: np.ndarray
    snapshots: np.ndarray
    rows: slice
    dispersion: Dispersion | None
    bands: int

    @property
    def displacements(self) -> np.ndarray:
        """(band,) px."""
        return np.zeros(self.bands) if self.dispersion is None else self.dispersion.centres

    def operator(self, code: np.ndarray) -> LinearOperator:
        """Forward model with a code (shot, band, y, x) of any values."""
        code = np.ascontiguousarray(code, np.float32)
        step = 0 if self.dispersion is None else self.dispersion.whole_step
        if step is not None:
            return ColoredOperator(code, step)
        assert self.dispersion is not None
        return DispersedOperator(code, code.shape[1:], self.dispersion)

    def codes(
        self, model: Model, down: float = 0.0, right: float = 0.0, wider: tuple[float, float] = (0, 0)
    ) -> np.ndarray:
        """(shot, band, rows, x) code as each band sees it with this model, and moved or blurred by more."""
        blur = model.blur[0] + wider[0], model.blur[1] + wider[1]
        moved = moved_code(self.code, model.place[0] + down, model.right(self.displacements) + right, blur, self.rows)
        return moved * np.exp(model.log_gains)[:, None, None, None]


def moved_code(
    code: np.ndarray, down: float, right: np.ndarray, blur: tuple[float, float], rows: slice = slice(None)
) -> np.ndarray:
    """Code (shot, band, rows, x) blurred, and moved by cubic splines, in each band by its own distance to the right.

    `code` is (shot, y, x) or (shot, band, y, x); beyond its edges, it goes on as at the edge. `blur` is variances, px².
    """
    from scipy.ndimage import gaussian_filter, shift, spline_filter

    first, last, _ = rows.indices(code.shape[-2])
    above = min(first, MARGIN)
    code = code[..., first - above : last + MARGIN, :]
    kept = slice(above, above + last - first)
    sigma = tuple(max(v, 0.0) ** 0.5 for v in blur)
    alike = code.ndim == 3 and np.ptp(right) == 0
    moved = []
    for shot in code.astype(np.float64):
        layers = [shot] if shot.ndim == 2 else shot
        smooth = [gaussian_filter(one, sigma, mode="nearest") for one in layers]
        splines = [spline_filter(np.pad(one, 4, mode="edge"), order=3) for one in smooth]
        places = right[:1] if alike else right
        bands = [
            shift(splines[k % len(splines)], (down, x), order=3, mode="nearest", prefilter=False)[4:-4, 4:-4][kept]
            for k, x in enumerate(places)
        ]
        moved.append(np.repeat(bands, len(right), axis=0) if alike else np.stack(bands))
    return np.stack(moved)


@dataclass(frozen=True, kw_only=True, eq=False)
class Refined:
    """Model that predicts held-out pixels best, and standard errors by name, as `parameters` has them.

    Attributes
    ----------
    held_out : root mean square error of predicting them, with the first and the best model.
    """

    model: Model
    errors: dict[str, float]
    held_out: tuple[float, float]


def parameters(capture: Capture) -> list[str]:
    """Names of what is estimated: a dispersion where there is one, and gains against the mean where there are shots."""
    place = ["dy", "dx"] if capture.dispersion is None or capture.bands < 2 else ["dy", "dx", "scale"]
    return [*place, "blur_y", "blur_x", *(f"gain_{q}" for q in range(1, len(capture.snapshots)))]


def refine(capture: Capture, model: Model, rounds: int = MOST_ROUNDS) -> Refined:
    """Improve a model until it settles."""
    kept = (np.random.default_rng(0).random(capture.snapshots.shape) > HELD_OUT).astype(np.float32)
    names, history = parameters(capture), []
    tried: list[tuple[float, Model, np.ndarray]] = []
    scale = _units(capture, names)
    for _ in range(rounds):
        error, step, step_errors = _look(capture, model, kept, names)
        tried.append((error, model, step_errors))
        history.append((_vector(model, names) * scale, step * scale))
        wanted = _extrapolated(history)
        if np.abs(wanted).max() < SETTLED:
            break
        model = _moved_on(model, names, wanted / scale)
    best = min(tried, key=lambda one: one[0])
    errors = dict(zip(names, (PART * best[2]).tolist(), strict=True))
    return Refined(model=best[1], errors=errors, held_out=(tried[0][0], best[0]))


def _units(capture: Capture, names: Sequence[str]) -> np.ndarray:
    """Factors that turn parameters into px, px² and shares of a gain."""
    last = float(np.abs(capture.displacements).max())
    return np.array([last if name == "scale" else 1.0 for name in names])


def _vector(model: Model, names: Sequence[str]) -> np.ndarray:
    known = dict(zip(("dy", "dx", "scale", "blur_y", "blur_x"), (*model.place, *model.blur), strict=True))
    known |= {f"gain_{q}": float(g) for q, g in enumerate(model.log_gains)}
    return np.array([known[name] for name in names])


def _moved_on(model: Model, names: Sequence[str], step: np.ndarray) -> Model:
    new = dict(zip(names, _vector(model, names) + step, strict=True))
    place = (
        float(np.clip(new["dy"], -FARTHEST, FARTHEST)),
        float(np.clip(new["dx"], -FARTHEST, FARTHEST)),
        float(new.get("scale", 0.0)),
    )
    gains = np.array([model.log_gains[0], *(new[name] for name in names if name.startswith("gain_"))])
    gains[0] = -gains[1:].sum()
    return replace(
        model, place=place, blur=(max(float(new["blur_y"]), 0.0), max(float(new["blur_x"]), 0.0)), log_gains=gains
    )


def _look(
    capture: Capture, model: Model, kept: np.ndarray, names: Sequence[str]
) -> tuple[float, np.ndarray, np.ndarray]:
    """Error of predicting held-out pixels; the step that predicts them better, and its standard errors."""
    code = np.clip(capture.codes(model), 0, None)
    H = capture.operator(code)
    cube = solve(EigenTV(max_iter=ITERATIONS), Weighted(H, kept), capture.snapshots * kept).x
    out = kept == 0
    seen = H.forward(cube)
    rest = (capture.snapshots - seen)[out].astype(np.float64)
    slopes = np.stack([slope[out] for slope in _slopes(capture, model, cube, seen, code, names)], axis=1).astype(
        np.float64
    )
    # Cauchy's weights: edges that a reconstruction misses should not decide.
    typical = max(float(np.median(np.abs(rest))), 1e-12)
    weight = 1 / (2 * typical**2 + rest**2)
    curvature = (slopes * weight[:, None]).T @ slopes
    curvature += 1e-9 * np.diag(np.diag(curvature)) + np.finfo(float).tiny * np.eye(len(names))
    inverse = np.linalg.inv(curvature)
    # What a reconstruction misses is alike over many pixels: the tiles of the detector are the samples, not the pixels.
    sums = _by_tile(slopes * (weight * rest)[:, None], out)
    errors = np.sqrt(np.maximum(np.diag(inverse @ (sums.T @ sums) @ inverse), 0))
    return float(np.sqrt(np.square(rest).mean())), inverse @ (slopes.T @ (weight * rest)), errors


def _by_tile(values: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Sums of values (pixel, parameter), of the pixels where `out` (shot, y, x) is true, over each tile of the detector."""
    _, ny, nx = out.shape
    tile = (np.arange(ny)[:, None] * TILES // ny) * TILES + np.arange(nx) * TILES // nx
    of_pixel = np.broadcast_to(tile, out.shape)[out]
    return np.stack([np.bincount(of_pixel, weights=column, minlength=TILES**2) for column in values.T], axis=1)


def _slopes(
    capture: Capture, model: Model, cube: np.ndarray, seen: np.ndarray, code: np.ndarray, names: Sequence[str]
) -> list[np.ndarray]:
    """How the snapshots of a cube change with each parameter."""
    h = DIFFERENCE
    down = capture.operator((capture.codes(model, down=h) - capture.codes(model, down=-h)) / (2 * h))
    right = capture.operator((capture.codes(model, right=h) - capture.codes(model, right=-h)) / (2 * h))
    found = {"dy": down.forward(cube), "dx": right.forward(cube)}
    if "scale" in names:
        found["scale"] = right.forward(cube * capture.displacements.astype(np.float32)[:, None, None])
    for name, wider in (("blur_y", (WIDENING, 0.0)), ("blur_x", (0.0, WIDENING))):
        found[name] = capture.operator((capture.codes(model, wider=wider) - code) / WIDENING).forward(cube)
    shots = np.arange(len(seen))
    for q in shots[1:]:
        # The gains' mean stays: what one shot gains, the first one loses.
        found[f"gain_{q}"] = seen * ((shots == q) - 1.0 * (shots == 0)).astype(np.float32)[:, None, None]
    return [found[name] for name in names]


def _extrapolated(history: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Step from the last model to where the steps seen so far point: those of the last models, combined to be small."""
    (x, f), before = history[-1], history[:-1][-5:]
    step = 2.0 * f
    if before:
        dx = np.stack([x - a for a, _ in before], axis=1)
        df = np.stack([f - b for _, b in before], axis=1)
        weight = np.linalg.lstsq(df, f, rcond=0.05)[0]
        step = 2.0 * (f - df @ weight) - dx @ weight
    return np.clip(step, -STEP, STEP)
