"""The cache that a preview uses: what frames find at surfaces, kept in world space and read back without noise.

Each sample is split over the corners of three lattices, from fine to coarse, by trilinear weights. A read is
(S + k V) / (C + k): S and C are the sum and the count of samples that the fine corners hold, V the mean of the next
coarser ones, made likewise, and k says how many samples that mean is worth (trust.py). So the first frames are smooth,
later ones sharp, and nothing is tuned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..rays import chunks
from ..threads import in_threads
from .keys import CORNERS, lattice_keys, surface_keys
from .lattice import corners
from .layers import Layer, Packed, number_entries
from .levels import levels_of
from .table import MOST, Table
from .trust import EVERY, MEMORY, departure, scatter, worth

PIECE = 1 << 14
"""Samples handled together: their corners stay in the second-level cache. No result depends on threads."""

HANDED_DOWN = 16.0
"""A new entry begins with the mean of the next coarser one, worth at most so many samples."""


TINY = np.float32(1e-12)


@dataclass
class Places:
    """Where in a cache some samples belong. It stays usable while the samples stay where they are.

    count: of samples. slot: (m,) int64 entries that they use; home, tag: (m,) int32 and uint32, by which these are found
    again once the table has put itself in order (`moves`). pieces: for each piece of the samples a layer for each lattice,
    finest first; thin: the first two of them for a few of the samples. share: (m,) float32 sums of weights.
    noise: (2, m) sums that tell how samples scatter.
    """

    count: int
    slot: np.ndarray
    home: np.ndarray
    tag: np.ndarray
    moves: int
    pieces: Sequence[Sequence[Layer]]
    thin: Sequence[Sequence[Layer]]
    share: np.ndarray
    noise: np.ndarray


class Cache:
    """Shading in world space, from many frames.

    channels: 1 (occlusion; 12 bytes an entry) or 3 (colour; 20).
    fine, coarse: cells' edges in footprints of a pixel, coarse ones in growing order; none for a single lattice.
    trust: samples that the mean of each coarse lattice is worth beside what is finer; that of the first is where it
        begins, and then measured unless `measured` is False (see trust.py).
    most: no entry counts more samples than this, so what changed fades in as fast as 1 / most.
    slots: of the table, a power of two; half of them can be in use, then the least recently seen entries go.
    by_normal: whether surfaces that face other ways (of 26) are kept apart.
    seed: another seed, other hashes. threads: None for all.

    The same samples give the same values on one thread or many.
    """

    def __init__(
        self,
        channels: int = 1,
        *,
        fine: float = 2.5,
        coarse: Sequence[float] | None = (8.0, 32.0),
        trust: Sequence[float] = (48.0, 12.0),
        measured: bool = True,
        most: float = MOST,
        slots: int = 1 << 20,
        by_normal: bool = True,
        seed: int = 0,
        threads: int | None = None,
    ):
        if channels < 1:
            raise ValueError(f"A cache holds at least one channel, not {channels}.")
        self.sizes = (fine, *(coarse or ()))
        if fine <= 0 or (np.diff(self.sizes) <= 0).any():
            raise ValueError(f"Cells must have a size, and grow from lattice to lattice: {self.sizes}.")
        self.trust = tuple(trust)[: len(self.sizes) - 1]
        if len(self.trust) < len(self.sizes) - 1:
            raise ValueError(f"{len(self.sizes) - 1} coarse lattices need as many trusts, not {len(self.trust)}.")
        self.measured = measured and len(self.sizes) > 1
        self.most, self.by_normal, self.seed, self.threads = most, by_normal, seed, threads
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

        position: (n, 3) float32, m; float64 where a scene is farther than a million of its cells from the origin.
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

        def again(piece):
            return [(runs, self.table.find(runs.key)) for runs, _ in piece]

        pieces = in_threads(seek, _pieces(count), self.threads)
        found = [layer for piece in pieces for layer in piece]
        used = np.zeros(self.table.slots + 1, bool)
        for _, slot in found:
            used[slot] = True
        if create:
            # before others are made, so that these are not forgotten for them
            self.table.touch(np.flatnonzero(used))
            moves = self.table.moves
            made = self._make_missing(found)
            if moves == self.table.moves:
                used[made] = True
            else:
                pieces = in_threads(again, pieces, self.threads)
                used[:] = False
                for piece in pieces:
                    for _, slot in piece:
                        used[slot] = True
        live = np.flatnonzero(used)
        number = np.empty(self.table.slots + 1, np.int32)
        number[live] = np.arange(len(live), dtype=np.int32)

        def settle(piece):
            layers = []
            for runs, slot in piece:
                entry, own = number_entries(number.take(slot), len(live))
                layers.append(Layer(entry, runs.weight, own.astype(np.int64).take(runs.run, axis=1)))
            thin = [layer.thinned(EVERY) for layer in layers[:2]] if self.measured else []
            return layers, thin, [layer.sums() for layer in layers]

        layers, thin, sums = zip(*in_threads(settle, pieces, self.threads), strict=True)
        share = np.zeros(len(live))
        for piece, parts in zip(layers, sums, strict=True):
            for layer, part in zip(piece, parts, strict=True):
                share[layer.entry] += part
        home, tag = self.table.homes(live), self.table.tag[live]
        noise = np.zeros((2, len(live)))
        return Places(count, live, home, tag, self.table.moves, layers, thin, share.astype(np.float32), noise)

    def _make_missing(self, found):
        """Make entries for all corners that have none, write their slots into `found` in place, and return them."""
        absent = [np.flatnonzero(slot == self.table.nowhere) for _, slot in found]
        keys = np.concatenate([runs.key.reshape(-1)[rows] for (runs, _), rows in zip(found, absent, strict=True)])
        if not len(keys):
            return keys.astype(np.int32)
        new, example, inverse = np.unique(keys, return_index=True, return_inverse=True)
        before = self.table.used
        made = self.table.insert(new)
        of_each = np.split(made[inverse.reshape(-1)], np.cumsum([len(rows) for rows in absent])[:-1])
        for (_, slot), rows, part in zip(found, absent, of_each, strict=True):
            slot.reshape(-1)[rows] = part
        if before:
            self._hand_down(found, absent, example, made)
        return made

    def _hand_down(self, found, absent, example, made):
        """New entries begin with what the nearest entry of the next coarser level has, so that a new level is no cut."""
        cell, level, surface = [], [], []
        for (runs, _), rows in zip(found, absent, strict=True):
            corner, run = np.divmod(rows, max(len(runs.first), 1))
            cell.append(runs.cell[:, run] + CORNERS.T[:, corner])
            level.append(runs.level[run])
            surface.append(runs.surface[run])
        cell = np.concatenate(cell, axis=1)[:, example]
        level, surface = np.concatenate(level)[example], np.concatenate(surface)[example]
        parent = self.table.find(lattice_keys(cell >> 1, level + 1, surface))
        rows = np.flatnonzero((parent != self.table.nowhere) & (made != self.table.nowhere))
        parent = parent[rows]
        count = np.minimum(self.table.counts(parent), np.float32(HANDED_DOWN))
        self.table.put(made[rows], self.table.mean[:, parent], count)

    def holds(self, places: Places) -> bool:
        """Whether the table still has all entries of these places; look them up again where it does not."""
        return bool((self.table.tag[self._slots(places)] == places.tag).all())

    def _slots(self, places):
        if places.moves != self.table.moves:
            places.slot, places.moves = self.table.find_again(places.home, places.tag), self.table.moves
        return places.slot

    def add(self, places: Places, values: np.ndarray) -> None:
        """Add one sample at each place: values (n, channels), or (n,) for one channel."""
        values = np.asarray(values, np.float32)
        if values.size != places.count * self.channels:
            raise ValueError(f"{places.count} places take {self.channels} numbers each; these are {values.shape}.")
        values = values.reshape(places.count, self.channels)
        by_channel = np.ascontiguousarray(values.T)
        slot = self._slots(places)

        def gather(item):
            piece, layers, thin = item
            sums = [np.stack([layer.sums(row[piece]) for row in by_channel]) for layer in layers]
            spread = (
                scatter(thin[1], self._sums(slot[thin[1].entry]), by_channel[:, piece][:, ::EVERY]) if thin else None
            )
            return sums, spread

        items = zip(_pieces(places.count), places.pieces, places.thin, strict=True)
        sums = np.zeros((self.channels, len(slot)))
        places.noise[:] *= MEMORY
        for layers, (parts, spread) in zip(places.pieces, in_threads(gather, items, self.threads), strict=True):
            for layer, part in zip(layers, parts, strict=True):
                sums[:, layer.entry] += part
            if spread is not None:
                places.noise[:, layers[1].entry] += spread
        self.table.tick()
        before = self.table.counts(slot)
        count = before + places.share
        weight = 1 / np.maximum(count, TINY)
        mean = self.table.mean[:, slot] * (before * weight) + sums.astype(np.float32) * weight
        self.table.put(slot, mean, np.minimum(count, self.most))

    def _sums(self, slot):
        """Sums of each channel and counts, of entries."""
        count = self.table.counts(slot)
        return Packed(np.concatenate([self.table.mean[:, slot] * count, count[None]]))

    def read(self, places: Places, otherwise: np.ndarray | float = 0.0) -> np.ndarray:
        """(n, channels) float32 of the places; where nothing is known `otherwise`, a number or (n, channels)."""
        otherwise = np.broadcast_to(np.asarray(otherwise, np.float32), (places.count, self.channels))
        return np.ascontiguousarray(self._read(places, otherwise.T)[0])

    def known(self, places: Places) -> np.ndarray:
        """(n,) float32 count of samples that a read at each place rests on, coarse means as what they are worth."""
        return self._read(places, 0.0)[1]

    def _read(self, places, otherwise):
        sums = self._sums(self._slots(places))
        trust = self._measured_trust(places, sums) if self.measured else None

        def mix(layers):
            total = layers[-1].mixtures(sums.take(layers[-1].entry))
            # from the coarsest on: what is known by then joins the sums of the next as so many samples
            for k in range(len(layers) - 2, -1, -1):
                worth = self.trust[k] if k or trust is None else layers[1].mixtures(trust.take(layers[1].entry))[0]
                total *= np.minimum(total[-1], worth) / np.maximum(total[-1], TINY)
                total += layers[k].mixtures(sums.take(layers[k].entry))
            total[:-1] /= np.maximum(total[-1], TINY)
            return total

        total = np.concatenate(in_threads(mix, places.pieces, self.threads), axis=1)
        return np.where(total[-1] > 0, total[:-1], otherwise).T, total[-1]

    def _measured_trust(self, places, sums):
        noise = (places.noise[0] / np.maximum(places.noise[1], TINY)).astype(np.float32)

        def depart(thin):
            return departure(*thin, sums, noise)

        total = np.zeros((3, len(places.slot)))
        for (_, coarse), part in zip(places.thin, in_threads(depart, places.thin, self.threads), strict=True):
            total[:, coarse.entry] += part
        trust = np.full((1, len(noise)), self.trust[0], np.float32)
        rows = np.flatnonzero(total[2] > 0)
        trust[0, rows] = worth(noise[rows], total[:, rows], self.trust[0])
        return Packed(trust)

    def age(self, factor: float = 0.9) -> None:
        """Every count times `factor`: what is known weighs less beside what comes."""
        self.table.scale_counts(factor)

    def drop(self, count: float = 3.0) -> None:
        """No entry counts more than so many samples: after a lamp or an object moved, what is new soon shows."""
        self.table.limit_counts(count)

    def clear(self) -> None:
        """Forget all values. Places stay usable."""
        self.table.limit_counts(0.0)


def _pieces(count):
    return chunks(count, PIECE) or [slice(0, 0)]
