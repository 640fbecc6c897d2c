"""The areas of Blender's windows that show what is ours, and asking for them to be drawn anew."""

from __future__ import annotations

import bpy


def redraw_panel() -> None:
    """Draw all Properties editors anew."""
    _redraw("PROPERTIES")


def redraw_viewports() -> None:
    """Draw all 3D viewports anew."""
    _redraw("VIEW_3D")


def _redraw(kind: str) -> None:
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == kind:
                area.tag_redraw()
