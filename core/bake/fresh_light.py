"""What a bake is judged by: light at a few places, gathered anew, that knows nothing of panes and points.

Most of it is a plain gather of the entries' radiosities, solved without panes for the lamps at hand. That an entry does
not shine evenly, near a lamp or across a shadow's edge, is found along fewer paths, which look at the lamp from where they
really land. Later bounces are softer, and tracing those as well brought nothing but noise.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..lights import irradiance
from ..panes.exits import gather_panes
from ..rays import chunks
from ..sampling import cosine_hemisphere, hammersley_points, hash_uniform
from ..surface import SurfaceSamples, sample_triangles, surface_colour
from ..threads import in_threads
from ..transfer.entries import MAX_ALBEDO
from ..transfer.gather import turns
from .steps import EntryFields, Prepared


def entry_fields(made: Prepared) -> EntryFields:
    """All bounces of the test lamps' light by the transport, without panes; remembered, for the transport is let go."""
    if made.fields is None:
        entries, lamps = made.entries, len(made.test_lamps)
        albedo = np.tile(entries.albedo, (1, lamps))
        radiosity = made.transport.solve(albedo, albedo * np.repeat(made.test_direct, 3, axis=1), 1e-2)
        arriving = made.transport.arriving(radiosity).reshape(len(entries), lamps, 3)
        radiosity = np.pad(radiosity, ((0, made.gatherer.size - len(entries)), (0, 0)))
        made.fields = EntryFields(radiosity.reshape(-1, lamps, 3), arriving)
    return made.fields


def even_light(
    made: Prepared,
    places: SurfaceSamples,
    fields: EntryFields,
    rays: int,
    seed: int,
    tick: Callable[[int], None] | None = None,
) -> np.ndarray:
    """(n, l, 3) float32 indirect irradiance of places, W/m², were every entry to shine evenly."""
    table = fields.radiosity.reshape(1, len(fields.radiosity), -1)
    found = gather_panes(made.gatherer, places, np.array([0, len(places)]), table, rays, seed, tick)
    return found.reshape(len(places), *fields.radiosity.shape[1:])


def uneven_light(made: Prepared, places: SurfaceSamples, fields: EntryFields, rays: int, seed: int) -> np.ndarray:
    """(n, l, 3) float32: what paths bring more, W/m², than if every entry shone evenly."""
    lamps = made.test_lamps
    result = np.empty((len(places), len(lamps), 3), np.float32)
    lattice = hammersley_points(rays, seed)
    tracer, gatherer, entries, patches = made.tracer.alone(), made.gatherer, made.entries, made.patches
    offset = np.float32(tracer.offset)

    def part(piece: slice):
        number = np.arange(piece.start, piece.stop)
        shift = np.stack([hash_uniform(number, k, seed + 3) for k in (1, 2)], 1)
        pattern = cosine_hemisphere(((lattice + shift[:, None]) % 1).reshape(-1, 2)).astype(np.float32)
        turn = turns(places.normal[piece], piece, seed)
        directions = np.einsum("nsk,knd->nsd", pattern.reshape(len(number), rays, 3), turn).reshape(-1, 3)
        flat = np.repeat(places.flat[piece], rays, axis=0)
        origins = np.repeat(places.position[piece], rays, axis=0) + flat * offset
        ids, hits = gatherer.meet(np.ascontiguousarray(origins), np.ascontiguousarray(directions), flat.T)
        # through glass nothing says where a ray landed: as if its entry shone evenly
        known = np.flatnonzero((ids < len(entries)) & (hits.triangle >= 0) & ~gatherer.is_clear(hits.triangle))
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

    in_threads(part, chunks(len(places), max(2048 // rays, 1)))
    return result
