"""Time and memory of bakes and relights against the size of each thing that a scene or a bake has many of.

`python -m tests.bench scaling` runs the sizes that take seconds, `LIGHTPANES_SCALING=full` in the environment those up
to the ends of the axes, too; every point is a process of its own, so that its largest memory is its own. It fits
exponents to the upper half of each axis (least squares of the logarithms), and writes scaling.json and scaling.png to
out/bench; `python -m tests.bench.bench_scaling` draws docs/scaling.png from that JSON. The whole takes most of an hour:
`python -m tests.bench.bench_scaling keep AXIS SIZE …` measures single points into the JSON, and `LIGHTPANES_SCALING=kept`
makes the rows of what is there.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lightpanes.core.bake import Settings, bake
from lightpanes.core.panes import Relighter
from lightpanes.core.rays import Tracer
from lightpanes.core.scene import Light, Material, Scene
from lightpanes.tests.core import shapes

from . import harness

STEEPEST = 1.1
"""Largest exponent of time and of memory."""

MOST_MEMORY = 4.0  # GiB, of any bake
LONGEST = 900  # s for one point
COLOURS = (Material("Walls", (0.7, 0.6, 0.5)), Material("Things", (0.3, 0.5, 0.8)))
SMALL = {
    "entries": 800,
    "entry_rays": 256,
    "exit_rays": 32,
    "lamps": 200,
    "regions": 48,
    "points": 2000,
    "point_rays": 128,
}
"""Budgets of what an axis does not measure."""


@dataclass(frozen=True)
class Axis:
    """run(size) does the work and returns seconds of its stages. sizes: quick ones; more: those that take minutes.
    fitted: stages whose sum is fitted, None for all."""

    label: str
    run: Callable[[int], dict[str, float]]
    sizes: tuple[int, ...]
    more: tuple[int, ...] = ()


def room(**more) -> Scene:
    return shapes.scene(*shapes.room_parts(), materials=COLOURS, names=["Room", "Block"], **more)


def lamps(count: int, live: bool = True) -> list[Light]:
    """In the room's air, each somewhere else."""
    places = np.random.default_rng(count).uniform((0.3, 0.3, 1.2), (3.7, 2.7, 2.3), (count, 3))
    return [
        Light(f"Lamp {k}", "POINT", np.block([[np.eye(3), place[:, None]], [np.zeros((1, 3)), 1]]), np.full(3, 9.0), radius=0.05, live=live)
        for k, place in enumerate(places)
    ]  # fmt: skip


def baked(scene: Scene, lit: list[Light] | None = None, **settings) -> dict[str, float]:
    """Seconds of a bake's stages, and of opening and relighting it."""
    result = bake(scene, Settings(**settings))
    stages = dict(result.report["stages"])
    began = time.perf_counter()
    relighter = Relighter(result.panes(), Tracer(scene))
    opened = time.perf_counter()
    relighter.relight(lamps(1) if lit is None else lit)
    return stages | {"Open": opened - began, "Relight": time.perf_counter() - opened}


def texels(side: int) -> dict[str, float]:
    return baked(room(), resolution=side, **SMALL | {"exits": "points"})


def texel_exits(side: int) -> dict[str, float]:
    return baked(room(), resolution=side, **SMALL | {"exits": "texels"})


def triangles(count: int) -> dict[str, float]:
    """A wavy floor of so many in a room."""
    walls, cells = shapes.room_parts()[0], round(np.sqrt(count / 2))
    points, faces, flat = shapes.grid((0.1, 0.1, 0.2), (3.8, 0, 0), (0, 2.8, 0), cells)
    points[:, 2] += 0.1 * np.sin(9 * points[:, 0]) * np.cos(7 * points[:, 1])
    scene = shapes.scene(walls, (points, faces, flat, 1), materials=COLOURS)
    return baked(scene, resolution=256, **SMALL | {"points": None, "exits": "points"})


def live_lamps(count: int) -> dict[str, float]:
    """Only what follows the lamps: all of them are new."""
    result = bake(room(), Settings(resolution=256, **SMALL | {"entries": 4000}))
    relighter, lit = Relighter(result.panes(), Tracer(room())), lamps(count)
    began = time.perf_counter()
    relighter.relight(lit)
    return {"Relight": time.perf_counter() - began}


def baked_lamps(count: int) -> dict[str, float]:
    return baked(room(lights=lamps(count, live=False)), resolution=256, **SMALL)


def entries(count: int) -> dict[str, float]:
    given = {"resolution": 256, "exits": "points", "points": 2000, "point_rays": 128, "lamps": 400, "regions": 96}
    return baked(room(), **given, entries=count, entry_rays=512)


def objects(count: int) -> dict[str, float]:
    """Boxes on a floor, each with a mesh of its own, baked in Blender."""
    return in_blender(count, shared=False)


def shared_objects(count: int) -> dict[str, float]:
    return in_blender(count, shared=True)


