"""Pictures of X-ray scenes: the scanner in space, the mask in view, and what stands before it."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import ListedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

from shadowgram.codes._rectangles import merged
from shadowgram.scenes.readers.atomic import replace_file
from shadowgram.xray._layout import detector_corners, placed_solids, world_corners
from shadowgram.xray._placed import Placed, across, contains
from shadowgram.xray._solids import Voxels

from ._surfaces import Polygons, cuboid, surface
from .style import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION, YELLOW, new_figure, png, style

if TYPE_CHECKING:
    from shadowgram.xray.scene import Mask, Scene, Solid

Floats = NDArray[np.float64]

TARGETS = (VERMILION, BLUE, GREEN, PURPLE, ORANGE, YELLOW)
SHIELD, ENVIRONMENT, DETECTOR, MASK, BEAM = "#6b7480", "#c3cad3", SKY, "#3a4048", ORANGE
GRID = "#d5dae0"
_LIGHT = np.array([-0.35, 0.75, -0.55])  # where it comes from
_RAYS = 12
_LINE = 0.7  # pt; one for all, since they are not sorted with the polygons
_STEPS = 24  # pieces of a ray
_WIDEST = 1.4  # rad, half angle of a cone that is drawn


@dataclass(frozen=True, kw_only=True, eq=False)
class Piece:
    """A surface to be drawn.

    Attributes
    ----------
    polygons : (corner, 3) each, world, mm.
    colour, opacity : of its faces.
    edges : whether the edges of its faces are drawn.
    target : whether it is something to look at.
    """

    polygons: Polygons
    colour: str
    opacity: float
    edges: bool = False
    target: bool = False


def draw(scene: Scene, path: str | os.PathLike[str], *, shot: int = 0) -> None:
    """Write the picture of a scene to a PNG file.

    Raises
    ------
    OSError
        If the file, or one that the scene names, cannot be read or written.
    ValueError
        If a file that the scene names does not hold what it should.
    """
    with style():
        replace_file(path, [png(picture(scene, shot=shot))])


def picture(scene: Scene, *, shot: int = 0) -> Figure:
    """A scene in space with the beam to the right; beside it the mask in view and what stands before it.

    Parameters
    ----------
    shot : which the mask is drawn at.

    Examples
    --------
    >>> from shadowgram.figures.xray_scene import picture
    >>> from shadowgram.xray.scene import shipped_scene
    >>> [axes.get_title() for axes in picture(shipped_scene("cxbi-ud")).axes[1:]]
    ['Mask, shot 0 of 512', 'Targets and field']
    """
    placed = placed_solids(scene, files=True)
    pieces = [_piece(scene, solid, placed) for solid in scene.solids]
    pieces += [
        Piece(polygons=cuboid(*detector_corners(one)), colour=DETECTOR, opacity=0.3, edges=True)
        for one in scene.detectors
    ]
    figure = new_figure(11.0, 6.0)
    figure.set_layout_engine("none")
    with mpl.rc_context({"grid.color": GRID, "grid.linewidth": 0.6}):
        room: Any = figure.add_axes((0.0, 0.12, 0.72, 0.84), projection="3d", computed_zorder=False)
    _draw_room(room, scene, pieces, shot)
    figure.suptitle(scene.title, x=0.02, y=0.975, ha="left", weight="bold", fontsize=11)
    figure.legend(handles=_legend(scene), loc="lower center", ncols=4, bbox_to_anchor=(0.36, 0.01))
    if scene.mask is not None:
        _draw_mask(figure.add_axes((0.76, 0.6, 0.22, 0.33)), scene.mask, shot, scene.shots)
    targets = [piece for piece in pieces if piece.target]
    if targets:
        place = (0.76, 0.13, 0.22, 0.33) if scene.mask is not None else (0.76, 0.3, 0.22, 0.42)
        _draw_targets(figure.add_axes(place), scene, targets)
    return figure


def _piece(scene: Scene, solid: Solid, placed: Mapping[str, Placed]) -> Piece:
    world = scene.world.material.material()
    filled = None
    if isinstance(solid.shape, Voxels):
        filled = np.array([one.material() != world for one in solid.materials])
    polygons = _not_inside(surface(placed[solid.name], filled), _covering(scene, solid, placed))
    flat = solid.shape.kind == "box"
    if solid.role == "target":
        return Piece(
            polygons=polygons, colour=_target_colours(scene)[_made_of(solid)], opacity=1.0, edges=flat, target=True
        )
    if solid.role == "shield":
        return Piece(polygons=polygons, colour=SHIELD, opacity=0.85, edges=flat)
    return Piece(polygons=polygons, colour=ENVIRONMENT, opacity=0.35, edges=flat)


def _covering(scene: Scene, solid: Solid, placed: Mapping[str, Placed]) -> list[Placed]:
    """The solids inside which nothing is seen of this one: those that count over it, and those of its own material."""
    place = scene.solids.index(solid)
    mine = placed[solid.name]
    return [
        placed[other.name]
        for i, other in enumerate(scene.solids)
        if (i > place or (i < place and other.material == solid.material))
        and not isinstance(other.shape, Voxels)
        and ((placed[other.name].low < mine.high) & (placed[other.name].high > mine.low)).all()
    ]


def _not_inside(polygons: Polygons, covering: Sequence[Placed]) -> Polygons:
    """The polygons of which some corner is in none of the solids."""
    if not covering or not polygons:
        return polygons
    corners = np.concatenate(polygons)
    start = np.cumsum([0, *(len(polygon) for polygon in polygons[:-1])])
    for solid in covering:
        hidden = np.logical_and.reduceat(contains(solid, corners), start)
        polygons = [polygon for polygon, gone in zip(polygons, hidden, strict=True) if not gone]
        if not polygons:
            break
        corners = np.concatenate(polygons)
        start = np.cumsum([0, *(len(polygon) for polygon in polygons[:-1])])
    return polygons


def _made_of(solid: Solid) -> str:
    return "voxels" if solid.material is None else solid.material.material().name


def _target_colours(scene: Scene) -> dict[str, str]:
    names = dict.fromkeys(_made_of(solid) for solid in scene.solids if solid.role == "target")
    return {name: TARGETS[i % len(TARGETS)] for i, name in enumerate(names)}


# ---- the room ----------------------------------------------------------------------------------------------------------------


def _draw_room(axes: Any, scene: Scene, pieces: Sequence[Piece], shot: int) -> None:
    low, high = _extent(scene, pieces)
    shown = list(pieces)
    if scene.mask is not None:
        shown.append(Piece(polygons=_mask_sheet(scene.mask, shot, low, high), colour=MASK, opacity=0.95))
    polygons, faces, edges = [], [], []
    for piece in shown:
        for polygon in piece.polygons:
            colour = _lit(polygon, piece.colour)
            polygons.append(polygon)
            faces.append((*colour, piece.opacity))
            edges.append((*(0.45 * np.array(colour)), 0.9) if piece.edges else (*colour, piece.opacity))
    for line in _beam(scene, pieces, high):
        # As flat triangles among the others, so that what stands before a ray hides it.
        steps = np.linspace(0, 1, _STEPS)[:, None]
        points = np.concatenate([a + steps * (b - a) for a, b in pairwise(line)])
        for a, b in pairwise(points):
            polygons.append(np.stack([a, b, a]))
            faces.append((*to_rgb(BEAM), 1.0))
            edges.append((*to_rgb(BEAM), 1.0))
    _set_axes(axes, low, high)
    turned = [_turned(polygon) for polygon in polygons]
    axes.add_collection3d(Poly3DCollection(turned, facecolors=faces, edgecolors=edges, linewidths=_LINE, clip_on=False))
    _name_things(axes, scene)


def _turned(points: Floats) -> Floats:
    """World (x, y, z) → axes of the picture: z to the right, x into it, y up."""
    return np.asarray(points)[..., [2, 0, 1]]


def _lit(polygon: Floats, colour: str) -> tuple[float, float, float]:
    """The colour of a face by how it looks at the light."""
    normal = np.cross(polygon, np.roll(polygon, -1, axis=0)).sum(axis=0)  # Newell's
    length = np.linalg.norm(normal)
    shade = 1.0 if length == 0 else 0.7 + 0.3 * abs(normal @ _LIGHT) / (length * np.linalg.norm(_LIGHT))
    red, green, blue = (float(shade * part) for part in to_rgb(colour))
    return red, green, blue


def _extent(scene: Scene, pieces: Sequence[Piece]) -> tuple[Floats, Floats]:
    """Corners of what is shown: all but the ends of the mask, which slides far to the sides."""
    points = [np.concatenate(piece.polygons) for piece in pieces if piece.polygons]
    points.append(np.array([scene.source.position]))
    if scene.mask is not None:
        half = _window(scene.mask) * 1.15
        centre = np.array(scene.mask.position)
        points += [centre + np.array([[-1.0], [1.0]]) * np.append(half, 0)]
        field = _field(scene, pieces)
        points += [] if field is None else [field]
    every = np.concatenate(points)
    outer_low, outer_high = world_corners(scene.world)
    low, high = np.maximum(every.min(axis=0), outer_low), np.minimum(every.max(axis=0), outer_high)
    if not (high > low).any():  # nothing but a source
        return outer_low, outer_high
    least = 0.12 * (high - low).max()  # thin scenes get some room
    thin = np.maximum(least - (high - low), 0) / 2
    return low - thin, high + thin


def _window(mask: Mask) -> Floats:
    """Half width and half height of the field at the mask."""
    return np.array([mask.columns_in_view, mask.rows]) * mask.pitch / 2


def _field(scene: Scene, pieces: Iterable[Piece]) -> Floats | None:
    """(4, 3) corners of what the window lets the source see at the front of the targets; None where there is no such place."""
    nearest = [np.concatenate(piece.polygons)[:, 2].min() for piece in pieces if piece.target]
    if scene.mask is None or not nearest:
        return None
    source, centre, front = np.array(scene.source.position), np.array(scene.mask.position), min(nearest)
    if not source[2] < centre[2] < front:
        return None
    x, y = _window(scene.mask)
    corners = centre + np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]])
    return source + (corners - source) * (front - source[2]) / (centre[2] - source[2])


def _mask_sheet(mask: Mask, shot: int, low: Floats, high: Floats) -> Polygons:
    """The closed parts of the mask that lie between two corners, as rectangles at the mask's middle."""
    x0, y0, z = mask.plate_centre(shot)
    half = np.array([mask.columns, mask.rows]) * mask.pitch / 2
    cells = mask.cells()[:: -mask.row_direction, :: mask.column_direction]  # top row first, x to the right
    closed = merged(cells == 0) * mask.pitch
    found = [
        (x0 - half[0] + left, x0 - half[0] + right, y0 + half[1] - bottom, y0 + half[1] - top)
        for top, bottom, left, right in closed
    ]
    width, height = np.array(mask.plate) / 2
    found += [(x0 - width, x0 + width, y0 + half[1], y0 + height), (x0 - width, x0 + width, y0 - height, y0 - half[1])]
    found += [
        (x0 - width, x0 - half[0], y0 - half[1], y0 + half[1]),
        (x0 + half[0], x0 + width, y0 - half[1], y0 + half[1]),
    ]
    sheet = []
    for left, right, bottom, top in found:
        left, right = max(left, low[0]), min(right, high[0])
        bottom, top = max(bottom, low[1]), min(top, high[1])
        if left < right and bottom < top:
            sheet.append(np.array([[left, bottom, z], [right, bottom, z], [right, top, z], [left, top, z]]))
    return sheet


