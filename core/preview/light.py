"""Direct light of lamps at points, one sample a lamp: unbiased, where `core.lights` has closed forms and quotients.

A sample's value is what the lamp would bring if all of it stood where the sample is, so that the mean over samples is
the irradiance. Directions to round lamps and suns are spread evenly over the cap that they fill, places on area lamps
over the part that can shine on the point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..lights import NEAREST, SUN_REACH, spot_cone
from ..rays import Tracer
from ..scene import Light
from ..vectors import around, dot, join, scaled, split
from .darkness import Darkness

MOST_LAMPS = 4
"""Lamps that a point asks in one frame; with more each point picks so many of them."""

CELLS = 12
"""Cells along the longest side of the grid in which lamps are picked by how much they may bring."""

EVEN = 0.2
"""Part of the picks that goes to all lamps alike: none is forgotten behind its distance."""

_F = np.float32


@dataclass(frozen=True)
class Baked:
    """A bake's images over the atlas, (H, W, 3) float32 W/m², row 0 at v = 0: indirect irradiance, the first hit of sky
    and emissive faces, and caustics; None where there is none."""

    irradiance: np.ndarray
    first: np.ndarray | None = None
    caustics: np.ndarray | None = None


class Lamps:
    """The lamps of a scene. tracer: on the calling thread; bounds: (2, 3) corners of the scene, m.

    darkness: where lamps were found to be hidden, from the last `settle` on.
    """

    def __init__(self, lights: Sequence[Light], tracer: Tracer, bounds: np.ndarray):
        self.lights = [light for light in lights if light.power.any()]
        self._tracer = tracer
        self._reach = _F(SUN_REACH + 10 * float(np.linalg.norm(bounds[1] - bounds[0])))
        self._colour = [light.power.astype(np.float32) for light in self.lights]
        self._grid = _Grid(self.lights, bounds) if len(self.lights) > 1 else None
        self.darkness = Darkness(len(self.lights), bounds)

    def __len__(self) -> int:
        return len(self.lights)

    def irradiance(self, points, normals, u: np.ndarray, pick: np.ndarray, most: int = MOST_LAMPS) -> np.ndarray:
        """(n, 3) float32 W/m²: one sample of each lamp, or of `most` of them that each point picks.

        points: (n, 3) m, lifted off their surfaces. normals: (n, 3) unit. u: (2, n) in [0, 1), place on the lamps.
        pick: (n,) in [0, 1).
        """
        result = np.zeros((3, len(points)), np.float32)
        place, facing = split(points), split(normals)
        cell = self.darkness.cells(place)
        if len(self.lights) <= most:
            for number in range(len(self.lights)):
                self._add(result, number, None, cell, points, place, facing, _turned(u, number), None)
            return join(*result)
        for turn in range(most):
            stratum = (pick + turn) / _F(most)
            number, share = self._grid.pick(points, np.minimum(stratum, _F(1 - 2**-24)))
            order = np.argsort(number, kind="stable")
            ends = np.searchsorted(number[order], np.arange(len(self.lights) + 1))
            turned = _turned(u, turn)
            for each in np.unique(number):
                rows = order[ends[each] : ends[each + 1]]
                self._add(
                    result, each, rows, cell[rows], points[rows], place[:, rows], facing[:, rows], turned[:, rows],
                    share[rows] * _F(most),
                )  # fmt: skip
        return join(*result)

    def _add(self, result, number, rows, cell, points, place, facing, u, share):
        """Add a lamp's light to `rows` of the result, (3, n), None for all of them."""
        light = self.lights[number]
        chosen = self.darkness.choose(number, cell, u) if light.casts_shadow else None
        if chosen is not None:
            some, u, chance = chosen
            share = chance if share is None else share[some] * chance
            rows = some if rows is None else rows[some]
            cell, points = cell.take(some, mode="clip"), points.take(some, axis=0, mode="clip")
            place, facing = place.take(some, axis=1, mode="clip"), facing.take(some, axis=1)
        sample = {"POINT": _ball, "SPOT": _ball, "SUN": _sun, "AREA": _panel}[light.kind]
        value, vectors = sample(light, place, facing, u, self._reach)
        if share is not None:
            value = value / share
        if light.casts_shadow:
            value = self._shadowed(number, cell, u[1], value, points, vectors)
        for k in range(3):
            part = (value if value.ndim == 1 else value[:, k]) * self._colour[number][k]
            if rows is None:
                result[k] += part
            else:
                result[k][rows] += part

    def _shadowed(self, number, cell, u, value, points, vectors):
        """Values where nothing stands in between, (n,), or (n, 3) behind coloured glass."""
        lit = np.flatnonzero(value > 0)
        if len(lit) == len(value):
            through = self._tracer.visibility(points, join(*vectors))
            self._learn(number, cell, through, u)
        else:
            ways = join(*(part.take(lit, mode="clip") for part in vectors))
            some = self._tracer.visibility(points.take(lit, axis=0, mode="clip"), ways)
            self._learn(number, cell.take(lit, mode="clip"), some, u.take(lit, mode="clip"))
            through = np.zeros((len(value), *some.shape[1:]), np.float32)
            through[lit] = some
        return value * through if through.ndim == 1 else scaled(through, value)

    def _learn(self, number, cell, through, u):
        passed = (through if through.ndim == 1 else through.max(axis=1, initial=0)) > 0
        self.darkness.learn(number, cell, passed, u)


