"""Surfaces that mirror and refract, ready to be looked up: their shape, optics and the media that they enclose; and what
they do to a ray."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..optics import fresnel, reflect, refract
from ..scene import Scene
from ..vectors import dot, normalised
from .groups import encloses

MEDIA = 52
"""Objects whose insides are told apart: as many as a float64 has bits."""

_F = np.float32


class Crossing(NamedTuple):
    """Rays at surfaces. place, normal, flat: (3, n) float32, the smooth and the flat normal against the ray. cosine: (n,) of
    the ray to the normal. enters: (n,) bool, meets the outside. within, without: (n,) int64 masks of the objects around
    the inside and the outside. before, behind: (n,) int medium on the ray's side and on the other. relative: (n,)
    refractive index before over that behind."""

    place: np.ndarray
    normal: np.ndarray
    flat: np.ndarray
    cosine: np.ndarray
    enters: np.ndarray
    within: np.ndarray
    without: np.ndarray
    before: np.ndarray
    behind: np.ndarray
    relative: np.ndarray


class Bending:
    """Triangles of a scene that mirror or refract, (T,) bool, each of a material with optics.

    bends: (T,) bool, they. object: (T,) int32. flat: (T, 3) float32 unit geometric normal, outwards as shading has it. rows: (k,) the triangles.
    corners: (k, 3, 3) float32, m. owners: their objects. bit: (objects,) int64 of each one's inside, 0 where it has none.
    ior, absorption: of media, (media,) and (channels, media) float32. channels: 1 where none has a colour, else 3.
    """

    def __init__(self, scene: Scene, triangles: np.ndarray, tinted: bool = False):
        self.scene = scene
        self.bends = triangles
        self.object = scene.triangle_object
        self.flat = _outward(scene)
        self.rows = rows = np.flatnonzero(triangles)
        self._row = np.zeros(len(triangles), np.int32)
        self._row[rows] = np.arange(len(rows))
        self.corners = scene.positions[scene.triangles[rows]]
        normals = scene.corner_normals[rows]
        a, b, c = self.corners.transpose(1, 0, 2)
        na, nb, nc = normals.transpose(1, 0, 2)
        self._shape = np.concatenate([a, b - a, c - a, na, nb - na, nc - na, self.flat[rows]], axis=1)
        self.owners = np.unique(self.object[rows])
        self._media(triangles)
        self._colours(tinted)
        # float32 steps grow with the distance from the origin
        sizes = [float(np.ptp(self.of(k).reshape(-1, 3), axis=0).max()) for k in self.owners]
        self.offset = np.float32(4e-7 * np.abs(scene.positions).max(initial=0.0) + 1e-6 * min(sizes))

    def of(self, owner: int) -> np.ndarray:
        """(k, 3, 3) float32 corners, m, of an object's triangles among them."""
        return self.corners[self.object[self.rows] == owner]

    def shape(self, triangle: np.ndarray) -> np.ndarray:
        """(21, n) float32 of triangles (n,) that bend light: first corner, two edges, normal there and its two
        differences, flat normal."""
        return np.ascontiguousarray(self._shape.take(self._row[triangle], axis=0).T)

    def optics(self, triangle: np.ndarray) -> tuple[np.ndarray, ...]:
        """mirror, mirror_edge, glass, gloss: (channels, n) float32 each."""
        material = self.scene.triangle_material[triangle]
        return tuple(table.take(material, axis=1) for table in self._tables)

    def inside(self, mask: np.ndarray) -> np.ndarray:
        """(n,) int number of the medium that fills a place inside all objects of a mask (n,) int64; 0 is air.

        Where objects overlap the smallest one rules (nested dielectrics, Schmidt and Budge 2002).
        """
        return np.frexp(mask.astype(np.float64))[1]

    def _media(self, triangles):
        scene = self.scene
        size = {k: float(np.linalg.norm(np.ptp(self.of(k).reshape(-1, 3), axis=0))) for k in self.owners.tolist()}
        self.bit = np.zeros(len(scene.objects), np.int64)
        self.ior = np.ones(MEDIA + 1, np.float32)
        absorption = np.zeros((MEDIA + 1, 3), np.float32)
        order = sorted(size, key=lambda k: -size[k])
        # (objects,) index of refraction, for those beyond the last bit, which share it
        self.own_ior = np.ones(len(scene.objects), np.float32)
        number = 0
        for k in order:
            used = np.unique(scene.triangle_material[triangles & (self.object == k)])
            glassy = [scene.materials[m].optics for m in used if max(scene.materials[m].optics.glass) > 0]
            # what lets nothing in has no inside, but what it reflects depends on its index
            optics = glassy[0] if glassy else scene.materials[used[0]].optics
            self.own_ior[k] = optics.ior
            # rays that enter a sheet never leave it: it has no inside either
            if not glassy or not encloses(self.of(k)):
                continue
            number = min(number + 1, MEDIA)
            self.bit[k] = 1 << (number - 1)
            self.ior[number], absorption[number] = optics.ior, optics.absorption
        self._absorption = absorption

    def _colours(self, tinted):
        scene = self.scene
        blank = (0.0, 0.0, 0.0)
        tables = [
            np.array([getattr(m.optics, name) if m.optics else blank for m in scene.materials], np.float32).T
            for name in ("mirror", "mirror_edge", "glass", "gloss")
        ]
        used = np.unique(scene.triangle_material[self.rows])
        coloured = any(np.ptp(table[:, used], axis=0).max() > 1e-4 for table in tables)
        coloured |= bool(np.ptp(self._absorption, axis=1).max() > 1e-6) or tinted
        self.channels = 3 if coloured else 1
        pick = slice(None) if coloured else slice(0, 1)
        self._tables = [np.ascontiguousarray(table[pick]) for table in tables]
        self.absorption = np.ascontiguousarray(self._absorption[:, pick].T)

    def crossing(self, triangle, u, v, direction, mask, glassy) -> Crossing:
        """Rays in `direction`, (3, n), at barycentric places of triangles that bend light. mask: (n,) int64 of the objects
        around the rays. glassy: (n,) bool, lets light in."""
        shape = self.shape(triangle)
        place = shape[0:3] + shape[3:6] * u + shape[6:9] * v
        normal = normalised(shape[9:12] + shape[12:15] * u + shape[15:18] * v)
        flat = shape[18:21]
        owner = self.object[triangle]
        bit = self.bit[owner]
        enters = dot(direction, flat) < 0
        turn = np.where(enters, _F(1), _F(-1))
        normal, flat = normal * turn, flat * turn
        cosine = -dot(direction, normal)
        grazing = cosine <= 1e-5
        if grazing.any():
            # smooth normals of a coarse mesh turn away before the surface does
            normal = np.where(grazing, flat, normal)
            cosine = -dot(direction, normal)
        within = mask | bit
        without = mask & ~bit
        before, behind = self.inside(np.where(enters, mask, within)), self.inside(np.where(enters, within, without))
        # what encloses nothing has no inside that a mask could tell: the side that is met says where the glass is
        sheet = (bit == 0) & glassy
        before_ior = np.where(sheet & ~enters, self.own_ior[owner], self.ior[before])
        behind_ior = np.where(enters & (bit == 0), self.own_ior[owner], self.ior[behind])
        return Crossing(
            place, normal, flat, cosine, enters, within, without, before, behind, before_ior / behind_ior
        )  # fmt: skip


