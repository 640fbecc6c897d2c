"""The volumes of hierarchical penumbra casting: what a triangle may hide of a lamp, of a group of samples, of one sample.

Laine & Aila 2005, "Light Sample Hierarchy" and "Penumbra Volumes". All points from which a triangle may block a ray to a
node of the light hierarchy lie in the node's penumbra volume; that of a single sample is its hard shadow. Embree is the
judge of visibility, so each volume keeps clear of what Embree's rounding could decide otherwise.

Geometry here is local: float64, the diagonal of everything is 1, so that tolerances need no units (see `Space`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .lamp import LampSamples

GUARD = 2e-6
"""Embree's error in the place of a ray beside an edge, over the distances it works with: about 16 float32 roundings are
possible, 30 are allowed."""

END = 1 - 1e-4
"""Shadow rays end at this part of their segment (Bvh.occluded)."""

NEEDLE = 1e4
"""A triangle so many times longer than high has no volume to rely on."""

_TOUCH = 1e-10
"""What float64 leaves of a zero."""

_SQUARE = np.array([[0, 1], [1, 3], [3, 2], [2, 0]])
_CUBE = np.array([[i, i | bit] for bit in (1, 2, 4) for i in range(8) if not i & bit])


@dataclass(frozen=True)
class Space:
    """centre (3,) float64 and extent, m, of all points, corners and samples. band: local width of what is left to rays."""

    centre: np.ndarray
    extent: float
    band: float

    @classmethod
    def around(cls, *places: np.ndarray) -> Space:
        """The space of all `places`, each (n, 3), m."""
        points = np.concatenate([np.asarray(p, np.float64).reshape(-1, 3) for p in places])
        low, high = points.min(axis=0), points.max(axis=0)
        extent = float(np.linalg.norm(high - low)) or 1.0
        # Embree's boxes round with the distance from the origin, its triangles with that from the ray's
        return cls((low + high) / 2, extent, GUARD * (1 + float(np.abs(points).max()) / extent))

    def local(self, places: np.ndarray) -> np.ndarray:
        """float64 places (…, 3), m, within this space."""
        return (np.asarray(places, np.float64) - self.centre) / self.extent


@dataclass(frozen=True)
class LightHierarchy:
    """Three fixed levels: the lamp, groups of its samples, the samples ("Light Sample Hierarchy").

    samples: (sets, L, 3) float64 local places, or unit vectors towards the samples of a distant lamp.
    span: (sets, L) float64: a shadow ray is so many times as long as the vector towards its sample.
    near: 1.0, or 0.0 for a distant lamp: the fourth, homogeneous coordinate of its samples.
    root: (1, k, 3), groups: (g, k, 3) float64 corners of boxes around samples; k = 4 for planar lamps, otherwise 8.
    rim: (edges, 2) which of these corners are the ends of an edge.
    group: (sets, L) int of each sample. A group is a part of the lamp, the same for all sets.
    """

    samples: np.ndarray
    span: np.ndarray
    near: float
    root: np.ndarray
    groups: np.ndarray
    rim: np.ndarray
    group: np.ndarray


def light_hierarchy(lamp: LampSamples, space: Space) -> LightHierarchy:
    """The hierarchy of a lamp's samples in `space`: about √L groups, so that each level prunes about as much."""
    targets = lamp.targets().astype(np.float64)
    samples, span = space.local(targets), np.ones(targets.shape[:2])
    if lamp.distant:
        samples, span = targets, np.full(targets.shape[:2], lamp.reach / space.extent)
    dimensions = 2 if lamp.planar else 3
    side = max(1, round(lamp.count ** (0.5 / dimensions)))
    cell = np.clip(((lamp.places[..., :dimensions] + 1) * (side / 2)).astype(int), 0, side - 1) @ side ** np.arange(
        dimensions
    )
    held, group = np.unique(cell, return_inverse=True)
    root = _box(samples.reshape(1, -1, 3), lamp)
    groups = np.concatenate([_box(samples[cell == c][None], lamp) for c in held])
    if lamp.distant:
        # only directions count, so that all may have one length; those far from the sun's middle are longer
        length = np.linalg.norm(samples, axis=2)
        samples, span = samples / length[..., None], span * length
        root, groups = (corners / np.linalg.norm(corners, axis=2, keepdims=True) for corners in (root, groups))
    rim = _SQUARE if lamp.planar else _CUBE
    # numpy 2.0 alone gives the inverse flat
    return LightHierarchy(samples, span, float(not lamp.distant), root, groups, rim, group.reshape(cell.shape))


def _box(samples: np.ndarray, lamp: LampSamples) -> np.ndarray:
    """(1, 4 or 8, 3) corners of the box along the lamp's axes around samples (1, n, 3)."""
    # axes of a lamp under a skewed parent need not be perpendicular
    axes = np.linalg.qr(lamp.axes.T)[0].T
    along = samples[0] @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    if lamp.planar:
        # all samples share this coordinate but for the rounding of their places to float32
        low[2] = high[2] = (low[2] + high[2]) / 2
    corner = np.arange(4 if lamp.planar else 8)[:, None] >> np.arange(3) & 1
    return (np.where(corner, high, low) @ axes)[None]


