"""What the camera sees: for each pixel the diffuse surface that its ray ends on, after mirrors and glass on the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..lights import sky_radiance
from ..optics import fresnel, reflect, refract, schlick
from ..rays import chunks
from ..sampling import frame, hash_uniform
from ..scene import Optics, Sky
from ..threads import in_threads
from ..vectors import scaled
from .camera import Camera
from .surfaces import Surfaces

CHUNK = 1 << 14
"""Pixels that are traced together."""

BOUNCES = 12
"""Mirrors, glass and see-through surfaces that a camera's ray follows."""

_F = np.float32


@dataclass(frozen=True)
class GBuffer:
    """One ray through each of n pixels; m of them end on a diffuse surface.

    rows: (m,) int of the pixels. position (m, 3) m, lifted off the surface; normal, flat (m, 3) unit, shading and
    geometric, on the camera's side. triangle (m,) int32, u, v (m,). object_id (m,) int32. footprint (m,) m, of a pixel.
    reflectance (m, 3): albedo times what mirrors and glass took from the light.
    seen: (n, 3) float32 radiance that comes by itself, emission and sky. alpha: (n,) 1 where a surface is.
    depth: (n,) m along the camera's axis to the first surface, FARTHEST where there is none. shown_normal: (n, 3) of it.
    """

    rows: np.ndarray
    position: np.ndarray
    normal: np.ndarray
    flat: np.ndarray
    triangle: np.ndarray
    u: np.ndarray
    v: np.ndarray
    object_id: np.ndarray
    footprint: np.ndarray
    reflectance: np.ndarray
    seen: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    shown_normal: np.ndarray


FARTHEST = 1e10
"""Depth where nothing is, as Blender's engines have it."""


