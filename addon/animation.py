"""The operator `lightpanes.bake_animation`: a thin driver of addon/sequence.py, and how far it is."""

from __future__ import annotations

import time
import weakref
from pathlib import Path

import bpy
from bpy.props import BoolProperty, IntProperty, StringProperty

from ..core.bake import BakeError, Progress
from ..core.scene import SceneError
from . import job, live_image, saving, sequence, waiting
from .console import ConsoleProgress

SLICE = 0.1
"""Seconds of work between two looks at the keyboard."""

# The steps that a window works through. They belong to the operator and go with it, whatever ends it.
_steps = None
_fraction = 0.0


def running() -> bool:
    """Whether a window is writing an animation."""
    return _steps is not None and _steps() is not None


def progress() -> float:
    """How far it is, in [0, 1]; 0 while none is being written."""
    return _fraction if running() else 0.0


class LIGHTPANES_OT_bake_animation(bpy.types.Operator):
    bl_idname = "lightpanes.bake_animation"
    bl_label = "Bake Animation"
    bl_description = "Write the baked light of each frame to an image, for engines that play textures"
    bl_options = {"REGISTER"}

    directory: StringProperty(
        name="Folder",
        description="Where the images go; // is the folder of the .blend",
        subtype="DIR_PATH",
        default=f"//{sequence.FOLDER}/",
        options=saving.RELATIVE,
    )
    frame_start: IntProperty(name="Start", description="First frame; the scene's if not given", options={"SKIP_SAVE"})
    frame_end: IntProperty(name="End", description="Last frame; the scene's if not given", options={"SKIP_SAVE"})
    frame_step: IntProperty(
        name="Step", description="Frames from one to the next; the scene's if not given", min=1, options={"SKIP_SAVE"}
    )

    groups: BoolProperty(name="By Group", description=saving.BY_GROUP)

    @classmethod
    def poll(cls, context):
        if running():
            cls.poll_message_set("An animation is being written already")
        elif job.running():
            cls.poll_message_set("A bake is running")
        elif waiting.renders():
            cls.poll_message_set("Wait until the render is done")
        else:
            return True
        return False

    def execute(self, context):
        try:
            with ConsoleProgress(context.window_manager) as tell:
                manifest = sequence.write(context, *self._asked(context), tell, self.groups)
        except (SceneError, BakeError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return self._done(manifest)

    def invoke(self, context, event):
        global _steps
        if bpy.app.background:
            return self.execute(context)
        try:
            # the context that operators get may be gone at the next step
            self._steps = sequence.writing(bpy.context, *self._asked(context), self.groups)
            step = next(self._steps)
        except (SceneError, BakeError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        _steps = weakref.ref(self._steps)
        self._tell = ConsoleProgress(context.window_manager)
        self._tell.__enter__()
        self._show(context, step)
        self._timer = context.window_manager.event_timer_add(0.01, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type == "ESC" and event.value == "PRESS":
            self.cancel(context)
            self.report({"WARNING"}, "Cancelled; nothing was written")
            return {"CANCELLED"}
        if event.type != "TIMER":
            # whatever else the user could do now might change what is being written
            return {"RUNNING_MODAL"}
        # handed on, for others wait for timers, too
        until = time.perf_counter() + SLICE
        try:
            while time.perf_counter() < until:
                step = next(self._steps)
            self._show(context, step)
        except StopIteration as done:
            self.cancel(context)
            return self._done(done.value)
        except (SceneError, BakeError) as error:
            self.cancel(context)
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        except ReferenceError:
            # undo and opening a file, by a script or in another window, leave nothing of what was read
            self.cancel(context)
            self.report({"ERROR"}, "The scene was exchanged while its animation was being written; start again")
            return {"CANCELLED"}
        except BaseException:
            self.cancel(context)
            raise
        return {"PASS_THROUGH"}

    def cancel(self, context):
        """Also called by Blender, when the window closes."""
        global _steps
        self._steps.close()
        _steps = None
        context.window_manager.event_timer_remove(self._timer)
        self._tell.__exit__()
        context.workspace.status_text_set(None)
        live_image.redraw()

    def _asked(self, context) -> tuple[Path, range]:
        given = [
            getattr(self, name) if self.properties.is_property_set(name) else None
            for name in ("frame_start", "frame_end", "frame_step")
        ]
        return sequence.folder_of(self.directory), sequence.frames_of(context.scene, *given)

    def _show(self, context, step: Progress) -> None:
        global _fraction
        _fraction = step.fraction
        self._tell(step)
        context.workspace.status_text_set(f"Writing the baked light: {100 * step.fraction:.0f} %   Esc: stop")
        live_image.redraw()

    def _done(self, manifest: dict):
        for warning in manifest["warnings"]:
            self.report({"WARNING"}, warning)
        self.report({"INFO"}, f"Wrote {len(manifest['frames'])} frames to '{sequence.folder_of(self.directory)}'")
        return {"FINISHED"}


def register() -> None:
    bpy.utils.register_class(LIGHTPANES_OT_bake_animation)


def unregister() -> None:
    bpy.utils.unregister_class(LIGHTPANES_OT_bake_animation)
