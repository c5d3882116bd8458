"""Sensing matrices: Fig. 2.14, section 2.4.1.

A detector of 8×8 elements, s = 0.18, β = 1. Left as in the source: one shot and one band, in the super-resolving regime and in the
detector-limited one. Right: two shots and two bands, Δc = Δd, with the edge model of the source and as the elements see a finely
resolved scene that is even over every voxel. Vectors are in the order (shot, y, x) and (band, y, x), x fastest.

What agrees: sizes, the diagonal structure in the detector-limited regime, and that the second band is coded by the same code one
column further. What the source does not say: in the super-resolving regime a voxel can stand in two rows, so H is banded there; and
the second of the bands of s = 0.18 lies for 56 % beyond the longest wavelength.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram import codes
from shadowgram.experiments.source import CHART_RANGE, SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study
from shadowgram.operators import as_matrix
from shadowgram.spectral.continuous import ContinuousSSCSI
from shadowgram.spectral.sscsi import SSCSI

from . import _common as common
from . import _probes as probes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Curve, Curves, Heat

MATRIX, SHARE = "matrix", "share"
SEEN = 1e-12  # what rounding leaves of a closed element


@dataclass(frozen=True, slots=True, kw_only=True)
class MatrixSpec:
    """A matrix of a small detector, the first `bands` of its bands."""

    mask_position: float
    pitch_ratio: int
    elements: int
    shots: int
    bands: int
    fine_bands: int
    seed: int
    part: str = MATRIX


@dataclass(frozen=True, slots=True, kw_only=True)
class ShareSpec:
    """A matrix of the size of the simulations, of which only the share of elements that are not 0 is wanted."""

    elements: int
    bands: int
    shots: int
    seed: int
    part: str = SHARE


def specs(_scene: SceneSource, quick: bool) -> list[MatrixSpec | ShareSpec]:
    """The three matrices of the figure, and the size of the simulations."""
    figures = [(2, 1, 1), (1, 1, 1), (1, 2, 2)]
    return [
        *(
            MatrixSpec(
                mask_position=0.18, pitch_ratio=ratio, elements=8, shots=shots, bands=bands, fine_bands=36, seed=0
            )
            for ratio, shots, bands in figures
        ),
        ShareSpec(elements=64 if quick else 256, bands=6 if quick else 24, shots=2, seed=0),
    ]


def run(spec: MatrixSpec | ShareSpec, _scene: SceneSource) -> Result:
    """A matrix both ways, or its share of elements that are not 0."""
    if isinstance(spec, ShareSpec):
        return _share(spec)
    imager = _imager(spec.elements, spec.mask_position, spec.pitch_ratio)
    code = codes.boolean(shots=2, shape=imager.code_shape, seed=spec.seed)[: spec.shots]
    bands, rows, columns = imager.resolution.cube_shape
    matrix = as_matrix(imager.operator(code))[:, : spec.bands * rows * columns]
    fine = fine_matrix(imager, code, spec.fine_bands, spec.bands)
    blocks = matrix.reshape(-1, spec.bands, rows * columns)
    values: dict[str, object] = {
        "regime": imager.resolution.regime, "cube_shape": [spec.bands, rows, columns], "all_bands": bands,
        "size": list(matrix.shape), "nonzero": _nonzero(matrix),
        "most_in_row": _most(matrix, 1), "most_in_column": _most(matrix, 0),
        "difference": float(np.linalg.norm(matrix - fine) / np.linalg.norm(fine)),
        "light": _light(imager, spec.fine_bands),
    }  # fmt: skip
    if rows * columns == spec.elements**2:
        values["off_diagonal"] = int(np.count_nonzero(_off_diagonal(blocks, spec.elements**2) > SEEN))
    if spec.bands > 1:
        values["off_shifted"] = _off_shifted(imager, code)
    arrays = {"edge": matrix.astype(np.float32), "fine": fine.astype(np.float32), "code": code}
    return Result(values=values, arrays=arrays)


def _imager(elements: int, mask_position: float, pitch_ratio: int, shear: str = "edge") -> SSCSI:
    return SSCSI(
        detector_shape=(elements, elements), detector_pitch=common.PITCH, code_pitch=common.PITCH / pitch_ratio,
        mask_position=mask_position, wavelengths=CHART_RANGE, shear=shear,
    )  # fmt: skip


def fine_matrix(imager: SSCSI, code: np.ndarray, fine_bands: int, bands: int) -> np.ndarray:
    """What the elements record of a finely resolved scene that is 1 in one voxel, for every voxel of the first `bands` bands.

    Returns
    -------
    (shot y x, band y x) float64, as `as_matrix` gives it. Fine pixels that a voxel covers in part are that part of 1.
    """
    camera = ContinuousSSCSI(imager=imager, bands=fine_bands, oversampling=4 * imager.pitch_ratio)
    A = camera.operator(code)
    _, rows, columns = imager.resolution.cube_shape
    lit, row, column = _shares(camera)
    matrix = np.empty((math.prod(A.out_shape), bands, rows, columns))
    for k, n, m in np.ndindex(bands, rows, columns):
        scene = lit[k][:, None, None] * row[n][None, :, None] * column[m][None, None, :]
        matrix[:, k, n, m] = A.forward(scene).ravel()
    return matrix.reshape(len(matrix), -1)


def _shares(camera: ContinuousSSCSI) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shares of the fine bands, rows and columns in the imager's, each (voxel, fine voxel)."""
    imager, (bands, rows, columns) = camera.imager, camera.scene_shape
    said, (low, high) = imager.resolution, imager.wavelengths
    over = camera.oversampling
    return (
        _overlaps(bands, said.bands, said.band_width / (high - low) * bands),
        _overlaps(rows, said.cube_shape[1], said.y_pitch / common.PITCH * over),
        _overlaps(columns, said.cube_shape[2], said.x_pitch / common.PITCH * over),
    )


