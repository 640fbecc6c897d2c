"""Lets the baked light follow the lamps: notices what changed, recomputes the irradiance, writes the image.

Everything needed is in the .blend: the bake (addon/store.py) and the meshes, for shadow rays. What is worked out
from them is kept in a session per scene (addon/sessions.py), so a reopened file relights by itself.
"""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager, nullcontext
from dataclasses import replace

import bpy

from ..core.bake import BakeError
from ..core.scene import Light, SceneError
from . import (
    areas,
    caustics,
    direct,
    doubts,
    engine,
    environment,
    extract,
    lamps,
    live_image,
    meshes,
    points,
    sessions,
    stale,
    store,
    vertices,
    visibility,
)
from .lamps import lamp_key

# Renders run frame changes outside the main thread; a relighter has one set of buffers.
_lock = threading.Lock()
# How many ask that the light stay as it is.
_holds = 0


@contextmanager
def paused():
    """Handlers do nothing meanwhile: reading a scene for a bake makes changes that look like lamps switched on."""
    with _lock:
        yield


@contextmanager
def held():
    """The light does not follow the lamps meanwhile, for frames are gone through that nobody looks at. Unlike `paused`
    this may last while Blender is free."""
    global _holds
    _holds += 1
    try:
        yield
    finally:
        _holds -= 1


def relight(context: bpy.types.Context, depsgraph: bpy.types.Depsgraph | None = None) -> float:
    """Bring the scene's `Lightpanes Irradiance` up to date with its lamps, and `Lightpanes Direct` where it holds their
    light; returns milliseconds of the former.

    All lamps are read anew, those that stopped being live after the bake included. Raises SceneError when there is no
    bake or when it can't be used.
    """
    if reason := engine.unusable():
        raise SceneError(reason)
    scene = context.scene
    with _lock:
        current = sessions.of(scene)
        if current is None:
            raise SceneError(f"Scene '{scene.name}' has no bake; press Bake first.")
        current.last.clear()
        caustics.look_anew(scene)
        if direct.is_baked(scene) or caustics.is_baked(scene):
            look_again(scene, extract.fingerprint(context))
        lights = _read_lights(depsgraph or context.evaluated_depsgraph_get(), current)
        _apply_caustics(context, scene, current, lights)
        _apply(context, scene, current, lights)
        _apply_direct(context, scene, current, lights)
    check_stale(context)
    return current.milliseconds


def update(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph, at_once: bool = True, asked: bool = False) -> bool:
    """Relight if a lamp differs from what the images show; True when it did.

    at_once: the lamps' direct light, too, where it is baked; else that follows soon. asked: even where the scene does not
    follow them by itself.
    For handlers: what the user must know goes to the console and into the session, for the panel, once.
    """
    if _holds or not (scene.lightpanes.live or asked) or not _lock.acquire(blocking=False):
        return False
    try:
        current = sessions.of(scene)
        if current is None:
            return False
        lights = _read_lights(depsgraph, current)
        key = lamp_key(lights)
        if current.owes and not meshes.in_edit_mode():
            current.shown = ""
        changed = key != current.shown
        worked = direct.is_baked(scene) or caustics.is_baked(scene) or caustics.is_shown(scene)
        if not (changed or worked) or not engine.ready():
            return False
        try:
            if changed:
                caustics.need_landings(scene)
            focused = _apply_caustics(bpy.context, scene, current, lights, at_once)
            changed = changed or (focused and at_once)
            if changed:
                _apply(bpy.context, scene, current, lights)
            return _apply_direct(bpy.context, scene, current, lights, at_once) or changed or focused
        except (SceneError, BakeError) as error:
            current.shown = key  # the same lamps would fail the same way
            if current.error != str(error):
                current.error = str(error)
                print(f"Lightpanes: {error}")
            return False
    finally:
        _lock.release()


def check_stale(context: bpy.types.Context) -> tuple[str, ...]:
    """Sentences that name the objects and baked-in lamps which changed since the bake; empty while it is valid."""
    scene = context.scene
    current, meta = sessions.of(scene), store.read_meta(scene)
    if current is None or meta is None or "fingerprint" not in meta:
        return ()
    shining = lamps.read_lights(context.evaluated_depsgraph_get(), [])
    now = extract.fingerprint(context)
    if not extract.changed_objects(meta["fingerprint"], now) and not meshes.in_edit_mode():
        current.read_again()
    look_again(scene, now)
    current.stale = stale.of_objects(meta["fingerprint"], now) + _follow(context, current, meta, now)
    if meta.get("world", environment.digest(scene.world)) != environment.digest(scene.world):
        current.stale += ("The world was changed since the bake; bake again.",)
    current.stale += stale.of_lamps(current.static, current.panes, shining)
    return current.stale


