"""What only Cycles can evaluate, worked out before it is wanted: skies that are not of one colour, means of materials.

A render engine may not bake while it renders, so this is done when a render begins, or when Blender is idle; the result
is kept by what the nodes say.
"""

from __future__ import annotations

import bpy
import numpy as np

from ..core.scene import Sky
from . import environment, maps, materials

KINDS = ("albedo", "emission", "transmission")

_skies: dict[str, Sky | None] = {}
_means: dict[bytes, dict[str, np.ndarray]] = {}


def sky(world: bpy.types.World | None, warnings: list[str]) -> Sky | None:
    """The world's light, None where it is black or not known yet."""
    if not environment.lights_surfaces(world):
        return None
    if environment.plain(world) is not None:
        return environment.read(world, warnings)
    key = environment.digest(world)
    if key not in _skies:
        warnings.append(f"World '{world.name}' is not of one colour and was not evaluated in time: it is shown black.")
        return None
    return _skies[key]


def mean(material: bpy.types.Material | None, kind: str) -> np.ndarray | None:
    """(3,) mean of what varies over a material ("albedo", …), None where it is not known."""
    if material is None:
        return None
    return _means.get(materials.digest(material), {}).get(kind)


def missing(scene: bpy.types.Scene) -> bool:
    """Whether there is anything that `prepare` would work out."""
    world = scene.world
    if environment.lights_surfaces(world) and environment.plain(world) is None:
        if environment.digest(world) not in _skies:
            return True
    return bool(_unknown(scene))


def prepare(context: bpy.types.Context, scene: bpy.types.Scene) -> list[str]:
    """Work out what is missing; on the main thread, and not while a render runs. Returns sentences for the user."""
    warnings: list[str] = []
    world = scene.world
    if environment.lights_surfaces(world) and environment.plain(world) is None:
        key = environment.digest(world)
        if key not in _skies:
            _skies[key] = environment.read(world, warnings)
    unknown = _unknown(scene)
    if unknown:
        for material, kinds in unknown.items():
            _means[materials.digest(material)] = maps.means(context, material, kinds, warnings)
    return warnings


def forget() -> None:
    """Drop everything, as when another file is opened."""
    _skies.clear()
    _means.clear()


def _unknown(scene) -> dict[bpy.types.Material, list[str]]:
    """Materials whose mean is not known, and of what."""
    from . import textures

    used = {
        slot.material
        for item in scene.objects
        if item.type in {"MESH", "CURVE", "SURFACE", "FONT", "META"} and not item.hide_render
        for slot in item.material_slots
        if slot.material is not None
    }
    found = {}
    for material in sorted(used, key=lambda each: each.name_full):
        if materials.digest(material) in _means:
            continue
        look = materials.look(material, [])
        kinds = [kind for kind in KINDS if getattr(look, kind) is None]
        if kinds == ["albedo"] and textures.has_texture(material):
            continue
        if kinds:
            found[material] = kinds
    return found
