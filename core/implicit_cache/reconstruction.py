"""Values between points by distance in world space (Shepard 1968 as modified by Bikker and Reijerse 2009;
Delaere 2021, equations 3.1 and 3.2): w = max(0, r − |p − x|), value = Σ w v / Σ w."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np


def interpolate(
    candidates: Iterable[tuple[np.ndarray, np.ndarray]],
    radius: np.ndarray,
    value_of: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
) -> tuple[np.ndarray, np.ndarray]:
    """(channels, n) float32 values and (n,) sums of weights, 0 where no point within the radius is known.

    candidates: keys (n,) and offsets (3, n), m, of one candidate of all places each; radius: (n,) float32, m;
    value_of: keys → values (channels, m) and whether they are known, (m,) bool.
    """
    total, weights = None, np.zeros(len(radius), np.float32)
    for key, offset in candidates:
        weight = radius - np.sqrt(np.einsum("kn,kn->n", offset, offset))
        near = np.flatnonzero(weight > 0)
        if not len(near):
            continue
        value, known = value_of(key[near])
        weight = weight[near] * known
        if total is None:
            total = np.zeros((len(value), len(radius)), np.float32)
        weights[near] += weight
        total[:, near] += weight * value
    if total is None:
        return np.zeros((1, len(radius)), np.float32), weights
    return total / np.maximum(weights, np.float32(1e-30)), weights