def _overlaps(fine: int, coarse: int, width: float) -> np.ndarray:
    """(coarse, fine) share of each of the `fine` cells, one wide, that lies in each of the `coarse` ones."""
    left, cell = width * np.arange(coarse)[:, None], np.arange(fine)
    return np.clip(np.minimum(left + width, cell + 1) - np.maximum(left, cell), 0, 1)


def _light(imager: SSCSI, fine_bands: int) -> list[float]:
    """What the elements record of each band of a white scene through an open mask."""
    camera = ContinuousSSCSI(imager=imager, bands=fine_bands, oversampling=imager.pitch_ratio)
    A = camera.operator(np.ones((1, *imager.code_shape), np.uint8))
    lit = _shares(camera)[0]
    return [float(A.forward(np.broadcast_to(band[:, None, None], A.in_shape)).sum()) for band in lit]


def _off_diagonal(blocks: np.ndarray, side: int) -> np.ndarray:
    """Elements off the diagonals of the square blocks of a matrix (row, band, column)."""
    squares = blocks.reshape(-1, side, *blocks.shape[1:])
    return np.abs(squares[:, ~np.eye(side, dtype=bool)[:, None, :].repeat(blocks.shape[1], axis=1)])


def _nonzero(matrix: np.ndarray) -> float:
    return float(np.count_nonzero(matrix > SEEN) / matrix.size)


def _most(matrix: np.ndarray, axis: int) -> int:
    return int(np.count_nonzero(matrix > SEEN, axis=axis).max())


def _off_shifted(imager: SSCSI, code: np.ndarray) -> float:
    """Largest difference between the block of the second band and that of the first with the code moved by a column."""
    moved = np.pad(code, ((0, 0), (0, 0), (0, 1)))[:, :, 1:]
    side = imager.resolution.cube_shape[1] * imager.resolution.cube_shape[2]
    found = []
    for shear in ("edge", "exact"):
        camera = _imager(imager.detector_shape[0], imager.mask_position, imager.pitch_ratio, shear)
        here, there = (as_matrix(camera.operator(t)) for t in (code, moved))
        found.append(np.abs(here[:, side : 2 * side] - there[:, :side]).max())
    return float(max(found))


