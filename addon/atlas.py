"""One atlas for all objects that receive light: the UV layer `Lightpanes`, and each object's place in it.

Blender's Smart UV Project cuts the charts, on copies in a scene of its own, so that selection, mode
and every other UV layer stay as they are. Each chart then gets its true size in the world (the affine
map that best undoes the projection's stretch) and `packing` lays them out. Blender's own packer is not
used: it took 1 s to 90 s for three objects where shapes are concave, and filled less with boxes.
"""

from __future__ import annotations

from collections.abc import Collection, Generator, Iterable
from contextlib import contextmanager

import bpy
import numpy as np

from ..core.scene import SceneError
from . import refusals, visibility
from .charts import next_loop
from .layout import Unwrapped, lay_out
from .meshes import AT_VERTICES, LAYER, are_numbers, loop_triangles, read_attribute, weight_of
from .snapshot import Snapshot
from .unfolded import Unfolded
from .work import Work, run

ANGLE_LIMIT = np.radians(66.0)

TOGETHER, MANY_CORNERS = 32, 20_000
"""Meshes, and corners of their faces, that are unwrapped without a turn for Blender, about."""


def receivers(context: bpy.types.Context, objects: Iterable[bpy.types.Object], warnings: list[str]) -> list:
    """Those of the objects that can have a place in the atlas: meshes with faces that render, not excluded."""
    rendered = visibility.rendered_objects(context.view_layer)
    found, linked = [], []
    for obj in sorted(rendered.intersection(objects), key=lambda obj: obj.name):
        if obj.type != "MESH" or getattr(getattr(obj, "lightpanes", None), "exclude", False):
            continue
        if refusals.is_linked(obj):
            linked.append(obj)
        elif obj.data.is_editmode:
            raise SceneError(refusals.in_edit_mode(obj))
        elif obj.data.polygons:
            found.append(obj)
    if linked:
        warnings.append(refusals.linked(linked))
    return found


def make_atlas(
    context: bpy.types.Context,
    objects: Iterable[bpy.types.Object],
    resolution: int,
    at_vertices: Collection[bpy.types.Object] = (),
) -> list[str]:
    """All of `atlas_steps` at once, and the scene takes the atlas; returns warnings."""
    planned, warnings = run(atlas_steps(context, objects, resolution, at_vertices))
    unfolded = Unfolded(planned)
    warnings += unfolded.read(context, *(obj for obj in objects if obj.type == "MESH"))
    planned.restore()
    return warnings


def atlas_steps(
    context: bpy.types.Context,
    objects: Iterable[bpy.types.Object],
    resolution: int,
    at_vertices: Collection[bpy.types.Object] = (),
) -> Generator[float | Work, object, tuple[Snapshot, list[str]]]:
    """Plan for each of the objects that can receive light a place in one atlas of resolution² texels, object by object;
    yields the part that is done (see `work`) and returns the plan, whose `restore` makes it real, and warnings.

    It holds the UV layer `Lightpanes` of their meshes and the custom properties lightpanes_scale, _offset and _baked;
    every other object of the scene loses those. Objects that share a mesh share its layer and have a rectangle each;
    the others' charts are packed one by one. Those in at_vertices are marked as lit there and get neither layer nor
    place. Texels per metre are the same everywhere but for the objects' weights, and charts stay two texels apart.
    Changes nothing. Raises SceneError, naming the object and what to do.
    """
    warnings: list[str] = []
    objects = [obj for obj in receivers(context, objects, warnings) if obj not in at_vertices]
    if not objects and not at_vertices:
        raise SceneError("No object can receive light: add a mesh with faces that renders, or clear Exclude on one.")
    owners = _owners(objects)
    # all at once: whatever unwraps one mesh makes Blender evaluate the whole scene anew
    worlds = _worlds(context, objects)
    meshes: list[Unwrapped] = []
    waiting = list(owners.items())
    while waiting:
        yield 0.5 * len(meshes) / len(owners)
        some, waiting = _few(waiting)
        with _workbench() as bench:
            for data, users in some:
                meshes.append(_read(context, bench, data, users, [worlds[obj.name] for obj in users]))
    uvs, places = [], {}
    if meshes:
        uvs, places = yield Work(
            lambda progress: lay_out(meshes, resolution, warnings, lambda part: progress(0.5 + 0.5 * part))
        )
    planned = Snapshot()
    for obj in context.scene.objects:
        if "lightpanes_baked" in obj and obj.library is None:
            planned.places[obj.session_uid] = {}
    for (data, users), made, uv in zip(owners.items(), meshes, uvs, strict=True):
        planned.layers[data.session_uid] = np.ascontiguousarray(uv, np.float32), len(made.corners)
        for obj in users:
            scale, offset = places[obj.name]
            planned.meshes[obj.session_uid] = data.session_uid
            planned.places[obj.session_uid] = {
                "lightpanes_scale": list(scale), "lightpanes_offset": list(offset), "lightpanes_baked": 1.0
            }  # fmt: skip
    for obj in at_vertices:
        planned.hold(obj)
        planned.places[obj.session_uid] = {"lightpanes_baked": 1.0, AT_VERTICES: 1.0}
    return planned, warnings


