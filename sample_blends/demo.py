"""Bake a sample once, relight it for five places of its lamp, and show it beside Cycles.

python sample_blends/demo.py [--file FILE.blend] [--output DIR] [--error E] [--samples N] [--size PX]
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
import time
from pathlib import Path

import bpy
import lightpanes
import numpy as np
from lightpanes.addon import baking, commands, sessions
from lightpanes.core.bake import Progress
from lightpanes.core.metrics import relative_rmse

HERE = Path(__file__).resolve().parent
PLACES = 5
BOUNCES = 32  # of the reference; more would not show
LABELS = ("Direct light only", "Lightpanes", "Cycles, path traced")
GAP, STRIP = 6, 30  # pixels between panels and above them

# Share of the whole that each part takes, so that the bar moves evenly; measured.
BAKE_SHARE, RELIGHT_SHARE = 0.2, 0.05


def main() -> int:
    options = _options()
    output = Path(options.output).absolute()
    output.mkdir(parents=True, exist_ok=True)
    source = Path(options.file).absolute()
    if not source.exists():
        print(f"demo: there is no file '{source}'.", file=sys.stderr)
        return 2
    lightpanes.register()
    start = time.perf_counter()
    with commands.Bar() as bar:
        with quiet():
            bpy.ops.wm.open_mainfile(filepath=str(source), load_ui=False)
            scene = bpy.context.scene
            if options.error is not None:
                scene.lightpanes.error_target = options.error
            baked = baking.bake_scene(
                bpy.context, lambda p: bar(Progress(f"Bake: {p.stage}", BAKE_SHARE * p.fraction, p.rays))
            )
            lit = output / f"{source.stem}_lightpanes.blend"
            commands.save_blend(lit)
        relights = _relight_all(scene, bar)
        views = _views(scene, options, output, bar)
        bar(Progress("Done", 1.0, 0))
    report = {
        **commands.context_of(source),
        "input": source.name,
        "lit": lit.name,
        "bake": baked,
        "relights": relights,
        "views": views,
        "seconds": round(time.perf_counter() - start, 1),
    }
    (output / "report.json").write_text(json.dumps(report, indent=2) + "\n", "utf-8")
    _summary(report, output)
    return 0


def _options():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--file", default=HERE / "cornell.blend", help="scene with an animated lamp")
    parser.add_argument("--output", default=HERE.parent / "out" / "demo", help="folder for the results")
    parser.add_argument("--error", type=float, help="relative error to bake for (the scene's own setting)")
    parser.add_argument("--samples", type=int, default=64, help="Cycles samples per pixel of the reference")
    parser.add_argument("--size", type=int, default=320, help="width of a panel in pixels")
    return parser.parse_args()


def _relight_all(scene, bar) -> dict:
    """Play the whole animation: what a relight costs."""
    milliseconds, begin = [], time.perf_counter()
    frames = range(scene.frame_start, scene.frame_end + 1)
    for number, frame in enumerate(frames):
        scene.frame_set(frame)
        milliseconds.append(sessions.of(scene).milliseconds)
        bar(Progress("Relight every frame", BAKE_SHARE + RELIGHT_SHARE * number / len(frames), 0))
    return {
        "frames": len(frames),
        "seconds": round(time.perf_counter() - begin, 2),
        "median_ms": round(float(np.median(milliseconds)), 2),
        "worst_ms": round(max(milliseconds), 2),
    }


def _views(scene, options, output, bar) -> list[dict]:
    """One picture for each of five frames: direct light, ours and Cycles side by side."""
    prepare(scene, options.size)
    # what gloss focuses is another matter; our light knows none, so that neither shows it
    scene.cycles.caustics_reflective = scene.cycles.caustics_refractive = False
    lamp = next(item for item in scene.objects if item.type == "LIGHT" and item.animation_data)
    frames = np.linspace(scene.frame_start, scene.frame_end, PLACES + 1)[:-1]
    frames = np.round(frames + (frames[1] - frames[0]) / 2).astype(int)
    bounces = scene.cycles.diffuse_bounces, scene.cycles.max_bounces
    views = []
    for number, frame in enumerate(frames.tolist()):
        scene.frame_set(frame)
        panels, seconds = [], []
        # our picture and direct light are nearly free of noise, so few samples do
        for k, (ours, traced, samples) in enumerate(
            ((False, False, options.samples // 4), (True, False, options.samples // 4), (False, True, options.samples))
        ):
            done = BAKE_SHARE + RELIGHT_SHARE + (1 - BAKE_SHARE - RELIGHT_SHARE) * (number + k * 0.2) / PLACES
            bar(Progress(f"Picture {number + 1} of {PLACES}: {LABELS[k]}", done, 0))
            scene.lightpanes.cycles = ours
            scene.cycles.diffuse_bounces = BOUNCES if traced else 0
            scene.cycles.max_bounces = BOUNCES if traced else bounces[1]
            begin = time.perf_counter()
            panels.append(render(scene, samples, output))
            seconds.append(time.perf_counter() - begin)
        picture = output / f"view_{number + 1}.png"
        direct, lit, truth = panels
        compose(scene, panels, picture)
        views.append(
            {
                "picture": picture.name,
                "frame": frame,
                "lamp": [round(v, 3) for v in lamp.matrix_world.translation],
                "error": round(relative_rmse(lit, truth, block=4), 4),
                "error_without_indirect": round(relative_rmse(direct, truth, block=4), 4),
                "seconds_direct": round(seconds[0], 2),
                "seconds_lightpanes": round(seconds[1], 2),
                "seconds_cycles": round(seconds[2], 2),
            }
        )
    scene.lightpanes.cycles = False
    scene.cycles.diffuse_bounces, scene.cycles.max_bounces = bounces
    return views


def prepare(scene, size):
    """Let Cycles render pictures so many pixels wide, denoised, into OpenEXR."""
    output = scene.render
    output.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.use_denoising = True
    scene.cycles.denoiser = "OPENIMAGEDENOISE"
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.sample_clamp_indirect = 0.0
    aspect = output.resolution_y / output.resolution_x
    output.resolution_x, output.resolution_y = size, round(size * aspect)
    output.resolution_percentage = 100
    output.use_persistent_data = False
    output.image_settings.file_format = "OPEN_EXR"
    output.image_settings.color_mode, output.image_settings.color_depth = "RGB", "32"


def render(scene, samples, output) -> np.ndarray:
    """(H, W, 3) float32 linear picture, row 0 at the bottom."""
    scene.cycles.samples = samples
    path = output / ".panel.exr"
    scene.render.filepath = str(path)
    try:
        with quiet():
            bpy.ops.render.render(write_still=True)
            image = bpy.data.images.load(str(path))
        image.colorspace_settings.name = "Non-Color"
        pixels = np.empty(len(image.pixels), np.float32)
        image.pixels.foreach_get(pixels)
        bpy.data.images.remove(image)
    finally:
        path.unlink(missing_ok=True)
    return pixels.reshape(scene.render.resolution_y, scene.render.resolution_x, -1)[..., :3]


def compose(scene, panels, path: Path, labels=LABELS) -> None:
    """Panels side by side, as the scene's own view transform shows them, with their labels above."""
    height, width = panels[0].shape[:2]
    canvas = np.zeros((height + STRIP, width * len(panels) + GAP * (len(panels) - 1), 4), np.float32)
    canvas[..., 3] = 1
    for k, panel in enumerate(panels):
        left = k * (width + GAP)
        canvas[:height, left : left + width, :3] = panel
    image = bpy.data.images.new("Panels", canvas.shape[1], canvas.shape[0], float_buffer=True)
    image.pixels.foreach_set(canvas.reshape(-1))
    settings = scene.render.image_settings
    kept = settings.file_format, settings.color_mode, settings.color_depth
    settings.file_format, settings.color_mode = "PNG", "RGB"
    settings.color_depth = "8"
    image.save_render(str(path), scene=scene)
    settings.file_format = kept[0]
    settings.color_mode, settings.color_depth = kept[1:]
    bpy.data.images.remove(image)
    import blf  # these two exist once bpy has been imported
    import imbuf

    picture = imbuf.load(str(path))
    with blf.bind_imbuf(0, picture):
        blf.size(0, 16)
        blf.color(0, 0.9, 0.9, 0.9, 1)
        for k, label in enumerate(labels):
            blf.position(0, k * (width + GAP) + (width - blf.dimensions(0, label)[0]) / 2, height + 9, 0)
            blf.draw_buffer(0, label)
    imbuf.write(picture, filepath=str(path))


