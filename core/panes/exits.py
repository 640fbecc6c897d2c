"""The panes at the exits: one gather, accumulated as it lands."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..surface import SurfaceSamples
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
