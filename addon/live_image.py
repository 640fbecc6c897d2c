"""An image of a bake that follows the lamps beside Blender's own work: coarsely while they are dragged, in full once they
rest, so that whatever is quicker need not wait.

In full and at once wherever somebody waits for it: renders, frames, saving, scripts. `direct` and `caustics` each have
one of these; it knows nothing of what they show.
"""

from __future__ import annotations

import hashlib
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Protocol

import bpy
import numpy as np

from ..core.scene import SceneError
from . import areas, extract, store, waiting

REST = 0.2
"""Seconds without a change after which a lamp counts as put down."""

QUICK = 0.05
"""Seconds that a coarse image may take without a pause after it, which leaves time to the indirect light."""

TICK = 0.01
"""Seconds between two looks at what works beside Blender."""

PACKED = "lightpanes_lamps"
SURFACES = "lightpanes_surfaces"
"""On an image: keys of the lamps and of the surfaces that its packed pixels show, so that opening a file costs nothing."""

Read = Callable[[], tuple]
"""Reads what `LiveImage.make_atlas` needs: the bake's panes, the scene's surfaces as they are now, and so on."""


class Asked(Protocol):
    """What an image is to show; key: of it all."""

    key: str


@dataclass
class Held:
    """What is known about one scene's image while Blender runs.

    bake: key of its bake. surfaces: key of the shapes that the image shows, "" where that is not known. atlas: whatever works
    the image out. shown: key of what the image shows in full, coarse: coarsely. since: when what is asked for last changed; pause: until when
    nothing coarse is begun. milliseconds: that the last image took.
    """

    bake: str
    shown: str = ""
    coarse: str = ""
    atlas: object = None
    surfaces: str = ""
    milliseconds: float = 0.0
    error: str = ""
    asked: Asked | None = None
    since: float = 0.0
    pause: float = 0.0
    work: _Work | None = None


@dataclass
class _Work:
    """One image, made beside Blender's own work. name: of the image, for errors. image: the best there is by now, None
    once it is shown."""

    name: str
    asked: Asked
    full: bool
    atlas: object
    images: Callable[[], Iterable[np.ndarray | None]]
    image: np.ndarray | None = None
    made: int = 0
    error: str = ""
    seconds: float = 0.0
    dropped: bool = False
    thread: threading.Thread = field(init=False)

    def __post_init__(self):
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self):
        begin = time.perf_counter()
        try:
            for image in self.images():
                if image is not None:
                    self.image, self.made = image, self.made + 1
                self.seconds = time.perf_counter() - begin
                if self.dropped:
                    break
        except SceneError as error:
            self.error = str(error)
        except Exception as error:  # in a thread nobody else would ever hear of it
            traceback.print_exc()
            reason = f"{type(error).__name__}: {error}".rstrip(": ")
            self.error = (
                f"'{self.name}' could not be worked out ({reason}), and shows what it showed before; press Relight to try "
                "again."
            )
        self.seconds = time.perf_counter() - begin


# renders run frame changes outside the main thread
lock = threading.RLock()
_kinds: list[LiveImage] = []


