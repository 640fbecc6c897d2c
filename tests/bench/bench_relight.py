"""One relight of `cornell` and `pillars` at 256 × 256, default panes, one point lamp moved: from lamp to Blender's image."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import bpy
import numpy as np
from lightpanes.core.bake import Settings, bake
from lightpanes.core.panes import Relighter
from lightpanes.core.rays import Tracer

from . import harness, scenes

MOVES = 60


def rows() -> Iterator[dict]:
    for name in ("cornell", "pillars"):
        yield from sample_rows(name)


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
