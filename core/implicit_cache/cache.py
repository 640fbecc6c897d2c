"""The cache that a preview uses: what frames find at surfaces, kept in world space and read back without noise.

Each sample is split over the corners of two lattices, a fine and a coarse one, by trilinear weights. A read is
(S + k V) / (C + k): S and C are the sum and the count of samples that the fine corners hold, V the coarse mean, and k
says how many samples that mean is worth. So the first frames are smooth, later ones sharp, and nothing is tuned.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..rays import chunks
from ..threads import in_threads
from .keys import CORNERS, lattice_keys, surface_keys
from .lattice import Layer, corners
from .levels import levels_of
from .table import MOST, Table

PIECE = 1 << 14
"""Samples handled together: their corners stay in the second-level cache. No result depends on threads."""

HANDED_DOWN = 4.0
"""A new entry begins with the mean of the next coarser one, worth at most so many samples."""


TINY = np.float32(1e-12)


class Places(NamedTuple):
    """Where in a cache some samples belong. It stays usable while the samples stay where they are.

    count: of samples. slot: (m,) int32 entries that they use; tag: (m,) uint32, whose they are. pieces: for each piece
    of the samples a layer for the fine lattice and one for the coarse. share: (m,) float32 sums of weights.
    """

    count: int
    slot: np.ndarray
    tag: np.ndarray
    pieces: list[list[Layer]]
    share: np.ndarray


class Cache:
    """Shading in world space, from many frames.

    channels: 1 (occlusion; 12 bytes an entry) or 3 (colour; 20).
    fine, coarse: cells' edges in footprints of a pixel; coarse may be None for a single layer.
    trust: samples that a coarse mean is worth beside a fine one.
    most: no entry counts more samples than this, so what changed fades in as fast as 1 / most.
    slots: of the table, a power of two; four of ten can be in use, then the least recently seen entries go.
    by_normal: whether surfaces that face other ways (of 26) are kept apart.
    seed: another seed, other hashes. threads: None for all.

    The same samples give the same values on one thread or many.
    """

    def __init__(
        self,
        channels: int = 1,
        *,
        fine: float = 2.0,
        coarse: float | None = 8.0,
        trust: float = 48.0,
        most: float = MOST,
        slots: int = 1 << 20,
        by_normal: bool = True,
        seed: int = 0,
        threads: int | None = None,
    ):
        if channels < 1:
            raise ValueError(f"A cache holds at least one channel, not {channels}.")
        if fine <= 0 or (coarse is not None and coarse <= fine):
            raise ValueError(
                f"Cells must be larger than nothing and coarse ones larger than fine ones: {fine}, {coarse}."
            )
        self.sizes = (fine,) if coarse is None else (fine, coarse)
        self.trust, self.most, self.by_normal, self.seed, self.threads = trust, most, by_normal, seed, threads
        self.table = Table(channels, slots)

    @property
    def channels(self) -> int:
        """Numbers of a value."""
        return self.table.channels

    @property
    def occupancy(self) -> float:
        """Share of the table's slots in use."""
        return self.table.used / self.table.slots

    @property
    def entries(self) -> int:
        """Points that hold a value."""
        return self.table.used

    @property
    def bytes_per_entry(self) -> int:
        """Of memory."""
        return self.table.bytes_per_entry

    def frame(
        self,
        position: np.ndarray,
        normal: np.ndarray | None,
        object_id: np.ndarray | None,
        footprint: np.ndarray | float,
        value: np.ndarray,
    ) -> np.ndarray:
        """Add one sample at each place and read there: (n, channels) float32. See `look_up`, `add` and `read`.

        Places that the table has no room for keep the frame's own value.
        """
        places = self.look_up(position, normal, object_id, footprint)
        self.add(places, value)
        return self.read(places, np.asarray(value, np.float32).reshape(len(position), self.channels))

    def look_up(
        self,
        position: np.ndarray,
        normal: np.ndarray | None = None,
        object_id: np.ndarray | None = None,
        footprint: np.ndarray | float = 1.0,
        create: bool = True,
    ) -> Places:
        """Entries for places, made where they are missing.

        position: (n, 3) float32, m; float64 where a scene is farther from the origin than 10,000 of its cells' sizes.
        normal: (n, 3) float32 unit, towards the side that is seen; None where all sides share entries.
        object_id: (n,) integers, None where all objects share them.
        footprint: (n,) or one number, m: what a pixel covers there. Levels are powers of two.
        create: False finds what is there, and makes nothing.
        Neighbours in these arrays should be neighbours in the image, as pixels by rows are.
        """
        position = np.asarray(position)
        count = len(position)
        if position.dtype != np.float64:
            position = position.astype(np.float32, copy=False)
        footprint = np.broadcast_to(np.asarray(footprint, np.float32), count)
        normal = normal if self.by_normal else None

        def seek(piece):
            own = np.ascontiguousarray(position[piece].T)
            facing = None if normal is None else np.ascontiguousarray(normal[piece].T)
            ids = None if object_id is None else object_id[piece]
            surface = surface_keys(facing, ids, self.seed, own.shape[1])
            found = []
            for size in self.sizes:
                runs = corners(own, levels_of(footprint[piece] * np.float32(size)), surface)
                found.append((runs, self.table.find(runs.key)))
            return found

        pieces = in_threads(seek, _pieces(count), self.threads)
        found = [layer for piece in pieces for layer in piece]
        used = np.zeros(self.table.slots + 1, bool)
        for _, slot in found:
            used[slot] = True
        if create:
            # before others are made, so that these are not forgotten for them
            self.table.touch(np.flatnonzero(used))
            used[self._make_missing(found)] = True
        # entries in use get numbers in a row, so that sums and reads touch nothing else
        live = np.flatnonzero(used)
        number = np.empty(self.table.slots + 1, np.int64)
        number[live] = np.arange(len(live))

        def settle(piece):
            layers = [Layer(runs.weight, number[slot].take(runs.run, axis=1)) for runs, slot in piece]
            return layers, sum(layer.sums(None, len(live)) for layer in layers)

        settled = in_threads(settle, pieces, self.threads)
        share = sum((part for _, part in settled), np.zeros(len(live))).astype(np.float32)
        return Places(count, live, self.table.tag[live], [layers for layers, _ in settled], share)

    def _make_missing(self, found):
        """Make entries for all corners that have none, write their slots into `found` in place, and return them."""
        absent = [np.nonzero(slot == self.table.nowhere) for _, slot in found]
        keys = np.concatenate([runs.key[where] for (runs, _), where in zip(found, absent, strict=True)])
        new, example, inverse = np.unique(keys, return_index=True, return_inverse=True)
        before = self.table.used
        made = self.table.insert(new)
        of_each = np.split(made[inverse.reshape(-1)], np.cumsum([len(corner) for corner, _ in absent])[:-1])
        for (_, slot), where, part in zip(found, absent, of_each, strict=True):
            slot[where] = part
        if before and len(new):
            self._hand_down(found, absent, example, made)
        return made

    def _hand_down(self, found, absent, example, made):
        """New entries begin with what the nearest entry of the next coarser level has, so that a new level is no cut."""
        pairs = list(zip(found, absent, strict=True))
        cell = np.concatenate([runs.cell[:, run] + CORNERS[corner].T for (runs, _), (corner, run) in pairs], axis=1)
        level = np.concatenate([runs.level[run] for (runs, _), (_, run) in pairs])
        surface = np.concatenate([runs.surface[run] for (runs, _), (_, run) in pairs])
        parents = lattice_keys(cell[:, example] >> 1, level[example] + 1, surface[example])
        parent = self.table.find(parents)
        rows = np.flatnonzero((parent != self.table.nowhere) & (made != self.table.nowhere))
        parent = parent[rows]
        count = np.minimum(self.table.counts(parent), np.float32(HANDED_DOWN))
        self.table.put(made[rows], self.table.mean[:, parent], count)

    def holds(self, places: Places) -> bool:
        """Whether the table still has all entries of these places; look them up again where it does not."""
        return bool((self.table.tag[places.slot] == places.tag).all())

    def _slots(self, places):
        gone = self.table.tag[places.slot] != places.tag
        return np.where(gone, self.table.nowhere, places.slot) if gone.any() else places.slot

    def add(self, places: Places, values: np.ndarray) -> None:
        """Add one sample at each place: values (n, channels), or (n,) for one channel."""
        values = np.asarray(values, np.float32)
        if values.size != places.count * self.channels:
            raise ValueError(f"{places.count} places take {self.channels} numbers each; these are {values.shape}.")
        values = values.reshape(places.count, self.channels)
        by_channel = np.ascontiguousarray(values.T)
        entries = len(places.slot)

        def gather(item):
            piece, layers = item
            return [sum(layer.sums(row[piece], entries) for layer in layers) for row in by_channel]

        sums = np.zeros((self.channels, entries))
        for part in in_threads(gather, zip(_pieces(places.count), places.pieces, strict=True), self.threads):
            sums += part
        slot = self._slots(places)
        self.table.tick()
        before = self.table.counts(slot)
        count = before + places.share
        weight = 1 / np.maximum(count, np.float32(1e-12))
        mean = self.table.mean[:, slot] * (before * weight) + sums.astype(np.float32) * weight
        self.table.put(slot, mean, np.minimum(count, self.most))

    def read(self, places: Places, otherwise: np.ndarray | float = 0.0) -> np.ndarray:
        """(n, channels) float32 of the places; where nothing is known `otherwise`, a number or (n, channels)."""
        otherwise = np.broadcast_to(np.asarray(otherwise, np.float32), (places.count, self.channels))
        return np.ascontiguousarray(self._read(places, otherwise.T)[0])

    def known(self, places: Places) -> np.ndarray:
        """(n,) float32 count of samples that a read at each place rests on, both layers together."""
        return self._read(places, 0.0)[1]

    def _read(self, places, otherwise):
        slot = self._slots(places)
        count = self.table.counts(slot)
        rows = [*(self.table.mean[:, slot] * count), count]
        # as complex numbers, since two values are fetched in the time of one
        pairs = [a + np.complex64(1j) * b for a, b in zip(rows[0::2], rows[1::2], strict=False)]
        alone = rows[2 * len(pairs) :]

        def mix(layers):
            sums = np.zeros((self.channels + 1, layers[0].weight.shape[1]), np.float32)
            # from the coarsest on: what is known by then joins the sums of the next as so many samples
            for layer in reversed(layers):
                sums *= np.minimum(sums[-1], np.float32(self.trust)) / np.maximum(sums[-1], TINY)
                for k, pair in enumerate(pairs):
                    both = layer.mixtures(pair)
                    sums[2 * k] += both.real
                    sums[2 * k + 1] += both.imag
                for row in alone:
                    sums[-1] += layer.mixtures(row)
            sums[:-1] /= np.maximum(sums[-1], TINY)
            return sums

        parts = in_threads(mix, places.pieces, self.threads)
        sums = np.concatenate(parts, axis=1)
        return np.where(sums[-1] > 0, sums[:-1], otherwise).T, sums[-1]

    def age(self, factor: float = 0.9) -> None:
        """Every count times `factor`: what is known weighs less beside what comes."""
        self.table.scale_counts(factor)

    def drop(self, count: float = 10.0) -> None:
        """No entry counts more than so many samples: after a lamp or an object moved, what is new soon shows."""
        self.table.limit_counts(count)

    def clear(self) -> None:
        """Forget all values. Places stay usable."""
        self.table.limit_counts(0.0)


def _pieces(count):
    return chunks(count, PIECE) or [slice(0, 0)]
