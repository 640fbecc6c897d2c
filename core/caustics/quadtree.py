"""Photons as the vertices of patches on quadtrees: patches of 3 × 3 photons, refined where they predict badly.

After Wyman and Nichols, Adaptive Caustic Maps Using Deferred Shading, 2009: a coarse grid of photons is subdivided
where they diverge, to a level limit, an error threshold or a number of photons. Two things differ. A patch is a beam
with an area in place of a cluster of points, and its error is how far the photons inside landed from where the coarser
patch's biquadratic said, which costs nothing, since refining traces them anyway.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

LEVELS = 20
"""Finest level: patches of 2⁻²⁰ of the square's side, whose photons are 2⁻²¹ apart."""

SIDE = 1 << (LEVELS + 1)
"""Lattice steps along the side of a square."""

BITS = LEVELS + 2
"""Of a lattice coordinate in a key; SIDE itself must fit."""

DIVIDED = 0.8
"""Weight of a patch whose photons took different ways and some of them landed, over one that is as wrong as can be."""

DARK = 0.1
"""The same where none of them landed, though one that lies between them may."""

FLOOR = 4.0
"""Texels: an error counts in relation to the patch's size, or to this where it is smaller."""

ENOUGH = 0.02
"""Texels of error below which a patch is left as it is."""

# parts of a patch that its photons stand for: of a smooth one, and of one whose photons differ
SIMPSON = np.outer((1, 4, 1), (1, 4, 1)).reshape(9) / 36
CELLS = np.outer((1, 2, 1), (1, 2, 1)).reshape(9) / 16

