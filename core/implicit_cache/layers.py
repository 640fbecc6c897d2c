"""Sums over samples by entry, and mixtures of entries by sample: all that a frame costs once its places are known.

Each piece of the samples numbers the entries that it uses anew, so that its sums and reads stay in the second-level cache.
"""

from __future__ import annotations

from copy import copy
from typing import NamedTuple

import numpy as np


class Packed:
    """Rows of (entries,) values, in pairs as complex numbers: two are fetched in the time of one."""

    def __init__(self, rows: np.ndarray):
        self.count = len(rows)
        self.pairs = []
        for k in range(0, self.count - 1, 2):
            pair = np.empty(rows.shape[1], np.complex64)
            pair.real, pair.imag = rows[k], rows[k + 1]
            self.pairs.append(pair)
        if self.count % 2:
            self.pairs.append(rows[-1].astype(np.float32))

    def take(self, entry: np.ndarray) -> Packed:
        """Of these entries."""
        taken = copy(self)
        taken.pairs = [pair.take(entry) for pair in self.pairs]
        return taken


class Layer(NamedTuple):
    """A piece of the samples on one lattice.

    entry: (k,) int64, the entries that it uses. weight: (8, n) float32 of the samples' corners; number: (8, n) int64, which
    of the k these are.
    """

    entry: np.ndarray
    weight: np.ndarray
    number: np.ndarray

    def sums(self, value: np.ndarray | None = None) -> np.ndarray:
        """(k,) float64 sums of weight times value, (n,) float32 or None for 1."""
        terms = self.weight if value is None else self.weight * value
        return np.bincount(self.number.reshape(-1), terms.reshape(-1), minlength=len(self.entry))

    def mixtures(self, rows: Packed) -> np.ndarray:
        """(rows, n) float32 sums of weight times value, of rows of values of the layer's entries."""
        result = np.empty((rows.count, self.weight.shape[1]), np.float32)
        for k, pair in enumerate(rows.pairs):
            terms = pair.take(self.number)
            terms *= self.weight
            total = terms.sum(axis=0)
            result[2 * k] = total.real
            if 2 * k + 1 < rows.count:
                result[2 * k + 1] = total.imag
        return result

    def thinned(self, every: int) -> Layer:
        """Of one in so many samples."""
        weight, number = (np.ascontiguousarray(part[:, ::every]) for part in (self.weight, self.number))
        return Layer(self.entry, weight, number)


def number_entries(entry: np.ndarray, entries: int) -> tuple[np.ndarray, np.ndarray]:
    """Different entries (k,) int64 in order, and which of them each of `entry`, of any shape and below `entries`, is."""
    used = np.zeros(entries, bool)
    used[entry] = True
    own = np.flatnonzero(used)
    number = np.empty(entries, np.int32)
    number[own] = np.arange(len(own), dtype=np.int32)
    return own, number.take(entry)
