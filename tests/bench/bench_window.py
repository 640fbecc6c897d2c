"""What a person at Blender's window feels: stalls of the main thread while a bake runs, and how soon Esc frees it."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import bpy
import lightpanes
from lightpanes.addon import job

from ..gui import window
from . import harness, scenes

TICK = 0.01  # s
SAMPLE, RESOLUTION = "atrium", 512


def rows() -> Iterator[dict]:
    yield from job_rows()
    yield from window_rows()


def job_rows() -> Iterator[dict]:
    """The same bake without a window: what the worker and our own steps take from the main thread, redraws apart."""
    lightpanes.register()
    bpy.ops.wm.open_mainfile(filepath=str(scenes.FOLDER / f"{SAMPLE}.blend"))
    bpy.context.scene.lightpanes.resolution = RESOLUTION
    running = job.start(bpy.context)
    steps, waits = [], []
    while True:
        before = running.progress.stage
        began = time.perf_counter()
        ended = running.advance()
        took = time.perf_counter() - began
        steps.append((took, f"{before} to {running.progress.stage}"))
        if ended:
            break
        began = time.perf_counter()
        time.sleep(TICK)
        if running.thread is not None:
            waits.append((time.perf_counter() - began - TICK, running.progress.stage))
    waits.sort()
    (stall, stage), (step, what) = waits[-1], max(steps)
    often = waits[int(0.99 * len(waits))][0]
    yield harness.row(f"main thread, {SAMPLE}: longest stall from the worker, redraws apart", 1000 * stall, 100, "ms", detail=f"{stage}; 99 % are below {1000 * often:.0f} ms")  # fmt: skip
    yield harness.row(f"main thread, {SAMPLE}: longest step of ours", 1000 * step, 1000, "ms", detail=what)


def window_rows() -> Iterator[dict]:
    if reason := window.missing():
        yield harness.row("window: not measured", 0, ok=False, detail=reason)
        return
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        archive = window.build(folder, window.python_of_blender(folder))
        found = window.session(folder, archive, SAMPLE, RESOLUTION)
    redraw = found["stalls"]["no bake"][""]
    yield harness.row(f"window, {SAMPLE}: gap of the main thread without a bake, redraws alone", 1000 * redraw, unit="ms")  # fmt: skip
    gaps = [(gap, stage) for name, part in found["stalls"].items() if name != "no bake" for stage, gap in part.items()]
    for kind, bar in (("worker", 0.1), ("main", 1.0)):
        gap, stage = max(item for item in gaps if item[1].startswith(f"{kind}:"))
        label = {"worker": "longest stall while the worker runs", "main": "longest step on the main thread"}[kind]
        yield harness.row(f"window, {SAMPLE}: {label}", 1000 * gap, 1000 * bar, "ms", detail=f"{stage}; redraws included")  # fmt: skip
    yield harness.row(f"window, {SAMPLE}: from Esc to a free interface", max(found["ends"]), 0.5, "s", detail=f"{len(found['ends'])} bakes")  # fmt: skip
