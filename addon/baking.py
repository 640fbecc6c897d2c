"""One bake from start to end, the same for the button and the command line.

`bake_steps` reads the scene object by object on the main thread, hands arrays to core as `Work`, and writes the result
back. While core works the scene is as it was before, so that whatever ends the bake then has nothing to undo.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Generator
from dataclasses import replace

import bpy
import numpy as np

from ..core.bake import Cancelled, Kept, Progress, Settings, bake
from ..core.panes import Relighter
from ..core.scene import SceneError
from . import (
    atlas,
    caustics,
    claims,
    direct,
    environment,
    extract,
    lamps,
    linking,
    nodes,
    points,
    relight,
    sessions,
    store,
    twice,
    vertices,
    waiting,
)
from .preflight import check as preflight
from .snapshot import PLACE, Snapshot, remove_layer
from .unfolded import Unfolded, together
from .work import Work, mapped, run

# Parts of the whole at which reading the scene, core's work, and building what is stored end.
ATLAS, READ, BAKED, STORED = 0.03, 0.05, 0.97, 0.98

SOLVED = 0.9
"""Part at which core's work ends where caustics follow it."""


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
    if waiting.renders():
        raise SceneError("A render is running: wait until it is done.")
    warnings = preflight(context)
    asked = scene.lightpanes
    settings = Settings(
        error_target=asked.error_target,
        time_budget=asked.time_budget,
        resolution=asked.resolution,
        seed=asked.seed,
        exits=asked.exits.lower(),
        photons=caustics.photons_asked(scene),
        memory=asked.memory_budget,
    )
    yield Progress("Atlas", 0.0, 0)
    objects = [item for item in scene.objects if item.type == "MESH" and store.TAG not in item]
    with relight.paused():
        at_vertices, told = vertices.choose(context, objects)
    warnings += told
    making = atlas.atlas_steps(context, objects, settings.resolution, at_vertices)
    planned, told = yield from mapped(making, lambda part: Progress("Atlas", ATLAS * part, 0))
    warnings += told
    yield Progress("Reading the scene", ATLAS, 0)
    # nothing of the atlas is in the scene until the new bake is: what is there shows by the old one, and files that are
    # saved and steps that are undone meanwhile are those of a scene without a bake under way
    unfolded = Unfolded(planned)
    for some in together(objects):
        with relight.paused():
            warnings += unfolded.read(context, *some)
        yield Progress("Reading the scene", ATLAS, 0)
        depsgraph = context.evaluated_depsgraph_get()
        for item in some:
            # subdivision waits until somebody asks for the mesh
            _ = item.evaluated_get(depsgraph).data
        yield Progress("Reading the scene", ATLAS, 0)
    loops: dict = {}
    with relight.paused(), unfolded.laid(objects):
        surfaces = extract.extract(context, resolution=settings.resolution, loops=loops, atlas=unfolded)
    found, world = extract.fingerprint(context), environment.digest(scene.world)
    lit = direct.ask_now(context) if asked.direct == "BAKED" else None
    focused = caustics.ask_of(scene, surfaces)
    by_hand, reserved = bool(asked.photons), caustics.reserve(scene, focused)
    solved = BAKED if focused is None else SOLVED

    def work(progress):
        def told(now):
            # more follows here
            if now.fraction < 1:
                share = READ + (solved - READ) * now.fraction
                progress(Progress(now.stage, share, now.rays, now.error, now.seconds_left))

        result = bake(surfaces, settings, told, kept, time.perf_counter() - start + reserved)
        # what is kept stays as it is
        result = replace(result, meta=copy.deepcopy(result.meta))
        points.remember(result, surfaces)
        tracer = caustics.make_tracer(surfaces)
        relighter = Relighter(result.panes(), tracer)
        shown = None if lit is None else direct.make_atlas(relighter.panes, surfaces, tracer, lit)
        traced = None
        if focused is not None:
            rays, left = result.report["rays"], np.inf
            if settings.time_budget and not by_hand:
                left = settings.time_budget - (time.perf_counter() - start)
            traced, photons = caustics.trace(
                relighter.panes,
                surfaces,
                focused,
                lambda part: progress(Progress("Caustics", SOLVED + (BAKED - SOLVED) * part, rays)),
                left,
            )
            if photons < focused.photons:
                result.meta[caustics.PHOTONS] = photons
                result.report["warnings"].append(
                    f"There was time for {photons:,} photons of each lamp, where caustics ask for {focused.photons:,}: "
                    "allow more Time, or set Photons."
                )
        return result, relighter, shown, traced, store.key_of(result)

    del scene, asked, objects, at_vertices, making, unfolded
    result, relighter, shown, traced, key = yield Work(work, alone=True)
    scene = context.scene
    report = result.meta["report"]
    yield Progress("Storing", BAKED, report["rays"])
    report["warnings"] = warnings + [w for w in report.get("warnings", []) if w not in warnings]
    still = [lamp for lamp in surfaces.lights if not lamp.live]
    result.meta["static"] = {lamp.name: lamps.lamp_key([lamp]) for lamp in still}
    result.meta["static_lamps"] = [lamps.to_json(lamp) for lamp in still]
    result.meta["world"] = world
    _refuse_edited(planned)
    built = yield from mapped(
        store.build_steps(result, surfaces.albedo_map, key),
        lambda part: Progress("Storing", BAKED + (STORED - BAKED) * part, report["rays"]),
    )
    try:
        yield Progress("Storing", STORED, report["rays"])
        _refuse_edited(planned)
        late = set(extract.changed_objects(found, extract.fingerprint(context)))
        # undo may have brought back an older one
        before = Snapshot.of(scene, [item for item in scene.objects if item.type == "MESH" and store.TAG not in item])
        try:
            with relight.paused():
                planned.restore()
                store.put(scene, built)
        except BaseException:
            before.restore()
            raise
    except BaseException:
        store.discard(built)
        raise
    if kept is not None:
        kept.clear()
    with relight.paused():
        vertices.keep(context, surfaces, loops)
        claims.claim(scene)
        sessions.adopt(scene, relighter)
        placed = extract.fingerprint(context)
    ending = _Ending(report["rays"])
    yield from ending.turn(0.985)
    with relight.paused():
        late |= set(extract.changed_objects(placed, extract.fingerprint(context)))
        report["warnings"] += nodes.attach(context, surfaces)
        # after attaching, which may give materials to objects that have none; but what changed meanwhile is stale
        seen = extract.fingerprint(context)
        result.meta["fingerprint"] = {name: was if name in late else seen.get(name, was) for name, was in found.items()}
        store.write_meta(scene, result.meta)
        if shown is not None:
            direct.adopt(scene, shown, result.meta["fingerprint"])
        caustics.adopt(scene, traced, result.meta["fingerprint"])
    yield from ending.turn(0.99)
    report["relight_ms"] = round(relight.relight(context), 2)
    if direct.is_baked(scene):
        report["direct_ms"] = round(direct.held(scene).milliseconds, 2)
        report["warnings"] += direct.sentences(scene)
    if (told := caustics.report(scene)) is not None:
        report["caustics"] = told
        report["warnings"] += [w for w in caustics.sentences(scene) if w not in report["warnings"]]
    yield from ending.turn(0.995)
    sessions.pack()
    report["total_seconds"] = round(time.perf_counter() - start, 3)
    store.write_meta(scene, result.meta)
    yield from ending.turn(1.0, "Done")
    return report


def _refuse_edited(planned: Snapshot) -> None:
    if reason := planned.edited():
        raise SceneError(f"{reason}: bake again.")


class _Ending:
    """Turns for Blender once the new bake is in place, when it is too late to cancel: whoever does gets all the rest."""

    def __init__(self, rays: int):
        self.rays, self.hurry = rays, False

    def turn(self, fraction: float, stage: str = "Storing") -> Generator[Progress, None, None]:
        if not self.hurry:
            try:
                yield Progress(stage, fraction, self.rays)
            except Cancelled:
                self.hurry = True


def clear_scene(context: bpy.types.Context) -> bool:
    """Take everything of ours out of the context's scene; True when there was a bake."""
    scene = context.scene
    nodes.detach(scene)
    twice.give_back(scene)
    linking.give_back(scene)
    sessions.forget(scene)
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
            for key in PLACE:
                if key in item:
                    del item[key]
    vertices.drop()
    kept = {item.data for item in bpy.data.objects if "lightpanes_baked" in item}
    for mesh in {item.data for item in mine if item.type == "MESH"} - kept:
        if mesh.library is None:
            remove_layer(mesh)
