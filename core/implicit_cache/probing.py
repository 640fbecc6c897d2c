"""Linear probing over flat arrays of tags, many keys at a time (Knuth, The Art of Computer Programming 3, 6.4 L)."""

from __future__ import annotations

import numpy as np

PROBES = 64
"""Slots that are tried for a key. A search ends at the first empty one, so few take more than two."""

EMPTY = 0
"""Tag of a slot that holds nothing."""


def find(tags: np.ndarray, home: np.ndarray, tag: np.ndarray) -> np.ndarray:
    """(n,) int32 slots that hold these tags, −1 where none does. tags: (slots,) uint32, a power of two; home: (n,) int32
    where a search begins; tag: (n,) uint32, not EMPTY."""
    there = tags.take(home, mode="clip")
    slot = np.where(there == tag, home, np.int32(-1))
    open_ = np.flatnonzero((there != tag) & (there != EMPTY))
    home, tag = home[open_], tag[open_]
    for _ in range(PROBES - 1):
        if not len(open_):
            break
        home = home + 1 & len(tags) - 1
        there = tags.take(home, mode="clip")
        found = there == tag
        slot[open_[found]] = home[found]
        more = ~found & (there != EMPTY)
        open_, home, tag = open_[more], home[more], tag[more]
    return slot


def claim(tags: np.ndarray, home: np.ndarray, tag: np.ndarray) -> np.ndarray:
    """(n,) int32 slots for different tags that the table does not hold, which are written there; −1 where none is free."""
    slot = np.full(len(home), -1, np.int32)
    open_ = np.arange(len(home))
    for _ in range(PROBES):
        if not len(open_):
            break
        free = tags[home] == EMPTY
        # where several want a slot the last one gets it, and the others look on
        tags[home[free]] = tag[free]
        settled = free & (tags[home] == tag)
        slot[open_[settled]] = home[settled]
        open_, home, tag = open_[~settled], home[~settled] + 1 & len(tags) - 1, tag[~settled]
    return slot
