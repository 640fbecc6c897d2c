"""Where photons start: the part of a lamp's light that may meet an object, spread over a square so that equal areas of
it are equal amounts of light before the lamp's own falloff.

The square is the rectangle around the object in Lambert's azimuthal projection, which keeps areas; for parallel light
it is the object's cross-section. A soft lamp is a set of points, each with a square of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..lights import soft_box_norm, spot_cone
from ..sampling import concentric_disk, frame, hammersley_points, hash_uniform, spiral
from ..scene import Light

SHIFT = 0.15
"""Part of a soft lamp's squares by which they are larger than they need be."""

MARGIN = 0.01
"""Of the square around an object, so that rounding and bent edges cut nothing off."""


WIDE = 0.1
"""rad, angle of an edge beyond which its ends don't bound it: the projection bends it."""

ALONG = np.arange(1, 64) / 64
"""Places along an edge, as angles seen from the lamp, that then bound it too."""

BEHIND = 0.989
"""Cosine, to the direction away from an object, of a part of it that is too far around to be bounded."""


class Bounds(NamedTuple):
    """What bounds an object as a lamp sees it. points: (n, 3) corners, m. edges: (e, 2, 3), m, those that may be long in
    the lamp's eyes."""

    points: np.ndarray
    edges: np.ndarray

    def seen_from(self, origin: np.ndarray) -> np.ndarray:
        """(k, 3) float64 places, m: corners, and places along edges that look long from (3,) `origin`, evenly in angle."""
        a, b = self.edges[:, 0] - origin, self.edges[:, 1] - origin
        length = np.linalg.norm(b - a, axis=1)
        rows = np.flatnonzero(length > WIDE * np.linalg.norm(a + b, axis=1) / 2)
        if not len(rows):
            return self.points
        a, b = a[rows], b[rows]
        far = [np.maximum(np.linalg.norm(v, axis=1), 1e-12) for v in (a, b)]
        angle = 2 * np.arctan2(
            *(np.linalg.norm(a / far[0][:, None] + sign * b / far[1][:, None], axis=1) for sign in (-1, 1))
        )
        # of the ray at part t of the angle, the sine rule's place on the edge
        angle = np.clip(angle, 1e-6, np.pi - 1e-6)[:, None]
        one, other = far[0][:, None] * np.sin(ALONG * angle), far[1][:, None] * np.sin((1 - ALONG) * angle)
        part = (one / (one + other))[:, :, None]
        return np.concatenate([self.points, (a[:, None] + (b - a)[:, None] * part).reshape(-1, 3) + origin])


class Edges:
    """An object's edges, longest first: those of triangles (t, 3, 3), m."""

    def __init__(self, corners: np.ndarray):
        ends = np.stack([corners, np.roll(corners, -1, axis=1)], 2).reshape(-1, 2, 3)
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        order = np.argsort(-length, kind="stable")
        self._ends, self._length = ends[order], length[order]
        self._low, self._high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))

    def near(self, place: np.ndarray, reach: float) -> np.ndarray:
        """(e, 2, 3) float32, m, those that may look long from within `reach` m of (3,) `place`."""
        away = np.linalg.norm(np.maximum(np.maximum(self._low - place, place - self._high), 0)) - reach
        ends = self._ends[: np.searchsorted(-self._length, -WIDE * away)]
        length = self._length[: len(ends)]
        return ends[length > WIDE * (np.linalg.norm(ends.mean(axis=1) - place, axis=1) - reach)]


