"""An atlas in the scene: our UV layer on meshes, and the objects' places in it; as it is, or as it is to be.

Objects and meshes are named by the numbers that they keep in a session, since undo and deletion make references to them
invalid.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import bpy
import numpy as np

from .meshes import AT_VERTICES, BAKE, LAYER, read_attribute

# Custom properties of objects that say where in the atlas they are.
PLACE = ("lightpanes_scale", "lightpanes_offset", "lightpanes_baked", AT_VERTICES, BAKE)


@dataclass
class Snapshot:
    """places: of objects, what they have of PLACE. layers: of meshes, the coordinates (L, 2) float32 of our UV layer, None
    where they have none, and the number of their corners. meshes: which one an object has."""

    places: dict[int, dict[str, float | list[float]]] = field(default_factory=dict)
    layers: dict[int, tuple[np.ndarray | None, int]] = field(default_factory=dict)
    meshes: dict[int, int] = field(default_factory=dict)

    @classmethod
    def of(cls, scene: bpy.types.Scene, objects: Iterable[bpy.types.Object]) -> Snapshot:
        """The layers of the objects' meshes, and the places of all objects of the scene, as they are."""
        taken = cls()
        for item in scene.objects:
            if item.library is None:
                taken.places[item.session_uid] = {
                    name: (list(v) if hasattr(v := item[name], "to_list") else v) for name in PLACE if name in item
                }
        for item in objects:
            taken.hold(item)
        return taken

    def hold(self, item: bpy.types.Object) -> None:
        """Note the object's mesh and its layer as it is."""
        data = item.data
        self.meshes[item.session_uid] = data.session_uid
        if data.library is None and data.session_uid not in self.layers:
            self.layers[data.session_uid] = read_layer(data), len(data.loops)

    def layer(self, data: bpy.types.Mesh) -> np.ndarray | None:
        """Our coordinates (L, 2) on the mesh, None where it has none or other corners."""
        uv, loops = self.layers.get(data.session_uid, (None, -1))
        return uv if loops == len(data.loops) else None

    def edited(self) -> str:
        """What has another mesh, or a mesh with other corners, than when this was taken: a sentence's begin; else ""."""
        for item in bpy.data.objects:
            held = self.meshes.get(item.session_uid)
            if held is not None and (item.type != "MESH" or item.data.session_uid != held):
                return f"'{item.name}' has another mesh than when the bake began"
        for data in bpy.data.meshes:
            if data.session_uid in self.layers and len(data.loops) != self.layers[data.session_uid][1]:
                return f"Mesh '{data.name}' was edited while the bake ran"
        return ""

    def restore(self) -> None:
        """Make the scene like this, as far as what is held is still there. No mesh may be in Edit Mode."""
        for data in bpy.data.meshes:
            uv, loops = self.layers.get(data.session_uid, (None, -1))
            if uv is not None and loops == len(data.loops):
                write_layer(data, uv)
            elif uv is None and loops >= 0:
                remove_layer(data)
        for item in bpy.data.objects:
            values = self.places.get(item.session_uid)
            if values is None:
                continue
            for name in PLACE:
                if name in values:
                    item[name] = values[name]
                elif name in item:
                    del item[name]


def rectangle(place: Mapping) -> tuple[np.ndarray, np.ndarray]:
    """Scale and offset, (2,) float32 each, that take UVs of an object with these properties into the atlas."""
    return (
        np.array(place.get("lightpanes_scale", (1.0, 1.0)), np.float32),
        np.array(place.get("lightpanes_offset", (0.0, 0.0)), np.float32),
    )


def read_layer(data: bpy.types.Mesh) -> np.ndarray | None:
    """(L, 2) float32 of our UV layer, None where the mesh has none."""
    if LAYER not in data.uv_layers:
        return None
    return read_attribute(data, LAYER, len(data.loops), 2, "vector", np.float32)


def write_layer(data: bpy.types.Mesh, uv: np.ndarray) -> None:
    """Give the mesh our UV layer with these coordinates, (L, 2); the user's active ones stay active."""
    layers = data.uv_layers
    layer = layers.get(LAYER)
    if layer is None:
        active = layers.active.name if layers.active else None
        render = next((other.name for other in layers if other.active_render), None)
        layers.new(name=LAYER, do_init=False)
        if active is not None:
            layers.active = layers[active]
            layers[render].active_render = True
        layer = layers[LAYER]
    layer.uv.foreach_set("vector", np.ascontiguousarray(uv, np.float32).ravel())
    data.update()


def remove_layer(data: bpy.types.Mesh) -> None:
    """Take our UV layer off; the user's active ones stay active."""
    layers = data.uv_layers
    layer = layers.get(LAYER)
    if layer is None:
        return
    active = layers.active.name if layers.active else None
    render = next((other.name for other in layers if other.active_render), None)
    layers.remove(layer)
    if active in layers:
        layers.active = layers[active]
    if render in layers:
        layers[render].active_render = True
