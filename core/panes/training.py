"""Virtual lamps that teach the panes what lamps can do to a scene.

They fill the scene's free air, near surfaces and far (after the lighting priors of Loos et al. 2011,
Modular Radiance Transfer), with suns where the scene has a sun.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..lights import irradiance
from ..rays import Bvh, Tracer, chunks, product3
from ..sampling import cosine_hemisphere, frame, hash_uniform, spiral
from ..scene import Light, Scene
from ..surface import SurfaceSamples
from ..threads import in_threads
from ..transfer import Gatherer

NAME = "training"
"""Of lamps that are none of the scene's."""

NEAR = (0.01, 0.15)
"""Least and most distance of near lamps from the surface below, in parts of the scene's extent. Nearer, they light single entries
from next to them, and panes learn these in place of what many lamps have in common; farther, lamps beside a surface are new."""

CRACK = 0.006
"""Room around a lamp, in parts of the scene's extent, below which it hangs in a crack; where too little is wider, the roomiest
places serve."""

SUNS = 12
"""One training lamp in so many is a sun, where the scene has one."""

SUN_RAYS = 1024
"""Rays that look for the sky, for each sun: through a small window few of them find it."""


def free_air(
    points: SurfaceSamples, bvh: Bvh, extent: float, seed: int, near: tuple[float, float] | None = None
) -> np.ndarray:
    """(n, 3) float32 places in the air, one above each of `points`.

    near: (least, most) distance in m from the surface below; None for anywhere along a cosine ray.
    """
    index = np.arange(len(points))
    origin, direction = _cosine_rays(points, extent, seed, index)
    free = np.minimum(bvh.hits(origin, direction).distance, 0.5 * extent)
    part = hash_uniform(index, 3, seed)
    if near is None:
        along = free * (0.02 + 0.96 * part)
    else:
        height = np.einsum("nd,nd->n", direction, points.normal)
        along = np.minimum(near[0] * (near[1] / near[0]) ** part / np.maximum(height, 0.3), 0.9 * free)
    return (origin + direction * along[:, None]).astype(np.float32)


def _cosine_rays(points, extent, seed, index):
    """Origins and directions (n, 3) float32 of one cosine ray from each point."""
    local = cosine_hemisphere(np.stack([hash_uniform(index, k, seed) for k in (1, 2)], 1)).astype(np.float32)
    tangent, bitangent = frame(points.normal)
    direction = local[:, :1] * tangent + local[:, 1:2] * bitangent + local[:, 2:] * points.normal
    origin = points.position + points.flat * np.float32(1e-4 * extent)
    return np.ascontiguousarray(origin, np.float32), np.ascontiguousarray(direction, np.float32)


def point_lamps(places: np.ndarray) -> list[Light]:
    """Point lamps of unit power at (n, 3) places."""
    lamps = []
    for place in places:
        matrix = np.eye(4)
        matrix[:3, 3] = place
        lamps.append(Light(NAME, "POINT", matrix, np.ones(3)))
    return lamps


def sun_lamps(scene: Scene, points: SurfaceSamples, bvh: Bvh, count: int, seed: int) -> list[Light]:
    """About `count` suns where the scene has one, in directions from which they reach `points`; otherwise none.

    A window lets in few of all suns, and those are the ones to learn.
    """
    if count < 1 or not any(light.kind == "SUN" for light in scene.lights):
        return []
    index = np.arange(SUN_RAYS * count)
    samples = points.take(np.sort(np.random.default_rng(seed).integers(0, len(points), len(index))))
    origin, direction = _cosine_rays(samples, scene.extent, seed, index)
    free = (bvh.hits(origin, direction).triangle < 0) & (direction[:, 2] > 0.03)
    toward = direction[np.random.default_rng(seed + 1).permutation(np.flatnonzero(free))[:count]]
    lamps = []
    for axis, side, up in zip(toward, *frame(toward), strict=True):
        matrix = np.eye(4)
        matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = side, up, axis
        lamps.append(Light(NAME, "SUN", matrix, np.ones(3)))
    return lamps


