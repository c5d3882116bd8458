r"""The bench behind an SSCSI: from lenses, grating and pupil to α, β and the mask positions that can be reached.

::

    exit pupil       grating      lens f1        lens f2     mask  image                     detector
        |               ⋮            ()             ()         ¦   of the          ()            |
        |               ⋮            ()             ()         ¦   grating         ()            |
        |<------ p ---->|<--- f1 --->|<-- f1 + f2 ->|          ¦     |      relay, magnified      |
                                              |     |          |<-dc>|
                                              |<--- d, to the spectral plane->|

An objective images the scene on a transmission grating of G lines a length. Light falls on it along its normal and leaves at
sin θ(λ) = order·λ·G; the axis of all that follows is bent to θ(λc) of the central wavelength λc. A 4f relay images the grating with
magnification M = f2/f1, and the mask stands dc before that image; a second relay images the image on the detector.

**Spectral plane.** The rays of one wavelength that pass the middle of the objective's exit pupil leave the grating as if they came
from a point p before it and p·tan(θ(λ) − θ(λc)) beside the axis. The 4f relay stretches lengths across the axis by M and along it
by M², wherever they are. So the points of all wavelengths lie in the spectral plane, d = p·M² before the image, at

    X(λ) = p·M·tan(θ(λ) − θ(λc)),    α = mean of dX/dλ over the range,    β = length of the plane ÷ width of the mask,    s = dc/d.

Where d > f2, as on most benches, lens f2 stands in front of this plane, which is then virtual: the rays between that lens and the
image point to it all the same, and the mask meets only these.

**What d does.** The mask is sheared by s·α = dc·(dθ/dλ)·(f1/f2) a wavelength, whatever d is; d enters the stretch 1/(1 − s) alone.
With a telecentric objective (p and d infinite) s = 0 wherever the mask stands and nothing is stretched, but the shear is there:
such a bench has a spectral resolution that s cannot express. With one relay lens in place of the 4f, the spectral plane of a
telecentric objective is that lens's focal plane, of length f·θ. This is eq. (2.1), R1 = bd/(b+d)·θ, when d is read as the distance
from the lens to the sensor, since then bd/(b+d) = f.

**Pupil.** A point of the image receives a cone of f-number N, which cuts a spot of d/N out of the spectral plane for every
wavelength, and a spot of dc/N out of the mask. Shear and blur both grow with dc, so the mask's position does not matter here:
wavelengths closer than 1/(N·(dθ/dλ)·(f1/f2)), `pupil_band_width`, see the same part of the mask. To resolve Δλ, N must be at least
1/(Δλ·(dθ/dλ)·(f1/f2)). With 300 lines/mm and f1 = f2, 20 nm ask for N = 164, and this is why section 2.5.3 reports blur and little
light. Diffraction sets the other limit: a point of the image is no smaller than about λN, 90 µm there. A narrower pupil trades
detail along x for detail along λ, at a fixed product λ/((dθ/dλ)·(f1/f2)): the resolving power of the grating lines within the spot.

Left out: aberrations, and the grating's anamorphism, which shortens p by cos²θ(λc) (3 % for 300 lines/mm in green light).

Sources: Lin et al., ACM Trans. Graph. 33 (2014) 233; Salazar (2022), sections 2.2 and 2.5; Mohan et al., Comput. Graph. Forum 27
(2008) 709 for the spectral plane. The pupil rules follow from the geometry above.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from ._checks import check_count, check_pitch, check_shape, check_wavelengths
from .resolution import ROUNDING
from .sscsi import SSCSI

UM = 1000.0  # µm in a mm


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Optical bench of a spatial-spectral compressive spectral imager; the module's docstring has its physics.

    Parameters
    ----------
    grating_lines : lines per mm.
    relay_focal_lengths : (f1, f2) mm of the 4f relay between grating and mask.
    wavelengths : (shortest, longest) nm.
    detector_shape : (y, x) elements.
    detector_pitch : µm.
    code_pitch : µm, of the mask itself.
    mask_distances : (nearest, farthest) mm from the image of the grating that the mount allows, towards lens f2.
    pupil_distance : mm from the objective's exit pupil to the grating. Give this or `measured_ratio`.
    measured_ratio : β as measured: length of the spectral plane, where the mask's rays point to, ÷ width of the mask.
    magnification : of the second relay, from mask to detector; by default one mask element becomes one detector element.
    f_number : N of the cone on the image of the grating; infinite for a pinhole.
    order : of diffraction.

    Raises
    ------
    ValueError
        If the parts do not make a bench.

    Examples
    --------
    >>> import shadowgram as sg
    >>> bench = sg.spectral.Bench(
    ...     grating_lines=300, relay_focal_lengths=(75, 75), wavelengths=(480, 620), detector_shape=(256, 256),
    ...     detector_pitch=9.9, code_pitch=19.4, mask_distances=(0, 10), pupil_distance=350, f_number=160,
    ... )
    >>> round(bench.dispersion_ratio, 2), round(bench.reachable[1], 4), round(bench.pupil_band_width, 1)
    (3.0, 0.0286, 20.5)
    >>> s = sg.spectral.position_for(bench, band_width=22)
    >>> round(bench.distance(s), 2), bench.imager(s).resolution.bands
    (2.9, 7)
    """

    grating_lines: float
    relay_focal_lengths: tuple[float, float]
    wavelengths: tuple[float, float]
    detector_shape: tuple[int, int]
    detector_pitch: float
    code_pitch: float
    mask_distances: tuple[float, float]
    pupil_distance: float | None = None
    measured_ratio: float | None = None
    magnification: float | None = None
    f_number: float = math.inf
    order: int = 1

    def __post_init__(self) -> None:
        check_wavelengths(self.wavelengths)
        check_shape("detector_shape", self.detector_shape, ("y", "x"))
        check_pitch("detector_pitch", self.detector_pitch)
        check_pitch("code_pitch", self.code_pitch)
        check_count("order", self.order)
        self._check_grating()
        if len(self.relay_focal_lengths) != 2 or not all(map(_is_length, self.relay_focal_lengths)):
            raise ValueError(
                f"relay_focal_lengths must be two positive lengths in mm, got {tuple(self.relay_focal_lengths)}"
            )
        self._check_plane()
        if not self.f_number > 0:
            raise ValueError(f"f_number must be a positive number, got {self.f_number}")
        self._check_magnification()
        self._check_mount()

    def _check_grating(self) -> None:
        if not _is_length(self.grating_lines):
            raise ValueError(f"grating_lines must be a positive number of lines per mm, got {self.grating_lines}")
        sine = self._sines(self.wavelengths[1])
        if sine >= 1:
            raise ValueError(
                f"a grating of {self.grating_lines:g} lines/mm sends no light of {self.wavelengths[1]:g} nm into order"
                f" {self.order}; it takes at most {self.grating_lines / float(sine):.4g} lines/mm"
            )

    def _check_plane(self) -> None:
        if (self.pupil_distance is None) == (self.measured_ratio is None):
            raise ValueError("a bench takes either pupil_distance or measured_ratio: the other follows from it")
        if self.pupil_distance is not None and not _is_length(self.pupil_distance):
            raise ValueError(
                f"pupil_distance must be a positive length in mm, got {self.pupil_distance}; with a telecentric objective"
                " s is 0 wherever the mask stands"
            )
        if self.measured_ratio is not None and not _is_length(self.measured_ratio):
            raise ValueError(f"measured_ratio must be a positive number, got {self.measured_ratio}")

    def _check_magnification(self) -> None:
        if self.magnification is None:
            return
        if not _is_length(self.magnification):
            raise ValueError(f"magnification must be a positive number, got {self.magnification}")
        ratio = self.detector_pitch / (self.code_pitch * self.magnification)
        if ratio < 0.99 or abs(ratio / round(ratio) - 1) > 0.01:
            raise ValueError(
                f"a detector element must cover a whole number of mask elements, got {self.detector_pitch:g} µm over"
                f" {self.code_pitch:g} × {self.magnification:g} µm = {ratio:.4g}; set magnification to"
                f" {self.detector_pitch / (self.code_pitch * max(1, round(ratio))):.4g}"
            )

    def _check_mount(self) -> None:
        if len(self.mask_distances) != 2 or not 0 <= self.mask_distances[0] < self.mask_distances[1] < math.inf:
            raise ValueError(
                f"mask_distances must be (nearest, farthest) in mm, ascending from 0, got {tuple(self.mask_distances)}"
            )
        farthest, limit = self.mask_distances[1], min(self.relay_focal_lengths[1], self.plane_distance)
        if farthest >= limit:
            where = "the second relay lens" if limit == self.relay_focal_lengths[1] else "the spectral plane"
            raise ValueError(
                f"the mask cannot stand at {farthest:g} mm: {where} is {limit:.4g} mm from the image plane"
            )

    @property
    def pitch_ratio(self) -> int:
        """Mask elements per detector element, each way."""
        if self.magnification is None:
            return 1
        return round(self.detector_pitch / (self.code_pitch * self.magnification))

    @property
    def mask_width(self) -> float:
        """Mm, along x."""
        return self.detector_shape[1] * self.pitch_ratio * self.code_pitch / UM

    def _sines(self, wavelength: float | np.ndarray) -> float | np.ndarray:
        """Sine of the diffraction angle; nm · lines/mm."""
        return self.order * wavelength * self.grating_lines * 1e-6

    def _slopes(self, wavelength: np.ndarray) -> np.ndarray:
        """Tangent of the angle between a wavelength's ray and the axis, behind the grating."""
        axis = math.asin(self._sines(sum(self.wavelengths) / 2))
        return np.tan(np.arcsin(self._sines(wavelength)) - axis)

    @property
    def angular_dispersion(self) -> float:
        """Mean slope of the rays on the image of the grating per wavelength, (dθ/dλ)·(f1/f2), rad/nm."""
        low, high = self.wavelengths
        f1, f2 = self.relay_focal_lengths
        blue, red = self._slopes(np.array([low, high]))
        return float((red - blue) / (high - low) * f1 / f2)

    @property
    def plane_distance(self) -> float:
        """d, mm from the spectral plane to the image of the grating."""
        if self.pupil_distance is not None:
            f1, f2 = self.relay_focal_lengths
            return self.pupil_distance * (f2 / f1) ** 2
        low, high = self.wavelengths
        return self.dispersion_ratio * self.mask_width / (self.angular_dispersion * (high - low))

    @property
    def exit_pupil(self) -> float:
        """Mm from the objective's exit pupil to the grating, given or derived from `measured_ratio`."""
        f1, f2 = self.relay_focal_lengths
        return self.plane_distance * (f1 / f2) ** 2

    @property
    def dispersion(self) -> float:
        """α, µm on the spectral plane per nm."""
        return self.plane_distance * self.angular_dispersion * UM

    @property
    def dispersion_ratio(self) -> float:
        """β, length of the spectral plane ÷ width of the mask."""
        if self.measured_ratio is not None:
            return float(self.measured_ratio)
        low, high = self.wavelengths
        return self.plane_distance * self.angular_dispersion * (high - low) / self.mask_width

    @property
    def nonlinearity(self) -> float:
        """Largest error, nm, in the wavelength of a point of the spectral plane when α is taken for the same everywhere."""
        nm = np.linspace(*self.wavelengths, 257)
        slopes = self._slopes(nm)
        straight = np.interp(slopes, slopes[[0, -1]], nm[[0, -1]])
        return float(np.abs(straight - nm).max())

    @property
    def reachable(self) -> tuple[float, float]:
        """(smallest, largest) s."""
        nearest, farthest = self.mask_distances
        return nearest / self.plane_distance, farthest / self.plane_distance

    @property
    def pupil_band_width(self) -> float:
        """Nm; wavelengths closer than this meet the same spot of the mask, wherever it stands. 0 for a pinhole."""
        return 1 / (self.f_number * self.angular_dispersion)

    @property
    def pupil(self) -> float:
        """µm; width of the aperture's image on the spectral plane, d/N, in the scale of the detector.

        It is what `ContinuousSSCSI` takes with an imager of this bench.
        """
        scale = self.detector_pitch / self.pitch_ratio / self.code_pitch
        return self.plane_distance / self.f_number * UM * scale

    @property
    def diffraction_spot(self) -> float:
        """µm; about the least size of a point on the image of the grating, λN at the central wavelength. Infinite for a pinhole."""
        return sum(self.wavelengths) / 2 / UM * self.f_number

    def f_number_for(self, band_width: float) -> float:
        """Smallest f-number whose pupil does not blur bands of `band_width` nm into each other."""
        if not _is_length(band_width):
            raise ValueError(f"band_width must be a positive number of nm, got {band_width}")
        return 1 / (band_width * self.angular_dispersion)

    def distance(self, mask_position: float) -> float:
        """Distance dc, mm, of the mask at s from the image of the grating."""
        return mask_position * self.plane_distance

    def blur(self, mask_position: float) -> float:
        """Width, µm, of the spot through which a point of the image sees the mask at s, dc/N."""
        return self.distance(mask_position) / self.f_number * UM

    def imager(self, mask_position: float, shear: str = "exact") -> SSCSI:
        """SSCSI with the mask of this bench at s; pitches are those on the detector.

        Parameters
        ----------
        mask_position : s, within `reachable`.
        shear : as for `SSCSI`.

        Raises
        ------
        ValueError
            If the mask cannot stand there.
        """
        nearest, farthest = self.reachable
        if not nearest * (1 - ROUNDING) <= mask_position <= farthest * (1 + ROUNDING):
            raise ValueError(
                f"mask_position {mask_position:.4g} is beyond what the bench reaches, s from {nearest:.4g} to {farthest:.4g}"
                f" ({self.mask_distances[0]:g} to {self.mask_distances[1]:g} mm from the image plane)"
            )
        return SSCSI(
            detector_shape=self.detector_shape,
            detector_pitch=self.detector_pitch,
            code_pitch=self.detector_pitch / self.pitch_ratio,
            mask_position=mask_position,
            wavelengths=self.wavelengths,
            dispersion_ratio=self.dispersion_ratio,
            shear=shear,
        )


