"""Dart sources: places in the air that light reaches, from which darts are thrown (Bikker & Reijerse, section 3.1).

A flood of particles leaves one at every vertex of its paths, so no dart lands inside a solid thing or outside of the
building, and nothing need be known about what is solid.
"""

from __future__ import annotations

import numpy as np

from ..rays import Bvh, chunks
from ..scene import Scene
from ..surface import Patches
from ..threads import in_threads
from ..transfer.reach import walk
from .grid import LevelGrid, nearest_first

LIFT = 0.45
"""Part of the free way along its normal by which a source is lifted into the air, at most."""

LOOKS = 4
"""Sources that are asked whether they see a place."""


def flood_sources(
    scene: Scene,
    patches: Patches,
    bvh: Bvh,
    offset: float,
    size: float,
    seed: int = 0,
    places: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices of the flood's paths, (n, 3) float32 places and normals, about one for each square of `size` m.

    places: (m, 3) where lamps may stand beside those of the scene, m.
    """
    place, normal = [], []
    for met in walk(scene, patches, bvh, offset, seed, places):
        place.append(met.place)
        normal.append(met.normal)
    if not place:
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32)
    return thin_out(np.concatenate(place).astype(np.float32), np.concatenate(normal).astype(np.float32), size)


def thin_out(place: np.ndarray, normal: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """One of the places (n, 3), with its normal, in each cube of `size` m and each of six facings."""
    if not len(place):
        return place, normal
    cell = np.floor((place - place.min(axis=0)) / np.float32(size)).astype(np.int64)
    axis = np.abs(normal).argmax(axis=1)
    facing = 2 * axis + (normal[np.arange(len(normal)), axis] < 0)
    span = cell.max(axis=0) + 1
    key = ((cell[:, 0] * span[1] + cell[:, 1]) * span[2] + cell[:, 2]) * 6 + facing
    keep = np.sort(np.unique(key, return_index=True)[1])
    return place[keep], normal[keep]


class Sources:
    """Answers whether a dart from some source lands on a place.

    place, normal: (n, 3) float32 places on the surface that light reaches. size: m, how far a source serves. Where
    many stand, those nearest to a place answer.
    """

    def __init__(self, place: np.ndarray, normal: np.ndarray, bvh: Bvh, size: float, offset: float):
        self.bvh, self.offset = bvh, np.float32(offset)
        self.place, self.normal = place, normal
        start = np.ascontiguousarray(place + normal * self.offset, np.float32)
        reach = np.full(len(place), size, np.float32)
        ahead = np.ascontiguousarray(normal, np.float32)
        free = [bvh.hits(start[s], ahead[s], reach[s]).distance for s in chunks(len(place))]
        free = np.minimum(np.concatenate(free), size) if free else reach
        lift = np.minimum(LIFT * free, 0.3 * size).astype(np.float32)
        self.air = start + ahead * lift[:, None]
        self.size = np.float32(size)
        low = self.air.min(axis=0) if len(place) else np.zeros(3)
        self.grid = LevelGrid(low).fill(self.air, reach)

    def see(self, position: np.ndarray, flat: np.ndarray) -> np.ndarray:
        """(n,) bool: whether a source of its own cell or one of the LOOKS nearest sees the place (n, 3) from the side
        of `flat` (n, 3)."""

        def part(s):
            here, side = position[s], flat[s]
            seen = np.zeros(len(here), bool)
            # most are seen by the first of their own cell that lies ahead, whichever that is
            query, source, _ = self._ahead(here, side, True)
            first = np.flatnonzero(np.diff(query, prepend=-1))
            seen[query[first]] = self._clear(here, side, query[first], source[first])
            rest = np.flatnonzero(~seen)
            seen[rest] = self._nearest_see(here[rest], side[rest])
            return seen

        parts = in_threads(part, chunks(len(position), 8192))
        return np.concatenate(parts) if parts else np.zeros(0, bool)

    def _ahead(self, position, flat, own):
        """Pairs of a place and a source near it on its side, and the square of their distance, m²."""
        query, source = self.grid.pairs(position, np.full(len(position), self.size, np.float32), own)
        apart = self.air.take(source, axis=0) - position.take(query, axis=0)
        distance2 = np.einsum("nd,nd->n", apart, apart)
        # clearly in front: rounding can put a source in the plane of the wall that it stands beside
        ahead = np.einsum("nd,nd->n", apart, flat.take(query, axis=0)) > self.offset
        keep = np.flatnonzero((distance2 < (1.5 * self.size) ** 2) & ahead)
        return query[keep], source[keep], distance2[keep]

    def _clear(self, position, flat, query, source):
        """(m,) bool: whether nothing stands between place `query` and its source."""
        lifted = position[query] + flat[query] * self.offset
        toward = self.air[source] - lifted
        return ~self.bvh.occluded(np.ascontiguousarray(lifted), np.ascontiguousarray(toward))

    def _nearest_see(self, position, flat):
        query, source, distance2 = self._ahead(position, flat, False)
        order, first = nearest_first(query, distance2, len(position))
        count = np.diff(first)
        seen = np.zeros(len(position), bool)
        for look in range(LOOKS):
            rows = np.flatnonzero(~seen & (count > look))
            if not len(rows):
                break
            seen[rows] = self._clear(position, flat, rows, source[order[first[rows] + look]])
        return seen
