"""Our bake against Cycles' at equal error: one fixed lamp, and a hundred frames of a moving one.

The error is the bake's (core.metrics), mean over the sample's held-out lamps, for both; the time of a Cycles bake is
its mean over the same lamps. Both start from the same open file and atlas: reading the scene counts as ours. A fixed
lamp is one that is not live, so it is baked in and the bake makes no panes; the moving one needs them.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import bpy
import numpy as np
from lightpanes.addon import methods
from lightpanes.addon.extract import extract
from lightpanes.addon.lamps import read_lights
from lightpanes.core import metrics
from lightpanes.core.bake import Bake, Settings, bake
from lightpanes.core.panes import Relighter
from lightpanes.core.rays import Tracer

from . import bench_indirect, cycles, harness, scenes

NAMES = ("cornell", "pillars")
RESOLUTION = Settings().resolution
RUNS = 3
FRAMES = 100
MOST_SPP = 512
"""Cycles is measured up to here; beyond, its power law and its rate go on."""

PAPER = {"entries": 4096}
PAPER_SHARE = 16
"""The paper's way is done on one 4×4 block of texels in so many, and that time multiplied: it is long, and even."""


def rows() -> Iterator[dict]:
    for name in NAMES:
        yield from sample_rows(name)
    yield from paper_rows("pillars")


