"""Blender meshes as arrays, without a loop over faces."""

from __future__ import annotations

from dataclasses import dataclass, field

import bpy
import numpy as np

LAYER = "Lightpanes"
# On objects that are lit at their vertices, 1.0: shaders read it.
AT_VERTICES = "lightpanes_vertices"
# On baked objects: the key of the bake whose light they show.
BAKE = "lightpanes_bake"
FARTHEST = 1e15  # m


def in_edit_mode() -> bool:
    """Whether any mesh is in Edit Mode, where it holds no attributes. Of any scene: collections that are instanced need
    not be in the one that is looked at."""
    return any(mesh.is_editmode for mesh in bpy.data.meshes)


@dataclass
class Faces:
    """The triangles of one evaluated mesh in its own space; shared by all its instances.

    positions (V, 3) float32; triangles (T, 3) int32; normals (T, 3, 3) float32; flat (T,) bool;
    loops (T, 3) int32 of the mesh, which has so many corners; slots (T,) int32 material slot; uv (T, 3, 2) float32 or
    None where the layer is missing. layers: all UV layers (T, 3, 2) by name, where they were asked for; the one that
    renders by "", too.
    """

    positions: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray
    flat: np.ndarray
    loops: np.ndarray
    slots: np.ndarray
    uv: np.ndarray | None
    corners: int
    layers: dict[str, np.ndarray] = field(default_factory=dict)


def weight_of(obj: bpy.types.Object) -> float:
    """Texel density of the object relative to the others."""
    return float(getattr(getattr(obj, "lightpanes", None), "weight", 1.0))


def read_faces(mesh, layers: bool = False) -> Faces | None:
    """The mesh's triangles, None where it has none. layers: read all UV layers."""
    if not len(mesh.polygons):
        return None
    mesh.calc_loop_triangles()
    count = len(mesh.loop_triangles)
    if not count:
        return None
    corners = np.empty(count * 3, np.int32)
    mesh.loop_triangles.foreach_get("loops", corners)
    polygons = np.empty(count, np.int32)
    mesh.loop_triangles.foreach_get("polygon_index", polygons)
    positions = read_attribute(mesh, "position", len(mesh.vertices), 3, "vector", np.float32)
    vertices = read_attribute(mesh, ".corner_vert", len(mesh.loops), 1, "value", np.int32)
    normals = np.empty(len(mesh.loops) * 3, np.float32)
    mesh.corner_normals.foreach_get("vector", normals)
    slots = np.zeros(len(mesh.polygons), np.int32)
    if "material_index" in mesh.attributes:
        mesh.attributes["material_index"].data.foreach_get("value", slots)
    flat = np.zeros(len(mesh.polygons), bool)
    sharp = mesh.attributes.get("sharp_face")
    if sharp is not None and sharp.domain == "FACE":
        sharp.data.foreach_get("value", flat)
    layer = mesh.uv_layers.get(LAYER)
    uv = None
    if layer is not None:
        uv = read_attribute(mesh, LAYER, len(mesh.loops), 2, "vector", np.float32)[corners].reshape(-1, 3, 2)
    return Faces(
        positions,
        vertices[corners].reshape(-1, 3),
        normals.reshape(-1, 3)[corners].reshape(-1, 3, 3),
        flat[polygons],
        corners.reshape(-1, 3),
        slots[polygons],
        uv,
        len(mesh.loops),
        _read_layers(mesh, corners) if layers else {},
    )


def _read_layers(mesh, corners) -> dict[str, np.ndarray]:
    found = {}
    for layer in mesh.uv_layers:
        uv = read_attribute(mesh, layer.name, len(mesh.loops), 2, "vector", np.float32)
        found[layer.name] = uv[corners].reshape(-1, 3, 2)
        if layer.active_render:
            found[""] = found[layer.name]
    return found


def read_attribute(mesh, name: str, count: int, width: int, field: str, dtype) -> np.ndarray:
    """A mesh attribute as an array (count,) or (count, width)."""
    values = np.empty(count * width, dtype)
    mesh.attributes[name].data.foreach_get(field, values)
    return values.reshape(count, width) if width > 1 else values


def loop_triangles(mesh: bpy.types.Mesh) -> np.ndarray:
    """(T, 3) int32 loops of the mesh's triangles."""
    mesh.calc_loop_triangles()
    loops = np.empty(len(mesh.loop_triangles) * 3, np.int32)
    mesh.loop_triangles.foreach_get("loops", loops)
    return loops.reshape(-1, 3)


def are_numbers(values: np.ndarray) -> bool:
    """Whether all are finite and small enough to compute with: Blender stores infinity as its largest float."""
    return bool((np.abs(values) < FARTHEST).all())
