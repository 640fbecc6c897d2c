"""The four scenes of the world-space cache's benchmark, by script, after those of the thesis: an interior, an exterior
with foliage, a curved statue and a hairball. Triangles are (n, 3, 3) float32 corners, m."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from lightpanes.core.vectors import dot

from .penumbra_scenes import box, grid


@dataclass(frozen=True)
class Stage:
    """What a camera looks at. corners: (T, 3, 3) float32, m; object_id: (T,) int32; eye and target, m; width: of the image
    plane at unit distance; reach: m, how far occlusion counts."""

    corners: np.ndarray
    object_id: np.ndarray
    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    width: float
    reach: float

    @functools.cached_property
    def normals(self) -> np.ndarray:
        """(T, 3) float32 unit normals of the triangles."""
        a, b, c = self.corners.transpose(1, 0, 2)
        normal = np.cross(b - a, c - a)
        return normal / np.linalg.norm(normal, axis=1, keepdims=True)

    def facing(self, triangle: np.ndarray, ways: np.ndarray) -> np.ndarray:
        """(n, 3) normals of triangles, on the side that rays come from."""
        normal = self.normals.take(triangle, axis=0)
        away = np.copysign(np.float32(1), -dot(normal.T, ways.T))
        for k in range(3):
            normal[:, k] *= away
        return normal


def _stage(shapes, eye, target, width, reach) -> Stage:
    """Each shape is an object; triangles of no area are left out."""
    owner = np.repeat(np.arange(len(shapes), dtype=np.int32), [len(s) for s in shapes])
    corners = np.concatenate(shapes).astype(np.float32)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    keep = np.linalg.norm(cross, axis=1) > 1e-12
    return Stage(corners[keep], owner[keep], eye, target, width, reach)


def sheet(places: np.ndarray) -> np.ndarray:
    """(n, 3, 3) corners of a surface through (rows, columns, 3) places."""
    a, b, c, d = places[:-1, :-1], places[:-1, 1:], places[1:, 1:], places[1:, :-1]
    return np.concatenate([np.stack([a, b, c], 2).reshape(-1, 3, 3), np.stack([a, c, d], 2).reshape(-1, 3, 3)])


def lathe(foot, outline, sides: int = 16) -> np.ndarray:
    """A body of revolution about z: outline is (m, 2) radius and height, m, from below."""
    radius, height = np.array(outline, float).T
    turn = np.linspace(0, 2 * np.pi, sides + 1)
    turn[-1] = 0
    ring = np.stack([np.cos(turn), np.sin(turn)], 1)
    places = np.concatenate(
        [radius[:, None, None] * ring, np.broadcast_to(height[:, None, None], (len(height), sides + 1, 1))], axis=2
    )
    return sheet(places + np.array(foot, float))


def tube(path: np.ndarray, radius: np.ndarray, sides: int) -> np.ndarray:
    """A tube along (m, 3) places, of (m,) radii."""
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = np.cross(along, (0.31, 0.17, 0.93))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(along, side)
    turn = np.linspace(0, 2 * np.pi, sides + 1)[None, :, None]
    ring = np.cos(turn) * side[:, None] + np.sin(turn) * up[:, None]
    return sheet(path[:, None] + radius[:, None, None] * ring)


def block(middle, size, turn: float = 0.0) -> np.ndarray:
    """A box that stands on its `middle`, turned about z."""
    x, y, z = np.array(size, float)
    u, v = np.array((np.cos(turn), np.sin(turn), 0)) * x, np.array((-np.sin(turn), np.cos(turn), 0)) * y
    return box(np.array(middle, float) - u / 2 - v / 2, u, v, np.array((0, 0, z)), 1)


BOTTLE = [
    (0, 0),
    (0.036, 0),
    (0.038, 0.01),
    (0.038, 0.17),
    (0.034, 0.2),
    (0.015, 0.23),
    (0.013, 0.29),
    (0.016, 0.295),
    (0.016, 0.31),
    (0, 0.31),
]
GLASS = [
    (0, 0),
    (0.035, 0),
    (0.03, 0.006),
    (0.005, 0.012),
    (0.005, 0.08),
    (0.03, 0.1),
    (0.038, 0.13),
    (0.034, 0.17),
    (0.032, 0.17),
    (0.036, 0.13),
    (0, 0.1),
]
STOOL = [
    (0, 0),
    (0.2, 0),
    (0.2, 0.02),
    (0.03, 0.04),
    (0.03, 0.68),
    (0.17, 0.7),
    (0.18, 0.72),
    (0.18, 0.75),
    (0.16, 0.77),
    (0, 0.77),
]


def interior() -> Stage:
    """A bar: counter, stools, shelves of bottles, tables, panelled walls, beams. 19K triangles."""
    random = np.random.default_rng(1)
    shapes = [
        grid((0, 0, 0), (6, 0, 0), (0, 4, 0), 4, 4),
        grid((0, 0, 2.8), (0, 4, 0), (6, 0, 0), 4, 4),
        grid((0, 4, 0), (6, 0, 0), (0, 0, 2.8), 4, 4),
        grid((0, 0, 0), (0, 4, 0), (0, 0, 2.8), 4, 4),
        grid((6, 4, 0), (0, -4, 0), (0, 0, 2.8), 4, 4),
    ]
    shapes += [block((x, 2, 2.6), (0.14, 4, 0.2)) for x in np.linspace(0.6, 5.4, 6)]
    shapes += [block((x, 3.985, 0), (0.5, 0.03, 0.9)) for x in np.linspace(0.4, 5.6, 9)]
    shapes += [block((2.4, 3.0, 0), (3.6, 0.5, 1.0)), block((2.4, 2.98, 1.0), (3.8, 0.62, 0.05))]
    shapes += [block((x, 2.74, 0.1), (0.42, 0.03, 0.8)) for x in np.linspace(0.85, 3.95, 7)]
    for z in (1.15, 1.55, 1.95):
        shapes.append(block((2.4, 3.86, z), (3.4, 0.24, 0.03)))
        for x in np.arange(0.85, 4.0, 0.17):
            place = (x + random.uniform(-0.03, 0.03), 3.86 + random.uniform(-0.04, 0.04), z + 0.03)
            shapes.append(lathe(place, np.array(BOTTLE) * (1, random.uniform(0.7, 1.1)), 14))
    shapes += [lathe((x, 2.35 + random.uniform(-0.1, 0.1), 0), STOOL, 16) for x in np.linspace(0.9, 3.9, 5)]
    for x in np.linspace(1.0, 4.0, 12):
        shapes.append(lathe((x, random.uniform(2.8, 3.15), 1.05), GLASS, 14))
    for x, y, turn in ((4.9, 1.6, 0.4), (3.2, 1.1, -0.3)):
        shapes += [lathe((x, y, 0), [(0, 0), (0.25, 0), (0.25, 0.02), (0.04, 0.05), (0.04, 0.7), (0, 0.7)], 20)]
        shapes += [lathe((x, y, 0.7), [(0, 0), (0.42, 0), (0.44, 0.015), (0.42, 0.03), (0, 0.03)], 32)]
        shapes += [lathe((x + dx, y + dy, 0.73), GLASS, 14) for dx, dy in ((0.1, 0.2), (-0.2, 0.1), (0.2, -0.15))]
        for k in range(3):
            angle = turn + k * 2.1
            shapes.append(_chair((x + 0.7 * np.cos(angle), y + 0.7 * np.sin(angle)), angle))
    shapes += [
        tube(np.array([(x, 2.9, 2.6), (x, 2.9, 2.25), (x, 2.9, 2.0)]), np.array([0.01, 0.01, 0.01]), 6)
        for x in (1.2, 2.4, 3.6)
    ]
    shapes += [lathe((x, 2.9, 1.8), [(0.16, 0), (0.15, 0.06), (0.04, 0.2), (0, 0.2)], 20) for x in (1.2, 2.4, 3.6)]
    return _stage(shapes, (5.4, 0.35, 1.6), (2.4, 3.0, 0.95), 1.35, 1.5)


def _chair(place, angle):
    x, y = place
    along, side = np.array((np.cos(angle), np.sin(angle))), np.array((-np.sin(angle), np.cos(angle)))
    parts = [block((x, y, 0.43), (0.42, 0.42, 0.04), angle)]
    for a in (-0.18, 0.18):
        for b in (-0.18, 0.18):
            foot = np.array(place) + a * along + b * side
            parts.append(block((*foot, 0), (0.035, 0.035, 0.9 if a > 0 else 0.43), angle))
    for z in (0.55, 0.68, 0.81):
        parts.append(block((*(np.array(place) + 0.18 * along), z), (0.02, 0.34, 0.06), angle))
    return np.concatenate(parts)


def exterior() -> Stage:
    """A street: a front of windows, cobbles, a fence, a bicycle's wheels and trees of loose leaves. 43K triangles."""
    random = np.random.default_rng(2)
    shapes = [grid((-12, -6, -0.03), (24, 0, 0), (0, 14, 0), 8, 8), block((0, 6, 0), (20, 2, 8))]
    for x in np.arange(-8.4, 8.5, 1.4):
        for z in (0.9, 3.4, 5.9):
            shapes += [block((x - 0.45, 4.97, z), (0.08, 0.1, 1.6)), block((x + 0.45, 4.97, z), (0.08, 0.1, 1.6))]
            shapes += [block((x, 4.93, z - 0.08), (1.1, 0.25, 0.08)), block((x, 4.95, z + 1.6), (1.05, 0.16, 0.1))]
            shapes.append(block((x, 4.98, z + 0.75), (0.9, 0.05, 0.05)))
    shapes += [block((0, 4.9, z), (20, 0.3, 0.15)) for z in (3.0, 5.5)]
    stones = []
    for i, x in enumerate(np.arange(-5, 5, 0.24)):
        for y in np.arange(-2.4, 3.2, 0.24) + 0.12 * (i % 2):
            stones.append(block((x, y, -0.05), (0.21, 0.2, 0.05 + random.uniform(0, 0.02)), random.normal(0, 0.06)))
    shapes.append(np.concatenate(stones))
    shapes += [block((x, 3.4, 0), (0.04, 0.04, 1.0)) for x in np.arange(-5, 5, 0.16)]
    shapes += [block((0, 3.4, z), (10, 0.05, 0.05)) for z in (0.25, 0.85)]
    for x in (-1.3, -0.25):
        turn = np.linspace(0, 2 * np.pi, 41)
        rim = np.stack([x + 0.33 * np.cos(turn), 2.7 + 0 * turn, 0.34 + 0.33 * np.sin(turn)], 1)
        shapes.append(tube(rim, np.full(41, 0.018), 6))
        for a in turn[:-1:3]:
            spoke = np.array([(x, 2.7, 0.34), (x + 0.32 * np.cos(a), 2.7, 0.34 + 0.32 * np.sin(a))])
            shapes.append(tube(spoke, np.full(2, 0.004), 3))
    frame = np.array([(-1.3, 2.7, 0.34), (-0.85, 2.7, 0.3), (-0.4, 2.7, 0.85), (-0.25, 2.7, 0.34)])
    shapes += [
        tube(frame, np.full(4, 0.02), 6),
        tube(np.array([(-1.1, 2.7, 0.85), (-0.4, 2.7, 0.82)]), np.full(2, 0.02), 6),
    ]
    for x, y, tall, leaves in ((2.3, 1.6, 1.7, 4200), (-3.4, 2.2, 2.1, 4000), (4.4, 2.8, 1.9, 2900)):
        trunk = np.array([(x, y, 0), (x + 0.05, y, tall * 0.5), (x - 0.03, y + 0.05, tall), (x, y, tall + 0.8)])
        shapes.append(tube(trunk, np.array([0.11, 0.09, 0.07, 0.02]), 8))
        shapes.append(_leaves(np.array((x, y, tall + 0.6)), (1.0, 1.0, 0.8), leaves, 0.09, random))
    bush = [_leaves(np.array((x, 3.1, 0.3)), (0.45, 0.3, 0.35), 500, 0.05, random) for x in (1.2, 1.9, 3.3, 4.1)]
    shapes.append(np.concatenate(bush))
    return _stage(shapes, (-0.6, -3.2, 1.5), (0.5, 3.0, 1.35), 1.25, 2.0)


