"""Maps over the atlas of materials that vary over a surface, by Cycles' own bake.

Everything is done on copies in a scene of its own: objects, meshes, materials and render settings of
the user are not touched at all, and the copies are removed whatever happens.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace

import bpy
import numpy as np

from ..core.scene import Scene
from . import cycles, materials
from .meshes import LAYER
from .pixels import read_pixels
from .snapshot import read_layer, rectangle, write_layer
from .trees import heeds_nodes, source
from .unfolded import Unfolded
from .visibility import rendered_objects

DILATION = 2  # texels that colours spread past a chart, so that filtering at its edge reads them
SWATCH = 16  # texels a side of the square that gives a material's mean where it has no texels
MEAN_SAMPLES = 1 << 16  # points at which a map is read for its mean


def bake_maps(
    context, scene: Scene, used, sources, looks, wanted: set[str], resolution: int, atlas: Unfolded | None
) -> None:
    """Bake the wanted maps ("albedo", "emission", "transmission") into `scene` and set mapped materials' means.

    Arguments as of `materials.read_materials`; looks: `materials.Look` for each material.
    """
    varying = np.array([look.varies for look in looks])
    triangles = varying[scene.triangle_material]
    placed = triangles & np.isfinite(scene.atlas_uv).all(axis=(1, 2))
    own = rendered_objects(context.view_layer)
    targets = list(dict.fromkeys(sources[k] for k in np.unique(scene.triangle_object[placed]) if sources[k] in own))
    unplaced = [
        k for k in np.unique(scene.triangle_material[triangles]) if not (placed & (scene.triangle_material == k)).any()
    ]
    with _Studio(context) as studio:
        objects = [studio.add(obj, atlas) for obj in targets]
        swatches = [studio.add_swatch(used[k]) for k in unplaced]
        for kind in ("albedo", "emission", "transmission"):
            if kind not in wanted:
                continue
            image = studio.bake(objects, kind, resolution, scene.warnings)
            setattr(scene, f"{kind}_map", image)
            for k, mean in _means(scene, image, placed).items():
                _set(scene, k, kind, mean)
            for k, swatch in zip(unplaced, swatches, strict=True):
                mean = studio.bake([swatch], kind, SWATCH, scene.warnings).reshape(-1, 3).mean(axis=0)
                _set(scene, k, kind, mean)
    for k in unplaced:
        owner = scene.objects[scene.triangle_object[np.argmax(scene.triangle_material == k)]].name
        scene.warnings.append(f"'{owner}' has no texels, so material '{used[k].name}' is taken as its mean there.")


def means(context, material: bpy.types.Material, kinds: list[str], warnings: list[str]) -> dict[str, np.ndarray]:
    """(3,) mean of each of the kinds over a square with the material on it."""
    with _Studio(context) as studio:
        swatch = studio.add_swatch(material)
        return {kind: studio.bake([swatch], kind, SWATCH, warnings).reshape(-1, 3).mean(axis=0) for kind in kinds}


def _set(scene, index, kind, value) -> None:
    changed = list(scene.materials)
    changed[index] = replace(changed[index], **{kind: tuple(float(v) for v in value)})
    scene.materials = tuple(changed)


def _means(scene, image, placed) -> dict[int, np.ndarray]:
    """Mean of the map by area for each material on the placed triangles."""
    if not placed.any():
        return {}
    area = np.linalg.norm(scene.triangle_cross(placed), axis=1).cumsum()
    strata = (np.arange(MEAN_SAMPLES) + 0.5) / MEAN_SAMPLES
    chosen = np.minimum(np.searchsorted(area, strata * area[-1]), len(area) - 1)
    # the plastic number's sequence spreads points evenly over the triangles that have many
    u, v = (np.arange(MEAN_SAMPLES) * step % 1.0 for step in (0.7548776662466927, 0.5698402909980532))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    weights = np.stack([1 - u - v, u, v], axis=1)
    uv = np.einsum("pc,pcd->pd", weights, scene.atlas_uv[placed][chosen])
    size = np.array(image.shape[1::-1])
    x, y = np.clip((uv * size).astype(np.int64), 0, size - 1).T
    index = scene.triangle_material[placed][chosen]
    total = np.bincount(index)
    sums = np.stack([np.bincount(index, image[y, x, c]) for c in range(3)], axis=1)
    return {int(k): sums[k] / total[k] for k in np.flatnonzero(total > 0)}


class _Studio:
    """A scene with nothing but copies of what is baked; leaves nothing behind."""

    def __init__(self, context):
        self.context = context
        self.made: list[bpy.types.ID] = []
        self.copies: dict[bpy.types.Material | None, bpy.types.Material] = {}

    def __enter__(self):
        cycles.require("Textured materials need")
        self.scene = bpy.data.scenes.new("Lightpanes Maps")
        self.scene.render.engine = "CYCLES"
        self.scene.cycles.device = "CPU"
        self.scene.cycles.samples = 1
        self.scene.cycles.use_denoising = False
        self.scene.render.bake.margin = DILATION
        self.scene.render.bake.margin_type = "EXTEND"
        self.scene.render.bake.use_selected_to_active = False
        self.scene.frame_set(self.context.scene.frame_current)
        self.made.append(self.scene)
        return self

    def __exit__(self, *_):
        bpy.data.batch_remove(self.made)

    def add(self, obj, atlas) -> bpy.types.Object:
        """A copy of the object whose UV layer is in the atlas, with copies of its materials."""
        mesh = obj.data.copy()
        copy = obj.copy()
        self.made += [mesh, copy]
        copy.data = mesh
        copy.hide_render = copy.hide_viewport = False
        uv, place = (read_layer(mesh), obj) if atlas is None else (atlas.layer(obj), atlas.place(obj))
        scale, offset = rectangle(place)
        write_layer(mesh, uv * scale + offset)
        override = self.context.view_layer.material_override
        if not mesh.materials:
            mesh.materials.append(None)
        for slot, before in zip(copy.material_slots, obj.material_slots or [None], strict=False):
            slot.link = "OBJECT"
            slot.material = self.copy_of(override or (before.material if before else None))
        self.scene.collection.objects.link(copy)
        return copy

    def add_swatch(self, material) -> bpy.types.Object:
        """A square of 2 m in the object's own space with the material on it."""
        mesh = bpy.data.meshes.new("Lightpanes Swatch")
        obj = bpy.data.objects.new("Lightpanes Swatch", mesh)
        self.made += [mesh, obj]
        mesh.from_pydata([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [], [(0, 1, 2, 3)])
        for name in ("UVMap", LAYER):
            mesh.uv_layers.new(name=name).uv.foreach_set("vector", np.array([0, 0, 1, 0, 1, 1, 0, 1], np.float32))
        mesh.uv_layers["UVMap"].active_render = True
        mesh.materials.append(self.copy_of(material))
        self.scene.collection.objects.link(obj)
        return obj

    def copy_of(self, material) -> bpy.types.Material:
        if material not in self.copies:
            copy = material.copy() if material is not None else bpy.data.materials.new("Lightpanes Empty")
            self.made.append(copy)
            if not heeds_nodes(copy):
                colour = tuple(copy.diffuse_color)
                copy.use_nodes = True
                for node in copy.node_tree.nodes:
                    if node.type == "BSDF_PRINCIPLED":
                        node.inputs["Base Color"].default_value = colour
                        node.inputs["Specular IOR Level"].default_value = 0.0
            for node in list(copy.node_tree.nodes):
                if "lightpanes" in node:
                    copy.node_tree.nodes.remove(node)
                elif node.type == "BSDF_PRINCIPLED":
                    _count_gloss(copy.node_tree, node)
            self.copies[material] = copy
        return self.copies[material]

    def bake(self, objects, kind, resolution, warnings) -> np.ndarray:
        """(resolution, resolution, 3) float32, row 0 at v = 0; black where nothing was baked."""
        pixels = np.zeros((resolution, resolution, 4), np.float32)
        if not objects:
            return pixels[..., :3].copy()
        image = bpy.data.images.new("Lightpanes Map", resolution, resolution, alpha=True, float_buffer=True)
        image.colorspace_settings.name = "Non-Color"
        image.pixels.foreach_set(pixels.ravel())
        try:
            with self._aimed_at(image, kind):
                self._run(objects, kind, warnings)
            found = read_pixels(image)
        finally:
            bpy.data.images.remove(image)
        found = np.where(np.isfinite(found), found, 0.0)
        if kind != "emission":
            np.clip(found, 0.0, 1.0, out=found)
        return np.ascontiguousarray(found[..., :3], np.float32)

    def _run(self, objects, kind, warnings) -> None:
        options = {"type": "DIFFUSE", "pass_filter": {"COLOR"}} if kind == "albedo" else {"type": "EMIT"}
        options.update(
            target="IMAGE_TEXTURES",
            uv_layer=LAYER,
            use_clear=False,
            margin=DILATION,
            margin_type="EXTEND",
            save_mode="INTERNAL",
        )
        view_layer = self.scene.view_layers[0]
        for group in (objects, *([obj] for obj in objects)) if len(objects) > 1 else (objects,):
            override = {
                "scene": self.scene, "view_layer": view_layer, "active_object": group[0], "object": group[0], "selected_objects": group,
            }  # fmt: skip
            for obj in objects:
                obj.select_set(obj in group, view_layer=view_layer)
            view_layer.objects.active = group[0]
            try:
                with self.context.temp_override(**override):
                    bpy.ops.object.bake(**options)
            except RuntimeError as error:
                if len(group) == 1:
                    warnings.append(
                        f"'{group[0].name}': its {kind} could not be baked and is taken as constant ({str(error).strip()})."
                    )
                continue
            if len(group) == len(objects):
                return

    @contextmanager
    def _aimed_at(self, image, kind):
        """Every copied material bakes into the image, and emits what passes through it if that is wanted."""
        undo = []
        for copy in self.copies.values():
            tree = copy.node_tree
            if kind == "transmission":
                undo.append(_emit_transmission(tree))
            node = tree.nodes.new("ShaderNodeTexImage")
            node.image = image
            tree.nodes.active = node
            undo.append(lambda tree=tree, node=node: tree.nodes.remove(node))
        try:
            yield
        finally:
            for action in reversed(undo):
                action()


def _count_gloss(tree, node) -> None:
    """Let the diffuse colour count the light that the glossy lobe returns, see `materials`."""
    gloss = materials.principled_gloss(node)
    mix = tree.nodes.new("ShaderNodeMix")
    mix.data_type = "RGBA"
    mix.inputs[0].default_value = gloss
    first, second, out = mix.inputs[6], mix.inputs[7], mix.outputs[2]
    base = node.inputs["Base Color"]
    first.default_value = base.default_value
    second.default_value = (1, 1, 1, 1)
    if base.is_linked:
        tree.links.new(base.links[0].from_socket, first)
    tree.links.new(out, base)
    for name in ("Specular IOR Level", "Coat Weight", "Sheen Weight"):
        socket = node.inputs[name]
        for link in list(socket.links):
            tree.links.remove(link)
        socket.default_value = 0.0


def _emit_transmission(tree):
    """Make the tree emit the light that its surface lets pass; returns what undoes it."""
    output = tree.get_output_node("CYCLES")
    surface = output.inputs["Surface"] if output else None
    before = set(tree.nodes)
    if surface is None or not surface.is_linked:
        return lambda: None
    old = surface.links[0].from_socket
    emission = tree.nodes.new("ShaderNodeEmission")
    _connect(tree, _passing(tree, source(surface)), emission.inputs["Color"])
    tree.links.new(emission.outputs[0], surface)

    def undo():
        for node in set(tree.nodes) - before:
            tree.nodes.remove(node)
        tree.links.new(old, surface)

    return undo


def _connect(tree, value, socket) -> None:
    """Feed a socket with an output, or set it to a number or colour."""
    if isinstance(value, bpy.types.NodeSocket):
        tree.links.new(value, socket)
    elif socket.type == "RGBA":
        socket.default_value = (*np.broadcast_to(value, 3), 1.0)
    else:
        socket.default_value = value


def _input(node, name):
    socket = node.inputs[name]
    if socket.is_linked:
        return socket.links[0].from_socket
    return np.array(socket.default_value[:3]) if socket.type == "RGBA" else socket.default_value


def _blend(tree, share, first, second):
    mix = tree.nodes.new("ShaderNodeMix")
    mix.data_type = "RGBA"
    for value, socket in ((share, mix.inputs[0]), (first, mix.inputs[6]), (second, mix.inputs[7])):
        _connect(tree, value, socket)
    return mix.outputs[2]


def _passing(tree, node):
    """Colour that a shader lets pass, as a socket or a constant."""
    if node is None:
        return np.zeros(3)
    if node.type == "BSDF_PRINCIPLED":
        glass = _blend(tree, _input(node, "Transmission Weight"), np.zeros(3), _input(node, "Base Color"))
        glass = _blend(tree, _input(node, "Metallic"), glass, np.zeros(3))
        return _blend(tree, _input(node, "Alpha"), np.ones(3), glass)
    if node.type in {"BSDF_TRANSPARENT", "BSDF_GLASS", "BSDF_REFRACTION"}:
        return _input(node, "Color")
    if node.type == "MIX_SHADER":
        return _blend(tree, _input(node, 0), *(_passing(tree, source(node.inputs[k])) for k in (1, 2)))
    if node.type == "ADD_SHADER":
        total = tree.nodes.new("ShaderNodeMix")
        total.data_type, total.blend_type = "RGBA", "ADD"
        total.inputs[0].default_value = 1.0
        for k, socket in ((0, total.inputs[6]), (1, total.inputs[7])):
            _connect(tree, _passing(tree, source(node.inputs[k])), socket)
        return total.outputs[2]
    return np.zeros(3)
