"""Elements of entries: where there are more than a matrix can hold, far light is balanced between entries, and only
near light between their elements.

After the substructuring of Cohen et al. 1986 (An Efficient Radiosity Approach for Realistic Image Synthesis), with the
elements on both ends, as in hierarchical radiosity of two levels (Hanrahan et al. 1991). How far light changes within an
entry nobody sees; near light is a list of the elements that each one sees, and of what they send.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..rays import chunks
from ..scene import Scene
from ..surface import Patches, SurfaceSamples
from ..threads import in_threads
from .entries import MAX_ALBEDO, PLACES, Entries, entries_of_sides
from .gather import ROWS as GATHERED
from .gather import Gatherer
from .pairs import far_pairs
from .spots import Seen, Spots
from .transport import Bounces, Transport

NEAR = 3.0
"""Entries within this many times their mean size of each other exchange light element by element."""

ROWS = 16
"""Entries that are handled together."""

TOUCHING = 3.0
"""Elements within this many times their mean size exchange what rays say; between others the geometric term does."""

LOOKS = 4
"""Places of an element between which its light is estimated."""

COLUMNS = 32
"""Of light that is passed on together: what near elements bring then stays in the caches."""


@dataclass(frozen=True)
class Elements:
    """sides: n entries of their own, sorted by the entry that they are part of. entry: (n,) int32 that entry. share: (n,)
    float32 of the entry's area."""

    sides: Entries
    entry: np.ndarray
    share: np.ndarray

    def __len__(self) -> int:
        return len(self.entry)


