"""Objects that show the light of another bake than their scene's: appended, linked, or shared with another scene."""

from __future__ import annotations

import bpy

from . import claims, nodes, store
from .meshes import BAKE


def carriers(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """These objects, by name; members of instanced collections included."""
    found = [item for item in claims.baked_objects(scene) if not claims.belongs(item, scene) or _groups(item, scene)]
    return sorted(found, key=lambda item: item.name)


def source(item: bpy.types.Object, scene: bpy.types.Scene) -> bpy.types.Scene | None:
    """The other scene of this file whose light one of the scene's carriers shows."""
    groups = _groups(item, scene)
    for other in bpy.data.scenes:
        if other != scene and store.find_entries(other) is not None:
            if nodes.group_of(other) in groups or (not groups and item.get(BAKE) == store.bake_key(other)):
                return other
    return None


def adoptable(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """A bake that was appended with its objects, which the scene may make its own by pointing to it."""
    keys = {item.get(BAKE) for item in carriers(scene)}
    found = [entries for entries in store.strays(scene) if entries.data.get(store.KEY) in keys]
    return found[0] if found and store.find_entries(scene) is None else None


def _groups(item, scene) -> set[bpy.types.NodeTree]:
    """Groups of other bakes than the scene's by which the object's materials show light."""
    shown = {nodes.shown_by(slot.material) for slot in item.material_slots if slot.material is not None}
    return shown - {None, nodes.group_of(scene)}
