"""One atlas for all objects that receive light: the UV layer `Lightpanes`, and each object's place in it.

Blender's Smart UV Project cuts the charts, on copies in a scene of its own, so that selection, mode
and every other UV layer stay as they are. Each chart then gets its true size in the world (the affine
map that best undoes the projection's stretch) and `packing` lays them out. Blender's own packer is not
used: it took 1 s to 90 s for three objects where shapes are concave, and filled less with boxes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from contextlib import contextmanager
from dataclasses import dataclass

import bpy
import numpy as np

from ..core.scene import SceneError
from . import visibility
from .charts import lay_flat, next_loop
from .meshes import AT_VERTICES, LAYER, are_numbers, loop_triangles, read_attribute, weight_of
from .packing import FEW, INSET, MARGIN, Charts, pack

ANGLE_LIMIT = np.radians(66.0)
LARGEST_GRID = 1024  # cells; above it a cell is several texels wide
PLACE = ("lightpanes_scale", "lightpanes_offset", "lightpanes_baked", AT_VERTICES)
SMALLEST_COVERAGE = 0.2  # of the texels; below it the charts are too many for the atlas
SMALLEST_CHARTED = 0.9  # of the area must be in charts of a texel or more
DOUBLING = {"MIRROR", "ARRAY", "SOLIDIFY", "SCREW", "NODES", "BOOLEAN", "SKIN", "BUILD"}


@dataclass
class _Mesh:
    """One mesh that is laid out, in the world space of its first user.

    positions (V, 3), corners (L,) vertex of each loop, faces (F,) first loop of each polygon.
    users: objects; ratios: linear size of each, the first one's being 1, weight included.
    """

    data: bpy.types.Mesh
    users: list
    ratios: np.ndarray
    positions: np.ndarray
    corners: np.ndarray
    faces: np.ndarray

    @property
    def shared(self) -> bool:
        return len(self.users) > 1


def receivers(context: bpy.types.Context, objects: Iterable[bpy.types.Object], warnings: list[str]) -> list:
    """Those of the objects that can have a place in the atlas: meshes with faces that render, not excluded."""
    rendered = visibility.rendered_objects(context.view_layer)
    found = []
    for obj in sorted(rendered.intersection(objects), key=lambda obj: obj.name):
        if obj.type != "MESH" or getattr(getattr(obj, "lightpanes", None), "exclude", False):
            continue
        if obj.library or obj.data.library:
            warnings.append(
                f"'{obj.name}' comes from a linked library, so it blocks and reflects light but receives none: "
                "use Object > Relations > Make Local > Selected Objects and Data."
            )
        elif obj.mode == "EDIT":
            raise SceneError(f"'{obj.name}' is in Edit Mode: leave it (Tab) and bake again.")
        elif obj.data.polygons:
            found.append(obj)
    return found


def make_atlas(
    context: bpy.types.Context,
    objects: Iterable[bpy.types.Object],
    resolution: int,
    at_vertices: Collection[bpy.types.Object] = (),
) -> list[str]:
    """Give each of the objects that can receive light a place in one atlas of resolution² texels; returns warnings.

    Makes or updates the UV layer `Lightpanes` of their meshes and the custom properties
    lightpanes_scale, _offset and _baked; every other object of the scene loses those. Objects that
    share a mesh share its layer and have a rectangle each; the others' charts are packed one by one.
    Those in at_vertices are marked as lit there and get neither layer nor place. Texels per metre are the same
    everywhere but for the objects' weights, and charts stay two texels apart. Raises SceneError, naming the object and what to do, before anything has changed.
    """
    warnings: list[str] = []
    objects = [obj for obj in receivers(context, objects, warnings) if obj not in at_vertices]
    if not objects and not at_vertices:
        raise SceneError("No object can receive light: add a mesh with faces that renders, or clear Exclude on one.")
    meshes = _gather(context, objects)
    layouts, places = _lay_out(meshes, _unwrap(context, meshes), resolution, warnings) if meshes else ([], {})
    for mesh, uv in zip(meshes, layouts, strict=True):
        _write_layer(mesh.data, uv)
    kept = set(objects)
    for obj in context.scene.objects:
        if obj not in kept and "lightpanes_baked" in obj and obj.library is None:
            for name in PLACE:
                obj.pop(name, None)
    for obj, (scale, offset) in places.items():
        obj["lightpanes_scale"], obj["lightpanes_offset"], obj["lightpanes_baked"] = scale, offset, 1.0
        obj.pop(AT_VERTICES, None)
    for obj in at_vertices:
        obj["lightpanes_baked"] = obj[AT_VERTICES] = 1.0
    _warn_overlaps(context, meshes, warnings)
    return warnings


def remember(context: bpy.types.Context, objects: list[bpy.types.Object]) -> Callable[[], None]:
    """A function that puts the atlas back as it is now, for a bake that fails or is cancelled."""
    places = [
        (obj, {n: (list(v) if hasattr(v := obj[n], "__len__") else v) for n in PLACE if n in obj})
        for obj in context.scene.objects
    ]
    layers = []
    for data in {obj.data for obj in objects}:
        layer = data.uv_layers.get(LAYER)
        layers.append(
            (data, None if layer is None else read_attribute(data, LAYER, len(data.loops), 2, "vector", np.float32))
        )

    def restore() -> None:
        for data, uv in layers:
            layer = data.uv_layers.get(LAYER)
            if uv is not None and layer is not None and len(data.loops) == len(uv):
                layer.uv.foreach_set("vector", uv.ravel())
                data.update()
            elif uv is None and layer is not None:
                remove_layer(data)
        for obj, values in places:
            for name in PLACE:
                if name in values:
                    obj[name] = values[name]
                elif name in obj:
                    del obj[name]

    return restore


def _gather(context, objects) -> list[_Mesh]:
    users: dict[bpy.types.Mesh, list] = {}
    for obj in objects:
        layers = obj.data.uv_layers
        if LAYER not in layers and len(layers) >= 8:
            raise SceneError(
                f"'{obj.name}' has 8 UV layers, the most that Blender allows: delete one, or exclude the object."
            )
        if LAYER not in layers and LAYER in obj.data.attributes:
            raise SceneError(f"'{obj.name}' has an attribute named '{LAYER}' that is not a UV layer: rename it.")
        users.setdefault(obj.data, []).append(obj)
    depsgraph = context.evaluated_depsgraph_get()
    meshes = []
    for data, owners in users.items():
        local = read_attribute(data, "position", len(data.vertices), 3, "vector", np.float32).astype(np.float64)
        corners = read_attribute(data, ".corner_vert", len(data.loops), 1, "value", np.int32)
        faces = np.empty(len(data.polygons), np.int32)
        data.polygons.foreach_get("loop_start", faces)
        worlds = [np.array(obj.evaluated_get(depsgraph).matrix_world, np.float64)[:3, :3] for obj in owners]
        weights = [max(weight_of(obj), 1e-6) for obj in owners]
        placed = [local @ world.T for world in worlds]
        for obj, positions in zip(owners, placed, strict=True):
            if not are_numbers(positions):
                raise SceneError(
                    f"'{obj.name}' has vertices that are not numbers (NaN or infinite): repair or delete them, or hide the object from renders."
                )
        areas = np.array([_area(positions, corners, faces) for positions in placed]) * weights
        ratios = np.sqrt(areas / max(areas[0], 1e-30)) if areas[0] > 0 else np.ones(len(owners))
        meshes.append(_Mesh(data, owners, np.maximum(ratios, 1e-6), placed[0] * np.sqrt(weights[0]), corners, faces))
    return meshes


def _area(positions, corners, faces) -> float:
    """Area of all polygons: Newell's vectors, exact for planar ones."""
    points = positions[corners]
    after = points[next_loop(faces, len(corners))]
    return float(np.linalg.norm(np.add.reduceat(np.cross(points, after), faces), axis=1).sum() / 2)


