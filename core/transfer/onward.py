"""Where rays between diffuse surfaces go on that meet a mirror, glass or rough metal on their way.

A ray does one of the things that the surface does with light, with the odds of how much of it it does, the mean over the
colours: what is tinted in the scene is grey here. Glass is entered and left with all that it bends and reflects inside, and
absorbs. A metal's roughness is that of facets (GGX); what facets hide from each other is scattered evenly, for no light is
lost between them.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ..caustics.bending import Bending, onward
from ..caustics.casters import is_caster, passes_on
from ..optics import fresnel, reflect, schlick, unmasked, visible_facet
from ..rays import LAYERS, Bvh, Transmission
from ..sampling import cosine_hemisphere, hammersley_points, hash_uniform
from ..scene import Material, Scene
from ..surface import Patches
from ..vectors import around, dot, join, split

LEAST = 1e-3
"""Part of the light that is taken to stay on any entry."""

CHANCES = 8
"""Numbers that one surface may ask for."""

STAYS, STRAIGHT, TURNED, LOST = range(4)
"""What becomes of a ray at a surface."""

_F = np.float32


def passing(scene: Scene) -> np.ndarray | None:
    """(T,) bool, triangles at which light goes on by mirrors and glass; None where there are none."""
    found = np.array([passes_on(m) for m in scene.materials], bool)[scene.triangle_material]
    return found if found.any() else None


def find_bending(scene: Scene) -> Bending | None:
    """Those triangles, ready to be looked up."""
    triangles = passing(scene)
    return None if triangles is None else Bending(scene, triangles)


def opaque_part(scene: Scene, patches: Patches) -> np.ndarray:
    """(patches,) float32 in (0, 1]: part of the light that stays where it lands."""
    part = 1 - patches.transmission.mean(axis=1)
    triangles = passing(scene)
    if triangles is not None:
        piece = np.zeros(len(patches), np.int64)
        piece[patches.patch] = np.arange(len(patches.patch))
        parent = patches.parent[piece]
        part = np.where(triangles[parent], _stays(scene)[scene.triangle_material[parent]], part)
    return np.maximum(part, LEAST).astype(np.float32)


def _stays(scene):
    """(materials,) float32 odds with which rays stay to be scattered, whatever their angle."""
    return np.array([_stay(m) if passes_on(m) else 1 for m in scene.materials], np.float32)


def _stay(material: Material) -> float:
    scattered = max(material.albedo)
    if scattered <= 0:
        return 0.0
    optics = material.optics
    most = np.maximum(optics.mirror, optics.mirror_edge) + np.maximum(optics.glass, optics.gloss) + optics.clear
    return max(scattered, 1 - float(most.mean()))


class Onward:
    """Follows rays of a gather through the scene's mirrors and glass.

    bending: from `find_bending`. transmission: of what else lets rays straight on, those triangles being solid. lift:
    m, by which rays step behind what they pass straight.
    """

    def __init__(
        self, scene: Scene, patches: Patches, bending: Bending, transmission: Transmission, lift: float
    ) -> None:
        self._patches, self._transmission, self._lift = patches, transmission, _F(lift)
        self._bending = bending
        self._material = scene.triangle_material
        # the last row answers Embree's −1
        self._bends = np.append(bending.bends[patches.parent], False)
        self._meets = self._bends | np.append(transmission.see_through[patches.parent], False)
        self._stays = _stays(scene)
        rough = [m.optics.roughness**2 if passes_on(m) and not is_caster(m) else 0 for m in scene.materials]
        self._alpha = np.array(rough, np.float32)
        self._free = np.array([_free_part(alpha) for alpha in rough], np.float32)

    @property
    def both_ways(self) -> bool:
        """Whether as much light passes one way as the other; glass that encloses nothing is entered from one side and left
        from the other, at which much is reflected."""
        bending = self._bending
        return not (
            bending.optics(bending.rows)[2].any(axis=0) & (bending.bit[bending.object[bending.rows]] == 0)
        ).any()

    def meets(self, piece: np.ndarray) -> np.ndarray:
        """Of piece's shape, bool: at which of the patches' pieces rays may go on; −1, the sky, is none."""
        return self._meets.take(piece, mode="wrap")

    def follow(
        self, bvh: Bvh, origins: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """(n,) int32 piece that rays land on at last and (n, 3) direction with which they do, and (n,) bool each, those that
        were bent on the way and those that land nowhere. origins, directions: (n, 3) float32."""
        bent, lost = np.zeros(len(origins), bool), np.zeros(len(origins), bool)
        piece, directions = np.full(len(origins), -1, np.int32), directions.copy()
        rows = np.arange(len(origins))
        place, ahead = split(origins), split(directions)
        mask = np.zeros(len(rows), np.int64)
        for layer in range(LAYERS):
            if not len(rows):
                break
            way = join(*ahead)
            hits = bvh.hits(join(*place), way)
            piece[rows], directions[rows] = hits.triangle, way
            chance = partial(_chance, _bits(way), layer)
            fate = np.zeros(len(rows), np.uint8)
            medium = self._bending.inside(mask)
            clear = self._meets.take(hits.triangle, mode="wrap")
            bends = np.flatnonzero(self._bends.take(hits.triangle, mode="wrap"))
            clear[bends] = False
            clear = np.flatnonzero(clear)
            if len(clear):
                odds = self._transmission.at(*self._on_parent(hits, clear)).mean(axis=1)
                fate[clear] = np.where(chance(0, clear) < odds, STRAIGHT, STAYS)
                place[:, clear] += ahead[:, clear] * (hits.distance[clear] + self._lift)
            if len(bends):
                where = self._on_parent(hits, bends)
                some = self._bend(where, ahead[:, bends], mask[bends], partial(chance, rows=bends))
                fate[bends], place[:, bends], ahead[:, bends], mask[bends], medium[bends] = some
            fate[self._fades(medium, hits, chance)] = LOST
            bent[rows[fate == TURNED]] = True
            lost[rows[fate == LOST]] = True
            on = np.flatnonzero((fate == STRAIGHT) | (fate == TURNED))
            rows, place, ahead, mask = rows[on], place[:, on], ahead[:, on], mask[on]
        lost[rows] = True
        return piece, directions, bent, lost

    def _on_parent(self, hits, rows):
        """Triangle of the scene, u and v of hits on pieces."""
        piece, u, v = hits.triangle[rows], hits.u[rows], hits.v[rows]
        weights = np.einsum("nk,nkc->nc", np.stack([1 - u - v, u, v], 1), self._patches.weights[piece])
        return self._patches.parent[piece], weights[:, 1], weights[:, 2]

    def _fades(self, medium, hits, chance):
        """(n,) rows absorbed on their way to what they met, by Beer and Lambert."""
        absorption = self._bending.absorption
        if not absorption.any():
            return np.zeros(0, np.int64)
        inner = np.flatnonzero((medium > 0) & (hits.triangle >= 0))
        left = np.exp(-absorption[:, medium[inner]] * hits.distance[inner]).mean(axis=0)
        return inner[chance(1, inner) >= left]

    def _bend(self, where, ahead, mask, chance):
        """What becomes of rays that meet what mirrors or refracts, on triangles at u, v: their fates, where they go on and
        in which directions, (3, n), the objects around them then, and the medium that they came through."""
        triangle, _, _ = where
        mirror, edge, glass, gloss = self._bending.optics(triangle)
        at = self._bending.crossing(*where, ahead, mask, glass.max(axis=0) > 0)
        material = self._material[triangle]
        alpha = self._alpha[material]
        rough = np.flatnonzero(alpha)
        facet, cosine = at.normal, at.cosine
        if len(rough):
            facet, cosine = facet.copy(), cosine.copy()
            seen = visible_facet(
                -ahead[:, rough], at.normal[:, rough], alpha[rough], *(chance(k)[rough] for k in (2, 3))
            )
            facet[:, rough], cosine[rough] = seen, -dot(ahead[:, rough], seen)
        reflected, inner = fresnel(at.cosine, at.relative)
        back = (schlick(mirror, edge, cosine) + gloss * reflected).mean(axis=0)
        through = back + (glass * (1 - reflected)).mean(axis=0)
        clear = through + self._transmission.at(*where).mean(axis=1)
        pick = chance(0)
        mirrors, straight = pick < back, (pick >= through) & (pick < clear)
        stays = (pick >= clear) & (pick >= 1 - self._stays[material])
        fate = np.select([straight, pick < clear, stays], [STRAIGHT, TURNED, STAYS], LOST).astype(np.uint8)
        way = onward(ahead, at, inner, mirrors, straight)
        some = rough[mirrors[rough]]
        if len(some):
            lobes = mirror[:, some], edge[:, some], alpha[some], self._free[material[some]]
            way[:, some], fades = _off_facets(at, ahead, facet, *lobes, chance, some)
            fate[some[fades]] = LOST
        place = at.place + at.flat * np.where(mirrors, self._bending.offset, -self._bending.offset)
        mask = np.where(mirrors | straight, mask, np.where(at.enters, at.within, at.without))
        return fate, place, way, mask, at.before


def _off_facets(at, ahead, facet, mirror, edge, alpha, leaves, chance, some):
    """(3, k) directions of rays `some` that facets mirror, and (k,) bool, which of them other facets absorb. What these
    hide leaves evenly at last (Kulla and Conty 2017, Revisiting Physically Based Shading at Imageworks). leaves: (k,) as
    from `_free_part`."""
    way = reflect(ahead[:, some], facet[:, some])
    flat = at.flat[:, some]
    up = dot(way, at.normal[:, some])
    free = (up > 0) & (dot(way, flat) > 0) & (chance(4)[some] < unmasked(up, alpha))
    local = cosine_hemisphere(np.stack([chance(5)[some], chance(6)[some]], 1)).astype(np.float32).T
    evenly = np.stack(around(flat, *local))
    # the mean of Schlick's curve over the hemisphere, at each facet but the first
    tint = (mirror + (edge - mirror) / 21).mean(axis=0)
    odds = tint * leaves / np.maximum(1 - tint * (1 - leaves), _F(1e-6))
    return np.where(free, way, evenly), ~free & (chance(7)[some] >= odds)


def _free_part(alpha: float, count: int = 4096) -> float:
    """Part of diffuse light that leaves a white rough surface after one facet."""
    if not alpha:
        return 1.0
    view = cosine_hemisphere(hammersley_points(count)).astype(np.float32).T
    up, wide = np.zeros_like(view), np.full(count, alpha, np.float32)
    up[2] = 1
    facet = visible_facet(view, up, wide, *(hash_uniform(np.arange(count), k) for k in (1, 2)))
    leaves = reflect(-view, facet)[2]
    return float(np.where(leaves > 0, unmasked(leaves, wide), 0).mean())


def _bits(directions: np.ndarray) -> np.ndarray:
    """(n,) uint64 of a ray's own bits, from which its choices come: they depend on neither chunk nor thread."""
    bits = np.ascontiguousarray(directions).view(np.uint32).astype(np.uint64)
    return bits[:, 0] ^ (bits[:, 1] << np.uint64(20)) ^ (bits[:, 2] << np.uint64(32))


def _chance(bits, layer, number, rows=slice(None)):
    """(n,) in [0, 1), the so many-th of the surface that is met as the layer-th."""
    return hash_uniform(bits[rows], 101 + CHANCES * layer + number, 0)
