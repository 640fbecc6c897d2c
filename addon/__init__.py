"""Lightpanes inside Blender: reads the scene into core's types, calls core, writes the results back."""

from __future__ import annotations

import atexit

from . import (
    animation,
    beside,
    commands,
    fixes,
    following,
    job,
    operators,
    overlay,
    panel,
    preferences,
    preflight,
    properties,
    refresh,
    render,
    render_panel,
    saving,
    translations,
)

MODULES = (
    preferences, properties, operators, job, animation, fixes, saving, preflight, panel, translations, following, beside,
    refresh, overlay, render, render_panel, commands,
)  # fmt: skip

_registered = False


def register() -> None:
    """Add settings, operators, panels, handlers and the command; doing it twice does no harm."""
    global _registered
    if _registered:
        return
    for module in MODULES:
        module.register()
    _registered = True
    # The pip bpy of 4.5 hangs at exit while handlers of ours are registered.
    atexit.register(unregister)


def unregister() -> None:
    """Take all of it out again."""
    global _registered
    if not _registered:
        return
    _registered = False
    atexit.unregister(unregister)
    for module in reversed(MODULES):
        module.unregister()
