"""The lamps' direct light in `Lightpanes Direct`, where the scene asks for it: its soft shadows follow the lamps, too.

In full wherever somebody waits for it: renders, frames, saving, scripts. In a window a lamp that is dragged is followed
beside Blender's own work, coarsely until it rests, so that the indirect light, which is quicker, need not wait.
"""

from __future__ import annotations

import hashlib
import json
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import bpy
import numpy as np

from ..core.direct_atlas import DirectAtlas
from ..core.panes import Panes
from ..core.penumbra import samples_for
from ..core.rays import Tracer
from ..core.scene import Light, Scene, SceneError
from . import areas, claims, extract, linking, nodes, store, vertices, waiting
from .lamps import lamp_key, read_lights
from .meshes import AT_VERTICES

REST = 0.2
"""Seconds without a change after which a lamp counts as put down."""

QUICK = 0.05
"""Seconds that a coarse image may take without a pause after it, which leaves time to the indirect light."""

TICK = 0.01
"""Seconds between two looks at what works beside Blender."""

# On `Lightpanes Direct`: keys of the lamps and of the surfaces that its packed pixels show, and the names of these lamps'
# objects.
PACKED = "lightpanes_lamps"
SURFACES = "lightpanes_surfaces"
OWNERS = "lightpanes_owners"

Read = Callable[[], tuple[Panes, Scene, Tracer]]
"""The bake's panes, and the scene's surfaces as they are now."""


@dataclass(frozen=True)
class Asked:
    """What an image is to show. samples, owners: by lamp's name; owners are objects' names. key: of it all."""

    lights: tuple[Light, ...]
    samples: dict[str, int]
    owners: tuple[str, ...]
    key: str


@dataclass
class Held:
    """What is known about one scene's direct light while Blender runs.

    bake: key of its bake. surfaces: key of the shapes that the image shows, "" where that is not known. shown: key of what the image shows in
    full, coarse: coarsely. linked: what `link` last went by. since: when what is asked for last changed; pause: until when
    nothing coarse is begun.
    """

    bake: str
    shown: str = ""
    coarse: str = ""
    atlas: DirectAtlas | None = None
    surfaces: str = ""
    linked: tuple = ()
    left_out: tuple[str, ...] = ()
    milliseconds: float = 0.0
    error: str = ""
    asked: Asked | None = None
    since: float = 0.0
    pause: float = 0.0
    work: _Work | None = None


@dataclass
class _Work:
    """One image, made beside Blender's own work."""

    asked: Asked
    full: bool
    atlas: DirectAtlas
    image: np.ndarray | None = None
    error: str = ""
    seconds: float = 0.0
    thread: threading.Thread = field(init=False)

    def __post_init__(self):
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self):
        begin = time.perf_counter()
        try:
            make = self.atlas.image if self.full else self.atlas.coarse
            self.image = make(self.asked.lights, self.asked.samples)
        except SceneError as error:
            self.error = str(error)
        self.seconds = time.perf_counter() - begin


_held: dict[int, Held] = {}
# renders run frame changes outside the main thread
_lock = threading.RLock()


def is_baked(scene: bpy.types.Scene) -> bool:
    """Whether the scene has a bake and wants the lamps' direct light in it."""
    return scene.lightpanes.direct == "BAKED" and store.find_entries(scene) is not None


def held(scene: bpy.types.Scene) -> Held:
    """What is known about the scene, which has a bake. Another bake starts anew."""
    key = store.bake_key(scene)
    found = _held.get(scene.session_uid)
    if found is None or found.bake != key:
        image = store.find_image(scene, store.DIRECT)
        packed = image is not None and not image.is_dirty and image.get(PACKED)
        found = Held(key, shown=packed or "", surfaces=image.get(SURFACES, "") if packed else "")
        _held[scene.session_uid] = found
    return found


def forget(scene: bpy.types.Scene) -> None:
    """Drop what was worked out."""
    _held.pop(scene.session_uid, None)


