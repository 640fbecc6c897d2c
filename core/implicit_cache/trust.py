"""How many samples a coarse mean is worth beside a fine one: many on open walls, few where light has detail.

Of two estimates of a value, one noisy and one smoothed, the best mixture weighs each by one over its squared error. The
noisy one's is σ² / c with c samples, the smoothed one's the square b² of what smoothing takes away; so the smoothed mean
is worth σ² / b² samples. Both are measured in each coarse cell from some of the pixels: σ² from how frames scatter about
the coarse mean, b² from how far fine means lie from it beyond what their noise explains. This is the thesis's local
complexity (section 6.2), in world space and with its noise known.
"""

from __future__ import annotations

import numpy as np

from .layers import Layer, Packed

EVERY = 4
"""One in so many samples tells of its surroundings."""

GAIN = 8.0
"""Samples that a read by trilinear weights averages over the count that it shows: it spans several corners."""

MEMORY = 0.95
"""What the noise's sums keep at each frame."""

LEAST, MOST = 4.0, 500.0
"""Bounds of trust."""

LITTLE = np.float32(0.05)
"""Fewer fine samples tell nothing."""

TINY = np.float32(1e-12)


def scatter(coarse: Layer, sums: Packed, values: np.ndarray) -> np.ndarray:
    """(2, k) sums, by coarse entry, over samples of their squared difference from the coarse mean, a mean over channels,
    and of 1.

    coarse: of some samples. sums: rows of S = mean × count for each channel, and of counts, of its entries. values:
    (channels, n) float32 of the samples.
    """
    *total, count = coarse.mixtures(sums)
    squared = sum((s / np.maximum(count, TINY) - v) ** 2 for s, v in zip(total, values, strict=True)) / len(values)
    known = (count > 0).astype(np.float32)
    return np.stack([coarse.sums(squared * known), coarse.sums(known)])


def departure(fine: Layer, coarse: Layer, sums: Packed, noise: np.ndarray) -> np.ndarray:
    """(3, k) sums, by coarse entry, over samples of the squared difference between fine and coarse means, of the part
    that the fine one's noise explains, and of 1. sums: as in `scatter`, of all entries; noise: (entries,) float32
    variance σ² of a sample, at coarse entries."""
    *near, count = fine.mixtures(sums.take(fine.entry))
    *far, there = coarse.mixtures(sums.take(coarse.entry))
    known = ((count > LITTLE) & (there > 0)).astype(np.float32)
    count, there = np.maximum(count, LITTLE), np.maximum(there, TINY)
    squared = sum((a / count - b / there) ** 2 for a, b in zip(near, far, strict=True)) / len(near)
    (variance,) = coarse.mixtures(Packed(noise[None]).take(coarse.entry))
    explained = variance / (count * np.float32(GAIN))
    return np.stack([coarse.sums(term * known) for term in (squared, explained, np.float32(1))])


def worth(noise: np.ndarray, departures: np.ndarray, usual: float) -> np.ndarray:
    """(entries,) float32 trust in coarse entries: σ² / b², and `usual` where noise hides b² or nothing is known."""
    squared, explained, samples = (d / np.maximum(departures[2], TINY) for d in departures)
    prior = noise / np.float32(GAIN * usual)
    # the noise's own spread is about its size, and is compared with what would change the usual trust
    clear = 1 / (1 + (explained / np.maximum(prior, TINY)) ** 2) * (samples > 0)
    bias = clear * np.maximum(squared - explained, 0) + (1 - clear) * prior
    trust = noise / np.maximum(np.float32(GAIN) * bias, TINY)
    return np.where(noise > 0, np.clip(trust, LEAST, MOST), usual).astype(np.float32)
