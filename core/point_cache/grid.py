"""Point set queries: which points are near a place (Bikker & Reijerse, section 5).

`DiscGrid` is the paper's regular grid: each point is an oriented disc, listed in every cell that the disc touches, so
a query reads one cell. `LevelGrid` lists each point once a level of radius and reads eight cells; it can grow.
Both are flat arrays: where a cell's list begins, and the lists one after another.
"""

from __future__ import annotations

import numpy as np

from ..rays import chunks
from ..threads import in_threads

QUERIES = 16_384
"""Queries handled together: their pairs stay in the caches."""

THICK = 0.3
"""Half the thickness of a disc over its radius: curved surfaces leave the disc's plane."""

DISC_CELLS = 1.5
"""Cell of the regular grid over the small discs' radius."""


def expand(first: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Runs first[i], first[i] + 1, … of `count[i]` each, one after another, and the number i of each."""
    row = np.repeat(np.arange(len(count), dtype=np.int32), count)
    ends = np.cumsum(count)
    total = int(ends[-1]) if len(ends) else 0
    return np.arange(total) + np.repeat(first - (ends - count), count), row


class DiscGrid:
    """The paper's grid of oriented discs.

    position: (n, 3) float32, m; normal: (n, 3) float32; reach: (n,) float32 radius of each disc, m.
    """

    def __init__(self, position: np.ndarray, normal: np.ndarray, reach: np.ndarray):
        self.low = position.min(axis=0) if len(position) else np.zeros(3, np.float32)
        self.cell = np.float32(DISC_CELLS * np.quantile(reach, 0.25)) if len(reach) else np.float32(1)
        point, cells = self._touched(position - self.low, normal, reach)
        # one more on each side, for queries just outside
        self.low_cell = cells.min(axis=0) - 1 if len(cells) else np.zeros(3, np.int64)
        self.shape = cells.max(axis=0) - self.low_cell + 2 if len(cells) else np.ones(3, np.int64)
        key = self._key(cells)
        order = np.argsort(key, kind="stable")
        self.point = point[order]
        self.names, self.first, self.count = np.unique(key[order], return_index=True, return_counts=True)

    def _key(self, cells):
        inside = np.clip(cells - self.low_cell, 0, self.shape - 1)
        return (inside[:, 0] * self.shape[1] + inside[:, 1]) * self.shape[2] + inside[:, 2]

    def _touched(self, position, normal, reach):
        """Every (point, cell) that touch: (m,) int32 and (m, 3) int64."""
        points, cells = [], []
        half = reach[:, None] * (np.sqrt(np.maximum(1 - normal**2, 0)) + np.float32(THICK) * np.abs(normal))
        first = np.floor((position - half) / self.cell).astype(np.int64)
        span = np.floor((position + half) / self.cell).astype(np.int64) - first + 1
        counts = span.prod(axis=1)
        for piece in chunks(len(position), 4096):
            run, row = expand(np.zeros(piece.stop - piece.start, np.int64), counts[piece])
            row = row + piece.start
            x, rest = np.divmod(run, span[row, 1] * span[row, 2])
            y, z = np.divmod(rest, span[row, 2])
            cell = first[row] + np.stack([x, y, z], 1)
            middle = (cell + np.float32(0.5)) * self.cell - position[row]
            outside = np.maximum(np.abs(middle) - self.cell / 2, 0)
            above = np.abs(np.einsum("nd,nd->n", middle, normal[row]))
            allowed = np.float32(THICK) * reach[row] + self.cell / 2 * np.abs(normal[row]).sum(axis=1)
            keep = ((outside**2).sum(axis=1) <= reach[row] ** 2) & (above <= allowed)
            points.append(row[keep].astype(np.int32))
            cells.append(cell[keep])
        if not points:
            return np.zeros(0, np.int32), np.zeros((0, 3), np.int64)
        return np.concatenate(points), np.concatenate(cells)

    def pairs(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(m,) int32 query and (m,) int32 point of all pairs whose disc may hold the place; places: (q, 3) float32.

        Pairs come in the queries' order. One thread: cut into chunks before.
        """
        if not len(self.names):
            return np.zeros(0, np.int32), np.zeros(0, np.int32)
        key = self._key(np.floor((places - self.low) / self.cell).astype(np.int64))
        at = np.minimum(np.searchsorted(self.names, key), len(self.names) - 1)
        count = np.where(self.names[at] == key, self.count[at], 0)
        slot, query = expand(self.first[at], count)
        return query, self.point[slot]


class LevelGrid:
    """Points in cells as large as a radius, listed once for each half octave between their least radius and their
    largest; finds those that are nearer than the smaller of two radii.
    """

    def __init__(self, low: np.ndarray):
        self.low = np.asarray(low, np.float32)
        self.table = np.zeros(2, np.int64)
        self.point = np.zeros(0, np.int32)
        self.size = 1
        self.lowest = self.highest = 0

    @staticmethod
    def levels(radius: np.ndarray) -> np.ndarray:
        """(n,) int64: half octaves of the radius, m."""
        return np.floor(2 * np.log2(radius)).astype(np.int64)

    @staticmethod
    def _cells(level):
        """m: twice the largest radius of a level."""
        return np.exp2(0.5 * (level + 1) + 1).astype(np.float32)

    def _hash(self, cell, level):
        mixed = cell[0] * 73856093 ^ cell[1] * 19349663 ^ cell[2] * 83492791 ^ level * 49979687
        return (mixed ^ mixed >> 15) & (self.size - 1)

    def fill(self, position: np.ndarray, radius: np.ndarray) -> LevelGrid:
        """List these points, (n, 3) float32 and (n,) float32, in place of those that were."""
        count = len(position)
        own = self.levels(radius) if count else np.zeros(1, np.int64)
        self.lowest, self.highest = int(own.min()), int(own.max())
        levels = range(self.lowest, self.highest + 1)
        self.size = 1 << max(4, int(np.ceil(np.log2(4 * len(levels) * max(count, 1)))))
        local = (position - self.low).T
        keys = np.empty((len(levels), count), np.int32)
        for k, level in enumerate(levels):
            cell = np.floor(local / self._cells(level)).astype(np.int64)
            keys[k] = self._hash(cell, level)
        keys = keys.reshape(-1)
        order = np.argsort(keys)
        self.point = (order % max(count, 1)).astype(np.int32)
        self.table = np.concatenate([[0], np.cumsum(np.bincount(keys, minlength=self.size))])
        return self

    def pairs(self, places: np.ndarray, radius: np.ndarray, own: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """(m,) int32 query and (m,) int32 point of all pairs that may lie within the smaller radius of each other.

        own: only those that share a cell. A pair may come twice. One thread: cut into chunks before.
        """
        # beyond the points' own radii theirs is the smaller one, or holds the query's
        level = np.clip(self.levels(radius), self.lowest, self.highest)
        size = self._cells(level)
        corner = np.floor((places - self.low).T / size - np.float32(0 if own else 0.5)).astype(np.int64)
        queries, points = [], []
        for k in range(1 if own else 8):
            cell = corner + np.array([k >> 2 & 1, k >> 1 & 1, k & 1])[:, None]
            key = self._hash(cell, level)
            first = self.table[key]
            slot, query = expand(first, self.table[key + 1] - first)
            queries.append(query)
            points.append(self.point[slot])
        return np.concatenate(queries), np.concatenate(points)


def in_chunks(function, count: int) -> list:
    """[function(slice)] over the queries, on threads, in order."""
    return in_threads(function, chunks(count, QUERIES))


def nearest_first(query: np.ndarray, distance: np.ndarray, queries: int) -> tuple[np.ndarray, np.ndarray]:
    """Order of pairs by query and, within one, by distance (m,) float32 ≥ 0; and (queries + 1,) where each begins."""
    # positive floats sort like the integers of their bits
    key = query.astype(np.int64) << 32 | distance.astype(np.float32).view(np.uint32)
    first = np.concatenate([[0], np.cumsum(np.bincount(query, minlength=queries))])
    return np.argsort(key), first
