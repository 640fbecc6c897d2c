"""Texels that nobody sees: something lies on them, closer than they are wide."""

from __future__ import annotations

import numpy as np

from ..rays import Tracer, chunks
from ..sampling import cosine_hemisphere, hammersley_points
from ..scene import Scene
from ..surface import Texels
from ..threads import in_threads
from .gather import turns

WITHIN = 0.5
"""Texels' sides within which something covers them."""

RAYS = 16
COVERED = 14
"""Of RAYS, that something must stop, the one straight up among them."""

PART = 65_536


def covered(scene: Scene, texels: Texels, tracer: Tracer, seed: int = 0) -> np.ndarray:
    """(n,) bool: texels that something opaque covers, whose own light, next to none, would only darken those beside them.

    tracer: of the scene, without `solid`: what is seen through glass is not covered.
    """
    samples = texels.samples
    reach = np.float32(WITHIN) * _sides(scene, texels)

    def part(s):
        found = np.zeros(s.stop - s.start, bool)
        flat = samples.flat[s]
        origins = samples.position[s] + flat * np.float32(tracer.offset)
        rows = np.flatnonzero(tracer.blocked(origins, flat * reach[s, None]))
        if len(rows):
            turn = turns(flat[rows], rows + s.start, seed)
            stopped = np.ones(len(rows), np.int32)
            for ray in cosine_hemisphere(hammersley_points(RAYS - 1, seed)).astype(np.float32):
                vectors = np.einsum("k,knd->nd", ray, turn) * reach[s][rows, None]
                stopped += tracer.blocked(np.ascontiguousarray(origins[rows]), vectors)
            found[rows] = stopped >= COVERED
        return found

    return np.concatenate(in_threads(part, chunks(len(texels), PART)) or [np.zeros(0, bool)])


def _sides(scene: Scene, texels: Texels) -> np.ndarray:
    """(n,) float32 m, the side of a square as large as each texel."""
    triangle = texels.samples.triangle
    flat = scene.atlas_uv[triangle].astype(np.float64) * texels.resolution
    edge, other = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    in_atlas = np.abs(edge[:, 0] * other[:, 1] - edge[:, 1] * other[:, 0])
    world = np.linalg.norm(scene.triangle_cross(triangle).astype(np.float64), axis=1)
    return np.sqrt(world / np.maximum(in_atlas, 1e-12)).astype(np.float32)
