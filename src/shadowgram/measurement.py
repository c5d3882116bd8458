"""Measurements: the snapshots, and by which imager, code and noise they were made, in memory and in a file.

`capture` simulates one from a datacube; a camera's own snapshots are put into a `Measurement` by hand. Either way the file holds
all that a reconstruction needs.
"""

from __future__ import annotations

import dataclasses
import json
import os
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from . import noise as _noise
from .codes.patterns import check_code
from .operators.base import LinearOperator
from .spectral._checks import shortened
from .spectral._geometry import interval_means
from .spectral.calibration import CalibratedImager
from .spectral.cassi import CASSI, DualCASSI
from .spectral.colored import ColoredCASSI
from .spectral.continuous import ContinuousSSCSI
from .spectral.sscsi import SSCSI

if TYPE_CHECKING:
    import xarray as xr

Imager = SSCSI | CASSI | DualCASSI | ColoredCASSI | CalibratedImager
IMAGERS: tuple[type[Imager], ...] = (SSCSI, CASSI, DualCASSI, ColoredCASSI, CalibratedImager)
Spec = TypeVar("Spec")


@dataclass(frozen=True, kw_only=True)
class AWGN:
    """White Gaussian noise, as `shadowgram.noise.awgn` adds it.

    Parameters
    ----------
    snr_db : signal-to-noise ratio, dB.
    seed : of the noise.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.measurement import AWGN
    >>> AWGN(snr_db=30, seed=0).add(np.ones((1, 4, 4))).shape
    (1, 4, 4)
    """

    snr_db: float
    seed: int

    def add(self, snapshots: np.ndarray) -> np.ndarray:
        """Snapshots with this noise."""
        return _noise.awgn(snapshots, snr_db=self.snr_db, seed=self.seed)


@dataclass(frozen=True, kw_only=True, eq=False)
class Measurement:
    r"""Snapshots together with what made them.

    Parameters
    ----------
    imager : `SSCSI`, `CASSI`, `DualCASSI`, `ColoredCASSI` or `shadowgram.spectral.CalibratedImager`.
    code : (shot, \\*imager.code_shape) transmittance in [0, 1].
    snapshots : (shot, y, x) finite, as `imager.operator(code)` gives them.
    noise : what was added in a simulation; None for none, or for the noise of a real camera.
    scene : name of what was measured.

    Raises
    ------
    ValueError
        If code or snapshots do not fit the imager, or a value is not finite.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> from shadowgram.measurement import Measurement
    >>> imager = sg.CASSI(cube_shape=(3, 8, 10), wavelengths=(450, 650))
    >>> code = sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0)
    >>> Measurement(imager=imager, code=code, snapshots=np.zeros((2, 8, 12)), scene="dark room").operator.in_shape
    (3, 8, 10)
    """

    imager: Imager
    code: np.ndarray
    snapshots: np.ndarray
    noise: AWGN | None = None
    scene: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "code", check_code(self.code, self.imager.code_shape))
        snapshots = np.asarray(self.snapshots)
        if snapshots.dtype.kind not in "fiub":
            raise TypeError(f"snapshots must be real numbers, got an array of {snapshots.dtype}")
        if snapshots.shape != self.operator.out_shape:
            raise ValueError(
                f"this imager and code give snapshots of shape (shot, y, x) = {self.operator.out_shape}, got {snapshots.shape};"
                " check the number of shots and the detector's size"
            )
        if snapshots.dtype.kind != "f":
            snapshots = snapshots.astype(np.float32)
        _check_finite(snapshots, "the snapshots")
        object.__setattr__(self, "snapshots", snapshots)

    @cached_property
    def operator(self) -> LinearOperator:
        """Forward model, datacube (band, y, x) → snapshots (shot, y, x)."""
        return self.imager.operator(self.code)


