"""Light leaves a surface from where a lamp lit it: entries share it with those beside them.

An entry shines evenly, so a lamp that is nearer than the entry is wide shines from the entry's middle, wherever it stands
above it, and jumps when it passes on to the next. So each entry near a lamp gives of its light to two of those beside it on
the same surface, as much as keeps the light's own middle: it wanders as the lamp does. Of all pairs that do, that one is
taken that spreads the light the least (the triangle of a Delaunay triangulation that holds the middle).
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..point_cache.grid import LevelGrid, in_chunks, nearest_first
from ..rays import Tracer, chunks
from ..sampling import frame
from ..threads import in_threads

if TYPE_CHECKING:
    from .entry_light import EntrySurface

REACH = 2.0
"""How far entries beside one lie at most, in the lesser size of the two."""

MOST = 8
"""Of these the nearest."""

STRAIGHT, FLAT = 0.9, 0.2
"""Least cosine of the angle between entries of one surface, and how far one may lie off the other's plane, over their
distance."""

ALIKE = 0.1
"""Part by which their albedo may differ: what is shared must come back as bright."""

ABOVE = 1 / 16
"""Of its size, how far above an entry nothing may stand between it and one beside it."""

OFF = 1e3
"""How much the square of what the light's middle is off weighs against the light's own mean square about the entry."""

LEFT = 0.5
"""Part of a moment that counts as wrong still when its light was shared: it is spread out instead."""

NARROW = 0.05
"""Least sine of the angle between two that share."""

_X, _Y = np.triu_indices(MOST, 1)
_SLOT = np.concatenate([np.stack([np.arange(MOST)] * 2, 1), np.stack([_X, _Y], 1)])
_TINY = np.float32(1e-30)


class Sharing:
    """Which entries lie beside one another on one surface, and how they share a lamp's light.

    tracer: of the scene, where things may stand between entries.
    """

    def __init__(self, surface: EntrySurface, tracer: Tracer):
        self._surface, self._tracer = surface, tracer
        self.middle = surface.middle
        self.area = np.maximum(surface.size**2 * surface.left, _TINY)
        corners = surface.pieces.astype(np.float64)
        own = np.repeat(np.arange(len(surface)), surface.counts)
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal = np.stack([np.bincount(own, cross[:, k], len(surface)) for k in range(3)], 1)
        self.normal = (normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)).astype(np.float32)
        self._axes = frame(self.normal)

    @cached_property
    def beside(self) -> np.ndarray:
        """(n, MOST) int32 entries beside each, the nearest first, −1 where there are no more; found when first asked for."""
        surface, tracer, count = self._surface, self._tracer, len(self._surface)
        beside = np.full((count, MOST), -1, np.int32)
        if count < 2:
            return beside
        # slivers are longer than their area says
        place = surface.position.reshape(count, -1, 3)
        spread = ((place - place.mean(axis=1, keepdims=True)) ** 2).sum(axis=2).mean(axis=1)
        size = np.maximum(np.sqrt(6 * spread), surface.size)
        reach = REACH * np.maximum(size, size.max() / 64).astype(np.float32)
        grid = LevelGrid(self.middle.min(axis=0)).fill(self.middle, reach)

        def pairs(s):
            here, there = grid.pairs(self.middle[s], reach[s])
            here = here + s.start
            first = here < there
            here, there = here[first], there[first]
            way = self.middle[there] - self.middle[here]
            square = np.einsum("md,md->m", way, way)
            close = (square > 0) & (square < np.minimum(reach[here], reach[there]) ** 2)
            here, there, way, apart = here[close], there[close], way[close], np.sqrt(square[close])
            one, other = self.normal[here], self.normal[there]
            off = np.maximum(*(np.abs(np.einsum("md,md->m", way, v)) for v in (one, other)))
            colours = surface.albedo[here], surface.albedo[there]
            alike = np.abs(colours[0] - colours[1]).max(axis=1) <= ALIKE * np.maximum(*colours).max(axis=1)
            same = (np.einsum("md,md->m", one, other) > STRAIGHT) & (off < FLAT * apart) & alike
            return np.unique(here[same].astype(np.int64) * count + there[same])

        here, there = np.divmod(np.concatenate(in_chunks(pairs, count)), count)
        lift = np.maximum(ABOVE * np.minimum(size[here], size[there]), 2 * tracer.offset)[:, None].astype(np.float32)
        start = self.middle[here] + self.normal[here] * lift
        way = self.middle[there] + self.normal[there] * lift - start
        parted = in_threads(lambda s: tracer.blocked(start[s], way[s]), chunks(len(here)))
        free = ~np.concatenate([*parted, np.zeros(0, bool)])
        here, there = np.concatenate([here[free], there[free]]), np.concatenate([there[free], here[free]])
        order, first = nearest_first(here, np.linalg.norm(self.middle[there] - self.middle[here], axis=1), count)
        rank = np.arange(len(here)) - first[here[order]]
        few = order[rank < MOST]
        beside[here[few], rank[rank < MOST]] = there[few]
        return beside

    def share(self, found: np.ndarray, moment: np.ndarray, rows: np.ndarray, part: np.ndarray) -> None:
        """Share the light of some entries (m,), in place.

        found: (n,) or (n, 3) irradiance of all entries, of a moment (n, 3), m, about each entry's middle; both become what they
        are afterwards. part: (m,) of the moments, how much of them.
        """
        grey = found[rows] if found.ndim == 1 else found[rows].mean(axis=1)
        lit = np.flatnonzero((grey > 0) & (part > 0))
        if not len(lit):
            return
        rows, centre = rows[lit], moment[rows[lit]] / grey[lit, None]
        to, weight, carried = self._weights(rows, centre)
        weight *= part[lit, None]
        moment[rows] -= carried * (np.float32(1 - LEFT) * part[lit] * grey[lit])[:, None]
        scale = weight * (self.area[rows, None] / self.area[to])
        given = found[rows].reshape(len(rows), -1)
        kept = given * np.maximum(1 - weight.sum(axis=1, keepdims=True), 0)
        gained = given[:, None] * scale[..., None]
        found[rows] = kept.reshape(-1, *found.shape[1:])
        np.add.at(found, to.reshape(-1), gained.reshape(-1, *found.shape[1:]))

    @cached_property
    def _fan(self):
        """Of those beside each entry, in its plane: m (n, MOST) to the side and across, their squared distance, and (n, pairs)
        1 over twice the area of the triangle of two of them with the entry, NaN where there is none to speak of."""
        way = self.middle[self.beside] - self.middle[:, None]
        x, y = (np.einsum("nkd,nd->nk", way, axis) for axis in self._axes)
        square = np.maximum(x * x + y * y, _TINY)
        double = x[:, _X] * y[:, _Y] - y[:, _X] * x[:, _Y]
        wide = np.abs(double) > NARROW * np.sqrt(square[:, _X] * square[:, _Y])
        use = wide & (self.beside[:, _Y] >= 0)
        return x, y, square, np.where(use, 1 / np.where(use, double, 1), np.float32(np.nan))

    def _weights(self, rows, centre):
        """(m, 2) entries that entries (m,) share with, (m, 2) part of their light that each gets, and (m, 3) how far that
        moves the light's middle, m. centre: (m, 3) m, where it is to be, from the entry's own."""
        beside, (side, across) = self.beside[rows], (axis[rows] for axis in self._axes)
        x, y, square, inverse = (values[rows] for values in self._fan)
        u, v = (np.einsum("md,md->m", centre, axis)[:, None] for axis in (side, across))
        # one alone, as near as it gets
        single = np.where(beside < 0, 0, np.clip((x * u + y * v) / square, 0, 1))
        alone = OFF * ((u - single * x) ** 2 + (v - single * y) ** 2) + single * square
        # two whose triangle with the entry holds the middle: parts of its area
        over = u * y - v * x
        first, second = over[:, _Y] * inverse, -over[:, _X] * inverse
        holds = (first >= 0) & (second >= 0) & (first + second <= 1)
        pair = np.where(holds, first * square[:, _X] + second * square[:, _Y], np.inf)
        best = np.concatenate([alone, pair], 1).argmin(axis=1)
        row = np.arange(len(rows))
        slot = _SLOT[best]
        two = np.maximum(best - MOST, 0)
        lone = best < MOST
        weight = np.empty((len(rows), 2), np.float32)
        weight[:, 0] = np.where(lone, single[row, slot[:, 0]], first[row, two])
        weight[:, 1] = np.where(lone, 0, second[row, two])
        at = row[:, None], slot
        moved = ((weight * x[at]).sum(axis=1), (weight * y[at]).sum(axis=1))
        return beside[at], weight, moved[0][:, None] * side + moved[1][:, None] * across
