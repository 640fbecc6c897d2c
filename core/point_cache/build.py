"""From a scene to its point set: a coarse even set, a guide measured on it, and the set that the guide asks for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..rays import Bvh
from ..scene import Scene, used_rows
from ..surface import Patches, SurfaceSamples, unit
from ..surface.patches import bisect
from ..transfer import Gatherer
from . import guides
from .darts import PACKING, Fragments, throw
from .gradients import gather_gradients
from .points import PointSet
from .sources import Sources, flood_sources, thin_out

COARSE = (6_000, 16_000)
"""Least and most points of the coarse set; between them, as many as are wanted in the end."""

RAYS = 64
"""Rays for the ambient occlusion of a point."""

LOOKS = 1_500
"""Points of the coarse set, about, at which lamps are asked; LOOK_RAYS rays each."""

LOOK_RAYS = 128

FEWER = 4
"""Darts for each point of the coarse set, which need not be full."""

STRIDE = 3.0
"""Distance of the points that look for more sources, over that of the coarse set."""

GROWTH = 4
"""Rounds in which points that were found help to find more."""

FINEST, LARGEST = 1 / 4, 3.0
"""Least and most radius, over that of as many even points."""


@dataclass(frozen=True)
class Ground:
    """What all point sets of a scene share.

    coarse: an even set where light gets; size: its radius, m; ao, harmonic: openness and harmonic mean distance (m) of
    its points. reach: m, within which things occlude. fragments: of the whole surface. sources: the coarse points, from
    which darts are thrown.
    """

    scene: Scene
    bvh: Bvh
    offset: float
    coarse: SurfaceSamples
    size: float
    ao: np.ndarray
    harmonic: np.ndarray
    reach: float
    fragments: Fragments
    sources: Sources

    def reached(self, samples: SurfaceSamples) -> np.ndarray:
        """(n,) bool: whether light gets to the samples."""
        return self.sources.see(samples.position, samples.flat)


def survey(
    scene: Scene,
    patches: Patches,
    bvh: Bvh,
    offset: float,
    seed: int = 0,
    places: np.ndarray | None = None,
    seen: SurfaceSamples | None = None,
    count: int = COARSE[1],
) -> Ground:
    """Throw the coarse set from the flood's sources, and look around from it.

    places: (m, 3) where lamps may stand beside those of the scene, m. seen: places that light reaches wherever lamps go,
    in place of the flood's. count: of the coarse set, about, held within COARSE.
    """
    size = float(np.sqrt(PACKING * patches.area.sum() / np.clip(count, *COARSE)))
    triangles = used_rows(patches.parent, len(scene.triangles))
    corners, parent, weights = bisect(scene.positions[scene.triangles[triangles]], 3 * size)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(cross.astype(np.float64), axis=1)
    whole = np.full(2 * len(parent), size, np.float32)
    fragments = Fragments(triangles[parent].astype(np.int32), weights, area, whole)
    if seen is None:
        place, normal = flood_sources(scene, patches, bvh, offset, size, seed, places)
        place, normal = _grow(scene, fragments, place, normal, bvh, size, offset, seed)
    else:
        place, normal = thin_out(seen.position, seen.flat, size)
    sources = Sources(place, normal, bvh, 1.5 * size, offset)
    coarse = throw(scene, fragments, lambda s: sources.see(s.position, s.flat), seed, darts=FEWER).samples
    sources = Sources(coarse.position, coarse.flat, bvh, 1.5 * size, offset)
    reach = guides.REACH * scene.extent
    ao, harmonic = guides.surroundings(coarse, bvh, reach, RAYS, offset, seed + 1)
    return Ground(scene, bvh, offset, coarse, size, ao, harmonic, reach, fragments, sources)


def _grow(scene, fragments, place, normal, bvh, size, offset, seed):
    """More sources, where few of the flood's particles came: what a source sees becomes one, until there are no more."""
    wide = STRIDE * size
    loose = replace(fragments, radius=fragments.radius * np.float32(STRIDE))
    before = 0
    for _ in range(GROWTH):
        sources = Sources(place, normal, bvh, wide, offset)
        found = throw(scene, loose, lambda s, by=sources: by.see(s.position, s.flat), seed, darts=FEWER).samples
        place, normal = np.concatenate([place, found.position]), np.concatenate([normal, found.flat])
        place, normal = thin_out(place, normal, size)
        if len(found) <= 1.01 * before:
            break
        before = len(found)
    return place, normal


