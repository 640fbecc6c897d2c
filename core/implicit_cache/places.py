"""Where samples belong: their entries on all lattices, and what is measured there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from .keys import lattice_keys
from .lattice import Points, share_points, share_samples
from .shares import Shares
from .table import Table

HANDED_DOWN = 16.0
"""A new entry begins with the mean of the next coarser one, worth at most so many samples."""


@dataclass
class Tier:
    """m different entries on one lattice.

    shares: of the samples, or of the entries of the next finer tier, among these. points: (m,) where they are;
    slot: (m,) int64, where the table has them (numpy copies shorter numbers before it takes by them). share: (m,) float32,
    what the samples weigh in sum.
    """

    shares: Shares
    points: Points
    slot: np.ndarray
    share: np.ndarray


@dataclass
class Piece:
    """Some of the samples. tiers: their entries, finest first. near: (k,) of the next coarser entries those that are nearest
    to some of the finest, and nearest: (m,) which of the k is so to each; noise: (2, k) sums at those, that tell how samples
    scatter; all None where trust is not measured."""

    tiers: list[Tier]
    near: np.ndarray | None
    nearest: np.ndarray | None
    noise: np.ndarray | None


@dataclass
class Places:
    """Where in a cache some samples belong. It stays usable while the samples stay where they are.

    count: of samples. moves: how often the table had put itself in order. whole: whether it still has all entries.
    """

    count: int
    pieces: Sequence[Piece]
    moves: int
    whole: bool = field(default=True)

    @property
    def tiers(self) -> list[Tier]:
        """Of all pieces."""
        return [tier for piece in self.pieces for tier in piece.tiers]

    def find_again(self, table: Table) -> None:
        """Slots, after the table has put itself in order."""
        if self.moves == table.moves:
            return
        for tier in self.tiers:
            slot = table.find(tier.points.key).astype(np.int64)
            self.whole &= not ((slot == table.nowhere) & (tier.slot != table.nowhere)).any()
            tier.slot = slot
        self.moves = table.moves


def find_piece(
    table: Table,
    position: np.ndarray,
    level: np.ndarray,
    tags: np.ndarray,
    octaves: Sequence[int],
    measured: bool,
) -> Piece:
    """Entries of samples at positions (3, n), m, at levels (n,) int32, on surfaces of (n,) uint64 tags, as far as there are any.

    octaves: from each lattice to the next coarser one.
    """

    def tier(shares, points, share):
        return Tier(shares, points, table.find(points.key).astype(np.int64), share)

    shares, points = share_samples(position, level, tags)
    tiers = [tier(shares, points, shares.weights())]
    for step in octaves:
        shares, points = share_points(points, step)
        tiers.append(tier(shares, points, shares.sums(tiers[-1].share[None])[0]))
    if not measured:
        return Piece(tiers, None, None, None)
    nearest, entries = tiers[1].shares.nearest_entries(), tiers[1].shares.entries
    near = np.flatnonzero(np.bincount(nearest, minlength=entries))
    row = np.empty(entries, np.int64)
    row[near] = np.arange(len(near))
    return Piece(tiers, near, row.take(nearest), np.zeros((2, len(near))))


def make_missing(table: Table, places: Places) -> None:
    """Make the entries that the table does not hold."""
    tiers = places.tiers
    absent = [np.flatnonzero(tier.slot == table.nowhere) for tier in tiers]
    if not any(len(rows) for rows in absent):
        return
    missing = [tier.points.take(rows) for tier, rows in zip(tiers, absent, strict=True)]
    missing = Points(*(np.concatenate(columns, axis=-1) for columns in zip(*missing, strict=True)))
    new, example, inverse = np.unique(missing.key, return_index=True, return_inverse=True)
    if not table.has_room(len(new)):
        # so that what is seen now is not forgotten for it
        for tier in tiers:
            table.touch(tier.slot)
    before = table.used
    made = table.insert(new)
    ends = np.cumsum([len(rows) for rows in absent])[:-1]
    for tier, rows, part in zip(tiers, absent, np.split(made[inverse.reshape(-1)], ends), strict=True):
        tier.slot[rows] = part
    if before:
        _hand_down(table, missing.take(example), made)
    places.find_again(table)
    places.whole = True


def _hand_down(table, points, made):
    """New entries begin with what the nearest entry of the next coarser level has, so that a new level is no cut."""
    parent = table.find(lattice_keys(points.cell >> 1, points.level + 1, points.surface))
    rows = np.flatnonzero((parent != table.nowhere) & (made != table.nowhere))
    parent = parent[rows]
    count = np.minimum(table.counts(parent), np.float32(HANDED_DOWN))
    table.put(made[rows], table.mean[:, parent], count)
