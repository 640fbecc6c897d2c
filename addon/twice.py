"""Light that the render engine adds by itself to what a bake already holds, and so counts twice."""

from __future__ import annotations

from collections.abc import Iterator

import bpy

from . import former, linking, store, world_light
from .obstacles import WARNING, Facts, Obstacle, about
from .refusals import named

EEVEE = linking.EEVEE
# The fast GI method that only darkens, and adds no light.
NO_LIGHT = "AMBIENT_OCCLUSION_ONLY"


def find(facts: Facts) -> Iterator[Obstacle]:
    """One for each source of light that counts twice in the engine that the scene renders with."""
    scene = facts.scene
    if scene.render.engine in EEVEE:
        yield from _world(scene)
        yield from _fast_gi(scene)
        yield from _probes(facts)
        yield from _lamps(scene)
    elif scene.render.engine == "CYCLES" and scene.lightpanes.cycles and store.find_entries(scene) is not None:
        yield from _cycles(scene)


def give_back(scene: bpy.types.Scene) -> None:
    """Undo what the fixes of these obstacles changed; the bake that made them needed is gone."""
    former.give_back(scene)
    for world in _worlds(scene):
        world_light.give_back(world)


def is_changed(scene: bpy.types.Scene) -> bool:
    """Whether there is anything to give back."""
    return former.is_any(scene) or any(world_light.is_hidden(world) for world in _worlds(scene))


def _worlds(scene) -> list[bpy.types.World]:
    """The scene's world, and those that no other scene has: it may have had them when their light was hidden."""
    others = {other.world for other in bpy.data.scenes if other != scene}
    return [world for world in bpy.data.worlds if world == scene.world or world not in others]


def _world(scene) -> Iterator[Obstacle]:
    world = scene.world
    if not world_light.shines(world):
        return
    if world_light.is_hidden(world):
        if world_light.is_outdated(world):
            sentence = f"EEVEE still shows world '{world.name}' as it was before its nodes were linked anew."
            button = "Show It as It Is" if world.library is None else ""
            yield Obstacle("WORLD_OUTDATED", WARNING, sentence, button=button)
        return
    sentence = f"EEVEE lights surfaces with world '{world.name}', whose light is in the bake too, with its shadows."
    others = [other for other in bpy.data.scenes if other != scene and other.world == world]
    if world.library is not None:
        sentence += " The world is linked from another file: make it local."
    elif others:
        sentence += f" Scene '{others[0].name}' has the same world: make it a single user."
    free = world.library is None and not others
    yield Obstacle("WORLD_LIGHT", WARNING, sentence, button="Show It to the Camera Only" if free else "")


def _fast_gi(scene) -> Iterator[Obstacle]:
    eevee = scene.eevee
    if eevee.use_raytracing and not only_darkens(eevee):
        sentence = "EEVEE's ray tracing adds bounced light of its own to that of the bake."
        yield Obstacle("FAST_GI", WARNING, sentence, button="Keep Reflections Only")


def only_darkens(eevee: bpy.types.SceneEEVEE) -> bool:
    """Whether ray tracing leaves diffuse surfaces to a fast GI that adds no light."""
    rough = eevee.ray_tracing_options.trace_max_roughness
    return eevee.use_fast_gi and eevee.fast_gi_method == NO_LIGHT and rough < 1


def _probes(facts) -> Iterator[Obstacle]:
    probes = [item for item in facts.rendered if item.type == "LIGHT_PROBE" and item.data.type == "VOLUME"]
    if probes:
        probes.sort(key=lambda item: item.name)
        sentence = f"The indirect light that light probe {named(probes)} holds, once baked, adds to that of the bake."
        button = "Hide Light Probes" if any(item.library is None for item in probes) else ""
        yield Obstacle("LIGHT_PROBES", WARNING, sentence, about(*probes), button)


def _lamps(scene) -> Iterator[Obstacle]:
    if scene.lightpanes.direct == "BAKED" and not linking.is_known(scene.render.engine):
        version = ".".join(map(str, bpy.app.version[:2]))
        sentence = f"EEVEE of Blender {version} knows no light linking, so lamps light what holds their light already."
        yield Obstacle("LAMPS", WARNING, sentence, button="Direct Light: Engine")


def _cycles(scene) -> Iterator[Obstacle]:
    cycles = scene.cycles
    if cycles.diffuse_bounces > 0:
        sentence = "Cycles' own diffuse bounces are on again, beside the baked light that Show in Cycles brings."
        yield Obstacle("CYCLES_BOUNCES", WARNING, sentence, button="Set Diffuse Bounces to 0")
    if store.find_image(scene, store.CAUSTICS) is not None:
        yield from _cycles_caustics(scene)
    if cycles.use_fast_gi:
        sentence = "Cycles' Fast GI Approximation adds ambient light to the baked light that Show in Cycles brings."
        yield Obstacle("CYCLES_FAST_GI", WARNING, sentence, button="Turn Fast GI Off")


def _cycles_caustics(scene) -> Iterator[Obstacle]:
    cycles = scene.cycles
    if cycles.diffuse_bounces > 0 and (cycles.caustics_reflective or cycles.caustics_refractive):
        sentence = "Cycles' own caustics are on again, beside the baked ones that Show in Cycles brings."
        yield Obstacle("CYCLES_CAUSTICS", WARNING, sentence, button="Turn Caustics Off")
    lamps = [
        item
        for item in scene.objects
        if item.type == "LIGHT" and getattr(getattr(item.data, "cycles", None), "is_caustics_light", False)
    ]
    if lamps:
        sentence = f"Cycles adds shadow caustics of {named(lamps)} to the baked ones that Show in Cycles brings."
        button = "Turn Shadow Caustics Off" if any(item.data.library is item.library is None for item in lamps) else ""
        yield Obstacle("SHADOW_CAUSTICS", WARNING, sentence, about(*lamps), button)
