"""What frames add up to: plain means per pixel, behind the interface of the world-space cache, and the film."""

from __future__ import annotations

import numpy as np


class PixelCache:
    """Each look-up's rows keep their own mean. What the world-space cache is compared with.

    channels: of the values.
    """

    def __init__(self, channels: int):
        self._channels = channels
        self._sum = np.zeros((0, channels), np.float32)
        self._count = np.zeros(0, np.float32)

    def look_up(self, position, normal, object_id, footprint, pixel=None) -> np.ndarray:
        """Where values at points belong: here the pixels themselves, (n,) int."""
        rows = np.arange(len(position)) if pixel is None else pixel
        need = int(rows.max(initial=-1)) + 1
        if need > len(self._count):
            more = need - len(self._count)
            self._sum = np.concatenate([self._sum, np.zeros((more, self._channels), np.float32)])
            self._count = np.concatenate([self._count, np.zeros(more, np.float32)])
        return rows

    def add(self, places: np.ndarray, values: np.ndarray) -> None:
        """values: (n, C). A place may not occur twice."""
        self._sum[places] += values
        self._count[places] += 1

    def read(self, places: np.ndarray) -> np.ndarray:
        """(n, C) float32 means so far."""
        return self._sum[places] / np.maximum(self._count[places], 1)[:, None]

    def clear(self) -> None:
        self._sum[:], self._count[:] = 0, 0


class Film:
    """Weighted means of images, (pixels, C) each, by name."""

    def __init__(self):
        self._sums: dict[str, np.ndarray] = {}
        self._weights: dict[str, float] = {}

    def add(self, name: str, image: np.ndarray, weight: float = 1.0) -> None:
        """Count one more image; the first one may be kept and changed."""
        if name not in self._sums:
            self._sums[name] = image * np.float32(weight)
            self._weights[name] = weight
            return
        self._sums[name] += image if weight == 1 else image * np.float32(weight)
        self._weights[name] += weight

    def mean(self, name: str) -> np.ndarray:
        return self._sums[name] / np.float32(self._weights[name])

    def __contains__(self, name: str) -> bool:
        return name in self._sums

    def clear(self) -> None:
        self._sums.clear()
        self._weights.clear()
