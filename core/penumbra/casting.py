"""Shadow rays for the relations between receivers and a lamp's samples: the oracle, and what geometry leaves open."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..rays import chunks
from ..threads import in_threads
from .lamp import LampSamples
from .masks import AWAY, LIT, UMBRA, Masks, Statistics, full_mask, words_from
from .receivers import Receivers, facing

Occluded = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(origins (n, 3), vectors (n, 3)) float32 → (n,) bool, whether anything solid stands between."""

RAYS = 1 << 14
"""Rays of a call: origins, vectors and Embree's own arrays stay in the second-level cache."""


def cast_rays(receivers: Receivers, lamp: LampSamples, occluded: Occluded, threads: int | None = None) -> Masks:
    """Every relation by its own ray, those of receivers that face away excepted: brute force."""
    rows = np.flatnonzero(facing(receivers, lamp))
    targets = lamp.targets()
    step = max(1, RAYS // lamp.count)
    parts = in_threads(
        lambda part: trace_all(receivers, rows[part], lamp, targets, occluded), chunks(len(rows), step), threads
    )
    words = np.concatenate([np.zeros((0, len(full_mask(lamp.count))), np.uint64), *parts])
    index = np.full(len(receivers), AWAY, np.int32)
    statistics = Statistics(relations=len(receivers) * lamp.count, rays=len(rows) * lamp.count, by_rays=1.0)
    statistics.away = statistics.relations - statistics.rays
    index[rows], words = settle(words, lamp.count)
    return Masks(index, words, lamp.count, statistics)


def trace_all(receivers: Receivers, rows, lamp: LampSamples, targets, occluded: Occluded) -> np.ndarray:
    """(n, words) uint64 masks of the receivers at `rows`, by a ray for each sample."""
    origins = np.repeat(receivers.position[rows], lamp.count, axis=0)
    aims = targets[receivers.sets(rows)].reshape(-1, 3)
    return words_from(occluded(origins, lamp.vectors(origins, aims)).reshape(len(rows), lamp.count))


def trace_open(receivers: Receivers, rows, lamp: LampSamples, targets, occluded: Occluded, open_words, words) -> int:
    """Trace the relations whose bits are set in open_words (n, words) and set those that are blocked in `words`,
    in place; both must be contiguous. Returns how many rays that took."""
    if not words.flags.c_contiguous:
        raise ValueError("The masks must be contiguous, or a copy of them would be changed.")
    cells = np.flatnonzero(open_words != 0)
    if not len(cells):
        return 0
    bits = np.unpackbits(open_words.ravel()[cells].view(np.uint8), bitorder="little")
    places = np.flatnonzero(bits.view(bool))
    cell = cells[places >> 6]
    row, sample = cell // words.shape[1], (cell % words.shape[1]) * 64 + (places & 63)
    own = rows[row]
    origins = receivers.position.take(own, axis=0)
    if receivers.group is not None:
        sample += receivers.sets(own) * lamp.count
    aims = targets.reshape(-1, 3).take(sample, axis=0)
    bits[places] = occluded(origins, lamp.vectors(origins, aims))
    words.reshape(-1)[cells] |= np.packbits(bits, bitorder="little").view(np.uint64)
    return len(places)


def settle(words: np.ndarray, samples: int, first: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """(n,) int32 index (LIT, UMBRA or a row, counted from `first`) of masks (n, words), and those that are mixed."""
    lit = ~words.any(axis=1)
    dark = (words == full_mask(samples)).all(axis=1)
    mixed = ~(lit | dark)
    index = np.where(lit, LIT, UMBRA).astype(np.int32)
    index[mixed] = np.arange(first, first + np.count_nonzero(mixed), dtype=np.int32)
    return index, words[mixed]
