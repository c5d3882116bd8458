"""Snapshots as a function of the code: what learned codes need.

A snapshot is linear in the cube f for a given code t, and linear in the code for a given cube. Both follow from one form that is
linear in code, cube and snapshots g, T(t, f, g) = ⟨H(t) f, g⟩: its derivatives in g, f and t are the snapshots H(t) f, the adjoint
H(t)ᵀ g, and the adjoint with respect to the code. Codes of any sign are taken, as gradients and their derivatives need.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from shadowgram._threads import run_chunks
from shadowgram.operators.base import LinearOperator, Shape

from .cassi import CASSI, DualCASSI
from .colored import ColoredCASSI
from .sscsi import SSCSI

CodedImager = SSCSI | CASSI | DualCASSI | ColoredCASSI


def code_operator(imager: CodedImager, cube: np.ndarray, shots: int) -> CodeOperator:
    """Forward model of one cube as an operator on codes: code (shot, …) → snapshots (shot, y, x).

    Parameters
    ----------
    imager : `SSCSI`, `CASSI`, `DualCASSI` or `ColoredCASSI`.
    cube : (band, y, x), as `imager.operator` takes it.
    shots : number of shots of the codes.

    Returns
    -------
    CodeOperator
        ``code_operator(imager, cube, shots).forward(code)`` is ``imager.operator(code).forward(cube)``; its adjoint takes the
        gradient of a loss by the snapshots to the gradient by the code.

    Raises
    ------
    ValueError
        If the cube does not fit, or shots is not positive.
    TypeError
        If the imager is of another kind.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> imager = sg.CASSI(cube_shape=(4, 8, 8), wavelengths=(450, 650))
    >>> cube, code = np.ones((4, 8, 8)), sg.codes.random(shots=2, shape=imager.code_shape, seed=0)
    >>> by_code = sg.spectral.code_operator(imager, cube, shots=2)
    >>> bool(np.allclose(by_code.forward(code), imager.operator(code).forward(cube)))
    True
    """
    form = CodedForm.of(imager)
    cube = np.asarray(cube)
    if cube.shape != form.cube_shape:
        raise ValueError(f"code_operator needs a cube of shape {form.cube_shape} for this imager, got {cube.shape}")
    if not isinstance(shots, int | np.integer) or shots < 1:
        raise ValueError(f"code_operator: shots must be a whole number of at least 1, got {shots!r}")
    return CodeOperator(form, np.ascontiguousarray(cube, np.float64), int(shots))


@dataclass(frozen=True, eq=False)
class CodeOperator(LinearOperator):
    """Code (shot, …) → snapshots (shot, y, x) of one cube; made by `code_operator`."""

    form: CodedForm
    cube: np.ndarray
    shots: int

    @property
    def in_shape(self) -> Shape:
        """(shot, y, x) of the code; (shot, band, y, x) of a colored one."""
        return (self.shots, *self.form.code_shape)

    @property
    def out_shape(self) -> Shape:
        """(shot, y, x) of the snapshots."""
        return (self.shots, *self.form.detector_shape)

    def _forward(self, x: np.ndarray, out: np.ndarray) -> None:
        self.form.snapshots(x, self.cube.astype(x.dtype, copy=False), out)

    def _adjoint(self, y: np.ndarray, out: np.ndarray) -> None:
        self.form.code(self.cube.astype(y.dtype, copy=False), y, out)


@dataclass(frozen=True, eq=False)
class CodedForm:
    """T(t, f, g) = ⟨H(t) f, g⟩ of an imager; the methods fill `out` with its derivatives, for arrays of one dtype.

    Attributes
    ----------
    cube_shape : (band, y, x).
    code_shape : (y, x), or (band, y, x) of a colored code.
    detector_shape : (y, x).
    terms : (5, term) int64: band, code column, voxel column, detector column, in the order in which they are summed; and a number
        that is the same in terms that may belong to one run.
    weights : (term,) float64.
    """

    cube_shape: tuple[int, int, int]
    code_shape: tuple[int, ...]
    detector_shape: tuple[int, int]
    terms: np.ndarray
    weights: np.ndarray

    @classmethod
    def of(cls, imager: CodedImager) -> CodedForm:
        """Form of an imager."""
        if isinstance(imager, SSCSI):
            return _sscsi_form(imager)
        if isinstance(imager, CASSI | DualCASSI | ColoredCASSI):
            return _cassi_form(imager)
        raise TypeError(
            f"codes can be learned for SSCSI, CASSI, DualCASSI and ColoredCASSI, got a {type(imager).__name__}"
        )

    @cached_property
    def _runs(self) -> np.ndarray:
        """(run, 6) int64: band, first code, voxel and detector column, first weight, and length."""
        steps = np.diff(self.terms, axis=1)
        together = (steps[0] == 0) & (steps[1:4] == 1).all(axis=0) & (steps[4] == 0)
        starts = np.concatenate([[0], np.flatnonzero(~together) + 1])
        lengths = np.diff(np.append(starts, self.terms.shape[1]))
        return np.ascontiguousarray(np.vstack([self.terms[:4, starts], starts, lengths]).T)

    def snapshots(self, code: np.ndarray, cube: np.ndarray, out: np.ndarray) -> None:
        """H(t) f, (shot, y, x)."""
        self._run("snapshots", self._banded(code), cube, out)

    def cube(self, code: np.ndarray, snapshots: np.ndarray, out: np.ndarray) -> None:
        """H(t)ᵀ g, (band, y, x)."""
        self._run("cube", self._banded(code), snapshots, out)

    def code(self, cube: np.ndarray, snapshots: np.ndarray, out: np.ndarray) -> None:
        """Derivative of ⟨H(t) f, g⟩ by t, of the shape of the code."""
        self._run("code", cube, snapshots, self._banded(out))

    def _banded(self, code: np.ndarray) -> np.ndarray:
        """View (shot, band or 1, y, x)."""
        return code if len(self.code_shape) == 3 else code[:, None]

    def _run(self, kernel: str, one: np.ndarray, two: np.ndarray, out: np.ndarray) -> None:
        from . import _code_kernels

        weights = self.weights.astype(out.dtype, copy=False)
        run_chunks(getattr(_code_kernels, kernel), self.detector_shape[0], 4, self._runs, weights, one, two, out)


def _form(
    cube_shape: Shape, code_shape: Shape, detector_shape: Shape, indices: tuple[np.ndarray, ...], weights: np.ndarray
) -> CodedForm:
    """Form of terms given by (band, code, voxel, detector) columns of shape (band, j, piece), without those that see nothing."""
    index = np.stack(np.broadcast_arrays(*indices, np.arange(weights.shape[1])[:, None])).astype(np.int64)
    code, detector = index[1], index[3]
    seen = (weights > 0) & (code >= 0) & (code < code_shape[-1]) & (detector >= 0) & (detector < detector_shape[-1])
    return CodedForm(
        (cube_shape[0], cube_shape[1], cube_shape[2]),
        code_shape,
        (detector_shape[0], detector_shape[1]),
        np.ascontiguousarray(index[:, seen]),
        np.ascontiguousarray(weights[seen]),
    )


def _sscsi_form(imager: SSCSI) -> CodedForm:
    """A piece of a detector element sees, in band k, the code columns from first[k] on."""
    table, pieces = imager._table, imager._pieces
    bands = np.arange(imager.resolution.bands)[:, None, None]
    weights = np.broadcast_to(table.weights.swapaxes(0, 1), (len(bands), len(table.weights), len(pieces.start)))
    columns = table.first[:, None, :] + np.arange(weights.shape[1])[:, None]
    return _form(
        imager.resolution.cube_shape,
        imager.code_shape,
        imager.detector_shape,
        (bands, columns, pieces.voxel, pieces.detector),
        weights,
    )


def _cassi_form(imager: CASSI | DualCASSI | ColoredCASSI) -> CodedForm:
    """The footprint of a voxel lies on the detector, or on the code of a `DualCASSI`."""
    dispersion = imager._dispersion
    bands, rows, columns = imager.cube_shape
    prints = dispersion.footprints
    voxel = np.arange(columns)
    reached = voxel + prints.first[:, None, None] + np.arange(prints.weights.shape[1])[:, None]
    weights = np.broadcast_to(prints.weights[:, :, None], reached.shape)
    dual = isinstance(imager, DualCASSI)
    code, detector = (reached, voxel) if dual else (voxel, reached)
    width = columns if dual else columns + dispersion.extra_columns
    k = np.arange(bands)[:, None, None]
    return _form(imager.cube_shape, imager.code_shape, (rows, width), (k, code, voxel, detector), weights)
