"""Triangles joined to convex polygons, so that there are fewer occluders: what lies in one plane and meets edge to edge.

Where a flat part of a mesh is convex as a whole, whatever it is cut into, it becomes one polygon; elsewhere pairs of
triangles become quads.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..surface.components import components

FLAT = 4e-7
"""Distance from a plane or a line, in parts of the largest coordinate, that float32 vertices of a flat face may have."""

TURN = 1e-4
"""Radians between edges that count as one, if the places between them are on the line."""


MOST_SIDES = 64
"""Sides of a polygon; what has more stays in pieces."""


@dataclass(frozen=True)
class Polygons:
    """vertices: (v, 3) float64, m, the polygons' corners, anticlockwise around their normals, one polygon after another.
    first: (p + 1,) int32 first corner of each. normal: (p, 3) float64 unit. part: (p,) int32, which connected piece of
    surface each belongs to. closed: (parts,) bool, whether that piece is watertight, its normals outwards.
    """

    vertices: np.ndarray
    first: np.ndarray
    normal: np.ndarray
    part: np.ndarray
    closed: np.ndarray

    def __len__(self) -> int:
        return len(self.normal)

    @property
    def sides(self) -> np.ndarray:
        """(p,) int32 number of edges."""
        return np.diff(self.first)


def make_polygons(corners: np.ndarray, merge: bool = True) -> Polygons:
    """Polygons of triangles, (T, 3, 3) float32 corners in m; triangles as they are if not `merge`. Triangles without
    an area, to float32's precision, keep their place: they block nothing that rays would not decide."""
    corners = np.asarray(corners, np.float32)
    if not len(corners):
        return Polygons(
            np.zeros((0, 3)), np.zeros(1, np.int32), np.zeros((0, 3)), np.zeros(0, np.int32), np.zeros(0, bool)
        )
    vertex = _weld(corners.reshape(-1, 3)).reshape(-1, 3)
    # float64: products of places cancel
    places = corners.astype(np.float64)
    cross = np.cross(places[:, 1] - places[:, 0], places[:, 2] - places[:, 0])
    normal = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)
    mate = _mates(vertex)
    part = _parts(mate)
    closed, inverted = _closed(places, mate, part)
    flip = inverted[part]
    vertex[flip], places[flip] = vertex[flip][:, ::-1], places[flip][:, ::-1]
    normal[flip] *= -1
    # the edge opposite to where it was: (0,1), (1,2), (2,0) of reversed corners are (1,2), (0,1), (2,0)
    mate = _mates(vertex)
    first = np.arange(0, 3 * len(corners) + 1, 3, dtype=np.int32)
    plain = Polygons(places.reshape(-1, 3), first, normal, part, closed)
    if not merge:
        return plain
    tolerance = FLAT * float(np.abs(corners).max())
    return _merge(plain, vertex, mate, tolerance)


def _weld(places: np.ndarray) -> np.ndarray:
    """(n,) int64 number of each place; equal places, to the last bit, have the same."""
    places = places + np.float32(0)  # −0 is 0
    words = np.ascontiguousarray(places).view(np.uint32).astype(np.uint64)
    key = words[:, 0] * np.uint64(0x9E3779B97F4A7C15) ^ words[:, 1] * np.uint64(0xC2B2AE3D27D4EB4F)
    key = (key ^ key >> np.uint64(29)) * np.uint64(0xBF58476D1CE4E5B9) + words[:, 2] * np.uint64(0x94D049BB133111EB)
    _, first, number = np.unique(key, return_index=True, return_inverse=True)
    number = number.reshape(-1)
    if (places[first[number]] != places).any():
        # two places with one key: sort the places themselves
        number = np.unique(places, axis=0, return_inverse=True)[1].reshape(-1)
    return number


def _mates(vertex: np.ndarray) -> np.ndarray:
    """(T, 3) int64 half-edge 3 · triangle + k that runs back along each half-edge, −1 where there is none or several."""
    start, end = vertex.ravel(), np.roll(vertex, -1, axis=1).ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    key = low * (int(vertex.max()) + 1) + high
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    new = np.append(True, ordered[1:] != ordered[:-1])
    begin = np.flatnonzero(new)
    count = np.diff(np.append(begin, len(ordered)))
    pair = begin[count == 2]
    a, b = order[pair], order[pair + 1]
    opposite = start[a] == end[b]
    mate = np.full(len(key), -1, np.int64)
    mate[a[opposite]], mate[b[opposite]] = b[opposite], a[opposite]
    return mate.reshape(-1, 3)


