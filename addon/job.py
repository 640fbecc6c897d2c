"""The bake that runs while Blender stays free: steps of it on a timer, core's work on a thread.

One bake runs at a time. Cancelling lets go of the thread at once, which ends at its next report; what it had finished
is kept, in the cache folder too, and the next bake of the same scene with the same settings goes on from there.
"""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Generator

import bpy
from bpy.app.handlers import persistent
from bpy.app.translations import pgettext_iface as iface_

from ..core.bake import Cancelled, Kept, Progress
from ..core.scene import SceneError
from . import figures, handlers, waiting
from .unfolded import CHANGED
from .work import Work

SLICE = 0.03
"""s that steps on the main thread may take before Blender gets a turn; a step once begun is not interrupted."""


class _Thread(threading.Thread):
    """Runs one Work and keeps its result or its exception."""

    def __init__(self, work: Work, job: Job):
        super().__init__(name="Lightpanes", daemon=True)
        self.run_work, self.alone, self.job = work.run, work.alone, job
        self.result: object = None
        self.error: BaseException | None = None

    def run(self) -> None:
        try:
            self.result = self.run_work(self._told)
        except BaseException as error:
            self.error = error
        # with what it was made of
        del self.run_work
        if self.job.ended:
            self.result = None

    def _told(self, progress: Progress) -> None:
        if self.job.ended:
            raise Cancelled
        self.job.progress = progress


class Job:
    """Drives the steps of one bake.

    Read `progress` and `waiting`, what it waits for, at any time; call `advance` again and again on the main thread until
    it returns True, then read `report`, or `error`: what the user must know, empty after a cancel.
    """

    def __init__(self, scene: bpy.types.Scene, steps: Generator, after: threading.Thread | None = None):
        self.scene = scene.session_uid
        self.steps = steps
        self.began = time.perf_counter()
        self.progress = Progress("Waiting for the cancelled bake" if after else "Atlas", 0.0, 0)
        self.waiting = ""
        self.ended = False
        self.report: dict | None = None
        self.error = ""
        self._after, self._thread, self._answer = after, None, None

    def advance(self) -> bool:
        """Do what is to be done on the main thread for a moment; True once the bake has ended."""
        if self.ended:
            return True
        if self.thread is not None:
            return False
        self._after = None
        # a mode or a render may begin while core works, and between any two steps
        self.waiting = waiting.reason()
        if self.waiting:
            return False
        if self._thread is not None:
            thread, self._thread = self._thread, None
            if thread.error is not None:
                self._fail(thread.error)
                return True
            self._answer = thread.result
        until = time.perf_counter() + SLICE
        self._step()
        while self._thread is None and not self.ended and time.perf_counter() < until:
            self._step()
        return self.ended

    def _step(self) -> None:
        answer, self._answer = self._answer, None
        try:
            with self._in_its_scene():
                step = self.steps.send(answer)
        except StopIteration as end:
            self._finish(end.value)
        except BaseException as error:
            self._end(error)
        else:
            if isinstance(step, Work):
                self._thread = _Thread(step, self)
                self._thread.start()
            else:
                self.progress = step

    def cancel(self) -> None:
        """End it now; what was there before stays. Where the new bake is in place already, it is finished."""
        if not self.ended:
            self._fail(Cancelled())
        while not self.ended and self._thread is None:
            self._step()

    def _fail(self, error: BaseException) -> None:
        """Let the steps know; those that say that it is too late go on."""
        try:
            with self._in_its_scene():
                self.progress = self.steps.throw(error)
        except StopIteration as end:
            self._finish(end.value)
        except BaseException as raised:
            self._end(raised)

    def _finish(self, report: dict | None) -> None:
        self.report, self.ended, self.waiting = report, True, ""
        self._answer = None
        if self._thread is not None:
            # one that still runs lets go by itself
            self._thread.result = None
            self._thread = self._thread if self._thread.is_alive() else None

    def _end(self, error: BaseException) -> None:
        # it may not have heard of the error: steps that can't begin are not asked
        self.steps.close()
        self._finish(None)
        if isinstance(error, (Cancelled, GeneratorExit)):
            return
        if isinstance(error, ReferenceError):
            # an object that was being read has been deleted
            self.error = CHANGED
        elif isinstance(error, (SceneError, MemoryError)):
            self.error = str(error) or "There is not enough memory: lower Resolution."
        elif isinstance(error, Exception):
            self.error = f"The bake failed ({type(error).__name__}: {error})."
            traceback.print_exception(error)
        else:
            raise error

    def _in_its_scene(self):
        """The steps read the context, whose scene the user may have left."""
        scene = next((s for s in bpy.data.scenes if s.session_uid == self.scene), None)
        if scene is None:
            raise SceneError("The scene was deleted while it was baked.")
        if bpy.context.scene == scene:
            return bpy.context.temp_override()
        return bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0])

    @property
    def says(self) -> str:
        """What it does and how far it is, or what it waits for, in the user's language."""
        if self.waiting:
            return iface_(self.waiting)
        return f"{iface_(self.progress.stage)}  {100 * self.progress.fraction:.0f} %"

    @property
    def alone(self) -> bool:
        """Whether the bake holds nothing of Blender's just now."""
        return self._thread is not None and self._thread.alone

    @property
    def thread(self) -> threading.Thread | None:
        """Where core still works, after a cancel too."""
        for thread in (self._thread, self._after):
            if thread is not None and thread.is_alive():
                return thread
        return None


