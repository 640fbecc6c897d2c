"""Obstacles of caustics, as far as Blender's data tell: glass without an inside, and more casters than photons are for."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np

from ..core.caustics.groups import encloses
from . import caustics
from .obstacles import WARNING, Facts, Obstacle, about
from .optics import open_sentence, read_optics
from .refusals import is_linked, named

LEAST = 250
"""Photons for each object that focuses light: with fewer its caustics are blots."""

FACES = 500_000
"""Of what focuses light, above which it is slow to follow."""

LOOKED_AT = 20_000
"""Faces of a mesh that is looked at for holes."""

THICK = 0.01
"""Of Solidify, in parts of an object's largest side."""


def find(facts: Facts) -> Iterator[Obstacle]:
    """Those that a look at shapes and materials finds."""
    if not facts.scene.lightpanes.caustics:
        return
    made: dict[bpy.types.Material, bool] = {}
    for item in facts.shown:
        for slot in item.material_slots:
            if slot.material is not None and slot.material not in made:
                made[slot.material] = caustics.is_made_of(slot.material)
    focusing = [
        item for item in facts.shown if item.visible_shadow and any(made.get(s.material) for s in item.material_slots)
    ]
    yield from _open(focusing, made)
    yield from _many(facts, focusing)
    huge = [item for item in focusing if item.type == "MESH" and len(item.data.polygons) > FACES]
    if huge:
        count = sum(len(item.data.polygons) for item in huge) / 1e6
        yield Obstacle(
            "HUGE_CASTER",
            WARNING,
            f"{named(huge)} focus{'es' * (len(huge) == 1)} light with {count:.1f} million faces: caustics take long to follow "
            "it. A Decimate modifier, or more roughness than 0.1 where none are wanted, helps.",
            about(*huge),
        )


def _open(focusing, made) -> Iterator[Obstacle]:
    for item in focusing:
        if item.type != "MESH" or item.modifiers or item.mode == "EDIT" or not _is_glass(item, made):
            continue
        if is_open(item.data):
            button = "" if is_linked(item) else "Add Solidify"
            yield Obstacle("OPEN_GLASS", WARNING, open_sentence(item.name), about(item), button, str(item.session_uid))


def _is_glass(item, made) -> bool:
    materials = {slot.material for slot in item.material_slots if made.get(slot.material)}
    return any((found := read_optics(material, [])) is not None and any(found.glass) for material in materials)


def is_open(mesh: bpy.types.Mesh) -> bool:
    """Whether it has no inside; meshes of many faces are left to the bake."""
    if not 0 < len(mesh.polygons) <= LOOKED_AT:
        return False
    mesh.calc_loop_triangles()
    corners, place = np.empty(3 * len(mesh.loop_triangles), np.int32), np.empty(3 * len(mesh.vertices), np.float32)
    mesh.loop_triangles.foreach_get("vertices", corners)
    mesh.vertices.foreach_get("co", place)
    return not encloses(place.reshape(-1, 3)[corners.reshape(-1, 3)])


def _many(facts, focusing) -> Iterator[Obstacle]:
    asked = facts.scene.lightpanes
    photons, needed = caustics.photons_asked(facts.scene), photons_needed(len(focusing))
    if photons < needed:
        budget = "Photons" if asked.photons else "Error"
        yield Obstacle(
            "MANY_CASTERS",
            WARNING,
            f"{len(focusing)} objects share the {photons:,} photons of each lamp that {budget} asks for, too few for their "
            "caustics: raise Photons, or join those that stand together.",
            about(*focusing),
            f"Photons: {needed:,}",
        )


def photons_needed(objects: int) -> int:
    """Of each lamp, for so many objects."""
    return min(LEAST * objects, caustics.MOST)
