"""Scenes for penumbra casting: occluders of all kinds under an area lamp, and what a camera sees of them.

Receivers are the surfaces under the pixels of an image, as in the paper: ordered as pixels are, no way that suits us.
Every scene fills the whole image.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from lightpanes.core.rays import Bvh, chunks, in_threads
from lightpanes.core.scene import Light, Scene


@dataclass(frozen=True)
class Stage:
    """A scene, its lamp and a camera: eye and target, m, and the width of the image plane at unit distance."""

    scene: Scene
    lamp: Light
    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    width: float


def receivers(stage: Stage, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Places and unit normals, two (side², 3) float32, that the camera sees; places are lifted off their surface."""
    eye, target = (np.array(v, np.float64) for v in (stage.eye, stage.target))
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, (0, 0, 1) if abs(ahead[2]) < 0.99 else (0, 1, 0))
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead)
    across = ((np.arange(side) + 0.5) / side - 0.5) * stage.width
    directions = ahead + across[None, :, None] * right - across[:, None, None] * up
    directions = directions.reshape(-1, 3).astype(np.float32)
    origins = np.broadcast_to(eye.astype(np.float32), directions.shape).copy()
    bvh = Bvh(stage.scene.positions[stage.scene.triangles])
    found = in_threads(lambda part: bvh.hits(origins[part], directions[part]), chunks(len(directions)))
    triangle = np.concatenate([hits.triangle for hits in found])
    distance = np.concatenate([hits.distance for hits in found])
    if (triangle < 0).any():
        raise ValueError(f"{(triangle < 0).sum()} pixels see nothing.")
    normal = stage.scene.triangle_cross(triangle)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal[np.einsum("nd,nd->n", normal, directions) > 0] *= -1
    lift = 2e-5 * stage.scene.extent
    return (origins + directions * distance[:, None] + normal * np.float32(lift)).astype(np.float32), normal


def area_lamp(place, size: float, target=None, shape: str = "SQUARE") -> Light:
    """An area lamp that shines down, or at the target."""
    matrix = np.eye(4)
    if target is not None:
        back = np.array(place, float) - target
        back /= np.linalg.norm(back)
        side = np.cross((0, 1, 0), back)
        side /= np.linalg.norm(side)
        matrix[:3, :3] = np.stack([side, np.cross(back, side), back], axis=1)
    matrix[:3, 3] = place
    return Light("Lamp", "AREA", matrix, 100.0, shape=shape, size=(size, size))


def one_occluder() -> Stage:
    """A sheet over a floor."""
    shapes = [grid((-20, -20, 0), (40, 0, 0), (0, 40, 0), 1, 1), grid((-0.6, -0.5, 1), (1.2, 0, 0), (0, 1, 0), 1, 1)]
    return Stage(scene_of(shapes), area_lamp((0.3, 0.2, 4), 1.0), (0, -4, 4), (0, 0, 0), 1.1)


def crossed_grids() -> Stage:
    """Three grids of square bars, turned against each other, over a floor: 32K triangles, as the paper's Grids."""
    shapes = [grid((-20, -20, 0), (40, 0, 0), (0, 40, 0), 4, 4)]
    for layer, (height, turn) in enumerate(((0.5, 0.1), (1.0, 0.5), (1.5, 0.9))):
        for k in range(20):
            for along in (0, 1):
                offset = (k - 9.5) * 0.2
                shapes.append(_bar(offset, height + 0.03 * along, turn + along * np.pi / 2, 4.0, 0.04, 33 + layer % 2))
    return Stage(scene_of(shapes), area_lamp((0.5, 0.3, 4), 1.0), (0, -4.5, 4), (0, -0.2, 0.4), 0.9)


def _bar(offset, height, turn, length, thick, pieces):
    """A square bar of so many pieces, closed at its ends."""
    along = np.array([np.cos(turn), np.sin(turn), 0]) * length
    side = np.array([-np.sin(turn), np.cos(turn), 0])
    low = np.array([0, 0, height]) + side * (offset - thick / 2) - along / 2
    return box(low, along, side * thick, np.array([0, 0, thick]), pieces)


