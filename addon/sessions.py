"""What was worked out for each scene while Blender runs: its relighter, what its images show, what the user must know.

All of it follows from the .blend, so a session that is missing is begun anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import bpy
import numpy as np

from ..core.panes import Panes, Relighter
from ..core.panes.trust import Expected, expected_of
from ..core.rays import Tracer
from ..core.scene import Light, Scene, SceneError
from . import caustics, direct, extract, lamps, live_image, meshes, store, visibility
from .focus import Focus


@dataclass
class Session:
    """What is known about one scene while Blender runs. Nothing here outlives the process."""

    key: str
    relighter: Relighter | None = None
    focuses: bool = True  # whether it lets what casts caustics block the lamps
    edited: bool = False  # its shadows are those of surfaces that differ from what was baked
    shown: str = ""  # key of the lamps that the image shows
    landed: int = 0  # key of the caustics whose bounces it shows
    focus: Focus | None = None  # what these bring to the entries
    last: dict[str, Light] = field(default_factory=dict)  # the lamps that the image shows, by name
    static: dict[str, str] = field(default_factory=dict)  # keys of the lamps that are baked in, by name
    baked_in: tuple[Light, ...] = ()  # these lamps, as they were baked
    owners: dict[str, bpy.types.Object] = field(default_factory=dict)  # objects of the lamps last read, by lamp's name
    read: tuple[Scene, Tracer | None] | None = None  # surfaces just read, for the direct light and the caustics
    panes: bool = True  # whether the bake holds any
    stale: tuple[str, ...] = ()
    followed: str = ""  # key of the surfaces where the points are
    moved: tuple[str, ...] = ()  # what to say about that
    owes: bool = False  # a mesh that is lit at its vertices was in Edit Mode when the light changed
    wrote_meshes: bool = False  # light went to vertices, and Blender has yet to report that these meshes changed
    milliseconds: float = 0.0
    error: str = ""
    expected: Expected = field(default_factory=Expected)  # what the bake knows of its own error
    doubts: tuple[str, ...] = ()  # about lamps where they are now

    def read_again(self) -> None:
        """Where the surfaces are as they were baked again, shadows of what they were meanwhile must go."""
        if self.edited:
            self.relighter, self.edited, self.shown = None, False, ""


# On `Lightpanes Irradiance`: key of the lamps that its packed pixels show, so that opening a file costs nothing.
PACKED = "lightpanes_lamps"

_sessions: dict[int, Session] = {}


def of(scene: bpy.types.Scene) -> Session | None:
    """The scene's session, None without a bake. Another bake starts another session."""
    key = store.bake_key(scene)
    if key is None:
        _sessions.pop(scene.session_uid, None)
        return None
    found = _sessions.get(scene.session_uid)
    if found is None or found.key != key:
        image = store.find_image(scene, store.IRRADIANCE)
        packed = image is not None and not image.is_dirty and not store.is_lost(image) and image.get(PACKED)
        found = _sessions[scene.session_uid] = _begin(scene, key, shown=packed or "")
    return found


def begun(scene: bpy.types.Scene) -> Session | None:
    """The scene's session, None where none was begun yet."""
    return _sessions.get(scene.session_uid)


def every() -> tuple[Session, ...]:
    """All sessions that were begun."""
    return tuple(_sessions.values())


def _begin(scene, key, **more) -> Session:
    meta = store.read_meta(scene) or {}
    panes = "panes" not in meta.get("report", {}).get("skipped", {})
    baked_in = tuple(lamps.from_json(values) for values in meta.get("static_lamps", ()))
    # what is shown was made with caustics where these are there, whatever the setting has become
    focuses = scene.lightpanes.caustics or caustics.is_shown(scene)
    expected = expected_of(meta.get("report", {}))
    return Session(
        key, focuses=focuses, static=meta.get("static", {}), baked_in=baked_in, panes=panes, expected=expected, **more
    )


def forget(scene: bpy.types.Scene) -> None:
    """Drop what was worked out for the scene, its images' light included."""
    direct.forget(scene)
    caustics.forget(scene)
    _sessions.pop(scene.session_uid, None)


def adopt(scene: bpy.types.Scene, relighter: Relighter) -> None:
    """Use this relighter, just made by a bake, instead of making one from the .blend."""
    direct.forget(scene)
    caustics.forget(scene)
    _sessions[scene.session_uid] = _begin(scene, store.bake_key(scene), relighter=relighter)


def surfaces_of(context: bpy.types.Context, current: Session) -> tuple[Panes, Scene, Tracer]:
    """The bake's panes, and the scene's surfaces as they are now, with their shadow rays.

    Raises SceneError where these can't be used.
    """
    panes, surfaces = shapes_of(context, current)
    if current.read[1] is None:
        current.read = surfaces, caustics.make_tracer(surfaces)
    return panes, *current.read


def shapes_of(context: bpy.types.Context, current: Session) -> tuple[Panes, Scene]:
    """The same without shadow rays."""
    panes = relighter_of(context, current).panes
    if current.read is None:
        current.read = extract.extract(context, resolution=panes.resolution, albedo=False), None
    return panes, current.read[0]


def image_of(context: bpy.types.Context, current: Session, lights: Sequence[Light]) -> np.ndarray:
    """(H, W, 4) float32 irradiance under these lamps, W/m², with what bounces off the caustics that were worked out last."""
    relighter = relighter_of(context, current)
    focus(context.scene, current, relighter)
    return relighter.relight(lights)


def focus(scene: bpy.types.Scene, current: Session, relighter: Relighter) -> None:
    """Let the relighter know of the caustics that were worked out last."""
    landed = caustics.landed(scene)
    if landed.key != current.landed or (current.focus is not None and relighter.extra is None):
        if current.focus is None and landed.landings:
            current.focus = Focus(relighter.panes.surface, relighter.entry_light.tracer.offset)
        if current.focus is not None:
            current.focus.take(landed)
            relighter.extra = current.focus.of
        current.landed = landed.key


def relighter_of(context: bpy.types.Context, current: Session) -> Relighter:
    """The session's relighter, made from the bake and the meshes in the .blend where there is none yet.

    Raises SceneError where these can't be used.
    """
    scene = context.scene
    if current.relighter is None:
        shown = visibility.rendered_objects(context.view_layer)
        if not any(item.type in extract.GEOMETRY and store.TAG not in item for item in shown):
            raise SceneError("All meshes of the bake are deleted or hidden; bring them back, or press Clear.")
        bake = store.load_bake(scene)
        geometry = extract.extract(context, resolution=bake.resolution, albedo=False)
        changed = extract.changed_objects(bake.meta.get("fingerprint", {}), extract.fingerprint(context))
        # what is in Edit Mode has its new shape already
        current.edited = bool(changed) or meshes.in_edit_mode()
        tracer = caustics.make_tracer(geometry)
        current.relighter = Relighter(bake.panes(), tracer)
        current.read = geometry, tracer
    return current.relighter


def stop() -> None:
    """Forget everything, as when another file is opened."""
    _sessions.clear()
    live_image.stop()


def pack() -> None:
    """Pack the images that changed, so that they are saved, and note which lamps they show."""
    shown: dict[bpy.types.Image, str] = {}
    for scene in bpy.data.scenes:
        current, image = of(scene), store.find_image(scene, store.IRRADIANCE)
        if current is not None and image is not None and image.is_dirty:
            # copies of a scene share it, and one of them has written it
            shown[image] = shown.get(image) or current.shown
        direct.note_packed(scene)
        caustics.note_packed(scene)
    for image, key in shown.items():
        image[PACKED] = key
    store.pack_dirty()
