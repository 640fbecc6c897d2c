"""Which sides of which patches pass light on, and which places lie inside solid things.

A side matters when cosine rays that start where light is wanted, or on another side that matters,
land on it. What no such ray finds gets no entry: the outside of a sealed room costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..rays import Bvh
from ..sampling import spiral
from ..scene import Scene
from ..surface import Patches, SurfaceSamples
from .gather import Gatherer

PILOT_RAYS = 32
SIGNIFICANT = 0.02
"""A back side gets an entry when its share of the rays exceeds this part of the average side's."""

MAX_ALBEDO = 0.98
"""Bounces between albedo-1 surfaces never end; beyond this the solve would diverge."""


@dataclass(frozen=True)
class Entries:
    """Sides of patches on which lamps may shine.

    patch: (n,) int32. back: (n,) bool, the patch's reverse. area: (n,) float64 m². position, normal:
    (n, 3) float32. albedo: (n, 3) float32 in [0, MAX_ALBEDO]. radiosity: (n, 3) float32 emitted, W/m².
    front_id, back_id: (patches,) int32 entry of each patch's side, n where it has none.
    """

    patch: np.ndarray
    back: np.ndarray
    area: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    albedo: np.ndarray
    radiosity: np.ndarray
    front_id: np.ndarray
    back_id: np.ndarray

    def __len__(self) -> int:
        return len(self.patch)

    def points(self, scene: Scene, patches: Patches, each: int, seed: int) -> SurfaceSamples:
        """`each` random places on every entry, row-major: the first `each` rows are entry 0's."""
        samples = patches.sample(scene, np.repeat(self.patch, each), seed)
        # smooth shading can turn the flat normal over; the patch's own geometry names the side
        cross = scene.triangle_cross()[samples.triangle]
        upside = np.einsum("nd,nd->n", cross, samples.flat) < 0
        return samples.flipped(np.repeat(self.back, each) ^ upside)


def solid_objects(scene: Scene, bvh: Bvh, patches: Patches) -> np.ndarray:
    """(objects,) bool: closed surfaces seen from outside, whose inside no light needs to reach.

    Closed: every edge is shared by two triangles that run along it in opposite directions. A closed
    thing around a lamp is a room, not a solid.
    """
    points = np.unique(scene.positions, axis=0, return_inverse=True)[1].reshape(-1)
    corner = points[scene.triangles].astype(np.int64)
    start, end = corner.reshape(-1), np.roll(corner, -1, axis=1).reshape(-1)
    owner = np.repeat(scene.triangle_object.astype(np.int64), 3)
    span = len(points) + 1
    count = len(scene.objects)
    # an edge and its reverse cancel
    sign = np.where(start < end, 1, -1)
    key = (np.minimum(start, end) * span + np.maximum(start, end)) * count + owner
    names, edge = np.unique(key, return_inverse=True)
    edge = edge.reshape(-1)
    balance = np.bincount(edge, sign, len(names))
    closed = np.ones(count, bool)
    closed[(names % count)[(balance != 0) | (np.bincount(edge) != 2)]] = False
    cross = scene.triangle_cross()
    # outward: positive volume
    volume = np.einsum("nd,nd->n", scene.positions[scene.triangles[:, 0]] - scene.positions.mean(axis=0), cross)
    closed &= np.bincount(scene.triangle_object, volume, count) > 0
    closed[np.bincount(scene.triangle_object, minlength=count) == 0] = False
    lamps = [light.position for light in scene.lights if light.kind != "SUN"]
    if closed.any() and lamps:
        around = spiral(128)
        origins = np.repeat(np.array(lamps, np.float32), len(around), axis=0)
        piece = bvh.closest(origins, np.tile(around, (len(lamps), 1)).astype(np.float32))
        hit = piece >= 0
        triangle = patches.parent[piece[hit]]
        behind = np.einsum("nd,nd->n", cross[triangle], np.tile(around, (len(lamps), 1))[hit]) > 0
        lamp = np.repeat(np.arange(len(lamps)), len(around))[hit]
        seen = np.bincount(lamp[behind] * count + scene.triangle_object[triangle][behind], minlength=len(lamps) * count)
        closed &= ~(seen.reshape(-1, count) > 0.5 * len(around)).any(axis=0)
    return closed