def capture(
    imager: Imager,
    code: np.ndarray,
    cube: xr.DataArray | np.ndarray,
    *,
    noise: AWGN | None = None,
    fine: bool = False,
    pupil: float = 0.0,
    scene: str = "",
) -> Measurement:
    r"""Simulate the measurement of a datacube.

    Parameters
    ----------
    imager : `SSCSI`, `CASSI`, `DualCASSI`, `ColoredCASSI` or `shadowgram.spectral.CalibratedImager`.
    code : (shot, \\*imager.code_shape) transmittance in [0, 1].
    cube : (band, y, x), finite; light per band of the imager.
    noise : to be added, or None.
    fine : the cube is finer than what the imager resolves, and all of it reaches the detector, each band and pixel in its own
        place. The reconstruction then has a model error, as with a real scene; without it the same model simulates and
        reconstructs, the "inverse crime". For an `SSCSI` the cube has any number of bands, evenly spread over
        `imager.wavelengths`, and n × n pixels a detector element (`shadowgram.spectral.ContinuousSSCSI`); for the CASSI family a
        multiple of the imager's bands.
    pupil : µm; with `fine`, diameter of the lens aperture's image on the spectral plane of an `SSCSI`, which blurs the mask.
    scene : name of what was measured.

    Raises
    ------
    ValueError
        If the cube's shape or wavelengths do not match the imager, or a value is not finite.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.measurement import capture
    >>> imager = sg.SSCSI(detector_shape=(32, 32), detector_pitch=10.0, code_pitch=10.0, mask_position=0.125,
    ...                   wavelengths=(450, 650))
    >>> code = sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0)
    >>> cube = sg.scenes.chart(size=32, bands=4, seed=0, wavelengths=(450, 650))
    >>> capture(imager, code, cube).snapshots.shape
    (2, 32, 32)
    """
    if fine:
        snapshots = _measured_finely(imager, code, cube, pupil)
    elif pupil:
        raise ValueError("a pupil blurs the mask between the bands of a finely resolved scene: measure with fine=True")
    else:
        check_cube(cube, imager)
        snapshots = imager.operator(code).forward(np.asarray(cube))
    if noise is not None:
        snapshots = noise.add(snapshots)
    return Measurement(imager=imager, code=code, snapshots=snapshots, noise=noise, scene=scene)