def _turned(u, turn):
    """Numbers that are independent enough for one more lamp."""
    if not turn:
        return u
    u = u + _F(0.6180340) * turn
    return u - np.floor(u)


def _in_cap(middle, sine2, u):
    """Unit directions evenly over caps, their cosine and sine to the middle, and 1 + the caps' cosine."""
    base = 1 + np.sqrt(1 - sine2)
    depth = u[0] * (sine2 / base)
    radius = np.sqrt(depth * (2 - depth))
    z = 1 - depth
    angle = u[1] * _F(2 * np.pi)
    return around(middle, radius * np.cos(angle), radius * np.sin(angle), z), z, radius, base


def _ball(light: Light, points, normals, u, reach):
    """POINT and SPOT: see `core.lights`. Returns (n,) irradiance for unit power, and vectors to the lamp."""
    vectors = [_F(light.position[k]) - points[k] for k in range(3)]
    d2 = np.maximum(dot(vectors, vectors), _F(NEAREST))
    d = np.sqrt(d2)
    over = 1 / d
    middle = [v * over for v in vectors]
    if light.radius <= 0:
        value = np.maximum(dot(middle, normals), 0) / (_F(4 * np.pi) * d2)
        direction = middle
    else:
        radius2 = _F(light.radius) ** 2
        soft = light.shape == "DISK"
        spread2 = d2 + radius2 if soft else np.maximum(d2, radius2)
        direction, z, radius, base = _in_cap(middle, radius2 / spread2, u)
        value = np.maximum(dot(direction, normals), 0) / (_F(2 * np.pi) * spread2 * base)
        if soft:
            way = d / np.maximum(z, _F(1e-6))
        else:
            way = d * z - np.sqrt(np.maximum(radius2 - d2 * radius * radius, 0))
        vectors = [part * way for part in direction]
        if not soft:
            inside = np.flatnonzero(d2 <= radius2)
            value[inside] = 1 / (4 * np.pi * radius2)
            for k in range(3):
                vectors[k][inside] = normals[k][inside] * (_F(light.radius) - d[inside])
    if light.kind == "SPOT":
        value = value * spot_cone(light, direction)
    return value, vectors


def _sun(light: Light, points, normals, u, reach):
    count = len(points[0])
    axis = (-light.direction).astype(np.float32)
    half = min(light.angle, np.pi) / 2
    if half <= 0:
        cosine = axis[0] * normals[0] + axis[1] * normals[1] + axis[2] * normals[2]
        return np.maximum(cosine, 0), [np.full(count, t * reach, np.float32) for t in axis]
    sine2 = _F(np.sin(half) ** 2)
    direction, _, _, base = _in_cap(axis, sine2, u)
    value = np.maximum(dot(direction, normals), 0)
    value *= 2 / base
    for part in direction:
        part *= reach
    return value, direction


