"""A small ray caster for the generated scene: a canvas of samples, cards, balls, and soft shadows in closed form.

World coordinates: x to the right, y up, z towards the camera; y = 0 is the table. Points and directions are (3, ...) float32.
Objects are painted from far to near, so that no depth is kept.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from . import _chart_parts as parts
from ._chart_parts import Paint, dot, ramp, unit

WALL = -1.5  # z of the backdrop
GLASS_RADIUS = 0.36
RING_RADIUS = 0.41
_SOFTNESS = 0.11  # half the angle of the lamp, rad: half the width of a shadow's edge at distance 1

Window = tuple[slice, slice]  # rows and columns of samples


@dataclass(frozen=True)
class Camera:
    """A pinhole and where its picture lies."""

    position: np.ndarray
    right: np.ndarray
    up: np.ndarray
    forward: np.ndarray
    slope: float  # half the shorter side of the picture, at distance 1

    @classmethod
    def looking(cls, position: tuple[float, ...], target: tuple[float, ...], slope: float) -> Camera:
        """Camera at `position`, with `target` in the middle of the picture."""
        forward = unit(np.subtract(target, position))
        right = unit(np.cross(forward, [0.0, 1.0, 0.0]))
        return cls(np.asarray(position), right, np.cross(right, forward), forward, slope)

    def rays(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Unit directions (3, ...) through the points (u, v) of the picture, whose shorter side runs from −1 to 1."""
        ahead, right, up = (a.astype(np.float32) for a in (self.forward, self.slope * self.right, self.slope * self.up))
        return unit(np.stack([ahead[k] + right[k] * u + up[k] * v for k in range(3)]))

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where points (3, ...) are in the picture, (u, v), and their distance along the view."""
        d = points - self.position.reshape(3, *[1] * (points.ndim - 1))
        depth = dot(self.forward, d)
        scale = np.maximum(depth, 1e-3) * self.slope
        return dot(self.right, d) / scale, dot(self.up, d) / scale, depth


@dataclass(frozen=True)
class Canvas:
    """Samples of some rows of the picture: two materials, their mixture and light, and a gloss on top.

    Radiance = (1 − gloss) · light · [(1 − share) · first + share · second] + gloss · shine.
    """

    u: np.ndarray  # (columns,) rising
    v: np.ndarray  # (rows,) falling
    first: np.ndarray  # (rows, columns) material
    second: np.ndarray
    shine: np.ndarray  # the lamp or an LED
    share: np.ndarray
    light: np.ndarray
    gloss: np.ndarray

    @classmethod
    def blank(cls, u: np.ndarray, v: np.ndarray) -> Canvas:
        """Black samples at all (u, v)."""
        shape = (v.size, u.size)
        first, second, shine = (np.full(shape, number, np.uint8) for number in (parts.BLACK, parts.BLACK, parts.LAMP))
        share, light, gloss = (np.zeros(shape, np.float32) for _ in range(3))
        return cls(u, v, first, second, shine, share, light, gloss)

    def window(self, u: ArrayLike, v: ArrayLike) -> Window:
        """Samples in the smallest rectangle around the points (u, v)."""
        rows = np.searchsorted(-self.v, [-np.max(v), -np.min(v)])
        columns = np.searchsorted(self.u, [np.min(u), np.max(u)])
        return slice(*map(int, rows)), slice(*map(int, columns))

    def samples(self, window: Window, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """Flat indices (n,) of the samples in a window, and the rays (3, n) through them."""
        rows, columns = (np.arange(part.start, part.stop) for part in window)
        rays = camera.rays(self.u[None, window[1]], self.v[window[0], None])
        return (rows[:, None] * self.u.size + columns).ravel(), rays.reshape(3, -1)

    def paint(self, at: np.ndarray, paint: Paint, light: np.ndarray, gloss: np.ndarray | float = 0.0) -> None:
        """Cover the samples at the flat indices `at`."""
        first, second, share = paint
        for target, value in (
            (self.first, first),
            (self.second, second),
            (self.shine, parts.LAMP),
            (self.share, share),
            (self.light, light),
            (self.gloss, gloss),
        ):
            target.ravel()[at] = value

    def abundances(self, factor: int) -> np.ndarray:
        """How much of each material is in each pixel of factor × factor samples, (material, y, x) float32."""
        rows, columns = self.v.size // factor, self.u.size // factor
        pixel = (np.arange(self.v.size) // factor)[:, None] * columns + np.arange(self.u.size) // factor
        total = np.zeros(parts.MATERIALS * rows * columns)
        body = self.light * (1 - self.gloss)
        for material, weight in (
            (self.first, body * (1 - self.share)),
            (self.second, body * self.share),
            (self.shine, self.gloss),
        ):
            index = material.astype(np.int64) * (rows * columns) + pixel
            total += np.bincount(index.ravel(), weight.ravel(), total.size)
        return (total / factor**2).astype(np.float32).reshape(parts.MATERIALS, rows, columns)


@dataclass(frozen=True)
class Ball:
    """A bead, or the dome of an LED."""

    centre: np.ndarray
    radius: float
    materials: tuple[int, int]
    pattern: str  # "plain", "stripes", "marble" or "led"
    axis: np.ndarray  # of the stripes and of the hole
    drilled: bool


@dataclass(frozen=True)
class Card:
    """A flat rectangle with a drawing on it."""

    corner: np.ndarray  # where s = t = 0
    along: np.ndarray  # side from s = 0 to s = 1
    upward: np.ndarray  # side from t = 0 to t = 1, at a right angle to the other
    drawing: Callable[[np.ndarray, np.ndarray], Paint]

    @cached_property
    def normal(self) -> np.ndarray:
        """Unit normal on the side with the drawing."""
        return unit(np.cross(self.along, self.upward))

    def corners(self, low: float, high: float) -> np.ndarray:
        """The points (3, 4) where s and t are `low` or `high`."""
        return np.stack(
            [self.corner + a * self.along + b * self.upward for a in (low, high) for b in (low, high)], axis=1
        )

    def local(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates s and t of points (3, ...) on the card."""
        s, t = (side / dot(side, side) for side in (self.along, self.upward))
        return (
            dot(s.astype(np.float32), points) - np.float32(dot(s, self.corner)),
            dot(t.astype(np.float32), points) - np.float32(dot(t, self.corner)),
        )

    def hides(self, points: np.ndarray, lamp: np.ndarray) -> np.ndarray:
        """Share of the lamp that the card hides from `points`."""
        normal = self.normal.astype(np.float32)
        away = (np.float32(dot(self.normal, self.corner)) - dot(normal, points)) / dot(normal, lamp)
        s, t = self.local(points + lamp.reshape(3, *[1] * (points.ndim - 1)) * away)
        blur = _SOFTNESS * np.maximum(away, 0) + 0.01
        s_blur, t_blur = (blur / np.float32(np.linalg.norm(side)) for side in (self.along, self.upward))
        inside = ramp(s / s_blur, -1, 1) * ramp((1 - s) / s_blur, -1, 1)
        return inside * ramp(t / t_blur, -1, 1) * ramp((1 - t) / t_blur, -1, 1) * (away > 0)