def onward(direction, at: Crossing, inner, mirrors, straight) -> np.ndarray:
    """(3, n) unit directions in which rays go on: mirrored, straight on, or else refracted. inner: (n,) cosine of the
    refracted ray, as from `fresnel`. mirrors, straight: (n,) bool."""
    passed = np.where(straight, direction, refract(direction, at.normal, at.cosine, inner, at.relative))
    ahead = np.where(mirrors, reflect(direction, at.normal), passed)
    # a smooth normal may send the ray to the wrong side of the flat face; the face's own does not
    wrong = ((dot(ahead, at.flat) > 0) != mirrors) & (mirrors | ~straight)
    if wrong.any():
        steep = -dot(direction[:, wrong], at.flat[:, wrong])
        inner_flat = fresnel(steep, at.relative[wrong])[1]
        ahead[:, wrong] = np.where(
            mirrors[wrong],
            reflect(direction[:, wrong], at.flat[:, wrong]),
            refract(direction[:, wrong], at.flat[:, wrong], steep, inner_flat, at.relative[wrong]),
        )
    return normalised(ahead)


def _outward(scene: Scene) -> np.ndarray:
    """(T, 3) float32 unit normals of the triangles, on the side to which their corners' normals point."""
    cross = scene.triangle_cross().astype(np.float64)
    flat = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)
    facing = np.einsum("td,td->t", flat, scene.corner_normals.sum(axis=1))
    return np.where(facing[:, None] < 0, -flat, flat).astype(np.float32)
