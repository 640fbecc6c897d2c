"""The sample scenes as the benchmarks use them: opened, with an atlas, extracted, and lit by held-out lamps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import bpy
from lightpanes.addon import lamps
from lightpanes.addon.atlas import make_atlas
from lightpanes.addon.extract import extract
from lightpanes.core.scene import Light, Scene

FOLDER = Path(__file__).resolve().parents[2] / "sample_blends"
NAMES = ("cornell", "pillars", "two_rooms", "stairs")


@dataclass(frozen=True)
class Setting:
    """One way to light a sample: a lamp at a frame of its animation, nothing else shining but, if asked, the sky.

    spp: samples a texel of each half of the reference: small lights close to surfaces need many.
    """

    lamp: str
    frame: int
    spp: int
    sky: bool = False


SETTINGS = {
    "cornell": (Setting("Lamp", 20, 384), Setting("Lamp", 35, 768), Setting("Lamp", 62, 256), Setting("Lamp", 84, 512)),
    "pillars": (
        Setting("Torch", 20, 512),
        Setting("Torch", 50, 256),
        Setting("Torch", 75, 768),
        Setting("Spot", 1, 512),
    ),
    "two_rooms": (
        Setting("Lamp", 25, 192),
        Setting("Lamp", 45, 384),
        Setting("Lamp", 85, 192),
        Setting("Sun", 1, 512, sky=True),
    ),
    "stairs": (Setting("Panel", 15, 64), Setting("Panel", 40, 64), Setting("Panel", 55, 96), Setting("Panel", 80, 64)),
}


def open_sample(name: str, resolution: int = 256) -> Scene:
    """Open sample_blends/NAME.blend, make its atlas and extract it, albedo baked."""
    bpy.ops.wm.open_mainfile(filepath=str(FOLDER / f"{name}.blend"))
    context = bpy.context
    make_atlas(context, [o for o in context.scene.objects if o.type == "MESH"], resolution)
    return extract(context, resolution=resolution)


def settings(name: str) -> Iterator[tuple[Setting, tuple[Light, ...]]]:
    """Light the open sample in its ways, one after another; yields what shines, as the relighter wants it."""
    scene = bpy.context.scene
    world, frame = scene.world, scene.frame_current
    lamp_objects = [obj for obj in scene.objects if obj.type == "LIGHT"]
    hidden = [obj.hide_render for obj in lamp_objects]
    for setting in SETTINGS[name]:
        for obj in lamp_objects:
            obj.hide_render = obj.name != setting.lamp
        scene.world = world if setting.sky else None
        scene.frame_set(setting.frame)
        bpy.context.view_layer.update()
        warnings: list[str] = []
        yield setting, lamps.read_lights(bpy.context.evaluated_depsgraph_get(), warnings)
    # as it was, or what is baked next is another scene
    for obj, was in zip(lamp_objects, hidden, strict=True):
        obj.hide_render = was
    scene.world = world
    scene.frame_set(frame)
    bpy.context.view_layer.update()