@dataclass(frozen=True)
class StillLife:
    """All that a seed decides."""

    camera: Camera
    lamp: np.ndarray  # direction
    tile: np.ndarray  # of noise
    threads: tuple[int, int]  # materials of the backdrop
    cards: tuple[Card, ...]
    glass: np.ndarray  # centre of the didymium glass
    beads: tuple[Ball, ...]
    leds: tuple[Ball, ...]

    @cached_property
    def bead_places(self) -> tuple[np.ndarray, np.ndarray]:
        """Centres (bead, 3) and radii (bead,)."""
        return np.stack([bead.centre for bead in self.beads]), np.array([bead.radius for bead in self.beads])


def render(scene: StillLife, size: tuple[int, int], rows: slice, factor: int) -> np.ndarray:
    """Abundances (material, y, x) in some rows of a picture of `size` pixels, each of factor × factor samples."""
    ny, nx = (n * factor for n in size)
    half = min(ny, nx) / 2
    u = (np.arange(nx) + 0.5 - nx / 2) / half
    v = (ny / 2 - 0.5 - np.arange(rows.start * factor, rows.stop * factor)) / half
    canvas = Canvas.blank(u.astype(np.float32), v.astype(np.float32))
    _paint_room(canvas, scene)
    for card in scene.cards:
        _paint_card(canvas, scene, card)
    balls = sorted((*scene.beads, *scene.leds), key=lambda ball: -scene.camera.project(ball.centre)[2])
    glass_depth = scene.camera.project(scene.glass)[2]
    behind = sum(bool(scene.camera.project(ball.centre)[2] > glass_depth) for ball in balls)
    for ball in balls[:behind]:
        _paint_ball(canvas, scene, ball)
    _paint_glass(canvas, scene)
    for ball in balls[behind:]:
        _paint_ball(canvas, scene, ball)
    for led in scene.leds:
        _paint_glow(canvas, scene, led)
    return canvas.abundances(factor)


