"""The same indirect light in EEVEE and in Cycles: what `cornell`'s bake adds to a picture of each, without bounces."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import bpy
import lightpanes
import numpy as np
from lightpanes.addon import nodes

from . import harness, scenes

SIZE = 192
SAMPLES = {"EEVEE": 32, "CYCLES": 128}


def rows() -> Iterator[dict]:
    lightpanes.register()
    bpy.ops.wm.open_mainfile(filepath=str(scenes.FOLDER / "cornell.blend"))
    scene = bpy.context.scene
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.render.resolution_percentage = 100
    scene.view_settings.view_transform = "Raw"
    scene.render.filter_size = 0.01
    bpy.ops.lightpanes.bake()
    scene.lightpanes.cycles = True
    shown = {engine: _added(scene, engine) for engine in SAMPLES}
    eevee, cycles = _blocks(shown["EEVEE"]), _blocks(shown["CYCLES"])
    error = float(np.sqrt(((eevee - cycles) ** 2).mean()) / cycles.mean())
    detail = f"4×4 blocks of {SIZE}² pixels, edges of things included; mean {eevee.mean():.4f} and {cycles.mean():.4f}"
    yield harness.row("indirect light that the bake adds to a picture: EEVEE against Cycles at zero bounces", error, detail=detail)  # fmt: skip


def _added(scene, engine) -> np.ndarray:
    """(H, W, 3): a render with the bake less one without it."""
    with_it = _render(scene, engine)
    group = nodes.group_of(scene)
    end = next(node for node in group.nodes if node.type == "GROUP_OUTPUT")
    entrance = next(node for node in group.nodes if node.type == "GROUP_INPUT")
    before = end.inputs["Shader"].links[0].from_socket
    group.links.new(entrance.outputs["Shader"], end.inputs["Shader"])
    without = _render(scene, engine)
    group.links.new(before, end.inputs["Shader"])
    return with_it - without


def _render(scene, engine) -> np.ndarray:
    if engine == "CYCLES":
        scene.render.engine = engine
        scene.cycles.samples, scene.cycles.max_bounces, scene.cycles.use_denoising = SAMPLES[engine], 0, False
    else:
        scene.render.engine = "BLENDER_EEVEE" if bpy.app.version >= (5, 0) else "BLENDER_EEVEE_NEXT"
        scene.eevee.taa_render_samples = SAMPLES[engine]
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = str(Path(folder) / "picture.exr")
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        pixels = np.array(image.pixels[:], np.float32).reshape(SIZE, SIZE, 4)[..., :3]
        bpy.data.images.remove(image)
    return pixels


def _blocks(picture) -> np.ndarray:
    return picture.reshape(SIZE // 4, 4, SIZE // 4, 4, 3).mean(axis=(1, 3))
