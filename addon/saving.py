"""The operator `lightpanes.save_images`: the bake's display images as OpenEXR files, for other programs."""

from __future__ import annotations

import os
from pathlib import Path

import bpy

from ..core.scene import SceneError
from . import direct, store

ROLES = (store.IRRADIANCE, store.DIRECT, store.ALBEDO)


def save_images(scene: bpy.types.Scene, folder: Path) -> list[Path]:
    """Write `Lightpanes Irradiance`, `Direct` and `Albedo`, those that the bake has, as 32-bit EXR; returns the files.

    Each is written under another name first, so that an existing file stays whole whatever happens. Raises SceneError,
    naming the file, when it can't be written, or when there is no bake.
    """
    direct.finish(scene)
    images = [image for role in ROLES if (image := store.find_image(scene, role)) is not None]
    if not images:
        raise SceneError(f"Scene '{scene.name}' has no bake; press Bake first.")
    files = []
    for image in images:
        target = folder / f"{bpy.path.clean_name(image.name, replace=' ')}.exr"
        temporary = target.with_name(f".{target.stem}-{os.getpid()}.exr")
        try:
            image.save(filepath=str(temporary), save_copy=True)
            os.replace(temporary, target)
        except (OSError, RuntimeError) as error:
            reason = getattr(error, "strerror", None) or str(error).strip().splitlines()[-1]
            raise SceneError(f"Can't write '{target}': {reason}. Choose another folder.") from error
        finally:
            temporary.unlink(missing_ok=True)
        files.append(target)
    return files


class LIGHTPANES_OT_save_images(bpy.types.Operator):
    bl_idname = "lightpanes.save_images"
    bl_label = "Save Images"
    bl_description = "Write the baked light as 32-bit OpenEXR images into a folder"
    bl_options = {"REGISTER"}

    directory: bpy.props.StringProperty(
        name="Folder", description="Where the images go; empty is beside the .blend", subtype="DIR_PATH"
    )

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
            files = save_images(context.scene, Path(bpy.path.abspath(directory)))
        except SceneError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"Wrote {len(files)} images to {files[0].parent}")
        return {"FINISHED"}


def register() -> None:
    bpy.utils.register_class(LIGHTPANES_OT_save_images)


def unregister() -> None:
    bpy.utils.unregister_class(LIGHTPANES_OT_save_images)