def _measured_finely(imager: Imager, code: np.ndarray, cube: xr.DataArray | np.ndarray, pupil: float) -> np.ndarray:
    values = np.asarray(cube)
    _check_values(values)
    _check_range(cube, imager)
    bands, rows, columns = values.shape
    if isinstance(imager, SSCSI):
        ny, nx = imager.detector_shape
        if rows % ny or columns != rows // ny * nx:
            raise ValueError(
                f"a finely resolved scene has n × n pixels a detector element of {ny} × {nx} (y × x), the cube has"
                f" {rows} × {columns}: resample it or choose another detector shape"
            )
        camera = ContinuousSSCSI(imager=imager, bands=bands, oversampling=rows // ny, pupil=pupil)
        return camera.operator(code).forward(values)
    if isinstance(imager, CalibratedImager):
        raise ValueError("a calibrated imager knows its own bands only: measure a cube of those bands, without fine")
    if pupil:
        raise ValueError(f"a pupil belongs to the SSCSI, whose mask is out of focus, not to {type(imager).__name__}")
    factor = bands // imager.resolution.bands
    if not factor or bands != factor * imager.resolution.bands:
        raise ValueError(
            f"a finely resolved scene has a multiple of the imager's {imager.resolution.bands} bands, the cube has {bands}"
        )
    camera = imager.finer(factor)
    check_cube(values, camera)
    code = check_code(code, imager.code_shape)
    repeated = np.repeat(code, factor, axis=1) if isinstance(imager, ColoredCASSI) else code
    snapshots = camera.operator(repeated).forward(values)
    # A cube holds light per band of the imager; a finer band holds its share of it.
    return snapshots / snapshots.dtype.type(factor)


def _check_values(values: np.ndarray) -> None:
    if values.ndim != 3:
        raise ValueError(f"the imager takes a datacube (band, y, x), got an array of shape {values.shape}")
    if values.dtype.kind not in "fiub":
        raise TypeError(f"the datacube must hold real numbers, got {values.dtype}")
    _check_finite(values, "the datacube")


def check_cube(cube: xr.DataArray | np.ndarray, imager: Imager) -> None:
    """Raise unless `cube` is what `imager` takes: (band, y, x) of its resolution, its wavelengths where known, finite."""
    values, want = np.asarray(cube), imager.resolution.cube_shape
    _check_values(values)
    if values.shape[0] != want[0]:
        raise ValueError(
            f"the imager resolves {want[0]} bands, the cube has {values.shape[0]}:"
            " choose bands or a mask position that give as many, or measure the bands of a finer cube each in its own place (fine)"
        )
    if values.shape[1:] != want[1:]:
        raise ValueError(
            f"the imager sees {want[1]} × {want[2]} pixels (y × x), the cube has {values.shape[1]} × {values.shape[2]}:"
            " crop the cube or choose another detector shape"
        )
    _check_range(cube, imager)


def _check_range(cube: xr.DataArray | np.ndarray, imager: Imager) -> None:
    """Raise if a cube that says its wavelengths has others than the imager."""
    known = getattr(cube, "coords", {})
    if "wavelength" in known:
        got, expected = np.asarray(known["wavelength"], dtype=float), imager.resolution.wavelengths
        if max(abs(got[0] - expected[0]), abs(got[-1] - expected[-1])) > imager.resolution.band_width:
            raise ValueError(
                f"the cube's bands lie at {got[0]:.4g} to {got[-1]:.4g} nm, those of the imager at {expected[0]:.4g} to"
                f" {expected[-1]:.4g} nm: give the imager the wavelengths of the cube"
            )


def band_means(values: np.ndarray, imager: Imager) -> np.ndarray:
    """Mean of a cube over each band of the imager: what a perfect reconstruction of a finely resolved cube would be.

    Parameters
    ----------
    values : (band, y, x), bands evenly spread over `imager.wavelengths`, or over each of the bands that have centres of their own.
    imager : says which bands are wanted.

    Returns
    -------
    (band, y, x) float array, float64 if `values` is, else float32. The last band may reach beyond the longest wavelength, where
    there is no light: its mean is that of the whole band.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> from shadowgram.measurement import band_means
    >>> imager = sg.CASSI(cube_shape=(2, 1, 1), wavelengths=(400, 600))
    >>> band_means(np.array([1.0, 3.0, 5.0, 7.0]).reshape(4, 1, 1), imager).ravel()
    array([2., 6.])
    """
    if isinstance(imager, CASSI | DualCASSI | ColoredCASSI) and imager.band_centres is not None:
        # Finer bands of these divide each band, as `finer` does, and are no more even than the bands.
        bands = imager.resolution.bands
        if len(values) % bands:
            raise ValueError(f"a cube that is finer has a multiple of the imager's {bands} bands, got {len(values)}")
        return np.asarray(values).reshape(bands, -1, *np.shape(values)[1:]).mean(axis=1)
    low, high = imager.wavelengths
    places = (imager.resolution.band_edges - low) * (len(values) / (high - low))
    return interval_means(np.asarray(values), 0, places, whole=True)


def write_measurement(measurement: Measurement, path: str | os.PathLike[str], *, configuration: str = "") -> None:
    """Write a measurement to a native file, whole or not at all.

    Parameters
    ----------
    measurement : what to write.
    path : ends in ``.nc``; an existing file is replaced.
    configuration : text that is kept in the file, such as the settings of the program that made it.

    Raises
    ------
    OSError
        If the file cannot be written.
    ValueError
        If `path` does not end in ``.nc``.

    Examples
    --------
    >>> import os, tempfile, numpy as np, shadowgram as sg
    >>> from shadowgram.measurement import Measurement, read_measurement, write_measurement
    >>> imager = sg.CASSI(cube_shape=(3, 8, 10), wavelengths=(450, 650))
    >>> code = sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = os.path.join(folder, "shots.nc")
    ...     write_measurement(Measurement(imager=imager, code=code, snapshots=np.zeros((2, 8, 12))), path)
    ...     read_measurement(path).imager == imager
    True
    """
    import xarray as xr

    from . import __version__
    from .scenes.readers.native import write_dataset

    if not os.fspath(path).endswith(".nc"):
        raise ValueError(f"a measurement is written to a file that ends in .nc, got {os.fspath(path)}")
    m = measurement
    axes = ("shot", "code_band", "code_y", "code_x") if m.code.ndim == 4 else ("shot", "code_y", "code_x")
    dataset = xr.Dataset(
        {"snapshots": (("shot", "y", "x"), m.snapshots), "code": (axes, m.code)},
        attrs={
            "kind": "measurement",
            "imager": imager_to_json(m.imager),
            "noise": "" if m.noise is None else json.dumps(dataclasses.asdict(m.noise)),
            "scene": m.scene,
            "configuration": configuration,
            "shadowgram_version": __version__,
        },
    )
    write_dataset(dataset, path)


def read_measurement(path: str | os.PathLike[str]) -> Measurement:
    """Read a measurement that `write_measurement` wrote.

    Raises
    ------
    OSError
        If the file cannot be read or is damaged.
    ValueError
        If it is not a measurement, or its contents do not fit together.
    """
    from .scenes.readers.native import read_dataset

    dataset = read_dataset(path)
    attributes = dataset.attrs
    if attributes.get("kind") != "measurement" or not {"snapshots", "code"} <= set(dataset.data_vars):
        raise ValueError(f"{os.fspath(path)} is not a measurement; make one with 'shadowgram capture'")
    try:
        noise = _text(attributes, "noise")
        return Measurement(
            imager=imager_from_json(_text(attributes, "imager")),
            code=dataset["code"].values,
            snapshots=dataset["snapshots"].values,
            noise=_from_fields(AWGN, _fields(noise, "the noise")) if noise else None,
            scene=_text(attributes, "scene"),
        )
    except (ValueError, TypeError) as error:
        raise ValueError(f"{os.fspath(path)} is not a valid measurement: {error}") from error


def imager_to_json(imager: Imager) -> str:
    """Imager as JSON text: its type's name and its parameters."""
    return json.dumps({"type": type(imager).__name__, **dataclasses.asdict(imager)})


def imager_from_json(text: str) -> Imager:
    """Imager from the text that `imager_to_json` gives.

    Raises
    ------
    ValueError
        If the text is not the description of a known imager.

    Examples
    --------
    >>> from shadowgram.measurement import imager_from_json
    >>> imager_from_json('{"type": "CASSI", "cube_shape": [3, 8, 10], "wavelengths": [450, 650]}').code_shape
    (8, 10)
    """
    fields = _fields(text, "the imager")
    name = fields.pop("type", None)
    known = {kind.__name__: kind for kind in IMAGERS}
    if not isinstance(name, str) or name not in known:
        raise ValueError(f"the imager must be one of {', '.join(known)}, got {shortened(name)}")
    return _from_fields(known[name], fields)


def _fields(text: str, what: str) -> dict[str, object]:
    try:
        fields = json.loads(text)
    except (ValueError, RecursionError):
        fields = None
    if not isinstance(fields, dict):
        raise ValueError(f"the description of {what} is not a JSON object")
    return fields


def _from_fields(kind: type[Spec], fields: dict[str, object]) -> Spec:
    """Dataclass with exactly its fields, each of its type."""
    from pydantic import TypeAdapter, ValidationError

    names = {field.name for field in dataclasses.fields(kind)}  # type: ignore[arg-type]  # callers give a dataclass
    if unknown := set(fields) - names:
        raise ValueError(f"{kind.__name__} has no parameter {shortened(min(unknown))}")
    try:
        # By way of JSON, where a list is a tuple even in strict mode.
        return TypeAdapter(kind).validate_json(json.dumps(fields), strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        message = first["msg"].removeprefix("Value error, ")
        raise ValueError(f"{kind.__name__}: {where + ': ' if where else ''}{message}") from None


def _text(attributes: dict[str, object], name: str) -> str:
    value = attributes.get(name, "")
    if not isinstance(value, str):
        raise ValueError(f"its {name} is not text")
    return value


def _check_finite(values: np.ndarray, what: str) -> None:
    if values.dtype.kind == "f":
        bad = values.size - int(np.count_nonzero(np.isfinite(values)))
        if bad:
            raise ValueError(
                f"{what} must be finite, but {bad} of {values.size} values are NaN or infinite: fill or crop them"
            )