def _parts(mate: np.ndarray, keep: np.ndarray | None = None) -> np.ndarray:
    """(T,) int32 number of the connected part of each triangle; keep: (T, 3) bool, mates that connect."""
    linked = mate >= 0 if keep is None else keep
    return components(len(mate), np.nonzero(linked)[0], mate[linked] // 3)


def _closed(places, mate, part):
    """Two (parts,) bool: watertight, and watertight with its normals inwards."""
    open_edges = np.bincount(part, (mate < 0).sum(axis=1))
    middle = np.zeros((len(open_edges), 3))
    size = np.bincount(part)
    for axis in range(3):
        middle[:, axis] = np.bincount(part, places[:, :, axis].mean(axis=1)) / size
    local = places - middle[part][:, None]
    volume = np.bincount(part, np.einsum("nd,nd->n", local[:, 0], np.cross(local[:, 1], local[:, 2])))
    closed = (open_edges == 0) & (volume != 0)
    return closed, closed & (volume < 0)


def _merge(plain: Polygons, vertex, mate, tolerance) -> Polygons:
    """Flat convex parts as one polygon, pairs of triangles elsewhere."""
    triangles = plain.vertices.reshape(-1, 3, 3)
    flat = (mate >= 0) & _in_plane(plain, triangles, mate, tolerance)
    patch = _parts(mate, flat)
    polygon, taken = _whole_patches(plain, triangles, mate, flat, patch, tolerance)
    quads, paired = _pairs(plain, triangles, mate, flat & ~taken[:, None], tolerance)
    rest = np.flatnonzero(~taken & ~paired)
    pieces = [polygon, quads, (triangles[rest].reshape(-1, 3), np.full(len(rest), 3), rest)]
    vertices = np.concatenate([p[0] for p in pieces])
    sides = np.concatenate([p[1] for p in pieces])
    of = np.concatenate([p[2] for p in pieces]).astype(np.int64)
    first = np.append(0, np.cumsum(sides)).astype(np.int32)
    return Polygons(vertices, first, plain.normal[of], plain.part[of], plain.closed)


def _in_plane(plain, triangles, mate, tolerance):
    """(T, 3) bool: whether the triangle across each half-edge lies in the same plane, unfolded."""
    other = np.maximum(mate, 0)
    apex = triangles[other // 3, (other % 3 + 2) % 3]
    height = np.abs(np.einsum("tkd,td->tk", apex - triangles[:, :1], plain.normal))
    alike = np.einsum("tkd,td->tk", plain.normal[other // 3], plain.normal) > 0
    # judged from both sides, so that a sliver's unsteady normal joins nothing
    both = height <= tolerance
    return both & both.ravel()[other] & alike & (np.linalg.norm(plain.normal, axis=1) > 0.5)[:, None]


def _whole_patches(plain, triangles, mate, flat, patch, tolerance):
    """Polygons (vertices, sides, a triangle of each) of the patches that are convex; (T,) bool, their triangles.

    A convex polygon's edges, sorted by their direction, follow one another.
    """
    size = np.bincount(patch)
    border = ~flat & (size[patch] > 1)[:, None]
    edge_patch = np.broadcast_to(patch[:, None], border.shape)[border]
    start = triangles[border]
    end = np.roll(triangles, -1, axis=1)[border]
    none = (np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0, np.int64)), np.zeros(len(triangles), bool)
    if not len(edge_patch):
        return none
    # a frame for each patch: its first triangle's plane, its first border edge the x axis
    lead = np.zeros(len(size), np.int64)
    lead[patch[::-1]] = np.arange(len(patch))[::-1]
    order = np.argsort(edge_patch, kind="stable")
    edge_patch, start, end = edge_patch[order], start[order], end[order]
    begin = np.flatnonzero(np.append(True, edge_patch[1:] != edge_patch[:-1]))
    run = np.repeat(np.arange(len(begin)), np.diff(np.append(begin, len(edge_patch))))
    along = end - start
    length = np.linalg.norm(along, axis=1)
    x = along[begin] / np.maximum(length[begin], 1e-300)[:, None]
    n = plain.normal[lead[edge_patch[begin]]]
    y = np.cross(n, x)
    # half a step back, so that edges in line with the first one are not cut apart at ± π
    angle = np.arctan2(np.einsum("nd,nd->n", along, y[run]), np.einsum("nd,nd->n", along, x[run]))
    angle = (angle + TURN) % (2 * np.pi)
    order = np.lexsort((angle, run))
    run, start, end, angle, along, length = (v[order] for v in (run, start, end, angle, along, length))
    fresh = np.append(True, (run[1:] != run[:-1]) | (angle[1:] - angle[:-1] > TURN))
    chain = np.cumsum(fresh) - 1
    # within a chain, in the order in which they are walked
    lead_edge = np.flatnonzero(fresh)
    walk = np.einsum("nd,nd->n", start - start[lead_edge[chain]], along[lead_edge[chain]])
    order = np.lexsort((walk, chain))
    run, start, end, chain = run[order], start[order], end[order], chain[order]
    head = np.flatnonzero(np.append(True, chain[1:] != chain[:-1]))
    tail = np.append(head[1:], len(chain)) - 1
    step = np.ones(len(chain), bool)
    # every edge begins where the one before it ends; a run's first edge where its last one ends
    opening = np.flatnonzero(np.append(True, run[1:] != run[:-1]))
    closing = np.append(opening[1:], len(run)) - 1
    before = np.arange(len(run)) - 1
    before[opening] = closing
    step = (end[before] == start).all(axis=1)
    # and what a chain leaves out lies on its line
    line = end[tail] - start[head]
    away = start - start[head[chain]]
    line_length = np.maximum(np.linalg.norm(line, axis=1), 1e-300)
    off = np.linalg.norm(np.cross(away, line[chain]), axis=1) / line_length[chain]
    good = np.bincount(run, ~step | (off > tolerance)) == 0
    chains = np.bincount(run[head], minlength=len(good))
    good &= (chains >= 3) & (chains <= MOST_SIDES)
    # once around, and no more: the polygon's own area is that of its triangles
    area = np.zeros(len(good))
    a, b = start[head], start[np.append(head[1:], 0)]
    own = run[head]
    first_of = np.append(0, np.cumsum(chains))[:-1]
    last_of = np.cumsum(chains) - 1
    b[last_of] = a[first_of]
    area = np.bincount(
        own, np.einsum("nd,nd->n", np.cross(a - a[first_of][own], b - a[first_of][own]), n[own]), len(good)
    )
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    sum_ = np.bincount(patch, np.linalg.norm(cross, axis=1), len(size))
    names = edge_patch[begin]
    good &= np.abs(area - sum_[names]) <= 1e-5 * sum_[names]
    taken = np.zeros(len(size), bool)
    taken[names[good]] = True
    use = good[own]
    return (a[use], chains[good], lead[names[good]]), taken[patch]


def _pairs(plain, triangles, mate, free, tolerance):
    """Convex quads (vertices, sides, a triangle of each) of two triangles that both want each other most; (T,) bool,
    the triangles used. What counts is the length of the edge that goes."""
    other = np.maximum(mate, 0)
    a, b = triangles, np.roll(triangles, -1, axis=1)
    apex = triangles[other // 3, (other % 3 + 2) % 3]
    own = np.roll(triangles, -2, axis=1)
    corners = np.stack([a, apex, b, own], axis=2)
    turn = np.cross(np.roll(corners, -1, axis=2) - corners, np.roll(corners, -2, axis=2) - np.roll(corners, -1, axis=2))
    height = np.einsum("tkcd,td->tkc", turn, plain.normal)
    scale = np.linalg.norm(b - a, axis=2) ** 2
    fits = free & (height.min(axis=2) > 1e-4 * scale)
    paired = np.zeros(len(triangles), bool)
    quads, of = [], []
    for _ in range(3):
        usable = fits & ~paired[:, None] & ~paired[other // 3]
        gain = np.where(usable, scale, -1)
        best = gain.argmax(axis=1)
        rows = np.flatnonzero(gain[np.arange(len(gain)), best] > 0)
        target = other[rows, best[rows]]
        mutual = (best[target // 3] == target % 3) & (rows < target // 3)
        rows = rows[mutual]
        if not len(rows):
            break
        quads.append(corners[rows, best[rows]])
        of.append(rows)
        paired[rows] = True
        paired[other[rows, best[rows]] // 3] = True
    if not quads:
        return (np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0, np.int64)), paired
    quads, of = np.concatenate(quads), np.concatenate(of)
    return (quads.reshape(-1, 3), np.full(len(quads), 4), of), paired
