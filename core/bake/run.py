"""Run a bake: patches, entries, transport, modes, exits; with progress, and cancelled by an exception."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..lights import sky_radiance
from ..panes import Panes
from ..panes.entry_light import EntrySurface
from ..panes.exits import gather_panes
from ..panes.modes import learn_modes, training_fields
from ..panes.regions import features, make_regions, nearest
from ..panes.training import illuminate, training_lamps
from ..panes.weights import make_weights
from ..planner import Settings, limit_rays, plan
from ..rays import Bvh, Tracer
from ..scene import Scene
from ..surface import make_patches, make_texels
from ..transfer import find_entries, make_gatherer, make_transport
from .check import compression_error, gather_noise
from .record import Bake

PLACES = 16
"""Places on each entry where lamps are evaluated at run time."""

SKY_BINS = (32, 64)
"""Bins of a sky that is not uniform: rows of equal solid angle, columns."""

TEST_LAMPS = 24
"""Held-out lamps that measure the panes' error at the end of a bake."""


@dataclass(frozen=True)
class Progress:
    """stage: what is being done. fraction: of the whole bake, in [0, 1]. rays: traced so far."""

    stage: str
    fraction: float
    rays: int


class _Clock:
    """Reports progress and remembers the seconds of each stage."""

    STAGES = {"Surfaces": 0.05, "Entries": 0.12, "Transport": 0.35, "Lamps": 0.52, "Panes": 0.66, "Exits": 0.97, "Check": 1.0}

    def __init__(self, progress: Callable[[Progress], None] | None):
        self.progress = progress
        self.seconds: dict[str, float] = {}
        self.rays = 0
        self.stage, self.began = "", time.perf_counter()
        self.done, self.total = 0, 1

    def start(self, stage: str, rays: int = 0):
        self.stop()
        self.stage, self.began = stage, time.perf_counter()
        self.done, self.total = 0, max(rays, 1)
        self.tick(0)

    def stop(self):
        if self.stage:
            self.seconds[self.stage] = round(time.perf_counter() - self.began, 4)
            self.stage = ""

    def tick(self, rays: int):
        self.rays += rays
        self.done += rays
        if self.progress is None:
            return
        names = list(self.STAGES)
        at = names.index(self.stage)
        low = self.STAGES[names[at - 1]] if at else 0.0
        part = min(self.done / self.total, 1.0)
        self.progress(Progress(self.stage, low + (self.STAGES[self.stage] - low) * part, self.rays))


def bake(scene: Scene, settings: Settings = Settings(), progress: Callable[[Progress], None] | None = None) -> Bake:
    """Bake how `scene` passes light around.

    progress is called every few thousand rays; an exception that it raises cancels the bake. Same scene and
    settings, same bake, on any number of threads (a time budget excepted). Raises SceneError for scenes that
    cannot be baked.
    """
    began = time.perf_counter()
    seed = settings.seed
    budget = plan(scene, settings)
    clock = _Clock(progress)

    clock.start("Surfaces")
    warnings = list(scene.warnings)
    texels = make_texels(scene, settings.resolution)
    patches = make_patches(scene, budget.entries, seed)
    bvh = Bvh(patches.corners)
    tracer = Tracer(scene)

    clock.start("Entries")
    entries, buried = find_entries(scene, patches, bvh, texels.samples, tracer.offset, seed)
    if buried.all():
        buried[:] = False
        warnings.append("Every texel lies inside a closed object; flip the normals of the room, or put a lamp inside it.")
    texels = texels.keep(~buried)
    if (patches.albedo > 0.98).any():
        names = sorted({scene.materials[scene.triangle_material[t]].name for t in patches.parent[(patches.albedo > 0.98).any(axis=1)[patches.patch]]})  # fmt: skip
        warnings.append(f"Albedo above 0.98 is lowered to 0.98 (light would never fade): {', '.join(names)}.")
    sky, bins = scene.sky, (1, 1)
    if sky is not None and sky.radiance.shape[:2] != (1, 1):
        bins = SKY_BINS
    gatherer = make_gatherer(scene, patches, entries, bvh, tracer.offset, bins)

    clock.start("Transport", len(entries) * budget.entry_rays)
    transport = make_transport(scene, patches, entries, gatherer, budget.entry_rays, seed, clock.tick)

    clock.start("Lamps")
    places = entries.points(scene, patches, PLACES, seed + 5)
    lamps = training_lamps(scene, places, bvh, budget.lamps, seed + 6)
    direct = illuminate(lamps, places, PLACES, tracer, seed, clock.tick)
    test = training_lamps(scene, places, bvh, TEST_LAMPS, seed + 1006)
    test_direct = illuminate(test, places, PLACES, tracer, seed + 1000)

    clock.start("Panes")
    radiosity, field = training_fields(entries, transport, direct)
    points = features(entries.position, entries.normal, scene.extent)
    region = make_regions(points, entries.area, budget.regions, seed)
    modes = learn_modes(entries, region, radiosity, field, budget.panes)
    weights = make_weights(entries, transport, modes, entries.albedo.mean(axis=1, keepdims=True) * direct[:, ::8])
    steady, shine = _steady_light(sky, bins, entries, transport)

    own = _own_region(texels.samples, bvh, entries, patches, region, points, scene.extent, tracer.offset)
    order = np.lexsort((texels.index, own))
    exits = texels.keep(order)
    starts = np.concatenate([[0], np.cumsum(np.bincount(own, minlength=modes.regions))])
    tables = _tables(modes, steady, shine, gatherer.size)
    if settings.time_budget:
        spent = time.perf_counter() - began
        rate = clock.rays / max(clock.seconds["Transport"], 1e-3)
        budget = limit_rays(budget, len(exits), rate, 0.9 * (settings.time_budget - spent))

    clock.start("Exits", len(exits) * budget.exit_rays)
    found = gather_panes(gatherer, exits.samples, starts, tables, budget.exit_rays, seed + 41, clock.tick)
    k = modes.panes
    fill = exits.fill()
    panes = Panes(
        rows=np.ascontiguousarray(found[:, :k]),
        starts=starts,
        steady=np.ascontiguousarray(found[:, k : k + 3]) if steady is not None else np.zeros((len(exits), 3), np.float32),
        fill=fill,
        resolution=settings.resolution,
        surface=EntrySurface.of(entries, patches, places, tracer.offset),
        weights=weights,
    )
    first_hit = None
    if shine is not None:
        padded = np.concatenate([found[:, k + 3 : k + 6], np.zeros((1, 3), np.float32)])
        first_hit = padded[fill].reshape(settings.resolution, settings.resolution, 3)

    clock.start("Check")
    compression = compression_error(entries, transport, modes, weights, test_direct)
    noise = gather_noise(gatherer, exits.samples, starts, tables, budget.exit_rays, seed, weights, entries, test_direct)
    clock.stop()
    report = {
        "error": float(np.hypot(compression, noise)),
        "error_parts": {"panes": compression, "gather noise": noise},
        "error_target": settings.error_target,
        "seconds": round(time.perf_counter() - began, 3),
        "stages": clock.seconds,
        "rays": clock.rays,
        "texels": len(exits),
        "buried_texels": int(buried.sum()),
        "triangles": len(scene.triangles),
        "entries": len(entries),
        "regions": modes.regions,
        "panes_per_texel": modes.panes,
        "budget": budget.__dict__,
        "warnings": warnings,
    }
    result = Bake.from_panes(panes, exits.index, first_hit, {"report": report, "seed": seed})
    report["bytes"] = result.bytes
    if progress is not None:
        progress(Progress("Done", 1.0, clock.rays))
    return result


