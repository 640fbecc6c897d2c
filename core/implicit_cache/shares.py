"""Sums over samples by entry, and mixtures of entries by sample: all that a frame costs once its places are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

GROUP = 4
"""Samples that are handled as one: what they share is fetched and kept once for all of them. With 8, every second place
in a group would be empty."""


@dataclass(frozen=True)
class Shares:
    """n samples, each shared out among the eight corners of its cell, all of which together are m entries.

    Samples of a cell stand together in groups of GROUP, and what is missing in its last group weighs nothing.
    weight: (8, GROUP, groups) float32 of the corners. corner: (8, groups) int64, which of the m they are.
    sample: (GROUP, groups) int64, which of the n stands there. place: (n,) int64, where each does, among all of `sample`.
    bounds: (PARTS + 1,) int64; between them lie the entries of each part (see keys.parts_of).
    """

    weight: np.ndarray
    corner: np.ndarray
    sample: np.ndarray
    place: np.ndarray
    bounds: np.ndarray

    @property
    def entries(self) -> int:
        """m."""
        return int(self.bounds[-1])

    def part(self, number: int) -> slice:
        """Entries of a part."""
        return slice(*self.bounds[number : number + 2].tolist())

    def sums(self, rows: np.ndarray) -> np.ndarray:
        """(rows, m) float32 sums of weight times value, of (rows, n) float32 values of the samples."""
        result = np.empty((len(rows), self.entries), np.float32)
        for row, total in zip(rows, result, strict=True):
            # no number is out of range, and numpy asks less when told to clip
            terms = np.einsum("kjg,jg->kg", self.weight, row.take(self.sample, mode="clip"))
            total[:] = self._by_entry(terms)
        return result

    def weights(self) -> np.ndarray:
        """(m,) float32 sums of weights."""
        return self._by_entry(self.weight.sum(axis=1)).astype(np.float32)

    def _by_entry(self, terms):
        return np.bincount(self.corner.reshape(-1), terms.reshape(-1), minlength=self.entries)

    def mixtures(self, rows: np.ndarray) -> np.ndarray:
        """(rows, n) float32 sums of weight times value, of (rows, m) float32 values of the entries."""
        result = np.empty((len(rows), len(self.place)), np.float32)
        for row, total in zip(rows, result, strict=True):
            mixed = np.einsum("kg,kjg->jg", row.take(self.corner, mode="clip"), self.weight)
            np.take(mixed, self.place, out=total, mode="clip")
        return result

    def nearest_entries(self) -> np.ndarray:
        """(n,) int64, of each sample's entries the one with the largest weight, where none lies on a cell's face: points of
        a finer lattice don't."""
        first, groups = self.weight[0], self.corner.shape[1]
        # x, y and z are on the far side
        row = 4 * (self.weight[4] > first) + 2 * (self.weight[2] > first) + (self.weight[1] > first)
        row *= groups
        row += np.arange(groups)
        return self.corner.reshape(-1).take(row.take(self.place))


def grouped(cell: np.ndarray, cells: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """`sample` and `place` of Shares for (n,) int64 cells, each of which has a sample; (groups,) int64 their cells; and
    (GROUP, groups) bool, where a sample stands. Elsewhere the last of its group stands once more.
    """
    held = np.bincount(cell, minlength=cells)
    groups = held + (GROUP - 1) >> GROUP.bit_length() - 1
    owner = np.repeat(np.arange(cells), groups)
    # short numbers are sorted by their bytes, in a sixth of the time
    order = np.argsort(cell.astype(np.uint16) if cells <= 1 << 16 else cell, kind="stable")
    # where in that order a group begins, and the last of its cell
    ends = np.cumsum(held)
    begins = ends - held - GROUP * (np.cumsum(groups) - groups)
    begin, last = begins.take(owner), ends.take(owner) - 1
    begin += GROUP * np.arange(len(owner))
    there = begin + np.arange(GROUP)[:, None]
    filled = there <= last
    sample = order.take(np.minimum(there, last, out=there))
    place = np.empty(len(cell), np.int64)
    # those that stand there once more are overwritten
    for row in range(GROUP - 1, -1, -1):
        place[sample[row]] = np.arange(row * len(owner), (row + 1) * len(owner))
    return sample, place, owner, filled