@contextlib.contextmanager
def quiet():
    """Blender writes each step of a render to stdout from C; that belongs beside no progress bar."""
    sys.stdout.flush()
    kept = os.dup(1)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    try:
        yield
    finally:
        sys.stdout.flush()
        os.dup2(kept, 1)
        os.close(kept)


def _summary(report, output):
    bake, relights, views = report["bake"], report["relights"], report["views"]
    print(f"\nBaked {report['input']} once in {bake['total_seconds']:.1f} s; its own estimate of the error is "
          f"{100 * bake['error']:.1f} %.")  # fmt: skip
    print(f"Relit {relights['frames']} frames in {relights['seconds']:.1f} s: {relights['median_ms']:.1f} ms each "
          f"(median), the worst {relights['worst_ms']:.1f} ms.\n")  # fmt: skip
    print("  picture      frame   lamp at                 differs from Cycles   without indirect light   Cycles took")
    for view in views:
        place = ", ".join(f"{v:6.2f}" for v in view["lamp"])
        print(f"  {view['picture']:<12} {view['frame']:5d}   {place}   {100 * view['error']:17.1f} %"
              f"   {100 * view['error_without_indirect']:20.1f} %   {view['seconds_cycles']:9.1f} s")  # fmt: skip
    for warning in bake["warnings"]:
        print(f"  Warning: {warning}")
    print(f"\nEverything is in {output}; open {report['lit']} in Blender, move the lamp, and the light follows.")
    print(f"The whole demo took {report['seconds']:.0f} s.")


if __name__ == "__main__":
    sys.exit(main())