def _owners(objects) -> dict[bpy.types.Mesh, list]:
    """Objects by the mesh that they have."""
    users: dict[bpy.types.Mesh, list] = {}
    for obj in objects:
        if refusals.has_no_layer_left(obj):
            raise SceneError(refusals.no_layer_left(obj))
        if refusals.has_foreign_attribute(obj):
            raise SceneError(refusals.foreign_attribute(obj))
        users.setdefault(obj.data, []).append(obj)
    return users


def _worlds(context, objects) -> dict[str, np.ndarray]:
    """(3, 3) float64 of each object, from its own space to the world's directions."""
    depsgraph = context.evaluated_depsgraph_get()
    return {obj.name: np.array(obj.evaluated_get(depsgraph).matrix_world, np.float64)[:3, :3] for obj in objects}


def _few(waiting: list[tuple[bpy.types.Mesh, list]]) -> tuple[list, list]:
    """Meshes that are unwrapped without a turn for Blender: a second's worth at most, and the rest."""
    corners, count = 0, 0
    while count < len(waiting) and count < TOGETHER and (not count or corners < MANY_CORNERS):
        corners += len(waiting[count][0].loops)
        count += 1
    return waiting[:count], waiting[count:]


def _read(context, bench, data, owners, worlds) -> Unwrapped:
    """A mesh's faces in the world space of the first of its owners, unwrapped. worlds: of the owners."""
    local = read_attribute(data, "position", len(data.vertices), 3, "vector", np.float32).astype(np.float64)
    corners = read_attribute(data, ".corner_vert", len(data.loops), 1, "value", np.int32)
    faces = np.empty(len(data.polygons), np.int32)
    data.polygons.foreach_get("loop_start", faces)
    weights = [max(weight_of(obj), 1e-6) for obj in owners]
    placed = [local @ world.T for world in worlds]
    for obj, positions in zip(owners, placed, strict=True):
        if not are_numbers(positions):
            raise SceneError(
                f"'{obj.name}' has vertices that are not numbers (NaN or infinite): repair or delete them, or hide the object from renders."
            )
    areas = np.array([_area(positions, corners, faces) for positions in placed]) * weights
    ratios = np.sqrt(areas / max(areas[0], 1e-30)) if areas[0] > 0 else np.ones(len(owners))
    names, positions = [obj.name for obj in owners], placed[0] * np.sqrt(weights[0])
    uv = _unwrap(context, bench, positions, corners, faces)
    return Unwrapped(names, np.maximum(ratios, 1e-6), positions, corners, faces, loop_triangles(data), uv)


def _area(positions, corners, faces) -> float:
    """Area of all polygons: Newell's vectors, exact for planar ones."""
    points = positions[corners]
    after = points[next_loop(faces, len(corners))]
    return float(np.linalg.norm(np.add.reduceat(np.cross(points, after), faces), axis=1).sum() / 2)


@contextmanager
def _workbench():
    """A scene of its own with an object of an empty mesh; removed at the end.

    To make and to remove things costs Blender a look at all that there are: one workbench serves many meshes.
    """
    scene = bpy.data.scenes.new("Lightpanes Atlas")
    copy = bpy.data.meshes.new("Lightpanes Atlas")
    obj = bpy.data.objects.new("Lightpanes Atlas", copy)
    try:
        scene.collection.objects.link(obj)
        view_layer = scene.view_layers[0]
        obj.select_set(True, view_layer=view_layer)
        view_layer.objects.active = obj
        yield scene, view_layer, obj
    finally:
        bpy.data.objects.remove(obj)
        bpy.data.meshes.remove(copy)
        bpy.data.scenes.remove(scene)


def _fill(copy, positions, corners, faces) -> None:
    """Make these faces all that the mesh has."""
    copy.clear_geometry()
    copy.vertices.add(len(positions))
    copy.loops.add(len(corners))
    copy.polygons.add(len(faces))
    copy.vertices.foreach_set("co", positions.astype(np.float32).ravel())
    copy.loops.foreach_set("vertex_index", corners)
    copy.polygons.foreach_set("loop_start", faces)
    copy.uv_layers.new(name=LAYER)
    copy.update(calc_edges=True)


def _unwrap(context, bench, positions, corners, faces) -> np.ndarray:
    """Smart UV Project: (L, 2) float64, charts apart but neither scaled nor packed for us."""
    scene, view_layer, obj = bench
    _fill(obj.data, positions, corners, faces)
    override = {
        "scene": scene,
        "view_layer": view_layer,
        "active_object": obj,
        "object": obj,
        "selected_objects": [obj],
    }
    with context.temp_override(**override):
        bpy.ops.object.mode_set(mode="EDIT")
    try:
        with context.temp_override(**override, edit_object=obj):
            bpy.ops.mesh.select_all(action="SELECT")
            bpy.ops.uv.smart_project(
                angle_limit=ANGLE_LIMIT,
                margin_method="SCALED",
                rotate_method="AXIS_ALIGNED",
                island_margin=0.001,
                correct_aspect=False,
                scale_to_bounds=False,
            )
    finally:
        with context.temp_override(**override, edit_object=obj):
            bpy.ops.object.mode_set(mode="OBJECT")
    return read_attribute(obj.data, LAYER, len(obj.data.loops), 2, "vector", np.float32).astype(np.float64)
