"""The imager that the options of `codes design` and `codes analyse` describe, where no scene says its size."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .arguments import parse_size, parse_wavelengths, read_curve

if TYPE_CHECKING:
    from shadowgram.spectral.cassi import CASSI, DualCASSI
    from shadowgram.spectral.colored import ColoredCASSI
    from shadowgram.spectral.sscsi import SSCSI

    Camera = SSCSI | CASSI | DualCASSI | ColoredCASSI

PITCH = 10.0  # µm
SIZE = (256, 256)
RANGE = (450.0, 650.0)  # nm; no code depends on it, but for a measured dispersion


class Kind(StrEnum):
    """Imagers whose codes are designed."""

    sscsi = "sscsi"
    cassi = "cassi"
    dual = "dual"
    colored = "colored"


class Shear(StrEnum):
    """How a model averages the code of a band."""

    exact = "exact"
    centre = "centre"
    edge = "edge"


DetectorShape = Annotated[
    str | None, typer.Option(help="SSCSI: detector elements y x x; CASSIs: pixels of the scene.", show_default=False)
]
DetectorPitch = Annotated[float | None, typer.Option(help="Side of a detector element, µm.", show_default="10")]
CodePitch = Annotated[
    float | None, typer.Option(help="SSCSI: side of a code element, µm; by default that of the detector.")
]
MaskPosition = Annotated[
    float | None, typer.Option(help="SSCSI: s in [0, 1); with --bench by default as far as it reaches.")
]
Bands = Annotated[
    int | None,
    typer.Option(min=1, help="Bands to resolve; for an SSCSI instead of --mask-position.", show_default=False),
]
Wavelengths = Annotated[
    str | None, typer.Option(help="Shortest and longest wavelength, nm, which matter with --dispersion.")
]
DispersionRatio = Annotated[
    float | None,
    typer.Option(help="SSCSI: length of the spectral plane over that of the mask, β.", show_default="1"),
]
ShearOption = Annotated[
    Shear | None,
    typer.Option(
        help="How the model spreads a band: SSCSI exact, centre or edge; CASSIs centre or exact (higher order).",
        show_default="exact; CASSIs centre",
    ),
]
BandShift = Annotated[
    float | None, typer.Option(help="CASSIs: pixels of dispersion a band, any positive number.", show_default="1")
]
Dispersion = Annotated[Path | None, typer.Option(help="CASSIs: measured curve instead, a text file of lines 'nm, px'.")]
BenchOption = Annotated[
    str | None,
    typer.Option(metavar="FILE|NAME", help="SSCSI: TOML file of a bench, or salazar2022; instead of the geometry."),
]


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """The options as they were typed; None where they were not."""

    kind: Kind | None
    detector_shape: str | None
    detector_pitch: float | None
    code_pitch: float | None
    mask_position: float | None
    bands: int | None
    wavelengths: str | None
    dispersion_ratio: float | None
    shear: Shear | None
    band_shift: float | None
    dispersion: Path | None
    bench: str | None

    def given(self, *but: str) -> list[str]:
        """Names of the options that were typed, without those of `but`."""
        values = {"imager" if f.name == "kind" else f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        return [
            "--" + name.replace("_", "-") for name, value in values.items() if value is not None and name not in but
        ]


def make_imager(options: Geometry, code_shape: tuple[int, ...] | None = None) -> Camera:
    """Imager of these options.

    Parameters
    ----------
    options : as typed.
    code_shape : of one shot of a code, whose size the imager takes where the options do not say one.

    Raises
    ------
    ValueError
        If options are missing, contradict each other, or make no imager.
    OSError
        If the file of a bench or of a dispersion curve cannot be read.
    """
    kind = options.kind or Kind.sscsi
    if kind != Kind.sscsi:
        common = ("imager", "detector_shape", "detector_pitch", "bands", "wavelengths")
        if wrong := options.given(*common, "shear", "band_shift", "dispersion"):
            raise ValueError(f"{' and '.join(wrong)} belong to the imager sscsi")
        return _cassi(kind, options, code_shape)
    if wrong := [name for name in options.given() if name in ("--band-shift", "--dispersion")]:
        raise ValueError(f"{' and '.join(wrong)} belong to the CASSIs; an SSCSI disperses by --mask-position")
    if options.mask_position is not None and options.bands is not None:
        raise ValueError("--mask-position and --bands say the same thing for an SSCSI: give one of them")
    return _sscsi(options, code_shape) if options.bench is None else _on_bench(options, options.bench)


def _sscsi(options: Geometry, code_shape: tuple[int, ...] | None) -> SSCSI:
    from shadowgram.spectral.sscsi import SSCSI

    if options.mask_position is None and options.bands is None:
        raise ValueError("say where the mask stands, --mask-position, or what it must resolve, --bands")
    pitch = PITCH if options.detector_pitch is None else options.detector_pitch
    camera = SSCSI(
        detector_shape=_size(options.detector_shape, None),
        detector_pitch=pitch,
        code_pitch=pitch if options.code_pitch is None else options.code_pitch,
        mask_position=0.0,
        wavelengths=_range(options),
        dispersion_ratio=1.0 if options.dispersion_ratio is None else options.dispersion_ratio,
        shear=(options.shear or Shear.exact).value,
    )
    if options.detector_shape is None and code_shape is not None:
        ny, nx = (max(1, n // camera.pitch_ratio) for n in code_shape[-2:])
        camera = dataclasses.replace(camera, detector_shape=(ny, nx))
    return dataclasses.replace(camera, mask_position=_position(options, camera))


def _on_bench(options: Geometry, name: str) -> SSCSI:
    from shadowgram.spectral.bench import read_bench

    if wrong := options.given("imager", "bench", "mask_position", "bands", "shear"):
        raise ValueError(f"a bench has its own geometry: leave out {', '.join(wrong)}, or --bench")
    bench = read_bench(name)
    reach = bench.reachable[1]
    if options.mask_position is not None or options.bands is not None:
        reach = _position(options, bench.imager(reach))
    return bench.imager(reach, shear=(options.shear or Shear.exact).value)


def _position(options: Geometry, camera: SSCSI) -> float:
    """s, or that which resolves the bands."""
    if options.bands is None:
        return options.mask_position or 0.0
    position = options.bands / (camera.dispersion_ratio * camera.code_shape[1])
    if position >= 1:
        raise ValueError(
            f"{options.bands} bands cannot be resolved with {camera.code_shape[1]} code columns: no mask position disperses"
            " them far enough; ask for fewer bands"
        )
    return position


def _cassi(kind: Kind, options: Geometry, code_shape: tuple[int, ...] | None) -> CASSI | DualCASSI | ColoredCASSI:
    from shadowgram.spectral.cassi import CASSI, DualCASSI
    from shadowgram.spectral.colored import ColoredCASSI

    bands = options.bands
    if bands is None and kind == Kind.colored and code_shape is not None and len(code_shape) == 3:
        bands = code_shape[0]
    if bands is None:
        raise ValueError("say how many --bands the CASSI resolves")
    if options.dispersion is not None and options.wavelengths is None:
        raise ValueError(
            "say the --wavelengths of the scene, such as 451:642 in nm: the curve of --dispersion is in nm"
        )
    shape = _size(options.detector_shape, code_shape)
    camera = {Kind.cassi: CASSI, Kind.dual: DualCASSI, Kind.colored: ColoredCASSI}[kind](
        cube_shape=(bands, *shape),
        wavelengths=_range(options),
        pitch=PITCH if options.detector_pitch is None else options.detector_pitch,
        shear=(options.shear or Shear.centre).value,
        band_shift=options.band_shift,
        dispersion=None if options.dispersion is None else read_curve(options.dispersion),
    )
    beside = camera.code_shape[-1] - shape[1]
    if options.detector_shape is None and code_shape is not None and 0 < beside < shape[1]:
        # The code of a dual disperser is wider than the scene.
        camera = dataclasses.replace(camera, cube_shape=(bands, shape[0], shape[1] - beside))
    return camera


def _size(given: str | None, code_shape: tuple[int, ...] | None) -> tuple[int, int]:
    if given is not None:
        return parse_size("--detector-shape", given)
    return SIZE if code_shape is None else (code_shape[-2], code_shape[-1])


def _range(options: Geometry) -> tuple[float, float]:
    return RANGE if options.wavelengths is None else parse_wavelengths(options.wavelengths)
