"""A room for soft shadows, what its images show, and what lamps leave alone."""

import bpy
import numpy as np
from lightpanes.addon import store
from lightpanes.addon.reference import cycles_bake
from lightpanes.core.metrics import relative_rmse

EEVEE = "BLENDER_EEVEE" if bpy.app.version >= (5, 0) else "BLENDER_EEVEE_NEXT"


def shine(scene, name="Panel", location=(-0.3, -0.2, 0.8), energy=20.0):
    """One more lamp: half a metre of panel that looks down."""
    lamp = bpy.data.objects.new(name, bpy.data.lights.new(name, "AREA"))
    lamp.data.energy, lamp.data.size, lamp.location = energy, 0.5, location
    scene.collection.objects.link(lamp)
    return lamp


def hang_panel(scene):
    """An area lamp in place of the room's own, and its direct light wanted in the bake."""
    scene.render.engine = EEVEE
    bpy.data.objects.remove(bpy.data.objects["Lamp"])
    shine(scene)
    scene.lightpanes.direct = "BAKED"
    return scene


def image(role=store.DIRECT):
    """(H, W, 3)."""
    return store.read_image(bpy.context.scene, role)[..., :3].copy()


def sky(scene, strength=0.5):
    scene.world = bpy.data.worlds.new("World")
    if scene.world.node_tree is None:
        scene.world.use_nodes = True
    background = next(node for node in scene.world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Strength"].default_value = strength
    return scene.world


def yard(scene):
    """A floor and a block under the open sky, and a sun that is some degrees wide."""
    for item in list(scene.objects):
        bpy.data.objects.remove(item)
    bpy.ops.mesh.primitive_plane_add(size=3.0)
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(0.2, 0.1, 0.25))
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.data.energy, sun.data.angle, sun.rotation_euler = 3.0, 0.3, (0.5, 0.3, 0.0)
    scene.collection.objects.link(sun)
    bpy.context.view_layer.update()


def error(samples=256):
    """Against Cycles' own direct light, on blocks of 4 × 4 texels that nothing covers."""
    shown = image()
    reference, mask, _ = cycles_bake(bpy.context, {"DIRECT"}, shown.shape[0], samples)
    return relative_rmse(shown, reference, mask & store.load_bake(bpy.context.scene).own, 4)


def linked():
    """Names of the objects that each lamp leaves alone."""
    return {
        item.name: sorted(part.name for part in item.light_linking.receiver_collection.objects)
        for item in bpy.data.objects
        if item.type == "LIGHT" and item.light_linking.receiver_collection is not None
    }


def camera(scene):
    eye = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(eye)
    eye.location, eye.rotation_euler, eye.data.lens = (0, -0.95, 0), (np.pi / 2, 0, 0), 18
    scene.camera = eye
    scene.render.resolution_x = scene.render.resolution_y = 64
    scene.render.image_settings.file_format = "OPEN_EXR"


def render(tmp_path):
    """(H, W, 3) in linear light."""
    scene = bpy.context.scene
    scene.render.filepath = str(tmp_path / "picture.exr")
    bpy.ops.render.render(write_still=True)
    picture = bpy.data.images.load(scene.render.filepath)
    try:
        pixels = np.array(picture.pixels, np.float32)
        return pixels.reshape(picture.size[1], picture.size[0], 4)[..., :3]
    finally:
        bpy.data.images.remove(picture)
