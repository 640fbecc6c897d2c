"""The truth that panes are measured against: the same entries and all their bounces, with no panes in between."""

from functools import cache

import numpy as np
from lightpanes.core.bake import bake
from lightpanes.core.bake.steps import prepare
from lightpanes.core.panes import Relighter
from lightpanes.core.panes.entry_light import EntryLight
from lightpanes.core.panes.exits import gather_panes
from lightpanes.core.scene import Material, Scene

from .shapes import box, lamp, quick, room_parts, scene

WHITISH = Material("White", (0.8, 0.8, 0.8))


class Uncompressed:
    """All bounces between the entries and the exits' gather with many rays: no panes, no groups of entries."""

    def __init__(self, made: Scene, settings, rays: int = 256):
        self.ready = prepare(made, settings)
        self.rays = rays
        ready = self.ready
        self.light = EntryLight(ready.surface, ready.tracer)

    def texels(self, lights) -> np.ndarray:
        """(frames, t): red irradiance of the exits under each lamp alone, gathered by the same rays."""
        ready = self.ready
        direct = np.stack([self.light.unit(light) * light.power[0] for light in lights], 1).astype(np.float32)
        albedo = ready.entries.albedo[:, :1]
        table = np.zeros((1, ready.gatherer.size, len(lights)), np.float32)
        table[0, : len(ready.entries)] = ready.transport.solve(albedo, albedo * direct)
        whole = np.array([0, len(ready.exits)])
        return gather_panes(ready.gatherer, ready.exits.samples, whole, table, self.rays, 77).T


def red(runtime: Relighter, lights) -> np.ndarray:
    """(frames, t)."""
    return np.stack([runtime.texels([light])[:, 0] for light in lights])


def relative(found, truth) -> np.ndarray:
    """(frames,) RMSE over the mean."""
    return np.sqrt(((found - truth) ** 2).mean(axis=1)) / truth.mean(axis=1)


@cache
def walled():
    """A room with a block and a free-standing wall, its bake, and the truth."""
    wall = (*box((2.6, 0.6, 0), (2.7, 2.4, 1.6)), 1)
    made = scene(*room_parts(), wall, materials=(WHITISH, WHITISH), lights=[lamp((2, 1.5, 2))])
    settings = quick(entries=900, lamps=500, regions=48, exit_rays=256)
    return made, bake(made, settings), Uncompressed(made, settings)
