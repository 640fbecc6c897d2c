"""Our bake against Cycles' at equal error: one lamp position, and a hundred frames of a moving lamp.

The error is the bake's (core.metrics), mean over the sample's held-out lamps, for both; the time of a Cycles bake is
its mean over the same lamps. Both start from the same open file and atlas: reading the scene counts as ours.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import bpy
import numpy as np
from lightpanes.addon import methods
from lightpanes.addon.extract import extract
from lightpanes.addon.lamps import read_lights
from lightpanes.core import metrics
from lightpanes.core.bake import Settings, bake
from lightpanes.core.panes import Relighter
from lightpanes.core.rays import Tracer

from . import bench_indirect, cycles, harness, scenes

NAMES = ("cornell", "pillars")
RESOLUTION = Settings().resolution
RUNS = 3
FRAMES = 100
MOST_SPP = 256
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
    result = bake(scene, Settings())
    found = [c for _, c in bench_indirect.compare_sample(name, scene, result)]
    error = metrics.mean_error(found)
    pilot = _pilot(name, error)
    quarter = max(pilot // 4, 1)
    # the first bake loads kernels; few samples show what does not grow with them
    idle = min(_cycles(name, 1, run)[1] for run in range(2))
    ours, reading, few, many = [], [], [], None
    for run in range(RUNS):
        # in turns, so that a busy machine slows both alike
        started = time.perf_counter()
        scene = extract(bpy.context, resolution=RESOLUTION)
        reading.append(time.perf_counter() - started)
        result = bake(scene, Settings())
        ours.append(time.perf_counter() - started)
        if run == 0:
            many = _cycles(name, pilot, 10)
        else:
            few.append(_cycles(name, quarter, run))
    samples, seconds = _equal(error, (quarter, few), (pilot, many), idle)
    mine = min(ours)
    detail = (
        f"ours: error {error:.4f} in {mine:.2f} s, {min(reading):.2f} s of them reading the scene; Cycles: "
        f"{np.mean([f[0] for f in few]):.4f} at {quarter} spp in {min(f[1] for f in few):.2f} s, "
        f"{many[0]:.4f} at {pilot} spp in {many[1]:.2f} s, so {error:.4f} at {samples:.0f} spp in {seconds:.2f} s"
    )
    label = f"equal error, one fixed lamp, {name}: our bake over Cycles'"
    yield harness.row(label, mine / seconds, 1 / 5, detail=detail)
    relights, places = _animation(name, scene, result)
    yield harness.row(
        f"{FRAMES} frames of a moving lamp, {name}: bake and relights over Cycles'",
        (mine + relights) / (FRAMES * seconds),
        1 / 100,
        detail=f"{mine:.2f} s + {relights:.2f} s for {FRAMES} relights at {places} places; Cycles {FRAMES} × {seconds:.2f} s",
    )


def _pilot(name: str, error: float) -> int:
    """Samples at which Cycles should have that error, by the root law from the references' halves."""
    scale = []
    for setting, _ in scenes.settings(name):
        truth = cycles.reference_indirect(bpy.context, RESOLUTION, setting.spp)
        noise = metrics.compare(truth.image, truth.image, truth.mask, reference_halves=tuple(truth.halves)).noise
        # the noise is that of the halves' mean
        scale.append(noise * np.sqrt(2 * setting.spp))
    return int(np.clip(round((np.mean(scale) / max(error, 1e-4)) ** 2), 4, MOST_SPP))


def _cycles(name: str, spp: int, seed: int) -> tuple[float, float]:
    """Error and seconds of one Cycles bake, means over the sample's lamps."""
    errors, seconds = [], []
    for setting, _ in scenes.settings(name):
        truth = cycles.reference_indirect(bpy.context, RESOLUTION, setting.spp)
        image, _, spent = cycles.cycles_bake(bpy.context, {"INDIRECT"}, RESOLUTION, spp, 100 + seed)
        found = metrics.compare(image, truth.image, truth.mask, reference_halves=tuple(truth.halves))
        errors.append(found.error)
        seconds.append(spent)
    return float(np.mean(errors)), float(np.mean(seconds))


def _equal(error, few, many, idle) -> tuple[float, float]:
    """Samples and seconds of Cycles at an error, from the power law through two measured counts of samples.

    few: samples, [(error, seconds)]; many: samples, (error, seconds). The faster of the two rates counts.
    """
    rough = float(np.mean([f[0] for f in few[1]]))
    power = np.log(many[1][0] / rough) / np.log(many[0] / few[0])
    # noise of the measurement aside, no sampling of Cycles' leaves this range
    power = float(np.clip(power, -0.7, -0.4))
    samples = many[0] * (error / many[1][0]) ** (1 / power)
    rates = [(min(f[1] for f in few[1]) - idle) / (few[0] - 1), (many[1][1] - idle) / (many[0] - 1)]
    return samples, idle + max(min(rates), 0) * (samples - 1)


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
        errors.append(
            metrics.compare(
                made.relight(lights), truth.image, truth.mask & made.valid, reference_halves=tuple(truth.halves)
            )
        )
    yield harness.row(
        f"the paper's way, {name}: virtual lights + {methods.CLUSTERS} clusters, whole bake",
        seconds,
        unit="s",
        detail=f"{made.entries} entries, error {metrics.mean_error(errors):.3f}; from one block in {PAPER_SHARE}; "
        "the paper states 8.5 s",
    )
