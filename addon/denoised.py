"""OpenImageDenoise on baked images. Cycles' bakes do not denoise, so the compositor does it, in a scene of its own."""

from __future__ import annotations

import os
import tempfile
import time
from contextlib import contextmanager

import bpy
import numpy as np

from ..core.scene import SceneError
from .pixels import read_pixels


def can() -> bool:
    """Whether this Blender was built with what it takes."""
    try:
        import _cycles
    except ImportError:
        return False
    return bool(getattr(_cycles, "with_openimagedenoise", False))


def denoise(image: np.ndarray) -> tuple[np.ndarray, float]:
    """(H, W, 3) float32 image, linear and without bounds, as the compositor's Denoise node makes it, and seconds.

    Nothing else is known of the surfaces, such as albedo or normals. Raises SceneError where Blender fails.
    """
    height, width = image.shape[:2]
    started = time.perf_counter()
    with _stage(height, width) as (scene, source, folder):
        pixels = np.ones((height, width, 4), np.float32)
        pixels[..., :3] = image
        source.pixels.foreach_set(pixels.ravel())
        source.update()
        scene.render.filepath = os.path.join(folder, "denoised.exr")
        bpy.ops.render.render(write_still=True, scene=scene.name)
        if not os.path.exists(scene.render.filepath):
            raise SceneError("The compositor wrote no image, so nothing could be denoised.")
        made = bpy.data.images.load(scene.render.filepath)
        try:
            found = read_pixels(made)[..., :3]
        finally:
            bpy.data.images.remove(made)
    return found, time.perf_counter() - started


@contextmanager
def _stage(height, width):
    """A scene of nothing that renders one image through the Denoise node; gone afterwards."""
    scene = bpy.data.scenes.new("Lightpanes Denoise")
    source = bpy.data.images.new("Lightpanes Noisy", width, height, float_buffer=True)
    source.colorspace_settings.name = "Non-Color"
    camera = bpy.data.objects.new("Lightpanes Denoise", bpy.data.cameras.new("Lightpanes Denoise"))
    before, shown = set(bpy.data.node_groups), set(bpy.data.images)
    try:
        scene.collection.objects.link(camera)
        scene.camera = camera
        scene.render.engine, scene.cycles.samples = "CYCLES", 1
        scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, height, 100
        scene.view_settings.view_transform = "Raw" if _has_raw(scene) else "Standard"
        kind = scene.render.image_settings
        kind.file_format, kind.color_depth, kind.color_mode = "OPEN_EXR", "32", "RGB"
        _wire(scene, source)
        with tempfile.TemporaryDirectory() as folder:
            yield scene, source, folder
    finally:
        data = camera.data
        bpy.data.objects.remove(camera)
        bpy.data.cameras.remove(data)
        bpy.data.images.remove(source)
        bpy.data.scenes.remove(scene)
        # 4.5 gives a new compositor a viewer
        for viewed in set(bpy.data.images) - shown:
            if viewed.type == "COMPOSITING":
                bpy.data.images.remove(viewed)
        for tree in set(bpy.data.node_groups) - before:
            bpy.data.node_groups.remove(tree)


def _has_raw(scene):
    return "Raw" in scene.view_settings.bl_rna.properties["view_transform"].enum_items.keys()


def _wire(scene, source):
    """Image → Denoise → output, as this Blender wants its compositor."""
    if hasattr(scene, "compositing_node_group"):
        tree = bpy.data.node_groups.new("Lightpanes Denoise", "CompositorNodeTree")
        scene.compositing_node_group = tree
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        last = tree.nodes.new("NodeGroupOutput")
    else:
        scene.use_nodes = True
        tree = scene.node_tree
        tree.nodes.clear()
        last = tree.nodes.new("CompositorNodeComposite")
    first, middle = tree.nodes.new("CompositorNodeImage"), tree.nodes.new("CompositorNodeDenoise")
    first.image = source
    tree.links.new(first.outputs["Image"], middle.inputs["Image"])
    tree.links.new(middle.outputs["Image"], last.inputs["Image"])