@contextmanager
def _workbench(meshes):
    """A scene of its own with a copy of each mesh's faces, all selected; removed at the end."""
    scene = bpy.data.scenes.new("Lightpanes Atlas")
    objects = []
    try:
        for mesh in meshes:
            copy = bpy.data.meshes.new("Lightpanes Atlas")
            obj = bpy.data.objects.new("Lightpanes Atlas", copy)
            objects.append(obj)
            copy.vertices.add(len(mesh.positions))
            copy.loops.add(len(mesh.corners))
            copy.polygons.add(len(mesh.faces))
            copy.vertices.foreach_set("co", mesh.positions.astype(np.float32).ravel())
            copy.loops.foreach_set("vertex_index", mesh.corners)
            copy.polygons.foreach_set("loop_start", mesh.faces)
            copy.uv_layers.new(name=LAYER)
            copy.update(calc_edges=True)
            scene.collection.objects.link(obj)
        view_layer = scene.view_layers[0]
        for obj in objects:
            obj.select_set(True, view_layer=view_layer)
        view_layer.objects.active = objects[0]
        yield scene, view_layer, objects
    finally:
        for obj in objects:
            data = obj.data
            bpy.data.objects.remove(obj)
            bpy.data.meshes.remove(data)
        bpy.data.scenes.remove(scene)


