"""The thesis's two tables: what a frame finds is summed in a small one, which is then merged into one that persists
(Delaere 2021, sections 3.2 and 4.3). Flat arrays of fixed-point numbers; an entry takes 8 bytes and 4 a channel.

Merging is value = Vp · Cp / (Cp + Ca) + Va / (Cp + Ca) and count = s · (Ca + Cp), p the persistent entry and a the
frame's, whose value is a sum.
"""

from __future__ import annotations

import numpy as np

from .probing import EMPTY, claim, find

SUM_BITS = 11
"""Fraction bits of a frame's sums: with 32 bits, sums up to two million."""

MEAN_BITS = 31
"""Fraction bits of persistent values, which lie in [0, 1] times the scale."""


class FixedTable:
    """Linear probing by 32-bit keys, which are hashes already."""

    def __init__(self, channels: int, slots: int):
        self.key = np.zeros(slots, np.uint32)
        self.value = np.zeros((channels, slots), np.uint32)
        self.count = np.zeros(slots, np.uint32)

    @property
    def used(self) -> int:
        """Entries."""
        return int(np.count_nonzero(self.key))

    @property
    def bytes_per_entry(self) -> int:
        """Of memory."""
        return self.key.itemsize + self.count.itemsize + self.value.itemsize * len(self.value)

    def _homes(self, keys):
        tag = np.maximum(keys, EMPTY + 1)
        return (tag & np.uint32(len(self.key) - 1)).astype(np.int32), tag

    def find(self, keys: np.ndarray) -> np.ndarray:
        """(n,) int32 slots of (n,) uint32 keys, −1 where there is none."""
        return find(self.key, *self._homes(keys))

    def make(self, keys: np.ndarray) -> np.ndarray:
        """(n,) int32 slots of keys that are not there yet, equal ones the same; −1 for those that find no room."""
        return claim(self.key, *self._homes(keys))


def sum_frame(keys: np.ndarray, values: np.ndarray) -> FixedTable:
    """A frame's table, of (n,) uint32 keys and (n, channels) float32 values ≥ 0: its sums and counts."""
    slots = 1 << max(6, int(2 * len(keys)).bit_length())
    table = FixedTable(values.shape[1], slots)
    slot = table.make(keys)
    kept = slot >= 0
    fixed = np.rint(np.maximum(values[kept], 0) * np.float32(1 << SUM_BITS))
    for row, column in zip(table.value, fixed.T, strict=True):
        row[:] = np.minimum(np.bincount(slot[kept], column, minlength=slots), 2**32 - 1)
    table.count[:] = np.bincount(slot[kept], minlength=slots)
    return table


def merge(table: FixedTable, frame: FixedTable, scale: float, ageing: float) -> None:
    """Merge a frame's table into the persistent one. scale: the largest value; ageing: s."""
    rows = np.flatnonzero(frame.count)
    keys = frame.key[rows]
    slot = table.find(keys)
    new = slot < 0
    slot[new] = table.make(keys[new])
    rows, slot = rows[slot >= 0], slot[slot >= 0]
    before, now = table.count[slot].astype(np.float64), frame.count[rows].astype(np.float64)
    total = before + now
    mean = table.value[:, slot] * (before / total)
    mean += frame.value[:, rows] * (2.0 ** (MEAN_BITS - SUM_BITS) / scale / total)
    table.value[:, slot] = np.minimum(np.rint(mean), 2.0**MEAN_BITS).astype(np.uint32)
    table.count[slot] = np.maximum(np.floor(total * ageing), 1).astype(np.uint32)


def values_at(table: FixedTable, slot: np.ndarray, scale: float) -> np.ndarray:
    """(channels, n) float32 at slots."""
    return table.value[:, slot].astype(np.float32) * np.float32(scale * 2.0**-MEAN_BITS)
