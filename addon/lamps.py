"""Lamps and the world, read from Blender as Cycles takes them.

Measured on Blender 4.5 and 5.2 against Cycles: the scale of a point, spot or sun changes neither its
size nor its power, uneven scale bends a spot's cone; an area lamp's size scales with its object.
Custom distances and diffuse factors are EEVEE's alone.
"""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import fields

import bpy
import numpy as np

from ..core.scene import Light, SceneError, Sky
from . import cycles, environment, groups, linking, visibility
from .trees import heeds_nodes

BOUNCES = 8
"""A lamp whose light ends after fewer bounces gets a warning: panes hold all bounces."""


def read_lights(
    depsgraph: bpy.types.Depsgraph, warnings: list[str], owners: dict[str, bpy.types.Object] | None = None
) -> tuple[Light, ...]:
    """All lamps that light diffuse surfaces in a render, instanced ones too; their names are unique.

    Lamps that only the viewport hides shine: it is the render that counts. owners: filled with each one's object, by
    the lamp's name.
    """
    owners = {} if owners is None else owners
    rendered = visibility.rendered_objects(depsgraph.view_layer)
    scene, lights, met = depsgraph.scene, [], set()
    names: Counter[str] = Counter()
    for instance in depsgraph.object_instances:
        obj = instance.object
        if obj.type != "LIGHT":
            continue
        original, parent = obj.original, instance.parent.original if instance.is_instance else None
        met.add(original if parent is None else None)
        shown = (original if parent is None else parent) in rendered and (
            parent is not None or not _is_pattern(original)
        )
        if parent is not None and parent.instance_type == "COLLECTION" and parent.instance_collection:
            shown = shown and original in visibility.rendered_members(parent.instance_collection)
        if not shown or not _shines(obj):
            continue
        name = original.name if parent is None else f"{parent.name} > {original.name}"
        names[name] += 1
        if names[name] > 1:
            name = f"{name} {names[name]}"
        owners[name] = original
        lights.append(_read(obj, np.array(instance.matrix_world, np.float64), scene, warnings, name))
    for obj in sorted(rendered - met, key=lambda o: o.name):
        if obj.type == "LIGHT" and _shines(obj) and not _is_pattern(obj):
            owners[obj.name] = obj
            lights.append(_read(obj, np.array(obj.matrix_world, np.float64), scene, warnings, obj.name))
    return tuple(light for light in lights if light is not None)


def lamp_key(lights: Iterable[Light]) -> str:
    """Of all that decides the lamps' light, their names included."""
    digest = hashlib.blake2b(digest_size=12)
    for light in lights:
        digest.update(repr((light.name, light.geometry, light.power.tobytes())).encode())
    return digest.hexdigest()


def to_json(light: Light) -> dict:
    """A lamp as JSON holds it."""
    plain = lambda value: value.tolist() if isinstance(value, np.ndarray) else value  # noqa: E731
    return {part.name: plain(getattr(light, part.name)) for part in fields(light)}


def from_json(values: dict) -> Light:
    """The lamp that `to_json` wrote, exactly."""
    return Light(**{**values, "size": tuple(values["size"])})


def read_sky(world: bpy.types.World | None, warnings: list[str]) -> Sky | None:
    """The world's light; None where it is black or kept from diffuse surfaces.

    A constant background becomes one texel, everything else a map that Cycles evaluates.
    """
    return environment.read(world, warnings) if environment.lights_surfaces(world) else None


def _is_pattern(obj) -> bool:
    """Whether an object is only what its parent's vertices or faces repeat, and not rendered itself."""
    return obj.parent is not None and obj.parent.instance_type in {"VERTS", "FACES"}


def _shines(obj) -> bool:
    """Whether diffuse surfaces get light from the lamp at all; portals only guide the sky's rays."""
    # Cycles' settings from the original: changes to them do not reach evaluated copies by themselves
    portal = obj.data.type == "AREA" and cycles.setting(obj.data.original, "is_portal", False)
    return obj.visible_diffuse and not obj.hide_render and not portal and obj.data.energy != 0


