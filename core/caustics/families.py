"""Which families of paths (see tracing) matter for an object under a lamp."""

from __future__ import annotations

import numpy as np

from ..sampling import r2_points
from .emission import Emitter
from .surfaces import Surfaces
from .tracing import SPLITS, trace

PILOT = 128
"""Photons that tell what a family carries."""

PILOT_BOUNCES = 8

MOST_FAMILIES = 8
UNTRACED = 0.01
"""Part of the light that meets an object which families may carry that are not followed."""


def families(surfaces: Surfaces, emitter: Emitter, caster: int, seed: int = 0) -> np.ndarray:
    """(k,) int64 families to follow, those that carry most; 0 always among them."""
    s, t = r2_points(PILOT, seed).T.astype(np.float64)
    origins, directions, power = emitter.rays(s, t)
    first = np.full(PILOT, caster, np.int32)
    chosen: list[int] = []
    waiting, total = {0: np.inf}, 0.0
    # a round follows all that matter of what the rounds before left, so that few photons are traced together
    while waiting and len(chosen) < MOST_FAMILIES and (not chosen or sum(waiting.values()) > UNTRACED * total):
        order = sorted(waiting, key=waiting.get, reverse=True)[: MOST_FAMILIES - len(chosen)]
        least = UNTRACED / 4 * total
        tried = [f for f in order if waiting[f] > least] or order[:1]
        found = trace(
            surfaces, np.tile(origins, len(tried)), np.tile(directions, len(tried)), np.tile(first, len(tried)),
            np.repeat(np.array(tried, np.int64), PILOT), bounces=PILOT_BOUNCES,
        )  # fmt: skip
        left = (found.left.reshape(SPLITS, len(tried), PILOT) * power).sum(axis=2)
        for k, family in enumerate(tried):
            chosen.append(family)
            del waiting[family]
            for split in range(family.bit_length(), SPLITS):
                if left[split, k] > 0:
                    waiting[family | 1 << split] = float(left[split, k])
        if chosen == [0]:
            total = float(power[found.path != 0].sum())
            if total == 0:
                break
    return np.array(sorted(chosen), np.int64)


def followed(chosen: np.ndarray) -> np.ndarray:
    """(k, SPLITS) float32: 1 where what a family leaves to others at a split is followed by none of them."""
    known = set(chosen.tolist())
    return np.array([[float(m | 1 << i not in known) for i in range(SPLITS)] for m in chosen.tolist()], np.float32)