def _unwrap(context, meshes) -> list[np.ndarray]:
    """Smart UV Project of each mesh: (L, 2) per mesh, charts apart but neither scaled nor packed for us."""
    with _workbench(meshes) as (scene, view_layer, objects):
        first = objects[0]
        override = {
            "scene": scene,
            "view_layer": view_layer,
            "active_object": first,
            "object": first,
            "selected_objects": objects,
        }
        with context.temp_override(**override):
            bpy.ops.object.mode_set(mode="EDIT")
        try:
            with context.temp_override(**override, edit_object=first):
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
            with context.temp_override(**override, edit_object=first):
                bpy.ops.object.mode_set(mode="OBJECT")
        return [
            read_attribute(obj.data, LAYER, len(obj.data.loops), 2, "vector", np.float32).astype(np.float64)
            for obj in objects
        ]


def _lay_out(meshes, unwrapped, resolution, warnings):
    """The layer's UVs per mesh and each object's (scale, offset)."""
    layouts = [
        lay_flat(mesh.positions, mesh.corners, mesh.faces, loop_triangles(mesh.data), uv)
        for mesh, uv in zip(meshes, unwrapped, strict=True)
    ]
    grid = min(resolution, LARGEST_GRID)
    total = sum(layout.areas.sum() * (mesh.ratios**2).sum() for mesh, layout in zip(meshes, layouts, strict=True))
    if total <= 0:
        raise SceneError("Every face has zero area; scale the objects up or apply their scale.")
    chart_count = sum(len(layout.areas) * len(mesh.users) for mesh, layout in zip(meshes, layouts, strict=True))
    density = high = _densest(meshes, layouts, total, chart_count, grid)
    smallest = 0.2 * density
    # whether charts fit is not monotonic in their size: few charts can afford to try more sizes
    step = 0.97 if chart_count <= FEW else 0.94
    packed = low = None
    while (low is None and density > smallest) or (low is not None and high / low > 1.015):
        attempt = _attempt(meshes, layouts, density, grid)
        if attempt is None:
            high = density
        else:
            packed, low = attempt, density
        density = np.sqrt(low * high) if low else density * step
    if packed is None:
        raise SceneError(_too_small(meshes, chart_count, resolution))
    density = low * resolution / grid
    _check_sizes(meshes, layouts, density, resolution, total, chart_count, warnings)
    return packed


def _densest(meshes, layouts, total, chart_count, grid) -> float:
    """Cells per metre at which charts and their margins would fill the atlas without a gap; 0 if they can't."""
    border = 0.0
    for mesh, layout in zip(meshes, layouts, strict=True):
        corner = np.zeros((len(layout.areas), 2))
        np.maximum.at(corner, layout.chart, layout.points)
        border += 2 * MARGIN * corner.sum() * mesh.ratios.sum()
    free = grid * grid - (2 * MARGIN) ** 2 * chart_count
    if free <= 0:
        return 0.0
    return float((np.sqrt(border**2 + 4 * total * free) - border) / (2 * total))


def _too_small(meshes, chart_count, resolution) -> str:
    worst = max(meshes, key=lambda mesh: len(mesh.faces) * len(mesh.users)).users[0].name
    return (
        f"An atlas of {resolution}×{resolution} texels is too small for its {chart_count} charts: raise Resolution, "
        f"or exclude objects with many small faces ('{worst}' has most)."
    )


def _check_sizes(meshes, layouts, density, resolution, total, chart_count, warnings) -> None:
    covered = total * density**2 / resolution**2
    charted = 0.0
    for mesh, layout in zip(meshes, layouts, strict=True):
        for obj, ratio in zip(mesh.users, mesh.ratios, strict=True):
            texels = layout.areas * (ratio * density) ** 2
            seen = layout.areas[texels >= 1].sum() * ratio**2
            charted += seen
            if texels.sum() < 1:
                warnings.append(
                    f"'{obj.name}' is smaller than a texel, so its light is coarse: raise Resolution or the object's weight."
                )
    if covered < SMALLEST_COVERAGE or charted < SMALLEST_CHARTED * total:
        raise SceneError(_too_small(meshes, chart_count, resolution))


