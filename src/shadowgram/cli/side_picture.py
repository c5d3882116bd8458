"""A panchromatic or colour picture of the scene beside the coded shots, for `shadowgram reconstruct --side`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from shadowgram.measurement import Measurement
    from shadowgram.operators.base import LinearOperator


# How much noisier a picture counts than the shots: it is never quite where it should be, nor its response what it should be.
_CAUTION = 2.0


class Response(StrEnum):
    """What a picture shows of the scene."""

    pan = "pan"
    rgb = "rgb"


def with_picture(path: Path, response: Response, measurement: Measurement) -> tuple[LinearOperator, np.ndarray]:
    """Operator and snapshots of the imager and the picture together.

    The exposure of the picture is found by comparing it with a first reconstruction. It is taken to be twice as noisy, relative
    to its brightness, as the shots are.

    Raises
    ------
    ValueError
        If the picture does not fit the scene, is dark, or holds values that are not finite.
    """
    import numpy as np

    from shadowgram.operators import SpectralResponse, stack
    from shadowgram.scenes import rgb_response
    from shadowgram.solvers.eigen_tv import EigenTV
    from shadowgram.solvers.solution import solve

    H, shots = measurement.operator, measurement.snapshots
    bands, rows, columns = H.in_shape
    if response == Response.pan:
        camera = SpectralResponse.pan((bands, rows, columns))
    else:
        camera = SpectralResponse(rgb_response(measurement.imager.resolution.wavelengths), (bands, rows, columns))
    picture = _read(path, camera.out_shape)
    # By the mean of each channel: pixel by pixel, the errors of the first reconstruction would dim the picture.
    expected = camera.forward(solve(EigenTV(max_iter=40), H, shots).x).mean(axis=(1, 2), dtype=np.float64)
    channels = picture.mean(axis=(1, 2))
    picture *= (expected @ channels) / max(channels @ channels, np.finfo(float).tiny)
    ratio = _CAUTION * float(np.abs(picture).mean() / np.abs(shots).mean())
    if not ratio > 0:
        raise ValueError(
            f"{path} and the shots have nothing in common: one of them is dark, or the picture is of another scene"
        )
    both = stack(H, camera, noise=(1.0, ratio))
    return both, both.join([shots, picture.astype(shots.dtype)])


def _read(path: Path, shape: tuple[int, ...]) -> np.ndarray:
    """Picture (channel, y, x) in float64."""
    import numpy as np

    from shadowgram.scenes import read_array

    values = np.asarray(read_array(path), np.float64)
    if values.ndim == 2:
        values = values[None]
    if values.shape != shape and values.ndim == 3 and values.shape[-1] == shape[0]:
        values = np.moveaxis(values, -1, 0)
    if values.shape != shape:
        raise ValueError(
            f"{path} must be a picture of {shape[0]} channel{'s' * (shape[0] > 1)}, (channel, y, x) = {shape} as the scene has,"
            f" got {values.shape}"
        )
    if not np.isfinite(values).all() or not values.any():
        raise ValueError(f"{path} must hold finite values that are not all 0")
    return np.ascontiguousarray(values)
