"""The panes at the exits: one gather, accumulated as it lands."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..memory import slices
from ..surface import SurfaceSamples, Texels
from ..threads import in_threads, thread_count
from ..transfer import Begun, Gatherer
from .regions import region_of


def gather_panes(
    gatherer: Gatherer,
    exits: SurfaceSamples,
    starts: np.ndarray,
    tables: np.ndarray,
    rays: int,
    seed: int,
    tick: Callable[[int], None] | None = None,
    begun: Begun | None = None,
) -> np.ndarray:
    """Mean of table rows over the ids that each exit's rays land on: P = W Φ.

    exits: sorted by region; starts: (regions + 1,) int, where each region's exits begin. tables:
    (regions, ids, c) float32, a row per id of the gatherer. begun: of the same gather, ended before its time, from
    which it goes on. Returns (exits, c) float32.
    """
    columns = tables.shape[2]
    begun = Begun() if begun is None else begun
    result = begun.rows_of((len(exits), columns))

    def consume(piece: slice, ids: np.ndarray):
        first = int(np.searchsorted(starts, piece.start, side="right")) - 1
        at = piece.start
        while at < piece.stop:
            end = min(int(starts[first + 1]), piece.stop)
            if end > at:
                part = ids[:, at - piece.start : end - piece.start]
                found = np.take(tables[first], part.reshape(-1), axis=0, mode="clip")
                result[at:end] += found.reshape(len(part), end - at, columns).sum(axis=0)
            at = end
            first += 1

    gatherer.gather(exits, rays, seed, consume, tick, done=begun.done)
    return result * np.float32(1 / rays)


STEPS = tuple((dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dy or dx)
"""A texel's eight neighbours, in the order in which `joined` and whoever reads it count them."""


def joined(exits: Texels) -> np.ndarray:
    """(t, 8) bool: which of its neighbours (STEPS) in the atlas lie next to a texel on the same smooth surface.

    They face alike and are close by; what lies across an edge or on another chart is not.
    """
    size, place, at = _grid(exits)
    position, normal = exits.samples.position, exits.samples.normal
    # texels of one chart are about evenly spaced: a neighbour much farther than most is on another chart
    nearby = _spacing(place, at, size, position)
    result = np.zeros((len(exits), len(STEPS)), bool)
    for s in slices(len(exits), 80):
        for k, (dy, dx) in enumerate(STEPS):
            near = place[at[s] + dy * (size + 2) + dx]
            apart = position[near] - position[s]
            alike = np.einsum("nd,nd->n", normal[near], normal[s]) > 0.9
            result[s, k] = (near >= 0) & alike & (np.einsum("nd,nd->n", apart, apart) < (2 * nearby[s]) ** 2)
    return result


def smooth_panes(rows: np.ndarray, exits: Texels, starts: np.ndarray, beside: np.ndarray) -> np.ndarray:
    """(t, c) float32: rows without the gather's grain, each averaged with its neighbours in the atlas. `rows` are overwritten.

    beside: as from `joined`; of those only neighbours of the same region count, whose panes mean the same. A binomial mean
    B alone dims peaks and fills hollows by half the field's curvature. What it took away, B again of (1 − B) of the rows, is
    given back (twicing: Tukey 1977, Exploratory Data Analysis): fields up to the third degree stay, and a quarter of the
    variance of noise. So where all neighbours within two texels count; beside borders slopes lose a tenth of a texel's step, and
    either side of a sharp edge overshoots by a sixteenth of it.
    """
    size, place, at = _grid(exits)
    region = region_of(starts)

    def mean(values, s):
        total, weight = 4 * values[s], np.full((s.stop - s.start, 1), 4, np.float32)
        for k, (dy, dx) in enumerate(STEPS):
            near = place[at[s] + dy * (size + 2) + dx]
            same = beside[s, k] & (region[near] == region[s])
            share = (same * np.float32((2 - abs(dx)) * (2 - abs(dy))))[:, None]
            total += share * values[near]
            weight += share
        total /= weight
        return total

    pieces = slices(len(rows), 16 * rows.shape[1], thread_count())
    result = np.empty_like(rows)

    def first(s):
        result[s] = mean(rows, s)

    def second(s):
        result[s] += mean(rows, s)

    in_threads(first, pieces)
    rows -= result
    in_threads(second, pieces)
    return result


def _grid(exits):
    """The atlas' side, the row at each place of the atlas with a margin (−1 for none), and each row's place in it."""
    size = exits.resolution
    place = np.full((size + 2) * (size + 2), -1, np.int32)
    at = (exits.index // size + 1) * (size + 2) + exits.index % size + 1
    place[at] = np.arange(len(exits))
    return size, place, at


def _spacing(place, at, size, position):
    """(t,) float32 m from each texel to the nearest of its four straight neighbours."""
    least = np.full(len(at), np.inf, np.float32)
    for s in slices(len(at), 60):
        for step in (-1, 1, -size - 2, size + 2):
            near = place[at[s] + step]
            apart = np.linalg.norm(position[near] - position[s], axis=1)
            least[s] = np.minimum(least[s], np.where((near >= 0) & (apart > 0), apart, np.inf))
    return least
