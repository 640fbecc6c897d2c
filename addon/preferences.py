"""The add-on's preferences: how many threads bakes and relights may use, and where cancelled bakes are kept."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.props import FloatProperty, IntProperty, StringProperty

from ..core import threads
from ..core.bake import Cache
from . import preflight

ADDON = __package__.rpartition(".")[0]
"""By this name Blender keeps the preferences: the whole extension's, not this folder's."""


GB = 10**9


def _default_folder() -> str:
    """In the user's files of this extension; "" where Lightpanes is none, as in the pip bpy."""
    try:
        return bpy.utils.extension_path_user(ADDON, path="cache")
    except (AttributeError, ValueError):
        return ""


def _threads_changed(preferences, _context):
    threads.use_threads(preferences.threads)
    # more threads, less time
    preflight.forget()


class LightpanesPreferences(bpy.types.AddonPreferences):
    bl_idname = ADDON

    threads: IntProperty(
        name="Threads",
        description="Threads that bakes and relights may use, 0 for all cores. Fewer leave Blender more room; "
        "the result is the same",
        default=0,
        min=0,
        max=threads.MOST_THREADS,
        update=_threads_changed,
    )
    cache_folder: StringProperty(
        name="Cache Folder",
        description="Where cancelled bakes keep what they had finished, so that baking goes on from there after Blender "
        "was closed. Empty: in memory only",
        default=_default_folder(),
        subtype="DIR_PATH",
    )
    cache_size: FloatProperty(
        name="Cache Size",
        description="Gigabytes that the cache folder may hold. What was used least recently is deleted first",
        default=2.0,
        min=0.05,
        soft_max=50.0,
        precision=1,
    )

    def draw(self, _context):
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        self.layout.prop(self, "threads")
        self.layout.prop(self, "cache_folder")
        row = self.layout.row()
        row.active = bool(self.cache_folder.strip())
        row.prop(self, "cache_size")


def cache() -> Cache | None:
    """Where cancelled bakes are kept; None for nowhere but in memory."""
    settings = _settings()
    folder = settings.cache_folder.strip() if settings is not None else ""
    # preferences are beside no .blend
    if not folder or folder.startswith("//"):
        return None
    return Cache(Path(folder).expanduser().absolute(), int(settings.cache_size * GB))


def _settings() -> LightpanesPreferences | None:
    """None where Blender keeps none: the pip bpy registers us without an entry among its add-ons."""
    addon = bpy.context.preferences.addons.get(ADDON)
    return addon.preferences if addon is not None else None


def register() -> None:
    bpy.utils.register_class(LightpanesPreferences)
    settings = _settings()
    if settings is not None:
        threads.use_threads(settings.threads)


def unregister() -> None:
    threads.use_threads(0)
    bpy.utils.unregister_class(LightpanesPreferences)
