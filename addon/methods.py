"""The ways to relight a scene that the chart compares, behind one interface.

The paper's own (virtual lights, clusters), its clusters on our gather, and what a bake does: regional eigenpanes.
All have the same texels, the same entries' lamps with the same shadow rays, and differ in nothing else.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..core.bake import Settings, bake
from ..core.panes import Relighter
from ..core.panes.clusters import ClusterPanes, gather_clusters, make_clusters
from ..core.panes.entry_light import EntryLight, EntrySurface
from ..core.planner import plan
from ..core.rays import Bvh, Tracer
from ..core.scene import Light, Scene
from ..core.surface import Patches, Texels, make_patches, make_texels
from ..core.transfer import Entries, find_entries, make_gatherer, make_transport
from ..core.transfer.virtual_lights import gather_virtual_lights, walk

CLUSTERS = 256
"""Panes of the paper."""

Tick = Callable[[float], None]
"""Called with the part of the bake that is done, in [0, 1]; an exception that it raises ends the bake."""


@dataclass(frozen=True)
class Baked:
    """What one way made of a scene.

    seconds: of the whole bake. entries, rays: its budget. bytes: of the panes and, for eigenpanes, all that
    relighting reads. valid: (H, W) bool, the texels with a value of their own. relight: lamps → (H, W, 3)
    float32 indirect irradiance, W/m², row 0 at v = 0. budget: what a planner's trials led to, empty without them.
    """

    seconds: float
    entries: int
    rays: int
    bytes: int
    valid: np.ndarray
    relight: Callable[[Sequence[Light]], np.ndarray]
    budget: dict[str, int] = field(default_factory=dict)


def eigenpanes(scene: Scene, settings: Settings, tick: Tick) -> Baked:
    """The bake as it is."""
    started = time.perf_counter()
    made = bake(scene, settings, lambda p: tick(p.fraction))
    seconds = time.perf_counter() - started
    relighter = Relighter(made.panes(), Tracer(scene))
    own = made.own
    report = made.report
    return Baked(
        seconds,
        report["entries"],
        report["rays"],
        made.bytes,
        own,
        lambda lights: relighter.relight(lights)[..., :3],
        report["budget"],
    )


def gathered_clusters(scene: Scene, settings: Settings, tick: Tick) -> Baked:
    """The paper's panes, from the gather and the solve that eigenpanes have too, with the same budgets."""
    started = time.perf_counter()
    base = _Base.of(scene, settings)
    budget = plan(scene, settings)
    gatherer = make_gatherer(scene, base.patches, base.entries, base.bvh, base.tracer.offset)
    traced = [0, len(base.entries) * budget.entry_rays + len(base.texels) * budget.exit_rays]

    def count(rays):
        traced[0] += rays
        tick(min(traced[0] / traced[1], 1))

    transport = make_transport(base.entries, gatherer, budget.entry_rays, settings.seed, lambda rays, *_: count(rays))
    cluster = make_clusters(base.entries, CLUSTERS, scene.extent, settings.seed)
    panes = gather_clusters(
        base.entries,
        transport,
        gatherer,
        base.texels.samples,
        cluster,
        budget.exit_rays,
        settings.seed + 41,
        count,
    )
    return base.baked(panes, time.perf_counter() - started, traced[1])


def virtual_lights(scene: Scene, settings: Settings, tick: Tick, part: np.ndarray | None = None) -> Baked:
    """The paper: random walks, a virtual light at every vertex, shadow rays to all texels, clusters.

    part: (H, W) bool, the texels to do alone.
    """
    started = time.perf_counter()
    base = _Base.of(scene, settings, part)
    lights = walk(scene, base.patches, base.entries, base.bvh, base.tracer.offset, settings.seed)
    cluster = make_clusters(base.entries, CLUSTERS, scene.extent, settings.seed)
    groups = int(cluster.max()) + 1
    pairs = [0, len(lights.entry) * len(base.texels)]

    def count(done):
        pairs[0] += int(done)
        tick(min(pairs[0] / pairs[1], 1))

    found = gather_virtual_lights(lights, cluster, groups, base.texels.samples, base.tracer, count)
    panes = ClusterPanes(cluster, found, base.entries.area)
    return base.baked(panes, time.perf_counter() - started, pairs[1])


METHODS: dict[str, Callable[[Scene, Settings, Tick], Baked]] = {
    "The paper's method": virtual_lights,
    "The paper's panes, our gather": gathered_clusters,
    "Lightpanes": eigenpanes,
}


@dataclass(frozen=True)
class _Base:
    """What clusters need of a scene: texels, entries and how lamps see them."""

    scene: Scene
    texels: Texels
    patches: Patches
    bvh: Bvh
    tracer: Tracer
    entries: Entries
    light: EntryLight

    @classmethod
    def of(cls, scene, settings, part=None):
        seed = settings.seed
        texels = make_texels(scene, settings.resolution)
        tracer = Tracer(scene)
        patches = make_patches(scene, plan(scene, settings).entries, seed, tracer)
        bvh = Bvh(patches.corners)
        entries, buried, _ = find_entries(scene, patches, bvh, texels.samples, tracer.offset, seed)
        use = np.ones(len(texels), bool) if buried.all() else ~buried
        if part is not None:
            use &= part.reshape(-1)[texels.index]
        surface = EntrySurface.of(entries, patches, entries.places, tracer.offset)
        return cls(scene, texels.keep(use), patches, bvh, tracer, entries, EntryLight(surface, tracer, seed))

    def baked(self, panes, seconds, rays):
        size = self.texels.resolution
        valid = np.zeros((size, size), bool)
        valid.reshape(-1)[self.texels.index] = True
        image = np.zeros((size, size, 3), np.float32)

        def relight(lights):
            direct = np.zeros((len(self.entries), 3), np.float32)
            for lamp in lights:
                unit = self.light.unit(lamp)
                direct += (unit if unit.ndim == 2 else unit[:, None]) * lamp.power.astype(np.float32)
            image.reshape(-1, 3)[self.texels.index] = panes.texels(direct)
            return image

        return Baked(seconds, len(self.entries), rays, panes.panes.nbytes, valid, relight)