def _is_empty(window: Window) -> bool:
    return any(part.start >= part.stop for part in window)


def _open_light(scene: StillLife, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Light of the lamp and of the room on surfaces, before anything stands in the way."""
    x, y, z = points
    falloff = 1 / (1 + 0.035 * ((x + 0.5) ** 2 + (y - 0.8) ** 2 + 0.6 * (z - 0.3) ** 2))
    lamp = 0.80 * np.maximum(dot(scene.lamp, normals), 0) * falloff
    corner = np.maximum(z - WALL, 0) + np.maximum(y, 0)  # where wall and table meet, little of the room is seen
    return lamp, (0.20 + 0.08 * normals[1]) * (1 - 0.45 * np.exp(-corner / 0.25))


def _shade(
    light: tuple[np.ndarray, np.ndarray],
    scene: StillLife,
    points: np.ndarray,
    normals: np.ndarray,
    centre: np.ndarray,
    radius: float,
) -> None:
    """Take away, in place, the light of the lamp and of the room that a ball keeps from `points`.

    The lamp: how far the ray to its middle passes the ball, compared with the width of the lamp there. The room: the share of it
    that a ball at distance d covers, weighted with the cosine, is (r / d)² cos θ.
    """
    x, y, z = (np.float32(centre[k]) - points[k] for k in range(3))
    square = x * x + y * y + z * z
    along = x * scene.lamp[0] + y * scene.lamp[1] + z * scene.lamp[2]
    miss = np.sqrt(np.maximum(square - along * along, 0))
    blur = _SOFTNESS * np.maximum(along, 0) + np.float32(0.004)
    lamp, room = light
    lamp *= 1 - ramp((np.float32(radius) - miss) / blur, -1, 1) * (along > 0)
    square = np.maximum(square, np.float32(radius**2))
    cosine = (x * normals[0] + y * normals[1] + z * normals[2]) / np.sqrt(square)
    room *= 1 - np.maximum(cosine, 0) * (np.float32(radius**2) / square)


def _paint_room(canvas: Canvas, scene: StillLife) -> None:
    """Table and backdrop."""
    camera = scene.camera
    rays = camera.rays(canvas.u[None, :], canvas.v[:, None])
    eye = camera.position.astype(np.float32)
    far = (np.float32(WALL) - eye[2]) / rays[2]
    on_table = eye[1] + far * rays[1] < 0
    far = np.where(on_table, -eye[1] / np.minimum(rays[1], -1e-6), far)
    points = np.stack([eye[k] + far * rays[k] for k in range(3)])
    normals = np.stack([np.zeros_like(far), on_table.astype(np.float32), 1 - on_table.astype(np.float32)])
    lamp, room = _open_light(scene, points, normals)
    for card in scene.cards:
        window = _reach_of_card(canvas, scene, card)
        if not _is_empty(window):
            lamp[window] *= 1 - card.hides(points[:, *window], scene.lamp)
    for ball in (*scene.beads, *scene.leds):
        window = _reach_on_table(canvas, scene, ball)
        if not _is_empty(window):
            light = lamp[window], room[window]
            _shade(light, scene, points[:, *window], normals[:, *window], ball.centre, ball.radius)
    light = (lamp + room).ravel()
    x, y, z = points.reshape(3, -1)
    at = np.flatnonzero(on_table)
    paint, factor = parts.wood(x[at], z[at], scene.tile)
    canvas.paint(at, paint, light[at] * factor)
    at = np.flatnonzero(~on_table)
    paint, factor = parts.weave(x[at], y[at], scene.tile, scene.threads)
    canvas.paint(at, paint, light[at] * factor)


def _reach_on_table(canvas: Canvas, scene: StillLife, ball: Ball) -> Window:
    """Window in which a ball darkens the table."""
    x, _, z = ball.centre
    r = ball.radius
    dx, dz = -2 * r * scene.lamp[[0, 2]] / scene.lamp[1]
    xs = np.array([x - 4 * r, x + 4 * r, x + dx - 2 * r, x + dx + 2 * r])
    zs = np.maximum([z - 4 * r, z + 4 * r, z + dz - 2 * r, z + dz + 2 * r], WALL)
    corners = np.array([[a, 0.0, b] for a in (xs.min(), xs.max()) for b in (zs.min(), zs.max())]).T
    u, v, _ = scene.camera.project(corners)
    return canvas.window(u, v)


def _reach_of_card(canvas: Canvas, scene: StillLife, card: Card) -> Window:
    """Window in which a card can darken the table and the backdrop."""
    corners = card.corners(-0.1, 1.1)
    reach = np.minimum(np.maximum(corners[1], 0) / scene.lamp[1], (corners[2] - WALL) / scene.lamp[2])
    u, v, _ = scene.camera.project(np.concatenate([corners, corners - reach * scene.lamp[:, None]], axis=1))
    return canvas.window(u, v)


def _paint_card(canvas: Canvas, scene: StillLife, card: Card) -> None:
    u, v, _ = scene.camera.project(card.corners(0, 1))
    window = canvas.window(u, v)
    if _is_empty(window):
        return
    at, rays = canvas.samples(window, scene.camera)
    normal = card.normal.astype(np.float32)
    far = np.float32(dot(card.normal, card.corner - scene.camera.position)) / dot(normal, rays)
    points = scene.camera.position.astype(np.float32)[:, None] + far * rays
    s, t = card.local(points)
    on = (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    at, points, s, t = at[on], points[:, on], s[on], t[on]
    normals = np.broadcast_to(normal[:, None], points.shape)
    light = _open_light(scene, points, normals)
    middle, reach = card.corner + 0.5 * (card.along + card.upward), 0.5 * np.linalg.norm(card.along + card.upward)
    for bead in scene.beads:
        if np.linalg.norm(bead.centre - middle) < reach + 4 * bead.radius:
            _shade(light, scene, points, normals, bead.centre, bead.radius)
    canvas.paint(at, card.drawing(s, t), light[0] + light[1])


def _paint_ball(canvas: Canvas, scene: StillLife, ball: Ball) -> None:
    camera = scene.camera
    u, v, depth = camera.project(ball.centre)
    margin = 1.3 * ball.radius / (depth * camera.slope)
    window = canvas.window([u - margin, u + margin], [v - margin, v + margin])
    if _is_empty(window):
        return
    at, rays = canvas.samples(window, camera)
    offset = (camera.position - ball.centre).astype(np.float32)
    along = dot(offset, rays)
    inside = along**2 - np.float32(dot(offset, offset) - ball.radius**2)
    on = inside > 0
    at, rays = at[on], rays[:, on]
    normals = (offset[:, None] - (along[on] + np.sqrt(inside[on])) * rays) / np.float32(ball.radius)
    facing = -dot(normals, rays)
    if ball.pattern == "led":
        # A milky dome: it shines from within, and a little daylight falls on it.
        canvas.paint(at, (*ball.materials, 0.05), 0.62 + 0.38 * ramp(facing, 0.1, 0.8))
        return
    x, y, z = 0.21 * normals
    veins = parts.sample(scene.tile, x + np.float32(ball.centre[0]), y + z + np.float32(ball.centre[1]))
    paint, dark = parts.bead(ball.pattern, ball.materials, ball.axis, ball.drilled, normals, veins)
    mirrored = rays + 2 * facing * normals
    rim = 0.04 + 0.50 * (1 - np.clip(facing, 0, 1)) ** 5
    gloss = 0.97 * _window_reflection(mirrored, scene.lamp) + 0.55 * rim * ramp(mirrored[1], 0.0, 0.8)
    canvas.paint(at, paint, _bead_light(scene, ball, normals) * (1 - 0.93 * dark), np.clip(gloss * (1 - dark), 0, 1))


def _bead_light(scene: StillLife, ball: Ball, normals: np.ndarray) -> np.ndarray:
    points = ball.centre.astype(np.float32)[:, None] + np.float32(ball.radius) * normals
    lamp = 0.76 * np.maximum(dot(scene.lamp, normals), 0)  # with the room no more than 1
    up = 0.5 + 0.5 * normals[1]
    # The room above; below, what the table gives back where the bead itself does not shade it.
    room = 0.26 * up + 0.13 * (1 - up) * ramp(points[1] / np.float32(ball.radius), 0.0, 1.2)
    centres, radii = scene.bead_places
    gap = np.linalg.norm(centres - ball.centre, axis=1)
    for near in np.flatnonzero((gap > 0) & (gap < 3.5 * radii + ball.radius)):
        _shade((lamp, room), scene, points, normals, centres[near], radii[near])
    return lamp + room


def _window_reflection(directions: np.ndarray, lamp: np.ndarray) -> np.ndarray:
    """How bright a window of four panes, in the direction of the lamp, is seen along `directions` (3, n)."""
    right = unit(np.cross(lamp, [0.0, 1.0, 0.0])).astype(np.float32)
    facing = dot(lamp, directions)
    safe = np.maximum(facing, 1e-3)
    a, b = np.abs(dot(right, directions) / safe), np.abs(dot(np.cross(right, lamp), directions) / safe)
    panes = (1 - ramp(a, 0.36, 0.44)) * (1 - ramp(b, 0.42, 0.50)) * ramp(a, 0.03, 0.06) * ramp(b, 0.03, 0.06)
    return panes * (facing > 0)


def _paint_glass(canvas: Canvas, scene: StillLife) -> None:
    """A round didymium glass in a metal ring, standing upright: what has been painted is seen through it."""
    camera = scene.camera
    u, v, depth = camera.project(scene.glass)
    margin = 1.2 * RING_RADIUS / (depth * camera.slope)
    window = canvas.window([u - margin, u + margin], [v - margin, v + margin])
    if _is_empty(window):
        return
    at, rays = canvas.samples(window, camera)
    offset = (camera.position - scene.glass).astype(np.float32)
    far = -offset[2] / rays[2]
    x, y = offset[0] + far * rays[0], offset[1] + far * rays[1]
    radius = np.hypot(x, y)
    glass = at[radius < GLASS_RADIUS]
    for material in (canvas.first, canvas.second, canvas.shine):
        material.ravel()[glass] += parts.BEHIND_GLASS
    ring = (radius >= GLASS_RADIUS) & (radius < RING_RADIUS)
    across = (radius[ring] - GLASS_RADIUS) / (RING_RADIUS - GLASS_RADIUS)
    bright = (0.5 + 0.5 * np.cos(np.arctan2(y[ring], x[ring]) - 2.2)) * np.sin(np.pi * across)
    canvas.paint(at[ring], (parts.NEUTRAL_35, parts.NEUTRAL_8, bright), 0.35 + 0.5 * bright, 0.6 * bright**6)


def _paint_glow(canvas: Canvas, scene: StillLife, led: Ball) -> None:
    """Light that an LED spills on what is around it, as the lens shows it."""
    u, v, depth = scene.camera.project(led.centre)
    width = 2.0 * led.radius / (depth * scene.camera.slope)
    window = canvas.window([u - 4 * width, u + 4 * width], [v - 4 * width, v + 4 * width])
    du, dv = canvas.u[window[1]] - u, canvas.v[window[0]] - v
    glow = 0.60 * np.exp(-(du[None, :] ** 2 + dv[:, None] ** 2) / (2 * width**2)).astype(np.float32)
    glow *= 1 - canvas.light[window]  # so that the sum stays within full light
    stronger = glow > canvas.gloss[window]
    canvas.gloss[window][stronger] = glow[stronger]
    canvas.shine[window][stronger] = led.materials[0]
    canvas.light[window][stronger] /= 1 - glow[stronger]  # this gloss is added, and takes nothing away