# the 3 × 3 of each child among its parent's 5 × 5
_CHILD = np.array([[(a + i) * 5 + b + j for i in range(3) for j in range(3)] for a in (0, 2) for b in (0, 2)], np.int64)
_OLD = np.array([i * 5 + j for i in (0, 2, 4) for j in (0, 2, 4)])
_NEW = np.setdiff1d(np.arange(25), _OLD)
# those on the border of the 5 × 5 that are not among the 3 × 3
_EDGE = np.array([k for k in _NEW if k // 5 in (0, 4) or k % 5 in (0, 4)])


def _halfway():
    """(25, 9) weights of a patch's vertices in the biquadratic at the places of the 5 × 5."""
    t = np.arange(5) / 4
    line = np.stack([(1 - t) * (1 - 2 * t), 4 * t * (1 - t), t * (2 * t - 1)], 1)
    return np.einsum("ai,bj->abij", line, line).reshape(25, 9)


_PREDICT = _halfway()[_NEW].astype(np.float32)
# which of the new places each child holds
_HELD = np.array([[k for k, place in enumerate(_NEW) if place in child] for child in _CHILD])
# neighbours among the 3 × 3
_STEPS = [(k, k + 1) for k in (0, 1, 3, 4, 6, 7)] + [(k, k + 3) for k in range(6)]


@dataclass
class Photons:
    """Vertices. place: (n, 2) float32 in texels. power: (n, c) float32 W that landed, if the whole square were like it.
    carried: (n,) float32 W, mean of the channels, with which they landed or left the scene. signature: (n,) int32 (see
    `Forest`). chart: (n,) int32 of the atlas, 0 for none. rest: (n, k) float32, whatever else is known of them."""

    place: np.ndarray
    power: np.ndarray
    carried: np.ndarray
    signature: np.ndarray
    chart: np.ndarray
    rest: np.ndarray

    def __len__(self) -> int:
        return len(self.signature)

    def join(self, more: Photons) -> Photons:
        """These, then `more`."""
        return Photons(*(np.concatenate([getattr(self, k), getattr(more, k)]) for k in self.__dataclass_fields__))

    def take(self, rows: np.ndarray) -> Photons:
        """Those at `rows` only."""
        return Photons(*(getattr(self, k)[rows] for k in self.__dataclass_fields__))


Tracing = Callable[[np.ndarray, np.ndarray, np.ndarray], Photons]
"""(tree (n,) int, s (n,), t (n,) float64 in [0, 1]) → Photons."""


class Forest:
    """Patches on one square for each tree, and their photons.

    trace: photons at places of squares. Their signature is 0 where they missed the object, else alike for photons that
    took the same way to the same chart: a negative number where they landed nowhere, else a positive one, odd where the
    place is in the atlas. levels: (trees,) int of each tree's first grid.

    photons: all so far. corner: (p, 9) int32 rows of the photons of each patch. tree, level: (p,). error: (p,) float32
    texels by which the coarser patch was wrong here, infinite where it is not known.
    """

    def __init__(self, trace: Tracing, levels: np.ndarray):
        self._trace = trace
        self._keys = np.zeros(0, np.int64)
        self._rows = np.zeros(0, np.int64)
        # of each photon
        self._key = np.zeros(0, np.int64)
        self.photons: Photons | None = None
        self.tree = np.repeat(np.arange(len(levels), dtype=np.int32), 4 ** levels.astype(np.int64))
        self.level = levels[self.tree].astype(np.int8)
        grids = {level: np.meshgrid(*2 * [np.arange(1 << level)], indexing="ij") for level in set(levels.tolist())}
        side = SIDE >> self.level.astype(np.int64)
        self.x, self.y = (
            (np.concatenate([grids[level][k].ravel() for level in levels.tolist()]) * side).astype(np.int32)
            for k in (0, 1)
        )
        half = side[:, None] >> 1
        i, j = np.arange(9) // 3, np.arange(9) % 3
        keys = _key(self.tree.astype(np.int64)[:, None], self.x[:, None] + i * half, self.y[:, None] + j * half)
        self.corner = self._add(keys.ravel()).reshape(-1, 9).astype(np.int32)
        self.error = np.full(len(self.tree), np.inf, np.float32)

    def __len__(self) -> int:
        return len(self.tree)

    @property
    def measure(self) -> np.ndarray:
        """(p,) float64 part of its square that each patch is."""
        return 0.25 ** self.level.astype(np.float64)

    def kinds(self) -> tuple[np.ndarray, np.ndarray]:
        """Two (p,) bool: patches whose photons all took the same way into the atlas; those that differ."""
        return kinds_of(self.photons.signature[self.corner])

    def scores(self) -> np.ndarray:
        """(p,) float32 W that may be in the wrong place; 0 for what need not be refined."""
        signature = self.photons.signature[self.corner]
        beams, divided = kinds_of(signature)
        carried = self.photons.carried
        power = carried[self.corner].max(axis=1)
        place = self.photons.place[self.corner]
        one, other = place[:, 8] - place[:, 0], place[:, 6] - place[:, 2]
        area = 0.5 * np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
        part = np.minimum(1, self.error / np.maximum(FLOOR, np.sqrt(area)))
        part = np.where(self.error < ENOUGH, 0, part)
        part = np.where(beams, part, np.where(divided, DIVIDED, 0))
        alike = (signature == signature[:, :1]).all(axis=1)
        part = np.where(~alike & ~divided, DARK, part)
        blank = np.flatnonzero(alike & ~beams)
        power[blank] = self._beside(blank, carried)
        part[blank] = DIVIDED
        return np.where(self.level < LEVELS, part * power * self.measure, 0).astype(np.float32)

    def _beside(self, rows: np.ndarray, carried: np.ndarray) -> np.ndarray:
        """(m,) float32 largest power of the photons that finer neighbours traced on the edges of patches at `rows`.

        Where a patch's own photons all went nowhere, these tell of light that reaches into it between them.
        """
        quarter = ((SIDE >> 2) >> self.level[rows].astype(np.int64))[:, None]
        i, j = _EDGE // 5, _EDGE % 5
        keys = _key(
            self.tree[rows].astype(np.int64)[:, None],
            self.x[rows, None] + i * quarter,
            self.y[rows, None] + j * quarter,
        )
        at = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
        known = self._keys[at] == keys
        signature = self.photons.signature[self._rows[at]]
        lands = known & (signature > 0) & (signature & 1 == 1)
        return np.where(lands, carried[self._rows[at]], 0).max(axis=1, initial=0)

    def refine(self, chosen: np.ndarray) -> np.ndarray:
        """Replace the patches (m,) by four each. Returns (p,) bool of the new list: those that are new, at its end."""
        if not len(chosen):
            return np.zeros(len(self), bool)
        tree, level = self.tree[chosen], self.level[chosen]
        quarter = (SIDE >> 2) >> level.astype(np.int64)
        x, y = self.x[chosen].astype(np.int64), self.y[chosen].astype(np.int64)
        i, j = _NEW // 5, _NEW % 5
        keys = _key(
            tree.astype(np.int64)[:, None], x[:, None] + i * quarter[:, None], y[:, None] + j * quarter[:, None]
        )
        rows = self._add(keys.ravel()).reshape(keys.shape)
        lattice = np.empty((len(chosen), 25), np.int32)
        lattice[:, _OLD], lattice[:, _NEW] = self.corner[chosen], rows
        error = self._errors(self.corner[chosen], rows)
        corner = lattice[:, _CHILD].reshape(-1, 9)
        error = error.ravel()
        unknown = np.flatnonzero(np.isinf(error))
        unknown = unknown[kinds_of(self.photons.signature[corner[unknown]])[0]]
        error[unknown] = self._bent(corner[unknown])
        self._replace(
            chosen,
            corner=corner,
            tree=np.repeat(tree, 4),
            level=np.repeat(level + 1, 4).astype(np.int8),
            x=(x[:, None] + np.array([0, 0, 2, 2]) * quarter[:, None]).ravel().astype(np.int32),
            y=(y[:, None] + np.array([0, 2, 0, 2]) * quarter[:, None]).ravel().astype(np.int32),
            error=error,
        )
        new = np.zeros(len(self), bool)
        new[-4 * len(chosen) :] = True
        return new

    def halfway(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """(n,) rows of the photons halfway between those at rows (n,), which lie an even number of lattice steps apart on one
        line; those that are not known are traced."""
        return self._add(self._key[one] + self._key[other] >> 1)

    def between(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """The same, −1 where none is known."""
        return self._find(self._key[one] + self._key[other] >> 1)

    def beyond(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """(n,) rows of the photons as far beyond the second as that is from the first, −1 where none is known."""
        # a coordinate below 0 makes a key that no photon has
        return self._find(2 * self._key[other] - self._key[one])

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Two (n,) int64 of the photons: the tree that each is on, and the name of its place in that tree's square."""
        return self._key >> 2 * BITS, self._key & (1 << 2 * BITS) - 1

    def names(self, group: np.ndarray) -> np.ndarray:
        """(p,) int64, the same for patches at the same place of trees with the same number in `group`, (trees,) int."""
        return _key(group[self.tree].astype(np.int64), self.x.astype(np.int64), self.y.astype(np.int64))

    def weights(self) -> np.ndarray:
        """(n,) float64: the part of its square that each photon stands for; all of a tree sum up to 1."""
        beams, _ = self.kinds()
        share = np.where(beams[:, None], SIMPSON, CELLS) * self.measure[:, None]
        return np.bincount(self.corner.ravel(), share.ravel(), len(self.photons))

    def part(self, rows: np.ndarray) -> Forest:
        """The patches at `rows` and their photons alone, to be refined by themselves."""
        part = copy.copy(self)
        used, corner = np.unique(self.corner[rows], return_inverse=True)
        part.corner = corner.reshape(-1, 9).astype(np.int32)
        part.photons = self.photons.take(used)
        for name in ("tree", "level", "x", "y", "error"):
            setattr(part, name, getattr(self, name)[rows])
        # and those beside and between them, which tell where ways end
        part._key = self._key[used]
        part._rows = np.argsort(part._key, kind="stable")
        part._keys = part._key[part._rows]
        return part

    def _replace(self, chosen, **new):
        keep = np.ones(len(self), bool)
        keep[chosen] = False
        for name, value in new.items():
            setattr(self, name, np.concatenate([getattr(self, name)[keep], value]))

    def _errors(self, old, rows):
        """(m, 4) float32 texels: the farthest that a photon of each child landed from where the parent's nine say."""
        photons = self.photons
        signature = photons.signature[old]
        alike = (signature == signature[:, :1]).all(axis=1) & (photons.signature[rows] == signature[:, :1]).all(axis=1)
        place = np.ascontiguousarray(photons.place[old].transpose(1, 0, 2)).reshape(9, -1)
        off = (_PREDICT @ place).reshape(16, -1, 2) - photons.place[rows].transpose(1, 0, 2)
        off = np.sqrt((off * off).sum(axis=2))
        error = off[_HELD].max(axis=1).T
        return np.where(alike[:, None], error, np.inf).astype(np.float32)

    def _bent(self, corner):
        """(m,) float32 texels, half of how far the middle one of three photons of patches (m, 9) in a row is off: a guess
        at the error where the coarser patch was no beam, so that it says nothing."""
        grid = self.photons.place[corner].reshape(-1, 3, 3, 2)
        off = [grid[:, 0] - 2 * grid[:, 1] + grid[:, 2], grid[:, :, 0] - 2 * grid[:, :, 1] + grid[:, :, 2]]
        return 0.5 * np.sqrt(np.max([(o * o).sum(axis=2).max(axis=1) for o in off], axis=0))

    def _find(self, keys: np.ndarray) -> np.ndarray:
        """(n,) rows of the photons at lattice keys (n,), −1 where there is none."""
        at = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
        return np.where(self._keys[at] == keys, self._rows[at], -1)

    def _add(self, keys: np.ndarray) -> np.ndarray:
        """(n,) rows of the photons at lattice keys (n,); those that are not known are traced."""
        names, back = np.unique(keys, return_inverse=True)
        back = back.reshape(-1)
        rows = np.full(len(names), -1, np.int64)
        if len(self._keys):
            at = np.minimum(np.searchsorted(self._keys, names), len(self._keys) - 1)
            known = self._keys[at] == names
            rows[known] = self._rows[at[known]]
        fresh = names[rows < 0]
        if len(fresh):
            first = len(self._keys)
            tree, x, y = fresh >> 2 * BITS, fresh >> BITS & (1 << BITS) - 1, fresh & (1 << BITS) - 1
            found = self._trace(tree, x / SIDE, y / SIDE)
            self.photons = found if self.photons is None else self.photons.join(found)
            self._key = np.concatenate([self._key, fresh])
            rows[rows < 0] = first + np.arange(len(fresh))
            # two sorted runs: a stable sort merges them
            merged = np.concatenate([self._keys, fresh])
            order = np.argsort(merged, kind="stable")
            self._keys = merged[order]
            self._rows = np.concatenate([self._rows, first + np.arange(len(fresh))])[order]
        return rows[back]


def kinds_of(signature: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of (p, k) signatures: two (p,) bool, all alike and in the atlas; not all alike, and some in the atlas."""
    alike = (signature == signature[:, :1]).all(axis=1)
    lands = (signature > 0) & (signature & 1 == 1)
    return alike & lands[:, 0], ~alike & lands.any(axis=1)


def _key(tree, x, y):
    return tree << 2 * BITS | x << BITS | y
