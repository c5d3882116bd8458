"""Rows of a measurement: dispersion is along x, so that the rows of a detector see different rows of the scene and of the code."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from shadowgram.codes.patterns import check_code
from shadowgram.measurement import AWGN, IMAGERS, Imager, Measurement, imager_from_json
from shadowgram.spectral.sscsi import SSCSI

Range = tuple[int, int]  # first row and the one after the last, of the detector


@dataclass(frozen=True, kw_only=True)
class Header:
    """What a measurement's file says of it, without its arrays.

    Attributes
    ----------
    imager : of the whole detector.
    shots : number of them.
    scene : name of what was measured.
    double : whether the snapshots are float64, and so is the reconstruction.
    code_bytes : of an element of the code.
    """

    imager: Imager
    shots: int
    scene: str
    double: bool
    code_bytes: int


def detector_rows(imager: Imager) -> int:
    """Rows of the detector.

    Raises
    ------
    TypeError
        If it is no imager whose rows are independent.
    """
    if isinstance(imager, SSCSI):
        return imager.detector_shape[0]
    if not isinstance(imager, IMAGERS):
        raise TypeError(
            f"strips of rows are known for {', '.join(kind.__name__ for kind in IMAGERS)}, not for {type(imager).__name__}"
        )
    return imager.cube_shape[1]


def row_ratio(imager: Imager) -> int:
    """Rows of the datacube and of the code for a row of the detector; `SSCSI` takes whole ratios only."""
    return imager.pitch_ratio if isinstance(imager, SSCSI) else 1


def imager_rows(imager: Imager, rows: int) -> Imager:
    """The imager with so many rows of its detector.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.experiments._strips_rows import imager_rows
    >>> imager_rows(sg.CASSI(cube_shape=(3, 64, 32), wavelengths=(450, 650)), 16).cube_shape
    (3, 16, 32)
    """
    detector_rows(imager)
    if isinstance(imager, SSCSI):
        return dataclasses.replace(imager, detector_shape=(rows, imager.detector_shape[1]))
    bands, _, columns = imager.cube_shape
    return dataclasses.replace(imager, cube_shape=(bands, rows, columns))


def code_rows(imager: Imager, code: np.ndarray, ranges: Sequence[Range]) -> np.ndarray:
    """Rows of the code, (shot, …, y, x), in front of these rows of the detector."""
    ratio = row_ratio(imager)
    code = check_code(code, imager.code_shape)
    return np.concatenate([code[..., ratio * a : ratio * b, :] for a, b in ranges], axis=-2)


def snapshot_rows(snapshots: np.ndarray, ranges: Sequence[Range]) -> np.ndarray:
    """Rows of the snapshots (shot, y, x)."""
    return np.concatenate([snapshots[:, a:b] for a, b in ranges], axis=1)


def cut(measurement: Measurement, ranges: Sequence[Range]) -> Measurement:
    """Rows of a measurement, those of several ranges one below the other.

    Its operator gives exactly the rows of the whole one. Only where a gray code has nothing but open and closed elements in these
    rows, it is taken for a binary one, and rounding may differ.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> from shadowgram.experiments._strips_rows import cut
    >>> from shadowgram.measurement import capture
    >>> imager = sg.CASSI(cube_shape=(3, 16, 10), wavelengths=(450, 650))
    >>> cube = np.random.default_rng(0).random((3, 16, 10), np.float32)
    >>> whole = capture(imager, sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0), cube)
    >>> strip = cut(whole, [(4, 9)])
    >>> np.array_equal(strip.operator.forward(cube[:, 4:9]), whole.snapshots[:, 4:9])
    True
    """
    return Measurement(
        imager=imager_rows(measurement.imager, sum(b - a for a, b in ranges)),
        code=code_rows(measurement.imager, measurement.code, ranges),
        snapshots=snapshot_rows(measurement.snapshots, ranges),
        scene=measurement.scene,
    )


def read_header(path: Path) -> Header:
    """What the file of a measurement says of it.

    Raises
    ------
    ValueError
        If it is not a measurement that shadowgram wrote, or damaged.
    OSError
        If it cannot be opened.
    """
    from shadowgram.scenes.readers.native_parts import read_part

    found = read_part(path, {"y": slice(0, 1), "code_y": slice(0, 1)})
    attrs = found.attrs
    if attrs.get("kind") != "measurement" or not {"snapshots", "code"} <= set(found.data_vars):
        raise ValueError(f"{path} is not a measurement; make one with 'shadowgram capture'")
    snapshots = found["snapshots"]
    try:
        imager = imager_from_json(str(attrs.get("imager", "")))
    except ValueError as error:
        raise ValueError(f"{path} is not a valid measurement: {error}") from error
    return Header(
        imager=imager,
        shots=snapshots.sizes["shot"],
        scene=str(attrs.get("scene", "")),
        double=snapshots.dtype == np.float64,
        code_bytes=found["code"].dtype.itemsize,
    )


def read_rows(path: Path, header: Header, ranges: Sequence[Range]) -> Measurement:
    """Rows of the measurement in a file, as `cut` gives them, without the others in memory.

    Raises
    ------
    ValueError
        If the file is damaged, or its contents do not fit together.
    OSError
        If it cannot be opened.
    """
    from shadowgram.scenes.readers.native_parts import read_part

    ratio = row_ratio(header.imager)
    parts = [read_part(path, {"y": slice(a, b), "code_y": slice(ratio * a, ratio * b)}) for a, b in ranges]
    try:
        return Measurement(
            imager=imager_rows(header.imager, sum(b - a for a, b in ranges)),
            code=np.concatenate([part["code"].values for part in parts], axis=-2),
            snapshots=np.concatenate([part["snapshots"].values for part in parts], axis=1),
            scene=header.scene,
        )
    except ValueError as error:
        raise ValueError(f"{path} is not a valid measurement: {error}") from error


def capture_by_rows(
    imager: Imager,
    code: np.ndarray,
    scene: Callable[[int, int], np.ndarray],
    *,
    step: int = 64,
    noise: AWGN | None = None,
    name: str = "",
) -> Measurement:
    r"""Simulate the measurement of a datacube that is never whole in memory.

    Parameters
    ----------
    imager : with or without dispersion, along x.
    code : (shot, \*imager.code_shape) transmittance in [0, 1].
    scene : called as ``scene(start, stop)`` for rows of the datacube, (band, stop − start, x).
    step : rows of the detector at a time.
    noise : to be added, or None.
    name : of the scene.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> from shadowgram.experiments.strips import capture_by_rows
    >>> imager = sg.CASSI(cube_shape=(3, 100, 10), wavelengths=(450, 650))
    >>> code = sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0)
    >>> capture_by_rows(imager, code, lambda start, stop: np.ones((3, stop - start, 10), np.float32)).snapshots.shape
    (2, 100, 12)
    """
    ratio, rows = row_ratio(imager), detector_rows(imager)
    code = check_code(code, imager.code_shape)
    seen = []
    for a in range(0, rows, step):
        b = min(a + step, rows)
        part = imager_rows(imager, b - a).operator(code[..., ratio * a : ratio * b, :])
        seen.append(part.forward(scene(ratio * a, ratio * b)))
    snapshots = np.concatenate(seen, axis=1)
    if noise is not None:
        snapshots = noise.add(snapshots)
    return Measurement(imager=imager, code=code, snapshots=snapshots, noise=noise, scene=name)
