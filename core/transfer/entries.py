"""Which sides of which patches pass light on, and which places lie buried inside other things.

A side matters when cosine rays that start where light is wanted, or on another side that matters,
land on it. What no such ray finds gets no entry: the outside of a sealed room costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock

import numpy as np

from ..rays import Bvh
from ..scene import Scene
from ..surface import Patches, SurfaceSamples
from .gather import ROWS, Gatherer
from .onward import opaque_part
from .reach import flood

PLACES = 16
"""Places on each entry from which its rays start and where lamps are evaluated."""

PILOT_RAYS = ROWS
"""Of each point; as many as a gather hands over together."""

SCOUTS = 12_000
"""Places, about, on sides newly found from which such rays look for more of them."""

SIGNIFICANT = 0.02
"""A back side gets an entry when its share of the rays exceeds this part of the average side's."""

BURIED = 0.2
"""Part of a place's rays that may meet back sides which no light reaches."""

MAX_ALBEDO = 0.98
"""Bounces between albedo-1 surfaces never end; beyond this the solve would diverge."""


@dataclass(frozen=True)
class Entries:
    """Sides of patches on which lamps may shine.

    places: n × PLACES samples on them, row-major: the first PLACES rows are entry 0's. Where other things stand on
    a patch its places lie on the part that is left, and area counts that part only.
    patch: (n,) int32. back: (n,) bool, the patch's reverse. area: (n,) float64 m². position, normal:
    (n, 3) float32. albedo: (n, 3) float32 in [0, MAX_ALBEDO]. radiosity: (n, 3) float32 emitted, W/m².
    opaque: (n,) float32 part of the light that stays, in (0, 1]; albedo and radiosity are those of this part.
    front_id, back_id: (patches,) int32 entry of each patch's side, n where it has none. hidden: (n,) bool, entries of
    which only a sliver shows: all their places lie inside other things.
    """

    patch: np.ndarray
    back: np.ndarray
    area: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    albedo: np.ndarray
    radiosity: np.ndarray
    opaque: np.ndarray
    front_id: np.ndarray
    back_id: np.ndarray
    places: SurfaceSamples
    hidden: np.ndarray

    def __len__(self) -> int:
        return len(self.patch)

    def span(self) -> np.ndarray:
        """(n,) float32 m: the side of a square whose places lie as far from its middle as those of the entry.

        For slivers it is far more than √area.
        """
        place = self.places.position.reshape(len(self), -1, 3)
        spread = ((place - place.mean(axis=1, keepdims=True)) ** 2).sum(axis=2).mean(axis=1)
        return np.sqrt(6 * spread).astype(np.float32)


def _places(scene: Scene, patches: Patches, patch: np.ndarray, back: np.ndarray, seed: int) -> SurfaceSamples:
    """A random place on each of `patch` (n,), on its reverse where `back` (n,) is set."""
    return patches.sample(scene, patch.astype(np.int32), seed).on_side(scene, back)