def sample_rows(name: str) -> Iterator[dict]:
    scene = scenes.open_sample(name, RESOLUTION)
    # the first bake loads kernels; few samples show what does not grow with them
    idle = min(_cycles(name, 1, run)[1] for run in range(2))
    fixed, moving = [], []
    for run in range(RUNS):
        # in turns with Cycles, so that a busy machine slows both alike
        fixed.append(_fixed(name))
        moving.append(_moving(name))
        if run == 0:
            pilots = [_pilot(name, made[0][0]) for made in (fixed, moving)]
            cycles_runs = {spp: [] for spp in (*pilots, max(pilots[1] // 4, 1))}
        for spp, found in cycles_runs.items():
            if not found or spp == min(cycles_runs):
                found.append(_cycles(name, spp, 10 + run))
    curve = _Curve(cycles_runs, idle)
    for label, made in (("fixed", fixed), ("live", moving)):
        error, mine = made[0][0], min(seconds for _, seconds, *_ in made)
        samples, seconds = curve.at(error)
        detail = (
            f"ours: error {error:.4f} in {mine:.2f} s; {curve}, so {error:.4f} at {samples:.0f} spp in {seconds:.2f} s"
        )
        if label == "fixed":
            yield harness.row(f"equal error, one fixed lamp, {name}: our bake over Cycles'", mine / seconds, 1 / 5, detail=detail)  # fmt: skip
            continue
        yield harness.row(f"equal error, one live lamp, {name}: our bake over Cycles'", mine / seconds, detail=detail)
        relights, places = _animation(name, scene, made[-1][2])
        yield harness.row(
            f"{FRAMES} frames of a moving lamp, {name}: bake and relights over Cycles'",
            (mine + relights) / (FRAMES * seconds),
            1 / 100,
            detail=f"{mine:.2f} s + {relights:.2f} s for {FRAMES} relights at {places} places; Cycles {FRAMES} × {seconds:.2f} s",
        )


def _moving(name: str) -> tuple[float, float, Bake]:
    """Error, seconds with reading the scene, and the bake, of lamps that may move."""
    started = time.perf_counter()
    scene = extract(bpy.context, resolution=RESOLUTION)
    result = bake(scene, Settings())
    seconds = time.perf_counter() - started
    return metrics.mean_error([c for _, c in bench_indirect.compare_sample(name, scene, result)]), seconds, result


def _fixed(name: str) -> tuple[float, float]:
    """Error and seconds, means over a bake for each lamp, which is baked in."""
    errors, spent = [], []
    for setting, lights in scenes.settings(name):
        truth = cycles.reference_indirect(bpy.context, RESOLUTION, setting.spp)
        started = time.perf_counter()
        scene = extract(bpy.context, resolution=RESOLUTION)
        scene = replace(scene, lights=tuple(replace(light, live=False) for light in lights))
        result = bake(scene, Settings())
        spent.append(time.perf_counter() - started)
        image = Relighter(result.panes(), Tracer(scene)).relight(())[..., :3]
        errors.append(truth.compare(image, bench_indirect.valid_texels(result)).error)
    return float(np.mean(errors)), float(np.mean(spent))


def _pilot(name: str, error: float) -> int:
    """Samples at which Cycles should have that error, by the root law from the references' halves."""
    scale = []
    for setting, _ in scenes.settings(name):
        truth = cycles.reference_indirect(bpy.context, RESOLUTION, setting.spp)
        # the noise is that of the halves' mean
        scale.append(truth.noise * np.sqrt(2 * setting.spp))
    return int(np.clip(round((np.mean(scale) / max(error, 1e-4)) ** 2), 4, MOST_SPP))


def _cycles(name: str, spp: int, seed: int) -> tuple[float, float]:
    """Error and seconds of one Cycles bake, means over the sample's lamps."""
    errors, seconds = [], []
    for setting, _ in scenes.settings(name):
        truth = cycles.reference_indirect(bpy.context, RESOLUTION, setting.spp)
        image, _, spent = cycles.cycles_bake(bpy.context, {"INDIRECT"}, RESOLUTION, spp, 100 + seed)
        found = truth.compare(image)
        errors.append(found.error)
        seconds.append(spent)
    return float(np.mean(errors)), float(np.mean(seconds))


class _Curve:
    """Cycles' error and seconds by samples, from the runs measured: {samples: [(error, seconds), …]}."""

    def __init__(self, runs, idle):
        self.samples = sorted(runs)
        self.errors = [float(np.mean([error for error, _ in runs[spp]])) for spp in self.samples]
        self.seconds = [min(seconds for _, seconds in runs[spp]) for spp in self.samples]
        self.idle = idle
        power = np.polyfit(np.log(self.samples), np.log(self.errors), 1)[0]
        # noise of the measurement aside, no sampling of Cycles' leaves this range
        self.power = float(np.clip(power, -0.7, -0.4))
        # the fastest of the rates counts
        self.rate = min((s - idle) / max(n - 1, 1) for n, s in zip(self.samples, self.seconds, strict=True) if n > 1)

    def at(self, error: float) -> tuple[float, float]:
        """Samples and seconds that an error takes, from the nearest measured one by the power law."""
        near = int(np.argmin(np.abs(np.log(np.array(self.errors) / error))))
        samples = self.samples[near] * (error / self.errors[near]) ** (1 / self.power)
        return samples, self.idle + max(self.rate, 0) * (samples - 1)

    def __str__(self):
        points = zip(self.errors, self.samples, self.seconds, strict=True)
        return "Cycles: " + ", ".join(f"{e:.4f} at {n} spp in {s:.2f} s" for e, n, s in points)


def _animation(name, scene, result) -> tuple[float, int]:
    """Seconds for reading the lamp and relighting at each of FRAMES frames; at how many places it was."""
    lamp = scenes.SETTINGS[name][0].lamp
    view = bpy.context.scene
    for obj in view.objects:
        if obj.type == "LIGHT":
            obj.hide_render = obj.name != lamp
    relighter = Relighter(result.panes(), Tracer(scene))
    seconds, places = 0.0, set()
    for frame in np.rint(np.linspace(view.frame_start, view.frame_end, FRAMES)).astype(int):
        view.frame_set(int(frame))
        started = time.perf_counter()
        lights = read_lights(bpy.context.evaluated_depsgraph_get(), [])
        relighter.relight(lights)
        seconds += time.perf_counter() - started
        places.add(lights[0].geometry)
    return seconds, len(places)


def paper_rows(name: str) -> Iterator[dict]:
    scene = scenes.open_sample(name, RESOLUTION)
    row, column = np.indices((RESOLUTION, RESOLUTION)) // metrics.BLOCK
    part = (row * 7 + column) % PAPER_SHARE == 0
    began = [0.0]

    def tick(_):
        began[0] = began[0] or time.perf_counter()

    started = time.perf_counter()
    made = methods.virtual_lights(scene, Settings(**PAPER), tick, part)
    before = began[0] - started
    seconds = before + PAPER_SHARE * (made.seconds - before)
    errors = []
    for setting, lights in scenes.settings(name):
        truth = cycles.reference_indirect(bpy.context, RESOLUTION, setting.spp)
        errors.append(truth.compare(made.relight(lights), made.valid))
    yield harness.row(
        f"the paper's way, {name}: virtual lights + {methods.CLUSTERS} clusters, whole bake",
        seconds,
        unit="s",
        detail=f"{made.entries} entries, error {metrics.mean_error(errors):.3f}; from one block in {PAPER_SHARE}; "
        "the paper states 8.5 s",
    )
