"""Samples among lattice points: each belongs to the eight corners of its cell, by trilinear weights.

Splitting a sample over its corners, in place of giving it to one at random, takes the grid's steps out of the picture,
and reading by the same weights takes them out once more. Pixels that follow one another in one cell share its corners:
these are looked up once a run.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .keys import CORNER_STEPS, lattice_keys
from .levels import cell_size


class Runs(NamedTuple):
    """A piece of the samples, n in R runs of one cell each.

    weight: (8, n) float32, sums 1. first: (R,) int64, where each run begins; run: (n,) int64, the run of each sample.
    key: (8, R) uint64 of the corners. cell: (3, R) int64 of the first one; level: (R,) int32; surface: (R,) uint64.
    """

    weight: np.ndarray
    first: np.ndarray
    run: np.ndarray
    key: np.ndarray
    cell: np.ndarray
    level: np.ndarray
    surface: np.ndarray


def corners(position: np.ndarray, level: np.ndarray, surface: np.ndarray) -> Runs:
    """Corners of samples at positions (3, n), m, at levels (n,) int32, on surfaces (n,) uint64.

    Lattice point i lies in the middle of cell i, so that the lattices of no two levels share points.
    """
    place = position / cell_size(level) - np.float32(0.5)
    low = np.floor(place)
    place -= low
    cell = low.astype(np.int64)
    key = lattice_keys(cell, level, surface)
    starts = np.empty(len(key), bool)
    starts[:1] = True
    np.not_equal(key[1:], key[:-1], out=starts[1:])
    first = np.flatnonzero(starts)
    run = np.cumsum(starts) - 1
    return Runs(
        trilinear(place.astype(np.float32)),
        first,
        run,
        key[first] + CORNER_STEPS[:, None],
        cell[:, first],
        level[first],
        surface[first],
    )


def trilinear(place: np.ndarray) -> np.ndarray:
    """(8, n) float32 weights of a cell's corners, of places (3, n) in [0, 1]; x is the slowest of their bits."""
    x, y, z = place
    weight = np.empty((8, place.shape[1]), np.float32)
    np.multiply(1 - x, 1 - y, out=weight[0])
    np.multiply(1 - x, y, out=weight[2])
    np.multiply(x, 1 - y, out=weight[4])
    np.multiply(x, y, out=weight[6])
    weight[1::2] = weight[0::2] * z
    weight[0::2] -= weight[1::2]
    return weight
