"""How much memory a bake may take: work over many rows is cut into chunks by it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

GIB = 1 << 30
DEFAULT, LEAST_MEMORY = 4.0, 0.25  # GiB

CHUNK = 1 / 64
"""Part of what a bake may take that passing arrays of one step may, on all threads together."""

THREADS, IN_THREAD = 1 / 4, 64e6
"""Part of it that all threads together may take while they work, and bytes that one takes."""

_allowed = DEFAULT * GIB


@contextmanager
def allowing(gib: float) -> Iterator[None]:
    """Within it work that begins is cut into chunks for a bake of so many GiB; results don't depend on it."""
    global _allowed
    before, _allowed = _allowed, gib * GIB
    try:
        yield
    finally:
        _allowed = before


def most_threads() -> int:
    """Threads whose passing arrays fit."""
    return max(int(THREADS * _allowed / IN_THREAD), 1)


def slices(count: int, each: float, threads: int = 1) -> list[slice]:
    """Consecutive rows of `count`, of which each takes `each` bytes while it is worked on, as many together as memory
    allows; threads: that work at once."""
    size = max(int(CHUNK * _allowed / (each * threads)), 1024)
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]
