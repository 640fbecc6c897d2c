"""From the irradiance of the panes' rows to the atlas' image: rows are texels, or points between which texels lie."""

from __future__ import annotations

import numpy as np

from ..rays import chunks
from ..threads import in_threads
from .exits import STEPS
from .regions import region_of

BLOCK = 64
"""Rows of one region that are blended by one matrix product: their red lies together, then green, then blue."""

PIXELS = 32_768
"""Texels between points that are done together: their sums stay in the cache."""


class TexelDisplay:
    """Rows are texels. Those at regions' borders are averaged with their neighbours, for each side errs in its own way.

    panes: `relighter.Panes` whose exits are texels. place: (t,) where each row's red lies in the blended light; black:
    where black lies there.
    """

    def __init__(self, panes, place: np.ndarray, black: int):
        self._image = np.ones((panes.resolution, panes.resolution, 4), np.float32)
        self._show = [np.append(place + c * BLOCK, black)[panes.fill] for c in range(3)]
        self._seam = _seams(panes, place)

    def finish(self, light: np.ndarray) -> None:
        """Blend the regions' borders, in place."""
        at, near, share = self._seam
        total = light.take(at) * share[0]
        for places, weight in zip(near, share[1:], strict=True):
            total += light.take(places) * weight
        light[at] = total

    def image(self, light: np.ndarray) -> np.ndarray:
        """(H, W, 4) float32, reused by the next call. Changes `light`: noise can dip below nothing."""
        np.maximum(light, 0, out=light)
        light[-1] = 0
        pixels = self._image.reshape(-1, 4)
        for c in range(3):
            pixels[:, c] = light.take(self._show[c])
        return self._image


class PointDisplay:
    """Rows are points; a texel is a sum over the few that serve it.

    panes: `relighter.Panes` whose exits are points. place: (n,) where each row's red lies in the blended light.
    """

    def __init__(self, panes, place: np.ndarray):
        self._image = np.zeros((panes.resolution, panes.resolution, 4), np.float32)
        self._image[..., 3] = 1
        self._place = place
        # only texels that something serves; the others stay black
        self._texel = np.flatnonzero(~panes.shown.orphan)
        served = panes.shown.take(self._texel)
        self._point, self._weight = np.ascontiguousarray(served.point.T), np.ascontiguousarray(served.weight.T)

    def finish(self, light: np.ndarray) -> None:
        """Nothing: texels between points of two regions blend them anyway."""

    def image(self, light: np.ndarray) -> np.ndarray:
        """(H, W, 4) float32, reused by the next call."""
        # four floats move as one number, which numpy does twice as fast as a row of four
        values = np.ones((len(self._place), 4), np.float32)
        values[:, :3] = row_values(light, self._place)
        values = values.view(np.complex128).reshape(-1)
        pixels = self._image.reshape(-1, 4).view(np.complex128).reshape(-1)

        def part(s):
            out = values.take(self._point[0, s]).view(np.float32).reshape(-1, 4)
            out *= self._weight[0, s, None]
            for point, weight in zip(self._point[1:, s], self._weight[1:, s], strict=True):
                row = values.take(point).view(np.float32).reshape(-1, 4)
                row *= weight[:, None]
                out += row
            # affine weights can dip below nothing beside a shadow
            np.maximum(out, 0, out=out)
            out[:, 3] = 1
            pixels[self._texel[s]] = out.view(np.complex128).reshape(-1)

        in_threads(part, chunks(len(self._texel), PIXELS))
        return self._image


def row_values(light: np.ndarray, place: np.ndarray) -> np.ndarray:
    """(n, 3) red, green and blue of rows in the blended light; place: (n,) where each row's red lies."""
    return np.stack([light.take(place + c * BLOCK) for c in range(3)], 1)


def _seams(panes, place):
    """Texels beside one of another region: their places in the blended light for red, green and blue (3, s), those of
    their straight neighbours (4, 3, s), and the weights of the texel and its neighbours (5, s)."""
    size, texel = panes.resolution, panes.texel
    row = np.full(size * size, -1, np.int32)
    row[texel] = np.arange(len(texel), dtype=np.int32)
    region = region_of(panes.starts)
    straight = [k for k, (dy, dx) in enumerate(STEPS) if not dy or not dx]
    steps = np.array([dy * size + dx for dy, dx in (STEPS[k] for k in straight)])
    around = np.clip(texel + steps[:, None], 0, size * size - 1)
    near = np.where(panes.beside[:, straight].T, row[around], -1)
    at = np.flatnonzero(((near >= 0) & (region[near] != region)).any(axis=0))
    near = near[:, at]
    share = np.concatenate([np.ones((1, len(at)), np.float32), (near >= 0).astype(np.float32)])
    near = np.where(near >= 0, near, at)
    colours = BLOCK * np.arange(3)[:, None]
    return place[at] + colours, place[near][:, None] + colours, share / share.sum(axis=0)
