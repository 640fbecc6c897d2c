"""The add-on's preferences: how many threads bakes and relights may use."""

from __future__ import annotations

import bpy
from bpy.props import IntProperty

from ..core import threads
from . import preflight

ADDON = __package__.rpartition(".")[0]
"""By this name Blender keeps the preferences: the whole extension's, not this folder's."""


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

    def draw(self, _context):
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        self.layout.prop(self, "threads")


def register() -> None:
    bpy.utils.register_class(LightpanesPreferences)
    # the pip bpy registers us without an entry among its add-ons
    addon = bpy.context.preferences.addons.get(ADDON)
    if addon is not None and addon.preferences is not None:
        threads.use_threads(addon.preferences.threads)


def unregister() -> None:
    threads.use_threads(0)
    bpy.utils.unregister_class(LightpanesPreferences)
