"""Penumbra casting against Embree's shadow rays: bits, speed, growth, memory; and soft shadows against Cycles.

Scenes and receivers: penumbra_scenes.py. Both sides run on all threads, in turns; each takes its best of several runs.
What is prepared once per scene (Embree's hierarchy, merged polygons) is outside of both; tables of a sample pattern,
made once per pattern, too. Everything that depends on where the lamp stands is inside.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Iterator
from dataclasses import dataclass, replace

import bpy
import lightpanes
import numpy as np
from lightpanes.addon import lamps
from lightpanes.core import metrics
from lightpanes.core.bake import Settings, bake
from lightpanes.core.direct_atlas import DirectAtlas
from lightpanes.core.panes.exits import joined
from lightpanes.core.penumbra import Cost, Masks, Occluders, Receivers, cast, cast_rays, sample_lamp, shade
from lightpanes.core.rays import Tracer
from lightpanes.core.surface import make_texels

from ..core import test_penumbra as hostile
from . import cycles, harness, penumbra_charts, scenes
from .penumbra_scenes import LOSING, STAGES, Stage, boxes, receivers

LARGE = {"one occluder": 10, "crossed grids": 5, "boxes": 3, "columned room": 2}
MANY = {"one occluder": 13, "crossed grids": 5, "boxes": 3.5, "columned room": 2}
LEAST = 0.85
ERROR = 0.02
MEMORY = 64e6
REPEATS = 3


@dataclass(frozen=True)
class Run:
    """Seconds of penumbra casting and of rays, best of several; bits that differ; what the cast did."""

    seconds: float
    brute: float
    differing: int
    masks: Masks

    @property
    def speed(self) -> float:
        return self.brute / self.seconds

    @property
    def detail(self) -> str:
        s = self.masks.statistics
        part = {name: getattr(s, name) / s.relations for name in ("lit", "umbra", "away", "geometry", "rays")}
        parts = ", ".join(f"{name} {100 * value:.1f} %" for name, value in part.items())
        asked = s.relations - s.away
        return (
            f"{1e3 * self.seconds:.0f} ms against {1e3 * self.brute:.0f} ms ({1e9 * self.brute / max(asked, 1):.0f} ns a "
            f"ray), K {s.candidates:.0f}; {parts}; clusters left to rays {100 * s.by_rays:.0f} %"
        )


class Workshop:
    """Stages, prepared once; runs, done once."""

    def __init__(self):
        self._stages: dict[str, tuple[Stage, Tracer, Occluders]] = {}
        self._runs: dict[tuple, Run] = {}

    def prepared(self, name: str, stage: Stage | None = None) -> tuple[Stage, Tracer, Occluders]:
        if name not in self._stages:
            stage = stage or {**STAGES, **LOSING}[name]()
            tracer = Tracer(stage.scene)
            self._stages[name] = stage, tracer, Occluders.of(tracer)
        return self._stages[name]

    def run(self, name: str, side: int, samples: int, repeats: int = REPEATS, stage: Stage | None = None) -> Run:
        key = name, side, samples
        if key not in self._runs:
            stage, tracer, occluders = self.prepared(name, stage)
            self._runs[key] = race(stage, tracer, occluders, side, samples, repeats)
        return self._runs[key]


def race(stage: Stage, tracer: Tracer, occluders: Occluders, side: int, samples: int, repeats: int) -> Run:
    """Cast and brute force in turns."""
    seen = Receivers(*receivers(stage, side))
    lamp = sample_lamp(stage.lamp, samples)
    ours, rays = [], []
    # the table of this pattern, and pages of memory
    cast(seen.take(np.arange(0, len(seen), 16)), lamp, occluders, cost=Cost(samples, "lines"))
    for _ in range(repeats):
        began = time.perf_counter()
        masks = cast(seen, lamp, occluders)
        between = time.perf_counter()
        brute = cast_rays(seen, lamp, tracer.blocked)
        end = time.perf_counter()
        ours.append(between - began)
        rays.append(end - between)
    differing = int(np.unpackbits((masks.packed() ^ brute.packed()).view(np.uint8)).sum())
    return Run(min(ours), min(rays), differing, masks)


def rows() -> Iterator[dict]:
    shop = Workshop()
    yield from exact_rows(shop)
    yield from speed_rows(shop)
    yield from losing_rows(shop)
    yield from growth_rows(shop)
    yield shading_row(shop)
    yield memory_row(shop)
    yield from chart_rows(shop)
    yield from shadow_rows()


def exact_rows(shop: Workshop) -> Iterator[dict]:
    for name in STAGES:
        differing, relations = 0, 0
        for side in (128, 256, 512):
            for samples in (64, 256):
                run = shop.run(name, side, samples, REPEATS if samples == 256 else 2)
                differing += run.differing
                relations += run.masks.statistics.relations
        yield harness.row(
            f"bits that differ from rays, {name}, merged polygons", differing / relations * 1e7, 1, "in 10 M",
            detail=f"{differing} of {relations / 1e6:.0f} M: 16K, 65K, 262K receivers × 64, 256 samples",
        )  # fmt: skip
    yield adversarial_row()
    differing = relations = 0
    for name in STAGES:
        stage, tracer, _ = shop.prepared(name)
        occluders = Occluders.of(tracer, merge=False)
        seen, lamp = Receivers(*receivers(stage, 128)), sample_lamp(stage.lamp, 256)
        masks = cast(seen, lamp, occluders, cost=Cost(256, "lines"))
        brute = cast_rays(seen, lamp, tracer.blocked)
        differing += int(np.unpackbits((masks.packed() ^ brute.packed()).view(np.uint8)).sum())
        relations += masks.statistics.relations
    yield harness.row(
        "bits that differ from rays, triangles", differing, 0, detail=f"of {relations / 1e6:.0f} M, all four scenes"
    )


def adversarial_row() -> dict:
    """Every lamp of the tests over clutter: boxes through one another, receivers on both sides of everything."""
    differing = relations = 0
    for seed in range(8):
        scene = hostile.clutter(seed)
        tracer = Tracer(scene)
        seen = hostile.scattered(scene, 8000, seed)
        for merge in (True, False):
            occluders = Occluders.of(tracer, merge)
            for light in hostile.LAMPS.values():
                lamp = sample_lamp(light, 64)
                masks = cast(seen, lamp, occluders, cost=Cost(64, "lines"))
                brute = cast_rays(seen, lamp, tracer.blocked)
                differing += int(np.unpackbits((masks.packed() ^ brute.packed()).view(np.uint8)).sum())
                relations += masks.statistics.relations
    detail = (
        f"of {relations / 1e6:.0f} M: 8 scenes, {len(hostile.LAMPS)} lamps, polygons and triangles; more in tests/core"
    )
    return harness.row("bits that differ from rays, adversarial", differing, 0, detail=detail)


def speed_rows(shop: Workshop) -> Iterator[dict]:
    for bars, side, samples in ((LARGE, 512, 256), (MANY, 256, 1024)):
        for name, bar in bars.items():
            run = shop.run(name, side, samples)
            label = f"speed over rays, {side * side // 1024}K receivers × {samples}, {name}"
            yield harness.row(label, run.speed, bar, "×", at_least=True, detail=run.detail)


def losing_rows(shop: Workshop) -> Iterator[dict]:
    cases = [(name, 256, 256) for name in LOSING]
    cases += [(name, 64, 256) for name in STAGES] + [(name, 256, 16) for name in STAGES]
    for name, side, samples in cases:
        run = shop.run(name, side, samples, 7 if side * samples < 10_000 else REPEATS)
        label = f"where rays should win: {side * side // 1024}K receivers × {samples}, {name}"
        yield harness.row(label, run.speed, LEAST, "×", at_least=True, detail=run.detail)


def growth_rows(shop: Workshop) -> Iterator[dict]:
    sub_linear = 0
    for name in STAGES:
        few, middle, many = (
            shop.run(name, 256, samples, 2 if samples == 64 else REPEATS) for samples in (64, 256, 1024)
        )
        yield harness.row(f"time, 64 → 256 samples, {name}", middle.seconds / few.seconds, 2.2, "×")
        yield harness.row(f"time, 256 → 1024 samples, {name}", many.seconds / middle.seconds, 3, "×")
        large = shop.run(name, 512, 256)
        growth = large.seconds / middle.seconds
        sub_linear += growth < 3.7
        yield harness.row(f"time, 65K → 262K receivers, {name}", growth, detail="rays: 4")
    yield harness.row(
        "scenes on which receivers × 4 take less than × 3.7", sub_linear, 3, at_least=True, detail="of four"
    )


def shading_row(shop: Workshop) -> dict:
    """Shading from masks beside casting them, the slowest of the four."""
    found = {}
    for name in STAGES:
        stage, _, occluders = shop.prepared(name)
        seen, lamp = Receivers(*receivers(stage, 512)), sample_lamp(stage.lamp, 256)
        masks = cast(seen, lamp, occluders)
        shading, casting = harness.interleaved(
            lambda masks=masks, seen=seen, lamp=lamp, stage=stage: shade(stage.lamp, lamp, seen, masks),
            lambda occluders=occluders, seen=seen, lamp=lamp: cast(seen, lamp, occluders),
            repeats=3,
        )
        found[name] = shading / casting
    detail = ", ".join(f"{name} {value:.2f}" for name, value in found.items())
    return harness.row("shading over casting at 262K × 256", max(found.values()), detail=detail)


def memory_row(shop: Workshop) -> dict:
    """The largest of the four at 262K × 256: masks, tables, work."""
    worst, parts = 0.0, []
    for name in STAGES:
        stage, _, occluders = shop.prepared(name)
        seen, lamp = Receivers(*receivers(stage, 512)), sample_lamp(stage.lamp, 256)
        tracemalloc.start()
        masks = cast(seen, lamp, occluders)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        worst = max(worst, peak)
        parts.append(f"{name} {peak / 1e6:.0f} (masks {(masks.words.nbytes + masks.index.nbytes) / 1e6:.1f})")
    table = "and 17 MB for the pattern's table"
    return harness.row(
        "memory at 262K × 256", (worst + 17e6) / 1e6, MEMORY / 1e6, "MB", detail=f"{', '.join(parts)}, {table}"
    )


def chart_rows(shop: Workshop) -> Iterator[dict]:
    """Speed-up against receivers, samples, the lamp's size and triangles, into out/bench/penumbra.png."""
    series = {"receivers": {}, "samples": {}, "lamp side, m": {}, "triangles": {}}
    for name in STAGES:
        series["receivers"][name] = [(side * side, shop.run(name, side, 256, 2).speed) for side in (64, 128, 256, 512)]
        series["samples"][name] = [(count, shop.run(name, 256, count, 2).speed) for count in (16, 64, 256, 1024)]
        sizes = []
        for size in (0.1, 0.4, 1.0, 2.0, 4.0):
            stage, tracer, occluders = shop.prepared(name)
            resized = replace(stage, lamp=replace(stage.lamp, size=(size, size)))
            sizes.append((size, race(resized, tracer, occluders, 256, 256, 1).speed))
        series["lamp side, m"][name] = sizes
    counts = []
    for count in (30, 100, 300, 1000, 3000, 10000):
        stage = boxes(count)
        counts.append((12 * count, shop.run(f"{count} boxes", 256, 256, 1, stage).speed))
    series["triangles"]["boxes"] = counts
    penumbra_charts.draw(series)
    worst = min(value for one in series.values() for line in one.values() for _, value in line)
    yield harness.row(
        "slowest of the chart over rays", worst, LEAST, "×", at_least=True, detail="out/bench/penumbra.png"
    )


