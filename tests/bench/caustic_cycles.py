"""The same caustic path traced by Cycles: a ball of glass above a floor, baked into the floor's atlas."""

from __future__ import annotations

import time

import bpy
import numpy as np
from lightpanes.core.scene import Light, Scene


def build(scene: Scene, light: Light) -> bpy.types.Object:
    """The scene's two objects, floor and glass, and its lamp, in a new file. Returns the floor."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    objects = []
    for number, material in enumerate((_diffuse(), _glass())):
        rows = np.flatnonzero(scene.triangle_object == number)
        used, triangles = np.unique(scene.triangles[rows], return_inverse=True)
        triangles = triangles.reshape(-1, 3)
        mesh = bpy.data.meshes.new(f"Object {number}")
        mesh.from_pydata(scene.positions[used].tolist(), [], triangles.tolist())
        if number == 0:
            mesh.uv_layers.new(name="Atlas").uv.foreach_set("vector", scene.atlas_uv[rows].ravel())
        else:
            mesh.shade_smooth()
        mesh.materials.append(material)
        objects.append(bpy.data.objects.new(mesh.name, mesh))
        bpy.context.collection.objects.link(objects[-1])
    data = bpy.data.lights.new("Lamp", "POINT")
    data.energy, data.shadow_soft_size = float(light.power[0]), light.radius
    lamp = bpy.data.objects.new("Lamp", data)
    lamp.location = light.position
    bpy.context.collection.objects.link(lamp)
    return objects[0]


def bake(floor: bpy.types.Object, resolution: int, samples: int, seed: int) -> tuple[np.ndarray, float]:
    """(resolution, resolution) irradiance, W/m², and seconds."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.samples, cycles.seed, cycles.use_adaptive_sampling = samples, seed, False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.blur_glossy = 0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    image = bpy.data.images.new("Baked", resolution, resolution, float_buffer=True)
    nodes = floor.data.materials[0].node_tree.nodes
    node = nodes.new("ShaderNodeTexImage")
    node.image = image
    nodes.active = node
    bpy.ops.object.select_all(action="DESELECT")
    floor.select_set(True)
    bpy.context.view_layer.objects.active = floor
    began = time.perf_counter()
    bpy.ops.object.bake(type="DIFFUSE", pass_filter={"DIRECT", "INDIRECT"}, margin=0)
    spent = time.perf_counter() - began
    pixels = np.empty(resolution * resolution * 4, np.float32)
    image.pixels.foreach_get(pixels)
    nodes.remove(node)
    bpy.data.images.remove(image)
    # a bake without colour is radiance of a white surface
    return pixels.reshape(resolution, resolution, 4)[..., 0] * np.pi, spent


def _diffuse():
    material = bpy.data.materials.new("Grey")
    material.use_nodes = True
    # black but for what it receives: the ball must not light it by a second way
    material.node_tree.nodes.clear()
    shader = material.node_tree.nodes.new("ShaderNodeBsdfDiffuse")
    output = material.node_tree.nodes.new("ShaderNodeOutputMaterial")
    material.node_tree.links.new(shader.outputs[0], output.inputs[0])
    return material


def _glass():
    material = bpy.data.materials.new("Glass")
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    shader, output = nodes.new("ShaderNodeBsdfGlass"), nodes.new("ShaderNodeOutputMaterial")
    shader.inputs["Roughness"].default_value, shader.inputs["IOR"].default_value = 0.0, 1.5
    shader.inputs["Color"].default_value = (1, 1, 1, 1)
    material.node_tree.links.new(shader.outputs[0], output.inputs[0])
    return material
