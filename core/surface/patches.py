"""Cut surfaces into patches: the entries through which light enters the scene.

Large triangles are cut so that tracing itself names the patch that a ray lands on; the small ones of
detailed meshes are grouped by place, normal, object and material.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..rays import Tracer
from ..sampling import hash_uniform
from ..scene import Scene
from .components import components
from .samples import SurfaceSamples, inside_triangle, sample_triangles, surface_colour
from .walls import cut_at_walls, part_at_walls

ROOM = 100
"""Patches, about, of a connected part of a mesh that keeps them to itself."""

CROWDED = 1.5
"""Patches over those asked for above which objects share some."""

WALLED = 0.03
"""Part by which walls may change the number of patches before another size is sought."""

NORMAL_BINS = 27
"""A normal's direction, each coordinate rounded to −1, 0 or 1."""


@dataclass(frozen=True)
class Patches:
    """Pieces of triangles, grouped into patches.

    corners: (p, 3, 3) float32, m, of the pieces; parent: (p,) int32 triangle of the scene;
    weights: (p, 3, 3) float32 barycentric weights in the parent of each piece's corners.
    piece_area: (p,) float32, m². patch: (p,) int32 the patch of each piece.
    area: (n,) float64, m². position: (n, 3) float32 centroid. normal: (n, 3) float32 mean geometric
    normal. albedo, emission, transmission: (n, 3) float32 means over the patch.
    """

    corners: np.ndarray
    parent: np.ndarray
    weights: np.ndarray
    piece_area: np.ndarray
    patch: np.ndarray
    area: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    albedo: np.ndarray
    emission: np.ndarray
    transmission: np.ndarray

    def __len__(self) -> int:
        return len(self.area)

    def sample(self, scene: Scene, patch: np.ndarray, seed: int) -> SurfaceSamples:
        """A random place, uniform by area, on each of `patch` (n,); rows are independent."""
        order = np.argsort(self.patch, kind="stable")
        # float64: a running sum over all pieces must still resolve the smallest
        total = np.cumsum(self.piece_area[order], dtype=np.float64)
        last = np.cumsum(np.bincount(self.patch, minlength=len(self)))
        end = total[last - 1]
        start = np.concatenate([[0.0], end[:-1]])
        index = np.arange(len(patch))
        pick = start[patch] + (end - start)[patch] * hash_uniform(index, 0, seed)
        first = np.concatenate([[0], last[:-1]])
        row = np.clip(np.searchsorted(total, pick, side="right"), first[patch], last[patch] - 1)
        piece = order[row]
        inside = inside_triangle(hash_uniform(index, 1, seed), hash_uniform(index, 2, seed))
        weights = np.einsum("nk,nkc->nc", inside, self.weights[piece])
        return sample_triangles(scene, self.parent[piece], weights)


