"""What the studies of doses and of the man share: mean counts of coded shots from one response of the mask, kept in the process.

The response holds what each cell of the mask gives by transport, holes with their walls and neighbours; the shots of any strip
follow from it. What the mask scatters itself is not in it. That is found by direct runs of a few shots, and taken as the same
in every shot, as if the plate had no ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

if TYPE_CHECKING:
    from shadowgram.xray.montecarlo.response import Response

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Shots:
    """Mean counts of the shots of a scan.

    Attributes
    ----------
    codes : (shot, y, x) uint8; a shot without an open cell is left out.
    counts, air : (shot,) mean counts with and without the target, of all detectors; without what the mask scatters itself.
    image : (y, x) counts that the target gives through each open cell.
    """

    codes: NDArray[np.uint8]
    counts: Floats
    air: Floats
    image: Floats


@lru_cache(maxsize=8)
def response(scene: str, target: bool, histories: int) -> Response:
    """Response of a shipped scene's mask, with its target or without."""
    from shadowgram.xray._scan_codes import lit_margin
    from shadowgram.xray._scan_linear import response_of
    from shadowgram.xray.montecarlo.response import CORE_SHARE

    described = _scene(scene)
    mask = described.mask
    assert mask is not None
    cells = mask.rows * (mask.columns_in_view + 2 * lit_margin(described) / CORE_SHARE)
    each = max(2 * CORE_SHARE, int(histories / cells))
    return response_of(described if target else described.without_targets(), each, 0 if target else 1)


@lru_cache(maxsize=4)
def expected(scene: str, *, percent: float, seed: int, shots: int, step: int, histories: int, photons: float) -> Shots:
    """Mean counts of every `step`-th shot of a random strip.

    Parameters
    ----------
    scene : name of a shipped one.
    percent : of open cells.
    seed : of the strip.
    shots : of the whole strip.
    step : take every so manieth.
    histories : of each response.
    photons : of the source in a shot.
    """
    with_target, without = (response(scene, target, histories) for target in (True, False))
    rows, columns = with_target.image.shape
    strip = random_strip(rows, columns + shots - 1, percent, seed)
    codes = np.ascontiguousarray(sliding_window_view(strip, columns, axis=1)[:, ::step].transpose(1, 0, 2))
    counts, air = photons * _counts((with_target, without), strip, step)
    lit = codes.any(axis=(1, 2))
    return Shots(codes=codes[lit], counts=counts[lit], air=air[lit], image=photons * with_target.image)


def _counts(responses: tuple[Response, ...], strip: NDArray[np.uint8], step: int) -> Floats:
    """(response, shot) mean counts per photon of the source, as `Response.shots`, but of every `step`-th shot alone.

    A product of neighbouring cells slides with the strip, so that it is taken once for all shots.
    """
    from shadowgram.xray.montecarlo.response import SETS, SIDES, _product

    first = responses[0]
    side = first.margin + 1
    padded = np.pad(strip.astype(float), ((1, 1), (side, side)))[:, None, :]
    total: Floats = np.zeros((len(responses), -(-(strip.shape[1] - first.columns + 1) // step)))
    for corner in range(SIDES):
        for subset in range(SETS):
            terms = np.stack([one.terms[:, corner, subset].sum(axis=0) for one in responses])
            if terms.any():
                product = _product(padded, corner, subset)[:, 0]
                windows = sliding_window_view(product, terms.shape[2], axis=1)[:, ::step]
                total += np.einsum("rij,iqj->rq", terms, windows)
    return total


def random_strip(rows: int, columns: int, percent: float, seed: int) -> NDArray[np.uint8]:
    """Random strip (row, column), 1 = open, each cell with the same probability.

    Examples
    --------
    >>> from shadowgram.experiments.studies._cxbi_maps import random_strip
    >>> float(random_strip(32, 543, 10, seed=0).mean().round(2))
    0.1
    """
    return (np.random.default_rng((seed, rows)).random((rows, columns)) < percent / 100).astype(np.uint8)


@lru_cache(maxsize=32)
def own_scatter(scene: str, percent: float, histories: int) -> float:
    """Mean counts in a shot, for one photon of the source, that do not come through the mask's cells: what the mask scatters."""
    from shadowgram.xray._scan_codes import coded
    from shadowgram.xray._scan_linear import _offset
    from shadowgram.xray.scan import with_transmittance

    bare = _scene(scene).without_targets()
    whole = coded(with_transmittance(bare, percent / 100), None, None)
    assert whole.strip is not None
    linear = response(scene, False, histories).shots(whole.strip)[:, : len(whole.steps)].sum(axis=0)
    return max(0.0, float(_offset(whole, linear, histories, 0, None)[0].mean()))


def photons_per_shot(scene: str) -> float:
    """Photons that a shipped scene's source emits in a shot."""
    return _scene(scene).photons_per_shot


def _scene(name: str):
    from shadowgram.xray.scene import shipped_scene

    return shipped_scene(name)
