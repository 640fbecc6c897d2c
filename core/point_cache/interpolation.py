"""How a value spreads from the points to any place: sparse weights, found once.

The paper's are Shepard's, search radius − distance (Bikker & Reijerse, section 5). The default measures distance as
Ward et al. (1988) do, by place and by normal, and lets gradients carry a value from its point to the place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..memory import slices
from ..rays import Bvh
from ..sampling import frame, hash_uniform
from ..surface import SurfaceSamples
from .grid import DiscGrid, in_chunks, nearest_first
from .points import PointSet

REACH = 2.0
"""Radii within which a point serves."""

KEEP = 4
"""Points that a place takes its light from, at most; more blur."""

RISE = 0.5
"""A point serves places off its plane by no more than this part of their distance."""

FACING = 0.4
"""Least cosine of the angle between the normals of a point and a place that it serves."""

LIFT = 0.1
"""Lift of a visibility ray's ends off the surface, over their distance."""

STIFF = 0.03
"""Square of the spread, in radii, below which points tell nothing about the slope between them."""

LEAST = -0.3
"""Least of the affine weights: lower ones would trade a slope for noise."""

TURN = 2.0
"""How far a turn of the normal by one radian counts, in radii."""

SHEPARD = {"linear": 1, "quadratic": 2, "cubic": 3}
KERNELS = ("ward", "affine", "nearest", *SHEPARD, *(f"bare {name}" for name in SHEPARD))


@dataclass(frozen=True)
class Weights:
    """point: (q, k) int32; weight: (q, k) float32 with sum 1, 0 where fewer serve and all 0 where none does."""

    point: np.ndarray
    weight: np.ndarray

    @property
    def orphan(self) -> np.ndarray:
        """(q,) bool: places that no point serves, which need a gather of their own."""
        return ~self.weight.any(axis=1)

    def take(self, rows: np.ndarray | slice) -> Weights:
        """Those of the places at `rows`."""
        return Weights(self.point[rows], self.weight[rows])

    def named(self, rows: np.ndarray) -> Weights:
        """Those of the places at `rows` (r,) int, of which −1 has none."""
        shape = len(rows), self.point.shape[1]
        point, weight = np.zeros(shape, np.int32), np.zeros(shape, np.float32)
        for s in slices(len(rows), 16 + 8 * shape[1]):
            some = np.flatnonzero(rows[s] >= 0)
            at, some = rows[s][some], some + s.start
            point[some], weight[some] = self.point[at], self.weight[at]
        return Weights(point, weight)

    def apply(self, values: np.ndarray) -> np.ndarray:
        """(q, c) of values (n, c)."""
        result = np.empty((len(self.point), values.shape[1]), np.result_type(values, self.weight))
        for s in slices(len(result), 16 * values.shape[1]):
            total = values.take(self.point[s, 0], axis=0) * self.weight[s, :1]
            for k in range(1, self.point.shape[1]):
                total += values.take(self.point[s, k], axis=0) * self.weight[s, k : k + 1]
            result[s] = total
        return result

    def steps(self, points: PointSet, places: SurfaceSamples) -> np.ndarray:
        """(q, k, 7) float32: with these, times a row's value and its gradients, a place sums up what its points hold
        (see `gradients.gather_gradients`)."""
        turn = places.normal[:, None] - points.normal[self.point]
        step = places.position[:, None] - points.position[self.point]
        weight = self.weight[..., None]
        return np.concatenate([weight, turn * weight, step * weight], 2)

    def carry(self, rows: np.ndarray, points: PointSet, places: SurfaceSamples) -> np.ndarray:
        """(q, c) of rows (n, 7, c) with gradients, carried from the points to the places."""
        return np.einsum("qka,qkac->qc", self.steps(points, places), rows[self.point])


