"""The operators: thin drivers of addon/baking.py and addon/relight.py."""

from __future__ import annotations

import bpy

from ..core.bake import BakeError
from ..core.scene import SceneError
from . import baking, relight

# Where the console progress stands: a line for each stage and each tenth.
STEP = 0.1


class ConsoleProgress:
    """Progress as lines on the console and, in a window, as the cursor's number."""

    def __init__(self, window_manager):
        self.window_manager = window_manager
        self.stage, self.tenth = "", -1

    def __enter__(self):
        self.window_manager.progress_begin(0, 100)
        return self

    def __exit__(self, *_):
        self.window_manager.progress_end()

    def __call__(self, progress) -> None:
        self.window_manager.progress_update(100 * progress.fraction)
        tenth = int(progress.fraction / STEP)
        if progress.stage != self.stage or tenth != self.tenth:
            self.stage, self.tenth = progress.stage, tenth
            print(f"Lightpanes: {100 * progress.fraction:3.0f} %  {progress.stage}")


class LIGHTPANES_OT_bake(bpy.types.Operator):
    bl_idname = "lightpanes.bake"
    bl_label = "Bake"
    bl_description = "Bake how this scene passes light around, so that its indirect light can follow the lamps"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave edit mode first")
            return False
        return True

    def execute(self, context):
        try:
            with ConsoleProgress(context.window_manager) as progress:
                report = baking.bake_scene(context, progress)
        except (SceneError, BakeError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        for warning in report["warnings"]:
            self.report({"WARNING"}, warning)
        self.report({"INFO"}, summary(report))
        return {"FINISHED"}


class LIGHTPANES_OT_relight(bpy.types.Operator):
    bl_idname = "lightpanes.relight"
    bl_label = "Relight"
    bl_description = "Bring the baked light up to date with all live lamps"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context):
        try:
            milliseconds = relight.relight(context)
        except (SceneError, BakeError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        current = relight.session(context.scene)
        for sentence in current.stale:
            self.report({"WARNING"}, sentence)
        self.report({"INFO"}, f"Relit in {milliseconds:.1f} ms")
        return {"FINISHED"}


class LIGHTPANES_OT_clear(bpy.types.Operator):
    bl_idname = "lightpanes.clear"
    bl_label = "Clear"
    bl_description = "Delete this scene's bake and give its materials back as they were"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        return context.mode == "OBJECT"

    def execute(self, context):
        if not baking.clear_scene(context):
            self.report({"INFO"}, "There was no bake to clear")
        return {"FINISHED"}


def summary(report: dict) -> str:
    """One line about a bake."""
    parts = [f"Baked in {report.get('total_seconds', 0):.1f} s"]
    if report.get("error") is not None:
        parts.append(f"error {100 * report['error']:.1f} %")
    if "relight_ms" in report:
        parts.append(f"relights in {report['relight_ms']:.1f} ms")
    return ", ".join(parts)


CLASSES = (LIGHTPANES_OT_bake, LIGHTPANES_OT_relight, LIGHTPANES_OT_clear)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
