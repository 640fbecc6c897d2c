"""Lamps that pass where panes are bad, frame by frame: error, flicker, and what the detector says of each frame.

The truth is the uncompressed solve of some four times as many entries as the bake has, gathered twice with independent
rays, so that its noise can be taken off. All is grey: panes are shared by red, green and blue anyway.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from lightpanes.core import metrics
from lightpanes.core.bake import Settings, bake
from lightpanes.core.bake.steps import Prepared, prepare
from lightpanes.core.panes import Relighter
from lightpanes.core.panes.clusters import gather_clusters, make_clusters
from lightpanes.core.panes.entry_light import EntryLight
from lightpanes.core.panes.exits import gather_panes
from lightpanes.core.panes.trust import Trust, expected_of, trust
from lightpanes.core.rays import Bvh, Tracer
from lightpanes.core.sampling import spiral
from lightpanes.core.scene import Light, Material, Scene
from lightpanes.core.threads import in_threads

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

ORDINARY = ("the open room", "a door")
"""Sweeps of lamps as they usually hang, where a warning is a false alarm."""


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


def lamps(name: str, frames: int) -> list[Light]:
    """The sweep's lamp in each frame."""
    return [lamp(place) for place in np.linspace(*PATHS[name], frames)]


@dataclass(frozen=True)
class Swept:
    """Of a sweep: irradiance (frames, H, W) of each method and of the truth's halves, their common mask (H, W), the
    detector's word on each frame, error of each frame by method, and flicker by method."""

    images: dict[str, np.ndarray]
    halves: np.ndarray
    mask: np.ndarray
    trusts: list[Trust]
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
        ready = self.ready = prepare(self.scene, settings)
        self.fine = prepare(self.scene, truth)
        cluster = make_clusters(ready.entries, CLUSTERS, self.scene.extent)
        rays = ready.budget.exit_rays
        self.clusters = gather_clusters(
            ready.entries, ready.transport, ready.gatherer, ready.exits.samples, cluster, rays, settings.seed + 41
        )

    def sweep(self, name: str, frames: int) -> Swept:
        """One sweep with all methods."""
        lights = lamps(name, frames)
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
        return Swept(images, halves, mask, trusts, errors, flicker)

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


VIRTUAL = 4096
"""Rays from a lamp, a virtual light at each one's end."""


def brute_force(ready: Prepared, light: Light, seed: int) -> np.ndarray:
    """(t,) irradiance of `ready.exits` under a lamp of grey light so near to a surface that its pool is smaller than any entry.

    The first bounce is summed over all rays from the lamp, each a small disc that shines as wide as its ray is (Keller 1997,
    without his spikes); the later ones, smooth by then, come from the entries.
    """
    made, exits = ready.scene, ready.exits.samples
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    way = np.ascontiguousarray(spiral(VIRTUAL) @ turn.T, np.float32)
    start = np.tile(np.float32(light.position), (VIRTUAL, 1))
    met = Bvh(made.positions[made.triangles]).hits(start, way)
    hit = np.flatnonzero(met.triangle >= 0)
    normal = made.triangle_cross()[met.triangle[hit]].astype(np.float64)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal *= -np.sign(np.einsum("nd,nd->n", normal, way[hit]))[:, None]
    distance = met.distance[hit].astype(np.float64)
    place = start[hit] + way[hit] * distance[:, None] + normal * ready.tracer.offset
    slant = np.maximum(-np.einsum("nd,nd->n", normal, way[hit]), 1e-3)
    disc = 4 * np.pi / VIRTUAL * distance**2 / slant
    shade = np.array([material.albedo[0] for material in made.materials])[made.triangle_material[met.triangle[hit]]]
    sent = light.power[0] / VIRTUAL * shade
    position = (exits.position + exits.flat * np.float32(ready.tracer.offset)).astype(np.float64)
    facing = np.asarray(exits.normal, np.float64)

    def part(rows):
        vectors = position[None] - place[rows, None]
        distance2 = np.einsum("vtd,vtd->vt", vectors, vectors)
        away = np.einsum("vtd,vd->vt", vectors, normal[rows])
        toward = -np.einsum("vtd,td->vt", vectors, facing)
        v, t = np.nonzero((away > 0) & (toward > 0))
        seen = ready.tracer.visibility(position[t].astype(np.float32), (-vectors[v, t]).astype(np.float32))
        square = distance2[v, t]
        value = sent[rows][v] * away[v, t] * toward[v, t] / square / (np.pi * square + disc[rows][v]) * seen
        return np.bincount(t, value, len(position))

    pieces = [slice(k, k + 64) for k in range(0, len(hit), 64)]
    total = np.zeros(len(position))
    for some in in_threads(part, pieces):
        total += some
    direct = (EntryLight(ready.surface, ready.tracer).unit(light) * light.power[0])[:, None].astype(np.float32)
    albedo = ready.entries.albedo[:, :1]
    sent_on = ready.transport.solve(albedo, albedo * direct, 1e-3) - albedo * direct
    table = np.zeros((1, ready.gatherer.size, 1), np.float32)
    table[0, : len(ready.entries)] = sent_on
    whole = np.array([0, len(position)])
    return total + gather_panes(ready.gatherer, exits, whole, table, 256, seed + 5)[:, 0]
