"""Connected parts of meshes: charts of the atlas, and surfaces over which normals are smooth.

Photons that cross from one part to another land apart, however close together they started.
"""

from __future__ import annotations

import numpy as np

from ..sampling import hash_uint32


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


def _joined(corner: np.ndarray) -> np.ndarray:
    """(t,) int32 number of the connected part of each triangle; corner: (t, 3, k) float32, alike where joined."""
    count = len(corner)
    # −0 is 0
    words = np.ascontiguousarray(corner.reshape(3 * count, -1) + np.float32(0)).view(np.uint32)
    key = np.zeros(3 * count, np.uint64)
    for column in range(words.shape[1]):
        key = key * np.uint64(0x9E3779B97F4A7C15) + hash_uint32(words[:, column], column).astype(np.uint64)
        key ^= key >> np.uint64(29)
    vertex = np.unique(key, return_inverse=True)[1].reshape(count, 3)
    label = np.arange(3 * count)
    while True:
        before = label
        least = label[vertex].min(axis=1)
        label = label.copy()
        for k in range(3):
            np.minimum.at(label, vertex[:, k], least)
        label = label[label]
        if np.array_equal(label, before):
            return np.unique(label[vertex[:, 0]], return_inverse=True)[1].reshape(-1).astype(np.int32)
