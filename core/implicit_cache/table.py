"""The cache's hash table: open addressing with linear probing, in flat arrays.

An entry is a tag of 4 bytes, a mean of 4 bytes a channel, and 4 bytes that hold both its count of samples and when it
was last seen: 12 bytes for occlusion, 20 for colour. Means are float32, so that light of any strength is kept.
Nothing ever moves. A table that is full forgets what was least recently seen.
"""

from __future__ import annotations

import numpy as np

from .keys import mix
from .probing import EMPTY, LEFT, PROBES, claim, find

FULL = 0.4
"""Largest share of slots in use; probing slows down soon after."""

KEPT = 0.7
"""Share of those that are kept when the table is full."""

CLOCK = 4096
"""The clock of last sights runs modulo this, in the low 12 bits of a word; the count has the other 20."""

STEP = 1 / 32
"""Unit of a stored count."""

MOST = (2**20 - 1) * STEP
"""Largest count."""


class Table:
    """Means and counts by 64-bit key. channels: numbers of a mean; slots: how many, a power of two."""

    def __init__(self, channels: int, slots: int):
        if slots < 64 or slots & slots - 1:
            raise ValueError(f"The slots must be a power of two of at least 64, not {slots}.")
        self.channels, self.slots, self.used, self.now = channels, slots, 0, 0
        # one more at the end, for what finds no place: nothing is ever kept there
        self.tag = np.zeros(slots + 1, np.uint32)
        self.mean = np.zeros((channels, slots + 1), np.float32)
        self.word = np.zeros(slots + 1, np.uint32)

    @property
    def nowhere(self) -> int:
        """The slot of keys that have none."""
        return self.slots

    @property
    def bytes_per_entry(self) -> int:
        """Of memory, over all arrays that stay."""
        return self.tag.itemsize + self.word.itemsize + self.mean.itemsize * self.channels

    def _homes(self, keys):
        scattered = mix(keys)
        tag = np.maximum(scattered.astype(np.uint32), LEFT + 1)
        return (scattered >> np.uint64(32)).astype(np.int32) & np.int32(self.slots - 1), tag

    def find(self, keys: np.ndarray) -> np.ndarray:
        """Slots, int32, `nowhere` for those that the table does not hold, of keys, uint64, of any shape. Changes nothing."""
        slot = find(self.tag[:-1], *self._homes(keys.reshape(-1)))
        slot[slot < 0] = self.nowhere
        return slot.reshape(keys.shape)

    def insert(self, keys: np.ndarray) -> np.ndarray:
        """(n,) int32 slots for (n,) different keys that the table does not hold; `nowhere` for those that find none.

        Their counts are 0. Entries that were not seen at this tick of the clock may be forgotten.
        """
        limit = int(FULL * self.slots)
        if self.used + len(keys) > limit:
            self._forget(max(self.used + len(keys) - limit, self.used - int(KEPT * limit)))
        slot = np.full(len(keys), self.nowhere, np.int32)
        room = min(len(keys), limit - self.used)
        found = claim(self.tag[:-1], *self._homes(keys[:room]))
        slot[:room][found >= 0] = found[found >= 0]
        new = slot[slot != self.nowhere]
        self.used += len(new)
        self.mean[:, new] = 0
        self.word[new] = self.now % CLOCK
        return slot

    def _forget(self, count):
        """Free so many slots, or as many as were not seen just now."""
        held = np.flatnonzero(self.tag[:-1] > LEFT)
        age = (self.now - self.word[held].astype(np.int64)) % CLOCK
        held, age = held[age > 0], age[age > 0]
        gone = held[np.argsort(-age, kind="stable")[:count]]
        self.tag[gone] = LEFT
        self.word[gone] = 0
        self.used -= len(gone)
        # a slot before an empty one need not keep searches going
        tag = self.tag[:-1]
        for _ in range(PROBES):
            ends = np.flatnonzero((tag == LEFT) & (np.roll(tag, -1) == EMPTY))
            if not len(ends):
                break
            tag[ends] = EMPTY

    def tick(self) -> None:
        """The clock of last sights goes on."""
        self.now += 1
        if self.now % (CLOCK // 4) == 0:
            # what is older than half a turn stays so, in place of looking young again
            age = (self.now - self.word.astype(np.int64)) % CLOCK
            old = np.flatnonzero(age > CLOCK // 2)
            self._store(old, self.counts(old), (self.now - CLOCK // 2) % CLOCK)

    def counts(self, slots: np.ndarray | slice) -> np.ndarray:
        """float32 counts of samples."""
        return (self.word[slots] >> np.uint32(12)).astype(np.float32) * np.float32(STEP)

    def touch(self, slots: np.ndarray) -> None:
        """These are seen now."""
        self.word[slots] = self.word[slots] & ~np.uint32(CLOCK - 1) | np.uint32(self.now % CLOCK)

    def put(self, slots: np.ndarray, mean: np.ndarray, count: np.ndarray) -> None:
        """Keep means (channels, n) and counts (n,) of samples, in [0, MOST]; what has some count keeps some."""
        self.mean[:, slots] = mean
        self._store(slots, count, self.now % CLOCK)
        self.word[self.nowhere] = 0

    def _store(self, slots, count, stamp):
        units = np.rint(np.minimum(count, MOST) * (1 / STEP)).astype(np.uint32)
        np.maximum(units, count > 0, out=units)
        self.word[slots] = units << np.uint32(12) | np.uint32(stamp)

    def limit_counts(self, most: float) -> None:
        """No count stays above this."""
        units = np.uint32(min(most, MOST) / STEP)
        stamp = self.word & np.uint32(CLOCK - 1)
        np.minimum(self.word >> np.uint32(12), units, out=self.word)
        self.word <<= np.uint32(12)
        self.word |= stamp

    def scale_counts(self, factor: float) -> None:
        """All counts times a factor in [0, 1]."""
        held = np.flatnonzero(self.word >> np.uint32(12))
        stamp = self.word[held] & np.uint32(CLOCK - 1)
        units = (self.word[held] >> np.uint32(12)).astype(np.float32) * np.float32(factor)
        self.word[held] = units.astype(np.uint32) << np.uint32(12) | stamp
