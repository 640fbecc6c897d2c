"""Charts of an unwrapped mesh, each flattened at its true size.

A projection foreshortens what it sees at a slant. Each chart gets the affine map whose metric is the
mean of its surface's, so that texels are as dense and square as one map per chart can make them; an
affine map cannot make a chart overlap itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .packing import Charts


@dataclass
class Layout:
    """Charts of one mesh: loops' points (L, 2) in metres, edges (E, 2) between loops along the charts' outlines,
    chart (L,) of each loop, areas (C,) m²."""

    points: np.ndarray
    edges: np.ndarray
    chart: np.ndarray
    areas: np.ndarray

    @property
    def charts(self) -> Charts:
        count = len(self.areas)
        return Charts(self.points, self.chart, self.edges, count, np.ones(count, bool))


def lay_flat(
    positions: np.ndarray, corners: np.ndarray, faces: np.ndarray, triangles: np.ndarray, uv: np.ndarray
) -> Layout:
    """Charts of an unwrapped mesh at their true size.

    positions (V, 3) in metres, corners (L,) vertex of each loop, faces (F,) first loop of each polygon,
    triangles (T, 3) loops, uv (L, 2) in [0, 1] with its charts apart.
    """
    counts = np.diff(np.append(faces, len(corners)))
    key, chart = _charts_of(corners, uv, faces, counts)
    count = int(chart.max()) + 1
    points, areas = _true_size(positions[corners], uv, triangles, chart, count)
    edges = _outlines(key, chart, np.stack([np.arange(len(corners)), next_loop(faces, len(corners))], axis=1), count)
    return Layout(_upright(points, chart, edges[:, 0], count), edges, chart, areas)


def _outlines(key, chart, edges, count) -> np.ndarray:
    """Edges with a face of their chart on one side only; all edges of a chart that has none such."""
    ends = np.sort(key[edges], axis=1)
    _, which, times = np.unique(ends[:, 0] * (key.max() + 1) + ends[:, 1], return_inverse=True, return_counts=True)
    outer = (times == 1)[which.ravel()]
    closed = np.bincount(chart[edges[outer, 0]], minlength=count) == 0
    return edges[outer | closed[chart[edges[:, 0]]]]


def next_loop(faces: np.ndarray, loops: int) -> np.ndarray:
    """(L,) the loop that follows each one round its polygon."""
    after = np.arange(1, loops + 1)
    after[np.append(faces[1:], loops) - 1] = faces
    return after


def _charts_of(vertices, uv, faces, counts) -> tuple[np.ndarray, np.ndarray]:
    """(L,) key of each loop's vertex and UV, and (L,) its chart: faces that share a key are one chart."""
    quantum = np.round(np.clip(uv, 0, 1) * ((1 << 20) - 1)).astype(np.int64)
    _, key = np.unique((vertices.astype(np.int64) << 40) | (quantum[:, 0] << 20) | quantum[:, 1], return_inverse=True)
    key = key.ravel()
    label = np.arange(key.max() + 1)
    while True:
        lowest = np.minimum.reduceat(label[key], faces)
        new = label.copy()
        np.minimum.at(new, key, np.repeat(lowest, counts))
        new = new[new]
        if np.array_equal(new, label):
            return key, np.unique(label[key], return_inverse=True)[1].ravel()
        label = new


def _true_size(positions, uv, triangles, chart, count):
    """UVs in metres: each chart's best affine map from its projection to its surface, in mean metric.

    Returns (L, 2) UVs and (count,) world areas.
    """
    p, q = positions[triangles], uv[triangles]
    e, f = p[:, 1:] - p[:, :1], q[:, 1:] - q[:, :1]
    area = np.linalg.norm(np.cross(e[:, 0], e[:, 1]), axis=1) / 2
    flat = (f[:, 0, 0] * f[:, 1, 1] - f[:, 0, 1] * f[:, 1, 0]) / 2
    owner = chart[triangles[:, 0]]
    # triangles seen edge-on have no inverse; they count for the area alone
    good = np.abs(flat) > 1e-12
    inverse = np.zeros_like(f)
    inverse[good] = np.linalg.inv(f[good])
    metric = inverse @ (e @ e.transpose(0, 2, 1)) @ inverse.transpose(0, 2, 1)
    weight = np.where(good, area, 0.0)
    total = np.bincount(owner, weight, count)
    g = np.stack([np.bincount(owner, weight * metric[:, i, j], count) for i, j in ((0, 0), (0, 1), (1, 1))], axis=1)
    g /= np.maximum(total, 1e-300)[:, None]
    g[total <= 0] = 1, 0, 1
    root = np.sqrt(np.maximum(g[:, 0] * g[:, 2] - g[:, 1] ** 2, 0))
    norm = np.sqrt(np.maximum(g[:, 0] + g[:, 2] + 2 * root, 1e-300))
    a = np.stack([(g[:, 0] + root) / norm, g[:, 1] / norm, (g[:, 2] + root) / norm], axis=1)
    world = np.bincount(owner, area, count)
    covered = np.bincount(owner, np.abs(flat), count) * np.abs(a[:, 0] * a[:, 2] - a[:, 1] ** 2)
    a *= np.sqrt(np.where(covered > 0, world / np.maximum(covered, 1e-300), 1.0))[:, None]
    a = a[chart]
    mapped = np.stack([uv[:, 0] * a[:, 0] + uv[:, 1] * a[:, 1], uv[:, 0] * a[:, 1] + uv[:, 1] * a[:, 2]], axis=1)
    return mapped, world


def _upright(points, chart, outline, count):
    """Turn each chart to its smallest box (in steps of 2.5°) and move its corner to the origin.

    outline: points that are enough to measure every chart's box.
    """
    order = outline[np.argsort(chart[outline], kind="stable")]
    owner, border = chart[order], points[order]
    starts = np.searchsorted(owner, np.arange(count))
    best, angle = np.full(count, np.inf), np.zeros(count)
    for theta in np.radians(np.arange(0, 90, 2.5)):
        turned = _turn(border, theta)
        box = np.maximum.reduceat(turned, starts) - np.minimum.reduceat(turned, starts)
        size = box.prod(axis=1)
        better = size < best * (1 - 1e-3)
        best[better], angle[better] = size[better], theta
    corner = np.minimum.reduceat(_turn(border, angle[owner]), starts)
    return _turn(points, angle[chart]) - corner[chart]


def _turn(points, angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1]], axis=1)
