"""A scene made ready for rays from a camera: where they land, with which normals, and what passes straight on."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..caustics import casters
from ..rays import LAYERS, Bvh, Tracer
from ..scene import Scene
from ..surface.components import components
from ..surface.samples import unit
from ..vectors import around, dot, join, split
from .lobes import OpticsTable
from .looks import Looks, Texture, corner_values

SMOOTH = 0.9999
"""Cosine between a corner's normal and the face's own, below which a triangle counts as smoothly shaded."""


class Places(NamedTuple):
    """Where rays land. rows: (m,) of those that land at all. triangle (m,) int32; u, v (m,) barycentric weights;
    distance (m,) m along the ray; weight (m, 3) that light got on its way through see-through surfaces, None for ones.
    missed: (k,) rows that leave the scene, and their weight, (k, 3) or None."""

    rows: np.ndarray
    triangle: np.ndarray
    u: np.ndarray
    v: np.ndarray
    distance: np.ndarray
    weight: np.ndarray | None
    missed: np.ndarray
    missed_weight: np.ndarray | None


class Surfaces:
    """Rays through a scene. textures: of materials, by number. Calls trace on the calling thread."""

    def __init__(self, scene: Scene, textures: Mapping[int, Texture] | None = None):
        self.scene = scene
        self.looks = Looks(scene, textures)
        self.flat = unit(scene.triangle_cross())
        turned = np.einsum("tkd,td->tk", scene.corner_normals, self.flat)
        self.smooth = (turned < SMOOTH).any(axis=1)
        self._any_smooth, self._flat = bool(self.smooth.any()), split(self.flat)
        self.tracer = Tracer(scene).alone()
        self.offset = np.float32(self.tracer.offset)
        self.transmission = self.tracer.transmission
        self.see_through = self.transmission.see_through
        self.any_see_through = bool(self.see_through.any())
        self.optics = OpticsTable(scene.materials)
        self.several = self.see_through | self.optics.shiny[scene.triangle_material]
        self.any_several = bool(self.several.any())
        owner = scene.triangle_object
        self._blocking: Tracer | None = None
        self._made: dict[bytes, tuple[Bvh, np.ndarray | None]] = {}
        self.seen = self._bvh(np.array([o.seen for o in scene.objects], bool)[owner])
        self.reflecting = self._bvh(np.array([o.reflects for o in scene.objects], bool)[owner])

    def shadows(self, focused: bool) -> Tracer:
        """Shadow rays. focused: mirrors and glass stop them, since the light that these focus is known (`Baked`)."""
        found = casters(self.scene) if focused else None
        if found is None:
            return self.tracer
        if self._blocking is None:
            self._blocking = Tracer(self.scene, solid=found.triangles).alone()
        return self._blocking

    def _bvh(self, mask):
        """Hierarchy over the triangles of a mask, and their numbers, None where these are all."""
        key = mask.tobytes()
        if key not in self._made:
            bvh, names = self.tracer.solid
            if not np.array_equal(names, np.flatnonzero(mask)):
                names = np.flatnonzero(mask)
                bvh = Bvh(self.scene.positions, self.scene.triangles[names])
            self._made[key] = bvh, None if len(names) == len(mask) else names.astype(np.int32)
        return self._made[key]

    @property
    def is_plain(self) -> bool:
        """Whether a camera's ray ends at the first surface that it meets, whichever that is."""
        return not self.any_see_through and all(material.optics is None for material in self.scene.materials)

    def land(self, part, origins, directions, chance: np.ndarray | None = None, reach=None) -> Places:
        """First surfaces that rays meet; what is see-through they pass with the chance that it lets light pass.

        part: `seen` or `reflecting`. origins, directions: (n, 3) float32, unit directions. chance: (n,) in [0, 1);
        None to stop at the first surface, whatever it is. reach: (n,) m.
        """
        bvh, names = part
        hits = bvh.hits(origins, directions, reach)
        triangle = hits.triangle
        if names is not None:
            triangle = np.where(triangle < 0, -1, names.take(np.maximum(triangle, 0)))
        landed = triangle >= 0
        rows, missed = np.flatnonzero(landed), np.flatnonzero(~landed)
        triangle, u, v, distance = triangle[rows], hits.u[rows], hits.v[rows], hits.distance[rows]
        if not self.any_see_through or chance is None:
            return Places(rows, triangle, u, v, distance, None, missed, None)
        return self._pass_on(part, origins, directions, chance, reach, (rows, triangle, u, v, distance, missed))

    def _pass_on(self, part, origins, directions, chance, reach, first) -> Places:
        rows, triangle, u, v, distance, missed = first
        count = len(origins)
        weight = np.ones((count, 3), np.float32)
        at, way = np.full(count, -1, np.int32), np.zeros(count, np.float32)
        us, vs = np.zeros(count, np.float32), np.zeros(count, np.float32)
        gone = np.zeros(count, np.float32)
        chance = chance.copy()
        for _ in range(LAYERS):
            passes = self.see_through[triangle]
            clear = np.flatnonzero(passes)
            tint = self.transmission.at(triangle[clear], u[clear], v[clear])
            share, who = tint.mean(axis=1), rows[clear]
            through = chance[who] < share
            # what is left of a chance is again uniform
            part_share = np.where(through, share, 1 - share)
            chance[who] = np.where(through, chance[who], chance[who] - share) / np.maximum(part_share, 1e-6)
            weight[who] *= np.where(through[:, None], tint, 1) / np.maximum(part_share, 1e-6)[:, None]
            passes[clear] = through
            stop = np.flatnonzero(~passes)
            at[rows[stop]], us[rows[stop]], vs[rows[stop]] = triangle[stop], u[stop], v[stop]
            way[rows[stop]] = gone[rows[stop]] + distance[stop]
            on = np.flatnonzero(passes)
            if not len(on):
                break
            rows = rows[on]
            gone[rows] += distance[on] + self.offset
            start = origins[rows] + gone[rows, None] * directions[rows]
            left = None if reach is None else np.maximum(reach[rows] - gone[rows], 0)
            more = self.land(part, start, directions[rows], None, left)
            triangle, u, v, distance = more.triangle, more.u, more.v, more.distance
            rows = rows[more.rows]
        landed = at >= 0
        rows, missed = np.flatnonzero(landed), np.flatnonzero(~landed)
        return Places(rows, at[rows], us[rows], vs[rows], way[rows], weight[rows], missed, weight[missed])

    @cached_property
    def strip_width(self) -> np.ndarray:
        """(T,) float32, about how wide the island of the atlas is that a triangle belongs to, in atlas widths: its area over
        its longest side. NaN without a place there."""
        uv = self.scene.atlas_uv.astype(np.float32)
        place = np.ascontiguousarray(uv).view(np.uint64)[..., 0]
        corner = np.unique(place, return_inverse=True)[1].reshape(place.shape)
        ends = corner[:, [0, 1]].ravel(), corner[:, [1, 2]].ravel()
        island = components(int(corner.max(initial=-1)) + 1, *ends)[corner[:, 0]]
        along, up = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
        area = np.bincount(island, np.abs(along[:, 0] * up[:, 1] - along[:, 1] * up[:, 0]) / 2)
        low, high = np.full((len(area), 2), np.inf), np.full((len(area), 2), -np.inf)
        np.minimum.at(low, island, uv.min(axis=1))
        np.maximum.at(high, island, uv.max(axis=1))
        return (area / np.maximum(np.linalg.norm(high - low, axis=1), 1e-30)).astype(np.float32)[island]

    def is_front(self, triangle, normal) -> np.ndarray:
        """(n,) bool: whether normals (n, 3) of triangles (n,) point where the faces' own do."""
        own = self._flat
        return (
            own[0].take(triangle, mode="clip") * normal[:, 0]
            + own[1].take(triangle, mode="clip") * normal[:, 1]
            + own[2].take(triangle, mode="clip") * normal[:, 2]
            > 0
        )

    def normals(self, triangle, u, v, directions) -> tuple[np.ndarray, np.ndarray]:
        """Unit shading normals and geometric ones, (n, 3) float32 each, both on the side that rays come from.

        directions: (n, 3) of the rays that landed there.
        """
        parts = [column.take(triangle, mode="clip") for column in self._flat]
        sign = np.copysign(np.float32(1), -dot(parts, directions.T))
        flat = join(*(part * sign for part in parts))
        smooth = np.flatnonzero(self.smooth[triangle]) if self._any_smooth else ()
        if not len(smooth):
            return flat, flat
        normal = flat.copy()
        mean = corner_values(self.scene.corner_normals, triangle[smooth], u[smooth], v[smooth])
        length = np.sqrt(np.einsum("nd,nd->n", mean, mean))[:, None]
        mean /= np.maximum(length, np.float32(1e-6))
        mean[np.einsum("nd,nd->n", mean, flat[smooth]) < 0] *= -1
        # opposite corner normals can cancel
        normal[smooth] = np.where(length > 1e-6, mean, flat[smooth])
        return normal, flat

    def scatter(self, normal, flat, u: np.ndarray) -> np.ndarray:
        """(n, 3) unit directions in proportion to their cosine with the shading normal, above the surface.

        u: (2, n) in [0, 1).
        """
        angle, radius = u[1] * np.float32(2 * np.pi), np.sqrt(u[0])
        parts = around(split(normal), radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - u[0]))
        if normal is not flat:
            height = dot(parts, flat.T)
            below = np.flatnonzero(height < 0)
            for k in range(3):
                parts[k][below] -= 2 * height[below] * flat[below, k]
        return join(*parts)
