"""Which families of paths (see tracing) matter for an object under a lamp."""

from __future__ import annotations

import numpy as np

from ..sampling import r2_points
from .emission import Emitter
from .surfaces import Surfaces
from .tracing import SPLITS, trace

PILOT = 256
"""Photons that tell what a family carries."""

MOST_FAMILIES = 8
UNTRACED = 0.01
"""Part of the light that meets an object which families may carry that are not followed."""


def families(surfaces: Surfaces, emitter: Emitter, caster: int, seed: int = 0) -> np.ndarray:
    """(k,) int64 families to follow, those that carry most; 0 always among them. Empty where the object is not met."""
    s, t = r2_points(PILOT, seed).T.astype(np.float64)
    origins, directions, power = emitter.rays(s, t)
    first = np.full(PILOT, caster, np.int32)
    waiting = {0: np.inf}
    chosen: list[int] = []
    total = 0.0
    while waiting and len(chosen) < MOST_FAMILIES and (not chosen or sum(waiting.values()) > UNTRACED * total):
        family = max(waiting, key=waiting.get)
        if waiting.pop(family) <= 0:
            break
        chosen.append(family)
        found = trace(surfaces, origins, directions, first, np.full(PILOT, family, np.int64))
        if family == 0:
            total = float(power[found.path != 0].sum())
            if total == 0:
                return np.zeros(1, np.int64)
        left = found.left @ power
        for split in range(family.bit_length(), SPLITS):
            waiting[family | 1 << split] = float(left[split])
    return np.array(sorted(chosen), np.int64)


def followed(chosen: np.ndarray) -> np.ndarray:
    """(k, SPLITS) float32: 1 where what a family leaves to others at a split is followed by none of them."""
    known = set(chosen.tolist())
    return np.array([[float(m | 1 << i not in known) for i in range(SPLITS)] for m in chosen.tolist()], np.float32)
