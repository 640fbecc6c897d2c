"""Light at the vertices of objects that take no texture: the colour attribute `lightpanes_irradiance` of their meshes.

Beside it stands a hidden attribute that says where each vertex, or each corner of a face, finds its light among the
bake's places, so that a relight needs no more than one look-up, in a reopened file too.
"""

from __future__ import annotations

from collections.abc import Iterable

import bpy
import numpy as np

from ..core.scene import Scene
from ..core.surface import make_vertices
from . import atlas, claims, refusals, visibility
from .meshes import AT_VERTICES, read_attribute
from .snapshot import remove_layer

LIGHT = "lightpanes_irradiance"
# Number of the place plus one, 0 for none. Blender's interface does not list names that begin with a dot.
PLACE = ".lightpanes_place"
# On meshes whose attributes of these names are ours to write and to delete.
OURS = "lightpanes_vertex_light"


def choose(context: bpy.types.Context, objects: Iterable[bpy.types.Object]) -> tuple[list[bpy.types.Object], list[str]]:
    """Those of the objects that ask for light at their vertices and can have it, and a warning for each that can't."""
    receivers = atlas.receivers(context, objects, [])
    asking = [item for item in receivers if item.lightpanes.target == "VERTICES"]
    reshaped = _reshaped(context, [item for item in asking if item.modifiers])
    users: dict[bpy.types.Mesh, list[bpy.types.Object]] = {}
    for item in receivers:
        users.setdefault(item.data, []).append(item)
    chosen, warnings = [], []
    for item in asking:
        other = next((each for each in users[item.data] if each != item), None)
        if other is not None:
            warnings.append(refusals.shares_mesh(item, other))
        elif LIGHT in item.data.attributes and OURS not in item.data:
            warnings.append(refusals.has_own_light(item, LIGHT))
        elif item in reshaped:
            warnings.append(refusals.reshaped(item))
        else:
            chosen.append(item)
    return chosen, warnings


def _reshaped(context, objects) -> set[bpy.types.Object]:
    """Objects whose modifiers leave other vertices or faces than their mesh has."""
    if not objects:
        return set()
    with visibility.as_rendered(context) as depsgraph:
        return {item for item in objects if not _same_faces(item.data, item.evaluated_get(depsgraph).data)}


def _same_faces(mesh, evaluated) -> bool:
    counts = [(len(m.vertices), len(m.loops), len(m.polygons)) for m in (mesh, evaluated)]
    if counts[0] != counts[1]:
        return False
    first, second = (read_attribute(m, ".corner_vert", len(m.loops), 1, "value", np.int32) for m in (mesh, evaluated))
    return np.array_equal(first, second)


def keep(context: bpy.types.Context, surfaces: Scene, loops: dict[str, np.ndarray]) -> None:
    """Make the attributes of all objects of the bake that are lit at their vertices, and take those of others away.

    surfaces: what was baked; loops: of its triangles, from `extract.extract`.
    """
    scene = context.scene
    drop()
    found = make_vertices(surfaces)
    owner = surfaces.triangle_object[found.triangle]
    textured = {item.data for item in bpy.data.objects if "lightpanes_scale" in item}
    for index, part in enumerate(surfaces.objects):
        if part.at_vertices:
            item = scene.objects.get(part.name)
            # deleted, or turned into something else, while the bake ran
            if item is None or item.type != "MESH":
                continue
            mesh = item.data
            first, last = np.searchsorted(owner, [index, index + 1])
            _make_attributes(mesh, loops[part.name], found.corner[first:last])
            # from a bake that gave it a place in the atlas
            if mesh not in textured:
                remove_layer(mesh)


def _make_attributes(mesh, loops, place) -> None:
    if OURS in mesh:
        _remove_attributes(mesh)
    vertex = read_attribute(mesh, ".corner_vert", len(mesh.loops), 1, "value", np.int32)
    at_corner, at_vertex = np.zeros(len(mesh.loops), np.int32), np.zeros(len(mesh.vertices), np.int32)
    at_corner[loops] = place + 1
    at_vertex[vertex[loops]] = place + 1
    # corners of faces without area, which the bake leaves out, show what another corner of their vertex does
    at_corner = np.where(at_corner > 0, at_corner, at_vertex[vertex])
    smooth = np.array_equal(at_corner, at_vertex[vertex])
    domain, places = ("POINT", at_vertex) if smooth else ("CORNER", at_corner)
    colors = mesh.color_attributes
    active, default = colors.active_color_name, colors.default_color_name
    mesh.attributes.new(PLACE, "INT", domain).data.foreach_set("value", places)
    mesh.attributes.new(LIGHT, "FLOAT_COLOR", domain)
    _set_active(colors, active, default)
    mesh[OURS] = 1


def _set_active(colors, active, default) -> None:
    colors.active_color_name, colors.default_color_name = active, default


def lit(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The scene's objects that its bake lights at their vertices."""
    found = [item for item in scene.objects if AT_VERTICES in item and item.type == "MESH" and OURS in item.data]
    return [item for item in found if claims.belongs(item, scene)]


def show(scene: bpy.types.Scene, values: np.ndarray) -> list[str]:
    """Write the light of the bake's places, (v, 3) float32, to the meshes that are not in Edit Mode; returns what to tell
    the user."""
    if not len(values):
        return []
    # the first row is for vertices that the bake does not know
    table = np.zeros((len(values) + 1, 4), np.float32)
    table[1:, :3] = values
    table[:, 3] = 1
    told = []
    for item in lit(scene):
        if item.data.is_editmode:
            continue
        light, place = (item.data.attributes.get(name) for name in (LIGHT, PLACE))
        if light is None or place is None or (light.data_type, light.domain) != ("FLOAT_COLOR", place.domain):
            told.append(f"The attribute '{LIGHT}' of '{item.name}' has been deleted or converted; bake again.")
            continue
        index = np.empty(len(place.data), np.int32)
        if not len(index) or len(light.data) != len(index):
            continue
        place.data.foreach_get("value", index)
        index[(index < 0) | (index > len(values))] = 0
        light.data.foreach_set("color", table.take(index, axis=0).reshape(-1))
        item.data.update()
    return told


def drop() -> None:
    """Take our attributes off all meshes by which no object, of any scene, is lit any more."""
    kept = {item.data for item in bpy.data.objects if AT_VERTICES in item}
    for mesh in bpy.data.meshes:
        if OURS in mesh and mesh not in kept and mesh.library is None:
            _remove_attributes(mesh)


def _remove_attributes(mesh) -> None:
    colors = mesh.color_attributes
    active, default = colors.active_color_name, colors.default_color_name
    for name in (LIGHT, PLACE):
        attribute = mesh.attributes.get(name)
        if attribute is not None:
            mesh.attributes.remove(attribute)
    _set_active(colors, *("" if name == LIGHT else name for name in (active, default)))
    del mesh[OURS]
    mesh.update()
