"""Dart throwing: a Poisson disk set on the surface (Bikker & Reijerse, section 3), the same for any batch size.

A dart's number gives its place, by hashing, and its priority: the set is what throwing the darts one by one gives,
however many are handled together. Darts fall on a fragment of the surface in proportion to its area over the square of
the radius there, since elsewhere most would be thrown away.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..sampling import hash_uint32, hash_uniform
from ..scene import Scene
from ..surface import SurfaceSamples, inside_triangle, no_samples, sample_triangles
from .grid import LevelGrid, in_chunks

PACKING = 0.6
"""Points per r² of area that DARTS darts each bring about; no more than 0.696 would ever fit (Feder 1980)."""

DARTS = 8
"""Darts for each point that fits."""

LIKE = 0.5
"""Cosine of the angle between normals up to which points keep their distance."""

FLAT = 0.5
"""Points whose connection rises more than this over the surface, relative to its length, lie on different sheets."""

LARGEST_BATCH = 524_288
"""Darts handled together at most, so that memory is bounded."""

FEW = 2048
"""Of a crowd, those that are the first to be thinned out."""

WINDOW = 16_384
"""Darts over which the hit rate is judged."""

HIT_RATE = 0.01
"""Below this part of darts that stick, the surface counts as full."""


@dataclass(frozen=True)
class Fragments:
    """Both sides of pieces of the surface: side 2k is piece k's front, 2k + 1 its back.

    parent: (f,) int32 triangle of the scene; weights: (f, 3, 3) float32 of its corners in the parent; area: (f,)
    float64 m². radius: (2 f,) float32 m, NaN on sides without points.
    """

    parent: np.ndarray
    weights: np.ndarray
    area: np.ndarray
    radius: np.ndarray

    def expected(self) -> float:
        """Points that fit."""
        return float(PACKING * self.density().sum())

    def density(self) -> np.ndarray:
        """(2 f,) float64: area over the square of the radius, 0 on sides without points."""
        return np.where(np.isfinite(self.radius), np.repeat(self.area, 2) / self.radius.astype(np.float64) ** 2, 0)

    def scaled(self, count: int, least: float, most: float) -> Fragments:
        """The radii times one number such that about `count` points fit, within [least, most] m."""
        low, high = 1e-12, 1e12
        # bisection: the clamps make the count anything but a power of the scale
        for _ in range(80):
            scale = np.sqrt(low * high)
            trial = replace(self, radius=np.clip(self.radius * np.float32(scale), np.float32(least), np.float32(most)))
            low, high = (scale, high) if trial.expected() > count else (low, scale)
        return trial


@dataclass(frozen=True)
class Darts:
    """What stuck. samples: (n) places; radius: (n,) float32 m; back: (n,) bool; number: (n,) int64 of each dart, in
    order; thrown: how many were thrown."""

    samples: SurfaceSamples
    radius: np.ndarray
    back: np.ndarray
    number: np.ndarray
    thrown: int

    def join(self, samples, radius, back, number, thrown: int) -> Darts:
        """With more that stuck, after `thrown` in all."""
        mine = (self.radius, radius), (self.back, back), (self.number, number)
        return Darts(self.samples.join(samples), *(np.concatenate(pair) for pair in mine), thrown)


def throw(
    scene: Scene,
    fragments: Fragments,
    reached: Callable[[SurfaceSamples], np.ndarray],
    seed: int = 0,
    count: int | None = None,
    batch: int = 65_536,
    darts: int = DARTS,
    tick: Callable[[int], None] | None = None,
    least: float = 0.0,
    measure: Callable[[SurfaceSamples, np.ndarray], np.ndarray] | None = None,
) -> Darts:
    """Throw darts until the surface is full, or `count` stick.

    reached(samples): (n,) bool, whether light gets there. batch: darts handled together at first, then as many as were
    thrown before; it changes nothing but time. darts: thrown for each point that fits. tick(darts thrown) follows each
    batch. measure(samples, numbers): (n,) float32 radius of each dart, m, at least `least`, in place of its fragment's,
    as in the paper: asked of those that have no point within `least` and are reached.
    """
    density = fragments.density()
    limit = int(darts * PACKING * density.sum()) + 64
    # float64: the smallest fragments' shares are below float32's steps
    total = np.cumsum(density)
    low = scene.positions.min(axis=0)
    stuck_in = np.zeros(-(-limit // WINDOW) + 1, np.int64)
    grid = LevelGrid(low)
    stuck = Darts(no_samples(), np.zeros(0, np.float32), np.zeros(0, bool), np.zeros(0, np.int64), 0)
    while stuck.thrown < limit and total[-1] > 0:
        at = stuck.thrown
        number = np.arange(at, min(at + max(batch, min(at, LARGEST_BATCH)), limit))
        samples, r, back = _places(scene, fragments, total, number, seed)
        if measure is not None:
            r = np.full(len(number), least, np.float32)
        free = np.flatnonzero(~_conflicts(grid, stuck, samples, r))
        free = free[reached(samples.take(free))]
        if measure is not None:
            # what sticks with nothing near needs its measure as well: later darts ask how far it keeps them
            r[free] = measure(samples.take(free), number[free])
            free = free[~_conflicts(grid, stuck, samples.take(free), r[free])]
        chosen = free[first_come(samples.take(free), r[free], low)]
        end = _end(stuck_in, number[chosen], at + len(number), limit)
        chosen = chosen[number[chosen] < end]
        if count is not None:
            chosen = chosen[: count - len(stuck.radius)]
        fresh = (samples.take(chosen), r[chosen], back[chosen], number[chosen])
        stuck = stuck.join(*fresh, thrown=at + len(number))
        if tick is not None:
            tick(len(number))
        if end < stuck.thrown or (count is not None and len(stuck.radius) >= count):
            break
        grid.fill(stuck.samples.position, stuck.radius)
    return stuck


def _end(stuck_in, number, at, limit):
    """The dart before which throwing ends: the first window, complete by now, in which too few stuck."""
    stuck_in += np.bincount(number // WINDOW, minlength=len(stuck_in))
    poor = np.flatnonzero(stuck_in[: at // WINDOW] < HIT_RATE * WINDOW)
    return (int(poor[0]) + 1) * WINDOW if len(poor) else limit


def _places(scene, fragments, total, number, seed):
    """Places, radii and sides of darts, each from its number alone."""
    # rounding must not go past the last side that has points
    last = np.searchsorted(total, total[-1])

    def part(s):
        # two hashes: there may be more fragments than the bits of one float32 tell apart
        own = number[s]
        fine = hash_uint32(own, 0, seed).astype(np.float64) * 2.0**-32 + hash_uint32(own, 1, seed) * 2.0**-64
        side = np.minimum(np.searchsorted(total, fine * total[-1], side="right"), last)
        inside = inside_triangle(hash_uniform(own, 2, seed), hash_uniform(own, 3, seed))
        weights = np.einsum("nk,nkc->nc", inside, fragments.weights[side // 2])
        back = side % 2 == 1
        samples = sample_triangles(scene, fragments.parent[side // 2], weights).on_side(scene, back)
        return samples, fragments.radius[side], back

    samples, radius, back = zip(*in_chunks(part, len(number)), strict=True)
    return samples[0].join(*samples[1:]), np.concatenate(radius), np.concatenate(back)


def conflicting(
    query: np.ndarray, point: np.ndarray, one: tuple[np.ndarray, ...], other: tuple[np.ndarray, ...]
) -> np.ndarray:
    """Which of the pairs (query, point) lie on one surface and are closer than the smaller radius: their rows.

    one, other: (position, normal, radius) arrays that `query` and `point` are rows of.
    """
    apart = other[0].take(point, axis=0) - one[0].take(query, axis=0)
    distance2 = np.einsum("nd,nd->n", apart, apart)
    near = np.flatnonzero(distance2 < np.minimum(one[2].take(query), other[2].take(point)) ** 2)
    mine, yours = one[1].take(query[near], axis=0), other[1].take(point[near], axis=0)
    alike = np.einsum("nd,nd->n", mine, yours) > LIKE
    rise = np.abs(np.einsum("nd,nd->n", apart[near], mine + yours)) / 2
    return near[alike & (rise <= FLAT * np.sqrt(distance2[near]))]


def _conflicts(grid, stuck, samples, r):
    """(n,) bool: whether a dart that stuck already is too near."""
    found = np.zeros(len(r), bool)
    if not len(stuck.radius):
        return found
    there = stuck.samples.position, stuck.samples.normal, stuck.radius

    def part(s):
        bad = np.zeros(s.stop - s.start, bool)
        # most meet a rival in their own cell
        for own in (True, False):
            left = np.flatnonzero(~bad)
            here = samples.position[s][left], samples.normal[s][left], r[s][left]
            query, point = grid.pairs(here[0], here[2], own)
            rows = conflicting(query, point, here, there)
            bad[left[query[rows]]] = True
        found[s] = bad

    in_chunks(part, len(r))
    return found


def first_come(samples: SurfaceSamples, r: np.ndarray, low: np.ndarray) -> np.ndarray:
    """(m,) int64: of darts in the order of their rows, those that stick: each whose earlier rivals do not.

    r: (n,) m. low: (3,) least coordinates, m.
    Rounds of Luby's kind: all darts without an undecided earlier rival stick at once; their later rivals fall.
    """
    count = len(r)
    if not count:
        return np.zeros(0, np.int64)
    grid = LevelGrid(low).fill(samples.position, r)
    all_ = samples.position, samples.normal, r

    def part(s):
        query, point = grid.pairs(samples.position[s], r[s])
        query = query + np.int32(s.start)
        earlier = np.flatnonzero(point < query)
        query, point = query[earlier], point[earlier]
        rows = conflicting(query, point, all_, all_)
        return query[rows], point[rows]

    parts = in_chunks(part, count)
    late, early = (np.concatenate([p[k] for p in parts]) for k in (0, 1))
    open_, stuck = np.ones(count, bool), np.zeros(count, bool)
    while open_.any():
        waits = np.zeros(count, bool)
        waits[late[open_[early]]] = True
        now = open_ & ~waits
        stuck |= now
        open_ &= waits
        open_[late[now[early]]] = False
    return np.flatnonzero(stuck)


def first_of_many(samples: SurfaceSamples, r: np.ndarray, low: np.ndarray) -> np.ndarray:
    """The same as `first_come`, for crowds: most fall to those that stick among the first few, so that the pairs of all
    never meet in memory."""
    stuck = Darts(no_samples(), np.zeros(0, np.float32), np.zeros(0, bool), np.zeros(0, np.int64), 0)
    grid = LevelGrid(low)
    while stuck.thrown < len(r):
        end = min(2 * max(stuck.thrown, FEW), len(r))
        rows = np.arange(stuck.thrown, end)
        rows = rows[~_conflicts(grid, stuck, samples.take(rows), r[rows])]
        rows = rows[first_come(samples.take(rows), r[rows], low)]
        stuck = stuck.join(samples.take(rows), r[rows], np.zeros(len(rows), bool), rows, end)
        grid.fill(stuck.samples.position, stuck.radius)
    return stuck.number
