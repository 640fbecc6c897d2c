"""The baked light of an animation as images, for engines that only play textures.

A folder gets `irradiance_0001.exr` and so on, one a frame: irradiance in W/m², linear Rec.709, the receiver's own colour
divided out, so that outgoing radiance = albedo × irradiance / π. `lightpanes_animation.json` beside them says which
frames there are and where in the atlas each object lies; `direct.exr` is the first hit of sky and emissive faces, to be
added, where the bake holds it. Where the lamps' direct light is baked, each frame has its own instead, `direct_0001.exr`
and so on; so it is with caustics, `caustics_0001.exr`, where anything casts them. By group, `irradiance_0001_GROUP.exr` and `irradiance_Steady.exr` sum up to the whole. All files of a run
appear at once when its last frame is done, or not at all.
"""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Callable, Generator
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np

from ..core import exr
from ..core.bake import Progress
from ..core.files import filling
from ..core.scene import Light, SceneError
from . import caustics, direct, engine, extract, groups, lamps, nodes, relight, sessions, store, vertices, visibility
from .work import run

FOLDER = "lightpanes_irradiance"
MANIFEST = "lightpanes_animation.json"
DIRECT = "direct.exr"
SCHEMA, SCHEMA_DIRECT, SCHEMA_CAUSTICS = 1, 2, 3
"""Of the manifest: another number where a reader of the former one would go wrong. The second: with direct light that
each frame has its own of. The third: with caustics, and `direct` of each frame or once, as it is named."""

Steps = Generator[Progress, None, dict]


def frames_of(scene: bpy.types.Scene, start: int | None, end: int | None, step: int | None) -> range:
    """The frames to write; None means the scene's own. Raises SceneError when there are none."""
    start = scene.frame_start if start is None else start
    end = scene.frame_end if end is None else end
    if end < start:
        raise SceneError(f"The last frame, {end}, is before the first, {start}; name them the other way round.")
    return range(start, end + 1, scene.frame_step if step is None else step)


def folder_of(directory: str) -> Path:
    """An absolute folder from what a user typed. Raises SceneError when that names none."""
    if not directory.strip():
        raise SceneError("No folder is named for the images; name one.")
    if directory.startswith("//") and not bpy.data.filepath:
        raise SceneError(
            f"The folder '{directory}' lies beside the .blend, which has not been saved yet. Save it, or name a folder "
            "by its full path."
        )
    return Path(bpy.path.abspath(directory)).expanduser().absolute()


def write(
    context: bpy.types.Context,
    folder: Path,
    frames: range,
    tell: Callable[[Progress], None] | None = None,
    by_group: bool = False,
) -> dict:
    """Write the animation of the context's scene to `folder`, which is made if missing; returns the manifest.

    by_group: also an image for each group of lamps (see `groups`).

    Raises SceneError with a sentence for the user. Whatever stops it, an exception raised by `tell` included, leaves
    the folder, the scene's frame and its light as they were.
    """
    return run(writing(context, folder, frames, by_group), tell)


def writing(context: bpy.types.Context, folder: Path, frames: range, by_group: bool = False) -> Steps:
    """`write` in steps of a tenth of a second, as far as Blender's own work on a frame allows; close it to cancel."""
    scene = context.scene
    if reason := engine.unusable():
        raise SceneError(reason)
    current = sessions.of(scene)
    if current is None:
        raise SceneError(f"Scene '{scene.name}' has no bake; press Bake first.")
    manifest = _manifest(scene, frames)
    if by_group:
        _name_groups(manifest, groups.in_scene(scene, current.static))
    with _staged(folder) as stage, visibility.awake(context.view_layer), _frame_kept(scene), relight.held():
        yield from _write_images(context, stage, frames, manifest)
        manifest["warnings"] += _leftovers(folder, stage)
        _write_manifest(stage / MANIFEST, manifest)
    return manifest


@contextlib.contextmanager
def _staged(folder: Path):
    """A folder whose files appear in `folder` when all of them are there."""
    begun = False
    try:
        with filling(folder, last=MANIFEST) as stage:
            begun = True
            yield stage
    except OSError as error:
        what = f"'{error.filename2 or folder}'" if begun else f"folder '{folder}'"
        raise SceneError(f"Can't write to {what}: {error.strerror}. Choose another folder.") from error


@contextlib.contextmanager
def _frame_kept(scene: bpy.types.Scene):
    """Afterwards the scene is at its frame again, with the light that belongs there."""
    frame, part = scene.frame_current, scene.frame_subframe
    try:
        yield
    finally:
        with contextlib.suppress(ReferenceError):  # another file was opened meanwhile
            if (scene.frame_current, scene.frame_subframe) != (frame, part):
                scene.frame_set(frame, subframe=part)