def make_gbuffer(
    surfaces: Surfaces,
    camera: Camera,
    sky: Sky | None,
    offset: tuple[float, float],
    seed: int,
    transparent: bool = False,
) -> GBuffer:
    """Trace the camera's rays through the same place of each pixel.

    offset: that place, (0.5, 0.5) its middle. seed: of the choices at surfaces that do several things with light.
    transparent: the sky is not seen by the camera, only by what reflects it.
    """
    origins, directions, reach = camera.rays(offset)
    parts = in_threads(
        lambda piece: _trace(surfaces, camera, sky, origins, directions, reach, piece, seed, transparent),
        chunks(len(origins), CHUNK),
    )
    return GBuffer(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _trace(surfaces, camera, sky, origins, directions, reach, piece, seed, transparent):
    """The fields of a GBuffer for a piece of its pixels."""
    pixel = np.arange(piece.start, piece.stop)
    start, way, far = origins[piece], directions[piece], reach[piece]
    count = len(pixel)
    seen, alpha = np.zeros((count, 3), np.float32), np.zeros(count, np.float32)
    depth, shown = np.full(count, FARTHEST, np.float32), np.zeros((count, 3), np.float32)
    weight, gone = None, np.zeros(count, np.float32)
    inside = np.zeros((count, 3), np.float32)
    alive, ends = np.arange(count), []
    looks, optics = surfaces.looks, _optics(surfaces)
    for turn in range(BOUNCES):
        found = surfaces.land(surfaces.seen if turn == 0 else surfaces.reflecting, start, way, None, far)
        out = found.missed
        if len(out) and sky is not None and not (transparent and turn == 0):
            light = sky_radiance(sky, way[out])
            seen[alive[out]] += light if weight is None else weight[out] * light
        rows, triangle, u, v = found.rows, found.triangle, found.u, found.v
        if not len(rows):
            break
        who, way, distance = alive[rows], way.take(rows, axis=0), found.distance
        weight = None if weight is None else weight[rows]
        hit = scaled(way, distance)
        hit += start.take(rows, axis=0)
        normal, flat = surfaces.normals(triangle, u, v, way)
        gone = gone[rows] + distance
        inside = inside[rows] if turn else inside
        if turn and inside.any():
            weight = (1 if weight is None else weight) * np.exp(-inside * distance[:, None])
        if turn == 0:
            alpha[who], depth[who], shown[who] = 1, camera.depth(hit), normal
        if looks.emits:
            light = looks.emission(triangle, u, v)
            seen[who] += light if weight is None else weight * light
        albedo = looks.albedo(triangle, u, v)
        material = surfaces.scene.triangle_material[triangle]
        passes, special = surfaces.see_through[triangle], optics.shiny[material]
        stops = np.ones(len(rows), bool)
        reflectance = albedo if weight is None else albedo * weight
        several = np.flatnonzero(passes | special)
        if len(several):
            chance = hash_uniform(pixel[who[several]], 7 * turn, seed)
            lobe, factor, onward, swallowed = _choose(
                surfaces, optics, several, triangle, u, v, albedo, material, way, normal, chance,
                hash_uniform(pixel[who[several]], 7 * turn + 1, seed), hash_uniform(pixel[who[several]], 7 * turn + 2, seed),
            )  # fmt: skip
            stops[several] = lobe == _DIFFUSE
            if weight is None:
                weight = np.ones((len(rows), 3), np.float32)
            reflectance[several] = albedo[several] * weight[several] * factor
        lit = np.flatnonzero(stops & (reflectance[:, 0] + reflectance[:, 1] + reflectance[:, 2] > 0))
        lit = slice(None) if len(lit) == len(rows) else lit
        span = camera.footprint(depth[who[lit]]) if camera.is_orthographic else camera.footprint(gone[lit])
        ends.append(
            (
                who[lit], _lifted(hit[lit], flat[lit], surfaces.offset), normal[lit], flat[lit], triangle[lit], u[lit], v[lit],
                surfaces.scene.triangle_object[triangle[lit]], span, reflectance[lit],
            )
        )  # fmt: skip
        if not len(several):
            break
        on = np.flatnonzero((lobe != _DIFFUSE) & (factor > 0).any(axis=1))
        rows = several[on]
        if not len(rows):
            break
        alive, weight, gone = who[rows], weight[rows] * factor[on], gone[rows]
        way = onward[on]
        side = np.sign(np.einsum("nd,nd->n", way, flat[rows]))[:, None]
        start = hit[rows] + side * surfaces.offset * flat[rows]
        inside = np.where(lobe[on, None] == _GLASS, swallowed[on], inside[rows] if turn else np.float32(0))
        far = np.full(len(rows), 1e30, np.float32)
    if ends:
        ends = [np.concatenate(column) for column in zip(*ends, strict=True)]
    else:
        none3, none = np.zeros((0, 3), np.float32), np.zeros(0, np.float32)
        names = np.zeros(0, np.int32)
        ends = [np.zeros(0, np.int64), none3, none3, none3, names, none, none, names, none, none3]
    if (np.diff(ends[0]) < 0).any():
        # in the order of pixels, so that neighbours stay together
        order = np.argsort(ends[0], kind="stable")
        ends = [column[order] for column in ends]
    ends[0] = ends[0] + piece.start
    return (*ends, seen, alpha, depth, shown)


_DIFFUSE, _STRAIGHT, _MIRROR, _GLASS = range(4)


@dataclass(frozen=True)
class _OpticsTable:
    """Optics of all materials, a row each."""

    shiny: np.ndarray
    values: dict[str, np.ndarray]


def _optics(surfaces) -> _OpticsTable:
    materials = surfaces.scene.materials
    plain = Optics()
    each = [m.optics or plain for m in materials]
    names = Optics.__dataclass_fields__
    values = {name: np.array([getattr(o, name) for o in each], np.float32) for name in names}
    lobes = ("mirror", "mirror_edge", "glass", "gloss")
    shiny = np.array([m.optics is not None for m in materials], bool)
    shiny &= np.any([values[name].any(axis=1) for name in lobes], axis=0)
    return _OpticsTable(shiny, values)


def _choose(surfaces, optics, rows, triangle, u, v, albedo, material, way, normal, chance, a, b):
    """One of the things that surfaces at `rows` do with light, in proportion to how much of it they do.

    Returns for each row the lobe, (k, 3) the factor that the light gets, (k, 3) where the ray goes on, and (k, 3)
    absorption beyond, 1/m.
    """
    triangle, way, normal, material = triangle[rows], way[rows], normal[rows], material[rows]
    straight = np.zeros((len(rows), 3), np.float32)
    clear = np.flatnonzero(surfaces.see_through[triangle])
    straight[clear] = surfaces.transmission.at(triangle[clear], u[rows[clear]], v[rows[clear]])
    get = {name: values[material] for name, values in optics.values.items()}
    glassy = get["glass"].any(axis=1)
    # the rest is bent instead
    straight[glassy] = get["clear"][glassy]
    # rough lobes look along a facet's normal (GGX)
    alpha2 = np.minimum(get["roughness"] ** 4, 1)
    steep = alpha2 * a / np.maximum(1 - a, 1e-6)
    z, angle = 1 / np.sqrt(1 + steep), b * _F(2 * np.pi)
    wide = np.sqrt(np.maximum(1 - z * z, 0))
    tangent, bitangent = frame(normal)
    facet = (
        (wide * np.cos(angle))[:, None] * tangent + (wide * np.sin(angle))[:, None] * bitangent + z[:, None] * normal
    )
    cosine = -np.einsum("nd,nd->n", way, facet)
    facet = np.where(cosine[:, None] > 0, facet, normal)
    cosine = np.clip(-np.einsum("nd,nd->n", way, facet), 0, 1)
    # which side of the surface the ray comes from: normals of the winding point outside
    outside = np.einsum("nd,nd->n", way, surfaces.flat[triangle]) < 0
    eta = np.where(outside, 1 / get["ior"], get["ior"])
    reflectance, beyond = fresnel(cosine, eta)
    mirror = schlick(get["mirror"], get["mirror_edge"], cosine[:, None]) + get["gloss"] * reflectance[:, None]
    glass = get["glass"] * (1 - reflectance)[:, None]
    lobes = np.stack([albedo[rows], straight, mirror, glass])
    size = lobes.max(axis=2)
    whole = size.sum(axis=0)
    upto = np.cumsum(size, axis=0)
    lobe = np.minimum((chance * whole >= upto).sum(axis=0), 3)
    k = np.arange(len(rows))
    share = size[lobe, k] / np.maximum(whole, 1e-20)
    bounced = reflect(way.T, facet.T).T
    bent = refract(way.T, facet.T, cosine, beyond, eta).T
    onward = np.select([lobe[:, None] == _MIRROR, lobe[:, None] == _GLASS], [bounced, bent], way)
    onward /= np.maximum(np.linalg.norm(onward, axis=1, keepdims=True), 1e-20)
    swallowed = np.where(outside[:, None], get["absorption"], 0)
    diffuse = lobe == _DIFFUSE
    # the diffuse lobe's colour is counted by the caller
    factor = np.where(diffuse[:, None], 1, lobes[lobe, k]) / np.maximum(share, 1e-20)[:, None]
    factor[whole <= 0] = 0
    return lobe, factor.astype(np.float32), onward.astype(np.float32), swallowed.astype(np.float32)


def background(camera: Camera, sky: Sky | None, transparent: bool = False) -> np.ndarray:
    """(height, width, 4) float32 of an image in which there is nothing but the sky."""
    width, height = camera.size
    image = np.zeros((height * width, 4), np.float32)
    if not transparent:
        image[:, 3] = 1
        if sky is not None:
            image[:, :3] = sky_radiance(sky, camera.rays()[1])
    return image.reshape(height, width, 4)


def _lifted(places, flat, offset) -> np.ndarray:
    """(n, 3) places moved off their surfaces."""
    lifted = flat * offset
    lifted += places
    return lifted
