"""Names of lattice points: 64-bit keys that are linear in the lattice's coordinates, and the hash that scatters them.

A linear key costs one addition for each further corner of a cell, and equal keys along a scanline tell that pixels lie
in one cell. Two lattice points share a key only where a combination of their coordinates' difference vanishes modulo
2^64, which takes differences of millions of cells.
"""

from __future__ import annotations

import numpy as np

STEPS = np.array([0x9E3779B97F4A7C15, 0xD1B54A32D192ED03, 0x8CB92BA72F3D8DD7], np.uint64)
"""What one cell along x, y or z adds to a key."""

LEVEL_STEP = np.uint64(0xF1357AEA2E62A9C5)
"""What one level adds."""

CORNERS = np.array([[k >> 2 & 1, k >> 1 & 1, k & 1] for k in range(8)])
"""(8, 3) offsets of a cell's corners."""

CORNER_STEPS = (CORNERS.astype(np.uint64) * STEPS).sum(axis=1, dtype=np.uint64)

BIN_EDGE = np.float32(5 / 6)
"""A component of a unit normal counts once it exceeds half of this."""


def normal_bins(normal: np.ndarray) -> np.ndarray:
    """(n,) uint64 in 0 … 26 of unit normals (3, n): which of 26 directions (faces, edges, corners of a cube) is near."""
    rounded = np.rint(normal * (1 / BIN_EDGE))
    return (rounded[0] * 9 + rounded[1] * 3 + rounded[2] + 13).astype(np.uint64)


def mix(keys: np.ndarray) -> np.ndarray:
    """uint64 of any shape, scattered (the finaliser of SplitMix64: Steele, Lea, Flood 2014)."""
    keys = keys ^ (keys >> np.uint64(30))
    keys *= np.uint64(0xBF58476D1CE4E5B9)
    keys ^= keys >> np.uint64(27)
    keys *= np.uint64(0x94D049BB133111EB)
    keys ^= keys >> np.uint64(31)
    return keys


def surface_keys(normal: np.ndarray | None, object_id: np.ndarray | None, seed: int, count: int) -> np.ndarray:
    """(count,) uint64: what sets surfaces apart that share a cell. normal: (3, n) unit or None; object_id: (n,) ints."""
    tags = np.full(count, np.uint64(seed * 0x9E3779B9 & 0xFFFFFFFFFFFFFFFF))
    if normal is not None:
        tags += normal_bins(normal) << np.uint64(1)
    if object_id is not None:
        tags += object_id.astype(np.uint64) << np.uint64(8)
    return mix(tags)


def lattice_keys(cell: np.ndarray, level: np.ndarray, surface: np.ndarray) -> np.ndarray:
    """(n,) uint64 of cells (3, n) integers at levels (n,) integers on surfaces (n,) uint64."""
    # numbers below zero wrap round, which is what modulo 2^64 means
    words = cell.astype(np.int64).view(np.uint64)
    keys = words[0] * STEPS[0]
    keys += words[1] * STEPS[1]
    keys += words[2] * STEPS[2]
    keys += level.astype(np.int64).view(np.uint64) * LEVEL_STEP
    keys += surface
    return keys