@dataclass(frozen=True)
class PenumbraVolumes:
    """Penumbra volumes of one triangle for v nodes of the light hierarchy, each an intersection of half-spaces.

    planes: (p, 4) float64, unit normals inwards. owner: (p,) which volume each bounds.
    face: (4,) the triangle's own plane. slack, lean: (v,), see `reach`.
    """

    planes: np.ndarray
    owner: np.ndarray
    face: np.ndarray
    slack: np.ndarray
    lean: np.ndarray

    def meet(self, middle: np.ndarray, half: np.ndarray, active: np.ndarray, tests: np.ndarray, keep: bool) -> int:
        """Test boxes, middle and half extents (n, 3), against the volumes; returns how many planes that took.

        active: (n, v) bool, whether a box may meet a volume; cleared in place where it does not.
        tests: (n, p) bool, the active plane sets: planes that a box is wholly inside of are cleared, in place, and need
        no test for the boxes within it. Not with `keep`.
        """
        box, plane = np.nonzero(tests & active[:, self.owner])
        normal, owner = self.planes[plane, :3], self.owner[plane]
        value = (normal * middle[box]).sum(axis=1) + self.planes[plane, 3]
        spread = (np.abs(normal) * half[box]).sum(axis=1)
        outside = value + spread < -self.reach(middle, half)[box, owner]
        active[box[outside], owner[outside]] = False
        if not keep:
            tests[box, plane] = value < spread
        return len(box)

    def reach(self, middle: np.ndarray, half: np.ndarray) -> np.ndarray:
        """(n, v) how far outside a volume's planes a box may be and still hold receivers that Embree finds blocked.

        Embree blocks rays that pass an edge by the width of its error. Behind a triangle near the lamp this width grows
        with the distance, and a triangle seen edge-on (or a needle) it prolongs: the sine between ray and triangle is
        at least the height over its plane of the light (lean) or of the receiver.
        """
        height = np.abs(middle @ self.face[:3] + self.face[3]) - half @ np.abs(self.face[:3])
        return self.slack / np.maximum(np.maximum(self.lean, height[:, None]), 1e-9)


def penumbra_volumes(triangle: np.ndarray, nodes: np.ndarray, lights: LightHierarchy, band: float) -> PenumbraVolumes:
    """Penumbra volumes of a triangle (3, 3) for light nodes (v, k, 3), all local ("Penumbra Volumes").

    A receiver hidden from light S by X on the triangle is at X + λ(X − S), λ > 0: so on the triangle's side of every
    plane that separates triangle and light. The tightest touch both: in an edge of one and a corner of the other, or in
    the triangle itself. Where none separates them, or the triangle has no area, the volume is all of space.
    """
    face, needle = _face(triangle)
    count = len(nodes)
    if needle > NEEDLE:
        return PenumbraVolumes(np.zeros((0, 4)), np.zeros(0, int), face, np.full(count, np.inf), np.zeros(count))
    planes = _planes(triangle, nodes, lights)
    planes = np.concatenate([planes, np.broadcast_to(face, (count, 1, 4))], axis=1)
    at_triangle = planes[..., :3] @ triangle.T + planes[..., 3:]
    at_light = planes[..., :3] @ nodes.transpose(0, 2, 1) + lights.near * planes[..., 3:]
    proper = planes[..., :3].any(axis=2)
    parts = []
    for sign in (1, -1):
        apart = proper & (sign * at_triangle >= -_TOUCH).all(axis=2) & (sign * at_light <= _TOUCH).all(axis=2)
        owner, chosen = np.nonzero(apart)
        parts.append((sign * planes[owner, chosen], owner))
    heights = at_light[:, -1]
    astride = np.minimum(heights.max(axis=1), -heights.min(axis=1)) >= 0
    lean = np.where(astride, 0, np.abs(heights).min(axis=1))
    slack = np.full(count, band * needle)
    if lights.near:
        between = np.maximum(nodes.min(axis=1) - triangle.max(axis=0), triangle.min(axis=0) - nodes.max(axis=1))
        gap = np.maximum(np.linalg.norm(np.maximum(between, 0), axis=1), lean)
        # λ, at most; a blocker nearer to the sample than END allows is none
        slack *= 1 + np.minimum(1 / np.maximum(gap, 1e-9), END / (1 - END))
    return PenumbraVolumes(
        np.concatenate([p for p, _ in parts]), np.concatenate([o for _, o in parts]), face, slack, lean
    )


