"""Blender's application handlers, by the names of their events in `bpy.app.handlers`."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import bpy


def add(handlers: Mapping[str, Callable]) -> None:
    """Call each function at its event."""
    for event, handler in handlers.items():
        getattr(bpy.app.handlers, event).append(handler)


def remove(handlers: Mapping[str, Callable]) -> None:
    """Call them no more; those that are gone already do no harm."""
    for event, handler in handlers.items():
        listed = getattr(bpy.app.handlers, event)
        if handler in listed:
            listed.remove(handler)