def look_again(scene: bpy.types.Scene, now: dict[str, str], of_caustics: bool = False) -> None:
    """Drop what was worked out of other surfaces than these (`extract.fingerprint`). of_caustics: of theirs alone."""
    if (current := sessions.of(scene)) is not None:
        current.read = None
    caustics.look_again(scene, now)
    if not of_caustics:
        direct.look_again(scene, now)


def _follow(context, current: sessions.Session, meta: dict, now: dict[str, str]) -> tuple[str, ...]:
    """Let the points follow what has moved, and say how far; the scene is read only where it differs from last time."""
    if points.mesh_of(context.scene) is None:
        return ()
    key = repr(sorted(now.items()))
    if key == current.followed:
        return current.moved
    if extract.changed_objects(meta["fingerprint"], now):
        with paused():
            try:
                surfaces = extract.extract(context, resolution=16, looks=False)
            except SceneError:
                return ()  # everything is hidden or broken, which the other sentences say
    else:
        surfaces = None
    current.followed, current.moved = key, points.follow(context.scene, meta, surfaces)
    return current.moved


def _read_lights(depsgraph, current: sessions.Session, rendering: bool = False) -> tuple[Light, ...]:
    """The lamps that a render or a viewport shows; those that are not live as they were when last shown, and those
    that are baked in not at all."""
    scene, layer, hidden = depsgraph.scene.original, depsgraph.view_layer.name, set()
    owners: dict[str, bpy.types.Object] = {}
    if rendering or not _is_viewport(depsgraph):
        # a render's own depsgraph holds what the viewport hides; a window has nothing to show such lamps for
        asleep = bpy.app.background and depsgraph.mode == "VIEWPORT"
        with visibility.awake(scene.view_layers[layer]) if asleep else nullcontext():
            shining = lamps.read_lights(depsgraph, [], owners)
    else:
        shining, hidden = lamps.read_lights(depsgraph, [], owners), _hidden_lamps(scene, layer)
    lights = []
    current.owners = owners
    for light in shining:
        if light.name not in hidden and light.name not in current.static:
            shown = replace(light, live=True)
            lights.append(shown if light.live else current.last.get(light.name, shown))
    return tuple(lights)


def _is_viewport(depsgraph) -> bool:
    """Whether somebody looks at a viewport, where a hidden lamp is a lamp that is off."""
    return depsgraph.mode == "VIEWPORT" and not bpy.app.background


def _hidden_lamps(scene, view_layer: str) -> set[str]:
    layer = scene.view_layers[view_layer]
    return {item.name for item in scene.objects if item.type == "LIGHT" and not item.visible_get(view_layer=layer)}


def _apply(context, scene, current: sessions.Session, lights):
    relighter = sessions.relighter_of(context, current)
    sessions.focus(scene, current, relighter)
    begin = time.perf_counter()
    light = relighter.light(lights)
    if relighter.panes.shown is not None:
        points.show(scene, relighter.rows(light))
    told = vertices.show(scene, relighter.vertices(light))
    current.wrote_meshes = relighter.panes.vertices is not None
    current.owes = any(item.data.is_editmode for item in vertices.lit(scene))
    store.write_irradiance(scene, relighter.image(light))
    current.milliseconds = 1000 * (time.perf_counter() - begin)
    current.doubts = doubts.sentences(relighter, lights, current.expected)
    current.shown = lamp_key(lights)
    for other in sessions.every():
        if other is not current and other.key == current.key:
            # of a copy of the scene, which shows the same image
            other.shown = ""
    current.last = {light.name: light for light in lights}
    current.error = ""
    if told:
        raise SceneError(" ".join(told))


