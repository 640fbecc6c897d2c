"""What photons need to know of each triangle, ready to be looked up: shape, optics and media."""

from __future__ import annotations

import numpy as np

from ..rays import Bvh, Transmission
from ..scene import Light, Scene
from .casters import Casters
from .emission import Bounds, Edges, extreme_points
from .groups import encloses, smooth_groups

LANDS, PASSES, BENDS = 0, 1, 2
"""What a triangle does to a photon: it scatters it diffusely, lets it straight on, or mirrors and refracts it."""

MEDIA = 52
"""Objects whose insides are told apart: as many as a float64 has bits."""


class Surfaces:
    """A scene as photons see it.

    bvh: of all triangles. kind: (T,) uint8. object, group: (T,) int32, group is the smooth surface. flat: (T, 3) float32
    unit geometric normal, outwards as shading has it. ghost: (T,) bool, lamps shine through (no shadow). scatters: (T,)
    bool, has an albedo. clears: whether any caster lets some light straight on.
    channels: 1 where nothing that photons meet has a colour, else 3.
    """

    def __init__(self, scene: Scene, found: Casters):
        self.scene = scene
        self.bvh = Bvh(scene.positions, scene.triangles)
        self.object = scene.triangle_object
        self.casters = found.index
        casts = np.array([o.casts_shadow for o in scene.objects], bool)
        self.ghost = ~casts[self.object]
        self.transmission = Transmission(scene, found.triangles)
        # casters that also let light straight on
        self.clears = bool(self.transmission.see_through[found.triangles].any())
        # what passes light on in part and scatters the rest shows it too
        scatters = np.array([m.mapped or max(m.albedo) > 0 for m in scene.materials], bool)
        self.scatters = scatters[scene.triangle_material]
        self.kind = np.where(self.transmission.see_through, PASSES, LANDS).astype(np.uint8)
        self.kind[found.triangles] = BENDS
        self.flat = _outward(scene)
        rows = np.flatnonzero(found.triangles)
        self._row = np.zeros(len(self.kind), np.int32)
        self._row[rows] = np.arange(len(rows))
        corners = scene.positions[scene.triangles[rows]]
        normals = scene.corner_normals[rows]
        a, b, c = corners.transpose(1, 0, 2)
        na, nb, nc = normals.transpose(1, 0, 2)
        self._shape = np.concatenate([a, b - a, c - a, na, nb - na, nc - na, self.flat[rows]], axis=1)
        self.group = np.zeros(len(self.kind), np.int32)
        self.group[rows] = smooth_groups(corners, normals)
        self._media(found, corners)
        self._colours(found)
        owner = self.object[rows]
        self._bounds = {}
        for k in self.casters.tolist():
            own = corners[owner == k]
            places = np.unique(own.reshape(-1, 3), axis=0)
            self._bounds[k] = Edges(own), places, extreme_points(places)
        self.extent = scene.extent
        # float32 steps grow with the distance from the origin
        sizes = [float(np.ptp(places, axis=0).max()) for _, places, _ in self._bounds.values()]
        self.offset = np.float32(4e-7 * np.abs(scene.positions).max(initial=0.0) + 1e-6 * min(sizes))

    def bounding(self, caster: int, light: Light) -> Bounds:
        """What bounds a caster as a lamp sees it: few places where the lamp is not near."""
        edges, places, few = self._bounds[int(caster)]
        if light.kind == "SUN":
            return Bounds(few, np.zeros((0, 2, 3), np.float32))
        low, high = few.min(axis=0), few.max(axis=0)
        reach = np.hypot(*light.size) / 2 if light.kind == "AREA" else light.radius
        near = np.linalg.norm(light.position - (low + high) / 2) < np.linalg.norm(high - low) + reach
        return Bounds(places if near else few, edges.near(light.position, reach))

    def shape(self, triangle: np.ndarray) -> np.ndarray:
        """(21, n) float32 of triangles (n,) that bend light: first corner, two edges, normal there and its two
        differences, flat normal."""
        return np.ascontiguousarray(self._shape.take(self._row[triangle], axis=0).T)

    def optics(self, triangle: np.ndarray) -> tuple[np.ndarray, ...]:
        """mirror, mirror_edge, glass, gloss: (channels, n) float32 each."""
        material = self.scene.triangle_material[triangle]
        return tuple(table.take(material, axis=1) for table in self._tables)

    def through(self, triangle: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(channels, n) float32: the part of light that goes straight on at barycentric places of triangles."""
        return np.ascontiguousarray(self.transmission.at(triangle, u, v).T[: self.channels])

    def inside(self, mask: np.ndarray) -> np.ndarray:
        """(n,) int number of the medium that fills a place inside all objects of a mask (n,) int64; 0 is air.

        Where objects overlap the smallest one rules (nested dielectrics, Schmidt and Budge 2002).
        """
        return np.frexp(mask.astype(np.float64))[1]

    def _media(self, found, corners):
        scene = self.scene
        owners = self.object[found.triangles]
        size = {k: float(np.linalg.norm(np.ptp(corners[owners == k].reshape(-1, 3), axis=0))) for k in found.index}
        self.bit = np.zeros(len(scene.objects), np.int64)
        self.ior = np.ones(MEDIA + 1, np.float32)
        absorption = np.zeros((MEDIA + 1, 3), np.float32)
        order = sorted(size, key=lambda k: -size[k])
        # (objects,) index of refraction, for those beyond the last bit, which share it
        self.own_ior = np.ones(len(scene.objects), np.float32)
        number = 0
        for k in order:
            used = np.unique(scene.triangle_material[found.triangles & (self.object == k)])
            glassy = [scene.materials[m].optics for m in used if max(scene.materials[m].optics.glass) > 0]
            # what lets nothing in has no inside, but what it reflects depends on its index
            optics = glassy[0] if glassy else scene.materials[used[0]].optics
            self.own_ior[k] = optics.ior
            # rays that enter a sheet never leave it: it has no inside either
            if not glassy or not encloses(corners[owners == k]):
                continue
            number = min(number + 1, MEDIA)
            self.bit[k] = 1 << (number - 1)
            self.ior[number], absorption[number] = optics.ior, optics.absorption
        self._absorption = absorption

    def _colours(self, found):
        scene = self.scene
        blank = (0.0, 0.0, 0.0)
        tables = [
            np.array([getattr(m.optics, name) if m.optics else blank for m in scene.materials], np.float32).T
            for name in ("mirror", "mirror_edge", "glass", "gloss")
        ]
        used = np.unique(scene.triangle_material[found.triangles])
        coloured = any(np.ptp(table[:, used], axis=0).max() > 1e-4 for table in tables)
        coloured |= bool(np.ptp(self._absorption, axis=1).max() > 1e-6) or self.transmission.tinted
        self.channels = 3 if coloured else 1
        pick = slice(None) if coloured else slice(0, 1)
        self._tables = [np.ascontiguousarray(table[pick]) for table in tables]
        self.absorption = np.ascontiguousarray(self._absorption[:, pick].T)


def _outward(scene: Scene) -> np.ndarray:
    """(T, 3) float32 unit normals of the triangles, on the side to which their corners' normals point."""
    cross = scene.triangle_cross().astype(np.float64)
    flat = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)
    facing = np.einsum("td,td->t", flat, scene.corner_normals.sum(axis=1))
    return np.where(facing[:, None] < 0, -flat, flat).astype(np.float32)
