"""Edges as lines across the lamp, and tables of the samples on either side of every such line.

For a receiver P and an occluder's edge AB the signed volume of (P, A, B, S) is affine in the lamp's sample S on the
lamp's plane: f(S) = ga·a + gb·b + g0 for the sample at (a, b). An edge, seen from P, is a line that cuts the samples in
two. Divided by |ga| + |gb| it has two parameters and a sign; a table over both holds the samples that are surely on the
inner side, and those that may be: what lies between is left to rays. So the cost of an edge does not grow with the
number of samples as rays do. The line takes the place of the hard shadow volumes of single samples in Laine and Aila's
leaves (2005).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from .masks import full_mask, words_of

TABLE_BYTES = 1 << 24
"""Size that a table may have: finer tables leave fewer relations to rays, but no longer stay in the cache."""

ROUNDING = np.float32(3e-7)
"""Error of a coefficient in float32, in parts of the sum of its terms' magnitudes: five roundings."""


class LineTable:
    """Rows of 2 × words uint64, [surely inside | maybe inside], for lines (sign of ga, gb/s, g0/s), s = |ga| + |gb|.

    places: (sets, L, 2) float32 in [−1, 1]. guard: width of the band, in units of s, in which rays decide.
    """

    def __init__(self, places: np.ndarray, guard: float):
        self.sets, self.samples = places.shape[:2]
        self.guard = guard
        self.words = words_of(self.samples)
        cells = TABLE_BYTES // (16 * self.words * self.sets * 2)
        # four times as many offsets as slopes: a sample's place changes by less with the slope
        self.slopes = 1 << max(5, int(np.log2(max(cells, 1)) / 2 - 1))
        self.offsets = 1 << max(7, int(np.log2(max(cells, 1)) - np.log2(self.slopes)))
        # |g0| ≤ s · (1 + guard) covers all lines that touch the lamp; the cells at the ends are all out and all in
        self.scale = np.float32((self.offsets / 2 - 1) / (1 + guard))
        sides = [self._side(one, sign) for one in places for sign in (1, -1)]
        rows = np.concatenate(sides)
        none, all_ = np.zeros(self.words, np.uint64), full_mask(self.samples)
        special = [np.concatenate(pair) for pair in ((none, all_), (none, none), (all_, all_))]
        self.rows = np.ascontiguousarray(np.concatenate([rows, special]))
        self.unknown, self.outside, self.inside = range(len(rows), len(rows) + 3)

    def _side(self, places, sign):
        """(slopes × offsets, 2 × words) rows for lines whose ga has this sign."""
        t = np.linspace(-1, 1, self.slopes + 1)[None]
        a, b = places.astype(np.float64).T[:, :, None]
        # along a cell's slope the value is linear but for the corner at t = 0, which lies on a border of cells
        value = sign * (1 - np.abs(t)) * a + t * b
        low, high = (f(value[:, :-1], value[:, 1:]) for f in (np.minimum, np.maximum))
        # the first offset cell from which a sample is surely inside (its whole cell above the guard), and maybe
        sure = np.ceil((self.guard - low) * self.scale + self.offsets / 2).astype(np.int64)
        maybe = np.floor((-self.guard - high) * self.scale + self.offsets / 2).astype(np.int64)
        result = np.empty((self.slopes, self.offsets, 2 * self.words), np.uint64)
        for part, first in ((0, sure), (1, maybe)):
            # the last cell holds all lines beyond the lamp, the first one those on its other side
            first = np.clip(first, 1, self.offsets - 1)
            bits = np.zeros((self.slopes, self.offsets, self.words), np.uint64)
            slope = np.broadcast_to(np.arange(self.slopes), first.shape)
            for word in range(self.words):
                some = slice(64 * word, 64 * word + 64)
                bit = np.uint64(1) << np.arange(len(first[some]), dtype=np.uint64)[:, None]
                np.bitwise_or.at(bits[:, :, word], (slope[some], first[some]), np.broadcast_to(bit, first[some].shape))
            np.bitwise_or.accumulate(bits, axis=1, out=bits)
            result[:, :, part * self.words : (part + 1) * self.words] = bits
        return result.reshape(-1, 2 * self.words)

    @property
    def rows_per_set(self) -> int:
        return 2 * self.slopes * self.offsets

    def index(self, ga: np.ndarray, gb: np.ndarray, g0: np.ndarray) -> np.ndarray:
        """(n,) intp rows of lines, coefficients (n,) float32, which are overwritten; for the first set."""
        half = np.float32(self.slopes / 2)
        scale = np.abs(ga)
        steep = np.abs(gb)
        scale += steep
        np.divide(np.float32(1), scale, out=scale)
        gb *= scale
        gb *= half
        # the last slope's own end belongs to it
        gb += half
        np.minimum(gb, np.float32(self.slopes - 0.5), out=gb)
        np.floor(gb, out=gb)
        negative = ga < 0
        g0 *= scale
        g0 *= self.scale
        g0 += np.float32(self.offsets / 2)
        np.clip(g0, np.float32(0), np.float32(self.offsets - 0.5), out=g0)
        np.floor(g0, out=g0)
        gb += np.multiply(negative, np.float32(self.slopes), dtype=np.float32, out=steep)
        gb *= np.float32(self.offsets)
        gb += g0
        return gb.astype(np.intp)


@lru_cache(maxsize=4)
def _table(key: bytes, shape: tuple[int, ...], guard: float) -> LineTable:
    return LineTable(np.frombuffer(key, np.float32).reshape(shape), guard)


def line_table(places: np.ndarray, guard: float) -> LineTable:
    """The table of samples (sets, L, 2) in [−1, 1]; the same pattern costs nothing a second time.

    guard is rounded up to a power of two.
    """
    places = np.ascontiguousarray(places, np.float32)
    return _table(places.tobytes(), places.shape, float(2.0 ** np.ceil(np.log2(guard))))


def edge_coefficients(a: np.ndarray, b: np.ndarray, half: np.ndarray, distant: bool) -> np.ndarray:
    """(n, 3, 4) float64: ga, gb and g0 of edges AB as affine functions (constant, x, y, z) of the receiver's place.

    a, b: (n, 3) float64, m, in the lamp's frame (x and y in its plane, z into the scene, the origin at its middle; a
    distant lamp shines along z). half: the lamp's half extents.
    """
    # float64: m is the difference of products of places
    d = b - a
    m = np.cross(a, b)
    result = np.zeros((len(a), 3, 4))
    result[:, 0, 0] = half[0] * m[:, 0]
    result[:, 0, 2] = -half[0] * d[:, 2]
    result[:, 0, 3] = half[0] * d[:, 1]
    result[:, 1, 0] = half[1] * m[:, 1]
    result[:, 1, 1] = half[1] * d[:, 2]
    result[:, 1, 3] = -half[1] * d[:, 0]
    if distant:
        result[:, 2, 0] = -m[:, 2]
        result[:, 2, 1] = d[:, 1]
        result[:, 2, 2] = -d[:, 0]
    else:
        result[:, 2, 1:] = -m
    return result
