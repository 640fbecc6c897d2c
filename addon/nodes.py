"""How baked light gets into materials: the `Lightpanes` node group behind a second Material Output.

The user's nodes and links stay as they are. Beside them stand a group node and a Material Output that only EEVEE
reads (and, when asked for, a pair that only Cycles reads), tagged `lightpanes`; without them the tree is what it was.
"""

from __future__ import annotations

import math

import bpy

from ..core.scene import Material, Scene
from . import claims, store, vertices
from .meshes import AT_VERTICES
from .trees import NO_NODES, heeds_nodes

GROUP = "Lightpanes"
UV_LAYER = "Lightpanes"
DEFAULT_MATERIAL = "Lightpanes Default"
NODE_TAG = "lightpanes"

_SLOT = "lightpanes_slot"
_SAMPLING = "lightpanes_sampling"
FORMER = "lightpanes_former"
_GROUP = "lightpanes_group"


def attach(context: bpy.types.Context, baked: Scene | None = None) -> list[str]:
    """Let the baked objects' materials show the scene's bake. Returns warnings, each naming its material or object.

    baked: what was baked; its materials give the albedo where a node tree does not show it plainly.
    """
    scene = context.scene
    detach(scene)
    warnings: list[str] = []
    albedos = {material.name: material for material in baked.materials} if baked is not None else {}
    group = _make_group(scene)
    for material in _materials(context, warnings):
        if material.library is not None or (material.node_tree is not None and material.node_tree.library is not None):
            warnings.append(
                f"Material '{material.name}' is linked from another file and can't show baked light; make it local."
            )
            continue
        _attach_material(material, group, albedos.get(material.name))
    show_in_cycles(scene)
    return warnings


def detach(scene: bpy.types.Scene) -> None:
    """Take the scene's light out of all materials and give the trees back as they were.

    The light of bakes that are in no scene of this file, which came with objects that were appended or which the user
    deleted, goes out of the materials of the scene's objects, too.
    """
    own = group_of(scene)
    others = {group_of(other) for other in bpy.data.scenes if other != scene}
    here, elsewhere = _seen_in([scene]), _seen_in(other for other in bpy.data.scenes if other != scene)
    shown = set()
    for material in list(bpy.data.materials):
        group = shown_by(material)
        if group is None or material.library is not None:
            continue
        if group in others:
            # of a copy of this scene, which may have materials of its own
            stays = group != own or material in elsewhere or material not in here
        else:
            stays = group != own and material in elsewhere - here
        if stays:
            shown.add(group)
        else:
            _detach_material(material)
    _restore_bounces(scene)
    _restore_caustics(scene)
    _remove_default_material()
    for group in list(bpy.data.node_groups):
        if group.get(store.TAG) == GROUP and group.library is None and group not in others | shown:
            bpy.data.node_groups.remove(group)
    store.sweep()


def show_in_cycles(scene: bpy.types.Scene) -> None:
    """Add or remove, as `scene.lightpanes.cycles` says, what shows the bake in Cycles.

    Cycles brings the first hit of sky and emissive faces itself, so of `Lightpanes Direct` only the lamps' light counts
    there, and its own diffuse bounces, which the bake replaces, are switched off; so are its caustics where the bake has
    some.
    """
    show = scene.lightpanes.cycles
    for material in bpy.data.materials:
        tree = material.node_tree
        if tree is None or material.library is not None:
            continue
        shown = _pair(tree, "EEVEE")
        if shown is None or shown[0].node_tree != group_of(scene):
            continue
        if show and _pair(tree, "CYCLES") is None:
            _add_pair(material, "CYCLES", shown[0].node_tree, shown[0])
            _stop_light_sampling(material)
        elif not show and _pair(tree, "CYCLES") is not None:
            _remove_pair(material, "CYCLES")
    cycles = getattr(scene, "cycles", None)
    if show and cycles is not None and scene.lightpanes.diffuse_bounces < 0:
        scene.lightpanes.diffuse_bounces = cycles.diffuse_bounces
        cycles.diffuse_bounces = 0
    elif not show:
        _restore_bounces(scene)
    if show and cycles is not None and store.find_image(scene, store.CAUSTICS) is not None:
        _stop_caustics(scene)
    else:
        _restore_caustics(scene)