def _planes(triangle, nodes, lights) -> np.ndarray:
    """(v, c, 4) planes through an edge of the triangle and a corner of the light, or the other way round."""
    towards = nodes[:, None] - lights.near * triangle[:, None]
    edges = np.roll(triangle, -1, axis=0) - triangle
    by_edge = cross(edges[:, None], towards)
    by_corner = cross(towards[:, :, lights.rim[:, 0]], towards[:, :, lights.rim[:, 1]])
    normals = np.concatenate([by_edge, by_corner], axis=2)
    length = np.linalg.norm(normals, axis=3, keepdims=True)
    # a corner in line with an edge makes no plane
    normals = np.where(length > 1e-7, normals / np.maximum(length, 1e-7), 0)
    offsets = -(normals * triangle[:, None]).sum(axis=3, keepdims=True)
    return np.concatenate([normals, offsets], axis=3).reshape(len(nodes), -1, 4)


def _face(triangle) -> tuple[np.ndarray, float]:
    """The triangle's plane (4,), and how many times longer than high it is: about 1 to NEEDLE, or infinite."""
    normal = cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
    longest = np.square(triangle - np.roll(triangle, 1, axis=0)).sum(axis=1).max()
    area = np.linalg.norm(normal)
    if area * NEEDLE <= longest:
        return np.zeros(4), np.inf
    unit = normal / area
    return np.append(unit, -unit @ triangle[0]), float(longest / area)


@dataclass(frozen=True)
class HardShadows:
    """Hard shadow volumes of one triangle for s samples: planes through the sample and each edge, and the triangle's own.

    samples: (s, 3), local. sides: (s, 3, 4) float64 planes, not unit: their value at a receiver is the volume that
    receiver, sample and edge span. face: (4,), likewise. near: as in LightHierarchy; span: (s,), too. longest: edge,
    local. corners: (3, 3) and terms: (3,), the sums of what the face's normal is a difference of, which bound its error.
    """

    samples: np.ndarray
    sides: np.ndarray
    face: np.ndarray
    near: float
    span: np.ndarray
    longest: float
    corners: np.ndarray
    terms: np.ndarray
    band: float

    def test(self, points: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Whether samples `which` (n,) are blocked from points (n, 3): (n,) bool, and (n,) bool, which rays must decide.

        Whatever is in neither is not blocked: by this triangle.
        """
        samples, span, sides = self.samples[which], self.span[which], self.sides[which]
        volume = np.einsum("nsd,nd->ns", sides[:, :, :3], points) + sides[:, :, 3]
        doubt = self.band * self.longest * np.linalg.norm(samples - self.near * points, axis=1)
        least, most = volume.min(axis=1), volume.max(axis=1)
        beside = (least < -doubt) & (most > doubt)
        through = (least > doubt) | (most < -doubt)
        # height of both ends of the ray over the triangle's plane
        start = points @ self.face[:3] + self.face[3]
        light = samples @ self.face[:3] + self.near * self.face[3]
        end = start + END * span * (light - self.near * start)
        # most receivers lie on some triangle: a bound for its own normal leaves fewer of them to rays
        reach = np.abs(points[:, None] - self.corners).max(axis=1)
        start_doubt = GUARD * (reach @ self.terms) + self.band * np.linalg.norm(self.face[:3])
        end_doubt = self.band * self.longest**2 * np.maximum(span, 1)
        clear = (np.abs(start) > start_doubt) & (np.abs(end) > end_doubt)
        crosses = (start > 0) != (end > 0)
        blocked = through & clear & crosses
        return blocked, ~(blocked | beside | clear & ~crosses)


def hard_shadows(triangle: np.ndarray, lights: LightHierarchy, chosen: np.ndarray, band: float) -> HardShadows:
    """Hard shadow volumes of a triangle (3, 3) for samples `chosen` (s,), each set · L + sample, local
    ("Processing a Triangle")."""
    samples, span = lights.samples.reshape(-1, 3)[chosen], lights.span.ravel()[chosen]
    edges = np.roll(triangle, -1, axis=0) - triangle
    normals = cross(samples[:, None] - lights.near * triangle, edges)
    sides = np.concatenate([normals, -(normals * triangle).sum(axis=2, keepdims=True)], axis=2)
    normal = cross(edges[0], edges[1])
    face = np.append(normal, -normal @ triangle[0])
    longest = float(np.linalg.norm(edges, axis=1).max())
    sizes = np.abs(edges)
    terms = (
        sizes[:, [1, 2, 0]] * sizes[[1, 2, 0]][:, [2, 0, 1]] + sizes[:, [2, 0, 1]] * sizes[[1, 2, 0]][:, [1, 2, 0]]
    ).max(axis=0)
    return HardShadows(samples, sides, face, lights.near, span, longest, triangle, terms, band)


def cross(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Cross products of (…, 3) and (…, 3); numpy's own takes ten times as long for a few."""
    after, before = [1, 2, 0], [2, 0, 1]
    return left[..., after] * right[..., before] - left[..., before] * right[..., after]
