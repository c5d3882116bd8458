"""The linear route to a scan: the response of the mask, and what it leaves out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.typing import NDArray

from ._scan_blocks import OFFSET_FIRST, Found, Plan, blocks_of, check_whole, together
from ._scan_codes import Coded, checked, lit_margin, mask_of
from .montecarlo.response import CORE_SHARE, Response, mask_response
from .patterns import written
from .simulation import compiled, prepare

if TYPE_CHECKING:
    from .scene import Scene

Floats = NDArray[np.float64]

PER_CELL, MOST = 20_000, 24_000_000
"""Source photons through each cell in view, and of all cells together, unless said: half a minute."""
OFFSET_SHOTS, OFFSET_DEGREE = 16, 6
OFFSET_SHARE = 1.0
"""Histories of the runs that say what the mask scatters itself, for one of the response's."""
_LEAST_PER_CELL = 2 * CORE_SHARE  # two rounds, for a standard error
_MASK = 1
"""Number of the mask among the solids."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Means:
    """Mean counts per source photon.

    Attributes
    ----------
    counts, standard_error : (shot,) of all detectors.
    offset : (shot,) the part of it that is not in the response: what the mask scatters itself, and light around it.
    offset_error : its standard error in each shot.
    image : (y, x) from the target through each cell.
    """

    counts: Floats
    standard_error: Floats
    offset: Floats
    offset_error: float
    image: Floats


def means(
    whole: Coded, histories: int | None, seed: int, threads: int | None, progress: Callable[[int, int], None]
) -> Means:
    """Mean counts of all shots.

    Parameters
    ----------
    whole : the scene and its codes.
    histories : of the response; see `shadowgram.xray.scan.linear_scan`.
    seed, threads, progress : as there.
    """
    per_cell = _per_cell(whole.scene, histories)
    response = response_of(whole.scene, per_cell, seed, threads, progress)
    found = response.shots(whole.codes if whole.strip is None else whole.strip)[:, : len(whole.steps)]
    margin = response.margin
    variance = (response.standard_error[:, :, margin : margin + response.columns] ** 2).sum(axis=0)
    counts = found.sum(axis=0)
    offset, error = _offset(whole, counts, response.histories, seed, threads)
    # Cells are independent of one another; what leaks from outside the view is small.
    spread = np.einsum("qij,ij->q", whole.codes, variance)
    return Means(
        counts=counts + offset,
        standard_error=np.sqrt(spread + error**2),
        offset=offset,
        offset_error=error,
        image=response.image,
    )


def _per_cell(scene: Scene, histories: int | None) -> int:
    mask = mask_of(scene)
    cells = mask.rows * (mask.columns_in_view + 2 * lit_margin(scene) / CORE_SHARE)
    if histories is None:
        return min(PER_CELL, max(_LEAST_PER_CELL, int(MOST / cells)))
    found = int(check_whole("histories", histories, 2) / cells)
    if found < _LEAST_PER_CELL:
        raise ValueError(
            f"the response of this mask needs at least {int(np.ceil(cells * _LEAST_PER_CELL)) + 1} histories, got {histories}"
        )
    return found


def response_of(
    scene: Scene,
    histories_per_cell: int,
    seed: int,
    threads: int | None = None,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Response:
    """What the cells of a scene's mask give, those in view and those beside it that the source lights.

    Examples
    --------
    >>> from shadowgram.xray._scan_linear import response_of
    >>> from shadowgram.xray.scene import shipped_scene
    >>> response = response_of(shipped_scene("cxbi-blocks"), 8, seed=0)
    >>> response.open.shape, response.margin
    ((2, 32, 48), 8)
    """
    mask, margin = mask_of(scene), lit_margin(scene)
    columns = mask.columns_in_view + 2 * margin
    closed = written(np.zeros((mask.rows, columns), np.uint8))
    pattern = mask.pattern.model_copy(update={"rows": closed, "file": None, "transmittance": None, "seed": None})
    # A strip that has the view in its middle, so that the plate stands in the middle of its way.
    around = mask.model_copy(update={"columns": columns, "view": mask.columns_in_view, "pattern": pattern})
    placed = checked(scene.model_copy(update={"mask": around, "shots": 2 * margin + 1}))
    return mask_response(
        prepare(compiled(placed, margin), variance_reduction=True),
        solid=_MASK,
        first_column=margin,
        columns=mask.columns_in_view,
        margin=margin,
        histories_per_cell=histories_per_cell,
        seed=seed,
        threads=threads,
        progress=progress,
    )


def _offset(whole: Coded, linear: Floats, histories: int, seed: int, threads: int | None) -> tuple[Floats, float]:
    """What direct runs of a few shots give beyond the linear ones, per source photon: (shot,) a smooth fit, and its error."""
    shots = len(linear)
    count = min(OFFSET_SHOTS, shots)
    # Closer to one another towards the ends, where it changes most.
    places = (1 - np.cos(np.pi * np.arange(count) / max(1, count - 1))) / 2
    chosen = np.unique((places * (shots - 1)).round().astype(int))
    each = max(2, int(OFFSET_SHARE * histories) // len(chosen))
    blocks = blocks_of(
        whole.scene,
        [whole.steps[shot] for shot in chosen],
        histories=each,
        first_history=OFFSET_FIRST,
        seed=seed,
        variance_reduction=True,
        together=1,
    )
    found: Found = Plan(blocks=blocks, assemble=together).run(threads=threads)
    differences = found.counts / each - linear[chosen]
    terms = _offset_terms(whole, len(chosen))
    fit = terms @ np.linalg.lstsq(terms[chosen], differences, rcond=None)[0]
    own = float((found.standard_error**2).mean()) / each**2
    free = len(chosen) - terms.shape[1]
    if free <= 0:  # the fit goes through all of them
        return fit, math.sqrt(own)
    scatter = max(own, float(((differences - fit[chosen]) ** 2).sum()) / free)
    # What is not the runs' own error is how single shots differ from the fit.
    return fit, math.sqrt(scatter - own + scatter * terms.shape[1] / len(chosen))


def _offset_terms(whole: Coded, known: int) -> Floats:
    """(shot, term) of the fit to so many shots.

    A polynomial for the way of the plate: when an end of it comes close to the view, light goes around it. The number of holes in
    view, since what the tungsten of their walls emits comes out through them.
    """
    shots = len(whole.steps)
    degree = max(0, min(OFFSET_DEGREE, known // 2 - 2)) if whole.strip is not None else 0
    terms = [chebvander(np.linspace(-1, 1, shots), degree)]
    holes = whole.codes.sum(axis=(1, 2), dtype=float)
    if known > degree + 4 and np.ptp(holes) > 0:
        terms.append((holes - holes.mean())[:, None] / np.ptp(holes))
    return np.concatenate(terms, axis=1, dtype=np.float64)
