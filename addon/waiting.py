"""What a bake waits for before it touches the scene: Blender lends its meshes to modes, and its data to renders."""

from __future__ import annotations

import bpy

from .meshes import in_edit_mode


def renders() -> bool:
    """Whether a render runs, in a window; it reads what a bake would write."""
    return bpy.app.is_job_running("RENDER")


def reason() -> str:
    """What to wait for just now, for the user; "" for nothing.

    A mesh in Edit Mode holds no attributes, and one whose topology changes under a brush is made anew afterwards.
    """
    if renders():
        return "Waiting for the render"
    if in_edit_mode():
        return "Waiting for you to leave Edit Mode"
    if any(item.mode == "SCULPT" and item.use_dynamic_topology_sculpting for item in bpy.data.objects):
        return "Waiting for you to leave Sculpt Mode"
    return ""