def rebuild(scene: bpy.types.Scene) -> None:
    """Make the scene's group anew, in place, after images were added to the bake or taken from it."""
    group = group_of(scene)
    if group is not None:
        group.nodes.clear()
        _fill_group(scene, group)


def shows(item: bpy.types.Object, scene: bpy.types.Scene) -> bool:
    """Whether all materials of an object show the scene's bake."""
    group = group_of(scene)
    pairs = [
        slot.material is not None and slot.material.node_tree is not None and _pair(slot.material.node_tree, "EEVEE")
        for slot in item.material_slots
    ]
    return bool(pairs) and all(pair and pair[0].node_tree == group for pair in pairs)


def _restore_bounces(scene):
    cycles = getattr(scene, "cycles", None)
    if cycles is not None and scene.lightpanes.diffuse_bounces >= 0:
        cycles.diffuse_bounces = scene.lightpanes.diffuse_bounces
    scene.lightpanes.diffuse_bounces = -1


def _stop_caustics(scene):
    settings, cycles = scene.lightpanes, scene.cycles
    if settings.cycles_caustics < 0:
        settings.cycles_caustics = cycles.caustics_reflective + 2 * cycles.caustics_refractive
        cycles.caustics_reflective = cycles.caustics_refractive = False


def _restore_caustics(scene):
    former, cycles = scene.lightpanes.cycles_caustics, getattr(scene, "cycles", None)
    if cycles is not None and former >= 0:
        cycles.caustics_reflective, cycles.caustics_refractive = bool(former & 1), bool(former & 2)
    scene.lightpanes.cycles_caustics = -1


def group_of(scene: bpy.types.Scene) -> bpy.types.NodeTree | None:
    """The group that shows the scene's bake."""
    entries = store.find_entries(scene)
    return None if entries is None else entries.data.get(_GROUP)


def shown_by(material: bpy.types.Material) -> bpy.types.NodeTree | None:
    """The group of ours that a material shows light by."""
    nodes = material.node_tree.nodes if material.node_tree is not None else ()
    return next((group for node in nodes if _is_ours(node) and (group := getattr(node, "node_tree", None))), None)


def _seen_in(scenes) -> set[bpy.types.Material]:
    """Materials in the slots of the scenes' baked objects."""
    objects = (item for scene in scenes for item in claims.baked_objects(scene))
    return {slot.material for item in objects for slot in item.material_slots if slot.material is not None}


def _is_ours(node) -> bool:
    return NODE_TAG in node


def _materials(context, warnings) -> list[bpy.types.Material]:
    """Materials on baked objects, those set by geometry nodes included; empty slots get a default material."""
    depsgraph = context.evaluated_depsgraph_get()
    found: dict[bpy.types.Material, None] = {}
    for item in sorted(claims.baked_objects(context.scene), key=lambda item: item.name):
        _fill_slots(item, warnings)
        slots = [*item.material_slots, *item.evaluated_get(depsgraph).material_slots]
        for slot in slots:
            if slot.material is not None:
                found[slot.material.original] = None
    return list(found)


def _fill_slots(item, warnings):
    """Objects without a material look like Blender's default material; give them one that can show light."""
    data = item.data
    if data is None or not hasattr(data, "materials"):
        return
    if all(slot.material is not None for slot in item.material_slots) and item.material_slots:
        return
    if data.library is not None or item.library is not None:
        warnings.append(f"'{item.name}' has no material and is linked from another file, so it can't show baked light.")
        return
    default = next(iter(_default_materials()), None)
    if default is None:
        default = bpy.data.materials.new(DEFAULT_MATERIAL)
        default[store.TAG] = DEFAULT_MATERIAL
        if default.node_tree is None:
            default.use_nodes = True
    if not item.material_slots:
        data.materials.append(default)
        data[_SLOT] = 1
    for slot in item.material_slots:
        if slot.material is None:
            slot.material = default