def _apply_direct(context, scene, current: sessions.Session, lights, at_once: bool = True) -> bool:
    """Whether the lamps' direct light is baked and had to change."""
    try:
        if not direct.is_baked(scene):
            return False
        asked = direct.ask(scene, lights, current.baked_in, current.owners)
        return direct.update(context, scene, asked, lambda: sessions.surfaces_of(context, current), at_once)
    finally:
        # they fill memory, and soon are others
        current.read = None


def _apply_caustics(context, scene, current: sessions.Session, lights, at_once: bool = True) -> bool:
    """Whether the lamps' light is focused by anything, and that had to change."""
    if not caustics.is_baked(scene):
        # what was glass is none any more
        caustics.drop(scene)
        return False
    asked = caustics.ask(scene, lights, current.baked_in)
    return caustics.update(context, scene, asked, lambda: sessions.shapes_of(context, current), at_once)


def bounce(scene: bpy.types.Scene) -> None:
    """After caustics were worked out beside Blender: let the light bounce from where it falls now."""
    current = sessions.begun(scene)
    # whoever has the lock asks for them at once
    if current is None or current.relighter is None or not _lock.acquire(blocking=False):
        return
    try:
        landed = caustics.landed(scene)
        if landed.key != current.landed and scene == bpy.context.scene:
            _apply(bpy.context, scene, current, tuple(current.last.values()))
    except (SceneError, BakeError) as error:
        current.error = str(error)
        print(f"Lightpanes: {error}")
    finally:
        _lock.release()


def switch_caustics(context: bpy.types.Context, scene: bpy.types.Scene) -> None:
    """After `scene.lightpanes.caustics` was set: bring caustics into the bake, or take them out."""
    current = sessions.of(scene)
    if current is None:
        return
    with _lock:
        _switch_caustics(scene, current)
    if scene == context.scene:
        # also where nothing follows the lamps: glass that is shadowed without its caustics is no state to stay in
        update(scene, context.evaluated_depsgraph_get(), asked=True)
    areas.redraw_panel()


def _switch_caustics(scene, current: sessions.Session) -> None:
    if current.focuses != scene.lightpanes.caustics:
        # glass blocks lamps where caustics are on
        current.focuses = scene.lightpanes.caustics
        current.relighter, current.read, current.shown = None, None, ""
        direct.forget_surfaces(scene)
    if not scene.lightpanes.caustics:
        caustics.end(scene)


def switch_direct(context: bpy.types.Context, scene: bpy.types.Scene) -> None:
    """After `scene.lightpanes.direct` was set: bring the lamps' direct light into the bake, or take it out."""
    current = sessions.of(scene)
    if current is None:
        return
    with _lock:
        try:
            if scene.lightpanes.direct == "OFF":
                direct.end(scene)
            elif scene == context.scene and engine.ready():
                lights = _read_lights(context.evaluated_depsgraph_get(), current)
                _apply_direct(context, scene, current, lights)
        except (SceneError, BakeError) as error:
            current.error = str(error)
            print(f"Lightpanes: {error}")
    areas.redraw_panel()


def prepare_render(scene: bpy.types.Scene) -> None:
    """Show what a render is to show: lamps that the viewport may hide, and direct light in full."""
    if direct.is_baked(scene):
        with _lock:
            direct.finish(scene)
            direct.link(scene)
    caustics.finish(scene)
    if not scene.lightpanes.live or scene != bpy.context.scene:
        return
    with _lock:
        current = sessions.of(scene)
        if current is None:
            return
        try:
            lights = _read_lights(bpy.context.evaluated_depsgraph_get(), current, rendering=True)
            if engine.ready():
                focused = _apply_caustics(bpy.context, scene, current, lights)
                if focused or lamp_key(lights) != current.shown:
                    _apply(bpy.context, scene, current, lights)
                _apply_direct(bpy.context, scene, current, lights)
        except (SceneError, BakeError) as error:
            current.error = str(error)
            print(f"Lightpanes: {error}")


def undone(scene: bpy.types.Scene) -> None:
    """Undo brings back an image's packed pixels or keeps its last ones: neither need be what the lamps now ask for."""
    for current in sessions.every():
        current.shown = current.followed = ""
        current.read_again()
        current.error = ""
    live_image.undone()
    if sessions.of(scene) is not None and not direct.is_baked(scene):
        direct.end(scene)
    if (current := sessions.of(scene)) is not None:
        _switch_caustics(scene, current)
    update(scene, bpy.context.evaluated_depsgraph_get())
