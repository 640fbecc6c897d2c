"""What is said before a bake, over what it then takes: by the bare model, and as corrected by a bake before."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator

import bpy
import lightpanes
from lightpanes.addon import baking, preflight
from lightpanes.core.threads import thread_count

from . import harness, scenes
from .bench_bake import peak_memory

RESOLUTION = 256
ERROR = 0.035
"""Target of each sample's second bake, in place of 0.05."""

FACTOR = {"bare": 2.0, "corrected": 1.5, "memory": 1.3}
"""By which a forecast may be off."""


def rows() -> Iterator[dict]:
    for name in scenes.NAMES:
        # memory that an earlier bake has left to the process would not count
        command = [sys.executable, "-m", "tests.bench.bench_forecast", name]
        printed = subprocess.run(command, capture_output=True, text=True, check=True, cwd=harness.ROOT).stdout
        first, second = json.loads(next(line for line in printed.splitlines()[::-1] if line.startswith("[")))
        # as if other programs had left the processor the same share of both bakes
        second["wall"] = second["work"] * first["wall"] / first["work"]
        work, wall = "the processor's over its threads", "on the clock, at the first bake's load"
        yield _row(f"{name}: forecast without a bake before over seconds", "bare", first["said"], first["work"], "s", work)  # fmt: skip
        yield _row(f"{name}: forecast after another bake over seconds", "corrected", second["said"], second["wall"], "s", wall)  # fmt: skip
        yield _row(f"{name}: forecast over memory", "memory", first["bytes"] / 2**30, first["held"], "GiB", "its peak")


def _row(name: str, kind: str, said: float, was: float, unit: str, what: str) -> dict:
    ratio, factor = said / max(was, 1e-9), FACTOR[kind]
    detail = f"{said:.3g} of {was:.3g} {unit} ({what}); to be within {1 / factor:.2f} to {factor:.2f}"
    return harness.row(name, ratio, ok=1 / factor <= ratio <= factor, detail=detail)


def measure(name: str) -> list[dict]:
    """Of two bakes of a sample, one after the other: said and bytes before it; wall, work and held after it."""
    lightpanes.register()
    bpy.ops.wm.open_mainfile(filepath=str(scenes.FOLDER / f"{name}.blend"))
    asked = bpy.context.scene.lightpanes
    asked.resolution = RESOLUTION
    found = []
    for target in (asked.error_target, ERROR):
        asked.error_target = target
        preflight.forget()
        said = preflight.examine(bpy.context).forecast
        before, began = peak_memory(), time.process_time()
        report = baking.bake_scene(bpy.context)
        work = (time.process_time() - began) / thread_count()
        held = peak_memory() - before
        found.append({"said": said.seconds, "bytes": said.bytes, "wall": report["total_seconds"], "work": work, "held": held})  # fmt: skip
    return found


if __name__ == "__main__":
    import os

    print(json.dumps(measure(sys.argv[1])), flush=True)
    os._exit(0)