class Interpolator:
    """Finds the points that serve a place.

    bvh: of what blocks the view between a place and a point, None for none. reach: radii within which a point serves.
    """

    def __init__(self, points: PointSet, bvh: Bvh | None, offset: float, reach: float = REACH):
        self.points, self.bvh, self.offset, self.reach = points, bvh, np.float32(offset), np.float32(reach)
        self.grid = DiscGrid(points.position, points.normal, points.radius * self.reach)

    def weights(self, places: SurfaceSamples, kernel: str = "ward", keep: int = KEEP, seed: int = 0) -> Weights:
        """Weights of the points for each place, one of KERNELS.

        ward: the default, of the `keep` nearest, falling to 0 at the next. affine: the same, corrected so that what
        changes evenly over the surface is all but met; without gradients the better choice. linear, quadratic, cubic:
        Shepard's, of all within reach. nearest: one point, with a random part of its radius added to the distance, so
        that many places together show a smoothed Voronoi diagram. All of these leave out points that face otherwise,
        lie off the plane or are out of sight; bare linear, quadratic and cubic ask for the distance alone, as the
        paper does. Raises ValueError for other kernels.
        """
        if kernel not in KERNELS:
            raise ValueError(f"There is no interpolation '{kernel}'; use one of {', '.join(KERNELS)}.")
        if not len(places) or not len(self.points):
            return Weights(np.zeros((len(places), keep), np.int32), np.zeros((len(places), keep), np.float32))
        if kernel in ("ward", "affine"):
            # most kernels keep as many as are asked for: no second copy of what can be millions
            point, weight = np.zeros((len(places), keep), np.int32), np.zeros((len(places), keep), np.float32)

            def fill(s):
                point[s], weight[s] = self._weights(places.take(s), kernel, keep, s.start, seed)

            in_chunks(fill, len(places))
            return Weights(point, weight)
        parts = in_chunks(lambda s: self._weights(places.take(s), kernel, keep, s.start, seed), len(places))
        width = max(p[0].shape[1] for p in parts)
        return Weights(*(np.concatenate([widen(p[k], width) for p in parts]) for k in (0, 1)))

    def _weights(self, places, kernel, keep, start, seed):
        query, point, measure = self._candidates(places, kernel, start, seed)
        order, first = nearest_first(query, measure, len(places))
        shepard = kernel.split()[-1] in SHEPARD
        if not shepard:
            # twice as many as will be kept: some are out of sight
            rank = np.arange(len(order)) - np.repeat(first[:-1], np.diff(first))
            order = order[rank < 2 * (keep + 1)]
        query, point, measure = query[order], point[order], measure[order]
        if self.bvh is not None and not kernel.startswith("bare"):
            seen = self._visible(places, query, point)
            query, point, measure = query[seen], point[seen], measure[seen]
        count = np.bincount(query, minlength=len(places))
        rank = np.arange(len(query)) - np.repeat(np.cumsum(count) - count, count)
        width = {"nearest": 1}.get(kernel, max(int(count.max(initial=1)), 1) if shepard else keep)
        table = np.ones((len(places), width + 1), np.float32)
        names = np.zeros((len(places), width + 1), np.int32)
        used = rank <= width
        table[query[used], rank[used]] = measure[used]
        names[query[used], rank[used]] = point[used]
        names = names[:, :width]
        if kernel == "nearest":
            return names, (count > 0).astype(np.float32)[:, None]
        if shepard:
            weight = np.maximum(1 - table[:, :width], 0) ** SHEPARD[kernel.split()[-1]]
        else:
            # the first that is left out ends the reach, so a point comes and goes without a step
            weight = np.maximum(1 - table[:, :width] / np.maximum(table[:, width:], 1e-9), 0)
        total = weight.sum(axis=1, keepdims=True)
        weight = weight / np.where(total > 0, total, 1)
        if kernel == "affine":
            weight = self._affine(weight, names, places)
        return names, weight

    def _candidates(self, places, kernel, start, seed):
        """Pairs of a place and a point that may serve it, and the distance between them as the kernel measures it,
        1 at the end of the point's reach."""
        points = self.points
        query, point = self.grid.pairs(places.position)
        apart = points.position.take(point, axis=0) - places.position.take(query, axis=0)
        distance2 = np.einsum("nd,nd->n", apart, apart)
        near = np.flatnonzero(distance2 < (points.radius * self.reach).take(point) ** 2)
        query, point, apart, distance = query[near], point[near], apart[near], np.sqrt(distance2[near])
        measure = distance / (points.radius[point] * self.reach)
        if kernel.startswith("bare"):
            return query, point, measure
        alike = np.einsum("nd,nd->n", points.normal.take(point, axis=0), places.normal.take(query, axis=0))
        planes = points.samples.flat.take(point, axis=0) + places.flat.take(query, axis=0)
        rise = np.einsum("nd,nd->n", apart, planes) / 2
        serves = np.flatnonzero((alike > FACING) & (np.abs(rise) < RISE * distance + 4 * self.offset))
        query, point, measure, alike = query[serves], point[serves], measure[serves], alike[serves]
        if kernel in ("ward", "affine"):
            # a turn by a quarter of a circle counts as the whole reach, about
            measure = measure + np.sqrt(np.maximum(2 - 2 * alike, 0)) * (TURN / self.reach)
        elif kernel == "nearest":
            dice = hash_uniform((start + query.astype(np.int64)) << 24 ^ point, 41, seed)
            measure = measure + dice / self.reach
        near = np.flatnonzero(measure < 1) if kernel != "nearest" else slice(None)
        return query[near], point[near], measure[near].astype(np.float32)

    def _visible(self, places, query, point):
        flat, other = places.flat.take(query, axis=0), self.points.samples.flat.take(point, axis=0)
        start = places.position.take(query, axis=0)
        apart = self.points.position.take(point, axis=0) - start
        lift = np.maximum(np.float32(LIFT) * np.linalg.norm(apart, axis=1, keepdims=True), self.offset)
        origin, vector = start + lift * flat, apart + lift * (other - flat)
        seen = ~self.bvh.occluded(np.ascontiguousarray(origin), np.ascontiguousarray(vector))
        # a ray from a point to itself has no direction
        return seen | (np.einsum("nd,nd->n", apart, apart) <= self.offset**2)

    def _affine(self, weight, names, places):
        """(q, k) weights that come closer to what changes evenly over the surface (moving least squares, eased where
        points lie in a line)."""
        apart = self.points.position[names] - places.position[:, None]
        tangent, bitangent = frame(places.normal)
        scale = 1 / self.points.radius[names[:, 0]]
        u = np.einsum("qkd,qd->qk", apart, tangent * scale[:, None])
        v = np.einsum("qkd,qd->qk", apart, bitangent * scale[:, None])
        mu, mv = (weight * u).sum(axis=1), (weight * v).sum(axis=1)
        du, dv = u - mu[:, None], v - mv[:, None]
        # a line of points, or a single one, says nothing about the slope across
        uu = (weight * du * du).sum(axis=1) + np.float32(STIFF)
        vv = (weight * dv * dv).sum(axis=1) + np.float32(STIFF)
        uv = (weight * du * dv).sum(axis=1)
        determinant = uu * vv - uv * uv
        a, b = (vv * mu - uv * mv) / determinant, (uu * mv - uv * mu) / determinant
        slope = -(du * a[:, None] + dv * b[:, None])
        least = (weight * slope).min(axis=1)
        part = np.where(least < LEAST, LEAST / np.minimum(least, LEAST), 1).astype(np.float32)
        return weight * (1 + part[:, None] * slope)


def widen(values: np.ndarray, width: int) -> np.ndarray:
    """(n, k) values with columns of 0 added, (n, width)."""
    return np.pad(values, ((0, 0), (0, width - values.shape[1])))