def make_atlas(panes: Panes, surfaces: Scene, tracer: Tracer, asked: Asked | None = None) -> DirectAtlas:
    """The texels of a bake. asked: lamps to cast at once. Nothing of Blender is read: it may run beside it."""
    own = panes.own
    if own is None:
        own = np.zeros(panes.resolution**2, bool)
        own[panes.texel] = True
    atlas = DirectAtlas(surfaces, panes.resolution, tracer, own)
    if asked is not None:
        atlas.image(asked.lights, asked.samples)
    return atlas


def ask_now(context: bpy.types.Context) -> Asked:
    """What a bake of the context's scene is going to show."""
    owners: dict[str, bpy.types.Object] = {}
    lights = read_lights(context.evaluated_depsgraph_get(), [], owners)
    return ask(context.scene, lights, (), owners)[0]


def adopt(scene: bpy.types.Scene, atlas: DirectAtlas, fingerprint: dict[str, str]) -> None:
    """Use what a bake has just made of these surfaces (`extract.fingerprint`)."""
    mine = held(scene)
    mine.atlas, mine.surfaces = atlas, _surfaces(fingerprint)


def begin(scene: bpy.types.Scene) -> None:
    """Make room for the lamps' light in the bake's images; it is not in them yet."""
    if store.find_image(scene, store.STEADY) is not None:
        return
    image = store.find_image(scene, store.DIRECT)
    if store.holds_direct(scene):
        if image is None:
            raise SceneError(f"The image '{store.DIRECT}' has been deleted; bake again.")
        store.add_image(scene, store.STEADY, store.read_image(scene, store.DIRECT))
    elif image is None:
        size = store.find_image(scene, store.IRRADIANCE)
        if size is None:
            raise SceneError(f"The image '{store.IRRADIANCE}' has been deleted; bake again.")
        width, height = size.size
        store.add_image(scene, store.DIRECT, store.opaque(np.zeros((height, width, 3), np.float32)))
    else:
        return
    nodes.rebuild(scene)


def end(scene: bpy.types.Scene) -> None:
    """Leave the lamps' direct light to the engine again; the bake's images are then as they were baked."""
    linking.give_back(scene)
    with _lock:
        forget(scene)
    image = store.find_image(scene, store.DIRECT)
    if store.find_entries(scene) is None or image is None:
        return
    steady = store.read_image(scene, store.STEADY)
    if steady is not None:
        store.write_image(scene, store.DIRECT, steady)
        image.pack()
        for key in (PACKED, SURFACES, OWNERS):
            if key in image:
                del image[key]
        store.drop_image(scene, store.STEADY)
        nodes.rebuild(scene)
    elif not store.holds_direct(scene):
        store.drop_image(scene, store.DIRECT)
        nodes.rebuild(scene)
    elif image.is_dirty:
        # undo took away what was beside the packed pixels, which are what was baked
        image.reload()


def ask(
    scene: bpy.types.Scene,
    lights: Iterable[Light],
    baked_in: Iterable[Light],
    owners: dict[str, bpy.types.Object],
) -> tuple[Asked, tuple[str, ...]]:
    """What the image is to show under these lamps, and sentences about those that it leaves out.

    baked_in: lamps that are not live, as they were baked. owners: each lamp's object, by the lamp's name.
    """
    few = samples_for(scene.lightpanes.error_target)
    chosen, samples, names, told = [], {}, [], []
    for light in (*lights, *baked_in):
        owner = owners.get(light.name)
        # a lamp that was baked in and is gone shines on, as its indirect light does
        reason = linking.obstacle(owner) if owner is not None else ""
        if reason:
            told.append(f"Lamp '{light.name}' {reason}, so its direct light is left to the engine.")
            continue
        own = owner.data.lightpanes.samples if owner is not None else 0
        chosen.append(light)
        samples[light.name] = own or few
        if owner is not None:
            names.append(owner.name)
    key = f"{lamp_key(chosen)} {list(samples.values())}"
    return Asked(tuple(chosen), samples, tuple(dict.fromkeys(names)), key), tuple(told)