def boxes(count: int = 3000) -> Stage:
    """Boxes of many sizes, turned in all ways, over a floor: 36K triangles."""
    random = np.random.default_rng(7)
    shapes = [grid((-20, -20, 0), (40, 0, 0), (0, 40, 0), 4, 4)]
    for _ in range(count):
        turn, _r = np.linalg.qr(random.normal(size=(3, 3)))
        size = random.uniform(0.03, 0.12, 3)
        middle = random.uniform((-2.2, -2.2, 0.15), (2.2, 2.2, 1.6))
        axes = turn * size
        shapes.append(box(middle - axes.sum(axis=1) / 2, *axes.T, 1))
    return Stage(scene_of(shapes), area_lamp((0.4, 0.3, 4), 0.6), (0, -4.5, 4), (0, -0.2, 0.4), 0.9)


def columned_room() -> Stage:
    """A room with columns of 12 sides, a beam on each row, and a lamp under the ceiling: 2.4K triangles."""
    shapes = room((-6, -4, 0), (6, 4, 4), 6)
    for x in np.linspace(-4.5, 4.5, 5):
        for y in (-2.2, 0.4, 2.2):
            shapes.append(column((x, y, 0), 0.25, 3.4, 12))
    for y in (-2.2, 0.4, 2.2):
        shapes.append(box(np.array([-5, y - 0.25, 3.4]), np.array([10.0, 0, 0]), np.array([0, 0.5, 0]), np.array([0, 0, 0.3]), 1))
    return Stage(scene_of(shapes), area_lamp((0.8, -1.0, 3.9), 1.0), (-5.6, -3.5, 2.6), (2, 0.6, 0.8), 1.5)


def spheres(rings: int = 48, count: int = 26) -> Stage:
    """Finely tessellated spheres: 238K triangles, each far smaller than a penumbra. Rays should win."""
    random = np.random.default_rng(3)
    shapes = [grid((-20, -20, 0), (40, 0, 0), (0, 40, 0), 4, 4)]
    for _ in range(count):
        middle, radius = random.uniform((-2, -2, 0.4), (2, 2, 1.6)), random.uniform(0.15, 0.4)
        shapes.append(sphere(middle, radius, rings, 2 * rings))
    return Stage(scene_of(shapes), area_lamp((0.4, 0.3, 4), 1.0), (0, -4.5, 4), (0, -0.2, 0.4), 0.9)


def huge_lamp() -> Stage:
    """A lamp as large as the room that it is in: everything is penumbra."""
    shapes = room((-2, -2, 0), (2, 2, 3), 3)
    random = np.random.default_rng(5)
    for _ in range(60):
        turn, _r = np.linalg.qr(random.normal(size=(3, 3)))
        axes = turn * random.uniform(0.1, 0.5, 3)
        shapes.append(box(random.uniform((-1.6, -1.6, 0.2), (1.6, 1.6, 2)), *axes.T, 1))
    return Stage(scene_of(shapes), area_lamp((0, 0, 2.95), 4.0), (-1.9, -1.9, 2.5), (0.6, 0.6, 0.4), 1.4)


def flowers(plants: int = 900) -> Stage:
    """A meadow of small bent petals and leaves, open sheets: more than 200K triangles, as the paper's Flowers."""
    random = np.random.default_rng(11)
    shapes = [grid((-20, -20, 0), (40, 0, 0), (0, 40, 0), 4, 4)]
    for _ in range(plants):
        root = np.append(random.uniform(-2.2, 2.2, 2), 0)
        height = random.uniform(0.3, 0.7)
        lean = np.append(random.normal(0, 0.1, 2), 1) * height
        shapes.append(_leaf(root, lean, 0.012, 4, random))
        for _leaf_number in range(6):
            out = np.append(random.normal(0, 0.12, 2), random.uniform(0.02, 0.12))
            shapes.append(_leaf(root + lean * random.uniform(0.1, 0.7), out, 0.03, 8, random))
        for turn in np.linspace(0, 2 * np.pi, 9)[:-1]:
            out = np.array([np.cos(turn), np.sin(turn), random.uniform(-0.2, 0.5)]) * random.uniform(0.05, 0.1)
            shapes.append(_leaf(root + lean, out, 0.035, 8, random))
    return Stage(scene_of(shapes), area_lamp((0.5, 0.3, 4), 1.0), (0, -4.5, 4), (0, -0.2, 0.3), 0.9)


