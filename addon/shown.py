"""What a render engine is to show, read from the depsgraph that Blender gives it; nothing of Blender is changed."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from ..core.preview import Baked, Settings, Surfaces
from ..core.scene import Light, Sky
from . import extract, lamps, prepared, sessions, store, textures


@dataclass
class Lighting:
    """What may change while the surfaces stay. key: of all of it."""

    lights: tuple[Light, ...]
    sky: Sky | None
    baked: Baked | None
    key: str


def read_surfaces(depsgraph: bpy.types.Depsgraph, warnings: list[str]) -> Surfaces | None:
    """The surfaces with their looks, None where there is no face. Raises SceneError, naming the object."""
    looks = textures.Textures(warnings)
    scene, used = extract.extract_shown(depsgraph, looks.layer_of, warnings)
    if scene is None:
        return None
    source = depsgraph.scene.original
    albedo = store.read_image(source, store.ALBEDO) if is_fresh(source) else None
    found = looks.read(scene, used, albedo is not None)
    if albedo is not None:
        scene.albedo_map = np.ascontiguousarray(albedo[..., :3])
    return Surfaces(scene, found)


def read_lighting(depsgraph: bpy.types.Depsgraph, warnings: list[str]) -> Lighting:
    """Lamps, sky and what a bake holds."""
    source = depsgraph.scene.original
    lights = lamps.read_lights(depsgraph, warnings)
    if depsgraph.mode == "VIEWPORT":
        layer = source.view_layers[depsgraph.view_layer.name]
        hidden = {
            item.name for item in source.objects if item.type == "LIGHT" and not item.visible_get(view_layer=layer)
        }
        lights = tuple(light for light in lights if light.name not in hidden)
    sky = prepared.sky(depsgraph.scene.world, warnings)
    baked, shown = read_bake(source)
    key = repr((lamps.lamp_key(lights), None if sky is None else hash(sky.radiance.tobytes()), shown))
    return Lighting(lights, sky, baked, key)


def is_fresh(scene: bpy.types.Scene) -> bool:
    """Whether the scene has a bake, and nothing is known to have changed since."""
    if getattr(scene, "lightpanes", None) is None or store.find_entries(scene) is None:
        return False
    current = sessions.of(scene)
    return current is not None and not current.stale and not current.error


def read_bake(scene: bpy.types.Scene) -> tuple[Baked | None, str]:
    """The light that a fresh bake holds as its images show it, and a key of that."""
    if not is_fresh(scene):
        return None, ""
    irradiance = store.read_image(scene, store.IRRADIANCE)
    if irradiance is None:
        return None, ""
    # what lamps bring is traced, so it must not come from the image as well
    held = store.STEADY if store.find_image(scene, store.STEADY) is not None else store.DIRECT
    first = store.read_image(scene, held) if held == store.STEADY or store.holds_direct(scene) else None
    caustics = store.read_image(scene, store.CAUSTICS)
    images = [
        None if image is None else np.ascontiguousarray(image[..., :3]) for image in (irradiance, first, caustics)
    ]
    current = sessions.of(scene)
    return Baked(*images), repr((current.key, current.shown))


def settings_of(scene: bpy.types.Scene, **more) -> Settings:
    """The preview's settings for a scene."""
    mine = scene.lightpanes
    world = scene.world
    return Settings(
        bounces=mine.bounces,
        filter_width=scene.render.filter_size,
        ao_distance=world.light_settings.distance if world is not None else 10.0,
        transparent=scene.render.film_transparent,
        seed=mine.seed,
        **more,
    )
