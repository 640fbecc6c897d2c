"""Baked objects, and the bake that each is lit by.

An object takes its baked light along when it is appended or linked into another file, and shares it with the scenes
that it is in. So each names its bake.
"""

from __future__ import annotations

import bpy

from . import store
from .meshes import BAKE


def members(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The scene's objects, members of instanced collections included."""
    objects, pending = {}, list(scene.objects)
    while pending:
        item = pending.pop()
        if item in objects:
            continue
        objects[item] = True
        if item.instance_collection is not None:
            pending.extend(item.instance_collection.all_objects)
    return list(objects)


def baked_objects(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Those among them that show baked light."""
    return [item for item in members(scene) if "lightpanes_baked" in item]


def claim(scene: bpy.types.Scene) -> None:
    """Let the objects that the scene's bake, just made, has given light say so."""
    key = store.bake_key(scene)
    for item in scene.objects:
        if "lightpanes_baked" in item and item.library is None:
            item[BAKE] = key


def belongs(item: bpy.types.Object, scene: bpy.types.Scene) -> bool:
    """Whether a baked object names the scene's bake as its own."""
    key = store.bake_key(scene)
    # files of before objects named their bake
    return key is not None and item.get(BAKE, key) == key
