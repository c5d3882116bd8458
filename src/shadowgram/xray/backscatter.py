"""What a scene gives back by single Compton scattering, cell by cell: an integral in place of a simulation.

Source: Salazar (2022), eqs. (4.8) and (4.9), with units that fit together: photons of a cell, times the chance to scatter at a
depth towards a place on a detector, times what is left of them on the ways there and back, times the chance of a count.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from shadowgram._threads import run_chunks

from ._mask_rays import share_of_source, through_cells

if TYPE_CHECKING:
    from ._compile import Compiled
    from .scene import Mask, Scene

Floats = NDArray[np.float64]

ENERGIES = 16
"""Most energies that a spectrum is merged into."""
DEPTHS = 6
"""Places in a piece of the target."""
PIECES = 16
"""Most pieces of target on a ray."""
SATURATED = 0.95
_FINE = 32  # steps in a piece, for the depth of saturation


@dataclass(frozen=True, kw_only=True, eq=False)
class Backscatter:
    """Single scattering of a scene's target.

    Attributes
    ----------
    image : (y, x) counts per photon of the source through each cell of the mask, if it and its neighbours are open; rows and
        columns are the mask's.
    depth95 : (y, x) mm along the ray, from where it meets the target, within which 95 % of these counts scatter; NaN where it meets
        none.
    """

    image: Floats
    depth95: Floats


def single_scatter(scene: Scene, *, rays: int = 5) -> Backscatter:
    """Compute what each cell of a scene's mask gives at the detectors by single Compton scattering in the target.

    Parameters
    ----------
    scene : with a mask, a target and detectors.
    rays : through each cell, which tell how much of it the target fills. With one the edges of the target are rough.

    Returns
    -------
    Backscatter

    Raises
    ------
    OSError
        If a file of the scene cannot be read.
    ValueError
        If the scene has no mask, target or detector, has voxels, is too intricate, or a number cannot be.

    Notes
    -----
    Ways are straight through all solids of the scene, with bound electrons (incoherent scattering functions) where photons scatter.
    Left out are what the holes' walls cut off and let through, the focal spot's size, and at the detectors the resolution and what
    escapes from them: a photon counts if it is above the threshold and interacts other than by Rayleigh scattering. For plates of
    sodium iodide and a threshold of 10 keV that is 4 to 5 % too much, since lines of iodine escape; the rest agrees with
    `shadowgram.xray.simulate` within 1 %. Multiple and Rayleigh scattering, fluorescence and air are no part of it.

    Examples
    --------
    >>> import shadowgram as sg
    >>> scene = sg.xray.shipped_scene("cxbi-blocks")
    >>> found = sg.xray.single_scatter(scene)
    >>> found.image.shape, round(float((found.image * scene.photons_per_shot).max()), 1)
    ((32, 32), 101.7)
    """
    from ._scan_blocks import check_whole

    count = check_whole("rays", rays, 1)
    mask, arrays = _opened(scene)
    start = np.array(scene.source.position)
    cells = through_cells(mask, start, count)
    share = share_of_source(scene, mask, cells) / count
    lit = share > 0
    directions = np.ascontiguousarray((cells / np.linalg.norm(cells, axis=0))[:, lit].T)
    counts, depth = _along_rays(arrays, start, directions)
    each, reach = np.zeros(share.shape), np.zeros(share.shape)
    each[lit] = share[lit] * counts
    reach[lit] = each[lit] * depth
    image = each.sum(axis=0)
    with np.errstate(invalid="ignore"):
        return Backscatter(image=image, depth95=reach.sum(axis=0) / image)


def _opened(scene: Scene) -> tuple[Mask, Compiled]:
    """The part of the mask in view with all of its cells open, and the scene with it in arrays."""
    from ._compile import compile_scene
    from ._scan_codes import mask_of
    from .montecarlo.arrays import VOXELS
    from .patterns import written

    mask = mask_of(scene)
    if all(solid.role != "target" for solid in scene.solids):
        raise ValueError('nothing is there to scatter: give a solid of this scene role = "target"')
    rows = written(np.ones((mask.rows, mask.columns_in_view), np.uint8))
    pattern = mask.pattern.model_copy(update={"rows": rows, "file": None, "transmittance": None, "seed": None})
    opened = mask.model_copy(update={"columns": mask.columns_in_view, "view": None, "pattern": pattern})
    # The tables of fluorescence take longer than all the rest.
    arrays = compile_scene(scene.model_copy(update={"mask": opened, "shots": 1, "fluorescence": False}))
    if (arrays.geometry.kind == VOXELS).any():
        raise ValueError(
            "single scattering is not computed in voxels; give the target as boxes, cylinders or meshes, or simulate it"
        )
    return opened, arrays


def _along_rays(arrays: Compiled, start: Floats, directions: Floats) -> tuple[Floats, Floats]:
    """(ray) counts per photon, and depths of saturation in mm."""
    from ._backscatter_kernels import fresh_work, single_scatter_rays
    from .montecarlo.arrays import desk

    energies, weights = _merged(arrays)
    nodes = _face_nodes(arrays)
    s, share = np.polynomial.legendre.leggauss(DEPTHS)
    s, share = (s + 1) / 2, share / 2
    depths = s * s  # closer together where a piece begins, and where most of the scattering is
    spans = np.zeros((len(directions), PIECES, 2))
    found = np.zeros((len(directions), PIECES, DEPTHS))
    lowest = np.maximum(arrays.detectors.threshold, arrays.scene.cutoff)
    fixed = (arrays.geometry, arrays.physics, arrays.detectors)
    failed: list[int] = []

    def follow(first: int, last: int) -> None:
        scratch = desk(len(arrays.solid_names), len(arrays.detector_names))
        work = fresh_work(PIECES, len(energies))
        given = (start, directions, energies, weights, lowest, depths, nodes, work, spans, found)
        if single_scatter_rays(first, last, *fixed, scratch, *given) >= 0:
            failed.append(first)

    run_chunks(follow, len(directions), 16)
    if failed:
        raise ValueError(
            "single scattering is not computed in a scene so intricate: a ray meets too many solids; simulate it"
        )
    counts = (found @ (share * 2 * s) * spans[:, :, 1]).sum(axis=1)
    depth = np.zeros(len(counts))
    hit = counts > 0
    if hit.any():
        used = int((spans[:, :, 1] > 0).sum(axis=1).max())
        depth[hit] = _saturation(found[hit, :used], spans[hit, :used], depths)
    return counts, depth


def _merged(arrays: Compiled) -> tuple[Floats, Floats]:
    """Energies of the source above the cut-off, merged into bins of equal width, and their weights, of which all would be 1."""
    spectrum = arrays.scene.source.spectrum.spectrum()
    kept = spectrum.energy >= arrays.scene.cutoff
    energy, weight = spectrum.energy[kept], spectrum.weight[kept] / spectrum.total
    if energy.size <= ENERGIES:
        return energy.copy(), weight
    edges = np.linspace(energy[0], energy[-1], ENERGIES + 1)[1:-1]
    place = np.searchsorted(edges, energy, side="right")
    total = np.bincount(place, weight, ENERGIES)
    mean = np.bincount(place, weight * energy, ENERGIES)[total > 0] / total[total > 0]
    return mean, np.asarray(total[total > 0], np.float64)


def _face_nodes(arrays: Compiled) -> Floats:
    """(detector, node, 6) places on the faces that targets can see: x, y, z, axis, side, and the area that each stands for, mm²."""
    from .montecarlo.arrays import TARGET

    geometry = arrays.geometry
    targets = geometry.box[geometry.role == TARGET]
    low, high = targets[:, :3].min(axis=0), targets[:, 3:].max(axis=0)
    listed = [_nodes_of(geometry.box[solid], low, high) for solid in arrays.detectors.solid]
    nodes = np.zeros((len(listed), max(map(len, listed)), 6))  # what is added has no area
    for row, found in zip(nodes, listed, strict=True):
        row[: len(found)] = found
    return nodes


def _nodes_of(box: Floats, low: Floats, high: Floats) -> Floats:
    """(node, 6) of one detector, seen from a box."""
    distance = float(np.linalg.norm(np.maximum(0, np.maximum(box[:3] - high, low - box[3:]))))
    found = [np.zeros((0, 6))]
    for axis in range(3):
        for side, place, seen in (
            (-1, box[axis], low[axis] < box[axis]),
            (1, box[3 + axis], high[axis] > box[3 + axis]),
        ):
            if seen:
                found.append(_face(box, axis, side, place, distance))
    return np.concatenate(found)


def _face(box: Floats, axis: int, side: int, place: float, distance: float) -> Floats:
    """(node, 6) of one face, by Gauss and Legendre: the more, the larger it is for its distance."""
    across, along = (axis + 1) % 3, (axis + 2) % 3
    (a, da), (b, db) = (_gauss(box[one], box[3 + one], distance) for one in (across, along))
    nodes = np.zeros((a.size, b.size, 6))
    nodes[..., axis], nodes[..., across], nodes[..., along] = place, a[:, None], b
    nodes[..., 3], nodes[..., 4], nodes[..., 5] = axis, side, da[:, None] * db
    return nodes.reshape(-1, 6)


def _gauss(low: float, high: float, distance: float) -> tuple[Floats, Floats]:
    """Places and weights on an interval seen from a distance."""
    length = high - low
    x, w = np.polynomial.legendre.leggauss(1 + min(10, round(1.5 * length / max(distance, 0.1 * length))))
    return low + length * (x + 1) / 2, length * w / 2


def _saturation(found: Floats, spans: Floats, depths: Floats) -> Floats:
    """(ray) mm from the beginning of the first piece of target within which `SATURATED` of the counts scatter.

    Between the places the counts are taken as exponentials.
    """
    edges = np.linspace(0, 1, _FINE + 1) ** 2
    middle = (edges[1:] + edges[:-1]) / 2
    k = np.clip(np.searchsorted(depths, middle) - 1, 0, depths.size - 2)
    part = (middle - depths[k]) / (depths[k + 1] - depths[k])
    logs = np.log(np.maximum(found, np.finfo(float).tiny))
    steps = np.exp(logs[..., k] * (1 - part) + logs[..., k + 1] * part) * np.diff(edges) * spans[..., 1:]
    ends = spans[..., :1] - spans[:, :1, :1] + edges[1:] * spans[..., 1:]
    widths = np.diff(edges) * spans[..., 1:]
    steps, ends, widths = (values.reshape(len(found), -1) for values in (steps, ends, widths))
    upto = np.cumsum(steps, axis=1)
    wanted = SATURATED * upto[:, -1]
    at = np.minimum((upto < wanted[:, None]).sum(axis=1), upto.shape[1] - 1)
    row = np.arange(len(found))
    beyond = (upto[row, at] - wanted) / steps[row, at]
    return ends[row, at] - beyond * widths[row, at]
