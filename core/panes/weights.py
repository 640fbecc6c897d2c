"""From the entries' direct irradiance to the panes' weights: Galerkin in mode space.

The indirect field at the entries is y = F x with x = ρ (b + y). In the modes U (orthonormal under √area)
y = U w, so w = A (ρ b) + C w with A = U⁺ F and C = U⁺ F ρ U (U⁺: the modes' dual). A is shared by red, green and
blue. The bounces after the first, (1 − C)⁻¹ C, make smooth fields of low rank: they are kept as Q G. What little the low
rank loses is made good by gathering the field once more with A (final gathering).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..transfer import Entries, Transport
from .modes import Modes
from .regions import starts_of
from .spans import leading

RANK = 192
"""Leading fields kept of all bounces after the first, shared by rooms as their entries are."""

ROOM_RANK = 8
"""Leading fields of a room, at least."""

SKETCH = 32
"""Random mixtures of what the modes leave out: an RMS from so many is right to an eighth."""

TILE = 32
"""Rows of the large operator that lie together in memory; see `PaneWeights._gather`."""


@dataclass(frozen=True)
class PaneWeights:
    """first: (m, n) float32, A; m = regions × panes. spread: (m, r) float32, Q. later: (3, r, m) float32, G.
    region: (n,) int32 of each entry. field: (n, panes) float32, the entry's irradiance by its region's modes.
    albedo: (n, 3) float32. sketch: (2, SKETCH, n) float32, random mixtures of what the modes leave out of each
    entry's field, and of the entries themselves (`of_and_sketch`); None in bakes from before there was such a thing.
    """

    first: np.ndarray
    spread: np.ndarray
    later: np.ndarray
    region: np.ndarray
    field: np.ndarray
    albedo: np.ndarray
    sketch: np.ndarray | None = None

    def of(self, direct: np.ndarray) -> np.ndarray:
        """(m, 3) float32 weights for the entries' direct irradiance (n, 3) float32, W/m²."""
        return self._gather(self.radiosity(direct))

    def of_white(self, direct: np.ndarray) -> np.ndarray:
        """(m, 3 l) float32 weights, a lamp's red, green and blue side by side, of l white lamps with irradiance (n, l)."""
        light = self.radiosity_of_white(direct)
        return self.first @ light

    def radiosity_of_white(self, direct: np.ndarray) -> np.ndarray:
        """(n, 3 l) float32 as by `radiosity`, of l white lamps with irradiance (n, l)."""
        albedo = np.tile(self.albedo, (1, direct.shape[1]))
        direct = np.repeat(direct, 3, axis=1)
        once = self.first @ (albedo * direct)
        again = np.empty((self.spread.shape[1], once.shape[1]), np.float32)
        for c in range(3):
            again[:, c::3] = self.later[c] @ once[:, c::3]
        guess = (once + self.spread @ again).reshape(-1, self.field.shape[1], once.shape[1])
        return albedo * (direct + self._seen(guess))

    def _seen(self, values):
        """(n, s) irradiance of the entries for values (regions, panes, s)."""
        found = np.empty((len(self.region), values.shape[2]), np.float32)
        for r, own in enumerate(values):
            rows = np.flatnonzero(self.region == r)
            found[rows] = self.field[rows] @ own
        return found

    def of_and_sketch(self, direct: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """The weights, and sketches (2, SKETCH, 3) of the field that the modes do not hold and of the radiosity, both linear
        in the light: the root of the sum of a sketch's squares is about the RMS over the area, W/m² (Johnson &
        Lindenstrauss 1984)."""
        light = self.radiosity(direct)
        return self._gather(light), None if self.sketch is None else self.sketch @ light

    def radiosity(self, direct: np.ndarray) -> np.ndarray:
        """(n, 3) float32 that the entries send out under such direct light, all but the last bounce's, W/m²."""
        once = self._gather(self.albedo * direct)
        again = np.stack([self.later[c] @ np.ascontiguousarray(once[:, c]) for c in range(3)], 1)
        guess = (once + self.spread @ again).reshape(-1, self.field.shape[1], 3)
        indirect = np.einsum("nk,nkc->nc", self.field, guess.take(self.region, axis=0))
        return self.albedo * (direct + indirect)

    def mean(self, area: np.ndarray) -> np.ndarray:
        """(m,) what each weight adds to the mean of the field over the entries; area: (n,) m²."""
        k = self.field.shape[1]
        share = (area / area.sum())[:, None] * self.field
        sums = np.zeros((len(self.first) // k, k))
        np.add.at(sums, self.region, share)
        return sums.reshape(-1)

    def _gather(self, light: np.ndarray) -> np.ndarray:
        """(m, 3): A @ light (n, 3), by tiles.

        With three columns the product is bound by memory, and BLAS would spend more time on repacking A than on
        reading it; for small tiles with the long side first it does not repack.
        """
        columns = np.ascontiguousarray(light.T)
        found = np.matmul(columns, self._tiles)
        return found.transpose(0, 2, 1).reshape(-1, 3)[: len(self.first)]

    @cached_property
    def _tiles(self) -> np.ndarray:
        """(m / TILE, n, TILE) float32, `first` rearranged; zero beyond its last row."""
        size, count = self.first.shape
        tiles = np.zeros((-(-size // TILE), count, TILE), np.float32)
        for number, tile in enumerate(tiles):
            rows = self.first[number * TILE : (number + 1) * TILE]
            tile[:, : len(rows)] = rows.T
        return tiles


def make_weights(
    entries: Entries, transport: Transport, modes: Modes, room: np.ndarray, direct: np.ndarray, seed: int = 0
) -> PaneWeights:
    """Weights operator for `modes`.

    room: (n,) int32 of each entry (regions.rooms); no region reaches over two. direct: (n, s) float32 irradiance by some training lamps, from which the later bounces' leading fields are learnt.
    """
    count, k, regions = len(entries), modes.panes, modes.regions
    size = regions * k
    root = np.sqrt(entries.area / entries.area.mean()).astype(np.float32)
    order = np.argsort(modes.region, kind="stable")
    ends = starts_of(modes.region, regions)
    first = np.empty((size, count), np.float32)
    for r in range(regions):
        rows = order[ends[r] : ends[r + 1]]
        first[r * k : r * k + k] = transport.leaving(rows, modes.dual[rows] * root[rows, None])

    def again(values, c):
        """C @ values for modes' weights `values` (m, s): F ρ U in mode space, never formed."""
        field = np.empty((count, values.shape[1]), np.float32)
        for r in range(regions):
            rows = order[ends[r] : ends[r + 1]]
            field[rows] = (modes.basis[rows] / root[rows, None]) @ values[r * k : r * k + k]
        return first @ (entries.albedo[:, c : c + 1] * field)

    once = first @ (entries.albedo.mean(axis=1, keepdims=True) * direct)
    # the second bounce's fields span, all but exactly, those of the bounces that follow it
    fields = np.concatenate([again(once, c) for c in range(3)], 1)
    own = np.zeros(regions, np.int32)
    own[modes.region] = room
    spread = _leading_by_room(fields, np.repeat(own, k))
    later = np.empty((3, spread.shape[1], size), np.float32)
    seen = spread.T @ first
    for c in range(3):
        # Galerkin once more, in the span: q = Qᵀ C w₁ + Qᵀ C Q q
        operator = np.empty((spread.shape[1], size), np.float32)
        for r in range(regions):
            rows = order[ends[r] : ends[r + 1]]
            back = modes.basis[rows] * (entries.albedo[rows, c] / root[rows])[:, None]
            operator[:, r * k : r * k + k] = seen[:, rows] @ back
        # float64: near albedo 1 the system is close to singular
        system = np.eye(len(operator)) - (operator @ spread).astype(np.float64)
        later[c] = np.linalg.solve(system, operator)
    field = modes.basis / root[:, None]
    sketch = _sketch(entries.area, transport, first, modes.region, field, seed)
    return PaneWeights(first, spread, later, modes.region, field, entries.albedo, sketch)


def _sketch(area, transport, first, region, field, seed) -> np.ndarray:
    """(2, SKETCH, n) float32: Ω √a (F − U A), random mixtures of what the modes leave out of each entry's light, and Ω √a."""
    mix = np.random.default_rng(seed).standard_normal((SKETCH, len(area))).astype(np.float32)
    mix *= np.sqrt(area / area.sum() / SKETCH).astype(np.float32)
    k = field.shape[1]
    held = np.zeros((SKETCH, len(first)), np.float32)
    for r in range(len(first) // k):
        rows = np.flatnonzero(region == r)
        held[:, r * k : r * k + k] = mix[:, rows] @ field[rows]
    return np.stack([transport.leaving(slice(None), mix.T) - held @ first, mix])


def _leading_by_room(fields: np.ndarray, room: np.ndarray) -> np.ndarray:
    """(m, r) float32 orthonormal, each column of one room: what is rounded off in one must not shine in another.

    fields: (m, s) float32; room: (m,) int of each row.
    """
    parts = []
    for number in np.unique(room):
        rows = np.flatnonzero(room == number)
        basis = leading(fields[rows], max(round(RANK * len(rows) / len(room)), ROOM_RANK))
        parts.append(np.zeros((len(room), basis.shape[1]), np.float32))
        parts[-1][rows] = basis
    return np.concatenate(parts, 1)
