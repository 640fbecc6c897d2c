"""Vertices as places that take light: for objects that have no texture, and no UVs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene import Scene
from .samples import SurfaceSamples, no_samples, sample_triangles

INWARD = 0.02
"""Part of the way to the triangle's middle by which a place is moved off its vertex, where walls may meet."""


@dataclass(frozen=True)
class Vertices:
    """Places at the vertices of objects that are lit there, one for each normal that a vertex has.

    samples: n places. triangle: (m,) int32 of the scene, all triangles of such objects; corner: (m, 3) int32 the place
    of each of their corners.
    """

    samples: SurfaceSamples
    triangle: np.ndarray
    corner: np.ndarray

    def __len__(self) -> int:
        return len(self.samples)

    def keep(self, rows: np.ndarray) -> Vertices:
        """The places at `rows` only, without the triangles between them."""
        rows = np.asarray(rows, np.int64)
        return Vertices(self.samples.take(rows), self.triangle[:0], self.corner[:0])


def make_vertices(scene: Scene) -> Vertices:
    """Places of all objects that are `at_vertices`; they follow the order of triangles and corners, so the same scene
    has the same places."""
    chosen = np.array([o.at_vertices and o.receives for o in scene.objects], bool)
    triangle = np.flatnonzero(chosen[scene.triangle_object]).astype(np.int32)
    if not len(triangle):
        return Vertices(no_samples(), triangle, np.zeros((0, 3), np.int32))
    vertex = scene.triangles[triangle].reshape(-1).astype(np.int64)
    normal = np.rint(scene.corner_normals[triangle].reshape(-1, 3) * 100).astype(np.int64) + 101
    key = ((vertex * 203 + normal[:, 0]) * 203 + normal[:, 1]) * 203 + normal[:, 2]
    _, first, place = np.unique(key, return_index=True, return_inverse=True)
    weights = np.eye(3, dtype=np.float32)[first % 3] * np.float32(1 - INWARD) + np.float32(INWARD / 3)
    samples = sample_triangles(scene, triangle[first // 3], weights)
    return Vertices(samples, triangle, place.reshape(-1, 3).astype(np.int32))