def in_blender(count: int, shared: bool) -> dict[str, float]:
    import bpy
    import lightpanes
    from lightpanes.addon import baking, relight

    lightpanes.register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    side = int(np.ceil(np.sqrt(count)))
    floor = bpy.data.meshes.new("Floor")
    floor.from_pydata([(-1, -1, 0), (side, -1, 0), (side, side, 0), (-1, side, 0)], [], [(0, 1, 2, 3)])
    scene.collection.objects.link(bpy.data.objects.new("Floor", floor))
    points, faces, _ = shapes.box((0, 0, 0.1), (0.4, 0.4, 0.5))
    mesh = None
    for k in range(count):
        if mesh is None or not shared:
            mesh = bpy.data.meshes.new("Box")
            mesh.from_pydata(points.tolist(), [], faces.tolist())
        item = bpy.data.objects.new(f"Box {k}", mesh)
        item.location = (k % side, k // side, 0)
        scene.collection.objects.link(item)
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    lamp.location = (side / 2, side / 2, 3)
    scene.collection.objects.link(lamp)
    bpy.context.view_layer.update()
    asked = scene.lightpanes
    # the planner's trials are no part of what is measured
    asked.resolution, asked.error_target, asked.time_budget = 2048 if count > 1000 else 512, 0.5, 0
    marks: dict[str, float] = {}
    last = [time.perf_counter(), ""]

    def told(progress):
        moment = time.perf_counter()
        marks[last[1] or "Before"] = marks.get(last[1] or "Before", 0.0) + moment - last[0]
        last[:] = moment, progress.stage

    baking.bake_scene(bpy.context, told)
    began = time.perf_counter()
    lamp.location.x += 0.5
    bpy.context.view_layer.update()
    relight.relight(bpy.context)
    return marks | {"Relight": time.perf_counter() - began}


AXES = {
    "texels": Axis("texels a side (exits: points)", texels, (64, 128, 256, 512, 1024, 2048), (4096,)),
    "texel exits": Axis("texels a side (exits: texels)", texel_exits, (64, 128, 256, 512, 1024), (2048,)),
    "triangles": Axis("triangles", triangles, (1000, 10_000, 100_000, 300_000), (1_000_000, 3_000_000)),
    "live lamps": Axis("live lamps, relit", live_lamps, (1, 10, 100, 1000)),
    "baked lamps": Axis("lamps baked in", baked_lamps, (1, 10, 100, 1000)),
    "objects": Axis("objects, own meshes", objects, (1, 10, 100, 300, 1000), (3000, 10_000)),
    "shared objects": Axis("objects, one mesh", shared_objects, (1, 10, 100, 300, 1000), (3000, 10_000)),
    "entries": Axis("entries", entries, (256, 1024, 4096, 8192, 16_384), (32_768, 65_536)),
}
SQUARED = {"texels", "texel exits"}
"""Axes whose sizes are of a side: exponents are of the square."""


def rows(only: tuple[str, ...] = ()) -> Iterator[dict]:
    asked = os.environ.get("LIGHTPANES_SCALING")
    for name in only or AXES:
        axis = AXES[name]
        points = _kept().get(name, {"points": []})["points"] if asked == "kept" else []
        for size in () if asked == "kept" else axis.sizes + (axis.more if asked == "full" else ()):
            point = measure_alone(name, size)
            points.append(point)
            if "error" in point:
                break
        if not points:
            continue
        if asked != "kept":
            _keep(name, points)
        good = [point for point in points if "error" not in point]
        detail = "; ".join(f"{p['size']}: {p['cpu']:.2f} s, {p['held']:.0f} MiB" for p in good)
        for what, unit in (("cpu", "time"), ("held", "memory")):
            last = f"; between the last two {exponent(name, good[-2:], what):.2f}"
            yield harness.row(
                f"scaling: {name}, exponent of {unit}", exponent(name, good, what), STEEPEST, detail=detail + last
            )
        failed = [point for point in points if "error" in point]
        most = max((point["held"] for point in good), default=np.inf) / 1024
        detail = f"at {good[-1]['size']}" if good else ""
        if failed:
            most, detail = np.inf, f"at {failed[0]['size']}: {failed[0]['error']}"
        yield harness.row(f"scaling: {name}, largest memory of a bake", most, MOST_MEMORY, "GiB", detail=detail)
    draw(_kept(), harness.OUT / "scaling.png")


def exponent(name: str, points: list[dict], what: str) -> float:
    """Slope of the logarithms over the upper half of the sizes measured (by their logarithms)."""
    return float(_fit(name, points, what)[0])


def _fit(name, points, what):
    """The slope, and the fitted points' logarithms of sizes and values by it."""
    size = np.log([float(p["size"]) ** (2 if name in SQUARED else 1) for p in points])
    value = np.log([max(p[what], 1e-6) for p in points])
    upper = size >= 0.5 * (size[0] + size[-1]) - 1e-9
    if upper.sum() < 2:
        upper[-2:] = True
    slope, at = np.polyfit(size[upper], value[upper], 1)
    return slope, upper, at + slope * size[upper]


def measure_alone(name: str, size: int) -> dict:
    """One point, in a process of its own: see `measure`."""
    command = [sys.executable, "-m", "tests.bench.bench_scaling", name, str(size)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, cwd=harness.ROOT, timeout=LONGEST)
    except subprocess.TimeoutExpired:
        return {"size": size, "error": f"more than {LONGEST} s"}
    lines = [line for line in done.stdout.splitlines() if line.startswith('{"size"')]
    if done.returncode or not lines:
        return {"size": size, "error": (done.stderr.strip().splitlines() or [f"ended with {done.returncode}"])[-1]}
    return json.loads(lines[-1])


def measure(name: str, size: int) -> dict:
    """size; seconds on the clock; cpu: s of the processor over all threads; held: MiB at most beyond what the process
    held before; stages: s."""
    before, began, worked = memory("VmRSS"), time.perf_counter(), time.process_time()
    stages = AXES[name].run(size)
    seconds, cpu = time.perf_counter() - began, time.process_time() - worked
    if "lamps" in name and "Relight" in stages and len(stages) == 1:
        cpu = seconds = stages["Relight"]
    held = memory("VmHWM") - before
    stages = {stage: round(value, 4) for stage, value in stages.items()}
    return {"size": size, "seconds": round(seconds, 4), "cpu": round(cpu, 4), "held": round(held, 2), "stages": stages}


def memory(kind: str) -> float:
    """MiB that this process holds ("VmRSS") or has held at most ("VmHWM"); Linux tells."""
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(kind))
    return int(line.split()[1]) / 1024