def _read(obj, matrix, scene, warnings, name) -> Light | None:
    data = obj.data
    sizes = np.linalg.norm(matrix[:3, :3], axis=0)
    frame = np.eye(4)
    frame[:3, 3] = matrix[:3, 3]
    flat = sizes < 1e-12
    if data.type in {"SPOT", "SUN", "AREA"} and not np.isfinite(matrix).all():
        raise SceneError(f"Lamp '{name}' has a place that is not a number; reset its transform.")
    if flat.any():
        if data.type == "AREA" and flat[:2].any():
            return None
        if data.type != "POINT":
            warnings.append(f"Lamp '{name}' is scaled to zero along an axis and was left out; reset its scale.")
            return None
    else:
        frame[:3, :3] = matrix[:3, :3] / sizes
    power = _power(data) * _node_factor(data, warnings, name)
    if not power.any():
        return None
    _warn(obj, scene, frame, warnings, name)
    settings = {}
    if data.type in {"POINT", "SPOT"}:
        settings["radius"] = data.shadow_soft_size
        # Cycles' soft falloff: a disk that faces whatever it lights, in place of a sphere
        settings["shape"] = "DISK" if getattr(data, "use_soft_falloff", True) else "SQUARE"
        if not data.normalize:
            power = power * (4 * math.pi * data.shadow_soft_size**2 or 4.0)
    if data.type == "SPOT":
        settings.update(spot_angle=data.spot_size, spot_blend=data.spot_blend)
        settings["size"] = (_even(sizes[0] / sizes[2]), _even(sizes[1] / sizes[2]))
    if data.type == "SUN":
        settings["angle"] = data.angle
        if not data.normalize and data.angle > 0:
            power = power * math.pi * math.sin(data.angle / 2) ** 2
    if data.type == "AREA":
        second = data.size if data.shape in {"SQUARE", "DISK"} else data.size_y
        width, height = data.size * sizes[0], second * sizes[1]
        if width * height == 0:
            return None
        settings.update(shape=data.shape, size=(float(width), float(height)), spread=data.spread)
        if not data.normalize:
            power = power * width * height * (math.pi / 4 if data.shape in {"DISK", "ELLIPSE"} else 1)
    # without the add-on registered there is no setting, and every lamp is live
    mine = getattr(data.original, "lightpanes", None)
    live = mine is None or mine.live
    group = groups.group_of(data.original)
    return Light(name, data.type, frame, power, casts_shadow=data.use_shadow, live=live, group=group, **settings)


def _even(ratio: float) -> float:
    """Exactly 1 for a scale that is even up to rounding: round cones are the fast case."""
    return 1.0 if abs(ratio - 1) < 1e-5 else float(ratio)


def _power(data) -> np.ndarray:
    """(3,) what Cycles multiplies a lamp's shader with."""
    color = np.array(data.color, np.float64)
    if getattr(data, "use_temperature", False):
        color = color * np.array(data.temperature_color, np.float64)
    return color * data.energy * 2.0 ** getattr(data, "exposure", 0.0)


def _node_factor(data, warnings, name) -> np.ndarray:
    """(3,) colour times strength of a lamp's plain Emission node; ones where there are no nodes."""
    tree = data.node_tree
    if not heeds_nodes(data):
        return np.ones(3)
    output = tree.get_output_node("CYCLES")
    source = environment.linked_node(output.inputs["Surface"]) if output else None
    if source is None:
        return np.zeros(3)
    if source.type == "EMISSION" and not source.mute:
        color = environment.constant(source.inputs["Color"])
        strength = environment.constant(source.inputs["Strength"])
        if color is not None and strength is not None:
            return color * strength
    warnings.append(
        f"Lamp '{name}' has nodes that are more than an Emission of one colour and strength; "
        "it is lit by its own colour and power alone."
    )
    return np.ones(3)


def _warn(obj, scene, frame, warnings, name) -> None:
    if linking.is_users(obj):
        warnings.append(f"Lamp '{name}' uses light linking, which is not honoured: it lights and shadows all objects.")
    limit = min(BOUNCES, cycles.setting(scene, "max_bounces", BOUNCES))
    bounces = cycles.setting(obj.data.original, "max_bounces", limit)
    if bounces < limit:
        warnings.append(f"Lamp '{name}' limits its bounces to {bounces}, which is not honoured: all count.")
    skew = np.abs(frame[:3, :3].T @ frame[:3, :3] - np.eye(3)).max()
    if obj.data.type in {"AREA", "SPOT"} and skew > 1e-3:
        warnings.append(
            f"Lamp '{name}' is sheared by its parent's scale; it is lit as if its axes were square. Apply that scale."
        )