@dataclass(frozen=True)
class Emitter:
    """One point of a lamp, or one direction of a sun, towards one object.

    axes: (3, 3) float64: two unit vectors across, and the one towards the object. origin: (3,) float64, m. low, span:
    (2,) float64 of the rectangle, in the projection's plane; m for parallel light. share: of the lamp's power.
    lens: (2,) float64 place of the point on a ball's disk, m, which faces along the ray.
    """

    light: Light
    axes: np.ndarray
    origin: np.ndarray
    low: np.ndarray
    span: np.ndarray
    share: float
    parallel: bool = False
    lens: np.ndarray | None = None

    def rays(self, s: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Origins and unit directions, (3, n) float32, and W for the whole square, (n,) float32, at unit power.

        s, t: (n,) float64 in [0, 1], places in the square.
        """
        x, y = self.low[0] + self.span[0] * s, self.low[1] + self.span[1] * t
        size = float(self.span.prod()) * self.share
        if self.parallel:
            place = self.origin[:, None] + self.axes[0][:, None] * x + self.axes[1][:, None] * y
            direction = np.broadcast_to(self.axes[2][:, None], place.shape)
            power = np.full(len(x), size)
            if self.light.kind == "AREA":
                power = power * _within(self.light, place)
            return place.astype(np.float32), direction.astype(np.float32), power.astype(np.float32)
        square = x * x + y * y
        direction = _unproject(self.axes, x, y, square)
        origin = np.broadcast_to(self.origin[:, None], direction.shape)
        if self.lens is not None:
            origin = origin + _on_disk(self.axes, self.lens, direction)
        power = np.where(square < 4, size, 0.0) * intensity(self.light, direction)
        return origin.astype(np.float32), direction.astype(np.float32), power.astype(np.float32)

    def shifted(self, index: int, seed: int) -> Emitter:
        """The same light from a square that is a little larger and, by a hash of the index, moved: so is its grid."""
        move = np.array([hash_uniform(np.array([index]), axis, seed)[0] for axis in (301, 302)], np.float64)
        return replace(self, low=self.low - SHIFT * self.span * move, span=self.span * (1 + SHIFT))

    def emitted(self, detail: int = 64) -> float:
        """W that go out into the square at unit power, by midpoints."""
        cell = (np.arange(detail) + 0.5) / detail
        s, t = (a.ravel() for a in np.meshgrid(cell, cell))
        return float(self.rays(s, t)[2].mean(dtype=np.float64))


def is_soft(light: Light) -> bool:
    """Whether a lamp has a size, so that one point does not stand for it."""
    if light.kind == "SUN":
        return light.angle > 0
    if light.kind == "AREA":
        return light.spread > 0 and min(light.size) > 0
    return light.radius > 0


def emitters(light: Light, bounds: Bounds, count: int, seed: int = 0, extent: float = 0.0) -> list[Emitter]:
    """Of a lamp towards an object. bounds: of the object (`Surfaces.bounding`). count: points of a soft lamp.
    extent: of the scene, m, from beyond which sunlight comes. None where none of its light can meet it."""
    count = count if is_soft(light) else 1
    disk = concentric_disk(hammersley_points(count, seed)).astype(np.float64) if count > 1 else np.zeros((1, 2))
    make = {"SUN": _sun, "AREA": _panel, "POINT": _ball, "SPOT": _ball}[light.kind]
    bounds = Bounds(*(part.astype(np.float64) for part in bounds))
    return [e for e in make(light, bounds, disk, seed, extent) if e is not None and e.span.min() > 0]


def intensity(light: Light, direction: np.ndarray) -> np.ndarray:
    """(n,) W/sr of a point of a lamp of unit power along (3, n) unit directions."""
    axes = light.matrix[:3, :3] / np.linalg.norm(light.matrix[:3, :3], axis=0)
    if light.kind == "POINT":
        return np.full(direction.shape[1], 0.25 / np.pi)
    if light.kind == "SPOT":
        return spot_cone(light, -direction) * (0.25 / np.pi)
    x, y, z = axes[:, 0] @ direction, axes[:, 1] @ direction, -(axes[:, 2] @ direction)
    forward = np.maximum(z, 0)
    if light.spread >= np.pi:
        return forward / np.pi
    half = light.spread / 2
    slope = np.tan(half)
    grid = np.maximum(slope - np.hypot(x, y) / np.maximum(forward, 1e-9), 0) * soft_box_norm(half)
    return np.where(forward > 0, forward * grid / np.pi, 0)


def extreme_points(places: np.ndarray, directions: int = 512) -> np.ndarray:
    """(k, 3) of places (n, 3): those that lie farthest along directions all around. Where they are fewer than the places
    they bound them but for a tenth of MARGIN."""
    found = [int((places @ direction).argmax()) for direction in spiral(directions)]
    return places[np.unique(found)]


def _unproject(axes, x, y, square):
    scale = np.sqrt(np.maximum(1 - square / 4, 0))
    return axes[0][:, None] * (x * scale) + axes[1][:, None] * (y * scale) + axes[2][:, None] * (1 - square / 2)


def _project(axes, directions):
    """(n, 2) places in the plane of unit directions (n, 3)."""
    local = directions @ axes.T
    return local[:, :2] * np.sqrt(2 / np.maximum(1 + local[:, 2], 1e-9))[:, None]


def _on_disk(axes, lens, direction):
    """(3, n) offsets of a point of a disk that is turned to face along each direction, the shortest way."""
    half = direction + axes[2][:, None]
    along = np.maximum(1 + axes[2] @ direction, 1e-9)
    offset = 0.0
    for k in (0, 1):
        offset = offset + lens[k] * (axes[k][:, None] - half * ((axes[k] @ direction) / along))
    return offset


def _axes(towards):
    """(3, 3): a frame whose third axis points along (3,) `towards`."""
    towards = towards / np.linalg.norm(towards)
    side = frame(towards[None])[0][0].astype(np.float64)
    side -= towards * (side @ towards)
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(towards, side), towards])


def _turned(axes, flat):
    """The frame turned about its third axis, so that places (n, 2) in its plane spread most along its first."""
    centred = flat - flat.mean(axis=0)
    _, turn = np.linalg.eigh(centred.T @ centred)
    a, b = turn[:, 1]
    # a square lies as well either way: turn it only where that makes it smaller
    turned = flat @ np.array([[a, -b], [b, a]])
    if np.ptp(turned, axis=0).prod() > 0.98 * np.ptp(flat, axis=0).prod():
        return axes
    return np.stack([a * axes[0] + b * axes[1], a * axes[1] - b * axes[0], axes[2]])


def _rectangle(flat, least=1e-7):
    low, high = flat.min(axis=0), flat.max(axis=0)
    pad = MARGIN * (high - low) + least
    return low - pad, high + pad


def _towards(light, bounds, origin, share, lens=None, reach=0.0):
    """An emitter at a point: the rectangle of an object's directions, and of a spot's cone, around their middle."""
    points = bounds.seen_from(origin)
    low, high = points.min(axis=0), points.max(axis=0)
    away = (low + high) / 2 - origin
    whole = np.array([-2.0, -2.0]), np.array([2.0, 2.0])
    inside = (origin > low - reach).all() and (origin < high + reach).all()
    if inside and np.linalg.norm(away) < 1e-6 * np.linalg.norm(high - low):
        away = np.array([0.0, 0.0, 1.0])
    axes = _axes(away)
    if inside:
        low, high = whole
        vectors = points - origin
        distance = np.linalg.norm(vectors, axis=1)
        vectors = vectors / np.maximum(distance, 1e-12)[:, None]
        # a hull that does not surround the lamp leaves half of the directions free
        if reach == 0 and distance.min() > 0 and (vectors @ axes[2]).min() > 0:
            low, high = _rectangle(_project(axes, vectors))
    else:
        vectors = points - origin
        vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
        axes = _turned(axes, _project(axes, vectors))
        if lens is not None:
            for _ in range(3):
                shifted = points - origin - _on_disk(axes, lens, vectors.T).T
                vectors = shifted / np.linalg.norm(shifted, axis=1, keepdims=True)
        low, high = _rectangle(_project(axes, vectors))
        # what passes close behind the lamp goes round the rim between two places
        if (vectors @ axes[2]).min() < -BEHIND:
            low, high = whole
    low, high = np.maximum(low, -2.0), np.minimum(high, 2.0)
    if light.kind == "SPOT" or (light.kind == "AREA" and light.spread < np.pi):
        cone = _cone(light, axes)
        if cone is not None:
            low, high = np.maximum(low, cone[0]), np.minimum(high, cone[1])
    if (high <= low).any():
        return None
    return Emitter(light, axes, origin, low, high - low, share, lens=lens)


def _cone(light, axes):
    """The rectangle of the cone of a spot or a soft box in the projection, None where it is too wide to have one."""
    slope = np.tan(min((light.spot_angle if light.kind == "SPOT" else light.spread) / 2, 1.5707))
    own = light.matrix[:3, :3] / np.linalg.norm(light.matrix[:3, :3], axis=0)
    turn = np.linspace(0, 2 * np.pi, 64, endpoint=False)[:, None]
    rim = slope * (light.size[0] * np.cos(turn) * own[:, 0] + light.size[1] * np.sin(turn) * own[:, 1]) - own[:, 2]
    if tuple(light.size) == (1.0, 1.0) or light.kind != "SPOT":
        rim = slope * (np.cos(turn) * own[:, 0] + np.sin(turn) * own[:, 1]) - own[:, 2]
    rim /= np.linalg.norm(rim, axis=1, keepdims=True)
    half = np.arccos(np.clip((rim @ light.direction).min(), -1, 1))
    apart = np.arccos(np.clip(light.direction @ axes[2], -1, 1))
    if half + apart > 0.9 * np.pi:
        return None
    return _rectangle(_project(axes, rim))


def _ball(light, bounds, disk, seed, extent):
    for place in disk:
        lens = place * light.radius if len(disk) > 1 else None
        yield _towards(light, bounds, light.position, 1 / len(disk), lens, light.radius if lens is not None else 0.0)


def _panel(light, bounds, disk, seed, extent):
    points = bounds.points
    if min(light.size) <= 0:
        return
    own = light.matrix[:3, :3] / np.linalg.norm(light.matrix[:3, :3], axis=0)
    if light.spread <= 0:
        axes = np.stack([own[:, 0], -own[:, 1], -own[:, 2]])
        flat = (points - light.position) @ axes[:2].T
        half = np.array(light.size) / 2
        low, high = _rectangle(flat)
        low, high = np.maximum(low, -half), np.minimum(high, half)
        round_ = np.pi / 4 if light.shape in ("DISK", "ELLIPSE") else 1.0
        yield Emitter(
            light,
            axes,
            light.position,
            low,
            np.maximum(high - low, 0),
            1 / (light.size[0] * light.size[1] * round_),
            True,
        )
        return
    if light.shape in ("DISK", "ELLIPSE"):
        places = disk / 2
    else:
        places = hammersley_points(len(disk), seed).astype(np.float64) - 0.5 if len(disk) > 1 else disk
    for place in places:
        origin = light.position + own[:, 0] * (place[0] * light.size[0]) + own[:, 1] * (place[1] * light.size[1])
        ahead = (points - origin) @ light.direction
        if ahead.max() > 0:
            yield _towards(light, bounds, origin, 1 / len(places))


def _sun(light, bounds, disk, seed, extent):
    points = bounds.points
    half = min(light.angle, np.pi) / 2
    middle = _axes(light.direction)
    for place in disk:
        # even in solid angle over the sun's disk
        radius2 = float(place @ place)
        depth = radius2 * (1 - np.cos(half)) if len(disk) > 1 else 0.0
        ring = np.sqrt(max(depth * (2 - depth), 0.0))
        unit = place / np.sqrt(radius2) if radius2 > 0 else np.zeros(2)
        towards = middle[2] * (1 - depth) + (middle[0] * unit[0] + middle[1] * unit[1]) * ring
        axes = _axes(towards)
        axes = _turned(axes, points @ axes[:2].T)
        flat = points @ axes[:2].T
        low, high = _rectangle(flat)
        back = float((points @ axes[2]).min()) - 1.01 * extent
        share = 2 / (1 + np.cos(half)) / len(disk) if len(disk) > 1 else 1.0
        yield Emitter(light, axes, axes[2] * back, low, high - low, share, True)


def _within(light, place):
    """(n,) 1 where places (3, n) lie before a lamp of parallel light, else 0."""
    if light.shape not in ("DISK", "ELLIPSE"):
        return np.ones(place.shape[1])
    own = light.matrix[:3, :3] / np.linalg.norm(light.matrix[:3, :3], axis=0)
    local = (place - light.position[:, None]).T @ own
    return ((2 * local[:, 0] / light.size[0]) ** 2 + (2 * local[:, 1] / light.size[1]) ** 2 <= 1).astype(float)
