"""What may stand between receivers and a lamp: polygons in blocks of neighbours, and how a lamp sees them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..rays import Tracer
from .casting import Occluded
from .lamp import LampSamples
from .lines import edge_coefficients
from .polygons import Polygons, make_polygons
from .receivers import morton

BLOCK = 16
"""Polygons of a block."""

BRANCH = 8
"""Blocks of a block of blocks, and so on up."""

NEAR_PLANE = 2e-6
"""Distance from a plane, in parts of the scene's extent, at which a place may be on either side. The lift of receivers
(Tracer.offset) is ten times as large."""

SHORT = 2e-4
"""Shadow rays end this part of their length, at most, before the lamp: what is nearer to it may block them or not."""


class Occluders:
    """All that blocks light wholly in a scene, prepared once for all lamps.

    corners: (T, 3, 3) float32, m, of the triangles. occluded: rays against the same triangles. merge: join triangles to
    larger polygons first.
    """

    def __init__(self, corners: np.ndarray, occluded: Occluded, merge: bool = True):
        self.occluded = occluded
        polygons = make_polygons(corners, merge)
        low, high = _boxes(polygons.vertices, polygons.first)
        order = np.argsort(morton(((low + high) / 2).astype(np.float32)), kind="stable") if len(polygons) else []
        self.polygons = _reordered(polygons, np.asarray(order, np.intp))
        # as rays see it: their arithmetic is float32
        reach = float(np.abs(corners).max(initial=0.0))
        extent = float(np.linalg.norm(np.ptp(corners.reshape(-1, 3).astype(np.float64), axis=0))) if len(corners) else 0
        self.near_plane = max(NEAR_PLANE * extent, 4e-8 * reach, 1e-30)
        self.part_low, self.part_high = self._parts()
        low, high = _boxes(self.polygons.vertices, self.polygons.first)
        self.middle, self.half = (low + high) / 2, (high - low) / 2
        starts = np.arange(0, len(low), BLOCK)
        if len(starts):
            low, high = np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)
        self._block_middle, self._block_half = (low + high) / 2, (high - low) / 2

    @classmethod
    def of(cls, tracer: Tracer, merge: bool = True) -> Occluders:
        """The opaque surfaces of a scene whose shadow rays are `tracer`."""
        return cls(tracer.solid_corners, tracer.blocked, merge)

    def frame_boxes(self, lamp: LampSamples, middle: np.ndarray, half: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corners, two (n, 3) float64, in a lamp's frame (see LampView) of boxes around boxes: larger
        than need be for a lamp that is turned, and made in a third of the time."""
        middle = (middle - (0 if lamp.distant else lamp.centre)) @ lamp.axes.T
        half = half @ np.abs(lamp.axes.T)
        return middle - half, middle + half

    def blocks_before(self, lamp: LampSamples) -> Tree:
        """The blocks' boxes in a lamp's frame: all polygons, whatever side they turn to it."""
        low, high = self.frame_boxes(lamp, self._block_middle, self._block_half)
        return Tree.of(low.astype(np.float32), high.astype(np.float32))

    def _parts(self):
        count = len(self.polygons.closed)
        low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
        part = np.repeat(self.polygons.part, self.polygons.sides)
        np.minimum.at(low, part, self.polygons.vertices)
        np.maximum.at(high, part, self.polygons.vertices)
        return low, high


def _boxes(vertices, first):
    """Lowest and highest corner, two (p, 3), of runs of vertices."""
    if len(first) < 2:
        return np.zeros((0, 3)), np.zeros((0, 3))
    return np.minimum.reduceat(vertices, first[:-1]), np.maximum.reduceat(vertices, first[:-1])


def _reordered(polygons: Polygons, order) -> Polygons:
    sides = polygons.sides[order]
    first = np.append(0, np.cumsum(sides)).astype(np.int32)
    corner = np.repeat(polygons.first[:-1][order] - first[:-1], sides) + np.arange(first[-1])
    return Polygons(polygons.vertices[corner], first, polygons.normal[order], polygons.part[order], polygons.closed)


@dataclass(frozen=True)
class Tree:
    """Boxes of blocks, level by level from single polygons upwards: low, high (n, 3) float32."""

    low: list[np.ndarray]
    high: list[np.ndarray]

    @classmethod
    def of(cls, low: np.ndarray, high: np.ndarray) -> Tree:
        lows, highs, size = [low], [high], BLOCK
        while len(lows[-1]) > BLOCK:
            starts = np.arange(0, len(lows[-1]), size)
            lows.append(np.minimum.reduceat(lows[-1], starts))
            highs.append(np.maximum.reduceat(highs[-1], starts))
            size = BRANCH
        return cls(lows, highs)

    def children(self, level: int) -> int:
        """Nodes of the level below in each node of `level`."""
        return BLOCK if level == 1 else BRANCH