class LiveImage:
    """One kind of image, `role` of each bake. Subclasses say what it shows.

    held_as: what is known about a scene's. keeps: whether full work goes on when something else is asked for meanwhile.
    """

    role = ""
    held_as = Held
    keeps = True

    def __init__(self):
        self._held: dict[int, Held] = {}
        _kinds.append(self)

    # ---- what subclasses say ----

    def is_baked(self, scene: bpy.types.Scene) -> bool:
        """Whether the scene has a bake and wants this image in it."""
        raise NotImplementedError

    def begin(self, scene: bpy.types.Scene) -> None:
        """Make room for it among the bake's images."""
        raise NotImplementedError

    def make_atlas(self, *read):
        """Whatever works images out of what was read."""
        raise NotImplementedError

    def images(self, atlas, asked: Asked, full: bool) -> Iterator[np.ndarray | None]:
        """(H, W, 4) float32, from coarse to fine; the last one is what counts, and None is none yet, when nobody need want
        more. Nothing of Blender is read: it may run beside it."""
        raise NotImplementedError

    def show(self, scene: bpy.types.Scene, mine: Held, asked: Asked, image: np.ndarray, full: bool) -> None:
        """Put it where it is seen."""
        raise NotImplementedError

    def image(self, atlas, asked: Asked) -> np.ndarray:
        """The finest of them, for those who wait for it."""
        *_, finest = self.images(atlas, asked, True)
        return finest

    def rested(self, scene: bpy.types.Scene, mine: Held, asked: Asked) -> None:
        """It is shown in full."""

    # ---- what callers use ----

    def held(self, scene: bpy.types.Scene) -> Held:
        """What is known about the scene, which has a bake. Another bake starts anew."""
        key = store.bake_key(scene)
        found = self._held.get(scene.session_uid)
        if found is None or found.bake != key:
            image = store.find_image(scene, self.role)
            packed = image is not None and not image.is_dirty and image.get(PACKED)
            found = self.held_as(key, shown=packed or "", surfaces=image.get(SURFACES, "") if packed else "")
            self._held[scene.session_uid] = found
        return found

    def known(self, scene: bpy.types.Scene) -> Held | None:
        """The same where there is something, without a look at the bake."""
        return self._held.get(scene.session_uid)

    def forget(self, scene: bpy.types.Scene) -> None:
        """Drop what was worked out."""
        self._held.pop(scene.session_uid, None)

    def adopt(self, scene: bpy.types.Scene, atlas, fingerprint: dict[str, str]) -> None:
        """Use what a bake has just made of these surfaces (`extract.fingerprint`)."""
        mine = self.held(scene)
        mine.atlas, mine.surfaces = atlas, surfaces_key(fingerprint)

    def bring(self, context: bpy.types.Context, scene: bpy.types.Scene, what: Asked, read: Read, at_once: bool) -> None:
        """Show what is asked for: in full before this returns, else soon, coarsely first. Raises SceneError where it
        can't be shown."""
        with lock:
            mine = self.held(scene)
            self.begin(scene)
            self.prepare(context, mine, read)
            if at_once:
                self._at_once(scene, mine, what)
            elif mine.asked is None or mine.asked.key != what.key:
                mine.asked, mine.since = what, time.perf_counter()
                if mine.work is not None and not self.keeps:
                    mine.work.dropped = True
                if not bpy.app.timers.is_registered(look):
                    bpy.app.timers.register(look, first_interval=0.0)

    def _at_once(self, scene, mine: Held, what: Asked) -> None:
        settle(mine)
        started = time.perf_counter()
        image = self.image(mine.atlas, what)
        self._take_up(scene, mine, what, image, full=True)
        mine.milliseconds, mine.asked = 1000 * (time.perf_counter() - started), None

    def value(self, context: bpy.types.Context, scene: bpy.types.Scene, what: Asked, read: Read) -> np.ndarray:
        """(H, W, 4) float32 W/m²: what would be shown, without showing it."""
        with lock:
            mine = self.held(scene)
            self.begin(scene)
            self.prepare(context, mine, read)
            settle(mine)
            return self.image(mine.atlas, what)

    def finish(self, scene: bpy.types.Scene) -> None:
        """Show in full what is shown coarsely or about to be."""
        with lock:
            mine = self._held.get(scene.session_uid)
            if mine is None or mine.asked is None or mine.atlas is None or not self.is_baked(scene):
                return
            what = mine.asked
            settle(mine)
            self._take_up(scene, mine, what, self.image(mine.atlas, what), full=True)

    def note_packed(self, scene: bpy.types.Scene) -> None:
        """Before images are packed: say which lamps and surfaces they show."""
        image, mine = store.find_image(scene, self.role), self._held.get(scene.session_uid)
        if image is not None and mine is not None and image.is_dirty:
            # copies of a scene share it, and one of them has written it
            mine = next((each for each in self._held.values() if each.bake == mine.bake and each.shown), mine)
            image[PACKED], image[SURFACES] = mine.shown, mine.surfaces

    def look_again(self, scene: bpy.types.Scene, fingerprint: dict[str, str]) -> bool:
        """After surfaces may have changed: True where the image shows others than these (`extract.fingerprint`)."""
        with lock:
            mine = self.held(scene) if self.is_baked(scene) else None
            if mine is None or mine.surfaces in ("", surfaces_key(fingerprint)):
                return False
            self.drop_atlas(mine)
            return True

    def drop_atlas(self, mine: Held) -> None:
        """What it was made of is no more."""
        settle(mine)
        mine.atlas, mine.asked, mine.surfaces, mine.shown, mine.coarse = None, None, "", "", ""

    def prepare(self, context: bpy.types.Context, mine: Held, read: Read) -> None:
        """Make what works images out, where it is missing."""
        if mine.atlas is not None:
            return
        settle(mine)
        found = read()
        mine.surfaces = surfaces_key(extract.fingerprint(context))
        mine.atlas = self.make_atlas(*found)

    # ---- what the timer and events of Blender use ----

    def undone(self) -> None:
        """After undo an image may show anything."""
        for mine in self._held.values():
            settle(mine)
            mine.shown = mine.coarse = mine.error = ""
            mine.asked = None

    def stop(self) -> None:
        """Forget everything."""
        for mine in self._held.values():
            settle(mine)
        self._held.clear()

    def step(self, scene: bpy.types.Scene) -> bool:
        """Take up what is done for a scene, and begin what comes next; whether there is more to wait for."""
        mine = self._held.get(scene.session_uid)
        if mine is None or not self.is_baked(scene):
            return False
        work = mine.work
        if work is not None:
            ended = not work.thread.is_alive()
            if ended:
                mine.work = None
                mine.pause = time.perf_counter() + max(work.seconds - QUICK, 0)
            if mine.asked is not None and work.atlas is mine.atlas and mine.bake == store.bake_key(scene):
                self._take(scene, mine, work, ended)
            if not ended:
                return True
        if mine.asked is None or mine.atlas is None:
            return False
        now = time.perf_counter()
        rests = now - mine.since >= REST
        if rests or (mine.coarse != mine.asked.key and now >= mine.pause):
            atlas, asked = mine.atlas, mine.asked
            mine.work = _Work(self.role, asked, rests, atlas, lambda: self.images(atlas, asked, rests))
        return True

    def _take(self, scene, mine: Held, work: _Work, ended: bool) -> None:
        """Show what there is by now, or say why there is nothing."""
        error, image, work.image = work.error, work.image, None
        if image is not None:
            try:
                self._take_up(scene, mine, work.asked, image, work.full and ended and not (work.dropped or error))
            except SceneError as reason:
                error = str(reason)
            mine.milliseconds = 1000 * work.seconds
        elif ended and work.full and work.made and not (work.dropped or error):
            # its last image is shown already, as a coarse one
            self._done(scene, mine, work.asked)
        elif not (ended and error):
            return
        if error:
            mine.error, mine.asked = error, None
            print(f"Lightpanes: {error}")
        areas.redraw_panel()

    def _take_up(self, scene, mine: Held, what: Asked, image: np.ndarray, full: bool) -> None:
        self.show(scene, mine, what, image, full)
        mine.coarse, mine.shown, mine.error = what.key, "", ""
        for other in self._held.values():
            if other is not mine and other.bake == mine.bake:
                # of a copy of the scene, which shows the same image
                other.shown = other.coarse = ""
        if full:
            self._done(scene, mine, what)

    def _done(self, scene, mine: Held, what: Asked) -> None:
        mine.shown = what.key
        if mine.asked is not None and mine.asked.key == what.key:
            mine.asked = None
        self.rested(scene, mine, what)


def surfaces_key(fingerprint: dict[str, str]) -> str:
    """Of shapes and materials (`extract.fingerprint`)."""
    return hashlib.blake2b(repr(sorted(fingerprint.items())).encode(), digest_size=8).hexdigest()


def settle(mine: Held) -> None:
    """Wait for what works beside Blender, and drop it."""
    if mine.work is not None:
        mine.work.dropped = True
        mine.work.thread.join()
    mine.work = None


def undone() -> None:
    """After undo images may show anything."""
    with lock:
        for kind in _kinds:
            kind.undone()


def look() -> float | None:
    """A timer: take up what is done, and begin what comes next. Returns seconds to its next call, None for never."""
    if waiting.renders() or not lock.acquire(blocking=False):
        return REST
    try:
        waits = [kind.step(scene) for scene in bpy.data.scenes for kind in _kinds]
        return TICK if any(waits) else None
    finally:
        lock.release()


def stop() -> None:
    """Forget everything, as when another file is opened."""
    with lock:
        for kind in _kinds:
            kind.stop()
    if bpy.app.timers.is_registered(look):
        bpy.app.timers.unregister(look)
