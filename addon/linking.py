"""Keeps lamps off objects whose texture holds their light already, by Blender's own light linking.

The lamps' Receiver collection is then one of ours, which names these objects as excluded. Everything else is lit and
shadowed as before. A lamp that can't be kept off by this shines by itself, and stays out of the texture.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator

import bpy

from . import store

RECEIVERS = "Lightpanes Lamps"

EEVEE = {"BLENDER_EEVEE", "BLENDER_EEVEE_NEXT"}

EEVEE_KNOWS = (4, 3)
"""The first Blender whose EEVEE honours light linking."""


# Scenes, by session_uid, whose links stay as they are for now.
_suspended: set[int] = set()


def is_known(engine: str) -> bool:
    """Whether an engine honours light linking in this Blender."""
    return engine == "CYCLES" or (engine in EEVEE and bpy.app.version >= EEVEE_KNOWS)


def is_users(lamp: bpy.types.Object) -> bool:
    """Whether the lamp, or an object that shines, has light linking of the user's own."""
    links = lamp.light_linking
    if links is None:
        return False
    receivers = links.receiver_collection
    return links.blocker_collection is not None or (receivers is not None and store.TAG not in receivers)


def obstacle(lamp: bpy.types.Object) -> str:
    """Why a lamp can't be kept off objects, as the end of a sentence about it; "" where it can."""
    if lamp.library is not None:
        return "is linked from another file"
    if is_users(lamp):
        return "has light linking of its own"
    others = lamp.users_scene
    return f"is in {len(others)} scenes" if len(others) > 1 else ""


def keep_off(scene: bpy.types.Scene, lamps: Iterable[bpy.types.Object], objects: Iterable[bpy.types.Object]) -> None:
    """Let these lamps, and no others of the scene, leave the objects dark. Nothing is touched where that is so."""
    if scene.session_uid in _suspended:
        return
    lamps, objects = set(lamps), set(objects)
    if not lamps or not objects:
        give_back(scene)
        return
    group = scene.lightpanes.receivers
    if group is None or _is_shared(scene, group):
        # of a scene that this one is a copy of
        former, group = group, bpy.data.collections.new(RECEIVERS)
        group[store.TAG] = RECEIVERS
        _release(former, scene)
        scene.lightpanes.receivers = group
    there = set(group.objects)
    for item in there - objects:
        group.objects.unlink(item)
    for item in objects - there:
        group.objects.link(item)
    for member in group.collection_objects:
        if member.light_linking.link_state != "EXCLUDE":
            member.light_linking.link_state = "EXCLUDE"
    for lamp in _linked(group) - lamps:
        lamp.light_linking.receiver_collection = None
    for lamp in lamps:
        if lamp.light_linking.receiver_collection != group:
            lamp.light_linking.receiver_collection = group


def give_back(scene: bpy.types.Scene) -> None:
    """Let all lamps of the scene light everything again."""
    group = scene.lightpanes.receivers
    if group is None or scene.session_uid in _suspended:
        return
    shared = _is_shared(scene, group)
    _release(group, scene if shared else None)
    scene.lightpanes.receivers = None
    if not shared:
        bpy.data.collections.remove(group)


@contextlib.contextmanager
def suspended(scene: bpy.types.Scene) -> Iterator[None]:
    """All lamps light everything meanwhile, whatever handlers ask for."""
    group = scene.lightpanes.receivers
    lamps = _linked(group)
    _suspended.add(scene.session_uid)
    for lamp in lamps:
        lamp.light_linking.receiver_collection = None
    try:
        yield
    finally:
        _suspended.discard(scene.session_uid)
        for lamp in lamps:
            lamp.light_linking.receiver_collection = group


def _is_shared(scene, group) -> bool:
    return any(other.lightpanes.receivers == group for other in bpy.data.scenes if other != scene)


def _linked(group) -> set[bpy.types.Object]:
    if group is None:
        return set()
    lamps = (item for item in bpy.data.objects if item.type == "LIGHT" and item.library is None)
    return {lamp for lamp in lamps if lamp.light_linking.receiver_collection == group}


def _release(group, scene) -> None:
    """scene: whose lamps alone are meant, None for all."""
    for lamp in _linked(group):
        if scene is None or scene in lamp.users_scene:
            lamp.light_linking.receiver_collection = None
