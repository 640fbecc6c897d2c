"""One bake from start to end, the same for the button and the command line.

`bake_steps` reads the scene object by object on the main thread, hands arrays to core as `Work`, and writes the result
back. While core works the scene is as it was before, so that whatever ends the bake then has nothing to undo.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Generator

import bpy

from ..core.bake import Cancelled, Kept, Progress, Settings, bake
from ..core.panes import Relighter
from ..core.rays import Tracer
from ..core.scene import SceneError
from . import atlas, direct, extract, lamps, linking, nodes, points, relight, store, twice, vertices
from .preflight import check as preflight
from .snapshot import Snapshot
from .work import Work, mapped, run

# Parts of the whole at which reading the scene, and core's work, end.
ATLAS, READ, BAKED = 0.03, 0.05, 0.97


def bake_scene(context: bpy.types.Context, progress: Callable[[Progress], None] | None = None) -> dict:
    """Bake the context's scene as `scene.lightpanes` asks; returns the report (JSON-able).

    Raises SceneError with a sentence for the user when it can't be baked. Whatever stops it, an exception raised by
    `progress` included, leaves the scene's previous bake as it was.
    """
    return run(bake_steps(context), progress)


def bake_steps(context: bpy.types.Context, kept: Kept | None = None) -> Generator[Progress | Work, object, dict]:
    """The same, as a generator of its Progress and of the Work in it (see `work`).

    kept: what cancelled bakes had finished. Whoever drives it sees to it that the context's scene is the same at each
    step.
    """
    scene = context.scene
    start = time.perf_counter()
    warnings = preflight(context)
    asked = scene.lightpanes
    settings = Settings(
        error_target=asked.error_target,
        time_budget=asked.time_budget,
        resolution=asked.resolution,
        seed=asked.seed,
        exits=asked.exits.lower(),
    )
    yield Progress("Atlas", 0.0, 0)
    objects = [item for item in scene.objects if item.type == "MESH" and store.TAG not in item]
    before = Snapshot(scene, objects)
    loops: dict = {}
    try:
        with relight.paused():
            at_vertices, told = vertices.choose(context, objects)
        warnings += told
        making = atlas.atlas_steps(context, objects, settings.resolution, at_vertices)
        warnings += yield from mapped(making, lambda part: Progress("Atlas", ATLAS * part, 0))
        yield Progress("Reading the scene", ATLAS, 0)
        for item in objects:
            # subdivision waits until somebody asks for the mesh
            _ = item.evaluated_get(context.evaluated_depsgraph_get()).data
            yield Progress("Reading the scene", ATLAS, 0)
        with relight.paused():
            surfaces = extract.extract(context, resolution=settings.resolution, loops=loops)
        found = extract.fingerprint(context)
        planned = Snapshot(scene, objects)
        lit = direct.ask_now(context) if asked.direct == "BAKED" else None
    finally:
        # what is there shows by the old atlas until the new bake is
        before.restore()

    def work(progress):
        def told(now):
            progress(Progress(now.stage, READ + (BAKED - READ) * now.fraction, now.rays, now.error, now.seconds_left))

        result = bake(surfaces, settings, told, kept)
        tracer = Tracer(surfaces)
        relighter = Relighter(result.panes(), tracer)
        shown = None if lit is None else direct.make_atlas(relighter.panes, surfaces, tracer, lit)
        return result, relighter, shown

    del scene, asked, objects, at_vertices
    result, relighter, shown = yield Work(work, alone=True)
    scene = context.scene
    yield Progress("Storing", BAKED, result.meta["report"]["rays"])
    edited = planned.edited()
    if edited:
        raise SceneError(f"Mesh '{edited[0]}' was edited while the bake ran: bake again.")
    now = extract.fingerprint(context)
    report = result.meta["report"]
    report["warnings"] = warnings + [w for w in report.get("warnings", []) if w not in warnings]
    still = [lamp for lamp in surfaces.lights if not lamp.live]
    result.meta["static"] = {lamp.name: lamps.lamp_key([lamp]) for lamp in still}
    result.meta["static_lamps"] = [lamps.to_json(lamp) for lamp in still]
    points.remember(result, surfaces)
    yield Progress("Storing", 0.98, report["rays"])
    # again: undo may have brought back an older one
    before = Snapshot(scene, [item for item in scene.objects if item.type == "MESH" and store.TAG not in item])
    try:
        with relight.paused():
            planned.restore()
            store.store_bake(scene, result, surfaces.albedo_map)
    except BaseException:
        before.restore()
        raise
    with relight.paused():
        vertices.keep(context, surfaces, loops)
        relight.adopt(scene, relighter)
        report["warnings"] += nodes.attach(context, surfaces)
        # after attaching, which may give materials to objects that have none; but what changed meanwhile is stale
        late = {name: found.get(name, "") for name in extract.changed_objects(found, now) if name in found}
        result.meta["fingerprint"] = extract.fingerprint(context) | late
        store.write_meta(scene, result.meta)
        if shown is not None:
            direct.adopt(scene, shown, result.meta["fingerprint"])
    with contextlib.suppress(Cancelled):
        # too late: the new bake is in place
        yield Progress("Storing", 0.99, report["rays"])
    report["relight_ms"] = round(relight.relight(context), 2)
    if direct.is_baked(scene):
        report["direct_ms"] = round(direct.held(scene).milliseconds, 2)
        report["warnings"] += direct.sentences(scene)
    report["total_seconds"] = round(time.perf_counter() - start, 3)
    relight.pack()
    store.write_meta(scene, result.meta)
    yield Progress("Done", 1.0, report["rays"])
    return report


def clear_scene(context: bpy.types.Context) -> bool:
    """Take everything of ours out of the context's scene; True when there was a bake."""
    scene = context.scene
    nodes.detach(scene)
    twice.give_back(scene)
    linking.give_back(scene)
    relight.forget(scene)
    direct.forget(scene)
    found = store.clear(scene)
    _clear_atlas(scene)
    return found


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