class LampView:
    """The occluders as one lamp sees them: in its own frame, turned towards it, those that it can't meet left out.

    In the lamp's frame x and y lie in its plane, z runs into the scene and the origin is its middle; only the axes are
    turned for a distant lamp. A polygon that the lamp's light may cross from behind stands for two, one each way.

    polygon: (n,) int of the occluders' polygons. sign: (n,) float64, 1, or −1 where the polygon is turned around.
    normal: (n, 3) float64 towards the lamp, level: (n,) its plane's offset. cut: (n,) bool, the lamp lies on both sides
    of the plane. touching: (n,) bool, so near to the lamp that rays end before it.
    """

    def __init__(self, occluders: Occluders, lamp: LampSamples, deepest: float):
        """deepest: the largest distance of a receiver from the lamp's plane, m."""
        polygons = occluders.polygons
        self.occluders, self.lamp = occluders, lamp
        origin = np.zeros(3) if lamp.distant else lamp.centre
        self.origin = origin
        normal = polygons.normal @ lamp.axes.T
        level = np.einsum("nd,nd->n", polygons.normal, polygons.vertices[polygons.first[:-1]] - origin)
        corners = (lamp.corners() - origin) @ lamp.axes.T
        side = normal @ corners.T - (0 if lamp.distant else level[:, None])
        near = 1e-6 if lamp.distant else occluders.near_plane
        low, high = occluders.frame_boxes(lamp, occluders.middle, occluders.half)
        front, back = side.max(axis=1, initial=-np.inf) > -near, side.min(axis=1, initial=np.inf) < near
        # light that leaves a watertight part goes through a face turned towards the lamp, if the lamp is outside
        back &= ~(polygons.closed & self._outside(corners))[polygons.part]
        touching = np.zeros(len(polygons), bool)
        if not lamp.distant:
            short = SHORT * deepest + near
            flat = high[:, 2] < lamp.half[2] - short if lamp.one_sided and lamp.planar else np.zeros(len(low), bool)
            front &= ~flat
            back &= ~flat
            around = lamp.half + short
            touching = ((low <= around) & (high >= -around)).all(axis=1)
        chosen = np.append(np.flatnonzero(front), np.flatnonzero(back))
        sign = np.append(np.ones(np.count_nonzero(front)), -np.ones(np.count_nonzero(back)))
        order = np.argsort(chosen, kind="stable")
        self.polygon, self.sign = chosen[order], sign[order]
        self.normal = normal[self.polygon] * self.sign[:, None]
        self.level = level[self.polygon] * self.sign
        self.cut = (side[self.polygon] * self.sign[:, None]).min(axis=1, initial=np.inf) < near
        self.touching = touching[self.polygon]
        self.sides = polygons.sides[self.polygon]
        # float32, and larger by its rounding
        slack = np.float32(occluders.near_plane)
        self.tree = Tree.of(low[self.polygon].astype(np.float32) - slack, high[self.polygon].astype(np.float32) + slack)

    def __len__(self) -> int:
        return len(self.polygon)

    def _outside(self, corners):
        """(parts,) bool: whether the lamp is outside of each part's box."""
        if self.lamp.distant:
            return np.ones(len(self.occluders.part_low), bool)
        world = self.lamp.corners()
        low, high = self.occluders.part_low, self.occluders.part_high
        gap = self.occluders.near_plane
        return ((world.min(axis=0) > high + gap) | (world.max(axis=0) < low - gap)).any(axis=1)

    def coefficients(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lines of the polygons `rows`: (e, 3, 4) float64 (see lines.edge_coefficients), an edge after another and the
        line in which the polygon's plane cuts the lamp where it does; and (len(rows) + 1,) int where each begins."""
        first, sides = self.occluders.polygons.first[self.polygon[rows]], self.sides[rows]
        total = sides + self.cut[rows]
        begin = np.append(0, np.cumsum(total))
        edge = np.arange(begin[-1]) - np.repeat(begin[:-1], total)
        owner = np.repeat(np.arange(len(rows)), total)
        plane = edge >= sides[owner]
        start = first[owner] + np.where(plane, 0, edge)
        end = first[owner] + np.where(edge + 1 >= sides[owner], 0, edge + 1)
        vertices = self.occluders.polygons.vertices
        a, b = ((vertices[at] - self.origin) @ self.lamp.axes.T for at in (start, end))
        lines = edge_coefficients(a, b, self.lamp.half, self.lamp.distant)
        lines *= self.sign[rows][owner, None, None]
        cuts = np.flatnonzero(plane)
        if len(cuts):
            normal, level = self.normal[rows[owner[cuts]]], self.level[rows[owner[cuts]]]
            lines[cuts] = 0
            lines[cuts, 0, 0], lines[cuts, 1, 0] = (normal[:, k] * self.lamp.half[k] for k in (0, 1))
            # a distant lamp's middle is at −z
            lines[cuts, 2, 0] = -normal[:, 2] if self.lamp.distant else -level
        return lines, begin
