"""Structure of H, which the cost of the design is made of: Fig. 3.1, sections 3.3.2 and 3.3.3.

As in the source Q = 2, L = 2 and s = 0.25, of which N = 5 is the smallest detector with two bands. Vectors are in the source's
order: voxel i = kN² + mN + n + 1 and element qN² + mN + n + 1, with n, along y, fastest.

What agrees: a column of H holds what its voxel sees in the Q shots, and two columns can only have a product if their voxels lie
on one detector element, a multiple of N² apart; the product is (3.12). What the source does not say: many of these products are 0
as well, those of voxels that are open in different shots, and to have many of them is what the design is for. Exact shear keeps
the structure. Where the mask is finer than the detector, voxels beside each other and in two rows share elements too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram import codes
from shadowgram.experiments.source import CHART_RANGE, SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study
from shadowgram.operators import as_matrix
from shadowgram.spectral.resolution import DETECTOR_LIMITED
from shadowgram.spectral.sscsi import SSCSI

from . import _common as common
from . import _probes as probes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Heat

SEEN = 1e-12  # what rounding leaves of a closed element


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """A small camera with `elements` × `elements` detector elements, and a Boolean code."""

    mask_position: float
    pitch_ratio: int
    elements: int
    shear: str
    shots: int
    seed: int


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:  # noqa: ARG001 - small as it is
    """The source's matrix, the same with exact shear, and one of a finer mask."""
    return [
        Spec(mask_position=0.25, pitch_ratio=ratio, elements=elements, shear=shear, shots=2, seed=1)
        for ratio, elements, shear in ((1, 5, "edge"), (1, 5, "exact"), (2, 3, "edge"))
    ]


def run(spec: Spec, _scene: SceneSource) -> Result:
    """H and HᵀH, and which of their elements are not 0."""
    imager = SSCSI(
        detector_shape=(spec.elements, spec.elements), detector_pitch=common.PITCH, code_pitch=common.PITCH / spec.pitch_ratio,
        mask_position=spec.mask_position, wavelengths=CHART_RANGE, shear=spec.shear,
    )  # fmt: skip
    code = codes.boolean(shots=spec.shots, shape=imager.code_shape, seed=spec.seed)
    rows = _source_order((spec.shots, *imager.detector_shape))
    matrix = as_matrix(imager.operator(code))[np.ix_(rows, _source_order(imager.resolution.cube_shape))]
    gram = matrix.T @ matrix
    values: dict[str, object] = {
        "regime": imager.resolution.regime, "cube_shape": list(imager.resolution.cube_shape), "size": list(matrix.shape),
        "most_in_row": _most(matrix, 1), "most_in_column": _most(matrix, 0), **_pairs(gram, imager.resolution.cube_shape),
    }  # fmt: skip
    if imager.resolution.regime == DETECTOR_LIMITED:
        values |= _printed(matrix, gram, imager.effective_code(code))
    return Result(values=values, arrays={"matrix": matrix.astype(np.float32), "gram": gram.astype(np.float32)})


def _source_order(shape: tuple[int, ...]) -> np.ndarray:
    """Indices of an array (k, y, x) in the order of the source, y fastest."""
    return np.arange(int(np.prod(shape))).reshape(shape).transpose(0, 2, 1).ravel()


def _most(matrix: np.ndarray, axis: int) -> int:
    return int(np.count_nonzero(matrix > SEEN, axis=axis).max())


def _pairs(gram: np.ndarray, cube_shape: tuple[int, int, int]) -> dict[str, int]:
    """Pairs of different voxels that share light, by how they lie: on one place, or apart; and pairs on one place that do not."""
    _, rows, columns = cube_shape
    place = np.arange(len(gram)) % (rows * columns)
    same = (place[:, None] == place) & ~np.eye(len(gram), dtype=bool)
    apart = place[:, None] != place
    shared = gram > SEEN
    return {
        "on_one_place": int(np.count_nonzero(shared & same)) // 2,
        "on_one_place_dark": int(np.count_nonzero(~shared & same)) // 2,
        "apart": int(np.count_nonzero(shared & apart)) // 2,
    }