def _default_materials() -> list[bpy.types.Material]:
    return [m for m in bpy.data.materials if m.get(store.TAG) == DEFAULT_MATERIAL and m.library is None]


def _remove_default_material():
    for default in _default_materials():
        if default.node_tree is not None and any(_is_ours(node) for node in default.node_tree.nodes):
            continue  # another scene still shows its bake on it
        for item in bpy.data.objects:
            for index, slot in reversed(list(enumerate(item.material_slots))):
                if slot.material == default:
                    _empty_slot(item, index)
        bpy.data.materials.remove(default)


def _empty_slot(item, index):
    """Take our material out of a slot, and the slot away where it was ours too."""
    item.material_slots[index].material = None
    if _SLOT not in item.data:
        return
    del item.data[_SLOT]
    item.active_material_index = index
    # Popping it from the data leaves the objects' own count of slots behind.
    with bpy.context.temp_override(object=item, active_object=item):
        bpy.ops.object.material_slot_remove()


def _attach_material(material, group, baked: Material | None):
    if material.node_tree is not None and _pair(material.node_tree, "EEVEE") is not None:
        _detach_material(material)  # another scene's: the last bake shows
    if not heeds_nodes(material):
        _use_nodes(material)
    color, value, mapped = _albedo(material.node_tree, baked)
    node = _add_pair(material, "EEVEE", group, None)
    node.inputs["Direct"].default_value = 1.0
    node.inputs["Albedo Map"].default_value = float(mapped)
    node.inputs["Albedo"].default_value = (*value, 1.0)
    if color is not None:
        material.node_tree.links.new(color, node.inputs["Albedo"])
        node.inputs["Tint"].default_value = (*value, 1.0)


