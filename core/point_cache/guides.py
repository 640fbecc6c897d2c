"""What steers the points' density: a radius for every place, from a coarse set of points.

The paper uses ambient occlusion and names its first derivative as future work (Bikker & Reijerse, sections 3 and 7).
Ward et al. (1988) use the harmonic mean distance. The default asks lamps: minimising Σ r² g² at a fixed number of
points, with g the relative gradient of what lamps make, gives r ∝ g^-½; half of that and half of the harmonic mean
distance keeps dark corners from starving: r ∝ (Rh / g)^¼.
"""

from __future__ import annotations

import numpy as np

from ..rays import Bvh, chunks, product3
from ..sampling import cosine_hemisphere, hammersley_points
from ..surface import SurfaceSamples
from ..threads import in_threads
from ..transfer.gather import turns
from .grid import LevelGrid, in_chunks
from .points import PointSet

REACH = 0.15
"""Distance within which things occlude, over the scene's extent."""

LENGTHS = 0.5497004779019703
"""Third of the sequence R3 (Roberts, 2018): even beside the directions, whose own ratio's multiples would follow them."""

RATIO = 12.0
"""Largest radius over the smallest."""

SLOPE = 0.5
"""Growth of the radius with distance, at most."""

NEAR = 1.5
"""Radii of the coarse set within which it tells about a place."""