def _printed(matrix: np.ndarray, gram: np.ndarray, seen: np.ndarray) -> dict[str, float | int]:
    """How far H and HᵀH are from t̂ and (3.12), with the indices m_i, n_i, ℓ_i and j(i, k) as they are printed."""
    shots, bands, size, _ = seen.shape
    column_error = product_error = 0.0
    moved = 0
    for i in range(1, size * size * bands + 1):
        m, n, band = _place(i, size)
        expected = np.zeros(len(matrix))
        expected[np.arange(shots) * size * size + m * size + n] = seen[:, band, n, m]
        column_error = max(column_error, float(np.abs(matrix[:, i - 1] - expected).max()))
        for k in range(bands):
            j = (k - (i - 1) // size**2) * size**2 + i
            moved += _place(j, size) != (m, n, k)
            product = float(seen[:, band, n, m] @ seen[:, k, n, m])
            product_error = max(product_error, abs(float(gram[i - 1, j - 1]) - product))
    return {"column_error": column_error, "product_error": product_error, "indices_off": moved}


def _place(i: int, size: int) -> tuple[int, int, int]:
    """m, n and ℓ of voxel i = 1, 2, ..., as printed below (3.11)."""
    return (i - 1) // size - (i - 1) // size**2 * size, (i - 1) % size, (i - 1) // size**2


def figure(records: Sequence[Record]) -> Figure:
    """H with two columns of one place marked, HᵀH, and HᵀH of a finer mask."""
    from shadowgram.figures.sheet import sheet

    source, _, finer = records
    drawn = sheet(
        "Structure of H and of HᵀH (Fig. 3.1)",
        [
            [
                _heat(source, "matrix", "H: Q = 2, L = 2, s = 0.25", "element (shot, x, y)"),
                _heat(source, "gram", "HᵀH", "voxel j (band, x, y)"),
                _heat(finer, "gram", "HᵀH, mask twice as fine", "voxel j (band, x, y)"),
            ]
        ],
    )
    for axes, record, name in zip(drawn.axes, (source, source, finer), ("matrix", "gram", "gram"), strict=False):
        _parts(axes, record, name)
    _mark(drawn, source)
    return drawn


def _heat(record: Record, name: str, title: str, ylabel: str) -> Heat:
    """A matrix, the first row at the top."""
    from shadowgram.figures.sheet import Heat

    rows, columns = record.arrays[name].shape
    return Heat(
        title=title, values=record.arrays[name][::-1], extent=(0, columns, rows, 0), xlabel="voxel i (band, x, y)", ylabel=ylabel,
        unit="coefficient" if name == "matrix" else "inner product", low=0, high=1, colours="gray_r", aspect="equal",
    )  # fmt: skip


def _parts(axes: Axes, record: Record, name: str) -> None:
    """Lines between shots and bands, and between the columns of the detector."""
    bands, high, wide = record.values["cube_shape"]
    rows, columns = record.arrays[name].shape
    shots = record.spec["shots"] if name == "matrix" else bands
    tall = rows // shots // (record.spec["elements"] if name == "matrix" else wide)
    for place in range(tall, rows, tall):
        border = place % (rows // shots) == 0
        axes.axhline(place, color="C1", linewidth=1.4 if border else 0.35, alpha=1 if border else 0.6)
    for place in range(high, columns, high):
        border = place % (columns // bands) == 0
        axes.axvline(place, color="C1", linewidth=1.4 if border else 0.35, alpha=1 if border else 0.6)


def _mark(drawn: Figure, record: Record) -> None:
    """Circle what two voxels of one place see, and their products."""
    matrix, gram = drawn.axes[:2]
    H, place = record.arrays["matrix"], record.values["cube_shape"][1] * record.values["cube_shape"][2]
    products = np.diagonal(record.arrays["gram"], place)
    # A voxel that shares light with its neighbour in the spectrum and is gray: the columns have something to show.
    i = int(np.argmax(products * (products < 1 - 1e-6)))
    circle = {"markersize": 10, "markerfacecolor": "none", "markeredgecolor": "C0", "markeredgewidth": 1.4}
    for column in (i, i + place):
        for row in np.flatnonzero(H[:, column] > SEEN):
            matrix.plot(column + 0.5, row + 0.5, "o", **circle)
    paper = drawn.get_facecolor()
    text = {"color": "C0", "fontsize": 9, "va": "center", "bbox": {"facecolor": paper, "edgecolor": "none", "pad": 1.0}}
    arrow = {"arrowstyle": "<->", "color": "C0", "shrinkA": 0, "shrinkB": 0}
    matrix.annotate("", (i + place - 0.8, i + 0.5), (i + 1.8, i + 0.5), arrowprops=arrow)
    matrix.text(i + 0.5 + 0.62 * place, i + 0.5, "N²", ha="center", **text)
    for name, column in (("hᵢ", i), ("hⱼ", i + place)):
        matrix.text(column + 0.5, i + 0.5 + 0.5 * place, name, ha="center", **text)
    for x, row in ((i, i), (i, i + place), (i + place, i), (i + place, i + place)):
        gram.plot(x + 0.5, row + 0.5, "o", **circle)
    gram.text(i + place - 2, i + 0.5, f"⟨hᵢ, hⱼ⟩ = {products[i]:.2g}", ha="right", **text)


def claims(records: Sequence[Record]) -> list[Claim]:
    """Columns, products, and what changes with the shear and a finer mask."""
    source, exact, finer = records
    return [_columns(source), _apart(source), _product(source), _others(exact, finer)]


def _columns(record: Record) -> Claim:
    values, spec = record.values, record.spec
    bands = values["cube_shape"][0]
    agrees = values["column_error"] < SEEN and values["most_in_column"] <= spec["shots"]
    return Claim(
        page=44, says="column i of H holds what voxel i sees in the Q shots, [t̂₁ ... t̂_Q]",
        found=f"of {values['size'][0]}×{values['size'][1]} elements at most {values['most_in_column']} in a column (Q ="
        f" {spec['shots']}) and {values['most_in_row']} in a row (L = {bands}) are not 0; they differ from t̂ by"
        f" {probes.tiny(values['column_error'])}",
        agrees=agrees and values["most_in_row"] <= bands,
    )  # fmt: skip


def _apart(record: Record) -> Claim:
    values = record.values
    shared, dark = values["on_one_place"], values["on_one_place_dark"]
    return Claim(
        page=44, says="⟨hᵢ, hⱼ⟩ differs from 0 if, and only if, i and j are a multiple of N² apart, j = (k − ⌊(i−1)/N²⌋)N² + i",
        found=f"{values['apart']} pairs elsewhere have a product; of the {shared + dark} that far apart {shared} do;"
        f" {values['indices_off']} of the j lie on another element or in another band than printed",
        agrees=values["apart"] == 0 and values["indices_off"] == 0,
        why=f"only if, but not if: the other {dark} pairs are open in different shots, and the design is to make more of them",
    )  # fmt: skip


def _product(record: Record) -> Claim:
    off = record.values["product_error"]
    return Claim(
        page=45, says="⟨hᵢ, hⱼ⟩ = Σ_q t̂ t̂ of the two voxels (3.12)",
        found=f"the two differ by {probes.tiny(off)}", agrees=off < SEEN,
    )  # fmt: skip


def _others(exact: Record, finer: Record) -> Claim:
    return Claim(
        page=None, says="does this hold with exact shear, and where the mask is finer than the detector?",
        found=f"with exact shear {exact.values['apart']} pairs lie elsewhere, of {exact.values['on_one_place']} with a product."
        f" With Δc = Δd/2 (super-resolving) {finer.values['apart']} do, of"
        f" {finer.values['apart'] + finer.values['on_one_place']}: voxels of two code rows of one element, and beside each other."
        " `codes.design` counts these pairs too",
        agrees=None,
    )  # fmt: skip


STUDY = Study(
    name="fig-3-1",
    title="Structure of H and of HᵀH",
    source="Fig. 3.1, pages 44 and 45",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