def _beam(scene: Scene, pieces: Sequence[Piece], high: Floats) -> list[Floats]:
    """Lines, each (point, 3): the cone as far as the mask, and the part of it that fills the window; without a mask all."""
    source = scene.source
    position, axis = np.array(source.position), np.array(source.direction)
    field = _field(scene, pieces)
    lines: list[Floats] = []
    forward = axis[2] > 0.05
    reach = float((high[2] - position[2]) / axis[2] if forward else np.linalg.norm(high - position) / 2)
    if field is not None and scene.mask is not None:
        lines += [np.stack([position, corner]) for corner in field]
        lines.append(np.concatenate([field, field[:1]]))
        reach = float((scene.mask.position[2] - position[2]) / axis[2]) if forward else reach
    if source.half_angle == 0:
        lines.append(np.stack([position, position + reach * axis]))
    elif source.half_angle < _WIDEST:
        around = np.linspace(0, 2 * np.pi, 4 * _RAYS + 1)
        first, second = across(axis)
        spread = reach * np.tan(source.half_angle)
        rim = position + reach * axis + spread * (np.outer(np.cos(around), first) + np.outer(np.sin(around), second))
        lines += [rim, *(np.stack([position, point]) for point in rim[:-1:4])]
    return lines


def _name_things(axes: Any, scene: Scene) -> None:
    paper = axes.figure.get_facecolor()
    things = [("source", np.array(scene.source.position))]
    if scene.mask is not None:
        top = scene.mask.position + np.array([0, 1.5 * _window(scene.mask)[1], 0])
        things.append(("mask", top))
    for detector in scene.detectors:
        low, upper = detector_corners(detector)
        things.append((detector.name, np.array([(low[0] + upper[0]) / 2, upper[1], (low[2] + upper[2]) / 2])))
    place = _turned(np.array(scene.source.position))
    axes.scatter(*place[:, None], color=BEAM, edgecolors="black", linewidths=0.6, s=34, zorder=6, depthshade=False)
    for name, point in things:
        text = axes.text(*_turned(point), f"{name}\n", ha="center", va="bottom", fontsize=8, zorder=8, linespacing=0.5)
        text.set_path_effects([withStroke(linewidth=2.5, foreground=paper)])


