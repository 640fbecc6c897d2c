"""What frames add up to: plain means per pixel, as the world-space cache has them between pixels, and the film."""

from __future__ import annotations

import numpy as np


class PixelCache:
    """A mean for each pixel, in place of the world-space cache: what that is compared with.

    channels: of the values. Places are the numbers of pixels, (n,) int.
    """

    def __init__(self, channels: int, pixels: int):
        self._sum = np.zeros((pixels, channels), np.float32)
        self._count = np.zeros(pixels, np.float32)

    def add(self, places: np.ndarray, values: np.ndarray) -> None:
        """values: (n, C). A place may not occur twice."""
        self._sum[places] += values
        self._count[places] += 1

    def read(self, places: np.ndarray) -> np.ndarray:
        """(n, C) float32 means so far."""
        return self._sum[places] / np.maximum(self._count[places], 1)[:, None]

    def clear(self) -> None:
        """Forget all."""
        self._sum[:], self._count[:] = 0, 0

    drop = clear

    def holds(self, places: np.ndarray) -> bool:
        """Whether places are still known: always."""
        return True


class Film:
    """Weighted means of images, (pixels, C) each, by name."""

    def __init__(self):
        self._sums: dict[str, np.ndarray] = {}
        self._weights: dict[str, float] = {}

    def add(self, name: str, image: np.ndarray, weight: float = 1.0) -> None:
        """Count one more image."""
        if name not in self._sums:
            # a copy, for sums are changed in place
            self._sums[name] = image * np.float32(weight)
            self._weights[name] = weight
            return
        self._sums[name] += image if weight == 1 else image * np.float32(weight)
        self._weights[name] += weight

    def replace(self, name: str, image: np.ndarray, former: np.ndarray | None) -> None:
        """Count an image in place of a former one, None where it is one more."""
        if former is None:
            self.add(name, image)
        else:
            self._sums[name] += image - former

    def change(self, name: str, rows: np.ndarray, difference: np.ndarray) -> None:
        """Some pixels of an image that counts are now brighter by (k, C)."""
        self._sums[name][rows] += difference

    def mean(self, name: str) -> np.ndarray:
        return self._sums[name] / np.float32(self._weights[name])

    def __contains__(self, name: str) -> bool:
        return name in self._sums

    def clear(self) -> None:
        self._sums.clear()
        self._weights.clear()
