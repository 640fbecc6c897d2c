"""Before a bake: what it will hold, what it will take, and what stands in its way.

`check` is what a bake asks first; `inspect` is the same for the panel, from counts and settings alone, and remembered
until something changes, so that drawing costs nothing.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import bpy
from bpy.app.handlers import persistent

from ..core.scene import SceneError
from . import areas, foreign, glassware, handlers, obstacles, store, twice
from .forecast import Forecast, predict, shortage
from .obstacles import ERROR, Facts, Obstacle

REST = 20.0
"""Seconds for each second that looking took, before a scene that keeps changing is looked at again."""

LONGEST_REST = 2.0  # s

# Errors that the button's own rules or the atlas, which knows more, turn into a refusal.
FOR_THE_PANEL = {"NO_RECEIVER", "OTHER_MODE"}


@dataclass(frozen=True)
class Findings:
    """objects: that get light, of which at_vertices do at their vertices. excluded: by the user. blockers: all that
    render and block and reflect light only, those excluded among them. lamps: names of all; live, static: of those that
    render. forecast: None where nothing can be baked. can_give_back: whether Clear has something to undo beside a bake."""

    objects: int
    at_vertices: int
    excluded: int
    blockers: int
    lamps: tuple[str, ...]
    live: int
    static: int
    forecast: Forecast | None
    obstacles: tuple[Obstacle, ...]
    can_give_back: bool


@dataclass
class _Held:
    key: tuple
    findings: Findings
    rest_until: float


_held: dict[int, _Held] = {}
_changes = 0


def check(context: bpy.types.Context) -> list[str]:
    """Warnings that only matter before a bake; raises SceneError when there is nothing to bake or it can't begin."""
    facts = Facts(context)
    found = obstacles.find(facts)
    for obstacle in found:
        if obstacle.severity == ERROR and obstacle.kind not in FOR_THE_PANEL:
            raise SceneError(obstacle.sentence)
    if sentence := shortage(facts):
        raise SceneError(sentence)
    # the bake itself says the others, knowing modifiers
    return [obstacle.sentence for obstacle in found if obstacle.kind == "NO_LAMP"]


def inspect(context: bpy.types.Context) -> Findings:
    """`examine`, remembered until the scene changes, and a while longer where looking takes long."""
    scene = context.scene
    key, held = _key(context), _held.get(scene.session_uid)
    now = time.perf_counter()
    if held is not None and held.key == key:
        return held.findings
    if held is not None and now < held.rest_until:
        _redraw_later(held.rest_until - now)
        return held.findings
    findings = examine(context)
    took = time.perf_counter() - now
    _held[scene.session_uid] = _Held(key, findings, now + took + min(REST * took, LONGEST_REST))
    return findings


def examine(context: bpy.types.Context) -> Findings:
    """Look at the scene anew. Nothing is evaluated or rendered."""
    facts = Facts(context)
    found = [*obstacles.find(facts), *twice.find(facts), *glassware.find(facts)]
    if facts.receivers and (sentence := shortage(facts)):
        found.insert(0, Obstacle("MEMORY", ERROR, sentence))
    blocked = any(obstacle.severity == ERROR for obstacle in found) or not facts.receivers
    live = sum(item.data.lightpanes.live for item in facts.lamps)
    return Findings(
        objects=len(facts.receivers),
        at_vertices=len(facts.at_vertices),
        excluded=sum(item.lightpanes.exclude for item in facts.shown),
        blockers=len(facts.shown) - len(facts.receivers),
        lamps=tuple(item.name for item in facts.all_lamps),
        live=live,
        static=len(facts.lamps) - live,
        forecast=None if blocked else predict(facts),
        obstacles=tuple(found),
        can_give_back=twice.is_changed(facts.scene)
        or any(item.library is None for item in foreign.carriers(facts.scene)),
    )


def forget() -> None:
    """Look anew when next asked: something has changed that Blender doesn't report."""
    _held.clear()


def _key(context) -> tuple:
    """Differs where findings may. What depsgraph updates report is counted; of these things they say nothing."""
    scene = context.scene
    asked, cycles = scene.lightpanes, getattr(scene, "cycles", None)
    playing = context.screen is not None and context.screen.is_animation_playing
    item = context.object
    return (
        _changes,
        # renaming an attribute is no update either
        tuple(item.data.attributes.keys()) if item is not None and item.type == "MESH" else None,
        None if playing else scene.frame_current,
        context.mode,
        context.view_layer.name,
        scene.render.engine,
        asked.error_target,
        asked.time_budget,
        asked.memory_budget,
        asked.resolution,
        asked.exits,
        asked.cycles,
        asked.direct,
        asked.caustics,
        asked.photons,
        store.bake_key(scene),
        twice.only_darkens(scene.eevee),
        scene.eevee.use_raytracing,
        cycles and (cycles.diffuse_bounces, cycles.use_fast_gi, cycles.caustics_reflective, cycles.caustics_refractive),
    )


def _redraw_later(seconds: float) -> None:
    if not bpy.app.background and not bpy.app.timers.is_registered(areas.redraw_panel):
        bpy.app.timers.register(areas.redraw_panel, first_interval=seconds)


@persistent
def _on_change(*_):
    global _changes
    _changes += 1


@persistent
def _on_load(*_):
    forget()


HANDLERS = {
    "depsgraph_update_post": _on_change,
    "undo_post": _on_change,
    "redo_post": _on_change,
    "load_post": _on_load,
}


def register() -> None:
    handlers.add(HANDLERS)


def unregister() -> None:
    handlers.remove(HANDLERS)
    if bpy.app.timers.is_registered(areas.redraw_panel):
        bpy.app.timers.unregister(areas.redraw_panel)
    forget()
