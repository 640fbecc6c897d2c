"""Which objects mirror or refract sharply enough to focus light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene import Material, Scene

SHARP = 0.1
"""Roughness up to which a surface counts as smooth, as Blender's sliders have it."""

STRONG = 0.1
"""Part of the light that a surface must mirror or let in, seen straight on, to count."""


@dataclass(frozen=True)
class Casters:
    """Objects that cast caustics.

    objects: their names. index: (k,) int32 of them among the scene's objects. triangles: (T,) bool, those of the
    scene's triangles that mirror or refract; they block the lamps' shadow rays where caustics are on, but for what is
    clear in their optics, or light through glass would count twice (`rays.Tracer`, solid).
    """

    objects: tuple[str, ...]
    index: np.ndarray
    triangles: np.ndarray


def casters(scene: Scene) -> Casters | None:
    """The casters of a scene, None where there are none. Reads materials only.

    Objects that cast no shadow are none: lamps shine straight through them.
    """
    sharp = np.array([is_caster(m) for m in scene.materials], bool)
    if not sharp.any():
        return None
    casts = np.array([o.casts_shadow for o in scene.objects], bool)
    triangles = sharp[scene.triangle_material] & casts[scene.triangle_object]
    index = np.flatnonzero(np.bincount(scene.triangle_object[triangles], minlength=len(scene.objects)))
    if not len(index):
        return None
    return Casters(tuple(scene.objects[k].name for k in index), index.astype(np.int32), triangles)


def is_caster(material: Material) -> bool:
    """Whether a material mirrors or refracts sharply, and more of the light than it scatters."""
    optics = material.optics
    if optics is None or optics.roughness > SHARP:
        return False
    facing = ((optics.ior - 1) / (optics.ior + 1)) ** 2 if optics.ior > 0 else 0.0
    strongest = max(max(optics.mirror), max(optics.glass), facing * max(optics.gloss))
    return strongest >= max(STRONG, max(material.albedo))


def passes_on(material: Material) -> bool:
    """Whether bounced light goes on at a material by its lobes: casters, and metals however rough. Not what glows, whose
    light is that of all rays that meet it."""
    optics = material.optics
    if optics is None or max(material.emission) > 0:
        return False
    metal = max(optics.mirror) >= STRONG and not max(optics.glass) and not max(optics.gloss)
    return metal or is_caster(material)