def training_lamps(scene: Scene, points: SurfaceSamples, gatherer: Gatherer, count: int, seed: int) -> list[Light]:
    """About `count` lamps: a third anywhere in the air, the rest near surfaces, in turns; suns where there is one.

    points: places on the entries, from which the air is found.
    """
    extent, bvh = scene.extent, gatherer.bvh
    suns = sun_lamps(scene, points, bvh, count // SUNS, seed + 23)
    rng = np.random.default_rng(seed)
    places = []
    for share, near in ((1 / 3, None), (2 / 3, (NEAR[0] * extent, NEAR[1] * extent))):
        # twice as many as wanted: those in cracks fall out
        chosen = np.sort(rng.integers(0, len(points), int(2 * share * count) + 8))
        found = free_air(points.take(chosen), bvh, extent, seed + 17, near)
        room = room_around(found, gatherer)
        wide = room > CRACK * extent
        chosen = rng.permutation(np.flatnonzero(wide))
        # a tunnel a hundred times as long as wide is all cracks
        narrow = np.flatnonzero(~wide & (room > 0))
        chosen = np.concatenate([chosen, narrow[np.argsort(-room[narrow], kind="stable")]])
        places.append(found[chosen[: int(share * count)]])
    return point_lamps(np.concatenate(places)) + suns


def room_around(places: np.ndarray, gatherer: Gatherer) -> np.ndarray:
    """(n,) float32 distance, m, from each place (n, 3) to about the nearest surface, by 64 rays around; 0 for
    places inside things, which see sides that have no entry."""
    around = spiral(64)
    result = np.empty(len(places), np.float32)

    def part(piece):
        origins = np.repeat(places[piece], len(around), axis=0)
        rays = np.tile(around, (piece.stop - piece.start, 1))
        inside, distance = gatherer.dead_ends(origins, rays)
        inside = inside.reshape(-1, len(around)).mean(axis=1)
        result[piece] = np.where(inside > 0.3, 0, distance.reshape(-1, len(around)).min(axis=1))

    in_threads(part, chunks(len(places), 128))
    return result


def illuminate(
    lamps: list[Light],
    points: SurfaceSamples,
    each: int,
    tracer: Tracer,
    seed: int,
    tick: Callable[[int], None] | None = None,
) -> np.ndarray:
    """(n, lamps) float32 direct irradiance of unit lamps at n entries, each seen at `each` of its places.

    points: (n × each) samples, row-major. Lamps take turns with the places, so that training sees them all.
    """
    count = len(points) // each
    result = np.empty((count, len(lamps)), np.float32)
    lone = tracer.alone()
    position = points.position + points.flat * np.float32(tracer.offset)
    sharp = np.array([light.kind == "POINT" and light.radius == 0 for light in lamps], bool)
    lamp_place = np.array([light.position for light in lamps], np.float32).reshape(-1, 3)

    def one(k):
        rows = np.arange(count) * each + k
        mine = np.arange(k, len(lamps), each)
        points_of = [mine[sharp[mine]][i : i + 32] for i in range(0, int(sharp[mine].sum()), 32)]
        for columns in points_of:
            result[:, columns] = _point_lamps(position[rows], points.normal[rows], lamp_place[columns], lone.visibility)
        for column in mine[~sharp[mine]]:
            found = irradiance(
                lamps[column], position[rows], points.normal[rows], lone.visibility, 1, seed + int(column)
            )
            result[:, column] = found if found.ndim == 1 else found.mean(axis=1)
        if tick is not None:
            tick(len(mine))

    in_threads(one, range(each))
    return result


def _point_lamps(position, normal, places, visibility):
    """(n, l) float32 irradiance of points under unit point lamps at (l, 3) places, all at once."""
    # float32 products of coordinates cancel far from the origin
    middle = position.mean(axis=0)
    local, own = places - middle, position - middle
    facing = product3(normal, local.T) - np.einsum("nd,nd->n", normal, own)[:, None]
    i, j = np.nonzero(facing > 0)
    vectors = places[j] - position[i]
    distance2 = np.maximum(np.einsum("nd,nd->n", vectors, vectors), 1e-12)
    seen = visibility(position[i], vectors)
    seen = seen if seen.ndim == 1 else seen.mean(axis=1)
    result = np.zeros(facing.shape, np.float32)
    result[i, j] = facing[i, j] / (np.float32(4 * np.pi) * distance2 * np.sqrt(distance2)) * seen
    return result
