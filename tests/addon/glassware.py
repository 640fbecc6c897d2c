"""Glass and metal in the room, and what its images show."""

import bpy
import numpy as np
from lightpanes.addon import store


def material(name, **inputs):
    """Principled with these inputs, smooth."""
    made = bpy.data.materials.new(name)
    if made.node_tree is None:
        made.use_nodes = True
    shader = next(node for node in made.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Roughness"].default_value = 0.0
    for key, value in inputs.items():
        socket = shader.inputs[key.replace("_", " ")]
        socket.default_value = (*value, 1) if socket.type == "RGBA" else value
    return made


def ball(scene, name="Ball", location=(-0.35, -0.25, -0.4), radius=0.25, made=None):
    """A smooth sphere of clear glass that gets no light itself."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=48, radius=radius, location=location)
    item = bpy.context.object
    item.name = name
    item.data.polygons.foreach_set("use_smooth", [True] * len(item.data.polygons))
    item.data.materials.append(made or material("Glass", Base_Color=(1.0, 1.0, 1.0), Transmission_Weight=1.0, IOR=1.5))
    item.lightpanes.exclude = True
    bpy.context.view_layer.update()
    return item


def image(role=store.CAUSTICS):
    """(H, W, 3)."""
    return store.read_image(bpy.context.scene, role)[..., :3].copy()


def floor(scene=None):
    """(H, W) bool: texels of the room's floor, its lowest face."""
    from lightpanes.addon import extract
    from lightpanes.core.surface import make_texels

    surfaces = extract.extract(bpy.context, resolution=bpy.context.scene.lightpanes.resolution, albedo=False)
    texels = make_texels(surfaces, bpy.context.scene.lightpanes.resolution)
    low = np.abs(texels.samples.position[:, 2] + 1) < 1e-3
    found = np.zeros(texels.resolution**2, bool)
    found[texels.index[low & (texels.samples.normal[:, 2] > 0.5)]] = True
    return found.reshape(texels.resolution, -1)
