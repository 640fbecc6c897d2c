"""Form factors of distant pairs of entries by sampling the pair, not the hemisphere.

A far pair gets about one of an entry's cosine rays, which says little about it. Two places, the geometric
term between them and one ray that tells whether they see each other say nearly all: only penumbrae are
noisy. Near pairs, whose geometric term varies over the patches, are left to the hemisphere's rays.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..rays import in_threads
from ..surface import SurfaceSamples

ROWS = 64
"""Entries whose pairs with all others are handled together."""

FAR = 3.0
"""Pairs farther apart than this many times their mean size are sampled as pairs."""


def far_pairs(position: np.ndarray, size: np.ndarray, rows: slice) -> np.ndarray:
    """(m, n) bool: whether entries `rows` and each of the n are far apart for their size."""
    reach = np.float32(0.5 * FAR) * (size[rows, None] + size)
    return _distance2(position[rows], position) > reach * reach


def sample_pairs(
    samples: list[SurfaceSamples],
    area: np.ndarray,
    offset: float,
    visible: Callable[[np.ndarray, np.ndarray], np.ndarray],
    tick: Callable[[int], None] | None = None,
) -> np.ndarray:
    """(n, n) float32 symmetric: the mean geometric term with visibility, V cos cos / π r², 1/m², of all pairs.

    samples: one place on each entry, an independent set for each sample of a pair. visible(origins, vectors):
    float32 in [0, 1] over open segments. Near pairs hold no useful value.
    """
    count = len(area)
    result = np.zeros((count, count), np.float32)
    middle = samples[0].position.mean(axis=0)
    for places in samples:
        # float32 products of coordinates cancel far from the origin
        position = places.position - middle
        lifted = places.position + places.flat * np.float32(offset)
        own = np.einsum("nd,nd->n", position, places.normal)

        def block(start, position=position, lifted=lifted, own=own, places=places):
            rows = slice(start, min(start + ROWS, count))
            # each pair once: columns from the block's own on
            leaves = places.normal[rows] @ position[start:].T - own[rows, None]
            arrives = position[rows] @ places.normal[start:].T - own[start:]
            np.maximum(leaves, 0, out=leaves)
            np.maximum(arrives, 0, out=arrives)
            distance2 = np.maximum(_distance2(position[rows], position[start:]), 1e-12)
            term = leaves * arrives / (np.float32(np.pi) * distance2 * distance2)
            i, j = np.nonzero(term)
            seen = visible(lifted[start + i], lifted[start + j] - lifted[start + i])
            term[i, j] *= seen if seen.ndim == 1 else seen.mean(axis=1)
            result[rows, start:] += term
            if tick is not None:
                tick(len(i))

        in_threads(block, range(0, count, ROWS))
    result *= np.float32(1 / len(samples))
    for start in range(0, count, 512):
        rows = slice(start, min(start + 512, count))
        for left in range(start, count, 512):
            cols = slice(left, min(left + 512, count))
            if left == start:
                square = result[rows, cols]
                square[:] = np.triu(square) + np.triu(square, 1).T
            else:
                result[cols, rows] = result[rows, cols].T
    return result


def _distance2(a, b):
    """(m, n) float32 squared distances."""
    return (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * (a @ b.T)
