"""Makes Cycles read an image again whose pixels have changed.

A render that keeps its data (Persistent Data) knows images by their settings. Before Blender 5.2 it takes new pixels of
one only where a setting is new, too; `update_tag` is not enough. An opaque image looks the same in all its alpha modes,
so these serve: each change takes another one, and never that of the last render.
"""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from . import handlers

MODES = ("CHANNEL_PACKED", "NONE", "STRAIGHT", "PREMUL")

# Image's session_uid → alpha mode in which the last render has read it.
_rendered: dict[int, str] = {}


def renew(image: bpy.types.Image) -> None:
    """Call it before new pixels are written to an opaque image."""
    if bpy.app.version < (5, 2):
        used = {image.alpha_mode, _rendered.get(image.session_uid)}
        image.alpha_mode = next(mode for mode in MODES if mode not in used)


@persistent
def _on_rendered(*_):
    from . import store

    for image in bpy.data.images:
        if image.get(store.TAG) in {store.IRRADIANCE, store.DIRECT, store.CAUSTICS}:
            _rendered[image.session_uid] = image.alpha_mode


@persistent
def _on_load(*_):
    _rendered.clear()


HANDLERS = {"render_post": _on_rendered, "render_cancel": _on_rendered, "load_post": _on_load}


def register() -> None:
    handlers.add(HANDLERS)


def unregister() -> None:
    handlers.remove(HANDLERS)
    _rendered.clear()
