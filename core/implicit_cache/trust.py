"""How many samples a coarse mean is worth beside a fine one: many on open walls, few where light has detail.

Of two estimates of a value, one noisy and one smoothed, the best mixture weighs each by one over its squared error. The
noisy one's is σ² / c with c samples, the smoothed one's the square b² of what smoothing takes away; so the smoothed mean
is worth σ² / b² samples. Both are measured around each coarse entry: σ² from how a frame's samples differ from what fine
entries knew, b² from how far fine means lie from the coarse one beyond what their noise explains. This is the thesis's
local complexity (section 6.2), in world space and with its noise known.
"""

from __future__ import annotations

import numpy as np

SPREAD = 0.3
"""Variance of an entry's mean that counts one sample, over that of a sample: it has parts of several samples."""

GAIN = 8.0
"""Samples that a read by trilinear weights averages over the count that it shows: it spans several corners."""

MEMORY = 0.95
"""What the noise's sums keep at each frame."""

LEAST, MOST = 4.0, 500.0
"""Bounds of trust."""

LITTLE = 0.05
"""Fewer fine samples tell nothing."""

TINY = 1e-12


def scatter(sums: np.ndarray, share: np.ndarray, known: np.ndarray, nearest: np.ndarray, entries: int) -> np.ndarray:
    """(2, entries) sums, by coarse entry, that tell how a frame's samples differ from what was known: of squared
    differences, a mean over channels, and of what these would be for samples of variance 1.

    sums: (channels, m) of the frame's samples at fine entries, and share: (m,) of their weights. known: rows of
    S = mean × count for each channel, and of counts, before, (channels + 1, m). nearest: (m,) their coarse entry.
    """
    count = np.maximum(known[-1], 1)
    told = known[-1] > 1
    ratio = share / count
    squared = np.zeros(len(share), np.float32)
    for own, before in zip(sums, known[:-1], strict=True):
        squared += (own - ratio * before) ** 2
    squared *= told / np.float32(len(sums))
    wanted = SPREAD * (share + share * ratio) * told
    return np.stack([np.bincount(nearest, part, minlength=entries) for part in (squared, wanted)])


def departure(
    sums: np.ndarray, share: np.ndarray, above: np.ndarray, noise: np.ndarray, nearest: np.ndarray
) -> np.ndarray:
    """(4, entries) sums, by coarse entry, of the squared difference between fine and coarse means, of the part that the
    fine one's noise explains, of weights, and of their squares.

    sums, above: rows of S = mean × count for each channel, and of counts, of fine entries, and of the coarse mixture
    there, (channels + 1, m); share: (m,) weights. noise: (entries,) variance of a sample; nearest: (m,) coarse entries.
    """
    count, there = sums[-1], above[-1]
    weight = share * ((count > LITTLE) & (there > 0))
    count, there = np.maximum(count, np.float32(LITTLE)), np.maximum(there, np.float32(TINY))
    squared = np.zeros(len(share), np.float32)
    for own, coarse in zip(sums[:-1], above[:-1], strict=True):
        squared += (own / count - coarse / there) ** 2
    squared /= np.float32(len(sums) - 1)
    explained = noise.take(nearest, mode="clip") * SPREAD / count
    parts = (squared * weight, explained * weight, weight, weight * weight)
    return np.stack([np.bincount(nearest, part, minlength=len(noise)) for part in parts])


def worth(noise: np.ndarray, departures: np.ndarray, usual: float) -> np.ndarray:
    """(entries,) trust in coarse entries: σ² / b², and `usual` where noise hides b² or nothing is known."""
    squared, explained, weight, square = departures
    squared, explained = squared / np.maximum(weight, TINY), explained / np.maximum(weight, TINY)
    prior = noise / (GAIN * usual)
    # the noise's own spread, of so many squares, is compared with what would change the usual trust
    several = weight**2 / np.maximum(square, TINY)
    clear = 1 / (1 + 2 / np.maximum(several, 1) * (explained / np.maximum(prior, TINY)) ** 2) * (weight > 0)
    bias = clear * np.maximum(squared - explained, 0) + (1 - clear) * prior
    trust = noise / np.maximum(GAIN * bias, TINY)
    return np.where(noise > 0, np.clip(trust, LEAST, MOST), usual)
