"""The picture of caustics in README and manual: glass.blend without them, as baked, and traced by Cycles.

python sample_blends/caustics.py [--output DIR] [--samples N] [--size PX] [--resolution PX] [--photons N] [--frame N]
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import bpy
import lightpanes
import numpy as np
from demo import compose, prepare, quiet, render
from lightpanes.addon import baking, caustics, commands
from lightpanes.core.metrics import relative_rmse

HERE = Path(__file__).resolve().parent
LABELS = ("Without caustics", "Lightpanes", "Cycles, path traced")
RADIUS = 0.05
"""m, of the lamps, for path tracing never finds smaller ones."""

BOUNCES = 16
NOISELESS = 32
"""Samples a pixel where little noise is to be had."""


def main() -> int:
    options = _options()
    output = Path(options.output).absolute()
    output.mkdir(parents=True, exist_ok=True)
    lightpanes.register()
    with quiet():
        bpy.ops.wm.open_mainfile(filepath=str(HERE / "glass.blend"), load_ui=False)
    scene = bpy.context.scene
    scene.frame_set(options.frame)
    for item in scene.objects:
        if item.type == "LIGHT":
            # a ball, as photons and paths both know it
            item.data.shadow_soft_size, item.data.use_soft_falloff = RADIUS, False
    scene.lightpanes.resolution, scene.lightpanes.photons = options.resolution, options.photons
    with commands.Bar() as bar, quiet():
        report = baking.bake_scene(bpy.context, bar)
    prepare(scene, options.size)
    scene.cycles.blur_glossy = 0.0
    panels, seconds = [], []
    for ours, traced in ((True, False), (True, False), (False, True)):
        scene.lightpanes.caustics = bool(panels)
        scene.lightpanes.cycles = ours
        scene.cycles.diffuse_bounces = BOUNCES if traced else 0
        scene.cycles.max_bounces = BOUNCES
        begin = time.perf_counter()
        panels.append(render(scene, options.samples if traced else NOISELESS, output))
        seconds.append(round(time.perf_counter() - begin, 2))
    compose(scene, panels, output / "glass.png", LABELS)
    everywhere = np.ones(panels[0].shape[:2], bool)
    found = {
        "caustics": caustics.report(scene),
        "bake_seconds": report["total_seconds"],
        "differs_from_cycles": round(relative_rmse(panels[1], panels[2], everywhere, 4), 4),
        "differs_without_caustics": round(relative_rmse(panels[0], panels[2], everywhere, 4), 4),
        "render_seconds": dict(zip(LABELS, seconds, strict=True)),
        "samples": options.samples,
    }
    (output / "glass.json").write_text(json.dumps(found, indent=2) + "\n", "utf-8")
    print(json.dumps(found, indent=2))
    return 0


def _options():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", default=HERE.parent / "out" / "caustics", help="folder for the results")
    parser.add_argument("--samples", type=int, default=256, help="Cycles samples per pixel of the reference")
    parser.add_argument("--size", type=int, default=320, help="width of a panel in pixels")
    parser.add_argument("--resolution", type=int, default=512, help="of the atlas in pixels")
    # lamps as large as these want many: each point of them focuses light to another place
    parser.add_argument("--photons", type=int, default=160_000, help="of each lamp")
    parser.add_argument("--frame", type=int, default=1)
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