def keep(name: str, sizes: list[int]) -> None:
    """Measure points of an axis anew, beside those of its others that were measured before."""
    for size in sizes:
        point = measure_alone(name, size)
        print(name, json.dumps(point), flush=True)
        others = [p for p in _kept().get(name, {"points": []})["points"] if p["size"] != size]
        _keep(name, sorted([*others, point], key=lambda p: p["size"]))


def _kept() -> dict:
    place = harness.OUT / "scaling.json"
    return json.loads(place.read_text("utf-8")) if place.exists() else {}


def _keep(name: str, points: list[dict]) -> None:
    """Write an axis' points over those of an earlier run."""
    place, held = harness.OUT / "scaling.json", _kept()
    held[name] = {"label": AXES[name].label, "points": points}
    held["machine"], held["date"] = harness.machine(), time.strftime("%Y-%m-%d")
    harness.OUT.mkdir(parents=True, exist_ok=True)
    place.write_text(json.dumps(held, indent=1, ensure_ascii=False) + "\n", "utf-8")


def draw(held: dict, place: Path) -> None:
    """Time and memory of all axes, log-log, with the fits and their exponents; dashed: in proportion."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.ticker import NullFormatter

    names = [name for name in AXES if name in held]
    across = 4
    down = -(-len(names) // across)
    figure, grid = pyplot.subplots(2 * down, across, figsize=(10.5, 4.4 * down), layout="constrained", squeeze=False)
    for axes in grid.flat[2 * len(names) :]:
        axes.set_visible(False)
    for number, name in enumerate(names):
        points = [p for p in held[name]["points"] if "error" not in p]
        size = np.array([p["size"] for p in points])
        row, column = 2 * (number // across), number % across
        for axes, what, unit in ((grid[row, column], "cpu", "s of processor"), (grid[row + 1, column], "held", "MiB")):
            value = np.array([p[what] for p in points])
            slope, fitted, line = _fit(name, points, what)
            even = value[-1] * (size / size[-1]) ** (2.0 if name in SQUARED else 1.0)
            axes.plot(size, even, color="0.75", linestyle="--", linewidth=1)
            axes.plot(size[fitted], np.exp(line), color="#d9822b", linewidth=3, alpha=0.6)
            axes.plot(size, value, marker="o", markersize=3.5, linewidth=1.2, color="#3f6ea8")
            axes.set(xscale="log", yscale="log")
            axes.set_title(f"{unit}: exponent {slope:.2f}", fontsize=8)
            axes.grid(which="major", color="0.9")
            # at least a decade
            middle = np.sqrt(value.min() * value.max())
            axes.set_ylim(min(value.min() / 1.6, middle / 3.2), max(value.max() * 1.6, middle * 3.2))
            axes.tick_params(labelsize=7)
            axes.yaxis.set_minor_formatter(NullFormatter())
            axes.xaxis.set_minor_formatter(NullFormatter())
            axes.set_xlabel(held[name]["label"], fontsize=8)
    figure.suptitle(f"{held['machine']}; {held['date']}", fontsize=7, color="0.4")
    figure.savefig(place, dpi=110)
    pyplot.close(figure)


if __name__ == "__main__":
    if sys.argv[1:2] == ["keep"]:
        keep(sys.argv[2], [int(size) for size in sys.argv[3:]])
        sys.exit()
    if len(sys.argv) > 2:
        print(json.dumps(measure(sys.argv[1], int(sys.argv[2]))), flush=True)
        # Blender 4.5 as a module can hang in its exit handlers
        os._exit(0)
    draw(_kept(), harness.ROOT / "docs" / "scaling.png")