def _set_axes(axes: Any, low: Floats, high: Floats) -> None:
    spans = _turned(high - low)
    axes.autoscale(enable=False)
    axes.set_box_aspect(tuple(spans), zoom=1.15 if spans[2] < 0.75 * spans.max() else 1.06)
    for name, start, stop in zip("xyz", _turned(low), _turned(high), strict=True):
        getattr(axes, f"set_{name}lim")(start, stop)
        axis = getattr(axes, f"{name}axis")
        axis.set_pane_color((*to_rgb(GRID), 0.25))
        share = (stop - start) / spans.max()
        axis.set_major_locator(_few_ticks(8 if share > 0.6 else 5 if share > 0.25 else 3))
    axes.set(xlabel="z (mm)", ylabel="x (mm)", zlabel="y (mm)")
    axes.view_init(elev=22, azim=-107)  # from beside the source, so that the plates hide nothing


def _few_ticks(most: int) -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(most, steps=[1, 2, 5, 10])


def _legend(scene: Scene) -> list[Patch | Line2D]:
    colours = _target_colours(scene)
    found: list[Patch | Line2D] = [Patch(facecolor=colour, label=f"target: {name}") for name, colour in colours.items()]
    roles = {solid.role for solid in scene.solids}
    if scene.detectors:
        names = dict.fromkeys(one.material.material().name for one in scene.detectors)
        found.append(Patch(facecolor=DETECTOR, alpha=0.5, label=f"detector: {', '.join(names)}"))
    for role, colour in (("shield", SHIELD), ("environment", ENVIRONMENT)):
        if role in roles:
            names = dict.fromkeys(_made_of(solid) for solid in scene.solids if solid.role == role)
            found.append(Patch(facecolor=colour, label=f"{role}: {', '.join(names)}"))
    if scene.mask is not None:
        found.append(Patch(facecolor=MASK, label=f"mask: {scene.mask.material.material().name}"))
    return [*found, Line2D([], [], color=BEAM, label="beam")]


