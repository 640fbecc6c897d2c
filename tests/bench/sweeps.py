"""Lamps that pass where panes are bad, frame by frame: error, flicker, and what the detector says of each frame.

The truth is the uncompressed solve of some four times as many entries as the bake has, gathered twice with independent
rays, so that its noise can be taken off. All is grey: panes are shared by red, green and blue anyway.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from lightpanes.core import metrics
from lightpanes.core.bake import Settings, bake
from lightpanes.core.bake.steps import prepare
from lightpanes.core.panes import Relighter
from lightpanes.core.panes.clusters import gather_clusters, make_clusters
from lightpanes.core.panes.entry_light import EntryLight
from lightpanes.core.panes.exits import gather_panes
from lightpanes.core.panes.trust import Trust, expected_of, trust
from lightpanes.core.rays import Tracer
from lightpanes.core.scene import Light, Material, Scene

from ..core.shapes import box, lamp, scene

CLUSTERS = 256

PATHS = {
    "surface at 1 cm": ((0.3, 0.4, 0.01), (2.7, 0.4, 0.01)),
    "an occluder's edge": ((1.9, 1.9, 0.9), (1.9, 2.7, 0.9)),
    "a door": ((2.3, 1.45, 1.2), (3.7, 1.45, 1.2)),
    "a wall": ((2.5, 0.5, 1.2), (3.4, 0.5, 1.2)),
    "the open room": ((0.5, 1.6, 1.9), (2.4, 1.2, 1.4)),
}
"""m: where the lamp is in the first frame and in the last."""

HELD_OUT = {
    "attic": {
        "over the beams": ((0.5, 1.5, 1.5), (5.5, 1.5, 1.5)),
        "low over the floor": ((2.0, 0.6, 0.05), (4.4, 4.4, 0.05)),
        "the room": ((1.0, 2.0, 1.0), (5.0, 3.2, 1.0)),
    },
    "office": {
        "over the desks": ((0.5, 1.6, 0.85), (4.6, 1.6, 0.85)),
        "through the shelves": ((4.3, 3.8, 0.2), (4.3, 3.8, 2.2)),
        "the room": ((1.0, 1.0, 2.2), (4.0, 3.0, 1.8)),
    },
    "corridor": {
        "round the bend": ((0.7, 5.2, 1.2), (4.4, 5.2, 1.2)),
        "along a wall": ((0.05, 0.5, 1.2), (0.05, 5.5, 1.2)),
        "the middle": ((4.3, 0.8, 1.8), (7.3, 0.8, 1.8)),
    },
}
"""Of scenes of judged.py, sweeps that the detector was not made by, chosen before it was tried on them."""


def parts():
    """Two rooms of 3 × 3 × 2.5 m, a wall with a door between them, a free-standing screen, and a block: (positions,
    triangles, atlas_uv, material) each."""
    wall = [((2.9, 0, 0), (3, 1, 2.5)), ((2.9, 1.9, 0), (3, 3, 2.5)), ((2.9, 1, 2), (3, 1.9, 2.5))]
    return (
        (*box((0, 0, 0), (6, 3, 2.5), True), 0),
        *((*box(*corners), 0) for corners in wall),
        (*box((1.4, 0.8, 0), (1.45, 2.2, 1.5)), 1),
        (*box((4.2, 1.2, 0), (4.9, 1.9, 0.8)), 1),
    )


def rooms() -> Scene:
    greys = Material("Walls", (0.7,) * 3), Material("Things", (0.4,) * 3)
    return scene(*parts(), materials=greys, lights=[lamp((1.5, 1.5, 2.2))])


def lamps(path: tuple, frames: int) -> list[Light]:
    """A path's lamp in each frame."""
    return [lamp(place) for place in np.linspace(*path, frames)]


@dataclass(frozen=True)
class Swept:
    """Of a sweep: irradiance (frames, H, W) of each method and of the truth's halves, their common mask (H, W), the
    detector's word on each frame, whether it warns, error of each frame by method, and flicker by method."""

    images: dict[str, np.ndarray]
    halves: np.ndarray
    mask: np.ndarray
    trusts: list[Trust]
    warned: list[bool]
    errors: dict[str, np.ndarray]
    flicker: dict[str, float]


