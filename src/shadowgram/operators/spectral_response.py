"""Ordinary cameras beside a coded one: a panchromatic or colour picture of the scene, as an operator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shadowgram._threads import run_chunks

from .base import LinearOperator, Shape


@dataclass(frozen=True, eq=False)
class SpectralResponse(LinearOperator):
    """A picture of the scene, without dispersion: g[c, y, x] = Σ_k weights[c, k] f[k, y, x].

    Parameters
    ----------
    weights : (channel, band), what a channel reads of one unit in a band; (band,) for a single channel. Negative weights are
        allowed: those of pictures whose colours were corrected. `shadowgram.scenes.rgb_response` gives the weights of RGB.
    cube_shape : (band, y, x) of the datacube. The picture has its pixels: register it first, and average finer ones.

    Raises
    ------
    ValueError
        If the weights are not finite, or are of another number of bands.

    Examples
    --------
    A panchromatic picture beside one coded shot:

    >>> import numpy as np, shadowgram as sg
    >>> imager = sg.DualCASSI(cube_shape=(3, 16, 16), wavelengths=(450, 650))
    >>> H = imager.operator(sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0)[:1])
    >>> pan = sg.operators.SpectralResponse.pan(H.in_shape)
    >>> pan.forward(np.ones(H.in_shape)).shape
    (1, 16, 16)
    >>> sg.operators.stack(H, pan).out_shape
    (2, 16, 16)
    """

    weights: np.ndarray
    cube_shape: tuple[int, int, int]

    def __post_init__(self) -> None:
        weights = np.atleast_2d(np.asarray(self.weights, np.float64))
        if len(self.cube_shape) != 3:
            raise ValueError(f"SpectralResponse: cube_shape must be (band, y, x), got {self.cube_shape}")
        if weights.ndim != 2 or not len(weights) or weights.shape[1] != self.cube_shape[0]:
            raise ValueError(
                f"SpectralResponse: weights must be (channel, band) with {self.cube_shape[0]} bands as the cube has,"
                f" got {weights.shape}"
            )
        if not np.isfinite(weights).all():
            raise ValueError("SpectralResponse: weights must be finite numbers")
        object.__setattr__(self, "weights", np.ascontiguousarray(weights))

    @classmethod
    def pan(cls, cube_shape: tuple[int, int, int]) -> SpectralResponse:
        """Panchromatic picture: the mean of all bands."""
        return cls(np.full((1, cube_shape[0]), 1 / cube_shape[0]), cube_shape)

    @property
    def in_shape(self) -> Shape:
        """(band, y, x) of the datacube."""
        return self.cube_shape

    @property
    def out_shape(self) -> Shape:
        """(channel, y, x) of the picture."""
        return len(self.weights), *self.cube_shape[1:]

    def _forward(self, x: np.ndarray, out: np.ndarray) -> None:
        self._run(x, self.weights, out)

    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None:
        self._run(y, self.weights.T, out)

    def _run(self, x: np.ndarray, weights: np.ndarray, out: np.ndarray) -> None:
        from . import _response_kernels as kernels

        run_chunks(kernels.respond, self.cube_shape[1], 16, x, np.ascontiguousarray(weights, x.dtype), out)