def update(
    context: bpy.types.Context, scene: bpy.types.Scene, asked: tuple[Asked, tuple[str, ...]], read: Read, at_once: bool
) -> bool:
    """Show what is asked for (see `ask`), True where it is not shown already.

    at_once: in full before this returns; else soon, coarsely first. Raises SceneError where it can't be shown.
    """
    what, left_out = asked
    with _lock:
        mine = held(scene)
        mine.left_out = left_out
        if what.key == mine.shown and store.find_image(scene, store.DIRECT) is not None:
            mine.asked = None
            if mine.linked != _basis(scene, what.owners):
                link(scene)
            return False
        begin(scene)
        _make_atlas(context, mine, read)
        if at_once:
            _settle(mine)
            started = time.perf_counter()
            image = mine.atlas.image(what.lights, what.samples)
            _show(scene, mine, what, image, full=True)
            mine.milliseconds, mine.asked = 1000 * (time.perf_counter() - started), None
        elif mine.asked is None or mine.asked.key != what.key:
            mine.asked, mine.since = what, time.perf_counter()
            if not bpy.app.timers.is_registered(_look):
                bpy.app.timers.register(_look, first_interval=0.0)
        return True


def values(
    context: bpy.types.Context, scene: bpy.types.Scene, asked: tuple[Asked, tuple[str, ...]], read: Read
) -> np.ndarray:
    """(H, W, 3) float32 W/m²: what `update` would show, without showing it."""
    with _lock:
        mine = held(scene)
        begin(scene)
        _make_atlas(context, mine, read)
        _settle(mine)
        image = mine.atlas.image(asked[0].lights, asked[0].samples)
        return _with_steady(scene, image)[..., :3]


def finish(scene: bpy.types.Scene) -> None:
    """Show in full what is shown coarsely or about to be."""
    with _lock:
        mine = _held.get(scene.session_uid)
        if mine is None or mine.asked is None or mine.atlas is None or not is_baked(scene):
            return
        what = mine.asked
        _settle(mine)
        _show(scene, mine, what, mine.atlas.image(what.lights, what.samples), full=True)


def note_packed(scene: bpy.types.Scene) -> None:
    """Before images are packed: say which lamps and surfaces they show."""
    image, mine = store.find_image(scene, store.DIRECT), _held.get(scene.session_uid)
    if image is not None and mine is not None and image.is_dirty:
        image[PACKED], image[SURFACES] = mine.shown, mine.surfaces


def look_again(scene: bpy.types.Scene, fingerprint: dict[str, str]) -> bool:
    """After surfaces may have changed: True where the image shows others than these (`extract.fingerprint`)."""
    with _lock:
        mine = held(scene) if is_baked(scene) else None
        if mine is None or mine.surfaces in ("", _surfaces(fingerprint)):
            return False
        _settle(mine)
        mine.atlas, mine.asked, mine.surfaces, mine.shown, mine.coarse = None, None, "", "", ""
        return True


def undone() -> None:
    """After undo an image may show anything."""
    with _lock:
        for mine in _held.values():
            _settle(mine)
            mine.shown = mine.coarse = mine.error = ""
            mine.linked, mine.asked = (), None


def link(scene: bpy.types.Scene) -> None:
    """Keep lamps off the objects that show their light already, in the engine that the scene renders with."""
    image = store.find_image(scene, store.DIRECT)
    if not is_baked(scene) or image is None or not _is_shown(scene):
        linking.give_back(scene)
        names = ()
    else:
        names = tuple(json.loads(image.get(OWNERS, "[]")))
        owners = (bpy.data.objects.get(name) for name in names)
        lamps = [item for item in owners if item is not None and item.type == "LIGHT" and not linking.obstacle(item)]
        objects = claims.baked_objects(scene)
        linking.keep_off(
            scene, lamps, [item for item in objects if AT_VERTICES not in item and nodes.shows(item, scene)]
        )
    if scene.session_uid in _held:
        _held[scene.session_uid].linked = _basis(scene, names)


