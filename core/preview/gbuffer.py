"""What the camera sees: for each pixel the diffuse surface that its ray ends on, after mirrors and glass on the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..lights import sky_radiance
from ..rays import chunks
from ..sampling import BELOW_ONE, GOLDEN, PLASTIC, hash_uniform
from ..scene import Sky
from ..threads import in_threads, thread_count
from ..vectors import scaled
from .camera import Camera
from .lobes import DIFFUSE, GLASS, choose
from .surfaces import Surfaces

MOST, LEAST = 1 << 16, 1 << 12
"""Pixels that are traced together: many, so that threads seldom wait for each other, and few enough for all threads to have
some. No image depends on it."""

BOUNCES = 12
"""Mirrors, glass and see-through surfaces that a camera's ray follows."""


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
    number: int,
    seed: int,
    transparent: bool = False,
) -> GBuffer:
    """Trace the camera's rays through the same place of each pixel.

    offset: that place, (0.5, 0.5) its middle. number: of the frame; at surfaces that do several things with light, frames take turns.
    transparent: the sky is not seen by the camera, only by what reflects it.
    """
    width, height = camera.size
    parts = in_threads(
        lambda rows: _trace(surfaces, camera, sky, offset, rows, number, seed, transparent),
        pieces(height, max(width, 1)),
    )
    return GBuffer(*in_threads(np.concatenate, zip(*parts, strict=True)))


def pieces(count: int, each: int = 1) -> list[slice]:
    """Slices of range(count), as many as threads have use for. each: pixels that one of them stands for."""
    share = -(-count * each // thread_count())
    return chunks(count, max(1, min(MOST, max(LEAST, share)) // each))


def _trace(surfaces, camera, sky, offset, rows, number, seed, transparent):
    """The fields of a GBuffer for some rows of pixels."""
    start, way, far = camera.rays(offset, rows)
    first = rows.start * camera.size[0]
    pixel = np.arange(first, first + len(way))
    count = len(pixel)
    seen, alpha = np.zeros((count, 3), np.float32), np.zeros(count, np.float32)
    depth, shown = np.full(count, FARTHEST, np.float32), np.zeros((count, 3), np.float32)
    # rays begin on the near plane
    weight, gone = None, camera.depth(start)
    inside = np.zeros((count, 3), np.float32)
    alive, ends = np.arange(count), []
    looks = surfaces.looks
    for turn in range(BOUNCES):
        found = surfaces.land(surfaces.seen if turn == 0 else surfaces.reflecting, start, way, None, far)
        out = found.missed
        if len(out) and sky is not None and not (transparent and turn == 0):
            light = sky_radiance(sky, way[out])
            seen[alive[out]] += light if weight is None else weight[out] * light
        rows, triangle, u, v = found.rows, found.triangle, found.u, found.v
        if not len(rows):
            break
        who, way, distance = alive[rows], way.take(rows, axis=0, mode="clip"), found.distance
        weight = None if weight is None else weight[rows]
        hit = scaled(way, distance)
        hit += start.take(rows, axis=0, mode="clip")
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
        stops = np.ones(len(rows), bool)
        reflectance = albedo if weight is None else albedo * weight
        several = np.flatnonzero(surfaces.several[triangle]) if surfaces.any_several else ()
        if len(several):
            chance, *facet = _chances(pixel[who[several]], turn, number, seed)
            lobe, factor, onward, swallowed = choose(
                surfaces, several, triangle, u, v, albedo, way, normal, chance, *facet
            )  # fmt: skip
            stops[several] = lobe == DIFFUSE
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
        on = np.flatnonzero((lobe != DIFFUSE) & (factor > 0).any(axis=1))
        rows = several[on]
        if not len(rows):
            break
        alive, weight, gone = who[rows], weight[rows] * factor[on], gone[rows]
        way = onward[on]
        side = np.sign(np.einsum("nd,nd->n", way, flat[rows]))[:, None]
        start = hit[rows] + side * surfaces.offset * flat[rows]
        inside = np.where(lobe[on, None] == GLASS, swallowed[on], inside[rows] if turn else np.float32(0))
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
    ends[0] = ends[0] + first
    return (*ends, seen, alpha, depth, shown)


def _chances(pixel, turn, number, seed):
    """Three numbers in [0, 1) for each pixel; those of its frames are evenly spread."""
    made = []
    for k, step in enumerate((GOLDEN, *PLASTIC)):
        # each turn by steps of its own
        value = hash_uniform(pixel, 7 * turn + k, seed) + np.float32(number * (step + turn * 2**0.5) % 1)
        made.append(np.minimum(value - np.floor(value), BELOW_ONE))
    return made


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