def _attempt(meshes, layouts, density, grid):
    """Everything at `density` cells per metre: (UVs per mesh, places per object), or None if it doesn't fit."""
    singles = [i for i, mesh in enumerate(meshes) if not mesh.shared]
    blocks, sizes = {}, []
    for i, mesh in enumerate(meshes):
        if mesh.shared:
            # packed for its smallest user, so that the others' margins are only wider
            least = mesh.ratios.min()
            block = _block(layouts[i], density * least, grid)
            if block is None:
                return None
            blocks[i] = block
            sizes.extend((i, k, block[1] * (ratio / least)) for k, ratio in enumerate(mesh.ratios))
    charts = _together(
        [layouts[i] for i in singles],
        np.array([np.ceil(size - 1e-6) - 2 * MARGIN - 2 * INSET for _, _, size in sizes]).reshape(-1, 2) / density,
    )
    placed = pack(charts, density, grid, grid)
    if placed is None:
        return None
    uvs, places = [None] * len(meshes), {}
    moved = placed.apply(charts.points * density, charts.chart) / grid
    first = 0
    for i in singles:
        count = len(layouts[i].points)
        uvs[i] = moved[first : first + count]
        first += count
        places[meshes[i].users[0]] = ((1.0, 1.0), (0.0, 0.0))
    turned = charts.count - len(sizes)
    for n, (i, k, size) in enumerate(sizes):
        uvs[i] = blocks[i][0]
        corner = (placed.offset[turned + n] - MARGIN) / grid
        places[meshes[i].users[k]] = (tuple(float(s) for s in size / grid), tuple(float(c) for c in corner))
    return uvs, places


def _block(layout, density, grid):
    """A shared mesh's charts in a box of their own: UVs in [0, 1]² of the box, and its size in cells."""
    charts = layout.charts
    corner = np.zeros((charts.count, 2))
    np.maximum.at(corner, layout.chart, layout.points)
    cells = np.ceil(corner * density) + 2 * MARGIN
    side = np.sqrt(cells.prod(axis=1).sum())
    # a long chart may stand upright: only its shorter side must fit
    narrowest = cells.min(axis=1).max() + 1
    best = None
    for factor in (0.8, 0.9, 1.0, 1.15):
        width = int(np.ceil(max(side * factor, narrowest)))
        placed = pack(charts, density, width) if width <= grid else None
        if placed is None:
            continue
        points = placed.apply(charts.points * density, layout.chart)
        size = np.array([np.ceil(points[:, 0].max() - 1e-6) + MARGIN, placed.height], np.float64)
        if best is None or size.prod() < best[1].prod():
            best = points / size, size
    return best


def _together(layouts, boxes) -> Charts:
    """Charts of many meshes, then a fixed rectangle for each of `boxes` (n, 2), in metres."""
    points, owners, edges = [np.zeros((0, 2))], [np.zeros(0, np.int64)], [np.zeros((0, 2), np.int64)]
    loops = count = 0
    for layout in layouts:
        points.append(layout.points)
        owners.append(layout.chart + count)
        edges.append(layout.edges + loops)
        loops += len(layout.points)
        count += len(layout.areas)
    turnable = np.ones(count + len(boxes), bool)
    turnable[count:] = False
    ring = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)
    for box in np.maximum(boxes, 1e-9):
        points.append(ring * box)
        owners.append(np.full(4, count))
        edges.append(np.array([[0, 1], [1, 2], [2, 3], [3, 0]]) + loops)
        loops += 4
        count += 1
    return Charts(np.concatenate(points), np.concatenate(owners), np.concatenate(edges), count, turnable)


def _write_layer(data, uv) -> None:
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


def _warn_overlaps(context, meshes, warnings) -> None:
    """Modifiers that copy faces copy their UVs: more UV area than the mesh has means shared texels."""
    depsgraph = context.evaluated_depsgraph_get()
    for mesh in meshes:
        own = _uv_area(mesh.data)
        for obj in mesh.users:
            suspects = [
                modifier
                for modifier in obj.modifiers
                if modifier.type in DOUBLING and (modifier.show_viewport or modifier.show_render)
            ]
            if not suspects:
                continue
            evaluated = obj.evaluated_get(depsgraph).data
            if LAYER in evaluated.uv_layers and _uv_area(evaluated) > 1.05 * own:
                warnings.append(
                    f"'{obj.name}': the modifier '{suspects[0].name}' puts several faces on the same texels, "
                    "so they share their light: apply it."
                )


def _uv_area(data) -> float:
    if not len(data.polygons):
        return 0.0
    uv = read_attribute(data, LAYER, len(data.loops), 2, "vector", np.float32)[loop_triangles(data)].astype(np.float64)
    e, f = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    return float(np.abs(e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0]).sum() / 2)
