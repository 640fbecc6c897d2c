"""The sweeps' rooms in Blender, for Cycles: built once, kept as a file beside its cached references."""

from __future__ import annotations

import bpy
import numpy as np
from lightpanes.addon.atlas import make_atlas
from lightpanes.addon.extract import extract
from lightpanes.core.scene import Scene

from . import harness
from .sweeps import parts, rooms

BLEND = harness.OUT / "sweeps.blend"


def open_rooms(resolution: int) -> Scene:
    """Open the file, make its atlas, and extract it."""
    if not BLEND.exists():
        _build()
    bpy.ops.wm.open_mainfile(filepath=str(BLEND))
    make_atlas(bpy.context, [item for item in bpy.context.scene.objects if item.type == "MESH"], resolution)
    return extract(bpy.context, resolution=resolution)


def move_lamp(place) -> None:
    """Put the only lamp there."""
    bpy.data.objects["Lamp"].location = tuple(map(float, place))
    bpy.context.view_layer.update()


def _build():
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    made, scene = rooms(), bpy.context.scene
    paints = []
    for kind in made.materials:
        paint = bpy.data.materials.new(kind.name)
        if paint.node_tree is None:
            paint.use_nodes = True
        shader = next(node for node in paint.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
        shader.inputs["Base Color"].default_value = (*kind.albedo, 1)
        shader.inputs["Specular IOR Level"].default_value = 0.0
        paints.append(paint)
    for number, (points, triangles, _, material) in enumerate(parts()):
        mesh = bpy.data.meshes.new(f"Part {number}")
        mesh.from_pydata(np.asarray(points).tolist(), [], np.asarray(triangles).tolist())
        mesh.materials.append(paints[material])
        scene.collection.objects.link(bpy.data.objects.new(mesh.name, mesh))
    data = bpy.data.lights.new("Lamp", "POINT")
    data.energy, data.shadow_soft_size = 100.0, 0.0
    lamp = bpy.data.objects.new("Lamp", data)
    lamp.location = made.lights[0].position
    scene.collection.objects.link(lamp)
    scene.render.engine = "CYCLES"
    BLEND.parent.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(BLEND))
