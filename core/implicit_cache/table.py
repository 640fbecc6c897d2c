"""The cache's hash table: open addressing with linear probing, in flat arrays.

An entry is a tag of 4 bytes, a mean of 4 bytes a channel, and 4 bytes that hold its count of samples, when it was last
seen and how far it lies from where its search begins: 12 bytes for occlusion, 20 for colour. Means are float32, so that
light of any strength is kept. A table that is full forgets what was least recently seen, and puts the rest in order.
"""

from __future__ import annotations

import numpy as np

from .keys import mix
from .probing import EMPTY, claim, find

FULL = 0.5
"""Largest share of slots in use; probing slows down soon after."""

KEPT = 0.7
"""Share of those that are kept when the table is full."""

STEP = 1 / 16
"""Unit of a stored count, in the upper 18 bits of a word."""

MOST = (2**18 - 1) * STEP
"""Largest count."""

CLOCK, TICKS = 256, 4
"""The clock of last sights goes on by one in so many ticks, modulo 256: the 8 bits below the count."""

SHIFT = 64
"""Slots between an entry and where its search begins are fewer: the low 6 bits."""

TINY = np.float32(1e-12)


class Table:
    """Means and counts by 64-bit key. channels: numbers of a mean; slots: how many, a power of two.

    moves: how often entries got other slots.
    """

    def __init__(self, channels: int, slots: int):
        if slots < 64 or slots & slots - 1:
            raise ValueError(f"The slots must be a power of two of at least 64, not {slots}.")
        self.channels, self.slots, self.used, self.now, self.moves = channels, slots, 0, 0, 0
        # one more at the end, for what finds no place: nothing is ever kept there
        self.tag = np.zeros(slots + 1, np.uint32)
        # word and means of an entry lie together, so that one fetch gets them
        self._rows = np.zeros((slots + 1, 1 + channels), np.uint32)
        self.word = self._rows[:, 0]
        self.mean = self._rows[:, 1:].view(np.float32).T
        # whole rows as one value each: numpy writes these several times as fast
        self._entries = _whole(self._rows)

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
        tag = np.maximum(scattered.astype(np.uint32), EMPTY + 1)
        return (scattered >> np.uint64(32)).astype(np.int32) & np.int32(self.slots - 1), tag

    def find(self, keys: np.ndarray) -> np.ndarray:
        """Slots, int32, `nowhere` for those that the table does not hold, of keys, uint64, of any shape. Changes nothing."""
        slot = find(self.tag[:-1], *self._homes(keys.reshape(-1)))
        slot[slot < 0] = self.nowhere
        return slot.reshape(keys.shape)

    def has_room(self, count: int) -> bool:
        """Whether so many more entries can be made and none forgotten."""
        return self.used + count <= int(FULL * self.slots)

    def insert(self, keys: np.ndarray) -> np.ndarray:
        """(n,) int32 slots for (n,) different keys that the table does not hold; `nowhere` for those that find none.

        Their counts are 0. Entries that were not seen just now may be forgotten, and others get new slots: see `moves`.
        """
        limit = int(FULL * self.slots)
        if self.used + len(keys) > limit:
            self._forget(max(self.used + len(keys) - limit, self.used - int(KEPT * limit)))
        slot = np.full(len(keys), self.nowhere, np.int32)
        room = min(len(keys), limit - self.used)
        home, tag = self._homes(keys[:room])
        found = self._claim(home, tag)
        slot[:room][found >= 0] = found[found >= 0]
        new = slot[slot != self.nowhere]
        self.mean[:, new] = 0
        self.word[new] |= np.uint32(self._stamp() << 6)
        return slot

    def _claim(self, home, tag):
        """(n,) int32 slots, −1 for none; their words hold only how far they are from home."""
        slot = claim(self.tag[:-1], home, tag)
        there = slot >= 0
        self.word[slot[there]] = (slot[there] - home[there] & self.slots - 1).astype(np.uint32)
        self.used += int(np.count_nonzero(there))
        return slot

    def _forget(self, count):
        """Free so many slots, or as many as were not seen just now, and close the gaps."""
        held = np.flatnonzero(self.tag[:-1] != EMPTY)
        age = self._ages(held)
        gone = np.flatnonzero(age > 0)
        gone = gone[np.argsort(-age[gone], kind="stable")[:count]]
        if not len(gone):
            return
        held = np.delete(held, gone)
        home, tag = self.homes(held), self.tag[held]
        mean, word = self.mean[:, held], self.word[held]
        self.tag[:] = EMPTY
        self.word[:] = 0
        self.used = 0
        self.moves += 1
        slot = self._claim(home, tag)
        slot, there = slot[slot >= 0], slot >= 0
        self.mean[:, slot] = mean[:, there]
        self.word[slot] |= word[there] & ~np.uint32(SHIFT - 1)

    def homes(self, slots: np.ndarray) -> np.ndarray:
        """(n,) int32 where searches for the entries at these slots begin."""
        away = (self.word[slots] & np.uint32(SHIFT - 1)).astype(np.int32)
        return (slots - away & self.slots - 1).astype(np.int32)

    def _stamp(self):
        return self.now // TICKS % CLOCK

    def _ages(self, slots):
        return (self._stamp() - (self.word[slots] >> np.uint32(6)).astype(np.int64)) % CLOCK

    def tick(self) -> None:
        """The clock of last sights goes on."""
        self.now += 1
        if self.now % (CLOCK // 4 * TICKS) == 0:
            # what is older than half a turn stays so, in place of looking young again
            held = np.flatnonzero(self.tag[:-1] != EMPTY)
            old = held[self._ages(held) > CLOCK // 2]
            self._write(old, self.word[old] >> np.uint32(14), (self._stamp() - CLOCK // 2) % CLOCK)

    def counts(self, slots: np.ndarray | slice) -> np.ndarray:
        """float32 counts of samples."""
        return (self.word[slots] >> np.uint32(14)).astype(np.float32) * np.float32(STEP)

    def touch(self, slots: np.ndarray) -> None:
        """These are seen now."""
        self._write(slots, self.word[slots] >> np.uint32(14), self._stamp())

    def put(self, slots: np.ndarray, mean: np.ndarray, count: np.ndarray) -> None:
        """Keep means (channels, n) and counts (n,) of samples, in [0, MOST]; what has some count keeps some."""
        self.mean[:, slots] = mean
        units = np.rint(np.minimum(count, MOST) * (1 / STEP)).astype(np.uint32)
        self._write(slots, np.maximum(units, count > 0), self._stamp())
        self.word[self.nowhere] = 0

    def merge(self, slots: np.ndarray, sums: np.ndarray, share: np.ndarray, most: float) -> None:
        """Add samples to the entries at different slots (n,): their sums (channels, n), and (n,) of their weights. No entry
        counts more than `most`."""
        rows = self._rows.take(slots, axis=0, mode="clip")
        means = rows[:, 1:].view(np.float32).T
        word = rows[:, 0].copy()
        # counts in units of STEP, which is a power of two: as exact as in samples, and once less over all
        before = (word >> np.uint32(14)).astype(np.float32)
        count = share * np.float32(1 / STEP)
        count += before
        weight = 1 / np.maximum(count, TINY)
        before *= weight
        weight *= np.float32(1 / STEP)
        for mean, own in zip(means, sums, strict=True):
            mean *= before
            mean += own * weight
        np.minimum(np.rint(count, out=count), np.float32(min(most, MOST) / STEP), out=count)
        units = count.astype(np.uint32)
        np.maximum(units, share > 0, out=units)
        units <<= np.uint32(14)
        units |= np.uint32(self._stamp() << 6)
        word &= np.uint32(SHIFT - 1)
        np.bitwise_or(units, word, out=rows[:, 0])
        self._entries[slots] = _whole(rows)
        self.word[self.nowhere] = 0

    def sums(self, slots: np.ndarray) -> np.ndarray:
        """(channels + 1, n) float32 mean times count of each channel, and counts, of (n,) entries."""
        rows = self._rows.take(slots, axis=0, mode="clip")
        result = np.empty((1 + self.channels, len(slots)), np.float32)
        result[-1] = _count_of(rows[:, 0])
        np.multiply(rows[:, 1:].view(np.float32).T, result[-1], out=result[:-1])
        return result

    def _write(self, slots, units, stamp):
        away = self.word[slots] & np.uint32(SHIFT - 1)
        self.word[slots] = units << np.uint32(14) | np.uint32(stamp << 6) | away

    def limit_counts(self, most: float) -> None:
        """No count stays above this."""
        units = np.minimum(self.word >> np.uint32(14), np.uint32(min(most, MOST) / STEP))
        self.word &= np.uint32((1 << 14) - 1)
        self.word |= units << np.uint32(14)

    def scale_counts(self, factor: float) -> None:
        """All counts times a factor in [0, 1]."""
        units = (self.word >> np.uint32(14)).astype(np.float32) * np.float32(factor)
        self.word &= np.uint32((1 << 14) - 1)
        self.word |= units.astype(np.uint32) << np.uint32(14)


def _count_of(word):
    count = (word >> np.uint32(14)).astype(np.float32)
    count *= np.float32(STEP)
    return count


def _whole(rows):
    return rows.view(np.dtype((np.void, rows.itemsize * rows.shape[1])))[:, 0]
