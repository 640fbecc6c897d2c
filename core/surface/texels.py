"""The atlas' texels as surface samples, and how the texels between charts are filled."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..rays import Bvh, chunks
from ..scene import Scene, SceneError
from ..threads import in_threads
from .samples import SurfaceSamples, no_samples, sample_triangles

GUTTER = 16
"""Texels past a chart's border that are filled, so that filtering and mip maps never read black."""


THIN = 2048
"""Charts' triangles whose edges are followed together, from texel to texel."""


@dataclass(frozen=True)
class Texels:
    """Texels that lie on, or within one texel of, a chart.

    samples: one per such texel; where the centre is off the chart, the nearest place on the chart.
    index: (n,) int32 row × resolution + column in the atlas, row 0 at v = 0.
    centred: (n,) bool, whether the texel's own centre is on the chart.
    resolution: texels a side.
    """

    samples: SurfaceSamples
    index: np.ndarray
    centred: np.ndarray
    resolution: int

    def __len__(self) -> int:
        return len(self.index)

    def keep(self, rows: np.ndarray) -> Texels:
        """The texels at `rows` only."""
        return replace(self, samples=self.samples.take(rows), index=self.index[rows], centred=self.centred[rows])

    def fill(self, kept: np.ndarray | slice = slice(None)) -> np.ndarray:
        """(resolution²,) int32: for each texel of the atlas the row of `self`, of those at `kept` if given, that it shows.

        Texels without a row take the nearest one's within GUTTER texels, −1 beyond.
        """
        size = self.resolution
        rows = np.full((size, size), -1, np.int32)
        rows.reshape(-1)[self.index[kept]] = np.arange(len(self), dtype=np.int32)[kept]
        # nearest by growing rings: straight neighbours before diagonal ones
        steps = [(0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)]
        for _ in range(GUTTER):
            empty = rows < 0
            if not empty.any():
                break
            padded = np.pad(rows, 1, constant_values=-1)
            grown = rows.copy()
            for dy, dx in steps:
                near = padded[1 + dy : 1 + dy + size, 1 + dx : 1 + dx + size]
                grown = np.where(grown < 0, near, grown)
            rows = grown
        return rows.reshape(-1)


def make_texels(scene: Scene, resolution: int) -> Texels:
    """Find the surface under every texel, by rays through the flattened charts.

    Raises SceneError where nothing has a place in the atlas.
    """
    placed = np.flatnonzero(np.isfinite(scene.atlas_uv).all((1, 2)))
    receives = np.array([o.receives and not o.at_vertices for o in scene.objects], bool)
    placed = placed[receives[scene.triangle_object[placed]]]
    if not len(placed) and any(o.at_vertices for o in scene.objects):
        return Texels(no_samples(), np.zeros(0, np.int32), np.zeros(0, bool), resolution)
    if not len(placed):
        raise SceneError("No object has a place in the atlas; every object is excluded or could not be unwrapped.")
    flat = np.zeros((len(placed), 3, 3), np.float32)
    flat[:, :, :2] = scene.atlas_uv[placed] * resolution
    charts = Bvh(flat)

    def find(count, places):
        """Chart triangle, u and v under `count` places; places(slice): (m, 2) of them in texels."""
        triangle, u, v = np.empty(count, np.int32), np.empty(count, np.float32), np.empty(count, np.float32)

        def part(piece):
            origins = np.ones((piece.stop - piece.start, 3), np.float32)
            origins[:, :2] = places(piece)
            down = np.tile(np.array([0, 0, -1], np.float32), (len(origins), 1))
            hits = charts.hits(origins, down)
            triangle[piece], u[piece], v[piece] = hits.triangle, hits.u, hits.v

        in_threads(part, chunks(count))
        return triangle, u, v

    def centre(index):
        """(m, 2) float32 middles of texels."""
        return np.stack([index % resolution, index // resolution], 1).astype(np.float32) + np.float32(0.5)

    triangle, u, v = find(resolution**2, lambda piece: centre(np.arange(piece.start, piece.stop)))
    centred = triangle >= 0
    # texels whose centre is off the chart but which bilinear filtering reads: the nearest place that is on it
    steps = np.linspace(-1, 1, 7, dtype=np.float32)
    offsets = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    offsets = offsets[np.argsort((offsets**2).sum(1), kind="stable")][1:]
    near = _next_to(centred.reshape(resolution, resolution)).ravel()
    left = np.flatnonzero(near)
    for offset in offsets:
        if not len(left):
            break
        found, fu, fv = find(len(left), lambda piece, left=left, offset=offset: centre(left[piece]) + offset)
        hit = found >= 0
        rows = left[hit]
        triangle[rows], u[rows], v[rows] = found[hit], fu[hit], fv[hit]
        left = left[~hit]
    # charts thinner than the probes' spacing
    for piece in chunks(len(flat), THIN):
        crossed, owner, inside = _crossed(flat[piece], resolution)
        lost = triangle[crossed] < 0
        crossed, owner, inside = crossed[lost], owner[lost] + piece.start, inside[lost]
        triangle[crossed], u[crossed], v[crossed] = owner, inside[:, 1], inside[:, 2]
    index = np.flatnonzero(triangle >= 0).astype(np.int32)
    # in place: there can be many millions
    weights = np.empty((len(index), 3), np.float32)
    weights[:, 1], weights[:, 2] = u[index], v[index]
    weights[:, 0] = 1 - weights[:, 1] - weights[:, 2]
    np.clip(weights, 0, 1, out=weights)
    # off the very edge, where a wall may stand
    weights *= np.float32(0.999)
    weights += np.float32(0.001 / 3)
    triangle = placed.astype(np.int32)[triangle[index]]
    samples = sample_triangles(scene, triangle, weights)
    return Texels(samples, index, centred[index], resolution)


def _next_to(mask: np.ndarray) -> np.ndarray:
    """Unset texels with a set one among their eight neighbours."""
    padded = np.pad(mask, 1)
    size = mask.shape
    near = np.zeros_like(mask)
    for dy in range(3):
        for dx in range(3):
            near |= padded[dy : dy + size[0], dx : dx + size[1]]
    return near & ~mask


def _crossed(flat: np.ndarray, resolution: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Texels (m,) that edges of chart triangles cross, those triangles (m,), and weights (m, 3) of a place there."""
    start, end = flat[:, :, :2], np.roll(flat[:, :, :2], -1, axis=1)
    steps = np.ceil(2 * np.linalg.norm(end - start, axis=2)).astype(np.int64).ravel() + 1
    edge = np.repeat(np.arange(len(steps)), steps)
    along = (np.arange(len(edge)) - np.repeat(np.cumsum(steps) - steps, steps)) / np.maximum(steps - 1, 1)[edge]
    along = along.astype(np.float32)
    triangle, corner = edge // 3, edge % 3
    weights = np.zeros((len(edge), 3), np.float32)
    rows = np.arange(len(edge))
    weights[rows, corner], weights[rows, (corner + 1) % 3] = 1 - along, along
    place = np.einsum("nk,nkd->nd", weights, flat[triangle, :, :2])
    column, row = np.clip(place.astype(np.int64), 0, resolution - 1).T
    return row * resolution + column, triangle, weights
