"""The runtime: lamps → irradiance of the entries → weights → irradiance of the texels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..point_cache import Weights
from ..rays import Tracer
from ..scene import Light
from .display import BLOCK, PointDisplay, TexelDisplay, row_values
from .entry_light import EntryLight, EntrySurface
from .unevenness import nearness, sensitivity, unevenness
from .weights import PaneWeights


@dataclass(frozen=True)
class Panes:
    """All that relighting reads.

    rows: (t, k) float32 panes at the exits, sorted by region. starts: (regions + 1,) int. steady: (t, 3) float32
    irradiance that no live lamp changes (bounces of the sky, of emissive faces and of lamps that are not live), W/m².
    resolution: of the atlas. surface, weights: see EntrySurface and PaneWeights.
    Where exits are texels: fill: (resolution²,) int32 row that each texel of the atlas shows, −1 for none. texel: (t,)
    int row-major place of each row in the atlas. beside: (t, 8) bool, which of its neighbours lie on the same surface
    (exits.joined).
    Where exits are points: shown: weights of the rows for each of the resolution² texels. own: (resolution²,) bool,
    texels with light of their own, not a copy from beyond a chart's border. vertices: weights of the rows for the places
    of objects that are lit at their vertices (surface.make_vertices).
    """

    rows: np.ndarray
    starts: np.ndarray
    steady: np.ndarray
    resolution: int
    surface: EntrySurface
    weights: PaneWeights
    fill: np.ndarray | None = None
    texel: np.ndarray | None = None
    beside: np.ndarray | None = None
    shown: Weights | None = None
    own: np.ndarray | None = None
    vertices: Weights | None = None


@dataclass(frozen=True)
class Known:
    """Of a lamp: unit (n,) or (n, 3), irradiance of the entries at unit power, extra light left out; uneven (3,): W/m² at
    unit power, see `unevenness`; weights (m, 3) and sketches (2, SKETCH, 3) as of PaneWeights.of_and_sketch."""

    unit: np.ndarray
    uneven: np.ndarray
    weights: np.ndarray
    sketch: np.ndarray | None


class Relighter:
    """Relights a bake. Only lamps that changed are computed again.

    panes: of a bake. tracer: shadow rays in the scene as it is now. extra: further direct irradiance of the entries,
    (n, 3) float32, under a lamp of unit power, such as what mirrors and glass send there (`CausticLight.unit`), or None;
    another array each time that it changes. It may be set anew at any time.
    """

    def __init__(
        self, panes: Panes, tracer: Tracer, seed: int = 0, extra: Callable[[Light], np.ndarray | None] | None = None
    ):
        self.panes, self.extra = panes, extra
        self.entry_light = EntryLight(panes.surface, tracer, seed)
        self._unit: dict[tuple, np.ndarray] = {}
        self._uneven: dict[tuple, np.ndarray] = {}
        self._beside: dict[int, np.ndarray] = {}
        self._mean: np.ndarray | None = None
        self._steady_mean = 0.0
        self._weights: dict[tuple, tuple[np.ndarray, np.ndarray | None]] = {}
        self._blocks, self._region, slot = _blocks(panes.rows, panes.starts)
        # places of red in the blocks, green and blue follow at a BLOCK's distance; the last three are black
        flat = slot // BLOCK * (3 * BLOCK) + slot % BLOCK
        size = 3 * self._blocks.shape[0] * BLOCK
        self._place = flat
        if panes.shown is not None:
            self._display = PointDisplay(panes, flat)
        else:
            self._display = TexelDisplay(panes, flat, size)
        self._light = np.zeros(size + 1, np.float32)
        self._steady = np.zeros(size + 1, np.float32)
        for c in range(3):
            self._steady[flat + c * BLOCK] = panes.steady[:, c]

    def pane_weights(self, lights: Sequence[Light]) -> np.ndarray:
        """(m, 3) float32 sum of all live lamps' weights; lamps seen before in the same place cost nothing."""
        unit, weights, beside, uneven = {}, {}, {}, self._uneven
        for light in lights:
            if not light.live:
                continue
            place = light.geometry
            key, extra = self._key(light)
            # known by its number as long as it is kept
            beside[id(extra)] = extra
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
                    unit[place], moment = self.entry_light.look(light)
                    uneven[place] = unevenness(moment, self.sensitive)
            direct = unit[place] if unit[place].ndim == 2 else unit[place][:, None]
            if extra is not None:
                direct = direct + extra
            weights[key] = (self.panes.weights.of_and_sketch(direct * light.power.astype(np.float32)), 1)
        self._unit, self._beside = unit, beside
        self._uneven = {place: uneven[place] for place in unit}
        self._weights = {key: value for key, (value, _) in weights.items()}
        total = np.zeros((len(self.panes.weights.first), 3), np.float32)
        for (value, _), times in weights.values():
            total += value * np.float32(times)
        return total

    @cached_property
    def sensitive(self) -> np.ndarray:
        """(n, 3) of `sensitivity`: some thousand rays, once."""
        surface = self.panes.surface
        return sensitivity(surface, nearness(surface, self.entry_light.tracer, self.entry_light.seed))

    def _key(self, light):
        """What a lamp's weights are known by, and its extra light."""
        extra = None if self.extra is None else self.extra(light)
        return (light.geometry, light.power.tobytes(), id(extra)), extra

    def known(self, light: Light) -> Known | None:
        """Of a lamp that shone when the weights were last asked for; None of any other."""
        key, _ = self._key(light)
        if key not in self._weights:
            return None
        return Known(self._unit[light.geometry], self._uneven[light.geometry], *self._weights[key])

    def mean(self, weights: np.ndarray) -> float:
        """Mean irradiance over the surface and RGB for weights (m, 3), that of the light that no lamp changes included, W/m²."""
        if self._mean is None:
            self._mean = self.panes.weights.mean(self.panes.surface.size.astype(np.float64) ** 2)
            self._steady_mean = float(self.panes.steady.mean())
        return float(np.maximum(self._mean @ weights, 0).mean()) + self._steady_mean

    def combine(self, weights: np.ndarray) -> np.ndarray:
        """Irradiance of all texels for pane weights (m, 3): each region blends its own panes.

        Returns a flat float32 buffer, BLOCK texels of red, green and blue at a time, that the next call reuses.
        """
        own = np.ascontiguousarray(weights.reshape(-1, self._blocks.shape[1], 3).transpose(0, 2, 1))[self._region]
        np.matmul(own, self._blocks, out=self._light[:-1].reshape(len(self._blocks), 3, BLOCK))
        return self._light

    def light(self, lights: Sequence[Light]) -> np.ndarray:
        """The irradiance of all rows, laid out as by `combine`, for the methods below; the next call reuses it."""
        light = self.combine(self.pane_weights(lights))
        self._display.finish(light)
        light += self._steady
        return light

    def rows(self, light: np.ndarray) -> np.ndarray:
        """(t, 3) float32 irradiance of the panes' rows, W/m², as they come from the gather: noise and all."""
        return row_values(light, self._place)

    def vertices(self, light: np.ndarray) -> np.ndarray:
        """(v, 3) float32 irradiance at vertices, W/m²; none where no object is lit there."""
        if self.panes.vertices is None:
            return np.zeros((0, 3), np.float32)
        return np.maximum(self.panes.vertices.apply(self.rows(light)), 0)

    def image(self, light: np.ndarray) -> np.ndarray:
        """(resolution, resolution, 4) float32 irradiance, W/m², alpha 1; row 0 is v = 0. Call it last: it may change
        `light`. The buffer is reused by the next call."""
        return self._display.image(light)

    def texels(self, lights: Sequence[Light]) -> np.ndarray:
        """(t, 3) float32 indirect irradiance of the panes' rows under these lamps, W/m²."""
        return self.rows(self.light(lights))

    def relight(self, lights: Sequence[Light]) -> np.ndarray:
        """(resolution, resolution, 4) float32 indirect irradiance of the atlas under these lamps; see `image`."""
        return self.image(self.light(lights))

    def shares(self, groups: Sequence[Sequence[Light]]) -> tuple[list[np.ndarray], np.ndarray]:
        """What each group of lamps adds to the image, and the steady light: (resolution, resolution, 3) float32 each.

        They sum up to `relight` of all lamps. Light is linear, so nothing is cut off below zero, where noise may bring
        a group: the last one holds what cutting it off makes of the whole.
        """
        whole = self.relight([light for group in groups for light in group])[..., :3].copy()
        steady = self._display.image(self._steady.copy())[..., :3].copy()
        kept = self._unit, self._uneven, self._beside, self._weights
        parts = []
        for group in groups:
            light = self.combine(self.pane_weights(group)).copy()
            self._display.finish(light)
            # images hold nothing below zero
            above = self._display.image(light.copy())[..., :3].copy()
            parts.append(above - self._display.image(-light)[..., :3])
            # of all lamps, for the next group and the next relight
            self._unit, self._uneven, self._beside, self._weights = kept
        if parts:
            parts[-1] += whole - steady - np.sum(parts, axis=0)
        return parts, steady


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
