"""The panes at the exits: one gather, accumulated as it lands."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..surface import SurfaceSamples, Texels
from ..transfer import Gatherer


def gather_panes(
    gatherer: Gatherer,
    exits: SurfaceSamples,
    starts: np.ndarray,
    tables: np.ndarray,
    rays: int,
    seed: int,
    tick: Callable[[int], None] | None = None,
) -> np.ndarray:
    """Mean of table rows over the ids that each exit's rays land on: P = W Φ.

    exits: sorted by region; starts: (regions + 1,) int, where each region's exits begin. tables:
    (regions, ids, c) float32, a row per id of the gatherer. Returns (exits, c) float32.
    """
    columns = tables.shape[2]
    result = np.zeros((len(exits), columns), np.float32)

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

    gatherer.gather(exits, rays, seed, consume, tick)
    result *= np.float32(1 / rays)
    return result


def smooth_panes(rows: np.ndarray, exits: Texels, starts: np.ndarray) -> np.ndarray:
    """(t, c) float32: each row averaged with its eight neighbours in the atlas, binomially.

    Only neighbours of the same region, facing alike and close by, so that neither edges nor charts nor regions
    mix. It takes the gather's grain away (a seventh of the variance stays) for a texel's blur.
    """
    size = exits.resolution
    place = np.full((size + 2) * (size + 2), -1, np.int32)
    at = (exits.index // size + 1) * (size + 2) + exits.index % size + 1
    place[at] = np.arange(len(exits))
    region = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    position, normal = exits.samples.position, exits.samples.normal
    total, weight = 4 * rows, np.full((len(rows), 1), 4, np.float32)
    # texels of one chart are about evenly spaced: a neighbour much farther than most is on another chart
    nearby = _spacing(place, at, size, position)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            if dx == dy == 0:
                continue
            near = place[at + dy * (size + 2) + dx]
            apart = position[near] - position
            same = (near >= 0) & (region[near] == region) & (np.einsum("nd,nd->n", normal[near], normal) > 0.9)
            same &= np.einsum("nd,nd->n", apart, apart) < (2 * nearby) ** 2
            share = (same * np.float32((2 - abs(dx)) * (2 - abs(dy))))[:, None]
            total += share * rows[near]
            weight += share
    return total / weight


def _spacing(place, at, size, position):
    """(t,) float32 m from each texel to the nearest of its four straight neighbours."""
    least = np.full(len(at), np.inf, np.float32)
    for step in (-1, 1, -size - 2, size + 2):
        near = place[at + step]
        apart = np.linalg.norm(position[near] - position, axis=1)
        least = np.minimum(least, np.where((near >= 0) & (apart > 0), apart, np.inf))
    return least
