"""Patches end at walls: light on one side of a wall is not light on the other.

A floor of one mesh goes on below the walls that stand on it, and a patch that reaches across would shine on both sides. So
pieces are cut along the planes of what stands between their corners, and the pieces of a patch stay together only as far
as they see one another. Segments just above the surface tell, at a few heights, so that a low bump parts nothing.
"""

from __future__ import annotations

import numpy as np

from ..rays import Hits, Tracer, chunks
from ..threads import in_threads
from .components import components

HEIGHTS = (1 / 32, 1 / 8, 1 / 2)
"""Above the surface, at which places see one another: in sizes of a patch, ascending."""

INSET = 1e-4
"""How far from its corners, of the way to its middle, a piece is looked across."""

CUTS = 5
"""Times that a piece is cut, its parts again."""

FINEST = 1 / 8
"""Pieces shorter than this part of a patch's size are not cut."""

STEEP = 0.9
"""Cosine of the angle between a surface and what stands on it, above which that is no wall."""

SLIVER = 1e-5
"""Part of a piece's longest edge, nearer than which to a cut its corners lie on it: what is left beyond a wall joins rooms."""

FLAT, FLUSH = 1 / 8, 1 / 64
"""Of a patch's size, how far off its plane its pieces may lie if they hang together, and if not: the leaves of a tree hide
one another, and are no floor."""

LOOKS = 16
"""Pieces of a patch that are looked at before all of them are."""

LINK = 1 / 16
"""Of a patch's area, what two of its parts have to see together to stay one: a ray may slip through an edge of a wall."""

LEADERS = 6
"""Pieces of a patch that others are seen from before the rest is one more part."""


def cut_at_walls(pieces: tuple, size: float, tracer: Tracer) -> tuple:
    """Pieces as from `bisect`, those on which walls stand cut along the walls' planes. size: of a patch, m."""
    corners, parent, weights = pieces
    look = np.flatnonzero(_longest(corners) > FINEST * size)
    for _ in range(CUTS):
        signed, crossed = _planes(corners[look], size, tracer)
        look = look[crossed]
        if not len(look):
            break
        values = np.concatenate([corners[look], weights[look]], axis=2).astype(np.float64)
        made, origin = _cut(values, signed[crossed])
        made = made.astype(np.float32)
        # what rounding leaves nothing of
        some = _middles(made[..., :3])[2] > 0
        made, origin = made[some], origin[some]
        kept = np.ones(len(corners), bool)
        kept[look] = False
        corners = np.concatenate([corners[kept], made[..., :3]])
        weights = np.concatenate([weights[kept], made[..., 3:]])
        parent = np.concatenate([parent[kept], parent[look[origin]]])
        fresh = np.arange(kept.sum(), len(corners))
        look = fresh[_longest(corners[fresh]) > FINEST * size]
    return corners, parent, weights


