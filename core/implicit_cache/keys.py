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

PARTS = 4
"""Into which entries are divided, a power of two of at most 4."""

FINENESS = np.float32(3.5)
"""Components of a normal times this are rounded: its bins are some 16° wide. On curved surfaces wider ones show, and
blur what narrow ones keep (SSIM of a moving statue by 26, 98 and these bins: 0.943, 0.949, 0.953)."""


def normal_bins(normal: np.ndarray) -> np.ndarray:
    """(n,) uint64 below 729 of unit normals (3, n): those of a bin face alike, opposite ones never share one."""
    rounded = np.rint(normal * FINENESS)
    return (rounded[0] * 81 + rounded[1] * 9 + rounded[2] + 364).astype(np.uint64)


def mix(keys: np.ndarray) -> np.ndarray:
    """uint64 of any shape, scattered (the finaliser of SplitMix64: Steele, Lea, Flood 2014)."""
    keys = keys ^ (keys >> np.uint64(30))
    keys *= np.uint64(0xBF58476D1CE4E5B9)
    keys ^= keys >> np.uint64(27)
    keys *= np.uint64(0x94D049BB133111EB)
    keys ^= keys >> np.uint64(31)
    return keys


def parts_of(keys: np.ndarray) -> np.ndarray:
    """(n,) uint8 below PARTS of (n,) uint64 keys: entries of different parts never lie in one slot of a table, so that
    threads can write them at once.

    The bits are some by which a table tells keys apart: those that it takes for one are in one part.
    """
    return (mix(keys) >> np.uint64(30)).astype(np.uint8) & np.uint8(PARTS - 1)


def surface_tags(normal: np.ndarray | None, object_id: np.ndarray | None, seed: int, count: int) -> np.ndarray:
    """(count,) uint64: what sets surfaces apart that share a cell. normal: (3, n) unit or None; object_id: (n,) ints."""
    tags = np.full(count, np.uint64(seed * 0x9E3779B9 & 0xFFFFFFFFFFFFFFFF))
    if normal is not None:
        tags += normal_bins(normal) << np.uint64(1)
    if object_id is not None:
        tags += object_id.astype(np.uint64) << np.uint64(11)
    return tags


def surface_keys(normal: np.ndarray | None, object_id: np.ndarray | None, seed: int, count: int) -> np.ndarray:
    """The same, scattered: (count,) uint64."""
    return mix(surface_tags(normal, object_id, seed, count))


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