# ---- the panels --------------------------------------------------------------------------------------------------------------


def _draw_mask(axes: Axes, mask: Mask, shot: int, shots: int) -> None:
    code = mask.code(shot)[:: -mask.row_direction, :: mask.column_direction]
    (x, y), (width, height) = mask.position[:2], _window(mask)
    extent = (x - width, x + width, y - height, y + height)
    axes.imshow(code, cmap=ListedColormap([MASK, "white"]), extent=extent, origin="upper", vmin=0, vmax=1)
    of = f" of {shots}" if shots > 1 else ""
    share = f"{code.shape[0]} × {code.shape[1]} cells of {mask.pitch:g} mm, {100 * code.mean():.3g} % open"
    axes.set(title=f"Mask, shot {shot}{of}" if shots > 1 else "Mask", xlabel=f"x (mm)\n{share}", ylabel="y (mm)")
    axes.grid(visible=False)


def _draw_targets(axes: Axes, scene: Scene, targets: Sequence[Piece]) -> None:
    """What stands in the beam from the front, the nearest on top."""
    parts = [(polygon, piece.colour) for piece in targets for polygon in piece.polygons]
    parts.sort(key=lambda part: -part[0][:, 2].mean())
    colours = [_lit(polygon, colour) for polygon, colour in parts]
    flat = [polygon[:, :2] for polygon, _ in parts]
    axes.set_axisbelow(True)
    axes.add_collection(PolyCollection(flat, facecolors=colours, edgecolors=colours, linewidths=0.3))
    field = _field(scene, targets)
    every = np.concatenate(flat)
    if field is not None:
        closed = np.concatenate([field, field[:1]])
        axes.plot(closed[:, 0], closed[:, 1], color=BEAM, linewidth=1.4)
        every = np.concatenate([every, field[:, :2]])
    low, high = every.min(axis=0), every.max(axis=0)
    middle, half = (low + high) / 2, 0.54 * (high - low).max()
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half), aspect="equal")
    axes.set(title="Targets and field" if field is not None else "Targets", xlabel="x (mm)", ylabel="y (mm)")
    if field is not None and scene.mask is not None:
        cell = (field[1, 0] - field[0, 0]) / scene.mask.columns_in_view
        axes.set_xlabel(f"x (mm)\na cell is {cell:.3g} mm at z = {field[0, 2]:.4g} mm")
