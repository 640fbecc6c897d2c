"""Light under a lamp so near to a surface that its pool is smaller than any entry, by brute force.

What was found is kept in out/bench/cache, so that what is held against it can change without another hour of rays.
"""

from __future__ import annotations

import hashlib

import numpy as np
from lightpanes.core.bake.steps import Prepared
from lightpanes.core.panes.entry_light import EntryLight
from lightpanes.core.panes.exits import gather_panes
from lightpanes.core.rays import Bvh
from lightpanes.core.sampling import spiral
from lightpanes.core.scene import Light
from lightpanes.core.threads import in_threads

from . import harness

CACHE = harness.OUT / "cache"

VIRTUAL = 2048
"""Rays from a lamp, a virtual light at each one's end."""


def brute_force(ready: Prepared, light: Light, seed: int) -> np.ndarray:
    """(t,) irradiance of `ready.exits` under a lamp of grey light so near to a surface that its pool is smaller than any entry.

    The first bounce is summed over all rays from the lamp, each a small disc that shines as wide as its ray is (Keller 1997,
    without his spikes); the later ones, smooth by then, come from the entries.
    """
    made, exits = ready.scene, ready.exits.samples
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    way = np.ascontiguousarray(spiral(VIRTUAL) @ turn.T, np.float32)
    start = np.tile(np.float32(light.position), (VIRTUAL, 1))
    met = Bvh(made.positions[made.triangles]).hits(start, way)
    hit = np.flatnonzero(met.triangle >= 0)
    normal = made.triangle_cross()[met.triangle[hit]].astype(np.float64)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal *= -np.sign(np.einsum("nd,nd->n", normal, way[hit]))[:, None]
    distance = met.distance[hit].astype(np.float64)
    place = start[hit] + way[hit] * distance[:, None] + normal * ready.tracer.offset
    slant = np.maximum(-np.einsum("nd,nd->n", normal, way[hit]), 1e-3)
    disc = 4 * np.pi / VIRTUAL * distance**2 / slant
    shade = np.array([material.albedo[0] for material in made.materials])[made.triangle_material[met.triangle[hit]]]
    sent = light.power[0] / VIRTUAL * shade
    position = (exits.position + exits.flat * np.float32(ready.tracer.offset)).astype(np.float64)
    facing = np.asarray(exits.normal, np.float64)

    lone = ready.tracer.alone()
    # products of coordinates cancel: float64
    beyond, across = np.einsum("vd,vd->v", normal, place), np.einsum("td,td->t", facing, position)

    def part(rows):
        away = normal[rows] @ position.T - beyond[rows, None]
        toward = place[rows] @ facing.T - across
        v, t = np.nonzero((away > 0) & (toward > 0))
        vectors = place[rows][v] - position[t]
        seen = lone.visibility(position[t].astype(np.float32), vectors.astype(np.float32))
        square = np.einsum("nd,nd->n", vectors, vectors)
        value = sent[rows][v] * away[v, t] * toward[v, t] / square / (np.pi * square + disc[rows][v]) * seen
        return np.bincount(t, value, len(position))

    pieces = [slice(k, k + 64) for k in range(0, len(hit), 64)]
    total = np.zeros(len(position))
    for some in in_threads(part, pieces):
        total += some
    direct = (EntryLight(ready.surface, ready.tracer).unit(light) * light.power[0])[:, None].astype(np.float32)
    albedo = ready.entries.albedo[:, :1]
    sent_on = ready.transport.solve(albedo, albedo * direct, 1e-3) - albedo * direct
    table = np.zeros((1, ready.gatherer.size, 1), np.float32)
    table[0, : len(ready.entries)] = sent_on
    whole = np.array([0, len(position)])
    return total + gather_panes(ready.gatherer, exits, whole, table, 256, seed + 5)[:, 0]


def truth(ready: Prepared, light: Light, resolution: int) -> np.ndarray:
    """(2, resolution, resolution) float32 irradiance of the atlas, two halves with noise of their own; kept on disk."""
    made = ready.scene
    digest = hashlib.sha256(repr((VIRTUAL, resolution, ready.budget, light.power.tolist())).encode())
    colours = np.array([material.albedo for material in made.materials])
    for values in (made.positions, made.triangles, made.triangle_material, colours, light.matrix, ready.exits.index):
        digest.update(np.ascontiguousarray(values).tobytes())
    path = CACHE / f"brute_{digest.hexdigest()[:32]}.npz"
    if path.exists():
        with np.load(path, allow_pickle=False) as stored:
            return stored["halves"]
    halves = np.zeros((2, resolution * resolution), np.float32)
    for seed in (0, 1):
        halves[seed, ready.exits.index] = brute_force(ready, light, seed)
    halves = halves.reshape(2, resolution, resolution)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part.npz")
    np.savez_compressed(part, halves=halves)
    part.replace(path)
    return halves
