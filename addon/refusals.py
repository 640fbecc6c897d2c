"""Why objects get no light, or get it elsewhere than asked: in one wording for the panel, which looks ahead, and for a
bake, which knows."""

from __future__ import annotations

from collections.abc import Iterable

import bpy

from .meshes import LAYER

MOST_LAYERS = 8
"""UV layers that Blender allows a mesh."""


def named(items: Iterable) -> str:
    """'A', 'B' and 3 more."""
    names = [f"'{item.name}'" for item in items]
    if len(names) > 3:
        names[2:] = [f"{len(names) - 2} more"]
    return " and ".join((", ".join(names[:-1]), names[-1])) if len(names) > 1 else names[0]


def in_edit_mode(item: bpy.types.Object) -> str:
    return f"'{item.name}' is in Edit Mode: leave it (Tab) and bake again."


def has_no_layer_left(item: bpy.types.Object) -> bool:
    """Whether our UV layer finds no place beside others."""
    layers = item.data.uv_layers
    return LAYER not in layers and len(layers) >= MOST_LAYERS


def no_layer_left(item: bpy.types.Object) -> str:
    return (
        f"'{item.name}' has {MOST_LAYERS} UV layers, the most that Blender allows: delete one, or exclude the object."
    )


def has_foreign_attribute(item: bpy.types.Object) -> bool:
    """Whether the user's own attribute stands where our UV layer would go."""
    return LAYER not in item.data.uv_layers and LAYER in item.data.attributes


def foreign_attribute(item: bpy.types.Object) -> str:
    return f"'{item.name}' has an attribute named '{LAYER}' that is not a UV layer: rename it."


def is_linked(item: bpy.types.Object) -> bool:
    return item.library is not None or item.data.library is not None


def linked(items: list[bpy.types.Object]) -> str:
    come = "comes from a linked library: it blocks and reflects"
    receives = "receives"
    if len(items) > 1:
        come, receives = "come from a linked library: they block and reflect", "receive"
    return (
        f"{named(items)} {come} light but {receives} none. "
        "Use Object > Relations > Make Local > Selected Objects and Data."
    )


def instances(owner: bpy.types.Object) -> str:
    return (
        f"Instances made by '{owner.name}' block and reflect light but receive none. "
        "Use Object > Apply > Make Instances Real."
    )


def not_at_vertices(item: bpy.types.Object, reason: str) -> str:
    return f"'{item.name}' can't be lit at its vertices and takes a texture instead, because it {reason}."


def shares_mesh(item: bpy.types.Object, other: bpy.types.Object) -> str:
    return not_at_vertices(
        item,
        f"shares its mesh with '{other.name}': use Object > Relations > Make Single User > Object & Data",
    )


def has_own_light(item: bpy.types.Object, attribute: str) -> str:
    return not_at_vertices(item, f"has an attribute '{attribute}' of its own: rename or delete that")


def reshaped(item: bpy.types.Object) -> str:
    return not_at_vertices(
        item, "has modifiers that change its vertices, and the light belongs to the mesh without them: apply them"
    )
