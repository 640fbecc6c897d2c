"""Exits at points: gather where the point cache says, store where texels and vertices find it near enough.

Gathered points hold gradients, which carry their panes to the denser stored points; each stored point keeps one row, in
the panes of its own region, so that a relight knows nothing of gradients.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..panes.regions import starts_of
from ..planner import Settings
from ..point_cache import Ground, PointSet, Weights, gather_gradients, lamp_radius, make_points, serve, survey
from ..point_cache.gradients import POINTS
from ..rays import chunks
from ..surface import Texels
from ..threads import in_threads
from ..transfer import Begun
from ..transfer.entries import PLACES
from .clock import Clock
from .kept import digest
from .steps import Prepared, gather_in_time, own_region

DENSER = 3
"""Stored points for each gathered one: what they alone lose is then less than what the gathered ones do."""


@dataclass(frozen=True)
class Stored:
    """points: n stored points, sorted by region; starts: (regions + 1,) where each region's begin. rows: (n, c) float32
    panes and steady shares of each. texels, vertices: weights of the points for each of the bake's texels and vertices;
    texels inside solid things have none. gathered: how many points were gathered."""

    points: PointSet
    starts: np.ndarray
    rows: np.ndarray
    texels: Weights
    vertices: Weights
    gathered: int


def bake_points(
    made: Prepared, settings: Settings, clock: Clock, guide: Callable[[Ground], np.ndarray] | None = None
) -> Stored:
    """Find both sets of points, gather, and carry the panes to what is stored.

    guide: from the ground to a radius at its coarse points, in any unit, in place of what lamps ask for.
    """
    seed = settings.seed
    clock.start("Points", 4)
    ground, radius = _survey(made, seed, guide)
    clock.tick(1, 0)
    # darts are counted so that they may be cancelled
    stored = make_points(ground, radius, DENSER * made.budget.points, seed, lambda _: clock.tick(0))
    gathered = stored.sparser(np.sqrt(DENSER))
    clock.tick(1, 0)
    places = made.exits.samples
    if len(made.vertices):
        places = places.join(made.vertices.samples)
    stored, shown = serve(stored, places, ground, "affine", seed, made.is_buried)
    clock.tick(1, 0)
    region = own_region(made, stored.samples)
    order = np.argsort(region, kind="stable")
    stored, region = stored.take(order), region[order]
    place = np.empty(len(order), np.int32)
    place[order] = np.arange(len(order), dtype=np.int32)
    shown = Weights(place[shown.point], shown.weight)
    gathered, carried = serve(gathered, stored.samples, ground, "ward", seed + 2)
    rows = _gather(made, gathered, carried, stored.samples, region, settings, clock)
    texels = len(made.exits)
    starts = starts_of(region, made.modes.regions)
    return Stored(stored, starts, rows, shown.take(slice(texels)), shown.take(slice(texels, None)), len(gathered))


def spread_to_texels(made: Prepared, settings: Settings, clock: Clock) -> tuple[Texels, Stored]:
    """A pane atlas, as engines read it, from the same gather: every texel gets a row of its own.

    Returns the valid texels, sorted by region, and their rows; each texel is served by its own row alone.
    """
    seed = settings.seed
    clock.start("Points", 3)
    ground, radius = _survey(made, seed)
    clock.tick(1, 0)
    gathered = make_points(ground, radius, made.budget.points, seed, lambda _: clock.tick(0))
    clock.tick(1, 0)
    gathered, carried = serve(gathered, made.exits.samples, ground, "ward", seed, made.is_buried)
    kept = np.flatnonzero(~carried.orphan)
    texels = made.exits.keep(kept)
    region = own_region(made, texels.samples)
    order = np.lexsort((texels.index, region))
    texels, region, carried = texels.keep(order), region[order], carried.take(kept[order])
    rows = _gather(made, gathered, carried, texels.samples, region, settings, clock)
    itself = Weights(np.arange(len(texels), dtype=np.int32)[:, None], np.ones((len(texels), 1), np.float32))
    starts = starts_of(region, made.modes.regions)
    return texels, Stored(gathered, starts, rows, itself, itself.take(slice(0)), len(gathered))


def _survey(made, seed, guide=None):
    """The ground of all point sets, and the radius that its guide, or else lamps, ask for on it."""
    entries = made.entries
    # an entry of which only a sliver looks out from under a thing has its places under that thing
    seen = entries.places.take(np.repeat(~entries.hidden, PLACES))
    count = made.budget.points
    ground = survey(made.scene, made.patches, made.bvh, made.tracer.offset, seed, seen=seen, count=count)
    if guide is not None:
        return ground, guide(ground)
    return ground, lamp_radius(ground, made.gatherer, made.guide, seed + 3)


def _gather(made, points, carried, places, region, settings, clock):
    """(n, c) rows of `places`, each in its own region's panes, from the points that serve it."""
    regions = made.modes.regions
    # a point near a border is wanted in the panes of several regions
    used = carried.weight != 0
    key = carried.point.astype(np.int64) * regions + region[:, None]
    names, pair = np.unique(np.where(used, key, key[:, :1]), return_inverse=True)
    point, table = np.divmod(names, regions)

    def gather(rays, seed):
        # one scene can be given several sets of points
        begun = made.kept.part(f"exits {rays} {digest(points.position, names).hex()}", Begun)
        clock.skip(rays * len(begun.done) * POINTS)
        return gather_gradients(
            made.gatherer, points.samples, points.radius, made.tables, rays, seed, clock.tick, point, table, begun
        )

    found = gather_in_time(made, settings, clock, "point_rays", len(points), gather)
    pair = pair.reshape(used.shape)
    rows = np.zeros((len(places), made.tables.shape[2]), np.float32)

    def carry(s):
        steps = carried.take(s).steps(points, places.take(s))
        for k in range(pair.shape[1]):
            rows[s] += np.einsum("qa,qac->qc", steps[:, k], found[pair[s, k]])

    in_threads(carry, chunks(len(places)))
    return rows