def find_entries(
    scene: Scene, patches: Patches, bvh: Bvh, exits: SurfaceSamples, offset: float, seed: int = 0
) -> tuple[Entries, np.ndarray]:
    """Entries reached by light paths that end at `exits`, and (exits,) bool: those inside solid things."""
    solid = solid_objects(scene, bvh, patches)[scene.triangle_object[patches.parent]]
    count = len(patches)
    front = 2 * patches.patch
    inside_id = 2 * count
    back = np.where(solid, inside_id, front + 1)
    gatherer = Gatherer(scene, patches, bvh, front, back, inside_id + 2, offset=offset)

    def pilot(points, rays, salt):
        hits = np.zeros(gatherer.size, np.int64)
        lost = np.zeros(len(points), np.float32)

        def consume(piece, ids):
            lost[piece] += (ids == inside_id).sum(axis=0)
            found.append(np.bincount(ids.reshape(-1), minlength=gatherer.size))

        found: list[np.ndarray] = []
        gatherer.gather(points, rays, seed + salt, consume)
        for part in found:
            hits += part
        return hits[: 2 * count], lost / rays

    hits, lost = pilot(exits, PILOT_RAYS, 101)
    buried = lost > 0.5
    # what the valid exits see; then what those sides see, until nothing new turns up
    valid = np.flatnonzero(~buried)
    total = pilot(exits.take(valid), PILOT_RAYS, 102)[0] if buried.any() else hits
    reached = _significant(total, patches)
    fresh = reached.copy()
    for step in range(4):
        sides = np.flatnonzero(fresh)
        if not len(sides):
            break
        chosen = np.tile(sides, max(1, 20_000 // len(sides)))
        samples = patches.sample(scene, (chosen // 2).astype(np.int32), seed + 11 + step)
        upside = np.einsum("nd,nd->n", scene.triangle_cross()[samples.triangle], samples.flat) < 0
        points = samples.flipped((chosen % 2 == 1) ^ upside)
        total = total + pilot(points, PILOT_RAYS, 200 + step)[0]
        now = _significant(total, patches)
        fresh, reached = now & ~reached, now | reached
    return _make(scene, patches, np.flatnonzero(reached)), buried


def _significant(hits, patches):
    """(2n,) bool sides whose share of the rays matters for their area."""
    area = np.repeat(patches.area, 2)
    used = hits > 0
    if not used.any():
        return used
    average = hits.sum() / area[used].sum()
    return hits > SIGNIFICANT * average * area


def _make(scene, patches, sides):
    count = len(sides)
    patch, back = (sides // 2).astype(np.int32), sides % 2 == 1
    front_id = np.full(len(patches), count, np.int32)
    back_id = front_id.copy()
    index = np.arange(count, dtype=np.int32)
    front_id[patch[~back]] = index[~back]
    back_id[patch[back]] = index[back]
    # rays pass with the odds of the mean transmission, so those that stay see only the opaque part
    opaque = np.maximum(1 - patches.transmission[patch].mean(axis=1, keepdims=True), 1e-3)
    sign = np.where(back, -1, 1).astype(np.float32)[:, None]
    return Entries(
        patch=patch,
        back=back,
        area=patches.area[patch],
        position=patches.position[patch],
        normal=patches.normal[patch] * sign,
        albedo=np.clip(patches.albedo[patch] / opaque, 0, MAX_ALBEDO).astype(np.float32),
        radiosity=(np.pi * patches.emission[patch] / opaque).astype(np.float32),
        front_id=front_id,
        back_id=back_id,
    )
