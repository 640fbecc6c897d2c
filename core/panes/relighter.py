"""The runtime: lamps → irradiance of the entries → weights → irradiance of the texels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..rays import Tracer
from ..scene import Light
from .entry_light import EntryLight, EntrySurface
from .exits import STEPS
from .weights import PaneWeights

BLOCK = 64
"""Texels of one region that are blended by one matrix product."""


@dataclass(frozen=True)
class Panes:
    """All that relighting reads.

    rows: (t, k) float32 panes at the valid texels, sorted by region. starts: (regions + 1,) int.
    steady: (t, 3) float32 irradiance that no live lamp changes (bounces of the sky, of emissive faces and of lamps
    that are not live), W/m².
    fill: (resolution²,) int32 row that each texel of the atlas shows, −1 for none. texel: (t,) int row-major place of
    each row in the atlas. beside: (t, 8) bool, which of its neighbours lie on the same surface (exits.joined).
    surface, weights: see EntrySurface and PaneWeights.
    """

    rows: np.ndarray
    starts: np.ndarray
    steady: np.ndarray
    fill: np.ndarray
    texel: np.ndarray
    beside: np.ndarray
    resolution: int
    surface: EntrySurface
    weights: PaneWeights


class Relighter:
    """Relights a bake. Only lamps that changed are computed again.

    panes: of a bake. tracer: shadow rays in the scene as it is now.
    """

    def __init__(self, panes: Panes, tracer: Tracer, seed: int = 0):
        self.panes = panes
        self.entry_light = EntryLight(panes.surface, tracer, seed)
        self._unit: dict[tuple, np.ndarray] = {}
        self._weights: dict[tuple, np.ndarray] = {}
        self._blocks, self._region, slot = _blocks(panes.rows, panes.starts)
        # places of red in the blocks, green and blue follow at a BLOCK's distance; the last three are black
        flat = slot // BLOCK * (3 * BLOCK) + slot % BLOCK
        size = 3 * self._blocks.shape[0] * BLOCK
        self._place = flat
        self._show = [np.append(flat + c * BLOCK, size)[panes.fill] for c in range(3)]
        self._image = np.ones((panes.resolution, panes.resolution, 4), np.float32)
        self._light = np.zeros(size + 1, np.float32)
        self._seam = _seams(panes, flat)
        self._steady = np.zeros(size + 1, np.float32)
        for c in range(3):
            self._steady[flat + c * BLOCK] = panes.steady[:, c]

    def pane_weights(self, lights: Sequence[Light]) -> np.ndarray:
        """(m, 3) float32 sum of all live lamps' weights; lamps seen before in the same place cost nothing."""
        unit, weights = {}, {}
        for light in lights:
            if not light.live:
                continue
            place = light.geometry
            key = (place, light.power.tobytes())
            if key in weights:
                weights[key] = (weights[key][0], weights[key][1] + 1)
                continue
            if key in self._weights:
                unit[place] = self._unit[place]
                weights[key] = (self._weights[key], 1)
                continue
            if place not in unit:
                unit[place] = self._unit.get(place)
                if unit[place] is None:
                    unit[place] = self.entry_light.unit(light)
            direct = unit[place] if unit[place].ndim == 2 else unit[place][:, None]
            weights[key] = (self.panes.weights.of(direct * light.power.astype(np.float32)), 1)
        self._unit, self._weights = unit, {key: value for key, (value, _) in weights.items()}
        total = np.zeros((len(self.panes.weights.first), 3), np.float32)
        for value, times in weights.values():
            total += value * np.float32(times)
        return total

    def combine(self, weights: np.ndarray) -> np.ndarray:
        """Irradiance of all texels for pane weights (m, 3): each region blends its own panes.

        Returns a flat float32 buffer, BLOCK texels of red, green and blue at a time, that the next call reuses.
        """
        own = np.ascontiguousarray(weights.reshape(-1, self._blocks.shape[1], 3).transpose(0, 2, 1))[self._region]
        np.matmul(own, self._blocks, out=self._light[:-1].reshape(len(self._blocks), 3, BLOCK))
        return self._light

    def blend_seams(self, light: np.ndarray) -> None:
        """Average texels at the regions' borders with their neighbours, in place: each side errs in its own way."""
        at, near, share = self._seam
        total = light.take(at) * share[0]
        for places, weight in zip(near, share[1:], strict=True):
            total += light.take(places) * weight
        light[at] = total

    def _lit(self, lights):
        """The whole irradiance, laid out as by `combine`."""
        light = self.combine(self.pane_weights(lights))
        self.blend_seams(light)
        light += self._steady
        return light

    def texels(self, lights: Sequence[Light]) -> np.ndarray:
        """(t, 3) float32 indirect irradiance of the panes' rows, W/m²."""
        light = self._lit(lights)
        return np.stack([light[self._place + c * BLOCK] for c in range(3)], 1)

    def relight(self, lights: Sequence[Light]) -> np.ndarray:
        """(resolution, resolution, 4) float32 indirect irradiance, W/m², alpha 1; row 0 is v = 0.

        The buffer is reused by the next call.
        """
        light = self._lit(lights)
        # noise of the gather can dip below nothing where there is no light
        np.maximum(light, 0, out=light)
        light[-1] = 0
        pixels = self._image.reshape(-1, 4)
        for c in range(3):
            pixels[:, c] = light.take(self._show[c])
        return self._image


def _seams(panes, flat):
    """Texels beside one of another region: their places in the blended light for red, green and blue (3, s), those of
    their straight neighbours (4, 3, s), and the weights of the texel and its neighbours (5, s).

    flat: (t,) place of each row's red.
    """
    size = panes.resolution
    row = np.full(size * size, -1, np.int32)
    row[panes.texel] = np.arange(len(panes.texel), dtype=np.int32)
    region = np.repeat(np.arange(len(panes.starts) - 1), np.diff(panes.starts))
    straight = [k for k, (dy, dx) in enumerate(STEPS) if not dy or not dx]
    steps = np.array([dy * size + dx for dy, dx in (STEPS[k] for k in straight)])
    place = np.clip(panes.texel + steps[:, None], 0, size * size - 1)
    near = np.where(panes.beside[:, straight].T, row[place], -1)
    at = np.flatnonzero(((near >= 0) & (region[near] != region)).any(axis=0))
    near = near[:, at]
    share = np.concatenate([np.ones((1, len(at)), np.float32), (near >= 0).astype(np.float32)])
    near = np.where(near >= 0, near, at)
    colours = BLOCK * np.arange(3)[:, None]
    return flat[at] + colours, flat[near][:, None] + colours, share / share.sum(axis=0)


def _blocks(rows, starts):
    """Panes cut into blocks of BLOCK rows of one region, so that one batched product blends them all.

    Returns (blocks, k, BLOCK) float32, the region of each block, and each row's place among the blocks. Panes come
    before texels: BLAS is three times faster that way round, and as fast as memory.
    """
    lengths = np.diff(starts)
    counts = -(-lengths // BLOCK)
    region = np.repeat(np.arange(len(lengths)), counts)
    first = (np.cumsum(counts) - counts) * BLOCK
    slot = np.arange(len(rows)) + np.repeat(first - starts[:-1], lengths)
    blocks = np.zeros((len(region) * BLOCK, rows.shape[1]), np.float32)
    blocks[slot] = rows
    blocks = blocks.reshape(len(region), BLOCK, rows.shape[1])
    return np.ascontiguousarray(blocks.transpose(0, 2, 1)), region, slot
