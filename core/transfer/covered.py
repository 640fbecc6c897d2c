"""Texels that nobody sees: something lies on them, closer than they are wide."""

from __future__ import annotations

from collections.abc import Callable

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

PART, TOGETHER = 65_536, 1_048_576
"""Texels that a thread takes, and those between two ticks."""


def covered(
    scene: Scene, texels: Texels, tracer: Tracer, seed: int = 0, tick: Callable[[int], None] | None = None
) -> np.ndarray:
    """(n,) bool: texels that something opaque covers, whose own light, next to none, would only darken those beside them.

    tracer: of the scene, without `solid`: what is seen through glass is not covered. tick: called now and then with a number
    of rays; an exception that it raises passes through.
    """
    samples = texels.samples
    result = np.zeros(len(texels), bool)

    def part(s):
        reach = np.float32(WITHIN) * _sides(scene, texels, s)
        flat = samples.flat[s]
        origins = samples.position[s] + flat * np.float32(tracer.offset)
        rows = np.flatnonzero(tracer.blocked(origins, flat * reach[:, None]))
        if len(rows):
            turn = turns(flat[rows], rows + s.start, seed)
            stopped = np.ones(len(rows), np.int32)
            for ray in cosine_hemisphere(hammersley_points(RAYS - 1, seed)).astype(np.float32):
                vectors = np.einsum("k,knd->nd", ray, turn) * reach[rows, None]
                stopped += tracer.blocked(np.ascontiguousarray(origins[rows]), vectors)
            result[s][rows] = stopped >= COVERED

    pieces = chunks(len(texels), PART)
    for some in chunks(len(pieces), TOGETHER // PART):
        in_threads(part, pieces[some])
        if tick is not None:
            tick(0)
    return result


def _sides(scene: Scene, texels: Texels, piece: slice) -> np.ndarray:
    """(n,) float32 m, the side of a square as large as each texel of a piece."""
    triangle = texels.samples.triangle[piece]
    flat = scene.atlas_uv[triangle].astype(np.float64) * texels.resolution
    edge, other = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    in_atlas = np.abs(edge[:, 0] * other[:, 1] - edge[:, 1] * other[:, 0])
    world = np.linalg.norm(scene.triangle_cross(triangle).astype(np.float64), axis=1)
    return np.sqrt(world / np.maximum(in_atlas, 1e-12)).astype(np.float32)