def _steady_light(sky, bins, entries, transport):
    """Light that no lamp changes: radiosity beyond what is emitted (n, 3), and what shines (ids, 3), or None."""
    emitted = entries.radiosity
    if (sky is None or sky.is_black) and not emitted.any():
        return None, None
    count = len(entries)
    from_sky = np.zeros((transport.sky.shape[1], 3), np.float32)
    if sky is not None:
        from_sky = np.float32(np.pi) * _bin_radiance(sky, bins)
    source = emitted + entries.albedo * (transport.sky @ from_sky)
    radiosity = np.stack([transport.solve(entries.albedo[:, c : c + 1], source[:, c : c + 1])[:, 0] for c in range(3)], 1)
    shine = np.zeros((count + 1 + len(from_sky), 3), np.float32)
    shine[:count] = emitted
    shine[count + 1 :] = from_sky
    return radiosity - emitted, shine


def _bin_radiance(sky, bins):
    """(bins, 3) float32 mean radiance of each of the sky's bins."""
    if bins == (1, 1):
        return sky.radiance.reshape(-1, 3).mean(axis=0, keepdims=True)
    fine = 8
    rows, columns = bins
    z = (np.arange(rows * fine, dtype=np.float32) + 0.5) * np.float32(2 / (rows * fine)) - 1
    around = np.float32(2 * np.pi) * (0.5 - (np.arange(columns * fine, dtype=np.float32) + 0.5) / (columns * fine))
    z, around = np.meshgrid(z, around, indexing="ij")
    ring = np.sqrt(1 - z * z)
    directions = np.stack([ring * np.cos(around), ring * np.sin(around), z], -1).reshape(-1, 3)
    radiance = sky_radiance(sky, directions.astype(np.float32))
    return radiance.reshape(rows, fine, columns, fine, 3).mean(axis=(1, 3)).reshape(-1, 3)


def _tables(modes, steady, shine, ids):
    """(regions, ids, c): what a ray that lands on an id brings: the region's modes, then the steady shares."""
    count, k = len(modes.basis), modes.panes
    extra = 0 if steady is None else 6
    tables = np.zeros((modes.regions, ids, k + extra), np.float32)
    tables[:, :count, :k] = modes.makers.reshape(count, modes.regions, k).swapaxes(0, 1)
    if extra:
        tables[:, :count, k : k + 3] = steady
        tables[:, :, k + 3 :] = shine
    return tables


def _own_region(samples, bvh, entries, patches, region, points, extent, offset):
    """(t,) region of each exit: that of the entry it lies on, else of the nearest."""
    lift = np.float32(4 * offset)
    triangle = np.concatenate(
        [
            bvh.closest(
                np.ascontiguousarray(samples.position[s] + samples.flat[s] * lift), np.ascontiguousarray(-samples.flat[s])
            )
            for s in (slice(i, i + 65536) for i in range(0, len(samples), 65536))
        ]
    )
    cross = np.cross(patches.corners[:, 1] - patches.corners[:, 0], patches.corners[:, 2] - patches.corners[:, 0])
    front = np.einsum("nd,nd->n", cross[triangle], samples.flat) > 0
    patch = patches.patch[triangle]
    entry = np.where(front, entries.front_id[patch], entries.back_id[patch])
    own = np.append(region, 0)[entry]
    lost = np.flatnonzero((triangle < 0) | (entry == len(entries)) | (patches.parent[triangle] != samples.triangle))
    if len(lost):
        near = nearest(features(samples.position[lost], samples.flat[lost], extent), points)
        own[lost] = region[near]
    return own