def sentences(scene: bpy.types.Scene) -> list[str]:
    """What the user should know about the scene's direct light."""
    mine = _held.get(scene.session_uid)
    told = [mine.error] * bool(mine.error) + list(mine.left_out) if mine is not None else []
    lit = sorted(item.name for item in vertices.lit(scene))
    if lit:
        names = ", ".join(f"'{name}'" for name in lit)
        told.append(f"Lit at their vertices, which hold no direct light of lamps: {names}.")
    return told


def _is_shown(scene) -> bool:
    """Whether the engine shows the bake."""
    return scene.render.engine != "CYCLES" or scene.lightpanes.cycles


def _basis(scene, names) -> tuple:
    return scene.render.engine, scene.lightpanes.cycles, names


def _surfaces(fingerprint) -> str:
    return hashlib.blake2b(repr(sorted(fingerprint.items())).encode(), digest_size=8).hexdigest()


def _make_atlas(context, mine: Held, read: Read) -> None:
    if mine.atlas is not None:
        return
    _settle(mine)
    panes, surfaces, tracer = read()
    mine.surfaces = _surfaces(extract.fingerprint(context))
    mine.atlas = make_atlas(panes, surfaces, tracer)


def _show(scene, mine: Held, what: Asked, image: np.ndarray, full: bool) -> None:
    store.write_image(scene, store.DIRECT, _with_steady(scene, image))
    shown = store.find_image(scene, store.DIRECT)
    if shown.get(OWNERS) != (names := json.dumps(what.owners)):
        shown[OWNERS] = names
    mine.coarse, mine.error = what.key, ""
    mine.shown = what.key if full else ""
    if full and mine.asked is not None and mine.asked.key == what.key:
        mine.asked = None
    # objects may have come or gone; while a lamp is dragged the same ones are taken to be there
    if full or mine.linked != _basis(scene, what.owners):
        link(scene)


def _with_steady(scene, image: np.ndarray) -> np.ndarray:
    """The image, (H, W, 4), with what sky and emissive faces bring added in place."""
    steady = store.read_image(scene, store.STEADY)
    if steady is not None:
        image[..., :3] += steady[..., :3]
    return image


def _settle(mine: Held) -> None:
    """Wait for what works beside Blender, and drop it."""
    if mine.work is not None:
        mine.work.thread.join()
    mine.work = None


def _look() -> float | None:
    """A timer: take up what is done, and begin what comes next. Returns seconds to its next call, None for never."""
    if waiting.renders() or not _lock.acquire(blocking=False):
        return REST
    try:
        scenes = {scene.session_uid: scene for scene in bpy.data.scenes}
        open_ones = [
            _step(scenes[uid], mine) for uid, mine in list(_held.items()) if uid in scenes and is_baked(scenes[uid])
        ]
        return TICK if any(open_ones) else None
    finally:
        _lock.release()


def _step(scene, mine: Held) -> bool:
    """Whether there is more to wait for."""
    work = mine.work
    if work is not None:
        if work.thread.is_alive():
            return True
        mine.work = None
        mine.pause = time.perf_counter() + max(work.seconds - QUICK, 0)
        if mine.asked is not None and work.atlas is mine.atlas and mine.bake == store.bake_key(scene):
            _take(scene, mine, work)
    if mine.asked is None or mine.atlas is None:
        return False
    now = time.perf_counter()
    rests = now - mine.since >= REST
    if rests or (mine.coarse != mine.asked.key and now >= mine.pause):
        mine.work = _Work(mine.asked, rests, mine.atlas)
    return True


def _take(scene, mine: Held, work: _Work) -> None:
    """Show what was made, or say why it wasn't."""
    error = work.error
    if work.image is not None:
        try:
            _show(scene, mine, work.asked, work.image, work.full)
        except SceneError as reason:
            error = str(reason)
        mine.milliseconds = 1000 * work.seconds
    else:
        mine.asked = None
    if error:
        mine.error, mine.asked = error, None
        print(f"Lightpanes: {error}")
    areas.redraw_panel()


def stop() -> None:
    """Forget everything, as when another file is opened."""
    with _lock:
        for mine in _held.values():
            _settle(mine)
        _held.clear()
    if bpy.app.timers.is_registered(_look):
        bpy.app.timers.unregister(_look)
