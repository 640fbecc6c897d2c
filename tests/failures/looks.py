"""Pictures of scenes: a look into a room, and its floor from above."""

from __future__ import annotations

import numpy as np
from lightpanes.core.rays import Bvh
from lightpanes.core.scene import Scene


def look(made: Scene, values: np.ndarray, eye, target, field: float = 1.2, size=(120, 160)) -> np.ndarray:
    """(H, W) values of the atlas (R, R) as a pinhole camera sees them, 0 where nothing is met or what is has no texel. field: rad, of the width."""
    eye, target = np.asarray(eye, float), np.asarray(target, float)
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, (0, 0, 1))
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead)
    height, width = size
    x, y = np.meshgrid((np.arange(width) + 0.5) / width * 2 - 1, (np.arange(height) + 0.5) / height * 2 - 1)
    way = ahead + np.tan(field / 2) * (x[..., None] * right + y[..., None] * (height / width) * up)
    way = np.ascontiguousarray(way.reshape(-1, 3), np.float32)
    start = np.tile(eye.astype(np.float32), (len(way), 1))
    met = Bvh(made.positions[made.triangles]).hits(start, way)
    uv = made.atlas_uv[met.triangle]
    u, v = met.u[:, None], met.v[:, None]
    place = uv[:, 0] * (1 - u - v) + uv[:, 1] * u + uv[:, 2] * v
    shown = (met.triangle >= 0) & np.isfinite(place).all(axis=1)
    place[~shown] = 0
    resolution = len(values)
    column, row = np.clip((place * resolution).astype(int), 0, resolution - 1).T
    return np.where(shown, values[row, column], 0).reshape(size)


def atlas(exits, values: np.ndarray) -> np.ndarray:
    """(R, R) atlas of values (t,) at exits, spread past the charts' borders."""
    return np.append(values, 0)[exits.fill()].reshape(exits.resolution, exits.resolution)


def floor_of(samples, values: np.ndarray, height: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """Places (n, 2) and values (n,) of the samples on the floor."""
    low = (samples.position[:, 2] < height) & (samples.normal[:, 2] > 0.5)
    return samples.position[low, :2], values[low]
