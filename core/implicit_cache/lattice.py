"""Samples among lattice points: each belongs to the eight corners of its cell, by trilinear weights.

Splitting a sample over its corners, in place of giving it to one at random, takes the grid's steps out of the picture,
and reading by the same weights takes them out once more. Lattice points themselves lie among those of a coarser lattice
in the same way.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .keys import CORNER_STEPS, CORNERS, PARTS, lattice_keys, mix, parts_of
from .levels import cell_size
from .shares import Shares, grouped

_SCATTER = 0x9E3779B97F4A7C15


class Points(NamedTuple):
    """m lattice points: (3, m) int64 cells in whose middle they lie, (m,) int32 levels, (m,) uint64 surfaces and keys."""

    cell: np.ndarray
    level: np.ndarray
    surface: np.ndarray
    key: np.ndarray

    def take(self, rows: np.ndarray) -> Points:
        """Of these points."""
        return Points(self.cell.take(rows, axis=1, mode="clip"), *(part.take(rows, mode="clip") for part in self[1:]))


def share_samples(position: np.ndarray, level: np.ndarray, tags: np.ndarray) -> tuple[Shares, Points]:
    """Samples at positions (3, n), m, at levels (n,) int32, on surfaces of tags (n,) uint64, and the points that they
    belong to.

    Lattice point i lies in the middle of cell i, so that the lattices of no two levels share points.
    """
    place = position / cell_size(level) - np.float32(0.5)
    low = np.floor(place)
    place -= low
    # runs along scanlines first, which are cheaper to tell than what is alike in other lines
    starts = np.ones(len(level), bool)
    differs = level[1:] != level[:-1]
    for row in (tags, *low):
        differs |= row[1:] != row[:-1]
    starts[1:] = differs
    first = np.flatnonzero(starts)
    cell, level, surface = low.take(first, axis=1).astype(np.int64), level.take(first), mix(tags.take(first))
    key = lattice_keys(cell, level, surface)
    example, which = distinct(key)
    cells = Points(cell, level, surface, key).take(example)
    which = which.take(np.cumsum(starts) - 1, mode="clip")
    return _shares(place.astype(np.float32, copy=False), cells, which)


def share_points(points: Points, octaves: int) -> tuple[Shares, Points]:
    """Lattice points among those of a lattice that is coarser by so many octaves."""
    wide = 1 << octaves
    cell = points.cell - (wide >> 1)
    place = ((cell & wide - 1).astype(np.float32) + np.float32(0.5)) / np.float32(wide)
    cell >>= octaves
    level = points.level + np.int32(octaves)
    cells = Points(cell, level, points.surface, lattice_keys(cell, level, points.surface))
    example, which = distinct(cells.key)
    return _shares(place, cells.take(example), which)


def _shares(place, cells, which):
    """Shares of places (3, n) in [0, 1] of cells, each in one of them, and the cells' corners, each once, by parts."""
    keys = (cells.key + CORNER_STEPS[:, None]).reshape(-1)
    stands = _stands(keys)
    example = np.flatnonzero(stands == np.arange(len(keys), dtype=np.int32))
    part = parts_of(keys.take(example))
    example = example.take(np.argsort(part, kind="stable"))
    bounds = np.concatenate([[0], np.cumsum(np.bincount(part, minlength=PARTS))])
    number = _numbers(stands, example)
    # several times as fast as divmod
    corner = example // max(len(cells.key), 1)
    points = cells.take(example - corner * len(cells.key))
    points = points._replace(cell=points.cell + CORNERS.T.take(corner, axis=1), key=keys.take(example))
    sample, there, owner, filled = grouped(which, len(cells.key))
    weight = trilinear(place.take(sample.reshape(-1), axis=1, mode="clip"), filled.reshape(-1))
    corners = number.reshape(8, -1).take(owner, axis=1, mode="clip")
    return Shares(weight.reshape(8, *sample.shape), corners, sample, there, bounds), points


def distinct(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows (k,) of (n,) uint64 keys, one for each different key, and (n,) which of the k each is."""
    stands = _stands(keys)
    chosen = np.flatnonzero(stands == np.arange(len(keys), dtype=np.int32))
    return chosen, _numbers(stands, chosen)


def _stands(keys):
    """(n,) int32: a row for each of (n,) uint64 keys, the same for all that are equal. By hashing: no sort."""
    count = len(keys)
    rows = np.arange(count, dtype=np.int32)
    bits = max(count.bit_length(), 4)
    last = np.empty(1 << bits, np.int32)
    shift = np.uint64(64 - bits)
    stands, open_, scatter = rows, rows, _SCATTER
    while len(open_):
        # the last key at a place stands for all that are equal to it; other keys there look for another place
        place = keys * np.uint64(scatter)
        place >>= shift
        place = place.view(np.int64)
        last[place] = rows[: len(open_)]
        stand = last.take(place, mode="clip")
        more = np.flatnonzero(keys.take(stand, mode="clip") != keys)
        if stands is rows:
            stands = stand
        else:
            stands[open_] = open_.take(stand)
        # those that found another key at their place will be put right
        open_, keys, scatter = open_.take(more), keys.take(more), scatter * _SCATTER & 0xFFFFFFFFFFFFFFFF
    return stands


def _numbers(stands, chosen):
    """(n,) int64: where the row that stands for each is among the chosen ones."""
    number = np.empty(len(stands), np.int64)
    number[chosen] = np.arange(len(chosen))
    return number.take(stands, mode="clip")


def trilinear(place: np.ndarray, filled: np.ndarray) -> np.ndarray:
    """(8, n) float32 weights of a cell's corners, of places (3, n) in [0, 1] where (n,) is true, and 0 elsewhere; x is the
    slowest of their bits."""
    x, y, z = place
    near, far = (1 - x) * filled, x * filled
    weight = np.empty((8, place.shape[1]), np.float32)
    np.multiply(near, 1 - y, out=weight[0])
    np.multiply(near, y, out=weight[2])
    np.multiply(far, 1 - y, out=weight[4])
    np.multiply(far, y, out=weight[6])
    np.multiply(weight[0::2], z, out=weight[1::2])
    weight[0::2] -= weight[1::2]
    return weight
