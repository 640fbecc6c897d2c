"""The operators: thin drivers of addon/baking.py and addon/relight.py."""

from __future__ import annotations

import bpy

from ..core.bake import BakeError
from ..core.scene import SceneError
from . import animation, areas, baking, engine, job, relight, sessions, waiting
from .console import ConsoleProgress

# Seconds between two looks at a bake that runs.
TICK = 0.05


class LIGHTPANES_OT_bake(bpy.types.Operator):
    bl_idname = "lightpanes.bake"
    bl_label = "Bake"
    bl_description = "Bake how this scene passes light around, so that its indirect light can follow the lamps"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        reason = engine.unusable()
        if reason is None and context.mode != "OBJECT":
            reason = "Leave edit mode first"
        if reason is None and job.running():
            reason = "A bake is running"
        if reason is None and animation.running():
            reason = "An animation is being written"
        if reason is None and waiting.renders():
            reason = "Wait until the render is done"
        if reason is not None:
            cls.poll_message_set(reason)
        return reason is None

    def invoke(self, context, _event):
        if bpy.app.background or context.window is None:
            return self.execute(context)
        self.job = job.start(context)
        self.shown = None
        self.timer = context.window_manager.event_timer_add(TICK, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type == "ESC" and event.value == "PRESS":
            self.job.cancel()
        elif event.type != "TIMER":
            return {"PASS_THROUGH"}
        try:
            if not self.job.advance():
                self._show(context)
                return {"PASS_THROUGH"}
        except BaseException:
            self._leave(context)
            raise
        self._leave(context)
        if self.job.report is None:
            if self.job.error:
                self.report({"ERROR"}, self.job.error)
            else:
                self.report({"INFO"}, "Cancelled; what was there before stays")
            return {"CANCELLED"}
        self._tell(self.job.report)
        return {"FINISHED"}

    def cancel(self, context):
        """Blender ends the operator: the window or the file is closed."""
        self.job.cancel()
        self._leave(context)

    def execute(self, context):
        if job.running():
            self.report({"ERROR"}, "A bake is running; wait for it, or cancel it")
            return {"CANCELLED"}
        try:
            with ConsoleProgress(context.window_manager) as progress:
                report = baking.bake_scene(context, progress)
            job.forget()
        except (SceneError, BakeError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self._tell(report)
        return {"FINISHED"}

    def _tell(self, report):
        for warning in report["warnings"]:
            self.report({"WARNING"}, warning)
        self.report({"INFO"}, summary(report))

    def _show(self, context):
        if self.job.says == self.shown:
            return
        self.shown = self.job.says
        if context.workspace is not None:
            context.workspace.status_text_set(f"Lightpanes: {self.shown}    Esc: Cancel")
        areas.redraw_panel()

    def _leave(self, context):
        context.window_manager.event_timer_remove(self.timer)
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        areas.redraw_panel()


class LIGHTPANES_OT_cancel(bpy.types.Operator):
    bl_idname = "lightpanes.cancel"
    bl_label = "Cancel"
    bl_description = "Stop the bake that is running. What was there before stays, and baking again goes on from here"

    @classmethod
    def poll(cls, _context):
        return job.running()

    def execute(self, _context):
        job.cancel()
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
        current = sessions.of(context.scene)
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
        return context.mode == "OBJECT" and not job.running()

    def execute(self, context):
        job.forget()
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


CLASSES = (LIGHTPANES_OT_bake, LIGHTPANES_OT_cancel, LIGHTPANES_OT_relight, LIGHTPANES_OT_clear)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