def surroundings(
    samples: SurfaceSamples, bvh: Bvh, reach: float, rays: int, offset: float, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Openness and harmonic mean distance, (n,) float32 each, from `rays` cosine rays.

    Openness in [0, 1] is ambient occlusion as it is shown: the part of the rays that meet nothing within `reach` m,
    those that meet something counting by how far off it is.
    """
    ao, harmonic = np.empty(len(samples), np.float32), np.empty(len(samples), np.float32)

    def part(s):
        origins, directions = _looks(samples, s, rays, offset, seed)
        open_, inverse = np.zeros(len(origins), np.float32), np.zeros(len(origins), np.float32)
        far = np.full(len(origins), reach, np.float32)
        for direction in directions:
            part_open = np.minimum(bvh.hits(origins, direction, far).distance / np.float32(reach), 1)
            open_ += part_open
            inverse += 1 / np.maximum(part_open, np.float32(1e-3))
        ao[s] = open_ / rays
        harmonic[s] = np.float32(reach) * rays / inverse

    in_threads(part, chunks(len(samples), 4096))
    return ao, harmonic


def openness(
    samples: SurfaceSamples, bvh: Bvh, reach: float, rays: int, offset: float, seed: int = 0,
    number: np.ndarray | None = None,
) -> np.ndarray:  # fmt: skip
    """(n,) float32: the openness of `surroundings` alone, in half the time: each ray asks only whether anything is
    nearer than its own part of the reach, and the parts are spread evenly.

    number: (n,) int, of each sample: then its value depends on that alone, whatever it is asked together with.
    """
    result = np.empty(len(samples), np.float32)
    length = np.float32(reach) * ((np.arange(rays) * LENGTHS + 0.5 / rays) % 1).astype(np.float32)

    def part(s):
        origins, directions = _looks(samples, s, rays, offset, seed, number)
        blocked = np.zeros(len(origins), np.float32)
        for direction, far in zip(directions, length, strict=True):
            blocked += bvh.occluded(origins, direction * far)
        result[s] = 1 - blocked / np.float32(rays)

    in_threads(part, chunks(len(samples), 4096))
    return result


def _looks(samples, s, rays, offset, seed, number=None):
    """Origins (m, 3) float32 of the cosine rays of samples `s`, and their directions, (m, 3) for each ray in turn."""
    axes = turns(samples.normal[s], s if number is None else number[s], seed).reshape(3, -1)
    origins = np.ascontiguousarray(samples.position[s] + samples.flat[s] * np.float32(offset))
    salt = seed + s.start if number is None else seed
    pattern = cosine_hemisphere(hammersley_points(rays, salt)).astype(np.float32)
    return origins, (product3(row[None], axes).reshape(-1, 3) for row in pattern)


def uniform(samples: SurfaceSamples) -> np.ndarray:
    """(n,) float32: the same radius everywhere."""
    return np.ones(len(samples), np.float32)


def by_occlusion(ao: np.ndarray, ratio: float = RATIO) -> np.ndarray:
    """(n,) float32: the paper's radius, between a least and a most by ambient occlusion (n,) in [0, 1]."""
    return (1 / ratio + (1 - 1 / ratio) * ao).astype(np.float32)


def by_occlusion_gradient(ao: np.ndarray, samples: SurfaceSamples, size: float) -> np.ndarray:
    """(n,) float32: the paper's future work: small where ambient occlusion changes, and where it is strong.

    size: m, within which neighbours tell the change.
    """
    query, point = _neighbours(samples, size)
    apart = np.maximum(np.linalg.norm(samples.position[point] - samples.position[query], axis=1), 1e-3 * size)
    steep = np.bincount(query, np.abs(ao[point] - ao[query]) / apart, len(ao))
    change = np.float32(size) * (steep / np.maximum(np.bincount(query, minlength=len(ao)), 1)).astype(np.float32)
    return by_occlusion(ao) / np.sqrt(1 + change / max(float(change.mean()), 1e-9))


def by_lamps(harmonic: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """(n,) float32: (Rh / g)^¼. harmonic: (n,) m. gradient: (n,) 1/m, root mean square over lamps of |∇E| over the
    mean of E."""
    floor = 1e-3 * max(float(gradient.max(initial=0)), 1e-20)
    return (harmonic / np.maximum(gradient, floor)) ** np.float32(0.25)


def spread(
    values: np.ndarray, known: SurfaceSamples, size: float, position: np.ndarray, normal: np.ndarray
) -> np.ndarray:
    """(q, 2) float32 `values` (n,) of `known` on both sides of places (q, 3) with normals (q, 3), by the logarithms'
    mean over those within `size` m that face alike; NaN where there are none."""
    grid = _ball_grid(known.position, size)
    log = np.log(values).astype(np.float32)

    def part(s):
        count = s.stop - s.start
        query, point = grid.pairs(position[s], np.full(count, size, np.float32))
        apart = known.position[point] - position[s][query]
        near = 1 - np.einsum("nd,nd->n", apart, apart) / np.float32(size * size)
        keep = near > 0
        query, point, near = query[keep], point[keep], near[keep]
        facing = np.einsum("nd,nd->n", known.flat[point], normal[s][query])
        weight = near * np.maximum(np.abs(facing) - np.float32(0.3), 0)
        side = 2 * query + (facing < 0)
        total = np.bincount(side, weight, 2 * count)
        with np.errstate(invalid="ignore"):
            return np.exp(np.bincount(side, weight * log[point], 2 * count) / total).reshape(-1, 2)

    return np.concatenate(in_chunks(part, len(position)) or [np.zeros((0, 2))]).astype(np.float32)


def nearest_radius(points: PointSet, position: np.ndarray) -> np.ndarray:
    """(q,) float32 m: the least radius of the points within whose own radius a place (q, 3) is, whichever way they
    face; where there are none, the least of all."""
    least = np.full(len(position), np.inf, np.float32)
    grid = LevelGrid(points.position.min(axis=0)).fill(points.position, points.radius)
    level = grid.levels(points.radius)
    for own in np.unique(level):
        reach = points.radius[level == own].max()
        rest = np.flatnonzero(np.isinf(least))
        for s in chunks(len(rest), 16_384):
            query, point = grid.pairs(position[rest[s]], np.full(len(rest[s]), reach, np.float32))
            query = rest[s][query]
            apart = points.position[point] - position[query]
            holds = (np.einsum("nd,nd->n", apart, apart) < points.radius[point] ** 2) & (level[point] == own)
            np.minimum.at(least, query[holds], points.radius[point[holds]])
    return np.where(np.isfinite(least), least, points.radius.min())


def limit(radius: np.ndarray, samples: SurfaceSamples, size: float) -> np.ndarray:
    """(n,) float32: `radius` (n,) m such that it grows by no more than SLOPE times the distance between neighbours
    within `size` m, and within RATIO of the smallest.

    So points that are near each other have like radii, and small ones announce themselves.
    """
    query, point = _neighbours(samples, size)
    apart = np.linalg.norm(samples.position[point] - samples.position[query], axis=1)
    radius = np.minimum(radius, RATIO * radius.min(initial=np.inf)).astype(np.float32)
    for _ in range(20):
        before = radius.copy()
        np.minimum.at(radius, query, radius[point] + np.float32(SLOPE) * apart)
        if np.allclose(before, radius, rtol=1e-3):
            break
    return radius


def _ball_grid(position, size):
    """Points in a grid whose queries of radius `size` m find all within that."""
    low = position.min(axis=0) if len(position) else np.zeros(3)
    return LevelGrid(low).fill(position, np.full(len(position), size, np.float32))


def _neighbours(samples, size):
    """Pairs of samples within `size` m of each other that face alike: (m,) the one, (m,) the other; each pair both
    ways, and some twice."""
    grid = _ball_grid(samples.position, size)

    def part(s):
        query, point = grid.pairs(samples.position[s], np.full(s.stop - s.start, size, np.float32))
        query = query + np.int32(s.start)
        apart = samples.position[point] - samples.position[query]
        keep = (np.einsum("nd,nd->n", apart, apart) < np.float32(size) ** 2) & (query != point)
        query, point = query[keep], point[keep]
        alike = np.einsum("nd,nd->n", samples.flat[point], samples.flat[query]) > 0.5
        return query[alike], point[alike]

    parts = in_chunks(part, len(samples)) or [(np.zeros(0, np.int32),) * 2]
    return tuple(np.concatenate(column) for column in zip(*parts, strict=True))
