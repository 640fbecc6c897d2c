"""The atlas as caustics see it: where on it a photon lands, and how much surface each texel stands for."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..rays import Bvh, chunks
from ..scene import Scene
from ..surface import make_texels
from ..threads import in_threads
from .blur import REACH
from .groups import charts
from .splat import box_samples

PROBES = 4
"""Places a side at which a texel on a chart's border is looked at, to tell how much of it is surface."""

SLIVER = 0.02
"""Texels with less than this part of themselves on a chart are none of it."""

HALF = 0.5
"""Texels with less than this part of themselves on a chart share a neighbour's light: theirs alone would be noise."""


class Receivers:
    """Texels that show caustics.

    resolution: texels a side. area: (resolution²,) float64 m² of surface whose light each texel gets, 0 off the charts.
    fill: (resolution²,) int32 texel that each shows, −1 where there is no surface near. inner: (resolution²,) bool, texels
    whose neighbours all belong to the same chart. chart: (T,) int32 of each triangle, 0 without a place in the atlas.

    Raises SceneError where nothing is lit, neither texels nor vertices; without texels light lands, and nothing shows it.
    """

    def __init__(self, scene: Scene, resolution: int, own: np.ndarray | None = None):
        texels = make_texels(scene, resolution)
        if own is not None and own[texels.index].any():
            texels = texels.keep(np.flatnonzero(own[texels.index]))
        self.resolution = resolution
        receives = np.array([o.receives and not o.at_vertices for o in scene.objects], bool)
        placed = np.isfinite(scene.atlas_uv).all((1, 2)) & receives[scene.triangle_object]
        rows = np.flatnonzero(placed)
        self._scene = scene
        # 0: no place in the atlas
        self.chart = np.zeros(len(placed), np.int32)
        self.chart[rows] = 1 + charts(scene.positions[scene.triangles[rows]], scene.atlas_uv[rows])
        self._owner = np.zeros(resolution * resolution, np.int32)
        self._owner[texels.index] = self.chart[texels.samples.triangle]
        self.area, full = self._areas(scene, rows, texels)
        self._owner[self.area <= 0] = 0
        self._home = self._homes(texels.index, full)
        own_home = self._home[texels.index] == texels.index
        self.texels = texels.keep(np.flatnonzero((self.area[texels.index] > 0) & own_home))
        fill = self.texels.fill()
        # −1 names the added one
        self.fill = np.append(self.texels.index, np.int32(-1))[fill]
        # whose neighbours all belong to the same chart
        self.inner = self._owner > 0
        for near in _neighbours(self._owner, resolution):
            self.inner &= near == self._owner

    @cached_property
    def depth(self) -> np.ndarray:
        """(resolution²,) uint8: texels to either side, in every direction, that all belong to the same chart as each."""
        size, reach = self.resolution, int(REACH[-1])
        owner = np.pad(self._owner.reshape(size, size), 1)
        depth, alike = np.zeros((size, size), np.uint8), self._owner.reshape(size, size) > 0
        for step in range(1, reach + 1):
            near = np.pad(alike, 1)
            alike = alike.copy()
            for dy, dx in np.ndindex(3, 3):
                part = slice(dy, dy + size), slice(dx, dx + size)
                alike &= near[part] & (owner[part] == owner[1:-1, 1:-1])
            depth[alike] = step
        return depth.reshape(-1)

    def place(self, triangle: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(2, n) float32 place in the atlas, in texels, of barycentric places on triangles; 0 where there is none."""
        corners = self._scene.atlas_uv[triangle]
        a, b, c = (corners[:, k].T for k in range(3))
        place = (a + (b - a) * u + (c - a) * v) * np.float32(self.resolution)
        return np.where(self.chart[triangle] > 0, place, np.float32(0))

    def owner(self, texel: np.ndarray) -> np.ndarray:
        """(n,) int32 chart that texels (n,) belong to, 0 for none."""
        return self._owner[texel]

    def irradiance(self, power: np.ndarray) -> np.ndarray:
        """(resolution², c) float32 W/m² of the power, (resolution², c), that landed at each texel; filled beyond charts."""
        size = len(self.area)
        area = np.bincount(self._home, self.area, size)
        area = np.where(area > 0, area, np.inf)
        lit = np.zeros(power.shape, np.float32)
        for k, channel in enumerate(power.T):
            shared = (np.bincount(self._home, channel, size) / area).astype(np.float32)
            lit[:, k] = np.where(self.fill >= 0, shared[self.fill], np.float32(0))
        return lit

    def _homes(self, index, full):
        """(resolution²,) int32 texel with which each shares its light: itself, or a neighbour on the same chart where only
        a small part of it is surface."""
        size = self.resolution
        home = np.arange(size * size, dtype=np.int32)
        part = np.zeros(size * size)
        part[index] = self.area[index] / full[index]
        best = np.where(part >= HALF, np.inf, np.maximum(part, HALF))
        for near, at, owner in zip(
            _neighbours(part, size),
            _neighbours(home.copy(), size),
            _neighbours(self._owner, size),
            strict=True,
        ):
            better = (near > best) & (owner == self._owner) & (self._owner > 0)
            home[better], best[better] = at[better], near[better]
        return home

    def _areas(self, scene, rows, texels):
        """(resolution²,) m² of surface that lies in each texel, and that would if all of it were surface."""
        size = self.resolution
        flat = scene.atlas_uv[rows].astype(np.float64) * size
        edge, other = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
        covered = np.abs(edge[:, 0] * other[:, 1] - edge[:, 1] * other[:, 0])
        world = np.linalg.norm(scene.triangle_cross(rows).astype(np.float64), axis=1)
        # m² of surface for a texel's area in the atlas
        spread = np.zeros(len(self.chart))
        spread[rows] = world / np.maximum(covered, 1e-12)
        area = np.zeros(size * size)
        area[texels.index] = spread[texels.samples.triangle]
        full = np.maximum(area, 1e-300)
        whole = np.zeros(size * size, bool)
        whole[texels.index[texels.centred]] = True
        inner = whole.copy()
        for near, also in zip(_neighbours(self._owner, size), _neighbours(whole, size), strict=True):
            inner &= also & (near == self._owner)
        border = np.flatnonzero((self._owner > 0) & ~inner)
        if not len(border):
            return area, full
        # those beside the border lend it what their samples spill over
        near = np.zeros(size * size, bool)
        near[border] = True
        for other in _neighbours(near.copy(), size):
            near |= other
        near = np.flatnonzero(near)
        step = (np.arange(PROBES) + 0.5) / PROBES
        offset = np.stack(np.meshgrid(step, step), -1).reshape(-1, 2)
        places = (np.stack([near % size, near // size], 1)[:, None] + offset).reshape(-1, 2).astype(np.float32)
        depth = np.zeros((len(flat), 3, 3), np.float32)
        depth[:, :, :2] = flat
        bvh = Bvh(depth)

        def find(piece):
            origins = np.ones((piece.stop - piece.start, 3), np.float32)
            origins[:, :2] = places[piece]
            return bvh.closest(origins, np.tile(np.array([0, 0, -1], np.float32), (len(origins), 1)))

        found = np.concatenate(in_threads(find, chunks(len(places))))
        hit = found >= 0
        part = spread[rows[found[hit]]][None] / PROBES**2
        half = np.full(hit.sum(), 0.5, np.float32)
        sums = np.zeros((size * size, 1))
        box_samples(sums, *places[hit].T, half, half, part.astype(np.float32), size)
        area[border] = np.where(sums[border, 0] > SLIVER * area[border], sums[border, 0], 0)
        return area, full


def _neighbours(values: np.ndarray, size: int):
    """The eight neighbours of each of (size²,) values, its own beyond the atlas."""
    padded = np.pad(values.reshape(size, size), 1, mode="edge")
    for dy in range(3):
        for dx in range(3):
            if dy != 1 or dx != 1:
                yield padded[dy : dy + size, dx : dx + size].reshape(-1)