def _share(spec: ShareSpec) -> Result:
    imager = _imager(spec.elements, spec.bands / spec.elements, 1)
    code = codes.boolean(shots=spec.shots, shape=imager.code_shape, seed=spec.seed)
    seen = np.count_nonzero(imager.effective_code(code) > SEEN)
    rows, columns = spec.shots * spec.elements**2, math.prod(imager.resolution.cube_shape)
    return Result(values={"size": [rows, columns], "nonzero": float(seen / (rows * columns))})


def figure(records: Sequence[Record]) -> Figure:
    """The matrices with the axes of their vectors, the codes, and a row of both bands over the mask."""
    from shadowgram.figures.sheet import Picture, sheet

    matrices = common.chosen(records, part=MATRIX)
    limited, *_ = common.chosen(matrices, pitch_ratio=1, shots=1)
    finer, *_ = common.chosen(matrices, pitch_ratio=2)
    two, *_ = common.chosen(matrices, shots=2)
    top = [
        _heat(finer, "edge", "1 shot, 1 band, Δc/(1 − s) ≤ Δd", width=1.5),
        _heat(limited, "edge", "1 shot, 1 band, Δc/(1 − s) > Δd"),
    ]
    middle = [
        _heat(two, "edge", "2 shots, 2 bands: model of the source"),
        _heat(two, "fine", "2 shots, 2 bands: finely resolved scene"),
    ]
    shots = [
        Picture(title=f"code, shot {number + 1}", picture=shot.astype(float), width=0.5)
        for number, shot in enumerate(two.arrays["code"])
    ]
    return sheet("Sensing matrices (Fig. 2.14)", [top, middle, [*shots, _row(two)]])


def _heat(record: Record, name: str, title: str, width: float = 1.0) -> Heat:
    """A matrix, the first row at the top, with lines between shots and bands."""
    from shadowgram.figures.sheet import Heat

    rows, columns = record.values["size"]
    shots, bands = record.spec["shots"], record.values["cube_shape"][0]
    lines = [np.array([[0, rows * q / shots], [columns, rows * q / shots]]) for q in range(1, shots)]
    lines += [np.array([[columns * k / bands, 0], [columns * k / bands, rows]]) for k in range(1, bands)]
    return Heat(
        title=title, values=record.arrays[name][::-1], extent=(0, columns, rows, 0), xlabel="voxel (band, y, x)",
        ylabel="element (shot, y, x)", unit="coefficient", low=0, high=1, colours="gray_r", lines=lines, width=width,
    )  # fmt: skip


def _row(record: Record) -> Curves:
    """Coefficients of a row of elements in both bands, over their place on the mask."""
    from shadowgram.figures.sheet import Curve, Curves

    n, s, bands = record.spec["elements"], record.spec["mask_position"], record.values["cube_shape"][0]
    code = record.arrays["code"][0]
    row = int(np.argmax(np.count_nonzero(code[:, 1:] != code[:, :-1], axis=1)))  # the liveliest
    curves = {"mask, seen by an element there": _seen(code[row], 1 - s)}
    diagonal = record.arrays["edge"][: n * n].reshape(n * n, bands, n * n)
    for k in range(bands):
        values = diagonal[row * n + np.arange(n), k, row * n + np.arange(n)]
        curves[f"band {k + 1}"] = Curve(x=np.arange(n) * (1 - s) + k, y=values, colour=k)
    return Curves(
        title=f"row {row + 1}, shot 1: every band one column further", xlabel="left edge of the element on the mask (code columns)",
        ylabel="coefficient", curves=curves,
    )  # fmt: skip


def _seen(code: np.ndarray, width: float) -> Curve:
    """Mean of a row of the code over an element that begins at u, over u."""
    from shadowgram.figures.sheet import Curve

    u = np.linspace(0, len(code) - width, 400)
    open_to = np.concatenate([[0.0], np.cumsum(code)])
    edges = np.arange(len(code) + 1)
    return Curve(x=u, y=(np.interp(u + width, edges, open_to) - np.interp(u, edges, open_to)) / width, reference=True)