def bisect(corners: np.ndarray, longest: float, limit: int = 2_000_000) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Halve triangles across their longest edge until none is longer than `longest` metres.

    corners: (t, 3, 3) float32. Returns corners (p, 3, 3), parent (p,) int32 and weights (p, 3, 3).
    Stops early rather than make more than `limit` pieces.
    """
    parent = np.arange(len(corners), dtype=np.int32)
    weights = np.tile(np.eye(3, dtype=np.float32), (len(corners), 1, 1))
    done = []
    while True:
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        long = edges.max(axis=1) > longest
        done.append((corners[~long], parent[~long], weights[~long]))
        corners, parent, weights, edges = corners[long], parent[long], weights[long], edges[long]
        if not len(corners) or 2 * len(corners) + sum(len(d[1]) for d in done) > limit:
            done.append((corners, parent, weights))
            break
        first = edges.argmax(axis=1)
        turn = (first[:, None] + np.arange(3)) % 3
        rows = np.arange(len(corners))[:, None]
        corners, weights = corners[rows, turn], weights[rows, turn]
        halves = []
        for values in (corners, weights):
            a, b, c = values[:, 0], values[:, 1], values[:, 2]
            middle = (a + b) * np.float32(0.5)
            halves.append(np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)]))
        corners, weights = halves
        parent = np.concatenate([parent, parent])
    return tuple(np.concatenate([d[k] for d in done]) for k in range(3))


def make_patches(scene: Scene, count: int, seed: int = 0, tracer: Tracer | None = None) -> Patches:
    """About `count` patches over all surfaces that diffuse rays can see.

    The size is one for the whole scene, solved for the wanted count. They end at walls that stand on a surface. tracer: of
    shadow rays, None for one that is made here.
    """
    tracer = tracer or Tracer(scene)
    reflects = np.array([o.reflects for o in scene.objects], bool)[scene.triangle_object]
    rows = np.flatnonzero(reflects).astype(np.int32)
    corners = scene.positions[scene.triangles[rows]]
    # float64: areas of millimetre scenes
    area = 0.5 * np.linalg.norm(scene.triangle_cross(rows).astype(np.float64), axis=1).sum()
    triangles = scene.triangles[rows]
    mesh = components(len(scene.positions), triangles[:, :2].ravel(), triangles[:, 1:].ravel())[triangles[:, 0]]
    island = _islands(scene, rows, mesh, float(np.sqrt(area / max(count, 1))))
    owner = scene.triangle_object[rows]
    for objects in (owner, np.zeros_like(owner)):
        pieces, patch, found = _fit(
            corners, mesh, area, count, tracer, partial(_group, scene, rows, seed, island, objects)
        )
        # among thousands of small things each cannot have patches of its own
        if found <= CROWDED * count:
            break
    return summarise(scene, rows, pieces, patch, int(patch.max(initial=-1)) + 1)


def _fit(corners, mesh, area, count, tracer, group):
    """As `fit_size`, of patches that end at walls."""

    def walled(pieces, size):
        pieces = cut_at_walls(pieces, size, tracer)
        patch, found = group(pieces, size)
        return pieces, *part_at_walls(pieces[0], mesh[pieces[1]], patch, found, size, tracer)

    # looking for walls takes longer than all the rest
    open_size, *plain = fit_size(
        corners, float(np.sqrt(area / max(count, 1))), count, lambda *given: (given[0], *group(*given))
    )
    made = walled(plain[0], open_size)
    if made[2] != plain[2] and abs(made[2] / count - 1) > WALLED:
        _, *other = fit_size(corners, open_size * np.sqrt(made[2] / count), count, walled, 2)
        made = min(made, other, key=lambda found: abs(np.log(found[2] / count)))
    return made


def fit_size(
    corners: np.ndarray,
    size: float,
    count: int,
    group: Callable[[tuple, float], tuple[tuple, np.ndarray, int]],
    tries: int = 6,
) -> tuple[float, tuple, np.ndarray, int]:
    """Bisect triangles (t, 3, 3) to the size, m, at which group(pieces, size) finds about `count` groups in them.

    size: the first that is tried. Returns the size, pieces as from `bisect`, which `group` may have cut further, (p,) the
    group of each, and how many there are that count.
    """
    low, high, best = 0.0, np.inf, None
    for _ in range(tries):
        pieces, number, found = group(bisect(corners, size), size)
        if best is None or abs(np.log(found / count)) < abs(np.log(best[3] / count)):
            best = (size, pieces, number, found)
        if abs(found / count - 1) < 0.03:
            break
        low, high = (size, high) if found > count else (low, size)
        guess = size * np.sqrt(found / count)
        size = guess if low < guess < high else (0.5 * (low + high) if np.isfinite(high) else 2 * size)
    return best


def _group(scene, rows, seed, island, owner, pieces, size):
    """Patch of each piece, and how many there are; owner: (len(rows),) of each triangle, whose patches are its own."""
    corners, parent, _ = pieces
    centre = corners.mean(axis=1)
    shift = hash_uniform(np.arange(3), 9, seed).astype(np.float32)
    # the grid is shifted, or a wall at a round coordinate would lie on a cell's border
    cell = np.floor((centre - centre.min(axis=0)) / np.float32(size) + shift).astype(np.int64)
    cross = scene.triangle_cross(rows)[parent]
    normal = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-30)
    bins = ((np.rint(normal) + 1) @ np.array([1, 3, 9])).astype(np.int64)
    span = cell.max(axis=0) + 1
    key = (cell[:, 0] * span[1] + cell[:, 1]) * span[2] + cell[:, 2]
    _, key = np.unique(key, return_inverse=True)
    source = rows[parent]
    key = key * NORMAL_BINS + bins
    key = key * len(scene.objects) + owner[parent]
    key = key * len(scene.materials) + scene.triangle_material[source]
    key = key * (int(island.max()) + 1) + island[parent]
    names, patch = np.unique(key, return_inverse=True)
    return patch.reshape(-1).astype(np.int32), len(names)


def _islands(scene, rows, mesh, size):
    """(len(rows),) int64 number of the connected part of a mesh that each triangle belongs to, 0 for all small parts:
    rooms of one mesh share no patch across a thin wall, the leaves of a tree do. mesh: as numbered among all."""
    _, island = np.unique(mesh, return_inverse=True)
    island = island.reshape(-1)
    area = np.bincount(island, 0.5 * np.linalg.norm(scene.triangle_cross(rows).astype(np.float64), axis=1))
    large = area > ROOM * size * size
    number = np.where(large, np.cumsum(large), 0)
    return number[island]


def summarise(scene: Scene, rows: np.ndarray, pieces: tuple, patch: np.ndarray, count: int) -> Patches:
    """Patches of pieces as from `bisect`, whose parents are numbers in `rows`, triangles of the scene; patch: (p,) of each
    piece, of `count`."""
    corners, parent, weights = pieces
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).astype(np.float64)
    piece_area = 0.5 * np.linalg.norm(cross, axis=1)
    area = np.bincount(patch, piece_area, count)

    def mean(values, scale=piece_area):
        return np.stack([np.bincount(patch, values[:, k] * scale, count) for k in range(3)], 1)

    position = mean(corners.mean(axis=1)) / area[:, None]
    normal = mean(cross, np.ones(len(cross)))
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    triangle = rows[parent]
    colours = {}
    for what in ("albedo", "emission", "transmission"):
        # corners' midpoints and the centre of each piece: four looks at a texture
        looks = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4], [2, 2, 2]], np.float32) / 6
        total = 0
        for look in looks if getattr(scene, f"{what}_map") is not None else looks[3:]:
            total = total + surface_colour(scene, what, triangle, np.einsum("k,nkc->nc", look, weights))
        total = total / (4 if getattr(scene, f"{what}_map") is not None else 1)
        colours[what] = (mean(total) / area[:, None]).astype(np.float32)
    return Patches(
        corners,
        triangle,
        weights,
        piece_area.astype(np.float32),
        patch,
        area,
        position.astype(np.float32),
        normal.astype(np.float32),
        **colours,
    )
