"""Sums over samples by entry, and mixtures of entries by sample: all that a frame costs once its places are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Shares:
    """n samples shared out among m entries, eight each. weight: (8, n) float32; number: (8, n) int64, which of the m.
    corner: (n,) int64, which of the eight weighs most."""

    weight: np.ndarray
    number: np.ndarray
    corner: np.ndarray
    entries: int

    def sums(self, value: np.ndarray | None = None) -> np.ndarray:
        """(m,) float64 sums of weight times value, (n,) or None for 1."""
        terms = self.weight if value is None else self.weight * value
        return np.bincount(self.number.reshape(-1), terms.reshape(-1), minlength=self.entries)

    def mixtures(self, rows: np.ndarray) -> np.ndarray:
        """(rows, n) float32 sums of weight times value, of (rows, m) float32 values of the entries."""
        result = np.empty((len(rows), self.weight.shape[1]), np.float32)
        terms = np.empty_like(self.weight)
        for row, total in zip(rows, result, strict=True):
            # no number is out of range, and numpy asks less when told to clip
            np.take(row, self.number, out=terms, mode="clip")
            np.einsum("kn,kn->n", terms, self.weight, out=total)
        return result

    def nearest(self) -> np.ndarray:
        """(n,) int64, of each sample's entries the one with the largest weight."""
        count = len(self.corner)
        return self.number.reshape(-1).take(self.corner * count + np.arange(count))