def _write_images(context, stage: Path, frames: range, manifest: dict) -> Steps:
    """All that `manifest` names, and what it can't know beforehand."""
    scene = context.scene
    current = sessions.of(scene)
    yield Progress("Reading the bake", 0.0, 0)
    warnings = _Warnings(context, current, frames)
    each = direct.is_baked(scene)
    steady = None if each else store.read_image(scene, store.DIRECT)
    if steady is not None:
        yield from (Progress("Direct light", 0.0, 0) for _ in exr.writing(stage / DIRECT, steady[..., :3]))
        manifest["direct"] = DIRECT
    names = [entry["group"] or "" for entry in manifest.get("groups", ())]
    lit = _Frames(context, current, stage) if each else None
    focused = _Focused(context, current, stage) if manifest["schema"] == SCHEMA_CAUSTICS else None
    shown, former = "", []
    for number, entry in enumerate(manifest["frames"]):
        if context.scene != scene or sessions.of(scene) is not current:
            raise SceneError(f"Scene '{scene.name}' was left, or its bake replaced or cleared, meanwhile; start again.")
        scene.frame_set(entry["frame"])
        # at once, for somebody may play the animation meanwhile
        lights = warnings.look(entry["frame"])
        yield Progress("Frames", number / len(frames), 0)
        files = [entry["file"], *entry.get("groups", {}).values()]
        key = relight.lamp_key(lights)
        if focused is not None:
            # where they fall the light bounces on
            for _ in focused.writing(entry["caustics"], lights):
                yield Progress("Frames", number / len(frames), 0)
        if key == shown:
            for old, new in zip(former, files, strict=True):
                shutil.copyfile(stage / old, stage / new)
        else:
            shown, light = key, _irradiance(context, current, lights)
            pictures = [light]
            if names:
                yield Progress("Frames", number / len(frames), 0)
                parts, steady = _shares(context, current, lights, names)
                pictures += parts
                if not former:
                    yield from (Progress("Frames", 0.0, 0) for _ in exr.writing(stage / manifest["steady"], steady))
            for done, (file, picture) in enumerate(zip(files, pictures, strict=True)):
                for part in exr.writing(stage / file, picture):
                    yield Progress("Frames", (number + (done + part) / len(files)) / len(frames), 0)
        former = files
        if lit is not None:
            for _ in lit.writing(entry["direct"], lights, warnings.owners):
                yield Progress("Frames", (number + 1) / len(frames), 0)
        yield Progress("Frames", (number + 1) / len(frames), 0)
    manifest["warnings"] += warnings.sentences()
    if lit is not None:
        manifest["warnings"] += lit.told


class _Frames:
    """Writes the direct light of each frame, sky and emissive faces included.

    told: sentences about lamps that are left out of it.
    """

    def __init__(self, context, current: sessions.Session, stage: Path):
        self.context, self.current, self.stage = context, current, stage
        self.key, self.place, self.told = "", None, []

    def writing(self, name: str, lights, owners) -> Generator[float, None, None]:
        """One file, in parts of itself that are done."""
        asked = direct.ask(self.context.scene, lights, self.current.baked_in, owners)
        self.told += [sentence for sentence in asked[1] if sentence not in self.told]
        former, self.place = self.place, self.stage / name
        if asked[0].key == self.key:
            shutil.copyfile(former, self.place)
            return
        self.key = asked[0].key
        with relight.paused():
            light = direct.values(
                self.context, self.context.scene, asked, lambda: sessions.surfaces_of(self.context, self.current)
            )
        yield from exr.writing(self.place, light)


class _Focused:
    """Writes the caustics of each frame."""

    def __init__(self, context, current: sessions.Session, stage: Path):
        self.context, self.current, self.stage = context, current, stage
        self.key, self.place = "", None

    def writing(self, name: str, lights) -> Generator[float, None, None]:
        """One file, in parts of itself that are done."""
        asked = caustics.ask(self.context.scene, lights, self.current.baked_in)
        former, self.place = self.place, self.stage / name
        if asked.key == self.key:
            shutil.copyfile(former, self.place)
            return
        self.key = asked.key
        with relight.paused():
            light = caustics.values(
                self.context, self.context.scene, asked, lambda: sessions.shapes_of(self.context, self.current)
            )
        yield from exr.writing(self.place, light)


def _irradiance(context, current: sessions.Session, lights) -> np.ndarray:
    """(H, W, 3) float32 of what `lightpanes.relight` would show; the image that the user sees is not touched, and follows
    the lamps again once all frames are written."""
    with relight.paused():
        return sessions.image_of(context, current, lights)[..., :3].copy()


def _shares(context, current: sessions.Session, lights, names) -> tuple[list[np.ndarray], np.ndarray]:
    with relight.paused():
        return groups.shares(sessions.relighter_of(context, current), lights, names)