def find_elements(
    scene: Scene,
    patches: Patches,
    owner: np.ndarray,
    entries: Entries,
    is_buried: Callable[[SurfaceSamples], np.ndarray],
    seed: int = 0,
) -> Elements:
    """The sides of small `patches` that are part of an entry's. owner: (patches,) the entry's patch that each is part
    of (surface.cut_patches). is_buried: as from `find_entries`."""
    side = np.arange(2 * len(patches))
    entry = np.where(side % 2, entries.back_id[owner[side // 2]], entries.front_id[owner[side // 2]])
    side = side[entry < len(entries)]
    entry = entry[entry < len(entries)]
    order = np.argsort(entry, kind="stable")
    side, entry = side[order], entry[order]
    each = np.repeat(side, PLACES)
    places = patches.sample(scene, (each // 2).astype(np.int32), seed + 6).on_side(scene, each % 2 == 1)
    sides = entries_of_sides(scene, patches, side, places, is_buried(places).reshape(-1, PLACES))
    area = np.bincount(entry, sides.area, len(entries))
    return Elements(sides, entry, (sides.area / area[entry]).astype(np.float32))


@dataclass(frozen=True)
class Links:
    """What n elements of m entries exchange. far: (m, m) float32, what of the light between entries is not in `near`.
    factor: (n,) float32, how much of its entry's far light an element receives, of mean 1. starts: (n + 1,) int64, near:
    (p,) int32 and weight: (p,) float32: the elements near[starts[i]:starts[i + 1]] send their `weight` to element i."""

    far: np.ndarray
    factor: np.ndarray
    starts: np.ndarray
    near: np.ndarray
    weight: np.ndarray

    def __len__(self) -> int:
        return len(self.factor)


@dataclass(frozen=True)
class ElementTransport(Bounces):
    """Transport between elements: far light from entry to entry, near light from element to element.

    whole: between the entries. The sky is the same for all elements of an entry.
    """

    elements: Elements
    whole: Transport
    links: Links

    def __len__(self) -> int:
        return len(self.links)

    @cached_property
    def between(self) -> np.ndarray:
        """(n, n) float32: all of it, for tests of a few elements."""
        return self.arriving(np.eye(len(self), dtype=np.float32))

    def arriving(self, values: np.ndarray) -> np.ndarray:
        """(n, c) float32 irradiance of the elements by radiosity `values` (n, c)."""
        values = values.astype(np.float32, copy=False)
        elements, links = self.elements, self.links
        first = np.searchsorted(elements.entry, np.arange(len(links.far)))
        mean = np.empty((len(links.far), values.shape[1]), np.float32)
        result = np.empty(values.shape, np.float32)
        columns = chunks(values.shape[1], COLUMNS)

        def average(s):
            np.add.reduceat(values[:, s] * elements.share[:, None], first, axis=0, out=mean[:, s])

        in_threads(average, columns)
        distant = links.far @ mean

        def bring(s):
            part = np.ascontiguousarray(values[:, s])
            for rows in self._pieces:
                found = distant[:, s].take(elements.entry[rows], axis=0) * links.factor[rows, None]
                mine = slice(links.starts[rows.start], links.starts[rows.stop])
                landed = part.take(links.near[mine], axis=0)
                landed *= links.weight[mine, None]
                count = np.diff(links.starts[rows.start : rows.stop + 1])
                some = np.flatnonzero(count)
                if len(some):
                    at = links.starts[rows.start : rows.stop][some] - mine.start
                    found[some] += np.add.reduceat(landed, at, axis=0)
                result[rows, s] = found

        in_threads(bring, columns)
        return result

    def from_sky(self, values: np.ndarray) -> np.ndarray:
        """(n, c) float32 irradiance by the sky's bins, `values` (k, c) π · radiance."""
        return self.whole.from_sky(values).take(self.elements.entry, axis=0)

    @cached_property
    def _pieces(self) -> list[slice]:
        """Elements whose near light is added up together: about 64K numbers a column."""
        size = max(1, int(65536 * len(self) / max(len(self.links.near), 1)))
        return chunks(len(self), size)

    def leaving(self, rows: np.ndarray | slice, values: np.ndarray) -> np.ndarray:
        """(k, n) float32, values.T @ F[rows]: what `values` (rows, k) of elements make of each one's radiosity."""
        elements, links, rows = self.elements, self.links, np.arange(len(self))[rows]
        entry, place = np.unique(elements.entry[rows], return_inverse=True)
        scaled = values * links.factor[rows, None]
        distant = np.stack([np.bincount(place, scaled[:, k], len(entry)) for k in range(values.shape[1])], 1)
        result = (distant.T.astype(np.float32) @ links.far[entry]).take(elements.entry, axis=1)
        result *= elements.share
        pick, owner = self._near_of(rows)
        near, weight = links.near[pick], links.weight[pick]
        for k in range(values.shape[1]):
            result[k] += np.bincount(near, weight * values[owner, k], len(self))
        return result

    def spots(self, rows: np.ndarray, glow: np.ndarray) -> Spots:
        """As of Transport: of each entry, all of whose elements glow alike, and of each element near to one of `rows`,
        which are in ascending order."""
        elements, links = self.elements, self.links
        own, count = elements.entry, len(links.far)
        faint = np.bincount(own, np.where(glow > 0, 1 / np.maximum(glow, 1e-30), 0), count)
        whole = np.where(faint > 0, 1 / np.maximum(faint, 1e-30), 0).astype(np.float32)
        pick, row = self._near_of(rows)
        single, place = np.unique(links.near[pick], return_inverse=True)
        entry, part = np.unique(own[rows], return_inverse=True)
        seen = Seen(
            far=links.far[entry],
            place=part,
            factor=links.factor[rows],
            group=whole,
            spot=glow[single],
            own=own[single],
            share=elements.share[single],
            row=row,
            single=place,
            weight=links.weight[pick],
        )

        def radiosity(values):
            found = (whole[:, None] * values[:count]).take(own, axis=0)
            found[single] += glow[single, None] * values[count:]
            return found

        return Spots(seen, radiosity)

    def _near_of(self, rows):
        """Places in `near` that belong to elements `rows`, and which of these each belongs to."""
        starts = self.links.starts
        count = starts[rows + 1] - starts[rows]
        owner = np.repeat(np.arange(len(rows)), count)
        return np.arange(len(owner)) + np.repeat(starts[rows] - (np.cumsum(count) - count), count), owner


def link_elements(
    entries: Entries,
    elements: Elements,
    whole: Transport,
    gatherer: Gatherer,
    rays: int,
    seed: int = 0,
    tick: Callable[[int], None] | None = None,
) -> Links:
    """From `whole` between entries: what two near entries exchange is shared among their elements by the geometric term
    between these, which is exact but for shadows' edges within the pair; what elements exchange that all but touch, by
    where `rays` cosine rays of each land. gatherer: names elements."""
    count, sides = len(entries), elements.sides
    beside, beside_from, beside_weight = _touching(elements, gatherer, rays, seed, tick)
    size = entries.span()
    middle = entries.position - entries.position.mean(axis=0)
    first = np.searchsorted(elements.entry, np.arange(count + 1))
    # float32 products of coordinates cancel far from the origin
    position = (sides.places.position - entries.position.mean(axis=0)).reshape(-1, PLACES, 3)[:, :LOOKS]
    normal = sides.places.normal.reshape(-1, PLACES, 3)[:, :LOOKS]
    area = sides.area.astype(np.float32)
    far = whole.between.copy()
    pair, place = np.unique(elements.entry[beside] * np.int64(count) + elements.entry[beside_from], return_inverse=True)
    at = np.divmod(pair, count)
    far[at] = np.maximum(far[at] - np.bincount(place, beside_weight * elements.share[beside], len(pair)), 0)
    span = sides.span()

    def part(rows):
        """Of entries `rows`: element from, element to, weight of each near pair."""
        close = ~far_pairs(middle, size, rows, slice(0, count), NEAR) & (far[rows] > 0)
        here, there = np.nonzero(close)
        here += rows.start
        wide, long = np.diff(first)[here], np.diff(first)[there]
        both = wide * long
        pair = np.repeat(np.arange(len(both)), both)
        run = np.arange(both.sum()) - np.repeat(np.cumsum(both) - both, both)
        to, origin = np.divmod(run, long[pair])
        to, origin = to + first[here[pair]], origin + first[there[pair]]
        looks = [_term(position, normal, area, span, to[s], origin[s]) for s in chunks(len(to), 65536)]
        term = np.concatenate([*looks, np.zeros(0, np.float32)])
        total = np.bincount(pair, term * elements.share[to], len(both))
        # pairs that see each other only round a corner of their own keep to the areas
        kept = total > 0
        exchanged = np.where(kept, far[here, there] / np.maximum(total, 1e-30), 0).astype(np.float32)
        far[here[kept], there[kept]] = 0
        term *= exchanged[pair]
        some = np.flatnonzero(term)
        return to[some].astype(np.int32), origin[some].astype(np.int32), term[some]

    parts = in_threads(part, chunks(count, ROWS))
    parts.append((beside, beside_from, beside_weight))
    to, near, weight = (np.concatenate(values) for values in zip(*parts, strict=True))
    order = np.argsort(to, kind="stable")
    to, near, weight = to[order], near[order], weight[order]
    starts = np.concatenate([[0], np.cumsum(np.bincount(to, minlength=len(elements)))])
    # what is close to an element hides what is far
    own = elements.entry
    brought = np.bincount(to, weight, len(elements))
    # slivers are few rays' and few looks' guess: what they are brought may not multiply light, or the solve diverges
    weight /= np.maximum(brought * MAX_ALBEDO, 1).astype(np.float32)[to]
    brought = np.minimum(brought, 1 / MAX_ALBEDO)
    reach, distant = whole.between.sum(axis=1), far.sum(axis=1)
    factor = np.where(distant[own] > 0, np.maximum(reach[own] - brought, 0) / np.maximum(distant[own], 1e-30), 1)
    factor /= np.maximum(np.bincount(own, factor * elements.share, count), 1e-30)[own]
    # all of it may not multiply light
    factor = np.minimum(factor, np.maximum(1 / MAX_ALBEDO - brought, 0) / np.maximum(distant[own], 1e-30))
    return Links(far, factor.astype(np.float32), starts, near, weight)


def _touching(elements, gatherer, rays, seed, tick):
    """Pairs of elements nearer than TOUCHING times their mean size: (p,) int32 to, (p,) int32 from, (p,) float32 form
    factor."""
    fine, sides = len(elements), elements.sides
    each = max(1, rays // PLACES)
    size = sides.span()
    pending: dict[int, list[np.ndarray]] = {}
    found: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def consume(piece, ids):
        here = pending.setdefault(piece.start, [])
        lands = np.flatnonzero(ids < fine)
        to, origin = (piece.start + lands % ids.shape[1]) // PLACES, ids.reshape(-1)[lands]
        apart = sides.position[to] - sides.position[origin]
        near = np.einsum("nd,nd->n", apart, apart) < (TOUCHING / 2 * (size[to] + size[origin])) ** 2
        here.append(to[near] * np.int64(fine) + origin[near])
        if len(here) == -(-each // GATHERED):
            found[piece.start] = np.unique(np.concatenate(pending.pop(piece.start)), return_counts=True)

    gatherer.gather(sides.places, each, seed + 33, consume, tick)
    names, times = (np.concatenate([found[k][part] for k in sorted(found)]) for part in (0, 1))
    to, origin = np.divmod(names, fine)
    # reciprocity makes one estimate of both directions
    names, place = np.unique(np.concatenate([names, origin * fine + to]), return_inverse=True)
    share = np.bincount(place, np.concatenate([times, times])) / (each * PLACES)
    to, origin = np.divmod(names, fine)
    area = sides.area * sides.opaque
    weight = share * area[origin] / (area[to] + area[origin])
    return to.astype(np.int32), origin.astype(np.int32), weight.astype(np.float32)


def _term(position, normal, area, size, to, origin):
    """(m,) float32 form factors of elements `origin` seen from `to`, if nothing stands between them: means over LOOKS
    places of what a disc of the element's area fills; 0 for those that all but touch."""
    middle = position.mean(axis=1)
    between = middle[origin] - middle[to]
    touch = np.einsum("md,md->m", between, between) < (TOUCHING / 2 * (size[to] + size[origin])) ** 2
    apart = position[origin] - position[to]
    distance2 = np.einsum("mkd,mkd->mk", apart, apart)
    leaves = -np.einsum("mkd,mkd->mk", apart, normal[origin])
    arrives = np.einsum("mkd,mkd->mk", apart, normal[to])
    size = area[origin, None]
    disc = size / np.maximum(distance2 * (np.float32(np.pi) * distance2 + size), 1e-30)
    return np.where(touch, 0, (np.maximum(leaves, 0) * np.maximum(arrives, 0) * disc).mean(axis=1))
