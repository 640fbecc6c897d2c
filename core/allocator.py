"""Memory that frames free and want again at once."""

from __future__ import annotations

import numpy as np

LARGE = 31 << 20
"""Bytes, just below what glibc's allocator takes as the largest sign."""


def keep_freed() -> None:
    """Let the process keep some tens of MB that it frees, where the allocator is glibc's.

    That one gives arrays of a frame back to the system as soon as they are freed, and the system clears every page of them
    when it is asked for them again: a fifth of a frame's time, in which threads wait for each other. Once it has seen a
    large block freed it no longer does so for smaller ones (mallopt(3), M_MMAP_THRESHOLD). The block itself is never
    written to, so it costs nothing.
    """
    np.empty(LARGE, np.uint8)
