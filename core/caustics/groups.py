"""Connected parts of meshes: charts of the atlas, and surfaces over which normals are smooth; which meshes are closed.

Photons that cross from one part to another land apart, however close together they started.
"""

from __future__ import annotations

import numpy as np

from ..sampling import hash_uint32
from ..surface.components import components

WELD = 1e-5
"""Corners this near, in parts of the mesh's size, are one vertex."""

OPEN = 0.1
"""Length of a mesh's open borders, in parts of the root of its area, up to which it counts as closed."""


def charts(corners: np.ndarray, atlas_uv: np.ndarray) -> np.ndarray:
    """(t,) int32 chart of each triangle: those that share a corner both in space and in the atlas are joined.

    corners: (t, 3, 3) float32, m. atlas_uv: (t, 3, 2) float32.
    """
    return _joined(np.concatenate([corners, atlas_uv], axis=2))


def smooth_groups(corners: np.ndarray, corner_normals: np.ndarray) -> np.ndarray:
    """(t,) int32 smooth surface of each triangle: those that share a corner and the normal there are joined.

    corners, corner_normals: (t, 3, 3) float32.
    """
    # normals of one smooth corner differ by what their transform rounds
    return _joined(np.concatenate([corners, np.round(corner_normals, 3)], axis=2))


def encloses(corners: np.ndarray) -> bool:
    """Whether triangles (t, 3, 3), m, have an inside: every edge is shared by two, but for a little hole."""
    corners = corners.astype(np.float64)
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).ravel()
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    low = corners.min(axis=(0, 1))
    grid = (corners - low) / max(WELD * float(np.ptp(corners, axis=(0, 1)).max()), 1e-300)
    borders = []
    # two grids: what rounding parts in one lies within a cell of the other
    for shift in (0.25, 0.75):
        vertex = _vertices(np.floor(grid + shift).astype(np.float32))
        ends = np.stack([vertex, np.roll(vertex, -1, axis=1)], 2).reshape(-1, 2)
        ends = np.sort(ends, axis=1).astype(np.int64)
        _, edge, uses = np.unique(ends[:, 0] * 3 * len(corners) + ends[:, 1], return_inverse=True, return_counts=True)
        borders.append(float(lengths[uses[edge.reshape(-1)] % 2 == 1].sum()))
    return min(borders) <= OPEN * np.sqrt(area)


def _joined(corner: np.ndarray) -> np.ndarray:
    """(t,) int32 number of the connected part of each triangle; corner: (t, 3, k) float32, alike where joined."""
    vertex = _vertices(corner)
    here, there = vertex[:, :2].reshape(-1), vertex[:, 1:].reshape(-1)
    return components(int(vertex.max(initial=-1)) + 1, here, there)[vertex[:, 0]]


def _vertices(corner: np.ndarray) -> np.ndarray:
    """(t, 3) int numbers of the corners of triangles, (t, 3, k) float32; alike where all k are."""
    count = len(corner)
    # −0 is 0
    words = np.ascontiguousarray(corner.reshape(3 * count, corner.shape[2]) + np.float32(0)).view(np.uint32)
    key = np.zeros(3 * count, np.uint64)
    for column in range(words.shape[1]):
        key = key * np.uint64(0x9E3779B97F4A7C15) + hash_uint32(words[:, column], column).astype(np.uint64)
        key ^= key >> np.uint64(29)
    return np.unique(key, return_inverse=True)[1].reshape(count, 3)
