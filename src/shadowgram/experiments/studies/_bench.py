"""What the studies of section 2.5 share: the bench of the dissertation with a finite aperture, and a sensor with its faults.

The bench is that of `read_bench("salazar2022")`. With fewer elements its mask is narrower and the spectral plane, β mask widths
long, nearer; a mask position s is scaled by `like`, so that the mask stands where it stood, and moves and blurs by as many columns.

The sensor has 12 bits, a full well of 10 000 electrons, 5 electrons of read noise, a pattern of dark levels, and pixels that differ
by 1 % in sensitivity. Every capture is exposed so that its brightest pixel is at 80 % of the full well, whatever the aperture lets
through: what a small aperture costs is time. Captures of a calibration are averages of eight frames.

Left out: diffraction. At f/160 it makes a point of the image 88 µm wide, 4.5 elements of the mask; at f/32 it is one element.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from shadowgram import noise
from shadowgram.experiments.source import SceneSource
from shadowgram.spectral.bench import Bench, read_bench
from shadowgram.spectral.calibration import Calibration, calibrate
from shadowgram.spectral.continuous import ContinuousSSCSI
from shadowgram.spectral.sscsi import SSCSI

FULL_SIZE = 256  # columns of the bench's detector
WAVELENGTHS = (480.0, 620.0)
SOURCE_TABLE = {0.004: (43.0, 40.0), 0.0078: (22.0, 28.0), 0.011: (16.0, 20.0)}
"""Table 2.4: s → (theoretical, experimental) Δλ, nm."""

FRAMES = 8  # averaged for every capture of a calibration
OVERSAMPLING = 2  # scene pixels a detector element, each way
LEVELS = 4095
BRIGHTEST = 0.8  # of the full well
BLACK, BLACK_SPREAD = 64.0, 3.0  # dark level and its pattern, digital numbers
UNEVENNESS = 0.01  # standard deviation of the pixels' sensitivities


def like(mask_position: float, size: int) -> float:
    """Position on a detector of `size` columns, at which the mask stands as at `mask_position` on the whole bench."""
    return mask_position * FULL_SIZE / size


def bench_of(size: int, f_number: float | None, wavelengths: tuple[float, float] = WAVELENGTHS) -> Bench:
    """The dissertation's bench with `size` × `size` elements; in part of its range the spectral plane is the shorter."""
    bench = read_bench("salazar2022")
    share = (wavelengths[1] - wavelengths[0]) / (WAVELENGTHS[1] - WAVELENGTHS[0])
    return replace(
        bench,
        detector_shape=(size, size),
        wavelengths=wavelengths,
        measured_ratio=bench.dispersion_ratio * share,
        f_number=float("inf") if f_number is None else f_number,
    )


def aperture_name(f_number: float | None) -> str:
    """For legends."""
    return "ideal aperture" if f_number is None else f"f/{f_number:g}"


@dataclass(frozen=True, kw_only=True, eq=False)
class Sensor:
    """A sensor with faults; what it reads is in digital numbers.

    Attributes
    ----------
    dark : (y, x) reading without light.
    gain : (y, x) relative sensitivity.
    seed : of the noise.
    """

    dark: np.ndarray
    gain: np.ndarray
    seed: int

    def read(self, light: np.ndarray, *, capture: int, frames: int = 1, full: float | None = None) -> np.ndarray:
        """Mean of some frames.

        Parameters
        ----------
        light : (…, y, x), any unit.
        capture : number of the capture in the session; each has noise of its own.
        frames : averaged.
        full : light that fills the well; by default the exposure puts the brightest pixel at `BRIGHTEST`.
        """
        full = exposure(light) if full is None else full
        total = np.zeros(light.shape)
        for frame in range(frames):
            total += noise.sensor(
                light * self.gain, seed=1_000_000 * self.seed + 1000 * capture + frame, saturation=full
            )
        return (total * (LEVELS / (full * frames)) + self.dark).astype(np.float32)


def exposure(light: np.ndarray) -> float:
    """Light that fills the well when the brightest pixel is at `BRIGHTEST` of it."""
    return float(light.max()) / BRIGHTEST


