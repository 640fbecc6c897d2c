"""What is inside the node group `Lightpanes`: the light of a bake's images, as emission under the material's gloss."""

from __future__ import annotations

import math

import bpy

from . import store, vertices
from .meshes import AT_VERTICES

UV_LAYER = "Lightpanes"

GLOSS = ("Gloss", "Gloss Edge", "Gloss Power")
"""Inputs of the group, see `materials.gloss_by_angle`."""


def fill_group(scene, group):
    """Shader + albedo × (irradiance + direct + caustics) / π as emission, on baked objects, seen by the camera or in mirrors.

    The input Direct is 0 in engines that bring the first hit of sky and emissive faces themselves. Gloss lies over the
    base, as Principled has it: what it returns, more at grazing angles, does not reach the base.
    """
    there = {item.name for item in group.interface.items_tree if item.in_out == "INPUT"}
    for name in GLOSS:
        # those of older files
        if name not in there:
            group.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketFloat").default_value = 0.0
    build = _Builder(group)
    entrance, end = build.node("NodeGroupInput"), build.node("NodeGroupOutput")

    uv = build.node("ShaderNodeUVMap")
    uv.uv_map = UV_LAYER
    scale = build.attribute("lightpanes_scale").outputs["Vector"]
    offset = build.attribute("lightpanes_offset").outputs["Vector"]
    place = build.vector("ADD", build.vector("MULTIPLY", uv.outputs["UV"], scale), offset)

    light = build.image(store.find_image(scene, store.IRRADIANCE), place)
    mapped = entrance.outputs["Albedo Map"]
    direct = store.find_image(scene, store.DIRECT)
    if direct is not None:
        shown = build.image(direct, place)
        steady = store.find_image(scene, store.STEADY)
        if steady is not None:
            share = build.math("SUBTRACT", 1.0, entrance.outputs["Direct"])
            without = build.vector("MULTIPLY", build.image(steady, place), share)
            shown = build.vector("SUBTRACT", shown, without)
        elif store.holds_direct(scene):
            shown = build.vector("MULTIPLY", shown, entrance.outputs["Direct"])
        light = build.vector("ADD", light, shown)
    caustics = store.find_image(scene, store.CAUSTICS)
    if caustics is not None:
        light = build.vector("ADD", light, build.image(caustics, place))
    if vertices.lit(scene):
        at_vertices = build.attribute(AT_VERTICES).outputs["Fac"]
        light = build.mix(at_vertices, light, build.attribute(vertices.LIGHT, "GEOMETRY").outputs["Color"])
        # no place in the atlas, so no albedo there
        mapped = build.math("MULTIPLY", mapped, build.math("SUBTRACT", 1.0, at_vertices))
    albedo = build.vector("MULTIPLY", entrance.outputs["Albedo"], entrance.outputs["Tint"])
    baked_albedo = store.find_image(scene, store.ALBEDO)
    if baked_albedo is not None:
        albedo = build.mix(mapped, albedo, build.image(baked_albedo, place))
    radiance = build.vector("MULTIPLY", build.vector("MULTIPLY", light, albedo), (1 / math.pi,) * 3)

    # Seen after a diffuse bounce it would be bounced light that bounces again.
    fresh = build.math("LESS_THAN", build.node("ShaderNodeLightPath").outputs["Diffuse Depth"], 0.5)
    strength = build.math("MULTIPLY", fresh, build.attribute("lightpanes_baked").outputs["Fac"])
    strength = build.math("MULTIPLY", strength, _under_gloss(build, entrance))

    emission, add = build.node("ShaderNodeEmission"), build.node("ShaderNodeAddShader")
    group.links.new(radiance, emission.inputs["Color"])
    group.links.new(strength, emission.inputs["Strength"])
    group.links.new(entrance.outputs["Shader"], add.inputs[0])
    group.links.new(emission.outputs[0], add.inputs[1])
    group.links.new(add.outputs[0], end.inputs["Shader"])


def _under_gloss(build, entrance):
    """Part of the light that is not the gloss' (`materials.gloss_by_angle`)."""
    base, edge, power = (entrance.outputs[name] for name in GLOSS)
    view = build.node("ShaderNodeNewGeometry")
    facing = build.node("ShaderNodeVectorMath")
    facing.operation = "DOT_PRODUCT"
    for name, socket in zip(("Normal", "Incoming"), facing.inputs, strict=False):
        build.group.links.new(view.outputs[name], socket)
    away = build.math("SUBTRACT", 1.0, build.math("ABSOLUTE", facing.outputs["Value"], 0.0))
    away = build.math("MAXIMUM", away, 0.0)
    gloss = build.math("ADD", base, build.math("MULTIPLY", edge, build.math("POWER", away, power)))
    return build.math("MAXIMUM", build.math("SUBTRACT", 1.0, gloss), 0.0)


class _Builder:
    """Adds nodes to a group from left to right."""

    def __init__(self, group):
        self.group = group

    def node(self, kind: str):
        node = self.group.nodes.new(kind)
        node.location = (200 * (len(self.group.nodes) - 1), 0)
        return node

    def attribute(self, name: str, kind: str = "OBJECT"):
        node = self.node("ShaderNodeAttribute")
        node.attribute_type, node.attribute_name = kind, name
        return node

    def mix(self, share, first, second):
        node = self.node("ShaderNodeMix")
        node.data_type = "VECTOR"
        for value, socket in ((share, node.inputs[0]), (first, node.inputs[4]), (second, node.inputs[5])):
            self.group.links.new(value, socket)
        return node.outputs[1]

    def math(self, operation: str, a, b):
        return self._operate(self.node("ShaderNodeMath"), operation, a, b)

    def image(self, image, place):
        node = self.node("ShaderNodeTexImage")
        node.image, node.interpolation, node.extension = image, "Linear", "EXTEND"
        self.group.links.new(place, node.inputs["Vector"])
        return node.outputs["Color"]

    def vector(self, operation: str, a, b):
        return self._operate(self.node("ShaderNodeVectorMath"), operation, a, b)

    def _operate(self, node, operation, a, b):
        node.operation = operation
        for socket, value in zip(node.inputs, (a, b), strict=False):
            if isinstance(value, bpy.types.NodeSocket):
                self.group.links.new(value, socket)
            else:
                socket.default_value = value
        return node.outputs[0]