def shadow_rows() -> Iterator[dict]:
    """Direct light of a soft lamp over the atlas as Blender gets it, 64 samples in four sets, against Cycles' bake."""
    disk = {"type": "AREA", "shape": "DISK", "size": 0.6}
    sheet = {"type": "AREA", "shape": "RECTANGLE", "size": 1.0, "size_y": 0.4}
    for name, lamp, frame, change, bar in (
        ("stairs", "Panel", 40, {}, ERROR),
        ("cornell", "Lamp", 84, disk, ERROR),
        ("pillars", "Spot", 1, sheet, ERROR),
        # its rim is 5 cm from a wall, on which it makes 80 times the mean
        ("cornell", "Lamp", 20, disk, ERROR),
    ):
        comparison, spent = shadow(name, lamp, frame, change)
        detail = (
            f"bias {comparison.bias:+.4f}, reference's own noise {comparison.noise:.3f}, {spent:.2f} s for the lamp"
        )
        label = f"soft shadow against Cycles, {name} {frame}: relative RMSE"
        yield harness.row(label, comparison.error, bar, detail=detail)


def shadow(name: str, lamp: str, frame: int, change: dict, resolution: int = 256) -> tuple[metrics.Comparison, float]:
    lightpanes.register()
    scene = scenes.open_sample(name, resolution)
    context = bpy.context
    for item in context.scene.objects:
        if item.type == "LIGHT":
            item.hide_render = item.name != lamp
    context.scene.world = None
    context.scene.frame_set(frame)
    data = context.scene.objects[lamp].data
    if "type" in change:
        data.type = change["type"]
        data = context.scene.objects[lamp].data
    for key, value in change.items():
        if key != "type":
            setattr(data, key, value)
    context.view_layer.update()
    lights = lamps.read_lights(context.evaluated_depsgraph_get(), [])
    reference = cycles.reference_direct(context, resolution, 256)
    texels = make_texels(scene, resolution)
    direct = DirectAtlas(scene, resolution, Tracer(scene))
    began = time.perf_counter()
    image = direct.image(lights)[..., :3]
    spent = time.perf_counter() - began
    mask = np.zeros(resolution * resolution, bool)
    # Cycles' filter takes in black from beyond a chart's border
    mask[texels.index[texels.centred & joined(texels).all(axis=1)]] = True
    mask &= _surrounded(texels, resolution)
    # texels inside of other things get whatever their rays start in
    mask = mask.reshape(resolution, resolution) & bake(scene, Settings(0.2, resolution=resolution)).own
    return reference.compare(image, mask), spent


def _surrounded(texels, resolution):
    """(resolution²,) bool: texels whose neighbours all have their centres on a chart."""
    centred = np.zeros((resolution + 2, resolution + 2), bool)
    row, column = np.divmod(texels.index[texels.centred], resolution)
    centred[row + 1, column + 1] = True
    steps = [slice(k, k + resolution) for k in range(3)]
    return np.logical_and.reduce([centred[a, b] for a in steps for b in steps]).ravel()
