"""The operator `lightpanes.save_images`: the bake's display images as OpenEXR files, for other programs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

from ..core import exr
from ..core.bake import BakeError
from ..core.files import replacing
from ..core.scene import SceneError
from . import caustics, direct, groups, relight, sessions, store

BY_GROUP = (
    "Also write an image for each group of lamps, for those without one, and for the light that no lamp changes. "
    "Together they are the whole"
)
# Blender warns of `//` in a path that does not say that it takes it; before 4.5 it knows no such saying.
RELATIVE = {"PATH_SUPPORTS_BLEND_RELATIVE"} if bpy.app.version >= (4, 5) else set()
ROLES = (store.IRRADIANCE, store.DIRECT, store.CAUSTICS, store.ALBEDO)


def save_images(context: bpy.types.Context, folder: Path, by_group: bool = False) -> list[Path]:
    """Write `Lightpanes Irradiance`, `Direct`, `Caustics` and `Albedo`, those that the bake has, as 32-bit EXR; returns the files.

    by_group: the lamps are read anew, and `Lightpanes Irradiance_GROUP` and so on come along, which sum up to the whole.
    Each is written under another name first, so that an existing file stays whole whatever happens. Raises SceneError,
    naming the file, when it can't be written, or when there is no bake.
    """
    scene = context.scene
    direct.finish(scene)
    caustics.finish(scene)
    images = [image for role in ROLES if (image := store.find_image(scene, role)) is not None]
    if not images:
        raise SceneError(f"Scene '{scene.name}' has no bake; press Bake first.")
    shares = _shares(context) if by_group else {}
    files = []
    for image in images:
        name = bpy.path.clean_name(image.name, replace=" ")
        files.append(
            _write(folder / f"{name}.exr", lambda path, image=image: image.save(filepath=str(path), save_copy=True))
        )
        if image[store.TAG] == store.IRRADIANCE:
            for part, picture in shares.items():
                target = folder / f"{name}_{part}.exr"
                files.append(_write(target, lambda path, picture=picture: _save(path, picture)))
    return files


def _shares(context) -> dict[str, np.ndarray]:
    """(H, W, 3) float32 of each group, by what files call it."""
    relight.relight(context)
    current = sessions.of(context.scene)
    names = groups.in_scene(context.scene, current.static)
    with relight.paused():
        relighter = sessions.relighter_of(context, current)
        parts, steady = groups.shares(relighter, list(current.last.values()), names)
    return dict(zip(groups.file_parts(names).values(), parts, strict=True)) | {groups.STEADY: steady}


def _save(path, picture) -> None:
    for _ in exr.writing(path, picture, exact=True):
        pass


def _write(target: Path, write: Callable[[Path], object]) -> Path:
    try:
        with replacing(target) as temporary:
            write(temporary)
    except (OSError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or str(error).strip().splitlines()[-1]
        raise SceneError(f"Can't write '{target}': {reason}. Choose another folder.") from error
    return target


class LIGHTPANES_OT_save_images(bpy.types.Operator):
    bl_idname = "lightpanes.save_images"
    bl_label = "Save Images"
    bl_description = "Write the baked light as 32-bit OpenEXR images into a folder"
    bl_options = {"REGISTER"}

    directory: bpy.props.StringProperty(
        name="Folder",
        description="Where the images go; empty is beside the .blend",
        subtype="DIR_PATH",
        options=RELATIVE,
    )

    groups: bpy.props.BoolProperty(name="By Group", description=BY_GROUP)

    @classmethod
    def poll(cls, context):
        if store.find_entries(context.scene) is None:
            cls.poll_message_set("There is no bake; press Bake first")
            return False
        return True

    def invoke(self, context, _event):
        if not self.directory:
            self.directory = bpy.path.abspath("//")
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context):
        directory = self.directory or "//"
        if directory.startswith("//") and not bpy.data.filepath:
            self.report({"ERROR"}, "The file has not been saved yet: save it, or choose a folder")
            return {"CANCELLED"}
        try:
            files = save_images(context, Path(bpy.path.abspath(directory)), self.groups)
        except (SceneError, BakeError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"Wrote {len(files)} images to {files[0].parent}")
        return {"FINISHED"}


def register() -> None:
    bpy.utils.register_class(LIGHTPANES_OT_save_images)


def unregister() -> None:
    bpy.utils.unregister_class(LIGHTPANES_OT_save_images)
