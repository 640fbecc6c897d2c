"""How wrong light is because every entry shines evenly, though a lamp lights it unevenly: told from the lamp alone.

Seen from afar an entry's brighter and its darker half make up for each other. What is wrong near by is, to first order, the
moment of the light that the entry sends out (its strength times how far its middle is from that of the entry) times the
gradient of how it reaches a place. The form factor of places at a distance d falls as d⁻², its gradient as d⁻³.
"""

from __future__ import annotations

import numpy as np

from ..rays import Tracer, chunks
from ..sampling import cosine_hemisphere, frame, hammersley_points, hash_uniform
from ..threads import in_threads
from .entry_light import EntrySurface

RAYS = 64
"""Of an entry, that look for surfaces near it."""

REACH = 6.0
"""How far they look, in the entry's size: the square of a gradient falls with the fourth power more."""


def nearness(surface: EntrySurface, tracer: Tracer, seed: int = 0) -> np.ndarray:
    """(n,) float32 m⁻⁴: the sum over all surfaces of the squared gradient, as a place moves within an entry, of the part of
    its light that arrives there, for a square metre.

    The form factor is K = cos θ cos θ' / π d². With the place K changes by about 4 sin θ K / d, half the square of which
    falls in any one direction. So for cosine rays from the entry the sum is the mean of 8 sin² θ cos θ cos θ' / π d⁴. Nearer
    than an entry's size light mixes again, so d is at least that.
    """
    bvh, triangles = tracer.solid
    scene, count = tracer.scene, len(surface)
    each = len(surface.position) // max(count, 1)
    position = surface.position.reshape(count, each, 3)
    normal = surface.normal.reshape(count, each, 3)
    lattice = hammersley_points(RAYS, seed)
    result = np.zeros(count, np.float32)

    def part(piece):
        index = np.arange(piece.start, piece.stop)
        shift = np.stack([hash_uniform(index, k, seed + 3) for k in (1, 2)], 1)
        local = cosine_hemisphere(((lattice + shift[:, None]) % 1).reshape(-1, 2)).astype(np.float32)
        place = np.arange(RAYS) * each // RAYS
        origin, up = position[piece][:, place].reshape(-1, 3), normal[piece][:, place].reshape(-1, 3)
        side, across = frame(up)
        way = np.ascontiguousarray(local[:, :1] * side + local[:, 1:2] * across + local[:, 2:] * up, np.float32)
        size = np.repeat(surface.size[piece], RAYS)
        hits = bvh.hits(np.ascontiguousarray(origin), way, REACH * size)
        hit = np.flatnonzero(hits.triangle >= 0)
        cross = scene.triangle_cross(triangles[hits.triangle[hit]])
        slant = np.abs(np.einsum("nd,nd->n", cross, way[hit])) / np.maximum(np.linalg.norm(cross, axis=1), 1e-30)
        found = np.zeros(len(origin), np.float32)
        cosine = local[hit, 2]
        weight = 8 / np.pi * (1 - cosine**2) * cosine
        found[hit] = weight * slant / np.maximum(hits.distance[hit], size[hit]) ** 4
        result[piece] = found.reshape(-1, RAYS).mean(axis=1)

    in_threads(part, chunks(count, 1024))
    return result


def sensitivity(surface: EntrySurface, near: np.ndarray) -> np.ndarray:
    """(n, 3) float32 m⁻²: how much of the square of a moment of each entry's light, W²/m², is mean square error of the surface,
    W²/m⁴, red, green and blue. near: (n,) m⁻⁴ as from `nearness`. It is what `unevenness` reads, the same for all lamps."""
    area = surface.size.astype(np.float64) ** 2
    share = area**2 * near / max(area.sum(), 1e-30)
    return (share[:, None] * surface.albedo.astype(np.float64) ** 2).astype(np.float32)


def unevenness(moment: np.ndarray, sensitive: np.ndarray) -> np.ndarray:
    """(3,) RMS over the surface, W/m² for each W, of what even entries make wrong, red, green and blue.

    moment: (n, 3) m⁻¹, of a lamp's irradiance on each entry (`EntryLight.look`). sensitive: as from `sensitivity`.
    """
    return np.sqrt(np.einsum("nd,nd->n", moment, moment) @ sensitive)
