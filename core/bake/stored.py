"""Exits at points: gather where the point cache says, store where texels and vertices find it near enough.

Gathered points hold gradients, which carry their panes to the denser stored points; each stored point keeps one row, in
the panes of its own region, so that a relight knows nothing of gradients.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..point_cache import PointSet, Weights, gather_gradients, lamp_radius, make_points, serve, survey
from .clock import Clock
from .steps import Prepared, own_region

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


def bake_points(made: Prepared, seed: int, clock: Clock) -> Stored:
    """Find both sets of points, gather, and carry the panes to what is stored."""
    budget = made.budget
    clock.start("Points", 5)
    # an entry of which only a sliver looks out from under a thing has its places under that thing
    seen = made.places.take(~made.is_buried(made.places))
    ground = survey(made.scene, made.patches, made.bvh, made.tracer.offset, seed, seen=seen, count=budget.points)
    clock.tick(1, 0)
    radius = lamp_radius(ground, made.gatherer, made.guide, seed + 3)
    clock.tick(1, 0)
    stored = make_points(ground, radius, DENSER * budget.points, seed)
    gathered = stored.sparser(np.sqrt(DENSER))
    clock.tick(1, 0)
    places = made.exits.samples.join(made.vertices.samples)
    stored, shown = serve(stored, places, ground, "affine", seed, made.is_buried)
    clock.tick(1, 0)
    region = own_region(made, stored.samples)
    order = np.argsort(region, kind="stable")
    stored, region = stored.take(order), region[order]
    place = np.empty(len(order), np.int32)
    place[order] = np.arange(len(order), dtype=np.int32)
    shown = Weights(place[shown.point], shown.weight)
    clock.tick(1, 0)
    gathered, carried = serve(gathered, stored.samples, ground, "ward", seed + 2)

    clock.start("Exits", len(gathered) * budget.point_rays)
    rows = _gather(made, gathered, carried, stored.samples, region, seed + 41, clock.tick)
    starts = np.concatenate([[0], np.cumsum(np.bincount(region, minlength=made.modes.regions))])
    texels, vertices = (
        Weights(shown.point[s], shown.weight[s]) for s in np.split(np.arange(len(places)), [len(made.exits)])
    )
    return Stored(stored, starts, rows, texels, vertices, len(gathered))


def _gather(made, points, carried, places, region, seed, tick):
    """(n, c) rows of `places`, each in its own region's panes, from the points that serve it."""
    regions = made.modes.regions
    # a point near a border is wanted in the panes of several regions
    used = carried.weight != 0
    key = carried.point.astype(np.int64) * regions + region[:, None]
    names, pair = np.unique(np.where(used, key, key[:, :1]), return_inverse=True)
    point, table = np.divmod(names, regions)
    rays = made.budget.point_rays
    found = gather_gradients(made.gatherer, points.samples, points.radius, made.tables, rays, seed, tick, point, table)
    steps = carried.steps(points, places)
    pair = pair.reshape(used.shape)
    rows = np.zeros((len(places), made.tables.shape[2]), np.float32)
    for k in range(pair.shape[1]):
        rows += np.einsum("qa,qac->qc", steps[:, k], found[pair[:, k]])
    return rows
