"""One relight of `cornell` and `pillars` at 256 × 256, default panes, one point lamp moved: from lamp to Blender's image."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import bpy
import lightpanes
import numpy as np
from lightpanes.addon import sessions
from lightpanes.core.bake import Settings, bake
from lightpanes.core.panes import Relighter
from lightpanes.core.rays import Tracer
from mathutils import Vector

from . import harness, scenes

MOVES = 60


def rows() -> Iterator[dict]:
    for name in ("cornell", "pillars"):
        yield from sample_rows(name)
    yield drag_row()


def drag_row() -> dict:
    """A lamp of `cornell` moved again and again through Blender: handlers, image and all, but no redraw."""
    lightpanes.register()
    bpy.ops.wm.open_mainfile(filepath=str(scenes.FOLDER / "cornell.blend"))
    scene = bpy.context.scene
    bpy.ops.lightpanes.bake()
    lamp = next(item for item in scene.objects if item.type == "LIGHT")
    lamp.animation_data_clear()
    start, seen, took = lamp.location.copy(), set(), []
    for k in range(MOVES):
        began = time.perf_counter()
        lamp.location = start + 0.1 * Vector(np.sin(0.7 * k + np.arange(3)))
        bpy.context.view_layer.update()
        took.append(time.perf_counter() - began)
        seen.add(sessions.of(scene).shown)
    rate = 1 / float(np.median(took))
    return harness.row("a lamp dragged, cornell: updates a second", rate, 20, "1/s", at_least=True, ok=rate >= 20 and len(seen) == MOVES, detail=f"{MOVES} moves through Blender's handlers, redraw excluded")  # fmt: skip


def sample_rows(name: str) -> list[dict]:
    scene = scenes.open_sample(name)
    result = bake(scene, Settings())
    relighter = Relighter(result.panes(), Tracer(scene))
    lamp = next(light for light in scene.lights if light.kind == "POINT")
    image = bpy.data.images.new("Relit", 256, 256, float_buffer=True, is_data=True)
    parts = {"entries": [], "weights": [], "combine": [], "all": []}
    read = []
    weights = relighter.pane_weights([lamp])
    for k in range(MOVES):
        matrix = lamp.matrix.copy()
        matrix[:3, 3] += 0.1 * np.sin(0.7 * k + np.arange(3))
        moved = replace(lamp, matrix=matrix)
        marks = [time.perf_counter()]
        image.pixels.foreach_set(relighter.relight([moved]).reshape(-1))
        image.update()
        marks.append(time.perf_counter())
        unit = relighter.entry_light.unit(moved)
        marks.append(time.perf_counter())
        relighter.panes.weights.of(unit.reshape(len(unit), -1) * moved.power.astype(np.float32))
        marks.append(time.perf_counter())
        relighter.combine(weights)
        marks.append(time.perf_counter())
        relighter.panes.rows.sum()
        marks.append(time.perf_counter())
        for what, seconds in zip(("all", "entries", "weights", "combine"), np.diff(marks), strict=False):
            parts[what].append(1e3 * seconds)
        read.append(1e3 * (marks[5] - marks[4]))
    median = {what: float(np.median(values)) for what, values in parts.items()}
    detail = ", ".join(f"{what} {median[what]:.1f} ms" for what in ("entries", "weights", "combine"))
    ratio = float(np.median(parts["combine"]) / np.median(read))
    size = relighter.panes.rows.nbytes / 2**20
    return [
        harness.row(f"one relight, {name}, 256²: median", median["all"], 15, "ms", detail=f"{detail}; {MOVES} moves"),
        harness.row(
            f"combine, {name}, over numpy reading the panes once",
            ratio,
            2,
            detail=f"{size:.1f} MiB, {np.median(read):.2f} ms",
        ),
    ]