class _Warnings:
    """Reads the lamps of each frame, and notes what changes that a bake can't follow."""

    def __init__(self, context, current: sessions.Session, frames: range):
        self.context, self.current = context, current
        self.baked = (store.read_meta(context.scene) or {}).get("fingerprint")
        # hashing every mesh takes longer than a frame's light
        self.sampled = {frames[0], frames[len(frames) // 2], frames[-1]}
        self.found: dict[tuple, str] = {}
        self.owners: dict[str, bpy.types.Object] = {}
        if not current.panes:
            self.found["panes",] = "This bake has no live lamp, so all frames show the same light."

    def look(self, frame: int) -> tuple[Light, ...]:
        """The lamps that shine in this frame and are not baked in; those switched off from live count, too."""
        self.owners = {}
        shining = lamps.read_lights(self.context.evaluated_depsgraph_get(), [], self.owners)
        now = {light.name: relight.lamp_key([light]) for light in shining if light.name in self.current.static}
        for name, key in self.current.static.items():
            if now.get(name) != key:
                self.found.setdefault(
                    ("lamp", name),
                    f"Lamp '{name}' is baked in: that it is another at frame {frame} does not show. Switch on Live in "
                    "its own tab and bake again.",
                )
        if self.baked is not None and frame in self.sampled:
            for name in extract.changed_objects(self.baked, extract.fingerprint(self.context)):
                self.found.setdefault(
                    ("object", name),
                    f"'{name}' is not as it was baked at frame {frame}; the light around it stays as baked.",
                )
        return tuple(replace(light, live=True) for light in shining if light.name not in self.current.static)

    def sentences(self) -> list[str]:
        return list(self.found.values())


def _manifest(scene, frames: range) -> dict:
    """What an engine needs to know. Raises SceneError when the bake has no texture."""
    image = store.find_image(scene, store.IRRADIANCE)
    if image is None:
        raise SceneError(f"The image '{store.IRRADIANCE}' has been deleted; bake again.")
    placed = [item for item in scene.objects if "lightpanes_scale" in item and "lightpanes_offset" in item]
    without = sorted(item.name for item in vertices.lit(scene))
    names = ", ".join(f"'{name}'" for name in without)
    if not placed:
        raise SceneError(
            f"No object of this bake has a texture ({names} lit at vertices). Set Light In to Texture in an object's "
            "own tab and bake again."
            if without
            else "No object of this bake is left in the scene; bake again."
        )
    each, focused = direct.is_baked(scene), store.find_image(scene, store.CAUSTICS) is not None
    return {
        "schema": SCHEMA_CAUSTICS if focused else SCHEMA_DIRECT if each else SCHEMA,
        "unit": "W/m²",
        "quantity": "irradiance",
        "color_space": "linear Rec.709",
        "use": "outgoing radiance = albedo × (irradiance + direct + caustics) / π; atlas UV = UV × scale + offset, v = 0 below",
        "uv_layer": nodes.UV_LAYER,
        "resolution": list(image.size),
        "fps": scene.render.fps / scene.render.fps_base,
        "frames": [
            {"frame": frame, "file": _file_name(frame)}
            | ({"direct": _file_name(frame, "direct")} if each else {})
            | ({"caustics": _file_name(frame, "caustics")} if focused else {})
            for frame in frames
        ],
        "direct": None,
        "objects": [
            {
                "name": item.name,
                "scale": [float(v) for v in item["lightpanes_scale"]],
                "offset": [float(v) for v in item["lightpanes_offset"]],
            }
            for item in sorted(placed, key=lambda item: item.name)
        ],
        "without_texture": without,
        "warnings": [f"Lit at their vertices, which images don't hold: {names}."] if without else [],
    }


def _name_groups(manifest: dict, names: list[str]) -> None:
    """Files for each group, and for the light that no live lamp changes."""
    parts = groups.file_parts(names)
    manifest["groups"] = [{"group": name or None, "part": part} for name, part in parts.items()]
    manifest["steady"] = f"irradiance_{groups.STEADY}.exr"
    for entry in manifest["frames"]:
        stem = entry["file"].removesuffix(".exr")
        entry["groups"] = {part: f"{stem}_{part}.exr" for part in parts.values()}


def _file_name(frame: int, what: str = "irradiance") -> str:
    """As Blender numbers a sequence."""
    return f"{what}_{'-' * (frame < 0)}{abs(frame):04d}.exr"


def _leftovers(folder: Path, stage: Path) -> list[str]:
    """A warning where images of an earlier run will lie among the new ones."""
    new = {path.name for path in stage.iterdir()}
    old = sorted(
        path.name
        for pattern in ("irradiance_*.exr", "direct_*.exr", "caustics_*.exr", DIRECT)
        for path in folder.glob(pattern)
    )
    old = [name for name in old if name not in new]
    if not old:
        return []
    others = f" and {len(old) - 1} more" if len(old) > 1 else ""
    return [f"'{folder}' also holds '{old[0]}'{others} of an earlier run, which {MANIFEST} does not name."]


def _write_manifest(place: Path, manifest: dict) -> None:
    place.write_text(json.dumps(manifest, indent=2, ensure_ascii=False) + "\n", "utf-8")
