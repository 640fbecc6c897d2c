"""Which point a sample goes to: one of the three nearest, at random (Delaere 2021, equations 1.1 to 1.4), or a voxel
near it (Binder, Fricke and Keller 2019)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..sampling import concentric_disk, frame


def three_nearest(candidates: Iterable[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Keys (3, n) uint32 and squared distances (3, n) float32, m², of the nearest first.

    candidates: (n,) uint32 keys and (3, n) float32 offsets, m, of one candidate of all places each.
    """
    keys, distances = None, None
    for key, offset in candidates:
        distance = np.einsum("kn,kn->n", offset, offset)
        if keys is None:
            keys, distances = np.zeros((3, len(key)), np.uint32), np.full((3, len(key)), np.inf, np.float32)
        for k in range(3):
            # the nearer one stays here, the other goes on to the next place
            nearer = distance < distances[k]
            keys[k], key = np.where(nearer, key, keys[k]), np.where(nearer, keys[k], key)
            distances[k], distance = np.minimum(distance, distances[k]), np.maximum(distance, distances[k])
    return keys, distances


def areas(distances: np.ndarray) -> np.ndarray:
    """(3, n) float32 weights λ of sum 1 from squared distances (3, n): the area opposite a point grows with the
    distances of the two others, so the nearest point weighs most."""
    a, b, c = distances
    area = np.stack([b * c, a * c, a * b])
    total = area.sum(axis=0)
    # on two points at once, of which the first is as good as the second
    area[0, total == 0] = total[total == 0] = 1
    return area / total


def pick(weights: np.ndarray, chance: np.ndarray) -> np.ndarray:
    """(n,) int64 in 0 … 2 with probabilities (3, n), by (n,) float32 in [0, 1)."""
    return (chance >= weights[0]).astype(np.int64) + (chance >= weights[0] + weights[1])


def jittered(position: np.ndarray, normal: np.ndarray, radius: np.ndarray, chance: np.ndarray) -> np.ndarray:
    """(3, n) float32 positions moved within discs of the tangent plane. position, normal: (3, n); radius: (n,) m;
    chance: (n, 2) in [0, 1)."""
    across, along = frame(normal.T)
    disk = concentric_disk(chance) * radius[:, None]
    return position + (disk[:, :1] * across + disk[:, 1:] * along).T
