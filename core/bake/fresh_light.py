"""What a bake is judged by: light at a few places, gathered anew, that knows nothing of panes and points.

Most of it is a plain gather of the entries' radiosities, solved without panes for the lamps at hand. That an entry does
not shine evenly, near a lamp or across a shadow's edge, is found along fewer paths, which look at the lamp from where they
really land. That shows only where the entry is near: seen from afar its brighter and its darker half make up for each
other, and a path that finds but one of them brings noise. Later bounces are softer, and tracing those as well brought
nothing but noise.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from ..lights import irradiance
from ..panes.regions import starts_of
from ..rays import chunks
from ..sampling import cosine_hemisphere, hammersley_points, hash_uniform
from ..surface import SurfaceSamples, sample_triangles, surface_colour
from ..threads import in_threads
from ..transfer.entries import MAX_ALBEDO
from ..transfer.gather import turns
from .steps import EntryFields, Prepared

NEAR = 4.0
"""Within this many times its size, an entry shines unevenly."""

SETTLED, MOST_BOUNCES = 1e-3, 1000
"""Part of all light that the bounces which are left out may still change."""

TOGETHER, PATHS = 64, 16_384
"""Places of one region that are blended at once; paths that are followed at once."""


def entry_fields(made: Prepared) -> EntryFields:
    """All bounces of the test lamps' light by the transport; remembered, for the transport is let go.

    From what panes say of them, until nothing changes any more. Where much is reflected each bounce changes but little
    of what is wrong, so after two of them a step is taken that leaves the least to change (a minimal residual's).
    """
    if made.fields is None:
        entries, lamps = made.entries, len(made.test_lamps)
        albedo = np.tile(entries.albedo, (1, lamps))
        direct = np.repeat(made.test_direct, 3, axis=1)
        radiosity = made.weights.radiosity_of_white(made.test_direct)
        last = None
        for _ in range(MOST_BOUNCES):
            arriving = made.transport.arriving(radiosity)
            before, radiosity = radiosity, albedo * (direct + arriving)
            step = radiosity - before
            if last is None:
                last = step
                continue
            change, earlier = np.abs(step).sum(axis=0), np.abs(last).sum(axis=0)
            # the rest of a geometric series that falls as its terms do, or as no light falls more slowly
            falls = np.where(change < earlier, change / np.maximum(earlier - change, 1e-30), np.inf)
            left = change * np.minimum(falls, MAX_ALBEDO / (1 - MAX_ALBEDO))
            if (left <= SETTLED * radiosity.sum(axis=0)).all():
                break
            bend = step - last
            radiosity -= step * ((step * bend).sum(axis=0) / np.maximum((bend * bend).sum(axis=0), 1e-30))
            last = None
        radiosity = np.pad(radiosity, ((0, made.gatherer.size - len(entries)), (0, 0)))
        made.fields = EntryFields(radiosity.reshape(-1, lamps, 3), arriving.reshape(-1, lamps, 3))
    return made.fields


def even_light(
    made: Prepared,
    places: SurfaceSamples,
    region: np.ndarray,
    values: np.ndarray,
    rays: int,
    seed: int,
    tick: Callable[[int], None] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """(n, l, 3) indirect irradiance of places, W/m², were every entry to shine evenly, and (n, s) what the panes of regions
    (n,) make of pane weights `values` (regions, panes, s), along the same rays. All float32."""
    fields = entry_fields(made)
    order = np.argsort(region, kind="stable")
    some, region = places.take(order), region[order]
    landed = np.empty((len(some), rays), np.int32)
    done = np.zeros(len(some), np.int64)

    def consume(piece, ids):
        # a chunk's blocks come in order
        at = int(done[piece.start])
        landed[piece, at : at + len(ids)] = ids.T
        done[piece.start] = at + len(ids)

    made.gatherer.gather(some, rays, seed, consume, tick)
    light = fields.radiosity.reshape(len(fields.radiosity), -1)
    even = np.empty((len(some), light.shape[1]), np.float32)
    shown = np.empty((len(some), values.shape[2]), np.float32)
    panes = values.shape[1]

    def blend(piece):
        own = region[piece.start]
        ids, row = np.unique(landed[piece], return_inverse=True)
        row = row.reshape(-1, rays)
        even[order[piece]] = light[ids][row].mean(axis=1)
        shown[order[piece]] = (made.tables[own][ids, :panes] @ values[own])[row].mean(axis=1)

    starts = starts_of(region, len(values))
    pieces = [
        slice(start, min(start + TOGETHER, end))
        for first, end in pairwise(starts)
        for start in range(first, end, TOGETHER)
    ]
    in_threads(blend, pieces)
    return even.reshape(len(some), *fields.radiosity.shape[1:]), shown


def uneven_light(made: Prepared, places: SurfaceSamples, fields: EntryFields, rays: int, seed: int) -> np.ndarray:
    """(n, l, 3) float32: what paths bring more, W/m², than if every entry shone evenly."""
    lamps = made.test_lamps
    result = np.empty((len(places), len(lamps), 3), np.float32)
    lattice = hammersley_points(rays, seed)
    tracer, gatherer, entries, patches = made.tracer.alone(), made.gatherer, made.entries, made.patches
    offset = np.float32(tracer.offset)
    reach = NEAR * entries.span()

    def part(piece: slice):
        number = np.arange(piece.start, piece.stop)
        shift = np.stack([hash_uniform(number, k, seed + 3) for k in (1, 2)], 1)
        pattern = cosine_hemisphere(((lattice + shift[:, None]) % 1).reshape(-1, 2)).astype(np.float32)
        turn = turns(places.normal[piece], piece, seed)
        directions = np.einsum("nsk,knd->nsd", pattern.reshape(len(number), rays, 3), turn).reshape(-1, 3)
        flat = np.repeat(places.flat[piece], rays, axis=0)
        origins = np.repeat(places.position[piece], rays, axis=0) + flat * offset
        ids, hits = gatherer.meet(np.ascontiguousarray(origins), np.ascontiguousarray(directions), flat.T)
        # through glass and off mirrors nothing says where a ray landed: as if its entry shone evenly
        known = np.flatnonzero((ids < len(entries)) & (hits.triangle >= 0) & ~gatherer.lets_on(hits.triangle))
        known = known[hits.distance[known] < reach[ids[known]]]
        own, met = ids[known], hits.triangle[known]
        inside = np.stack([1 - hits.u[known] - hits.v[known], hits.u[known], hits.v[known]], 1)
        weights = np.einsum("nk,nkc->nc", inside, patches.weights[met])
        landed = sample_triangles(made.scene, patches.parent[met], weights).on_side(made.scene, entries.back[own])
        colour = surface_colour(made.scene, "albedo", patches.parent[met], weights) / entries.opaque[own, None]
        albedo = np.minimum(colour, MAX_ALBEDO)
        lifted = landed.position + landed.flat * offset
        more = np.zeros((len(ids), len(lamps), 3), np.float32)
        for column, lamp in enumerate(lamps):
            direct = irradiance(lamp, lifted, landed.normal, tracer.visibility, 1, seed + 5 + column)
            direct = direct[:, None] if direct.ndim == 1 else direct
            more[known, column] = albedo * (direct + fields.arriving[own, column]) - fields.radiosity[own, column]
        result[piece] = more.reshape(len(number), rays, len(lamps), 3).mean(axis=1)

    in_threads(part, chunks(len(places), max(PATHS // rays, 1)))
    return result