class Sweeps:
    """The scene, the bake that sweeps are relit by, clusters with its entries and rays, and the truth's preparations."""

    def __init__(self, made: Scene, settings: Settings, truth: Settings, truth_rays: int):
        self.scene = made
        self.settings, self.truth_rays = settings, truth_rays
        self.baked = bake(self.scene, settings)
        self.relighter = Relighter(self.baked.panes(), Tracer(self.scene))
        self.expected = expected_of(self.baked.report)
        # what trials ended at, so that both have the same entries
        ready = self.ready = prepare(self.scene, replace(settings, **self.baked.report["budget"]))
        self.fine = prepare(self.scene, truth)
        cluster = make_clusters(ready.entries, CLUSTERS, self.scene.extent)
        rays = ready.budget.exit_rays
        self.clusters = gather_clusters(
            ready.entries, ready.transport, ready.gatherer, ready.exits.samples, cluster, rays, settings.seed + 41
        )

    def sweep(self, name: str, frames: int) -> Swept:
        """One sweep with all methods."""
        lights = lamps(PATHS[name], frames)
        size = self.settings.resolution
        light = self.relighter.entry_light
        panes, clusters, trusts = [], np.zeros((frames, size * size), np.float32), []
        for k, one in enumerate(lights):
            panes.append(self.relighter.relight([one])[..., 0].copy())
            trusts.append(trust(self.relighter, [one], self.expected))
            direct = (light.unit(one) * np.float32(one.power[0]))[:, None].repeat(3, 1).astype(np.float32)
            clusters[k, self.ready.exits.index] = self.clusters.texels(direct)[:, 0]
        halves = np.stack([self._truth(lights, seed) for seed in (77, 78)])
        mask = np.zeros(size * size, bool)
        mask[np.intersect1d(self.ready.exits.index, self.fine.exits.index)] = True
        mask = mask.reshape(size, size)
        images = {"eigenpanes": np.stack(panes), "256 clusters": clusters.reshape(frames, size, size)}
        errors = {key: self.errors(values, halves, mask) for key, values in images.items()}
        flicker = {key: extra_change(values, halves, mask) for key, values in images.items()}
        warned = [one.warns(self.expected) for one in trusts]
        return Swept(images, halves, mask, trusts, warned, errors, flicker)

    def _truth(self, lights, seed):
        ready, size = self.fine, self.settings.resolution
        light = EntryLight(ready.surface, ready.tracer)
        direct = np.stack([light.unit(one) * one.power[0] for one in lights], 1).astype(np.float32)
        albedo = ready.entries.albedo[:, :1]
        table = np.zeros((1, ready.gatherer.size, len(lights)), np.float32)
        table[0, : len(ready.entries)] = ready.transport.solve(albedo, albedo * direct, 1e-3)
        whole = np.array([0, len(ready.exits)])
        found = gather_panes(ready.gatherer, ready.exits.samples, whole, table, self.truth_rays, seed)
        images = np.zeros((len(lights), size * size), np.float32)
        images[:, ready.exits.index] = found.T
        return images.reshape(-1, size, size)

    @staticmethod
    def errors(images, halves, mask) -> np.ndarray:
        """(frames,) error of each image; NaN where the truth is black, the lamp being in a wall."""
        result = np.full(len(images), np.nan)
        for k, (image, pair) in enumerate(zip(images, halves.swapaxes(0, 1), strict=True)):
            if pair[:, mask].mean() > 1e-6 * halves[:, :, mask].mean():
                result[k] = metrics.compare(image, pair.mean(axis=0), mask, reference_halves=tuple(pair)).error
        return result


def extra_change(images, halves, mask) -> float:
    """RMS change from frame to frame on 4×4 blocks minus the truth's, over the mean light; negative where the frames change
    less than the truth does. The truth's two halves share the change, not the noise."""

    def blocks(frames):
        return np.stack([metrics.block_average(frame, mask)[0][..., 0] for frame in frames])

    used = metrics.block_average(mask.astype(float), mask)[1] > 0
    first, second = (np.diff(blocks(half), axis=0)[:, used] for half in halves)
    truth = np.sqrt(max(float((first * second).mean()), 0.0))
    change = np.sqrt(float((np.diff(blocks(images), axis=0)[:, used] ** 2).mean()))
    return (change - truth) / float(halves[:, :, mask].mean())