def _use_nodes(material):
    """Nodes for a material that has none: what it looks like stays, as far as Blender's own conversion goes."""
    color = tuple(material.diffuse_color)
    fresh = material.node_tree is None or not material.node_tree.nodes
    material.use_nodes = True
    material[NO_NODES] = 1
    if fresh:
        shader = next((n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED"), None)
        if shader is not None:
            shader.inputs["Base Color"].default_value = color
            shader.inputs["Metallic"].default_value = material.metallic
            shader.inputs["Roughness"].default_value = material.roughness


def _albedo(tree, baked: Material | None):
    """(socket or None, constant (3,), read from `Lightpanes Albedo`) of the surface that EEVEE shows.

    With a socket the albedo is the socket's colour times the constant.
    """
    output = tree.get_output_node("EEVEE")
    links = output.inputs["Surface"].links if output is not None else ()
    shader = links[0].from_node if links else None
    color = factor = None
    if shader is not None and shader.type == "BSDF_PRINCIPLED":
        parts = [shader.inputs[name] for name in ("Metallic", "Transmission Weight", "Alpha")]
        if not any(part.is_linked for part in parts):
            metallic, transmission, alpha = (part.default_value for part in parts)
            color, factor = shader.inputs["Base Color"], (1 - metallic) * (1 - transmission) * alpha
    elif shader is not None and shader.type == "BSDF_DIFFUSE":
        color, factor = shader.inputs["Color"], 1.0
    if color is not None and color.is_linked:
        return color.links[0].from_socket, (factor,) * 3, False
    if color is not None:
        return None, tuple(factor * c for c in color.default_value[:3]), False
    if baked is not None and not baked.mapped:
        return None, tuple(baked.albedo), False
    return None, tuple(baked.albedo) if baked is not None else (0.8,) * 3, True


def _pair(tree, target: str):
    """(group node, output node) of ours for this engine, or None."""
    for output in tree.nodes:
        if _is_ours(output) and output.type == "OUTPUT_MATERIAL" and output.target == target:
            for link in output.inputs["Surface"].links:
                if _is_ours(link.from_node) and getattr(link.from_node, "node_tree", None) is not None:
                    return link.from_node, output
    return None


def _add_pair(material, target: str, group, like):
    """Our group node and output for an engine; `like`: a group node whose albedo the new one takes."""
    tree = material.node_tree
    active = tree.nodes.active
    former = tree.get_output_node(target)
    node, output = tree.nodes.new("ShaderNodeGroup"), tree.nodes.new("ShaderNodeOutputMaterial")
    for each in (node, output):
        each[NODE_TAG] = 1
        each.select = False
    node.node_tree = group
    output.target = target
    output.label = GROUP
    if former is not None:
        output[FORMER] = former.name
        drop = 180 if target == "EEVEE" else 340
        node.location = (former.location.x, former.location.y - drop)
        output.location = (former.location.x + 200, former.location.y - drop)
        for socket in former.inputs:
            if socket.is_linked and socket.name in output.inputs:
                entrance = node.inputs["Shader"] if socket.name == "Surface" else output.inputs[socket.name]
                tree.links.new(socket.links[0].from_socket, entrance)
    if like is not None:
        for name in ("Albedo", "Tint", "Albedo Map"):
            node.inputs[name].default_value = like.inputs[name].default_value
            if like.inputs[name].is_linked:
                tree.links.new(like.inputs[name].links[0].from_socket, node.inputs[name])
    tree.links.new(node.outputs["Shader"], output.inputs["Surface"])
    tree.nodes.active = active  # an output that becomes the active node would become the active output, too
    output.is_active_output = True
    return node


def _remove_pair(material, target: str):
    tree = material.node_tree
    pair = _pair(tree, target)
    if pair is None:
        return
    node, output = pair
    former = tree.nodes.get(output.get(FORMER, ""))
    if _SAMPLING in node and hasattr(material, "cycles"):
        material.cycles.emission_sampling = node[_SAMPLING]
    tree.nodes.remove(output)
    tree.nodes.remove(node)
    if former is not None:
        former.is_active_output = True


def _detach_material(material):
    for target in ("CYCLES", "EEVEE"):
        _remove_pair(material, target)
    for node in [node for node in material.node_tree.nodes if _is_ours(node)]:
        material.node_tree.nodes.remove(node)
    if NO_NODES in material:
        del material[NO_NODES]
        material.use_nodes = False


def _stop_light_sampling(material):
    """Our emission only shows light; without this Cycles would take every baked face for a lamp and waste rays on it."""
    node = _pair(material.node_tree, "CYCLES")[0]
    settings = getattr(material, "cycles", None)
    if settings is None or _emits(material.node_tree):
        return
    node[_SAMPLING] = settings.emission_sampling
    settings.emission_sampling = "NONE"


def _emits(tree) -> bool:
    for node in tree.nodes:
        if node.type == "EMISSION" or (node.type == "GROUP" and not _is_ours(node)):
            return True
        if node.type == "BSDF_PRINCIPLED":
            strength = node.inputs["Emission Strength"]
            if strength.is_linked or strength.default_value > 0:
                return True
    return False


def _make_group(scene) -> bpy.types.NodeTree:
    group = bpy.data.node_groups.new(GROUP, "ShaderNodeTree")
    group[store.TAG] = GROUP
    store.find_entries(scene).data[_GROUP] = group
    sockets = group.interface
    sockets.new_socket("Shader", in_out="INPUT", socket_type="NodeSocketShader")
    for name in ("Albedo", "Tint"):
        sockets.new_socket(name, in_out="INPUT", socket_type="NodeSocketColor").default_value = (1, 1, 1, 1)
    for name in ("Albedo Map", "Direct"):
        sockets.new_socket(name, in_out="INPUT", socket_type="NodeSocketFloat").default_value = 0.0
    sockets.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    _fill_group(scene, group)
    return group


def _fill_group(scene, group):
    """Shader + albedo × (irradiance + direct + caustics) / π as emission, on baked objects, seen by the camera or in mirrors.

    The input Direct is 0 in engines that bring the first hit of sky and emissive faces themselves.
    """
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

    emission, add = build.node("ShaderNodeEmission"), build.node("ShaderNodeAddShader")
    group.links.new(radiance, emission.inputs["Color"])
    group.links.new(strength, emission.inputs["Strength"])
    group.links.new(entrance.outputs["Shader"], add.inputs[0])
    group.links.new(emission.outputs[0], add.inputs[1])
    group.links.new(add.outputs[0], end.inputs["Shader"])


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
