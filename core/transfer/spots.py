"""What some entries see of small sources, each alone: what no lamp of a few would show."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

COLUMNS = 32
"""Of a product with what elements see that are made together: what links bring then stays in the caches."""


@dataclass(frozen=True)
class Spots:
    """seen: (rows, g) float32 irradiance of some entries by each of g small sources; or what multiplies like it.
    radiosity: from values (g, k), how much of each source, to the radiosity (n, k) of all entries."""

    seen: np.ndarray | Seen
    radiosity: Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Seen:
    """A matrix (rows, m + s) of what elements see of m entries and s single elements, known by its products alone: most
    of it is the far light between few entries, the rest is sparse.

    far: (e, m) float32 from all entries to those of the rows; place: (rows,) int, ascending, which one each row is part
    of; factor: (rows,) float32, times which it receives their light. group: (m,), spot: (s,) float32, how bright each
    source is. own: (s,) int, ascending, the entry of each single element, and share: (s,) float32 its part of that. row,
    single: (l,) int, links from single elements to rows, by row; weight: (l,) float32.
    """

    far: np.ndarray
    place: np.ndarray
    factor: np.ndarray
    group: np.ndarray
    spot: np.ndarray
    own: np.ndarray
    share: np.ndarray
    row: np.ndarray
    single: np.ndarray
    weight: np.ndarray

    # products with arrays are made here, not element by element
    __array_ufunc__ = None

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.place), len(self.group) + len(self.spot)

    def __rmul__(self, scale: np.ndarray) -> Seen:
        """Rows times `scale` (rows, 1)."""
        scale = scale[:, 0]
        return replace(self, factor=self.factor * scale, weight=self.weight * scale[self.row])

    def __matmul__(self, values: np.ndarray) -> np.ndarray:
        """(rows, k) of values (m + s, k)."""
        groups = self.group[:, None] * values[: len(self.group)]
        spots = self.spot[:, None] * values[len(self.group) :]
        sent = groups + _sums(self.share[:, None] * spots, self.own, len(groups))
        found = (self.far @ sent).take(self.place, axis=0) * self.factor[:, None]
        spots += groups.take(self.own, axis=0)
        for k in range(0, values.shape[1], COLUMNS):
            s = slice(k, k + COLUMNS)
            found[:, s] += _sums(spots[:, s].take(self.single, axis=0) * self.weight[:, None], self.row, len(found))
        return found

    def __rmatmul__(self, values: np.ndarray) -> np.ndarray:
        """(k, m + s) of values (k, rows)."""
        values = np.ascontiguousarray(values.T)
        received = _sums(values * self.factor[:, None], self.place, len(self.far))
        sent = self.far.T @ received
        order = np.argsort(self.single, kind="stable")
        row, weight, single = self.row[order], self.weight[order], self.single[order]
        spots = np.empty((len(self.spot), values.shape[1]), np.float32)
        for k in range(0, values.shape[1], COLUMNS):
            s = slice(k, k + COLUMNS)
            spots[:, s] = _sums(values[:, s].take(row, axis=0) * weight[:, None], single, len(spots))
        groups = sent + _sums(spots, self.own, len(sent))
        spots += self.share[:, None] * sent.take(self.own, axis=0)
        return np.concatenate([self.group[:, None] * groups, self.spot[:, None] * spots]).T


def _sums(values: np.ndarray, owner: np.ndarray, count: int) -> np.ndarray:
    """(count, k) float32 sums of values (n, k) by their owners (n,), ascending."""
    result = np.zeros((count, values.shape[1]), np.float32)
    if len(owner):
        first = np.flatnonzero(np.diff(owner, prepend=-1))
        result[owner[first]] = np.add.reduceat(values, first, axis=0)
    return result