def _is_length(value: float) -> bool:
    return math.isfinite(value) and value > 0


def read_bench(path: Path | str) -> Bench:
    """Bench from a TOML file whose keys are the parameters of `Bench`.

    Parameters
    ----------
    path : of the file; or, when there is no such file, the name of a bench that comes with shadowgram, ``"salazar2022"``.

    Raises
    ------
    OSError
        If there is no such file or bench.
    ValueError
        If it is not TOML, or does not describe a bench; the message has the file and what is wrong with it.

    Examples
    --------
    >>> from shadowgram.spectral.bench import read_bench
    >>> bench = read_bench("salazar2022")
    >>> [bench.imager(s).resolution.bands for s in (0.004, 0.0078, 0.011)]
    [4, 6, 9]
    >>> round(bench.exit_pupil)
    350
    """
    import tomllib

    data = _read(path)
    try:
        values = tomllib.loads(data.decode())
    except ValueError as error:
        raise ValueError(f"{path} is not TOML: {error}") from None
    return _checked(values, str(path))


def _read(path: Path | str) -> bytes:
    from importlib.resources import files

    if Path(path).exists():
        return Path(path).read_bytes()
    folder = files("shadowgram.spectral") / "benches"
    known = {Path(f.name).stem: f for f in folder.iterdir() if f.name.endswith(".toml")}
    if str(path) not in known:
        raise FileNotFoundError(
            f"there is no bench file {path}, and the benches that come with shadowgram are {', '.join(sorted(known))}"
        )
    return known[str(path)].read_bytes()


def _checked(values: dict[str, Any], source: str) -> Bench:
    from pydantic import ConfigDict, ValidationError, create_model

    hints = get_type_hints(Bench)
    fields: dict[str, Any] = {
        f.name: (hints[f.name], ... if f.default is dataclasses.MISSING else f.default)
        for f in dataclasses.fields(Bench)
    }
    model = create_model("Bench", __config__=ConfigDict(extra="forbid", strict=True), **fields)
    # TOML has arrays where a bench has tuples.
    values = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
    try:
        return Bench(**vars(model(**values)))
    except ValidationError as error:
        faults = [_fault(dict(fault)) for fault in error.errors(include_url=False)]
        raise ValueError(f"{source}: {'; '.join(faults)}") from None
    except ValueError as error:
        raise ValueError(f"{source}: {error}") from None


def _fault(fault: dict[str, Any]) -> str:
    """One fault that pydantic found, in words."""
    where = ".".join(map(str, fault["loc"]))
    match fault["type"]:
        case "extra_forbidden":
            return f"unknown key {where!r}"
        case "missing":
            return f"the key {where!r} is missing"
        case _:
            wrong = fault["msg"].removeprefix("Input should ")
            return f"{where} should {wrong}, got {fault['input']!r}"