def claims(records: Sequence[Record]) -> list[Claim]:
    """Structure, sizes, and the dispersion between bands."""
    matrices = common.chosen(records, part=MATRIX)
    return [
        _structure(records), _banded(common.only(matrices, pitch_ratio=2)), _sizes(matrices),
        _shifted(common.only(matrices, shots=2)), _two_bands(common.only(matrices, shots=2)),
    ]  # fmt: skip


def _structure(records: Sequence[Record]) -> Claim:
    limited = common.chosen(common.chosen(records, part=MATRIX), pitch_ratio=1)
    off = sum(r.values["off_diagonal"] for r in limited)
    large = common.only(records, part=SHARE)
    return Claim(
        page=25, says="H is a diagonal-structured matrix",
        found=f"where Δc/(1 − s) > Δd, {off} elements off the diagonals of the blocks; "
        + ", ".join(f"{100 * r.values['nonzero']:.2g} % of {_size(r)} are not 0" for r in limited)
        + f", and {100 * large.values['nonzero']:.1g} % of {_size(large)} (Q = {large.spec['shots']}, Nd ="
        f" {large.spec['elements']})",
        agrees=off == 0,
    )  # fmt: skip


def _banded(record: Record) -> Claim:
    values = record.values
    diagonal = values["most_in_column"] == 1
    return Claim(
        page=None, says="is H diagonal-structured in the super-resolving regime too?",
        found=f"where Δc/(1 − s) ≤ Δd, up to {values['most_in_row']} elements of a row and {values['most_in_column']} of a column"
        f" are not 0, {100 * values['nonzero']:.2g} % in all",
        agrees=None,
        why="" if diagonal else "an element sees several voxels, and a voxel cut by the edge of two elements is in both their rows:"
        " H is banded, and HHᵀ is not block-diagonal with one block an element",
    )  # fmt: skip


def _sizes(matrices: Sequence[Record]) -> Claim:
    right = [
        r.values["size"] == [r.spec["shots"] * r.spec["elements"] ** 2, math.prod(r.values["cube_shape"])]
        for r in matrices
    ]
    return Claim(
        page=25, says="H has QN²d rows and NxNyL columns",
        found="; ".join(
            f"{_size(r)} for Q = {r.spec['shots']}, {'×'.join(map(str, reversed(r.values['cube_shape'])))} voxels" for r in matrices
        ),
        agrees=all(right),
    )  # fmt: skip


def _size(record: Record) -> str:
    return "×".join(map(str, record.values["size"]))


def _shifted(record: Record) -> Claim:
    off = record.values["off_shifted"]
    return Claim(
        page=27, says="the dispersion shifts the code between the bands (circles and arrow)",
        found="the block of the second band and that of the first with the code one column further differ by"
        f" {probes.tiny(off)}, with edge and exact shear",
        agrees=off < SEEN,
    )  # fmt: skip


def _two_bands(record: Record) -> Claim:
    first, second = record.values["light"]
    n, s = record.spec["elements"], record.spec["mask_position"]
    return Claim(
        page=27, says="with an 8×8 code, s = 0.18 and β = 1 there are two bands",
        found=f"⌈{n * s:.2f}⌉ = {record.values['all_bands']}; a white scene gives the second {second / first:.2f} of the light"
        " of the first",
        agrees=record.values["all_bands"] == 2,
        why=f"the second band begins at {CHART_RANGE[0] + (CHART_RANGE[1] - CHART_RANGE[0]) / (n * s):.0f} of"
        f" {CHART_RANGE[0]:g} to {CHART_RANGE[1]:g} nm and would reach beyond",
    )  # fmt: skip


STUDY = Study(
    name="fig-2-14",
    title="Sensing matrices",
    source="Fig. 2.14, page 27",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
