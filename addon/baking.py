"""One bake from start to end, the same for the button and the command line."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import contextmanager

import bpy
import numpy as np

from ..core.bake import Progress, Settings, bake
from ..core.panes import Relighter
from ..core.rays import Tracer
from ..core.scene import SceneError
from . import extract, nodes, relight, store
from .atlas import make_atlas

UV_LAYER = nodes.UV_LAYER
PLACE = ("lightpanes_scale", "lightpanes_offset", "lightpanes_baked")
SURFACES = {"MESH", "CURVE", "SURFACE", "META", "FONT"}


def bake_scene(context: bpy.types.Context, progress: Callable[[Progress], None] | None = None) -> dict:
    """Bake the context's scene as `scene.lightpanes` asks; returns the report (JSON-able).

    Raises SceneError with a sentence for the user when it can't be baked. Whatever stops it, an exception raised by
    `progress` included, leaves the scene's previous bake as it was.
    """
    scene = context.scene
    start = time.perf_counter()
    progress = progress or (lambda _: None)
    warnings = preflight(scene)
    asked = scene.lightpanes
    settings = Settings(
        error_target=asked.error_target, time_budget=asked.time_budget, resolution=asked.resolution, seed=asked.seed
    )
    progress(Progress("Atlas", 0.0, 0))
    with relight.paused(), _atlas_kept_on_failure():
        objects = [item for item in scene.objects if item.type == "MESH" and not item.lightpanes.exclude]
        make_atlas(context, objects, settings.resolution)
        progress(Progress("Reading the scene", 0.02, 0))
        surfaces = extract.extract(context, resolution=settings.resolution)
        result = bake(surfaces, settings, lambda p: progress(Progress(p.stage, 0.05 + 0.93 * p.fraction, p.rays)))
        report = result.meta.setdefault("report", {})
        report["warnings"] = warnings + [w for w in report.get("warnings", []) if w not in warnings]
        store.store_bake(scene, result, surfaces.albedo_map)
    relight.adopt(scene, Relighter(result.panes(), Tracer(surfaces)))
    report["warnings"] += nodes.attach(context, surfaces)
    # after attaching, which may give materials to objects that have none
    result.meta["fingerprint"] = extract.fingerprint(context)
    store.write_meta(scene, result.meta)
    report["relight_ms"] = round(relight.relight(context), 2)
    report["total_seconds"] = round(time.perf_counter() - start, 3)
    relight.pack()
    store.write_meta(scene, result.meta)
    progress(Progress("Done", 1.0, report.get("rays", 0)))
    return report


def clear_scene(context: bpy.types.Context) -> bool:
    """Take everything of ours out of the context's scene; True when there was a bake."""
    scene = context.scene
    nodes.detach(scene)
    relight.forget(scene)
    found = store.clear(scene)
    _clear_atlas(scene)
    return found


def preflight(scene: bpy.types.Scene) -> list[str]:
    """Warnings; raises SceneError when there is nothing to bake."""
    surfaces = [item for item in scene.objects if item.type in SURFACES and store.TAG not in item]
    instancers = [item for item in scene.objects if item.instance_collection is not None]
    if not surfaces and not instancers:
        raise SceneError(f"There is nothing to bake: scene '{scene.name}' has no mesh. Add one.")
    if all(item.hide_render for item in surfaces + instancers):
        raise SceneError(
            f"There is nothing to bake: every mesh in scene '{scene.name}' is hidden from renders. "
            "Turn on its camera icon in the Outliner."
        )
    if surfaces and not instancers and all(item.lightpanes.exclude for item in surfaces):
        raise SceneError(f"There is nothing to bake: every mesh in scene '{scene.name}' is excluded from Lightpanes.")
    if not any(item.type == "LIGHT" and not item.hide_render for item in scene.objects) and not instancers:
        return [f"Scene '{scene.name}' has no visible lamp; the light follows as soon as you add or show one."]
    return []


@contextmanager
def _atlas_kept_on_failure():
    """The previous bake's images are read through the UV layer and the objects' places, so they must stay with it."""
    meshes = {mesh: _read_layer(mesh) for mesh in bpy.data.meshes if mesh.library is None}
    places = {item: {key: _plain(item[key]) for key in PLACE if key in item} for item in bpy.data.objects}
    try:
        yield
    except BaseException:
        for mesh, layer in meshes.items():
            _write_layer(mesh, layer)
        for item, place in places.items():
            for key in PLACE:
                if key in place:
                    item[key] = place[key]
                elif key in item:
                    del item[key]
        raise


def _plain(value):
    return list(value) if hasattr(value, "__len__") else value


def _read_layer(mesh):
    layer = mesh.uv_layers.get(UV_LAYER)
    if layer is None:
        return None
    uv = np.empty(2 * len(layer.uv), np.float32)
    layer.uv.foreach_get("vector", uv)
    return uv


def _write_layer(mesh, uv):
    layer = mesh.uv_layers.get(UV_LAYER)
    if uv is None:
        if layer is not None:
            mesh.uv_layers.remove(layer)
        return
    if layer is None:
        layer = mesh.uv_layers.new(name=UV_LAYER, do_init=False)
    if layer is not None and 2 * len(layer.uv) == len(uv):
        layer.uv.foreach_set("vector", uv)


def _clear_atlas(scene):
    mine = set(scene.objects)
    for item in list(mine):
        if item.instance_collection is not None:
            mine.update(item.instance_collection.all_objects)
    elsewhere = {
        user for other in bpy.data.scenes if other != scene and other.lightpanes.entries for user in other.objects
    }
    for item in mine - elsewhere:
        if item.library is None:
            for key in PLACE:
                if key in item:
                    del item[key]
    kept = {item.data for item in bpy.data.objects if "lightpanes_baked" in item}
    for mesh in {item.data for item in mine if item.type == "MESH"} - kept:
        layer = mesh.uv_layers.get(UV_LAYER)
        if layer is not None and mesh.library is None:
            mesh.uv_layers.remove(layer)
