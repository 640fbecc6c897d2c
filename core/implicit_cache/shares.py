"""Sums over samples by entry, and mixtures of entries by sample: all that a frame costs once its places are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Shares:
    """n samples, each shared out among the eight corners of its cell, all of which together are m entries.

    weight: (8, n) float32 of the corners. cell: (n,) int64 each sample's. corners: (8, cells) int64, which of the m.
    nearest: (n,) int64, which of the eight weighs most.
    """

    weight: np.ndarray
    cell: np.ndarray
    corners: np.ndarray
    nearest: np.ndarray
    entries: int

    def sums(self, value: np.ndarray | None = None) -> np.ndarray:
        """(m,) float64 sums of weight times value, (n,) or None for 1."""
        count = self.corners.shape[1]
        terms = self.weight if value is None else self.weight * value
        # by cells first: their numbers take less memory than those of all samples' corners would
        sums = np.concatenate([np.bincount(self.cell, row, minlength=count) for row in terms])
        return np.bincount(self.corners.reshape(-1), sums, minlength=self.entries)

    def mixtures(self, rows: np.ndarray) -> np.ndarray:
        """(rows, n) float32 sums of weight times value, of (rows, m) float32 values of the entries."""
        result = np.empty((len(rows), self.weight.shape[1]), np.float32)
        terms = np.empty_like(self.weight)
        for row, total in zip(rows, result, strict=True):
            # no number is out of range, and numpy asks less when told to clip
            np.take(row.take(self.corners, mode="clip"), self.cell, axis=1, out=terms, mode="clip")
            np.einsum("kn,kn->n", terms, self.weight, out=total)
        return result

    def nearest_entries(self) -> np.ndarray:
        """(n,) int64, of each sample's entries the one with the largest weight."""
        return self.corners.reshape(-1).take(self.nearest * self.corners.shape[1] + self.cell)