def make_sensor(shape: tuple[int, int], seed: int) -> Sensor:
    """A sensor with dark levels and sensitivities of its own, as `seed` draws them.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.experiments.studies._bench import make_sensor
    >>> sensor = make_sensor((32, 32), seed=0)
    >>> reading = sensor.read(np.ones((32, 32)), capture=0, frames=4)
    >>> round(float(reading.mean()) / 4095, 2)  # 80 % of the full well, and the dark level
    0.82
    """
    rng = np.random.default_rng(seed)
    return Sensor(
        dark=np.rint(rng.normal(BLACK, BLACK_SPREAD, shape)),
        gain=rng.normal(1, UNEVENNESS, shape).clip(0.9, 1.1),
        seed=seed,
    )


def white_captures(imager: SSCSI, code: np.ndarray, pupil: float, bands: int) -> np.ndarray:
    """Light of a white board in one of `bands` even bands at a time, (shot, band, y, x), in the units of the imager's snapshots."""
    camera = ContinuousSSCSI(imager=imager, bands=bands, pupil=pupil)
    return camera.white_captures(code, np.linspace(*imager.wavelengths, bands + 1))


def calibrated(sensor: Sensor, white: np.ndarray, wavelengths: np.ndarray, pitch: float) -> Calibration:
    """Capture a white board (shot, band, y, x), darkness, and the board without the mask, and calibrate."""
    shape = white.shape[2:]
    return calibrate(
        sensor.read(white, capture=1, frames=FRAMES),
        wavelengths=wavelengths.tolist(),
        pitch=pitch,
        dark=sensor.read(np.zeros(shape), capture=2, frames=FRAMES, full=1.0),
        flat=sensor.read(np.ones(shape), capture=3, frames=FRAMES),
        saturation=LEVELS,
    )


@lru_cache(maxsize=1)
def _fine_scene(source: SceneSource, bands: int, side: int, wavelengths: tuple[float, float]) -> np.ndarray:
    """Values (band, y, x), kept for the next task of the process."""
    values = source.cube(bands, (side, side), wavelengths).values
    values.flags.writeable = False
    return values


def range_of(scene: SceneSource) -> tuple[float, float]:
    """The bench's wavelengths, as far as the scene has them."""
    (low, high), (first, last) = WAVELENGTHS, scene.wavelengths
    if min(high, last) - max(low, first) < (high - low) / 2:
        raise ValueError(
            f"{scene.name} covers {first:g} to {last:g} nm; this study needs at least half of {low:g} to {high:g} nm"
        )
    return max(low, first), min(high, last)


@dataclass(frozen=True, kw_only=True, eq=False)
class Session:
    """What a session on the bench brings home.

    Attributes
    ----------
    calibration : from the white captures.
    snapshots : (shot, y, x) of the scene, in its units.
    level : of these snapshots, for an open mask before a white board in one band.
    truth : (band, y, x).
    blur : of the mask, code columns.
    """

    calibration: Calibration
    snapshots: np.ndarray
    level: float
    truth: np.ndarray
    blur: float


def record(scene: SceneSource, imager: SSCSI, code: np.ndarray, *, pupil: float, bands: int, seed: int) -> Session:
    """Calibrate in the bands of the imager, then record the scene in `bands` fine ones."""
    sensor = make_sensor(imager.detector_shape, seed)
    white = white_captures(imager, code, pupil, imager.resolution.bands)
    calibration = calibrated(sensor, white, imager.resolution.wavelengths, imager.detector_pitch)
    fine = _fine_scene(scene, bands, imager.detector_shape[0] * OVERSAMPLING, imager.wavelengths)
    camera = ContinuousSSCSI(imager=imager, bands=bands, oversampling=OVERSAMPLING, pupil=pupil)
    light = camera.operator(code).forward(fine)
    times = exposure(white) / exposure(light)
    return Session(
        calibration=calibration,
        snapshots=calibration.snapshots(sensor.read(light, capture=4), exposure=times),
        level=LEVELS / exposure(white) / calibration.scale,
        truth=camera.truth(fine),
        blur=camera.blur,
    )
