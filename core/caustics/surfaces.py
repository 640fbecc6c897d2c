"""What photons need to know of each triangle, ready to be looked up: shape, optics and media."""

from __future__ import annotations

import numpy as np

from ..rays import Bvh, Transmission
from ..scene import Light, Scene
from .bending import Bending
from .casters import Casters
from .emission import Bounds, Edges, extreme_points
from .groups import smooth_groups

LANDS, PASSES, BENDS = 0, 1, 2
"""What a triangle does to a photon: it scatters it diffusely, lets it straight on, or mirrors and refracts it."""


class Surfaces(Bending):
    """A scene as photons see it.

    bvh: of all triangles. kind: (T,) uint8. group: (T,) int32, the smooth surface. ghost: (T,) bool, lamps shine through
    (no shadow). scatters: (T,) bool, has an albedo. clears: whether any caster lets some light straight on.
    channels: 1 where nothing that photons meet has a colour, else 3.
    """

    def __init__(self, scene: Scene, found: Casters):
        self.transmission = Transmission(scene, found.triangles)
        super().__init__(scene, found.triangles, self.transmission.tinted)
        self.bvh = Bvh(scene.positions, scene.triangles)
        self.casters = found.index
        casts = np.array([o.casts_shadow for o in scene.objects], bool)
        self.ghost = ~casts[self.object]
        # casters that also let light straight on
        self.clears = bool(self.transmission.see_through[found.triangles].any())
        # what passes light on in part and scatters the rest shows it too
        scatters = np.array([m.mapped or max(m.albedo) > 0 for m in scene.materials], bool)
        self.scatters = scatters[scene.triangle_material]
        self.kind = np.where(self.transmission.see_through, PASSES, LANDS).astype(np.uint8)
        self.kind[found.triangles] = BENDS
        self.group = np.zeros(len(self.kind), np.int32)
        self.group[self.rows] = smooth_groups(self.corners, scene.corner_normals[self.rows])
        self._bounds = {}
        for k in self.casters.tolist():
            own = self.of(k)
            places = np.unique(own.reshape(-1, 3), axis=0)
            self._bounds[k] = Edges(own), places, extreme_points(places)
        self.extent = scene.extent

    def bounding(self, caster: int, light: Light) -> Bounds:
        """What bounds a caster as a lamp sees it: few places where the lamp is not near."""
        edges, places, few = self._bounds[int(caster)]
        if light.kind == "SUN":
            return Bounds(few, np.zeros((0, 2, 3), np.float32))
        low, high = few.min(axis=0), few.max(axis=0)
        reach = np.hypot(*light.size) / 2 if light.kind == "AREA" else light.radius
        near = np.linalg.norm(light.position - (low + high) / 2) < np.linalg.norm(high - low) + reach
        return Bounds(places if near else few, edges.near(light.position, reach))

    def through(self, triangle: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(channels, n) float32: the part of light that goes straight on at barycentric places of triangles."""
        return np.ascontiguousarray(self.transmission.at(triangle, u, v).T[: self.channels])
