"""Which lamps are hidden from which parts of a scene, as shadow rays have found: a lamp in the next room need not be asked for
each sample.

Where many rays to a lamp have gone and none passed, one in a few goes on being sent, and counts for all of them. So nothing is
lost in the mean, and light that was missed, as through a gap, is found after all, and from then on asked for as elsewhere.
"""

from __future__ import annotations

import threading

import numpy as np

CELLS = 16
"""Along the longest side of the grid."""

WANTED = 128
"""Rays to a lamp from a cell, none of which passed, after which it counts as dark."""

RARELY = 8
"""One ray in so many is sent from there."""

LEARNT = 3
"""One in so many rays is counted, about; to count all would cost more than it tells."""

_F = np.float32


class Darkness:
    """For some lamps, over a grid between the corners (2, 3) of a scene, m. What rays find counts from `settle` on, so that it
    does not matter in which order they are traced."""

    def __init__(self, lamps: int, bounds: np.ndarray):
        self._low = bounds[0].astype(np.float32)
        extent = np.maximum(bounds[1] - bounds[0], 1e-6)
        self._over = _F(CELLS / extent.max())
        self._size = np.maximum(np.ceil(extent * CELLS / extent.max()), 1).astype(np.int32)
        cells = int(self._size.prod())
        self._sent, self._passed = np.zeros((2, lamps, cells), np.int64)
        self._dark = np.zeros((lamps, cells), bool)
        self._any = [False] * lamps
        self._lock = threading.Lock()

    def cells(self, place) -> np.ndarray:
        """(n,) int32 cells of places, three (n,)."""
        number = 0
        for k in range(3):
            step = place[k] - self._low[k]
            step *= self._over
            np.clip(step, 0, _F(self._size[k] - 1), out=step)
            number = number * self._size[k] + step.astype(np.int32)
        return number

    def choose(self, lamp: int, cell: np.ndarray, u: np.ndarray):
        """Which points, in cells (n,), ask a lamp: their rows (k,), (2, k) numbers in [0, 1) of those that were u (2, n), and
        (k,) the probability with which they were chosen. None where all do."""
        if not self._any[lamp]:
            return None
        dark = self._dark[lamp].take(cell, mode="clip")
        rows = np.flatnonzero(~dark | (u[0] < _F(1 / RARELY)))
        if len(rows) == len(cell):
            return None
        dark, u = dark.take(rows), u.take(rows, axis=1, mode="clip")
        # what is left of the number that chose is even again
        u[0][dark] *= RARELY
        return rows, u, np.where(dark, _F(1 / RARELY), _F(1))

    def learn(self, lamp: int, cell: np.ndarray, passed: np.ndarray, u: np.ndarray) -> None:
        """Rays to a lamp from cells (n,), whether any light passed, (n,) bool, and a number of each in [0, 1), (n,) float32,
        whose last digits say whether it counts: that does not depend on what else is traced together."""
        counts = np.flatnonzero(u.view(np.uint32) % LEARNT == 0)
        cell, passed = cell.take(counts), passed.take(counts)
        count = len(self._sent[lamp])
        sent, through = np.bincount(cell, minlength=count), np.bincount(cell[passed], minlength=count)
        with self._lock:
            self._sent[lamp] += sent
            self._passed[lamp] += through

    def settle(self) -> None:
        """From now on what was learnt counts."""
        self._dark = (self._sent >= WANTED) & (self._passed == 0)
        self._any = self._dark.any(axis=1).tolist()
