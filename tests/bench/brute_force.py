"""Light under a lamp so near to a surface that its pool is smaller than any entry, by brute force.

What was found is kept in out/bench/cache, so that what is held against it can change without another hour of rays.
"""

from __future__ import annotations

import hashlib

import numpy as np
from lightpanes.core.bake.steps import Prepared
from lightpanes.core.panes.entry_light import EntryLight
from lightpanes.core.panes.exits import gather_panes
from lightpanes.core.rays import Bvh, chunks
from lightpanes.core.sampling import cosine_hemisphere, frame, hammersley_points, hash_uniform, spiral
from lightpanes.core.scene import Light
from lightpanes.core.threads import in_threads

from . import harness

CACHE = harness.OUT / "cache"

VIRTUAL = 4096
"""Rays from a lamp, a virtual light at each one's end."""

RAYS = 1024
"""Rays from a texel, that bring what virtual lights next to it are too wide to."""


LEAST_SLANT = 1e-3
"""Cosine at a surface below which a ray from the lamp counts as no more slanting: its disc would have no end."""


def brute_force(ready: Prepared, light: Light, seed: int) -> np.ndarray:
    """(t,) irradiance of `ready.exits` under a point lamp of grey light, in a scene without glass and textures, however
    small the lamp's pool is.

    The first bounce is summed over all rays from the lamp, each a small disc that shines as wide as its ray is (Keller 1997,
    without his spikes). Too near for a disc, in corners and on thin things, rays from the texel bring what it leaves out:
    of a disc's area a, d metres away, the part a / (π d² + a), so that both make up the whole whatever their numbers (Kollig
    and Keller 2004, their bias compensation). The later bounces, smooth by then, come from the entries.
    """
    exits = ready.exits.samples
    place = (exits.position + exits.flat * np.float32(ready.tracer.offset)).astype(np.float32)
    facing = np.ascontiguousarray(exits.normal, np.float32)
    lit = _Lit(ready, light)
    direct = (EntryLight(ready.surface, ready.tracer).unit(light) * light.power[0])[:, None].astype(np.float32)
    albedo = ready.entries.albedo[:, :1]
    sent_on = ready.transport.solve(albedo, albedo * direct, 1e-3) - albedo * direct
    table = np.zeros((1, ready.gatherer.size, 1), np.float32)
    table[0, : len(ready.entries)] = sent_on
    whole = np.array([0, len(place)])
    later = gather_panes(ready.gatherer, exits, whole, table, 256, seed + 5)[:, 0]
    return _of_discs(lit, place, facing, seed) + _of_rays(lit, place, facing, seed) + later


class _Lit:
    """What rays to surfaces need to know of the lamp's light there."""

    def __init__(self, ready, light):
        self.made, self.light = ready.scene, light
        self.tracer, self.bvh = ready.tracer.alone(), Bvh(ready.scene.positions[ready.scene.triangles])
        colours = np.array([material.albedo[0] for material in ready.scene.materials])
        self.albedo = colours[ready.scene.triangle_material]
        cross = ready.scene.triangle_cross().astype(np.float64)
        self.normal = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-30)

    def hits(self, start, way):
        """Of rays that meet something: which, the triangle, its unit normal on their side, the place above it, the distance."""
        met = self.bvh.hits(start, way)
        hit = np.flatnonzero(met.triangle >= 0)
        triangle, distance = met.triangle[hit], met.distance[hit].astype(np.float64)
        normal = self.normal[triangle]
        normal = normal * -np.sign(np.einsum("nd,nd->n", normal, way[hit]))[:, None]
        place = start[hit] + way[hit] * distance[:, None] + normal * self.tracer.offset
        return hit, triangle, normal, place, distance

    def disc(self, distance, slant):
        """m²: of a ray from the lamp, as wide as it is where it lands."""
        return 4 * np.pi / VIRTUAL * distance**2 / np.maximum(slant, LEAST_SLANT)


def _of_discs(lit, position, facing, seed):
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    way = np.ascontiguousarray(spiral(VIRTUAL) @ turn.T, np.float32)
    start = np.tile(np.float32(lit.light.position), (VIRTUAL, 1))
    hit, triangle, normal, place, distance = lit.hits(start, way)
    disc = lit.disc(distance, -np.einsum("nd,nd->n", normal, way[hit]))
    sent = lit.light.power[0] / VIRTUAL * lit.albedo[triangle]
    # products of coordinates cancel: float64
    exact, facing = position.astype(np.float64), facing.astype(np.float64)
    beyond, across = np.einsum("vd,vd->v", normal, place), np.einsum("td,td->t", facing, exact)

    def part(rows):
        away = normal[rows] @ exact.T - beyond[rows, None]
        toward = place[rows] @ facing.T - across
        v, t = np.nonzero((away > 0) & (toward > 0))
        vectors = place[rows][v] - exact[t]
        seen = lit.tracer.visibility(position[t], vectors.astype(np.float32))
        square = np.einsum("nd,nd->n", vectors, vectors)
        value = sent[rows][v] * away[v, t] * toward[v, t] / square / (np.pi * square + disc[rows][v]) * seen
        return np.bincount(t, value, len(position))

    total = np.zeros(len(position))
    for some in in_threads(part, chunks(len(hit), 64)):
        total += some
    return total


def _of_rays(lit, position, facing, seed):
    lattice = hammersley_points(RAYS, seed)
    lamp = lit.light.position.astype(np.float64)
    result = np.zeros(len(position))

    def part(rows):
        index = np.arange(rows.start, rows.stop)
        shift = np.stack([hash_uniform(index, k, seed + 9) for k in (1, 2)], 1)
        local = cosine_hemisphere(((lattice + shift[:, None]) % 1).reshape(-1, 2))
        up = np.repeat(facing[rows], RAYS, axis=0)
        side, across = frame(up)
        way = np.ascontiguousarray(local[:, :1] * side + local[:, 1:2] * across + local[:, 2:] * up, np.float32)
        hit, triangle, normal, place, near = lit.hits(np.repeat(position[rows], RAYS, axis=0), way)
        toward = lamp - place
        distance = np.linalg.norm(toward, axis=1)
        slant = np.einsum("nd,nd->n", normal, toward) / np.maximum(distance, 1e-30)
        # of what a disc there would send, at most all: lamp's irradiance times its area is its share of the power
        disc = lit.disc(distance, slant)
        value = lit.light.power[0] / VIRTUAL * lit.albedo[triangle] / (np.pi * near**2 + disc)
        value *= np.minimum(slant / LEAST_SLANT, 1) * (slant > 0)
        lights = np.flatnonzero(value)
        value[lights] *= lit.tracer.visibility(place[lights].astype(np.float32), toward[lights].astype(np.float32))
        result[rows] = np.bincount(hit // RAYS, value, len(index)) / RAYS

    in_threads(part, chunks(len(position), 64))
    return result


def truth(ready: Prepared, light: Light, resolution: int) -> np.ndarray:
    """(2, resolution, resolution) float32 irradiance of the atlas, two halves with noise of their own; kept on disk."""
    made = ready.scene
    digest = hashlib.sha256(repr((VIRTUAL, RAYS, resolution, ready.budget, light.power.tolist())).encode())
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
