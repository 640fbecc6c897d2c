"""The paper's way to the panes: random walks from the entries, a virtual light at every vertex, shadow rays
from all of them to all exits (Szécsi & Szirmay-Kalos, section 2.1; after Keller 1997). Kept for comparison.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..rays import Bvh, Tracer
from ..sampling import cosine_hemisphere, frame, hash_uniform
from ..scene import Scene
from ..surface import Patches, SurfaceSamples, sample_triangles, surface_colour
from ..threads import in_threads
from .entries import MAX_ALBEDO, PLACES, Entries

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
"""Rec.709."""

LONGEST = 64
"""Vertices after which a walk ends whatever the dice say."""


class VirtualLights(NamedTuple):
    """entry: (v,) int32 where the walk began. position, normal: (v, 3) float32. flux: (v, 3) float32 reflected
    flux, W, for unit irradiance of the entry."""

    entry: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    flux: np.ndarray


def walk(scene: Scene, patches: Patches, entries: Entries, bvh: Bvh, offset: float, seed: int = 0) -> VirtualLights:
    """One walk from each entry; it goes on with the odds of the albedo's luminance (Russian roulette)."""
    index = np.arange(len(entries))
    samples = entries.places.take(np.arange(len(entries)) * PLACES)
    flux = np.repeat(entries.area[:, None], 3, axis=1).astype(np.float32)
    lights = []
    for step in range(LONGEST):
        albedo = np.minimum(surface_colour(scene, "albedo", samples.triangle, samples.weights), MAX_ALBEDO)
        flux = flux * albedo
        lights.append(VirtualLights(index.astype(np.int32), samples.position, samples.flat, flux))
        odds = albedo @ LUMINANCE
        on = np.flatnonzero(hash_uniform(index, 3 * step, seed + 82) < odds)
        index, samples, flux = index[on], samples.take(on), flux[on] / odds[on, None]
        spin = np.stack([hash_uniform(index, 3 * step + k, seed + 82) for k in (1, 2)], 1)
        local = cosine_hemisphere(spin)
        tangent, bitangent = frame(samples.normal)
        ahead = local[:, :1] * tangent + local[:, 1:2] * bitangent + local[:, 2:] * samples.normal
        hits = bvh.hits(
            np.ascontiguousarray(samples.position + samples.flat * np.float32(offset)),
            np.ascontiguousarray(ahead, np.float32),
        )
        met = np.flatnonzero(hits.triangle >= 0)
        if not len(met):
            break
        piece = hits.triangle[met]
        inside = np.stack([1 - hits.u[met] - hits.v[met], hits.u[met], hits.v[met]], 1)
        weights = np.einsum("nk,nkc->nc", inside, patches.weights[piece])
        index, flux, ahead = index[met], flux[met], ahead[met]
        samples = sample_triangles(scene, patches.parent[piece], weights)
        samples = samples.flipped(np.einsum("nd,nd->n", samples.flat, ahead) > 0)
    return VirtualLights(*(np.concatenate(part) for part in zip(*lights, strict=True)))


def gather_virtual_lights(
    lights: VirtualLights,
    group: np.ndarray,
    groups: int,
    exits: SurfaceSamples,
    tracer: Tracer,
    tick: Callable[[int], None] | None = None,
) -> np.ndarray:
    """(groups, t, 3) float32 irradiance at the exits for unit irradiance of all of a group's entries.

    group: (n,) int32 of each entry. One shadow ray for each pair of light and exit that face each other.
    """
    panes = np.zeros((groups, len(exits), 3), np.float32)
    order = np.argsort(group[lights.entry], kind="stable")
    ends = np.searchsorted(group[lights.entry][order], np.arange(groups + 1))
    lift = np.float32(tracer.offset)
    places = exits.position + exits.flat * lift
    lone = tracer.alone()

    def one(g):
        for k in order[ends[g] : ends[g + 1]]:
            vectors = lights.position[k] + lights.normal[k] * lift - places
            distance2 = np.maximum(np.einsum("nd,nd->n", vectors, vectors), 1e-12)
            leaves = -(vectors @ lights.normal[k])
            arrives = np.einsum("nd,nd->n", vectors, exits.normal)
            rows = np.flatnonzero((leaves > 0) & (arrives > 0))
            seen = lone.visibility(places[rows], vectors[rows])
            seen = seen if seen.ndim == 1 else seen.mean(axis=1)
            form = leaves[rows] * arrives[rows] / (np.pi * distance2[rows] ** 2) * seen
            panes[g, rows] += form[:, None] * lights.flux[k]
        if tick is not None:
            tick((ends[g + 1] - ends[g]) * len(exits))

    in_threads(one, range(groups))
    return panes