def part_at_walls(
    corners: np.ndarray, mesh: np.ndarray, patch: np.ndarray, count: int, size: float, tracer: Tracer
) -> tuple[np.ndarray, int]:
    """Patch (p,) int32 of each piece (p, 3, 3): those given, `count`, in parts of which none sees the others; and how many
    are more than the part of a floor that lies inside of a wall. Where no wall stands they keep their numbers.

    mesh: (p,) the connected part of a mesh that each piece is of.
    """
    centre, normal, area = _middles(corners)
    total = np.bincount(patch, area, count)
    number = np.bincount(patch, minlength=count)

    def mean(values):
        return np.stack([np.bincount(patch, values[:, k] * area, count) for k in range(3)], 1)

    middle = mean(centre) / np.maximum(total, 1e-300)[:, None]
    plane = mean(normal)
    plane /= np.maximum(np.linalg.norm(plane, axis=1, keepdims=True), 1e-300)
    off = np.abs(np.einsum("pk,pk->p", centre - middle[patch], plane[patch]))
    flat = number > 1
    one = np.empty(count, np.int64)
    one[patch] = mesh
    mixed = np.zeros(count, bool)
    mixed[patch[one[patch] != mesh]] = True
    flat[patch[off > np.where(mixed, FLUSH, FLAT)[patch] * size]] = False
    # by patch, the largest piece first
    order = np.lexsort((np.arange(len(patch)), -area, patch))
    rank = np.empty(len(patch), np.int64)
    rank[order] = np.arange(len(patch)) - np.repeat(np.cumsum(number) - number, number)
    leader = order[np.cumsum(number) - number]
    some = np.flatnonzero(flat[patch] & (rank > 0) & (rank % np.maximum(-(-number // LOOKS), 1)[patch] == 0))
    key, inside = patch.astype(np.int64), np.zeros(len(patch), bool)
    for side in (1, -1):
        sight = _Sight(tracer, size, centre.astype(np.float32), (side * normal).astype(np.float32))
        crossed = np.zeros(count, bool)
        crossed[patch[some[sight.parted(leader[patch[some]], some)]]] = True
        rows = np.flatnonzero(crossed[patch])
        if len(rows):
            part = np.zeros(len(patch), np.int64)
            part[rows] = _parts(sight, patch[rows], rows, area[rows])
            key = key * (LEADERS + 1) + part
            if side == 1:
                inside[rows] = sight.inside(rows)
    names, part = np.unique(key, return_inverse=True)
    if len(names) == count:
        return patch, count
    part = part.reshape(-1).astype(np.int32)
    seen = np.zeros(len(names), bool)
    seen[part[~inside]] = True
    return part, int(seen.sum())


class _Sight:
    """Which places see one another above a surface. points, normals: (n, 3) float32; size: of a patch, m."""

    def __init__(self, tracer: Tracer, size: float, points: np.ndarray, normals: np.ndarray):
        self.scene, (self.bvh, self.numbers) = tracer.scene, tracer.solid
        self.points, self.normals = points, normals
        # lower than rays can start there is nothing to see
        self.heights = np.maximum(np.float32(size) * np.array(HEIGHTS, np.float32), np.float32(2 * tracer.offset))
        self.lift = np.float32(tracer.offset)
        self._level = np.full(len(points), -1)

    def level(self, rows: np.ndarray) -> np.ndarray:
        """How many of the heights are free above each place."""
        asked = np.zeros(len(self.points), bool)
        asked[rows] = True
        new = np.flatnonzero(asked & (self._level < 0))
        if len(new):
            normals = self.normals[new]
            reach = np.full(len(new), self.heights[-1], np.float32)
            hits = self._hits(self.points[new] + normals * self.lift, normals, reach)
            free = np.where(hits.triangle < 0, np.inf, hits.distance + self.lift)
            self._level[new] = np.searchsorted(self.heights, free)
        return self._level[rows]

    def parted(self, here: np.ndarray, there: np.ndarray) -> np.ndarray:
        """(m,) bool: whether something stands between places at every height that both reach.

        Where one is covered and the other is not, the lowest height tells; two that are covered are alike.
        """
        # whatever else there is, the lowest height is blocked
        pending = np.flatnonzero(self._blocked(here, there, 0))
        level = np.stack([self.level(here[pending]), self.level(there[pending])])
        pending, level = pending[level.any(axis=0)], level[:, level.any(axis=0)]
        low = level.min(axis=0)
        for k in range(1, len(HEIGHTS)):
            kept = (k >= low) | self._blocked(here[pending], there[pending], k)
            pending, low = pending[kept], low[kept]
        result = np.zeros(len(here), bool)
        result[pending] = True
        return result

    def between(self, here: np.ndarray, there: np.ndarray) -> np.ndarray:
        """(m,) triangle of the scene that parts places which are parted, seen from the first of them; −1 for none."""
        top = np.maximum(np.minimum(self.level(here), self.level(there)), 1) - 1
        origins, vectors = self._segment(here, there, self.heights[top][:, None])
        found = self._hits(origins, vectors, np.ones(len(origins), np.float32)).triangle
        return np.where(found < 0, -1, np.append(self.numbers, -1)[found])

    def inside(self, rows: np.ndarray) -> np.ndarray:
        """(m,) bool: whether the back of something is what lies above places."""
        normals = self.normals[rows]
        far = np.full(len(rows), 1e30, np.float32)
        found = self._hits(self.points[rows] + normals * self.lift, normals, far).triangle
        cross = self.scene.triangle_cross(np.append(self.numbers, 0)[found])
        return (found >= 0) & (np.einsum("mk,mk->m", cross, normals) > 0)

    def _segment(self, here, there, height):
        origins = self.points[here] + self.normals[here] * height
        return origins, self.points[there] + self.normals[there] * height - origins

    def _blocked(self, here, there, k):
        origins, vectors = self._segment(here, there, self.heights[k])
        found = in_threads(lambda s: self.bvh.occluded(origins[s], vectors[s]), chunks(len(origins)))
        return np.concatenate([*found, np.zeros(0, bool)])

    def _hits(self, origins, vectors, reach):
        found = [self.bvh.hits(origins[s], vectors[s], reach[s]) for s in chunks(len(origins))]
        return Hits(*(np.concatenate(values) for values in zip(*found, strict=True)))


def _parts(sight, patch, rows, area):
    """(n,) part, of at most LEADERS + 1, that each piece of patches (n,) is in. rows: their numbers for `sight`."""
    names, own = np.unique(patch, return_inverse=True)
    own = own.reshape(-1)
    label = np.full(len(rows), LEADERS)
    order = np.lexsort((np.arange(len(rows)), -area, own))
    each, links, shared = LEADERS + 1, [], []
    for turn in range(LEADERS):
        rest = order[label[order] == LEADERS]
        if not len(rest):
            break
        led, first = np.unique(own[rest], return_index=True)
        leader = np.full(len(names), -1)
        leader[led] = rest[first]
        asked = np.flatnonzero(leader[own] >= 0)
        seen = asked[~sight.parted(rows[leader[own[asked]]], rows[asked])]
        fresh = label[seen] == LEADERS
        label[seen[fresh]] = turn
        label[leader[led]] = turn
        both = seen[~fresh]
        links.append((own[both] * each + label[both]) * each + turn)
        shared.append(area[both])
    links, place = np.unique(np.concatenate(links), return_inverse=True)
    total = np.bincount(own, area)
    firm = np.bincount(place.reshape(-1), np.concatenate(shared), len(links)) > LINK * total[links // each**2]
    here = links[firm] // each
    there = here // each * each + links[firm] % each
    whole = components(len(names) * each, here, there)
    first = np.full(whole.max() + 1, -1)
    node = np.arange(len(whole))[::-1]
    first[whole[node]] = node
    return first[whole[own * each + label]] % each


def _planes(corners, size, tracer):
    """Of pieces (m, 3, 3): float64 m, how far (m, 3) their corners are from the plane of what parts them, and (m,) bool
    whether anything does."""
    centre, normal, _ = _middles(corners)
    places = (corners + INSET * (centre[:, None] - corners)).reshape(-1, 3).astype(np.float32)
    scene, count = tracer.scene, len(corners)
    signed, crossed = np.zeros((count, 3)), np.zeros(count, bool)
    # nor nearer than float32 tells places apart
    nearest = np.maximum(SLIVER * _longest(corners), 1e-6 * np.abs(scene.positions).max(initial=0))
    for side in (1, -1):
        sight = _Sight(tracer, size, places, np.repeat(side * normal, 3, axis=0).astype(np.float32))
        for k in range(3):
            rows = np.flatnonzero(~crossed)
            here, there = 3 * rows + k, 3 * rows + (k + 1) % 3
            found = sight.parted(here, there)
            rows, here, there = rows[found], here[found], there[found]
            if not len(rows):
                continue
            triangle = sight.between(here, there)
            met = triangle >= 0
            rows, triangle = rows[met], triangle[met]
            point = scene.positions[scene.triangles[triangle]].astype(np.float64)
            across = np.cross(point[:, 1] - point[:, 0], point[:, 2] - point[:, 0])
            across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
            off = np.einsum("nkc,nc->nk", corners[rows] - point[:, :1], across)
            off[np.abs(off) < nearest[rows, None]] = 0
            steep = np.abs(np.einsum("nc,nc->n", across, normal[rows])) < STEEP
            through = steep & (off.min(axis=1) < 0) & (off.max(axis=1) > 0)
            signed[rows[through]], crossed[rows[through]] = off[through], True
    return signed, crossed


def _cut(values, signed):
    """Triangles of corners' values (m, 3, c) in the parts (n, 3, c) that planes cut them into, and (n,) the triangle of
    each. signed: (m, 3) the corners' distances, of both signs."""
    sign = np.sign(signed)
    through = (sign == 0).any(axis=1)
    # first the corner on the plane, or the one that is alone on its side
    lone = np.where(through[:, None], sign == 0, sign == -sign.sum(axis=1, keepdims=True))
    turn = (lone.argmax(axis=1)[:, None] + np.arange(3)) % 3
    rows = np.arange(len(values))[:, None]
    values, signed = values[rows, turn], signed[rows, turn]

    def point(some, i, j):
        t = (signed[some, i] / (signed[some, i] - signed[some, j]))[:, None]
        return values[some, i] * (1 - t) + values[some, j] * t

    whole, halved = np.flatnonzero(~through), np.flatnonzero(through)
    a, b, c = (values[whole, k] for k in range(3))
    p, q = point(whole, 0, 1), point(whole, 0, 2)
    d, e, f = (values[halved, k] for k in range(3))
    r = point(halved, 1, 2)
    made = [(a, p, q), (p, b, c), (p, c, q), (d, e, r), (d, r, f)]
    origin = np.concatenate([whole, whole, whole, halved, halved])
    return np.concatenate([np.stack(part, 1) for part in made]), origin


def _middles(corners):
    """Centre (p, 3), unit normal (p, 3) and area (p,), float64, of triangles."""
    corners = corners.astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1)
    return corners.mean(axis=1), cross / np.maximum(length, 1e-300)[:, None], 0.5 * length


def _longest(corners):
    return np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
