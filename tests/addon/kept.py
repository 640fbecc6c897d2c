"""Bakes whose images lie beside the .blend: saved, opened again, and told apart bit by bit."""

import bpy
import numpy as np
from lightpanes.addon import beside, sessions, store

from .files import baked_once, empty


def baked_beside(scene, saved):
    """As `baked_once`, with images beside the file."""
    scene = baked_once(scene, saved)
    scene.lightpanes.storage = "BESIDE"
    return scene


def save(path, **options):
    path.parent.mkdir(exist_ok=True)
    assert bpy.ops.wm.save_as_mainfile(filepath=str(path), **options) == {"FINISHED"}


def open_file(path):
    """What a fresh Blender would see."""
    empty()
    bpy.ops.wm.open_mainfile(filepath=str(path))
    return bpy.context.scene


def image(scene):
    picture = store.find_image(scene, store.IRRADIANCE)
    pixels = np.empty(len(picture.pixels), np.float32)
    picture.pixels.foreach_get(pixels)
    return pixels


def contents(scene):
    """All of a bake, bit by bit."""
    bake = store.load_bake(scene)
    arrays = {**bake.images, **bake.entries, **bake.points}
    return {name: array.tobytes() for name, array in arrays.items()}, image(scene).tobytes()


def in_files(scene):
    """(of the bake's images, those that lie in files, those that are packed)."""
    images = store.images_of(scene)
    return sum(store.path_of(i) is not None for i in images), sum(i.packed_file is not None for i in images)


def move_lamp(scene, x=0.4):
    next(item for item in scene.objects if item.type == "LIGHT").location.x = x
    bpy.context.view_layer.update()


def follows(scene):
    """The image follows the lamp, from what is stored alone."""
    sessions.forget(scene)
    before = image(scene)
    move_lamp(scene, 0.45)
    after = image(scene)
    assert not np.allclose(before, after, rtol=0.01)
    return True


def files(blend):
    folder = beside.folder_of(blend)
    return sorted(path.name for path in folder.iterdir()) if folder.exists() else None