def _leaf(root, out, width, pieces, random):
    """A strip that bends down, pieces long and two wide."""
    along = np.linspace(0, 1, pieces + 1)[:, None]
    spine = root + along * out - along**2 * np.array([0, 0, 0.3 * np.linalg.norm(out)])
    side = np.cross(out, random.normal(size=3))
    side *= width / max(np.linalg.norm(side), 1e-9)
    half = np.sin(np.pi * (0.15 + 0.8 * along)) * side
    fold = np.cross(side, out)
    fold *= 0.3 * width / max(np.linalg.norm(fold), 1e-9)
    return _strip(np.stack([spine - half, spine + fold, spine + half], axis=1))


STAGES: dict[str, Callable[[], Stage]] = {
    "one occluder": one_occluder,
    "crossed grids": crossed_grids,
    "boxes": boxes,
    "columned room": columned_room,
}
LOSING: dict[str, Callable[[], Stage]] = {"spheres": spheres, "huge lamp": huge_lamp, "flowers": flowers}


# ---- shapes: (n, 3, 3) float64 corners ----


def scene_of(shapes: list[np.ndarray]) -> Scene:
    """One object of them all; vertices are not shared."""
    corners = np.concatenate(shapes)
    return Scene(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


def _strip(places):
    """Triangles of a grid of (rows, columns, 3) places."""
    a, b, c, d = places[:-1, :-1], places[:-1, 1:], places[1:, 1:], places[1:, :-1]
    return np.concatenate([np.stack(t, axis=2).reshape(-1, 3, 3) for t in ((a, b, c), (a, c, d))])


def grid(corner, u, v, columns: int, rows: int) -> np.ndarray:
    """A parallelogram cut into columns × rows."""
    corner, u, v = (np.array(x, float) for x in (corner, u, v))
    a, b = np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1)
    return _strip(corner + a[None, :, None] * u + b[:, None, None] * v)


def box(corner, u, v, w, pieces: int) -> np.ndarray:
    """A closed box, cut into pieces along u, wound outwards."""
    if np.dot(np.cross(u, v), w) < 0:
        v, w = w, v
    sides = [
        grid(corner, v, u, 1, pieces),
        grid(corner + w, u, v, pieces, 1),
        grid(corner, u, w, pieces, 1),
        grid(corner + v, w, u, 1, pieces),
        grid(corner, w, v, 1, 1),
        grid(corner + u, v, w, 1, 1),
    ]
    return np.concatenate(sides)


def room(low, high, pieces: int) -> list[np.ndarray]:
    """The six sides of a room, seen from within."""
    low, high = np.array(low, float), np.array(high, float)
    x, y, z = np.diag(high - low)
    return [grid(low, x, y, pieces, pieces), grid(low + z, y, x, pieces, pieces), grid(low, z, x, pieces, pieces),
            grid(low + y, x, z, pieces, pieces), grid(low, y, z, pieces, pieces), grid(low + x, z, y, pieces, pieces)]  # fmt: skip


def column(foot, radius: float, height: float, sides: int) -> np.ndarray:
    """A closed prism of many sides, with a wider plinth and head."""
    parts = []
    for low, high, wide in ((0, 0.2, 1.4), (0.2, height - 0.2, 1.0), (height - 0.2, height, 1.4)):
        angle = np.linspace(0, 2 * np.pi, sides + 1)
        angle[-1] = 0
        ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1) * radius * wide + np.array(foot, float)
        bottom, top = ring + [0, 0, low], ring + [0, 0, high]
        parts.append(_strip(np.stack([bottom, top])))
        for edge, middle in ((bottom, [0, 0, low]), (top[::-1], [0, 0, high])):
            centre = np.broadcast_to(np.array(foot, float) + middle, edge[:-1].shape)
            parts.append(np.stack([centre, edge[1:], edge[:-1]], axis=1))
    return np.concatenate(parts)


def sphere(middle, radius: float, rings: int, segments: int) -> np.ndarray:
    polar, turn = np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, segments + 1)
    turn[-1] = 0
    places = np.stack(
        [np.sin(polar)[:, None] * np.cos(turn), np.sin(polar)[:, None] * np.sin(turn), np.cos(polar)[:, None] + 0 * turn],
        axis=2,
    )
    corners = _strip(np.array(middle) + radius * places)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return corners[area > 1e-12]
