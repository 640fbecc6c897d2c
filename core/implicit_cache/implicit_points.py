"""Points that are stored nowhere: one in each octant of a voxel, placed by the voxel's hash (Delaere 2021, section 3.1).

All numbers come from integers, so a point is the same wherever it is met. With `even` spacing the points are the
middles of the octants: the fixed voxels of Binder, Fricke and Keller 2019 at the same density.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from .fixed_point import nest, voxel_words

R3 = np.array([0.8191725133961645, 0.6710436067037893, 0.5497004779019703])
"""Powers of 1/g, g⁴ = g + 1: multiples of them modulo 1 are the most even sequence in a cube (Roberts 2018)."""

R3_WORDS = np.rint(R3 * 2**32).astype(np.uint32)

NEIGHBOURS = {0: 0, 6: 1, 18: 2, 26: 3}
"""Coordinates in which a neighbour may differ."""


def noise(seed: np.ndarray) -> np.ndarray:
    """(3, n) float32 in [0, 1) for (n,) uint32 seeds; seeds in a row are spread evenly."""
    words = seed * R3_WORDS[:, None]
    return (words >> np.uint32(8)).astype(np.float32) * np.float32(2**-24)


@dataclass(frozen=True)
class ImplicitPoints:
    """A point set of all space.

    coarsest: m, edge of the voxels of level 0. levels: how many. neighbourhood: voxels whose points are candidates
    beside the own one's: 0, 6, 18 or 26, as in the thesis; or None for the 27 octants round a place, which hold the same
    three nearest points for 99.9 % of places at an eighth of the work. even: octants' middles in place of noise.
    shared: a coarser level's point stays a point of all finer ones (Appendix A). bits: of words, 32 or 64.
    """

    coarsest: float = 2560.0
    levels: int = 22
    neighbourhood: int | None = None
    even: bool = False
    shared: bool = False
    bits: int = 64

    def level_of(self, size: np.ndarray) -> np.ndarray:
        """(n,) int64 levels whose octants are nearest in size to (n,) m."""
        exact = np.rint(np.log2(self.coarsest / 2 / size))
        return np.clip(exact, 0, self.levels - 1).astype(np.int64)

    def octant_size(self, level: np.ndarray) -> np.ndarray:
        """float64, m: what a point of the level stands for."""
        return self.coarsest / 2 / 2.0**level

    def candidates(
        self, position: np.ndarray, level: np.ndarray, surface: np.ndarray, reach: int = 1
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """For each candidate its key, (n,) uint32, and where it is from the places, (3, n) float32 m.

        position: (3, n), m; level: (n,) int64; surface: (n,) uint32, added to the coordinates' hash, 0 for none.
        reach: octants on each side, where the neighbourhood is None.
        """
        edge = self.octant_size(level)
        place = position / edge
        octant = np.floor(place).astype(np.int64)
        inside = (place - octant).astype(np.float32)
        scale = edge.astype(np.float32)
        around, octants = self._around(reach)
        hashes = {}

        def voxel(axis, step):
            return (octant[axis] + step) >> 1 if octants is None else (octant[axis] >> 1) + step

        def hashed(steps):
            # x around y around z, each computed once
            if steps not in hashes:
                axis = 3 - len(steps)
                words = voxel_words(voxel(axis, steps[0]), level, self.levels, self.bits)
                hashes[steps] = nest(words, hashed(steps[1:]) if axis < 2 else surface)
            return hashes[steps]

        for steps in around:
            seed, step = hashed(steps), np.array(steps)[:, None]
            for target in [octant + step] if octants is None else [2 * ((octant >> 1) + step) + k for k in octants]:
                key = seed + octant_index(target)
                point = np.float32(0.5) if self.even else noise(key)
                if self.shared:
                    key, point = self._inherited(target, level, surface)
                yield key, (target - octant - inside + point) * scale

    def _around(self, reach):
        """Steps to neighbours, in octants, or in voxels and then also the (8, 3, 1) octants of each."""
        if self.neighbourhood is None:
            return list(product(range(-reach, reach + 1), repeat=3)), None
        differing = NEIGHBOURS[self.neighbourhood]
        steps = [s for s in product((-1, 0, 1), repeat=3) if np.count_nonzero(s) <= differing]
        return steps, np.array(list(product((0, 1), repeat=3)))[:, :, None]

    def _inherited(self, target, level, surface):
        """Keys, and places in their octants, of the points that octants (3, n) have from the coarsest level that puts
        one there: a point stays when its voxel is divided, and the other octants get new ones."""
        key = np.zeros(target.shape[1], np.uint32)
        place = np.full(target.shape, np.nan)
        for coarse in range(int(level.max()) + 1):
            there = coarse <= level
            octant = target >> np.maximum(level - coarse, 0)
            seed = surface
            for axis in (2, 1, 0):
                seed = nest(voxel_words(octant[axis] >> 1, coarse, self.levels, self.bits), seed)
            own = seed + octant_index(octant)
            # in coarsest voxels, float64: exact to the finest octant within 2^29 of them
            size = 0.5**coarse / 2
            kept = (np.floor(place / size) == octant).all(axis=0) | ~there
            key = np.where(kept, key, own)
            place = np.where(kept, place, (octant + noise(own)) * size)
        return key, (place / (0.5**level / 2) - target).astype(np.float32)


def octant_index(octant: np.ndarray) -> np.ndarray:
    """(n,) uint32 in 0 … 7: which one of its voxel's octants each of (3, n) is."""
    return ((octant[0] & 1) << 2 | (octant[1] & 1) << 1 | octant[2] & 1).astype(np.uint32)
