"""Calls `relight` when something happens that light may follow: an edit, a frame, a render, undo, saving."""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from . import areas, caustics, direct, extract, handlers, meshes, relight, sessions, store, waiting

STALE_DELAY = 0.5
"""Seconds after the last edit of a mesh at which the bake is checked against it."""


@persistent
def _on_update(scene, depsgraph):
    if store.bake_key(scene) is None:
        return
    if bpy.app.background:
        worked = direct.is_baked(scene) or caustics.is_baked(scene)
        if worked and any(_may_stale(scene, sessions.of(scene), change) for change in depsgraph.updates):
            relight.look_again(scene, extract.fingerprint(bpy.context))
        relight.update(scene, depsgraph)
        return
    # One relight for all that happens before Blender is idle again.
    if not bpy.app.timers.is_registered(_update_later):
        bpy.app.timers.register(_update_later, first_interval=0.0)
    current = sessions.of(scene)
    edits = [change for change in depsgraph.updates if _may_stale(scene, current, change)]
    current.wrote_meshes = False
    if any(caustics.can_follow(scene, change.id) for change in edits):
        _follow_glass_later()
    if edits:
        if bpy.app.timers.is_registered(_stale_later):
            bpy.app.timers.unregister(_stale_later)
        bpy.app.timers.register(_stale_later, first_interval=STALE_DELAY)


def _may_stale(scene: bpy.types.Scene, current: sessions.Session, change) -> bool:
    """Whether a change can make the bake stale: to an object's shape or place, to the world, or to a lamp that is
    baked in."""
    lamp = isinstance(change.id, bpy.types.Light) or (
        isinstance(change.id, bpy.types.Object) and change.id.type == "LIGHT"
    )
    if lamp:
        return bool(current.static) or not current.panes
    if isinstance(change.id, bpy.types.World):
        return True
    if isinstance(change.id, bpy.types.Material):
        return caustics.concerns(scene, change.id.original)
    if not isinstance(change.id, bpy.types.Object) or store.TAG in change.id:
        return False
    own = current.wrote_meshes and meshes.AT_VERTICES in change.id
    # shading also says that something was hidden from renders or casts no shadow any more
    return change.is_updated_transform or ((change.is_updated_geometry or change.is_updated_shading) and not own)


def _follow_glass_later():
    """Caustics need not wait until what casts them rests."""
    if not bpy.app.timers.is_registered(_glass_later):
        bpy.app.timers.register(_glass_later, first_interval=0.0)


def _glass_later():
    if not waiting.renders() and not meshes.in_edit_mode():
        context = bpy.context
        relight.look_again(context.scene, extract.fingerprint(context), of_caustics=True)
        _update_later()


def _update_later():
    if waiting.renders():
        return  # the render's own frame changes relight
    depsgraph = bpy.context.evaluated_depsgraph_get()
    relight.update(depsgraph.scene.original, depsgraph, at_once=False)
    areas.redraw_panel()
    areas.redraw_viewports()


def _stale_later():
    if not waiting.renders():
        relight.check_stale(bpy.context)
        # the direct light of what has moved
        _update_later()


@persistent
def _on_frame(scene, depsgraph):
    relight.update(scene, depsgraph)


@persistent
def _on_render(scene, *_):
    relight.prepare_render(scene)


@persistent
def _on_rendered(*_):
    if not bpy.app.background and not bpy.app.timers.is_registered(_update_later):
        bpy.app.timers.register(_update_later, first_interval=0.1)


@persistent
def _on_undo(scene, *_):
    relight.undone(scene)


@persistent
def _on_load(*_):
    sessions.stop()


@persistent
def _on_save(*_):
    for scene in bpy.data.scenes:
        direct.finish(scene)
        caustics.finish(scene)
        if direct.is_baked(scene):
            # what names baked objects would keep deleted ones in the file
            direct.link(scene)
    sessions.pack()


HANDLERS = {
    "depsgraph_update_post": _on_update,
    "frame_change_post": _on_frame,
    "render_init": _on_render,
    "render_complete": _on_rendered,
    "render_cancel": _on_rendered,
    "undo_post": _on_undo,
    "redo_post": _on_undo,
    "load_post": _on_load,
    "save_pre": _on_save,
}


def register() -> None:
    handlers.add(HANDLERS)


def unregister() -> None:
    handlers.remove(HANDLERS)
    for timer in (_update_later, _stale_later, _glass_later):
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)
    sessions.stop()
