"""Soft lamps: few points of a lamp stand for all of it, for a photon's landing is known to move with the lamp's point.

All points of a lamp aim at the same places around an object, so that photons of one place in the square meet it where the
others do. Where they take the same way their landings tell how far that moves by a step on the lamp (a ray's differential,
Igehy 1999, by differences of traced rays), and each beam is spread over what its point stands for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from ..sampling import concentric_disk, hash_uint32, r2_points
from ..scene import Light
from .borders import lands_in_atlas
from .emission import Bounds, Emitter, _cone, _on_disk, _project, _rectangle, _unproject, emitters, intensity
from .quadtree import Forest

NEAR = 2.0
"""Sizes of a lamp from its middle within which an object is too near for its points to aim at the same places."""

ALIKE = 0.3
"""Cosine to the axis beyond which an object is too wide for that."""

OFFSETS = 1024
"""Places in a cell of a lamp; a power of two."""

STRAIGHT, CURVED = 4, 9
"""Points that tell how a landing moves with the lamp's point, and how that changes."""

_F = np.float32


@dataclass(frozen=True)
class Aimed:
    """A point of a soft lamp, or a direction of a soft sun, that aims at the places at which the middle aims.

    middle: the lamp's middle, whose square is large enough for all points. place: (2,) on the lamp's unit disk, or
    [−1, 1]² of a panel. offset: (3,) m of a panel's point; direction: (3,) unit, of a sun's. far: m, how far from the
    middle they meet; of a sun, the depth along its axis.
    """

    middle: Emitter
    place: np.ndarray
    share: float
    far: float
    offset: np.ndarray | None = None
    direction: np.ndarray | None = None
    back: float = 0.0

    @property
    def light(self) -> Light:
        return self.middle.light

    def rays(self, s: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As `Emitter.rays`."""
        base = self.middle
        x, y = base.low[0] + base.span[0] * s, base.low[1] + base.span[1] * t
        size = float(base.span.prod()) * self.share
        if self.direction is not None:
            facing = float(self.direction @ base.axes[2])
            at = base.axes[0][:, None] * x + base.axes[1][:, None] * y + (base.axes[2] * self.far)[:, None]
            origin = at - (self.direction * self.back)[:, None]
            direction = np.broadcast_to(self.direction[:, None], at.shape)
            return origin.astype(_F), direction.astype(_F), np.full(len(x), size * facing, _F)
        square = x * x + y * y
        out = _unproject(base.axes, x, y, square)
        offset = self._offset(out)
        ahead = out * self.far - offset
        length = np.sqrt((ahead * ahead).sum(axis=0))
        direction = ahead / length
        meets = (direction * out).sum(axis=0)
        if self.offset is not None:
            part = (self.far / length) ** 2
        elif base.light.shape == "DISK":
            # it faces what it lights
            part = (self.far / length) ** 2 * meets
        else:
            # of a sphere all that is seen is as bright: even in solid angle
            part = 2 / (1 + self._rim[1])
        power = np.where(square < 4, size * part * meets, 0.0) * intensity(base.light, direction)
        return (base.origin[:, None] + offset).astype(_F), direction.astype(_F), power.astype(_F)

    def emitted(self, detail: int = 64) -> float:
        """As `Emitter.emitted`."""
        cell = (np.arange(detail) + 0.5) / detail
        s, t = (a.ravel() for a in np.meshgrid(cell, cell))
        return float(self.rays(s, t)[2].mean(dtype=np.float64))

    def _offset(self, out):
        """(3, 1) or (3, n) m of the point from the lamp's middle, for directions (3, n)."""
        if self.offset is not None:
            return self.offset[:, None]
        axes, radius = self.middle.axes, self.light.radius
        if self.light.shape == "DISK":
            return _on_disk(axes, self.place * radius, out)
        # where the ray from the place that is lit comes nearest to the middle
        square = float(self.place @ self.place)
        cosine = 1 - square * (1 - self._rim[1])
        sine = np.sqrt(max(1 - cosine * cosine, 0.0))
        aside = _on_disk(axes, self.place / max(np.sqrt(square), 1e-12), out)
        return (out * sine + aside * cosine) * (sine * self.far)

    @property
    def _rim(self):
        """Sine and cosine of the angle that the radius of a sphere fills."""
        sine = self.light.radius / self.far
        return sine, np.sqrt(1 - sine * sine)


def _reach(light):
    """m, from a lamp's middle to its rim."""
    return float(np.hypot(*light.size) / 2 if light.kind == "AREA" else light.radius)


def _far(points):
    return float(np.linalg.norm((points.min(axis=0) + points.max(axis=0)) / 2))


def width(light: Light, bounds: Bounds) -> float:
    """Size of a lamp, from its middle to its rim, in parts of how far it is from the middle of an object."""
    if light.kind == "SUN":
        return float(np.sin(min(light.angle, np.pi) / 2))
    return _reach(light) / max(_far(bounds.points - light.position), 1e-12)


def aimed(light: Light, bounds: Bounds, places: np.ndarray, extent: float) -> list[Aimed] | None:
    """Points of a soft lamp at `places` (k, 2) of its unit disk or, of a rectangle, of [−1, 1]²; None where the object is
    too near or too wide, and each point needs a square of its own."""
    found = emitters(light, bounds, 1, 0, extent)
    if not found or (light.kind == "AREA" and light.spread <= 0):
        return None
    base, share = found[0], 1 / len(places)
    bounds = Bounds(*(part.astype(np.float64) for part in bounds))
    if light.kind == "SUN":
        return _sun(light, bounds, places, extent, base)
    points = bounds.seen_from(light.position) - light.position
    far, distance, reach = _far(points), np.linalg.norm(points, axis=1), _reach(light)
    # a ring's middle may be nearer than all of it
    if min(far, distance.min()) < NEAR * reach or (points @ base.axes[2] < ALIKE * distance).any():
        return None
    axes = base.axes
    if light.kind == "AREA":
        own = light.matrix[:3, :3] / np.linalg.norm(light.matrix[:3, :3], axis=0)
        half = np.array(light.size) / 2
        offsets = (places * half) @ own[:, :2].T
        lamps = [Aimed(base, p, share, far, offset=o) for p, o in zip(places, offsets, strict=True)]
    else:
        lamps = [Aimed(base, p, share, far) for p in places]
    flat = []
    for lamp in lamps:
        offset = lamp._offset((points / distance[:, None]).T).T
        ahead = points - offset
        ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
        along = (ahead * offset).sum(axis=1)
        to = -along + np.sqrt(along**2 - (offset**2).sum(axis=1) + far**2)
        flat.append(_project(axes, (offset + ahead * to[:, None]) / far))
    low, high = _rectangle(np.concatenate(flat))
    if light.kind == "SPOT" or (light.kind == "AREA" and light.spread < np.pi):
        cone = _cone(light, axes)
        if cone is not None:
            low, high = np.maximum(low, cone[0] - 1.2 * reach / far), np.minimum(high, cone[1] + 1.2 * reach / far)
    if (high <= low).any():
        return None
    wide = replace(base, low=low, span=high - low)
    return [replace(lamp, middle=wide) for lamp in lamps]


def _sun(light, bounds, places, extent, base):
    half = min(light.angle, np.pi) / 2
    if np.cos(half) < ALIKE:
        return None
    axes, points = base.axes, bounds.points
    depth = points @ axes[2]
    far = float(depth.min() + depth.max()) / 2
    share = 2 / (1 + np.cos(half)) / len(places)
    back = float(np.ptp(depth)) + 1.01 * extent
    lamps, flat = [], []
    for place in places:
        # even in solid angle over the sun's disk
        down = float(place @ place) * (1 - np.cos(half))
        across = np.sqrt(max(2 - down, 0.0) * (1 - np.cos(half)))
        direction = axes[2] * (1 - down) + (axes[0] * place[0] + axes[1] * place[1]) * across
        direction /= np.linalg.norm(direction)
        lamps.append(Aimed(base, place, share, far, direction=direction, back=back))
        at = points - direction * ((depth - far) / (direction @ axes[2]))[:, None]
        flat.append(at @ axes[:2].T)
    low, high = _rectangle(np.concatenate(flat))
    wide = replace(base, low=low, span=high - low)
    return [replace(lamp, middle=wide) for lamp in lamps]


class Cells(NamedTuple):
    """Points of a unit lamp and what each stands for: cells that together are all of it. point: (k, 2) their middles.
    offset: (k, m, 2) float32 places evenly in each cell, from its middle."""

    point: np.ndarray
    offset: np.ndarray


class Softness(NamedTuple):
    """Of a forest: slope (n, 4) of its photons (see `slopes`), cell (trees,) of each tree, offset (k, m, 2) of the cells."""

    slope: np.ndarray
    cell: np.ndarray
    offset: np.ndarray


@cache
def cells(count: int, round_: bool) -> Cells:
    """About so many cells, a square number, of the unit disk, else of [−1, 1]²."""
    side = max(2, round(np.sqrt(count)))
    inner = r2_points(OFFSETS).astype(np.float64)
    i, j = (a.ravel() for a in np.meshgrid(np.arange(side), np.arange(side), indexing="ij"))
    place = (np.stack([i, j], 1)[:, None] + inner) / side
    place = concentric_disk(place.reshape(-1, 2)).astype(np.float64) if round_ else 2 * place.reshape(-1, 2) - 1
    place = place.reshape(-1, OFFSETS, 2)
    point = place.mean(axis=1)
    return Cells(point, (place - point[:, None]).astype(np.float32))


def worst_alike(forest: Forest, scores: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """(k,) rows of at most `count` patches to refine, those of all trees of a group together, the worst first.

    scores: (p,) W of the patches. group: (trees,) of each tree.
    """
    _, same, members = np.unique(forest.names(group), return_inverse=True, return_counts=True)
    total = np.bincount(same, scores)
    order = np.argsort(-total, kind="stable")
    order = order[total[order] > 0]
    chosen = np.zeros(len(total), bool)
    chosen[order[np.cumsum(members[order]) <= count]] = True
    return np.flatnonzero(chosen[same])


def slopes(forest: Forest, group: np.ndarray, point: np.ndarray) -> np.ndarray:
    """(n, 4) float32 texels that each photon's landing moves by a step of 1 on the unit lamp, x and y for each axis; 0 where
    the photons of other points went other ways, for there a border between ways moves as well.

    group: (trees,) of each tree. point: (trees, 2) on the unit lamp.
    """
    photons = forest.photons
    found = np.zeros((len(photons), 4), np.float32)
    tree, place = forest.places()
    rows = np.flatnonzero(lands_in_atlas(photons.signature))
    if not len(rows):
        return found
    # alike: the same place in the square, the same way
    key = hash_uint32(photons.signature[rows].astype(np.int64) * len(group) + group[tree[rows]], 0).astype(np.int64)
    _, same, count = np.unique(place[rows] << 20 | key >> 12, return_inverse=True, return_counts=True)
    same = same.reshape(-1)
    size = np.bincount(group)
    whole = (count[same] == size[group[tree[rows]]]) & (size[group[tree[rows]]] >= STRAIGHT)
    rows, same = rows[whole], same[whole]
    size = size[group[tree[rows]]]
    for number in np.unique(size).tolist():
        some = np.flatnonzero(size == number)
        some = rows[some[np.lexsort((tree[rows[some]], same[some]))]]
        slope = _derivatives(point[tree[some[:number]]])
        moved = np.tensordot(photons.place[some].reshape(-1, number, 2), slope, axes=(1, 2))
        # (places, x and y, points, axes)
        found[some] = moved.transpose(0, 2, 3, 1).reshape(-1, 4)
    return found


def _derivatives(point):
    """(k, 2, k) float32: the derivatives at points (k, 2), along both axes, of the best polynomial through values at all
    of them: linear, or quadratic where they tell one."""
    a, b = point.T
    one, none = np.ones_like(a), np.zeros_like(a)
    terms = [one, a, b]
    along = [[none, one, none], [none, none, one]]
    if len(point) >= CURVED:
        terms += [a * a, a * b, b * b]
        along[0] += [2 * a, b, none]
        along[1] += [none, a, 2 * b]
    return np.einsum("xfk,fj->kxj", np.array(along), np.linalg.pinv(np.stack(terms, 1))).astype(_F)