def find_entries(
    scene: Scene,
    patches: Patches,
    bvh: Bvh,
    exits: SurfaceSamples,
    offset: float,
    seed: int = 0,
    scouts: int | None = None,
) -> tuple[Entries, np.ndarray, Callable[[SurfaceSamples], np.ndarray]]:
    """Entries reached by light paths that end at `exits`, (exits,) bool: those buried inside other things, and what
    tells the same of any other places.

    A place is buried when it sees back sides that the flood of light does not reach. Fronts do not count: a sealed
    room without a lamp is no solid thing, one may be put there later.

    scouts: as SCOUTS, which None stands for.
    """
    count = len(patches)
    dark = flood(scene, patches, bvh, offset, seed) == 0
    front = 2 * patches.patch
    gatherer = Gatherer(scene, patches, bvh, front, front + 1, 2 * count + 1, offset=offset)
    backside = np.zeros(gatherer.size, np.float32)
    backside[1 : 2 * count : 2] = dark[1::2]

    def pilot(points, salt):
        """Sides seen from places that are not buried, and which places are."""
        buried = np.empty(len(points), bool)
        seen = np.zeros(gatherer.size, np.int64)
        turn = Lock()

        def consume(piece, ids):
            # all rays of a point are one block
            buried[piece] = backside.take(ids).mean(axis=0) > BURIED
            found = np.bincount(ids[:, ~buried[piece]].reshape(-1), minlength=gatherer.size)
            with turn:
                np.add(seen, found, out=seen)

        gatherer.gather(points, PILOT_RAYS, seed + salt, consume)
        return seen[: 2 * count], buried

    total, buried = pilot(exits, 101)
    if buried.all():
        # nothing but insides is wanted, so they count as rooms; their outsides must not lend them light
        backside[:] = 0
        total, _ = pilot(exits, 101)
    reached = _significant(total, patches)
    if not reached.any():
        # an open floor, say, whose rays meet nothing; lamps light its fronts all the same
        reached[front] = True
    fresh = reached
    # what the exits see; then what those sides see, until nothing new turns up
    for step in range(4):
        sides = np.flatnonzero(fresh)
        if not len(sides):
            break
        chosen = np.tile(sides, max(1, (scouts or SCOUTS) // len(sides)))
        points = _places(scene, patches, chosen // 2, chosen % 2 == 1, seed + 11 + step)
        total = total + pilot(points, 200 + step)[0]
        now = _significant(total, patches)
        fresh, reached = now & ~reached, now | reached
    sides = np.flatnonzero(reached)
    each = np.repeat(sides, PLACES)
    places = _places(scene, patches, each // 2, each % 2 == 1, seed + 5)
    hidden = pilot(places, 300)[1].reshape(-1, PLACES)
    return entries_of_sides(scene, patches, sides, places, hidden), buried, lambda points: pilot(points, 400)[1]


def _significant(hits, patches):
    """(2n,) bool sides whose share of the rays matters for their area."""
    area = np.repeat(patches.area, 2)
    used = hits > 0
    if not used.any():
        return used
    average = hits.sum() / area[used].sum()
    return hits > SIGNIFICANT * average * area


def entries_of_sides(
    scene: Scene, patches: Patches, sides: np.ndarray, places: SurfaceSamples, hidden: np.ndarray
) -> Entries:
    """Entries on sides (n,) of patches, 2p the front of patch p and 2p + 1 its back. places: n × PLACES on them; hidden:
    (n, PLACES) bool, those inside other things."""
    count = len(sides)
    all_hidden = hidden.all(axis=1)
    hidden = hidden & ~all_hidden[:, None]
    # places that are left stand in for the hidden ones, in turns
    left = PLACES - hidden.sum(axis=1)
    order = np.argsort(hidden, axis=1, kind="stable")
    pick = np.take_along_axis(order, np.arange(PLACES) % left[:, None], axis=1)
    places = places.take((pick + PLACES * np.arange(count)[:, None]).reshape(-1))
    patch, back = (sides // 2).astype(np.int32), sides % 2 == 1
    front_id = np.full(len(patches), count, np.int32)
    back_id = front_id.copy()
    index = np.arange(count, dtype=np.int32)
    front_id[patch[~back]] = index[~back]
    back_id[patch[back]] = index[back]
    # rays go on with the odds of the mean, so those that stay see only the opaque part
    opaque = opaque_part(scene, patches)[patch, None]
    sign = np.where(back, -1, 1).astype(np.float32)[:, None]
    return Entries(
        patch=patch,
        back=back,
        area=patches.area[patch] * (left / PLACES),
        position=patches.position[patch],
        normal=patches.normal[patch] * sign,
        albedo=np.clip(patches.albedo[patch] / opaque, 0, MAX_ALBEDO).astype(np.float32),
        radiosity=(np.pi * patches.emission[patch] / opaque).astype(np.float32),
        opaque=opaque[:, 0],
        front_id=front_id,
        back_id=back_id,
        places=places,
        hidden=all_hidden,
    )
