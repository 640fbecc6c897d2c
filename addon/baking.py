"""One bake from start to end, the same for the button and the command line."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import contextmanager

import bpy

from ..core.bake import Progress, Settings, bake
from ..core.panes import Relighter
from ..core.rays import Tracer
from ..core.scene import SceneError
from . import atlas, extract, nodes, points, relight, store, vertices, visibility


def bake_scene(context: bpy.types.Context, progress: Callable[[Progress], None] | None = None) -> dict:
    """Bake the context's scene as `scene.lightpanes` asks; returns the report (JSON-able).

    Raises SceneError with a sentence for the user when it can't be baked. Whatever stops it, an exception raised by
    `progress` included, leaves the scene's previous bake as it was.
    """
    scene = context.scene
    start = time.perf_counter()
    progress = progress or (lambda _: None)
    warnings = preflight(context)
    asked = scene.lightpanes
    settings = Settings(
        error_target=asked.error_target,
        time_budget=asked.time_budget,
        resolution=asked.resolution,
        seed=asked.seed,
        exits=asked.exits.lower(),
    )
    progress(Progress("Atlas", 0.0, 0))
    objects = [item for item in scene.objects if item.type == "MESH" and store.TAG not in item]
    loops: dict = {}
    with relight.paused(), _atlas_kept_on_failure(context, objects):
        at_vertices, told = vertices.choose(context, objects)
        warnings += told
        warnings += atlas.make_atlas(context, objects, settings.resolution, at_vertices)
        progress(Progress("Reading the scene", 0.02, 0))
        surfaces = extract.extract(context, resolution=settings.resolution, loops=loops)
        result = bake(surfaces, settings, lambda p: progress(Progress(p.stage, 0.05 + 0.93 * p.fraction, p.rays)))
        report = result.meta.setdefault("report", {})
        report["warnings"] = warnings + [w for w in report.get("warnings", []) if w not in warnings]
        result.meta["static"] = {lamp.name: relight.lamp_key([lamp]) for lamp in surfaces.lights if not lamp.live}
        points.remember(result, surfaces)
        store.store_bake(scene, result, surfaces.albedo_map)
    with relight.paused():
        vertices.keep(context, surfaces, loops)
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


def preflight(context: bpy.types.Context) -> list[str]:
    """Warnings; raises SceneError when there is nothing to bake."""
    scene = context.scene
    surfaces = [item for item in scene.objects if item.type in extract.GEOMETRY and store.TAG not in item]
    instancers = [item for item in scene.objects if item.instance_collection is not None]
    if not surfaces and not instancers:
        raise SceneError(f"There is nothing to bake: scene '{scene.name}' has no mesh. Add one.")
    rendered = visibility.rendered_objects(context.view_layer)
    shown = [item for item in surfaces if item in rendered]
    if not shown and not rendered.intersection(instancers):
        raise SceneError(
            f"There is nothing to bake: every mesh in scene '{scene.name}' is hidden from renders. "
            "Turn on its camera icon in the Outliner, or that of its collection."
        )
    if shown and all(item.lightpanes.exclude for item in shown):
        raise SceneError(f"There is nothing to bake: every mesh in scene '{scene.name}' is excluded from Lightpanes.")
    if shown and all(item.type == "MESH" and not item.data.polygons for item in shown):
        raise SceneError(f"There is nothing to bake: '{shown[0].name}' has no faces. Add some.")
    if not any(item.type == "LIGHT" for item in rendered) and not instancers:
        return [f"Scene '{scene.name}' has no visible lamp; the light follows as soon as you add or show one."]
    return []


@contextmanager
def _atlas_kept_on_failure(context, objects):
    """The previous bake's images are read through the UV layer and the objects' places: both stay with it."""
    restore = atlas.remember(context, objects)
    try:
        yield
    except BaseException:
        restore()
        raise


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
            for key in atlas.PLACE:
                if key in item:
                    del item[key]
    vertices.drop()
    kept = {item.data for item in bpy.data.objects if "lightpanes_baked" in item}
    for mesh in {item.data for item in mine if item.type == "MESH"} - kept:
        if mesh.library is None:
            atlas.remove_layer(mesh)
