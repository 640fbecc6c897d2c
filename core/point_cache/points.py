"""The point set: where light is stored."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..scene import Scene
from ..surface import SurfaceSamples, sample_triangles
from .darts import first_come


@dataclass(frozen=True)
class PointSet:
    """Points on the surface, on the side that their normals name.

    samples: n places. radius: (n,) float32, m, to the nearest other point at least. ao: (n,) float32 in [0, 1],
    ambient occlusion, 1 where nothing is near. back: (n,) bool, whether a point is on its triangle's reverse.
    """

    samples: SurfaceSamples
    radius: np.ndarray
    ao: np.ndarray
    back: np.ndarray

    def __len__(self) -> int:
        return len(self.radius)

    @property
    def position(self) -> np.ndarray:
        """(n, 3) float32, m."""
        return self.samples.position

    @property
    def normal(self) -> np.ndarray:
        """(n, 3) float32 shading normal."""
        return self.samples.normal

    def take(self, rows: np.ndarray) -> PointSet:
        """The points at `rows`."""
        return PointSet(self.samples.take(rows), self.radius[rows], self.ao[rows], self.back[rows])

    def join(self, more: PointSet) -> PointSet:
        """These points, then `more`."""
        rest = (np.concatenate([getattr(self, n), getattr(more, n)]) for n in ("radius", "ao", "back"))
        return PointSet(self.samples.join(more.samples), *rest)

    def sparser(self, times: float) -> PointSet:
        """Those of the points that keep `times` their radius from each other, with that radius; as many as go."""
        radius = self.radius * np.float32(times)
        kept = first_come(self.samples, radius, self.position.min(axis=0, initial=np.inf))
        return replace(self.take(kept), radius=radius[kept])

    def follow(self, scene: Scene) -> PointSet:
        """The same points on the same triangles of a scene whose objects have moved or bent.

        Raises ValueError where the scene has other triangles than the one that the points were made on.
        """
        if len(self) and int(self.samples.triangle.max()) >= len(scene.triangles):
            raise ValueError("The scene has fewer triangles than the one that the points were made on; make them anew.")
        samples = sample_triangles(scene, self.samples.triangle, self.samples.weights).on_side(scene, self.back)
        return replace(self, samples=samples)
