"""Which samples of a lamp each receiver sees: bit masks, kept only where a lamp is partly seen."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

LIT = -1
UMBRA = -2
AWAY = -3


def words_of(samples: int) -> int:
    """uint64 words that hold so many bits."""
    return -(-samples // 64)


def full_mask(samples: int) -> np.ndarray:
    """(words,) uint64 with a bit for every sample."""
    bits = np.zeros(64 * words_of(samples), np.uint8)
    bits[:samples] = 1
    return np.packbits(bits, bitorder="little").view(np.uint64)


@dataclass
class Statistics:
    """What a cast did. Counts are of relations, one for each receiver and sample.

    lit, umbra: culled, for whole clusters at once. geometry: decided by lines across the lamp. rays: traced.
    away: of receivers that face away from the lamp, or lie behind it. candidates: K, mean number of polygons per mixed
    receiver. by_rays: part of the clusters that were left to rays. seconds: of each stage, summed over threads.
    """

    relations: int = 0
    lit: int = 0
    umbra: int = 0
    away: int = 0
    geometry: int = 0
    rays: int = 0
    candidates: float = 0.0
    by_rays: float = 0.0
    seconds: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Masks:
    """index: (R,) int32: LIT (sees every sample), UMBRA (none), AWAY (turned away from the lamp, so nothing was asked),
    otherwise a row of `words`. words: (m, ⌈L/64⌉) uint64; bit i of the little-endian row is 1 where something blocks
    sample i, as in the paper. samples: L. statistics: of the cast.
    """

    index: np.ndarray
    words: np.ndarray
    samples: int
    statistics: Statistics = field(default_factory=Statistics)

    def __len__(self) -> int:
        return len(self.index)

    def packed(self) -> np.ndarray:
        """(R, ⌈L/64⌉) uint64 for all receivers; those turned away count as blocked."""
        result = np.zeros((len(self.index), words_of(self.samples)), np.uint64)
        mixed = self.index >= 0
        result[mixed] = self.words[self.index[mixed]]
        result[(self.index == UMBRA) | (self.index == AWAY)] = full_mask(self.samples)
        return result

    def seen(self) -> np.ndarray:
        """(R,) float32 part of the samples that each receiver sees."""
        result = (self.index == LIT).astype(np.float32)
        mixed = np.flatnonzero(self.index >= 0)
        blocked = np.bitwise_count(self.words) if hasattr(np, "bitwise_count") else _count(self.words)
        part = 1 - blocked.sum(axis=1, dtype=np.int64) / self.samples
        result[mixed] = part[self.index[mixed]]
        return result


def bits_of(words: np.ndarray, samples: int) -> np.ndarray:
    """(m, samples) uint8 of (m, ⌈samples/64⌉) uint64 masks."""
    return np.unpackbits(words.view(np.uint8).reshape(len(words), -1), axis=1, count=samples, bitorder="little")


def words_from(bits: np.ndarray) -> np.ndarray:
    """(m, ⌈L/64⌉) uint64 of (m, L) bool; unused bits are 0."""
    words = words_of(bits.shape[1])
    packed = np.zeros((len(bits), 8 * words), np.uint8)
    bytes_ = np.packbits(bits, axis=1, bitorder="little")
    packed[:, : bytes_.shape[1]] = bytes_
    return packed.view(np.uint64)


def _count(words):
    """Bits set in each word, before numpy 2."""
    table = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1).sum(axis=1)
    return table[words.view(np.uint8)].reshape(*words.shape, 8).sum(axis=-1)
