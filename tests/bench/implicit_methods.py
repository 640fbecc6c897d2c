"""Methods under one interface: `show(frame number)` adds a frame and gives its picture. Ours, the papers', a pixel's own
mean, and reprojection with an edge-avoiding à-trous filter, which is what real-time renderers do without a cache."""

from __future__ import annotations

import numpy as np
from lightpanes.core.implicit_cache import ImplicitPoints, OnePointCache

from .implicit_views import HEIGHT, WIDTH, View

PAPERS = {
    "fixed + jitter": {"even": True, "choice": "jitter"},
    "fixed + barycentric": {"even": True, "choice": "barycentric"},
    "implicit + barycentric": {"even": False, "choice": "barycentric"},
}
"""The thesis's Table 1."""


def paper(name: str, cell: float, ageing: float = 1.0, neighbourhood: int | None = None) -> OnePointCache:
    """A method of Table 1. Ageing is 1, which suits a camera at rest better than the thesis's 0.9; the neighbourhood of 27
    octants stands for 216 points (see test_implicit_points.py)."""
    points = ImplicitPoints(even=PAPERS[name]["even"], neighbourhood=neighbourhood)
    return OnePointCache(points=points, choice=PAPERS[name]["choice"], cell=cell, ageing=ageing)


class Reprojection:
    """Means along the camera's path and five passes of an à-trous wavelet that stops at edges of depth, normal and, with
    the noise known, of light (Dammertz et al. 2010; Schied et al. 2017, without its albedo, which is 1 here)."""

    def __init__(self, most: float = 64.0, passes: int = 5):
        self.most, self.passes = most, passes
        self.history = None

    def frame(self, view: View, value: np.ndarray, project) -> np.ndarray:
        """(n,) picture. project: world positions (n, 3) → row and column in the frame before, (n,) float each."""
        hit = view.hit.reshape(HEIGHT, WIDTH)
        moments = np.stack([value, value * value])
        count = np.ones(len(value), np.float32)
        if self.history is not None:
            before, weight = self._fetch(view, project)
            weight = np.minimum(weight, self.most - 1)
            count = weight + 1
            moments = (before * weight + moments) / count
        planes = np.zeros((3, HEIGHT * WIDTH), np.float32)
        planes[:, view.hit] = [*moments, count]
        self.history = (planes.reshape(3, HEIGHT, WIDTH), view, self._ids(view))
        variance = np.maximum(moments[1] - moments[0] ** 2, 0)
        # few frames tell no variance: then the worst of an openness's
        variance = np.where(count < 4, np.maximum(variance, 0.25), variance) / count
        light = np.zeros((2, HEIGHT * WIDTH), np.float32)
        light[:, view.hit] = [moments[0], variance]
        return self._filter(light.reshape(2, HEIGHT, WIDTH), view, hit)

    @staticmethod
    def _ids(view):
        """(HEIGHT, WIDTH) which surface each pixel sees, −1 for none."""
        ids = np.full(HEIGHT * WIDTH, -1)
        ids[view.hit] = np.arange(len(view.pixel))
        return ids.reshape(HEIGHT, WIDTH)

    def _fetch(self, view, project):
        planes, old, ids = self.history
        row, column = project(view.position)
        low_row, low_column = np.floor(row).astype(int), np.floor(column).astype(int)
        total, weights = np.zeros((2, len(row)), np.float32), np.zeros(len(row), np.float32)
        counts = np.zeros(len(row), np.float32)
        for i in (0, 1):
            for j in (0, 1):
                y, x = low_row + i, low_column + j
                inside = (y >= 0) & (y < HEIGHT) & (x >= 0) & (x < WIDTH)
                y, x = np.clip(y, 0, HEIGHT - 1), np.clip(x, 0, WIDTH - 1)
                there = ids[y, x]
                near = np.linalg.norm(old.position[there] - view.position, axis=1) < 3 * view.footprint
                same = np.einsum("nd,nd->n", old.normal[there], view.normal) > 0.9
                share = (1 - np.abs(row - low_row - i)) * (1 - np.abs(column - low_column - j))
                share = np.where(inside & (there >= 0) & near & same, share, 0).astype(np.float32)
                total += share * planes[:2, y, x]
                counts += share * planes[2, y, x]
                weights += share
        return total / np.maximum(weights, 1e-6), np.where(weights > 0.01, counts / np.maximum(weights, 1e-6), 0)

    def _filter(self, light, view, hit):
        taps = np.array([1, 4, 6, 4, 1], np.float32) / 16
        position, normal = np.zeros((HEIGHT, WIDTH, 3), np.float32), np.zeros((HEIGHT, WIDTH, 3), np.float32)
        position[hit], normal[hit] = view.position, view.normal
        footprint = np.ones((HEIGHT, WIDTH), np.float32)
        footprint[hit] = view.footprint
        for k in range(self.passes):
            step = 1 << k
            blurred = _shifts(light[1], 1, np.array([0.25, 0.5, 0.25], np.float32))
            scale = 4 * np.sqrt(np.maximum(blurred, 0)) + 1e-4
            total, weights, spread = np.zeros_like(light[0]), np.zeros_like(light[0]), np.zeros_like(light[0])
            for i in range(-2, 3):
                for j in range(-2, 3):
                    here, there = _overlap(i * step, HEIGHT), _overlap(j * step, WIDTH)
                    a, b = (here[0], there[0]), (here[1], there[1])
                    away = np.abs(((position[b] - position[a]) * normal[a]).sum(-1))
                    weight = (
                        np.exp(-away / (footprint[a] * step) - np.abs(light[0][b] - light[0][a]) / scale[a])
                        * np.maximum((normal[b] * normal[a]).sum(-1), 0) ** 64
                    )
                    weight *= taps[i + 2] * taps[j + 2] * hit[b]
                    total[a] += weight * light[0][b]
                    spread[a] += weight**2 * light[1][b]
                    weights[a] += weight
            light = np.stack([total / np.maximum(weights, 1e-9), spread / np.maximum(weights, 1e-9) ** 2])
        return light[0][hit]


def _overlap(shift, size):
    """Slices of what has a neighbour so far on, and of these neighbours."""
    return slice(max(0, -shift), size - max(0, shift)), slice(max(0, shift), size + min(0, shift))


def _shifts(plane, step, taps):
    for axis in (0, 1):
        padded = np.pad(plane, [(step, step) if k == axis else (0, 0) for k in (0, 1)], mode="edge")
        parts = [np.take(padded, range(k * step, k * step + plane.shape[axis]), axis) for k in range(3)]
        plane = sum(tap * part for tap, part in zip(taps, parts, strict=True))
    return plane
