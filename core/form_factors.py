"""Closed forms: how much of an evenly bright cap or polygon a surface receives, where the light of a point falls on a
triangle; Gauss rules for the rest.

Vectors are lists of three arrays, one a component, where nothing else is said.
"""

from __future__ import annotations

import numpy as np

_F = np.float32


def dot(a, b):
    """Scalar product of two vectors given by component."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a, b):
    """(3, …) vector product of two vectors given by component."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def cap(cosine, sine2):
    """(m,) irradiance of a cap of directions, over what it brings when it faces the surface, which is
    π · radiance · sine2.

    cosine: of the angle between the normal and the cap's middle. sine2: squared sine of its half angle.
    The part below the horizon is left out (Snyder, Area Light Sources for Real-Time Graphics, 1996).
    """
    result = np.maximum(cosine, 0)
    rows = np.flatnonzero(np.square(cosine) < sine2)
    if len(rows):
        c, s2 = np.asarray(cosine[rows], np.float64), np.asarray(sine2[rows], np.float64)
        outside = np.maximum(1 - s2, 1e-12)
        above = np.sqrt(np.maximum(s2 - c * c, 0))
        tilt = np.arccos(np.clip(-c * np.sqrt(outside / (s2 * np.maximum(1 - c * c, 1e-12))), -1, 1))
        part = s2 * c * tilt - np.sqrt(outside) * above + np.arctan(above / np.sqrt(outside))
        result[rows] = np.maximum(part / (np.pi * s2), 0)
    return result


def polygon(width, height, edges):
    """(K, 2) corners: a rectangle of 4, or a polygon with the area of the ellipse."""
    angle = (np.arange(edges) + 0.5) * (2 * np.pi / edges)
    swell = np.sqrt(0.5) if edges == 4 else np.sqrt((2 * np.pi / edges) / np.sin(2 * np.pi / edges)) / 2
    return np.stack([width * swell * np.cos(angle), height * swell * np.sin(angle)], axis=1).astype(np.float32)


def form_factor(corners, place, normal):
    """(m,) form factor of a polygon in the plane z = 0, the part below the horizon left out.

    corners: (K, 2). place, normal: (3, m) in the lamp's frame. Lambert's formula, 1760, edge by edge.
    """
    a, b = corners[:, 0, None] - place[0], corners[:, 1, None] - place[1]
    c = np.broadcast_to(-place[2], a.shape)
    height = a * normal[0] + b * normal[1] + c * normal[2]
    ends = [np.roll(v, -1, axis=0) for v in (a, b, c, height)]
    start, end = [a, b, c], ends[:3]
    closing = 0.0
    cut = np.flatnonzero((height <= 0).any(axis=0))
    if len(cut):
        start, end, closing = _clip(start, end, height, ends[3], normal, cut)
    total = _edges(start, end, normal).sum(axis=0)
    if len(cut):
        total[cut] += closing
    return np.abs(total) / _F(2 * np.pi)


def _edges(start, end, normal):
    """What each edge brings to Lambert's sum: the angle it spans, times the normal's part of its axis."""
    cross = [start[k - 2] * end[k - 1] - start[k - 1] * end[k - 2] for k in range(3)]
    size = np.sqrt(dot(cross, cross))
    angle = np.arctan2(size, dot(start, end))
    return dot(cross, normal) * angle / np.maximum(size, _F(1e-30))


def _clip(start, end, low, high, normal, cut):
    """Cut the polygons of some columns at the horizon; also what the new edges along it bring, (len(cut),)."""
    start, end = [np.array(v) for v in start], [np.array(v) for v in end]
    low, high = low[:, cut], high[:, cut]
    fraction = low / np.where(low == high, _F(1), low - high)
    crossing = [s[:, cut] + fraction * (e[:, cut] - s[:, cut]) for s, e in zip(start, end, strict=True)]
    leaves, enters = (low > 0) & (high <= 0), (low <= 0) & (high > 0)
    hidden = (low <= 0) & (high <= 0)
    exit_, entry = [], []
    for k in range(3):
        s, e = start[k][:, cut], end[k][:, cut]
        exit_.append(np.where(leaves, crossing[k], 0).sum(axis=0))
        entry.append(np.where(enters, crossing[k], 0).sum(axis=0))
        start[k][:, cut] = np.where(hidden, 0, np.where(enters, crossing[k], s))
        end[k][:, cut] = np.where(hidden, 0, np.where(leaves, crossing[k], e))
    return start, end, _edges(exit_, entry, normal[:, cut])


def gauss(count, round_ends=False):
    """Nodes and weights, (count,) float32 each, of a Gauss rule on [0, 1]; round_ends: for integrands
    that end like a square root."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    nodes, weights = (nodes + 1) / 2, weights / 2
    if round_ends:
        weights = weights * np.pi / 2 * np.sin(np.pi * nodes)
        nodes = (1 - np.cos(np.pi * nodes)) / 2
    return nodes.astype(np.float32), weights.astype(np.float32)


def triangles_from(corners: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) sr that triangles fill, seen from a place in front of them, and (n, 3) ∫ (x − place) dω over each, m; 0 from behind.

    corners: (n, 3, 3) m; place: (3,). The angle after Van Oosterom & Strackee 1983. Of a plane at a distance h, dω is
    h / (h² + r²)^3/2 dA around the place's foot, and ∫ r dω = −h ∮ n / √(h² + r²) dl round the triangle, n pointing out of it.
    """
    # float64: slivers cancel
    ends = np.ascontiguousarray(corners.T, np.float64) - np.reshape(place, (3, 1, 1))
    a, b, c = ends.swapaxes(0, 1)
    square = dot(ends, ends)
    length = np.sqrt(square)
    normal = cross(b - a, c - a)
    normal /= np.maximum(np.sqrt(dot(normal, normal)), 1e-300)
    volume = -dot(a, cross(b, c))
    below = length.prod(axis=0) + dot(a, b) * length[2] + dot(a, c) * length[1] + dot(b, c) * length[0]
    angle = 2 * np.arctan2(volume, below)
    edge = ends[:, [1, 2, 0]] - ends
    long = np.sqrt(dot(edge, edge))
    edge /= np.maximum(long, 1e-300)
    start = dot(ends, edge)
    apart = np.sqrt(np.maximum(square - start**2, 1e-24))
    along = np.arcsinh((start + long) / apart) - np.arcsinh(start / apart)
    round_it = cross((along * edge).sum(axis=1), normal)
    moment = dot(a, normal) * (normal * angle + round_it)
    lit = angle > 0
    return np.where(lit, angle, 0), np.where(lit, moment, 0).T