def lamp_radius(ground: Ground, gatherer: Gatherer, table: np.ndarray, seed: int = 0) -> np.ndarray:
    """(coarse points,) radius, in no unit, that lamps ask for: small where what they make changes fast.

    table: (1, ids, lamps) float32 radiosity of a few lamps, by the gatherer's ids. Without any, as for a single block
    in the open, from which light goes nowhere, the harmonic mean distance is all there is to go by.
    """
    coarse = ground.coarse
    if not table.shape[2]:
        return ground.harmonic
    step = max(len(coarse) // LOOKS, 1)
    some = coarse.take(slice(None, None, step))
    apart = ground.size * np.sqrt(step)
    found = gather_gradients(gatherer, some, np.full(len(some), apart, np.float32), table, LOOK_RAYS, seed)
    # float64: the square of a faint lamp's light is 0 in float32
    mean = np.maximum(found[:, 0].mean(axis=0, dtype=np.float64), 1e-30)
    gradient = np.sqrt(((found[:, 4:7] / mean) ** 2).sum(axis=1).mean(axis=1)).astype(np.float32)
    # of logarithms: one place that no lamp lights would make its neighbours' mean 0
    gradient = np.maximum(gradient, 1e-3 * gradient.max(initial=1e-20))
    there = guides.spread(gradient, some, guides.NEAR * apart, coarse.position, coarse.flat)[:, 0]
    there = np.where(np.isfinite(there), there, np.sqrt((gradient**2).mean()))
    return guides.by_lamps(ground.harmonic, there.astype(np.float32))


def make_points(
    ground: Ground,
    radius: np.ndarray,
    count: int,
    seed: int = 0,
    tick: Callable[[int], None] | None = None,
    **how,
) -> PointSet:
    """About `count` points whose radius follows `radius` (coarse points,) in any unit. how: as for `throw`."""
    scene, size = ground.scene, ground.size
    even = size * np.sqrt(len(ground.coarse) / max(count, 1))
    middle = np.exp(np.log(radius).mean()) if len(radius) else 1.0
    wanted = guides.limit(radius * np.float32(even / middle), ground.coarse, guides.NEAR * size)
    fragments = replace(ground.fragments, radius=_at_fragments(ground, wanted))
    fragments = fragments.scaled(count, FINEST * even, LARGEST * even)
    darts = throw(scene, fragments, ground.reached, seed, tick=tick, **how)
    ao = guides.openness(darts.samples, ground.bvh, ground.reach, RAYS, ground.offset, seed + 2)
    return PointSet(darts.samples, darts.radius, ao, darts.back)


def make_points_by_darts(ground: Ground, count: int, seed: int = 0, **how) -> PointSet:
    """About `count` points by the paper's own rule (Bikker & Reijerse, section 3): each dart looks around itself, and
    its ambient occlusion is its radius, between a least and a most. how: as for `throw`.

    `make_points` steered by ambient occlusion looks from a coarse set only, in a fraction of the time.
    """
    asked = _at_fragments(ground, guides.by_occlusion(ground.ao))
    even = ground.size * np.sqrt(len(ground.coarse) / max(count, 1))
    loose = replace(ground.fragments, radius=asked)
    fragments = loose.scaled(count, FINEST / guides.RATIO * even, LARGEST * guides.RATIO * even)
    known = np.flatnonzero(np.isfinite(asked))
    most = float(fragments.radius[known[0]] / asked[known[0]]) if len(known) else even

    def openness(samples, number):
        return guides.openness(samples, ground.bvh, ground.reach, RAYS, ground.offset, seed + 2, number)

    def measure(samples, number):
        return np.float32(most) * guides.by_occlusion(openness(samples, number))

    least = most / guides.RATIO
    darts = throw(ground.scene, fragments, ground.reached, seed, least=least, measure=measure, **how)
    return PointSet(darts.samples, darts.radius, openness(darts.samples, darts.number), darts.back)


def _at_fragments(ground, radius):
    """(2 f,) float32 radius on each side of each fragment, NaN where light does not get."""
    scene, parent = ground.scene, ground.fragments.parent
    middle = np.einsum("nkc,ncd->nd", ground.fragments.weights, scene.positions[scene.triangles[parent]]) / 3
    flat = unit(scene.triangle_cross(parent))
    near = guides.NEAR * ground.size
    result = guides.spread(radius, ground.coarse, near, middle, flat).reshape(-1)
    # a wire that no coarse dart hit: its own look
    lost = np.flatnonzero(np.isnan(result))
    side = np.where(lost % 2, -1, 1).astype(np.float32)[:, None] * flat[lost // 2]
    seen = ground.sources.see(middle[lost // 2], side)
    result[lost[seen]] = np.median(radius) if len(radius) else ground.size
    return result
