"""Form factors of distant pairs of entries by sampling the pair, not the hemisphere.

A far pair gets about one of an entry's cosine rays, which says little about it. Two places, the geometric
term between them and one ray that tells whether they see each other say nearly all: only penumbrae are
noisy. Near pairs, whose geometric term varies over the patches, are left to the hemisphere's rays.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..rays import product3
from ..surface import SurfaceSamples
from ..threads import in_threads

ROWS = 64
"""Entries whose pairs with all others are handled together."""

FAR = 3.0
"""Pairs farther apart than this many times their mean size are sampled as pairs."""

VERY_FAR = 8.0
"""Beyond this many times, one sample says enough."""


def far_pairs(position: np.ndarray, size: np.ndarray, rows: slice, cols: slice, times: float = FAR) -> np.ndarray:
    """(m, n) bool: which of entries `rows` × `cols` are farther apart than `times` their mean size."""
    reach = np.float32(0.5 * times) * (size[rows, None] + size[cols])
    return _distance2(position[rows], position[cols]) > reach * reach


def sample_pairs(
    samples: list[SurfaceSamples],
    size: np.ndarray,
    offset: float,
    visible: Callable[[np.ndarray, np.ndarray], np.ndarray],
    tick: Callable[[int], None] | None = None,
) -> np.ndarray:
    """(n, n) float32 symmetric: the mean geometric term with visibility, V cos cos / π r², 1/m², of all pairs.

    samples: one place on each entry, an independent set for each sample; pairs that are VERY_FAR take the first
    only. visible(origins, vectors): float32 in [0, 1] over open segments. Near pairs hold no useful value.
    """
    count = len(size)
    result = np.zeros((count, count), np.float32)
    # float32 products of coordinates cancel far from the origin
    middle = samples[0].position.mean(axis=0)
    sets = []
    for places in samples:
        position = places.position - middle
        own = np.einsum("nd,nd->n", position, places.normal)
        sets.append((position, places.normal, own, places.position + places.flat * np.float32(offset)))

    def block(start):
        rows, cols = slice(start, min(start + ROWS, count)), slice(start, count)
        middling = None
        for number, (position, normal, own, lifted) in enumerate(sets):
            # each pair once: columns from the block's own on
            leaves = product3(normal[rows], position[cols].T) - own[rows, None]
            arrives = product3(position[rows], normal[cols].T) - own[cols]
            np.maximum(leaves, 0, out=leaves)
            np.maximum(arrives, 0, out=arrives)
            leaves *= arrives
            if number == 1:
                middling = ~far_pairs(sets[0][0], size, rows, cols, VERY_FAR)
                middling &= far_pairs(sets[0][0], size, rows, cols)
            if middling is not None:
                leaves *= middling
            pairs = np.flatnonzero(leaves)
            i, j = np.divmod(pairs.astype(np.int32), np.int32(count - start))
            i, j = i + start, j + start
            vectors = lifted[j] - lifted[i]
            apart = position[j] - position[i]
            distance2 = np.maximum(np.einsum("nd,nd->n", apart, apart), 1e-12)
            term = leaves.reshape(-1)[pairs] / (np.float32(np.pi) * distance2 * distance2)
            term *= visible(lifted[i], vectors)
            if number == 0:
                result[i, j] = term
            else:
                result[i, j] += term
            if tick is not None:
                tick(len(i))
        if middling is not None:
            result[rows, cols] *= np.where(middling, np.float32(1 / len(sets)), 1)

    in_threads(block, range(0, count, ROWS))
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
    return (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * product3(a, b.T)