def _leaves(middle, size, count, length, random):
    """Two triangles a leaf, in an ellipsoid, denser outside."""
    place = random.normal(size=(count, 3))
    place *= (random.uniform(0.2, 1, count) ** 0.5 / np.linalg.norm(place, axis=1))[:, None]
    place = place * size + middle
    along, side = random.normal(size=(2, count, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = np.cross(along, side)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(along, side)
    tip, left, right = place + length * along, place + length * (0.5 * along + 0.3 * side + 0.1 * up), place
    right = place + length * (0.5 * along - 0.3 * side + 0.1 * up)
    return np.concatenate([np.stack([place, left, tip], 1), np.stack([place, tip, right], 1)])


def statue() -> Stage:
    """A scaled, ridged body wound round itself on a plinth, in front of nothing. 81K triangles."""
    t, a = np.meshgrid(np.linspace(0, 1, 361), np.linspace(0, 2 * np.pi, 112), indexing="ij")
    turn = 2 * np.pi * 2.2 * t
    wide = 0.42 * np.cos(0.5 * np.pi * t) ** 0.5 + 0.1
    path = np.stack([wide * np.cos(turn), wide * np.sin(turn), 0.16 + 1.25 * t + 0.06 * np.sin(3 * turn)], -1)
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    out = np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1)
    out -= (out * along).sum(-1, keepdims=True) * along
    out /= np.linalg.norm(out, axis=-1, keepdims=True)
    up = np.cross(along, out)
    body = 0.15 * np.sin(np.pi * np.clip(t * 0.97 + 0.03, 0, 1)) ** 0.45
    scales = (
        1
        + 0.07 * np.abs(np.sin(60 * np.pi * t + 3 * a)) * np.abs(np.sin(6 * a))
        + 0.3 * np.exp(-8 * (a - np.pi / 2) ** 2) * np.abs(np.sin(45 * np.pi * t))
    )
    ring = np.cos(a)[..., None] * out + np.sin(a)[..., None] * up
    skin = sheet(path + (body * scales)[..., None] * ring)
    plinth = [
        block((0, 0, -0.35), (1.5, 1.5, 0.25)),
        lathe((0, 0, -0.1), [(0, 0), (0.66, 0), (0.68, 0.04), (0.62, 0.08), (0.6, 0.12), (0, 0.12)], 180),
    ]
    floor = grid((-6, -6, -0.35), (12, 0, 0), (0, 12, 0), 2, 2)
    return _stage([skin, *plinth, floor], (1.7, -1.9, 1.35), (0, 0, 0.58), 0.85, 1.0)


def hairball(strands: int = 1500, pieces: int = 30) -> Stage:
    """Curls of hair round a ball. 270K triangles."""
    random = np.random.default_rng(4)
    start = random.normal(size=(strands, 3))
    start /= np.linalg.norm(start, axis=1, keepdims=True)
    steps = np.linspace(0, 1, pieces + 1)
    shapes = []
    for root in start:
        pull, phase = random.normal(size=3), random.uniform(0, 6.28)
        path = root * (0.35 + 0.6 * steps[:, None]) + 0.12 * np.sin(4 * steps + phase)[:, None] * np.cross(root, pull)
        path += 0.25 * (steps**2)[:, None] * pull * 0.6
        shapes.append(tube(path, 0.0055 * (1 - 0.6 * steps), 3))
    return _stage([np.concatenate(shapes)], (0, -2.6, 0.5), (0, 0, 0), 0.95, 0.5)


STAGES: dict[str, Callable[[], Stage]] = {
    "interior": interior,
    "exterior": exterior,
    "statue": statue,
    "hairball": hairball,
}
