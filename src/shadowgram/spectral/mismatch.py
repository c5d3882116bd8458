"""How a camera differs from its model, estimated from a capture of any scene: mask, dispersion, blur, gains, dark level.

First, windows of a few pixels, in each of which every band has one brightness, show the dark level and about where the mask is;
then reconstructions from most of the pixels are asked to predict the others. docs/decisions/0014-mismatch.md has the measurements.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from shadowgram.codes.patterns import check_code
from shadowgram.operators.base import LinearOperator

from . import _mismatch_fit as windowed
from ._mismatch_windows import windows_of
from .calibration import CalibratedImager, real_captures
from .cassi import CASSI
from .colored import ColoredCASSI

if TYPE_CHECKING:
    from ._mismatch_refine import Model, Refined

MOST_WINDOWS = 6000
MOST_ROWS = 256  # of the detector that reconstructions are made of
CERTAIN = 3.0  # standard errors from which something is corrected
# What simulated captures of real scenes were wrong by, beside the scatter: px of dy and dx, and of the last band's displacement;
# px² of the blur; share of a gain.
SYSTEMATIC = {"dy": 0.05, "dx": 0.08, "scale": 0.15, "blur_y": 0.08, "blur_x": 0.08}
SYSTEMATIC_GAIN = 0.01

MovableImager = CASSI | ColoredCASSI | CalibratedImager


@dataclass(frozen=True, kw_only=True, eq=False)
class Mismatch:
    """What is wrong with a model, with standard errors, and the model put right.

    Attributes
    ----------
    dy, dx, dy_error, dx_error : px; the mask is this much further down and further right than the code says.
    dispersion, dispersion_error : true displacement of the bands over that of the imager; 1 ± 0 of an imager that is calibrated.
    blur, blur_errors : (y, x) px²; variance of what blurs the mask's image beside what the code shows.
    gains, gain_errors : (shot,); brightness of each shot over their geometric mean. 1 ± 0 of a single shot.
    offsets, offset_errors : (shot,) dark level, in the units of the snapshots.
    held_out : root mean square error, in the units of the snapshots, with which a reconstruction predicts pixels that it was not
        given: with the model as it was, dark level subtracted, and with the best one.
    imager, code : with what exceeds three standard errors put right. A wrong dispersion takes a `ColoredCASSI`, whose code is
        another one in every band.
    snapshots : (shot, y, x) float32 without offsets and gains.
    displaced : (band,) px; how far right of its place each band of a cube that `operator` explains lies.
    """

    dy: float
    dx: float
    dispersion: float
    blur: tuple[float, float]
    gains: np.ndarray
    offsets: np.ndarray
    dy_error: float
    dx_error: float
    dispersion_error: float
    blur_errors: tuple[float, float]
    gain_errors: np.ndarray
    offset_errors: np.ndarray
    held_out: tuple[float, float]
    imager: MovableImager
    code: np.ndarray
    snapshots: np.ndarray
    displaced: np.ndarray

    @property
    def operator(self) -> LinearOperator:
        """Forward model put right: datacube (band, y, x) → `snapshots`."""
        return self.imager.operator(self.code)

    def aligned(self, cube: np.ndarray) -> np.ndarray:
        """A cube (band, y, x) that `operator` explains, with its bands moved onto each other."""
        from scipy.ndimage import shift

        if not self.displaced.any():
            return cube
        pairs = zip(cube, self.displaced, strict=True)
        return np.stack([shift(band, (0, -right), order=3, mode="nearest") for band, right in pairs])

    def __str__(self) -> str:
        before, after = self.held_out
        gains = ", ".join(f"{g:.4g} ± {e:.1g}" for g, e in zip(self.gains, self.gain_errors, strict=True))
        offsets = ", ".join(f"{o:.4g} ± {e:.1g}" for o, e in zip(self.offsets, self.offset_errors, strict=True))
        blur = " × ".join(f"{v:.2f} ± {e:.1g}" for v, e in zip(self.blur, self.blur_errors, strict=True))
        blur += " px² (y × x, variance)"
        lines = {
            "mask": f"{self.dy:+z.3f} ± {self.dy_error:.1g} px down, {self.dx:+z.3f} ± {self.dx_error:.1g} px right",
            "dispersion": f"{self.dispersion:.5f} ± {self.dispersion_error:.1g} of the imager's",
            "blur": blur,
            "gains": gains,
            "dark level": offsets,
            "held-out error": f"{before:.4g} → {after:.4g}",
        }
        return "\n".join(f"{name:<16}{text}" for name, text in lines.items())


def estimate_mismatch(imager: MovableImager, code: np.ndarray, snapshots: ArrayLike) -> Mismatch:
    r"""How the camera that took some snapshots differs from the model of it.

    Parameters
    ----------
    imager : `CASSI`, `ColoredCASSI` or `CalibratedImager`.
    code : (shot, \\*imager.code_shape) transmittance in [0, 1], as measured or designed.
    snapshots : (shot, y, x) of any scene that has light and structure. Dark parts are what shows the dark level.

    Returns
    -------
    Mismatch

    Raises
    ------
    TypeError
        If the snapshots are not real numbers, or the imager is of another kind.
    ValueError
        If code or snapshots do not fit, the snapshots are constant, or too small.

    Notes
    -----
    The dark level comes from windows of a few pixels with 2.5 values for each band; in each, all bands have a brightness of their
    own, found by least squares for every trial (variable projection). So do the whole pixels, up to 2, by which the mask is out
    of place, and the start for `dy`. Then `EigenTV` reconstructs the lightest 256 rows from four fifths of the pixels, and the
    derivatives of the snapshots of that cube by the parameters tell which change would predict the other fifth better; at most
    8 rounds. Standard errors add what simulated captures of real scenes were wrong by, which decides mostly: 0.05 px down, 0.08 px
    right, 0.15 px at the last band, 0.08 px² of blur, 1 % of gains.

    Neighbouring bands see the same mask a step apart, so that a shift along the dispersion looks much like a shift of the spectrum
    and of the scene, and half a step also like a blur along x: `dx` and the dispersion are the least certain, and least harmful.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> imager = sg.CASSI(cube_shape=(4, 64, 64), wavelengths=(450, 650), band_shift=2)
    >>> code = sg.codes.random(shots=2, shape=imager.code_shape, seed=0)
    >>> scene = np.zeros((4, 64, 64), np.float32)
    >>> scene[:, 12:52, 12:52] = np.array([0.2, 0.5, 0.7, 0.3])[:, None, None]
    >>> moved = np.roll(code, 1, axis=1)
    >>> found = sg.spectral.estimate_mismatch(imager, code, imager.operator(moved).forward(scene) + 0.5)
    >>> abs(found.dy - 1) < 0.1, abs(found.dx) < 0.1, found.offsets.round(1).tolist()
    (True, True, [0.5, 0.5])
    """
    from ._mismatch_refine import Capture, Model, refine

    code, values = checked_problem(imager, code, snapshots)
    windows = windows_of(imager.operator(code), values, MOST_WINDOWS)
    offsets, offset_errors, start = _first_look(windows)
    rows = lightest_rows(values, offsets)
    capture = Capture(
        code=code,
        snapshots=(values[:, rows] - offsets[:, None, None]).astype(np.float32),
        rows=rows,
        dispersion=None if isinstance(imager, CalibratedImager) else imager._dispersion,
        bands=imager.cube_shape[0],
    )
    none = Model(place=(0.0, 0.0, 0.0), blur=(0.0, 0.0), log_gains=np.zeros(len(values)))
    before = refine(capture, none, rounds=1).held_out[0]
    refined = refine(capture, Model(place=(*start, 0.0), blur=none.blur, log_gains=none.log_gains))
    return _result(imager, code, values, (offsets, offset_errors), capture.displacements, refined, before)


def _first_look(windows: windowed.Windows) -> tuple[np.ndarray, np.ndarray, tuple[float, float]]:
    """Dark level, its standard errors, and place of the mask (dy, dx): whole pixels, and then dy."""
    everywhere = windowed.spread_out(windows, windowed.MOST_ALL)
    offsets = np.zeros(windows.shots)
    floor = windowed.noise_floor(everywhere, offsets)
    offsets, _ = windowed.fit_offsets(everywhere, (0.0, 0.0), offsets, floor)
    lit = windowed.lit(windows, offsets, windowed.MOST_LIT)
    place = best_place(lit, offsets)
    place = windowed.fit_down(lit, place, offsets, windowed.noise_floor(lit, offsets))[0], place[1]
    offsets, errors = windowed.fit_offsets(everywhere, place, offsets, floor)
    return offsets, errors, place


def best_place(lit: windowed.Windows, offsets: np.ndarray) -> tuple[float, float]:
    """Whole pixels, down and right, by which the mask is out of place; 0 unless another place is clearly better."""
    few = windowed.spread_out(lit, windowed.MOST_SEARCHED)
    scores = windowed.search(few, offsets, windowed.noise_floor(few, offsets))
    dy, dx = min(scores, key=lambda at: float(scores[at].mean()))
    if windowed.worse_by(scores[dy, 0], scores[dy, dx], few.tile) < windowed.CLEAR:
        dx = 0
    if windowed.worse_by(scores[0, dx], scores[dy, dx], few.tile) < windowed.CLEAR:
        dy = 0
    return float(dy), float(dx)


def lightest_rows(values: np.ndarray, offsets: np.ndarray) -> slice:
    """The rows with most light that are worth a reconstruction."""
    light = (values - offsets[:, None, None]).sum(axis=(0, 2))
    count = min(MOST_ROWS, len(light))
    sums = np.convolve(light, np.ones(count), mode="valid")
    first = int(sums.argmax())
    return slice(first, first + count)


def _result(
    imager: MovableImager,
    code: np.ndarray,
    values: np.ndarray,
    dark: tuple[np.ndarray, np.ndarray],
    displacements: np.ndarray,
    refined: Refined,
    before: float,
) -> Mismatch:
    model, last = refined.model, max(float(displacements.max()), 1.0)
    errors = {}
    for name, error in refined.errors.items():
        floor = SYSTEMATIC.get(name, SYSTEMATIC_GAIN) / (last if name == "scale" else 1)
        errors[name] = math.hypot(error, floor)
    gains, shots = np.exp(model.log_gains), len(values)
    gain_errors = gains * [max((e for n, e in errors.items() if n.startswith("gain")), default=0.0)] * np.ones(shots)
    corrected, moved, displaced = _put_right(imager, code, _certain(model, errors), displacements)
    return Mismatch(
        dy=model.place[0],
        dx=model.place[1],
        dispersion=1 + model.place[2],
        blur=model.blur,
        gains=gains,
        offsets=dark[0],
        dy_error=errors["dy"],
        dx_error=errors["dx"],
        dispersion_error=errors.get("scale", 0.0),
        blur_errors=(errors["blur_y"], errors["blur_x"]),
        gain_errors=gain_errors,
        offset_errors=dark[1],
        held_out=(before, refined.held_out[1]),
        imager=corrected,
        code=moved,
        snapshots=((values - dark[0][:, None, None]) / gains[:, None, None]).astype(np.float32),
        displaced=displaced,
    )


def _certain(model: Model, errors: dict[str, float]) -> dict[str, float]:
    """What is worth correcting; the rest is 0."""
    found = dict(zip(("dy", "dx", "scale", "blur_y", "blur_x"), (*model.place, *model.blur), strict=True))
    return {name: value if abs(value) > CERTAIN * errors.get(name, math.inf) else 0.0 for name, value in found.items()}


def checked_problem(imager: object, code: np.ndarray, snapshots: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Code and snapshots of an imager whose mask can move, or say what is wrong with them."""
    if not isinstance(imager, CASSI | ColoredCASSI | CalibratedImager):
        raise TypeError(
            f"the model of a CASSI, a ColoredCASSI or a CalibratedImager is checked, got {type(imager).__name__}"
        )
    code = check_code(code, imager.code_shape)
    values = real_captures("the snapshots", snapshots, ("shot", "y", "x"))
    if values.shape != imager.operator(code).out_shape:
        raise ValueError(
            f"this imager and code give snapshots of shape (shot, y, x) = {imager.operator(code).out_shape}, got {values.shape}"
        )
    for shot, image in enumerate(values):
        if image.min() == image.max():
            raise ValueError(f"shot {shot} is {image.flat[0]:g} in every pixel: it shows nothing; capture it again")
    return code, values


def _put_right(
    imager: MovableImager, code: np.ndarray, wrong: dict[str, float], displacements: np.ndarray
) -> tuple[MovableImager, np.ndarray, np.ndarray]:
    """Imager and code with the code of each band moved, one code for all bands where they move alike; and by how much more or less.

    `wrong` has dy, dx, scale, blur_y and blur_x.
    """
    from ._mismatch_refine import moved_code

    if not any(wrong.values()):
        return imager, code, np.zeros(len(displacements))
    displaced = wrong["scale"] * displacements
    blur = wrong["blur_y"], wrong["blur_x"]
    moved = np.clip(moved_code(code, wrong["dy"], wrong["dx"] + displaced, blur), 0, 1).astype(np.float32)
    if not isinstance(imager, CASSI):
        return imager, moved, displaced
    if not displaced.any():
        return imager, moved[:, 0], displaced
    fields = {field.name: getattr(imager, field.name) for field in dataclasses.fields(imager)}
    return ColoredCASSI(**fields), moved, displaced
