"""The cache that a preview uses: what frames find at surfaces, kept in world space and read back without noise.

Each sample is split over the corners of its cell in a fine lattice, and what these gain over those of a coarser one, and
so on, by trilinear weights. At each fine corner is known (S + k V) / (C + k): S and C are the sum and the count of its
samples, V the mean of the coarser corners around it, made likewise, and k says how many samples that mean is worth
(trust.py). A read mixes what is known at the corners around. So the first frames are smooth, later ones sharp, and
nothing is tuned.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..allocator import keep_freed
from ..rays import chunks
from ..threads import in_threads
from .keys import PARTS, surface_tags
from .levels import levels_of
from .places import Places, find_piece, make_missing
from .table import MOST, Table
from .trust import MEMORY, departure, scatter, worth

TINY = np.float32(1e-12)

PIECE = 1 << 16
"""Samples handled together: few enough for all threads to have some. No result depends on how many threads there are."""


class Cache:
    """Shading in world space, from many frames.

    channels: 1 (occlusion; 12 bytes an entry) or 3 (colour; 20).
    fine, coarse: cells' edges in footprints of a pixel, each a power of two times the finer one; no coarse ones for a
        single lattice.
    trust: samples that the mean of each coarse lattice is worth beside what is finer; that of the first is where it
        begins, and then measured unless `measured` is False (see trust.py).
    most: no entry counts more samples than this, so what changed fades in as fast as 1 / most.
    slots: of the table, a power of two; half of them can be in use, then the least recently seen entries go.
    by_normal: whether surfaces that face other ways, by some 16°, are kept apart.
    seed: another seed, other hashes. threads: None for all.

    The same samples give the same values on one thread or many.
    """

    def __init__(
        self,
        channels: int = 1,
        *,
        fine: float = 3.5,
        coarse: Sequence[float] | None = (14.0, 56.0),
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
        sizes = np.array([fine, *(coarse or ())])
        if fine <= 0 or (sizes[1:] <= sizes[:-1]).any():
            raise ValueError(f"Cells must have a size, and grow from lattice to lattice: {sizes.tolist()}.")
        octaves = np.log2(sizes[1:] / sizes[:-1])
        if (octaves != np.rint(octaves)).any():
            raise ValueError(f"Cells must grow by powers of two from lattice to lattice: {sizes.tolist()}.")
        self.fine, self.octaves = fine, tuple(octaves.astype(int).tolist())
        self.trust = tuple(trust)[: len(octaves)]
        if len(self.trust) < len(octaves):
            raise ValueError(f"{len(octaves)} coarse lattices need as many trusts, not {len(self.trust)}.")
        self.measured = measured and len(octaves) > 0
        self.most, self.by_normal, self.seed, self.threads = most, by_normal, seed, threads
        keep_freed()
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

        def find(piece):
            own = np.ascontiguousarray(position[piece].T)
            facing = None if normal is None else np.ascontiguousarray(normal[piece].T)
            ids = None if object_id is None else object_id[piece]
            tags = surface_tags(facing, ids, self.seed, own.shape[1])
            level = levels_of(footprint[piece] * np.float32(self.fine))
            return find_piece(self.table, own, level, tags, self.octaves, self.measured)

        places = Places(count, in_threads(find, _pieces(count), self.threads), self.table.moves)
        if create:
            make_missing(self.table, places)
        return places

    def holds(self, places: Places) -> bool:
        """Whether the table still has all entries of these places; look them up again where it does not."""
        places.find_again(self.table)
        return places.whole

    def add(self, places: Places, values: np.ndarray) -> None:
        """Add one sample at each place: values (n, channels), or (n,) for one channel."""
        values = np.asarray(values, np.float32)
        if values.size != places.count * self.channels:
            raise ValueError(f"{places.count} places take {self.channels} numbers each; these are {values.shape}.")
        values = values.reshape(places.count, self.channels)
        places.find_again(self.table)

        def gather(item):
            rows, piece = item
            sums, total = [], np.ascontiguousarray(values[rows].T)
            for tier in piece.tiers:
                total = tier.shares.sums(total)
                sums.append(total)
            if self.measured:
                finest = piece.tiers[0]
                known = self.table.sums(finest.slot)
                piece.noise *= MEMORY
                piece.noise += scatter(sums[0], finest.share, known, piece.nearest, piece.noise.shape[1])
            return sums

        self.table.tick()
        items = zip(_pieces(places.count), places.pieces, strict=True)
        gathered = in_threads(gather, items, self.threads)

        def keep(part):
            # pieces and tiers share entries, so these are kept one after another; parts do not
            for piece, sums in zip(places.pieces, gathered, strict=True):
                for tier, own in zip(piece.tiers, sums, strict=True):
                    rows = tier.shares.part(part)
                    self.table.merge(tier.slot[rows], own[:, rows], tier.share[rows], self.most)

        in_threads(keep, range(PARTS), self.threads)

    def read(self, places: Places, otherwise: np.ndarray | float = 0.0) -> np.ndarray:
        """(n, channels) float32 of the places; where nothing is known `otherwise`, a number or (n, channels)."""
        result = np.empty((places.count, self.channels), np.float32)
        otherwise = np.broadcast_to(np.asarray(otherwise, np.float32), result.shape)

        def show(rows, total):
            np.divide(total[:-1].T, np.maximum(total[-1], TINY)[:, None], out=result[rows])
            nothing = np.flatnonzero(total[-1] <= 0)
            result[rows][nothing] = otherwise[rows][nothing]

        self._read(places, show)
        return result

    def known(self, places: Places) -> np.ndarray:
        """(n,) float32 count of samples that a read at each place rests on, coarse means as what they are worth."""
        return np.concatenate(self._read(places, lambda _rows, total: total[-1]))

    def _read(self, places, show):
        """Of each piece what `show` makes of its slice and (channels + 1, n) float32 sums and counts of what is known."""
        places.find_again(self.table)
        items = zip(_pieces(places.count), places.pieces, strict=True)
        return in_threads(lambda item: show(item[0], self._mix(item[1])), items, self.threads)

    def _mix(self, piece):
        tiers = piece.tiers
        total = self.table.sums(tiers[-1].slot)
        # from the coarsest on: what is known by then joins the sums of the next as so many samples
        for k in range(len(tiers) - 2, -1, -1):
            own, above = self.table.sums(tiers[k].slot), tiers[k + 1].shares.mixtures(total)
            worth = self.trust[k]
            if k == 0 and self.measured:
                worth = self._measured_trust(piece, own, above)
            above *= np.minimum(above[-1], worth) / np.maximum(above[-1], TINY)
            own += above
            total = own
        return tiers[0].shares.mixtures(total)

    def _measured_trust(self, piece, own, above):
        noise = piece.noise[0] / np.maximum(piece.noise[1], TINY)
        total = departure(own, piece.tiers[0].share, above, noise, piece.nearest)
        trust = np.full(piece.tiers[1].shares.entries, self.trust[0], np.float32)
        trust[piece.near] = worth(noise, total, self.trust[0])
        return piece.tiers[1].shares.mixtures(trust[None])[0]

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