def _panel(light: Light, points, normals, u, reach):
    """AREA: flat, shining to one side, evenly or through a soft box's grid (spread)."""
    width, height = (_F(s) for s in light.size)
    axes = light.matrix[:3, :3] / np.linalg.norm(light.matrix[:3, :3], axis=0)
    axes = axes.astype(np.float32) * np.array([1, 1, -1], np.float32)
    away = [points[k] - _F(light.position[k]) for k in range(3)]
    x, y, z = (dot(away, axes[:, k]) for k in range(3))
    normal = [dot(normals, axes[:, k]) for k in range(3)]
    round_ = light.shape in ("DISK", "ELLIPSE")
    area = width * height * _F(np.pi / 4 if round_ else 1)
    if area <= 0:
        return np.zeros(len(x), np.float32), points
    front = z > 0
    depth = np.where(front, z, _F(1))
    if light.spread <= 0:
        a, b = 2 * x / width, 2 * y / height
        inside = (a * a + b * b <= 1) if round_ else (np.maximum(np.abs(a), np.abs(b)) <= 1)
        value = np.where(front & inside, np.maximum(-normal[2], 0) / area, 0)
        return value, [-z * axes[k, 2] for k in range(3)]
    grid, share = _F(1), _F(1)
    if light.spread < np.pi:
        # only the part of the lamp around the point's own foot is seen
        slope = _F(np.tan(light.spread / 2))
        low = [np.maximum(-s / 2, p - slope * depth) for p, s in ((x, width), (y, height))]
        high = [np.minimum(s / 2, p + slope * depth) for p, s in ((x, width), (y, height))]
        size = [np.maximum(h - s, 0) for h, s in zip(high, low, strict=True)]
        a, b = low[0] + u[0] * size[0], low[1] + u[1] * size[1]
        share = size[0] * size[1] / area
        if round_:
            share = share * ((2 * a / width) ** 2 + (2 * b / height) ** 2 <= 1)
        half = light.spread / 2
        norm = 3 / half**3 if half < 0.05 else 1 / (np.tan(half) - half)
        a, b = a - x, b - y
        grid = np.maximum(slope - np.hypot(a, b) / depth, 0) * _F(norm)
    elif round_:
        radius, angle = np.sqrt(u[0]) * _F(0.5), u[1] * _F(2 * np.pi)
        a, b = width * radius * np.cos(angle) - x, height * radius * np.sin(angle) - y
    else:
        a, b = width * (u[0] - _F(0.5)) - x, height * (u[1] - _F(0.5)) - y
    d2 = np.maximum(a * a + b * b + z * z, _F(NEAREST))
    brought = np.maximum(normal[0] * a + normal[1] * b - normal[2] * z, 0) * depth / (d2 * d2)
    value = np.where(front, brought * grid * share / _F(np.pi), 0)
    return value, [a * axes[k, 0] + b * axes[k, 1] - z * axes[k, 2] for k in range(3)]


class _Grid:
    """How likely lamps are picked, for each cell of a grid over the scene: by power over squared distance."""

    def __init__(self, lights, bounds):
        self._low = bounds[0].astype(np.float32)
        extent = np.maximum(bounds[1] - bounds[0], 1e-6)
        self._cell = _F(extent.max() / CELLS)
        self._size = np.maximum(np.ceil(extent / self._cell), 1).astype(np.int32)
        index = np.stack(np.meshgrid(*(np.arange(s) for s in self._size), indexing="ij"), -1).reshape(-1, 3)
        middle = self._low + (index + 0.5) * self._cell
        table = np.empty((len(middle), len(lights)), np.float64)
        for k, light in enumerate(lights):
            power = light.power.sum()
            if light.kind != "SUN":
                power = power / (4 * np.pi * (((middle - light.position) ** 2).sum(1) + (self._cell / 2) ** 2))
            table[:, k] = power
        table = np.abs(table)
        table *= (1 - EVEN) / np.maximum(table.sum(axis=1, keepdims=True), 1e-300)
        table += EVEN / len(lights)
        table /= table.sum(axis=1, keepdims=True)
        self._share = table.astype(np.float32)
        self._upto = np.cumsum(table, axis=1).astype(np.float32)
        self._upto[:, -1] = 2

    def pick(self, points, chance):
        """Number of a lamp for each point (n,) and the probability that it was picked with (n,)."""
        cell = np.clip(((points - self._low) / self._cell).astype(np.int32), 0, self._size - 1)
        cell = (cell[:, 0] * self._size[1] + cell[:, 1]) * self._size[2] + cell[:, 2]
        lamps = self._upto.shape[1]
        low, high = np.zeros(len(points), np.int64), np.full(len(points), lamps - 1)
        flat, base = self._upto.reshape(-1), cell.astype(np.int64) * lamps
        for _ in range(int(np.ceil(np.log2(lamps))) + 1):
            middle = (low + high) // 2
            above = flat[base + middle] > chance
            high = np.where(above, middle, high)
            low = np.where(above, low, np.minimum(middle + 1, high))
        return high, self._share.reshape(-1)[base + high]