_kept = Kept()
_current: Job | None = None


def start(context: bpy.types.Context) -> Job:
    """Begin to bake the context's scene; raises SceneError while another bake runs."""
    from . import baking, preferences

    global _current
    if running():
        raise SceneError("A bake is running; wait for it, or cancel it.")
    after = _current.thread if _current is not None else None
    if after is None:
        # else its thread may just be writing there
        _kept.cache = preferences.cache()
    # the context that operators get may be gone at the next step
    _current = Job(context.scene, baking.bake_steps(bpy.context, _kept), after)
    return _current


def running() -> bool:
    """Whether a bake is under way."""
    return _current is not None and not _current.ended


def current() -> Job | None:
    """The bake that is under way, or the last one."""
    return _current


def cancel() -> None:
    """Cancel the bake that is under way, if any."""
    if running():
        _current.cancel()


def forget() -> None:
    """Let go of what cancelled bakes had finished. A thread that has yet to notice its end fills its own."""
    global _kept
    _kept = Kept()


def draw(layout: bpy.types.UILayout, _context: bpy.types.Context) -> None:
    """The bar with the stage, what is known so far, and Cancel."""
    progress = _current.progress
    row = layout.row(align=True)
    row.scale_y = 1.4
    row.progress(factor=progress.fraction, type="BAR", text=_current.says)
    row.operator("lightpanes.cancel", text="", icon="X")
    known = facts(progress)
    if known:
        layout.label(text=known, icon="TIME")


def facts(progress: Progress) -> str:
    """Time left, rays and error as far as they are known."""
    parts = []
    if progress.seconds_left is not None:
        parts.append(f"{figures.duration(progress.seconds_left)} left")
    if progress.rays:
        parts.append(f"{progress.rays / 1e6:.1f} M rays")
    if progress.error is not None:
        parts.append(f"error from {figures.percent(progress.error)}")
    return ", ".join(parts)


@persistent
def _on_load(*_):
    cancel()
    forget()


@persistent
def _on_undo(*_):
    """Undo makes references to data-blocks invalid."""
    if running() and not _current.alone:
        cancel()


HANDLERS = {"load_pre": _on_load, "undo_pre": _on_undo, "redo_pre": _on_undo}


def register() -> None:
    handlers.add(HANDLERS)


def unregister() -> None:
    cancel()
    forget()
    handlers.remove(HANDLERS)
