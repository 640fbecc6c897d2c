"""Images, and where on them a place of a triangle lies: read by components, and two channels at a time.

A pair of channels is a complex number, which numpy fetches and scales as one; rows of three would take three times as long.
"""

from __future__ import annotations

import numpy as np

_F = np.float32


class Raster:
    """An image that is read at any place.

    image: (H, W, C) float32, row 0 at v = 0. extension: beyond [0, 1] the image is repeated ("REPEAT"), its border goes on
    ("EXTEND"), or there is nothing ("CLIP"). smooth: bilinear, else the nearest texel.
    """

    def __init__(self, image: np.ndarray, extension: str = "EXTEND", smooth: bool = True):
        self.height, self.width, self.channels = image.shape
        self.extension, self.smooth = extension, smooth
        rows = np.zeros((2 * -(-self.channels // 2), self.height * self.width), np.float32)
        rows[: self.channels] = image.reshape(-1, self.channels).T
        self._pairs = []
        for k in range(0, self.channels, 2):
            pair = np.empty(rows.shape[1], np.complex64)
            pair.real, pair.imag = rows[k], rows[k + 1]
            self._pairs.append(pair)

    def at(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(C, n) float32 at coordinates (n,) each."""
        if not np.isfinite(u.sum() + v.sum()):
            u, v = (np.nan_to_num(part, nan=0.0, posinf=0.0, neginf=0.0) for part in (u, v))
        outside = None
        if self.extension == "REPEAT":
            u, v = u - np.floor(u), v - np.floor(v)
        elif self.extension == "CLIP":
            outside = (u < 0) | (u > 1) | (v < 0) | (v > 1)
        x, y = u * _F(self.width), v * _F(self.height)
        found = self._between(x, y) if self.smooth else self._nearest(x, y)
        made = np.empty((2 * len(found), len(x)), np.float32)
        for k, pair in enumerate(found):
            made[2 * k], made[2 * k + 1] = pair.real, pair.imag
        made = made[: self.channels]
        if outside is not None:
            made[:, outside] = 0
        return made

    def _nearest(self, x, y):
        texel = self._inside(y.astype(np.int32), self.height) * self.width + self._inside(
            x.astype(np.int32), self.width
        )
        return [pair.take(texel, mode="clip") for pair in self._pairs]

    def _between(self, x, y):
        x, y = x - _F(0.5), y - _F(0.5)
        left, low = np.floor(x), np.floor(y)
        # numbers of one kind: a product of two costs several passes otherwise
        a, b = (x - left).astype(np.complex64), (y - low).astype(np.complex64)
        left, low = left.astype(np.int32), low.astype(np.int32)
        columns = [self._inside(column, self.width) for column in (left, left + 1)]
        rows = [self._inside(row, self.height) * self.width for row in (low, low + 1)]
        texels = [[row + column for column in columns] for row in rows]
        return [self._mixed(_mix(pair, *texels[0], a), _mix(pair, *texels[1], a), b) for pair in self._pairs]

    @staticmethod
    def _mixed(below, above, share):
        above -= below
        above *= share
        above += below
        return above

    def _inside(self, index, size):
        if self.extension != "REPEAT":
            return np.clip(index, 0, size - 1)
        # coordinates are in [0, 1] by now
        return np.where(index < 0, index + size, np.where(index >= size, index - size, index))


def _mix(plane, first, second, share):
    one = plane.take(first, mode="clip")
    other = plane.take(second, mode="clip")
    other -= one
    other *= share
    other += one
    return other


class CornerUV:
    """Coordinates on an image of places on triangles, from those of their corners, (T, 3, 2)."""

    def __init__(self, corners: np.ndarray):
        place = np.empty(corners.shape[:2], np.complex64)
        place.real, place.imag = corners[..., 0], corners[..., 1]
        self._first = place[:, 0].copy()
        self._along, self._up = place[:, 1] - place[:, 0], place[:, 2] - place[:, 0]

    def at(self, triangle: np.ndarray, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Both coordinates, (n,) float32 each, at barycentric places of triangles (n,)."""
        place = self._along.take(triangle, mode="clip")
        place *= u
        up = self._up.take(triangle, mode="clip")
        up *= v
        place += up
        place += self._first.take(triangle, mode="clip")
        return place.real.copy(), place.imag.copy()
