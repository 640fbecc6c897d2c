"""Cycles is an add-on, which the user may have switched off: its settings are then missing from every data-block."""

from __future__ import annotations

import bpy

from ..core.scene import SceneError


def setting(owner: bpy.types.ID, name: str, default):
    """A setting of Cycles' own of a scene, lamp or material; the default where there is none."""
    return getattr(getattr(owner, "cycles", None), name, default)


def require(what: str) -> None:
    """Raise SceneError where Cycles is switched off. what: needs it, as in "This thing needs"."""
    if not hasattr(bpy.types.Scene, "cycles"):
        raise SceneError(f"{what} Cycles: turn on the add-on Cycles Render Engine in Preferences.")
